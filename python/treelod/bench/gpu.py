"""
How fast does a graphics card draw each technique, and how like the processor?

Run it on the machine whose card is in question: one command gives absolute figures with the card's
name. The plant is the grown chestnut, which fills the picture's height; the scene is a wood of it.
Every technique has its default parameters. The processor draws the same lists in turns.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from treelod import _core, metrics
from treelod.bench.raster import LEAD_IN, filling_camera
from treelod.bench.rows import Row, interleaved
from treelod.cameras import Camera
from treelod.errors import NoAdapterError
from treelod.gpu import adapters
from treelod.plants import grow_plant
from treelod.provenance import core_count
from treelod.render import camera_facts, render
from treelod.scenes import Scene
from treelod.techniques import REGISTRY, FullMesh

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from treelod.plants import Plant

__all__ = ["rows"]

SIZE = (1024, 768)

WOOD_SIDE = 5
"""Trees along either side of the wood."""


def rows(*, repeats: int, small: bool) -> Iterator[Row]:
    """
    Measure, technique by technique, with the card that `tl.render` takes by default.

    Parameters
    ----------
    repeats : int
        Rounds that are counted, at least 1.
    small : bool
        A small plant in a small picture, for tests.

    Yields
    ------
    Row
        Two for each subject and number of samples: against the processor, with FLIP to its picture,
        and against the card's own clock, where the card has one.

    Raises
    ------
    NoAdapterError
        If there is no graphics card.
    """
    cards = adapters()
    if not cards:
        msg = "there is no graphics adapter; treelod gpu says what to install"
        raise NoAdapterError(msg)
    plant = grow_plant("chestnut", leaf_count=200 if small else None)
    size = (128, 96) if small else SIZE
    camera = filling_camera(plant, size)
    for name, technique in REGISTRY.items():
        subject = Scene([(technique.build(plant), None)])
        yield from _rows(f"chestnut, {name}", subject, camera, repeats)
    wood, view = _wood(plant, 2 if small else WOOD_SIDE, size)
    yield from _rows(f"{wood.instance_count} chestnuts, full_mesh", wood, view, repeats)


def _wood(plant: Plant, side: int, size: tuple[int, int]) -> tuple[Scene, Camera]:
    """Trees in rows, and a camera that looks along them."""
    low, high = np.asarray(plant.bounds)
    step = float((high - low)[[0, 2]].max()) * 1.1
    placed = np.tile(np.eye(4), (side * side, 1, 1))
    for number, transform in enumerate(placed):
        transform[0, 3] = (number % side - (side - 1) / 2) * step
        transform[2, 3] = -(number // side) * step
    height = float(high[1] - low[1])
    eye = (0.0, float(low[1]) + height * 0.6, float(high[2]) + height * 1.2)
    target = (0.0, float(low[1]) + height * 0.45, -side * step / 2)
    scene = Scene([(FullMesh.build(plant), placed)])
    return scene, Camera.perspective(eye, target, fov_y_deg=45.0, size=size)


def _rows(name: str, scene: Scene, camera: Camera, repeats: int) -> Iterator[Row]:
    threads = core_count()
    facts = camera_facts(camera)
    for samples in (1, 4):
        own: list[float] = []

        def draw(
            backend: str, renderer: _core.Renderer, samples: int = samples, own: list[float] = own
        ) -> float:
            stats = renderer.time(
                scene._core, facts, samples=samples, threads=threads, backend=backend
            )
            if stats["gpu_millis"] is not None:
                own.append(stats["gpu_millis"] / 1e3)
            return float(stats["emit_millis"] + stats["draw_millis"]) / 1e3

        runs: dict[str, Callable[[], float | None]] = {
            backend: partial(draw, backend, _core.Renderer()) for backend in ("gpu", "cpu")
        }
        secs = interleaved(runs, repeats=repeats, lead_in=LEAD_IN)
        processor = render(scene, camera, samples=samples)
        card = render(scene, camera, samples=samples, backend="gpu")
        case = f"{name}, {camera.size[0]}x{camera.size[1]}, samples={samples}, {card.stats.adapter}"
        row = partial(Row, group="gpu", case=case, ours_secs=secs["gpu"])
        yield row(
            peer=f"the CPU renderer, threads={threads}",
            peer_secs=secs["cpu"],
            ours_error=metrics.compare(processor, card).flip,
            error_kind="FLIP to the CPU renderer's picture",
        )
        if own:
            # all but the first round's
            yield row(peer="the card's own clock", peer_secs=float(np.median(own[LEAD_IN + 1 :])))
