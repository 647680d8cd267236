"""Which directions are bad: an error by azimuth and elevation, as a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.ticker import FixedLocator, FuncFormatter

from treelod.plots.settings import check_columns, looks, metric_of, one_setting, panel_values
from treelod.plots.style import STYLE, ShownFigure, capped, ceiling_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from treelod.plots.style import MetricName

__all__ = ["error_heat_map"]

_CELL_INCHES = (0.32, 0.3)
_MAX_NUMBERS = 12
"""Columns up to which every cell says its number."""

_EMPTY = "#f2f2f2"


def error_heat_map(
    table: pd.DataFrame,
    label: str | Sequence[str] | None = None,
    metric: MetricName = "flip",
) -> Figure:
    """
    Plot an error by the direction it is seen from: a map of azimuth and elevation.

    Parameters
    ----------
    table : pandas.DataFrame
        As from ``Comparison.table()`` or a sweep.
    label : str or sequence of str, optional
        Which labels, one row of maps each. Default: all.
    metric : str, default "flip"
        The error, one of `METRICS`.

    Returns
    -------
    matplotlib.figure.Figure
        A column of maps for each distance (of many, four), all with one scale, on which darker is
        better. Directions that the table has no view from are pale and crossed out. Up to 12
        azimuths each cell says its number.

    Raises
    ------
    ValueError
        If there is no such label, metric or column, if the metric was not measured, or if the
        table is empty, or if it mixes plants or settings.

    Examples
    --------
    >>> import treelod as tl
    >>> from treelod.comparison import compare_techniques
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> cameras = [c for up in (0, 25) for c in tl.orbit(plant, 4, up, size=(64, 64))]
    >>> table = compare_techniques(plant, {}, cameras, reference_samples=16, repeats=1).table()
    >>> figure = tl.plots.error_heat_map(table, "full_mesh")
    >>> figure.axes[0].get_ylabel()
    'elevation (degrees)'
    """
    check_columns(table, "label", "distance", "azimuth_deg", "elevation_deg")
    one_setting(table)
    about = metric_of(table, metric)
    labels = _asked(table, label)
    table = table[table["label"].isin(labels)]
    distances = panel_values(table["distance"])
    azimuths = sorted(float(value) for value in table["azimuth_deg"].unique())
    elevations = sorted(float(value) for value in table["elevation_deg"].unique())
    ceiling = ceiling_of(table[metric])
    maps = {
        (name, distance): _cells(table, name, distance, metric, ceiling, azimuths, elevations)
        for name in labels
        for distance in distances
    }
    values = np.concatenate([cells.ravel() for cells in maps.values()])
    values = values[np.isfinite(values)]
    if about.signed:
        reach = max(float(np.abs(values).max()), 1e-6)
        low, high, colors = -reach, reach, "PuOr_r"
    else:
        low, high = (0.0 if about.lower_is_better else float(values.min())), float(values.max())
        high = high if high > low else low + 1e-6
        # dark is good: an error's map turns pale where it is wrong
        colors = "cividis" if about.lower_is_better else "cividis_r"
    with mpl.rc_context(STYLE | {"axes.grid": False}):
        cell_width, cell_height = _CELL_INCHES
        width = max(cell_width * len(azimuths), 1.5)
        height = max(cell_height * len(elevations), 0.55)
        figure = ShownFigure(
            figsize=(
                max(width * len(distances) + 1.7, 4.2),
                max((height + 0.3) * len(labels) + 0.9, 2.0),
            ),
            layout="constrained",
        )
        grid = figure.subplots(len(labels), len(distances), squeeze=False, sharex=True, sharey=True)
        mesh: Any = None
        for row, name in enumerate(labels):
            for column, distance in enumerate(distances):
                axes = grid[row][column]
                cells = maps[name, distance]
                mesh = _draw(axes, cells, low, high, colors, len(azimuths))
                # a long label reaches over the next map, where nothing else stands on its line
                title = name if column == 0 else ""
                if row == 0:
                    title += f"\ndistance {distance:.4g} radii"
                axes.set_title(title)
                _angle_ticks(axes.xaxis, azimuths, most=5)
                _angle_ticks(axes.yaxis, elevations, most=6)
        for axes in grid[-1]:
            axes.set_xlabel("azimuth (degrees)")
        for axes in grid[:, 0]:
            axes.set_ylabel("elevation (degrees)")
        if len(labels) > 1:
            # once for all: beside low maps it would be longer than they are
            for axes in grid[:, 0]:
                axes.set_ylabel("")
            figure.supylabel("elevation (degrees)", fontsize=9)
        count = table["distance"].nunique()
        if len(distances) < count:
            note = f"{len(distances)} of {count} distances"
            figure.supxlabel(note, x=0.99, ha="right", fontsize=7.5, color="#555555")
        bar = figure.colorbar(mesh, ax=grid, shrink=1.0, aspect=max(12, 8 * len(labels)), pad=0.015)
        bar.set_label(
            about.label if ceiling is None else f"{about.label} (∞ shown as {ceiling:.0f})"
        )
        bar.outline.set_linewidth(0.5)
    return figure


def _asked(table: pd.DataFrame, label: str | Sequence[str] | None) -> list[str]:
    known = list(looks(table))
    asked = known if label is None else [label] if isinstance(label, str) else list(label)
    if not asked:
        msg = "label must name at least one label"
        raise ValueError(msg)
    for name in asked:
        if name not in known:
            msg = f"table has no label {name!r}; there are {', '.join(known)}"
            raise ValueError(msg)
    return asked


def _cells(
    table: pd.DataFrame,
    label: str,
    distance: float,
    metric: str,
    ceiling: float | None,
    azimuths: Sequence[float],
    elevations: Sequence[float],
) -> NDArray[np.float64]:
    """Mean of the metric in each direction, NaN where there is no view: (elevations, azimuths)."""
    rows = table[(table["label"] == label) & (table["distance"] == distance)]
    cells = np.full((len(elevations), len(azimuths)), np.nan)
    for (elevation, azimuth), group in rows.groupby(["elevation_deg", "azimuth_deg"]):
        value = capped(group[metric], ceiling).mean()
        cells[elevations.index(elevation), azimuths.index(azimuth)] = value
    return cells


def _draw(
    axes: Axes,
    cells: NDArray[np.float64],
    low: float,
    high: float,
    colors: str,
    column_count: int,
) -> Any:
    axes.set_facecolor(_EMPTY)
    rows, columns = cells.shape
    mesh = axes.pcolormesh(
        np.arange(columns + 1) - 0.5,
        np.arange(rows + 1) - 0.5,
        np.ma.masked_invalid(cells),
        cmap=colors,
        vmin=low,
        vmax=high,
        edgecolors="white",
        linewidth=0.6,
    )
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    for row, column in np.argwhere(np.isnan(cells)):
        axes.plot(
            [column - 0.3, column + 0.3], [row - 0.3, row + 0.3], color="#bbbbbb", linewidth=0.7
        )
    if column_count <= _MAX_NUMBERS:
        digits = _digits(cells)
        for row, column in np.argwhere(~np.isnan(cells)):
            value = cells[row, column]
            red, green, blue, _ = mesh.cmap(mesh.norm(value))
            dark = 0.299 * red + 0.587 * green + 0.114 * blue < 0.5
            axes.text(
                column,
                row,
                _short(value, digits),
                ha="center",
                va="center",
                fontsize=6.3,
                color="white" if dark else "#222222",
            )
    return mesh


def _digits(cells: NDArray[np.float64]) -> int:
    """Decimals with which a map's numbers are told apart: two figures of the largest."""
    largest = float(np.nanmax(np.abs(cells))) if np.isfinite(cells).any() else 1.0
    return 0 if largest >= 10.0 else 1 if largest >= 2.0 else 2 if largest >= 0.1 else 3


def _short(value: float, digits: int) -> str:
    """Write a number without what all of them begin with: .07 for 0.07."""
    text = f"{value:.{digits}f}"
    if float(text) == 0.0:
        return "0"
    return text.replace("0.", ".", 1) if abs(float(text)) < 1.0 else text


def _angle_ticks(axis: Any, angles: Sequence[float], most: int) -> None:
    step = -(-len(angles) // most)
    places = list(range(0, len(angles), step))
    axis.set_major_locator(FixedLocator(places))
    axis.set_major_formatter(FuncFormatter(lambda place, _: f"{angles[round(place)]:g}"))
