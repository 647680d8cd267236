"""Where copies stand: the foot of a plant is that of its meshes, whatever stands for it."""

import numpy as np
import pytest

import treelod as tl
from made_plants import crown as crown_of
from made_plants import random_crown, random_leaves

SIZES = tl.Variety(size=0.9, hue_deg=0, value=0, mirror=False, seed=4)
"""Copies of many sizes, each grown or shrunk about its foot."""


def foot_of(lod):
    """The place that stays when a copy changes its size, from the box around it: x, y and z."""
    still = np.array(tl.Scene([(lod, None)]).bounds)
    grown = np.array(tl.Scene([(lod, None)], variety=SIZES).bounds)
    scale = SIZES.of(0, 0).scale
    assert abs(scale - 1) > 0.2, "it changes"
    feet = (grown - scale * still) / (1 - scale)
    np.testing.assert_allclose(feet[0], feet[1], atol=1e-9, err_msg="both corners tell the same")
    return feet[0]


def tall_crown():
    """A crown on a trunk, all of it off the axis."""
    leaves, colors = random_leaves(80)
    return crown_of(leaves, colors, trunk=True, origin=(0.5, 0.0, -2.0))


MAKERS = {
    "billboard": lambda p: tl.Billboard.build(p, resolution=32, samples=1),
    "leaf_clusters": lambda p: tl.LeafClusters.build(p, cluster_count=6, resolution=(16, 16)),
    "slicings": lambda p: tl.Slicings.build(p, resolution=32, samples=1),
    "orthogonal_slices": lambda p: tl.OrthogonalSlices.build(p, resolution=32, samples=1),
    "simplified_mesh": lambda p: tl.SimplifiedMesh.build(p, triangle_count=10**9),
    "layers": lambda p: tl.LayeredBillboards.build(p, resolution=32, samples=1),
    "layers on a mesh": lambda p: tl.LayeredBillboards.build(p, resolution=32, wood_as="mesh"),
    "layers that turn": lambda p: tl.LayeredBillboards.build(p, resolution=32, turn="viewer"),
    "pruning": tl.StochasticPruning.build,
    "pruning, few leaves": lambda p: tl.StochasticPruning.build(p).at(kept_share=0.02),
    "octahedral impostor": lambda p: tl.OctahedralImpostor.build(p, frame_count=4, resolution=16),
    "points and lines": tl.PointsAndLines.build,
    "points and lines, few points": lambda p: tl.PointsAndLines.build(p, sample_distance_px=64),
    "hierarchy": tl.FoliageHierarchy.build,
    "hierarchy, few leaves": lambda p: coarsest(tl.FoliageHierarchy.build(p)),
}


def coarsest(lod):
    """As few quads as a hierarchy has."""
    return lod.at(leaf_count=lod.root_count)


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("plant", [tall_crown, random_crown])
def test_every_technique_stands_where_the_full_mesh_does(name, plant):
    plant = plant()
    expected = foot_of(tl.FullMesh.build(plant))
    low, high = plant.bounds
    middle = (np.array(low) + high) / 2
    np.testing.assert_allclose(expected, [middle[0], low[1], middle[2]], atol=1e-6)
    np.testing.assert_allclose(foot_of(MAKERS[name](plant)), expected, atol=1e-6)


def test_some_techniques_draw_below_the_foot():
    # the control: without a foot of their own these would stand elsewhere
    plant = random_crown()
    ground = plant.bounds[0][1]
    for name in (
        "layers that turn",
        "pruning, few leaves",
        "hierarchy, few leaves",
        "octahedral impostor",
    ):
        low, _ = tl.Scene([(MAKERS[name](plant), None)]).bounds
        assert low[1] < ground - 0.05, name


def test_the_box_holds_what_is_sheared_below_the_foot():
    lod = MAKERS["pruning, few leaves"](random_crown())
    wind = tl.Wind(lean=1.0, sway=0.0, azimuth_deg=90)
    still, leaning = (np.array(tl.Scene([(lod, None)], wind=w).bounds) for w in (None, wind))
    foot = foot_of(lod)
    assert leaning[0, 0] <= still[0, 0] - (foot[1] - still[0, 1]) + 1e-9
    assert leaning[1, 0] >= still[1, 0] + (still[1, 1] - foot[1]) - 1e-9
