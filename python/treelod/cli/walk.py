"""``treelod walk``: a camera around or through growing groves."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

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
    counts_of,
    frame_size_of,
    technique_of,
)
from treelod.cli.subjects import subject_of
from treelod.render import check_backend, opened_card
from treelod.techniques import REGISTRY, FullMesh
from treelod.terminal import Stages, reported


class WalkPath(StrEnum):
    """Where the camera of a walk goes."""

    CIRCLE = "circle"
    THROUGH = "through"


@app.command()
def walk(
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
    backend: TimedBackend = Backend.CPU,
    adapter: AdapterName = None,
    seed: Seed = None,
    leaf_count: LeafCount = None,
    verbose: Verbose = False,
) -> None:
    """
    Go around or through growing groves of a plant: primitives and milliseconds of each technique.

    The worst case is that of windows of 20 frames, without the slowest 5 %; it takes 200 frames.

    The report is OUTPUT/walk.html, one self-contained page.
    Beside it lie walk.parquet, walk.csv and the plots.
    """
    specs = [FullMesh.name, *all_techniques()] if technique is None else technique
    wanted = dict(technique_of(text) for text in specs)
    counts = counts_of("--trees", trees)
    frame_size = None if size is None else frame_size_of(size)
    strides = dict(_stride(text) for text in every or ())
    with reported(verbose=verbose), Stages() as stages:
        from treelod import walks
        from treelod.report import check_folder
        from treelod.report.walk import write_walk

        check_folder(output)
        check_backend(backend.value, adapter)
        if backend is Backend.GPU:
            opened_card(adapter)
        subject, _ = subject_of(stages, plant, seed=seed, leaf_count=leaf_count)
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
            backend=backend.value,
            adapter=adapter,
            progress=stages,
        )
        page = write_walk(found, output)
    console = Console(width=None if Console().is_terminal else 160)
    way = "around" if path is WalkPath.CIRCLE else "through"
    title = f"{found.plant}: {way} groves"
    if found.settings["backend"] == "gpu":
        title += f", on {found.settings['adapter']}"
    table = Table(title=Text(title))
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


def _stride(text: str) -> tuple[str, int]:
    # a label has signs of its own: slicings:slice_count=3
    label, _, count = text.rpartition("=")
    try:
        return label, int(count)
    except ValueError:
        msg = f"{text!r} is not SPEC=COUNT, full_mesh=10 for example"
        raise typer.BadParameter(msg, param_hint="--every") from None
