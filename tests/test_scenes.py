"""Placed copies: what a scene holds, and that transforms do to pictures what they say."""

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, random_crown

SIZE = (40, 40)
CAMERA = tl.Camera.perspective((0, 0, 9), (0, 0, 0), size=SIZE)


@pytest.fixture(scope="module")
def mesh():
    return tl.FullMesh.build(random_crown())


@pytest.fixture(scope="module")
def slicings():
    return tl.Slicings.build(random_crown(), slicing_count=4, slice_count=3, resolution=32)


def moved(x, y, z, scale=(1, 1, 1)):
    matrix = np.diag([*scale, 1.0])
    matrix[:3, 3] = x, y, z
    return matrix


def test_one_copy_where_it_stands_is_the_technique(mesh, slicings):
    for technique in (mesh, slicings):
        alone = tl.render(technique, CAMERA)
        for transforms in (None, np.eye(4), [np.eye(4)]):
            scene = tl.Scene([(technique, transforms)])
            assert scene.instance_count == 1
            np.testing.assert_array_equal(tl.render(scene, CAMERA).color, alone.color)


def test_bounds_hold_all_copies(mesh):
    low, high = random_crown().bounds
    scene = tl.Scene([(mesh, [moved(5, 0, 0), moved(0, -7, 0, (2, -2, 2))]), (mesh, None)])
    assert scene.instance_count == 3
    assert repr(scene) == "Scene(3 copies)"
    doubled = [
        [2 * low[0], -7 - 2 * high[1], 2 * low[2]],
        [2 * high[0], -7 - 2 * low[1], 2 * high[2]],
    ]
    shift = np.array([5, 0, 0])
    boxes = np.array([[low, high], [low + shift, high + shift], doubled])
    np.testing.assert_allclose(scene.bounds, [boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def test_an_empty_scene_is_an_empty_picture(mesh):
    for scene in (tl.Scene([]), tl.Scene([(mesh, np.empty((0, 4, 4)))])):
        assert (scene.instance_count, scene.bounds) == (0, None)
        frame = tl.render(scene, CAMERA)
        assert not frame.color.any()
        assert frame.bounds_px == (0, 0, 0, 0)


def test_moving_the_copy_is_moving_the_camera_back(mesh, slicings):
    shift = np.array([3.0, -2.0, 1.0])
    camera = tl.Camera.perspective(np.array([0, 0, 9]) - shift, -shift, size=SIZE)
    for technique in (mesh, slicings):
        here = tl.render(tl.Scene([(technique, moved(*shift))]), CAMERA)
        there = tl.render(technique, camera)
        np.testing.assert_allclose(here.color, there.color, atol=1e-5)


def test_a_copy_twice_as_large_fills_a_view_twice_as_far(mesh, slicings):
    camera = tl.Camera.perspective((0, 0, 18), (0, 0, 0), size=SIZE)
    for technique in (mesh, slicings):
        large = tl.render(tl.Scene([(technique, moved(0, 0, 0, (2, 2, 2)))]), camera)
        np.testing.assert_array_equal(large.color, tl.render(technique, CAMERA).color)


def test_a_mirrored_copy_is_the_mirrored_picture(mesh):
    # Texels larger than pixels: a mip level would be chosen by the step to the pixel on the right,
    # which is mirrored too.
    slicings = tl.Slicings.build(random_crown(), slicing_count=4, slice_count=3, resolution=4)
    camera = tl.Camera.perspective((5, 0.4, 7.5), (0, 0, 0), size=SIZE)
    opposite = tl.Camera.perspective((-5, 0.4, 7.5), (0, 0, 0), size=SIZE)
    for technique in (mesh, slicings):
        mirror = tl.Scene([(technique, moved(0, 0, 0, (-1, 1, 1)))])
        # one sample in the middle of the pixel, so that the mirrored one lies there too
        mirrored = tl.render(mirror, camera, samples=1).color
        expected = tl.render(technique, opposite, samples=1).color[:, ::-1]
        np.testing.assert_allclose(mirrored, expected, atol=1e-5)
        assert expected.any()


def test_near_crowns_cover_far_ones_in_any_order(slicings):
    near, far = moved(0.2, 0, 3), moved(-0.2, 0, -3)
    pictures = [
        tl.render(tl.Scene(groups), CAMERA, samples=1).color
        for groups in (
            [(slicings, [near, far])],
            [(slicings, [far, near])],
            [(slicings, near), (slicings, far)],
        )
    ]
    for other in pictures[1:]:
        np.testing.assert_array_equal(other, pictures[0])
    # blended by hand: crowns that do not intersect are layers
    front, back = (
        tl.render(tl.Scene([(slicings, at)]), CAMERA, samples=1).color for at in (near, far)
    )
    np.testing.assert_allclose(pictures[0], front + (1 - front[..., 3:]) * back, atol=1e-6)


def test_copies_out_of_view_are_not_submitted(mesh):
    places = [moved(0, 0, 0), moved(100, 0, 0), moved(0, 0, 20), moved(0, -60, -20)]
    frame = tl.render(tl.Scene([(mesh, places)]), CAMERA)
    assert frame.stats.triangles == mesh.footprint.triangles


@pytest.mark.parametrize(
    ("transforms", "message"),
    [
        (np.eye(3), r"shape \(N, 4, 4\)"),
        (np.zeros((2, 2, 4, 4)), r"shape \(N, 4, 4\)"),
        (1.0, r"shape \(N, 4, 4\)"),
        (moved(np.nan, 0, 0), "finite"),
        (moved(0, np.inf, 0), "finite"),
        (moved(0, 0, 1e30), "transforms"),
        (np.zeros((4, 4)), "0 0 0 1"),
        (moved(0, 0, 0, (1, 1, 0)), "flattens"),
        (moved(0, 0, 0, (1, 1, 1)).T + np.diag([0, 0, 0, 1.0]), "0 0 0 1"),
        ("here", "float"),
    ],
)
def test_bad_transforms_are_refused(mesh, transforms, message):
    with pytest.raises(ValueError, match=message):
        tl.Scene([(mesh, transforms)])


def test_only_techniques_are_placed():
    for wrong in (random_crown(3), None, tl.FullMesh):
        with pytest.raises(TypeError, match="built techniques"):
            tl.Scene([(wrong, None)])


def test_wind_moves_the_top_and_not_the_foot():
    # a wall of 2 x 4 m that stands on the ground: pixels of 0.1 m
    lod = tl.FullMesh.build(crown([((0, 2, 0), (1, 0, 0), (0, 2, 0))]))
    camera = tl.Camera.orthographic((0, 2, 9), (0, 2, 0), height=6, size=(60, 60))
    still = tl.render(lod, camera, samples=1).color[..., 3] > 0
    assert (still[10:50].sum(axis=1) == 20).all()
    assert still.sum() == 20 * 40
    blown = tl.Scene([(lod, None)], wind=tl.Wind(lean=0.25, sway=0.0))
    picture = tl.render(blown, camera, samples=1).color[..., 3] > 0
    left = picture[10:50].argmax(axis=1)
    # row 49 is 0.05 m above the foot, row 10 is 3.95 m above it; a pixel is 0.1 m
    heights = 3.95 - 0.1 * np.arange(40)
    np.testing.assert_allclose(left, 20 + 2.5 * heights, atol=0.51)
    assert (picture[10:50].sum(axis=1) == 20).all(), "a shear keeps every width"
    away = tl.Scene([(lod, None)], wind=tl.Wind(lean=0.25, sway=0.0, azimuth_deg=180.0))
    np.testing.assert_array_equal(tl.render(away, camera, samples=1).color[..., 3] > 0, still)


def test_wind_moves_with_the_cameras_time(mesh, slicings):
    for lod in (mesh, slicings):
        scene = tl.Scene([(lod, [moved(-2, 0, 0), moved(2, 0, 0)])], wind=tl.Wind(sway=0.2))
        frames = [tl.render(scene, CAMERA.at(t)).color for t in (0.0, 1.0, 4.0)]
        assert (frames[0] != frames[1]).any()
        np.testing.assert_array_equal(frames[0], frames[2], "a period of 4 seconds")
        other = tl.Scene([(lod, [moved(-2, 0, 0), moved(2, 0, 0)])], wind=tl.Wind(sway=0.2, seed=1))
        assert (tl.render(other, CAMERA).color != frames[0]).any()
        calm = tl.Scene([(lod, [moved(-2, 0, 0), moved(2, 0, 0)])], wind=tl.Wind(sway=0.0))
        still = tl.Scene([(lod, [moved(-2, 0, 0), moved(2, 0, 0)])])
        np.testing.assert_array_equal(
            tl.render(calm, CAMERA.at(1.0)).color, tl.render(still, CAMERA).color
        )


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("sway", -0.1),
        ("sway", np.nan),
        ("lean", 1.1),
        ("period_secs", 0.0),
        ("azimuth_deg", 361.0),
        ("seed", -1),
    ],
)
def test_bad_winds_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        tl.Wind(**{field: value})


def test_something_else_than_a_wind_is_refused(mesh):
    with pytest.raises(TypeError, match="wind must be a Wind"):
        tl.Scene([(mesh, None)], wind=0.1)
    for time_secs in (np.nan, 1e10):
        with pytest.raises(ValueError, match="time_secs"):
            CAMERA.at(time_secs)
