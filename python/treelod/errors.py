"""
What can go wrong, as classes that a caller can tell apart.

Bad arguments raise plain `ValueError` or `TypeError`, and a missing file raises
`FileNotFoundError`; the classes here are for everything that Python has no name for.
"""

__all__ = [
    "DeviceError",
    "ForkedError",
    "InternalError",
    "LimitError",
    "NoAdapterError",
    "PlantFileError",
    "StoreError",
    "SweepError",
    "SweepWarning",
    "TreelodError",
]


class TreelodError(Exception):
    """Base of every exception that treelod defines."""


class PlantFileError(TreelodError, ValueError):
    """A plant file is damaged, refused, or of a kind that is not read."""


class LimitError(TreelodError, ValueError):
    """A request needs more memory or larger indices than the stated limit."""


class ForkedError(TreelodError, RuntimeError):
    """The process was forked after treelod had started its threads."""


class NoAdapterError(TreelodError, RuntimeError):
    """No graphics adapter was found."""


class DeviceError(TreelodError, RuntimeError):
    """The graphics device was lost or refused a command."""


class StoreError(TreelodError):
    """Stored results or representations are damaged, or belong to something else."""


class InternalError(TreelodError, RuntimeError):
    """A bug in treelod: please report it, with the message."""


class SweepError(TreelodError, RuntimeError):
    """A cell of a sweep failed, or nobody is left to run them; what is done is stored."""


class SweepWarning(UserWarning):
    """A file of a store is skipped, or cells of a sweep have no row."""
