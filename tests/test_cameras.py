"""Do cameras send points where a drawing on paper says they go, and refuse what has no meaning?"""

from types import SimpleNamespace

import numpy as np
import pytest

from treelod.cameras import Camera, default_cameras, orbit

PLANT = SimpleNamespace(sphere=((1.0, 2.0, 3.0), 2.0))


def test_defaults_are_the_documented_ones():
    camera = Camera.perspective((0, 0, 10), (0, 0, 0))
    assert camera.fov_y_deg == 45.0
    assert camera.height is None
    assert camera.size == (1024, 768)
    assert camera.up == (0.0, 1.0, 0.0)
    assert camera.near == 0.01  # 1e-3 of 10 m
    assert camera.is_perspective


def test_perspective_projection_by_hand():
    # 90 degrees over 100 rows: at depth 2 the view is 4 m high, so 25 pixels a metre
    camera = Camera.perspective((0, 0, 2), (0, 0, 0), fov_y_deg=90, size=(200, 100))
    points = [[0, 0, 0], [1, 1, 0], [-1, 0, 1], [0, -2, -2]]
    expected = [
        [100, 50, 2],  # the target is the middle
        [125, 25, 2],  # right and up
        [50, 50, 1],  # nearer: 50 pixels a metre
        [100, 75, 4],  # further: 12.5 pixels a metre, down
    ]
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-12)
    assert camera.pixels_per_metre(4.0) == pytest.approx(12.5)


def test_orthographic_projection_by_hand():
    # 4 m over 100 rows: 25 pixels a metre at any depth, in front and behind
    camera = Camera.orthographic((5, 0, 0), (0, 0, 0), height=4, size=(200, 100))
    points = [[0, 0, 0], [0, 1, -1], [-20, 1, -1], [7, 0, 0]]
    expected = [[100, 50, 5], [125, 25, 5], [125, 25, 25], [100, 50, -2]]
    np.testing.assert_allclose(camera.project(points), expected, atol=1e-12)


def test_points_behind_the_eye_have_no_pixel():
    camera = Camera.perspective((0, 0, 2), (0, 0, 0))
    projected = camera.project([[0, 0, 3], [0, 0, 2]])
    assert np.isnan(projected[:, :2]).all()
    np.testing.assert_allclose(projected[:, 2], [-1, 0])


@pytest.mark.parametrize(
    ("eye", "right", "up", "back"),
    [
        ((0, 0, 9), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((9, 0, 0), (0, 0, -1), (0, 1, 0), (1, 0, 0)),
        ((0, 9, 0), (1, 0, 0), (0, 0, -1), (0, 1, 0)),  # straight down: -z is up
        ((0, -9, 0), (-1, 0, 0), (0, 0, -1), (0, -1, 0)),  # straight up: -z is up
    ],
)
def test_view_axes(eye, right, up, back):
    rotation = Camera.perspective(eye, (0, 0, 0)).view_rotation()
    np.testing.assert_allclose(rotation, [right, up, back], atol=1e-15)


def test_up_along_z_has_a_fallback_too():
    # -z, the usual replacement, is parallel to this view as well
    rotation = Camera.perspective((0, 0, 3), (0, 0, 0), up=(0, 0, 1)).view_rotation()
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-15)


@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e150])
def test_view_axes_are_orthonormal_at_any_scale(scale):
    eye = np.array([0.3, 0.7, -0.2]) * scale
    rotation = Camera.perspective(eye, (0, 0, 0), up=(0, scale, 0)).view_rotation()
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_orbit_starts_at_z_and_goes_counter_clockwise_from_above():
    cameras = orbit(PLANT, count=4, distance=3.0, size=(64, 48), fov_y_deg=30)
    eyes = np.array([camera.eye for camera in cameras])
    # 3 radii of 2 m around (1, 2, 3)
    expected = [[1, 2, 9], [7, 2, 3], [1, 2, -3], [-5, 2, 3]]
    np.testing.assert_allclose(eyes, expected, atol=1e-12)
    assert all(camera.target == (1.0, 2.0, 3.0) for camera in cameras)
    assert {(camera.size, camera.fov_y_deg) for camera in cameras} == {((64, 48), 30.0)}


def test_orbit_elevation():
    (eye,) = (camera.eye for camera in orbit(PLANT, count=1, elevation_deg=30, distance=1.0))
    np.testing.assert_allclose(eye, [1, 2 + 1, 3 + np.sqrt(3)], atol=1e-12)
    (above,) = orbit(PLANT, count=1, elevation_deg=90)
    np.testing.assert_allclose(above.view_rotation()[1], [0, 0, -1], atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"eye": (0, 0, 0)}, "eye and target must differ"),
        ({"eye": (0, 0, np.nan)}, "eye must be 3 finite numbers"),
        ({"target": (0, np.inf, 0)}, "target must be 3 finite numbers"),
        ({"eye": (0, 1)}, "eye must be 3 finite numbers"),
        ({"up": (0, 0, 0)}, "up must not be the zero vector"),
        ({"fov_y_deg": 0.0}, "fov_y_deg must be"),
        ({"fov_y_deg": 180.0}, r"fov_y_deg must be in \(0, 180\)"),
        ({"fov_y_deg": np.nan}, "fov_y_deg must be"),
        ({"size": (0, 10)}, "size must be 1 to 16384"),
        ({"size": (16385, 10)}, "size must be 1 to 16384"),
        ({"size": (10.5, 10)}, "size must be .* whole pixels"),
        ({"size": 7}, "size must be .* whole pixels"),
        ({"near": 0.0}, "near must be"),
        ({"near": np.inf}, "near must be"),
    ],
)
def test_refuses(change, message):
    good = {"eye": (0, 0, 5), "target": (0, 0, 0), "fov_y_deg": 45, "size": (4, 4)}
    Camera.perspective(**good)
    with pytest.raises(ValueError, match=message):
        Camera.perspective(**(good | change))


def test_refuses_heights_and_both_kinds_at_once():
    with pytest.raises(ValueError, match="height must be"):
        Camera.orthographic((0, 0, 5), (0, 0, 0), height=-1, size=(4, 4))
    fields = {"eye": (0, 0, 5), "target": (0, 0, 0), "up": (0, 1, 0), "size": (4, 4), "near": 1}
    with pytest.raises(ValueError, match="exactly one of"):
        Camera(**fields, fov_y_deg=45, height=2)
    with pytest.raises(ValueError, match="exactly one of"):
        Camera(**fields, fov_y_deg=None, height=None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"count": 0}, "count must be at least 1"),
        ({"elevation_deg": 91}, "elevation_deg must be"),
        ({"elevation_deg": np.nan}, "elevation_deg must be"),
        ({"distance": 0}, "distance must be"),
    ],
)
def test_orbit_refuses(change, message):
    with pytest.raises(ValueError, match=message):
        orbit(PLANT, **change)
    with pytest.raises(ValueError, match="bounding sphere of radius"):
        orbit(SimpleNamespace(sphere=((0, 0, 0), 0.0)))


def test_default_cameras_are_the_stated_circles():
    assert len(default_cameras(PLANT)) == 8 * 2 * 3
    cameras = default_cameras(
        PLANT, azimuth_count=2, elevations_deg=(0, 90), distances=(1, 3), size=(8, 6)
    )
    # 1 and 3 radii of 2 m around (1, 2, 3), by distance, elevation, azimuth
    expected = [
        ([1, 2, 5], [1, 2, 1], [1, 4, 3], [1, 4, 3]),
        ([1, 2, 9], [1, 2, -3], [1, 8, 3], [1, 8, 3]),
    ]
    np.testing.assert_allclose(
        np.array([camera.eye for camera in cameras]).reshape(2, 4, 3), expected, atol=1e-12
    )
    assert {camera.size for camera in cameras} == {(8, 6)}
    for nothing in ({"distances": ()}, {"elevations_deg": ()}):
        with pytest.raises(ValueError, match="at least one number"):
            default_cameras(PLANT, **nothing)


def test_project_refuses_wrong_shapes():
    camera = Camera.perspective((0, 0, 2), (0, 0, 0))
    with pytest.raises(ValueError, match=r"shape \(N, 3\), got \(3,\)"):
        camera.project([0, 0, 0])
