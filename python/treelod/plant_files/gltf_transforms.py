"""Where things of a glTF file are placed: nodes, instances, texture coordinates."""

import math

import numpy as np
from numpy.typing import NDArray

from treelod.errors import PlantFileError
from treelod.plant_files import checks
from treelod.plant_files.checks import Json

__all__ = ["local_transform", "placed_instances", "rotations", "transformed_uvs"]


def transformed_uvs(uvs: NDArray[np.float64], texture: Json | None) -> NDArray[np.float64]:
    """Apply KHR_texture_transform: scale, turn counter-clockwise as seen with v down, shift."""
    transform = checks.extension(texture or {}, "KHR_texture_transform")
    if not transform:
        return uvs
    what = "KHR_texture_transform"
    scale = checks.floats(transform.get("scale", [1, 1]), 2, what)
    offset = checks.floats(transform.get("offset", [0, 0]), 2, what)
    angle = checks.floats([transform.get("rotation", 0)], 1, what)[0]
    c, s = math.cos(angle), math.sin(angle)
    turned: NDArray[np.float64] = (uvs * scale) @ np.array([[c, -s], [s, c]]) + offset
    return turned


def placed_instances(
    matrices: NDArray[np.float64],
    positions: NDArray[np.float64],
    normals: NDArray[np.float64] | None,
    triangles: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.int64]]:
    """World positions, normals and triangles of all instances; mirrored ones are wound anew."""
    if np.array_equal(matrices, np.eye(4)[None]):
        return positions, normals, triangles
    linear = matrices[:, :3, :3]
    world = positions @ linear.transpose(0, 2, 1) + matrices[:, None, :3, 3]
    # the cofactors are the inverse transpose times the determinant, and exist for any matrix
    cofactors = np.cross(linear[:, [1, 2, 0]], linear[:, [2, 0, 1]])
    mirrored = np.linalg.det(linear) < 0
    cofactors[mirrored] *= -1
    turned = None
    if normals is not None:
        turned = (normals @ cofactors.transpose(0, 2, 1)).reshape(-1, 3)
    starts = np.arange(len(matrices)) * len(positions)
    wound = triangles + starts[:, None, None]
    wound[mirrored] = wound[mirrored][:, :, ::-1]
    return world.reshape(-1, 3), turned, wound.reshape(-1, 3)


def rotations(quaternions: NDArray[np.float64], what: str) -> NDArray[np.float64]:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4) in the order x, y, z, w."""
    lengths = np.linalg.norm(quaternions, axis=1)
    if not (lengths > 0).all():
        msg = f"{what}: a rotation of length 0"
        raise PlantFileError(msg)
    x, y, z, w = (quaternions / lengths[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def local_transform(node: Json, what: str) -> Json:
    """Return what places a node in its parent, after checking each number."""
    transform = {}
    for key, length in {"matrix": 16, "translation": 3, "rotation": 4, "scale": 3}.items():
        if key in node:
            transform[key] = checks.floats(node[key], length, f"{what}: {key}").tolist()
    if "rotation" in transform and not any(transform["rotation"]):
        msg = f"{what}: a rotation of length 0"
        raise PlantFileError(msg)
    return transform
