"""
What a comparison looks like on paper: speed against error, error by azimuth, error by distance.

Each function takes a table as `Comparison.table` gives it and returns a matplotlib figure, without
pyplot and its global state, so it works in threads, servers and notebooks alike. Techniques keep
one colour and marker through all plots of a table; both are told apart in print and by the
colour-blind.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "METRICS",
    "Metric",
    "encode",
    "error_by_azimuth",
    "error_by_distance",
    "pareto_front",
    "speed_against_error",
    "walk_costs",
]

# Okabe and Ito's palette; black is the full mesh, yellow is left out: it is lost on white paper
_COLORS = ("#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "h", "*")
_DASHES: tuple[Any, ...] = ("-", (0, (4, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)))

# typed loosely: matplotlib's stub wants the keys as a literal type
_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 9,
    "figure.facecolor": "white",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "lines.markersize": 5.5,
    # the same picture gives the same bytes
    "svg.hashsalt": "treelod",
    # labels are text: a dollar sign in one starts no formula
    "text.parse_math": False,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
}

_MAX_PANELS = 4
"""Distances shown side by side; of more, the nearest, the farthest and those evenly between."""

_PANEL_INCHES = (3.1, 2.7)

_DODGE = 0.035
"""How far techniques stand apart in a plot by distance, as a share of the distance."""


@dataclass(frozen=True)
class Metric:
    """
    How an error is named on an axis.

    Attributes
    ----------
    label : str
        Axis label with unit and background.
    lower_is_better : bool
        Which way is better.
    """

    label: str
    lower_is_better: bool


METRICS = {
    "flip": Metric("FLIP error, worse background", lower_is_better=True),
    "rmse": Metric("RMSE of sRGB values, worse background", lower_is_better=True),
    "psnr": Metric("PSNR (dB), worse background", lower_is_better=False),
    "ssim": Metric("SSIM, worse background", lower_is_better=False),
    "max_error": Metric("largest difference of sRGB values", lower_is_better=True),
    "coverage_error": Metric("mean |coverage difference|", lower_is_better=True),
}
"""Columns of a table that can be plotted."""

MetricName = Literal["flip", "rmse", "psnr", "ssim", "max_error", "coverage_error"]


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
        As from ``Comparison.table()``.
    metric : str, default "flip"
        The error, one of `METRICS`.

    Returns
    -------
    matplotlib.figure.Figure
        A point a technique: median frame time over the views of that distance against the mean
        error; bars reach from the best to the worst view. The line is the Pareto front: nothing
        on it is beaten in both.

    Raises
    ------
    ValueError
        If `metric` is unknown or the table is empty.
    """
    looks, about = _start(table, metric)
    distances = _panel_values(table["distance"])
    with mpl.rc_context(_STYLE):
        figure, panels = _panels(len(distances))
        for axes, distance in zip(panels, distances, strict=True):
            here = table[table["distance"] == distance]
            costs, middles = [], []
            ceiling = _ceiling(table[metric])
            for label in looks:
                rows = here[here["label"] == label]
                values = _capped(rows[metric], ceiling)
                cost, middle = float(rows["frame_millis"].median()), float(values.mean())
                costs.append(cost)
                middles.append(middle)
                axes.errorbar(
                    [cost],
                    [middle],
                    yerr=[[middle - values.min()], [values.max() - middle]],
                    xerr=[
                        [max(cost - float(rows["frame_millis"].min()), 0.0)],
                        [max(float(rows["frame_millis"].max()) - cost, 0.0)],
                    ],
                    fmt=looks[label].marker,
                    color=looks[label].color,
                    elinewidth=0.8,
                    capsize=2,
                    zorder=3,
                    # a marker at 0 is drawn whole, over the axis
                    clip_on=False,
                )
            sign = 1.0 if about.lower_is_better else -1.0
            front = pareto_front(costs, sign * np.asarray(middles))
            axes.plot(
                np.asarray(costs)[front],
                np.asarray(middles)[front],
                color="#999999",
                linewidth=1.2,
                linestyle=(0, (3, 2)),
                # between two techniques there is nothing to have: a staircase, not a slope
                drawstyle="steps-post",
                zorder=2,
            )
            axes.set_xscale("log")
            _plain_log_ticks(axes)
            axes.set_xlabel("frame time (ms), median")
            axes.set_title(_distance_title(distance))
        _share_y(panels, metric, about.label, _ceiling(table[metric]), table[metric])
        _legend(
            figure,
            [(label, look.line(linestyle="none")) for label, look in looks.items()]
            + [("Pareto front", Line2D([], [], color="#999999", linestyle=(0, (3, 2))))],
        )
    return figure


def error_by_azimuth(table: pd.DataFrame, metric: MetricName = "flip") -> Figure:
    """
    Plot how an error changes as the camera goes around the plant, one panel a distance.

    Parameters
    ----------
    table : pandas.DataFrame
        As from ``Comparison.table()``.
    metric : str, default "flip"
        The error, one of `METRICS`.

    Returns
    -------
    matplotlib.figure.Figure
        A line a technique and elevation; the elevations differ in dashes. A full circle is closed.

    Raises
    ------
    ValueError
        If `metric` is unknown or the table is empty.
    """
    looks, about = _start(table, metric)
    distances = _panel_values(table["distance"])
    elevations = sorted(table["elevation_deg"].unique())
    ceiling = _ceiling(table[metric])
    with mpl.rc_context(_STYLE):
        figure, panels = _panels(len(distances))
        for axes, distance in zip(panels, distances, strict=True):
            for label, look in looks.items():
                for order, elevation in enumerate(elevations):
                    rows = table[
                        (table["distance"] == distance)
                        & (table["label"] == label)
                        & (table["elevation_deg"] == elevation)
                    ].sort_values("azimuth_deg")
                    azimuths = rows["azimuth_deg"].to_numpy(np.float64)
                    values = _capped(rows[metric], ceiling)
                    if len(azimuths) > 2 and azimuths[0] == 0.0:
                        azimuths, values = np.append(azimuths, 360.0), np.append(values, values[0])
                    axes.plot(
                        azimuths,
                        values,
                        color=look.color,
                        marker=look.marker,
                        markersize=4,
                        linestyle=_DASHES[order % len(_DASHES)],
                        linewidth=1.1,
                        clip_on=False,
                    )
            axes.set_xlim(-12, 372)
            axes.xaxis.set_major_locator(FixedLocator([0, 90, 180, 270, 360]))
            axes.set_xlabel("azimuth (degrees)")
            axes.set_title(_distance_title(distance))
        _share_y(panels, metric, about.label, ceiling, table[metric])
        entries = [(label, look.line(linestyle="-")) for label, look in looks.items()]
        if len(elevations) > 1:
            entries += [
                (
                    f"elevation {elevation:g}°",
                    Line2D([], [], color="#777777", linestyle=_DASHES[order % len(_DASHES)]),
                )
                for order, elevation in enumerate(elevations)
            ]
        _legend(figure, entries)
    return figure


def error_by_distance(
    table: pd.DataFrame, metrics: Sequence[MetricName] = ("flip", "psnr")
) -> Figure:
    """
    Plot how errors change with distance, one panel an error.

    Parameters
    ----------
    table : pandas.DataFrame
        As from ``Comparison.table()``.
    metrics : sequence of str, default ("flip", "psnr")
        The errors, each one of `METRICS`.

    Returns
    -------
    matplotlib.figure.Figure
        A line a technique: the mean over the views of each distance, with bars from the best to
        the worst view. Techniques are a little apart to the side, or they would hide each other.
        Infinite PSNR is drawn on a line of its own, marked as such.

    Raises
    ------
    ValueError
        If a metric is unknown, there is none, or the table is empty.
    """
    if not metrics:
        msg = "metrics must name at least one error"
        raise ValueError(msg)
    looks: dict[str, _Look] = {}
    with mpl.rc_context(_STYLE):
        figure, panels = _panels(len(metrics), widest=3.6)
        for axes, metric in zip(panels, metrics, strict=True):
            looks, about = _start(table, metric)
            ceiling = _ceiling(table[metric])
            for position, (label, look) in enumerate(looks.items()):
                rows = table[table["label"] == label]
                distances = np.sort(rows["distance"].unique())
                groups = [_capped(rows[rows["distance"] == d][metric], ceiling) for d in distances]
                low, middle, high = (
                    np.array([reduce(group) for group in groups])
                    for reduce in (np.min, np.mean, np.max)
                )
                # side by side, or bars of like techniques hide each other
                shift = 1.0 + _DODGE * (position - (len(looks) - 1) / 2.0)
                axes.errorbar(
                    distances * shift,
                    middle,
                    yerr=[middle - low, high - middle],
                    color=look.color,
                    marker=look.marker,
                    elinewidth=0.8,
                    capsize=2,
                    clip_on=False,
                )
            axes.set_xscale("log")
            distances = np.sort(table["distance"].unique())
            _plain_log_ticks(axes, distances if len(distances) <= 6 else None)
            axes.set_xlabel("distance (radii of the plant's sphere)")
            _share_y([axes], metric, about.label, ceiling, table[metric])
        _legend(figure, [(label, look.line(linestyle="-")) for label, look in looks.items()])
    return figure


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
        If the table is empty.
    """
    looks = _looks(table)
    counts = np.sort(table["tree_count"].unique())
    with mpl.rc_context(_STYLE):
        figure, (primitives, millis) = _panels(2, widest=3.6)
        for position, (label, look) in enumerate(looks.items()):
            rows = table[table["label"] == label].sort_values("tree_count")
            shift = 1.0 + _DODGE * (position - (len(looks) - 1) / 2.0)
            shape: Any = {"color": look.color, "marker": look.marker, "clip_on": False}
            primitives.plot(rows["tree_count"] * shift, rows["primitives"], **shape)
            middle = rows["frame_millis"]
            reach = [middle - rows["frame_millis_low"], rows["frame_millis_high"] - middle]
            millis.errorbar(
                rows["tree_count"] * shift, middle, yerr=reach, elinewidth=0.8, capsize=2, **shape
            )
        for axes, title in ((primitives, "primitives a frame"), (millis, "milliseconds a frame")):
            axes.set_xscale("log")
            axes.set_yscale("log")
            _plain_log_ticks(axes, which="y")
            _plain_log_ticks(axes, counts if len(counts) <= 8 else None)
            axes.set_xlabel("trees")
            axes.set_title(title)
        _legend(figure, [(label, look.line(linestyle="-")) for label, look in looks.items()])
    return figure


def encode(figure: Figure, kind: Literal["svg", "png"] = "svg", *, dpi: float = 200.0) -> bytes:
    """
    Return a figure as the bytes of a picture file; the same figure gives the same bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        From one of this module's functions.
    kind : {"svg", "png"}
        The format. SVG holds its letters as shapes and needs no font.
    dpi : float, default 200
        Pixels an inch, for PNG.

    Returns
    -------
    bytes
        A complete file.

    Raises
    ------
    ValueError
        If `kind` is something else.
    """
    if kind not in ("svg", "png"):
        msg = f"kind must be 'svg' or 'png', got {kind!r}"
        raise ValueError(msg)
    file = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    with mpl.rc_context(_STYLE):
        figure.savefig(file, format=kind, dpi=dpi, bbox_inches="tight", metadata=metadata)
    return file.getvalue()


@dataclass(frozen=True)
class _Look:
    color: str
    marker: str

    def line(self, linestyle: Literal["-", "none"]) -> Line2D:
        return Line2D([], [], color=self.color, marker=self.marker, linestyle=linestyle)


def _start(table: pd.DataFrame, metric: str) -> tuple[dict[str, _Look], Metric]:
    if metric not in METRICS:
        msg = f"metric must be one of {', '.join(METRICS)}, got {metric!r}"
        raise ValueError(msg)
    return _looks(table), METRICS[metric]


def _looks(table: pd.DataFrame) -> dict[str, _Look]:
    if not len(table):
        msg = "table is empty: there is nothing to plot"
        raise ValueError(msg)
    return {
        str(label): _Look(_COLORS[index % len(_COLORS)], _MARKERS[index % len(_MARKERS)])
        for index, label in enumerate(table["label"].unique())
    }


def _panels(count: int, widest: float = _PANEL_INCHES[0]) -> tuple[Figure, list[Axes]]:
    width = widest * count if count > 1 else 1.5 * widest
    figure = Figure(figsize=(width, _PANEL_INCHES[1]), layout="constrained")
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def _panel_values(column: pd.Series[Any]) -> list[float]:
    values = sorted(float(value) for value in column.unique())
    if len(values) <= _MAX_PANELS:
        return values
    picks = np.linspace(0, len(values) - 1, _MAX_PANELS).round().astype(int)
    return [values[pick] for pick in picks]


def _distance_title(distance: float) -> str:
    return f"distance {distance:.4g} radii"


def _ceiling(values: pd.Series[Any]) -> float | None:
    """Where infinite values are drawn: clear above the finite ones. None if there is none."""
    numbers = values.to_numpy(np.float64, na_value=np.nan)
    if not np.isinf(numbers).any():
        return None
    finite = numbers[np.isfinite(numbers)]
    if not len(finite):
        return 100.0
    return float(finite.max() + max(0.2 * (finite.max() - finite.min()), 5.0))


def _capped(values: pd.Series[Any], ceiling: float | None) -> NDArray[np.float64]:
    numbers = values.to_numpy(np.float64, na_value=np.nan)
    return numbers if ceiling is None else np.where(np.isinf(numbers), ceiling, numbers)


def _share_y(
    panels: Sequence[Axes],
    metric: str,
    label: str,
    ceiling: float | None,
    values: pd.Series[Any],
) -> None:
    numbers = _capped(values, ceiling)
    finite = numbers[np.isfinite(numbers)]
    low, high = (finite.min(), finite.max()) if len(finite) else (0.0, 1.0)
    if metric not in ("psnr", "ssim"):
        low = 0.0
    room = max(high - low, 1e-6) * 0.07
    for axes in panels:
        axes.set_ylim(
            low - (0.0 if low == 0.0 else room), high + room * (1 if ceiling is None else 2.5)
        )
        if ceiling is not None:
            # no number stands beyond the finite ones, where the scale is broken
            top = values.replace(math.inf, np.nan).max()
            axes.set_yticks([tick for tick in axes.get_yticks() if low - room <= tick <= top])
            axes.axhline(ceiling, color="#999999", linewidth=0.7, linestyle=(0, (1, 2)), zorder=1)
            axes.annotate(
                "∞ (identical)",
                (0.0, ceiling),
                xycoords=("axes fraction", "data"),
                xytext=(3, 3),
                textcoords="offset points",
                fontsize=8,
                color="#555555",
            )
    panels[0].set_ylabel(label)
    for axes in panels[1:]:
        axes.tick_params(labelleft=False)


def _plain_log_ticks(
    axes: Axes, ticks: ArrayLike | None = None, *, which: Literal["x", "y"] = "x"
) -> None:
    """Label a logarithmic axis with plain numbers: 2, 5, 10, not powers of ten."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    if ticks is None:
        low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
        powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
        if high / low < 3.0:
            values = [float(tick) for tick in MaxNLocator(4).tick_values(low, high)]
        elif high / low > 300.0:
            values = [10.0**p for p in powers]
        else:
            mantissas = (1.0, 2.0, 5.0) if high / low > 8.0 else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
            values = [m * 10.0**p for p in powers for m in mantissas]
    else:
        values = [float(tick) for tick in np.asarray(ticks)]

    def plain(value: float, _position: int) -> str:
        return f"{value:,.0f}" if which == "y" and value >= 1e4 else f"{value:.4g}"

    axis.set_major_locator(FixedLocator(values))
    axis.set_major_formatter(FuncFormatter(plain))
    axis.set_minor_locator(FixedLocator([]))
    axis.set_minor_formatter(NullFormatter())


def _legend(figure: Figure, entries: Sequence[tuple[str, Line2D]]) -> None:
    # labels go in explicitly: one that begins with an underscore would be left out
    legend = figure.legend(
        handles=[line for _, line in entries],
        labels=["x"] * len(entries),
        loc="outside lower center",
        ncols=min(len(entries), 4),
    )
    for text, (label, _) in zip(legend.get_texts(), entries, strict=True):
        text.set_text(label)
