"""
How fast do leaves collapse? Against scipy's clustering of their centres, and every pair every step.

``scipy.cluster.hierarchy.linkage(method="centroid")`` merges points two by two, the nearest first:
the same loop with a simpler distance and nothing to make of each pair. Growth is measured on crowns
of the same leaves at the same density, so that a crown of twice the leaves has twice the volume;
and once more in a crown that stays as large.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod import _core
from treelod.bench.rows import Row, interleaved
from treelod.collapse import LeafForest, collapse_leaves
from treelod.plants import grow_plant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

__all__ = ["crown", "rows"]

LEAF_COUNT = 20_376
"""Leaves of the paper's tree."""

NAIVE_COUNT = 2000

GROWTH = (20_376, 100_000, 300_000, 1_000_000)

SPEED_AIM = 100.0

GROWTH_AIM = 1.15
"""Exponent of cost evaluations over leaves."""

MEMORY = """
import sys
from pathlib import Path
import treelod as tl
from treelod.bench.collapse import crown

def kib(name):
    status = Path("/proc/self/status").read_text()
    return int(status.split(name + ":")[1].split()[0])

corners = crown(int(sys.argv[1]))
before = kib("VmRSS")
# the peak so far is forgotten
Path("/proc/self/clear_refs").write_text("5")
tl.collapse_leaves(corners, threads=1)
print(before, kib("VmHWM"))
"""


def crown(leaf_count: int, *, same_size: bool = False) -> NDArray[np.float32]:
    """
    Return the leaves of a grown chestnut, or as many of them at the same density.

    Parameters
    ----------
    leaf_count : int
        How many.
    same_size : bool, default False
        Whether a crown of more leaves is as large as the grown one, and so denser.

    Returns
    -------
    ndarray of shape (leaf_count, 4, 3), dtype float32
    """
    foliage = grow_plant("chestnut").foliage
    rng = np.random.default_rng(1)
    # along the same branches, as leaves of one plant are stored
    leaves = np.sort(rng.integers(0, foliage.leaf_count, leaf_count))
    spread = 1.0 if same_size else (leaf_count / foliage.leaf_count) ** (1 / 3)
    centers = foliage.centers[leaves].astype(np.float64)
    offsets = foliage.rectangles[leaves] - centers[:, None]
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    radius = np.linalg.norm(centers - middle, axis=1).max()
    # a little moved, so that no two are the same
    places = (centers - middle) * spread + rng.normal(0, 0.02 * radius * spread, centers.shape)
    corners: NDArray[np.float32] = (places[:, None] + offsets).astype(np.float32)
    return corners


def rows(*, repeats: int, small: bool) -> Iterator[Row]:
    """
    Measure, case by case.

    Parameters
    ----------
    repeats : int
        Rounds that are counted, at least 1.
    small : bool
        Few leaves, for tests.

    Yields
    ------
    Row
        Errors of growth are exponents; that of the peak memory is in bytes a leaf.

    Raises
    ------
    RuntimeError
        If the collapses are not those of the slow twin.
    """
    yield _against_scipy(1000 if small else LEAF_COUNT, repeats)
    yield _against_naive(200 if small else NAIVE_COUNT, repeats)
    counts = [count // 200 for count in GROWTH] if small else list(GROWTH)
    for same_size in (False, True):
        yield from _growth(counts, repeats, same_size=same_size)


def _against_scipy(leaf_count: int, repeats: int) -> Row:
    from scipy.cluster.hierarchy import linkage

    corners = crown(leaf_count)
    centers = corners.mean(axis=1).astype(np.float64)
    secs = interleaved(
        {
            "ours": partial(_ours, corners, 1, {}),
            "scipy": lambda: _nothing(linkage(centers, method="centroid")),
        },
        repeats=repeats,
    )
    return Row(
        group="collapse",
        case=f"whole hierarchy of {leaf_count} leaves, threads=1",
        ours_secs=secs["ours"],
        peer='scipy linkage(method="centroid") of their centres',
        peer_secs=secs["scipy"],
        aim=SPEED_AIM,
    )


def _against_naive(leaf_count: int, repeats: int) -> Row:
    corners = crown(leaf_count)
    found: dict[str, Any] = {}
    runs: dict[str, Callable[[], None]] = {"ours": partial(_ours, corners, 1, found)}
    ours = interleaved(runs, repeats=repeats)
    naive = interleaved({"naive": partial(_naive, corners, found)}, repeats=1, warmup=0)
    if not np.array_equal(found["ours"].children, found["naive"]["children"]):
        msg = "the slow twin collapses other leaves"
        raise RuntimeError(msg)
    return Row(
        group="collapse",
        case=f"whole hierarchy of {leaf_count} leaves, the same collapses, threads=1",
        ours_secs=ours["ours"],
        peer="the slow twin, every pair in every step",
        peer_secs=naive["naive"],
    )


def _growth(counts: list[int], repeats: int, *, same_size: bool) -> Iterator[Row]:
    found: dict[str, Any] = {}
    secs: dict[str, float] = {}
    for count in counts:
        corners = crown(count, same_size=same_size)
        runs: dict[str, Callable[[], None]] = {str(count): partial(_ours, corners, 1, found)}
        # the largest takes minutes to repeat
        secs |= interleaved(runs, repeats=min(repeats, 3), warmup=0)
        found[str(count)] = found.pop("ours").cost_count
    logs = np.log(counts)
    where = "in a crown of one size" if same_size else "at one density"
    case = f"growth {where}: {counts[-1]} leaves, threads=1"

    def row(values: list[float], kind: str, aim: float | None = None) -> Row:
        return Row(
            group="collapse",
            case=case if aim is None else f"{case}, exponent aim {aim}",
            ours_secs=secs[str(counts[-1])],
            peer=f"ours, {counts[0]} leaves",
            peer_secs=secs[str(counts[0])],
            ours_error=float(np.polyfit(logs, np.log(values), 1)[0]),
            error_kind=f"exponent of {kind} over leaves, fitted to {len(counts)} counts",
        )

    aim = None if same_size else GROWTH_AIM
    yield row([found[str(count)] for count in counts], "cost evaluations", aim)
    yield row([secs[str(count)] for count in counts], "time")
    if not same_size:
        yield Row(
            group="collapse",
            case=f"{case}, peak memory beyond the leaves' own",
            ours_secs=secs[str(counts[-1])],
            peer=f"ours, {counts[0]} leaves",
            peer_secs=secs[str(counts[0])],
            ours_error=_peak_bytes(counts[-1]) / counts[-1],
            error_kind="bytes a leaf",
        )


def _peak_bytes(leaf_count: int) -> int:
    """Memory that collapsing takes, in a process of its own."""
    command = [sys.executable, "-c", MEMORY, str(leaf_count)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ)
    before, after = (int(kib) for kib in printed.stdout.split())
    return (after - before) * 1024


def _ours(corners: NDArray[np.float32], threads: int, found: dict[str, LeafForest]) -> None:
    found["ours"] = collapse_leaves(corners, threads=threads)


def _naive(corners: NDArray[np.float32], found: dict[str, Any]) -> None:
    facts = {
        "distance": "centre",
        "weight": 1.0,
        "d_ref": None,
        "choice": "balanced",
        "keep_area": True,
        "target_leaf_count": 1,
        "max_cost": None,
    }
    areas = found["ours"].areas[: len(corners)].copy()
    found["naive"], _, _ = _core.collapse_leaves(
        corners.reshape(-1, 12), areas, facts, naive=True, threads=1
    )


def _nothing(_: object) -> None:
    """Drop a result, so that the timer times the call."""
