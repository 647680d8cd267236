"""How a command talks to the terminal: progress of long runs, and errors in one line."""

from __future__ import annotations

import contextlib
import logging
import time
from typing import TYPE_CHECKING

import typer
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.text import Text

from treelod.errors import TreelodError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.progress import TaskID

__all__ = ["Stages", "reported"]


class Stages:
    """
    Shows how far each stage of a long run is.

    Bars in a terminal; elsewhere one line a stage, when it is done. Called as `compare_techniques`
    calls its `progress`.
    """

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._bars = (
            Progress(
                TextColumn("{task.description:<18}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeElapsedColumn(),
                console=self._console,
            )
            if self._console.is_terminal
            else None
        )
        self._tasks: dict[str, TaskID] = {}
        self._spent: dict[str, float] = {}
        self._last = time.monotonic()

    def __enter__(self) -> Stages:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """
        Show how far a stage is.

        Parameters
        ----------
        stage : str
            Its name.
        done, total : int
            Steps.
        """
        if self._bars is not None:
            if stage not in self._tasks:
                self._tasks[stage] = self._bars.add_task(stage, total=total)
            self._bars.update(self._tasks[stage], completed=done, total=total)
            return
        # stages take turns: what has passed since any of them moved belongs to the one that moves
        now = time.monotonic()
        if done > 0:
            self._spent[stage] = self._spent.get(stage, 0.0) + now - self._last
        self._last = now
        if done == total:
            self._console.print(f"{stage}: {total} in {self._spent[stage]:.1f} s", highlight=False)


@contextlib.contextmanager
def reported(*, verbose: bool) -> Iterator[None]:
    """Turn what a user can cause into one line and exit code 1; a traceback with ``-v``."""
    console = Console(stderr=True)
    if verbose:
        logger = logging.getLogger("treelod")
        logger.setLevel(logging.DEBUG)
        if not logger.handlers:
            logger.addHandler(RichHandler(console=console, show_path=False))
    try:
        yield
    except (
        TreelodError,
        OSError,
        ValueError,
        TypeError,
        MemoryError,
        ImportError,
    ) as failure:
        if verbose:
            raise
        line = str(failure) or type(failure).__name__
        if isinstance(failure, OSError) and failure.filename is not None:
            line = f"{failure.filename}: {failure.strerror}"
        # names of files may hold what rich takes for markup
        console.print(Text.assemble(("error: ", "bold red"), line), soft_wrap=True)
        raise typer.Exit(1) from None
