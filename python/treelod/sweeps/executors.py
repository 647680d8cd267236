"""
Who works: this process, processes of its own, or any executor; and how plants reach the workers.

All of them are `concurrent.futures.Executor`; what differs is how many jobs to hand out at once,
how many threads each may use, what a broken one is replaced by, and how a plant gets there: as it
is within a process, as a file for processes of this machine, as a plugin for dask.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import operator
import os
import signal
import threading
import uuid
from collections.abc import Callable
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, TypeAlias

from treelod.errors import SweepError
from treelod.files import atomic_write
from treelod.provenance import core_count
from treelod.render import opened_card
from treelod.sweeps import worker

if TYPE_CHECKING:
    from collections.abc import Iterable
    from multiprocessing.process import BaseProcess

    from treelod.plants import Plant
    from treelod.sweeps.store import Store
    from treelod.sweeps.worker import Job, Outcome

__all__ = ["Crew", "ExecutorLike", "crew_of"]

ExecutorLike: TypeAlias = "Executor | int | Callable[[], Executor] | None"
"""Who works, as `sweep` takes it."""

_LOST = "KilledWorker"
"""What dask raises for a job whose workers died, again and again."""


class Crew:
    """
    An executor, with what a sweep needs to know of it.

    Parameters
    ----------
    executor : Executor or None
        Who works; None: whoever `make` makes.
    make : callable, optional
        Makes the executor, and another one when it breaks; it is then this crew's own.
    store : Store
        Where plants wait for processes.
    """

    def __init__(
        self, executor: Executor | None, make: Callable[[], Executor] | None, store: Store
    ) -> None:
        self._make = make
        self._store = store
        self._brought: list[str] = []
        # two sweeps may share workers, and plants
        self._name = uuid.uuid4().hex
        self.executor = executor if executor is not None else _made(make)

    @property
    def width(self) -> int:
        """How many jobs run at once."""
        return max(1, int(getattr(self.executor, "_max_workers", 0) or core_count()))

    def threads(self, *, is_alone: bool) -> int | None:
        """Return the threads of a job where none are asked for; None leaves it to the worker."""
        return max(1, worker.own_threads() // (1 if is_alone else self.width))

    def bring(self, plants: Iterable[Plant]) -> None:
        """Make plants available to every worker."""
        for plant in plants:
            path = self._store.plant_path(plant.digest)
            # written anew: what lies there may be of a writer that nobody vouches for
            atomic_write(path, plant.to_bytes())

    def plant_path(self, digest: str) -> str | None:
        """Return where workers find a plant; None if they hold it."""
        return str(self._store.plant_path(digest).absolute())

    def submit(self, job: Job) -> Future[Outcome]:
        """Hand a job out."""
        return self.executor.submit(worker.run, job)

    def card(self, adapter: str | None) -> str:
        """Open a graphics card where jobs will run, and return its name."""
        if isinstance(self.executor, ProcessPoolExecutor | ThreadPoolExecutor | _Inline):
            # workers of this machine have its cards
            return opened_card(adapter)[0]
        return self._elsewhere(opened_card, adapter).result()[0]

    def _elsewhere(
        self, function: Callable[..., tuple[str, str]], *arguments: str | None
    ) -> Future[tuple[str, str]]:
        return self.executor.submit(function, *arguments)

    def revive(self, error: BaseException) -> None:
        """Replace a broken executor."""
        if self._make is None:
            msg = (
                f"the executor is broken ({error}): give a function that makes one, or a number "
                "of workers, and another one is made; what was done is in the store"
            )
            raise SweepError(msg) from error
        self.executor.shutdown(wait=False, cancel_futures=True)
        self.executor = _made(self._make)

    def check_alive(self) -> None:
        """Refuse to go on with workers that die before they do anything."""
        try:
            self.executor.submit(os.getpid).result()
        except BrokenExecutor as error:
            msg = (
                f"workers die before they work ({error}): a script that uses processes must be "
                'guarded by `if __name__ == "__main__":`, and what starts a worker, an '
                "initializer for example, must work in the environment of the workers"
            )
            raise SweepError(msg) from error

    def is_lost(self, error: BaseException) -> bool:
        """Tell whether a job failed because its worker died."""
        return isinstance(error, BrokenExecutor)

    def close(self, *, at_once: bool) -> None:
        """Let own workers go: when they are done, or at once."""
        if self._make is None:
            return
        # listed first: a pool that is shut down knows its processes no more
        processes: list[BaseProcess] = list(
            (getattr(self.executor, "_processes", None) or {}).values()
        )
        self.executor.shutdown(wait=not at_once, cancel_futures=True)
        if at_once:
            for process in processes:
                process.terminate()
            for process in processes:
                process.join(5.0)


class _Here(Crew):
    """Workers that are threads of this process, or this very thread."""

    def threads(self, *, is_alone: bool) -> int | None:
        # jobs of one process share one pool of threads
        del is_alone
        return None

    def bring(self, plants: Iterable[Plant]) -> None:
        for plant in plants:
            self._brought.append(plant.digest)
            worker.hold_plant(plant.digest, plant, self._name)

    def plant_path(self, digest: str) -> str | None:
        del digest
        return None

    def close(self, *, at_once: bool) -> None:
        super().close(at_once=at_once)
        for digest in self._brought:
            worker.forget(digest, self._name)


class _Dask(Crew):
    """Workers of a dask cluster, wherever they are."""

    @property
    def _client(self) -> Any:
        return self.executor._client  # type: ignore[attr-defined]

    @property
    def width(self) -> int:
        # asked each time: workers join and leave
        return max(1, int(sum(self._client.nthreads().values())))

    def threads(self, *, is_alone: bool) -> int | None:
        # jobs of one worker share one pool of threads
        del is_alone
        return None

    def bring(self, plants: Iterable[Plant]) -> None:
        from treelod.sweeps.dask_plugin import HoldPlant

        for plant in plants:
            self._brought.append(plant.digest)
            plugin = HoldPlant(plant.digest, plant.to_bytes(), self._name)
            self._client.register_plugin(plugin)

    def plant_path(self, digest: str) -> str | None:
        del digest
        return None

    def submit(self, job: Job) -> Future[Outcome]:
        # a pure job that failed would be replayed from memory, and not run again
        executor: Any = self.executor
        future: Future[Outcome] = executor.submit(worker.run, job, pure=False)
        return future

    def _elsewhere(
        self, function: Callable[..., tuple[str, str]], *arguments: str | None
    ) -> Future[tuple[str, str]]:
        executor: Any = self.executor
        # not what it was when somebody asked before
        future: Future[tuple[str, str]] = executor.submit(function, *arguments, pure=False)
        return future

    def is_lost(self, error: BaseException) -> bool:
        return type(error).__name__ == _LOST or super().is_lost(error)

    def close(self, *, at_once: bool) -> None:
        from treelod.sweeps.dask_plugin import plugin_name

        for digest in self._brought:
            # a cluster that is gone, or knows of no such plugin, holds nothing
            with contextlib.suppress(OSError, TimeoutError, ValueError):
                self._client.unregister_worker_plugin(plugin_name(digest, self._name))
        super().close(at_once=at_once)


class _Inline(Executor):
    """Runs a job at once, in the thread that hands it out."""

    _max_workers = 1

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def crew_of(executor: ExecutorLike, store: Store) -> Crew:
    """
    Find out who works.

    Parameters
    ----------
    executor : None, int, Executor or callable
        As `sweep` takes it.
    store : Store
        Where plants wait for processes.

    Returns
    -------
    Crew

    Raises
    ------
    TypeError
        If it is none of these.
    ValueError
        If the number of workers is below 1.
    """
    if executor is None:
        return _Here(_Inline(), None, store)
    make: Callable[[], Executor] | None = None
    made: Executor | None = None
    if hasattr(executor, "__index__") and not isinstance(executor, bool):
        count = operator.index(executor)
        if count < 1:
            msg = f"executor must be at least 1 worker, got {count}"
            raise ValueError(msg)
        make = lambda: _processes(count)  # noqa: E731
    elif isinstance(executor, Executor):
        made = executor
    elif hasattr(executor, "get_executor"):
        # a client of dask; a job is never the same as another one
        made = executor.get_executor(pure=False)
    elif callable(executor):
        make = executor
    else:
        msg = f"executor must be None, a number of workers, or an Executor, got {executor!r}"
        raise TypeError(msg)
    first = made if made is not None else _made(make)
    kind = Crew
    if isinstance(first, ThreadPoolExecutor):
        kind = _Here
    elif type(first).__module__.partition(".")[0] == "distributed":
        kind = _Dask
    return kind(first, make, store)


def _made(make: Callable[[], Executor] | None) -> Executor:
    made = make() if make is not None else None
    if not isinstance(made, Executor):
        msg = f"executor made {made!r}, which is no concurrent.futures.Executor"
        raise TypeError(msg)
    return made


def _processes(count: int) -> Executor:
    # never `fork`: a fork copies no threads
    context = multiprocessing.get_context("forkserver" if os.name == "posix" else "spawn")
    threads = max(1, core_count() // count)
    return ProcessPoolExecutor(
        count, mp_context=context, initializer=_start_worker, initargs=(threads,)
    )


def _start_worker(threads: int) -> None:
    """Prepare a process of our own: no Ctrl-C, no more threads than its share, no life after us."""
    # Ctrl-C goes to the driver, which ends its workers
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["TREELOD_NUM_THREADS"] = str(threads)
    import OpenImageIO as oiio  # noqa: N813

    oiio.attribute("threads", threads)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    """End when the driver has: a pool's processes would wait for it for ever."""
    wait([sentinel])
    os._exit(1)
