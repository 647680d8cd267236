"""How an error, or a cost, answers to one parameter of a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter

from treelod.plots.settings import (
    check_columns,
    families,
    is_log_spaced,
    looks,
    metric_of,
    one_setting,
    panel_values,
    parameter_values,
    shown,
)
from treelod.plots.style import (
    DASHES,
    MARKERS,
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

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["error_against_parameter"]

_TITLES = {
    "distance": "distance {:.4g} radii",
    "elevation_deg": "elevation {:g}°",
    "azimuth_deg": "azimuth {:g}°",
    "plant": "{}",
}

_MANY = {
    "distance": "distances",
    "elevation_deg": "elevations",
    "azimuth_deg": "azimuths",
    "plant": "plants",
}

_MAX_BANDS = 3
"""Lines up to which each has its band: of more, bands hide one another."""

_YARDSTICK = "full_mesh"
"""Its error is that of the timed samples alone: a dotted line across every panel."""


def error_against_parameter(
    table: pd.DataFrame,
    parameter: str,
    metric: str = "flip",
    by: Literal["distance", "elevation_deg", "azimuth_deg", "plant"] | None = "distance",
) -> Figure:
    """
    Plot an error or a cost against a parameter that was swept.

    Parameters
    ----------
    table : pandas.DataFrame
        As from a sweep or ``Comparison.table()``.
    parameter : str
        A technique's parameter, ``"slice_count"`` for example, of at least two values.
    metric : str, default "flip"
        One of `METRICS` or `COSTS`.
    by : {"distance", "elevation_deg", "azimuth_deg", "plant"} or None, default "distance"
        One panel for each of its values (of many, four); None for a single panel.

    Returns
    -------
    matplotlib.figure.Figure
        A line a technique, and one for each combination of its other parameters that vary: the
        mean over the views (for times the median); up to three lines have a band from the least to
        the largest. The axis is logarithmic where the values are spaced so (a 0 stands at its
        end); values that are no numbers stand side by side. The full mesh, which has no such
        parameter, is a dotted line.

    Raises
    ------
    ValueError
        If there is no such parameter, metric or column, if the parameter has one value only, if
        the table is empty, or if it mixes plants (that `by` does not keep apart) or settings.

    Examples
    --------
    >>> import treelod as tl
    >>> from treelod.comparison import compare_techniques
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> cameras = tl.orbit(plant, count=2, size=(64, 64))
    >>> settings = {f"slicings:{n}": {"slice_count": n, "resolution": 32} for n in (1, 3)}
    >>> found = compare_techniques(plant, settings, cameras, reference_samples=16, repeats=1)
    >>> figure = tl.plots.error_against_parameter(found.table(), "slice_count")
    >>> figure.axes[0].get_xlabel()
    'slice_count'
    """
    check_columns(table, "label")
    about = metric_of(table, metric, costs=True)
    if by is not None and by not in _TITLES:
        msg = f"by must be one of {', '.join(_TITLES)} or None, got {by!r}"
        raise ValueError(msg)
    if by is not None:
        check_columns(table, by)
    one_setting(table, timed=metric in ("frame_millis", "speedup"), apart=by)
    values = parameter_values(table, parameter)
    distinct = list(dict.fromkeys(value for value in values if value is not None))
    if len(distinct) < 2:
        msg = (
            f"parameter {parameter!r} has one value, {shown(distinct[0])}: nothing to plot against"
        )
        raise ValueError(msg)
    numeric = all(_is_number(value) for value in distinct)
    distinct = sorted(distinct) if numeric else distinct
    places = {value: float(value) if numeric else float(i) for i, value in enumerate(distinct)}
    above = [places[value] for value in distinct if places[value] != 0.0]
    log = numeric and is_log_spaced(above)
    lines = _lines(
        table,
        {label for label, v in zip(table["label"], values, strict=True) if v is not None},
        parameter,
    )
    drawn = {label for line in lines for label in line.labels} | {_YARDSTICK}
    drawn_values = table[table["label"].isin(drawn)][metric]
    ceiling = ceiling_of(drawn_values)
    middles: list[float] = []
    panel_by = [None] if by is None else panel_values(table[by])
    with mpl.rc_context(STYLE):
        figure, row = panels(len(panel_by))
        for axes, here in zip(row, panel_by, strict=True):
            shown_rows = (
                np.ones(len(table), bool) if here is None else (table[by] == here).to_numpy()
            )
            mesh = table[shown_rows & (table["label"] == _YARDSTICK).to_numpy()]
            if len(mesh):
                level = _middle(metric, capped(mesh[metric], ceiling))
                middles.append(level)
                axes.axhline(level, color="#000000", linewidth=0.9, linestyle=(0, (1, 1.5)))
            for line in lines:
                picked = shown_rows & table["label"].isin(line.labels).to_numpy()
                numbers = capped(table[metric], ceiling)
                groups_of: dict[Any, list[float]] = {}
                for index in np.flatnonzero(picked):
                    groups_of.setdefault(values[index], []).append(numbers[index])
                xs = [value for value in distinct if value in groups_of]
                groups = [groups_of[value] for value in xs]
                positions = [places[value] for value in xs]
                middle = [_middle(metric, group) for group in groups]
                middles += middle
                if len(lines) <= _MAX_BANDS:
                    axes.fill_between(
                        positions,
                        [min(group) for group in groups],
                        [max(group) for group in groups],
                        color=line.color,
                        alpha=0.14,
                        linewidth=0,
                    )
                axes.plot(
                    positions,
                    middle,
                    color=line.color,
                    marker=line.marker,
                    linestyle=line.dash,
                    markersize=4.5,
                    clip_on=False,
                )
            _parameter_axis(axes, parameter, distinct, numeric=numeric, log=log)
            if by is not None:
                axes.set_title(_TITLES[by].format(here))
        if by is not None:
            say_left_out(row[-1], len(panel_by), table[by].nunique(), _MANY[by])
        if len(lines) > _MAX_BANDS:
            drawn_values = pd.Series(middles)
        if about.log and (drawn_values.dropna() > 0.0).all():
            for axes in row:
                axes.set_yscale("log")
            limits = [axes.get_ylim() for axes in row]
            for axes in row:
                axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
                plain_log_ticks(axes, which="y", name=metric)
                axes.tick_params(labelleft=axes is row[0])
            row[0].set_ylabel(about.label)
        else:
            share_y(row, metric, about.label, ceiling, drawn_values)
        entries: list[tuple[str, Any]] = [
            (line.name, Line2D([], [], color=line.color, marker=line.marker, linestyle=line.dash))
            for line in lines
        ]
        if (table["label"] == _YARDSTICK).any():
            dotted = Line2D([], [], color="#000000", linewidth=0.9, linestyle=(0, (1, 1.5)))
            entries.append((_YARDSTICK, dotted))
        legend(figure, entries)
    return figure


@dataclass(frozen=True)
class _Line:
    name: str
    labels: list[str]
    color: str
    marker: str
    dash: Any


def _lines(table: pd.DataFrame, with_it: set[str], parameter: str) -> list[_Line]:
    """Group the labels that have the parameter: by technique, then by what else varies."""
    known = looks(table)
    lines = []
    for number, family in enumerate(families(table)):
        groups: dict[str, list[str]] = {}
        for label in family.labels:
            if label in with_it:
                rest = family.varying[label]
                others = [f"{name} {shown(rest[name])}" for name in rest if name != parameter]
                groups.setdefault(", ".join(others), []).append(label)
        for order, (others_text, members) in enumerate(groups.items()):
            name = f"{family.technique} ({others_text})" if others_text else family.technique
            marker = MARKERS[(number + order * 3) % len(MARKERS)]
            look = known[members[-1]]
            color = look.color if len(groups) <= len(DASHES) else look.shade
            lines.append(_Line(name, members, color, marker, DASHES[order % len(DASHES)]))
    return lines


def _parameter_axis(
    axes: Axes,
    parameter: str,
    distinct: Sequence[Any],
    *,
    numeric: bool,
    log: bool,
) -> None:
    axes.set_xlabel(parameter)
    if not numeric:
        axes.xaxis.set_major_locator(FixedLocator(list(range(len(distinct)))))
        names = [shown(value) for value in distinct]
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: names[round(x)]))
        axes.set_xlim(-0.3, len(distinct) - 0.7)
        if sum(map(len, names)) > 34:
            axes.tick_params(axis="x", labelrotation=30)
        return
    numbers = [float(value) for value in distinct]
    if log:
        if numbers[0] == 0.0:
            # from 0 to the first number as far as a power of ten is wide at most
            axes.set_xscale("symlog", linthresh=numbers[1], linscale=0.4)
            axes.set_xlim(left=-0.2 * numbers[1])
        else:
            axes.set_xscale("log")
        few = numbers
        if len(numbers) > 6:
            few = numbers[:: -(-len(numbers) // 6)]
        plain_log_ticks(axes, few)
    elif len(numbers) <= 7 and _apart(numbers):
        axes.xaxis.set_major_locator(FixedLocator(numbers))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:.4g}"))


def _apart(numbers: Sequence[float]) -> bool:
    """Whether ticks at all these numbers would have room for their labels."""
    return bool(np.diff(numbers).min() / (numbers[-1] - numbers[0]) > 0.09)


def _middle(metric: str, values: Any) -> float:
    return float(np.median(values) if metric in ("frame_millis", "speedup") else np.mean(values))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)
