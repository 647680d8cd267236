"""
Benchmarks: treelod against its own slow twins and against other people's tools.

A group is a function that yields rows; `GROUPS` is all of them. Each does the same work with every
tool, in turns, and gives medians.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from treelod.bench.rows import Row, interleaved

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

__all__ = ["GROUPS", "Row", "interleaved"]


def _raster(*, repeats: int, small: bool) -> Iterator[Row]:
    from treelod.bench.raster import rows

    return rows(repeats=repeats, small=small)


def _bake(*, repeats: int, small: bool) -> Iterator[Row]:
    from treelod.bench.bake import rows

    return rows(repeats=repeats, small=small)


def _clusters(*, repeats: int, small: bool) -> Iterator[Row]:
    from treelod.bench import cards, clusters

    yield from clusters.rows(repeats=repeats, small=small)
    yield from cards.rows(repeats=repeats, small=small)


def _collapse(*, repeats: int, small: bool) -> Iterator[Row]:
    from treelod.bench import collapse, cuts

    yield from collapse.rows(repeats=repeats, small=small)
    yield from cuts.rows(repeats=repeats, small=small)


def _gpu(*, repeats: int, small: bool) -> Iterator[Row]:
    from treelod.bench.gpu import rows

    return rows(repeats=repeats, small=small)


def _splats(*, repeats: int, small: bool) -> Iterator[Row]:
    from treelod.bench.splats import rows

    return rows(repeats=repeats, small=small)


GROUPS: dict[str, Callable[..., Iterator[Row]]] = {
    "bake": _bake,
    "clusters": _clusters,
    "collapse": _collapse,
    "gpu": _gpu,
    "raster": _raster,
    "splats": _splats,
}
"""Groups by name. Called with `repeats` (rounds that are counted) and `small` (seconds instead of
minutes, for tests); peers are imported only then."""
