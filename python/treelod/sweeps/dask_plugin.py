"""How a plant reaches the workers of a dask cluster: each once, also those that join later."""

from __future__ import annotations

import multiprocessing

import OpenImageIO as oiio  # noqa: N813
from distributed import Worker, WorkerPlugin

from treelod.sweeps.worker import forget, hold_plant

__all__ = ["HoldPlant", "plugin_name"]


def plugin_name(digest: str) -> str:
    """
    Name the plugin that brings a plant.

    Parameters
    ----------
    digest : str
        The plant's.

    Returns
    -------
    str
    """
    return f"treelod-plant-{digest}"


class HoldPlant(WorkerPlugin):
    """
    Brings a plant to every worker.

    Parameters
    ----------
    digest : str
        What names it.
    data : bytes
        What `Plant.to_bytes` returns.
    """

    def __init__(self, digest: str, data: bytes) -> None:
        self.name = plugin_name(digest)
        self.digest = digest
        self.data = data

    def setup(self, worker: Worker) -> None:
        """Bring the plant, when a worker starts or the plugin is registered."""
        hold_plant(self.digest, self.data)
        # a process of dask's own; in another one the library's threads are not ours to set
        if multiprocessing.parent_process() is not None:
            oiio.attribute("threads", worker.state.nthreads)

    def teardown(self, worker: Worker) -> None:
        """Let the plant go, and all that was made of it."""
        del worker
        forget(self.digest)
