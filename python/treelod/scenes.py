"""Placed plants: which techniques stand where."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from treelod import _core

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from treelod.techniques.technique import Technique

__all__ = ["Scene"]


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

    Raises
    ------
    ValueError
        If transforms have another shape, are not finite, hold a number above 1e18 or flatten the
        plant.
    TypeError
        If something else than a technique is placed.
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

    def __init__(self, groups: Sequence[tuple[Technique, ArrayLike | None]]) -> None:
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
        self._core = _core.Scene(pairs)

    @property
    def instance_count(self) -> int:
        """Copies of all techniques."""
        return self._core.instance_count

    @property
    def bounds(self) -> NDArray[np.float64] | None:
        """Lowest and highest corner of the box around all copies, shape (2, 3), in metres."""
        box = self._core.bounds
        return None if box is None else np.array(box)

    def __repr__(self) -> str:
        return f"Scene({self.instance_count} copies)"
