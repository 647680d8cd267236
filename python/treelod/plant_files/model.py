"""What every reader hands over, and the checks that all formats share."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from treelod.errors import LimitError, PlantFileError

__all__ = [
    "MAX_FILE_BYTES",
    "MAX_NODE_COUNT",
    "MAX_TRIANGLE_COUNT",
    "MAX_VERTEX_COUNT",
    "MaterialFacts",
    "Model",
    "Piece",
    "check_counts",
]

MAX_FILE_BYTES = 1 << 32
"""Largest file that is read, and largest file that it may refer to."""

MAX_TRIANGLE_COUNT = 1 << 25
"""Most triangles of one plant, instances counted: 33 million, some 4 GiB while loading."""

MAX_VERTEX_COUNT = 3 * MAX_TRIANGLE_COUNT
"""Most vertices of one plant: enough for triangles that share none."""

MAX_NODE_COUNT = 1 << 17
"""Most nodes of a scene, and most primitives that they place: each takes about a millisecond."""

MAX_COORDINATE = 1e12
"""Largest coordinate in file units; areas of what lies beyond would leave the range of a float."""

Wrap = Literal["repeat", "mirror", "clamp"]
AlphaMode = Literal["opaque", "mask", "blend"]


@dataclass(frozen=True, kw_only=True)
class MaterialFacts:
    """A material as the file states it; the colour factor is part of each piece's colours."""

    name: str
    texture: NDArray[np.uint8] | None = None
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    alpha_mode: AlphaMode = "opaque"
    alpha_cutoff: float = 0.5
    double_sided: bool = False


@dataclass(frozen=True, kw_only=True)
class Piece:
    """
    Triangles of one material and one named mesh, placed in the file's world.

    ``positions`` (V, 3) f64, ``triangles`` (T, 3), ``colors`` (V, 4) f32, linear with straight
    alpha; ``normals`` (V, 3) and ``uvs`` (V, 2; v = 0 on top) or None.
    """

    mesh: str
    material: int
    positions: NDArray[np.float64]
    triangles: NDArray[np.int64]
    colors: NDArray[np.float32]
    normals: NDArray[np.float64] | None = None
    uvs: NDArray[np.float32] | None = None


@dataclass(kw_only=True)
class Model:
    """Pieces and materials, and what the reader wants the user to know."""

    pieces: list[Piece]
    materials: list[MaterialFacts]
    warnings: list[str] = field(default_factory=list)

    def check(self) -> None:
        """Refuse indices out of range, values that are not finite, and files without triangles."""
        for piece in self.pieces:
            _check_piece(piece)
        if not any(len(piece.triangles) for piece in self.pieces):
            msg = "it holds no triangles"
            raise PlantFileError(msg)
        check_counts(
            sum(len(piece.triangles) for piece in self.pieces),
            sum(len(piece.positions) for piece in self.pieces),
        )


def check_counts(triangle_count: int = 0, vertex_count: int = 0, node_count: int = 0) -> None:
    """Refuse more than the limits, before anything of that size is made."""
    counts = {
        "nodes or primitives": (node_count, MAX_NODE_COUNT),
        "triangles": (triangle_count, MAX_TRIANGLE_COUNT),
        "vertices": (vertex_count, MAX_VERTEX_COUNT),
    }
    for name, (count, limit) in counts.items():
        if count > limit:
            msg = f"{count} {name}, the limit is {limit}"
            raise LimitError(msg)


def _check_piece(piece: Piece) -> None:
    vertex_count = len(piece.positions)
    if piece.positions.shape != (vertex_count, 3):
        msg = f"mesh {piece.mesh!r}: its positions have {piece.positions.shape[-1]} coordinates"
        raise PlantFileError(msg)
    if len(piece.triangles):
        low, high = int(piece.triangles.min()), int(piece.triangles.max())
        if low < 0 or high >= vertex_count:
            worst = low if low < 0 else high
            msg = f"mesh {piece.mesh!r}: vertex index {worst}, but it has {vertex_count} vertices"
            raise PlantFileError(msg)
    arrays = {
        "position": piece.positions,
        "normal": piece.normals,
        "texture coordinate": piece.uvs,
        "colour": piece.colors,
    }
    for name, array in arrays.items():
        if array is None:
            continue
        if len(array) != vertex_count:
            msg = f"mesh {piece.mesh!r}: {len(array)} {name}s for {vertex_count} vertices"
            raise PlantFileError(msg)
        finite = np.isfinite(array).all(axis=1)
        if not finite.all():
            msg = f"mesh {piece.mesh!r}: the {name} of vertex {int(finite.argmin())} is not finite"
            raise PlantFileError(msg)
    if vertex_count and np.abs(piece.positions).max() > MAX_COORDINATE:
        msg = f"mesh {piece.mesh!r}: a coordinate lies beyond {MAX_COORDINATE:g}"
        raise PlantFileError(msg)
