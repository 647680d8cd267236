"""Variety: how copies of one plant differ."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from treelod import _core
from treelod.techniques.technique import flag, number, whole

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Variant", "Variety"]

MIN_CHANNEL = 1e-3
"""Darkest channel of a colour whose hue is turned."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """
    What one copy is like.

    Attributes
    ----------
    scale : float
        How many times as large as its plant.
    mirrored : bool
        Whether left and right are exchanged.
    tint : tuple of 3 floats
        What its linear colours are multiplied by.
    """

    scale: float
    mirrored: bool
    tint: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Variety:
    """
    How far the copies of a `Scene` may differ from their plants.

    Every copy draws its size, side, hue and brightness evenly from their ranges [1]_, from a random
    stream that is keyed by `seed` and the copy's place in its scene. Sizes and sides change about
    the foot, the middle of the lower side of the box around wood and leaves.

    Attributes
    ----------
    size : float, default 0.12
        Largest change of size, as a share, in [0, 0.9].
    hue_deg : float, default 10
        Largest turn of the hue in degrees, in [0, 180].
    value : float, default 0.1
        Largest change of brightness, as a share of linear light, in [0, 0.9].
    mirror : bool, default True
        Whether about half of the copies have left and right exchanged. Their light is mirrored too.
    color : sequence of 3 floats, default (0.09, 0.15, 0.03)
        The linear colour whose hue is turned exactly, each channel in [0.001, 1]: a leaf's. See
        Notes.
    seed : int, default 0
        Of all choices, in [0, 2**64).

    Raises
    ------
    ValueError
        If a number is out of range.

    Notes
    -----
    A copy's colours are multiplied by one tint, as by "per-vertex color" [1]_.
    A tint cannot turn all hues by one angle. This one takes `color` to the colour of the same HSV
    saturation and value (of encoded colours) whose hue is turned; other greens turn by nearly as
    much, and bark takes the same cast. All techniques of a plant get the same tint.

    References
    ----------
    .. [1] D. Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming, chapter 20:
       "allowing a 10-15 percent deviation from the standard size". New Riders, 2003.

    Examples
    --------
    >>> import treelod as tl
    >>> tree = tl.FullMesh.build(tl.grow_plant("chestnut", leaf_count=50))
    >>> grove = tl.Scene([(tree, tl.scatter(9, 10.0))], variety=tl.Variety(size=0.15))
    >>> 0.85 <= tl.Variety(size=0.15).of(0, 3).scale <= 1.15
    True
    """

    size: float = 0.12
    hue_deg: float = 10.0
    value: float = 0.1
    mirror: bool = True
    color: Sequence[float] = (0.09, 0.15, 0.03)
    seed: int = 0

    def __post_init__(self) -> None:
        """Check every field and store plain numbers."""
        for name, high in (("size", 0.9), ("hue_deg", 180.0), ("value", 0.9)):
            object.__setattr__(self, name, _within(name, getattr(self, name), 0.0, high))
        object.__setattr__(self, "mirror", flag("mirror", self.mirror))
        if isinstance(self.color, str) or len(self.color) != 3:
            msg = f"color must be 3 numbers, got {self.color!r}"
            raise ValueError(msg)
        color = tuple(_within("color", channel, MIN_CHANNEL, 1.0) for channel in self.color)
        object.__setattr__(self, "color", color)
        object.__setattr__(self, "seed", whole("seed", self.seed, 0, 2**64))

    def of(self, group: int, copy: int) -> Variant:
        """
        Return what a copy is like.

        Parameters
        ----------
        group : int
            Number of the technique among the scene's groups, from 0.
        copy : int
            Number of the transform in that group, from 0.

        Returns
        -------
        Variant

        Raises
        ------
        ValueError
            If a number is negative or too large.
        """
        place = whole("group", group, 0), whole("copy", copy, 0)
        scale, mirrored, (red, green, blue) = _core.variant(_facts(self), *place)
        return Variant(scale=scale, mirrored=mirrored, tint=(red, green, blue))


def _within(name: str, value: float, low: float, high: float) -> float:
    found = number(name, value)
    if not (math.isfinite(found) and low <= found <= high):
        msg = f"{name} must be in [{low:g}, {high:g}], got {found}"
        raise ValueError(msg)
    return found


def variety_facts(variety: Variety | None) -> _core._VarietyFacts | None:
    """
    Return a variety as the core takes it.

    Parameters
    ----------
    variety : Variety or None
        How copies differ, if they do.

    Returns
    -------
    dict or None

    Raises
    ------
    TypeError
        If it is anything else.
    """
    if variety is None:
        return None
    if not isinstance(variety, Variety):
        msg = f"variety must be a Variety or None, got {type(variety).__name__}"
        raise TypeError(msg)
    return _facts(variety)


def _facts(variety: Variety) -> _core._VarietyFacts:
    red, green, blue = variety.color
    return {
        "size": variety.size,
        "hue_deg": variety.hue_deg,
        "value": variety.value,
        "mirror": variety.mirror,
        "color": (red, green, blue),
        "seed": variety.seed,
    }
