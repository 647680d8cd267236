"""
What is hard for a renderer of plants, each with the result that it must have.

Here is what concerns a whole plant, seen through the package's face. The same list for the bakes is
in the slicings' own tests, for coverage in the soups, for files in `test_attacks`.
"""

import dataclasses
import math

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, quads, random_crown, random_leaves
from treelod.render import EMPTY_ID, OUTPUTS

SIZE = (48, 32)


def small_slicings(plant):
    """As quick to bake as it can be, with several slices and slicings."""
    return tl.Slicings.build(plant, slicing_count=4, slice_count=3, resolution=32, samples=4)


TECHNIQUES = (tl.FullMesh.build, small_slicings)

SAME_SHAPE_PIXELS = 0.01
"""Share of pixels that may differ in pictures of scaled plants: rounding moves an edge across a
sample here and there."""

SAME_COLOR = 1e-6
"""Difference from which a pixel of a scaled or moved plant differs: colours are the same f32
values, and averages of up to 1 round by 6e-8."""

SAME_DEPTH = 2e-6
"""Relative, of f32 depths that are scaled: 4e-7 was found, from rounding in some steps."""

ONE_COLUMN = 1 / SIZE[0]
"""Share of a picture: the near plane cuts a triangle between two columns, whose samples may fall to
either side."""


def pictures(plant, camera):
    return [tl.render(build(plant), camera, outputs=OUTPUTS) for build in TECHNIQUES]


def assert_is_a_picture(frame):
    """No NaN, nothing negative, nothing behind the eye; a pixel has all planes or none."""
    for name in ("color", "normal", "albedo"):
        assert np.isfinite(getattr(frame, name)).all(), name
    assert (frame.color >= 0).all()
    assert (frame.color[..., 3] <= 1 + 1e-6).all()
    assert not np.isnan(frame.depth).any()
    assert (frame.depth >= frame.camera.near * (1 - 1e-6)).all()
    empty = frame.color[..., 3] == 0
    assert (frame.ids[empty] == EMPTY_ID).all()
    assert np.isinf(frame.depth[empty]).all()


# --- leaves --------------------------------------------------------------------------------------

LINE = [((0, y, 0), (0.1, 0, 0), (0, 0.2, 0)) for y in (-1.0, -0.5, 0.0, 0.5, 1.0)]
CROWNS = {
    # name: leaves, areas, whether anything of it is seen from +z
    "one leaf": ([facing(0.3, 0.1, 0.2, 0.5)], [1.0], True),
    "two equal leaves": ([facing(0.3, 0.1, 0.2, 0.5)] * 2, [1.0, 1.0], True),
    "a point": ([((1, 1, 1), (0, 0, 0), (0, 0, 0))], [0.0], False),
    "needle": ([((0, 0, 0), (1, 0, 0), (0, 0, 0))], [0.0], False),
    "one of no area": ([facing(0, 0, 0, 0.5), ((1, 0, 0), (0, 0, 0), (0, 1, 0))], [1.0, 0.0], True),
    "coplanar": ([facing(x, 0, 0, 0.25) for x in (-1, 0, 1)], [0.25] * 3, True),
    "edge on": ([((x, 0, 0), (0, 0, 0.25), (0, 0.25, 0)) for x in (-1, 0, 1)], [0.25] * 3, False),
    "on a line": (LINE, [0.08] * 5, True),
}  # fmt: skip


@pytest.mark.parametrize("name", CROWNS)
def test_awkward_leaves_have_their_areas_and_a_picture(name):
    leaves, areas, is_seen = CROWNS[name]
    plant = crown(leaves)
    np.testing.assert_allclose(plant.foliage.areas, areas, rtol=1e-6)
    # a leaf without area has a place, but faces nowhere
    np.testing.assert_allclose(plant.foliage.centers, [leaf[0] for leaf in leaves], atol=1e-6)
    lengths = np.linalg.norm(plant.foliage.normals, axis=1)
    np.testing.assert_allclose(lengths, np.array(areas) > 0, atol=1e-6)
    camera = tl.Camera.orthographic((0, 0, 9), (0, 0, 0), height=4, size=SIZE)
    full, sliced = pictures(plant, camera)
    for frame in (full, sliced):
        assert_is_a_picture(frame)
        assert frame.color.any() == is_seen
    for camera in (
        tl.Camera.perspective((3, 2, 4), (0, 0, 0), size=SIZE),
        tl.Camera.perspective((0, 5, 0), (0, 0, 0), size=SIZE),
    ):
        for frame in pictures(plant, camera):
            assert_is_a_picture(frame)


def test_two_equal_leaves_look_like_one():
    camera = tl.Camera.perspective((1, 0.5, 3), (0, 0, 0), size=SIZE)
    one, two = (
        tl.render(tl.FullMesh.build(crown([facing(0, 0, 0, 1)] * count)), camera, outputs=OUTPUTS)
        for count in (1, 2)
    )
    for name in OUTPUTS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), name)


def test_normals_of_opposite_sign_are_kept_apart():
    # the same square wound both ways: each shows the side that is turned to the viewer
    forth = facing(-1, 0, 0, 0.5)
    back = ((1, 0, 0), (-0.5, 0, 0), (0, 0.5, 0))
    plant = crown([forth, back])
    np.testing.assert_allclose(plant.foliage.normals, [[0, 0, 1], [0, 0, -1]], atol=1e-6)
    camera = tl.Camera.orthographic((0, 0, 9), (0, 0, 0), height=4, size=(64, 32))
    frame = tl.render(tl.FullMesh.build(plant), camera, samples=1, outputs=OUTPUTS)
    np.testing.assert_allclose(frame.normal[frame.ids != EMPTY_ID][:, 2], 1, atol=1e-6)
    # the light on +z falls on the front of one and on the back of the other
    front, back = plant.foliage.mesh.front[0], plant.foliage.mesh.back[4]
    np.testing.assert_allclose(front, back, atol=1e-6)
    np.testing.assert_allclose(frame.color[16, 24, :3], front, atol=1e-6)
    np.testing.assert_allclose(frame.color[16, 40, :3], front, atol=1e-6)


# --- size and place ------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_a_tiny_and_a_huge_plant_look_alike(scale):
    def picture(scale):
        leaves, colors = random_leaves(60)
        scaled = [tuple(np.multiply(part, scale) for part in leaf) for leaf in leaves]
        camera = tl.Camera.perspective(np.array([2, 1, 5]) * scale, (0, 0, 0), size=SIZE)
        return tl.render(tl.FullMesh.build(crown(scaled, colors)), camera, outputs=OUTPUTS)

    scaled, plain = picture(scale), picture(1.0)
    assert_is_a_picture(scaled)
    differs = np.abs(scaled.color - plain.color).max(axis=2) > SAME_COLOR
    assert differs.mean() < SAME_SHAPE_PIXELS
    both = (scaled.ids == plain.ids) & (plain.ids != EMPTY_ID)
    np.testing.assert_allclose(scaled.depth[both] / scale, plain.depth[both], rtol=SAME_DEPTH)


@pytest.mark.parametrize("place", [(1e6, -3e5, 2.7e6), (1e9, 0, 1e9)])
def test_a_plant_far_from_the_origin_keeps_its_shape(place):
    # places that no float has exactly; at 1e9 m a double still tells tenths of a micrometre apart
    mesh, offsets = quads(*random_leaves(60))
    near = tl.Plant.from_arrays(foliage=mesh, leaf_offsets=offsets)
    far = tl.Plant.from_arrays(foliage=mesh, leaf_offsets=offsets, origin=place)
    for build in TECHNIQUES:
        frames = [
            tl.render(
                build(plant),
                tl.Camera.perspective(np.add(at, (2, 1, 5)), at, size=SIZE),
                outputs=OUTPUTS,
            )
            for plant, at in ((near, (0, 0, 0)), (far, place))
        ]
        assert_is_a_picture(frames[1])
        differs = np.abs(frames[0].color - frames[1].color).max(axis=2) > SAME_COLOR
        assert differs.mean() < SAME_SHAPE_PIXELS


# --- views ---------------------------------------------------------------------------------------


def test_straight_down_z_points_down_in_the_picture():
    # up is parallel to the view: -z takes its place
    plant = crown([((0, 0, 1), (0.4, 0, 0), (0, 0, 0.4))])
    for camera in (
        tl.Camera.perspective((0, 5, 0), (0, 0, 0), size=(33, 33)),
        tl.Camera.orthographic((0, 5, 0), (0, 0, 0), height=4, size=(33, 33)),
    ):
        frame = tl.render(tl.FullMesh.build(plant), camera, outputs=OUTPUTS)
        assert_is_a_picture(frame)
        rows, columns = np.nonzero(frame.color[..., 3])
        assert len(rows) > 4
        assert rows.min() > 16, "z = 1 lies below the middle"
        assert columns.min() + columns.max() == 32, "x = 0 lies in the middle"


def test_an_eye_inside_the_crown_sees_what_lies_ahead():
    # one square before the eye, one behind it, one around it
    plant = crown(
        [facing(0, 0, -2, 1), facing(0, 0, 2, 1), ((0, 0, 0), (0.5, 0, 0), (0, 0, 3))],
        [(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)],
    )
    camera = tl.Camera.perspective((0, 0.5, 0), (0, 0.5, -1), fov_y_deg=90, size=(32, 32))
    frame = tl.render(tl.FullMesh.build(plant), camera, samples=1, outputs=OUTPUTS)
    assert_is_a_picture(frame)
    ids = frame.ids // 2
    # 2 m ahead a pixel is 1/8 m: the first reaches from y = -1 to 1, 0.5 m above the eye
    assert frame.depth[15, 16] == pytest.approx(2)
    assert set(np.unique(ids[12:16, 8:24])) == {0}
    assert (frame.ids[:12] == EMPTY_ID).all()
    # the third runs through the near plane below the eye, down to the picture's lower edge
    middle = ids[17:, 16]
    assert (middle == 2).sum() >= 12
    assert middle[-1] == 2
    # the ray of row r meets y = 0 at depth 0.5 / slope
    slope = (31 + 0.5 - 16) / 16
    assert frame.depth[31, 16] == pytest.approx(0.5 / slope, rel=1e-5)
    assert not (ids == 1).any(), "what lies behind is not seen"


@pytest.mark.parametrize("build", TECHNIQUES)
def test_any_eye_inside_a_crown_gives_a_picture(build):
    lod = build(random_crown(80))
    for eye in ((0, 0, 0), (0.1, 0.05, -0.2), (0, 0, 0.6), (1e-9, 0, 0)):
        for way in ((0, 0, -1), (1, 0, 0), (0, -1, 0), (1, 1, 1)):
            camera = tl.Camera.perspective(eye, np.add(eye, way), size=(24, 24))
            assert_is_a_picture(tl.render(lod, camera, samples=1, outputs=OUTPUTS))


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_triangles_behind_through_and_on_the_near_plane(kind):
    def seen(*depths, near=1.0):
        """Share of the picture that a triangle covers with its corners at these depths."""
        corners = np.array([(-50, -50, 0), (50, -50, 0), (0, 99, 0)], float)
        corners[:, 2] = -np.array(depths)
        foliage = {"positions": corners, "triangles": [[0, 1, 2]]}
        plant = tl.Plant.from_arrays(foliage=foliage, leaf_offsets=[0, 1])
        eye, target = (0, 0, 0), (0, 0, -1)
        camera = tl.Camera.perspective(eye, target, fov_y_deg=90, size=SIZE, near=near)
        if kind == "orthographic":
            camera = tl.Camera.orthographic(eye, target, height=2, size=SIZE, near=near)
        frame = tl.render(tl.FullMesh.build(plant), camera, samples=4, outputs=OUTPUTS)
        assert_is_a_picture(frame)
        return frame.color[..., 3].mean()

    assert seen(2, 2, 2) == 1, "before the near plane"
    assert seen(1, 1, 1) == 1, "on it"
    assert seen(1 - 1e-6, 1 - 1e-6, 1 - 1e-6) == 0, "just behind it"
    assert seen(0.5, 0.5, 0.5) == 0, "between it and the eye"
    assert seen(0, 0, 0) == 0, "through the eye"
    assert seen(-3, -3, -3) == 0, "behind the eye"
    # depth rises with x from -1 to 3, and is 1 in the middle
    assert seen(-1, 3, 1) == pytest.approx(0.5, abs=ONE_COLUMN)
    assert seen(3, -1, 1) == pytest.approx(0.5, abs=ONE_COLUMN), "and mirrored"
    assert seen(-1, 3, 1, near=1e-9) > seen(-1, 3, 1, near=1), "a nearer plane cuts off less"


def test_ground_through_the_near_plane_has_its_depth():
    # from below and behind the eye to far away: the depth of each row is that of its ray
    ground = {
        "positions": [[-60, -1, 40], [60, -1, 40], [0, -1, -1e4]],
        "triangles": [[0, 1, 2]],
    }
    plant = tl.Plant.from_arrays(foliage=ground, leaf_offsets=[0, 1])
    camera = tl.Camera.perspective((0, 0, 0), (0, 0, -1), fov_y_deg=90, size=(32, 32), near=0.01)
    frame = tl.render(tl.FullMesh.build(plant), camera, samples=1)
    below = (np.arange(16, 32) + 0.5 - 16) / 16
    np.testing.assert_allclose(frame.depth[16:, 16], 1 / below, rtol=1e-5)
    assert np.isinf(frame.depth[:16]).all(), "nothing above the horizon"


def test_exact_ties_go_to_the_earlier():
    # wood before leaves, then in order; from both sides, at any sample count
    square = facing(0, 0, 0, 1)
    leaves, offsets = quads([square, square, square], [(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1)])
    wood, _ = quads([square], [(0.5, 0.5, 0.5, 1)])
    for parts in ({"wood": wood}, {}):
        plant = tl.Plant.from_arrays(**parts, foliage=leaves, leaf_offsets=offsets)
        for z in (-5, 5):
            camera = tl.Camera.perspective((0.3, 0.2, z), (0, 0, 0), size=SIZE)
            for samples in (1, 4, 16, 21):
                frame = tl.render(
                    tl.FullMesh.build(plant), camera, samples=samples, outputs=OUTPUTS
                )
                seen = set(np.unique(frame.ids[frame.ids != EMPTY_ID]).tolist())
                assert seen == {0, 1}, "both triangles of the first square, and no other"
                top = (plant.wood if parts else plant.foliage.mesh).base[0, :3]
                solid = frame.albedo[frame.color[..., 3] == 1]
                np.testing.assert_allclose(solid[:, :3], [top] * len(solid), atol=1e-6)


def test_cards_that_cross_at_one_centre():
    # painted in order of their slicings at any angle, and the same again
    plant = random_crown(60)
    lod = tl.Slicings.build(plant, slicing_count=8, slice_count=1, resolution=32)
    for azimuth in (0, 11.25, 22.5, 33.75, 45):
        angle = math.radians(azimuth)
        eye = (3 * math.sin(angle), 0, 3 * math.cos(angle))
        camera = tl.Camera.perspective(eye, (0, 0, 0), size=SIZE)
        first, again = (tl.render(lod, camera, outputs=OUTPUTS) for _ in range(2))
        assert_is_a_picture(first)
        assert first.color.any()
        for name in OUTPUTS:
            assert getattr(first, name).tobytes() == getattr(again, name).tobytes()


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (1, 200)])
@pytest.mark.parametrize("samples", [1, 4, 16, 21, 64])
def test_pictures_of_one_pixel_across(size, samples):
    plant = random_crown(40)
    camera = tl.Camera.perspective((0, 0, 6), (0, 0, 0), size=size)
    for build in TECHNIQUES:
        frame = tl.render(build(plant), camera, samples=samples, outputs=OUTPUTS)
        assert frame.color.shape == (size[1], size[0], 4)
        assert_is_a_picture(frame)
    # the one pixel of a view that a square fills is that square
    filled = tl.Camera.orthographic((0, 0, 6), (0, 0, 0), height=1, size=(1, 1))
    frame = tl.render(tl.FullMesh.build(crown([facing(0, 0, 0, 2)])), filled, samples=samples)
    assert frame.color[0, 0, 3] == pytest.approx(1, abs=1e-6)
    assert frame.depth[0, 0] == 6


# --- arrays that are wrong -----------------------------------------------------------------------

ARRAYS = {
    "positions": ((4, 3), 0.5),
    "normals": ((4, 3), 0.5),
    "uvs": ((4, 2), 0.5),
    "colors": ((4, 4), 0.5),
}


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e39])
@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("part", ["wood", "foliage"])
@pytest.mark.filterwarnings("ignore:overflow encountered in cast:RuntimeWarning")
def test_what_is_not_finite_is_refused_by_name(part, name, value):
    shape, fill = ARRAYS[name]
    mesh, offsets = quads([facing(0, 0, 0, 1)])
    array = np.full(shape, fill) if name != "positions" else np.array(mesh["positions"])
    array[2, 1] = value
    arguments = {part: mesh | {name: array}}
    if part == "foliage":
        arguments["leaf_offsets"] = offsets
    with pytest.raises(ValueError, match=rf"{name}.*finite"):
        tl.Plant.from_arrays(**arguments)


@pytest.mark.parametrize("index", [4, 2**31, 2**32 - 1, 2**32, -1])
@pytest.mark.parametrize("part", ["wood", "foliage"])
def test_indices_out_of_range_are_refused_by_name(part, index):
    mesh, offsets = quads([facing(0, 0, 0, 1)])
    triangles = np.array(mesh["triangles"], np.int64)
    triangles[1, 2] = index
    arguments = {part: mesh | {"triangles": triangles}}
    if part == "foliage":
        arguments["leaf_offsets"] = offsets
    with pytest.raises(ValueError, match="triangles"):
        tl.Plant.from_arrays(**arguments)
    with pytest.raises(ValueError, match="leaf_offsets"):
        tl.Plant.from_arrays(foliage=mesh, leaf_offsets=[0, 1, index])


@pytest.mark.parametrize("field", ["eye", "target", "up", "fov_y_deg", "near"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_cameras_that_are_not_finite_are_refused_by_name(field, value):
    camera = tl.Camera.perspective((0, 0, 5), (0, 0, 0), size=SIZE)
    bad = (0.0, value, 0.0) if field in ("eye", "target", "up") else value
    with pytest.raises(ValueError, match=field):
        dataclasses.replace(camera, **{field: bad})


def test_a_plant_of_wood_alone_or_of_leaves_alone_is_drawn():
    mesh, offsets = quads([facing(0, 0, 0, 1)])
    camera = tl.Camera.orthographic((0, 0, 5), (0, 0, 0), height=4, size=(16, 16))
    bare = tl.Plant.from_arrays(wood=mesh)
    leafy = tl.Plant.from_arrays(foliage=mesh, leaf_offsets=offsets)
    assert (bare.foliage.leaf_count, len(leafy.wood.triangles)) == (0, 0)
    for plant in (bare, leafy):
        frame = tl.render(tl.FullMesh.build(plant), camera)
        assert frame.color[..., 3].sum() == 64
        assert plant.triangle_count == 2
