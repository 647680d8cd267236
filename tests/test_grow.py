"""Does a grown plant have the stated counts, and does it stay the same?"""

import numpy as np
import pytest

import treelod as tl
from treelod.plants import PRESETS

# at seed 1: elements and triangles of the foliage, triangles of the wood, height in metres
FACTS = {
    "chestnut": (11_291, 112_910, 46_163, 15.8),
    "broadleaf": (20_376, 40_752, 47_688, 12.2),
    "grove": (5_782 + 1_349, 11_564 + 8_093, 2_054, 7.7),
    "pine": (80_000, 80_000, 35_932, 6.9),
    "palm": (2_520, 20_160, 3_012, 8.3),
    "sunflower": (581, 1_492, 928, 1.8),
    "daisy": (1_438, 4_772, 3_480, 0.29),
    "grass": (450, 4_050, 0, 0.46),
}
TREES = ("chestnut", "broadleaf", "grove", "pine", "palm")

MATERIALS = {
    **{key: ["wood", "leaves"] for key in TREES},
    **{key: ["stems", "leaves", "flowers"] for key in ("sunflower", "daisy")},
    "grass": ["leaves"],
}


def test_every_preset_has_its_facts():
    assert set(PRESETS) == set(FACTS)


@pytest.mark.parametrize("preset", FACTS)
def test_counts_and_place(preset):
    leaf_count, triangle_count, wood_count, height = FACTS[preset]
    plant = tl.grow_plant(preset, seed=1)
    assert plant.name == preset
    assert plant.foliage.leaf_count == leaf_count
    assert len(plant.foliage.triangles) == triangle_count
    assert len(plant.wood.triangles) == wood_count
    names = [material.name for material in plant.materials]
    assert names == MATERIALS[preset]
    used = set(plant.wood.material_ids) | set(plant.foliage.mesh.material_ids)
    assert used == set(range(len(names))), "every material is used"
    assert 0 not in plant.foliage.mesh.material_ids or wood_count == 0
    assert plant.bounds[0, 1] == 0.0, "stands on the ground"
    assert plant.bounds[1, 1] == pytest.approx(height, rel=0.02)
    feet = np.concatenate([plant.wood.positions, plant.foliage.positions])
    foot = feet[feet[:, 1] == 0.0]
    # a tuft's blades rise from a disc of 6 cm
    np.testing.assert_allclose(foot.mean(0), 0.0, atol=0.01, err_msg="around the origin")


def test_a_grove_is_the_paper_s_tree():
    plant = tl.grow_plant("grove")
    sizes = np.diff(plant.foliage.leaf_offsets)
    assert sizes[sizes == 2].sum() == 11_564, "leaves"
    assert sizes[sizes > 2].sum() == 8_093, "twigs"
    solid = tl.FullMesh.build(plant, wood_triangle_count=200)
    count = solid.footprint.triangles - len(plant.foliage.triangles)
    assert count == 181, "meshoptimizer stops where no step leads to the target"


HERB_AREA = 0.01
"""Share of a herb's leaf area by which 100,000 elements may differ: florets of full size would
multiply it, and with sizes drawn anew it differs by 0.3 %."""


@pytest.mark.parametrize("preset", ["sunflower", "daisy"])
def test_more_florets_are_smaller(preset):
    usual, more = (
        tl.grow_plant(preset, seed=3, leaf_count=count).foliage.areas.sum(dtype=np.float64)
        for count in (None, 100_000)
    )
    assert more == pytest.approx(usual, rel=HERB_AREA)


def test_needles_and_leaflets_are_long():
    for preset in ("pine", "palm"):
        foliage = tl.grow_plant(preset).foliage
        corners = foliage.positions.reshape(foliage.leaf_count, -1, 3).astype(np.float64)
        values = np.linalg.svd(corners - corners.mean(1, keepdims=True), compute_uv=False)
        assert np.median(values[:, 0] / values[:, 1]) > 4, preset


@pytest.mark.parametrize("preset", TREES)
def test_leaves_hang_in_a_crown_above_the_ground(preset):
    foliage = tl.grow_plant(preset).foliage
    assert foliage.positions[:, 1].min() > 0.4
    assert foliage.areas.min() > 0.0
    # leaves look in every direction around, and broad ones up more often than down
    azimuths = np.arctan2(foliage.normals[:, 0], foliage.normals[:, 2])
    counts, _ = np.histogram(azimuths, bins=8, range=(-np.pi, np.pi))
    assert counts.min() > 0.5 * counts.mean()
    if preset != "pine":
        assert (foliage.normals[:, 1] > 0).mean() > 0.8


def test_flowers_have_the_colours_of_their_kind():
    def parts(preset):
        plant = tl.grow_plant(preset)
        mesh = plant.foliage.mesh
        flower = mesh.triangles[mesh.material_ids == 2].ravel()
        return plant, mesh.base[flower, :3]

    plant, colors = parts("sunflower")
    red, green, blue = colors.T
    yellow = (red > 0.6) & (green > 0.3) & (blue < 0.1)
    brown = (red < 0.3) & (green < red) & (blue < green)
    assert yellow.mean() > 0.15
    assert brown.mean() > 0.4
    leaves = plant.foliage.areas[np.diff(plant.foliage.leaf_offsets) == 8]
    assert np.sort(leaves)[-17:].min() > 5 * np.median(leaves), "large leaves"
    _, colors = parts("daisy")
    white = colors.min(axis=1) > 0.6
    yellow = (colors[:, 0] > 0.5) & (colors[:, 2] < 0.1)
    assert white.mean() > 0.4
    assert yellow.mean() > 0.3


def test_grass_bends_over():
    foliage = tl.grow_plant("grass").foliage
    blades = foliage.positions.reshape(foliage.leaf_count, 11, 3)
    # two corners at each of five widths, then the tip
    axis = np.concatenate([blades[:, :10].reshape(-1, 5, 2, 3).mean(2), blades[:, 10:]], axis=1)
    steps = np.diff(axis, axis=1)
    steps /= np.linalg.norm(steps, axis=2, keepdims=True)
    assert (axis[:, 0, 1] == 0.0).all(), "from the ground"
    assert (steps[:, 0, 1] > 0.7).all(), "upright at the foot"
    assert (steps[:, 0, 1] > steps[:, -1, 1]).all(), "less so at the tip"
    assert 0.1 < (steps[:, -1, 1] < 0).mean() < 0.9, "some hang, some do not"


def test_same_arguments_same_plant():
    first, again = (tl.grow_plant("chestnut", seed=7, leaf_count=300) for _ in range(2))
    other = tl.grow_plant("chestnut", seed=8, leaf_count=300)
    for part in ("wood", "foliage"):
        np.testing.assert_array_equal(
            getattr(first, part).positions, getattr(again, part).positions
        )
        assert getattr(first, part).positions[:9].tolist() != (
            getattr(other, part).positions[:9].tolist()
        )


@pytest.mark.parametrize("preset", FACTS)
def test_seeds_differ_in_shape_and_not_in_counts(preset):
    first, again, other = (tl.grow_plant(preset, seed=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.foliage.positions, again.foliage.positions)
    np.testing.assert_array_equal(first.wood.positions, again.wood.positions)
    assert first.foliage.positions.shape == other.foliage.positions.shape
    assert (first.foliage.positions != other.foliage.positions).any(axis=1).mean() > 0.9


# what a plant always has besides leaves, petals that are not florets, and twigs
LEAST = {"grove": 1_350, "sunflower": 82, "daisy": 449}


@pytest.mark.parametrize("leaf_count", [1, 7, 30_000])
@pytest.mark.parametrize("preset", FACTS)
def test_leaf_count_is_exact(preset, leaf_count):
    leaf_count = max(leaf_count, LEAST.get(preset, 1))
    plant = tl.grow_plant(preset, leaf_count=np.int64(leaf_count))
    assert plant.foliage.leaf_count == leaf_count
    np.testing.assert_array_equal(plant.wood.positions, tl.grow_plant(preset).wood.positions)


@pytest.mark.parametrize("preset", LEAST)
def test_what_a_plant_always_has_is_the_least(preset):
    message = rf"leaf_count must be in \[{LEAST[preset]}, 5000000\], got {LEAST[preset] - 1}"
    with pytest.raises(ValueError, match=message):
        tl.grow_plant(preset, leaf_count=LEAST[preset] - 1)


def test_lighting_is_used():
    lighting = tl.Lighting(sun=(0.0, 0.0, 0.0), sky=(0.0, 0.0, 0.0), ground=(0.0, 0.0, 0.0))
    plant = tl.grow_plant("broadleaf", leaf_count=10, lighting=lighting)
    assert plant.foliage.mesh.front.max() == 0.0
    assert tl.grow_plant("broadleaf", leaf_count=10).foliage.mesh.front.max() > 0.1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"preset": "oak"},
            "preset: .*oak.*chestnut, broadleaf, grove, pine, palm, sunflower, daisy, grass",
        ),
        ({"preset": "chestnut", "seed": -1}, "seed must be in"),
        ({"preset": "chestnut", "seed": 2**64}, "seed must be in"),
        ({"preset": "chestnut", "leaf_count": 0}, "leaf_count must be in"),
        ({"preset": "chestnut", "leaf_count": -1}, "leaf_count must be"),
        ({"preset": "chestnut", "leaf_count": 5_000_001}, "leaf_count must be in"),
        ({"preset": "chestnut", "leaf_count": 10**30}, "leaf_count must be"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        tl.grow_plant(**arguments)


def test_largest_seed():
    assert tl.grow_plant("broadleaf", seed=2**64 - 1, leaf_count=1).foliage.leaf_count == 1
