"""Slicings: parallel slices through the crown, baked for several directions and blended."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from treelod import _core
from treelod.render import camera_facts, thread_count
from treelod.techniques.technique import (
    Technique,
    TextureFormat,
    core_of,
    resolution_texels,
    whole,
    wood_facts,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant

__all__ = ["Slicings"]

LEVEL_TOLERANCE = 1e-9
"""Height of a unit direction up to which it counts as horizontal; the core has the same."""


class Slicings(Technique):
    """
    Slices through the crown for several directions, blended by the view; see `build`.

    Attributes
    ----------
    m : float or None
        The multiplier in use, or None with the optical correction.
    fitted : bool or None
        With ``correction="fit"``: whether a multiplier in [0, 4] gives the crown its on-axis mean
        alpha from all around; if not, the nearer end is used.
    tau : float
        Optical depth of a slice: -ln(1 - mean slice alpha inside the silhouette).
    large_leaf_count : int
        Leaves longer than the spacing, summed over slicings.
    baked : list of bool
        Which slicings were baked.
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
        self.m: float | None = measured["m"]
        self.fitted: bool | None = measured["fitted"]
        self.tau: float = measured["tau"]
        self.large_leaf_count: int = measured["large_leaf_count"]
        self.baked: list[bool] = measured["baked"]

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        slicing_count: int = 6,
        slice_count: int = 5,
        resolution: int | tuple[int, int] = 256,
        samples: int = 16,
        correction: float | Literal["fit", "optical"] = 0.5,
        large_leaves: Literal["split", "mesh"] = "split",
        orientations: Literal["circle", "sphere"] | ArrayLike = "circle",
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
        slice_count : int, default 5
            Parallel slices of each slicing, in 1..=4096. A crown without depth along a direction
            has one.
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
            If all slices together would have more than 2**29 texels.

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
        start = time.perf_counter()
        core, measured = _core.slicings(
            core_of(plant),
            directions,
            triangles,
            slice_count=whole("slice_count", slice_count),
            resolution=(width, height),
            samples=whole("samples", samples),
            correction=correction if isinstance(correction, str) else float(correction),
            large_leaves=large_leaves,
            format=format,
            views=facts,
            threads=thread_count(threads),
            progress=progress,
            **wood_params,
        )
        secs = time.perf_counter() - start
        params = {
            "slicing_count": len(directions),
            "slice_count": slice_count,
            "resolution": (width, height),
            "samples": samples,
            "correction": correction,
            "large_leaves": large_leaves,
            "orientations": orientations if isinstance(orientations, str) else directions.tolist(),
            "format": format,
            "views": None if views is None else len(views),
            **wood_params,
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
