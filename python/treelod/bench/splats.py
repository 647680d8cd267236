"""
How fast are points and lines? The CPU rasteriser against its slow twin and against VTK.

Everyone draws the same points, those of a grown chestnut, and the same lines, a grown pine's
needles, in flat colours with a depth test at 795 x 700, the size of the paper's pictures. VTK draws
with Mesa's llvmpipe, on the same processor and with as many threads; its data are uploaded before.
With one sample a pixel the pictures are compared: the share of covered pixels that only one of them
covers.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from treelod import _core
from treelod.bench.raster import filling_camera
from treelod.bench.rows import Row, interleaved
from treelod.bench.vtk_points import VtkCloud
from treelod.plants import grow_plant
from treelod.provenance import core_count
from treelod.render import camera_facts
from treelod.techniques import PointsAndLines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from treelod.cameras import Camera

__all__ = ["rows"]

SIZE = (795, 700)
SIZES_PX = (1.0, 2.0, 3.0)
AIM = 5.0
"""Speed-up over VTK that is aimed for."""

POINT_LEAVES = 50_000
"""Leaves of the chestnut: 10 triangles each, two points a triangle."""

LINE_LEAVES = 400_000
"""Needles of the pine: a line each."""

TWIN_SIZE = (64, 48)
"""The slow twin asks every point at every sample."""

MIX = (460_000, 400_000, 300_000)
"""Triangles, lines and points of the paper's landscape, a frame."""


def rows(*, repeats: int, small: bool) -> Iterator[Row]:
    """
    Measure, case by case.

    Parameters
    ----------
    repeats : int
        Rounds that are counted, at least 1.
    small : bool
        Few points in a small picture, for tests.

    Yields
    ------
    Row

    Raises
    ------
    ImportError, RuntimeError
        If VTK is not there, or does not draw on the processor.
    """
    share = 100 if small else 1
    size = (80, 70) if small else SIZE
    tree = grow_plant("chestnut", leaf_count=POINT_LEAVES // share)
    pine = grow_plant("pine", leaf_count=LINE_LEAVES // share)
    points = _samples(tree, 0)
    needles = _samples(pine, 1)
    threads = core_count()
    renderer = _core.Renderer()
    for kind, (positions, colors), plant in (("points", points, tree), ("lines", needles, pine)):
        lines = kind == "lines"
        count = len(positions) // (2 if lines else 1)
        camera = filling_camera(plant, size)
        for size_px in SIZES_PX[:1] if small else SIZES_PX:
            scene = _scene(_core.cloud(positions, colors, lines=lines, size_px=size_px))
            for samples in (1, 4):
                case = f"{count} {kind} of {size_px:g} px, {size[0]}x{size[1]}, samples={samples}"
                with VtkCloud(
                    positions, colors, lines=lines, size_px=size_px, camera=camera, samples=samples
                ) as peer:
                    runs: dict[str, Callable[[], float | None]] = {
                        "ours": partial(_time, renderer, scene, camera, samples, threads),
                        "ours, one thread": partial(_time, renderer, scene, camera, samples, 1),
                        "vtk": peer.draw,
                    }
                    secs = interleaved(runs, repeats=repeats, warmup=2)
                    label = f"VTK {peer.version}, {peer.adapter}"
                    alone = _alone(renderer, scene, camera, peer) if samples == 1 else None
                row = partial(Row, group="splats")
                yield row(
                    case=f"{case}, threads={threads}",
                    ours_secs=secs["ours"],
                    peer=label,
                    peer_secs=secs["vtk"],
                    peer_error=alone,
                    error_kind="" if alone is None else "covered pixels that one covers alone",
                    aim=AIM,
                )
                yield row(
                    case=f"{case}, threads=1 against {threads}",
                    ours_secs=secs["ours, one thread"],
                    peer=label,
                    peer_secs=secs["vtk"],
                )
        yield _twin_row(kind, positions, colors, filling_camera(plant, TWIN_SIZE), repeats)
    yield _mixed_row(points, needles, filling_camera(tree, size), repeats, share, threads)


def _samples(plant: object, kind: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Positions and colours of a plant's points (0) or lines (1)."""
    lod = PointsAndLines.build(plant, wood=False, octree_depth=0)  # type: ignore[arg-type]
    return lod._samples.samples[kind]


def _scene(*groups: _core.Representation) -> _core.Scene:
    return _core.Scene([(group, np.eye(4)[np.newaxis]) for group in groups])


def _time(
    renderer: _core.Renderer, scene: _core.Scene, camera: Camera, samples: int, threads: int
) -> float:
    stats = renderer.time(scene, camera_facts(camera), samples=samples, threads=threads)
    return float(stats["emit_millis"] + stats["draw_millis"]) / 1e3


def _alone(renderer: _core.Renderer, scene: _core.Scene, camera: Camera, peer: VtkCloud) -> float:
    planes, _ = renderer.render(
        scene,
        camera_facts(camera),
        samples=1,
        background=(0.0, 0.0, 0.0, 0.0),
        outputs=("color",),
        threads=None,
    )
    ours = planes["color"][..., 3] > 0
    theirs = peer.picture().any(axis=-1)
    return float((ours ^ theirs).sum() / (ours | theirs).sum())


def _twin_row(
    kind: str,
    positions: NDArray[np.float32],
    colors: NDArray[np.float32],
    camera: Camera,
    repeats: int,
) -> Row:
    scene = _scene(_core.cloud(positions, colors, lines=kind == "lines", size_px=1.0))
    runs: dict[str, Callable[[], float | None]] = {
        "ours": partial(_time, _core.Renderer(), scene, camera, 1, 1),
        "twin": lambda: _core.time_naive(scene, camera_facts(camera), samples=1),
    }
    secs = interleaved(runs, repeats=min(repeats, 2))
    count = len(positions) // (2 if kind == "lines" else 1)
    return Row(
        group="splats",
        case=f"{count} {kind} of 1 px, {camera.size[0]}x{camera.size[1]}, samples=1, threads=1",
        ours_secs=secs["ours"],
        peer="the slow twin",
        peer_secs=secs["twin"],
    )


def _mixed_row(
    points: tuple[NDArray[np.float32], NDArray[np.float32]],
    needles: tuple[NDArray[np.float32], NDArray[np.float32]],
    camera: Camera,
    repeats: int,
    share: int,
    threads: int,
) -> Row:
    """Time a frame of the paper's landscape: triangles, lines and points together."""
    triangle_count, line_count, point_count = (count // share for count in MIX)
    mesh = grow_plant("chestnut", leaf_count=triangle_count // 10)
    leaves = _core.full_mesh(mesh._core, wood=False, wood_triangle_count=None, filter="bilinear")
    sparse = [np.ascontiguousarray(part[:point_count]) for part in points]
    thin = [np.ascontiguousarray(part[: 2 * line_count]) for part in needles]
    scene = _scene(
        leaves,
        _core.cloud(thin[0], thin[1], lines=True, size_px=1.0),
        _core.cloud(sparse[0], sparse[1], lines=False, size_px=1.0),
    )
    renderer = _core.Renderer()
    scalar = _core.Renderer(simd="scalar")
    runs = {
        "ours": partial(_time, renderer, scene, camera, 1, threads),
        "scalar": partial(_time, scalar, scene, camera, 1, threads),
    }
    secs = interleaved(runs, repeats=repeats)
    case = (
        f"{triangle_count} triangles, {line_count} lines, {point_count} points of 1 px, "
        f"{camera.size[0]}x{camera.size[1]}, samples=1, threads={threads}"
    )
    return Row(
        group="splats",
        case=case,
        ours_secs=secs["ours"],
        peer="ours, scalar",
        peer_secs=secs["scalar"],
    )
