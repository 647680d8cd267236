"""Points and lines: a plant from afar is a prefix of random points on it and lines along it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from treelod import _core
from treelod.render import camera_facts, thread_count
from treelod.techniques.technique import Technique, core_of, number, text, whole, wood_facts

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant

__all__ = ["PlantPart", "PointsAndLines", "SampleGroup", "Selection"]


@dataclass(frozen=True, kw_only=True)
class PlantPart:
    """
    What wood or leaves have of one material.

    Attributes
    ----------
    name : str
        ``wood:`` or ``foliage:`` and the material's name.
    is_wood : bool
        Whether it belongs to the wood.
    drawn_as : {'mesh', 'points', 'lines'}
        What it is drawn as where it is small. Pieces of a part of lines that are less than four
        times as long as wide become points, unless lines were asked for.
    importance : float
        What the distance between samples is divided by, at least 1.
    color : tuple of 3 floats
        Mean linear lit colour where it is opaque, over both sides.
    area : float
        Opaque area in square metres.
    piece_count : int
        Leaves, or pieces of wood.
    """

    name: str
    is_wood: bool
    drawn_as: Literal["mesh", "points", "lines"]
    importance: float
    color: tuple[float, float, float]
    area: float
    piece_count: int


@dataclass(frozen=True, kw_only=True)
class SampleGroup:
    """
    Pieces of one cell of the octree, of one part and class: they are drawn together.

    Attributes
    ----------
    part : int
        Index into `PointsAndLines.parts`.
    cell : int
        Number of the cell.
    drawn_as : {'mesh', 'points', 'lines'}
        What it is drawn as where it is small.
    sampling : {'stratified', 'area'}
        How its points were chosen.
    triangle_count, opaque_triangle_count : int
        All triangles, and those that are opaque anywhere and so have points (k).
    point_count, line_count : int
        Points and lines held.
    seen_area : float
        Mean projected area over all directions, in square metres.
    line_length : float
        Of all lines together, in metres.
    deviation : float
        Largest distance of a vertex from its line, in metres (e).
    center : tuple of 3 floats
        Mean of its opaque surface in the world, in metres.
    radius : float
        Largest distance of a vertex from there, in metres.
    """

    part: int
    cell: int
    drawn_as: Literal["mesh", "points", "lines"]
    sampling: Literal["stratified", "area"]
    triangle_count: int
    opaque_triangle_count: int
    point_count: int
    line_count: int
    seen_area: float
    line_length: float
    deviation: float
    center: tuple[float, float, float]
    radius: float


@dataclass(frozen=True, kw_only=True)
class Selection:
    """
    What a view needs of a group.

    Attributes
    ----------
    group : int
        Index into `PointsAndLines.groups`.
    distance : float
        Metres from the eye to the group's centre (r); 1 in parallel views.
    needed : float
        Samples that its area needs (p), before rounding; infinite if the eye is at the centre.
    line_share : float
        Share of its lines whose area is that of its polygons (q).
    triangles, points, lines : int
        Drawn.
    vertices : int
        Three a triangle, one a point, two a line.
    point_size_px, line_width_px : float
        Pixels.
    """

    group: int
    distance: float
    needed: float
    line_share: float
    triangles: int
    points: int
    lines: int
    vertices: int
    point_size_px: float
    line_width_px: float


class PointsAndLines(Technique):
    """
    A plant as points, lines and the triangles they stand for; see `build`.

    Attributes
    ----------
    parts : list of PlantPart
        Wood first, by material.
    groups : list of SampleGroup
        By cell, part and class.
    sample_bytes : int
        Bytes of points, lines and tables.
    triangle_bytes : int
        Bytes of the triangles.
    splat_factors : ndarray of float
        With ``splat_factor="coverage"``: the factors for 2 points a triangle, 1, 1/2, and so on,
        at which points cover what polygons cover. Else empty.
    """

    name: ClassVar[str] = "points_and_lines"

    def __init__(
        self, samples: _core.PointsAndLines, params: Mapping[str, Any], build_secs: float
    ) -> None:
        super().__init__(samples.representation(), params, build_secs)
        self._samples = samples
        self.parts = [PlantPart(**facts) for facts in samples.parts]
        self.groups = [SampleGroup(**facts) for facts in samples.groups]
        self.sample_bytes, self.triangle_bytes = samples.bytes
        self.splat_factors: NDArray[np.float64] = np.array(samples.factors, np.float64)

    def selection(self, camera: Camera) -> list[Selection]:
        """
        Tell what a camera needs of each group, seen or not.

        Parameters
        ----------
        camera : Camera
            It looks at the plant where its file put it.

        Returns
        -------
        list of Selection
            One a group.
        """
        return [Selection(**facts) for facts in self._samples.selection(camera_facts(camera))]

    def drawn(
        self,
        *,
        splat_factor: float | Literal["coverage"] | None = None,
        sample_distance_px: float | None = None,
        antialias: Literal["off", "coverage", "blend"] | None = None,
        threads: int | None = None,
    ) -> PointsAndLines:
        """
        Draw the same points and lines otherwise; nothing is built anew.

        Parameters
        ----------
        splat_factor, sample_distance_px, antialias : optional
            As in `build`. Default: as they are.
        threads : int, optional
            Threads that measure factors for ``splat_factor="coverage"``.

        Returns
        -------
        PointsAndLines
            It shares everything with this one.

        Raises
        ------
        ValueError
            If an argument is out of range.
        """
        given = {
            "splat_factor": splat_factor,
            "sample_distance_px": sample_distance_px,
            "antialias": antialias,
        }
        params = {**self.params, **{name: v for name, v in given.items() if v is not None}}
        facts = _drawing(params["splat_factor"], params["sample_distance_px"], params["antialias"])
        samples = self._samples.drawn(facts, threads=thread_count(threads))
        return PointsAndLines(samples, {**params, **facts}, self.build_secs)

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        splat_factor: float | Literal["coverage"] = "coverage",
        sample_distance_px: float = 1.0,
        sampling: Literal["auto", "stratified", "area"] = "auto",
        pair_order: Literal["split", "paired"] = "split",
        classes: Mapping[str, Literal["auto", "mesh", "points", "lines"]] | None = None,
        importance: Literal["auto"] | float | Mapping[str, float] = "auto",
        orientation_factor: float = 0.5**0.5,
        antialias: Literal["off", "coverage", "blend"] = "off",
        octree_depth: int = 3,
        cell_triangle_count: int = 16384,
        seed: int = 0,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> PointsAndLines:
        """
        Turn a plant into points on its surface and lines along its long thin pieces.

        Parameters
        ----------
        plant : Plant
            What to draw.
        splat_factor : float or 'coverage', default 'coverage'
            Area of a splat over the square of the distance between samples, in [0.01, 256]. 1
            covers what the same area of random polygons covers; the paper uses 1.2 to 1.5 against
            holes. 'coverage' takes, for each view, the factor at which the splats cover what this
            plant's polygons cover; it is measured while building.
        sample_distance_px : float, default 1.0
            Pixels between two samples on the picture, in [0.01, 256]: fewer and larger splats the
            larger it is.
        sampling : {'auto', 'stratified', 'area'}, default 'auto'
            Two points on each triangle, or points by area, which cannot be blended with triangles.
            'auto' takes 'stratified' for a group whose triangles' areas vary by at most half of
            their mean (coefficient of variation).
        pair_order : {'split', 'paired'}, default 'split'
            Which points belong to triangle j of k: j and k + j, or 2 j and 2 j + 1 (the paper's),
            so that short prefixes hold one point of each triangle, or two.
        classes : mapping of str to {'auto', 'mesh', 'points', 'lines'}, optional
            What parts are drawn as where they are small, by the name of a part ('foliage:leaf'), of
            a material ('leaf'), 'wood', 'foliage', or '*' for all; later entries overrule earlier
            ones. By itself a part becomes lines if most of its area has pieces at least four times
            as long as wide.
        importance : 'auto', float or mapping of str to float, default 'auto'
            What the distance between samples is divided by, in [1, 64]: for all parts, or by name
            as above, all others being automatic. 'auto' is ``min(4, 1 + max(0, dE - 10) / 20)``
            with the CIELAB distance dE of the part's mean colour from the plant's.
        orientation_factor : float, default 1 / sqrt(2)
            Mean length of a line on the picture over its length, in [0.01, 1]. The default is the
            paper's; over all directions it is pi / 4.
        antialias : {'off', 'coverage', 'blend'}, default 'off'
            Splats and lines thinner than a pixel are drawn as they are; or a pixel wide, in as many
            samples as their area asks for; or a pixel wide, blended by their area, without order.
        octree_depth : int, default 3
            How often a cell is divided in eight at most, in 0..=8. Each cell has its own distance.
        cell_triangle_count : int, default 16384
            Cells with more triangles are divided.
        seed : int, default 0
            Of every random choice; at least 0.
        wood : bool, default True
            Whether trunk and limbs are drawn; they become points and lines as leaves do.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to first; see `FullMesh.build`.
        threads : int, optional
            Threads that work. Default: ``TREELOD_NUM_THREADS``, else all cores.
        progress : callable, optional
            Called as ``progress(done, total)`` with pieces turned into points and lines.

        Returns
        -------
        PointsAndLines

        Raises
        ------
        ValueError
            If an argument is out of range, a name is none of a part's, or nothing is left to draw.
        LimitError
            If there were more than 2**32 - 2 vertices or points.

        Notes
        -----
        The method is that of [1]_; what differs is marked in the documentation.

        References
        ----------
        .. [1] O. Deussen, C. Colditz, M. Stamminger, G. Drettakis. Interactive Visualization of
           Complex Plant Ecosystems. IEEE Visualization 2002, 219-226.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("daisy")
        >>> lod = tl.PointsAndLines.build(plant)
        >>> [(part.name, part.drawn_as) for part in lod.parts]
        [('wood:stems', 'lines'), ('foliage:leaves', 'points'), ('foliage:flowers', 'points')]
        """
        wood_params = wood_facts(wood=wood, wood_triangle_count=wood_triangle_count)
        drawing = _drawing(splat_factor, sample_distance_px, antialias)
        weights, is_automatic = _importance(importance)
        named = _by_name("classes", {} if classes is None else classes)
        facts: dict[str, Any] = {
            "sampling": text("sampling", sampling),
            "pair_order": text("pair_order", pair_order),
            "orientation_factor": number("orientation_factor", orientation_factor),
            "octree_depth": whole("octree_depth", octree_depth, 0),
            "cell_triangle_count": whole("cell_triangle_count", cell_triangle_count, 1, 2**64),
            "seed": whole("seed", seed, 0, 2**64),
            **wood_params,
        }
        start = time.perf_counter()
        samples = _core.points_and_lines(
            core_of(plant),
            {
                **facts,
                "drawing": drawing,
                "classes": [(name, text("classes", kind)) for name, kind in named.items()],
                "importance": list(weights.items()),
                "automatic_importance": is_automatic,
            },
            threads=thread_count(threads),
            progress=progress,
        )
        secs = time.perf_counter() - start
        params = {
            **drawing,
            **facts,
            "classes": None if classes is None else dict(named),
            "importance": dict(importance) if isinstance(importance, Mapping) else importance,
        }
        return cls(samples, params, secs)


def _drawing(
    splat_factor: float | str, sample_distance_px: float, antialias: str
) -> dict[str, Any]:
    """Return what can be changed without building anew, as the core takes it."""
    factor = splat_factor
    return {
        "splat_factor": factor if isinstance(factor, str) else number("splat_factor", factor),
        "sample_distance_px": number("sample_distance_px", sample_distance_px),
        "antialias": text("antialias", antialias),
    }


def _by_name(name: str, given: Mapping[str, Any]) -> Mapping[str, Any]:
    if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
        msg = f"{name} must map names of parts, got {given!r}"
        raise TypeError(msg)
    return given


def _importance(importance: str | float | Mapping[str, float]) -> tuple[dict[str, float], bool]:
    """Return importance by name, and whether all others have their own instead of 1."""
    if isinstance(importance, str):
        if importance == "auto":
            return {}, True
        msg = f'importance must be "auto", a number or a mapping, got {importance!r}'
        raise ValueError(msg)
    if isinstance(importance, Mapping):
        given = _by_name("importance", importance)
        return {name: number("importance", weight) for name, weight in given.items()}, True
    return {"*": number("importance", importance)}, False
