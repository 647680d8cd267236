"""
Frames of leaf clusters against the full mesh: leaves alone, from near and far.

The paper drew 11,291 leaves at 40 frames a second and 107, 54, 32 and 29 cards at 163, 256, 278 and
292, on a graphics card of 2004 whose limit was the count of vertices.
"""

from __future__ import annotations

import statistics
from typing import TYPE_CHECKING

import numpy as np

import treelod as tl
from treelod.bench.rows import Row

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["rows"]

PAPER_RATIOS = {107: 163 / 40, 54: 256 / 40, 32: 278 / 40, 29: 292 / 40}
"""Frames a second of so many cards over those of the mesh, by the paper."""

HEIGHTS = (1, 4, 16)
"""Distances of the eye from the crown's middle, in heights of the tree."""


def rows(*, repeats: int, small: bool) -> Iterator[Row]:
    """
    Time cards and the mesh from several distances, in turns.

    Parameters
    ----------
    repeats : int
        Rounds that are counted.
    small : bool
        Few leaves, cards and pixels.

    Yields
    ------
    Row
        "Ours" are the cards, the peer is the full mesh of the same leaves; errors are FLIP against
        16 samples of the mesh.
    """
    plant = tl.grow_plant("chestnut", seed=1, leaf_count=200 if small else None)
    counts = (8,) if small else tuple(PAPER_RATIOS)
    size = (96, 72) if small else (1024, 768)
    mesh = tl.FullMesh.build(plant, wood=False)
    subjects: dict[str, tl.FullMesh | tl.LeafClusters] = {"mesh": mesh}
    for count in counts:
        subjects[str(count)] = tl.LeafClusters.build(
            plant, cluster_count=count, wood=False, resolution=64 if small else 512
        )
    low, high = plant.bounds
    middle = (low + high) / 2
    height = float(high[1] - low[1])
    for heights in HEIGHTS[1:2] if small else HEIGHTS:
        eye = middle + np.array([0.0, 0.0, heights * height])
        camera = tl.Camera.perspective(tuple(eye), tuple(middle), size=size)
        reference = tl.render(mesh, camera, samples=16)
        errors = {
            label: tl.metrics.compare(reference, tl.render(subject, camera, samples=4)).flip
            for label, subject in subjects.items()
        }
        for samples in (1, 4):
            millis = tl.time_frames(subjects, camera, samples=samples, repeats=repeats)
            secs = {label: statistics.median(taken) / 1e3 for label, taken in millis.items()}
            for count in counts:
                paper = PAPER_RATIOS.get(count)
                beside = "" if paper is None else f" (paper {paper:.1f} x)"
                yield Row(
                    group="clusters",
                    case=f"{count} cards, {heights} heights away, {samples} samples{beside}",
                    ours_secs=secs[str(count)],
                    peer="full mesh, leaves alone",
                    peer_secs=secs["mesh"],
                    ours_error=errors[str(count)],
                    peer_error=errors["mesh"],
                    error_kind="FLIP at 4 samples",
                )
