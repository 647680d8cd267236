"""Orthogonal slices: slabs of a plant across two or three axes, blended by their facing."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from treelod import _core
from treelod.render import camera_facts, thread_count
from treelod.techniques.technique import (
    Technique,
    TextureFormat,
    core_of,
    flag,
    number,
    resolution_texels,
    text,
    whole,
    wood_facts,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from treelod.cameras import Camera
    from treelod.plants import Plant

__all__ = ["OrthogonalSlices"]


class OrthogonalSlices(Technique):
    """
    Slabs across z and x, and y if asked for, as cards that stay where they are; see `build`.

    Attributes
    ----------
    m : float or None
        The multiplier in use, or None with the optical correction.
    fitted : bool or None
        With ``correction="fit"``: whether a multiplier in [0, 4] gives the crown its on-axis mean
        alpha from all around; if not, the nearer end is used.
    tau : float
        Optical depth of a slice: -ln(1 - mean slice alpha inside the silhouette).
    treetop_leaf_count : int
        Leaves in the treetop, which the other slices do not show.
    baked : list of bool
        Which axes were baked: z, x, and y with three axes.
    """

    name: ClassVar[str] = "orthogonal_slices"

    def __init__(
        self,
        core: _core.Representation,
        params: Mapping[str, Any],
        build_secs: float,
        measured: Mapping[str, Any],
    ) -> None:
        super().__init__(core, params, build_secs)
        self.m: float | None = measured["m"]
        self.fitted: bool | None = measured["fitted"]
        self.tau: float = measured["tau"]
        self.treetop_leaf_count: int = measured["treetop_leaf_count"]
        self.baked: list[bool] = measured["baked"]

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        axes: int = 2,
        slice_count: int = 7,
        resolution: int | tuple[int, int] = 256,
        samples: int = 16,
        blend: Literal["power", "linear"] = "power",
        k: float = 2.0,
        correction: float | Literal["fit", "optical"] = 0.8,
        paint_order: Literal["slices", "exact"] = "slices",
        treetop_slice_count: int = 0,
        treetop_height_rel: float = 0.3,
        format: TextureFormat = "rgba8",  # noqa: A002
        views: Sequence[Camera] | None = None,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        bake_wood: bool = False,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> OrthogonalSlices:
        """
        Bake slabs of a plant's foliage across axes; the wood stays a mesh, or is baked in.

        Parameters
        ----------
        plant : Plant
            A plant with leaves.
        axes : int, default 2
            2 or 3: z and x, or y too, for views from above and from below.
        slice_count : int, default 7
            Slabs of each axis, in 1..=4096; 5 to 8 are usual. A crown without depth along an axis
            has one. An odd number has a slab in the middle, where the trunk is.
        resolution : int or (int, int), default 256
            Texels of a slice, width and height, each in 1..=16384.
        samples : int, default 16
            Samples a texel, as in `treelod.render`.
        blend : {'power', 'linear'}, default 'power'
            The share of an axis u seen from the direction v: ``|u . v| ** k`` over the sum of all
            axes, or linear in the angle along the horizon. With three axes 'linear' is 'power' with
            k = 1.
        k : float, default 2
            Exponent of the power law, in [0, 64]. The higher it is, the sooner one axis takes over.
        correction : float or {'fit', 'optical'}, default 0.8
            How several half-transparent axes are made as opaque as one: as in `Slicings.build`.
        paint_order : {'slices', 'exact'}, default 'slices'
            Whole cards, the farthest of each axis first, then the second farthest of each; or cards
            cut where they cross, in exact order.
        treetop_slice_count : int, default 0
            Slices of each axis for the treetop, which sways by itself, in 0..=4096; 0 for none.
        treetop_height_rel : float, default 0.3
            Share of the crown's height that is treetop, in [1e-6, 1 - 1e-6]: leaves whose centres
            are that high.
        format : {'rgba8', 'rgb5a1', 'rgb8', 'palette8', 'bc1', 'bc3', 'bc7'}, default 'rgba8'
            How texels are stored, and so what is drawn of them; see `TextureFormat`.
        views : sequence of Camera, optional
            The cameras that will look. Only axes that one of them shows are baked, with no more
            texels than the nearest one has pixels; other cameras are then refused where they need
            another axis. Default: all directions.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to; see `FullMesh.build`.
        bake_wood : bool, default False
            Whether wood is in the slices with the leaves, and no mesh is drawn.
        threads : int, optional
            Threads that bake. Default: ``TREELOD_NUM_THREADS``, else all cores.
        progress : callable, optional
            Called as ``progress(done, total)`` with slices baked.

        Returns
        -------
        OrthogonalSlices

        Raises
        ------
        ValueError
            If an argument is out of range, or if the plant has no leaves.
        LimitError
            If all slices together would have more than 2**29 texels, or their cards more than 2**20
            pieces.

        Notes
        -----
        The tree is cut like a body in a scanner [1]_: every leaf is clipped at the borders of the
        slabs, and the slabs of an axis together show each leaf once.

        References
        ----------
        .. [1] D. Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming,
           chapter 20. New Riders, 2003.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> lod = tl.OrthogonalSlices.build(plant, slice_count=5, resolution=64)
        >>> lod.footprint.cards
        10
        """
        facts = {
            "axes": whole("axes", axes),
            "slice_count": whole("slice_count", slice_count),
            "resolution": resolution_texels("resolution", resolution),
            "samples": whole("samples", samples),
            "blend": text("blend", blend),
            "k": number("k", k),
            "correction": correction if isinstance(correction, str) else float(correction),
            "paint_order": text("paint_order", paint_order),
            "treetop_slice_count": whole("treetop_slice_count", treetop_slice_count, 0),
            "treetop_height_rel": number("treetop_height_rel", treetop_height_rel),
            "format": text("format", format),
            "views": None if views is None else [camera_facts(camera) for camera in views],
            "bake_wood": flag("bake_wood", bake_wood),
            **wood_facts(wood=wood, wood_triangle_count=wood_triangle_count),
        }
        start = time.perf_counter()
        core, measured = _core.orthogonal_slices(
            core_of(plant), facts, threads=thread_count(threads), progress=progress
        )
        secs = time.perf_counter() - start
        params = facts | {"views": None if views is None else len(views)}
        return cls(core, params, secs, measured)
