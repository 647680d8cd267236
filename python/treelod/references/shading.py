"""
Lit colour by embree's hits and NumPy: barycentric colour times texel, layer behind layer.

For plants whose leaves are cut out, which mitsuba's feature buffers ignore. `run` is what the child
process does; `shade` asks for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.references.runner import reference
from treelod.references.texels import bilinear, decoded
from treelod.references.views import pixel_rays

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.references.soup import Soup

__all__ = ["run", "shade"]

_RAYS_AT_ONCE = 1 << 18

_STEP_REL = 2e-6
"""How far behind a hit the next ray starts, as a share of the scene's size: some ten f32 steps."""

_MAX_LAYERS = 1000
"""More than a ray meets; ends a ray that would hit one triangle for ever."""

_CLEAR = 1e-4
"""A ray is done when this share of the light comes from behind."""


def shade(
    soup: Soup,
    view: dict[str, Any],
    positions: NDArray[np.float64],
    *,
    rows: tuple[int, int] | None = None,
    cached: bool = True,
) -> NDArray[np.float64]:
    """
    Draw triangles by rays.

    Parameters
    ----------
    soup : Soup
        What to draw.
    view : dict
        From `treelod.references.views.camera_settings`.
    positions : ndarray of shape (S, 2)
        Where in each pixel rays go through, in pixels.
    rows : tuple of 2 ints, optional
        The first row to draw and the one after the last. Default: all.
    cached : bool, default True
        As in `treelod.references.runner.reference`.

    Returns
    -------
    ndarray of shape (H, W, 4)
        Linear and premultiplied: the mean over the rays. Of `rows` alone, if stated.

    Raises
    ------
    ImportError, ReferenceFailedError
        As `treelod.references.runner.reference`.
    """
    arrays: dict[str, NDArray[Any]] = {
        "corners": soup.corners,
        "uvs": soup.uvs,
        "front": soup.front,
        "back": soup.back,
        "opacity": soup.opacity,
        "material_ids": soup.material_ids,
        "positions": positions,
    }
    facts = []
    for index, material in enumerate(soup.materials):
        if material.texture is not None:
            arrays[f"texture_{index}"] = material.texture
        facts.append(
            {
                "wrap": list(material.wrap),
                "mode": material.alpha_mode,
                "cutoff": material.alpha_cutoff,
            }
        )
    settings = {"view": view, "materials": facts, "rows": list(rows or (0, view["size"][1]))}
    return reference("shade", arrays, settings, cached=cached)["color"]


def run(arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """
    Do the work of `shade`, in the child.

    Parameters
    ----------
    arrays : dict
        The soup's arrays, ``positions``, and ``texture_I`` of the materials that have one.
    settings : dict
        ``view``, ``materials`` and ``rows``.

    Returns
    -------
    dict
        ``color``.
    """
    import trimesh

    corners, view, positions = arrays["corners"], settings["view"], arrays["positions"]
    mesh = trimesh.Trimesh(
        corners.reshape(-1, 3), np.arange(len(corners) * 3).reshape(-1, 3), process=False
    )
    painter = _Painter(arrays, settings["materials"])
    width = view["size"][0]
    first, after = (row * width for row in settings["rows"])
    color = np.zeros((after - first, 4))
    pixels_at_once = max(_RAYS_AT_ONCE // len(positions), 1)
    for start in range(first, after, pixels_at_once):
        pixels = np.arange(start, min(start + pixels_at_once, after))
        points = np.stack([pixels % width, pixels // width], axis=1)[:, np.newaxis] + positions
        rays = pixel_rays(view, points.reshape(-1, 2))
        layers = _through(mesh, painter, *rays)
        color[pixels - first] = layers.reshape(len(pixels), len(positions), 4).mean(axis=1)
    return {"color": color.reshape(-1, width, 4)}


def _through(
    mesh: Any,
    painter: _Painter,
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Premultiplied colour of each ray."""
    color = np.zeros((len(origins), 4))
    step = _STEP_REL * float(np.linalg.norm(mesh.extents))
    step = step / np.linalg.norm(directions, axis=1)[:, np.newaxis]
    alive = np.arange(len(origins))
    starts = origins.copy()
    last = np.full(len(origins), -1, np.int64)
    strides = np.ones((len(origins), 1))
    for _ in range(_MAX_LAYERS):
        triangles, rays, places = mesh.ray.intersects_id(
            starts[alive], directions[alive], multiple_hits=False, return_locations=True
        )
        alive = alive[rays]
        if not len(alive):
            break
        # the same triangle again: the ray grazes it and has not yet left it
        fresh = triangles != last[alive]
        strides[alive] = np.where(fresh[:, np.newaxis], 1.0, 2.0 * strides[alive])
        hit = alive[fresh]
        layer = painter.paint(triangles[fresh], places[fresh], directions[hit])
        color[hit] += (1.0 - color[hit, 3:]) * layer
        last[alive] = triangles
        starts[alive] = places + directions[alive] * step[alive] * strides[alive]
        alive = alive[color[alive, 3] < 1.0 - _CLEAR]
    return color


class _Painter:
    """Colours of hits."""

    def __init__(self, arrays: dict[str, NDArray[Any]], materials: list[dict[str, Any]]) -> None:
        self._arrays = arrays
        self._materials = materials
        self._textures = {
            index: decoded(arrays[f"texture_{index}"])
            for index in range(len(materials))
            if f"texture_{index}" in arrays
        }
        corners = arrays["corners"]
        self._first, self._second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        self._normals = np.cross(self._first, self._second)

    def paint(
        self,
        triangles: NDArray[np.int64],
        places: NDArray[np.float64],
        directions: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Premultiplied colour of each hit, clear where it is cut out."""
        arrays = self._arrays
        weights = self._weights(triangles, places)
        facing = (self._normals[triangles] * directions).sum(axis=1) < 0.0
        lit = np.where(
            facing[:, np.newaxis, np.newaxis], arrays["front"][triangles], arrays["back"][triangles]
        )
        color = np.ones((len(triangles), 4))
        color[:, :3] = np.einsum("nc,nck->nk", weights, lit)
        opacity = np.einsum("nc,nc->n", weights, arrays["opacity"][triangles])
        uvs = np.einsum("nc,nck->nk", weights, arrays["uvs"][triangles])
        of_material = arrays["material_ids"][triangles]
        for index, material in enumerate(self._materials):
            own = np.flatnonzero(of_material == index)
            texel_alpha = np.ones(len(own))
            if index in self._textures:
                texels = bilinear(self._textures[index], uvs[own], tuple(material["wrap"]))
                texel_alpha = texels[:, 3]
                straight = texels[:, :3] / np.where(texel_alpha > 0.0, texel_alpha, 1.0)[:, None]
                color[own, :3] *= straight
            alpha = texel_alpha * opacity[own]
            if material["mode"] == "mask":
                alpha = (alpha >= material["cutoff"]).astype(np.float64)
            elif material["mode"] == "opaque":
                alpha = np.ones(len(own))
            color[own] *= np.clip(alpha, 0.0, 1.0)[:, np.newaxis]
        return color

    def _weights(
        self, triangles: NDArray[np.int64], places: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Barycentric weights of points in triangles, by areas."""
        normals = self._normals[triangles]
        offset = places - self._arrays["corners"][triangles, 0]
        size_sq = (normals**2).sum(axis=1)
        size_sq = np.where(size_sq > 0.0, size_sq, 1.0)
        second = (np.cross(offset, self._second[triangles]) * normals).sum(axis=1) / size_sq
        third = (np.cross(self._first[triangles], offset) * normals).sum(axis=1) / size_sq
        weights = np.stack([1.0 - second - third, second, third], axis=1)
        return np.asarray(np.clip(weights, 0.0, 1.0))
