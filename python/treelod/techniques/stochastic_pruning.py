"""Stochastic pruning: from afar fewer leaves, each larger."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from treelod import _core
from treelod.render import camera_facts
from treelod.techniques.technique import Technique, core_of, flag, number, whole, wood_facts

if TYPE_CHECKING:
    from collections.abc import Mapping

    from treelod.cameras import Camera
    from treelod.plants import Plant

__all__ = ["PruningLevel", "StochasticPruning"]


@dataclass(frozen=True, kw_only=True)
class PruningLevel:
    """
    How leaves are drawn for a view.

    Attributes
    ----------
    kept_share : float
        Share of the leaves that is drawn (u).
    window : float
        Share of all leaves that is shrinking.
    area_scale : float
        What a whole leaf's area is multiplied by.
    contrast : float
        What a colour's distance from the mean is multiplied by.
    """

    kept_share: float
    window: float
    area_scale: float
    contrast: float


class StochasticPruning(Technique):
    """Leaves in a random order, of which views from afar draw a part; see `build`."""

    name: ClassVar[str] = "stochastic_pruning"

    def __init__(
        self, pruning: _core.StochasticPruning, params: Mapping[str, Any], build_secs: float
    ) -> None:
        super().__init__(pruning.representation(), params, build_secs)
        self._pruning = pruning

    def level(self, camera: Camera) -> PruningLevel:
        """Tell how the leaves are drawn for a camera that looks at the plant where it stands."""
        return PruningLevel(**self._pruning.level(camera_facts(camera)))

    def at(self, *, kept_share: float) -> StochasticPruning:
        """
        Draw the same share of the leaves in every view.

        Parameters
        ----------
        kept_share : float
            In [1e-9, 1]; one leaf is always left.

        Returns
        -------
        StochasticPruning
            It shares everything with this one.

        Raises
        ------
        ValueError
            If the share is out of range.
        """
        params = {**self.params, "kept_share": kept_share}
        pruning = self._pruning.at(number("kept_share", kept_share))
        return StochasticPruning(pruning, params, self.build_secs)

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        leaf_width_px: float = 2.0,
        half_ratio: float = 2.0,
        shrink: float = 0.2,
        contrast: bool = True,
        seed: int = 0,
        wood: bool = True,
        wood_triangle_count: int | None = None,
    ) -> StochasticPruning:
        """
        Put a plant's leaves in a random order; the wood stays a mesh.

        Parameters
        ----------
        plant : Plant
            A plant with leaves.
        leaf_width_px : float, default 2.0
            Width in pixels of a mean leaf, the root of its area, where pruning begins; in
            [1e-3, 1e6].
        half_ratio : float, default 2.0
            How many times farther half of the leaves are left (h), in [1.01, 1e6]:
            ``u = z ** (-log(2) / log(h))`` at z times the distance at which pruning begins.
        shrink : float, default 0.2
            Share of the leaves that are left, or of those that are not if they are fewer, which
            shrink before they leave; in [0, 1]. With 0 they vanish at their full size.
        contrast : bool, default True
            Whether colours move towards their mean where many leaves would share a pixel, since
            fewer of them average less.
        seed : int, default 0
            Of the order; at least 0.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to; see `FullMesh.build`.

        Returns
        -------
        StochasticPruning

        Raises
        ------
        ValueError
            If an argument is out of range, or if the plant has no leaves.

        Notes
        -----
        The method is that of [1]_; what differs is marked in the documentation.

        References
        ----------
        .. [1] R. L. Cook, J. Halstead, M. Planck, D. Ryu. Stochastic Simplification of Aggregate
           Detail. ACM Transactions on Graphics 26(3), article 79, 2007.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> lod = tl.StochasticPruning.build(plant, half_ratio=2.0)
        >>> lod.at(kept_share=0.25).params["kept_share"]
        0.25
        """
        facts: dict[str, Any] = {
            "leaf_width_px": number("leaf_width_px", leaf_width_px),
            "half_ratio": number("half_ratio", half_ratio),
            "shrink": number("shrink", shrink),
            "contrast": flag("contrast", contrast),
            "seed": whole("seed", seed, 0, 2**64),
            **wood_facts(wood=wood, wood_triangle_count=wood_triangle_count),
        }
        start = time.perf_counter()
        pruning = _core.stochastic_pruning(core_of(plant), **facts)
        return cls(pruning, facts, time.perf_counter() - start)
