"""Values of a JSON header that may be anything: what is wrong with one is said by its name."""

from collections.abc import Container
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treelod.errors import PlantFileError

__all__ = [
    "Json",
    "extension",
    "extensions",
    "floats",
    "index",
    "index_list",
    "integer",
    "one_of",
]

Json = dict[str, Any]


def extensions(owner: Json) -> Json:
    """Extensions of an object by name."""
    found = owner.get("extensions", {})
    if not isinstance(found, dict):
        msg = "extensions is not an object"
        raise PlantFileError(msg)
    return found


def extension(owner: Json, name: str) -> Json:
    """Return an extension of an object, empty if it has none of that name."""
    found = extensions(owner).get(name, {})
    if not isinstance(found, dict):
        msg = f"{name} is not an object"
        raise PlantFileError(msg)
    return found


def one_of(value: object, known: Container[object]) -> bool:
    """Whether a value is a text or an integer that is known; lists and objects never are."""
    return isinstance(value, (str, int)) and value in known


def index_list(values: object, what: str) -> list[int]:
    """Return a list of node indices, each at least 0."""
    if not isinstance(values, list):
        msg = f"{what}: not a list"
        raise PlantFileError(msg)
    return [integer(value, 0, f"{what}: node index") for value in values]


def integer(value: object, low: int, what: str) -> int:
    """Return an integer of at least `low`."""
    if not isinstance(value, int) or isinstance(value, bool) or value < low:
        msg = f"{what} is {value!r}, not an integer of at least {low}"
        raise PlantFileError(msg)
    return value


def index(value: object, length: int, what: str) -> int:
    """Return an index into a list of `length` things."""
    found = integer(value, 0, what)
    if found >= length:
        msg = f"{what} {found}, but there are {length}"
        raise PlantFileError(msg)
    return found


def floats(values: object, length: int, what: str) -> NDArray[np.float64]:
    """Return a list of `length` finite numbers as an array."""
    numbers = isinstance(values, list) and all(
        isinstance(value, (int, float)) and not isinstance(value, bool) for value in values
    )
    if not numbers or len(values) != length:  # type: ignore[arg-type]
        msg = f"{what} is {values!r}, not {length} numbers"
        raise PlantFileError(msg)
    try:
        array = np.array(values, dtype=np.float64)
    except OverflowError:
        array = np.array([np.inf])
    if not np.isfinite(array).all():
        msg = f"{what} is not finite"
        raise PlantFileError(msg)
    return array
