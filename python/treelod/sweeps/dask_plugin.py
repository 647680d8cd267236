"""How a plant reaches the workers of a dask cluster: each once, also those that join later."""

from __future__ import annotations

from distributed import WorkerPlugin

from treelod.sweeps import worker

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

    def setup(self, worker: object) -> None:
        """Bring the plant, when a worker starts or the plugin is registered."""
        del worker
        hold(self.digest, self.data)

    def teardown(self, worker: object) -> None:
        """Let the plant go, and all that was made of it."""
        del worker
        forget(self.digest)


hold, forget = worker.hold_plant, worker.forget
