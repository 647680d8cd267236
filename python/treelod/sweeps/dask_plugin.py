"""How a plant reaches the workers of a dask cluster: each once, also those that join later."""

from __future__ import annotations

import multiprocessing

import OpenImageIO as oiio  # noqa: N813
from distributed import Worker, WorkerPlugin

from treelod.sweeps.worker import forget, hold_plant

__all__ = ["HoldPlant", "plugin_name"]


def plugin_name(digest: str, holder: str) -> str:
    """
    Name the plugin that brings a plant: of each sweep its own.

    Parameters
    ----------
    digest : str
        The plant's.
    holder : str
        Who brings it.

    Returns
    -------
    str
    """
    return f"treelod-plant-{digest}-{holder}"


class HoldPlant(WorkerPlugin):
    """
    Brings a plant to every worker.

    Parameters
    ----------
    digest : str
        What names it.
    data : bytes
        What `Plant.to_bytes` returns.
    holder : str
        Who brings it.
    """

    def __init__(self, digest: str, data: bytes, holder: str) -> None:
        self.name = plugin_name(digest, holder)
        self.holder = holder
        self.digest = digest
        self.data = data

    def setup(self, worker: Worker) -> None:
        """Bring the plant, when a worker starts or the plugin is registered."""
        hold_plant(self.digest, self.data, self._holder(worker))
        # a process of dask's own; in another one the library's threads are not ours to set
        if multiprocessing.parent_process() is not None:
            oiio.attribute("threads", worker.state.nthreads)

    def teardown(self, worker: Worker) -> None:
        """Let the plant go, and what was made of it."""
        forget(self.digest, self._holder(worker))

    def _holder(self, worker: Worker) -> str:
        # workers may share a process
        return f"{self.holder} {worker.id}"
