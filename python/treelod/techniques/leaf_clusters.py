"""Leaf clusters: leaves near a common plane become one card in it; levels of ever fewer cards."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from treelod import _core
from treelod.render import camera_facts, thread_count
from treelod.techniques.technique import (
    Technique,
    TextureFormat,
    core_of,
    flag,
    is_many,
    number,
    numbers,
    resolution_texels,
    whole,
    whole_numbers,
    wood_facts,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant

__all__ = ["CardSide", "LeafClusters"]


@dataclass(frozen=True, kw_only=True, eq=False)
class CardSide:
    """
    One side of a cluster's card.

    Attributes
    ----------
    cluster : int
        Its cluster.
    is_back : bool
        Whether this is the side away from the card's normal, which looks up.
    corners : ndarray of shape (4, 3), dtype float64
        World positions of its picture's corners in metres, from the lower left counter-clockwise as
        seen from its side.
    outline : ndarray of shape (V, 3), dtype float64
        World positions of the card's corners in metres.
    texels : ndarray of shape (H, W, 4), dtype uint8, or None
        The finest level of its picture, sRGB with straight alpha, row 0 on top; None with indirect
        texturing.
    """

    cluster: int
    is_back: bool
    corners: NDArray[np.float64]
    outline: NDArray[np.float64]
    texels: NDArray[np.uint8] | None


class LeafClusters(Technique):
    """
    Clusters of leaves, flattened and baked on a card each; see `build`.

    Attributes
    ----------
    level_count : int
        Clusterings held; level 0 is the finest.
    level_errors : list of float
        Metres, one a level: root mean square distance of leaf vertices from their planes, never
        less than the finer level's.
    kmeans_errors : list of float
        Total error in square metres after each iteration of k-means.
    converged : bool
        Whether k-means ended before `max_iterations`: because nothing changed any more, or by less
        than 1e-12 of the error.
    alpha : float
        Weight of the angle in use, in square metres.
    atlas_fills : list of float
        Share of each level's texture that cards cover.
    """

    name: ClassVar[str] = "leaf_clusters"

    def __init__(
        self, clusters: _core.LeafClusters, params: Mapping[str, Any], build_secs: float
    ) -> None:
        super().__init__(clusters.representation(), params, build_secs)
        self._clusters = clusters
        self.level_count: int = clusters.level_count
        self.level_errors: list[float] = clusters.level_errors
        self.kmeans_errors, self.converged = clusters.kmeans_errors
        self.alpha: float = clusters.alpha
        self.atlas_fills: list[float] = clusters.atlas_fills

    @property
    def cluster_ids(self) -> NDArray[np.uint32]:
        """Cluster of each leaf at the finest level, shape (L,)."""
        return self.cluster_ids_at(0)

    @property
    def planes(self) -> NDArray[np.float64]:
        """
        Planes of the finest level in the world, shape (K, 4).

        A row (nx, ny, nz, d) is the plane of all points p with ``n . p + d == 0``; n has unit
        length and d is not negative.
        """
        return self.planes_at(0)

    def cluster_ids_at(self, level: int) -> NDArray[np.uint32]:
        """Cluster of each leaf at a level, shape (L,)."""
        return self._clusters.cluster_ids(_level(level))

    def planes_at(self, level: int) -> NDArray[np.float64]:
        """Planes of a level in the world, shape (K, 4), as `planes`."""
        return self._clusters.planes(_level(level))

    def parents_at(self, level: int) -> NDArray[np.uint32]:
        """For each cluster of a level, its cluster of the next: (K,), or (0,) at the coarsest."""
        return self._clusters.parents(_level(level))

    def card_sides_at(self, level: int) -> list[CardSide]:
        """Every side of every card of a level that was baked, cluster by cluster."""
        sides = self._clusters.card_sides(_level(level))
        name = f"level {level}, "
        atlas = next((t.levels[0] for t in self.textures if t.name.startswith(name)), None)

        def cut(place: tuple[int, int, int, int] | None) -> NDArray[np.uint8] | None:
            if place is None or atlas is None:
                return None
            x, y, width, height = place
            return atlas[y : y + height, x : x + width]

        return [
            CardSide(
                cluster=cluster,
                is_back=is_back,
                corners=np.array(corners),
                outline=np.array(outline),
                texels=cut(place),
            )
            for cluster, is_back, corners, outline, place in sides
        ]

    def at(self, *, level: int, t: float = 0.0) -> LeafClusters:
        """
        Hold one level for every view.

        Parameters
        ----------
        level : int
            In ``range(level_count)``; 0 is the finest.
        t : float, default 0
            Share of the way to the next level, in [0, 1]; 0 at the coarsest.

        Returns
        -------
        LeafClusters
            It shares everything with this one.

        Raises
        ------
        ValueError
            If an argument is out of range.
        """
        params = {**self.params, "level": level, "t": t}
        return LeafClusters(
            self._clusters.at(_level(level), number("t", t)), params, self.build_secs
        )

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        cluster_count: int | Sequence[int] = 32,
        alpha_rel: float = 0.01,
        alpha: float | None = None,
        init: Literal["plus_plus", "random"] | ArrayLike = "plus_plus",
        seed: int = 0,
        restarts: int = 1,
        max_iterations: int = 100,
        eigen: Literal["exact", "paper"] = "exact",
        flatten: Literal["project", "rotate"] = "project",
        two_sided: bool = True,
        resolution: int | tuple[int, int] = 512,
        texels_per_metre: float | None = None,
        samples: int = 16,
        format: TextureFormat = "rgba8",  # noqa: A002
        texturing: Literal["direct", "indirect"] = "direct",
        layers: int = 2,
        rotation_count: int = 64,
        leaf_resolution: int = 64,
        texels_per_leaf: int = 4,
        drawing: Literal["test", "coverage", "blend"] = "test",
        outline: int | None = None,
        level_error_px: float = 1.0,
        level_distances: float | Sequence[float] | None = None,
        morph: bool = True,
        fade_share: float = 0.1,
        views: Sequence[Camera] | None = None,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> LeafClusters:
        """
        Cluster a plant's leaves by planes and bake a card for each; the wood stays a mesh.

        Parameters
        ----------
        plant : Plant
            A plant with leaves.
        cluster_count : int or sequence of int, default 32
            Clusters, in 1..=4096, or those of each level, falling: ``(128, 64, 32, 16, 8)``. A
            crown of fewer leaves, or of fewer planes, has fewer. Coarser levels merge clusters of
            finer ones. With pictures of 512 x 512 texels on both sides a level holds about 110
            cards: give more of them a smaller `resolution`.
        alpha_rel : float, default 0.01
            Weight of the angle between leaf and plane against their distance, times the square of
            the crown's radius (largest distance of a leaf's vertex from the centre of the box of
            leaf centres); at least 0.
        alpha : float, optional
            The weight itself, in square metres; then `alpha_rel` does not count.
        init : {'plus_plus', 'random'} or array_like, default 'plus_plus'
            First planes of k-means: of leaves drawn in proportion to their error, through random
            leaves with random normals (the paper's), given planes of shape (K, 4) in the world, or
            those of given cluster ids of shape (L,).
        seed : int, default 0
            Of every random choice; at least 0.
        restarts : int, default 1
            Runs of k-means, of which the one of least error counts.
        max_iterations : int, default 100
            Iterations of a run, at most.
        eigen : {'exact', 'paper'}, default 'exact'
            How a plane is fitted. The paper's iteration does not always find the best plane.
        flatten : {'project', 'rotate'}, default 'project'
            Leaves get into their plane along its normal, which makes leaning ones smaller, or are
            turned about their centres, which keeps their area.
        two_sided : bool, default True
            Whether each card has a second picture, baked from behind. Otherwise the picture of the
            side that looks up is seen from both.
        resolution : int or (int, int), default 512
            Texels of a card, width and height, each in 1..=16384.
        texels_per_metre : float, optional
            Texels of a card by its size instead; then `resolution` does not count.
        samples : int, default 16
            Samples a texel, as in `treelod.render`.
        format : {'rgba8', 'rgb5a1', 'rgb8', 'palette8', 'bc1', 'bc3', 'bc7'}, default 'rgba8'
            How texels are stored, and so what is drawn of them; see `TextureFormat`.
        texturing : {'direct', 'indirect'}, default 'direct'
            Whether a card stores its texels, or names the leaves that are seen in it: all leaves
            are then drawn as turned copies of one, each with its own tint. Then `resolution`,
            `texels_per_metre` and `format` do not count.
        layers : int, default 2
            With indirect texturing: leaves that a texel can name, in 1..=8.
        rotation_count : int, default 64
            With indirect texturing: angles at which the leaf is stored, in 1..=128.
        leaf_resolution : int, default 64
            With indirect texturing: texels a side of the leaf's picture, in 1..=1024.
        texels_per_leaf : int, default 4
            With indirect texturing: texels of the map along the side of a leaf's square, in 1..=64.
        drawing : {'test', 'coverage', 'blend'}, default 'test'
            Cards are there where alpha is at least one half; or on as many of a pixel's samples as
            alpha asks for, other samples for each card; or blended far to near, without depth.
        outline : int, optional
            Corners at most, in 3..=64, of a convex outline that each card is cut to. Default: the
            whole rectangle.
        level_error_px : float, default 1.0
            With several levels: the coarsest is drawn whose error is at most this many pixels where
            the crown is nearest to the eye.
        level_distances : float or sequence of float, optional
            Distances of the eye from the crown's centre, in crown radii, at which one level
            becomes the next: rising, one less than levels. Then `level_error_px` does not count.
        morph : bool, default True
            Whether a level's cards move into the next one's planes on the way to it.
        fade_share : float, default 0.1
            Last share of that way over which the next level is faded in, in [0, 1].
        views : sequence of Camera, optional
            The cameras that will look. Cards then have no more texels than the nearest of them has
            pixels, and only the sides that one of them sees. Default: all directions.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to; see `FullMesh.build`.
        threads : int, optional
            Threads that work. Default: ``TREELOD_NUM_THREADS``, else all cores.
        progress : callable, optional
            Called as ``progress(done, total)``: with iterations of k-means, then from 0 again with
            card sides baked.

        Returns
        -------
        LeafClusters

        Raises
        ------
        ValueError
            If an argument is out of range, or if the plant has no leaves.
        LimitError
            If all cards together would have more than 2**29 texels, or do not fit into a texture of
            16384 x 16384 and 2**26 texels a level.

        Notes
        -----
        The method is that of [1]_; what differs is marked in the documentation.

        References
        ----------
        .. [1] I. Garcia, M. Sbert, L. Szirmay-Kalos. Leaf Cluster Impostors for Tree Rendering with
           Parallax. Eurographics 2005, short presentations.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> lod = tl.LeafClusters.build(plant, cluster_count=8, resolution=64)
        >>> lod.footprint.cards, lod.planes.shape
        (8, (8, 4))
        """
        counts = whole_numbers("cluster_count", cluster_count)
        wood_params = wood_facts(wood=wood, wood_triangle_count=wood_triangle_count)
        initial, init_name = _init(init)
        size = resolution_texels("resolution", resolution)
        distances = None if level_distances is None else numbers("level_distances", level_distances)
        facts: dict[str, Any] = {
            "cluster_counts": counts,
            "alpha": None if alpha is None else number("alpha", alpha),
            "alpha_rel": number("alpha_rel", alpha_rel),
            "init": initial,
            "seed": whole("seed", seed, 0, 2**64),
            "restarts": whole("restarts", restarts),
            "max_iterations": whole("max_iterations", max_iterations),
            "eigen": eigen,
            "flatten": flatten,
            "two_sided": flag("two_sided", two_sided),
            "resolution": size,
            "texels_per_metre": (
                None if texels_per_metre is None else number("texels_per_metre", texels_per_metre)
            ),
            "samples": whole("samples", samples),
            "format": format,
            "texturing": texturing,
            "layers": whole("layers", layers),
            "rotation_count": whole("rotation_count", rotation_count),
            "leaf_resolution": whole("leaf_resolution", leaf_resolution),
            "texels_per_leaf": whole("texels_per_leaf", texels_per_leaf),
            "drawing": drawing,
            "outline": None if outline is None else whole("outline", outline),
            "level_error_px": number("level_error_px", level_error_px),
            "level_distances": distances,
            "morph": flag("morph", morph),
            "fade_share": number("fade_share", fade_share),
            **wood_params,
        }
        cameras = None if views is None else [camera_facts(camera) for camera in views]
        start = time.perf_counter()
        clusters = _core.leaf_clusters(
            core_of(plant),
            {**facts, "views": cameras},
            threads=thread_count(threads),
            progress=progress,
        )
        secs = time.perf_counter() - start
        params = {
            "cluster_count": tuple(counts) if is_many(cluster_count) else counts[0],
            **{key: value for key, value in facts.items() if key != "cluster_counts"},
            "init": init_name,
            "views": None if views is None else len(views),
        }
        return cls(clusters, params, secs)


def _level(level: int) -> int:
    return whole("level", level, 0)


def _init(init: str | ArrayLike) -> tuple[Any, str]:
    """Return what the core takes, and what tables show."""
    if isinstance(init, str):
        return init, init
    given = np.asarray(init)
    if given.ndim == 1 and given.dtype.kind in "ui":
        if given.size and not 0 <= given.min() <= given.max() < 2**32:
            msg = "init must have cluster ids of at least 0 and below 2**32"
            raise ValueError(msg)
        return given.tolist(), "ids"
    if given.ndim == 2 and given.shape[1] == 4:
        planes = np.ascontiguousarray(given, dtype=np.float64)
        if not np.isfinite(planes).all():
            msg = "init must be finite"
            raise ValueError(msg)
        return planes.tolist(), "planes"
    msg = f"init must be a name, ids of shape (L,) or planes of shape (K, 4), got {given.shape}"
    raise ValueError(msg)
