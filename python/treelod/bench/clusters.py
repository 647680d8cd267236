"""
How fast are leaves clustered? K-means of leaves and planes, against scikit-learn's k-means.

scikit-learn clusters points, not planes: each leaf is a point of six numbers, its centre over the
crown radius R and its normal times sqrt(alpha) / R, in float32. That is a simpler problem of the
same size: as many leaves, clusters and turns, from the same leaves. Its clusters are then given
our planes, and the errors of both are in the rows. Ours is called from Python like scikit-learn.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from treelod import _core
from treelod.bench.rows import Row, interleaved
from treelod.clusters import plane_misses
from treelod.plants import grow_plant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

__all__ = ["rows"]

THREADS = (1, 2)
ALPHA_REL = 0.1
JITTER = 0.02
"""Of the crown radius: how far copies of the chestnut's leaves are moved where more are wanted."""


class _Size(NamedTuple):
    leaf_count: int | None
    turns: int
    naive_turns: int
    run_aim: float
    pass_aim: float


SIZES = (_Size(None, 50, 50, 10.0, 3.0), _Size(1_000_000, 50, 1, 4.0, 2.0))
"""Sizes: the grown chestnut as it is, and a crown of its leaves, again and again. Turns are fewer
than either needs to end, so that both take as many."""

SMALL = (_Size(None, 4, 4, 10.0, 3.0), _Size(3000, 3, 1, 4.0, 2.0))

PLANE_COUNTS = (32, 128)
GROWTH = (10_000, 30_000, 100_000, 300_000, 1_000_000)


class Crown(NamedTuple):
    """Leaves, and the crown radius."""

    centers: NDArray[np.float32]
    normals: NDArray[np.float32]
    radius: float

    @classmethod
    def grown(cls, leaf_count: int | None = None) -> Crown:
        """Return the leaves of a grown chestnut."""
        foliage = grow_plant("chestnut", leaf_count=leaf_count).foliage
        middle = (foliage.centers.min(axis=0) + foliage.centers.max(axis=0)) / 2
        radius = np.linalg.norm(foliage.centers - middle, axis=1).max()
        return cls(foliage.centers, foliage.normals, float(radius))

    def repeated(self, leaf_count: int) -> Crown:
        """Return as many leaves, drawn from these and moved a little, along the same branches."""
        rng = np.random.default_rng(1)
        leaves = np.sort(rng.integers(0, len(self.centers), leaf_count))
        moved = rng.normal(0, JITTER * self.radius, (leaf_count, 3))
        centers = (self.centers[leaves] + moved).astype(np.float32)
        return Crown(centers, self.normals[leaves], self.radius)

    @property
    def alpha(self) -> float:
        """Weight of angles, in square metres."""
        return ALPHA_REL * self.radius**2

    def start(self, plane_count: int) -> NDArray[np.intp]:
        """Return the leaves that everybody starts from."""
        rng = np.random.default_rng(2)
        return rng.choice(len(self.centers), plane_count, replace=False)

    def planes(self, leaves: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the planes of leaves."""
        normals = self.normals[leaves].astype(np.float64)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        d = -(self.centers[leaves] * normals).sum(axis=1, keepdims=True)
        return np.hstack([normals, d])

    def points(self) -> NDArray[np.float32]:
        """Return what scikit-learn clusters: shape (L, 6)."""
        normals = np.sqrt(ALPHA_REL) * self.normals
        return np.hstack([self.centers / self.radius, normals]).astype(np.float32)

    def error(self, ids: NDArray[Any]) -> float:
        """Return the mean error of clusters and their best planes, by R^2."""
        misses = plane_misses(self.centers, self.normals, ids, alpha=self.alpha)
        return float(misses.best_costs.sum()) / len(ids) / self.radius**2


def rows(*, repeats: int, small: bool) -> Iterator[Row]:
    """
    Measure, case by case.

    Parameters
    ----------
    repeats : int
        Rounds that are counted, at least 1.
    small : bool
        Few leaves and turns, for tests.

    Yields
    ------
    Row
        Errors are of the ids at the end, by R^2 and leaf; those of growth are exponents.

    Raises
    ------
    ImportError
        If the extra ``bench`` is not installed.
    RuntimeError
        If ids are not those of the slow twin.
    """
    try:
        import sklearn.cluster  # noqa: F401
    except ImportError as missing:
        msg = "the clustering benchmark needs scikit-learn: pip install 'treelod[bench]'"
        raise ImportError(msg) from missing
    grown = Crown.grown(500 if small else None)
    for size in SMALL if small else SIZES:
        crown = grown if size.leaf_count is None else grown.repeated(size.leaf_count)
        for plane_count in PLANE_COUNTS:
            for threads in THREADS:
                yield from _compared(crown, size, plane_count, threads, repeats)
    yield _growth(grown, [count // 100 for count in GROWTH] if small else GROWTH, repeats)


def _compared(
    crown: Crown, size: _Size, plane_count: int, threads: int, repeats: int
) -> Iterator[Row]:
    ids: dict[str, NDArray[Any]] = {}
    leaves = crown.start(plane_count)
    planes = crown.planes(leaves)
    runs: dict[str, Callable[[], None]] = {
        way: partial(_ours, crown, planes, way, size.turns, threads, ids)
        for way in ("pruned", "full")
    }
    points = crown.points()
    runs["sklearn"] = partial(_sklearn, points, points[leaves], size.turns, threads, ids)
    secs = interleaved(runs, repeats=repeats)
    naive = partial(_ours, crown, planes, "naive", size.naive_turns, 1, ids)
    alone = partial(_ours, crown, planes, "pruned", size.naive_turns, threads, ids)
    errors = {way: crown.error(ids[way]) for way in ("pruned", "sklearn")}
    if not np.array_equal(ids["pruned"], ids["full"]):
        msg = "pruned and full passes give other ids"
        raise RuntimeError(msg)
    slow = interleaved({"naive": naive, "ours": alone}, repeats=1, warmup=0)
    if not np.array_equal(ids["pruned"], ids["naive"]):
        msg = "the slow twin gives other ids"
        raise RuntimeError(msg)
    case = f"{len(points)} leaves, {plane_count} planes, threads={threads}"
    row = partial(Row, group="clusters")
    whole, one = f"{case}, {size.turns} turns", f"{case}, a turn without pruning"
    yield row(
        case=whole,
        ours_secs=secs["pruned"],
        peer="scikit-learn KMeans, lloyd",
        peer_secs=secs["sklearn"],
        ours_error=errors["pruned"],
        peer_error=errors["sklearn"],
        error_kind="mean error of leaf and best plane, by R^2",
        aim=size.run_aim,
    )
    yield row(
        case=one,
        ours_secs=secs["full"] / size.turns,
        peer="scikit-learn KMeans, lloyd",
        peer_secs=secs["sklearn"] / size.turns,
        aim=size.pass_aim,
    )
    ops, rate = _core.vector_peak()
    yield row(
        case=one,
        ours_secs=secs["full"] / size.turns,
        peer=f"bound: {ops} operations a pair at {rate / 1e9:.0f} G/s and thread",
        peer_secs=len(points) * plane_count * ops / rate / threads,
    )
    yield row(
        case=f"{case}, {size.naive_turns} turns, the same ids",
        ours_secs=slow["ours"],
        peer="the slow twin, 64 bits, threads=1",
        peer_secs=slow["naive"],
    )


def _ours(
    crown: Crown,
    planes: NDArray[np.float64],
    method: str,
    turns: int,
    threads: int,
    ids: dict[str, NDArray[Any]],
) -> None:
    ids[method], *_ = _core.cluster_leaves(
        crown.centers,
        crown.normals,
        cluster_count=len(planes),
        alpha=crown.alpha,
        init=planes,
        seed=0,
        restarts=1,
        max_iterations=turns,
        eigen="exact",
        method=method,
        threads=threads,
    )


def _sklearn(
    points: NDArray[np.float32],
    start: NDArray[np.float32],
    turns: int,
    threads: int,
    ids: dict[str, NDArray[Any]],
) -> None:
    from sklearn.cluster import KMeans
    from threadpoolctl import threadpool_limits

    with threadpool_limits(threads):
        model = KMeans(len(start), init=start, n_init=1, max_iter=turns, tol=0, algorithm="lloyd")
        ids["sklearn"] = model.fit(points).labels_.astype(np.uint32)


def _growth(grown: Crown, counts: list[int] | tuple[int, ...], repeats: int) -> Row:
    """Time of ten turns with 32 planes, by leaves."""
    turns, plane_count, ids = 10, PLANE_COUNTS[0], dict[str, Any]()
    runs: dict[str, Callable[[], None]] = {}
    for count in counts:
        crown = grown.repeated(count)
        planes = crown.planes(crown.start(plane_count))
        runs[str(count)] = partial(_ours, crown, planes, "pruned", turns, 1, ids)
    secs = interleaved(runs, repeats=repeats)
    exponent = np.polyfit(np.log(counts), np.log([secs[str(count)] for count in counts]), 1)[0]
    return Row(
        group="clusters",
        case=f"growth: {counts[-1]} leaves, {plane_count} planes, {turns} turns, threads=1",
        ours_secs=secs[str(counts[-1])],
        peer=f"ours, {counts[0]} leaves",
        peer_secs=secs[str(counts[0])],
        ours_error=float(exponent),
        error_kind=f"exponent of time over leaves, fitted to {len(counts)} counts",
    )
