"""
The command line: ``treelod compare``, ``demo``, ``sweep``, ``walk``, ``grow``,
``validate``, ``bench``.

Progress and errors go to the error stream, results to the output stream. Exit codes: 0 done,
1 failed, 2 wrong usage.
"""

from __future__ import annotations

import contextlib
import inspect
import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

import treelod
from treelod.bench import GROUPS
from treelod.cameras import (
    DEFAULT_AZIMUTH_COUNT,
    DEFAULT_DISTANCES,
    DEFAULT_ELEVATIONS_DEG,
    default_cameras,
)
from treelod.export import plant_glb
from treelod.files import atomic_write, check_target
from treelod.plants import PRESETS, grow_plant, load_plant
from treelod.provenance import file_sha256
from treelod.techniques import REGISTRY, FullMesh
from treelod.terminal import Stages, reported

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

    from treelod.bench import Row
    from treelod.plants import Plant
    from treelod.results import Comparison

__all__ = ["app", "main"]


class WalkPath(StrEnum):
    """Where the camera of a walk goes."""

    CIRCLE = "circle"
    THROUGH = "through"


app = typer.Typer(
    name="treelod",
    help="Measure level of detail of trees and foliage: speed against error, for every technique.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

DEMO_PRESET = "chestnut"

SMALL_DEMO = {"leaf_clusters": "leaf_clusters:resolution=128"}
"""Where a technique's defaults take seconds to bake: what `demo --small` takes instead."""

_NO_SETTINGS = {"progress", "threads", "views"}
"""What a build takes besides a technique's own parameters: options of the command, or objects."""

Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Log what happens; show tracebacks of errors.")
]
Threads = Annotated[
    int | None,
    typer.Option("--threads", min=1, show_default="all cores", help="Threads that draw."),
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


def main() -> None:
    """Run the command line."""
    app()


def _print_version(value: bool) -> None:  # noqa: FBT001
    if value:
        typer.echo(f"treelod {treelod.__version__}")
        raise typer.Exit


@app.callback()
def _root(
    *,
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    """Hold the options that stand before a command."""


@app.command()
def compare(
    *,
    plant: Annotated[
        str,
        typer.Argument(
            metavar="PLANT",
            help=f"A GLB, glTF, OBJ or PLY file, or a plant to grow: {', '.join(PRESETS)}.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the report; made if missing.")
    ],
    technique: Annotated[
        list[str] | None,
        typer.Option(
            "--technique",
            "-t",
            metavar="SPEC",
            show_default="each, with its default parameters",
            help="What to compare with the full mesh, as NAME or NAME:KEY=VALUE,KEY=VALUE; a value "
            "of several numbers is A+B. Repeat for several, also for one technique with different "
            "parameters. "
            f"There are: {', '.join(name for name in REGISTRY if name != FullMesh.name)}.",
        ),
    ] = None,
    foliage: Annotated[
        list[str] | None,
        typer.Option(
            "--foliage",
            metavar="NAME",
            show_default="found out",
            help="Material or mesh that is foliage; repeat for several.",
        ),
    ] = None,
    unit: Annotated[
        float | None, typer.Option("--unit", show_default="1", help="Metres a unit of the file.")
    ] = None,
    up: Annotated[
        str | None,
        typer.Option("--up", metavar="x|y|z", show_default="y", help="The file's up axis."),
    ] = None,
    azimuths: Annotated[
        int, typer.Option("--azimuths", min=1, help="Cameras on each circle.")
    ] = DEFAULT_AZIMUTH_COUNT,
    elevations: Annotated[
        str, typer.Option("--elevations", metavar="DEGREES,...", help="Heights of the circles.")
    ] = ",".join(f"{value:g}" for value in DEFAULT_ELEVATIONS_DEG),
    distances: Annotated[
        str,
        typer.Option(
            "--distances",
            metavar="RADII,...",
            help="Distances from the plant's centre, in radii of its bounding sphere.",
        ),
    ] = ",".join(f"{value:g}" for value in DEFAULT_DISTANCES),
    size: Annotated[
        str, typer.Option("--size", metavar="WIDTHxHEIGHT", help="Pictures' size in pixels.")
    ] = "1024x768",
    samples: Annotated[
        int, typer.Option("--samples", min=1, help="Samples a pixel of the frames that are timed.")
    ] = 4,
    reference_samples: Annotated[
        int,
        typer.Option(
            "--reference-samples", min=1, help="Samples a pixel of the frames that are measured."
        ),
    ] = 64,
    repeats: Annotated[
        int, typer.Option("--repeats", min=1, help="Timed frames of each technique and view.")
    ] = 9,
    ppd: Annotated[
        float, typer.Option("--ppd", help="Pixels a degree of sight, for FLIP and Yee.")
    ] = 67.02,
    yee: Annotated[
        bool,
        typer.Option("--yee", help="Also measure Yee's metric, a column of results.csv: slow."),
    ] = False,
    threads: Threads = None,
    seed: Seed = None,
    leaf_count: LeafCount = None,
    verbose: Verbose = False,
) -> None:
    """
    Compare techniques for a plant: what they cost and how wrong they look.

    The report is OUTPUT/report.html, one self-contained page.
    Beside it lie results.parquet, results.csv, plots and pictures.
    """
    wanted = dict(_technique(text) for text in technique or _all_techniques())
    elevation_values = _numbers("--elevations", elevations)
    distance_values = _numbers("--distances", distances)
    frame_size = _frame_size(size)
    with reported(verbose=verbose), Stages() as stages:
        measure = _measurement(output)
        subject, source = _subject(
            stages, plant, foliage, unit, up, seed=seed, leaf_count=leaf_count
        )
        cameras = default_cameras(
            subject,
            azimuth_count=azimuths,
            elevations_deg=elevation_values,
            distances=distance_values,
            size=frame_size,
        )
        comparison, page = measure(
            subject,
            wanted,
            cameras,
            samples=samples,
            reference_samples=reference_samples,
            repeats=repeats,
            ppd=ppd,
            yee=yee,
            threads=threads,
            source=source,
            progress=stages,
        )
    _show(comparison, page)


@app.command()
def demo(
    *,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the report; made if missing.")
    ] = Path("demo"),
    small: Annotated[
        bool, typer.Option("--small", help="Fewer leaves, views and pixels: seconds, not minutes.")
    ] = False,
    threads: Threads = None,
    verbose: Verbose = False,
) -> None:
    """
    Grow a chestnut, compare every technique on it, write a report.

    The place to begin: it needs no file and takes a minute or two.
    """
    if small:
        views: dict[str, Any] = {
            "azimuth_count": 4,
            "elevations_deg": (0.0,),
            "distances": (2.5, 10.0),
            "size": (256, 192),
        }
        leaf_count, reference_samples = 2000, 16
        techniques = [SMALL_DEMO.get(name, name) for name in _all_techniques()]
    else:
        views = {
            # 6 would meet the 6 directions that slicings are baked for and show no other
            "azimuth_count": 5,
            "elevations_deg": DEFAULT_ELEVATIONS_DEG,
            "distances": DEFAULT_DISTANCES,
            "size": (512, 384),
        }
        leaf_count, reference_samples = None, 64
        techniques = _all_techniques()
    with reported(verbose=verbose), Stages() as stages:
        measure = _measurement(output)
        subject, source = _subject(stages, DEMO_PRESET, leaf_count=leaf_count)
        comparison, page = measure(
            subject,
            dict(_technique(text) for text in techniques),
            default_cameras(subject, **views),
            reference_samples=reference_samples,
            threads=threads,
            source=source,
            progress=stages,
        )
    _show(comparison, page)


@app.command()
def sweep(
    *,
    config: Annotated[
        Path,
        typer.Argument(metavar="CONFIG", help="A TOML file: plants, cameras, techniques."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the rows; made if missing.")
    ],
    workers: Annotated[
        int | None,
        typer.Option("--workers", min=1, show_default="none", help="Processes that work."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            "--scheduler",
            metavar="ADDRESS",
            show_default="none",
            help="A dask scheduler whose workers work, as tcp://127.0.0.1:8786.",
        ),
    ] = None,
    timing: Annotated[
        str | None,
        typer.Option(
            "--timing",
            metavar="shared|exclusive|none",
            show_default="the file's, else shared",
            help="Whether cells are timed while others run, each alone after all, or not at all.",
        ),
    ] = None,
    keep_going: Annotated[
        bool, typer.Option("--keep-going", help="Go on where a cell fails; exit code 1 at the end.")
    ] = False,
    threads: Threads = None,
    verbose: Verbose = False,
) -> None:
    """
    Measure a grid of techniques and parameters; only what OUTPUT does not have is computed.

    Beside the rows lie results.parquet, results.csv and plots.
    """
    if workers is not None and scheduler is not None:
        msg = "workers of this machine and of a scheduler do not mix"
        raise typer.BadParameter(msg, param_hint="--scheduler")
    with reported(verbose=verbose), Stages() as stages:
        # seconds of imports, which `--help` and mistyped options should not wait for
        from treelod.sweeps.command import run_config

        table = run_config(
            config,
            output,
            workers=workers,
            scheduler=scheduler,
            timing=timing,
            threads=threads,
            goes_on=keep_going,
            progress=stages,
        )
    for plant in table["plant"].unique():
        summary = table[table["plant"] == plant].summary()
        samples = int(table["time_samples"].iloc[0])
        _print_summary(f"{plant}: medians and means over all views", summary, samples)
    failed = table.attrs["failed"]
    for loss in failed[:10]:
        where = f"{loss['plant']}, {loss['technique']}, view {loss['view']}"
        typer.echo(f"failed: {where}: {loss['error']}")
    if len(failed) > 10:
        typer.echo(f"failed: {len(failed) - 10} more")
    for line in (
        f"table: {output / 'results.csv'}, plots: {output / 'plots'}",
        f"next: treelod sweep {config} -o {output}  # computes only what {config.name} adds",
    ):
        Console().print(Text(line), soft_wrap=True)
    if failed:
        raise typer.Exit(1)


@app.command()
def walk(
    *,
    plant: Annotated[
        str,
        typer.Argument(
            metavar="PLANT",
            help=f"A GLB, glTF, OBJ or PLY file, or a plant to grow: {', '.join(PRESETS)}.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the report; made if missing.")
    ],
    technique: Annotated[
        list[str] | None,
        typer.Option(
            "--technique",
            "-t",
            metavar="SPEC",
            show_default="each, with its default parameters",
            help="What to walk with, as for compare.",
        ),
    ] = None,
    trees: Annotated[
        str, typer.Option("--trees", metavar="COUNT,...", help="Trees of each grove, rising.")
    ] = "1,2,4,8",
    path: Annotated[
        WalkPath,
        typer.Option(
            "--path",
            help="Where the camera goes: around the grove, or through it for the worst case.",
        ),
    ] = WalkPath.CIRCLE,
    frames: Annotated[
        int | None,
        typer.Option(
            "--frames",
            min=1,
            show_default="36 around, 2600 through",
            help="Frames of a lap.",
        ),
    ] = None,
    laps: Annotated[
        int | None,
        typer.Option(
            "--laps", min=1, show_default="3 around, 1 through", help="Laps that are counted."
        ),
    ] = None,
    every: Annotated[
        list[str] | None,
        typer.Option(
            "--every",
            metavar="SPEC=COUNT",
            help="Draw only one of so many windows of 20 frames with this technique, named as in "
            "--technique; repeat for several.",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            "--size",
            metavar="WIDTHxHEIGHT",
            show_default="512x384 around, 640x480 through",
            help="Pictures' size in pixels.",
        ),
    ] = None,
    samples: Annotated[int, typer.Option("--samples", min=1, help="Samples a pixel.")] = 4,
    threads: Threads = None,
    seed: Seed = None,
    leaf_count: LeafCount = None,
    verbose: Verbose = False,
) -> None:
    """
    Go around or through growing groves of a plant: primitives and milliseconds of each technique.

    The report is OUTPUT/walk.html, one self-contained page.
    Beside it lie walk.parquet, walk.csv and the plot.
    """
    specs = [FullMesh.name, *_all_techniques()] if technique is None else technique
    wanted = dict(_technique(text) for text in specs)
    counts = _counts("--trees", trees)
    frame_size = None if size is None else _frame_size(size)
    strides = dict(_stride(text) for text in every or ())
    with reported(verbose=verbose), Stages() as stages:
        from treelod import walks
        from treelod.report import check_folder
        from treelod.report.walk import write_walk

        check_folder(output)
        subject, _ = _subject(stages, plant, seed=seed, leaf_count=leaf_count)
        built = {}
        for done, (label, params) in enumerate(wanted.items()):
            stages("building", done, len(wanted))
            built[label] = REGISTRY[label.partition(":")[0]].build(subject, **params)
        stages("building", len(wanted), len(wanted))
        found = walks.walk(
            subject,
            built,
            tree_counts=counts,
            path=path.value,
            frame_count=frames,
            laps=laps,
            every=strides,
            size=frame_size,
            samples=samples,
            threads=threads,
            progress=stages,
        )
        page = write_walk(found, output)
    console = Console(width=None if Console().is_terminal else 160)
    table = Table(title=f"{found.plant}: around groves")
    table.add_column("technique", overflow="fold")
    for name in ("trees", "primitives", "frame ms", "worst case ms"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in found.table.to_dict("records"):
        table.add_row(
            Text(str(row["label"])),
            str(row["tree_count"]),
            f"{row['primitives']:,.0f}",
            f"{row['frame_millis']:.2f}",
            "-" if math.isnan(row["frame_millis_worst"]) else f"{row['frame_millis_worst']:.2f}",
        )
    console.print(table)
    console.print(Text(f"report: {page}"), soft_wrap=True)


@app.command()
def grow(
    *,
    preset: Annotated[
        str, typer.Argument(metavar="PRESET", help=f"What to grow: {', '.join(PRESETS)}.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The GLB file to write.")],
    seed: Seed = None,
    leaf_count: LeafCount = None,
    verbose: Verbose = False,
) -> None:
    """Grow a plant and write it as a GLB file."""
    if output.suffix.lower() != ".glb":
        msg = f"{output} must end in .glb"
        raise typer.BadParameter(msg, param_hint="--output")
    if preset not in PRESETS:
        msg = f"there is no preset {preset!r}; there are {', '.join(PRESETS)}"
        raise typer.BadParameter(msg, param_hint="PRESET")
    with reported(verbose=verbose), Stages() as stages:
        check_target(output)
        subject, _ = _subject(stages, preset, seed=seed, leaf_count=leaf_count)
        data = plant_glb(subject)
        atomic_write(output, data)
    typer.echo(subject.summary())
    typer.echo(f"{output}  {len(data) / 1e6:.1f} MB")


@app.command()
def bench(
    *,
    group: Annotated[
        str, typer.Argument(metavar="GROUP", help=f"What to measure: {', '.join(GROUPS)}.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            show_default="the output stream",
            help="File for the rows, one line of JSON each.",
        ),
    ] = None,
    repeats: Annotated[
        int, typer.Option("--repeats", min=1, help="Rounds whose median is taken.")
    ] = 9,
    small: Annotated[
        bool, typer.Option("--small", help="Small inputs: shows that it runs, measures little.")
    ] = False,
    verbose: Verbose = False,
) -> None:
    """
    Time treelod against its peers on the same work, in turns.

    Close other programs first. Each row is a line of JSON; a table goes to the error stream.
    """
    if output is not None and not output.absolute().parent.is_dir():
        msg = f"there is no folder {output.absolute().parent}"
        raise typer.BadParameter(msg, param_hint="--output")
    if group not in GROUPS:
        msg = f"there is no group {group!r}; there are {', '.join(GROUPS)}"
        raise typer.BadParameter(msg, param_hint="GROUP")
    with reported(verbose=verbose), Stages() as stages:
        rows = []
        stages(f"bench {group}", 0, 1)
        for row in GROUPS[group](repeats=repeats, small=small):
            rows.append(row)
            stages(f"bench {group}", len(rows), len(rows) + 1)
        stages(f"bench {group}", len(rows), len(rows))
        lines = "".join(f"{row.to_json()}\n" for row in rows)
        if output is None:
            typer.echo(lines, nl=False)
        else:
            atomic_write(output, lines.encode())
    _show_rows(rows)


@app.command()
def validate(
    *,
    plant: Annotated[
        str,
        typer.Argument(
            metavar="PLANT",
            help=f"A GLB, glTF, OBJ or PLY file, or a plant to grow: {', '.join(PRESETS)}.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the report; made if missing.")
    ],
    full: Annotated[
        bool, typer.Option("--full", help="Everything at full size: minutes, not seconds.")
    ] = False,
    verbose: Verbose = False,
) -> None:
    r"""
    Check pictures and bakes of a plant against mitsuba, embree and trimesh.

    The report is OUTPUT/validation.html; exit code 1 if a check fails.
    Needs mitsuba and embree: pip install 'treelod\[validate]'.
    """
    with reported(verbose=verbose), Stages() as stages:
        from treelod import references
        from treelod.report import check_folder
        from treelod.report.validation import write_validation

        check_folder(output)
        references.require()
        subject, source = _subject(stages, plant)
        found = references.validate(subject, full=full, source=source, progress=stages)
        page = write_validation(found, output)
    for section in found.sections:
        for check in section.checks:
            if not check.passed:
                typer.echo(
                    f"failed: {section.title}: {check.name}: "
                    f"{check.value:.6g}, not {check.relation} {check.limit:g}"
                )
    count = sum(len(section.checks) for section in found.sections)
    typer.echo(f"{found.plant}: {count} checks {'passed' if found.passed else 'made'}")
    typer.echo(f"report: {page}")
    if not found.passed:
        raise typer.Exit(1)


def _subject(
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


def _measurement(folder: Path) -> Callable[..., tuple[Comparison, Path]]:
    """Refuse a folder that cannot be written to; else return what compares and writes to it."""
    # seconds of imports, which `--help` and mistyped options should not wait for
    from treelod.comparison import compare_techniques
    from treelod.report import check_folder, write_report

    check_folder(folder)

    def measure(*arguments: Any, progress: Stages, **settings: Any) -> tuple[Comparison, Path]:
        comparison = compare_techniques(*arguments, progress=progress, **settings)
        progress("writing the report", 0, 1)
        page = write_report(comparison, folder)
        progress("writing the report", 1, 1)
        return comparison, page

    return measure


def _all_techniques() -> list[str]:
    return [name for name in REGISTRY if name != FullMesh.name]


def _technique(text: str) -> tuple[str, dict[str, Any]]:
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
        params[key] = _value(value)
    return text, params


def _value(text: str) -> Any:
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


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        msg = f"{text!r} is not a list of numbers with commas between"
        raise typer.BadParameter(msg, param_hint=option) from None


def _counts(option: str, text: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        msg = f"{text!r} is not a list of whole numbers with commas between"
        raise typer.BadParameter(msg, param_hint=option) from None


def _stride(text: str) -> tuple[str, int]:
    # a label has signs of its own: slicings:slice_count=3
    label, _, count = text.rpartition("=")
    try:
        return label, int(count)
    except ValueError:
        msg = f"{text!r} is not SPEC=COUNT, full_mesh=10 for example"
        raise typer.BadParameter(msg, param_hint="--every") from None


def _frame_size(text: str) -> tuple[int, int]:
    width, separator, height = text.lower().partition("x")
    try:
        if not separator:
            raise ValueError
        return int(width), int(height)
    except ValueError:
        msg = f"{text!r} is not WIDTHxHEIGHT, 1024x768 for example"
        raise typer.BadParameter(msg, param_hint="--size") from None


def _show(comparison: Comparison, page: Path) -> None:
    """Print the table and the report's path."""
    title = f"{comparison.plant['name']}: medians and means over all views"
    _print_summary(title, comparison.summary(), comparison.settings["time_samples"])
    Console().print(Text(f"report: {page}"), soft_wrap=True)


def _print_summary(title: str, summary: pd.DataFrame, samples: int) -> None:
    """Print errors and costs of each technique; times may be missing."""
    import pandas as pd

    from treelod.report.text import (
        NONE,
        decibels,
        error,
        millis,
        seconds,
        signed,
        size_bytes,
        times,
    )

    console = Console()
    # in a file or a pipe, lines are as long as the table needs
    if not console.is_terminal:
        console = Console(width=160)
    table = Table(title=Text(title))
    table.add_column("technique", overflow="fold")
    for name in (
        "frame ms",
        "speed-up",
        "FLIP",
        "worst",
        "PSNR worst",
        "SSIM",
        "coverage bias",
        "size",
        "build",
    ):
        table.add_column(name, justify="right", no_wrap=True)
    for row in summary.to_dict("records"):
        label = str(row["label"])
        if label == FullMesh.name:
            label += f" ({samples} samples)"
        is_timed = pd.notna(row["frame_millis"])
        table.add_row(
            Text(label),
            millis(row["frame_millis"]) if is_timed else NONE,
            times(row["speedup"]) if is_timed else NONE,
            error(row["flip"]),
            error(row["flip_worst"]),
            decibels(row["psnr_worst"]),
            error(row["ssim"]),
            signed(row["coverage_bias"]),
            size_bytes(row["total_bytes"]),
            seconds(row["build_secs"]),
        )
    console.print(table)


def _show_rows(rows: list[Row]) -> None:
    """Print rows as a table on the error stream."""
    console = Console(stderr=True)
    if not console.is_terminal:
        console = Console(stderr=True, width=160)
    table = Table()
    table.add_column("case", overflow="fold")
    table.add_column("peer", overflow="fold")
    for name in ("ours ms", "peer ms", "speed-up", "aim", "ours error", "peer error"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        errors = [
            "" if value is None else f"{value:.5f}" for value in (row.ours_error, row.peer_error)
        ]
        table.add_row(
            Text(row.case),
            Text(row.peer),
            f"{row.ours_secs * 1e3:.2f}",
            f"{row.peer_secs * 1e3:.2f}",
            f"{row.speedup:.2f}",
            "" if row.aim is None else f"{row.aim:g}",
            *errors,
        )
    console.print(table)


if __name__ == "__main__":
    main()
