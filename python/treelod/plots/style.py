"""
One look for all plots: fonts, colours, panels, legends, ticks, and how figures become files.

Everything is drawn without pyplot and its global state. Colours are told apart by the colour-blind,
and markers in print without colours.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullFormatter

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "COLORS",
    "COSTS",
    "DASHES",
    "DODGE",
    "FRONT",
    "MARKERS",
    "METRICS",
    "STYLE",
    "Metric",
    "MetricName",
    "ShownFigure",
    "capped",
    "ceiling_of",
    "encode",
    "floor_of",
    "legend",
    "panels",
    "place_labels",
    "plain_log_ticks",
    "say_left_out",
    "share_y",
    "short_bytes",
]

COLORS = (
    # Okabe and Ito's palette; black is the full mesh, yellow is left out: it is lost on white paper
    *("#000000", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"),
    # of Paul Tol's muted palette what is not near one of those
    *("#882255", "#999933", "#332288", "#7F7F7F"),
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "h", "*")
DASHES: tuple[Any, ...] = ("-", (0, (4, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)))

# typed loosely: matplotlib's stub wants the keys as a literal type
STYLE: Any = {
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

PANEL_INCHES = (3.1, 2.6)
LEGEND_INCHES = 0.19
"""Height of a legend's line."""

DODGE = 0.035
"""How far techniques stand apart in a plot by distance, as a share of the distance."""

FRONT: Any = {"color": "#999999", "linestyle": (0, (3, 2))}
"""How a Pareto front is drawn."""

_NOTEBOOK_DPI = 100.0
"""Pixels an inch in a notebook, where one is a pixel of the screen."""

LABEL_SIZE = 7.5
"""Of labels beside points, in points."""


@dataclass(frozen=True)
class Metric:
    """
    How a column is named on an axis.

    Attributes
    ----------
    label : str
        Axis label with unit and background.
    lower_is_better : bool
        Which way is better; of a signed one, which way its magnitude is.
    signed : bool
        Whether values stand on both sides of 0, which is best.
    log : bool
        Whether values of different techniques are factors apart.
    """

    label: str
    lower_is_better: bool
    signed: bool = False
    log: bool = False

    def badness(self, values: ArrayLike) -> NDArray[np.float64]:
        """
        Turn values so that less is better.

        Parameters
        ----------
        values : array_like
            Of this column.

        Returns
        -------
        ndarray of float64
            Of the same shape.

        Examples
        --------
        >>> METRICS["psnr"].badness([30.0]).tolist(), METRICS["coverage_bias"].badness(-0.5).item()
        ([-30.0], 0.5)
        """
        numbers = np.asarray(values, dtype=np.float64)
        if self.signed:
            return np.abs(numbers)
        return numbers if self.lower_is_better else -numbers


METRICS = {
    "flip": Metric("FLIP error, worse background", lower_is_better=True),
    "rmse": Metric("RMSE of sRGB values, worse background", lower_is_better=True),
    "psnr": Metric("PSNR (dB), worse background", lower_is_better=False),
    "ssim": Metric("SSIM, worse background", lower_is_better=False),
    "max_error": Metric("largest difference of sRGB values", lower_is_better=True),
    "coverage_error": Metric("mean |coverage difference|", lower_is_better=True),
    "coverage_bias": Metric("mean coverage difference", lower_is_better=True, signed=True),
}
"""Errors of a table that can be plotted."""

COSTS = {
    "frame_millis": Metric("frame time (ms), median", lower_is_better=True, log=True),
    "speedup": Metric("speed-up over the full mesh", lower_is_better=False, log=True),
    "build_secs": Metric("build time (s)", lower_is_better=True, log=True),
    "total_bytes": Metric("geometry and textures", lower_is_better=True, log=True),
    "geometry_bytes": Metric("geometry", lower_is_better=True, log=True),
    "texture_bytes": Metric("textures", lower_is_better=True, log=True),
    "fragments": Metric("fragments a frame", lower_is_better=True, log=True),
    "overdraw": Metric("fragments a covered pixel", lower_is_better=True),
    "drawn_triangles": Metric("triangles a frame", lower_is_better=True, log=True),
    "drawn_cards": Metric("cards a frame", lower_is_better=True, log=True),
    "drawn_lines": Metric("lines a frame", lower_is_better=True, log=True),
    "drawn_points": Metric("points a frame", lower_is_better=True, log=True),
    "drawn_vertices": Metric("vertices a frame", lower_is_better=True, log=True),
}
"""Costs of a table that can be plotted."""

MetricName = Literal["flip", "rmse", "psnr", "ssim", "max_error", "coverage_error", "coverage_bias"]


class ShownFigure(Figure):
    """
    A figure that shows itself as the last value of a notebook's cell, with no pyplot to help.

    Where pyplot's inline pictures are on, they go first, and it is shown once all the same.
    """

    def _repr_png_(self) -> bytes:
        return encode(self, "png", dpi=_NOTEBOOK_DPI)


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

    Examples
    --------
    >>> encode(Figure(figsize=(1, 1)), "png")[1:4]
    b'PNG'
    """
    if kind not in ("svg", "png"):
        msg = f"kind must be 'svg' or 'png', got {kind!r}"
        raise ValueError(msg)
    file = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    with mpl.rc_context(STYLE):
        figure.savefig(file, format=kind, dpi=dpi, bbox_inches="tight", metadata=metadata)
    return file.getvalue()


def panels(
    count: int, widest: float = PANEL_INCHES[0], *, rows: int = 1
) -> tuple[Figure, list[Axes]]:
    """Make a figure of `count` panels in rows; a single one is half as wide again."""
    columns = -(-count // rows)
    width = widest * columns if count > 1 else 1.5 * widest
    figure = ShownFigure(figsize=(width, PANEL_INCHES[1] * rows), layout="constrained")
    return figure, list(figure.subplots(rows, columns, squeeze=False).flat)[:count]


def say_left_out(axes: Axes, shown: int, count: int, what: str) -> None:
    """Write above the last panel that not all have one; nothing where they do."""
    if shown < count:
        axes.set_title(f"{shown} of {count} {what}", loc="right", fontsize=7.5, color="#555555")


def ceiling_of(values: pd.Series[Any]) -> float | None:
    """Where infinite values are drawn: clear above the finite ones. None if there is none."""
    numbers = values.to_numpy(np.float64, na_value=np.nan)
    if not np.isinf(numbers).any():
        return None
    finite = numbers[np.isfinite(numbers)]
    if not len(finite):
        return 100.0
    return float(finite.max() + max(0.2 * (finite.max() - finite.min()), 5.0))


def capped(values: pd.Series[Any], ceiling: float | None) -> NDArray[np.float64]:
    """Values as numbers, with `ceiling` for infinite ones."""
    numbers = values.to_numpy(np.float64, na_value=np.nan)
    return numbers if ceiling is None else np.where(np.isinf(numbers), ceiling, numbers)


def floor_of(name: str, low: float) -> float:
    """Where an axis of errors begins: at 0 unless that says nothing about them."""
    if name in ("psnr", "ssim"):
        return low
    return min(low, 0.0)


def share_y(
    axes_row: Sequence[Axes],
    name: str,
    label: str,
    ceiling: float | None,
    values: pd.Series[Any],
) -> None:
    """Give panels one range of y, and the first its label; infinite values a line of their own."""
    numbers = capped(values, ceiling)
    finite = numbers[np.isfinite(numbers)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    low = floor_of(name, low)
    high = max(high, 0.0) if name == "coverage_bias" else high
    room = max(high - low, 1e-6) * 0.07
    for axes in axes_row:
        axes.set_ylim(
            low - (0.0 if low == 0.0 else room), high + room * (1 if ceiling is None else 2.5)
        )
        if name == "coverage_bias":
            axes.axhline(0.0, color="#444444", linewidth=0.7, zorder=1)
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
    axes_row[0].set_ylabel(label)
    for axes in axes_row[1:]:
        axes.tick_params(labelleft=False)


def short_bytes(count: float) -> str:
    """
    Write a number of bytes for an axis.

    Parameters
    ----------
    count : float
        Bytes, at least 0.

    Returns
    -------
    str
        With a decimal prefix.

    Examples
    --------
    >>> [short_bytes(count) for count in (0, 500, 2e3, 1.5e6, 3e9)]
    ['0 B', '500 B', '2 kB', '1.5 MB', '3 GB']
    """
    for prefix, unit in (("G", 1e9), ("M", 1e6), ("k", 1e3)):
        if count >= unit:
            return f"{count / unit:.4g} {prefix}B"
    return f"{count:.4g} B"


def plain_log_ticks(
    axes: Axes,
    ticks: ArrayLike | None = None,
    *,
    which: Literal["x", "y"] = "x",
    name: str = "",
) -> None:
    """Label a logarithmic axis with plain numbers: 2, 5, 10, not powers of ten; bytes by name."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    if ticks is None:
        low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
        powers = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
        if high / low < 3.0:
            values = [float(tick) for tick in MaxNLocator(4).tick_values(low, high)]
        elif high / low > 300.0:
            step = max(round(math.log10(high / low) / 5.0), 1)
            values = [10.0**p for p in powers if p % step == 0]
        else:
            mantissas = (1.0, 2.0, 5.0) if high / low > 8.0 else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
            values = [m * 10.0**p for p in powers for m in mantissas]
        # text as wide as "500 kB" needs room
        if name.endswith("_bytes") and 8.0 < high / low <= 300.0:
            values = [m * 10.0**p for p in powers for m in (1.0, 3.0)]
    else:
        values = [float(tick) for tick in np.asarray(ticks)]

    def plain(value: float, _position: int) -> str:
        if name.endswith("_bytes"):
            return short_bytes(value)
        return f"{value:,.0f}" if which == "y" and value >= 1e4 else f"{value:.4g}"

    axis.set_major_locator(FixedLocator(values))
    axis.set_major_formatter(FuncFormatter(plain))
    axis.set_minor_locator(FixedLocator([]))
    axis.set_minor_formatter(NullFormatter())


def legend(figure: Figure, entries: Sequence[tuple[str, Any]]) -> None:
    """Put a legend below all panels, in as many columns as there is room for."""
    # labels go in explicitly: one that begins with an underscore would be left out
    longest = max(len(label) for label, _ in entries)
    fitting = int(figure.get_figwidth() * 72.0 / (longest * 5.0 + 44.0))
    columns = max(min(len(entries), fitting, 6), 1)
    # panels keep their height, however many lines the legend has
    figure.set_figheight(figure.get_figheight() + LEGEND_INCHES * -(-len(entries) // columns))
    box = figure.legend(
        handles=[line for _, line in entries],
        labels=["x"] * len(entries),
        loc="outside lower center",
        ncols=columns,
    )
    for text, (label, _) in zip(box.get_texts(), entries, strict=True):
        text.set_text(label)


def place_labels(
    figure: Figure,
    wanted: Sequence[tuple[Axes, float, float, str, str]],
) -> None:
    """
    Write labels beside points so that none lies on another, on a marker, or outside its panel.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        With everything else already in it: places are found for its present layout.
    wanted : sequence of (Axes, float, float, str, str)
        Panel, point in data coordinates, text and colour; the first come first. A label for which
        there is no room is left out.
    """
    canvas = FigureCanvasAgg(figure)
    renderer = canvas.get_renderer()  # type: ignore[no-untyped-call]
    figure.draw_without_rendering()
    scale = figure.dpi / 72.0
    taken: dict[Axes, list[_Box]] = {}
    lines: dict[Axes, list[_Box]] = {}
    for axes in {axes for axes, *_ in wanted}:
        marks = np.concatenate(
            [
                axes.transData.transform(np.column_stack(line.get_data()).astype(float))
                for line in axes.get_lines()
                if line.get_marker() not in ("None", "", None)
            ]
            or [np.empty((0, 2))]
        )
        half = 3.4 * scale
        taken[axes] = [(x - half, y - half, x + half, y + half) for x, y in marks]
        lines[axes] = _along_lines(axes, 4.0 * scale)
    for axes, x, y, text, color in wanted:
        at = axes.transData.transform((x, y))
        # the axes' own box, a little larger: a label may reach over the frame but not into a
        # neighbour's ticks
        frame = axes.get_window_extent(renderer).padded(4.0 * scale)
        # clear of lines where it can be, else of markers and other labels alone
        for place in range(2 * len(_PLACES)):
            dx, dy, horizontal, vertical = _PLACES[place % len(_PLACES)]
            obstacles = taken[axes] + (lines[axes] if place < len(_PLACES) else [])
            note = axes.annotate(
                text,
                (x, y),
                xytext=(dx, dy),
                textcoords="offset points",
                ha=horizontal,
                va=vertical,
                fontsize=LABEL_SIZE,
                color=color,
                zorder=5,
            )
            # layout is settled: a label must not move what it was placed beside
            note.set_in_layout(False)
            box = note.get_window_extent(renderer)
            found = (box.x0, box.y0, box.x1, box.y1)
            inside = (
                frame.x0 <= box.x0
                and box.x1 <= frame.x1
                and frame.y0 <= box.y0
                and box.y1 <= frame.y1
            )
            own = (at[0] - 0.1, at[1] - 0.1, at[0] + 0.1, at[1] + 0.1)
            if inside and not any(_meet(found, other) for other in [*obstacles, own]):
                taken[axes].append(found)
                break
            note.remove()


_Box = tuple[float, float, float, float]

_PLACES: tuple[tuple[float, float, Any, Any], ...] = tuple(
    (distance * dx, distance * dy, horizontal, vertical)
    for distance in (5.0, 10.0, 16.0, 24.0)
    for dx, dy, horizontal, vertical in (
        (0.0, 1.0, "center", "bottom"),
        (0.0, -1.0, "center", "top"),
        (1.2, 0.0, "left", "center"),
        (-1.2, 0.0, "right", "center"),
        (0.8, 0.8, "left", "bottom"),
        (-0.8, 0.8, "right", "bottom"),
        (0.8, -0.8, "left", "top"),
        (-0.8, -0.8, "right", "top"),
    )
)
"""Where a label may stand, the best first: offset in points, and which of its sides is there."""


def _meet(a: _Box, b: _Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _along_lines(axes: Axes, step: float) -> list[_Box]:
    """Small boxes along every line of a panel, `step` pixels apart."""
    boxes: list[_Box] = []
    drawn = [
        line.get_transform().transform_path(line.get_path()).vertices
        for line in axes.get_lines()
        if line.get_linestyle() != "None"
    ]
    for stems in axes.collections:
        if isinstance(stems, LineCollection):
            drawn += [axes.transData.transform(segment) for segment in stems.get_segments()]
    for vertices in drawn:
        points = np.asarray(vertices, dtype=np.float64)
        if len(points) < 2 or not np.isfinite(points).all():
            continue
        for a, b in pairwise(points):
            count = min(int(np.hypot(*(b - a)) / step) + 2, 200)
            for x, y in a + np.linspace(0.0, 1.0, count)[:, np.newaxis] * (b - a):
                boxes.append((x - 1.0, y - 1.0, x + 1.0, y + 1.0))
    return boxes
