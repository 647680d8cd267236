"""The plant that a command is about: loaded or grown, and where it came from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from treelod.plants import PRESETS, grow_plant, load_plant
from treelod.provenance import file_sha256

if TYPE_CHECKING:
    from treelod.plants import Plant
    from treelod.terminal import Stages

__all__ = ["subject_of"]


def subject_of(
    stages: Stages,
    name: str,
    foliage: list[str] | None = None,
    unit: float | None = None,
    up: str | None = None,
    *,
    seed: int | None = None,
    leaf_count: int | None = None,
) -> tuple[Plant, dict[str, Any]]:
    """Load or grow a plant, and say where it came from. A file goes before a preset."""
    path = Path(name)
    if name in PRESETS and not path.exists():
        for option, value in (("--foliage", foliage), ("--unit", unit), ("--up", up)):
            if value:
                msg = f"{name!r} is grown; this is for files"
                raise typer.BadParameter(msg, param_hint=option)
        stage = f"growing {name}"
        stages(stage, 0, 1)
        seed = 1 if seed is None else seed
        plant = grow_plant(
            name,
            seed=seed,
            leaf_count=leaf_count,
            # the light comes after the last leaf
            progress=lambda done, total: stages(stage, done, total + 1),
        )
        stages(stage, 1, 1)
        source = {"preset": name, "seed": seed, "leaf_count": plant.foliage.leaf_count}
        return plant, source
    for option, number in (("--seed", seed), ("--leaf-count", leaf_count)):
        if number is not None:
            msg = f"{name!r} is a file; this is for plants to grow: {', '.join(PRESETS)}"
            raise typer.BadParameter(msg, param_hint=option)
    if not path.exists():
        msg = f"there is no file {name}, and no plant of that name to grow ({', '.join(PRESETS)})"
        raise FileNotFoundError(msg)
    stage = f"loading {path.name}"
    stages(stage, 0, 1)
    axis: Any = up or "y"
    plant = load_plant(path, foliage, unit=1.0 if unit is None else unit, up=axis)
    stages(stage, 1, 1)
    source = {
        "file": path.name,
        "sha256": file_sha256(path),
        "unit": 1.0 if unit is None else unit,
        "up": axis,
    }
    if foliage:
        source["foliage"] = foliage
    return plant, source
