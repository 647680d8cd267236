"""
Which cells run next, and what becomes of those that fail: the driver's loop.

Cells of one representation are handed out a few at a time. A worker that comes back gets the next
ones of the same representation, so that it is built about once and not once a worker. When a
worker dies, nobody knows which cell it was: all that were out are tried again, each alone. One that
kills its worker again and again is given up.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from treelod.errors import SweepError, TreelodError

if TYPE_CHECKING:
    from treelod.sweeps.cells import Cell
    from treelod.sweeps.executors import Crew
    from treelod.sweeps.worker import Job, Outcome

__all__ = ["Group", "Loss", "Schedule"]

JOB_SECS = 1.0
"""About how long a job should take: short to lose little, long to be worth the way."""

MAX_JOB_CELLS = 16

FIRST_JOB_CELLS = 2
"""Cells of a job while nobody knows yet how long one takes."""

DEATHS_OF_ALL = 2
"""Cells of a representation that must kill their worker before the others are not tried."""

POLL_SECS = 0.5
"""How long to wait before looking for workers that have joined."""


@dataclass(kw_only=True, eq=False)
class Group:
    """
    Cells of one representation that are still to do.

    Attributes
    ----------
    cells : deque of Cell
        Not handed out yet.
    cell_secs : float or None
        Seconds that one took, lately.
    row_count : int
        How many came back.
    death_count : int
        How many were given up because they killed their worker.
    """

    cells: deque[Cell]
    cell_secs: float | None = None
    row_count: int = 0
    death_count: int = 0

    def take(self, most: int) -> list[Cell]:
        """Take as many cells as make a job, and at most `most`."""
        count = FIRST_JOB_CELLS
        if self.cell_secs is not None:
            count = int(JOB_SECS / max(self.cell_secs, 1e-9))
        count = min(max(1, count), most, MAX_JOB_CELLS, len(self.cells))
        return [self.cells.popleft() for _ in range(count)]


@dataclass(frozen=True, kw_only=True)
class Loss:
    """
    A cell without a row, and why.

    Attributes
    ----------
    cell : Cell
        Which.
    text : str
        What went wrong.
    error : Exception or None
        What was raised, where it is known.
    trace : str
        Where it was raised, in the worker.
    """

    cell: Cell
    text: str
    error: Exception | None = None
    trace: str = ""


@dataclass(frozen=True, eq=False)
class _Out:
    """A job that was handed out."""

    group: Group
    cells: list[Cell]
    is_alone: bool = False


@dataclass(kw_only=True, eq=False)
class Schedule:
    """
    Runs cells until all are done, failed, or the sweep is stopped.

    Attributes
    ----------
    crew : Crew
        Who works.
    groups : sequence of Group
        What is to do, in this order.
    job_of : callable
        Makes a job of cells of one representation.
    keep : callable
        Called with a cell, its columns and the outcome they came in.
    lose : callable
        Called with each loss.
    retries : int
        How often a cell is tried again alone that has killed its worker.
    goes_on : bool
        Whether to go on after a loss.
    one_by_one : bool
        Whether only one job may be out.
    """

    crew: Crew
    groups: Sequence[Group]
    job_of: Callable[[list[Cell]], Job]
    keep: Callable[[Cell, dict[str, Any], Outcome], None]
    lose: Callable[[Loss], None]
    retries: int
    goes_on: bool
    one_by_one: bool = False
    _out: dict[Future[Outcome], _Out] = field(default_factory=dict)
    _warm: list[Group] = field(default_factory=list)
    _suspects: deque[tuple[Group, Cell]] = field(default_factory=deque)
    _deaths: Counter[str] = field(default_factory=Counter)
    _is_stopping: bool = False
    _have_worked: bool = False

    def run(self) -> None:
        """
        Run all cells.

        Raises
        ------
        SweepError
            If nobody can work any more.
        """
        cold = deque(self.groups)
        try:
            while True:
                if not self._is_stopping:
                    self._hand_out(cold)
                if not self._out:
                    return
                done, _ = wait(self._out, timeout=POLL_SECS, return_when=FIRST_COMPLETED)
                for future in done:
                    if future in self._out:
                        self._take(future)
        except BaseException:
            self._save()
            raise

    def _hand_out(self, cold: deque[Group]) -> None:
        if self._suspects:
            # alone, so that a death has one suspect
            if not self._out:
                group, cell = self._suspects.popleft()
                self._submit(_Out(group, [cell], is_alone=True))
            return
        width = 1 if self.one_by_one else self.crew.width
        while len(self._out) < width and not self._suspects:
            chosen = self._next(cold)
            if chosen is None:
                return
            # the last jobs are short, so that all workers end together
            left = sum(len(group.cells) for group in self.groups)
            self._submit(_Out(chosen, chosen.take(max(1, math.ceil(left / (2 * width))))))

    def _next(self, cold: deque[Group]) -> Group | None:
        """Choose a group: one whose worker has just come back, a fresh one, or the longest."""
        while self._warm:
            group = self._warm.pop()
            if group.cells:
                return group
        while cold:
            group = cold.popleft()
            if group.cells:
                return group
        longest = max(self.groups, key=lambda group: len(group.cells), default=None)
        return longest if longest is not None and longest.cells else None

    def _submit(self, out: _Out) -> None:
        job = self.job_of(out.cells)
        try:
            future = self.crew.submit(job)
        except BrokenExecutor as error:
            self._recover(error)
            future = self.crew.submit(job)
        self._out[future] = out

    def _take(self, future: Future[Outcome]) -> None:
        out = self._out.pop(future)
        error = None if future.cancelled() else future.exception()
        if future.cancelled() or isinstance(error, BaseException):
            if error is None or not self.crew.is_lost(error):
                raise _fatal(error)
            self._suspect(out)
            if isinstance(error, BrokenExecutor):
                self._recover(error)
            return
        self._accept(out, future.result())

    def _accept(self, out: _Out, outcome: Outcome) -> None:
        group = out.group
        self._have_worked = True
        for position, row in sorted(outcome.rows.items()):
            self.keep(out.cells[position], row, outcome)
            group.row_count += 1
        for failure in outcome.failures:
            cell = out.cells[failure.position]
            self._give_up(
                Loss(cell=cell, text=failure.text, error=failure.error, trace=failure.trace)
            )
        if outcome.is_hopeless:
            failure = outcome.failures[0]
            while group.cells and not self._is_stopping:
                cell = group.cells.popleft()
                self._give_up(
                    Loss(cell=cell, text=failure.text, error=failure.error, trace=failure.trace)
                )
        elif outcome.rows:
            group.cell_secs = outcome.cell_secs
            self._warm.append(group)

    def _suspect(self, out: _Out) -> None:
        """Try the cells of a job whose worker died again, each alone, unless this was alone."""
        if not out.is_alone:
            self._suspects.extend((out.group, cell) for cell in out.cells)
            return
        (cell,) = out.cells
        self._deaths[cell.key] += 1
        count = self._deaths[cell.key]
        if count > self.retries:
            times = "once" if count == 1 else f"{count} times"
            self._give_up(Loss(cell=cell, text=f"it killed its worker {times}"))
            out.group.death_count += 1
            self._bury(out.group)
        else:
            self._suspects.append((out.group, cell))

    def _bury(self, group: Group) -> None:
        """Give up the rest of a representation of which all that was tried has killed."""
        if group.row_count or group.death_count < DEATHS_OF_ALL:
            return
        suspects = [cell for other, cell in self._suspects if other is group]
        self._suspects = deque(pair for pair in self._suspects if pair[0] is not group)
        for cell in [*suspects, *group.cells]:
            self._give_up(Loss(cell=cell, text="others of its representation killed their worker"))
        group.cells.clear()

    def _recover(self, error: BaseException) -> None:
        """Collect all that was out, and get another executor."""
        for future in [*self._out]:
            out = self._out.pop(future)
            if _is_fine(future):
                self._accept(out, future.result())
            else:
                self._suspect(out)
        self.crew.revive(error)
        if not self._have_worked:
            # is it the cells, or can nobody work at all?
            self.crew.check_alive()
            self._have_worked = True

    def _give_up(self, loss: Loss) -> None:
        self.lose(loss)
        if not self.goes_on:
            self._is_stopping = True

    def _save(self) -> None:
        """Keep what is done, and call the rest off."""
        for future, out in self._out.items():
            if not future.cancel() and future.done() and _is_fine(future):
                outcome = future.result()
                for position, row in outcome.rows.items():
                    self.keep(out.cells[position], row, outcome)
        self._out.clear()


def _is_fine(future: Future[Outcome]) -> bool:
    return future.done() and not future.cancelled() and future.exception() is None


def _fatal(error: BaseException | None) -> BaseException:
    """Say what it means that a job came back without an outcome."""
    if isinstance(error, TreelodError):
        return error
    text = "it was cancelled" if error is None else f"{type(error).__name__}: {error}"
    if "deserializ" in text or isinstance(error, ImportError):
        why = "driver, scheduler and workers need the same environment, treelod included"
    elif error is None or type(error).__name__.endswith("CancelledError"):
        why = "the executor was shut down, or the cluster is gone"
    else:
        why = "the executor failed, and not the cell"
    fatal = SweepError(f"a job came back without an outcome ({text}): {why}")
    fatal.__cause__ = error
    return fatal
