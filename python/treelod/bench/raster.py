"""
How fast is a frame of a whole plant? The CPU rasteriser against its twins and against llvmpipe.

The plant is the grown chestnut, which fills the picture's height. Every tool draws its 159,073
triangles into float colour with a depth test: clear, transform, raster and resolve, in memory that
stays warm.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from treelod import _core
from treelod.bench.llvmpipe import MAX_SAMPLES, Llvmpipe
from treelod.bench.rows import Row, interleaved
from treelod.cameras import Camera
from treelod.plants import grow_plant
from treelod.references.checks import rmse
from treelod.render import camera_facts, render
from treelod.scenes import Scene
from treelod.techniques import FullMesh

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from treelod.plants import Plant

__all__ = ["rows"]

SIZE = (1024, 768)
THREADS = (1, 2)
AIMS = {1: 8.0, 4: 4.0}
"""Speed-up over llvmpipe that is aimed for, by samples a pixel."""

TWIN_SIZE = (64, 48)
"""The slow twin asks every triangle at every sample: a full picture would take an hour."""

REFERENCE_SAMPLES = 256

MARGIN = 1.05
"""Of the distance at which a flat plant would just fit: boughs that reach forward need it."""


def rows(*, repeats: int, small: bool) -> Iterator[Row]:
    """
    Measure, case by case.

    Parameters
    ----------
    repeats : int
        Rounds that are counted, at least 1.
    small : bool
        A small plant in a small picture, for tests.

    Yields
    ------
    Row

    Raises
    ------
    ImportError, RuntimeError
        If llvmpipe is not there.
    """
    plant = grow_plant("chestnut", leaf_count=500 if small else None)
    size = (128, 96) if small else SIZE
    name = f"chestnut, {plant.triangle_count} triangles"
    mesh = FullMesh.build(plant)
    best, scalar = _core.Renderer(), _core.Renderer(simd="scalar")
    scene = Scene([(mesh, None)])
    camera = filling_camera(plant, size)
    reference = _color(render(mesh, camera, samples=REFERENCE_SAMPLES).color)
    for samples in (1, 4, 16):
        ours_error = rmse(_color(render(mesh, camera, samples=samples).color), reference)
        for threads in THREADS:
            case = f"{name}, {size[0]}x{size[1]}, samples={samples}, threads={threads}"
            with ExitStack() as stack:
                peer = stack.enter_context(
                    _llvmpipe(plant, camera, min(samples, MAX_SAMPLES), threads)
                )
                draws = -(-samples // MAX_SAMPLES)
                runs: dict[str, Callable[[], float]] = {
                    "ours": partial(_draw, best, scene, camera, samples, threads),
                    "scalar": partial(_draw, scalar, scene, camera, samples, threads),
                    "llvmpipe": partial(_draws, peer, draws),
                    "copy": _copy(bytes_touched(plant, size), threads, stack),
                }
                secs = interleaved(runs, repeats=repeats, warmup=2)
                # more samples than it knows are several pictures of it, which nothing here averages
                peer_error = rmse(peer.picture(), reference) if draws == 1 else None
            label = peer.adapter if draws == 1 else f"{peer.adapter}, {draws} draws of 4 samples"
            row = partial(Row, group="raster", case=case, ours_secs=secs["ours"])
            yield row(
                peer=label,
                peer_secs=secs["llvmpipe"],
                ours_error=ours_error,
                peer_error=peer_error,
                error_kind=f"colour RMSE to {REFERENCE_SAMPLES} samples",
                aim=AIMS.get(samples),
            )
            yield row(peer="ours, scalar", peer_secs=secs["scalar"])
            yield row(peer="bound: a copy of the bytes touched", peer_secs=secs["copy"])
    yield _twin_row(scene, filling_camera(plant, TWIN_SIZE), name, repeats)


def filling_camera(plant: Plant, size: tuple[int, int]) -> Camera:
    """
    Return a perspective camera in front of a plant, which fills the picture's height.

    Parameters
    ----------
    plant : Plant
        What it looks at.
    size : tuple of 2 ints
        Width and height in pixels.

    Returns
    -------
    Camera
    """
    low, high = np.asarray(plant.bounds)
    center, extent = (low + high) / 2.0, high - low
    distance = MARGIN * extent[1] / 2.0 / np.tan(np.deg2rad(45.0) / 2.0)
    eye = center + np.array([0.0, 0.0, distance])
    return Camera.perspective(tuple(eye), tuple(center), fov_y_deg=45.0, size=size)


def bytes_touched(plant: Plant, size: tuple[int, int]) -> int:
    """
    Return the bytes that a frame must at least read or write.

    Each vertex is read, placed (24 bytes) and read again; each triangle's indices are read, its
    shape (64 bytes) and origin (20 bytes) are written and read, and so is its place in a tile's
    list (4 bytes); each pixel is written.

    Parameters
    ----------
    plant : Plant
        What is drawn.
    size : tuple of 2 ints
        Width and height in pixels.

    Returns
    -------
    int
    """
    vertices = len(plant.wood.positions) + len(plant.foliage.mesh.positions)
    per_vertex = 12 + 2 * 24
    per_triangle = 12 + 2 * (64 + 20 + 4)
    return vertices * per_vertex + plant.triangle_count * per_triangle + size[0] * size[1] * 16


def _copy(byte_count: int, threads: int, stack: ExitStack) -> Callable[[], float]:
    """Copy half as many bytes, which reads and writes as many, and time it."""
    source = np.ones(byte_count // 2, np.uint8)
    target = np.empty_like(source)
    parts = list(zip(np.array_split(target, threads), np.array_split(source, threads), strict=True))
    pool = stack.enter_context(ThreadPoolExecutor(threads))

    def run() -> float:
        start = time.perf_counter()
        # copying releases the interpreter's lock
        list(pool.map(lambda part: np.copyto(*part), parts))
        return time.perf_counter() - start

    return run


def _draw(
    renderer: _core.Renderer, scene: Scene, camera: Camera, samples: int, threads: int
) -> float:
    facts = camera_facts(camera)
    stats = renderer.time(scene._core, facts, samples=samples, threads=threads)
    return float(stats["emit_millis"] + stats["draw_millis"]) / 1e3


def _draws(peer: Llvmpipe, count: int) -> float:
    return sum(peer.draw() for _ in range(count))


def _twin_row(scene: Scene, camera: Camera, name: str, repeats: int) -> Row:
    facts = camera_facts(camera)

    def twin() -> float:
        return _core.time_naive(scene._core, facts, samples=1)

    secs = interleaved(
        {"ours": partial(_draw, _core.Renderer(), scene, camera, 1, 1), "twin": twin},
        repeats=min(repeats, 3),
    )
    case = f"{name}, {camera.size[0]}x{camera.size[1]}, samples=1, threads=1"
    return Row(
        group="raster",
        case=case,
        ours_secs=secs["ours"],
        peer="the slow twin",
        peer_secs=secs["twin"],
    )


def _llvmpipe(plant: Plant, camera: Camera, samples: int, threads: int) -> Llvmpipe:
    wood, leaves = plant.wood, plant.foliage.mesh
    return Llvmpipe(
        positions=np.concatenate([wood.positions, leaves.positions]),
        front=np.concatenate([wood.front, leaves.front]),
        back=np.concatenate([wood.back, leaves.back]),
        triangles=np.concatenate([wood.triangles, leaves.triangles + len(wood.positions)]),
        clip_from_local=_clip_from_world(camera) @ _translation(plant.origin),
        size=camera.size,
        samples=samples,
        threads=threads,
    )


def _translation(offset: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def _clip_from_world(camera: Camera) -> NDArray[np.float64]:
    """Clip space with depth near / z, which keeps its precision far away and has no far plane."""
    view = np.eye(4)
    view[:3, :3] = camera.view_rotation()
    view[:3, 3] = -camera.view_rotation() @ np.asarray(camera.eye)
    assert camera.fov_y_deg is not None
    scale = 1.0 / np.tan(np.deg2rad(camera.fov_y_deg) / 2.0)
    width, height = camera.size
    clip = np.array(
        [
            [scale * height / width, 0.0, 0.0, 0.0],
            [0.0, scale, 0.0, 0.0],
            [0.0, 0.0, 0.0, camera.near],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )
    product: NDArray[np.float64] = clip @ view
    return product


def _color(color: NDArray[np.float32] | None) -> NDArray[np.float32]:
    assert color is not None
    return color
