"""
Which leaves become one? Leaves collapse two by two, the cheapest pair first, into a forest.

`collapse_leaves` does it for any quads; `FoliageHierarchy` does it for a plant, and draws it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from treelod import _core
from treelod.render import thread_count
from treelod.techniques.technique import flag, number, text, whole

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

__all__ = ["LeafForest", "collapse_leaves"]

MAX_AREA = 1e36
"""Square metres of a leaf: the square of the largest coordinate."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LeafForest:
    """
    Leaves, and what they collapse into.

    Nodes 0 to L - 1 are the leaves. Node L + t is what collapse t made of two others, so that the
    first L + t nodes without a parent among them are the crown after t collapses.

    Attributes
    ----------
    positions : ndarray of shape (4 L, 3), dtype float64
        Corners of the leaves in metres: leaf i has rows 4 i to 4 i + 3.
    vertices : ndarray of shape (N, 4), dtype uint32
        Corners of each node, in order around it, as rows of `positions`. A node is the triangles
        (0, 1, 2) and (0, 2, 3).
    children : ndarray of shape (N, 2), dtype int64
        What each node was made of, the lower index first; -1 for leaves.
    parents : ndarray of shape (N,), dtype int64
        What each node collapses into; -1 for the roots.
    costs : ndarray of shape (N - L,), dtype float64
        Cost of each collapse, in order.
    areas : ndarray of shape (N,), dtype float64
        Square metres of all leaves below each node.
    scales : ndarray of shape (N,), dtype float32
        By which each node is drawn larger than its corners say, about its centre.
    texture_corners : ndarray of shape (N, 2), dtype uint32
        The leaf whose texture coordinates each node has, and by how many corners it is turned: its
        corner k has those of the leaf's corner (k + turn) % 4.
    balls : ndarray of shape (N, 4), dtype float64
        Centre and radius in metres of a ball around each node and all below it, as drawn.
    cost_count : int
        How many costs were computed.
    d_ref : float
        Distance in metres at which two parallel leaves cost 1.
    """

    positions: NDArray[np.float64]
    vertices: NDArray[np.uint32]
    children: NDArray[np.int64]
    parents: NDArray[np.int64]
    costs: NDArray[np.float64]
    areas: NDArray[np.float64]
    scales: NDArray[np.float32]
    texture_corners: NDArray[np.uint32]
    balls: NDArray[np.float64]
    cost_count: int
    d_ref: float

    def __repr__(self) -> str:
        return f"LeafForest({self.leaf_count} leaves, {self.root_count} roots)"

    @property
    def leaf_count(self) -> int:
        """Leaves at the finest level, L."""
        return len(self.positions) // 4

    @property
    def root_count(self) -> int:
        """Quads at the coarsest level, R."""
        return self.leaf_count - len(self.costs)

    def quads(self, *, drawn: bool = True) -> NDArray[np.float64]:
        """
        Corners of all nodes in metres.

        Parameters
        ----------
        drawn : bool, default True
            Scaled as they are drawn; else on the leaves' own corners.

        Returns
        -------
        ndarray of shape (N, 4, 3), dtype float64
        """
        quads: NDArray[np.float64] = self.positions[self.vertices]
        if not drawn:
            return quads
        first, second = _triangle_areas(quads)
        area = first + second
        a, b, c, d = quads.transpose(1, 0, 2)
        with np.errstate(invalid="ignore", divide="ignore"):
            centers = (a + b + c) * first[:, None] + (a + c + d) * second[:, None]
            centers = centers / (3.0 * area)[:, None]
        centers = np.where((area > 0.0)[:, None], centers, quads.mean(axis=1))
        scaled = (quads - centers[:, None]) * self.scales[:, None, None]
        moved: NDArray[np.float64] = centers[:, None] + scaled
        return moved

    def level(self, *, leaf_count: int) -> NDArray[np.int64]:
        """
        Nodes of the crown after some collapses.

        Parameters
        ----------
        leaf_count : int
            How many quads are left, between `root_count` and L.

        Returns
        -------
        ndarray of shape (leaf_count,), dtype int64
            In ascending order.

        Raises
        ------
        ValueError
            If `leaf_count` is out of range.
        """
        count = whole("leaf_count", leaf_count, self.root_count, self.leaf_count + 1)
        made = 2 * self.leaf_count - count
        parents = self.parents[:made]
        return np.flatnonzero((parents < 0) | (parents >= made))

    @cached_property
    def area_drifts(self) -> NDArray[np.float64]:
        """
        Area of each collapsed node by that of the leaves below it, minus 1, shape (N - L,).

        Of the node before it is scaled; NaN where the leaves have no area.
        """
        areas = np.add(*_triangle_areas(self.quads(drawn=False)[self.leaf_count :]))
        below = self.areas[self.leaf_count :]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(below > 0.0, areas / below - 1.0, np.nan)

    @cached_property
    def planarities(self) -> NDArray[np.float64]:
        """
        How flat each collapsed node is, shape (N - L,): 1 is flat, 0 is folded together.

        Length of its area vector by its area; NaN where it has none.
        """
        quads = self.quads(drawn=False)[self.leaf_count :]
        a, b, c, d = quads.transpose(1, 0, 2)
        across = np.linalg.norm(np.cross(c - a, d - b), axis=1) / 2.0
        areas = np.add(*_triangle_areas(quads))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(areas > 0.0, across / areas, np.nan)


def _triangle_areas(
    quads: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    a, b, c, d = quads.transpose(1, 0, 2)
    first = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    return first, np.linalg.norm(np.cross(c - a, d - a), axis=1) / 2.0


def collapse_facts(
    *,
    distance: str,
    weight: float,
    d_ref: float | None,
    choice: str,
    keep_area: bool,
    target_leaf_count: int,
    max_cost: float | None,
) -> dict[str, Any]:
    """Return how leaves collapse as the core takes it; see `collapse_leaves`."""
    return {
        "distance": text("distance", distance),
        "weight": number("weight", weight),
        "d_ref": None if d_ref is None else number("d_ref", d_ref),
        "choice": text("choice", choice),
        "keep_area": flag("keep_area", keep_area),
        "target_leaf_count": whole("target_leaf_count", target_leaf_count),
        "max_cost": None if max_cost is None else number("max_cost", max_cost),
    }


def collapse_leaves(
    corners: ArrayLike,
    areas: ArrayLike | None = None,
    *,
    distance: Literal["centre", "hausdorff"] = "centre",
    weight: float = 1.0,
    d_ref: float | None = None,
    choice: Literal["balanced", "paper"] = "balanced",
    keep_area: bool = True,
    target_leaf_count: int = 1,
    max_cost: float | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> LeafForest:
    """
    Collapse quads two by two, the cheapest pair first.

    The cost of a pair is ``(d / d_ref)**2 + weight * |n_i x n_j|**2``, d the distance between the
    two and n their unit normals. Each step takes the true minimum over all pairs, of equals the one
    of lowest indices. The new quad has two corners of each of its parents. The result is the same
    on any number of threads.

    Parameters
    ----------
    corners : array_like of shape (L, 4, 3)
        Corners in metres, in order around each quad, which is cut along corners 0 and 2. float32 is
        taken as it is. Anything else is brought near zero in float64 before it is stored in
        float32, so a crown may lie far away.
    areas : array_like of shape (L,), optional
        Square metres that each quad stands for, in [0, 1e36]. Default: its own area.
    distance : {'centre', 'hausdorff'}, default 'centre'
        Between centroids, or of the corner that is farthest from the other quad, both ways.
    weight : float, default 1.0
        Of the second term, at least 0.
    d_ref : float, optional
        Metres, in [1e-100, 1e100]. Default: the side of a square of the mean area; 1 if there is
        no area.
    choice : {'balanced', 'paper'}, default 'balanced'
        What the new quad is chosen for among those that do not cross themselves. 'balanced': the
        least ``|S - T| / T + (1 - V / S)``, S its area, T that of the leaves below, V the length of
        its area vector. 'paper': the least ``|S - T|``, of equals the flattest.
    keep_area : bool, default True
        Whether nodes are scaled to the area of the leaves below them.
    target_leaf_count : int, default 1
        Where to stop, at least 1.
    max_cost : float, optional
        No pair that costs more collapses. Default: all do.
    threads : int, optional
        By default ``TREELOD_NUM_THREADS``, else all cores. Only the first search uses several.
    progress : callable, optional
        Called as ``progress(done, total)`` while it runs; what it raises ends the call.

    Returns
    -------
    LeafForest

    Raises
    ------
    ValueError
        If an argument is out of range, not finite, or of another shape than stated.

    References
    ----------
    I. Remolar, M. Chover, O. Belmonte, J. Ribelles, C. Rebollo. Geometric Simplification of
    Foliage. Eurographics 2002, short presentations.

    Examples
    --------
    Two squares that touch become the rectangle around both.

    >>> import treelod as tl
    >>> square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    >>> moved = [[x + 1, y, z] for x, y, z in square]
    >>> forest = tl.collapse_leaves([square, moved])
    >>> forest.quads()[2].tolist()
    [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
    >>> forest.costs.tolist()
    [1.0]
    """
    facts = collapse_facts(
        distance=distance,
        weight=weight,
        d_ref=d_ref,
        choice=choice,
        keep_area=keep_area,
        target_leaf_count=target_leaf_count,
        max_cost=max_cost,
    )
    near, origin = _near_zero(corners)
    found, cost_count, d_ref_used = _core.collapse_leaves(
        near.reshape(-1, 12),
        _areas(areas, near),
        facts,
        threads=thread_count(threads),
        progress=progress,
    )
    found["positions"] += origin
    found["balls"][:, :3] += origin
    return LeafForest(**found, cost_count=cost_count, d_ref=d_ref_used)


def _near_zero(corners: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Corners in float32, and what was subtracted from them."""
    given = np.asarray(corners)
    if given.ndim != 3 or given.shape[1:] != (4, 3):
        msg = f"corners must have shape (L, 4, 3), got {given.shape}"
        raise ValueError(msg)
    if given.dtype.kind not in "iuf":
        msg = f"corners must be real numbers, got {given.dtype}"
        raise ValueError(msg)
    wide = given.astype(np.float64)
    if not np.isfinite(wide).all():
        msg = "corners must be finite"
        raise ValueError(msg)
    origin = np.zeros(3)
    if given.dtype != np.float32 and len(wide):
        origin = wide.min(axis=(0, 1)) / 2 + wide.max(axis=(0, 1)) / 2
    with np.errstate(over="ignore"):
        near = np.ascontiguousarray(wide - origin, dtype=np.float32)
    if not np.isfinite(near).all():
        msg = "corners must fit into float32"
        raise ValueError(msg)
    return near, origin


def _areas(areas: ArrayLike | None, corners: NDArray[np.float32]) -> NDArray[np.float64]:
    if areas is None:
        return np.add(*_triangle_areas(corners.astype(np.float64)))
    given = np.asarray(areas)
    if given.shape != (len(corners),) or given.dtype.kind not in "iuf":
        msg = (
            f"areas must be real numbers of shape ({len(corners)},), "
            f"got {given.dtype} of shape {given.shape}"
        )
        raise ValueError(msg)
    wide = np.ascontiguousarray(given, dtype=np.float64)
    if not ((wide >= 0.0) & (wide <= MAX_AREA)).all():
        msg = f"areas must be in [0, {MAX_AREA:g}]"
        raise ValueError(msg)
    return wide
