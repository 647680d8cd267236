"""Foliage simplified by meshoptimizer: a baseline that knows surfaces and not leaves."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from treelod import _core
from treelod.techniques.technique import Technique, core_of, flag, number, whole, wood_facts

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from treelod.plants import Plant

__all__ = ["SimplifiedMesh"]

DEFAULT_KEEP_FRACTION = 0.1
"""Share of the foliage's triangles where neither that nor a count is given."""


class SimplifiedMesh(Technique):
    """
    A plant whose foliage meshoptimizer has simplified; see `build`.

    Attributes
    ----------
    triangle_count : int
        Triangles left of the foliage; may be 0.
    error : float
        meshoptimizer's error in metres, the largest of all materials'. With 'simplify' it is the
        largest of all steps' weighted mean distances from the planes of the triangles that a vertex
        stands for, or the radius of the largest piece that was dropped; with 'attributes' the
        weighted change of normals and texture coordinates is in it. It bounds neither the distance
        of a leaf that is gone nor coverage.
    """

    name: ClassVar[str] = "simplified_mesh"

    def __init__(
        self,
        core: _core.Representation,
        params: Mapping[str, Any],
        build_secs: float,
        *,
        triangle_count: int,
        error: float,
    ) -> None:
        super().__init__(core, params, build_secs)
        self.triangle_count = triangle_count
        self.error = error

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        triangle_count: int | None = None,
        keep_fraction: float | None = None,
        method: Literal["simplify", "sloppy", "attributes"] = "simplify",
        target_error_rel: float | None = None,
        prune: bool = True,
        lock_border: bool = False,
        normal_weight: float = 0.5,
        uv_weight: float = 1.0,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        filter: Literal["nearest", "bilinear", "trilinear"] = "bilinear",  # noqa: A002
        progress: Callable[[int, int], object] | None = None,
    ) -> SimplifiedMesh:
        """
        Simplify a plant's foliage with meshoptimizer; the wood stays a mesh of its own.

        Parameters
        ----------
        plant : Plant
            A plant with leaves.
        triangle_count : int, optional
            About how many triangles the foliage is simplified to, at least 1. Each material keeps
            its share, rounded up. What is reached is told by the attribute of that name.
        keep_fraction : float, optional
            The same as a share of the foliage's triangles, in (0, 1]. Give one of the two.
            Default: 0.1.
        method : {'simplify', 'sloppy', 'attributes'}, default 'simplify'
            ``meshopt_simplify`` collapses edges and keeps the topology; ``meshopt_simplifySloppy``
            joins vertices that share a cell of a grid, which joins leaves with their neighbours;
            ``meshopt_simplifyWithAttributes`` is the first one, with normals and texture
            coordinates in the error.
        target_error_rel : float, optional
            Stops earlier, where meshoptimizer's error reaches this share of the largest side of the
            foliage's box, in [0, 1]. Default: only the count stops.
        prune : bool, default True
            Whether pieces smaller than the error are dropped whole. Flat leaves collapse to nothing
            without it, too: it matters for closed pieces. Does not count with 'sloppy'.
        lock_border : bool, default False
            Whether vertices on open borders stay where they are. All vertices of a flat leaf do,
            unless it has inner ones. Does not count with 'sloppy'.
        normal_weight : float, default 0.5
            With 'attributes': weight of each of a normal's three numbers, in [0, 1e6]. With 1, a
            change by 1 costs as much as moving by the largest side of the foliage's box.
        uv_weight : float, default 1.0
            With 'attributes': weight of both texture coordinates, in [0, 1e6], in the same way.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to; see `FullMesh.build`.
        filter : {'nearest', 'bilinear', 'trilinear'}, default 'bilinear'
            How textures are read.
        progress : callable, optional
            Called as ``progress(done, total)`` with materials simplified.

        Returns
        -------
        SimplifiedMesh

        Raises
        ------
        ValueError
            If an argument is out of range, if both a count and a share are given, or if the plant
            has no leaves.

        Notes
        -----
        The simplifiers are those of meshoptimizer [1]_. The documentation shows what they do to
        loose leaves.

        References
        ----------
        .. [1] A. Kapoulkine. meshoptimizer. https://github.com/zeux/meshoptimizer

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> len(plant.foliage.mesh.triangles)
        2000
        >>> tl.SimplifiedMesh.build(plant, triangle_count=500).triangle_count <= 500
        True
        """
        if triangle_count is not None and keep_fraction is not None:
            msg = "keep_fraction and triangle_count are two ways to say the same: give one"
            raise ValueError(msg)
        if triangle_count is None and keep_fraction is None:
            keep_fraction = DEFAULT_KEEP_FRACTION
        params: dict[str, Any] = {
            "triangle_count": (
                None if triangle_count is None else whole("triangle_count", triangle_count)
            ),
            "keep_fraction": (
                None if keep_fraction is None else number("keep_fraction", keep_fraction)
            ),
            "method": method,
            "target_error_rel": (
                None if target_error_rel is None else number("target_error_rel", target_error_rel)
            ),
            "prune": flag("prune", prune),
            "lock_border": flag("lock_border", lock_border),
            "normal_weight": number("normal_weight", normal_weight),
            "uv_weight": number("uv_weight", uv_weight),
            **wood_facts(wood=wood, wood_triangle_count=wood_triangle_count),
            "filter": filter,
        }
        start = time.perf_counter()
        core, count, error = _core.simplified_mesh(
            core_of(plant),
            # the share does not count where a count is given
            {**params, "keep_fraction": 1.0 if keep_fraction is None else params["keep_fraction"]},
            progress=progress,
        )
        secs = time.perf_counter() - start
        return cls(core, params, secs, triangle_count=count, error=error)
