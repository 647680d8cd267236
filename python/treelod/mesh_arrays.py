"""Arrays of a mesh as users state them: checked, completed and brought to the core's types."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treelod import _core

__all__ = ["as_indices", "mesh_arrays"]


def _as_floats(name: str, array: ArrayLike, width: int) -> NDArray[np.float32]:
    floats = np.ascontiguousarray(array, dtype=np.float32)
    if floats.ndim != 2 or floats.shape[1] != width:
        msg = f"{name} must have shape (N, {width}), got {floats.shape}"
        raise ValueError(msg)
    return floats


def as_indices(name: str, array: ArrayLike, ndim: int) -> NDArray[np.uint32]:
    """
    Check indices and bring them to the core's type.

    Parameters
    ----------
    name : str
        What messages call the array.
    array : array_like of int
        Shape (N, 3) if `ndim` is 2, else (N,); in [0, 2**32).
    ndim : {1, 2}
        How many dimensions it must have.

    Returns
    -------
    ndarray of dtype uint32
        The same values, contiguous.

    Raises
    ------
    ValueError
        If the shape is another one, or a value is no integer or out of range.
    """
    values = np.asarray(array)
    if values.ndim != ndim or (ndim == 2 and values.shape[1] != 3):
        shape = "(N, 3)" if ndim == 2 else "(N,)"
        msg = f"{name} must have shape {shape}, got {values.shape}"
        raise ValueError(msg)
    if values.size and not np.issubdtype(values.dtype, np.integer):
        msg = f"{name} must be integers, got {values.dtype}"
        raise ValueError(msg)
    if values.size and (values.min() < 0 or values.max() >= 2**32):
        msg = f"{name} must be in [0, 2**32), got {values.min()} to {values.max()}"
        raise ValueError(msg)
    return np.ascontiguousarray(values, dtype=np.uint32)


_MESH_KEYS = {"positions", "triangles", "normals", "uvs", "colors", "material_ids"}


def mesh_arrays(part: str, mesh: Mapping[str, ArrayLike] | None) -> "_core._MeshArrays":
    """
    Check the arrays of a mesh and fill in those that are not stated.

    Parameters
    ----------
    part : str
        What messages call the mesh.
    mesh : mapping of str to array_like, optional
        As `wood` and `foliage` of `Plant.from_arrays`. None: no triangles.

    Returns
    -------
    dict of str to ndarray
        Every array that the core takes: colours with alpha, normals, texture coordinates and
        material indices.

    Raises
    ------
    ValueError
        If an array is unknown or missing, or has another shape or type of values than stated.
    """
    if mesh is None:
        mesh = {"positions": np.empty((0, 3)), "triangles": np.empty((0, 3), np.uint32)}
    unknown = sorted(set(mesh) - _MESH_KEYS)
    missing = sorted({"positions", "triangles"} - set(mesh))
    if unknown or missing:
        msg = f"{part}: unknown arrays {unknown}, missing arrays {missing}"
        raise ValueError(msg)
    positions = _as_floats(f"{part} positions", mesh["positions"], 3)
    triangles = as_indices(f"{part} triangles", mesh["triangles"], 2)
    colors = np.asarray(mesh.get("colors", np.ones((len(positions), 4))), dtype=np.float32)
    if colors.ndim == 2 and colors.shape[1] == 3:
        colors = np.column_stack([colors, np.ones(len(colors), np.float32)])
    normals = mesh.get("normals")
    return {
        "positions": positions,
        "normals": _core.smooth_normals(positions, triangles)
        if normals is None
        else _as_floats(f"{part} normals", normals, 3),
        "uvs": _as_floats(f"{part} uvs", mesh.get("uvs", np.zeros((len(positions), 2))), 2),
        "colors": _as_floats(f"{part} colors", colors, 4),
        "triangles": triangles,
        "material_ids": as_indices(
            f"{part} material_ids", mesh.get("material_ids", np.zeros(len(triangles), np.uint32)), 1
        ),
    }
