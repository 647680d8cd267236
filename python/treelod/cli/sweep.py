"""``treelod sweep``: parameters over plants and cameras, as a file says."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from treelod.cli.app import app
from treelod.cli.options import AdapterName, Backend, Threads, Verbose
from treelod.cli.summaries import print_summary
from treelod.terminal import Stages, reported


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
    backend: Annotated[
        Backend | None,
        typer.Option(
            "--backend",
            show_default="the file's, else cpu",
            help="What draws the frames that are timed.",
        ),
    ] = None,
    adapter: AdapterName = None,
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
            backend=None if backend is None else backend.value,
            adapter=adapter,
            goes_on=keep_going,
            progress=stages,
        )
    for plant in table["plant"].unique():
        summary = table[table["plant"] == plant].summary()
        samples = int(table["time_samples"].iloc[0])
        title = f"{plant}: medians and means over all views"
        if table["adapter"].notna().any():
            title += f"; times of {table['adapter'].dropna().iloc[0]}"
        print_summary(title, summary, samples)
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
