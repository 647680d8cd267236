"""
Coverage of texels by embree alone, bare or through trimesh: peers for benchmarks.

Opaque triangles only. `run` is what the child process does; `coverage` asks for it.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.references.runner import reference
from treelod.references.views import pixel_rays

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from treelod.references.soup import Soup

__all__ = ["coverage", "run"]


def coverage(
    soups: Sequence[Soup], views: Sequence[dict[str, Any]], side_samples: int, *, through: str
) -> tuple[list[NDArray[np.float32]], float]:
    """
    Count what share of each pixel's rays hits something.

    Parameters
    ----------
    soups : sequence of Soup
        What to draw, opaque.
    views : sequence of dict
        Of each soup, from `treelod.references.views.camera_settings`.
    side_samples : int
        Rays along each side of a pixel, on an even grid.
    through : {'embreex', 'trimesh'}
        Who calls embree: its bare binding, in f32, or trimesh, as most Python programs do.

    Returns
    -------
    pictures : list of ndarray of shape (H, W), dtype float32
        Share covered.
    secs : float
        Seconds that embree traced; building its scenes and making rays is not counted.

    Raises
    ------
    ImportError, ReferenceFailedError
        As `treelod.references.runner.reference`.
    """
    arrays = {f"corners_{i}": soup.corners.astype(np.float32) for i, soup in enumerate(soups)}
    settings = {"views": list(views), "side_samples": side_samples, "through": through}
    made = reference("embree", arrays, settings, cached=False)
    return [made[f"picture_{index}"] for index in range(len(soups))], float(made["secs"])


def run(arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """
    Do the work of `coverage`, in the child.

    Parameters
    ----------
    arrays : dict
        ``corners_I`` of soup I.
    settings : dict
        ``views``, ``side_samples`` and ``through``.

    Returns
    -------
    dict
        ``picture_I`` and ``secs``.
    """
    grid = (np.arange(settings["side_samples"]) + 0.5) / settings["side_samples"]
    positions = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    result: dict[str, NDArray[Any]] = {}
    secs = 0.0
    for index, view in enumerate(settings["views"]):
        first_hits = _TRACERS[settings["through"]](arrays[f"corners_{index}"])
        width, height = view["size"]
        pixels = np.arange(width * height)
        points = np.stack([pixels % width, pixels // width], axis=1)[:, np.newaxis] + positions
        origins, directions = pixel_rays(view, points.reshape(-1, 2))
        dtype = np.float32 if settings["through"] == "embreex" else np.float64
        rays = [np.ascontiguousarray(part, dtype) for part in (origins, directions)]
        # the first query of a scene also builds its tree
        first_hits(rays[0][:1], rays[1][:1])
        start = time.perf_counter()
        hits = first_hits(*rays)
        secs += time.perf_counter() - start
        covered = (hits >= 0).reshape(height, width, len(positions))
        result[f"picture_{index}"] = covered.mean(axis=2, dtype=np.float32)
    return {**result, "secs": np.array(secs)}


def _bare(corners: NDArray[np.float32]) -> Callable[..., NDArray[Any]]:
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scene = rtcore_scene.EmbreeScene()
    mesh = TriangleMesh(scene, corners)

    def first_hits(origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[Any]:
        # embree holds a pointer to the mesh, which must live as long
        assert mesh is not None
        return np.asarray(scene.run(origins, directions))

    return first_hits


def _through_trimesh(corners: NDArray[np.float32]) -> Callable[..., NDArray[Any]]:
    import trimesh

    faces = np.arange(len(corners) * 3).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False)
    first_hits: Callable[..., NDArray[Any]] = mesh.ray.intersects_first
    return first_hits


_TRACERS = {"embreex": _bare, "trimesh": _through_trimesh}
