"""The plant as it is: the reference, and the technique that every other one has to beat."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, ClassVar, Literal

from treelod import _core
from treelod.techniques.technique import Technique, core_of, wood_facts

if TYPE_CHECKING:
    from treelod.plants import Plant

__all__ = ["FullMesh"]


class FullMesh(Technique):
    """Every triangle of a plant; see `build`."""

    name: ClassVar[str] = "full_mesh"

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        filter: Literal["nearest", "bilinear", "trilinear"] = "bilinear",  # noqa: A002
    ) -> FullMesh:
        """
        Take a plant's triangles over.

        Parameters
        ----------
        plant : Plant
            What to draw.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to, at least 1. meshoptimizer stops
            where the surface allows no further step, so there may be more, and drops whole twigs
            that are smaller than its error, so there may be fewer (1808 for 2000 of a chestnut's
            46,000); `footprint` tells. Default: all of it, as it is.
        filter : {'nearest', 'bilinear', 'trilinear'}, default 'bilinear'
            How textures are read. The reference reads level 0, bilinear.

        Returns
        -------
        FullMesh

        Raises
        ------
        ValueError
            If an argument is out of range, or if nothing is left to draw.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=50)
        >>> mesh = tl.FullMesh.build(plant, wood=False)
        >>> mesh.footprint.triangles
        500
        """
        wood_params = wood_facts(wood=wood, wood_triangle_count=wood_triangle_count)
        start = time.perf_counter()
        core = _core.full_mesh(core_of(plant), filter=filter, **wood_params)
        secs = time.perf_counter() - start
        return cls(core, {**wood_params, "filter": filter}, secs)
