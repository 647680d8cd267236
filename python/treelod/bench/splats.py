"""
How fast are points and lines? The CPU rasteriser against its slow twin, llvmpipe and VTK.

Everyone draws the same points, those of a grown chestnut, and the same lines, a grown pine's
needles, in flat colours with a depth test at 795 x 700, the size of the paper's pictures. llvmpipe
is given the same lists by treelod's GPU backend. VTK draws with llvmpipe, too, in its own ways; its
data are uploaded before. All use the same processor and as many threads. Pictures are compared: the
share of covered pixels that only one of them covers.
"""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from treelod import _core
from treelod.bench.llvmpipe import Llvmpipe
from treelod.bench.raster import LEAD_IN, filling_camera
from treelod.bench.rows import Row, interleaved
from treelod.bench.subjects import Cloud, GrownMesh, Subject
from treelod.bench.vtk_points import VtkCloud
from treelod.plants import grow_plant
from treelod.provenance import core_count
from treelod.render import camera_facts
from treelod.techniques import PointsAndLines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant

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


ERROR_KIND = "covered pixels that one covers alone"


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
    NoAdapterError, ImportError, RuntimeError
        If llvmpipe or VTK is not there, or VTK does not draw on the processor.
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
        whole = partial(Cloud, positions=positions, colors=colors, lines=kind == "lines")
        camera = filling_camera(plant, size)
        for size_px in SIZES_PX[:1] if small else SIZES_PX:
            cloud = whole(size_px=size_px)
            for samples in (1, 4):
                yield from _rows_of(renderer, cloud, camera, samples, threads, repeats)
        yield _twin_row(whole(size_px=1.0), filling_camera(plant, TWIN_SIZE), repeats)
    for samples in (1, 4):
        camera = filling_camera(tree, size)
        yield from _mixed_rows(points, needles, camera, samples, repeats, share, threads)


def _rows_of(
    renderer: _core.Renderer,
    cloud: Cloud,
    camera: Camera,
    samples: int,
    threads: int,
    repeats: int,
) -> Iterator[Row]:
    """Time one cloud beside llvmpipe and VTK."""
    subject = Subject([cloud], camera_facts(camera))
    draw = partial(subject.secs, renderer, samples=samples)
    with ExitStack() as stack:
        vtk = stack.enter_context(VtkCloud(cloud, camera=camera, samples=samples))
        card = stack.enter_context(Llvmpipe(subject, samples=samples, threads=threads))
        runs: dict[str, Callable[[], float | None]] = {
            "ours": partial(draw, threads=threads),
            "ours, one thread": partial(draw, threads=1),
            "llvmpipe": card.draw,
            "vtk": vtk.draw,
        }
        secs = interleaved(runs, repeats=repeats, lead_in=LEAD_IN)
        ours, _ = subject.picture(renderer, samples=samples)
        card_alone = _alone(ours[..., 3], card.picture()[..., 3])
        # VTK's picture has no coverage, and 8 bits
        vtk_alone = _alone(ours[..., 3], vtk.picture().max(axis=-1)) if samples == 1 else None
    case = f"{_name(cloud)}, {camera.size[0]}x{camera.size[1]}, samples={samples}"
    row = partial(Row, group="splats", case=f"{case}, threads={threads}", ours_secs=secs["ours"])
    yield row(
        peer=card.driver,
        peer_secs=secs["llvmpipe"],
        peer_error=card_alone,
        error_kind=ERROR_KIND,
    )
    label = f"VTK {vtk.version}, {vtk.adapter}"
    yield row(
        peer=label,
        peer_secs=secs["vtk"],
        peer_error=vtk_alone,
        error_kind="" if vtk_alone is None else ERROR_KIND,
        aim=AIM,
    )
    yield Row(
        group="splats",
        case=f"{case}, threads=1 against {threads}",
        ours_secs=secs["ours, one thread"],
        peer=label,
        peer_secs=secs["vtk"],
    )


def _name(cloud: Cloud) -> str:
    return f"{cloud.count} {'lines' if cloud.lines else 'points'} of {cloud.size_px:g} px"


def _samples(plant: Plant, kind: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Positions and colours of a plant's points (0) or lines (1)."""
    lod = PointsAndLines.build(plant, wood=False, octree_depth=0)
    return lod._samples.samples[kind]


def _alone(ours: NDArray[np.generic], theirs: NDArray[np.generic]) -> float:
    """Of the pixels that either covers, the share that the other leaves empty."""
    one, other = ours != 0, theirs != 0
    return float(np.logical_xor(one, other).sum() / np.logical_or(one, other).sum())


def _twin_row(cloud: Cloud, camera: Camera, repeats: int) -> Row:
    subject = Subject([cloud], camera_facts(camera))
    runs: dict[str, Callable[[], float | None]] = {
        "ours": partial(subject.secs, _core.Renderer(), samples=1, threads=1),
        "twin": subject.naive_secs,
    }
    secs = interleaved(runs, repeats=min(repeats, 2))
    return Row(
        group="splats",
        case=f"{_name(cloud)}, {camera.size[0]}x{camera.size[1]}, samples=1, threads=1",
        ours_secs=secs["ours"],
        peer="the slow twin",
        peer_secs=secs["twin"],
    )


def _mixed_rows(
    points: tuple[NDArray[np.float32], NDArray[np.float32]],
    needles: tuple[NDArray[np.float32], NDArray[np.float32]],
    camera: Camera,
    samples: int,
    repeats: int,
    share: int,
    threads: int,
) -> Iterator[Row]:
    """Time a frame of the paper's landscape: triangles, lines and points together."""
    triangle_count, line_count, point_count = (count // share for count in MIX)
    sparse = [np.ascontiguousarray(part[:point_count]) for part in points]
    thin = [np.ascontiguousarray(part[: 2 * line_count]) for part in needles]
    parts = (
        GrownMesh(preset="chestnut", leaf_count=triangle_count // 10, wood=False),
        Cloud(positions=thin[0], colors=thin[1], lines=True, size_px=1.0),
        Cloud(positions=sparse[0], colors=sparse[1], lines=False, size_px=1.0),
    )
    subject = Subject(parts, camera_facts(camera))
    best, scalar = _core.Renderer(), _core.Renderer(simd="scalar")
    draw = partial(subject.secs, samples=samples, threads=threads)
    with Llvmpipe(subject, samples=samples, threads=threads) as card:
        runs: dict[str, Callable[[], float | None]] = {
            "ours": partial(draw, best),
            "scalar": partial(draw, scalar),
            "llvmpipe": card.draw,
        }
        secs = interleaved(runs, repeats=repeats, lead_in=LEAD_IN)
        ours, _ = subject.picture(best, samples=samples)
        alone = _alone(ours[..., 3], card.picture()[..., 3])
    case = (
        f"{triangle_count} triangles, {line_count} lines, {point_count} points of 1 px, "
        f"{camera.size[0]}x{camera.size[1]}, samples={samples}, threads={threads}"
    )
    row = partial(Row, group="splats", case=case, ours_secs=secs["ours"])
    yield row(
        peer=card.driver,
        peer_secs=secs["llvmpipe"],
        peer_error=alone,
        error_kind=ERROR_KIND,
    )
    yield row(peer="ours, scalar", peer_secs=secs["scalar"])
