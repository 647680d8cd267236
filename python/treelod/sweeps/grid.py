"""
Which representations a sweep builds: techniques with every set of parameters that was asked for.

Names and types are checked here, against the signature of the technique's `build`, so that a
mistyped grid is refused before anything is drawn. Ranges are the technique's own matter.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from treelod.sweeps.parameters import canonical, checked, defaults, written
from treelod.techniques import REGISTRY, FullMesh

__all__ = ["Grid", "GridLike", "ParameterSets", "Variant", "crossed", "expand", "labels", "zipped"]


class ParameterSets:
    """
    Sets of parameters, each of which gives one representation; see `zipped` and `crossed`.

    Attributes
    ----------
    sets : tuple of dict
        One dict of parameters a representation.
    """

    def __init__(self, sets: Iterable[Mapping[str, Any]]) -> None:
        self.sets = tuple(dict(one) for one in sets)

    def __len__(self) -> int:
        return len(self.sets)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.sets)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ParameterSets) and self.sets == other.sets

    def __hash__(self) -> int:
        return hash(len(self.sets))

    def __repr__(self) -> str:
        return f"ParameterSets({list(self.sets)!r})"


Part: TypeAlias = Mapping[str, Any] | ParameterSets
GridLike: TypeAlias = Mapping[str, "Part | Sequence[Part] | None"] | Sequence[str]
"""Techniques, each with parameters, or with a list of alternatives; or names of techniques."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Variant:
    """
    One technique with one set of parameters.

    Attributes
    ----------
    technique : str
        Its name in the registry.
    given : tuple of str
        Parameters that the grid named, for this technique.
    params : dict of str to object
        All parameters, defaults included, in the one form in which equal ones are equal.
    """

    technique: str
    given: tuple[str, ...]
    params: dict[str, Any]

    @property
    def is_yardstick(self) -> bool:
        """Whether it is the full mesh as it is."""
        return self.technique == FullMesh.name and self.params == defaults(FullMesh.name)

    def canonical_params(self) -> dict[str, Any]:
        """Return all parameters as JSON holds them."""
        return {name: canonical(name, value) for name, value in self.params.items()}


Grid: TypeAlias = list[Variant]


def zipped(**parameters: Any) -> ParameterSets:
    """
    Let parameters of a grid move together, instead of crossing each with each.

    Parameters
    ----------
    **parameters : sequences of equal length
        Values of each parameter: a list, a range or a one-dimensional array.

    Returns
    -------
    ParameterSets
        As many sets as there are values.

    Raises
    ------
    ValueError
        If the lengths differ, or if there is no value.
    TypeError
        If a parameter has one value and not several.

    Examples
    --------
    >>> list(zipped(slice_count=[3, 5], resolution=[128, 256]))
    [{'slice_count': 3, 'resolution': 128}, {'slice_count': 5, 'resolution': 256}]
    """
    columns: dict[str, list[Any]] = {}
    for name, value in parameters.items():
        values = _several(value)
        if values is None:
            msg = f"zipped: {name} must be a list of values, got {value!r}"
            raise TypeError(msg)
        columns[name] = values
    if not columns or not any(columns.values()):
        msg = "zipped needs at least one parameter with at least one value"
        raise ValueError(msg)
    first, *others = columns
    for other in others:
        if len(columns[other]) != len(columns[first]):
            msg = (
                f"zipped: {first} has {len(columns[first])} values and {other} has "
                f"{len(columns[other])}: they must be as many"
            )
            raise ValueError(msg)
    return ParameterSets(
        dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)
    )


def crossed(*parts: Part) -> ParameterSets:
    """
    Cross sets of parameters: each of one part with each of the others.

    Parameters
    ----------
    *parts : mapping or ParameterSets
        A dict of parameters, whose lists are crossed too, or what `zipped` and `crossed` return.

    Returns
    -------
    ParameterSets
        The last part changes quickest.

    Raises
    ------
    ValueError
        If two parts have a parameter in common, or if there is no value.

    Examples
    --------
    >>> sets = crossed(zipped(slice_count=[3, 5], resolution=[128, 256]), {"samples": [4, 16]})
    >>> len(sets), sets.sets[1]
    (4, {'slice_count': 3, 'resolution': 128, 'samples': 16})
    """
    sets: list[dict[str, Any]] = [{}]
    for part in parts:
        grown = []
        for before, added in itertools.product(sets, _sets_of("crossed", part)):
            twice = sorted(before.keys() & added.keys())
            if twice:
                msg = f"crossed: {twice[0]} is in two parts"
                raise ValueError(msg)
            grown.append(before | added)
        sets = grown
    return ParameterSets(sets)


def expand(grid: GridLike) -> Grid:
    """
    List every representation of a grid, the full mesh first; each once.

    Parameters
    ----------
    grid : mapping or sequence of str
        As `sweep` takes it.

    Returns
    -------
    list of Variant

    Raises
    ------
    ValueError
        If a technique or a parameter is unknown, has no value, or a value that it does not know.
    TypeError
        If a value, or the grid itself, is of another type.
    """
    found: dict[tuple[str, str], Variant] = {}
    asked: dict[str, list[Part]] = {FullMesh.name: [{}]}
    for name, parts in _techniques(grid).items():
        asked[name] = [*asked.get(name, []), *parts]
    for name, parts in asked.items():
        sets = [one for part in parts for one in _sets_of(name, part)]
        given = tuple(dict.fromkeys(key for one in sets for key in one))
        for one in sets:
            params = defaults(name) | checked(name, one)
            variant = Variant(technique=name, given=given, params=params)
            found.setdefault((name, written(variant.canonical_params())), variant)
    return list(found.values())


def labels(variants: Sequence[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """
    Name representations by what varies between those of one technique.

    Parameters
    ----------
    variants : sequence of (str, mapping of str to object)
        Technique and canonical parameters of each; none twice.

    Returns
    -------
    list of str
        ``"technique"``, or ``"technique:name=value,..."`` where it has several. The full mesh as
        it is is always ``"full_mesh"``.
    """
    kept: dict[str, list[Mapping[str, Any]]] = {}
    for technique, params in variants:
        kept.setdefault(technique, []).append(params)
    yardstick = {name: canonical(name, value) for name, value in defaults(FullMesh.name).items()}
    # the yardstick has no label of its own where it is not among them
    kept.setdefault(FullMesh.name, []).append(yardstick)
    texts: dict[str, dict[str, dict[str, str]]] = {}
    for technique, rows in kept.items():
        names = dict.fromkeys(name for row in rows for name in row)
        texts[technique] = {}
        for name in names:
            values = {written(row.get(name)): row.get(name) for row in rows}
            if len(values) > 1:
                texts[technique][name] = _shortest(values)
    result = []
    for technique, params in variants:
        if technique == FullMesh.name and params == yardstick:
            result.append(technique)
            continue
        parts = [
            f"{name}={known[written(params.get(name))]}" for name, known in texts[technique].items()
        ]
        result.append(f"{technique}:{','.join(parts)}" if parts else technique)
    return result


def _shortest(values: Mapping[str, Any]) -> dict[str, str]:
    """Write values as shortly as they stay different."""
    for digits in (6, 17):
        texts = {key: _text(value, digits) for key, value in values.items()}
        if len(set(texts.values())) == len(texts):
            return texts
    return dict(zip(values, values, strict=True))


def _text(value: Any, digits: int) -> str:
    """Write a value as the command line takes it."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    if isinstance(value, list) and len(value) <= 8 and not any(isinstance(v, list) for v in value):
        return "+".join(_text(part, digits) for part in value)
    return str(value) if isinstance(value, str | int) else written(value)


def _techniques(grid: GridLike) -> dict[str, list[Part]]:
    if isinstance(grid, str) or not isinstance(grid, Mapping | Sequence):
        msg = f"grid must map techniques to parameters, or list techniques, got {grid!r}"
        raise TypeError(msg)
    pairs = grid.items() if isinstance(grid, Mapping) else ((name, None) for name in grid)
    found: dict[str, list[Part]] = {}
    for name, value in pairs:
        if name not in REGISTRY:
            msg = f"grid: unknown technique {name!r}; there are {', '.join(sorted(REGISTRY))}"
            raise ValueError(msg)
        if value is None:
            parts: list[Any] = [{}]
        elif isinstance(value, Mapping | ParameterSets):
            parts = [value]
        elif isinstance(value, Sequence) and not isinstance(value, str):
            parts = list(value)
        else:
            parts = [value]
        if not parts:
            msg = f"grid: the list of {name} is empty"
            raise ValueError(msg)
        found[name] = parts
    return found


def _sets_of(where: str, part: Part) -> list[dict[str, Any]]:
    """List the sets of parameters of one part; lists of a dict are crossed."""
    if isinstance(part, ParameterSets):
        return [dict(one) for one in part]
    if not isinstance(part, Mapping):
        msg = f"grid: {where} must have a dict of parameters, zipped or crossed, got {part!r}"
        raise TypeError(msg)
    columns = []
    for name, value in part.items():
        values = _several(value)
        if values is not None and not values:
            msg = f"grid: {where}: {name} has no value"
            raise ValueError(msg)
        columns.append([value] if values is None else values)
    return [dict(zip(part, row, strict=True)) for row in itertools.product(*columns)]


def _several(value: Any) -> list[Any] | None:
    """Return the values of a list, range or one-dimensional array; None for a single value."""
    if isinstance(value, np.ndarray):
        return list(value) if value.ndim == 1 else None
    if isinstance(value, list | range):
        return list(value)
    # a Series or an Index of pandas, which need not be imported to be told
    if hasattr(value, "to_numpy") and getattr(value, "ndim", 0) == 1:
        return list(value.to_numpy())
    return None
