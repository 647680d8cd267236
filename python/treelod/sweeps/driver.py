"""
Parameter sweeps: every representation of a grid from every camera, each measured once and kept.

The driver lists the cells, reads those that the store has, hands the others out, and writes each
row as it comes back. So a sweep may be killed at any time, and be run again with a larger grid.
"""

from __future__ import annotations

import json
import sys
import uuid
import warnings
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from treelod import metrics
from treelod.cameras import Camera, default_cameras
from treelod.columns import source_columns, time_columns
from treelod.comparison import Progress
from treelod.errors import SweepError, SweepWarning
from treelod.kernel_version import kernel_version
from treelod.notebook import LiveLine, is_notebook
from treelod.plants import Plant
from treelod.render import check_size
from treelod.results import View
from treelod.sweeps import worker
from treelod.sweeps.cells import Cell, Settings, Timing, whole
from treelod.sweeps.executors import ExecutorLike, crew_of
from treelod.sweeps.grid import GridLike, expand
from treelod.sweeps.results import SweepResults, table_of
from treelod.sweeps.schedule import Group, Loss, Schedule
from treelod.sweeps.store import Shard, Store
from treelod.terminal import Stages

if TYPE_CHECKING:
    import os

    from treelod.sweeps.executors import Crew
    from treelod.sweeps.worker import Job, Outcome

__all__ = ["sweep"]

Plants: TypeAlias = Plant | Sequence[Plant] | Mapping[str, Plant]
Cameras: TypeAlias = Sequence[Camera] | Callable[[Plant], Sequence[Camera]]


def sweep(
    plants: Plants,
    grid: GridLike,
    cameras: Cameras | None = None,
    *,
    store: str | os.PathLike[str],
    executor: ExecutorLike = None,
    samples: int = 4,
    reference_samples: int = 64,
    repeats: int = 9,
    warmup: int = 2,
    timing: Timing = "shared",
    threads: int | None = None,
    ppd: float = metrics.DEFAULT_PPD,
    yee: bool = False,
    retries: int = 2,
    on_error: Literal["raise", "record"] = "raise",
    sources: Mapping[str, Mapping[str, Any]] | None = None,
    progress: bool | Progress = True,
    backend: str = "cpu",
    adapter: str | None = None,
) -> SweepResults:
    """
    Measure every technique and parameter of a grid, for every plant, from every camera.

    What the store has already is not computed again. A sweep that was killed goes on where it was
    when it is run again; a larger grid computes what it adds.

    Parameters
    ----------
    plants : Plant, sequence of Plant, or mapping of str to Plant
        What is drawn. Names must differ: those of the mapping, or the plants' own.
    grid : mapping or sequence of str
        Techniques of `techniques.REGISTRY`, each with a dict of parameters: a list, a range or a
        one-dimensional array is several values, anything else is one, a tuple or a str too. All
        lists of a dict are crossed. `zipped` lets parameters move together, `crossed` crosses
        such sets with others, and a list of dicts and sets is their union. A sequence of names
        takes defaults. The full mesh is always there, as the yardstick.
    cameras : sequence of Camera, or callable, optional
        The cameras, or what gives them for a plant. Default: `default_cameras`.
    store : path-like
        Folder for the rows; made if it is missing.
    executor : None, int, Executor, or callable, optional
        Who works: this process; so many processes; a `concurrent.futures.Executor` or a dask
        client; or a function without arguments that makes an executor, and another one when it
        breaks. Default: this process. A script that uses processes must be guarded by
        ``if __name__ == "__main__":``.
    samples : int, default 4
        Samples a pixel of the frames that are timed.
    reference_samples : int, default 64
        Samples a pixel of the reference and of the frames that are measured.
    repeats : int, default 9
        Timed frames of each cell, in turns with the full mesh.
    warmup : int, default 2
        Frames drawn before those, not counted.
    timing : {'shared', 'exclusive', 'none'}, default 'shared'
        Whether cells are timed while others may run, after all others with nothing else of the
        sweep running, or not at all.
    threads : int, optional
        Threads that draw, in ``1..=1024``. Default: in processes of this machine its cores over
        their number; of a dask worker its own; else all cores.
    ppd : float, default 67.02
        Pixels a degree of sight, for FLIP.
    yee : bool, default False
        Whether to measure Yee's metric too, which takes seconds a frame.
    retries : int, default 2
        How often a cell that has killed its worker is tried again.
    on_error : {'raise', 'record'}, default 'raise'
        What happens if a cell fails: no other is begun and `SweepError` is raised, or it is listed
        in ``attrs["failed"]`` and the sweep goes on.
    sources : mapping of str to (mapping of str to object), optional
        Where plants came from, by name, stored with their rows: ``sha256`` and ``seed`` become
        columns.
    progress : bool or callable, default True
        Whether to show bars where the error stream is a terminal, and a line in a notebook; or what
        is called with a stage ("cells" or "timing"), how many of its steps are done, and how many
        there are.
    backend : {'cpu', 'gpu'}, default 'cpu'
        What draws the frames that are timed: the processor, or a graphics card. Errors, counts and
        overdraw are the processor's with either.
    adapter : str, optional
        Which graphics card, with ``backend="gpu"``, as in `render`; that of each worker.

    Returns
    -------
    SweepResults
        A `pandas.DataFrame`, one row a plant, technique, parameters and camera, in the grid's
        order.

    Raises
    ------
    ValueError
        If a name is unknown, a number out of range, or something empty; before anything is drawn.
    TypeError
        If an argument or a parameter is of another type.
    StoreError
        If the folder holds something else, or a worker runs other code.
    SweepError
        If a cell fails, with its plant, technique, parameters and view; if nobody is left to work.
    NoAdapterError
        If there is no graphics card of that name, or none at all; before anything is built.
    DeviceError
        If the graphics card does not open. One that fails later fails a cell.

    Warns
    -----
    SweepWarning
        For each file of the store that is skipped, and if cells were recorded as failed.

    Examples
    --------
    >>> import tempfile
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=60)
    >>> cameras = tl.orbit(plant, count=2, size=(48, 48))
    >>> grid = {"slicings": {"slice_count": [1, 3], "resolution": 16}}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     table = tl.sweep(plant, grid, cameras, store=folder, reference_samples=16, repeats=1)
    >>> table.groupby("label", sort=False)["view"].count().to_dict()
    {'full_mesh': 2, 'slicings:slice_count=1': 2, 'slicings:slice_count=3': 2}
    """
    settings = Settings.checked(
        samples=samples,
        reference_samples=reference_samples,
        repeats=repeats,
        warmup=warmup,
        timing=timing,
        threads=threads,
        ppd=ppd,
        yee=yee,
        backend=backend,
        adapter=adapter,
    )
    if whole("retries", retries) < 0:
        msg = f"retries must be at least 0, got {retries}"
        raise ValueError(msg)
    if on_error not in ("raise", "record"):
        msg = f"on_error must be 'raise' or 'record', got {on_error!r}"
        raise ValueError(msg)
    named = _named(plants)
    came = _sources(sources, named)
    if not isinstance(progress, bool) and not callable(progress):
        msg = f"progress must be True, False or callable, got {progress!r}"
        raise TypeError(msg)
    variants = expand(grid)
    views = {name: _views(plant, cameras) for name, plant in named.items()}
    _distinct(named)
    # who works, and with which card, is known before a folder is made
    crew = crew_of(executor, Store(store))
    try:
        if settings.backend == "gpu":
            settings = settings.on_card(crew.card(adapter))
        cells = [
            Cell.of(name, plant.digest, variant, view, settings, kernel_version())
            for name, plant in named.items()
            for variant in variants
            for view in views[name]
        ]
        opened = Store.open(store, make=True)
    except BaseException:
        crew.close(at_once=True)
        raise
    with _shown(progress) as report:
        run = _Run(named, cells, opened, crew, settings, came, report, retries, on_error)
        return run.results()


class _Run:
    """One call of `sweep`: what is done, and what is lost."""

    def __init__(
        self,
        plants: Mapping[str, Plant],
        cells: Sequence[Cell],
        store: Store,
        crew: Crew,
        settings: Settings,
        sources: Mapping[str, Mapping[str, Any]],
        report: Progress,
        retries: int,
        on_error: str,
    ) -> None:
        self._plants = plants
        # two views may be the same camera
        self._cells = [*{cell.key: cell for cell in reversed(cells)}.values()][::-1]
        self._asked = cells
        self._store = store
        self._crew = crew
        self._settings = settings
        self._sources = sources
        self._report = report
        self._retries = retries
        self._on_error = on_error
        self._name = uuid.uuid4().hex
        self._shards: dict[str, Shard] = {}
        self._losses: dict[str, Loss] = {}
        self._work: dict[str, Counter[str]] = {}

    def results(self) -> SweepResults:
        try:
            for cell in self._cells:
                shard = self._store.read(cell.key)
                if shard is not None:
                    self._shards[cell.key] = shard
            found = len(self._shards)
            for cell in self._cells:
                if cell.key not in self._shards:
                    self._borrow(cell)
            self._run()
        except BaseException:
            worker.stop(self._name)
            self._crew.close(at_once=True)
            raise
        self._crew.close(at_once=False)
        self._tell()
        shards, places = [], []
        for cell in self._asked:
            shard = self._shards.get(cell.key)
            if shard is not None:
                # of other names and places, perhaps, when it was stored
                row = {**shard.row, "plant": cell.plant}
                if cell.plant in self._sources:
                    row |= source_columns(self._sources[cell.plant])
                given = [*cell.variant.given]
                shards.append(Shard(row, shard.identity, given))
                places.append(cell.view.index)
        table = table_of(shards, places)
        table.attrs["failed"] = [_facts(loss) for loss in self._losses.values()]
        table.attrs["work"] = {
            "stored": found,
            "workers": {name: dict(counts) for name, counts in sorted(self._work.items())},
        }
        return table

    def _borrow(self, cell: Cell) -> None:
        """Take errors that are stored with other times: it remains to time the cell."""
        for key in cell.same_errors():
            shard = self._store.read(key)
            if shard is not None:
                settings = self._settings
                row = shard.row | self._constants(cell) | time_columns(None)
                row |= {"backend": settings.backend, "adapter": settings.adapter, "driver": None}
                self._shards[cell.key] = Shard(row, cell.identity, [*cell.variant.given])
                return

    def _run(self) -> None:
        missing = [cell for cell in self._cells if cell.key not in self._shards]
        timing = self._settings.timing
        what: Literal["all", "errors", "times"] = "errors" if timing == "exclusive" else "all"
        untimed = [
            cell
            for cell in self._cells
            if cell.key not in self._shards or not self._shards[cell.key].is_timed
        ]
        if not untimed:
            self._report("cells", len(self._cells), len(self._cells))
            return
        needed = {cell.plant for cell in untimed}
        self._crew.bring(plant for name, plant in self._plants.items() if name in needed)
        self._stage("cells", missing, what, len(self._cells))
        if self._losses and self._on_error != "record":
            return
        untimed = [
            cell
            for cell in untimed
            if cell.key in self._shards and not self._shards[cell.key].is_timed
        ]
        if untimed or timing == "exclusive":
            self._stage("timing", untimed, "times", len(untimed))

    def _stage(
        self, name: str, cells: Sequence[Cell], what: Literal["all", "errors", "times"], total: int
    ) -> None:
        groups: dict[tuple[str, int], Group] = {}
        for cell in cells:
            key = (cell.plant_digest, id(cell.variant))
            groups.setdefault(key, Group(cells=deque())).cells.append(cell)
        done = total - len(cells)
        self._report(name, done, total)

        def keep(cell: Cell, row: dict[str, Any], outcome: Outcome) -> None:
            nonlocal done
            self._keep(cell, row, outcome)
            done += 1
            self._report(name, done, total)

        def lose(loss: Loss) -> None:
            self._losses.setdefault(loss.cell.key, loss)

        Schedule(
            crew=self._crew,
            groups=[*groups.values()],
            job_of=lambda some: self._job(some, what),
            keep=keep,
            lose=lose,
            retries=self._retries,
            goes_on=self._on_error == "record",
            one_by_one=self._is_alone(what),
        ).run()

    def _job(self, cells: Sequence[Cell], what: Literal["all", "errors", "times"]) -> Job:
        first = cells[0]
        threads = self._settings.threads
        if threads is None:
            # a cell that is timed alone has the machine to itself
            threads = self._crew.threads(is_alone=self._is_alone(what))
        return worker.Job(
            plant_digest=first.plant_digest,
            plant_path=self._crew.plant_path(first.plant_digest),
            variant=first.variant,
            views=tuple(cell.view for cell in cells),
            settings=self._settings,
            what=what,
            threads=threads,
            kernel_version=kernel_version(),
            sweep=self._name,
        )

    def _is_alone(self, what: Literal["all", "errors", "times"]) -> bool:
        return what == "times" and self._settings.timing == "exclusive"

    def _keep(self, cell: Cell, row: dict[str, Any], outcome: Outcome) -> None:
        counts = self._work.setdefault(outcome.worker, Counter())
        counts.update(outcome.work)
        # counted once an outcome, not once a cell
        outcome.work.clear()
        counts["cells"] += 1
        known = self._shards.get(cell.key)
        if known is None and self._settings.timing == "exclusive":
            # another sweep may have been quicker; its times are not written over
            stored = self._store.read(cell.key)
            if stored is not None and stored.is_timed:
                self._shards[cell.key] = stored
                return
        if known is not None:
            row = known.row | row
        else:
            # in front: who reads a file by eye looks for these first
            row = {"plant": cell.plant, "view": cell.view.index, **row, **self._constants(cell)}
        shard = Shard(row, cell.identity, [*cell.variant.given])
        self._store.write(shard)
        self._shards[cell.key] = shard

    def _constants(self, cell: Cell) -> dict[str, Any]:
        """Return the columns that are known before anything is measured."""
        settings = self._settings
        return {
            "plant": cell.plant,
            "view": cell.view.index,
            "time_samples": settings.samples,
            "reference_samples": settings.reference_samples,
            "repeats": settings.repeats,
            "warmup": settings.warmup,
            "ppd": settings.ppd,
            **source_columns(self._sources.get(cell.plant, {})),
            "timing": settings.timing,
            "plant_digest": cell.plant_digest,
            "kernel_version": kernel_version(),
            "key": cell.key,
        }

    def _tell(self) -> None:
        """Raise the first loss, or warn of all."""
        if not self._losses:
            return
        losses = [*self._losses.values()]
        first = losses[0]
        cell = first.cell
        given = ", ".join(f"{name}={cell.variant.params[name]!r}" for name in cell.variant.given)
        where = f"plant {cell.plant!r}, {cell.variant.technique}({given}), view {cell.view.index}"
        if self._on_error == "raise":
            msg = f"{where}: {first.text}"
            error = SweepError(msg)
            if first.trace:
                error.add_note(f"In the worker:\n{first.trace.rstrip()}")
            raise error from first.error
        msg = (
            f"{len(losses)} of {len(self._cells)} cells failed, the first at {where}: {first.text}"
        )
        warnings.warn(msg, SweepWarning, stacklevel=4)


def _facts(loss: Loss) -> dict[str, Any]:
    cell = loss.cell
    return {
        "plant": cell.plant,
        "technique": cell.variant.technique,
        "params": cell.identity["params"],
        "view": cell.view.index,
        "key": cell.key,
        "error": loss.text,
    }


def _sources(
    sources: Mapping[str, Mapping[str, Any]] | None, plants: Mapping[str, Plant]
) -> dict[str, dict[str, Any]]:
    """Refuse what cannot be stored of where plants came from."""
    if sources is None:
        return {}
    if not isinstance(sources, Mapping):
        msg = f"sources must map names of plants to mappings, got {sources!r}"
        raise TypeError(msg)
    unknown = sorted(str(name) for name in sources if name not in plants)
    if unknown:
        msg = f"sources names {unknown[0]!r}, which is no plant of the sweep"
        raise ValueError(msg)
    found: dict[str, dict[str, Any]] = {}
    for plant, facts in sources.items():
        where = f"sources: {plant}"
        if not isinstance(facts, Mapping) or not all(isinstance(name, str) for name in facts):
            msg = f"{where} must map words to values, got {facts!r}"
            raise TypeError(msg)
        plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in facts.items()}
        try:
            json.dumps(plain, allow_nan=False)
        except (TypeError, ValueError, RecursionError) as error:
            msg = f"{where} must hold what JSON holds: {error}"
            raise TypeError(msg) from None
        sha256, seed = plain.get("sha256"), plain.get("seed")
        if not isinstance(sha256, str | None):
            msg = f"{where}: sha256 must be text, got {sha256!r}"
            raise TypeError(msg)
        if seed is not None and not -(2**63) <= whole(f"{where}: seed", seed) < 2**63:
            msg = f"{where}: seed must be in -2**63..2**63, got {seed}"
            raise ValueError(msg)
        found[plant] = plain
    return found


def _named(plants: Plants) -> dict[str, Plant]:
    if isinstance(plants, Plant):
        plants = [plants]
    if isinstance(plants, Mapping):
        pairs = [*plants.items()]
    elif isinstance(plants, Sequence) and not isinstance(plants, str):
        pairs = [(getattr(plant, "name", ""), plant) for plant in plants]
    else:
        msg = f"plants must be a Plant, a list or a mapping of them, got {plants!r}"
        raise TypeError(msg)
    if not pairs:
        msg = "plants is empty: there is nothing to draw"
        raise ValueError(msg)
    named: dict[str, Plant] = {}
    for name, plant in pairs:
        if not isinstance(plant, Plant) or not isinstance(name, str):
            msg = f"plants must be Plants by name, got {name!r}: {plant!r}"
            raise TypeError(msg)
        if name in named:
            msg = f"plants: two are named {name!r}; give a mapping of names to plants"
            raise ValueError(msg)
        named[name] = plant
    return named


def _distinct(plants: Mapping[str, Plant]) -> None:
    known: dict[str, str] = {}
    for name, plant in plants.items():
        other = known.setdefault(plant.digest, name)
        if other != name:
            msg = f"plants: {other!r} and {name!r} are the same plant"
            raise ValueError(msg)


def _views(plant: Plant, cameras: Cameras | None) -> list[View]:
    if cameras is None:
        chosen: Sequence[Camera] = default_cameras(plant)
    elif callable(cameras):
        chosen = cameras(plant)
    else:
        chosen = cameras
    chosen = list(chosen)
    if not chosen:
        msg = "cameras is empty: there is nothing to measure"
        raise ValueError(msg)
    for camera in chosen:
        if not isinstance(camera, Camera):
            msg = f"cameras must be Cameras, got {camera!r}"
            raise TypeError(msg)
        check_size(camera.size)
    return [View.of(plant, index, camera) for index, camera in enumerate(chosen)]


class _shown:  # noqa: N801
    """Gives what reports progress; ends its bars."""

    def __init__(self, progress: bool | Progress) -> None:  # noqa: FBT001
        self._stages: Stages | LiveLine | None = None
        if progress is True and is_notebook():
            self._stages = LiveLine()
        elif progress is True and sys.stderr.isatty():
            self._stages = Stages()
        self._call = progress if callable(progress) else self._stages

    def __enter__(self) -> Progress:
        if self._stages is not None:
            self._stages.__enter__()
        return self._call or (lambda _stage, _done, _total: None)

    def __exit__(self, *error: object) -> None:
        if self._stages is not None:
            self._stages.__exit__(*error)
