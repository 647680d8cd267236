"""What every reader hands over, and the checks that all formats share."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from treelod.errors import LimitError, PlantFileError

__all__ = ["MAX_FILE_BYTES", "MAX_TRIANGLE_COUNT", "MaterialFacts", "Model", "Piece"]

MAX_FILE_BYTES = 1 << 32
"""Largest file that is read, and largest file that it may refer to."""

MAX_TRIANGLE_COUNT = 1 << 25
"""Most triangles of one plant, instances counted: 33 million, some 4 GiB while loading."""

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
        check_triangle_count(sum(len(piece.triangles) for piece in self.pieces))


def check_triangle_count(count: int) -> None:
    """Refuse more triangles than the limit, before anything of that size is made."""
    if count > MAX_TRIANGLE_COUNT:
        msg = f"{count} triangles, the limit is {MAX_TRIANGLE_COUNT}"
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
