"""
Depth of leaf clusters' cards: against rays at the cards in f64, and against the leaves themselves.

Cards are tested against alpha: a ray goes on where the texel that it meets is clear.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from treelod.references import rays
from treelod.references.checks import Check, Panel
from treelod.references.clusters import build, clusters_of
from treelod.references.soup import geometry_only
from treelod.references.texels import bilinear
from treelod.references.views import camera_settings, check_cameras, pixel_rays
from treelod.references.visibility import DEPTH_TOLERANCE_REL, MIN_DEPTH_SHARE, depth_picture
from treelod.render import render

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant
    from treelod.references.clusters import Cluster, ClusterSettings
    from treelod.techniques.leaf_clusters import CardSide

__all__ = [
    "TEXEL_PX",
    "CardHits",
    "card_alpha",
    "depth_agreement",
    "depth_checks",
    "first_cards",
    "leaf_distance",
]

TEXEL_PX = 4.0
"""
Pixels of a texel where depth is compared, in the plant's middle: so many that the finest level is
read, on the far side and on cards that are seen askew, too.
"""

ALPHA_CUTOFF = 0.5
"""Alpha from which a card is there, by the definition."""

ALPHA_MARGIN = 0.01
"""
Rays whose alpha is nearer than this to the cutoff may go either way: corners are snapped to 1/256
pixel, texels here are a pixel or larger, and alpha changes by at most 1 a texel along each axis.
"""

MAX_LEFT_OUT = 1.0 / 3.0
"""
Share of rays that may be left out of the comparison, or it says little. A crown of small leaves has
an outline in front of many rays: a fifth of the chestnut's, less of others.
"""

MIN_HIT_SHARE = 0.999
"""Of the other rays, as of those that hit the full mesh at this size."""


class CardHits(NamedTuple):
    """
    Which card each ray meets first.

    Attributes
    ----------
    depth : ndarray of shape (H, W)
        View depth in metres, inf where there is none.
    unsure : ndarray of shape (H, W), dtype bool
        Rays that may go either way by rounding, or that read a coarser level.
    """

    depth: NDArray[np.float64]
    unsure: NDArray[np.bool_]


def first_cards(
    sides: list[CardSide],
    planes: NDArray[np.float64],
    camera: Camera,
    origin: NDArray[np.float64],
) -> CardHits:
    """
    Shoot a ray through each pixel's centre at alpha-tested cards.

    Parameters
    ----------
    sides : list of CardSide
        Of all cards, front and back.
    planes : ndarray of shape (K, 4)
        Of the clusters, in the world.
    camera : Camera
        From where.
    origin : ndarray of shape (3,)
        What positions are made relative to.

    Returns
    -------
    CardHits
    """
    view = camera_settings(camera, origin)
    width, height = camera.size
    # a row and a column more, for how much a texture moves from pixel to pixel
    rows, columns = np.indices((height + 1, width + 1))
    points = _centers(rows, columns)
    starts, directions = pixel_rays(view, points)
    depth = np.full((height, width), np.inf)
    doubtful = np.full((height, width), np.inf)
    for side in sides:
        plane = planes[side.cluster]
        normal = np.where(plane[1] < 0.0, -1.0, 1.0) * plane[:3]
        corners = side.corners - origin
        toward = np.array(view["back"])
        if view["perspective"]:
            toward = np.array(view["eye"]) - corners[0]
        if (normal @ toward < 0.0) != side.is_back:
            continue
        assert side.texels is not None
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = ((corners[0] - starts) @ normal) / (directions @ normal)
            places = starts + distance[:, np.newaxis] * directions - corners[0]
        across, along = corners[1] - corners[0], corners[3] - corners[0]
        uvs = np.stack(
            [places @ across / (across @ across), 1.0 - places @ along / (along @ along)], axis=1
        ).reshape(height + 1, width + 1, 2)
        distance = distance.reshape(height + 1, width + 1)[:-1, :-1]
        there = uvs[:-1, :-1]
        texels = np.array(side.texels.shape[1::-1])
        steps = [(uvs[:-1, 1:] - there) * texels, (uvs[1:, :-1] - there) * texels]
        longest = np.max([np.linalg.norm(step, axis=-1) for step in steps], axis=0)
        # where nothing but the border is filtered in, alpha is below a half all the same
        inside = ((there >= 0.0) & (there <= 1.0)).all(axis=-1) & (distance > camera.near)
        alpha = np.zeros((height, width))
        alpha[inside] = card_alpha(side.texels, there[inside])
        solid = inside & (alpha >= ALPHA_CUTOFF)
        depth = np.where(solid, np.minimum(depth, distance), depth)
        # NaN, where a ray runs along the plane, is doubtful too
        doubt = inside & ~((np.abs(alpha - ALPHA_CUTOFF) > ALPHA_MARGIN) & (longest < 1.0))
        doubtful = np.where(doubt, np.minimum(doubtful, distance), doubtful)
    return CardHits(depth, (doubtful <= depth) & np.isfinite(doubtful))


def _centers(rows: NDArray[Any], columns: NDArray[Any]) -> NDArray[np.float64]:
    """Centres of pixels, shape (N, 2)."""
    return np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64) + 0.5


def card_alpha(texels: NDArray[np.uint8], uvs: NDArray[np.float64]) -> NDArray[np.float64]:
    """
    Read a card's alpha between texels, with nothing around the card.

    Parameters
    ----------
    texels : ndarray of shape (H, W, 4), dtype uint8
        Of the card.
    uvs : ndarray of shape (N, 2)
        Coordinates in [0, 1]; v = 0 is the top row's upper edge.

    Returns
    -------
    ndarray of shape (N,)
    """
    alpha = np.pad(texels[..., 3:] / 255.0, ((1, 1), (1, 1), (0, 0)))
    size = np.array(texels.shape[1::-1])
    return bilinear(alpha, (uvs * size + 1.0) / (size + 2.0), ("clamp", "clamp"))[:, 0]


def depth_checks(plant: Plant, settings: ClusterSettings) -> tuple[list[Check], list[Panel]]:
    """
    Compare the depth of cards with rays at the cards, and with rays at the leaves.

    Parameters
    ----------
    plant : Plant
        With leaves; its textures are left out, so that a leaf stops each ray.
    settings : ClusterSettings
        How many clusters, and the size of views.

    Returns
    -------
    checks : list of Check
    panels : list of Panel
    """
    opaque = geometry_only(plant)
    extent = 2.0 * plant.sphere[1]
    cameras = check_cameras(plant, settings.rays)
    parallel = cameras["orthographic"]
    density = parallel.pixels_per_metre(1.0) / TEXEL_PX
    lod = build(opaque, settings.cluster_count, texels_per_metre=density).at(level=0)
    clusters = clusters_of(opaque, lod)
    views = [camera_settings(camera, plant.origin) for camera in cameras.values()]
    # cluster by cluster, so that a triangle's place says which it belongs to
    corners = np.concatenate([cluster.leaves.corners for cluster in clusters])
    meshes = rays.trace(corners, views)
    checks, panels = [], []
    for (kind, camera), leaves in zip(cameras.items(), meshes, strict=True):
        hits = first_cards(lod.card_sides_at(0), lod.planes_at(0), camera, plant.origin)
        frame = render(lod, camera, samples=1, outputs=("depth", "ids"))
        assert frame.depth is not None
        ours = frame.depth.astype(np.float64)
        checks += depth_agreement(ours, hits, kind, size=extent)
        assert frame.ids is not None
        numbers = frame.ids.astype(np.int64) - len(opaque.wood.triangles)
        checks.append(
            leaf_distance(ours, numbers, clusters, leaves, camera, plant.origin, size=extent)
        )
        both = np.isfinite(ours) & np.isfinite(hits.depth)
        different = np.abs(np.where(both, ours, 0.0) - np.where(both, hits.depth, 0.0)) > (
            DEPTH_TOLERANCE_REL * extent
        )
        panels.append(
            Panel(
                title=f"{kind}: depth of cards (near is bright), and rays that disagree",
                ours=depth_picture(ours),
                reference=depth_picture(hits.depth),
                difference=(different & ~hits.unsure).astype(np.float32),
            )
        )
    return checks, panels


def leaf_distance(
    depth: NDArray[np.float64],
    numbers: NDArray[np.int64],
    clusters: list[Cluster],
    leaves: rays.Hits,
    camera: Camera,
    origin: NDArray[np.float64],
    *,
    size: float,
) -> Check:
    """
    Check that a card is as far from the leaves of its cluster as they are from their plane.

    A ray that shows a card, and in the full mesh a leaf of that card's cluster, meets the two at
    depths that differ by the leaf's distance from the plane over the cosine between them.

    Parameters
    ----------
    depth, numbers : ndarray of shape (H, W)
        Of a frame of cards: depth, inf where there is none, and the cluster.
    clusters : list of Cluster
        By number.
    leaves : Hits
        Of rays through the same pixels at the triangles of all clusters, one after another.
    camera : Camera
        From where.
    origin : ndarray of shape (3,)
        `Plant.origin`.
    size : float
        The plant's size in metres.

    Returns
    -------
    Check
        By how much a ray's distance exceeds that of the farthest corner of the triangle that it
        hits, as a share of the size.
    """
    counts = [cluster.leaves.triangle_count for cluster in clusters]
    cluster_of = np.repeat(np.arange(len(clusters)), counts)
    farthest = np.concatenate(
        [np.abs(cluster.deviations).reshape(-1, 3).max(axis=1) for cluster in clusters]
    )
    both = np.isfinite(depth) & np.isfinite(leaves.depth)
    off = np.abs(depth[both] - leaves.depth[both])
    same = both & (cluster_of[leaves.ids] == numbers)
    rows, columns = np.nonzero(same)
    _, directions = pixel_rays(camera_settings(camera, origin), _centers(rows, columns))
    normals = np.array([cluster.normal for cluster in clusters])[numbers[same]]
    cosines = np.abs((directions * normals).sum(axis=1))
    distance = np.abs(depth[same] - leaves.depth[same]) * cosines
    excess = distance - farthest[leaves.ids[same]]
    kind = "perspective" if camera.is_perspective else "orthographic"
    deviations = np.concatenate([cluster.deviations for cluster in clusters])
    facts = {
        "mean": float(off.mean()) if len(off) else 0.0,
        "largest": float(off.max(initial=0.0)),
        "level": float(np.sqrt(np.mean(deviations**2))),
    }
    return Check(
        name=f"depth of cards, leaves of their cluster farther than from its plane, {kind}",
        value=float(excess.max(initial=0.0)) / size,
        relation="<=",
        limit=DEPTH_TOLERANCE_REL,
        note=f"{len(excess)} rays; along all rays mean {facts['mean']:.3g} m, largest "
        f"{facts['largest']:.3g} m, error of the level {facts['level']:.3g} m",
    )


def depth_agreement(
    depth: NDArray[np.float64], hits: CardHits, kind: str, *, size: float
) -> list[Check]:
    """
    Compare a picture of depth with rays.

    Parameters
    ----------
    depth : ndarray of shape (H, W)
        Of a frame of cards.
    hits : CardHits
        Of rays through the same pixels.
    kind : str
        Of the view, for the report.
    size : float
        The plant's size in metres.

    Returns
    -------
    list of Check
    """
    sure = ~hits.unsure
    ours, theirs = np.isfinite(depth), np.isfinite(hits.depth)
    same = (ours == theirs)[sure]
    both = sure & ours & theirs
    near = np.abs(depth[both] - hits.depth[both]) <= DEPTH_TOLERANCE_REL * size
    left_out = float(hits.unsure.mean())
    note = f"{int(both.sum())} rays hit, {left_out:.1%} left out"
    rows = (
        ("rays with the same hit or miss", same, MIN_HIT_SHARE),
        ("rays with equal depth", near, MIN_DEPTH_SHARE),
    )
    checks = [
        Check(
            name=f"depth of cards, {name}, {kind}",
            # cards too thin to be hit have no depth
            value=float(agrees.mean()) if len(agrees) else 1.0,
            relation=">=",
            limit=limit,
            note=note,
        )
        for name, agrees, limit in rows
    ]
    checks.append(
        Check(
            name=f"depth of cards, share of rays left out, {kind}",
            value=left_out,
            relation="<=",
            limit=MAX_LEFT_OUT,
        )
    )
    return checks
