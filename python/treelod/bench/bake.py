"""
How fast are textures baked? All slices of the grown chestnut, against mitsuba and embree.

Ours is the whole bake: sorting leaves into slices, lit colour and coverage, dilation, storage and
mips. Peers are timed while they trace alone: loading scenes, building trees and making rays is not
counted, nor could they leave it out. mitsuba draws colour, which is the nearest to our work, and
coverage alone, which is quicker; embree finds coverage alone.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from treelod import _core
from treelod.bench.rows import Row, interleaved
from treelod.plants import grow_plant
from treelod.references import embree, mitsuba
from treelod.references.checks import rmse
from treelod.references.coverage import SLICE_COUNT, SLICING_COUNT
from treelod.references.runner import require
from treelod.references.slices import Crown, stored_alpha
from treelod.techniques import Slicings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from treelod.plants import Plant

__all__ = ["rows"]

SAMPLES, SIDE_SAMPLES = 16, 4
THREADS = (1, 2)

AIMS = {"color": 50.0, "trimesh": 10.0}
"""Speed-ups that are aimed for."""

MITSUBA = {"color": "mitsuba scalar_rgb, lit colour", "alpha": "mitsuba scalar_rgb, coverage"}

EMBREE = {"trimesh": "trimesh + embreex, threads=1", "embreex": "bare embreex, threads=1"}
"""Both ways to embree from Python: the usual one, and its binding alone, twice as fast or more."""


class _Work(NamedTuple):
    """What everybody bakes, and the truth of the first slicing."""

    plant: Plant
    side: int
    crowns: list[Crown]
    truth: list[NDArray[np.float32]]


def rows(*, repeats: int, small: bool) -> Iterator[Row]:
    """
    Measure, peer by peer.

    Parameters
    ----------
    repeats : int
        Rounds that are counted, at least 1; each takes two minutes or three.
    small : bool
        A small plant and small textures, for tests.

    Yields
    ------
    Row
        Errors are those of the first slicing's slices.

    Raises
    ------
    ImportError
        If the extra ``validate`` is not installed.
    """
    require()
    work = _work(small=small)
    pictures: dict[str, list[NDArray[Any]]] = {}
    runs: dict[str, Callable[[], float]] = {}
    thread_counts = THREADS[:1] if small else THREADS
    for threads in thread_counts:
        runs[f"ours {threads}"] = partial(_ours, work, threads, pictures)
        for quantity in MITSUBA:
            runs[f"{quantity} {threads}"] = partial(_mitsuba, work, threads, quantity, pictures)
    for through in EMBREE:
        runs[through] = partial(_embree, work, through, pictures)
    # peers run in a process of their own each round, so that only ours can be warm: once is enough
    _ours(work, 1, pictures)
    secs = interleaved(runs, repeats=repeats, warmup=0)
    errors = {
        name: float(np.mean([rmse(a, b) for a, b in zip(drawn, work.truth, strict=True)]))
        for name, drawn in pictures.items()
    }
    count = SLICING_COUNT * SLICE_COUNT
    for threads in thread_counts:
        case = (
            f"chestnut, {work.plant.foliage.leaf_count} leaves, {count} textures of "
            f"{work.side}x{work.side}, samples={SAMPLES}, threads={threads}"
        )
        peers = [
            (quantity, f"{label}, threads={threads}", f"{quantity} {threads}")
            for quantity, label in MITSUBA.items()
        ]
        peers += [(through, label, through) for through, label in EMBREE.items()]
        for tool, label, run in peers:
            yield Row(
                group="bake",
                case=case,
                ours_secs=secs[f"ours {threads}"],
                peer=label,
                peer_secs=secs[run],
                ours_error=errors["ours"],
                peer_error=errors.get(tool),
                error_kind=f"alpha RMSE of the first slicing to mitsuba at {_truth_spp(small)}",
                aim=AIMS.get(tool),
            )


def _truth_spp(small: bool) -> int:  # noqa: FBT001
    return 64 if small else 256


def _work(*, small: bool) -> _Work:
    plant = grow_plant("chestnut", leaf_count=500 if small else None)
    side = 32 if small else 256
    directions = np.array(_core.circle_directions(SLICING_COUNT))
    crowns = [Crown.of(plant, toward, SLICE_COUNT) for toward in directions]
    picture = {
        "view": crowns[0].view(side),
        "quantity": "alpha",
        "spp": _truth_spp(small),
        "seed": 1,
        "sampler": "multijitter",
    }
    pictures = [{**picture, "soup": number} for number in range(SLICE_COUNT)]
    truth, _ = mitsuba.draw(crowns[0].slices, pictures)
    return _Work(plant, side, crowns, truth)


def _ours(work: _Work, threads: int, pictures: dict[str, list[NDArray[Any]]]) -> float:
    lod = Slicings.build(
        work.plant,
        slicing_count=SLICING_COUNT,
        slice_count=SLICE_COUNT,
        resolution=work.side,
        samples=SAMPLES,
        wood=False,
        threads=threads,
    )
    pictures["ours"] = list(stored_alpha(lod, 0, SLICE_COUNT, work.side))
    return lod.build_secs


def _mitsuba(
    work: _Work, threads: int, quantity: str, pictures: dict[str, list[NDArray[Any]]]
) -> float:
    soups = [soup for crown in work.crowns for soup in crown.slices]
    wanted = [
        {
            "soup": index,
            "view": work.crowns[index // SLICE_COUNT].view(work.side),
            "quantity": quantity,
            "spp": SAMPLES,
            # another than the truth's
            "seed": 2,
            "sampler": "independent",
        }
        for index in range(len(soups))
    ]
    drawn, secs = mitsuba.draw(soups, wanted, cached=False, threads=threads)
    if quantity == "alpha":
        pictures["alpha"] = list(drawn[:SLICE_COUNT])
    return float(secs.sum())


def _embree(work: _Work, through: str, pictures: dict[str, list[NDArray[Any]]]) -> float:
    soups = [soup for crown in work.crowns for soup in crown.slices]
    views = [crown.view(work.side) for crown in work.crowns for _ in crown.slices]
    drawn, secs = embree.coverage(soups, views, SIDE_SAMPLES, through=through)
    pictures[through] = list(drawn[:SLICE_COUNT])
    return secs
