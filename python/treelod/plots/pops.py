"""Where a technique switches on the way, and how much of that is seen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import FixedLocator

from treelod.plots.settings import check_columns, looks
from treelod.plots.style import STYLE, legend, panels, place_labels, plain_log_ticks

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["popping"]

_AXES = {
    "path": "way along the path (cameras)",
    "distance": "distance (radii)",
    "azimuth_deg": "azimuth (degrees)",
}

_NAMED = 3
"""Switches of a technique that say what they are: the worst ones."""

_SEEN = 1e-3
"""FLIP from which a switch is worth its name on the plot."""


def popping(
    table: pd.DataFrame,
    against: Literal["path", "distance", "azimuth_deg"] = "path",
) -> Figure:
    """
    Plot how much is seen of each switch on a path.

    Parameters
    ----------
    table : pandas.DataFrame
        As from `treelod.switches`; of several techniques, joined by ``pandas.concat``.
    against : {"path", "distance", "azimuth_deg"}, default "path"
        What the switches stand over; distances on a logarithmic axis.

    Returns
    -------
    matplotlib.figure.Figure
        A stem a switch, as high as the FLIP error between its two sides. The three worst of each
        technique say what changes. Where not all switches were measured the legend says how many
        were, and of how many at least.

    Raises
    ------
    ValueError
        If `against` is unknown, if a column is missing, or if the table is empty: nothing pops.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> lod = tl.Slicings.build(plant, slicing_count=4, slice_count=3, resolution=32)
    >>> way = tl.orbit(plant, count=24, size=(64, 64))[1:6]
    >>> figure = tl.plots.popping(tl.switches(lod, way, samples=4), "azimuth_deg")
    >>> figure.axes[0].get_xlabel()
    'azimuth (degrees)'
    """
    if against not in _AXES:
        msg = f"against must be one of {', '.join(_AXES)}, got {against!r}"
        raise ValueError(msg)
    check_columns(table, "label", "flip", "what", against)
    known = looks(table)
    labels: list[Any] = []
    with mpl.rc_context(STYLE):
        figure, (axes,) = panels(1, widest=4.2)
        for label, look in known.items():
            rows = table[table["label"] == label]
            at, flips = rows[against].to_numpy(np.float64), rows["flip"].to_numpy(np.float64)
            axes.vlines(at, 0.0, flips, color=look.shade, linewidth=1.0, zorder=2)
            axes.plot(
                at,
                flips,
                color=look.shade,
                marker=look.marker,
                linestyle="none",
                markersize=4.5,
                zorder=3,
                clip_on=False,
            )
            worst = rows.sort_values("flip", ascending=False, kind="stable").head(_NAMED)
            labels += [
                (axes, float(row[against]), float(row["flip"]), str(row["what"]), look.color)
                for _, row in worst.iterrows()
                if row["flip"] >= _SEEN
            ]
        axes.set_ylim(0.0, max(float(table["flip"].max()) * 1.25, 1e-4))
        if against == "distance" and table[against].max() > 1.5 * table[against].min():
            axes.set_xscale("log")
            plain_log_ticks(axes)
        axes.margins(x=0.08)
        if against == "azimuth_deg" and np.ptp(table[against]) > 180.0:
            axes.set_xlim(-12, 372)
            axes.xaxis.set_major_locator(FixedLocator([0, 90, 180, 270, 360]))
        axes.set_xlabel(_AXES[against])
        axes.set_ylabel("FLIP between the two sides")
        entries = [
            (label + _share(table[table["label"] == label]), look.line("none"))
            for label, look in known.items()
        ]
        legend(figure, entries)
        place_labels(figure, sorted(labels, key=lambda wanted: -wanted[2]))
    return figure


def _share(rows: pd.DataFrame) -> str:
    """Say how many switches were measured, if that is not all; tables by hand may not tell."""
    if "complete" not in rows.columns or all(rows["complete"].dropna()):
        return ""
    # each step that changes has one, and one was not measured
    least = len(rows) + 1
    if "changed_steps" in rows.columns:
        least = max(least, int(rows["changed_steps"].max()))
    return f" ({len(rows)} of at least {least} measured)"
