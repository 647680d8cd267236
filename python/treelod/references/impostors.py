"""
Cards of leaf clusters: their rectangles against trimesh's, and what they show against mitsuba.

Lit colours are compared with embree's hits. Depth has a module of its own.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from treelod.color import srgb_from_linear
from treelod.references.baked import card_checks
from treelod.references.card_depth import TEXEL_PX, depth_checks
from treelod.references.checks import Check, Panel, Section, rmse
from treelod.references.clusters import LEAST_SIDE, build, clusters_of, crown_reach
from treelod.references.geometry import rectangle_area
from treelod.references.runner import in_parallel
from treelod.references.shading import shade
from treelod.references.texels import decoded
from treelod.references.views import sample_positions

if TYPE_CHECKING:
    from collections.abc import Callable

    from treelod.plants import Plant
    from treelod.references.baked import BakedCard
    from treelod.references.clusters import Cluster, ClusterSettings
    from treelod.techniques import LeafClusters

__all__ = ["clusters_section", "color_checks", "place_checks"]

MAX_AREA_ERROR = 1e-6
"""
Largest difference of a rectangle's area, as a share of trimesh's. Leaves that are turned are stored
in f32 before the rectangle is found.
"""

MAX_CORNER_ERROR = 1e-6
"""Of the crown's radius: how far a corner lies off its plane, or a vertex outside its rectangle."""

MAX_LEVEL_ERROR = 1e-6
"""Relative difference of a level's error: a mean of squares of f32 positions."""

MAX_COLOR_RMSE = 0.01
"""
Of linear premultiplied colour, as for views: rays go through the bake's own sample positions, so
what is left is storage in 8 bits and samples on edges.
"""

COLOR_SAMPLES = 64
"""Samples a texel where colours are compared: their positions follow a rule, 16 have a table."""

COLOR_SIDE = 64
"""Texels of a side where colours are compared, at any extent."""


def clusters_section(
    plant: Plant, settings: ClusterSettings, progress: Callable[[int, int], None]
) -> Section:
    """
    Check the cards of leaf clusters: where they lie, what they show, and the depth they give.

    Parameters
    ----------
    plant : Plant
        With leaves.
    settings : ClusterSettings
        How much is checked.
    progress : callable
        Called with pictures done and all.

    Returns
    -------
    Section
    """
    checks: list[Check] = []
    panels: list[Panel] = []
    cards: list[BakedCard] = []
    turned: list[BakedCard] = []
    counts = {"project": settings.card_count, "rotate": settings.turned_count}
    for flatten, count in counts.items():
        lod = build(plant, settings.cluster_count, resolution=settings.side, flatten=flatten)
        clusters = clusters_of(plant, lod)
        kind = "" if flatten == "project" else ", leaves turned"
        checks += place_checks(plant, lod, clusters, kind)
        (cards if flatten == "project" else turned).extend(
            _fullest(plant, lod, clusters, count, kind)
        )
    # those that get many samples first, of both kinds
    many = settings.precise_count
    order = cards[:many] + turned[:many] + cards[many:] + turned[many:]
    found = card_checks(
        order,
        many=len(cards[:many]) + len(turned[:many]),
        many_spp=settings.precise_spp,
        spp=settings.spp,
        others="other sides of cards",
        progress=progress,
    )
    checks += found[0]
    panels += found[1]
    for part in (color_checks(plant, settings), depth_checks(plant, settings)):
        checks += part[0]
        panels += part[1]
    width, height = settings.rays
    return Section(
        title="Leaf clusters",
        what=f"Cards of {settings.cluster_count} clusters, {settings.side} x {settings.side} "
        "texels, as stored, against mitsuba's pictures of exactly the leaves of each, flattened; "
        f"depth of cards with texels of {TEXEL_PX:g} pixels in views of {width} x {height} pixels, "
        "one sample in each pixel's centre, against rays in f64.",
        checks=checks,
        panels=panels,
    )


def _by_size(clusters: list[Cluster]) -> list[Cluster]:
    """Those of most leaves first: most is seen there."""
    return sorted(clusters, key=lambda cluster: (-cluster.leaf_count, cluster.number))


def _fullest(
    plant: Plant, lod: LeafClusters, clusters: list[Cluster], count: int, kind: str
) -> list[BakedCard]:
    """Both sides of the cards with most leaves, named by their rank."""
    sides = lod.card_sides_at(0)
    reach = crown_reach(plant)
    cards = []
    for rank, cluster in enumerate(_by_size(clusters)[:count], start=1):
        for side in sides:
            if side.cluster == cluster.number:
                card = cluster.on_card(side, plant.origin, reach)
                cards.append(replace(card, name=f"{card.name} of card {rank}{kind}"))
    return cards


def place_checks(
    plant: Plant, lod: LeafClusters, clusters: list[Cluster], kind: str = ""
) -> list[Check]:
    """
    Compare rectangles with trimesh's, and the level's error with that of the vertices.

    Parameters
    ----------
    plant : Plant
        With leaves.
    lod : LeafClusters
        Of one level.
    clusters : list of Cluster
        Of that level.
    kind : str, default ''
        Appended to names.

    Returns
    -------
    list of Check
    """
    reach = crown_reach(plant)
    area_errors, overhangs, off_plane = [0.0], [0.0], [0.0]
    thin_count = 0
    for side in lod.card_sides_at(0):
        cluster = clusters[side.cluster]
        corners = side.corners - plant.origin
        off_plane.append(float(np.abs(corners @ cluster.normal + cluster.offset).max()))
        lengths = [float(np.linalg.norm(corners[k] - corners[0])) for k in (1, 3)]
        for k, length in zip((1, 3), lengths, strict=True):
            along = (corners[k] - corners[0]) / length
            places = (cluster.vertices - corners[0]) @ along
            overhangs.append(float(max(-places.min(), places.max() - length)))
        flat = cluster.vertices - np.outer(cluster.deviations, cluster.normal)
        theirs = rectangle_area(flat, cluster.normal)
        if theirs is None or min(lengths) < LEAST_SIDE * reach:
            thin_count += 1
        else:
            area_errors.append(abs(lengths[0] * lengths[1] / theirs - 1.0))
    distances = np.concatenate([cluster.distances for cluster in clusters])
    error = float(np.sqrt(np.mean(distances**2)))
    ours = lod.level_errors[0]
    shares = {
        "largest overhang of a vertex": float(np.max(overhangs)) / reach,
        "corners off their plane": float(np.max(off_plane)) / reach,
    }
    return [
        Check(
            name=f"rectangles of cards: largest relative area difference{kind}",
            value=float(np.max(area_errors)),
            relation="<=",
            limit=MAX_AREA_ERROR,
            note=f"{thin_count} are lines or points, which have none" if thin_count else "",
        ),
        *(
            Check(
                name=f"rectangles of cards: {name}{kind}",
                value=value,
                relation="<=",
                limit=MAX_CORNER_ERROR,
            )
            for name, value in shares.items()
        ),
        Check(
            name=f"error of the level, relative difference{kind}",
            # a flat crown has none but rounding
            value=abs(ours - error) / max(error, LEAST_SIDE * reach),
            relation="<=",
            limit=MAX_LEVEL_ERROR,
            note=f"{ours:.4g} m",
        ),
    ]


def color_checks(plant: Plant, settings: ClusterSettings) -> tuple[list[Check], list[Panel]]:
    """
    Compare the lit colours of the fullest card, front and back, with rays through its samples.

    Parameters
    ----------
    plant : Plant
        With leaves.
    settings : ClusterSettings
        How many clusters.

    Returns
    -------
    checks : list of Check
    panels : list of Panel
    """
    lod = build(plant, settings.cluster_count, resolution=COLOR_SIDE, samples=COLOR_SAMPLES)
    cluster = _by_size(clusters_of(plant, lod))[0]
    reach, positions = crown_reach(plant), sample_positions(COLOR_SAMPLES)
    sides = [side for side in lod.card_sides_at(0) if side.cluster == cluster.number]
    cards = [cluster.on_card(side, plant.origin, reach) for side in sides]
    calls = [functools.partial(shade, card.leaves, card.view, positions) for card in cards]
    errors, panels = [], []
    for side, card, theirs in zip(sides, cards, in_parallel(calls), strict=True):
        assert side.texels is not None
        ours, truth = decoded(side.texels)[..., :3], theirs[..., :3]
        errors.append(rmse(ours, truth))
        panels.append(
            Panel(
                title=f"lit colour of card 1's {card.name}",
                ours=srgb_from_linear(ours),
                reference=srgb_from_linear(truth),
                difference=np.abs(ours - truth).max(axis=2),
            )
        )
    check = Check(
        name="lit colour of card 1, RMSE",
        value=float(np.max(errors)),
        relation="<=",
        limit=MAX_COLOR_RMSE,
        note="front and back, " + " and ".join(f"{error:.4f}" for error in errors),
    )
    return [check], panels
