"""
What a table says about its techniques: which labels belong together, and what was swept.

A table comes from `Comparison.table` or from a sweep. In both a label names one setting of one
technique, and its parameters stand in ``params`` (JSON); a sweep has them in ``param_NAME`` too.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd
from matplotlib.colors import to_hex, to_rgb
from matplotlib.lines import Line2D

from treelod.plots.style import COLORS, COSTS, MARKERS, METRICS, Metric

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = [
    "Family",
    "Look",
    "Path",
    "check_columns",
    "families",
    "is_log_spaced",
    "legend_entries",
    "looks",
    "metric_of",
    "one_setting",
    "panel_values",
    "parameter_values",
    "range_text",
    "shown",
]

MAX_PANELS = 4
"""Distances shown side by side; of more, the nearest, the farthest and those evenly between."""

MAX_LEGEND = 12
"""Labels up to which each has a line in a legend."""

_PALEST = 0.62
"""Share of white in the colour of the first of a technique's settings; the last has none."""


@dataclass(frozen=True)
class Look:
    """How one label is drawn: `color` is its technique's, `shade` its own."""

    color: str
    shade: str
    marker: str

    def line(self, linestyle: Literal["-", "none"]) -> Line2D:
        """Make a legend's sample of it."""
        return Line2D([], [], color=self.shade, marker=self.marker, linestyle=linestyle)


@dataclass(frozen=True)
class Path:
    """Labels along which one parameter rises and all others stay; `others` says what they are."""

    labels: list[str]
    values: list[Any]
    others: str


@dataclass(frozen=True)
class Family:
    """
    The settings of one technique.

    `varying` has, for each label, the parameters that differ among the technique's labels; `swept`
    is the one of most values, which the paths follow.
    """

    technique: str
    labels: list[str]
    varying: dict[str, dict[str, Any]]
    swept: str | None
    paths: list[Path]


def check_columns(table: pd.DataFrame, *names: str) -> None:
    """Refuse a table without rows, or without the columns that a plot needs."""
    missing = [name for name in names if name not in table.columns]
    if missing:
        msg = f"table has no column {', '.join(map(repr, missing))}"
        raise ValueError(msg)
    if not len(table):
        msg = "table is empty: there is nothing to plot"
        raise ValueError(msg)


_SETTINGS = ("plant", "time_samples", "reference_samples", "ppd", "kernel_version")
"""Columns of which a mean over rows of several values would be of nothing."""

_TIME_SETTINGS = ("timing", "threads", "backend", "adapter")
"""The same of times; errors are the same bits for every number of threads and graphics card."""


def one_setting(table: pd.DataFrame, *, timed: bool = False, apart: str | None = None) -> None:
    """
    Refuse a table that mixes plants, or ways of measuring, and so has no mean.

    Columns may be missing, and values too: a comparison has no ``kernel_version``, so it can be
    joined to a sweep. `timed` looks at what times depend on as well; `apart` is a column whose
    values are kept apart.
    """
    rows = dict.fromkeys(_SETTINGS, table)
    if timed and "frame_millis" in table.columns:
        rows |= dict.fromkeys(_TIME_SETTINGS, table[table["frame_millis"].notna()])
    for name, those in rows.items():
        if name == apart or name not in those.columns:
            continue
        values = those[name].dropna().unique()
        if len(values) > 1:
            first = values[0].item() if isinstance(values[0], np.generic) else values[0]
            msg = (
                f"table has {len(values)} values of {name!r}, over which a mean says nothing: pick "
                f"the rows of one, table[table[{name!r}] == {first!r}]"
            )
            raise ValueError(msg)


def metric_of(table: pd.DataFrame, metric: str, *, costs: bool = False) -> Metric:
    """Find what is known of a metric; refuse unknown ones, and those that were not measured."""
    known = METRICS | COSTS if costs else METRICS
    if metric not in known:
        msg = f"metric must be one of {', '.join(known)}, got {metric!r}"
        raise ValueError(msg)
    check_columns(table, metric)
    if table[metric].isna().all():
        msg = f"table has no value of {metric!r}: it was not measured"
        raise ValueError(msg)
    return known[metric]


def techniques_of(table: pd.DataFrame) -> dict[str, str]:
    """Technique of each label, in the order of appearance."""
    first = table.drop_duplicates("label")
    labels = [str(label) for label in first["label"]]
    if "technique" in table.columns:
        return dict(zip(labels, map(str, first["technique"]), strict=True))
    return {label: label.partition(":")[0] for label in labels}


def parameter_values(table: pd.DataFrame, parameter: str) -> list[Any]:
    """
    Value of a parameter in each row, None where it has none: from its column, else from ``params``.

    Raises `ValueError` if no row has it.
    """
    column = f"param_{parameter}"
    if column in table.columns:
        values = [_plain(value) for value in table[column]]
    elif "params" in table.columns:
        read = {text: json.loads(text) for text in table["params"].unique()}
        values = [_plain(read[text].get(parameter)) for text in table["params"]]
    else:
        values = []
    if all(value is None for value in values):
        columns = [name.removeprefix("param_") for name in table.columns if "param_" in name]
        known = f"; there are {', '.join(columns)}" if columns else ""
        msg = f"no row of table has a parameter {parameter!r}{known}"
        raise ValueError(msg)
    return values


def families(table: pd.DataFrame) -> list[Family]:
    """Group labels by technique, and order them by what was swept."""
    first = table.drop_duplicates("label").set_index("label")
    grouped: dict[str, list[str]] = {}
    for label, technique in techniques_of(table).items():
        grouped.setdefault(technique, []).append(label)
    found = []
    for technique, labels in grouped.items():
        varying = _varying(first.loc[labels]) if len(labels) > 1 else {}
        swept = max(varying, key=lambda name: len(set(varying[name])), default=None)
        if swept is None:
            paths = [Path([label], [None], "") for label in labels]
            nothing: dict[str, dict[str, Any]] = {label: {} for label in labels}
            found.append(Family(technique, labels, nothing, None, paths))
            continue
        groups: dict[tuple[Any, ...], list[int]] = {}
        for index in range(len(labels)):
            rest = tuple(varying[name][index] for name in varying if name != swept)
            groups.setdefault(rest, []).append(index)
        values = varying[swept]
        paths = []
        for rest, members in groups.items():
            ordered = sorted(members, key=lambda index: _rank(values[index]))
            names = [name for name in varying if name != swept]
            others = ", ".join(
                f"{name} {shown(value)}" for name, value in zip(names, rest, strict=True)
            )
            paths.append(Path([labels[i] for i in ordered], [values[i] for i in ordered], others))
        ordered_labels = [label for path in paths for label in path.labels]
        settings = {
            label: {name: values[index] for name, values in varying.items()}
            for index, label in enumerate(labels)
        }
        found.append(Family(technique, ordered_labels, settings, swept, paths))
    return found


def looks(table: pd.DataFrame) -> dict[str, Look]:
    """
    Give each label a look, in the order of appearance.

    A technique has one colour; along what was swept its settings go from pale to full, whatever
    else they differ in. Labels differ in markers while there are enough, then techniques do.
    """
    check_columns(table, "label")
    found = {}
    order = list(techniques_of(table))
    enough = len(order) <= len(MARKERS)
    for position, family in enumerate(families(table)):
        color = COLORS[position % len(COLORS)]
        values = [value for path in family.paths for value in path.values]
        ranks = sorted({_rank(value) for value in values})
        last = len(ranks) - 1
        for label, value in zip(family.labels, values, strict=True):
            place = ranks.index(_rank(value))
            white = _PALEST * (1.0 - place / last) if last else 0.0
            number = order.index(label) if enough else position
            found[label] = Look(color, _paler(color, white), MARKERS[number % len(MARKERS)])
    return {label: found[label] for label in order}


def panel_values(column: pd.Series[Any]) -> list[Any]:
    """Values of a column, sorted; of many a few evenly between the first and the last."""
    values = sorted(column.unique())
    if len(values) <= MAX_PANELS:
        return values
    picks = np.linspace(0, len(values) - 1, MAX_PANELS).round().astype(int)
    return [values[pick] for pick in picks]


def is_log_spaced(values: Sequence[float]) -> bool:
    """
    Tell whether numbers stand more evenly on a logarithmic axis than on a plain one.

    Examples
    --------
    >>> is_log_spaced([1, 2, 4, 8, 16]), is_log_spaced([1, 2, 3, 5, 7]), is_log_spaced([0, 1, 10])
    (True, False, False)
    """
    numbers = np.unique(np.asarray(values, dtype=np.float64))
    if len(numbers) < 3 or numbers[0] <= 0.0 or numbers[-1] / numbers[0] < 8.0:
        return False
    plain, logs = np.diff(numbers), np.diff(np.log(numbers))
    return bool(logs.std() / logs.mean() < plain.std() / plain.mean())


def shown(value: Any) -> str:
    """Write a parameter's value: short numbers, lists without spaces after a comma."""
    if isinstance(value, bool | np.bool_):
        return str(bool(value))
    if isinstance(value, int | float | np.number):
        return f"{float(value):.4g}"
    if isinstance(value, list | tuple):
        return ",".join(shown(part) for part in value)
    return str(value)


def legend_entries(table: pd.DataFrame) -> list[tuple[str, Any]]:
    """Legend of lines: a line a label; of more than can be told apart a line a technique."""
    known = looks(table)
    if len(known) <= MAX_LEGEND:
        return [(label, look.line("-")) for label, look in known.items()]
    entries = []
    for family in families(table):
        last = known[family.labels[-1]]
        text = range_text(family) + (" (pale to full)" if family.swept else "")
        if len(family.paths) > 1:
            text += f", at {len(family.paths)} settings of the rest"
        entries.append((text, last.line("-")))
    return entries


def range_text(family: Family) -> str:
    """Name a technique with what was swept: ``slicings: slice_count 1 to 9``."""
    if family.swept is None:
        return family.technique
    values = [value for path in family.paths for value in path.values]
    ordered = sorted(values, key=_rank)
    first, last = shown(ordered[0]), shown(ordered[-1])
    return f"{family.technique}: {family.swept} {first} to {last}"


def _varying(settings: pd.DataFrame) -> dict[str, list[Any]]:
    """Parameters that differ between labels, with their values."""
    columns = [name for name in settings.columns if name.startswith("param_")]
    found: dict[str, list[Any]] = {}
    if columns:
        found = {
            name.removeprefix("param_"): [_plain(value) for value in settings[name]]
            for name in columns
        }
    elif "params" in settings.columns:
        read = [json.loads(text) for text in settings["params"]]
        names = dict.fromkeys(name for params in read for name in params)
        found = {name: [_plain(params.get(name)) for params in read] for name in names}
    return {name: values for name, values in found.items() if len({repr(v) for v in values}) > 1}


def _plain(value: Any) -> Any:
    """Return a value that can be looked up: lists as tuples, what is missing as None."""
    if isinstance(value, list | tuple | np.ndarray):
        return tuple(_plain(part) for part in value)
    if isinstance(value, dict):
        return json.dumps(value, sort_keys=True)
    if isinstance(value, np.generic):
        value = value.item()
    return None if value is None or pd.isna(value) else value


def _rank(value: Any) -> tuple[int, float, str]:
    """Order numbers by size, then the rest by their text."""
    if isinstance(value, int | float | np.number) and not math.isnan(float(value)):
        return 0, float(value), ""
    return 1, 0.0, repr(value)


def _paler(color: str, white: float) -> str:
    if white == 0.0:
        return color
    red, green, blue = (channel + (1.0 - channel) * white for channel in to_rgb(color))
    return to_hex((red, green, blue))
