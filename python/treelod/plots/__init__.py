"""
What tables look like on paper: speed and memory against error, errors by view and by parameter.

Each function takes a table, as `Comparison.table` or a sweep gives it, and returns a matplotlib
figure, without pyplot and its global state, so it works in threads, servers and notebooks alike.
Techniques keep one colour through all plots of a table, and are told apart in print and by the
colour-blind. `encode` turns a figure into the bytes of a file.
"""

from treelod.plots.costs import walk_costs, worst_case
from treelod.plots.fronts import memory_against_error, pareto_front, speed_against_error
from treelod.plots.heat_maps import error_heat_map
from treelod.plots.parameters import error_against_parameter
from treelod.plots.pops import popping
from treelod.plots.strips import picture_strip
from treelod.plots.style import COSTS, METRICS, Metric, MetricName, encode
from treelod.plots.views import coverage, error_by_azimuth, error_by_distance

__all__ = [
    "COSTS",
    "METRICS",
    "Metric",
    "MetricName",
    "coverage",
    "encode",
    "error_against_parameter",
    "error_by_azimuth",
    "error_by_distance",
    "error_heat_map",
    "memory_against_error",
    "pareto_front",
    "picture_strip",
    "popping",
    "speed_against_error",
    "walk_costs",
    "worst_case",
]
