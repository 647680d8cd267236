"""
What a worker does: measures cells of one representation, and remembers what the next ones need.

A plant reaches a process once, a representation is built once in it, and a reference is drawn once
for all techniques; each cache drops what was used longest ago once it is full. Workers write no
file: rows go back to the driver.
"""

from __future__ import annotations

import contextlib
import datetime
import functools
import inspect
import math
import os
import pickle
import platform
import sys
import threading
import time
import traceback
from collections import Counter, OrderedDict
from collections.abc import Callable
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from treelod import metrics
from treelod.columns import (
    bake_columns,
    count_columns,
    error_columns,
    provenance_columns,
    time_columns,
    view_columns,
)
from treelod.comparison import error_frames
from treelod.errors import NoAdapterError, StoreError
from treelod.kernel_version import kernel_version
from treelod.plants import Plant
from treelod.provenance import core_count, provenance
from treelod.render import frame_times, render
from treelod.results import Bake
from treelod.sweeps.parameters import written
from treelod.techniques import REGISTRY, FullMesh

if TYPE_CHECKING:
    from treelod.provenance import Provenance
    from treelod.render import Frame
    from treelod.results import View
    from treelod.sweeps.cells import Settings
    from treelod.sweeps.grid import Variant
    from treelod.techniques import Technique

__all__ = ["Failure", "Job", "Outcome", "forget", "hold_plant", "own_threads", "run", "stop"]

MAX_PLANT_BYTES = 2 << 30
MAX_BUILT_BYTES = 1 << 30
MAX_FRAME_BYTES = 1 << 29
"""How much of each kind a process keeps; the latest one is kept in any case."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """
    Cells of one representation.

    Attributes
    ----------
    plant_digest : str
        Which plant.
    plant_path : str or None
        Where a process finds it that does not hold it yet.
    variant : Variant
        Which representation.
    views : tuple of View
        Which cameras.
    settings : Settings
        How they are measured.
    what : {'all', 'errors', 'times'}
        What is measured.
    threads : int or None
        Threads that draw; None: those of the worker.
    kernel_version : str
        Code that the driver runs; the worker must run the same.
    sweep : str
        Which sweep it belongs to, for `stop`.
    """

    plant_digest: str
    plant_path: str | None
    variant: Variant
    views: tuple[View, ...]
    settings: Settings
    what: Literal["all", "errors", "times"]
    threads: int | None
    kernel_version: str
    sweep: str


@dataclass(frozen=True, kw_only=True)
class Failure:
    """
    What went wrong with a cell.

    Attributes
    ----------
    position : int
        Which of the job's views.
    error : Exception or None
        What was raised, where it can travel.
    text : str
        Its type and its message.
    trace : str
        Where it was raised.
    """

    position: int
    error: Exception | None
    text: str
    trace: str


@dataclass(kw_only=True)
class Outcome:
    """
    What came of a job.

    Attributes
    ----------
    worker : str
        Host and process.
    rows : dict of int to dict
        Columns, by position of the view in the job.
    failures : list of Failure
        Of the other views.
    is_hopeless : bool
        Whether the representation itself cannot be built.
    cell_secs : float
        Seconds a cell took, without building.
    work : Counter
        How often the worker read a plant, built and drew references, for this job.
    """

    worker: str
    rows: dict[int, dict[str, Any]] = field(default_factory=dict)
    failures: list[Failure] = field(default_factory=list)
    is_hopeless: bool = False
    cell_secs: float = 0.0
    work: Counter[str] = field(default_factory=Counter)


class _Cache:
    """Values by key, the latest used last; each is made once, also by several threads."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._kept: OrderedDict[Any, tuple[Any, int]] = OrderedDict()
        self._lock = threading.Lock()
        self._making: dict[Any, threading.Lock] = {}

    def get(self, key: Any, make: Callable[[], tuple[Any, int]]) -> Any:
        """Return the value of a key; `make` gives value and bytes if there is none."""
        with self._lock:
            mine = self._making.setdefault(key, threading.Lock())
        with mine:
            try:
                with self._lock:
                    if key in self._kept:
                        self._kept.move_to_end(key)
                        return self._kept[key][0]
                value, size = make()
                with self._lock:
                    self._kept[key] = value, size
                    total = sum(size for _, size in self._kept.values())
                    while total > self._limit and len(self._kept) > 1:
                        _, (_, freed) = self._kept.popitem(last=False)
                        total -= freed
                return value
            finally:
                with self._lock:
                    # whoever waits has the lock itself
                    self._making.pop(key, None)

    def drop(self, digest: str) -> None:
        """Drop what was made of a plant."""
        with self._lock:
            for key in [key for key in self._kept if digest in (key, key[0])]:
                del self._kept[key]


_plants = _Cache(MAX_PLANT_BYTES)
_built = _Cache(MAX_BUILT_BYTES)
_frames = _Cache(MAX_FRAME_BYTES)

_held: dict[str, bytes | Plant] = {}
"""Plants that were brought here: by the driver in its own process, or by dask."""

_holders: dict[str, set[str]] = {}
"""Who brought each of them: several sweeps may want the same plant at once."""

_holding = threading.Lock()


def hold_plant(digest: str, plant: bytes | Plant, holder: str) -> None:
    """
    Bring a plant to this process, and keep it until all who brought it let it go.

    Parameters
    ----------
    digest : str
        What names it.
    plant : bytes or Plant
        The plant, or what `Plant.to_bytes` returns.
    holder : str
        Who brings it.
    """
    with _holding:
        _held.setdefault(digest, plant)
        _holders.setdefault(digest, set()).add(holder)


_stopped: set[str] = set()


def stop(sweep: str) -> None:
    """
    Let jobs of a sweep that run in threads of this process end after their cell.

    Parameters
    ----------
    sweep : str
        Which.
    """
    _stopped.add(sweep)


def forget(digest: str, holder: str) -> None:
    """
    Let a plant go that was brought here, and what was made of it, unless others hold it too.

    Parameters
    ----------
    digest : str
        What names the plant.
    holder : str
        Who brought it.
    """
    with _holding:
        holders = _holders.get(digest, set())
        holders.discard(holder)
        if holders:
            return
        _holders.pop(digest, None)
        _held.pop(digest, None)
        for cache in (_plants, _built, _frames):
            cache.drop(digest)


def run(job: Job) -> Outcome:
    """
    Measure cells.

    Parameters
    ----------
    job : Job
        Which.

    Returns
    -------
    Outcome
        Rows of the cells that could be measured, failures of the others.

    Raises
    ------
    StoreError
        If this process runs other code than the driver, or cannot find the plant.
    """
    if job.kernel_version != kernel_version():
        msg = (
            f"worker {_worker_name()} runs another version of treelod or its libraries "
            f"({kernel_version()}, not {job.kernel_version}): driver, scheduler and workers need "
            "the same environment"
        )
        raise StoreError(msg)
    outcome = Outcome(worker=_worker_name())
    plant = _plant(job, outcome.work)
    threads = own_threads() if job.threads is None else job.threads
    try:
        full = _full_mesh(job, plant, outcome.work)
        technique = full
        if not job.variant.is_yardstick:
            technique = _representation(job, plant, threads, outcome.work)
    except Exception as error:
        outcome.is_hopeless = True
        outcome.failures = [_failure(position, error) for position in range(len(job.views))]
        return outcome
    start = time.perf_counter()
    for position, view in enumerate(job.views):
        if job.sweep in _stopped:
            msg = "the sweep was stopped"
            raise CancelledError(msg)
        try:
            row = _row(job, plant, technique, full, view, threads, outcome.work)
        except Exception as error:
            outcome.failures.append(_failure(position, error))
        else:
            outcome.rows[position] = row
    outcome.cell_secs = (time.perf_counter() - start) / len(job.views)
    return outcome


def _row(
    job: Job,
    plant: Plant,
    technique: Technique,
    full: Technique,
    view: View,
    threads: int,
    work: Counter[str],
) -> dict[str, Any]:
    """Measure one cell: the columns that do not depend on the rest of the sweep."""
    settings, camera = job.settings, view.camera
    row: dict[str, Any] = {}
    if job.what != "times":
        truth = _truth(job, full, view, threads, work)
        quick, frame, error_samples = error_frames(
            technique,
            camera,
            samples=settings.samples,
            # the yardstick's error is aliasing alone
            reference_samples=(
                settings.samples if technique is full else settings.reference_samples
            ),
            threads=threads,
        )
        errors = metrics.compare(truth, frame, ppd=settings.ppd, yee=settings.yee)
        bake = Bake(
            label=technique.name,
            technique=technique.name,
            params=dict(technique.params),
            build_secs=technique.build_secs,
            footprint=technique.footprint,
        )
        row |= bake_columns(bake) | view_columns(view) | error_columns(errors, error_samples)
        row |= time_columns(None) | count_columns(quick.stats)
        row |= {
            "overdraw": _overdraw(quick, settings.samples),
            "backend": settings.backend,
            # the processor is in `cpu`
            "adapter": settings.adapter,
            "driver": None,
        }
        del row["label"], row["view"]
    if job.what != "errors" and settings.timing != "none":
        subjects = {FullMesh.name: full}
        if technique is not full:
            # in turns with the yardstick, so that both meet the same machine
            subjects["own"] = technique
        times = frame_times(
            subjects,
            camera,
            samples=settings.samples,
            warmup=settings.warmup,
            repeats=settings.repeats,
            threads=threads,
            backend=settings.backend,
            adapter=settings.adapter,
        )
        base = times[FullMesh.name]
        own = times.get("own", base)
        if own.adapter != settings.adapter:
            msg = f"{_worker_name()} draws with {own.adapter}, and not with {settings.adapter}"
            raise NoAdapterError(msg)
        base_millis = float(np.median(base.frame_millis))
        row |= time_columns(own.frame_millis, base_millis, own.gpu_millis)
        row["driver"] = own.driver
    row |= {"threads": threads, **provenance_columns(_provenance())}
    row["date"] = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return row


def _overdraw(quick: Frame, samples: int) -> float | None:
    """Fragments a covered pixel, of one set of up to 16 samples."""
    assert quick.color is not None, "colour was asked for"
    assert quick.stats.fragments is not None, "the processor counts them"
    covered = int(np.count_nonzero(quick.color[..., 3]))
    sets = math.ceil(samples / 16)
    return quick.stats.fragments / (covered * sets) if covered else None


def _plant(job: Job, work: Counter[str]) -> Plant:
    """Return the plant: the driver's own, or one that is read once in this process."""
    digest = job.plant_digest

    def make() -> tuple[Plant, int]:
        held = _held.get(digest)
        if isinstance(held, Plant):
            return held, 0
        if held is not None:
            plant = Plant.from_bytes(held)
            _held[digest] = plant
            size = 0
        elif job.plant_path is not None:
            data = Path(job.plant_path).read_bytes()
            plant = Plant.from_bytes(data)
            # the arrays, and the colours that follow from them
            size = 2 * len(data)
        else:
            msg = f"worker {_worker_name()} was not given the plant {digest[:12]}"
            raise StoreError(msg)
        if plant.digest != digest:
            msg = f"stored plant: it is {plant.digest[:12]}, not {digest[:12]}"
            raise StoreError(msg)
        work["plants"] += 1
        return plant, size

    found: Plant = _plants.get(digest, make)
    return found


def _full_mesh(job: Job, plant: Plant, work: Counter[str]) -> Technique:
    def make() -> tuple[Technique, int]:
        work["builds"] += 1
        full = FullMesh.build(plant)
        return full, full.footprint.total_bytes

    found: Technique = _built.get((job.plant_digest, FullMesh.name), make)
    return found


def _representation(job: Job, plant: Plant, threads: int, work: Counter[str]) -> Technique:
    variant = job.variant

    def make() -> tuple[Technique, int]:
        work["builds"] += 1
        build = REGISTRY[variant.technique].build
        # not every technique bakes
        extra = {"threads": threads} if "threads" in inspect.signature(build).parameters else {}
        technique = build(plant, **variant.params, **extra)
        return technique, technique.footprint.total_bytes

    key = (job.plant_digest, variant.technique, written(variant.canonical_params()))
    found: Technique = _built.get(key, make)
    return found


def _truth(job: Job, full: Technique, view: View, threads: int, work: Counter[str]) -> Frame:
    samples = job.settings.reference_samples

    def make() -> tuple[Frame, int]:
        work["references"] += 1
        frame = render(full, view.camera, samples=samples, outputs=("color",), threads=threads)
        width, height = view.camera.size
        return frame, width * height * 16

    found: Frame = _frames.get((job.plant_digest, view.camera, samples), make)
    return found


def own_threads() -> int:
    """
    Return how many threads a call may use in this process.

    Returns
    -------
    int
        Those of a dask worker, else ``TREELOD_NUM_THREADS``, else all cores.
    """
    distributed = sys.modules.get("distributed")
    if distributed is not None:
        # jobs of one worker share a pool of that many threads
        with contextlib.suppress(ValueError):
            return int(distributed.get_worker().state.nthreads)
    stated = os.environ.get("TREELOD_NUM_THREADS", "").strip()
    return int(stated) if stated.isdigit() and int(stated) > 0 else core_count()


@functools.cache
def _provenance() -> Provenance:
    return provenance()


@functools.cache
def _worker_name() -> str:
    return f"{platform.node()}:{os.getpid()}"


def _failure(position: int, error: Exception) -> Failure:
    try:
        pickle.loads(pickle.dumps(error))
        travels: Exception | None = error
    except Exception:
        travels = None
    return Failure(
        position=position,
        error=travels,
        text=f"{type(error).__name__}: {error}",
        trace="".join(traceback.format_exception(error)),
    )
