"""Layered billboards through the public face: a tree by hand, twins in NumPy, the full mesh."""

from dataclasses import replace

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, quads, random_crown, random_leaves
from treelod.color import linear_from_srgb

WIND = tl.Wind(sway=0.1, lean=0.05, period_secs=4.0, seed=3)
FRONT = {"right": (1.0, 0.0, 0.0), "up": (0.0, 1.0, 0.0)}


def tube(base, tip, radius):
    """Corners and triangles of a square tube that narrows to half."""
    base, tip = np.array(base, float), np.array(tip, float)
    axis = (tip - base) / np.linalg.norm(tip - base)
    across = np.cross(axis, (0.3, 0.2, 0.9))
    across /= np.linalg.norm(across)
    along = np.cross(axis, across)
    sides = np.array([across, along, -across, -along])
    corners = np.vstack([base + radius * sides, tip + radius / 2 * sides])
    around = [(side, (side + 1) % 4) for side in range(4)]
    triangles = [t for a, b in around for t in ((a, b, b + 4), (a, b + 4, a + 4))]
    return corners, np.array(triangles, np.uint32)


def hand_made_tree():
    """
    A trunk, a limb to the left at 2 m with a twig at its end, a limb to the right at 3 m.

    Leaves: one on top of the trunk, one on the left limb, two on the twig, one on the right limb.
    """
    tubes = [
        tube((0, 0, 0), (0, 5, 0), 0.2),
        tube((0, 2, 0), (-2.6, 2, 0), 0.1),
        tube((0, 3, 0), (2.4, 3, -0.4), 0.1),
        tube((-2, 2, 0), (-2, 3.2, 0), 0.05),
    ]
    first = np.cumsum([0] + [len(corners) for corners, _ in tubes[:-1]])
    wood = {
        "positions": np.vstack([corners for corners, _ in tubes]),
        "triangles": np.vstack([t + at for (_, t), at in zip(tubes, first, strict=True)]),
    }
    leaves = [
        facing(0, 5.2, 0, 0.2),
        facing(-2.8, 2, 0.1, 0.2),
        facing(-2, 3.4, 0.2, 0.2),
        facing(-2.2, 3.3, 0.2, 0.2),
        facing(2.6, 3, -0.4, 0.2),
    ]
    foliage, offsets = quads(leaves)
    return tl.Plant.from_arrays(wood=wood, foliage=foliage, leaf_offsets=offsets)


@pytest.fixture(scope="module")
def tree():
    return hand_made_tree()


@pytest.fixture(scope="module")
def lod(tree):
    return tl.LayeredBillboards.build(tree, resolution=128, samples=4)


def camera_at(azimuth_deg=0.0, size=(64, 64), distance=12.0):
    angle = np.radians(azimuth_deg)
    eye = (distance * np.sin(angle), 2.5, distance * np.cos(angle))
    return tl.Camera.perspective(eye, (0, 2.5, 0), fov_y_deg=40, size=size)


# The hierarchy


def test_connected_wood_is_a_hierarchy(lod):
    assert [layer.name for layer in lod.layers] == ["trunk", "trunk/0", "trunk/0/0", "trunk/1"]
    assert [layer.parent for layer in lod.layers] == [None, 0, 1, 0]
    assert [layer.leaf_count for layer in lod.layers] == [1, 1, 2, 1]
    assert [layer.wood_triangle_count for layer in lod.layers] == [8, 8, 8, 8]
    anchors = [(0, 0, 0), (0, 2, 0), (-2, 2, 0), (0, 3, 0)]
    np.testing.assert_allclose([layer.anchor for layer in lod.layers], anchors, atol=1e-6)
    assert repr(lod.layers[2]) == "BillboardLayer('trunk/0/0', 2 leaves)"
    assert lod.footprint.cards == 4
    assert lod.footprint.triangles == 0
    assert 0 < lod.atlas_fill <= 1


def test_layers_lie_across_the_direction_around_what_they_show(tree):
    for direction in [(0, 0, 1), (1, 0, 1), (0.2, 0.5, -1), (0, 1, 0)]:
        lod = tl.LayeredBillboards.build(
            tree, direction=direction, resolution=64, samples=1, tilt=False
        )
        toward = np.array(direction) / np.linalg.norm(direction)
        for layer in lod.layers:
            across, up = layer.corners[1] - layer.corners[0], layer.corners[3] - layer.corners[0]
            normal = np.cross(across, up)
            np.testing.assert_allclose(normal / np.linalg.norm(normal), toward, atol=1e-9)
            if toward[1] < 0.9:
                assert up[1] > 0
                assert across[1] == pytest.approx(0, abs=1e-9)


def test_every_texel_of_a_layer_is_its_own(lod):
    taken = np.zeros(lod.textures[0].levels[0].shape[:2], int)
    for layer in lod.layers:
        x, y, width, height = layer.texels
        taken[y : y + height, x : x + width] += 1
        across, up = (
            layer.corners[1, 0] - layer.corners[0, 0],
            layer.corners[3, 1] - layer.corners[0, 1],
        )
        assert across / width == pytest.approx(up / height, rel=1e-9)
    assert taken.max() == 1
    alpha = lod.textures[0].levels[0][..., 3]
    assert (alpha[taken == 0] == 0).all()
    assert (alpha[taken == 1] == 255).any()


def test_grown_plants_know_their_branches():
    plant = tl.grow_plant("chestnut", leaf_count=600)
    lod = tl.LayeredBillboards.build(plant, resolution=64, samples=1)
    assert len(lod.layers) == 25
    assert sum(layer.leaf_count for layer in lod.layers) == 600
    assert sum(layer.wood_triangle_count for layer in lod.layers) == len(plant.wood.triangles)
    np.testing.assert_allclose(lod.layers[0].anchor, 0, atol=1e-6)
    names = [layer.name for layer in lod.layers]
    for layer in lod.layers[1:]:
        assert names[layer.parent] == layer.name.rpartition("/")[0]
    # the light changes, the branches stay
    relit = plant.lit(tl.Lighting(sun_direction=(1, 1, 0)))
    assert [
        layer.name for layer in tl.LayeredBillboards.build(relit, resolution=16).layers
    ] == names


# Pictures


def whole_picture(lod, texel):
    """A parallel camera from +z with a pixel for each texel."""
    corners = np.concatenate([layer.corners for layer in lod.layers if layer.corners is not None])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = np.round((high - low)[:2] / texel).astype(int)
    middle = (low + high) / 2
    eye = (middle[0], middle[1], high[2] + 20)
    return tl.Camera.orthographic(
        eye, (middle[0], middle[1], 0), height=float(high[1] - low[1]), size=tuple(map(int, size))
    )


def texel_of(lod):
    layer = next(layer for layer in lod.layers if layer.corners is not None)
    return (layer.corners[1, 0] - layer.corners[0, 0]) / layer.texels[2]


STORED = 0.0046
"""Half a code of 8-bit sRGB in linear light, at most."""


def painted(lod, layers):
    """Paint the texels of some layers one over the other: the picture of `whole_picture`."""
    texel = texel_of(lod)
    corners = np.concatenate([layer.corners for layer in lod.layers if layer.corners is not None])
    (left, _, _), (right, _, _) = corners.min(axis=0), corners.max(axis=0)
    bottom, top = corners[:, 1].min(), corners[:, 1].max()
    shape = round((top - bottom) / texel), round((right - left) / texel)
    picture = np.zeros((*shape, 4))
    level = lod.textures[0].levels[0]
    for layer in layers:
        x, y, width, height = layer.texels
        column = round((layer.corners[0, 0] - left) / texel)
        row = round((top - layer.corners[3, 1]) / texel)
        part = picture[row : row + height, column : column + width]
        tile = level[y : y + height, x : x + width]
        shown = tile[..., 3] == 255
        part[shown, :3] = linear_from_srgb(tile[shown, :3] / 255)
        part[shown, 3] = 1.0
    return picture


@pytest.mark.parametrize("layer_count", [1, 6, 25])
def test_slabs_show_the_plant_from_where_they_were_baked(layer_count):
    leaves, colors = random_leaves(200)
    plant = crown(leaves, colors, trunk=True)
    full = tl.FullMesh.build(plant)
    lod = tl.LayeredBillboards.build(
        plant, groups="slabs", layer_count=layer_count, resolution=128, samples=1
    )
    camera = whole_picture(lod, texel_of(lod))
    reference = tl.render(full, camera, samples=1).color
    found = tl.render(lod, camera, samples=1).color
    assert 0.2 < reference[..., 3].mean() < 0.9
    assert np.abs(found - reference).max() <= STORED
    # a twin: the slabs' own texels, far to near
    assert np.abs(painted(lod, lod.layers) - reference).max() <= STORED
    # the control: near to far, or without the nearest slab, it is another picture
    wrong = [lod.layers[:-1]] + ([lod.layers[::-1]] if layer_count > 1 else [])
    for layers in wrong:
        unlike = np.abs(painted(lod, layers) - reference).max(axis=2)
        assert (unlike > STORED).sum() > 10


def test_branches_err_where_they_reach_through_one_another():
    plant = tl.grow_plant("chestnut", leaf_count=3000)
    full = tl.FullMesh.build(plant)
    unlike = {}
    for groups in ("branches", "slabs"):
        lod = tl.LayeredBillboards.build(plant, groups=groups, resolution=256, samples=1)
        camera = whole_picture(lod, texel_of(lod))
        reference = tl.render(full, camera, samples=1).color
        found = tl.render(lod, camera, samples=1).color
        np.testing.assert_array_equal(found[..., 3] > 0.5, reference[..., 3] > 0.5)
        unlike[groups] = (np.abs(found - reference).max(axis=2) > STORED).mean()
    assert unlike["slabs"] == 0
    assert 0 < unlike["branches"] < 0.1


@pytest.mark.parametrize("params", [{}, {"turn": "viewer"}, {"drawing": "test"}])
def test_a_still_wind_is_no_wind(tree, params):
    lod = tl.LayeredBillboards.build(tree, resolution=64, **params)
    still = tl.Scene([(lod, None)], wind=tl.Wind(sway=0.0))
    windy = tl.Scene([(lod, None)], wind=WIND)
    camera = camera_at(10).at(1.5)
    expected = tl.render(lod, camera).color
    np.testing.assert_array_equal(tl.render(still, camera).color, expected)
    assert np.abs(tl.render(windy, camera).color - expected).max() > 0.1


def test_what_the_wind_moves_out_of_the_box_is_drawn(tree):
    lod = tl.LayeredBillboards.build(tree, resolution=64, growth=3.0)
    gale = tl.Wind(sway=1.0, seed=1)
    (low, high) = tl.Scene([(lod, None)], wind=gale).bounds
    for time_secs in np.linspace(0, 4, 9):
        poses = lod.poses(camera_at().at(time_secs), wind=gale)
        for layer, pose in zip(lod.layers, poses, strict=True):
            moved = layer.corners @ pose[:3, :3].T + pose[:3, 3]
            assert (moved >= low - 1e-9).all()
            assert (moved <= high + 1e-9).all()


def test_what_the_wind_moves_out_of_the_picture_and_into_it_is_drawn(tree):
    lod = tl.LayeredBillboards.build(tree, resolution=64, growth=3.0)
    gale = tl.Wind(sway=1.0, seed=1)
    still, windy = tl.Scene([(lod, None)]), tl.Scene([(lod, None)], wind=gale)
    low, high = still.bounds
    # the middle of the layer that is moved farthest out to a side of the box at rest
    out = []
    for time_secs in np.linspace(0, 4, 9):
        poses = lod.poses(camera_at().at(time_secs), wind=gale)
        for layer, pose in zip(lod.layers, poses, strict=True):
            middle = pose[:3, :3] @ layer.corners.mean(axis=0) + pose[:3, 3]
            out.append((max(low[0] - middle[0], middle[0] - high[0]), time_secs, middle))
    far, time_secs, (x, y, z) = max(out, key=lambda found: found[0])
    assert far > 0.5, "beyond the box"
    # a camera that sees nothing of the box
    camera = tl.Camera.orthographic((x, y, z + 20), (x, y, z), height=far, size=(32, 32))
    camera = camera.at(time_secs)
    assert not tl.render(still, camera).color.any()
    assert tl.render(windy, camera).color[..., 3].max() > 0.5


def test_tilted_layers_hang_on_their_parents_from_aside(tree):
    # the joint of a limb in the picture: where its anchor is, and where its card has that point
    for tilt, most in [(True, 1e-9), (False, None)]:
        lod = tl.LayeredBillboards.build(tree, resolution=64, tilt=tilt)
        misses = []
        for layer in lod.layers:
            corner, across, up = (
                layer.corners[0],
                layer.corners[1] - layer.corners[0],
                layer.corners[3] - layer.corners[0],
            )
            u = (layer.anchor[0] - corner[0]) / across[0]
            v = (layer.anchor[1] - corner[1]) / up[1]
            misses.append(np.linalg.norm(corner + u * across + v * up - layer.anchor))
        if most is None:
            assert max(misses) > 0.01
        else:
            assert max(misses) <= most


# Poses, against a twin


def twin_poses(layers, slopes, motion, right, up):
    """Each layer's place: its parent's times a turn or a shear about its anchor."""
    basis = np.array([right, up])
    poses = []
    for layer, slope in zip(layers, slopes, strict=True):
        angle = np.arctan(slope)
        plane = {
            # columns: where right and up go
            "rotate": [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]],
            "shear": [[1.0, slope], [0.0, 1.0]],
        }[motion]
        own = np.eye(4)
        own[:3, :3] += basis.T @ (np.array(plane) - np.eye(2)) @ basis
        own[:3, 3] = layer.anchor - own[:3, :3] @ layer.anchor
        poses.append(own if layer.parent is None else poses[layer.parent] @ own)
    return np.array(poses)


def own_slopes(layers, poses, motion):
    """How far each layer leans of its own, read off its matrix relative to its parent's."""
    slopes = []
    for layer, pose in zip(layers, poses, strict=True):
        own = pose if layer.parent is None else np.linalg.inv(poses[layer.parent]) @ pose
        slopes.append(own[0, 1] / own[1, 1] if motion == "rotate" else own[0, 1])
    return np.array(slopes)


@pytest.mark.parametrize("motion", ["rotate", "shear"])
def test_poses_are_forward_kinematics(tree, motion):
    lod = tl.LayeredBillboards.build(tree, motion=motion, growth=1.5, resolution=16)
    camera = camera_at()
    at = {
        t: own_slopes(lod.layers, lod.poses(camera.at(t), wind=WIND), motion)
        for t in (0.0, 1.0, 2.7)
    }
    level = np.array([0, 1, 2, 1])
    amplitude = WIND.sway * 1.5**level
    lean = np.where(level == 0, WIND.lean, 0.0)
    # a quarter of a period apart: sine and cosine of one phase
    sine, cosine = at[0.0] - lean, at[1.0] - lean
    np.testing.assert_allclose(np.hypot(sine, cosine), amplitude, rtol=1e-9)
    phase = np.arctan2(sine, cosine)
    assert len(np.unique(phase.round(6))) == 4
    expected = lean + amplitude * np.sin(phase + 2 * np.pi * 2.7 / WIND.period_secs)
    np.testing.assert_allclose(at[2.7], expected, atol=1e-12)
    poses = lod.poses(camera.at(2.7), wind=WIND)
    np.testing.assert_allclose(poses, twin_poses(lod.layers, expected, motion, **FRONT), atol=1e-12)
    # the control: without the parents' motion they are other places
    orphans = [replace(layer, parent=None) for layer in lod.layers]
    alone = twin_poses(orphans, expected, motion, **FRONT)
    assert np.abs(poses - alone).max() > 0.05


def test_children_hang_on_and_the_base_stays(lod):
    poses = lod.poses(camera_at().at(0.9), wind=WIND)
    for layer, pose in zip(lod.layers, poses, strict=True):
        anchor = np.append(layer.anchor, 1.0)
        parent = np.eye(4) if layer.parent is None else poses[layer.parent]
        np.testing.assert_allclose(pose @ anchor, parent @ anchor, atol=1e-12)


def test_copies_swing_at_phases_of_their_own(lod):
    camera = camera_at().at(0.3)
    first, again, other = (
        lod.poses(camera, wind=WIND, copy=copy) for copy in ((0, 1), (0, 1), (0, 2))
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3
    np.testing.assert_array_equal(lod.poses(camera), np.tile(np.eye(4), (4, 1, 1)))


def test_a_wind_towards_the_viewer_moves_nothing(lod):
    away = tl.Wind(sway=0.2, lean=0.1, azimuth_deg=0.0)
    poses = lod.poses(camera_at().at(1.0), wind=away)
    np.testing.assert_allclose(poses, np.tile(np.eye(4), (4, 1, 1)), atol=1e-12)


def test_layers_turn_to_the_viewer_about_their_anchors(tree):
    lod = tl.LayeredBillboards.build(tree, turn="viewer", max_turn_deg=60, resolution=32)
    assert lod.footprint.triangles == len(tree.wood.triangles)
    for azimuth, expected in [(0, 0), (30, 30), (-50, -50), (100, 60)]:
        angle = np.radians(azimuth)
        eye = (50 * np.sin(angle), 2.5, 50 * np.cos(angle))
        camera = tl.Camera.orthographic(eye, (0, 2.5, 0), height=8, size=(32, 32))
        for layer, pose in zip(lod.layers, lod.poses(camera), strict=True):
            facing_now = pose[:3, :3] @ (0, 0, 1)
            found = np.degrees(np.arctan2(facing_now[0], facing_now[2]))
            assert found == pytest.approx(expected, abs=1e-6)
            stays = pose[:3, :3] @ layer.anchor + pose[:3, 3]
            np.testing.assert_allclose(stays, layer.anchor, atol=1e-9)


# What is built, and what is refused


def test_facts_of_a_build(tree):
    seen = []
    lod = tl.LayeredBillboards.build(
        tree, resolution=32, progress=lambda done, total: seen.append((done, total))
    )
    assert lod.params == {
        "direction": (0.0, 0.0, 1.0),
        "groups": "auto",
        "layer_count": 25,
        "tilt": True,
        "turn": "fixed",
        "max_turn_deg": 180.0,
        "motion": "rotate",
        "growth": 1.25,
        "drawing": "blend",
        "resolution": 32,
        "samples": 16,
        "format": "rgba8",
        "wood": True,
        "wood_triangle_count": None,
        "wood_as": "baked",
        "views": None,
    }
    assert seen[-1] == (4, 4)
    assert lod.build_secs > 0
    (texture,) = lod.textures
    assert texture.name == "layers"
    assert lod.footprint.texture_bytes == 4 * sum(level[..., 0].size for level in texture.levels)
    short = tl.LayeredBillboards.build(tree, resolution=32, format="rgb5a1")
    assert short.footprint.texture_bytes * 2 == lod.footprint.texture_bytes


def test_wood_in_layers_as_a_mesh_or_not_at_all(tree):
    count = len(tree.wood.triangles)
    camera = camera_at()
    alpha = {}
    for name, params, triangles in [
        ("baked", {}, 0),
        ("mesh", {"wood_as": "mesh"}, count),
        ("none", {"wood": False}, 0),
    ]:
        lod = tl.LayeredBillboards.build(tree, resolution=256, **params)
        assert lod.footprint.triangles == triangles
        alpha[name] = tl.render(lod, camera).color[..., 3].mean()
    assert alpha["baked"] == pytest.approx(alpha["mesh"], abs=0.003)
    assert alpha["none"] < 0.5 * alpha["mesh"]
    few = tl.LayeredBillboards.build(tree, resolution=32, wood_triangle_count=16)
    assert sum(layer.wood_triangle_count for layer in few.layers) == few.footprint.triangles
    slabs = tl.LayeredBillboards.build(
        tree, groups="slabs", wood_as="mesh", layer_count=5, resolution=32
    )
    assert [layer.wood_triangle_count for layer in slabs.layers] == [0, 0, count, 0, 0]
    bare = tl.LayeredBillboards.build(tree, wood=False, resolution=32)
    assert [layer.wood_triangle_count for layer in bare.layers] == [0, 0, 0, 0]
    assert few.params["wood_as"] == "mesh"
    assert 0 < few.footprint.triangles <= count


def test_pictures_do_not_depend_on_the_thread_count(tree):
    for groups in ("branches", "slabs"):
        one, two = (
            tl.LayeredBillboards.build(tree, groups=groups, resolution=64, threads=threads)
            for threads in (1, 3)
        )
        np.testing.assert_array_equal(one.textures[0].levels[0], two.textures[0].levels[0])


@pytest.mark.parametrize(
    ("params", "error", "message"),
    [
        ({"layer_count": 0}, ValueError, "layer_count"),
        ({"layer_count": 2.5}, TypeError, "layer_count"),
        ({"azimuth_deg": float("nan")}, ValueError, "azimuth_deg"),
        ({"direction": (0, 0)}, ValueError, "direction"),
        ({"direction": (0, 0, 0)}, ValueError, "direction"),
        ({"groups": "limbs"}, ValueError, "groups"),
        ({"turn": "yes"}, ValueError, "turn"),
        ({"turn": "viewer", "max_turn_deg": 181}, ValueError, "max_turn_deg"),
        ({"turn": "fixed", "max_turn_deg": -1}, ValueError, "max_turn_deg"),
        ({"turn": "fixed", "max_turn_deg": float("nan")}, ValueError, "max_turn_deg"),
        ({"turn": "viewer", "wood_as": "baked"}, ValueError, "wood_as"),
        ({"wood_as": "baked", "wood_triangle_count": 5}, ValueError, "wood_triangle_count"),
        ({"motion": "swing"}, ValueError, "motion"),
        ({"growth": -1}, ValueError, "growth"),
        ({"growth": "1"}, TypeError, "growth"),
        ({"drawing": "coverage"}, ValueError, "drawing"),
        ({"resolution": 0}, ValueError, "resolution"),
        ({"resolution": 9000}, ValueError, "resolution"),
        ({"groups": "slabs", "layer_count": 500, "resolution": 8192}, tl.LimitError, "resolution"),
        ({"samples": 3}, ValueError, "samples"),
        ({"format": "png"}, ValueError, "format"),
        ({"wood_as": "stone"}, ValueError, "wood_as"),
        ({"views": []}, ValueError, "views"),
    ],
)
def test_what_cannot_be_built_is_refused(tree, params, error, message):
    with pytest.raises(error, match=f"^{message}"):
        tl.LayeredBillboards.build(tree, **params)


def test_no_branches_no_leaves_no_plant(tree):
    with pytest.raises(ValueError, match=r"^groups"):
        tl.LayeredBillboards.build(random_crown(), groups="branches")
    assert tl.LayeredBillboards.build(random_crown(), resolution=16).layers[0].name == "slab/0"
    with pytest.raises(TypeError, match=r"^plant"):
        tl.LayeredBillboards.build("tree")
    with pytest.raises(TypeError, match=r"^wind"):
        tl.LayeredBillboards.build(tree, resolution=16).poses(camera_at(), wind="strong")


# Real plants


@pytest.mark.parametrize(
    ("file", "layer_count"),
    [
        ("quaternius_common/CommonTree_1.gltf", 25),
        ("ez_oak_large/ez_oak_large.glb", 25),
        # 9 pieces of wood: fewer limbs than layers
        ("quaternius_common/CommonTree_3.gltf", 9),
    ],
)
def test_limbs_of_real_trees(models, file, layer_count):
    plant = tl.load_plant(models / file)
    lod = tl.LayeredBillboards.build(plant, resolution=64, samples=1)
    assert len(lod.layers) == layer_count
    assert lod.layers[0].name == "trunk"
    assert sum(layer.leaf_count for layer in lod.layers) == plant.foliage.leaf_count
    low, high = plant.bounds
    assert lod.layers[0].anchor[1] < low[1] + 0.1 * (high[1] - low[1])
    # limbs leave the trunk inside its outline
    for layer in lod.layers[1:]:
        assert (low <= layer.anchor).all()
        assert (layer.anchor <= high).all()
