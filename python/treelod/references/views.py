"""The views that a plant is checked in, and the rays through their pixels, by the definition."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.cameras import Camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.plants import Plant

__all__ = ["bands", "camera_settings", "check_cameras", "pixel_rays", "sample_positions"]

_AZIMUTH_DEG, _ELEVATION_DEG = 33.0, 12.0
"""From where plants are seen: no axis of a grown or modelled plant."""

_DISTANCE = 2.5
"""Of the eye from the plant's centre, in radii of its sphere."""


def check_cameras(plant: Plant, size: tuple[int, int]) -> dict[str, Camera]:
    """
    Place an orthographic and a perspective camera so that the plant fills the picture.

    Parameters
    ----------
    plant : Plant
        What they look at.
    size : tuple of 2 ints
        Width and height in pixels.

    Returns
    -------
    dict of str to Camera
        ``"orthographic"`` and ``"perspective"``. The plant fills the height, or the width if it is
        wider than the picture.
    """
    center, radius = plant.sphere
    azimuth, elevation = math.radians(_AZIMUTH_DEG), math.radians(_ELEVATION_DEG)
    out = np.array(
        [
            math.sin(azimuth) * math.cos(elevation),
            math.sin(elevation),
            math.cos(azimuth) * math.cos(elevation),
        ]
    )
    eye = tuple(float(x) for x in center + out * (_DISTANCE * radius))
    target = tuple(float(x) for x in center)
    aspect = size[0] / size[1]
    positions = np.concatenate([plant.wood.positions, plant.foliage.mesh.positions])
    world = positions.astype(np.float64) + plant.origin
    # a pixel is a metre, and then a radian's tangent, so that offsets are in those units
    unit = Camera.orthographic(eye, target, height=1.0, size=(1, 1))
    offsets = np.abs(unit.project(world)[:, :2] - 0.5)
    height = 2.0 * max(offsets[:, 1].max(), offsets[:, 0].max() / aspect)
    unit = Camera.perspective(eye, target, fov_y_deg=90.0, size=(2, 2))
    offsets = np.abs(unit.project(world)[:, :2] - 1.0)
    tangent = max(offsets[:, 1].max(), offsets[:, 0].max() / aspect)
    fov = 2.0 * math.degrees(math.atan(tangent))
    return {
        "orthographic": Camera.orthographic(eye, target, height=height, size=size),
        "perspective": Camera.perspective(eye, target, fov_y_deg=fov, size=size),
    }


def bands(size: tuple[int, int], samples: int, samples_a_band: int) -> list[tuple[int, int]]:
    """
    Part a picture into bands of rows that take about as long each.

    Parameters
    ----------
    size : tuple of 2 ints
        Width and height in pixels.
    samples : int
        A pixel.
    samples_a_band : int
        At most, but for a last row.

    Returns
    -------
    list of tuple of 2 ints
        The first row of each and the one after its last, from the top.
    """
    width, height = size
    count = min(max(math.ceil(width * height * samples / samples_a_band), 1), height)
    edges = [height * band // count for band in range(count + 1)]
    return list(itertools.pairwise(edges))


def sample_positions(sample_count: int) -> NDArray[np.float64]:
    """
    Return where in a pixel a picture of that many samples is sampled.

    Parameters
    ----------
    sample_count : int
        1, or above 16.

    Returns
    -------
    ndarray of shape (sample_count, 2)
        x to the right and y down, in pixels: the centre for 1, else the Hammersley points, moved to
        the middle of their cells and rounded down to 1/256 pixel.

    Raises
    ------
    ValueError
        For 2 to 16: those have tables of their own.
    """
    if sample_count == 1:
        return np.array([[0.5, 0.5]])
    if sample_count <= 16:
        msg = f"sample_count must be 1 or above 16, got {sample_count}"
        raise ValueError(msg)
    index = np.arange(sample_count, dtype=np.uint64)
    half_cell = 2**31 // sample_count
    x = index * 2**32 // sample_count + half_cell
    reversed_bits = np.array([int(f"{int(i):032b}"[::-1], 2) for i in index], np.uint64)
    y = reversed_bits + np.uint64(half_cell)
    steps = (np.stack([x, y], axis=1) % 2**32).astype(np.uint64) >> np.uint64(24)
    return np.asarray(steps / 256.0, dtype=np.float64)


def camera_settings(camera: Camera, origin: NDArray[np.float64]) -> dict[str, Any]:
    """
    Return a camera as references take it.

    Parameters
    ----------
    camera : Camera
        In the world.
    origin : ndarray of shape (3,)
        What positions are relative to: `Plant.origin`.

    Returns
    -------
    dict
        ``eye``, ``right``, ``up``, ``back``: lists of 3 floats; ``pixel``: width and height of a
        pixel in metres, or at depth 1 under perspective; ``perspective``; ``size``; ``near``;
        ``far``.
    """
    right, up, back = camera.view_rotation()
    pixel = 1.0 / camera.pixels_per_metre(1.0)
    return {
        "eye": (np.asarray(camera.eye) - origin).tolist(),
        "right": right.tolist(),
        "up": up.tolist(),
        "back": back.tolist(),
        "pixel": [pixel, pixel],
        "perspective": camera.is_perspective,
        "size": list(camera.size),
        "near": camera.near,
        "far": 2.0 * math.dist(camera.eye, camera.target),
    }


def pixel_rays(
    view: dict[str, Any], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """
    Return rays through points of a picture.

    Parameters
    ----------
    view : dict
        From `camera_settings`.
    points : ndarray of shape (N, 2)
        Pixels: x to the right, y down, the first pixel's centre at 0.5.

    Returns
    -------
    origins : ndarray of shape (N, 3)
        The eye, or points of its plane in a parallel view.
    directions : ndarray of shape (N, 3)
        With a length of 1 along the view, so that the distance travelled is view depth.
    """
    width, height = view["size"]
    right, up, back, eye = (np.array(view[name]) for name in ("right", "up", "back", "eye"))
    x = (points[:, :1] - width / 2.0) * view["pixel"][0]
    y = (height / 2.0 - points[:, 1:]) * view["pixel"][1]
    across = x * right + y * up
    if view["perspective"]:
        return np.broadcast_to(eye, across.shape), across - back
    return eye + across, np.broadcast_to(-back, across.shape)
