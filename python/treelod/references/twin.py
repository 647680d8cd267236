"""
Whether a picture of triangles is right up to its snapping: the definition, in f64.

Corners are snapped to 1/256 pixel, so a rasteriser may show at a point whatever the exact picture
shows within one step of it, and nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.cameras import Camera

__all__ = ["SNAP_PX", "Projected", "is_exact_within_a_step", "project"]

SNAP_PX = 1.0 / 256.0
"""
One step of the grid of corners. A corner moves by half a step along each axis, so an edge by at
most 0.71 steps; the rest is room for rounding of pixels in f32 (0.03 steps at 1024 pixels).
"""

ROUNDING_REL = 1e-6
"""Rounding of depths in f32, as a share of the plant's size."""


class Projected(NamedTuple):
    """
    Triangles on a picture.

    Attributes
    ----------
    points : ndarray of shape (T, 3, 2)
        Corners in pixels.
    keys : ndarray of shape (T, 3)
        Depth (parallel views) or 1 / depth: linear on the picture.
    perspective : bool
        Which of the two.
    """

    points: NDArray[np.float64]
    keys: NDArray[np.float64]
    perspective: bool


def project(corners: NDArray[np.float64], camera: Camera) -> Projected:
    """
    Project triangles in f64.

    Parameters
    ----------
    corners : ndarray of shape (T, 3, 3)
        World positions, all in front of the eye.
    camera : Camera
        From where.

    Returns
    -------
    Projected
    """
    placed = camera.project(corners.reshape(-1, 3)).reshape(-1, 3, 3)
    depths = placed[..., 2]
    keys = 1.0 / depths if camera.is_perspective else depths
    return Projected(placed[..., :2], keys, camera.is_perspective)


def is_exact_within_a_step(
    scene: Projected, points: NDArray[np.float64], ids: NDArray[np.int64], *, size: float
) -> NDArray[np.bool_]:
    """
    Say for points of a picture whether what it shows there is within one step of the truth.

    Parameters
    ----------
    scene : Projected
        All triangles.
    points : ndarray of shape (N, 2)
        Pixels.
    ids : ndarray of shape (N,)
        Triangle that the picture shows there; negative for none.
    size : float
        The plant's size in metres, for the rounding of depths.

    Returns
    -------
    ndarray of shape (N,), dtype bool
        False where the triangle shown does not reach to within a step of the point, or where
        another one that covers the point and a step around it is nearer than slopes and rounding
        allow.
    """
    low = scene.points.min(axis=1) - 2.0 * SNAP_PX
    high = scene.points.max(axis=1) + 2.0 * SNAP_PX
    result = np.empty(len(points), np.bool_)
    for index, (point, shown) in enumerate(zip(points, ids, strict=True)):
        near = np.flatnonzero(((low <= point) & (point <= high)).all(axis=1))
        inside = _inside(scene.points[near], point)
        depth, slack = _depths(scene.points[near], scene.keys[near], point, scene.perspective)
        covers = inside > SNAP_PX
        if shown < 0:
            result[index] = not covers.any()
            continue
        at = np.flatnonzero(near == shown)
        if not len(at) or inside[at[0]] < -SNAP_PX:
            result[index] = False
            continue
        farthest = depth[at[0]] - slack[at[0]] - ROUNDING_REL * size
        result[index] = not (covers & (depth + slack < farthest)).any()
    return result


def _inside(triangles: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of a point from the nearest edge of each triangle, negative outside."""
    start = triangles
    along = np.roll(triangles, -1, axis=1) - start
    to_point = point - start
    length_sq = (along**2).sum(axis=2)
    shares = (to_point * along).sum(axis=2) / np.where(length_sq > 0.0, length_sq, 1.0)
    nearest = to_point - np.clip(shares, 0.0, 1.0)[..., np.newaxis] * along
    distance = np.sqrt((nearest**2).sum(axis=2)).min(axis=1)
    sides = along[..., 0] * to_point[..., 1] - along[..., 1] * to_point[..., 0]
    within = (sides > 0.0).all(axis=1) | (sides < 0.0).all(axis=1)
    return np.asarray(np.where(within, distance, -distance))


def _depths(
    triangles: NDArray[np.float64],
    keys: NDArray[np.float64],
    point: NDArray[np.float64],
    perspective: bool,  # noqa: FBT001
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depth of each triangle's plane at a point, and how much it changes over one step."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    twice_area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    rise = keys[:, 1:] - keys[:, :1]
    with np.errstate(divide="ignore", invalid="ignore"):
        slope_x = (rise[:, 0] * second[:, 1] - rise[:, 1] * first[:, 1]) / twice_area
        slope_y = (rise[:, 1] * first[:, 0] - rise[:, 0] * second[:, 0]) / twice_area
        offset = point - triangles[:, 0]
        key = keys[:, 0] + slope_x * offset[:, 0] + slope_y * offset[:, 1]
        step = SNAP_PX * np.hypot(slope_x, slope_y)
    # a triangle seen edge on has any of its depths
    lowest, highest = keys.min(axis=1), keys.max(axis=1)
    flat = ~np.isfinite(key + step)
    key = np.clip(np.where(flat, 0.5 * (lowest + highest), key), lowest, highest)
    step = np.minimum(np.where(flat, np.inf, step), highest - lowest)
    if perspective:
        return 1.0 / key, step / key**2
    return key, step
