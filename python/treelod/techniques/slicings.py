"""Slicings: parallel slices through the crown, baked for several directions and blended."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from treelod import _core
from treelod.render import camera_facts, thread_count
from treelod.techniques.technique import (
    Technique,
    TextureFormat,
    core_of,
    flag,
    is_many,
    number,
    numbers,
    resolution_texels,
    text,
    whole,
    whole_numbers,
    wood_facts,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant

__all__ = ["SlicingLevel", "Slicings"]

LEVEL_TOLERANCE = 1e-9
"""Height of a unit direction up to which it counts as horizontal; the core has the same."""


@dataclass(frozen=True, kw_only=True)
class SlicingLevel:
    """
    One level of detail of slicings.

    Attributes
    ----------
    slice_count : int
        Slices of each slicing.
    m : float or None
        The multiplier in use, or None with the optical correction.
    fitted : bool or None
        With ``correction="fit"``: whether a multiplier was found.
    tau : float
        Optical depth of a slice.
    error : float
        How far, in metres, a leaf may seem to be from its place, seen from the worst side.
    """

    slice_count: int
    m: float | None
    fitted: bool | None
    tau: float
    error: float


class Slicings(Technique):
    """
    Slices through the crown for several directions, blended by the view; see `build`.

    Attributes
    ----------
    m : float or None
        The multiplier in use, or None with the optical correction; of the finest level.
    fitted : bool or None
        With ``correction="fit"``: whether a multiplier in [0, 4] gives the crown its on-axis mean
        alpha from all around; if not, the nearer end is used. Of the finest level.
    tau : float
        Optical depth of a slice: -ln(1 - mean slice alpha inside the silhouette). Of the finest
        level, and the mean of branches.
    levels : list of SlicingLevel
        The levels of detail, the finest first.
    large_leaf_count : int
        Leaves longer than the finest level's spacing, summed over slicings.
    part_count : int
        Crowns with slicings of their own: 1, or branches.
    baked : list of bool
        Which slicings can be drawn, those that mirror another one among them.
    """

    name: ClassVar[str] = "slicings"

    def __init__(
        self,
        core: _core.Representation,
        params: Mapping[str, Any],
        build_secs: float,
        measured: Mapping[str, Any],
    ) -> None:
        super().__init__(core, params, build_secs)
        self.levels = [SlicingLevel(**level) for level in measured["levels"]]
        self.m = self.levels[0].m
        self.fitted = self.levels[0].fitted
        self.tau = self.levels[0].tau
        self.part_count: int = measured["part_count"]
        self.large_leaf_count: int = measured["large_leaf_count"]
        self.baked: list[bool] = measured["baked"]

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        slicing_count: int = 6,
        slice_count: int | Sequence[int] = 5,
        level_error_px: float = 1.0,
        level_distances: float | Sequence[float] | None = None,
        resolution: int | tuple[int, int] = 256,
        samples: int = 16,
        correction: float | Literal["fit", "optical"] = 0.5,
        large_leaves: Literal["split", "mesh"] = "split",
        orientations: Literal["circle", "sphere"] | ArrayLike = "circle",
        vertical: bool = False,
        mirrored: bool = False,
        drop_back: int = 0,
        sub_slices: int = 1,
        quadtree: int | None = None,
        branch_level: int | None = None,
        format: TextureFormat = "rgba8",  # noqa: A002
        views: Sequence[Camera] | None = None,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> Slicings:
        """
        Bake slices of a plant's foliage; the wood stays a mesh.

        Parameters
        ----------
        plant : Plant
            A plant with leaves.
        slicing_count : int, default 6
            Directions from which slices are baked, in 1..=4096. Ignored where `orientations` is an
            array.
        slice_count : int or sequence of int, default 5
            Parallel slices of each slicing, in 1..=4096. A crown without depth along a direction
            has one. Several numbers, which must fall, are levels of detail, such as ``(5, 3, 1)``.
        level_error_px : float, default 1.0
            A level is shown where its slices seem no farther from the leaves than so many pixels,
            at the crown's near side and seen at the worst angle; at least 0.
        level_distances : float or sequence of float, optional
            Distances of the eye from the crown's centre, in crown radii, at which each level
            becomes the next: rising, one less than levels. Then `level_error_px` does not count.
        resolution : int or (int, int), default 256
            Texels of a slice, width and height, each in 1..=16384.
        samples : int, default 16
            Samples a texel, as in `treelod.render`.
        correction : float or {'fit', 'optical'}, default 0.5
            How two half-transparent slicings are made as opaque as one. A number m of at least 0
            multiplies opacities by 1 + m (1 - share of the primary), at most 1; 'fit' finds the m
            in [0, 4] that gives the crown, averaged over 36 directions, its on-axis mean alpha;
            'optical' gives a share s the opacity (1 - exp(-s tau)) / (1 - exp(-tau)).
        large_leaves : {'split', 'mesh'}, default 'split'
            Leaves longer than the distance between slices are cut half way between slices, or
            drawn as they are.
        orientations : {'circle', 'sphere'} or array_like of shape (N, 3), default 'circle'
            Directions from the crown to the viewer: evenly on the horizontal circle, evenly on the
            sphere (at least 4), or given. Given directions must all be horizontal, or surround the
            plant; a single one may point anywhere.
        vertical : bool, default False
            Whether a slicing that faces up is blended with the others as the eye rises above the
            horizon or sinks below it. For orientations that are all horizontal, and not with
            `branch_level`.
        mirrored : bool, default False
            Whether a slicing shares the textures of its opposite, seen from behind.
        drop_back : int, default 0
            How many of the rearmost slices of each slicing are not drawn, in 0..slice_count. The
            nearest slice always is.
        sub_slices : int, default 1
            Cells along each side of a slice, in 1..=64, each of which is blended by the angle at
            which it is seen itself. Not with `branch_level`.
        quadtree : int, optional
            Texels of a side of the smallest squares that textures are kept in, a power of two in
            16..=1024; empty squares are neither stored nor drawn. Default: textures are whole.
        branch_level : int, optional
            Generation of the branches that get one slicing each, across the direction in which they
            are flattest: 1 are those that grow from the trunk. For grown plants, whose branches are
            known; `slicing_count` and `orientations` do not count then, and there is nothing to
            blend: not with `vertical`, `sub_slices` or ``correction='fit'``. Default: one crown.
        format : {'rgba8', 'rgb5a1', 'rgb8', 'palette8', 'bc1', 'bc3', 'bc7'}, default 'rgba8'
            How texels are stored, and so what is drawn of them; see `TextureFormat`.
        views : sequence of Camera, optional
            The cameras that will look. Only slicings that one of them shows are baked, with no
            more texels than the nearest one has pixels; other cameras are then refused where they
            need another slicing. Default: all directions.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to; see `FullMesh.build`.
        threads : int, optional
            Threads that bake. Default: ``TREELOD_NUM_THREADS``, else all cores.
        progress : callable, optional
            Called as ``progress(done, total)`` with slices baked.

        Returns
        -------
        Slicings

        Raises
        ------
        ValueError
            If an argument is out of range, or if the plant has no leaves.
        LimitError
            If all slices together would have more than 2**29 texels, or, with `sub_slices`, more
            than 2**20 cards.

        Notes
        -----
        A view mixes the slicings that it lies between [1]_, drawn far to near in turn.

        References
        ----------
        .. [1] A. Jakulin. Interactive Vegetation Rendering with Slicing and Blending.
           Eurographics 2000, short presentations.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> lod = tl.Slicings.build(plant, slicing_count=4, slice_count=3, resolution=64)
        >>> lod.footprint.cards
        12
        """
        width, height = resolution_texels("resolution", resolution)
        directions, triangles = _directions(orientations, slicing_count)
        wood_params = wood_facts(wood=wood, wood_triangle_count=wood_triangle_count)
        facts = None if views is None else [camera_facts(camera) for camera in views]
        counts = whole_numbers("slice_count", slice_count)
        shared = {
            "level_error_px": number("level_error_px", level_error_px),
            "level_distances": (
                None if level_distances is None else numbers("level_distances", level_distances)
            ),
            "resolution": (width, height),
            "samples": whole("samples", samples),
            "correction": correction if isinstance(correction, str) else float(correction),
            "large_leaves": text("large_leaves", large_leaves),
            "vertical": flag("vertical", vertical),
            "mirrored": flag("mirrored", mirrored),
            "drop_back": whole("drop_back", drop_back, 0),
            "sub_slices": whole("sub_slices", sub_slices),
            "quadtree": None if quadtree is None else whole("quadtree", quadtree),
            "branch_level": None
            if branch_level is None
            else whole("branch_level", branch_level, 0),
            "format": text("format", format),
            **wood_params,
        }
        start = time.perf_counter()
        core, measured = _core.slicings(
            core_of(plant),
            directions,
            triangles,
            shared | {"slice_counts": counts, "views": facts},
            threads=thread_count(threads),
            progress=progress,
        )
        secs = time.perf_counter() - start
        params = {
            "slicing_count": len(directions),
            "slice_count": tuple(counts) if is_many(slice_count) else counts[0],
            "orientations": orientations if isinstance(orientations, str) else directions.tolist(),
            **shared,
            "views": None if views is None else len(views),
        }
        return cls(core, params, secs, measured)


def _directions(
    orientations: str | ArrayLike, slicing_count: int
) -> tuple[NDArray[np.float64], NDArray[np.uint32] | None]:
    """Directions of shape (N, 3), and the triangles between them where they are not all level."""
    if isinstance(orientations, str):
        count = whole("slicing_count", slicing_count)
        if orientations == "circle":
            return np.array(_core.circle_directions(count)), None
        if orientations != "sphere":
            msg = f"orientations must be 'circle', 'sphere' or an array, got {orientations!r}"
            raise ValueError(msg)
        if count < 4:
            msg = f"slicing_count must be at least 4 on the sphere, got {count}"
            raise ValueError(msg)
        directions = np.array(_core.sphere_directions(count))
    else:
        directions = np.ascontiguousarray(orientations, dtype=np.float64)
        if directions.ndim != 2 or directions.shape[1] != 3:
            msg = f"orientations must have shape (N, 3), got {directions.shape}"
            raise ValueError(msg)
    lengths = np.linalg.norm(directions, axis=1)
    usable = np.isfinite(lengths).all() and (lengths > 0).all()
    if len(directions) < 4 or not usable:
        return directions, None
    units = directions / lengths[:, np.newaxis]
    if (np.abs(units[:, 1]) <= LEVEL_TOLERANCE).all():
        return directions, None
    # a large library, for the sphere alone
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(units)
    except QhullError:
        # all in one plane: the core says what is wrong with them
        return directions, None
    return directions, np.ascontiguousarray(hull.simplices, dtype=np.uint32)
