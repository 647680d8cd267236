"""
Which leaves a cluster's card shows, and where they lie once they are flattened, in f64.

A cluster's leaves are those that bear its number, its plane is the one that is stated; all else is
worked out from the definition.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from treelod.references.baked import BakedCard, card_view
from treelod.references.soup import foliage_soup
from treelod.techniques import LeafClusters

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.plants import Plant
    from treelod.references.soup import Soup
    from treelod.techniques.leaf_clusters import CardSide

__all__ = ["LEAST_SIDE", "Cluster", "ClusterSettings", "build", "clusters_of", "crown_reach"]

LEAST_SIDE = 3e-6
"""Of the crown's radius: thinner rectangles are widened by the technique, and are not compared."""


class ClusterSettings(NamedTuple):
    """
    How much of leaf clusters is checked.

    Attributes
    ----------
    side : int
        Texels of a card along each axis.
    cluster_count : int
        Clusters asked for.
    card_count : int
        Cards whose sides are compared, those with most leaves first.
    turned_count : int
        The same, of cards with leaves turned into their planes.
    precise_count : int
        Sides that are compared with many samples, of each kind.
    precise_spp : int
        Of mitsuba for those.
    spp : int
        Of mitsuba for the others.
    rays : tuple of 2 ints
        Pixels of the views whose depth is compared.
    """

    side: int
    cluster_count: int
    card_count: int
    turned_count: int
    precise_count: int
    precise_spp: int
    spp: int
    rays: tuple[int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class Cluster:
    """
    The leaves of a cluster in the place where its card shows them.

    Attributes
    ----------
    number : int
        The cluster.
    normal : ndarray of shape (3,)
        Of its plane, upwards: to the viewer of the card's front.
    offset : float
        The plane is where ``position @ normal + offset == 0``, relative to `Plant.origin`.
    leaves : Soup
        Whole; turned into the plane's direction if that is how they are flattened.
    leaf_of : ndarray of shape (T,), dtype int64
        Leaf of each triangle.
    turned : bool
        Whether the leaves have been turned, so that all are parallel to the plane.
    distances : ndarray of shape (V,)
        Signed distance in metres of each corner of each triangle from the plane as leaves grow.
    """

    number: int
    normal: NDArray[np.float64]
    offset: float
    leaves: Soup
    leaf_of: NDArray[np.int64]
    turned: bool
    distances: NDArray[np.float64]

    @property
    def leaf_count(self) -> int:
        """How many leaves there are."""
        return len(np.unique(self.leaf_of))

    @property
    def vertices(self) -> NDArray[np.float64]:
        """Corners of all triangles, shape (V, 3)."""
        return self.leaves.corners.reshape(-1, 3)

    @property
    def deviations(self) -> NDArray[np.float64]:
        """Signed distance of each vertex from the plane in metres, shape (V,)."""
        return self.vertices @ self.normal + self.offset

    def on_card(self, side: CardSide, origin: NDArray[np.float64], reach: float) -> BakedCard:
        """
        Return one side of the card with the leaves that belong there.

        Parameters
        ----------
        side : CardSide
            Of this cluster.
        origin : ndarray of shape (3,)
            `Plant.origin`.
        reach : float
            Of the crown, in metres.

        Returns
        -------
        BakedCard
            Seen from the side's own side of the plane, whichever way its corners run.
        """
        assert side.texels is not None
        corners = side.corners - origin
        across = corners[1] - corners[0]
        width, height = (float(np.linalg.norm(corners[k] - corners[0])) for k in (1, 3))
        toward = -self.normal if side.is_back else self.normal
        right = across / width
        axes = right, np.cross(toward, right), toward
        rows, columns = side.texels.shape[:2]
        farthest = max(float(np.abs(self.deviations).max()), width, height, LEAST_SIDE * reach)
        leaves = self._apart(farthest) if self.turned else self.leaves
        return BakedCard(
            name="back" if side.is_back else "front",
            view=card_view(
                corners.mean(axis=0), axes, (width / 2, height / 2), 2.0 * farthest, (columns, rows)
            ),
            leaves=leaves,
            alpha=side.texels[..., 3] / 255.0,
        )

    def _apart(self, farthest: float) -> Soup:
        """
        Return the leaves in their order along the normal, spread evenly over twice `farthest`.

        Crossed leaves with one centre lie in one plane once they are turned. A ray that passes the
        clear part of one would start again behind the other; apart they cover what they covered.
        """
        leaf_ids, numbers = np.unique(self.leaf_of, return_inverse=True)
        own = self.deviations.reshape(-1, 3).mean(axis=1)
        heights = np.bincount(numbers, own) / np.bincount(numbers)
        places = np.empty(len(leaf_ids))
        places[np.argsort(heights, kind="stable")] = np.linspace(-farthest, farthest, len(leaf_ids))
        shifts = (places - heights)[numbers]
        corners = self.leaves.corners + shifts[:, np.newaxis, np.newaxis] * self.normal
        return replace(self.leaves, corners=corners)


def clusters_of(plant: Plant, lod: LeafClusters, level: int = 0) -> list[Cluster]:
    """
    Sort a plant's leaves into the clusters of a level.

    Parameters
    ----------
    plant : Plant
        With leaves.
    lod : LeafClusters
        Built of it.
    level : int, default 0
        Which one.

    Returns
    -------
    list of Cluster
        By number.
    """
    soup = foliage_soup(plant)
    ids = lod.cluster_ids_at(level).astype(np.int64)
    planes = lod.planes_at(level)
    planes = np.where(planes[:, 1:2] < 0.0, -planes, planes)
    leaf_of = np.repeat(np.arange(plant.foliage.leaf_count), np.diff(plant.foliage.leaf_offsets))
    turned = lod.params["flatten"] == "rotate"
    grown = soup.corners
    if turned:
        soup = _turned(plant, soup, leaf_of, planes[ids, :3])
    return [
        Cluster(
            number=number,
            normal=plane[:3],
            offset=float(plane[3] + plane[:3] @ plant.origin),
            leaves=soup.take(ids[leaf_of] == number),
            leaf_of=leaf_of[ids[leaf_of] == number],
            turned=turned,
            distances=grown[ids[leaf_of] == number].reshape(-1, 3) @ plane[:3]
            + float(plane[3] + plane[:3] @ plant.origin),
        )
        for number, plane in enumerate(planes)
    ]


def _turned(
    plant: Plant, soup: Soup, leaf_of: NDArray[np.int64], normals: NDArray[np.float64]
) -> Soup:
    """Leaves turned about their centres by the least turn that makes them parallel to a plane."""
    own = plant.foliage.normals.astype(np.float64)
    # either side of a leaf may come to face the plane's normal, whichever is nearer
    own = np.where((own * normals).sum(axis=1, keepdims=True) < 0.0, -own, own)
    axes = np.cross(own, normals)
    sines = np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.arctan2(sines, (own * normals).sum(axis=1, keepdims=True))
    # a leaf without area has no normal, and stays
    vectors = np.where(sines > 0.0, axes / np.where(sines > 0.0, sines, 1.0) * angles, 0.0)
    turns = Rotation.from_rotvec(vectors).as_matrix()[leaf_of]
    centers = plant.foliage.centers.astype(np.float64)[leaf_of][:, np.newaxis]
    corners = centers + np.einsum("tij,tkj->tki", turns, soup.corners - centers)
    return replace(soup, corners=corners)


def crown_reach(plant: Plant) -> float:
    """
    Return the largest distance of a leaf's vertex from the middle of the leaves' centres.

    Parameters
    ----------
    plant : Plant
        With leaves.

    Returns
    -------
    float
        Metres; 1 for a point.
    """
    foliage = plant.foliage
    middles = foliage.centers.astype(np.float64)
    center = 0.5 * (middles.min(axis=0) + middles.max(axis=0))
    around = foliage.positions[foliage.triangles].astype(np.float64) - center
    return float(np.linalg.norm(around, axis=2).max()) or 1.0


def build(plant: Plant, cluster_count: int, **params: Any) -> LeafClusters:
    """
    Build leaf clusters of one level, without wood.

    Parameters
    ----------
    plant : Plant
        With leaves.
    cluster_count : int
        Clusters asked for.
    **params
        The rest, as `LeafClusters.build` takes it.

    Returns
    -------
    LeafClusters
    """
    return LeafClusters.build(plant, cluster_count=cluster_count, wood=False, **params)
