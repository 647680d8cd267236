"""Does a grown plant have the stated counts, and does it stay the same?"""

import numpy as np
import pytest

import treelod as tl
from treelod.plants import PRESETS

# leaves, triangles a leaf and wood triangles of the papers' plants
FACTS = {"chestnut": (11_291, 10, 46_174), "broadleaf": (20_376, 2, 47_691)}


def test_every_preset_has_its_facts():
    assert set(PRESETS) == set(FACTS)


@pytest.mark.parametrize("preset", FACTS)
def test_counts_and_place(preset):
    leaf_count, per_leaf, wood_count = FACTS[preset]
    plant = tl.grow_plant(preset, seed=1)
    assert plant.name == preset
    assert plant.foliage.leaf_count == leaf_count
    np.testing.assert_array_equal(np.diff(plant.foliage.leaf_offsets), per_leaf)
    assert len(plant.wood.triangles) == pytest.approx(wood_count, rel=0.01)
    assert [material.name for material in plant.materials] == ["wood", "leaves"]
    assert set(plant.wood.material_ids) == {0}
    assert set(plant.foliage.mesh.material_ids) == {1}
    assert plant.bounds[0, 1] == 0.0, "stands on the ground"
    foot = plant.wood.positions[plant.wood.positions[:, 1] == 0.0]
    np.testing.assert_allclose(foot.mean(0), 0.0, atol=1e-3, err_msg="around the origin")


@pytest.mark.parametrize("preset", FACTS)
def test_leaves_hang_in_a_crown_above_the_ground(preset):
    foliage = tl.grow_plant(preset).foliage
    assert foliage.positions[:, 1].min() > 0.5
    assert foliage.areas.min() > 0.0
    # leaves look up more often than down, and in every direction around
    azimuths = np.arctan2(foliage.normals[:, 0], foliage.normals[:, 2])
    counts, _ = np.histogram(azimuths, bins=8, range=(-np.pi, np.pi))
    assert counts.min() > 0.5 * counts.mean()
    assert (foliage.normals[:, 1] > 0).mean() > 0.8


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


@pytest.mark.parametrize("leaf_count", [1, 7, 30_000])
def test_leaf_count_is_exact(leaf_count):
    plant = tl.grow_plant("broadleaf", leaf_count=np.int64(leaf_count))
    assert plant.foliage.leaf_count == leaf_count
    assert len(plant.wood.triangles) == len(tl.grow_plant("broadleaf").wood.triangles)


def test_lighting_is_used():
    lighting = tl.Lighting(sun=(0.0, 0.0, 0.0), sky=(0.0, 0.0, 0.0), ground=(0.0, 0.0, 0.0))
    plant = tl.grow_plant("broadleaf", leaf_count=10, lighting=lighting)
    assert plant.foliage.mesh.front.max() == 0.0
    assert tl.grow_plant("broadleaf", leaf_count=10).foliage.mesh.front.max() > 0.1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"preset": "oak"}, "preset: .*oak.*chestnut, broadleaf"),
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
