"""Octahedral impostors: pictures of the plant from all around, three of which a view mixes."""

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
    number,
    text,
    whole,
    wood_facts,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.plant import Lighting, Plant

__all__ = ["ImpostorFrames", "OctahedralImpostor"]


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpostorFrames:
    """
    Where the frames of an impostor lie, in space and in its atlas; one row a frame.

    Frames are counted along u first: frame ``v * frame_count + u`` lies at column u and row v of
    the grid on the square of directions. Rows of frames that were not baked are NaN.

    Attributes
    ----------
    toward, right, up : ndarray of shape (F, 3), dtype float64
        Unit vectors from the plant to the frame's viewer, and along the picture's sides.
    corner, size : ndarray of shape (F, 2), dtype float64
        Upper left corner and sides in the atlas, as texture coordinates.
    """

    toward: NDArray[np.float64]
    right: NDArray[np.float64]
    up: NDArray[np.float64]
    corner: NDArray[np.float64]
    size: NDArray[np.float64]


class OctahedralImpostor(Technique):
    """
    Pictures of a plant from all around, with depth; see `build`.

    Attributes
    ----------
    center : ndarray of shape (3,), dtype float64
        Middle of the ball that every frame shows, in metres in the plant's world.
    radius : float
        Of that ball, in metres; depths reach as far to both sides of a frame's plane.
    baked : list of bool
        Which frames were baked. Of frames that show the same direction only the first is.
    atlas_fill : float
        Share of the atlas that frames cover; the rest keeps them apart.
    """

    name: ClassVar[str] = "octahedral_impostor"

    def __init__(
        self, impostor: _core.OctahedralImpostor, params: Mapping[str, Any], build_secs: float
    ) -> None:
        super().__init__(impostor.representation(), params, build_secs)
        self._impostor = impostor
        facts = impostor.facts
        self.center: NDArray[np.float64] = np.array(facts["center"])
        self.radius: float = facts["radius"]
        self.baked: list[bool] = facts["baked"]
        self.atlas_fill: float = facts["atlas_fill"]

    @property
    def frames(self) -> ImpostorFrames:
        """Where frames lie, in space and in the atlas."""
        rows = self._impostor.frames
        toward, right, up, corner, size = np.split(rows, [3, 6, 9, 11], axis=1)
        return ImpostorFrames(toward=toward, right=right, up=up, corner=corner, size=size)

    def mixed(self, camera: Camera) -> dict[int, float]:
        """Tell which frames a camera sees of the plant where it stands, with their weights."""
        return dict(self._impostor.mixed(camera_facts(camera)))

    def relit(self, lighting: Lighting) -> OctahedralImpostor:
        """
        Show the same frames under another light.

        Nothing is baked: the result is what `build` makes with ``shading="relit"`` of the plant
        under that light, and shares its frames with this one.

        Parameters
        ----------
        lighting : Lighting
            The light. Its `occlusion` must be 0, as frames do not know what hides what.

        Returns
        -------
        OctahedralImpostor

        Raises
        ------
        ValueError
            If an argument of the light is out of range, or if this was built with
            ``shading="baked"``.
        """
        relit = self._impostor.relit(lighting._facts())
        return OctahedralImpostor(relit, self.params, self.build_secs)

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        frame_count: int = 8,
        hemisphere: bool = True,
        resolution: int = 128,
        samples: int = 16,
        blend: Literal["three", "nearest"] = "three",
        drawing: Literal["coverage", "test", "blend"] = "coverage",
        cutoff: float = 0.5,
        parallax_steps: int = 2,
        depth_tolerance: float | None = 0.05,
        shading: Literal["baked", "relit"] = "baked",
        format: TextureFormat = "rgba8",  # noqa: A002
        depth_bits: int = 8,
        views: Sequence[Camera] | None = None,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> OctahedralImpostor:
        """
        Bake a plant, wood and leaves, from the points of a grid of directions.

        Parameters
        ----------
        plant : Plant
            Any plant.
        frame_count : int, default 8
            Frames along each side of the grid, its square of them in all: in 2..=64, or in 3..=64
            over the whole sphere, whose four corners are one direction.
        hemisphere : bool, default True
            Whether only views from the horizon up have frames. Who looks from below then sees the
            frames of the horizon, ever more from the side: the plant thins out, and parallel views
            from about 88.9 degrees below show nothing. False spreads the grid over the whole
            sphere.
        resolution : int, default 128
            Texels along each side of a frame, in 1..=8192, of which all frames together must fit
            into 2**26 texels: up to 3968 where `frame_count` is 2, 960 where it is 8, and 120 where
            it is 64; over the whole sphere 3200 for 3, 1088 for 8 and 124 for 64. With `views` the
            frames and the texels that are baked count.
        samples : int, default 16
            Samples a texel, as in `treelod.render`.
        blend : {'three', 'nearest'}, default 'three'
            Whether the three frames around a direction are mixed, or the nearest stands for it.
        drawing : {'coverage', 'test', 'blend'}, default 'coverage'
            The plant is there on as many of a pixel's samples as the mixed alpha asks for; or where
            alpha is at least `cutoff`; or it is blended, farthest copies first, without depth.
        cutoff : float, default 0.5
            Alpha from which a tested impostor is there, in [1/255, 1] whatever `drawing` is.
        parallax_steps : int, default 2
            How often the stored depth moves the point that is read, in 0..=64: 0 shows frames as
            flat pictures, 1 is what engines do.
        depth_tolerance : float or None, default 0.05
            How far the depth at the point that the steps have found may be from the ray's for a
            frame to count half, in radii of the ball, in [1e-6, 1e6]. What one frame loses the
            others gain. None: frames count by weight alone, as in engines, and show ghosts beside
            the plant.
        shading : {'baked', 'relit'}, default 'baked'
            Whether frames hold colours under the plant's light, or colours without light and
            normals, which are lit when they are looked at: then `relit` changes the light, and the
            outputs ``albedo`` and ``normal`` are the plant's. Occlusion cannot be lit anew and is
            refused.
        format : {'rgba8', 'rgb5a1', 'rgb8', 'palette8', 'bc1', 'bc3', 'bc7'}, default 'rgba8'
            How colours are stored, and so what is drawn of them; see `TextureFormat`. Depths and
            normals are not compressed.
        depth_bits : {8, 16}, default 8
            Bits of a stored depth.
        views : sequence of Camera, optional
            The cameras that will look. Only frames that one of them sees are baked, with no more
            texels than the nearest one has pixels; other cameras are then refused where they need
            another frame. Default: all directions.
        wood : bool, default True
            Whether trunk and limbs are in the pictures. No mesh is drawn in any case.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to before it is baked; see
            `FullMesh.build`. It changes the pictures alone.
        threads : int, optional
            Threads that bake. Default: ``TREELOD_NUM_THREADS``, else all cores.
        progress : callable, optional
            Called as ``progress(done, total)`` with frames baked.

        Returns
        -------
        OctahedralImpostor

        Raises
        ------
        ValueError
            If an argument is out of range, or if the plant has no leaves and no wood is drawn.
        LimitError
            If all frames do not fit into a texture of 16384 x 16384 and 2**26 texels.

        Notes
        -----
        The method is that of [1]_; what differs is marked in the documentation.

        References
        ----------
        .. [1] R. Brucks. Octahedral Impostors. 2018. https://shaderbits.com/blog/octahedral-impostors

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> lod = tl.OctahedralImpostor.build(plant, frame_count=4, resolution=32)
        >>> sum(lod.baked), lod.footprint.cards
        (16, 1)
        """
        facts: dict[str, Any] = {
            "frame_count": whole("frame_count", frame_count),
            "hemisphere": flag("hemisphere", hemisphere),
            "resolution": whole("resolution", resolution),
            "samples": whole("samples", samples),
            "blend": text("blend", blend),
            "drawing": text("drawing", drawing),
            "cutoff": number("cutoff", cutoff),
            "parallax_steps": whole("parallax_steps", parallax_steps, 0),
            "depth_tolerance": depth_tolerance
            if depth_tolerance is None
            else number("depth_tolerance", depth_tolerance),
            "shading": text("shading", shading),
            "format": text("format", format),
            "depth_bits": whole("depth_bits", depth_bits),
            **wood_facts(wood=wood, wood_triangle_count=wood_triangle_count),
        }
        cameras = None if views is None else [camera_facts(camera) for camera in views]
        start = time.perf_counter()
        impostor = _core.octahedral_impostor(
            core_of(plant),
            {**facts, "views": cameras},
            threads=thread_count(threads),
            progress=progress,
        )
        secs = time.perf_counter() - start
        views_built = None if views is None else len(views)
        return cls(impostor, {**facts, "views": views_built}, secs)
