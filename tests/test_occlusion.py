"""Does occlusion darken the inside of a crown, and nothing else?"""

import numpy as np
import pytest

import treelod as tl

OVERCAST = {"sun": (0.0, 0.0, 0.0), "sky": (0.5, 0.5, 0.5), "ground": (0.25, 0.25, 0.25)}


@pytest.fixture(scope="module")
def chestnut():
    return tl.grow_plant("chestnut")


def share(plant, lighting, **options):
    """Front colour of each leaf with the lighting, as a share of that without occlusion."""
    dark = plant.lit(lighting, **options).foliage.mesh.front
    bright = plant.lit(tl.Lighting(**{**vars(lighting), "occlusion": 0.0})).foliage.mesh.front
    return (dark / bright).mean(axis=1).reshape(plant.foliage.leaf_count, -1).mean(axis=1)


def test_off_by_default(chestnut):
    assert tl.Lighting().occlusion == 0.0
    assert chestnut.lighting.occlusion == 0.0
    dark = chestnut.lit(tl.Lighting(occlusion=0.5))
    assert dark.lighting == tl.Lighting(occlusion=0.5)
    again = dark.lit(tl.Lighting())
    for part in (lambda plant: plant.wood, lambda plant: plant.foliage.mesh):
        np.testing.assert_array_equal(part(again).front, part(chestnut).front)
        np.testing.assert_array_equal(part(again).back, part(chestnut).back)
        np.testing.assert_array_equal(part(dark).base, part(chestnut).base)
        assert (part(dark).front <= part(chestnut).front).all(), "never brighter"


ROUNDING = 1e-6
"""Colours are f32, and shares of at most 1 are means of their quotients."""

INNER, RIM, TOP = 0.4, 0.9, 0.7
"""Parts of the crown's box, as shares of its half size: the middle, the outermost leaves, and by
height those that see most of the sky."""

DARKEST, BRIGHTEST = 0.4, 0.6
"""Limits of the mean light inside and at the rim, on both sides of one half: the chestnut has 0.26
and 0.71, and a crown that were shaded alike all over would have the same for both."""

CONTRAST = 1.5
"""The top over the inside, at least: BRIGHTEST over DARKEST."""


def test_the_inside_is_darker_than_the_rim(chestnut):
    dimmed = share(chestnut, tl.Lighting(occlusion=1.0, **OVERCAST))
    low, high = chestnut.foliage.centers.min(0), chestnut.foliage.centers.max(0)
    place = (chestnut.foliage.centers - (low + high) / 2) / ((high - low) / 2)
    depth = np.linalg.norm(place, axis=1)
    assert dimmed[depth < INNER].mean() < DARKEST
    assert dimmed[depth > RIM].mean() > BRIGHTEST
    upper = dimmed[(place[:, 1] > TOP)].mean()
    assert upper > CONTRAST * dimmed[depth < INNER].mean()


def test_strength_is_linear_and_the_sun_is_left_alone(chestnut):
    full = share(chestnut, tl.Lighting(occlusion=1.0, **OVERCAST))
    half = share(chestnut, tl.Lighting(occlusion=0.5, **OVERCAST))
    np.testing.assert_allclose(1 - half, (1 - full) / 2, atol=ROUNDING)
    sun_only = {"sky": (0.0, 0.0, 0.0), "ground": (0.0, 0.0, 0.0)}
    plain = chestnut.lit(tl.Lighting(**sun_only)).foliage.mesh.front
    dark = chestnut.lit(tl.Lighting(occlusion=1.0, **sun_only)).foliage.mesh.front
    np.testing.assert_array_equal(dark, plain)


def test_every_way_to_a_plant_takes_it(tmp_path):
    lighting = tl.Lighting(occlusion=0.7)
    grown = tl.grow_plant("grove", lighting=lighting)
    later = tl.grow_plant("grove").lit(lighting)
    np.testing.assert_array_equal(grown.foliage.mesh.front, later.foliage.mesh.front)
    mesh = {"positions": grown.foliage.positions, "triangles": grown.foliage.triangles}
    made = tl.Plant.from_arrays(
        foliage=mesh, leaf_offsets=grown.foliage.leaf_offsets, lighting=lighting
    )
    split = tl.Plant.from_mesh(mesh, lighting=lighting)
    assert made.lighting == split.lighting == lighting
    plain = tl.Plant.from_mesh(mesh)
    assert split.foliage.mesh.front.mean() < plain.foliage.mesh.front.mean()
    assert made.foliage.mesh.front.mean() == pytest.approx(split.foliage.mesh.front.mean())


def test_threads_change_nothing_and_progress_is_told(chestnut):
    seen = []
    lighting = tl.Lighting(occlusion=1.0)
    one = chestnut.lit(lighting, threads=1, progress=lambda done, total: seen.append((done, total)))
    two = chestnut.lit(lighting, threads=3)
    np.testing.assert_array_equal(one.foliage.mesh.front, two.foliage.mesh.front)
    np.testing.assert_array_equal(one.wood.back, two.wood.back)
    assert seen[-1][0] == seen[-1][1] > 0


def test_progress_can_stop_it():
    plant = tl.grow_plant("pine")

    def stop(done, total):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        plant.lit(tl.Lighting(occlusion=1.0), progress=stop)


@pytest.mark.parametrize("occlusion", [-0.01, 1.01, float("nan"), float("inf")])
def test_bad_values_are_named(chestnut, occlusion):
    with pytest.raises(ValueError, match="occlusion must be in"):
        chestnut.lit(tl.Lighting(occlusion=occlusion))
    with pytest.raises(ValueError, match="occlusion must be in"):
        tl.grow_plant("grass", lighting=tl.Lighting(occlusion=occlusion))


def test_bad_threads_are_named(chestnut):
    with pytest.raises(ValueError, match="threads must be in"):
        chestnut.lit(tl.Lighting(occlusion=1.0), threads=0)
