"""``treelod bench``: times against other tools."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from treelod.bench import GROUPS
from treelod.cli.app import app
from treelod.cli.options import Verbose
from treelod.files import atomic_write
from treelod.terminal import Stages, reported

if TYPE_CHECKING:
    from treelod.bench import Row


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
    case = None
    for row in rows:
        # a case has several peers
        is_next = row.case != case
        case = row.case
        if is_next:
            table.add_section()
        errors = [
            "" if value is None else f"{value:.5f}" for value in (row.ours_error, row.peer_error)
        ]
        table.add_row(
            Text(case if is_next else ""),
            Text(row.peer),
            f"{row.ours_secs * 1e3:.2f}",
            f"{row.peer_secs * 1e3:.2f}",
            f"{row.speedup:.2f}",
            "" if row.aim is None else f"{row.aim:g}",
            *errors,
        )
    console.print(table)
