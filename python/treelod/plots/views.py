"""How errors change with where the camera stands: around the plant, and away from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from treelod.plots.settings import (
    check_columns,
    legend_entries,
    looks,
    metric_of,
    one_setting,
    panel_values,
)
from treelod.plots.style import (
    DASHES,
    DODGE,
    STYLE,
    capped,
    ceiling_of,
    legend,
    panels,
    plain_log_ticks,
    say_left_out,
    share_y,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from treelod.plots.settings import Look
    from treelod.plots.style import MetricName

__all__ = ["coverage", "error_by_azimuth", "error_by_distance"]

_MAX_DASHED = 6
"""Labels up to which each has a line for every elevation."""


def error_by_azimuth(table: pd.DataFrame, metric: MetricName = "flip") -> Figure:
    """
    Plot how an error changes as the camera goes around the plant, one panel a distance.

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
        the figure says. A line a label and elevation; the elevations differ in dashes. Of more
        than 6 labels it is the mean over elevations. A full circle is closed, an arc is not.

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
    >>> cameras = tl.orbit(plant, count=4, size=(64, 64))
    >>> table = compare_techniques(plant, {}, cameras, reference_samples=16, repeats=1).table()
    >>> tl.plots.error_by_azimuth(table).axes[0].get_xlabel()
    'azimuth (degrees)'
    """
    check_columns(table, "label", "distance", "azimuth_deg", "elevation_deg")
    one_setting(table)
    about = metric_of(table, metric)
    known = looks(table)
    distances = panel_values(table["distance"])
    elevations = sorted(table["elevation_deg"].unique())
    if len(known) > _MAX_DASHED:
        elevations = [None]
    ceiling = ceiling_of(table[metric])
    with mpl.rc_context(STYLE):
        figure, row = panels(len(distances))
        for axes, distance in zip(row, distances, strict=True):
            here = table[table["distance"] == distance]
            for label, look in known.items():
                for order, elevation in enumerate(elevations):
                    rows = here[here["label"] == label]
                    if elevation is not None:
                        rows = rows[rows["elevation_deg"] == elevation]
                    groups = rows.groupby("azimuth_deg")[metric]
                    means = groups.apply(lambda values: capped(values, ceiling).mean())
                    azimuths = means.index.to_numpy(np.float64)
                    azimuths, values = _closed(azimuths, means.to_numpy(np.float64))
                    axes.plot(
                        azimuths,
                        values,
                        color=look.shade,
                        marker=look.marker,
                        markersize=4,
                        linestyle=DASHES[order % len(DASHES)],
                        linewidth=1.1,
                        clip_on=False,
                    )
            _azimuth_axis(axes)
            axes.set_title(f"distance {distance:.4g} radii")
        say_left_out(row[-1], len(distances), table["distance"].nunique(), "distances")
        share_y(row, metric, about.label, ceiling, table[metric])
        entries = legend_entries(table)
        if len(elevations) > 1:
            entries += [
                (
                    f"elevation {elevation:g}°",
                    Line2D([], [], color="#777777", linestyle=DASHES[order % len(DASHES)]),
                )
                for order, elevation in enumerate(elevations)
            ]
        legend(figure, entries)
    return figure


def error_by_distance(
    table: pd.DataFrame, metrics: Sequence[MetricName] = ("flip", "psnr")
) -> Figure:
    """
    Plot how errors change with distance, one panel an error.

    Parameters
    ----------
    table : pandas.DataFrame
        As from ``Comparison.table()`` or a sweep.
    metrics : sequence of str, default ("flip", "psnr")
        The errors, each one of `METRICS`.

    Returns
    -------
    matplotlib.figure.Figure
        A line a label: the mean over the views of each distance, with bars from the best to the
        worst view. Labels are a little apart to the side, or they would hide each other. Infinite
        PSNR is drawn on a line of its own, marked as such.

    Raises
    ------
    ValueError
        If a metric is unknown or was not measured, there is none, a column is missing, the table
        is empty, or it mixes plants or settings.

    Examples
    --------
    >>> import treelod as tl
    >>> from treelod.comparison import compare_techniques
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> cameras = [tl.orbit(plant, 1, 0.0, distance, (64, 64))[0] for distance in (2.5, 10)]
    >>> table = compare_techniques(plant, {}, cameras, reference_samples=16, repeats=1).table()
    >>> len(tl.plots.error_by_distance(table, ["flip", "rmse", "ssim"]).axes)
    3
    """
    if not len(metrics):
        msg = "metrics must name at least one error"
        raise ValueError(msg)
    check_columns(table, "label", "distance")
    one_setting(table)
    known = looks(table)
    with mpl.rc_context(STYLE):
        figure, row = panels(len(metrics), widest=3.6)
        for axes, metric in zip(row, metrics, strict=True):
            about = metric_of(table, metric)
            ceiling = ceiling_of(table[metric])
            _by_distance(axes, table, metric, known)
            share_y([axes], metric, about.label, ceiling, table[metric])
        legend(figure, legend_entries(table))
    return figure


def coverage(table: pd.DataFrame) -> Figure:
    """
    Plot where techniques are too dense or too thin: by distance, and around the plant.

    Parameters
    ----------
    table : pandas.DataFrame
        As from ``Comparison.table()`` or a sweep.

    Returns
    -------
    matplotlib.figure.Figure
        A line a label: mean alpha less the reference's, over the plant's pixels. On the left the
        mean over the views of each distance, with bars from the least to the largest; on the right
        the mean over distances and elevations, with a band from the least to the largest where
        there are up to 4 labels.

    Raises
    ------
    ValueError
        If a column is missing, if coverage was not measured, if the table is empty, or if it
        mixes plants or settings.

    Examples
    --------
    >>> import treelod as tl
    >>> from treelod.comparison import compare_techniques
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> cameras = tl.orbit(plant, count=4, size=(64, 64))
    >>> table = compare_techniques(plant, {}, cameras, reference_samples=16, repeats=1).table()
    >>> [axes.get_xlabel() for axes in tl.plots.coverage(table).axes]
    ["distance (radii of the plant's sphere)", 'azimuth (degrees)']
    """
    name = "coverage_bias"
    check_columns(table, "label", "distance", "azimuth_deg", name)
    one_setting(table)
    about = metric_of(table, name)
    known = looks(table)
    with mpl.rc_context(STYLE):
        figure, (by_distance, by_azimuth) = panels(2, widest=3.6)
        _by_distance(by_distance, table, name, known)
        by_distance.set_title("mean over the views of a distance")
        for label, look in known.items():
            groups = table[table["label"] == label].groupby("azimuth_deg")[name]
            middle = groups.mean()
            around = middle.index.to_numpy(np.float64)
            if len(known) <= 4:
                azimuths, low = _closed(around, groups.min().to_numpy(np.float64))
                _, high = _closed(around, groups.max().to_numpy(np.float64))
                by_azimuth.fill_between(
                    azimuths, low, high, color=look.shade, alpha=0.15, linewidth=0
                )
            azimuths, values = _closed(around, middle.to_numpy(np.float64))
            by_azimuth.plot(
                azimuths, values, color=look.shade, marker=look.marker, markersize=4, linewidth=1.1
            )
        _azimuth_axis(by_azimuth)
        by_azimuth.set_title("mean over distances and elevations")
        share_y([by_distance, by_azimuth], name, about.label, None, table[name])
        for text, height, side in (("too dense", 0.98, "top"), ("too thin", 0.02, "bottom")):
            by_distance.annotate(
                text,
                (0.99, height),
                xycoords="axes fraction",
                ha="right",
                va=side,
                fontsize=8,
                color="#555555",
            )
        legend(figure, legend_entries(table))
    return figure


def _by_distance(axes: Axes, table: pd.DataFrame, metric: str, known: dict[str, Look]) -> None:
    """Draw a line a label: means over the views of a distance, with bars to the least and most."""
    ceiling = ceiling_of(table[metric])
    for position, (label, look) in enumerate(known.items()):
        rows = table[table["label"] == label]
        distances = np.sort(rows["distance"].unique())
        groups = [capped(rows[rows["distance"] == d][metric], ceiling) for d in distances]
        low, middle, high = (
            np.array([reduce(group) for group in groups]) for reduce in (np.min, np.mean, np.max)
        )
        # side by side, or bars of like techniques hide each other; many are nearer together
        step = DODGE * min(1.0, 8.0 / len(known))
        shift = 1.0 + step * (position - (len(known) - 1) / 2.0)
        axes.errorbar(
            distances * shift,
            middle,
            yerr=[middle - low, high - middle],
            color=look.shade,
            marker=look.marker,
            elinewidth=0.8,
            capsize=2,
            clip_on=False,
        )
    axes.set_xscale("log")
    distances = np.sort(table["distance"].unique())
    plain_log_ticks(axes, distances if len(distances) <= 6 else None)
    axes.set_xlabel("distance (radii of the plant's sphere)")


def _closed(
    azimuths: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Repeat what is at 0 at 360 degrees, unless that would bridge more than any other step."""
    # of an arc the gap is where nobody looked; azimuths are worked out of positions
    if (
        len(azimuths) > 2
        and azimuths[0] == 0.0
        and 360.0 - azimuths[-1] <= np.diff(azimuths).max() * (1.0 + 1e-9)
    ):
        return np.append(azimuths, 360.0), np.append(values, values[0])
    return azimuths, values


def _azimuth_axis(axes: Axes) -> None:
    axes.set_xlim(-12, 372)
    axes.xaxis.set_major_locator(FixedLocator([0, 90, 180, 270, 360]))
    axes.set_xlabel("azimuth (degrees)")
