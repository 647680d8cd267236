"""
A plant's triangles as every reference takes them: nothing shared, nothing indexed, in f64.

Coordinates are metres relative to `Plant.origin`. Wood comes first, so a triangle's place is its id
in a frame of the full mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.plants import Plant

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.plants import Material, Mesh

__all__ = ["Soup", "foliage_soup", "geometry_only", "plant_soup"]

_ARRAYS = ("corners", "uvs", "front", "back", "opacity", "material_ids")


@dataclass(frozen=True, kw_only=True, eq=False)
class Soup:
    """
    Triangles.

    Attributes
    ----------
    corners : ndarray of shape (T, 3, 3)
        Positions: triangle, corner, axis.
    uvs : ndarray of shape (T, 3, 2)
        Texture coordinates, v = 0 on the texture's top row.
    front, back : ndarray of shape (T, 3, 3)
        Lit linear colours of the counter-clockwise side and of the other.
    opacity : ndarray of shape (T, 3)
        Alpha without the texture.
    material_ids : ndarray of shape (T,), dtype int64
        Indices into `materials`.
    materials : tuple of Material
        Of the plant.
    """

    corners: NDArray[np.float64]
    uvs: NDArray[np.float64]
    front: NDArray[np.float64]
    back: NDArray[np.float64]
    opacity: NDArray[np.float64]
    material_ids: NDArray[np.int64]
    materials: tuple[Material, ...]

    @property
    def triangle_count(self) -> int:
        """How many triangles there are."""
        return len(self.corners)

    def take(self, chosen: NDArray[Any]) -> Soup:
        """
        Return some of the triangles.

        Parameters
        ----------
        chosen : ndarray
            Indices, or a mask of shape (T,).

        Returns
        -------
        Soup
        """
        return replace(self, **{name: getattr(self, name)[chosen] for name in _ARRAYS})

    def joined(self, other: Soup) -> Soup:
        """
        Return these triangles and those of another soup of the same plant.

        Parameters
        ----------
        other : Soup
            With the same materials.

        Returns
        -------
        Soup
        """
        parts: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in _ARRAYS
        }
        return replace(self, **parts)

    def cut(self, normal: NDArray[np.float64], offset: float) -> Soup:
        """
        Return what lies on one side of a plane, triangles across it cut at it.

        Parameters
        ----------
        normal : ndarray of shape (3,)
            Points to the side that is kept.
        offset : float
            The plane is where ``position @ normal == offset``.

        Returns
        -------
        Soup
            A triangle becomes none, one or two.
        """
        heights = self.corners @ normal - offset
        above = heights >= 0.0
        counts = above.sum(axis=1)
        result = self.take(counts == 3)
        for count in (1, 2):
            chosen = np.flatnonzero(counts == count)
            if not len(chosen):
                continue
            # turn the corner that is alone on its side to the front
            alone = np.argmax(above[chosen] == (count == 1), axis=1)
            order = (alone[:, np.newaxis] + np.arange(3)) % 3
            turned = np.take_along_axis(heights[chosen], order, axis=1)
            # shares of the way from the first corner to the second and to the third
            shares = turned[:, :1] / (turned[:, :1] - turned[:, 1:])
            weights = np.zeros((len(chosen), 2, 3))
            weights[:, 0, 1] = shares[:, 0]
            weights[:, 1, 2] = shares[:, 1]
            weights[:, :, 0] = 1.0 - shares
            corner = np.broadcast_to(np.eye(3), (len(chosen), 3, 3))
            to_second, to_third = weights[:, 0], weights[:, 1]
            if count == 1:
                pieces = [(corner[:, 0], to_second, to_third)]
            else:
                pieces = [
                    (to_second, corner[:, 1], corner[:, 2]),
                    (to_second, corner[:, 2], to_third),
                ]
            for piece in pieces:
                result = result.joined(self._mixed(chosen, order, np.stack(piece, axis=1)))
        return result

    def _mixed(
        self, chosen: NDArray[np.int64], order: NDArray[np.int64], weights: NDArray[np.float64]
    ) -> Soup:
        """Triangles whose corners mix those of `chosen`: weights (N, corner of new, of old)."""
        mixed: dict[str, Any] = {"material_ids": self.material_ids[chosen]}
        for name in ("corners", "uvs", "front", "back", "opacity"):
            array = getattr(self, name)[chosen]
            turned = array[np.arange(len(chosen))[:, np.newaxis], order]
            mixed[name] = np.einsum("nij,nj...->ni...", weights, turned)
        return replace(self, **mixed)


def foliage_soup(plant: Plant) -> Soup:
    """
    Return the leaves' triangles, in their order.

    Parameters
    ----------
    plant : Plant
        Any.

    Returns
    -------
    Soup
    """
    return _soup(plant.foliage.mesh, plant.materials)


def plant_soup(plant: Plant) -> Soup:
    """
    Return all triangles: wood, then foliage, as `Frame.ids` numbers them.

    Parameters
    ----------
    plant : Plant
        Any.

    Returns
    -------
    Soup
    """
    return _soup(plant.wood, plant.materials).joined(foliage_soup(plant))


def geometry_only(plant: Plant) -> Plant:
    """
    Return the same triangles without anything that could let a ray through.

    Parameters
    ----------
    plant : Plant
        Any.

    Returns
    -------
    Plant
        Opaque, white, without textures; ids and leaves as before.
    """

    def mesh(of: Mesh) -> dict[str, Any] | None:
        arrays = {"positions": of.positions, "triangles": of.triangles}
        return arrays if len(of.triangles) else None

    foliage = mesh(plant.foliage.mesh)
    return Plant.from_arrays(
        wood=mesh(plant.wood),
        foliage=foliage,
        leaf_offsets=None if foliage is None else plant.foliage.leaf_offsets,
        name=plant.name,
        origin=(float(plant.origin[0]), float(plant.origin[1]), float(plant.origin[2])),
    )


def _soup(mesh: Mesh, materials: tuple[Material, ...]) -> Soup:
    def gather(array: NDArray[np.float32]) -> NDArray[np.float64]:
        return array[mesh.triangles].astype(np.float64)

    return Soup(
        corners=gather(mesh.positions),
        uvs=gather(mesh.uvs),
        front=gather(mesh.front),
        back=gather(mesh.back),
        opacity=gather(mesh.base)[..., 3],
        material_ids=mesh.material_ids.astype(np.int64),
        materials=materials,
    )
