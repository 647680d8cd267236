"""What all techniques have in common: built from a plant, with a cost and with textures."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeGuard

import numpy as np

from treelod import _core

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

__all__ = [
    "BakedTexture",
    "Footprint",
    "Technique",
    "TextureFormat",
    "core_of",
    "flag",
    "is_many",
    "number",
    "numbers",
    "resolution_texels",
    "text",
    "whole",
    "whole_numbers",
    "wood_facts",
]

TextureFormat = Literal["rgba8", "rgb5a1", "rgb8", "palette8", "bc1", "bc3", "bc7"]
"""
How baked textures are stored; they are drawn from what their format gives back.

``"rgba8"``: 8 bits a colour and of alpha, 4 bytes a texel. ``"rgb5a1"``: 5 bits a colour and 1 of
alpha, 2 bytes. ``"rgb8"``: 8 bits a colour, black is transparent, 3 bytes. ``"palette8"``: one of
256 colours with alpha, a byte, and 1 KiB a texture. ``"bc1"``, ``"bc3"``, ``"bc7"``: blocks of
texels as graphics cards read them; half a byte with 1 bit of alpha, a byte with alpha of its own,
and a byte in the way that suits each block best.
"""


@dataclass(frozen=True, kw_only=True)
class Footprint:
    """
    What a technique holds for one plant, whether or not a view needs it.

    Attributes
    ----------
    triangles, cards, lines, points : int
        Primitives stored, by kind.
    geometry_bytes : int
        Vertices, indices and side tables.
    texture_bytes : int
        All mip levels in the format they are stored in.
    """

    triangles: int
    cards: int
    lines: int
    points: int
    geometry_bytes: int
    texture_bytes: int

    @property
    def total_bytes(self) -> int:
        """Geometry and textures together."""
        return self.geometry_bytes + self.texture_bytes


@dataclass(frozen=True, kw_only=True, eq=False)
class BakedTexture:
    """
    A texture of a technique.

    Attributes
    ----------
    name : str
        What it shows.
    levels : list of ndarray of shape (H, W, 4), dtype uint8
        sRGB with straight alpha as stored, the finest level first; row 0 on top.
    corners : ndarray of shape (4, 3), dtype float64, or None
        World positions of its corners in metres, from the lower left counter-clockwise; None for a
        texture of the plant's own.
    """

    name: str
    levels: list[NDArray[np.uint8]]
    corners: NDArray[np.float64] | None

    def __repr__(self) -> str:
        height, width = self.levels[0].shape[:2]
        return f"BakedTexture({self.name!r}, {width} x {height})"


class Technique:
    """
    A plant as one technique stands for it. Made by a subclass's `build`; never changes.

    Attributes
    ----------
    name : str
        Of the class: what tables and command lines call it.
    params : dict
        What it was built with, defaults included.
    build_secs : float
        Seconds that building took.
    """

    name: ClassVar[str]

    def __init__(
        self, core: _core.Representation, params: Mapping[str, Any], build_secs: float
    ) -> None:
        self._core = core
        self.params = dict(params)
        self.build_secs = build_secs

    @classmethod
    def build(cls, *args: Any, **params: Any) -> Technique:
        """Build the technique for a plant: see the subclasses."""
        msg = f"{cls.__name__} is not a technique: use one of treelod.techniques.REGISTRY"
        raise TypeError(msg)

    @property
    def footprint(self) -> Footprint:
        """Bytes and primitives by kind."""
        return Footprint(**self._core.footprint)

    @property
    def textures(self) -> list[BakedTexture]:
        """Copies of all textures, bakes first."""
        return [
            BakedTexture(
                name=name, levels=levels, corners=None if corners is None else np.array(corners)
            )
            for name, levels, corners in self._core.textures
        ]

    def __repr__(self) -> str:
        params = ", ".join(f"{name}={value!r}" for name, value in self.params.items())
        return f"{type(self).__name__}({params})"


def wood_facts(*, wood: bool, wood_triangle_count: int | None) -> dict[str, Any]:
    """
    Check the two parameters that every `build` has for its wood.

    Parameters
    ----------
    wood : bool
        Whether wood is drawn at all.
    wood_triangle_count : int or None
        About how many triangles of it, at least 1; None for all.

    Returns
    -------
    dict
        The two, as the core takes them.

    Raises
    ------
    ValueError
        If the count is below 1.
    """
    if wood_triangle_count is not None and operator.index(wood_triangle_count) < 1:
        msg = f"wood_triangle_count must be at least 1 or None, got {wood_triangle_count}"
        raise ValueError(msg)
    return {"wood": flag("wood", wood), "wood_triangle_count": wood_triangle_count}


def whole(name: str, value: int, low: int = 1, end: int = 2**32) -> int:
    """
    Refuse what no integer of the core holds before the core sees it.

    Parameters
    ----------
    name : str
        The argument, for the message.
    value : int
        In ``range(low, end)``.
    low, end : int, default 1 and 2**32
        The range.

    Returns
    -------
    int

    Raises
    ------
    TypeError
        If it is no whole number.
    ValueError
        If it is out of range.
    """
    msg = f"{name} must be a whole number, got {value!r}"
    if isinstance(value, bool):
        raise TypeError(msg)
    try:
        count = operator.index(value)
    except TypeError:
        raise TypeError(msg) from None
    if not low <= count < end:
        bound = f"2**{end.bit_length() - 1}" if end.bit_count() == 1 else str(end)
        msg = f"{name} must be at least {low} and below {bound}, got {count}"
        raise ValueError(msg)
    return count


def number(name: str, value: float) -> float:
    """
    Return a number as the core takes it.

    Parameters
    ----------
    name : str
        The argument, for the message.
    value : float
        Any number.

    Returns
    -------
    float

    Raises
    ------
    TypeError
        If it is no number.
    """
    msg = f"{name} must be a number, got {value!r}"
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    # all of which float() would take, or the real part of
    if isinstance(value, str | bytes | bool | np.bool_ | np.ndarray | np.complexfloating):
        raise TypeError(msg)
    try:
        return float(value)
    except (TypeError, ValueError):
        raise TypeError(msg) from None


def is_many(value: object) -> TypeGuard[Sequence[Any]]:
    """
    Whether an argument that may be one number or several is several.

    Parameters
    ----------
    value : object
        What was given.

    Returns
    -------
    bool
    """
    return isinstance(value, Sequence | np.ndarray)


def whole_numbers(name: str, value: int | Sequence[int]) -> list[int]:
    """
    Return one whole number of at least 1, or several, as a list.

    Parameters
    ----------
    name : str
        The argument, for the message.
    value : int or sequence of int
        Each as in `whole`.

    Returns
    -------
    list of int

    Raises
    ------
    TypeError
        If it is anything else.
    ValueError
        If a number is out of range.
    """
    return [whole(name, count) for count in _each(name, value)]


def numbers(name: str, value: float | Sequence[float]) -> list[float]:
    """
    Return one number, or several, as a list.

    Parameters
    ----------
    name : str
        The argument, for the message.
    value : float or sequence of float
        Any numbers.

    Returns
    -------
    list of float

    Raises
    ------
    TypeError
        If it is anything else.
    """
    return [number(name, each) for each in _each(name, value)]


def _each(name: str, value: object) -> list[Any]:
    """Members of an argument that is one number or several; each is still to be looked at."""
    if isinstance(value, str | bytes) or (isinstance(value, np.ndarray) and value.ndim > 1):
        msg = f"{name} must be a number or a sequence of numbers, got {value!r}"
        raise TypeError(msg)
    if isinstance(value, np.ndarray):
        return [*np.atleast_1d(value)]
    return [*value] if is_many(value) else [value]


def core_of(plant: object) -> _core.Plant:
    """
    Return what the core knows of a plant.

    Parameters
    ----------
    plant : Plant
        What `build` was given.

    Returns
    -------
    _core.Plant

    Raises
    ------
    TypeError
        If it is anything else.
    """
    core = getattr(plant, "_core", None)
    if not isinstance(core, _core.Plant):
        msg = f"plant must be a Plant, got {type(plant).__name__}: see load_plant and grow_plant"
        raise TypeError(msg)
    return core


def text(name: str, value: object) -> str:
    """
    Return a name as the core takes it, which knows the names.

    Parameters
    ----------
    name : str
        The argument, for the message.
    value : object
        A str.

    Returns
    -------
    str

    Raises
    ------
    TypeError
        If it is anything else.
    """
    if not isinstance(value, str):
        msg = f"{name} must be a str, got {value!r}"
        raise TypeError(msg)
    return value


def flag(name: str, value: object) -> bool:
    """
    Return True or False.

    Parameters
    ----------
    name : str
        The argument, for the message.
    value : object
        A bool, or a number that is 0 or 1.

    Returns
    -------
    bool

    Raises
    ------
    TypeError
        If it is anything else.
    """
    if isinstance(value, bool | np.bool_) or (isinstance(value, int) and value in (0, 1)):
        return bool(value)
    msg = f"{name} must be True or False, got {value!r}"
    raise TypeError(msg)


def resolution_texels(name: str, resolution: int | tuple[int, int]) -> tuple[int, int]:
    """
    Width and height in texels.

    Parameters
    ----------
    name : str
        The argument, for the message.
    resolution : int or (int, int)
        One number for both sides, or both; each at least 1.

    Returns
    -------
    tuple of int

    Raises
    ------
    TypeError
        If it is neither.
    ValueError
        If there are not two numbers, or one is out of range.
    """
    msg = f"{name} must be a number or (width, height), got {resolution!r}"
    if isinstance(resolution, str | bytes):
        raise TypeError(msg)
    if not isinstance(resolution, Sequence):
        side = whole(name, resolution)
        return side, side
    if len(resolution) != 2:
        raise ValueError(msg)
    return whole(name, resolution[0]), whole(name, resolution[1])
