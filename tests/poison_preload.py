"""What a dask worker loads first so that slicings of two slices kill it."""

from made_sweeps import kill_on_two_slices


def dask_setup(_worker):
    """Dask calls this in the worker; whoever else imports the module is left alone."""
    kill_on_two_slices()
