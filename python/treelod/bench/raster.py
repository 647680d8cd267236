"""
How fast is a frame of a whole plant? The CPU rasteriser against its twins and against llvmpipe.

The plant is the grown chestnut, which fills the picture's height. All draw the same list, 159,073
triangles, into float colour with a depth test: clear, transform, raster and resolve, in memory that
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
from treelod.bench.llvmpipe import Llvmpipe
from treelod.bench.rows import Row, interleaved
from treelod.bench.subjects import GrownMesh, Subject
from treelod.cameras import Camera
from treelod.plants import grow_plant
from treelod.references.checks import rmse
from treelod.render import camera_facts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from treelod.plants import Plant

__all__ = ["rows"]

SIZE = (1024, 768)
THREADS = (1, 2)
AIMS = {1: 8.0, 4: 4.0}
"""Speed-up over llvmpipe that is aimed for, by samples a pixel."""

TWIN_SIZE = (64, 48)
"""The slow twin asks every triangle at every sample: a full picture would take an hour."""

REFERENCE_SAMPLES = 256

OPERATIONS = {"vertex": 42, "triangle": 143, "sample": 19}
"""
Additions, products and comparisons that the rasteriser's kernels do for each vertex, each triangle
(set up, and its edges) and each sample it covers, counted in their code.
"""

LEAD_IN = 2
"""Frames in a row before the one that is counted: after them its data is where it stays."""

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
    NoAdapterError, RuntimeError
        If llvmpipe is not there, or fails.
    """
    chestnut = GrownMesh(preset="chestnut", leaf_count=500 if small else None)
    plant = grow_plant(chestnut.preset, leaf_count=chestnut.leaf_count)
    size = (128, 96) if small else SIZE
    name = f"chestnut, {plant.triangle_count} triangles"
    best, scalar = _core.Renderer(), _core.Renderer(simd="scalar")
    subject = Subject([chestnut], camera_facts(filling_camera(plant, size)))
    reference, _ = subject.picture(best, samples=REFERENCE_SAMPLES)
    _, counts = subject.picture(best, samples=1)
    rate = max(_core.peak_rate() for _ in range(repeats))
    for samples in (1, 4, 16):
        ours_error = rmse(subject.picture(best, samples=samples)[0], reference)
        for threads in THREADS:
            case = f"{name}, {size[0]}x{size[1]}, samples={samples}, threads={threads}"
            draw = partial(subject.secs, samples=samples, threads=threads)
            with ExitStack() as stack:
                peer = stack.enter_context(Llvmpipe(subject, samples=samples, threads=threads))
                runs: dict[str, Callable[[], float]] = {
                    "ours": partial(draw, best),
                    "scalar": partial(draw, scalar),
                    "llvmpipe": peer.draw,
                    "copy": _copy(bytes_touched(plant, size), threads, stack),
                }
                secs = interleaved(runs, repeats=repeats, lead_in=LEAD_IN)
                peer_error = rmse(peer.picture(), reference)
            row = partial(Row, group="raster", case=case, ours_secs=secs["ours"])
            yield row(
                peer=peer.driver,
                peer_secs=secs["llvmpipe"],
                ours_error=ours_error,
                peer_error=peer_error,
                error_kind=f"colour RMSE to {REFERENCE_SAMPLES} samples",
                aim=AIMS.get(samples),
            )
            yield row(peer="ours, scalar", peer_secs=secs["scalar"])
            yield row(peer="bound: a copy of the bytes touched", peer_secs=secs["copy"])
            least = least_operations(plant, counts["fragments"] * samples) / (rate * threads)
            yield row(peer="bound: arithmetic in full vectors", peer_secs=least)
    near = Subject([chestnut], camera_facts(filling_camera(plant, TWIN_SIZE)))
    yield _twin_row(near, name, repeats)


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


def least_operations(plant: Plant, sample_count: int) -> int:
    """
    Return the operations on numbers that a frame must at least do, were every vector full.

    What colours take is left out, and so is all that is no arithmetic.

    Parameters
    ----------
    plant : Plant
        What is drawn.
    sample_count : int
        Samples that its triangles cover, hidden ones included.

    Returns
    -------
    int
    """
    vertices = len(plant.wood.positions) + len(plant.foliage.mesh.positions)
    counts = {"vertex": vertices, "triangle": plant.triangle_count, "sample": sample_count}
    return sum(counts[what] * OPERATIONS[what] for what in counts)


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


def _twin_row(subject: Subject, name: str, repeats: int) -> Row:
    runs: dict[str, Callable[[], float]] = {
        "ours": partial(subject.secs, _core.Renderer(), samples=1, threads=1),
        "twin": subject.naive_secs,
    }
    secs = interleaved(runs, repeats=min(repeats, 3))
    case = f"{name}, {TWIN_SIZE[0]}x{TWIN_SIZE[1]}, samples=1, threads=1"
    return Row(
        group="raster",
        case=case,
        ours_secs=secs["ours"],
        peer="the slow twin",
        peer_secs=secs["twin"],
    )
