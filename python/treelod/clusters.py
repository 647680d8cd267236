"""
Which leaves lie near a common plane? K-means of leaves and planes, after Garcia et al. (2005).

`cluster_leaves` finds the groups, `plane_misses` shows where the paper's way to fit planes fails.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treelod import _core
from treelod.techniques.technique import number, whole

__all__ = ["LeafClustering", "PlaneMisses", "cluster_leaves", "plane_misses"]

MISSED = 1e-6
"""A plane whose error exceeds the best by more than this, of itself, is not the best. Two ways to
find the same eigenvector differ by less than 1e-9."""


class LeafClustering(NamedTuple):
    """
    Leaves in clusters, and a plane for each cluster.

    Attributes
    ----------
    cluster_ids : ndarray of shape (L,), dtype uint32
        Which cluster each leaf is in.
    planes : ndarray of shape (K, 4), dtype float64
        Unit normal and d of each cluster's plane, fitted to its leaves: the points p with
        ``p @ planes[k, :3] + planes[k, 3] == 0``. d is at least 0, in metres; where it is 0, the
        normal's first nonzero component is positive.
    errors : ndarray of shape (I,), dtype float64
        Error of all leaves after each turn, in square metres.
    iteration_count : int
        How many turns were taken.
    converged : bool
        Whether it ended before `max_iterations` did.
    """

    cluster_ids: NDArray[np.uint32]
    planes: NDArray[np.float64]
    errors: NDArray[np.float64]
    iteration_count: int
    converged: bool


def cluster_leaves(
    centers: ArrayLike,
    normals: ArrayLike,
    *,
    cluster_count: int,
    alpha: float,
    init: Literal["plus_plus", "random"] | ArrayLike = "plus_plus",
    seed: int = 0,
    restarts: int = 1,
    max_iterations: int = 100,
    eigen: Literal["exact", "paper"] = "exact",
    threads: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> LeafClustering:
    """
    Group leaves that lie near a common plane.

    The error of a leaf with centre p and normal n and of a plane with unit normal N is
    ``(p @ N + d)**2 + alpha * |n x N|**2``. Every leaf goes to its best plane, every plane is
    fitted to its leaves, in turns, until nothing changes. The result is the same on any number of
    threads.

    Parameters
    ----------
    centers : array_like of shape (L, 3)
        In metres; at least one. float32 is taken as it is. Anything else is brought near zero in
        float64 before it is stored in float32, so a crown may lie far away.
    normals : array_like of shape (L, 3)
        Of length 1 (within 1e-3), either sign; 0 for a leaf that faces no way.
    cluster_count : int
        Clusters to look for, in [1, 65536]. Fewer are found if all leaves lie in fewer planes, or
        if there are fewer leaves.
    alpha : float
        What a leaf at right angles to its plane weighs, in square metres; in [0, 1e12].
    init : {"plus_plus", "random"} or array_like, default "plus_plus"
        Where to start. "plus_plus": planes of leaves drawn with a probability in proportion to
        their error so far. "random": planes with uniform normals through the centres of uniformly
        drawn leaves, as in the paper. Shape (cluster_count, 4), float: these planes, as in
        `LeafClustering.planes`. Shape (L,), int in [0, cluster_count): this cluster for each leaf.
    seed : int, default 0
        What random starts are drawn with, in [0, 2**64).
    restarts : int, default 1
        How many random starts are tried, in [1, 65536]. The least error wins, of equals the
        earliest. 1 where `init` is an array.
    max_iterations : int, default 100
        Turns at most, in [1, 2**20].
    eigen : {"exact", "paper"}, default "exact"
        How planes are fitted. "paper" misses the best plane where `alpha` matters; see
        `plane_misses`.
    threads : int, optional
        By default ``TREELOD_NUM_THREADS``, else all cores.
    progress : callable, optional
        Called as ``progress(done, total)`` while it runs, in turns; what it raises ends the call.

    Returns
    -------
    LeafClustering

    Raises
    ------
    ValueError
        If an argument is out of range, not finite, or of another shape than stated.

    References
    ----------
    I. Garcia, M. Sbert, L. Szirmay-Kalos. Leaf Cluster Impostors for Tree Rendering with Parallax.
    2005.

    Examples
    --------
    >>> import treelod as tl
    >>> centers = [[0, 0, 0], [1, 0, 0], [0, 0, 3], [1, 0, 3]]
    >>> normals = [[0, 0, 1]] * 4
    >>> found = tl.cluster_leaves(centers, normals, cluster_count=2, alpha=1.0)
    >>> found.cluster_ids[0] == found.cluster_ids[1] != found.cluster_ids[2]
    np.True_
    >>> float(found.errors[-1])
    0.0
    """
    near, origin = _near_zero(centers)
    ids, planes, errors, converged = _core.cluster_leaves(
        near,
        _rows("normals", normals),
        cluster_count=whole("cluster_count", cluster_count, 0),
        alpha=number("alpha", alpha),
        init=_init(init, origin),
        seed=whole("seed", seed, 0, 2**64),
        restarts=whole("restarts", restarts, 0),
        max_iterations=whole("max_iterations", max_iterations, 0),
        eigen=eigen,
        threads=threads,
        progress=progress,
    )
    return LeafClustering(ids, _moved(planes, origin), errors, len(errors), converged)


@dataclass(frozen=True)
class PlaneMisses:
    """
    Best planes of clusters beside those that the paper's iteration finds.

    Attributes
    ----------
    leaf_count : ndarray of shape (K,), dtype uint64
        Leaves of each cluster.
    best_planes, paper_planes : ndarray of shape (K, 4), dtype float64
        As `LeafClustering.planes`.
    best_costs, paper_costs : ndarray of shape (K,), dtype float64
        Errors of the cluster's leaves, in square metres.
    ratio : ndarray of shape (K,), dtype float64
        Error of the paper's plane by that of the best; 1 where both are 0, infinite where only the
        best is.
    missed : ndarray of shape (K,), dtype bool
        Where the paper's plane is worse than the best by more than one part in a million.
    """

    leaf_count: NDArray[np.uint64]
    best_planes: NDArray[np.float64]
    paper_planes: NDArray[np.float64]
    best_costs: NDArray[np.float64]
    paper_costs: NDArray[np.float64]
    ratio: NDArray[np.float64]
    missed: NDArray[np.bool_]

    @property
    def missed_share(self) -> float:
        """Share of the clusters with leaves whose best plane was missed."""
        return float(self.missed[self.leaf_count > 0].mean())

    @property
    def total_ratio(self) -> float:
        """Error of all paper's planes by that of all best ones; 1 where both are 0."""
        return float(_ratio(self.paper_costs.sum(), self.best_costs.sum()))


def plane_misses(
    centers: ArrayLike, normals: ArrayLike, cluster_ids: ArrayLike, *, alpha: float
) -> PlaneMisses:
    """
    Show where the paper's iteration misses a cluster's best plane, and by how much.

    It finds the eigenvector whose eigenvalue is nearest to zero. The best plane's is the smallest,
    and once `alpha` matters that is often far below zero.

    Parameters
    ----------
    centers, normals : array_like of shape (L, 3)
        As in `cluster_leaves`.
    cluster_ids : array_like of int, shape (L,)
        Cluster of each leaf, in [0, 65536).
    alpha : float
        As in `cluster_leaves`.

    Returns
    -------
    PlaneMisses
        One row a cluster, up to the largest id.

    Raises
    ------
    ValueError
        As `cluster_leaves`.

    Examples
    --------
    Two leaves that face along x. The best plane does too; the paper's lies across them.

    >>> import treelod as tl
    >>> centers, normals = [[0, 0, 0], [0, 0, 1]], [[1, 0, 0], [1, 0, 0]]
    >>> tl.plane_misses(centers, normals, [0, 0], alpha=2.0).missed
    array([ True])
    """
    near, origin = _near_zero(centers)
    ids = _ids("cluster_ids", cluster_ids)
    counts, planes, best, paper = _core.plane_misses(
        near,
        _rows("normals", normals),
        ids,
        cluster_count=int(ids.max(initial=0)) + 1,
        alpha=alpha,
    )
    ratio = _ratio(paper, best)
    best_planes, paper_planes = (_moved(rows, origin) for rows in planes)
    return PlaneMisses(
        counts, best_planes, paper_planes, best, paper, ratio, missed=ratio > 1 + MISSED
    )


def _ratio(paper: NDArray[np.float64], best: NDArray[np.float64]) -> NDArray[np.float64]:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(paper == best, 1.0, np.asarray(paper) / best)


def _rows(name: str, array: ArrayLike) -> NDArray[np.float32]:
    rows = np.asarray(array)
    _check_shape(name, rows)
    with np.errstate(over="ignore"):  # the core refuses infinity
        return np.ascontiguousarray(rows, dtype=np.float32)


def _check_shape(name: str, rows: NDArray[np.generic]) -> None:
    if rows.ndim != 2 or rows.shape[1] != 3:
        msg = f"{name} must have shape (L, 3), got {rows.shape}"
        raise ValueError(msg)
    if not np.issubdtype(rows.dtype, np.floating) and not np.issubdtype(rows.dtype, np.integer):
        msg = f"{name} must be real numbers, got {rows.dtype}"
        raise ValueError(msg)


def _near_zero(centers: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Centres in float32, and what was subtracted from them."""
    rows = np.asarray(centers)
    _check_shape("centers", rows)
    if rows.dtype == np.float32 or not len(rows):
        return _rows("centers", rows), np.zeros(3)
    wide = rows.astype(np.float64)
    with np.errstate(invalid="ignore"):  # the core refuses what is not finite
        origin = wide.min(axis=0) / 2 + wide.max(axis=0) / 2
        if not np.isfinite(origin).all():
            origin = np.zeros(3)
        return _rows("centers", wide - origin), origin


def _moved(planes: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Planes relative to `origin` as planes relative to zero, with the sign that planes have."""
    moved = planes.copy()
    moved[:, 3] -= planes[:, :3] @ origin
    ordered = moved[:, [3, 0, 1, 2]]
    first = ordered[np.arange(len(moved)), (ordered != 0).argmax(axis=1)]
    moved[first < 0] *= -1
    return moved + 0.0  # no -0


def _ids(name: str, array: ArrayLike) -> NDArray[np.uint32]:
    ids = np.asarray(array)
    if ids.ndim != 1:
        msg = f"{name} must have shape (L,), got {ids.shape}"
        raise ValueError(msg)
    if ids.size and not np.issubdtype(ids.dtype, np.integer):
        msg = f"{name} must be integers, got {ids.dtype}"
        raise ValueError(msg)
    if ids.size and (ids.min() < 0 or ids.max() >= 2**16):
        msg = f"{name} must be in [0, 65536), got {ids.min()} to {ids.max()}"
        raise ValueError(msg)
    return np.ascontiguousarray(ids, dtype=np.uint32)


def _init(init: str | ArrayLike, origin: NDArray[np.float64]) -> str | NDArray[np.generic]:
    """Bring a start to what the core takes; planes relative to `origin`."""
    if isinstance(init, str):
        return init
    start = np.asarray(init)
    if start.ndim == 1 and np.issubdtype(start.dtype, np.integer):
        return _ids("init", start)
    if start.ndim != 2 or start.shape[1] != 4:
        msg = (
            'init must be "plus_plus", "random", planes of shape (cluster_count, 4) or integers of '
            f"shape (L,), got {start.dtype} of shape {start.shape}"
        )
        raise ValueError(msg)
    planes = np.array(start, dtype=np.float64, order="C")
    planes[:, 3] += planes[:, :3] @ origin
    return planes
