"""How a plant is loaded from a file: its pieces turned upright, joined and told apart."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from treelod import _core
from treelod.plant import Lighting, Material, Plant
from treelod.plant_files import Model, Piece, read

__all__ = ["load_plant"]


def load_plant(
    path: str | os.PathLike[str],
    foliage: Sequence[str] | None = None,
    *,
    unit: float = 1.0,
    up: Literal["x", "y", "z"] = "y",
    lighting: Lighting | None = None,
) -> Plant:
    """
    Load a plant from a GLB, glTF, OBJ or PLY file, and tell its wood from its leaves.

    Parameters
    ----------
    path : path-like
        The file. Pictures and buffers that it names must lie in its folder or below.
    foliage : sequence of str, optional
        Names of materials or meshes (objects in OBJ, the file's stem in PLY) that are foliage;
        everything else is wood, and an empty sequence makes all of it wood. Default: automatic, see
        Notes.
    unit : float
        Metres per unit of the file, in [1e-6, 1e6]. glTF is in metres by definition; its authors
        differ.
    up : {'y', 'z', 'x'}
        Axis of the file that points up; the plant is turned so that it becomes y.
    lighting : Lighting, optional
        Default: ``Lighting()``.

    Returns
    -------
    Plant
        Its `Plant.summary` tells what was classed as what, and why.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    PlantFileError
        If the file is damaged, refused, of a kind that is not read, or holds no triangles. The
        message names the file and what is wrong in it. Refused are paths out of the file's folder,
        pictures above 16384 a side or 2**26 texels, and required extensions that are not read.
    LimitError
        If the file holds more than 2**25 triangles, instances counted, or 2**17 nodes.
    ValueError
        If a name in `foliage` is neither a material nor a mesh, or `unit` or `up` is out of range.

    Warns
    -----
    UserWarning
        If something that the file holds is ignored: points and lines beside triangles,
        KHR_materials_transmission, undefined OBJ materials.

    Notes
    -----
    Read are positions, normals (else smooth ones, weighted by area), one set of texture
    coordinates, vertex colours, base colour texture and factor, alpha mode, cutoff and wrap; scene
    transforms and instances (EXT_mesh_gpu_instancing) are applied. Skins and morph targets stay at
    rest.

    The automatic split classes connected pieces (triangles of a material that share positions). A
    piece is a leaf if its texture cuts it out (texels it uses lie below the cutoff, whatever the
    alpha mode says), if it is an open sheet, or if it is flat or has two faces. The rest is solid:
    wood if the largest solid of its material is at least a tenth of the plant, else buds, fruit or
    needles, which count as foliage. Crowns modelled as large closed blobs are solid: name them.

    Vertex colours of PLY and OBJ are taken as sRGB, those of glTF are linear by definition. OBJ's
    Kd is linear and ignored beside a map_Kd.

    Examples
    --------
    >>> load_plant("no/such/tree.glb")
    Traceback (most recent call last):
    FileNotFoundError: [Errno 2] No such file or directory: 'no/such/tree.glb'
    """
    if isinstance(foliage, str):
        msg = f"foliage must be a sequence of names, got the text {foliage!r}"
        raise TypeError(msg)
    if not (isinstance(unit, (int, float)) and 1e-6 <= unit <= 1e6):
        msg = f"unit must be a number in [1e-6, 1e6], got {unit!r}"
        raise ValueError(msg)
    if up not in _UPRIGHT:
        msg = f"up must be 'x', 'y' or 'z', got {up!r}"
        raise ValueError(msg)
    model = read(path)
    mask = None if foliage is None else _named_triangles(model, foliage)
    turn = _UPRIGHT[up] * float(unit)
    is_turned = not np.array_equal(turn, np.eye(3))
    positions = [p.positions @ turn.T if is_turned else p.positions for p in model.pieces]
    origin = _origin(positions, model)
    materials = [
        Material(
            name=facts.name,
            texture=facts.texture,
            wrap=facts.wrap,
            alpha_mode=facts.alpha_mode,
            alpha_cutoff=facts.alpha_cutoff,
            double_sided=facts.double_sided,
        )
        for facts in model.materials
    ]
    return Plant.from_mesh(
        _joined(model, positions, origin, turn),
        foliage_mask=mask,
        materials=materials,
        name=Path(path).stem,
        origin=(origin[0].item(), origin[1].item(), origin[2].item()),
        lighting=lighting,
    )


_UPRIGHT = {
    "x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
}
"""Turns that bring an axis up to y."""

_FAR_RADII = 8
"""Farther than so many bounding radii from the world's origin, positions get an origin of their
own: up to here a 32-bit float keeps at least a millionth of the plant's size."""


def _origin(positions: list[NDArray[np.float64]], model: Model) -> NDArray[np.float64]:
    used = [
        p[piece.triangles].reshape(-1, 3) for p, piece in zip(positions, model.pieces, strict=True)
    ]
    used = [corners for corners in used if len(corners)]
    low = np.min([corners.min(axis=0) for corners in used], axis=0)
    high = np.max([corners.max(axis=0) for corners in used], axis=0)
    center: NDArray[np.float64] = (low + high) / 2
    radius = np.linalg.norm(high - low) / 2
    is_far = np.linalg.norm(center) > _FAR_RADII * radius
    return center if is_far else np.zeros(3)


def _named_triangles(model: Model, foliage: Sequence[str]) -> NDArray[np.bool_]:
    known = {facts.name for facts in model.materials} | {piece.mesh for piece in model.pieces}
    unknown = sorted(set(foliage) - known)
    if unknown:
        msg = (
            f"foliage: no material or mesh is named {', '.join(map(repr, unknown))}; "
            f"there are {', '.join(map(repr, sorted(known)))}"
        )
        raise ValueError(msg)
    chosen = set(foliage)
    return np.concatenate(
        [
            np.full(
                len(piece.triangles),
                piece.mesh in chosen or model.materials[piece.material].name in chosen,
            )
            for piece in model.pieces
        ]
    )


def _joined(
    model: Model,
    positions: list[NDArray[np.float64]],
    origin: NDArray[np.float64],
    turn: NDArray[np.float64],
) -> dict[str, ArrayLike]:
    """All pieces as one mesh, relative to the origin."""
    counts = [len(piece.positions) for piece in model.pieces]
    starts = np.cumsum([0, *counts[:-1]])
    local = [(p - origin).astype(np.float32) for p in positions]
    triangles = [piece.triangles + start for piece, start in zip(model.pieces, starts, strict=True)]
    uvs = [
        np.zeros((count, 2), np.float32) if piece.uvs is None else piece.uvs
        for piece, count in zip(model.pieces, counts, strict=True)
    ]
    ids = [np.full(len(piece.triangles), piece.material, np.uint32) for piece in model.pieces]
    normals = [_normals(piece, p, turn) for piece, p in zip(model.pieces, local, strict=True)]
    return {
        "positions": np.concatenate(local),
        "triangles": np.concatenate(triangles).astype(np.uint32),
        "normals": np.concatenate(normals),
        "uvs": np.concatenate(uvs),
        "colors": np.concatenate([piece.colors for piece in model.pieces]),
        "material_ids": np.concatenate(ids),
    }


def _normals(
    piece: Piece, positions: NDArray[np.float32], turn: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return unit normals: the file's where it has any, else smooth ones."""
    triangles = piece.triangles.astype(np.uint32)
    if piece.normals is None:
        return _core.smooth_normals(positions, triangles)
    turned = piece.normals @ turn.T
    lengths = np.linalg.norm(turned, axis=1, keepdims=True)
    if not ((lengths > 1e-100) & (lengths < 1e100)).all():
        # squares of tiny and huge normals leave the range; zero ones have no direction
        scale = np.abs(turned).max(axis=1, keepdims=True)
        turned = turned / np.where(scale > 0, scale, 1)
        lengths = np.linalg.norm(turned, axis=1, keepdims=True)
        missing = lengths[:, 0] == 0
        if missing.any():
            turned[missing] = _core.smooth_normals(positions, triangles)[missing]
            lengths[missing] = 1
    units: NDArray[np.float32] = (turned / lengths).astype(np.float32)
    return units
