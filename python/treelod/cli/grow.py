"""``treelod grow``: a grown plant as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from treelod.cli.app import app
from treelod.cli.options import LeafCount, Seed, Verbose
from treelod.cli.subjects import subject_of
from treelod.export import plant_glb
from treelod.files import atomic_write, check_target
from treelod.plants import PRESETS
from treelod.terminal import Stages, reported


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
        subject, _ = subject_of(stages, preset, seed=seed, leaf_count=leaf_count)
        data = plant_glb(subject)
        atomic_write(output, data)
    typer.echo(subject.summary())
    typer.echo(f"{output}  {len(data) / 1e6:.1f} MB")
