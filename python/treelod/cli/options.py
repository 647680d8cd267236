"""Options that several commands share, and what their words mean."""

from __future__ import annotations

import contextlib
import inspect
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from treelod.plants import PRESETS
from treelod.techniques import REGISTRY, FullMesh

__all__ = [
    "AdapterName",
    "Backend",
    "LeafCount",
    "PlantName",
    "ReportFolder",
    "Seed",
    "Threads",
    "TimedBackend",
    "Verbose",
    "all_techniques",
    "counts_of",
    "frame_size_of",
    "numbers",
    "technique_of",
    "value_of",
]


class Backend(StrEnum):
    """What draws the frames that are timed."""

    CPU = "cpu"
    GPU = "gpu"


_NO_SETTINGS = {"progress", "threads", "views"}
"""What a build takes besides a technique's own parameters: options of the command, or objects."""

PlantName = Annotated[
    str,
    typer.Argument(
        metavar="PLANT",
        help=f"A GLB, glTF, OBJ or PLY file, or a plant to grow: {', '.join(PRESETS)}.",
    ),
]
ReportFolder = Annotated[
    Path, typer.Option("--output", "-o", help="Folder for the report; made if missing.")
]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Log what happens; show tracebacks of errors.")
]
Threads = Annotated[
    int | None,
    typer.Option("--threads", min=1, show_default="all cores", help="Threads that draw."),
]
TimedBackend = Annotated[
    Backend,
    typer.Option(
        "--backend",
        help="What draws the frames that are timed.",
    ),
]
AdapterName = Annotated[
    str | None,
    typer.Option(
        "--adapter",
        metavar="NAME",
        show_default="TREELOD_ADAPTER, else the first",
        help="Which graphics card, by a part of its name, its kind or its place in `treelod gpu`.",
    ),
]
Seed = Annotated[
    int | None, typer.Option("--seed", min=0, show_default="1", help="Seed of a grown plant.")
]
LeafCount = Annotated[
    int | None,
    typer.Option(
        "--leaf-count", min=1, show_default="the preset's", help="Leaves of a grown plant."
    ),
]


def all_techniques() -> list[str]:
    """Every technique but the reference, by name."""
    return [name for name in REGISTRY if name != FullMesh.name]


def technique_of(text: str) -> tuple[str, dict[str, Any]]:
    """Read ``NAME:KEY=VALUE,...``; the whole text is the technique's label."""
    name, _, tail = text.partition(":")
    if name not in REGISTRY:
        msg = f"there is no technique {name!r}; there are {', '.join(REGISTRY)}"
        raise typer.BadParameter(msg, param_hint="--technique")
    known = [
        parameter.name
        for parameter in inspect.signature(REGISTRY[name].build).parameters.values()
        if parameter.kind is parameter.KEYWORD_ONLY and parameter.name not in _NO_SETTINGS
    ]
    params: dict[str, Any] = {}
    for part in filter(None, tail.split(",")):
        key, separator, value = part.partition("=")
        if not separator or key not in known:
            msg = f"{part!r} in {text!r}: parameters of {name} are {', '.join(known) or 'none'}"
            raise typer.BadParameter(msg, param_hint="--technique")
        params[key] = value_of(value)
    return text, params


def value_of(text: str) -> Any:
    """Read one value; numbers with ``+`` between are a tuple, since commas end a value."""
    constants = {"none": None, "true": True, "false": False}
    if text.lower() in constants:
        return constants[text.lower()]
    number = _number(text)
    if number is not None:
        return number
    parts = [_number(part) for part in text.split("+")]
    return text if None in parts else tuple(parts)


def _number(text: str) -> float | None:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return None


def numbers(option: str, text: str) -> list[float]:
    """Read numbers with commas between, or refuse an option."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        msg = f"{text!r} is not a list of numbers with commas between"
        raise typer.BadParameter(msg, param_hint=option) from None


def counts_of(option: str, text: str) -> list[int]:
    """Read whole numbers with commas between, or refuse an option."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        msg = f"{text!r} is not a list of whole numbers with commas between"
        raise typer.BadParameter(msg, param_hint=option) from None


def frame_size_of(text: str) -> tuple[int, int]:
    """Read WIDTHxHEIGHT, or refuse it."""
    width, separator, height = text.lower().partition("x")
    try:
        if not separator:
            raise ValueError
        return int(width), int(height)
    except ValueError:
        msg = f"{text!r} is not WIDTHxHEIGHT, 1024x768 for example"
        raise typer.BadParameter(msg, param_hint="--size") from None
