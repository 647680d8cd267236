"""
Which part of a crown a slice shows, by the definition in the documentation of slicings, in f64.

Leaves go to the nearest plane; leaves longer than the spacing are cut half way between planes, here
as geometry and not sample by sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.references.baked import card_view
from treelod.references.soup import foliage_soup
from treelod.references.texels import decoded

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.plants import Plant
    from treelod.references.soup import Soup
    from treelod.techniques import Slicings

__all__ = ["Crown", "stored_alpha", "stored_texels"]

_FLAT = 1e-6
"""Share of its radius below which a crown is flat, all in the first slice, or a line as seen."""

_TIE = 1e-9
"""Share of the spacing by which a leaf may lie beyond the middle and still count as on it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Crown:
    """
    A plant's leaves, sliced across one direction.

    Attributes
    ----------
    right, up, toward : ndarray of shape (3,)
        Axes of the slices; `toward` leads to the viewer.
    center : ndarray of shape (3,)
        Relative to `Plant.origin`.
    half : tuple of 2 floats
        Half the rectangle's width and height in metres.
    reach : float
        Everything lies within this distance of the centre, in metres.
    slices : list of Soup
        By rising offset along `toward`.
    whole : Soup
        All leaves, uncut.
    large_count : int
        Leaves that are cut.
    """

    right: NDArray[np.float64]
    up: NDArray[np.float64]
    toward: NDArray[np.float64]
    center: NDArray[np.float64]
    half: tuple[float, float]
    reach: float
    slices: list[Soup]
    whole: Soup
    large_count: int

    @classmethod
    def of(cls, plant: Plant, toward: NDArray[np.float64], slice_count: int) -> Crown:
        """
        Slice a plant's leaves.

        Parameters
        ----------
        plant : Plant
            With leaves.
        toward : ndarray of shape (3,)
            Unit vector to the viewer, not vertical.
        slice_count : int
            How many slices.

        Returns
        -------
        Crown
        """
        foliage = plant.foliage
        soup = foliage_soup(plant)
        middles = foliage.centers.astype(np.float64)
        center = 0.5 * (middles.min(axis=0) + middles.max(axis=0))
        right = np.cross((0.0, 1.0, 0.0), toward)
        right /= np.linalg.norm(right)
        up = np.cross(toward, right)
        offsets = (middles - center) @ toward
        around = soup.corners.reshape(-1, 3) - center
        reach = float(np.linalg.norm(around, axis=1).max())
        depth = 2.0 * float(np.abs(offsets).max())
        flat = depth <= _FLAT * reach
        # any, where all lies in one plane
        spacing = 1.0 if flat else depth / slice_count
        starts = foliage.leaf_offsets[:-1]
        leaf_of = np.repeat(np.arange(foliage.leaf_count), np.diff(foliage.leaf_offsets))
        heights = (soup.corners - center) @ toward
        low = np.minimum.reduceat(heights.min(axis=1), starts)
        high = np.maximum.reduceat(heights.max(axis=1), starts)
        large = (high - low > spacing * (1.0 + _TIE)) & (slice_count > 1 and not flat)
        index = np.ceil(offsets / spacing + slice_count / 2.0 - _TIE) - 1.0
        index = np.clip(index, 0, 0 if flat else slice_count - 1).astype(np.int64)
        cut_up = soup.take(large[leaf_of])
        slices = []
        for number in range(slice_count):
            part = cut_up
            lower = (number - slice_count / 2.0) * spacing
            if number > 0:
                part = part.cut(toward, lower + center @ toward)
            if number + 1 < slice_count:
                part = part.cut(-toward, -(lower + spacing + center @ toward))
            whole = soup.take((~large & (index == number))[leaf_of])
            slices.append(whole.joined(part))
        least = _FLAT * reach
        half = (
            max(float(np.abs(around @ right).max()), least),
            max(float(np.abs(around @ up).max()), least),
        )
        return cls(
            right=right,
            up=up,
            toward=toward,
            center=center,
            half=half,
            reach=reach,
            slices=slices,
            whole=soup,
            large_count=int(large.sum()),
        )

    def view(self, side: int) -> dict[str, Any]:
        """
        Return the parallel view that fills a square texture with the rectangle.

        Parameters
        ----------
        side : int
            Texels along each axis.

        Returns
        -------
        dict
            As `treelod.references.views.camera_settings`.
        """
        axes = self.right, self.up, self.toward
        return card_view(self.center, axes, self.half, self.reach, (side, side))


def stored_alpha(
    lod: Slicings, slicing: int, slice_count: int, side: int
) -> list[NDArray[np.float64]]:
    """
    Return the alpha of a slicing's textures.

    Parameters
    ----------
    lod : Slicings
        Built with `slice_count` slices of `side` x `side` texels.
    slicing : int
        Which one.
    slice_count, side : int
        As built.

    Returns
    -------
    list of ndarray of shape (side, side)
        By rising offset; 0 where no texture is kept because nothing is in it.
    """
    return [texels[..., 3] for texels in stored_texels(lod, slicing, slice_count, side)]


def stored_texels(
    lod: Slicings, slicing: int, slice_count: int, side: int
) -> list[NDArray[np.float64]]:
    """
    Return a slicing's textures as they are mixed.

    Parameters
    ----------
    lod, slicing, slice_count, side
        As for `stored_alpha`.

    Returns
    -------
    list of ndarray of shape (side, side, 4)
        Linear and premultiplied, by rising offset; 0 where no texture is kept because nothing is
        in it.
    """
    textures = {texture.name: texture.levels[0] for texture in lod.textures}
    levels = [textures.get(f"slicing {slicing}, slice {number}") for number in range(slice_count)]
    return [np.zeros((side, side, 4)) if level is None else decoded(level) for level in levels]
