"""Placed plants: which techniques stand where."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING

import numpy as np

from treelod import _core
from treelod.variety import variety_facts
from treelod.wind import wind_facts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from treelod.techniques.technique import Technique
    from treelod.variety import Variety
    from treelod.wind import Wind

__all__ = ["Scene", "scatter"]

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))
"""Turn from one copy to the next in `scatter`: neighbours never line up (Vogel 1979)."""


class Scene:
    """
    Techniques with the transforms of their copies; never changes.

    Copies outside the camera's frustum are not drawn. Opaque parts of all copies are drawn first,
    then the blended ones, copy by copy from the farthest to the nearest: copies whose crowns do
    not intersect are painted in the right order.

    Parameters
    ----------
    groups : sequence of (Technique, transforms)
        `transforms` has shape (N, 4, 4) or (4, 4): column-vector matrices from the plant's own
        world to the scene's, with a last row 0 0 0 1. None stands for one copy where the plant's
        file put it.
    wind : Wind, optional
        What moves the copies as time passes from camera to camera: see `Wind` and `Camera.at`.
        Default: none.
    variety : Variety, optional
        How copies differ in size, side and colour: see `Variety`. Default: not at all.

    Raises
    ------
    ValueError
        If transforms have another shape, are not finite, hold a number above 1e18 or flatten the
        plant.
    TypeError
        If something else than a technique is placed, or `wind` or `variety` is something else.
    LimitError
        If there are more than 2**28 copies.

    Examples
    --------
    >>> import numpy as np
    >>> import treelod as tl
    >>> tree = tl.FullMesh.build(tl.grow_plant("chestnut", leaf_count=20))
    >>> beside = np.eye(4)
    >>> beside[0, 3] = 12.0
    >>> tl.Scene([(tree, [np.eye(4), beside])]).instance_count
    2
    """

    def __init__(
        self,
        groups: Sequence[tuple[Technique, ArrayLike | None]],
        *,
        wind: Wind | None = None,
        variety: Variety | None = None,
    ) -> None:
        pairs = []
        for technique, transforms in groups:
            if not isinstance(getattr(technique, "_core", None), _core.Representation):
                msg = f"a scene is made of built techniques, got {type(technique).__name__}"
                raise TypeError(msg)
            matrices = np.eye(4) if transforms is None else np.asarray(transforms, np.float64)
            if matrices.ndim == 2:
                matrices = matrices[np.newaxis]
            if matrices.ndim != 3 or matrices.shape[1:] != (4, 4):
                msg = f"transforms must have shape (N, 4, 4), got {matrices.shape}"
                raise ValueError(msg)
            pairs.append((technique._core, np.ascontiguousarray(matrices)))
        self._core = _core.Scene(
            pairs,
            wind=wind_facts(wind),
            variety=variety_facts(variety),
        )

    @property
    def instance_count(self) -> int:
        """Copies of all techniques."""
        return self._core.instance_count

    @property
    def bounds(self) -> NDArray[np.float64] | None:
        """Lowest and highest corner, in metres, around all copies wherever wind may move them."""
        box = self._core.bounds
        return None if box is None else np.array(box)

    def __repr__(self) -> str:
        return f"Scene({self.instance_count} copies)"


def scatter(
    count: int, spacing: float, *, seed: int = 0, about: Sequence[float] = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """
    Place copies of a plant on level ground, loosely and at random, the first where it stands.

    Fewer copies are the first of more copies, so that a grove grows at its edge.

    Parameters
    ----------
    count : int
        Copies, at least 0.
    spacing : float
        About how far neighbours are apart, in metres, above 0: no two are nearer than half of it.
    seed : int, default 0
        Of shifts and turns, at least 0.
    about : sequence of 3 floats, default (0, 0, 0)
        A point of the vertical axis about which each copy is turned, and which is put in its place.

    Returns
    -------
    ndarray of shape (count, 4, 4), dtype float64
        Transforms for `Scene`. They turn and move copies, and change neither height nor size.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> import treelod as tl
    >>> tree = tl.FullMesh.build(tl.grow_plant("chestnut", leaf_count=20))
    >>> tl.Scene([(tree, tl.scatter(5, spacing=10.0))]).instance_count
    5
    """
    if operator.index(count) < 0:
        msg = f"count must be at least 0, got {count}"
        raise ValueError(msg)
    if not 0.0 < spacing < np.inf:
        msg = f"spacing must be above 0 and finite, got {spacing}"
        raise ValueError(msg)
    if operator.index(seed) < 0:
        msg = f"seed must be at least 0, got {seed}"
        raise ValueError(msg)
    axis = np.asarray(about, np.float64)
    if axis.shape != (3,) or not np.isfinite(axis).all():
        msg = f"about must be three finite numbers, got {about}"
        raise ValueError(msg)
    index = np.arange(count)
    # a row of random numbers each, so that the first ones are the same for any count
    radius, direction, turn = np.random.default_rng(seed).random((count, 3)).T
    place = 0.65 * spacing * np.sqrt(index) * np.exp(1j * GOLDEN_ANGLE * index)
    # the first one does not move
    place += (index > 0) * 0.15 * spacing * np.sqrt(radius) * np.exp(2j * np.pi * direction)
    angle = (index > 0) * 2.0 * np.pi * turn
    cos, sin = np.cos(angle), np.sin(angle)
    transforms = np.tile(np.eye(4), (count, 1, 1))
    transforms[:, 0, 0], transforms[:, 0, 2] = cos, sin
    transforms[:, 2, 0], transforms[:, 2, 2] = -sin, cos
    transforms[:, 0, 3] = axis[0] + place.real - (cos * axis[0] + sin * axis[2])
    transforms[:, 2, 3] = axis[2] + place.imag - (-sin * axis[0] + cos * axis[2])
    return transforms
