"""The smallest rectangle around each leaf, as Python reads it."""

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, random_crown


def test_a_rectangle_is_its_own_smallest_rectangle():
    # 3 x 2, facing +z; the first side is a longer one and the corners are as quads() lists them
    plant = crown([((5, 6, 7), (1.5, 0, 0), (0, 1, 0))], origin=(1e6, 0, 0))
    rectangles = plant.foliage.rectangles
    assert rectangles.dtype == np.float64
    expected = [[[3.5, 5, 7], [6.5, 5, 7], [6.5, 7, 7], [3.5, 7, 7]]]
    np.testing.assert_array_equal(rectangles, expected, "relative to the origin")
    assert rectangles is plant.foliage.rectangles, "made once"
    assert not rectangles.flags.writeable


def test_rectangles_of_rectangles_have_their_areas_normals_and_centres():
    plant = random_crown(300)
    foliage = plant.foliage
    rectangles = foliage.rectangles
    assert rectangles.shape == (300, 4, 3)
    first, second = rectangles[:, 1] - rectangles[:, 0], rectangles[:, 3] - rectangles[:, 0]
    lengths = np.linalg.norm([first, second], axis=2)
    assert (lengths[0] >= lengths[1]).all()
    # positions are f32: 1e-7 of a crown 2 wide, on leaves of 0.2
    around = np.cross(first, second)
    np.testing.assert_allclose(around / foliage.areas[:, np.newaxis], foliage.normals, atol=1e-5)
    np.testing.assert_allclose(rectangles.mean(axis=1), foliage.centers, atol=1e-6)


def test_a_leaf_of_several_triangles_has_one_rectangle():
    # an L of three unit squares as two leaves: alone its box is 2 x 2, the foot alone 2 x 1
    corners = [[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [1, 1, 0], [1, 2, 0], [0, 2, 0]]
    triangles = [[0, 1, 2], [0, 2, 3], [3, 4, 5], [3, 5, 6]]
    for offsets, areas in (([0, 4], [4.0]), ([0, 2, 4], [2.0, 1.0])):
        foliage = {"positions": corners, "triangles": triangles}
        plant = tl.Plant.from_arrays(foliage=foliage, leaf_offsets=offsets)
        sides = np.diff(plant.foliage.rectangles[:, :3], axis=1)
        got = np.linalg.norm(sides, axis=2).prod(axis=1)
        np.testing.assert_allclose(got, areas, rtol=1e-12)


def test_plants_without_leaves_have_no_rectangles():
    wood = {"positions": np.eye(3), "triangles": [[0, 1, 2]]}
    assert tl.Plant.from_arrays(wood=wood).foliage.rectangles.shape == (0, 4, 3)


def test_points_have_four_equal_corners():
    plant = crown([facing(1, 2, 3, 0.0)])
    np.testing.assert_array_equal(plant.foliage.rectangles, [[[1, 2, 3]] * 4])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_never_gets_there(value):
    with pytest.raises(ValueError, match="positions must be finite"):
        crown([facing(value, 0, 0, 1.0)])
