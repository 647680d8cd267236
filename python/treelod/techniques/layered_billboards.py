"""Layered billboards: flat layers seen from one side, hung one from the other."""

from __future__ import annotations

import math
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
    number,
    text,
    whole,
    wood_facts,
)
from treelod.wind import wind_facts

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant
    from treelod.wind import Wind

__all__ = ["BillboardLayer", "LayeredBillboards"]


@dataclass(frozen=True, kw_only=True, eq=False)
class BillboardLayer:
    """
    A layer and where it hangs.

    Attributes
    ----------
    name : str
        Its place in the hierarchy: ``"trunk"``, ``"trunk/2"``, ``"trunk/2/0"``; a plant of several
        stems has ``"0"``, ``"1"`` for trunks, and slabs are ``"slab/0"``, the farthest, and so on.
    parent : int or None
        Index of the layer that it hangs from, lower than its own; None where it stands on the
        ground.
    anchor : ndarray of shape (3,), dtype float64
        Where it joins its parent, in metres in the plant's world.
    corners : ndarray of shape (4, 3), dtype float64, or None
        World positions of its corners at rest, from the lower left counter-clockwise; None for a
        layer that shows nothing, such as a bare trunk whose wood stays a mesh.
    texels : tuple of int or None
        Column and row of its upper left texel in the texture, its width and its height.
    leaf_count : int
        Leaves that it shows. A leaf that is cut between slabs counts where its centre is.
    wood_triangle_count : int
        Triangles of wood that are baked into it or, where the wood stays a mesh, move with it: all
        with the middle one of slabs. Wood that is cut between slabs counts where its centre is.
        0 without wood.
    """

    name: str
    parent: int | None
    anchor: NDArray[np.float64]
    corners: NDArray[np.float64] | None
    texels: tuple[int, int, int, int] | None
    leaf_count: int
    wood_triangle_count: int

    def __repr__(self) -> str:
        return f"BillboardLayer({self.name!r}, {self.leaf_count} leaves)"


class LayeredBillboards(Technique):
    """
    Flat layers seen from one side, hung one from the other; see `build`.

    Attributes
    ----------
    layers : list of BillboardLayer
        A parent before its children.
    atlas_fill : float
        Share of the texture that layers cover.
    """

    name: ClassVar[str] = "layered_billboards"

    def __init__(
        self, billboards: _core.LayeredBillboards, params: Mapping[str, Any], build_secs: float
    ) -> None:
        super().__init__(billboards.representation(), params, build_secs)
        self._billboards = billboards
        self.layers: list[BillboardLayer] = [
            BillboardLayer(
                name=name,
                parent=parent,
                anchor=np.array(anchor),
                corners=None if corners is None else np.array(corners),
                texels=texels,
                leaf_count=leaf_count,
                wood_triangle_count=wood_count,
            )
            for name, parent, anchor, corners, texels, leaf_count, wood_count in billboards.layers
        ]
        self.atlas_fill: float = billboards.atlas_fill

    def poses(
        self, camera: Camera, *, wind: Wind | None = None, copy: tuple[int, int] = (0, 0)
    ) -> NDArray[np.float64]:
        """
        Tell where each layer goes, as it is drawn for a camera at the camera's time.

        Parameters
        ----------
        camera : Camera
            Where layers turn to, if they do, and where the wind blows to, if it blows to the right
            of the picture.
        wind : Wind, optional
            As of a `Scene`.
        copy : (int, int), default (0, 0)
            Which copy of the scene: its group, and its place in the group's transforms. It
            decides at which phase the copy swings. The copy stands where the plant's file put it.

        Returns
        -------
        ndarray of shape (N, 4, 4), dtype float64
            Column-vector matrices, one a layer: from where a point of the layer is at rest to where
            it is drawn, in the plant's world.

        Raises
        ------
        TypeError
            If `wind` is something else than a `Wind`.
        """
        place = (whole("copy", copy[0], 0), whole("copy", copy[1], 0))
        return self._billboards.poses(camera_facts(camera), wind=wind_facts(wind), copy=place)

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        azimuth_deg: float = 0.0,
        direction: ArrayLike | None = None,
        groups: Literal["auto", "branches", "slabs"] = "auto",
        layer_count: int = 25,
        tilt: bool = True,
        turn: Literal["fixed", "viewer"] = "fixed",
        max_turn_deg: float = 180.0,
        motion: Literal["rotate", "shear"] = "rotate",
        growth: float = 1.25,
        drawing: Literal["blend", "test"] = "blend",
        resolution: int = 512,
        samples: int = 16,
        format: TextureFormat = "rgba8",  # noqa: A002
        wood_as: Literal["auto", "baked", "mesh"] = "auto",
        views: Sequence[Camera] | None = None,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> LayeredBillboards:
        """
        Bake layers of a plant, seen from one direction.

        Parameters
        ----------
        plant : Plant
            A plant with leaves, or with wood that is baked.
        azimuth_deg : float, default 0
            Where the layers are seen from, in degrees from +z towards +x. Ignored where
            `direction` is given.
        direction : array_like of shape (3,), optional
            The same, from the plant to the viewer, any length above 0.
        groups : {'auto', 'branches', 'slabs'}, default 'auto'
            What a layer shows: what grows on some branches, or a slab across the direction. 'auto'
            takes branches where the plant has at least two. A grown plant knows its branches; of
            others each connected piece of the wood is one.
        layer_count : int, default 25
            Layers at most, in 1..=4096.
        tilt : bool, default True
            Whether a layer of branches leans towards or away from the viewer, through its anchor,
            as what it shows does; else, and where layers turn, it lies at the mean depth of that.
        turn : {'fixed', 'viewer'}, default 'fixed'
            Whether layers stay as they were baked, or turn about their anchors to face the viewer,
            in yaw and in pitch, on wood that stays a mesh.
        max_turn_deg : float, default 180
            With 'viewer': by how many degrees at most, each of yaw and pitch, in [0, 180].
            Checked whatever `turn` is.
        motion : {'rotate', 'shear'}, default 'rotate'
            What the wind does to a layer: turn it about its anchor, or shear it there.
        growth : float, default 1.25
            How many times as far as the layer below a layer swings of its own, in [0, 10]; no layer
            swings more than 1000 times as far as the trunk.
        drawing : {'blend', 'test'}, default 'blend'
            Blended far to near, or tested against one half, with depth.
        resolution : int, default 512
            Texels along the longer side of the picture of the whole plant, in 1..=8192. Every
            layer has texels of the same size.
        samples : int, default 16
            Samples a texel, as in `treelod.render`.
        format : {'rgba8', 'rgb5a1', 'rgb8', 'palette8', 'bc1', 'bc3', 'bc7'}, default 'rgba8'
            How texels are stored, and so what is drawn of them; see `TextureFormat`.
        wood_as : {'auto', 'baked', 'mesh'}, default 'auto'
            Whether the wood is in the layers or stays a mesh, which moves with them: with the
            middle one of slabs. 'auto' bakes it unless layers turn to the viewer or
            `wood_triangle_count` is given.
        views : sequence of Camera, optional
            The cameras that will look: layers get no more texels than the nearest of them has
            pixels. Default: as many as `resolution` says.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to, as a mesh; see `FullMesh.build`.
        threads : int, optional
            Threads that bake. Default: ``TREELOD_NUM_THREADS``, else all cores.
        progress : callable, optional
            Called as ``progress(done, total)`` with layers baked.

        Returns
        -------
        LayeredBillboards

        Raises
        ------
        ValueError
            If an argument is out of range or contradicts another, if the plant has no leaves and
            no wood to be baked, or no branches where they are asked for.
        LimitError
            If all layers together would have more texels than a texture may have.

        Notes
        -----
        The method is the "parallel IBR" of [1]_, with layers that are found rather than drawn by
        hand. It holds for viewers on the side that it was baked from.

        References
        ----------
        .. [1] D. Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming, chapter
           20. New Riders, 2003.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> lod = tl.LayeredBillboards.build(plant, layer_count=5, resolution=64)
        >>> [layer.name for layer in lod.layers][:2]
        ['trunk', 'trunk/0']
        >>> sum(layer.leaf_count for layer in lod.layers)
        200
        """
        toward = _direction(azimuth_deg, direction)
        wood_params = wood_facts(wood=wood, wood_triangle_count=wood_triangle_count)
        form = text("wood_as", wood_as)
        if form == "auto":
            form = "mesh" if turn == "viewer" or wood_triangle_count is not None else "baked"
        facts: dict[str, Any] = {
            "groups": text("groups", groups),
            "layer_count": whole("layer_count", layer_count),
            "tilt": flag("tilt", tilt),
            "turn": text("turn", turn),
            "max_turn_deg": number("max_turn_deg", max_turn_deg),
            "motion": text("motion", motion),
            "growth": number("growth", growth),
            "drawing": text("drawing", drawing),
            "resolution": whole("resolution", resolution),
            "samples": whole("samples", samples),
            "format": text("format", format),
            **wood_params,
            "wood_as": form,
        }
        cameras = None if views is None else [camera_facts(camera) for camera in views]
        start = time.perf_counter()
        billboards = _core.layered_billboards(
            core_of(plant),
            {**facts, "direction": toward, "views": cameras},  # type: ignore[typeddict-item]
            threads=thread_count(threads),
            progress=progress,
        )
        secs = time.perf_counter() - start
        params = {
            "direction": toward,
            **facts,
            "views": None if views is None else len(views),
        }
        return cls(billboards, params, secs)


def _direction(azimuth_deg: float, direction: ArrayLike | None) -> tuple[float, float, float]:
    if direction is None:
        azimuth = number("azimuth_deg", azimuth_deg)
        if not math.isfinite(azimuth):
            msg = f"azimuth_deg must be finite, got {azimuth}"
            raise ValueError(msg)
        turned = math.radians(math.remainder(azimuth, 360.0))
        return math.sin(turned), 0.0, math.cos(turned)
    given = np.asarray(direction, np.float64)
    if given.shape != (3,):
        msg = f"direction must have shape (3,), got {given.shape}"
        raise ValueError(msg)
    return tuple(given.tolist())
