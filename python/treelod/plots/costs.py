"""What growing groves cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np

from treelod.plots.settings import check_columns, legend_entries, looks, one_setting
from treelod.plots.style import DODGE, FRONT, LABEL_SIZE, STYLE, legend, panels, plain_log_ticks

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

__all__ = ["walk_costs", "worst_case"]

JAKULIN_SPEEDUP = 20.0
"""Of slicings over the mesh, in the worst case, on the graphics card of Jakulin (2000)."""


def walk_costs(table: pd.DataFrame) -> Figure:
    """
    Plot what growing groves cost: primitives a frame and milliseconds a frame.

    Parameters
    ----------
    table : pandas.DataFrame
        As of `treelod.walks.Walk`.

    Returns
    -------
    matplotlib.figure.Figure
        A line a technique over the number of trees, both axes logarithmic. Bars reach from the
        quickest to the slowest frame. Techniques are a little apart to the side.

    Raises
    ------
    ValueError
        If a column is missing, if the table is empty, or if it mixes settings.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> mesh = tl.FullMesh.build(plant)
    >>> walk = tl.walks.walk(
    ...     plant, {"mesh": mesh}, tree_counts=(1, 2), frame_count=2, laps=1, size=(64, 48)
    ... )
    >>> len(tl.plots.walk_costs(walk.table).axes)
    2
    """
    check_columns(
        table, "label", "tree_count", "primitives", "frame_millis", "frame_millis_low",
        "frame_millis_high",
    )  # fmt: skip
    one_setting(table, timed=True)
    known = looks(table)
    counts = np.sort(table["tree_count"].unique())
    with mpl.rc_context(STYLE):
        figure, (primitives, millis) = panels(2, widest=3.6)
        for position, (label, look) in enumerate(known.items()):
            rows = table[table["label"] == label].sort_values("tree_count")
            shift = 1.0 + DODGE * (position - (len(known) - 1) / 2.0)
            shape: Any = {"color": look.shade, "marker": look.marker, "clip_on": False}
            primitives.plot(rows["tree_count"] * shift, rows["primitives"], **shape)
            middle = rows["frame_millis"]
            reach = [middle - rows["frame_millis_low"], rows["frame_millis_high"] - middle]
            millis.errorbar(
                rows["tree_count"] * shift, middle, yerr=reach, elinewidth=0.8, capsize=2, **shape
            )
        _over_trees(primitives, counts, "primitives a frame")
        _over_trees(millis, counts, "milliseconds a frame")
        legend(figure, legend_entries(table))
    return figure


def worst_case(table: pd.DataFrame, baseline: str | None = "full_mesh") -> Figure:
    """
    Plot the worst case and the mean of a path through growing groves, as figure 4 of [1]_ does.

    Parameters
    ----------
    table : pandas.DataFrame
        As of `treelod.walks.Walk`, with a worst case in every row: the walk has to have at least
        200 frames, as a path through a grove has.
    baseline : str, optional
        Label of what the others are compared with; None draws no comparison.

    Returns
    -------
    matplotlib.figure.Figure
        Milliseconds a frame over the number of trees, both axes logarithmic: filled markers for
        the worst case (`treelod.walks.worst_case_millis`), empty ones for the mean. Beside it how
        often the worst case of each technique fits into the baseline's, with a line at the 20
        which [1]_ reports for slicings over the mesh.

    Raises
    ------
    ValueError
        If a column is missing, if the table is empty, mixes settings, or has no worst case, or if
        it has no row of the baseline for each number of trees.

    References
    ----------
    .. [1] A. Jakulin. Interactive Vegetation Rendering with Slicing and Blending. Eurographics 2000
       Short Presentations.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=20)
    >>> subjects = {"full_mesh": tl.FullMesh.build(plant), "half": tl.SimplifiedMesh.build(plant)}
    >>> walk = tl.walks.walk(plant, subjects, path="through", frame_count=200, tree_counts=(1, 2),
    ...     size=(16, 12), samples=1)
    >>> len(tl.plots.worst_case(walk.table).axes)
    2
    """
    check_columns(table, "label", "tree_count", "frame_millis_mean", "frame_millis_worst")
    one_setting(table, timed=True)
    if table["frame_millis_worst"].isna().any():
        msg = "table has rows without a worst case: a lap needs at least 200 drawn frames"
        raise ValueError(msg)
    counts = np.sort(table["tree_count"].unique())
    slowest = table[table["label"] == baseline].set_index("tree_count")["frame_millis_worst"]
    if baseline is not None and not set(counts) <= set(slowest.index):
        msg = f"baseline {baseline!r} has no row for each number of trees"
        raise ValueError(msg)
    known = looks(table)
    with mpl.rc_context(STYLE):
        figure, (millis, *ratios) = panels(1 if baseline is None else 2, widest=3.6)
        for label, look in known.items():
            rows = table[table["label"] == label].sort_values("tree_count")
            shape: Any = {"color": look.shade, "marker": look.marker, "clip_on": False}
            millis.plot(rows["tree_count"], rows["frame_millis_worst"], **shape)
            millis.plot(
                rows["tree_count"],
                rows["frame_millis_mean"],
                **shape,
                linestyle=":",
                markerfacecolor="white",
            )
            if label != baseline:
                for axes in ratios:
                    over = slowest[rows["tree_count"]].to_numpy() / rows["frame_millis_worst"]
                    axes.plot(rows["tree_count"], over, **shape)
        _over_trees(millis, counts, "milliseconds a frame: worst (filled), mean (empty)")
        for axes in ratios:
            axes.axhline(JAKULIN_SPEEDUP, **FRONT)
            axes.annotate(
                "Jakulin 2000: slicings",
                (0.02, JAKULIN_SPEEDUP),
                xycoords=("axes fraction", "data"),
                xytext=(0.0, -3.0),
                textcoords="offset points",
                va="top",
                color="#555555",
                fontsize=LABEL_SIZE,
            )
            _over_trees(axes, counts, f"times quicker than {baseline}, worst case")
        legend(figure, legend_entries(table))
    return figure


def _over_trees(axes: Axes, counts: NDArray[np.int64], title: str) -> None:
    """Finish a panel over the number of trees."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    plain_log_ticks(axes, which="y")
    plain_log_ticks(axes, counts if len(counts) <= 8 else None)
    axes.set_xlabel("trees")
    axes.set_title(title)
