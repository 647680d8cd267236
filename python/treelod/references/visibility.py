"""Which triangle is seen, and how far away: the rasteriser against embree, and an f64 twin."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.references import rays, twin
from treelod.references.checks import Check, Panel, Section
from treelod.references.soup import geometry_only, plant_soup
from treelod.references.views import camera_settings, check_cameras
from treelod.render import EMPTY_ID, render
from treelod.techniques import FullMesh

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant
    from treelod.render import Frame

__all__ = ["agreement", "depth_picture", "seen_triangles", "visibility_section"]

MIN_HIT_SHARE = 0.9999
MIN_TRIANGLE_SHARE = 0.999
MIN_DEPTH_SHARE = 0.999
"""
Shares of rays that must agree at 1024 x 768 pixels. What is missing to 1 is snapping: at 256 pixels
across 8 sub-pixel bits give 0.9999 and 0.998.
"""

SHARES_FROM_PX = 768
"""Height of a picture from which the shares hold; below, only the twin's answer does."""

DEPTH_TOLERANCE_REL = 1e-5
"""Of the plant's size: depths are f32 numbers of up to three sizes, interpolated."""


def seen_triangles(frame: Frame) -> NDArray[np.int64]:
    """
    Return a frame's ids as references number them.

    Parameters
    ----------
    frame : Frame
        Drawn with the output ``ids``.

    Returns
    -------
    ndarray of shape (H, W), dtype int64
        -1 where nothing is seen.
    """
    assert frame.ids is not None
    return np.where(frame.ids == EMPTY_ID, -1, frame.ids.astype(np.int64))


def agreement(
    ids: NDArray[np.int64],
    depth: NDArray[np.float32],
    hits: rays.Hits,
    corners_world: NDArray[np.float64],
    camera: Camera,
    *,
    size: float,
) -> list[Check]:
    """
    Compare a picture of ids and depth with rays.

    Parameters
    ----------
    ids, depth : ndarray of shape (H, W)
        As `seen_triangles` and `Frame.depth`.
    hits : Hits
        Of rays through the same pixels.
    corners_world : ndarray of shape (T, 3, 3)
        The triangles.
    camera : Camera
        That made both.
    size : float
        The plant's size in metres.

    Returns
    -------
    list of Check
    """
    same = ids == hits.ids
    both = (ids >= 0) & same
    near = np.abs(depth[both] - hits.depth[both]) <= DEPTH_TOLERANCE_REL * size
    different = np.argwhere(~same)
    explained = twin.is_exact_within_a_step(
        twin.project(corners_world, camera),
        (different[:, ::-1] + 0.5).astype(np.float64),
        ids[~same],
        size=size,
    )
    kind = "perspective" if camera.is_perspective else "orthographic"
    checks = [
        Check(
            name=f"disagreeing rays further than a snapping step from an edge, {kind}",
            value=float((~explained).sum()),
            relation="<=",
            limit=0.0,
            note=f"{len(different)} of {ids.size} rays disagree",
        ),
        Check(
            name=f"rays with equal depth, of those with the same triangle, {kind}",
            value=float(near.mean()) if len(near) else 0.0,
            relation=">=",
            limit=MIN_DEPTH_SHARE,
        ),
    ]
    if ids.shape[0] >= SHARES_FROM_PX:
        hit = (ids >= 0) == (hits.ids >= 0)
        shares = (("hit or miss", hit, MIN_HIT_SHARE), ("triangle", same, MIN_TRIANGLE_SHARE))
        for name, agrees, limit in shares:
            checks.append(
                Check(
                    name=f"rays with the same {name}, {kind}",
                    value=float(agrees.mean()),
                    relation=">=",
                    limit=limit,
                )
            )
    return checks


def visibility_section(
    plant: Plant, size: tuple[int, int], progress: Callable[[int, int], None]
) -> Section:
    """
    Check what is seen of a plant through each pixel's centre.

    Parameters
    ----------
    plant : Plant
        Any; its textures are left out.
    size : tuple of 2 ints
        Pixels.
    progress : callable
        Called with views done and all.

    Returns
    -------
    Section
    """
    soup = plant_soup(plant)
    mesh = FullMesh.build(geometry_only(plant))
    extent = 2.0 * plant.sphere[1]
    cameras = check_cameras(plant, size)
    checks, panels = [], []
    progress(0, len(cameras))
    views = [camera_settings(camera, plant.origin) for camera in cameras.values()]
    traced = rays.trace(soup.corners, views)
    for done, ((kind, camera), hits) in enumerate(zip(cameras.items(), traced, strict=True)):
        progress(done, len(cameras))
        frame = render(mesh, camera, samples=1, outputs=("ids", "depth"))
        ids = seen_triangles(frame)
        assert frame.depth is not None
        world = soup.corners + plant.origin
        checks += agreement(ids, frame.depth, hits, world, camera, size=extent)
        panels.append(
            Panel(
                title=f"{kind}: depth (near is bright), and rays that disagree",
                ours=depth_picture(frame.depth),
                reference=depth_picture(hits.depth),
                difference=(ids != hits.ids).astype(np.float32),
            )
        )
    progress(len(cameras), len(cameras))
    return Section(
        title="Rays",
        what=f"The full mesh, geometry alone, {size[0]} x {size[1]} pixels, one sample in each "
        "pixel's centre, against trimesh and embree.",
        checks=checks,
        panels=panels,
    )


def depth_picture(depth: NDArray[Any]) -> NDArray[Any]:
    """
    Show depth as brightness.

    Parameters
    ----------
    depth : ndarray of shape (H, W)
        Metres, inf where there is nothing.

    Returns
    -------
    ndarray of shape (H, W)
        1 is nearest, 0.25 farthest, 0 nothing.
    """
    seen = np.isfinite(depth)
    if not seen.any():
        return np.zeros(depth.shape)
    near, far = depth[seen].min(), depth[seen].max()
    share = (far - np.where(seen, depth, far)) / max(far - near, 1e-30)
    return np.asarray(np.where(seen, 0.25 + 0.75 * share, 0.0))
