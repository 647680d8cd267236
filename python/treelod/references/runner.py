"""
How references are run: in processes of their own, with a time limit, once more if one dies, and
once.

mitsuba has been seen to end with a bus error in one of eleven runs of the same scene, and a plug-in
that aborts takes its whole process along. Results are kept under the hash of what went in.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import logging
import os
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from treelod.errors import TreelodError
from treelod.files import atomic_write
from treelod.provenance import core_count

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

__all__ = [
    "VERSIONED",
    "ReferenceFailedError",
    "cache_folder",
    "in_parallel",
    "reference",
    "require",
]

T = TypeVar("T")

JOBS = {
    "rays": "treelod.references.rays",
    "shade": "treelod.references.shading",
    "mitsuba": "treelod.references.mitsuba",
    "embree": "treelod.references.embree",
}
"""Modules by job; each has a function `run(arrays, settings)` that returns arrays."""

_PACKAGES = {"mitsuba": "mitsuba", "embreex": "embreex"}
"""Distributions of the extra `validate`, by the module that is imported."""

VERSIONED = ("mitsuba", "embreex", "trimesh", "scipy", "numpy")
"""What a result depends on besides its input and our own code."""

_REFERENCES = Path(__file__).parent
_COLOR = _REFERENCES.parent / "color.py"
"""Our own code that runs in children: how rays, texels and colours are made."""

_ATTEMPTS = 2

_TIMEOUT_SECS = 3600.0
"""A reference that takes longer hangs: the largest takes a quarter of it on two slow cores."""

_POLL_SECS = 0.05
"""How often a thread that waits for a child looks whether it shall."""

_MAX_WORKERS = 8
"""Children at once: each may hold a gigabyte."""

_of_thread = threading.local()
"""``stop``: the event that ends what a thread of `in_parallel` waits for."""

_logger = logging.getLogger(__name__)


class ReferenceFailedError(TreelodError):
    """A reference's process failed twice, or took too long."""


def require() -> None:
    """
    Check that the references are installed, without importing them.

    Raises
    ------
    ImportError
        If one is missing; the message holds the line that installs all.
    """
    missing = [name for name, module in _PACKAGES.items() if not importlib.util.find_spec(module)]
    if missing:
        msg = f"{' and '.join(missing)} missing: pip install 'treelod[validate]'"
        raise ImportError(msg)


def cache_folder() -> Path:
    """
    Return where results are kept: ``TREELOD_CACHE``, else ``treelod`` in the user's cache folder.

    Returns
    -------
    Path
        A folder, which need not exist.
    """
    stated = os.environ.get("TREELOD_CACHE")
    if stated:
        return Path(stated) / "references"
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "treelod" / "references"


def reference(
    job: str,
    arrays: Mapping[str, NDArray[Any]],
    settings: Mapping[str, Any],
    *,
    cached: bool = True,
    timeout_secs: float = _TIMEOUT_SECS,
) -> dict[str, NDArray[Any]]:
    """
    Run a reference, or take its result from the cache.

    Parameters
    ----------
    job : {'rays', 'shade', 'mitsuba', 'embree'}
        What to run: the module of that name.
    arrays : mapping of str to ndarray
        Its input.
    settings : mapping of str to (str, number, list or None)
        The rest of its input, as JSON holds it.
    cached : bool, default True
        Whether results are kept and taken; False to time a run.
    timeout_secs : float, default 3600
        Seconds after which a run has failed.

    Returns
    -------
    dict of str to ndarray
        What the job returns.

    Raises
    ------
    ImportError
        If the extra ``validate`` is not installed.
    ReferenceFailedError
        If it fails twice.
    """
    require()
    path = cache_folder() / f"{job}-{_fingerprint(job, arrays, settings)}.npz"
    if cached:
        kept = _read(path)
        if kept is not None:
            return kept
    result = _in_child(job, arrays, settings, timeout_secs)
    if cached:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, lambda file: np.savez_compressed(file, allow_pickle=False, **result))
    return result


def _fingerprint(job: str, arrays: Mapping[str, NDArray[Any]], settings: Mapping[str, Any]) -> str:
    digest = hashlib.sha256()
    spec = importlib.util.find_spec(JOBS[job])
    assert spec is not None
    assert spec.origin is not None
    # an edited reference gives other results, and so does what it imports
    for path in (Path(spec.origin), *sorted(_REFERENCES.glob("*.py")), _COLOR):
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    versions = {name: importlib.metadata.version(name) for name in VERSIONED}
    digest.update(json.dumps([versions, settings], sort_keys=True, allow_nan=False).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()[:32]


def _read(path: Path) -> dict[str, NDArray[Any]] | None:
    try:
        # opened here, because numpy leaves a damaged file open
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as damage:
        _logger.warning("%s is damaged and made again: %s", path, damage)
        return None


def _in_child(
    job: str,
    arrays: Mapping[str, NDArray[Any]],
    settings: Mapping[str, Any],
    timeout_secs: float,
) -> dict[str, NDArray[Any]]:
    with tempfile.TemporaryDirectory(prefix="treelod-") as folder:
        given, made = Path(folder) / "in.npz", Path(folder) / "out.npz"
        # prefixed, so that no array can bear the name of a parameter
        named: dict[str, Any] = {f"in_{name}": array for name, array in arrays.items()}
        np.savez(given, allow_pickle=False, **named)
        command = [sys.executable, "-m", "treelod.references.child", JOBS[job]]
        command += [str(given), str(made), json.dumps(dict(settings), allow_nan=False)]
        why = ""
        for attempt in range(1, _ATTEMPTS + 1):
            log = Path(folder) / "said.txt"
            try:
                code = _ended(command, log, timeout_secs)
            except subprocess.TimeoutExpired:
                why = f"took more than {timeout_secs:g} s"
            else:
                result = _read(made) if code == 0 else None
                if result is not None:
                    return result
                said = log.read_text(errors="replace").strip().splitlines() or ["nothing said"]
                why = f"ended with code {code}: {said[-1]}"
            _logger.warning("reference %r, attempt %d of %d: %s", job, attempt, _ATTEMPTS, why)
    msg = f"reference {job!r} failed {_ATTEMPTS} times; at last it {why}"
    raise ReferenceFailedError(msg)


class _StoppedError(Exception):
    """Another call of the same `in_parallel` has failed, or the user has stopped it."""


def _ended(command: list[str], log: Path, timeout_secs: float) -> int:
    """Run a child to its end and return its code; whatever ends the wait ends the child."""
    stop = getattr(_of_thread, "stop", None)
    deadline = time.monotonic() + timeout_secs
    with log.open("wb") as said:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=said, stderr=said)
        try:
            while True:
                if stop is not None and stop.is_set():
                    raise _StoppedError
                try:
                    return child.wait(timeout=_POLL_SECS)
                except subprocess.TimeoutExpired:
                    if time.monotonic() > deadline:
                        raise
        finally:
            if child.poll() is None:
                child.kill()
                child.wait()


def in_parallel(
    calls: Sequence[Callable[[], T]], progress: Callable[[int, int], object] | None = None
) -> list[T]:
    """
    Make calls that wait for references, as many at once as there are processors, at most eight.

    Parameters
    ----------
    calls : sequence of callable
        Each calls `reference`.
    progress : callable, optional
        Called with calls done and all, first with none; what it raises ends them.

    Returns
    -------
    list
        What the calls return, in their order.

    Raises
    ------
    BaseException
        What the first of them raises, or the progress, or Ctrl-C. The children are then killed.
    """
    stop = threading.Event()

    def begin() -> None:
        _of_thread.stop = stop

    worker_count = max(min(core_count(), _MAX_WORKERS, len(calls)), 1)
    report = progress or (lambda done, total: None)
    pool = ThreadPoolExecutor(worker_count, initializer=begin)
    try:
        report(0, len(calls))
        futures = [pool.submit(call) for call in calls]
        for done, future in enumerate(as_completed(futures), start=1):
            future.result()
            report(done, len(calls))
        return [future.result() for future in futures]
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)
