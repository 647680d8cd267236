"""Parameter sweeps: grids, the store, who works, and tables of results."""

from treelod.sweeps.driver import sweep
from treelod.sweeps.grid import ParameterSets, crossed, zipped
from treelod.sweeps.results import SweepResults, load_results

__all__ = ["ParameterSets", "SweepResults", "crossed", "load_results", "sweep", "zipped"]
