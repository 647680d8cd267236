"""How much of each pixel and texel is covered: views and slices against mitsuba."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from treelod import _core
from treelod.references import mitsuba
from treelod.references.baked import BAKE_SAMPLES, BakedCard, bias, card_checks, panel
from treelod.references.cards import SIDE_PARTS
from treelod.references.checks import Check, Section
from treelod.references.runner import in_parallel
from treelod.references.slices import Crown, stored_alpha
from treelod.references.soup import plant_soup
from treelod.references.views import camera_settings, check_cameras
from treelod.render import render
from treelod.techniques import FullMesh, Slicings

if TYPE_CHECKING:
    from collections.abc import Callable

    from treelod.plants import Plant

__all__ = [
    "SliceSettings",
    "slices_section",
    "view_section",
]

MANY_SAMPLES = 256
"""Ours, where a picture is compared with the truth and not with another 16-sample picture."""

MAX_CORNER_ERROR = 1e-6
"""Largest distance of a corner, as a share of the crown's radius: both sides round to f32."""


class SliceSettings(NamedTuple):
    """
    How much of the slices is checked.

    Attributes
    ----------
    side : int
        Texels of a slice along each axis.
    precise_count : int
        Slices of the first slicing that are compared with many samples.
    precise_spp : int
        Of mitsuba for those.
    slicing_count : int
        Slicings of which all other slices are tested.
    spp : int
        Of mitsuba for those.
    """

    side: int
    precise_count: int
    precise_spp: int
    slicing_count: int
    spp: int


SLICING_COUNT, SLICE_COUNT = 6, 5
"""The technique's defaults."""

TOGETHER_SIDE = 256
"""
The technique's default, at any extent: it needs no reference. Textures are blended as if what they
cover inside a texel were independent, which is the less true the coarser they are.
"""


def view_section(
    plant: Plant, size: tuple[int, int], spp: int, progress: Callable[[int, int], None]
) -> Section:
    """
    Check the coverage of the whole plant in a perspective view.

    Parameters
    ----------
    plant : Plant
        Any; masks and wood included.
    size : tuple of 2 ints
        Pixels.
    spp : int
        Samples a pixel of mitsuba.
    progress : callable
        Called with bands of the picture done and all.

    Returns
    -------
    Section
    """
    camera = check_cameras(plant, size)["perspective"]
    picture = {
        "soup": 0,
        "view": camera_settings(camera, plant.origin),
        "quantity": "alpha",
        "spp": spp,
        "seed": 1,
        "sampler": "multijitter",
        "side_parts": SIDE_PARTS,
    }
    theirs = np.concatenate(in_parallel(mitsuba.banded(plant_soup(plant), picture), progress))
    frame = render(FullMesh.build(plant), camera, samples=MANY_SAMPLES, outputs=("color",))
    assert frame.color is not None
    ours = frame.color[..., 3]
    return Section(
        title="Coverage of a view",
        what=f"The full mesh, {size[0]} x {size[1]} pixels, {MANY_SAMPLES} samples, against "
        f"mitsuba at {spp}.",
        checks=[bias("alpha of the view, bias", ours, theirs)],
        panels=[panel("alpha of the view", ours, theirs)],
    )


def slices_section(
    plant: Plant, settings: SliceSettings, progress: Callable[[int, int], None]
) -> Section:
    """
    Check the textures of slices, and that a slicing's slices make up its crown.

    Parameters
    ----------
    plant : Plant
        With leaves.
    settings : SliceSettings
        How much is checked.
    progress : callable
        Called with slices done and all.

    Returns
    -------
    Section
    """
    side = settings.side
    lod = _build(plant, side, SLICE_COUNT, BAKE_SAMPLES)
    directions = np.array(_core.circle_directions(SLICING_COUNT))[: settings.slicing_count]
    crowns = [Crown.of(plant, direction, SLICE_COUNT) for direction in directions]
    # the middle first: it holds most leaves
    order = sorted(range(SLICE_COUNT), key=lambda number: abs(number - SLICE_COUNT // 2))
    places = [(slicing, number) for slicing in range(len(crowns)) for number in order]
    stored = [stored_alpha(lod, slicing, SLICE_COUNT, side) for slicing in range(len(crowns))]
    cards = [
        BakedCard(
            name=f"slice {number}",
            view=crowns[slicing].view(side),
            leaves=crowns[slicing].slices[number],
            alpha=stored[slicing][number],
        )
        for slicing, number in places
    ]
    checks, panels = card_checks(
        cards,
        many=settings.precise_count,
        many_spp=settings.precise_spp,
        spp=settings.spp,
        others="other slices",
        progress=progress,
    )
    corners = [_corner_error(plant, lod, slicing, crown) for slicing, crown in enumerate(crowns)]
    checks.append(
        Check(
            name="corners of slices",
            value=float(np.max(corners)),
            relation="<=",
            limit=MAX_CORNER_ERROR,
            note="of the crown's radius",
        )
    )
    checks += together(plant)
    return Section(
        title="Coverage of slices",
        what=f"Textures of {side} x {side} texels, {BAKE_SAMPLES} samples a texel, as stored, "
        f"against mitsuba's pictures of exactly the leaves, cut or whole, that belong to each: "
        f"slices of the first slicing at {settings.precise_spp} samples, others at {settings.spp}.",
        checks=checks,
        panels=panels,
    )


def together(plant: Plant, side: int = TOGETHER_SIDE) -> list[Check]:
    """
    Check that the slices of a slicing make up the crown, neither more nor less.

    Parameters
    ----------
    plant : Plant
        With leaves.
    side : int, default 256
        Texels of a slice along each axis.

    Returns
    -------
    list of Check
        At one sample, where each texel is covered or not; and the mean at 16.
    """
    checks = []
    for samples in (1, BAKE_SAMPLES):
        through = np.ones((side, side))
        lod = _build(plant, side, SLICE_COUNT, samples, 1)
        for alpha in stored_alpha(lod, 0, SLICE_COUNT, side):
            through *= 1.0 - alpha
        (whole,) = stored_alpha(_build(plant, side, 1, samples, 1), 0, 1, side)
        if samples == 1:
            checks.append(
                Check(
                    name="slices together: texels unlike the whole crown's at 1 sample",
                    value=float((1.0 - through != whole).sum()),
                    relation="<=",
                    limit=0.0,
                    note=f"{side * side} texels",
                )
            )
        else:
            checks.append(bias("slices together: bias at 16 samples", 1.0 - through, whole))
    return checks


def _build(
    plant: Plant, side: int, slice_count: int, samples: int, slicing_count: int = SLICING_COUNT
) -> Slicings:
    return Slicings.build(
        plant,
        slicing_count=slicing_count,
        slice_count=slice_count,
        resolution=side,
        samples=samples,
        wood=False,
    )


def _corner_error(plant: Plant, lod: Slicings, slicing: int, crown: Crown) -> float:
    """Largest distance of a slice's corner from the twin's rectangle, across the direction."""
    across = crown.half[0] * crown.right
    along = crown.half[1] * crown.up
    middle = crown.center + plant.origin
    expected = middle + np.array([-across - along, across - along, across + along, along - across])
    axes = np.stack([crown.right, crown.up])
    errors = [0.0]
    for texture in lod.textures:
        if texture.name.startswith(f"slicing {slicing},"):
            assert texture.corners is not None
            offsets = (texture.corners - expected) @ axes.T
            errors.append(float(np.abs(offsets).max()) / crown.reach)
    return float(np.max(errors))
