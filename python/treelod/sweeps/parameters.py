"""
What a parameter of a technique may be, and the one form in which equal values are equal.

The signature of a technique's `build` says which types and which words a parameter takes. The
canonical form is what JSON holds: it names a representation in the store.
"""

from __future__ import annotations

import ast
import functools
import inspect
import json
import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

import numpy as np

from treelod.criteria import Criterion, criterion_from
from treelod.techniques import REGISTRY

__all__ = ["NOT_SWEPT", "canonical", "checked", "defaults", "is_whole", "known", "written"]

NOT_SWEPT = ("progress", "threads", "views")
"""What a build takes besides a technique's own parameters."""


@functools.cache
def known(technique: str) -> dict[str, inspect.Parameter]:
    """
    Return the parameters of a technique.

    Parameters
    ----------
    technique : str
        Its name in the registry.

    Returns
    -------
    dict of str to inspect.Parameter
        In the order of its `build`, without those that are no parameters of a sweep.
    """
    return {
        parameter.name: parameter
        for parameter in inspect.signature(REGISTRY[technique].build).parameters.values()
        if parameter.kind is parameter.KEYWORD_ONLY and parameter.name not in NOT_SWEPT
    }


def defaults(technique: str) -> dict[str, Any]:
    """
    Return a technique's parameters where none is given.

    Parameters
    ----------
    technique : str
        Its name in the registry.

    Returns
    -------
    dict of str to object
    """
    return {name: parameter.default for name, parameter in known(technique).items()}


def checked(technique: str, params: Mapping[str, Any]) -> dict[str, Any]:
    """
    Refuse parameters that a technique does not have, and values of another type.

    Parameters
    ----------
    technique : str
        Its name in the registry.
    params : mapping of str to object
        Parameters, one value each.

    Returns
    -------
    dict of str to object
        The same, as plain Python: numbers of NumPy become Python's, whole numbers become floats
        where the parameter is one, arrays and lists become tuples.

    Raises
    ------
    ValueError
        If a parameter is unknown, not finite, or a word that is not offered.
    TypeError
        If a value is of another type.
    """
    result = {}
    for name, value in params.items():
        if name not in known(technique):
            why = "is not swept" if name in NOT_SWEPT else "is no parameter of it"
            msg = f"{technique}: {name} {why}; there are {', '.join(known(technique)) or 'none'}"
            raise ValueError(msg)
        kinds = _kinds(technique, name)
        plain = _plain(f"{technique}: {name}", value, is_float=not is_whole(technique, name))
        _check(f"{technique}: {name}", plain, kinds)
        result[name] = plain
    return result


def is_whole(technique: str, name: str) -> bool:
    """
    Tell whether a parameter takes whole numbers and no others.

    Parameters
    ----------
    technique : str
        Its name in the registry.
    name : str
        One of its parameters.

    Returns
    -------
    bool
        True also for parameters that take no number at all.
    """
    texts = {node.id for kind in _kinds(technique, name) for node in _names(kind)}
    return "float" not in texts


def canonical(name: str, value: Any) -> Any:
    """
    Return a value as JSON holds it.

    Parameters
    ----------
    name : str
        The parameter, for the message.
    value : object
        What `checked` returns.

    Returns
    -------
    object

    Raises
    ------
    TypeError
        If the value has no form that names it: a function, for example.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        # minus zero is zero, and JSON tells them apart
        return value + 0.0
    if isinstance(value, tuple):
        return [canonical(name, part) for part in value]
    if isinstance(value, Mapping):
        return {str(key): canonical(name, part) for key, part in sorted(value.items())}
    if isinstance(value, Criterion) and not _has_function(value):
        return {"criterion": repr(value)}
    msg = f"{name}: nothing names {value!r} in a store; use criteria of treelod.criteria"
    raise TypeError(msg)


def written(value: Any) -> str:
    """
    Write a canonical value down: equal ones alike.

    Parameters
    ----------
    value : object
        As `canonical` returns it.

    Returns
    -------
    str
        JSON without spaces, names sorted.
    """
    return json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"))


def _plain(where: str, value: Any, *, is_float: bool) -> Any:
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return value
    if isinstance(value, int) and is_float:
        try:
            return float(value)
        except OverflowError:
            msg = f"{where} must be finite, got a number of {value.bit_length()} bits"
            raise ValueError(msg) from None
    if isinstance(value, float):
        if not math.isfinite(value):
            msg = f"{where} must be finite, got {value}"
            raise ValueError(msg)
        return value + 0.0
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(where, part, is_float=is_float) for key, part in value.items()}
    if isinstance(value, Sequence):
        return tuple(_plain(where, part, is_float=is_float) for part in value)
    return criterion_from(value) if callable(value) else value


def _check(where: str, value: Any, kinds: tuple[ast.expr, ...]) -> None:
    words = [word for kind in kinds for word in _words(kind)]
    if any(_fits(value, kind) for kind in kinds) or (isinstance(value, str) and value in words):
        return
    text = " | ".join(ast.unparse(kind) for kind in kinds)
    if isinstance(value, str) and words:
        msg = f"{where} must be {' or '.join(map(repr, words))}, got {value!r}"
        raise ValueError(msg)
    msg = f"{where} must be {text}, got {value!r}"
    raise TypeError(msg)


def _fits(value: Any, kind: ast.expr) -> bool:
    match kind:
        case ast.Constant(value=None):
            return value is None
        case ast.Name(id="bool"):
            return isinstance(value, bool)
        case ast.Name(id="int"):
            return isinstance(value, int) and not isinstance(value, bool)
        case ast.Name(id="float"):
            return isinstance(value, float)
        case ast.Name(id="str"):
            return isinstance(value, str)
        case ast.Name(id="CriterionLike"):
            return isinstance(value, Criterion)
        case ast.Name(id="ArrayLike"):
            return isinstance(value, tuple)
        case ast.Subscript(value=ast.Name(id="tuple" | "Sequence"), slice=inner):
            if not isinstance(value, tuple):
                return False
            each = inner.elts if isinstance(inner, ast.Tuple) else [inner] * len(value)
            return len(value) == len(each) and all(map(_fits, value, each))
        case ast.Subscript(value=ast.Name(id="Mapping")):
            return isinstance(value, Mapping)
    return False


@functools.cache
def _kinds(technique: str, name: str) -> tuple[ast.expr, ...]:
    """Return the alternatives that a parameter's annotation names."""
    annotation = known(technique)[name].annotation
    names = vars(sys.modules[REGISTRY[technique].build.__module__])
    return tuple(_alternatives(ast.parse(str(annotation), mode="eval").body, names))


def _alternatives(node: ast.expr, names: Mapping[str, Any]) -> list[ast.expr]:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        return [*_alternatives(node.left, names), *_alternatives(node.right, names)]
    # words that several techniques share have a name
    if isinstance(node, ast.Name) and get_origin(names.get(node.id)) is Literal:
        words = ", ".join(map(repr, get_args(names[node.id])))
        return [ast.parse(f"Literal[{words}]", mode="eval").body]
    return [node]


def _words(kind: ast.expr) -> list[str]:
    match kind:
        case ast.Subscript(value=ast.Name(id="Literal"), slice=inner):
            each = inner.elts if isinstance(inner, ast.Tuple) else [inner]
            return [str(part.value) for part in each if isinstance(part, ast.Constant)]
    return []


def _names(kind: ast.expr) -> list[ast.Name]:
    return [node for node in ast.walk(kind) if isinstance(node, ast.Name)]


def _has_function(criterion: Criterion) -> bool:
    return hasattr(criterion, "function") or any(map(_has_function, criterion.parts))
