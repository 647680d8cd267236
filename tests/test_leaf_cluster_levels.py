"""How leaf clusters go from one level to the next: how much each step shows, and what pops."""

import itertools

import pytest

import treelod as tl
from treelod.testing import assert_frame_close

STEP_FLIP = 0.01
"""
Largest FLIP error of a hundredth of the way between two levels, on the chestnut from 4 radii:
measured are 0.003 while cards move and 0.006 while the next level is faded in.
"""

SWAP_FLIP = 0.03
"""The same where cards have moved all the way and are exchanged, without a fade: measured 0.02."""


@pytest.fixture(scope="module")
def chestnut(treelod_plant):
    return treelod_plant("chestnut", leaf_count=2000)


@pytest.fixture(scope="module")
def near(chestnut):
    return tl.orbit(chestnut, count=5, distance=4, size=(128, 96))[1]


def levels(chestnut, **transition):
    return tl.LeafClusters.build(chestnut, cluster_count=(32, 16), resolution=128, **transition)


def test_no_step_to_the_next_level_is_seen(chestnut, near):
    lod = levels(chestnut)
    stages = [lod.at(level=0, t=step / 100) for step in range(101)] + [lod.at(level=1)]
    frames = [tl.render(stage, near, samples=16, outputs=("color",)) for stage in stages]
    steps = [assert_frame_close(b, a, flip=STEP_FLIP).flip for a, b in itertools.pairwise(frames)]
    assert steps[-1] == 0.0, "faded in already"
    assert min(steps[:-1]) > 0.0, "something moves at each step"
    # the steps lead somewhere, and are no jumps in disguise
    whole = tl.metrics.compare(frames[0], frames[-1]).flip
    assert whole > 3 * max(steps)
    tenth = [lod.at(level=0, t=t) for t in (0.5, 0.501)]
    assert tl.metrics.popping(*tenth, near, samples=16).flip < 0.5 * max(steps[:90])


def test_what_still_pops_at_a_swap(chestnut, near):
    def swap(**transition):
        lod = levels(chestnut, **transition)
        return tl.metrics.popping(lod.at(level=0, t=1.0), lod.at(level=1), near, samples=16).flip

    moved = swap(morph=True, fade_share=0.0)
    assert STEP_FLIP < moved <= SWAP_FLIP
    assert moved < 0.9 * swap(morph=False, fade_share=0.0), "cards that stay pop more"
    assert swap(morph=True, fade_share=0.1) == 0.0
    assert swap(morph=False, fade_share=0.1) == 0.0
