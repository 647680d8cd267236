"""``treelod compare`` and ``treelod demo``: every technique for a plant, and the report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from treelod.cameras import (
    DEFAULT_AZIMUTH_COUNT,
    DEFAULT_DISTANCES,
    DEFAULT_ELEVATIONS_DEG,
    default_cameras,
)
from treelod.cli.app import app
from treelod.cli.options import (
    AdapterName,
    Backend,
    LeafCount,
    PlantName,
    ReportFolder,
    Seed,
    Threads,
    TimedBackend,
    Verbose,
    all_techniques,
    frame_size_of,
    numbers,
    technique_of,
)
from treelod.cli.subjects import subject_of
from treelod.cli.summaries import print_summary
from treelod.render import check_backend, opened_card
from treelod.techniques import REGISTRY, FullMesh
from treelod.terminal import Stages, reported

if TYPE_CHECKING:
    from collections.abc import Callable

    from treelod.results import Comparison


DEMO_PRESET = "chestnut"

SMALL_DEMO = {"leaf_clusters": "leaf_clusters:resolution=128"}
"""Where a technique's defaults take seconds to bake: what `demo --small` takes instead."""


@app.command()
def compare(
    *,
    plant: PlantName,
    output: ReportFolder,
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
    backend: TimedBackend = Backend.CPU,
    adapter: AdapterName = None,
    seed: Seed = None,
    leaf_count: LeafCount = None,
    verbose: Verbose = False,
) -> None:
    """
    Compare techniques for a plant: what they cost and how wrong they look.

    The report is OUTPUT/report.html, one self-contained page.
    Beside it lie results.parquet, results.csv, plots and pictures.
    """
    wanted = dict(technique_of(text) for text in technique or all_techniques())
    elevation_values = numbers("--elevations", elevations)
    distance_values = numbers("--distances", distances)
    frame_size = frame_size_of(size)
    with reported(verbose=verbose), Stages() as stages:
        measure = _measurement(output, backend.value, adapter)
        subject, source = subject_of(
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
    backend: TimedBackend = Backend.CPU,
    adapter: AdapterName = None,
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
        techniques = [SMALL_DEMO.get(name, name) for name in all_techniques()]
    else:
        views = {
            # 6 would meet the 6 directions that slicings are baked for and show no other
            "azimuth_count": 5,
            "elevations_deg": DEFAULT_ELEVATIONS_DEG,
            "distances": DEFAULT_DISTANCES,
            "size": (512, 384),
        }
        leaf_count, reference_samples = None, 64
        techniques = all_techniques()
    with reported(verbose=verbose), Stages() as stages:
        measure = _measurement(output, backend.value, adapter)
        subject, source = subject_of(stages, DEMO_PRESET, leaf_count=leaf_count)
        comparison, page = measure(
            subject,
            dict(technique_of(text) for text in techniques),
            default_cameras(subject, **views),
            reference_samples=reference_samples,
            threads=threads,
            source=source,
            progress=stages,
        )
    _show(comparison, page)


def _measurement(
    folder: Path, backend: str, adapter: str | None
) -> Callable[..., tuple[Comparison, Path]]:
    """Return what compares and writes; refuse first what would end it after minutes."""
    # seconds of imports, which `--help` and mistyped options should not wait for
    from treelod.comparison import compare_techniques
    from treelod.report import check_folder, write_report

    check_folder(folder)
    check_backend(backend, adapter)
    if backend == "gpu":
        opened_card(adapter)

    def measure(*arguments: Any, progress: Stages, **settings: Any) -> tuple[Comparison, Path]:
        comparison = compare_techniques(
            *arguments, progress=progress, backend=backend, adapter=adapter, **settings
        )
        progress("writing the report", 0, 1)
        page = write_report(comparison, folder)
        progress("writing the report", 1, 1)
        return comparison, page

    return measure


def _show(comparison: Comparison, page: Path) -> None:
    """Print the table and the report's path."""
    title = f"{comparison.plant['name']}: medians and means over all views"
    if comparison.settings["backend"] == "gpu":
        title += f"; times of {comparison.settings['adapter']}"
    print_summary(title, comparison.summary(), comparison.settings["time_samples"])
    Console().print(Text(f"report: {page}"), soft_wrap=True)
