"""What costs how much and looks how wrong: error against time and memory, with the front."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.lines import Line2D

from treelod.plots.settings import (
    check_columns,
    families,
    looks,
    metric_of,
    one_setting,
    panel_values,
    range_text,
    shown,
)
from treelod.plots.style import (
    FRONT,
    STYLE,
    capped,
    ceiling_of,
    legend,
    panels,
    place_labels,
    plain_log_ticks,
    say_left_out,
    share_y,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike, NDArray

    from treelod.plots.settings import Family, Look
    from treelod.plots.style import MetricName

__all__ = ["memory_against_error", "pareto_front", "speed_against_error"]

_MAX_BARS = 12
"""Settings up to which every point has bars; of more they would be a thicket."""


def pareto_front(cost: ArrayLike, error: ArrayLike) -> NDArray[np.intp]:
    """
    Find what nothing else beats in both cost and error.

    Parameters
    ----------
    cost, error : array_like of shape (N,)
        Smaller is better in both; infinite values are allowed, NaN is never on the front.

    Returns
    -------
    ndarray of shape (K,), dtype intp
        Indices of the front by rising cost and falling error. Of equal points the first.

    Raises
    ------
    ValueError
        If the arrays are not one-dimensional and of one length.

    Examples
    --------
    >>> pareto_front([1, 2, 3, 4], [9, 5, 7, 1]).tolist()
    [0, 1, 3]
    """
    costs, errors = np.asarray(cost, dtype=np.float64), np.asarray(error, dtype=np.float64)
    if costs.ndim != 1 or costs.shape != errors.shape:
        msg = f"cost and error must be one-dimensional and equal, got {costs.shape}, {errors.shape}"
        raise ValueError(msg)
    front: list[int] = []
    best: float | None = None
    for index in np.lexsort((np.arange(len(costs)), errors, costs)):
        if math.isnan(costs[index]) or math.isnan(errors[index]):
            continue
        if best is None or errors[index] < best:
            front.append(int(index))
            best = float(errors[index])
    return np.asarray(front, dtype=np.intp)


def speed_against_error(table: pd.DataFrame, metric: MetricName = "flip") -> Figure:
    """
    Plot what a frame costs against how wrong it looks, one panel a distance.

    Parameters
    ----------
    table : pandas.DataFrame
        As from ``Comparison.table()`` or a sweep.
    metric : str, default "flip"
        The error, one of `METRICS`.

    Returns
    -------
    matplotlib.figure.Figure
        A panel a distance; of more than 4 the nearest, the farthest and two evenly between, which
        the figure says. A point a label: median frame time over the views of that distance against
        the mean error; bars reach from the best to the worst view, for up to 12 labels. Several
        settings of one technique share its colour; a thin line joins them in the order of the
        parameter that was swept, whose first and last value stand beside its ends. The dashed
        staircase is the Pareto front: nothing on it is beaten in both. Of ``coverage_bias`` the
        front is that of the mean magnitude over the views, because views too dense and views too
        thin are both wrong though their mean may be 0; points stand at the mean all the same.

    Raises
    ------
    ValueError
        If `metric` is unknown or was not measured, if a column is missing, if no row has a time,
        if the table is empty, or if it mixes plants or settings.

    Examples
    --------
    >>> import treelod as tl
    >>> from treelod.comparison import compare_techniques
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> cameras = tl.orbit(plant, count=2, size=(64, 64))
    >>> found = compare_techniques(
    ...     plant, {"stochastic_pruning": {}}, cameras, reference_samples=16, repeats=1
    ... )
    >>> figure = tl.plots.speed_against_error(found.table())
    >>> [axes.get_xlabel() for axes in figure.axes]
    ['frame time (ms), median']
    """
    return _against_error(table, metric, "frame_millis", "frame time (ms), median")


def memory_against_error(table: pd.DataFrame, metric: MetricName = "flip") -> Figure:
    """
    Plot what a technique holds in memory against how wrong it looks, one panel a distance.

    Parameters
    ----------
    table : pandas.DataFrame
        As from ``Comparison.table()`` or a sweep.
    metric : str, default "flip"
        The error, one of `METRICS`.

    Returns
    -------
    matplotlib.figure.Figure
        As `speed_against_error`, with bytes of geometry and textures for the time. Of more than 4
        distances 4 are shown here too.

    Raises
    ------
    ValueError
        If `metric` is unknown or was not measured, if a column is missing, or if the table is
        empty, or if it mixes plants or settings.

    Examples
    --------
    >>> import treelod as tl
    >>> from treelod.comparison import compare_techniques
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> cameras = tl.orbit(plant, count=2, size=(64, 64))
    >>> found = compare_techniques(
    ...     plant, {"stochastic_pruning": {}}, cameras, reference_samples=16, repeats=1
    ... )
    >>> figure = tl.plots.memory_against_error(found.table())
    >>> [axes.get_xlabel() for axes in figure.axes]
    ['geometry and textures']
    """
    return _against_error(table, metric, "total_bytes", "geometry and textures")


def _against_error(table: pd.DataFrame, metric: str, cost_name: str, cost_label: str) -> Figure:
    check_columns(table, "label", "distance", cost_name)
    one_setting(table, timed=cost_name == "frame_millis")
    about = metric_of(table, metric)
    if table[cost_name].isna().all():
        msg = f"table has no value of {cost_name!r}: it was not measured"
        raise ValueError(msg)
    if not (table[cost_name].dropna() > 0.0).all():
        msg = f"{cost_name} must be above 0 for a logarithmic axis"
        raise ValueError(msg)
    known, grouped = looks(table), families(table)
    distances = panel_values(table["distance"])
    ceiling = ceiling_of(table[metric])
    with_bars = len(known) <= _MAX_BARS
    labels: list[tuple[Axes, float, float, str, str]] = []
    with mpl.rc_context(STYLE):
        figure, row = panels(len(distances))
        for axes, distance in zip(row, distances, strict=True):
            here = table[table["distance"] == distance]
            points: dict[str, tuple[float, float]] = {}
            badness: list[float] = []
            for family in grouped:
                for label in family.labels:
                    rows = here[here["label"] == label]
                    if not len(rows):
                        continue
                    marker = known[(family.labels if family.swept else [label])[0]].marker
                    look = known[label]
                    values = capped(rows[metric], ceiling)
                    points[label] = _point(axes, rows[cost_name], values, look, marker, with_bars)
                    # of the views, not of their mean, in which signs cancel
                    badness.append(float(about.badness(values).mean()))
                labels += _join(axes, family, points, known)
            costs, middles = np.array(list(points.values())).T
            front = pareto_front(costs, badness)
            # between two techniques there is nothing to have: a staircase, not a slope
            axes.plot(
                costs[front],
                middles[front],
                linewidth=1.2,
                drawstyle="steps-post",
                zorder=2,
                **FRONT,
            )
            axes.set_xscale("log")
            plain_log_ticks(axes, name=cost_name)
            axes.set_xlabel(cost_label)
            axes.set_title(f"distance {distance:.4g} radii")
        say_left_out(row[-1], len(distances), table["distance"].nunique(), "distances")
        share_y(row, metric, about.label, ceiling, table[metric])
        entries: list[tuple[str, Any]] = []
        for family in grouped:
            if family.swept is None:
                entries += [(label, known[label].line("none")) for label in family.labels]
            else:
                look = known[family.labels[0]]
                line = Line2D([], [], color=look.color, marker=look.marker, linewidth=0.8)
                entries.append((range_text(family), line))
        front_name = "Pareto front of mean magnitudes" if about.signed else "Pareto front"
        legend(figure, [*entries, (front_name, Line2D([], [], **FRONT))])
        place_labels(figure, labels)
    return figure


def _point(
    axes: Axes,
    costs: pd.Series[Any],
    values: NDArray[np.float64],
    look: Look,
    marker: str,
    with_bars: bool,  # noqa: FBT001
) -> tuple[float, float]:
    """Draw one label's marker, and bars over its views; returns where it stands."""
    cost, middle = float(costs.median()), float(values.mean())
    bars: dict[str, Any] = {}
    if with_bars:
        bars = {
            "yerr": [[middle - values.min()], [values.max() - middle]],
            "xerr": [
                [max(cost - float(costs.min()), 0.0)],
                [max(float(costs.max()) - cost, 0.0)],
            ],
            "elinewidth": 0.8,
            "capsize": 2,
        }
    # a marker at 0 is drawn whole, over the axis
    axes.errorbar([cost], [middle], fmt=marker, color=look.color, zorder=3, clip_on=False, **bars)
    return cost, middle


def _join(
    axes: Axes,
    family: Family,
    points: dict[str, tuple[float, float]],
    known: dict[str, Look],
) -> list[tuple[Axes, float, float, str, str]]:
    """Join a technique's settings by a line for each path; returns the labels of its ends."""
    labels = []
    for path in family.paths:
        there = [
            (points[label], value)
            for label, value in zip(path.labels, path.values, strict=True)
            if label in points
        ]
        if family.swept is None or len(there) < 2:
            continue
        color = known[path.labels[0]].color
        line = np.array([point for point, _ in there])
        axes.plot(line[:, 0], line[:, 1], color=color, linewidth=0.8, zorder=2.5)
        for point, value in (there[-1], there[0]):
            text = shown(value)
            if point == there[-1][0] and path.others:
                text = f"{text} ({path.others})"
            labels.append((axes, *point, text, color))
    return labels
