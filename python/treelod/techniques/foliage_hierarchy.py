"""Foliage hierarchy: leaves collapse into larger leaves; levels follow a count or the view."""

from __future__ import annotations

import hashlib
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from treelod import _core, criteria
from treelod.collapse import LeafForest, collapse_facts
from treelod.criteria import criterion_from
from treelod.errors import StoreError
from treelod.files import atomic_write
from treelod.render import camera_facts, thread_count
from treelod.techniques.technique import Technique, core_of, flag, number, text, whole, wood_facts

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.criteria import CriterionLike
    from treelod.plants import Plant

__all__ = ["ActiveNodes", "FoliageHierarchy"]

NOTHING = {"leaf_count": None, "quad_px": None, "criterion": None, "rule": "inclusive"}
"""A selection without what is selected."""

BALL_PX = 4.0
"""Pixels that the ball around what a node stands for may look across, where nothing else is said:
see the measurements in docs/foliage_hierarchy.md."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ActiveNodes:
    """
    What one camera draws of a hierarchy, and what it took to get there from the camera before.

    Attributes
    ----------
    nodes : ndarray of shape (A,), dtype uint32
        Nodes drawn, depth first: every leaf has exactly one of them at or above itself.
    collapse_count, forced_collapse_count : int
        Pairs replaced by their parent: both drawn before, or one of them made by another collapse.
    split_count, forced_split_count : int
        Nodes replaced by their children: drawn before, or made by another split.
    asked_node_count, asked_ball_count : int
        How often the criterion was asked about a node, and about all below one.
    passed_count : int
        Sub-trees passed over because nothing in them can have changed.
    """

    nodes: NDArray[np.uint32]
    collapse_count: int
    forced_collapse_count: int
    split_count: int
    forced_split_count: int
    asked_node_count: int
    asked_ball_count: int
    passed_count: int


class FoliageHierarchy(Technique):
    """
    Leaves that collapse two by two, and a rule that says which of them are drawn; see `build`.

    Attributes
    ----------
    leaf_count : int
        Leaves of the plant: the most quads that are drawn.
    root_count : int
        Quads at the coarsest level.
    structure_bytes, side_bytes : int
        Bytes of nodes (7 words each) and their vertices (3 words each), and of everything else kept
        for each node: balls, costs, areas, scales and texture corners.
    wood_triangle_counts : list of int
        Triangles of each level of the wood, the finest first.
    wood_errors : list of float
        Error of each level of the wood in metres: 0 for the finest.
    """

    name: ClassVar[str] = "foliage_hierarchy"

    def __init__(
        self,
        hierarchy: _core.FoliageHierarchy,
        params: Mapping[str, Any],
        build_secs: float,
        plant_digest: bytes,
        effort: tuple[int, float],
    ) -> None:
        super().__init__(hierarchy.representation(), params, build_secs)
        self._plant_digest = plant_digest
        self._effort = effort
        self._hierarchy = hierarchy
        self._forest: LeafForest | None = None
        self.leaf_count: int = hierarchy.leaf_count
        self.root_count: int = hierarchy.root_count
        self.structure_bytes, self.side_bytes = hierarchy.forest_bytes
        self.wood_triangle_counts = [count for count, _ in hierarchy.wood_levels]
        self.wood_errors = [error for _, error in hierarchy.wood_levels]

    @property
    def forest(self) -> LeafForest:
        """The leaves and what they collapse into, with the cost of every collapse."""
        if self._forest is None:
            cost_count, d_ref = self._effort
            self._forest = LeafForest(
                **self._hierarchy.forest(), cost_count=cost_count, d_ref=d_ref
            )
        return self._forest

    def at(self, *, leaf_count: int) -> FoliageHierarchy:
        """
        Return the same hierarchy with a fixed number of quads.

        Levels are nested: a collapse that has happened at some count has happened at every lower
        one. The wood is drawn with the same share of its triangles, as near as its levels come.

        Parameters
        ----------
        leaf_count : int
            Quads drawn of a crown, between `root_count` and `leaf_count`.

        Returns
        -------
        FoliageHierarchy
            It shares everything with this one.

        Raises
        ------
        ValueError
            If `leaf_count` is out of range.
        """
        count = whole("leaf_count", leaf_count, 0)
        return self._with(
            {"leaf_count": count, "quad_px": None, "criterion": None, "rule": "inclusive"}
        )

    def uniform(self, *, quad_px: float) -> FoliageHierarchy:
        """
        Return the same hierarchy with the same detail in all of a crown, less of it far away.

        Parameters
        ----------
        quad_px : float
            Side in pixels of a square of the mean area of the quads drawn, as it looks at the
            nearest point of the crown; in [0.001, 1e6].

        Returns
        -------
        FoliageHierarchy
            It shares everything with this one.

        Raises
        ------
        ValueError
            If `quad_px` is out of range.
        """
        side = number("quad_px", quad_px)
        return self._with(
            {"leaf_count": None, "quad_px": side, "criterion": None, "rule": "inclusive"}
        )

    def view_dependent(
        self, criterion: CriterionLike, *, rule: Literal["inclusive", "paper"] = "inclusive"
    ) -> FoliageHierarchy:
        """
        Return the same hierarchy with more detail where a criterion holds.

        Parameters
        ----------
        criterion : Criterion or callable
            Made by the functions of `treelod.criteria`, or a function as
            `treelod.criteria.criterion_from` takes it.
        rule : {'inclusive', 'paper'}, default 'inclusive'
            When a node is replaced by its children: if the criterion holds for it or for any node
            below it, or, as in the paper, only if it holds for one below it.

        Returns
        -------
        FoliageHierarchy
            It shares everything with this one.

        Raises
        ------
        ValueError
            If a number in the criterion is out of range.
        TypeError
            If `criterion` is none.
        """
        zone = criterion_from(criterion)
        return self._with({**NOTHING, "criterion": zone, "rule": rule})

    def _with(self, selection: dict[str, Any]) -> FoliageHierarchy:
        start = time.perf_counter()
        hierarchy = self._hierarchy.with_selection(_as_core_takes_it(selection))
        secs = self.build_secs + time.perf_counter() - start
        params = {**self.params, **selection}
        changed = FoliageHierarchy(hierarchy, params, secs, self._plant_digest, self._effort)
        changed._forest = self._forest
        return changed

    def active(self, cameras: Sequence[Camera], *, threads: int | None = None) -> list[ActiveNodes]:
        """
        Return what cameras draw of one copy of the plant, one after the other.

        Each starts from the nodes of the one before, the first from the roots. What is drawn does
        not depend on that; how many steps it takes does. Hierarchies without a criterion take no
        steps.

        Parameters
        ----------
        cameras : sequence of Camera
            From where.
        threads : int, optional
            Default: ``TREELOD_NUM_THREADS``, else all cores.

        Returns
        -------
        list of ActiveNodes
            One a camera.
        """
        facts = [camera_facts(camera) for camera in cameras]
        walk = self._hierarchy.walk(facts, threads=thread_count(threads))
        return [ActiveNodes(nodes=nodes, **steps) for nodes, steps in walk]

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        distance: Literal["centre", "hausdorff"] = "centre",
        weight: float = 1.0,
        d_ref: float | None = None,
        choice: Literal["balanced", "paper"] = "balanced",
        keep_area: bool = True,
        keep_coverage: bool = True,
        target_leaf_count: int = 1,
        max_cost: float | None = None,
        leaf_count: int | None = None,
        quad_px: float | None = None,
        ball_px: float | None = None,
        criterion: CriterionLike | None = None,
        rule: Literal["inclusive", "paper"] = "inclusive",
        filter: Literal["nearest", "bilinear", "trilinear"] = "bilinear",  # noqa: A002
        wood: bool = True,
        wood_triangle_count: int | None = None,
        wood_levels: bool = True,
        wood_error_px: float = 0.25,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> FoliageHierarchy:
        """
        Collapse a plant's leaves [1]_, and keep everything between all of them and the last.

        Leaves that are no quads become quads first. `at`, `uniform` and `view_dependent` give the
        same hierarchy with another selection, and cost nothing.

        Parameters
        ----------
        plant : Plant
            A plant with leaves.
        distance : {'centre', 'hausdorff'}, default 'centre'
            Between leaves: of their centroids, or of the corner that is farthest from the other
            leaf, both ways. The second takes about ten times as long.
        weight : float, default 1.0
            Of the angle between leaves in the cost of a pair, at least 0:
            ``(d / d_ref)**2 + weight * |n_i x n_j|**2``.
        d_ref : float, optional
            Metres, above 0. Default: the side of a square of the mean leaf's area.
        choice : {'balanced', 'paper'}, default 'balanced'
            Which corners a new leaf takes; see `collapse_leaves`.
        keep_area : bool, default True
            Whether nodes are scaled to the area of the leaves below them. Without it a crown of a
            twentieth of its leaves has about half its area.
        keep_coverage : bool, default True
            Whether nodes are scaled further, so that crowns of fewer quads cover what all leaves
            cover, seen from all around: leaves hide one another more than larger ones of the same
            area do. Nodes of one level share the factor. Takes about a second.
        target_leaf_count : int, default 1
            Where collapsing stops, at least 1.
        max_cost : float, optional
            No pair that costs more collapses. Default: all do.
        leaf_count : int, optional
            Draw this many quads in every view; see `at`.
        quad_px : float, optional
            Draw quads of this side in pixels all over a crown; see `uniform`.
        ball_px : float, optional
            Draw nodes whose ball looks at most this many pixels across, wherever they are: the
            criterion ``treelod.criteria.screen_size(ball_px)``. Default, if none of these four is
            given: 4.
        criterion : Criterion or callable, optional
            Draw more where this holds; see `view_dependent`.
        rule : {'inclusive', 'paper'}, default 'inclusive'
            See `view_dependent`.
        filter : {'nearest', 'bilinear', 'trilinear'}, default 'bilinear'
            How textures are read; see `FullMesh.build`. Trilinear flickers less at few samples a
            pixel, but the mips of leaves that are cut out lose their outline: a crown then covers
            up to a sixth less than the full mesh.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood's finest level is simplified to; see `FullMesh.build`.
        wood_levels : bool, default True
            Whether the wood is simplified along with the foliage.
        wood_error_px : float, default 0.25
            By how many pixels simplified wood may be off, in [0, 1e6]. Twigs thinner than that are
            drawn back, so that bare wood thins; 0 keeps all of it. With `leaf_count` the wood has
            the same share of its triangles instead.
        threads : int, optional
            Default: ``TREELOD_NUM_THREADS``, else all cores.
        progress : callable, optional
            Called as ``progress(done, total)`` with leaves searched and collapsed.

        Returns
        -------
        FoliageHierarchy

        Raises
        ------
        ValueError
            If an argument is out of range, if several of `leaf_count`, `quad_px`, `ball_px` and
            `criterion` are given, or if the plant has no leaves.
        LimitError
            If there are more than 2**29 leaves.

        References
        ----------
        .. [1] I. Remolar, M. Chover, J. Ribelles, O. Belmonte. View-Dependent Multiresolution Model
           for Foliage. Journal of WSCG 11(1), 2003.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> lod = tl.FoliageHierarchy.build(plant)
        >>> lod.at(leaf_count=20)
        FoliageHierarchy(distance='centre', ... leaf_count=20, ...)
        >>> camera = tl.orbit(plant, count=1, distance=40)[0]
        >>> (active,) = lod.active([camera])
        >>> 1 < len(active.nodes) < 200
        True
        """
        collapse = collapse_facts(
            distance=distance,
            weight=weight,
            d_ref=d_ref,
            choice=choice,
            keep_area=keep_area,
            target_leaf_count=target_leaf_count,
            max_cost=max_cost,
        )
        selection = _selection(
            leaf_count=leaf_count,
            quad_px=quad_px,
            ball_px=ball_px,
            criterion=criterion,
            rule=rule,
        )
        drawn = _drawn(
            filter=filter,
            wood=wood,
            wood_triangle_count=wood_triangle_count,
            wood_levels=wood_levels,
            wood_error_px=wood_error_px,
        )
        keeps_coverage = flag("keep_coverage", keep_coverage)
        start = time.perf_counter()
        hierarchy, cost_count, d_ref_used = _core.foliage_hierarchy(
            core_of(plant),
            collapse,
            {"selection": _as_core_takes_it(selection), **drawn},
            keep_coverage=keeps_coverage,
            threads=thread_count(threads),
            progress=progress,
        )
        secs = time.perf_counter() - start
        params = {**collapse, "keep_coverage": keeps_coverage, **selection, **drawn}
        return cls(hierarchy, params, secs, _digest(plant), (cost_count, d_ref_used))

    def save(self, path: str | os.PathLike[str]) -> None:
        """
        Write the hierarchy to a file, so that it need not be built again.

        The file holds the forest and what it was built with, and names the foliage it was made of
        by a checksum. It does not hold textures, wood, and what is selected.

        Parameters
        ----------
        path : path-like
            The file to make or replace, all at once.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        cost_count, d_ref = self._effort
        note = {name: self.params[name] for name in BUILT_WITH}
        note |= {"cost_count": cost_count, "d_ref_used": d_ref}
        atomic_write(path, self._hierarchy.stored(self._plant_digest, json.dumps(note).encode()))

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        plant: Plant,
        *,
        leaf_count: int | None = None,
        quad_px: float | None = None,
        ball_px: float | None = None,
        criterion: CriterionLike | None = None,
        rule: Literal["inclusive", "paper"] = "inclusive",
        filter: Literal["nearest", "bilinear", "trilinear"] = "bilinear",  # noqa: A002
        wood: bool = True,
        wood_triangle_count: int | None = None,
        wood_levels: bool = True,
        wood_error_px: float = 0.25,
        threads: int | None = None,
    ) -> FoliageHierarchy:
        """
        Read a hierarchy that was saved.

        Parameters
        ----------
        path : path-like
            A file that `save` has written.
        plant : Plant
            The plant that it was built for; its light and its wood may differ.
        leaf_count, quad_px, ball_px, criterion, rule
            What is drawn, as in `build`.
        filter, wood, wood_triangle_count, wood_levels, wood_error_px, threads
            As in `build`.

        Returns
        -------
        FoliageHierarchy

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        StoreError
            If the file is no stored hierarchy, if it is damaged, or if it is of other foliage.
        ValueError
            As in `build`.
        """
        selection = _selection(
            leaf_count=leaf_count,
            quad_px=quad_px,
            ball_px=ball_px,
            criterion=criterion,
            rule=rule,
        )
        drawn = _drawn(
            filter=filter,
            wood=wood,
            wood_triangle_count=wood_triangle_count,
            wood_levels=wood_levels,
            wood_error_px=wood_error_px,
        )
        start = time.perf_counter()
        stored = Path(path).read_bytes()
        digest = _digest(plant)
        hierarchy, found = _core.stored_hierarchy(
            core_of(plant),
            stored,
            digest,
            {"selection": _as_core_takes_it(selection), **drawn},
            threads=thread_count(threads),
        )
        note = _note(found)
        secs = time.perf_counter() - start
        params = {**{name: note[name] for name in BUILT_WITH}, **selection, **drawn}
        return cls(hierarchy, params, secs, digest, (note["cost_count"], note["d_ref_used"]))


BUILT_WITH = (
    "distance",
    "weight",
    "d_ref",
    "choice",
    "keep_area",
    "target_leaf_count",
    "max_cost",
    "keep_coverage",
)
"""Parameters that a stored hierarchy knows."""


def _digest(plant: Plant) -> bytes:
    """Return 32 bytes that name a plant's foliage with its outlines, without colours and light."""
    core_of(plant)
    foliage = plant.foliage
    digest = hashlib.sha256()
    arrays = (
        foliage.positions,
        foliage.triangles,
        foliage.leaf_offsets,
        foliage.mesh.uvs,
        foliage.mesh.material_ids,
    )
    for array in arrays:
        digest.update(f"{array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    for material in plant.materials:
        digest.update(f"{material.alpha_mode} {material.alpha_cutoff}".encode())
        if material.texture is not None and material.alpha_mode != "opaque":
            alpha = np.ascontiguousarray(material.texture[..., 3])
            digest.update(f"{alpha.shape}".encode() + alpha.tobytes())
    return digest.digest()


def _note(note: bytes) -> dict[str, Any]:
    """Return what a stored hierarchy was built with."""
    kinds: dict[str, tuple[type, ...]] = {
        "distance": (str,),
        "weight": (int, float),
        "d_ref": (int, float, type(None)),
        "choice": (str,),
        "keep_area": (bool,),
        "target_leaf_count": (int,),
        "max_cost": (int, float, type(None)),
        "keep_coverage": (bool,),
        "cost_count": (int,),
        "d_ref_used": (int, float),
    }
    try:
        facts = json.loads(note)
    except ValueError:
        facts = None
    if isinstance(facts, dict) and facts.keys() == kinds.keys():
        fits = [
            isinstance(facts[name], kind)
            and (kind == (bool,) or not isinstance(facts[name], bool))
            and (not isinstance(facts[name], int | float) or 0 <= facts[name] < 2**63)
            for name, kind in kinds.items()
        ]
        named = facts["distance"] in ("centre", "hausdorff")
        named &= facts["choice"] in ("balanced", "paper")
        if all(fits) and named and facts["target_leaf_count"] > 0:
            return facts
    msg = "stored foliage: it does not say what it was built with"
    raise StoreError(msg)


def _drawn(
    *,
    filter: str,  # noqa: A002
    wood: bool,
    wood_triangle_count: int | None,
    wood_levels: bool,
    wood_error_px: float,
) -> dict[str, Any]:
    """Return how it is drawn, as the core takes it."""
    return {
        "filter": text("filter", filter),
        **wood_facts(wood=wood, wood_triangle_count=wood_triangle_count),
        "wood_levels": flag("wood_levels", wood_levels),
        "wood_error_px": number("wood_error_px", wood_error_px),
    }


def _as_core_takes_it(selection: Mapping[str, Any]) -> dict[str, Any]:
    zone = selection["criterion"]
    return {**selection, "criterion": None if zone is None else zone._core()}


def _selection(
    *,
    leaf_count: int | None,
    quad_px: float | None,
    ball_px: float | None,
    criterion: CriterionLike | None,
    rule: str,
) -> dict[str, Any]:
    """Return what is drawn, as the core takes it: one of three."""
    given = {
        "leaf_count": leaf_count,
        "quad_px": quad_px,
        "ball_px": ball_px,
        "criterion": criterion,
    }
    named = [name for name, value in given.items() if value is not None]
    if len(named) > 1:
        msg = f"{named[1]} says otherwise than {named[0]}: give one of them"
        raise ValueError(msg)
    if leaf_count is None and quad_px is None and criterion is None:
        pixels = BALL_PX if ball_px is None else number("ball_px", ball_px)
        if not pixels >= 0.0:
            msg = f"ball_px must be at least 0, got {pixels}"
            raise ValueError(msg)
        criterion = criteria.screen_size(pixels)
    return {
        "leaf_count": None if leaf_count is None else whole("leaf_count", leaf_count, 0),
        "quad_px": None if quad_px is None else number("quad_px", quad_px),
        "criterion": None if criterion is None else criterion_from(criterion),
        "rule": text("rule", rule),
    }
