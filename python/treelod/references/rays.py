"""
First hits of rays by embree, through trimesh: which triangle is seen, and how far away.

`run` is what the child process does; `trace` asks for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from treelod.references.runner import reference
from treelod.references.views import pixel_rays

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = ["Hits", "run", "trace"]

_RAYS_AT_ONCE = 1 << 19
"""Rays a call: some 200 MB of embree's and trimesh's arrays."""


class Hits(NamedTuple):
    """
    What the rays through pixels' centres hit.

    Attributes
    ----------
    ids : ndarray of shape (H, W), dtype int64
        Index of the triangle, -1 where there is none.
    depth : ndarray of shape (H, W), dtype float64
        View depth in metres, inf where there is none.
    """

    ids: NDArray[np.int64]
    depth: NDArray[np.float64]


def trace(
    corners: NDArray[np.float64], views: Sequence[dict[str, Any]], *, cached: bool = True
) -> list[Hits]:
    """
    Shoot a ray through the centre of each pixel of some views.

    Parameters
    ----------
    corners : ndarray of shape (T, 3, 3)
        Triangles, opaque from both sides.
    views : sequence of dict
        Each from `treelod.references.views.camera_settings`.
    cached : bool, default True
        As in `treelod.references.runner.reference`.

    Returns
    -------
    list of Hits
        One a view.

    Raises
    ------
    ImportError, ReferenceFailedError
        As `treelod.references.runner.reference`.
    """
    made = reference("rays", {"corners": corners}, {"views": list(views)}, cached=cached)
    return [Hits(made[f"ids_{i}"], made[f"depth_{i}"]) for i in range(len(views))]


def run(arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """
    Do the work of `trace`, in the child.

    Parameters
    ----------
    arrays : dict
        ``corners``.
    settings : dict
        ``views``.

    Returns
    -------
    dict
        ``ids_I`` and ``depth_I`` of view I.
    """
    import trimesh

    if not trimesh.ray.has_embree:
        msg = "trimesh does not find embreex"
        raise RuntimeError(msg)
    corners = arrays["corners"]
    mesh = trimesh.Trimesh(
        corners.reshape(-1, 3), np.arange(len(corners) * 3).reshape(-1, 3), process=False
    )
    result: dict[str, NDArray[Any]] = {}
    for index, view in enumerate(settings["views"]):
        result[f"ids_{index}"], result[f"depth_{index}"] = _first_hits(mesh, view)
    return result


def _first_hits(mesh: Any, view: dict[str, Any]) -> Hits:
    width, height = view["size"]
    ids = np.full(width * height, -1, np.int64)
    depth = np.full(width * height, np.inf)
    for start in range(0, width * height, _RAYS_AT_ONCE):
        pixels = np.arange(start, min(start + _RAYS_AT_ONCE, width * height))
        points = np.stack([pixels % width, pixels // width], axis=1) + 0.5
        origins, directions = pixel_rays(view, points)
        triangles, rays, places = mesh.ray.intersects_id(
            origins, directions, multiple_hits=False, return_locations=True
        )
        ids[pixels[rays]] = triangles
        depth[pixels[rays]] = -((places - np.array(view["eye"])) @ np.array(view["back"]))
    return Hits(ids.reshape(height, width), depth.reshape(height, width))
