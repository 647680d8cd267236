"""What growing groves cost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np

from treelod.plots.settings import check_columns, legend_entries, looks, one_setting
from treelod.plots.style import DODGE, STYLE, legend, panels, plain_log_ticks

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["walk_costs"]


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
        for axes, title in ((primitives, "primitives a frame"), (millis, "milliseconds a frame")):
            axes.set_xscale("log")
            axes.set_yscale("log")
            plain_log_ticks(axes, which="y")
            plain_log_ticks(axes, counts if len(counts) <= 8 else None)
            axes.set_xlabel("trees")
            axes.set_title(title)
        legend(figure, legend_entries(table))
    return figure
