"""``treelod gpu``: the graphics cards that can draw."""

from __future__ import annotations

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from treelod.cli.app import app
from treelod.gpu import adapters
from treelod.render import opened_card
from treelod.terminal import reported


@app.command()
def gpu() -> None:
    """
    List the graphics cards that can draw; the first one does where none is chosen.

    Without any: what to install, and exit code 1.
    """
    with reported(verbose=False):
        cards = adapters()
        if not cards:
            # it knows what there is to install, and whether this build can draw with a card at all
            opened_card(None)
    # in a file or a pipe, lines are as long as the table needs
    console = Console(width=None if Console().is_terminal else 160)
    table = Table()
    for name in ("", "name", "kind", "interface", "driver"):
        table.add_column(name, overflow="fold")
    for place, card in enumerate(cards):
        table.add_row(*map(Text, (f"#{place}", card.name, card.kind, card.api, card.driver)))
    console.print(table)
    typer.echo("choose one with --backend gpu --adapter NAME: a part of a name, a kind, or #0")
