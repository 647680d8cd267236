"""Billboards: a whole plant as one textured quad."""

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
    number,
    resolution_texels,
    text,
    whole,
    wood_facts,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant

__all__ = ["Billboard", "BillboardPicture", "BillboardQuad"]


@dataclass(frozen=True, kw_only=True, eq=False)
class BillboardPicture:
    """
    One of a billboard's pictures, as it was taken.

    Attributes
    ----------
    number : int
        Among all pictures, those that were left out counted: ring by ring, by rising azimuth.
    corners : ndarray of shape (4, 3), dtype float64
        World positions in metres of what it shows, counter-clockwise from the lower left, in the
        plane through the plant's centre that faces the camera which took it.
    texels : tuple of 4 ints
        Its left column and upper row in the texture, its width and its height.
    """

    number: int
    corners: NDArray[np.float64]
    texels: tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True, eq=False)
class BillboardQuad:
    """
    A quad as a camera sees it.

    Attributes
    ----------
    picture : int
        Number of the picture on it.
    share : float
        Share of the samples that show it, in (0, 1].
    corners : ndarray of shape (4, 3), dtype float64
        World positions in metres, counter-clockwise from the lower left.
    """

    picture: int
    share: float
    corners: NDArray[np.float64]


class Billboard(Technique):
    """
    A whole plant as one quad, which turns with the camera; see `build`.

    Attributes
    ----------
    pictures : list of BillboardPicture
        The pictures that were taken, all in one texture.
    """

    name: ClassVar[str] = "billboard"

    def __init__(
        self, billboard: _core.Billboard, params: Mapping[str, Any], build_secs: float
    ) -> None:
        super().__init__(billboard.representation(), params, build_secs)
        self._billboard = billboard

    @property
    def pictures(self) -> list[BillboardPicture]:
        """The pictures that were taken."""
        return [
            BillboardPicture(number=index, corners=np.array(corners), texels=(x, y, wide, high))
            for index, corners, (x, y, wide, high) in self._billboard.pictures
        ]

    def quads(self, camera: Camera) -> list[BillboardQuad]:
        """
        Return the quads that a camera sees of a plant where its file put it.

        Parameters
        ----------
        camera : Camera
            From where.

        Returns
        -------
        list of BillboardQuad
            One, or two that fade into one another, by the numbers of their pictures.

        Raises
        ------
        ValueError
            If the camera needs a picture that was not taken.
        """
        return [
            BillboardQuad(picture=index, share=abs(fade), corners=np.array(corners))
            for index, fade, corners in self._billboard.quads(camera_facts(camera))
        ]

    @classmethod
    def build(
        cls,
        plant: Plant,
        *,
        align: Literal["camera", "view_plane", "limited"] = "camera",
        axis: Literal["vertical", "free"] = "vertical",
        max_turn_deg: float = 30.0,
        view_count: int = 8,
        elevations_deg: Sequence[float] = (0.0,),
        view_blend: Literal["nearest", "cross_fade"] = "nearest",
        resolution: int | tuple[int, int] = 256,
        samples: int = 16,
        drawing: Literal["test", "coverage", "blend"] = "blend",
        format: TextureFormat = "rgba8",  # noqa: A002
        views: Sequence[Camera] | None = None,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        wood_as: Literal["picture", "mesh"] = "picture",
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> Billboard:
        """
        Take pictures of a plant from all around.

        Parameters
        ----------
        plant : Plant
            What to stand for.
        align : {'camera', 'view_plane', 'limited'}, default 'camera'
            The quad faces the eye; or is parallel to the picture plane; or faces the eye, but is
            turned at most `max_turn_deg` from the picture plane.
        axis : {'vertical', 'free'}, default 'vertical'
            The quad turns about the vertical through its centre, or about its centre. Neither
            rolls: the quad's rows are level.
        max_turn_deg : float, default 30
            Degrees in [0, 180]; for ``align='limited'``.
        view_count : int, default 8
            Pictures a ring, in 1..=4096, evenly by azimuth from +z.
        elevations_deg : sequence of float, default (0,)
            Degrees above the horizon from which pictures are taken, one ring of them each, in
            [-90, 90]. The ring nearest to the viewer is shown. Only 0 for a vertical axis.
        view_blend : {'nearest', 'cross_fade'}, default 'nearest'
            The nearest picture of the ring is shown; or the two nearest, each in as many samples as
            it is near, so that every sample shows one of them.
        resolution : int or (int, int), default 256
            Texels a picture: a side, or width and height.
        samples : int, default 16
            Samples a texel: 1, 4, 8, 16 or 17..=65536.
        drawing : {'test', 'coverage', 'blend'}, default 'blend'
            Drawn where alpha is at least one half, with depth; or in as many of a pixel's samples
            as alpha asks for, with depth; or blended, far to near, without depth.
        format : {'rgba8', 'rgb5a1', 'rgb8', 'palette8', 'bc1', 'bc3', 'bc7'}, default 'rgba8'
            How texels are stored, and so what is drawn of them; see `TextureFormat`.
        views : sequence of Camera, optional
            The cameras that will look. Only pictures that one of them shows are taken, with no more
            texels than the nearest one has pixels; other cameras are then refused where they need
            another picture. Default: all directions.
        wood : bool, default True
            Whether trunk and limbs are drawn.
        wood_triangle_count : int, optional
            About how many triangles the wood is simplified to before it is drawn, in pictures as in
            a mesh; see `FullMesh.build`.
        wood_as : {'picture', 'mesh'}, default 'picture'
            The wood is in the pictures, or beside them as a mesh.
        threads : int, optional
            Threads that draw. Default: ``TREELOD_NUM_THREADS``, else all cores.
        progress : callable, optional
            Called as ``progress(done, total)`` with pictures taken.

        Returns
        -------
        Billboard

        Raises
        ------
        ValueError
            If an argument is out of range, or if the plant has nothing to take a picture of.
        LimitError
            If there are more than 2**20 pictures, or if they do not fit into a texture of 2**26
            texels.

        See Also
        --------
        Billboard.forest : several plants in one texture.
        Wind : what moves billboards in a scene.
        Variety : how copies of one billboard differ.

        References
        ----------
        .. [1] D. Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming, chapter
           20. New Riders, 2003.

        Examples
        --------
        >>> import treelod as tl
        >>> plant = tl.grow_plant("chestnut", leaf_count=200)
        >>> lod = tl.Billboard.build(plant, view_count=4, resolution=64)
        >>> lod.footprint.cards
        4
        """
        (built,) = cls.forest(
            [plant],
            align=align,
            axis=axis,
            max_turn_deg=max_turn_deg,
            view_count=view_count,
            elevations_deg=elevations_deg,
            view_blend=view_blend,
            resolution=resolution,
            samples=samples,
            drawing=drawing,
            format=format,
            views=views,
            wood=wood,
            wood_triangle_count=wood_triangle_count,
            wood_as=wood_as,
            threads=threads,
            progress=progress,
        )
        return built

    @classmethod
    def forest(
        cls,
        plants: Sequence[Plant],
        *,
        align: Literal["camera", "view_plane", "limited"] = "camera",
        axis: Literal["vertical", "free"] = "vertical",
        max_turn_deg: float = 30.0,
        view_count: int = 8,
        elevations_deg: Sequence[float] = (0.0,),
        view_blend: Literal["nearest", "cross_fade"] = "nearest",
        resolution: int | tuple[int, int] = 256,
        samples: int = 16,
        drawing: Literal["test", "coverage", "blend"] = "blend",
        format: TextureFormat = "rgba8",  # noqa: A002
        views: Sequence[Camera] | None = None,
        wood: bool = True,
        wood_triangle_count: int | None = None,
        wood_as: Literal["picture", "mesh"] = "picture",
        threads: int | None = None,
        progress: Callable[[int, int], object] | None = None,
    ) -> list[Billboard]:
        """
        Take pictures of several plants, all in one texture.

        A scene of such billboards is drawn with one texture, and in one item unless pictures fade
        or the wood is a mesh: see ``frame.stats.items``.

        Parameters
        ----------
        plants : sequence of Plant
            What to stand for, at least one.
        align, axis, max_turn_deg, view_count, elevations_deg, view_blend, resolution, samples, \
drawing, format, views, wood, wood_triangle_count, wood_as, threads, progress
            As for `Billboard.build`; `views` in each plant's own world.

        Returns
        -------
        list of Billboard
            One for each plant. The texture's bytes are shared out among their footprints by texels.

        Raises
        ------
        ValueError, LimitError
            As `Billboard.build`, or if there is no plant.

        Examples
        --------
        >>> import treelod as tl
        >>> plants = [tl.grow_plant("chestnut", leaf_count=50, seed=seed) for seed in (1, 2)]
        >>> lods = tl.Billboard.forest(plants, view_count=4, resolution=32)
        >>> transforms = tl.scatter(20, 10.0)
        >>> forest = tl.Scene([(lods[0], transforms[::2]), (lods[1], transforms[1::2])])
        >>> camera = tl.Camera.perspective((0, 20, 90), (0, 5, 0), size=(64, 48))
        >>> stats = tl.render(forest, camera).stats
        >>> stats.items, stats.textures
        (1, 1)
        """
        width, height = resolution_texels("resolution", resolution)
        cores = [core_of(plant) for plant in plants]
        params: dict[str, Any] = {
            "align": text("align", align),
            "axis": text("axis", axis),
            "max_turn_deg": number("max_turn_deg", max_turn_deg),
            "view_count": whole("view_count", view_count),
            "elevations_deg": tuple(number("elevations_deg", each) for each in elevations_deg),
            "view_blend": text("view_blend", view_blend),
            "resolution": (width, height),
            "samples": whole("samples", samples),
            "drawing": text("drawing", drawing),
            "format": text("format", format),
            "views": None if views is None else len(views),
            **wood_facts(wood=wood, wood_triangle_count=wood_triangle_count),
            "wood_as": text("wood_as", wood_as),
        }
        cameras = None if views is None else [camera_facts(camera) for camera in views]
        facts: Any = {**params, "views": cameras}
        start = time.perf_counter()
        built = _core.billboards(cores, facts, threads=thread_count(threads), progress=progress)
        secs = time.perf_counter() - start
        return [cls(billboard, params, secs) for billboard in built]
