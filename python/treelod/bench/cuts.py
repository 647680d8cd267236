"""
How fast does a view-dependent crown follow a camera? From the last frame's leaves, or from scratch.

The camera moves by a hundredth of the crown's radius a frame. Both ways are timed inside the core
and end in the same list. The rate is of the entries of the active list: how many of them a frame
decides on in a second, most of them in whole blocks in which nothing can have changed.
"""

from __future__ import annotations

import statistics
from typing import TYPE_CHECKING

import numpy as np

from treelod import _core, criteria
from treelod.bench.collapse import crown
from treelod.bench.rows import Row, Timing
from treelod.cameras import Camera
from treelod.plants import Plant
from treelod.render import camera_facts
from treelod.techniques.foliage_hierarchy import FoliageHierarchy

if TYPE_CHECKING:
    from collections.abc import Iterator

    from treelod.criteria import Criterion

__all__ = ["rows"]

LEAF_COUNTS = (20_376, 1_000_000)
STEP_REL = 0.01
"""Of the crown's radius: how far the camera moves in a frame."""

FRAME_COUNT = 60


def rows(*, repeats: int, small: bool) -> Iterator[Row]:
    """
    Measure, crown by crown and criterion by criterion.

    Parameters
    ----------
    repeats : int
        Walks that are counted, at least 1.
    small : bool
        Few leaves, for tests.

    Yields
    ------
    Row
        Errors are rates: entries of the active list decided on in a second, followed and from
        scratch.
    """
    for leaf_count in (500, 2000) if small else LEAF_COUNTS:
        hierarchy = _hierarchy(leaf_count)
        positions = hierarchy.forest.positions
        center = (positions.min(axis=0) + positions.max(axis=0)) / 2
        radius = float(np.linalg.norm(positions - center, axis=1).max())
        zones: dict[str, Criterion] = {
            "screen size 8 px": criteria.screen_size(8),
            "coarse inside a sphere": criteria.sphere(center, 0.6 * radius),
            "fine before a plane": criteria.plane(center, (0, 0, 1)),
            "nearer than the middle": criteria.distance(2.5 * radius),
        }
        for label, zone in zones.items():
            yield _row(hierarchy, label, zone, center, radius, repeats)


def _hierarchy(leaf_count: int) -> FoliageHierarchy:
    corners = crown(leaf_count).reshape(-1, 3)
    first = 4 * np.arange(leaf_count, dtype=np.uint32)[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]], np.uint32)).reshape(-1, 3)
    plant = Plant.from_arrays(
        foliage={"positions": corners, "triangles": triangles},
        leaf_offsets=2 * np.arange(leaf_count + 1),
    )
    return FoliageHierarchy.build(plant, keep_coverage=False)


def _row(
    hierarchy: FoliageHierarchy,
    label: str,
    zone: Criterion,
    center: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    radius: float,
    repeats: int,
) -> Row:
    cameras = [
        Camera.perspective(
            (center + radius * np.array([step * STEP_REL, 0.2, 2.5])).tolist(),
            center.tolist(),
            size=(1024, 768),
        )
        for step in range(FRAME_COUNT)
    ]
    frames = _core.cut_times(
        hierarchy._hierarchy.stored(bytes(32), b""),
        zone._core(),
        [camera_facts(camera) for camera in cameras],
        origin=(0.0, 0.0, 0.0),
        rounds=repeats,
        threads=1,
    )
    # the first frame begins with the roots
    scratch = Timing.of([frame[0] * 1e-6 for frame in frames[1:]])
    followed = Timing.of([frame[1] * 1e-6 for frame in frames[1:]])
    active = statistics.median(frame[2] for frame in frames[1:])
    dirty = statistics.median(frame[3] for frame in frames[1:])
    return Row(
        group="collapse",
        case=(
            f"cut of {hierarchy.leaf_count} leaves, {label}: {active:.0f} active, "
            f"{dirty:.0f} changed a frame"
        ),
        ours_secs=followed,
        peer="ours, from scratch",
        peer_secs=scratch,
        ours_error=active / followed,
        peer_error=active / scratch,
        error_kind="entries of the active list a second",
    )
