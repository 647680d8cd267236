"""Leaves measured by trimesh: areas, centres, normals, rectangles, components and bounds."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from treelod.plants import Plant
from treelod.references.checks import Check, Section

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["geometry_section", "rectangle_area", "rectangles"]

ROUNDING = 1e-6
"""
Largest difference of what is stored in f32, as a share of the largest area, the plant's size or 1:
rounding makes 6e-8, and sums run in another order.
"""

MAX_AREA_ERROR = 1e-9
"""
Largest difference of a rectangle's area, as a share of trimesh's. Both are f64, but project onto
axes of their own: a leaf a thousandth as wide as long then differs by 1e-13.
"""

MAX_OVERHANG = 1e-12
"""
Largest distance of a vertex from its rectangle, as a share of the plant's size: in f64 both are
right to 1e-16 of it.
"""

FLAT = 1e-6
"""
Height of a rectangle, as a share of its length, below which a leaf counts as a line: trimesh's hull
wants more, and its vertices are f32.
"""


def geometry_section(plant: Plant) -> Section:
    """
    Compare a plant's measures with trimesh's.

    Parameters
    ----------
    plant : Plant
        Any.

    Returns
    -------
    Section
    """
    checks = [_bounds(plant)]
    if plant.foliage.leaf_count:
        checks += _leaves(plant)
        checks += rectangles(plant)
        checks.append(_components(plant))
    return Section(
        title="Geometry",
        what="Leaves, components and bounds as trimesh measures the same triangles, in f64.",
        checks=checks,
    )


def _leaves(plant: Plant) -> list[Check]:
    foliage = plant.foliage
    corners = foliage.positions[foliage.triangles].astype(np.float64)
    starts = foliage.leaf_offsets[:-1]
    vectors = trimesh.triangles.cross(corners) / 2.0
    areas: NDArray[np.float64] = trimesh.triangles.area(corners)  # type: ignore[no-untyped-call]
    leaf_areas = np.add.reduceat(areas, starts)
    largest_area = leaf_areas.max()
    solid = leaf_areas > 0.0
    centroids = corners.mean(axis=1) * areas[:, np.newaxis]
    centers = np.add.reduceat(centroids, starts)[solid] / leaf_areas[solid, np.newaxis]
    errors = {
        "leaf areas": np.abs(leaf_areas - foliage.areas) / (largest_area or 1.0),
        "leaf centres": np.linalg.norm(centers - foliage.centers[solid], axis=1) / _size(plant),
        "leaf normals": _normal_errors(plant, vectors, areas)[solid],
    }
    return [
        Check(name=name, value=float(error.max(initial=0.0)), relation="<=", limit=ROUNDING)
        for name, error in errors.items()
    ]


def _size(plant: Plant) -> float:
    """Diameter in metres that errors are shares of; 1 for a point."""
    return 2.0 * plant.sphere[1] or 1.0


def _normal_errors(
    plant: Plant, vectors: NDArray[np.float64], areas: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Chord between unit normals, times how well the sum of a leaf's triangles defines one."""
    foliage = plant.foliage
    errors = np.zeros(foliage.leaf_count)
    offsets = foliage.leaf_offsets.astype(np.int64)
    for leaf, (start, end) in enumerate(itertools.pairwise(offsets)):
        own, sizes = vectors[start:end], areas[start:end]
        largest = int(sizes.argmax())
        signs = np.where(own @ own[largest] < 0.0, -1.0, 1.0)
        total = signs @ own
        length = np.linalg.norm(total)
        if length == 0.0:
            continue
        chords = [np.linalg.norm(foliage.normals[leaf] - side * total / length) for side in (1, -1)]
        # of triangles equally large to rounding either may give the sign
        tied = (sizes >= sizes[largest] * (1.0 - 1e-9)).sum() > 1
        errors[leaf] = (min(chords) if tied else chords[0]) * length / sizes.sum()
    return errors


def rectangles(plant: Plant) -> list[Check]:
    """
    Compare the leaves' smallest rectangles with trimesh's.

    Parameters
    ----------
    plant : Plant
        With leaves.

    Returns
    -------
    list of Check
        Largest differences of area, and how far a vertex lies outside its leaf's rectangle.
    """
    foliage = plant.foliage
    corners = foliage.positions[foliage.triangles].astype(np.float64)
    offsets = foliage.leaf_offsets.astype(np.int64)
    area_errors, overhangs = [0.0], [0.0]
    line_count = 0
    for leaf, (start, end) in enumerate(itertools.pairwise(offsets)):
        vertices = corners[start:end].reshape(-1, 3)
        ours = foliage.rectangles[leaf]
        sides = ours[[1, 3]] - ours[0]
        lengths = np.linalg.norm(sides, axis=1)
        # along each side that has a length, no vertex lies before its start or behind its end
        for side, length in zip(sides, lengths, strict=True):
            if length > 0.0:
                places = (vertices - ours[0]) @ (side / length)
                overhangs.append(float(max(-places.min(), places.max() - length)))
        theirs = rectangle_area(vertices, foliage.normals[leaf].astype(np.float64))
        if theirs is None:
            line_count += 1
            # tight on it: no height, and no longer than twice what lies on one side of a vertex
            reach = np.linalg.norm(vertices - vertices[0], axis=1).max()
            overhangs.append(float(max(lengths[1] - FLAT * lengths[0], lengths[0] - 2.0 * reach)))
        else:
            area_errors.append(abs(float(lengths.prod()) / theirs - 1.0))
    return [
        Check(
            name="minimum-area rectangles: largest relative area difference",
            value=float(np.max(area_errors)),
            relation="<=",
            limit=MAX_AREA_ERROR,
            note=f"{line_count} leaves are lines or points, which have none" if line_count else "",
        ),
        Check(
            name="minimum-area rectangles: largest overhang of a vertex",
            value=float(np.max(overhangs)) / _size(plant),
            relation="<=",
            limit=MAX_OVERHANG,
        ),
    ]


def rectangle_area(vertices: NDArray[np.float64], normal: NDArray[np.float64]) -> float | None:
    """
    Return the area of the smallest rectangle around vertices, by trimesh.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3)
        Seen along `normal`.
    normal : ndarray of shape (3,)
        Of the rectangle's plane, of any length.

    Returns
    -------
    float or None
        Square metres; None for a line or a point.
    """
    around = vertices - vertices.mean(axis=0)
    size = float(np.abs(around).max())
    if size == 0.0 or not normal.any():
        return None
    # of size 1, because trimesh leaves out edges below 1e-10
    to_plane = trimesh.geometry.plane_transform(  # type: ignore[no-untyped-call]
        np.zeros(3), normal / np.linalg.norm(normal)
    )
    points = (around / size) @ to_plane[:2, :3].T
    if np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] < FLAT:
        return None
    sides = trimesh.bounds.oriented_bounds_2D(points)[1]  # type: ignore[no-untyped-call]
    return float(np.prod(sides)) * size * size


def _components(plant: Plant) -> Check:
    """Leaves of other sizes, in triangles, if leaves are the connected pieces of each material."""
    mesh = plant.foliage.mesh
    split = Plant.from_mesh(
        {
            "positions": mesh.positions,
            "triangles": mesh.triangles,
            "material_ids": mesh.material_ids,
        },
        foliage_mask=np.ones(len(mesh.triangles), np.bool_),
        materials=plant.materials,
    )
    ours = np.diff(split.foliage.leaf_offsets.astype(np.int64))
    theirs = []
    for material in np.unique(mesh.material_ids):
        own = mesh.triangles[mesh.material_ids == material]
        # positions alone: a crease in normals or a seam in texture does not part a leaf
        places = mesh.positions[own].reshape(-1, 3)
        _, corners = np.unique(places, axis=0, return_inverse=True)
        triangles = corners.reshape(-1, 3)
        edges = np.concatenate([triangles[:, :2], triangles[:, 1:]])
        labels = trimesh.graph.connected_component_labels(  # type: ignore[no-untyped-call]
            edges, node_count=int(corners.max()) + 1
        )
        theirs.append(np.unique(labels[triangles[:, 0]], return_counts=True)[1])
    sizes = np.concatenate(theirs)
    longest = max(ours.max(), sizes.max()) + 1
    counts = [np.bincount(array, minlength=longest) for array in (ours, sizes)]
    return Check(
        name="connected components of other sizes",
        value=float(np.abs(counts[0] - counts[1]).sum()),
        relation="<=",
        limit=0.0,
        note=f"{len(sizes)} components",
    )


def _bounds(plant: Plant) -> Check:
    positions = [
        mesh.positions[mesh.triangles].reshape(-1, 3) for mesh in (plant.wood, plant.foliage.mesh)
    ]
    corners = np.concatenate(positions).astype(np.float64)
    whole = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    difference = np.abs(whole.bounds + plant.origin - plant.bounds).max()
    return Check(
        name="bounds",
        value=float(difference / _size(plant)),
        relation="<=",
        limit=ROUNDING,
    )
