"""The command line itself: its name, its version and how it answers mistakes."""

from __future__ import annotations

from typing import Annotated

import typer

import treelod

__all__ = ["app", "main"]

app = typer.Typer(
    name="treelod",
    help="Measure level of detail of trees and foliage: speed against error, for every technique.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


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
