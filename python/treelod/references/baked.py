"""
Pictures that were baked, card by card, against mitsuba's pictures of exactly the same leaves.

What a card is, whose leaves it shows and from where, is the business of who asks.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.references import mitsuba
from treelod.references.cards import SIDE_PARTS
from treelod.references.checks import Check, Panel, rmse
from treelod.references.runner import in_parallel

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from treelod.references.soup import Soup

__all__ = [
    "BAKE_SAMPLES",
    "MAX_BIAS",
    "BakedCard",
    "bias",
    "card_checks",
    "card_view",
    "largest_z",
    "panel",
    "precise",
]

MAX_BIAS = 1e-3
"""Largest difference of mean alpha: a quarter of a step of 8 bits."""

BAKE_SAMPLES = 16
"""The techniques' default."""

MAX_Z = 6.0
"""
Largest difference of a block of texels, in standard deviations. Of a million blocks of pure noise
one in 500 runs has one beyond.
"""

BLOCK = 8
"""Side of a block in texels: a leaf is some texels, so blocks find one that is missing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BakedCard:
    """
    A rectangle, the leaves that belong on it, and what was baked.

    Attributes
    ----------
    name : str
        Which one, for the report.
    view : dict
        The parallel view that fills the texture with the rectangle, from `card_view`.
    leaves : Soup
        Cut, turned or whole, as they belong on the card.
    alpha : ndarray of shape (H, W)
        As stored, in [0, 1].
    """

    name: str
    view: dict[str, Any]
    leaves: Soup
    alpha: NDArray[np.float64]


def card_view(
    center: NDArray[np.float64],
    axes: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    half: tuple[float, float],
    reach: float,
    size: tuple[int, int],
) -> dict[str, Any]:
    """
    Return the parallel view that fills a texture with a rectangle.

    Parameters
    ----------
    center : ndarray of shape (3,)
        Of the rectangle, relative to `Plant.origin`.
    axes : tuple of 3 ndarrays of shape (3,)
        Units to the right, up and towards the viewer.
    half : tuple of 2 floats
        Half its width and height in metres.
    reach : float
        Everything that is seen lies within this distance of its plane, in metres, above 0.
    size : tuple of 2 ints
        Texels a row, and rows.

    Returns
    -------
    dict
        As `treelod.references.views.camera_settings`.
    """
    right, up, toward = axes
    return {
        "eye": (center + 2.0 * reach * toward).tolist(),
        "right": right.tolist(),
        "up": up.tolist(),
        "back": toward.tolist(),
        "pixel": [2.0 * extent / side for extent, side in zip(half, size, strict=True)],
        "perspective": False,
        "size": list(size),
        "near": 0.5 * reach,
        "far": 4.0 * reach,
    }


def card_checks(
    cards: Sequence[BakedCard],
    *,
    many: int,
    many_spp: int,
    spp: int,
    others: str,
    progress: Callable[[int, int], None],
) -> tuple[list[Check], list[Panel]]:
    """
    Compare cards with mitsuba's pictures.

    Parameters
    ----------
    cards : sequence of BakedCard
        Baked with 16 samples a texel.
    many : int
        How many of the first cards are compared with many samples.
    many_spp, spp : int
        Samples of mitsuba for those, and for the others.
    others : str
        What the others are, for the report.
    progress : callable
        Called with cards done and all.

    Returns
    -------
    checks : list of Check
        Bias and RMSE of the first ones; the largest deviation of the others, if there are any.
    panels : list of Panel
        The first ones.
    """

    def draw(number: int) -> list[NDArray[np.float32]]:
        picture = {
            "soup": 0,
            "view": cards[number].view,
            "quantity": "alpha",
            "side_parts": SIDE_PARTS,
        }
        kinds = [{"spp": spp, "sampler": "independent", "seed": 1}]
        if number < many:
            kinds = [
                {"spp": many_spp, "sampler": "multijitter", "seed": 1},
                {"spp": BAKE_SAMPLES, "sampler": "independent", "seed": 2},
            ]
        # one process a card, so that each is kept as soon as it is drawn
        pictures = [{**picture, **kind} for kind in kinds]
        return mitsuba.draw([cards[number].leaves], pictures, threads=1)[0]

    drawn = in_parallel([functools.partial(draw, k) for k in range(len(cards))], progress)
    checks: list[Check] = []
    panels: list[Panel] = []
    deviations: list[float] = []
    for number, (card, theirs) in enumerate(zip(cards, drawn, strict=True)):
        if number < many:
            checks += precise(card.name, card.alpha, *theirs)
            panels.append(panel(f"alpha of {card.name}", card.alpha, theirs[0]))
        else:
            deviations.append(largest_z(card.alpha, theirs[0], spp))
    if deviations:
        checks.append(
            Check(
                name=f"{others}: largest deviation of a block, in standard deviations",
                value=float(np.max(deviations)),
                relation="<=",
                limit=MAX_Z,
                note=f"{len(deviations)} pictures",
            )
        )
    return checks, panels


def largest_z(ours: NDArray[Any], theirs: NDArray[Any], spp: int) -> float:
    """
    Return the largest deviation of a block of texels in standard deviations.

    Parameters
    ----------
    ours, theirs : ndarray of shape (H, W)
        Alpha of a 16-sample bake, and of `spp` random samples a texel.
    spp : int
        Samples.

    Returns
    -------
    float
        Of blocks of 8 x 8 texels. The variance is that of random samples on both sides, with the
        share covered estimated as (covered + 1) / (samples + 2), so that texels that seem full or
        empty have one too.
    """
    share = (theirs.astype(np.float64) * spp + 1.0) / (spp + 2.0)
    variance = share * (1.0 - share) * (1.0 / spp + 1.0 / BAKE_SAMPLES)
    difference = ours.astype(np.float64) - theirs
    rows, columns = (np.arange(0, extent, BLOCK) for extent in ours.shape)

    def blocks(array: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.add.reduceat(np.add.reduceat(array, rows, axis=0), columns, axis=1))

    return float((np.abs(blocks(difference)) / np.sqrt(blocks(variance))).max())


def precise(
    name: str, ours: NDArray[np.float64], theirs: NDArray[Any], few: NDArray[Any]
) -> list[Check]:
    """
    Compare a card's alpha with the truth, and its error with that of a peer.

    Parameters
    ----------
    name : str
        Which card.
    ours : ndarray of shape (H, W)
        Of 16 samples a texel.
    theirs, few : ndarray of shape (H, W)
        Mitsuba's, of many samples and of 16.

    Returns
    -------
    list of Check
    """
    error, peer = rmse(ours, theirs), rmse(few, theirs)
    # where mitsuba has no error, in an empty picture, we may have none either
    share = error / peer if peer > 0.0 else 0.0 if error == 0.0 else math.inf
    return [
        bias(f"alpha of {name}, bias", ours, theirs),
        Check(
            name=f"alpha of {name}, RMSE over that of mitsuba at 16 samples",
            value=share,
            relation="<=",
            limit=1.0,
            note=f"{error:.4f} against {peer:.4f}",
        ),
    ]


def bias(name: str, ours: NDArray[Any], theirs: NDArray[Any]) -> Check:
    """
    Compare the means of two pictures of alpha.

    Parameters
    ----------
    name : str
        Of the check.
    ours, theirs : ndarray of shape (H, W)
        Alpha.

    Returns
    -------
    Check
    """
    off = float(ours.astype(np.float64).mean() - theirs.astype(np.float64).mean())
    return Check(name=name, value=abs(off), relation="<=", limit=MAX_BIAS, note=f"{off:+.5f}")


def panel(title: str, ours: NDArray[Any], theirs: NDArray[Any]) -> Panel:
    """
    Put two pictures of alpha side by side.

    Parameters
    ----------
    title : str
        What they show.
    ours, theirs : ndarray of shape (H, W)
        Alpha.

    Returns
    -------
    Panel
    """
    return Panel(
        title=title,
        ours=ours,
        reference=theirs,
        difference=np.abs(ours.astype(np.float64) - theirs),
    )
