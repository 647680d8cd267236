"""
How fast are textures baked? All slices of the grown chestnut, against mitsuba and embree.

Ours is the whole bake: sorting leaves into slices, lit colour and coverage, dilation, storage and
mips. Peers are timed while they trace alone: loading scenes, building trees and making rays is not
counted, nor could they leave it out. mitsuba draws colour, which is the nearest to our work, and
coverage alone, which is quicker; embree finds coverage alone. Errors are of what each draws: of lit
colour beside mitsuba's colour, else of coverage.
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
from treelod.references.slices import Crown, stored_texels
from treelod.techniques import Slicings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray

    from treelod.plants import Plant

__all__ = ["rows"]

SAMPLES, SIDE_SAMPLES = 16, 4
THREADS = (1, 2)

AIMS = {"color": 50.0, "trimesh": 10.0}
"""Speed-ups that are aimed for, on all threads and against the peer's best time on any."""

MITSUBA = {"color": "mitsuba scalar_rgb, lit colour", "alpha": "mitsuba scalar_rgb, coverage"}

KINDS = {"color": "linear premultiplied colour", "alpha": "alpha"}
"""What errors are of, by quantity."""

EMBREE = {"trimesh": "trimesh + embreex, threads=1", "embreex": "bare embreex, threads=1"}
"""Both ways to embree from Python: the usual one, and its binding alone, twice as fast or more."""


class _Work(NamedTuple):
    """What everybody bakes, and the truth of the first slicing, by quantity."""

    plant: Plant
    side: int
    crowns: list[Crown]
    truth: dict[str, list[NDArray[np.float32]]]


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
        Errors are those of the first slicing's slices. The aims are in the rows of most threads,
        where a peer that is slower on several threads than on one has the time of one.

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
        name: float(
            np.mean([rmse(a, b) for a, b in zip(drawn, work.truth[_drawn(name)], strict=True)])
        )
        for name, drawn in pictures.items()
    }
    case = (
        f"chestnut, {work.plant.foliage.leaf_count} leaves, {SLICING_COUNT * SLICE_COUNT} textures "
        f"of {work.side}x{work.side}, samples={SAMPLES}"
    )
    yield from compared(case, secs, errors, _truth_spp(small))


def compared(
    case: str, secs: Mapping[str, float], errors: Mapping[str, float], truth_spp: int
) -> Iterator[Row]:
    """
    Put times and errors beside those of each peer.

    Parameters
    ----------
    case : str
        What was baked.
    secs : mapping of str to float
        By run: "ours N", "color N" and "alpha N" on N threads; "trimesh" and "embreex".
    errors : mapping of str to float
        "ours color" and "ours alpha"; "color", "alpha", "trimesh" and "embreex".
    truth_spp : int
        Samples of mitsuba that errors are against.

    Yields
    ------
    Row
    """
    thread_counts = [count for count in THREADS if f"ours {count}" in secs]
    for threads in thread_counts:
        last = threads == thread_counts[-1]
        # more threads can be slower
        allowed = thread_counts if last else [threads]
        peers = []
        for quantity, label in MITSUBA.items():
            best = min(allowed, key=lambda count: secs[f"{quantity} {count}"])
            peers.append((quantity, f"{label}, threads={best}", f"{quantity} {best}"))
        peers += [(through, label, through) for through, label in EMBREE.items()]
        for tool, label, run in peers:
            kind = _drawn(tool)
            yield Row(
                group="bake",
                case=f"{case}, threads={threads}",
                ours_secs=secs[f"ours {threads}"],
                peer=label,
                peer_secs=secs[run],
                ours_error=errors[f"ours {kind}"],
                peer_error=errors[tool],
                error_kind=f"{KINDS[kind]} RMSE of the first slicing to mitsuba at {truth_spp}",
                aim=AIMS.get(tool) if last else None,
            )


def _drawn(tool: str) -> str:
    """Which quantity a tool draws, or "ours QUANTITY" names."""
    return "color" if tool.endswith("color") else "alpha"


def _truth_spp(small: bool) -> int:  # noqa: FBT001
    return 64 if small else 256


def _work(*, small: bool) -> _Work:
    plant = grow_plant("chestnut", leaf_count=500 if small else None)
    side = 32 if small else 256
    directions = np.array(_core.circle_directions(SLICING_COUNT))
    crowns = [Crown.of(plant, toward, SLICE_COUNT) for toward in directions]
    picture = {
        "view": crowns[0].view(side),
        "spp": _truth_spp(small),
        "seed": 1,
        "sampler": "multijitter",
    }
    truth = {}
    for quantity in MITSUBA:
        wanted = [{**picture, "quantity": quantity, "soup": i} for i in range(SLICE_COUNT)]
        truth[quantity], _ = mitsuba.draw(crowns[0].slices, wanted)
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
    texels = stored_texels(lod, 0, SLICE_COUNT, work.side)
    pictures["ours color"] = [texture[..., :3] for texture in texels]
    pictures["ours alpha"] = [texture[..., 3] for texture in texels]
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
    pictures[quantity] = list(drawn[:SLICE_COUNT])
    return float(secs.sum())


def _embree(work: _Work, through: str, pictures: dict[str, list[NDArray[Any]]]) -> float:
    soups = [soup for crown in work.crowns for soup in crown.slices]
    views = [crown.view(work.side) for crown in work.crowns for _ in crown.slices]
    drawn, secs = embree.coverage(soups, views, SIDE_SAMPLES, through=through)
    pictures[through] = list(drawn[:SLICE_COUNT])
    return secs
