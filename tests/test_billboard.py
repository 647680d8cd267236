"""Billboards: where quads stand, which pictures they show, and what wind and variety do to them."""

import itertools

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, random_crown, random_leaves

SMALL = {"view_count": 4, "resolution": 32}
ALIGNS = ["camera", "view_plane", "limited"]


def unit(vector):
    return np.asarray(vector, float) / np.linalg.norm(vector)


def turned_towards(start, goal, most):
    """A unit vector turned towards another by at most an angle, along the arc between them."""
    angle = np.arccos(np.clip(start @ goal, -1, 1))
    if angle <= most:
        return goal
    aside = unit(goal - (goal @ start) * start)
    return np.cos(most) * start + np.sin(most) * aside


def twin_quad(plant, camera, *, align, axis, max_turn_deg=30.0, view_count=4):
    """The number of the picture and the corners of the quad, from the definition."""
    points = np.concatenate(
        [mesh.positions[mesh.triangles].reshape(-1, 3) for mesh in (plant.wood, plant.foliage)]
    ).astype(float)
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    back = unit(np.subtract(camera.eye, camera.target))
    eye = unit(camera.eye - center) if camera.is_perspective else back
    step = 2 * np.pi / view_count
    number = int(np.rint(np.arctan2(eye[0], eye[2]) / step)) % view_count
    # how large the picture is, in its own frame
    azimuth = number * step
    across = np.array([np.cos(azimuth), 0, -np.sin(azimuth)])
    x, y = (points - center) @ across, points[:, 1] - center[1]
    start, goal = back, eye
    if axis == "vertical":
        start, goal = (unit(direction * [1, 0, 1]) for direction in (back, eye))
    normal = {
        "camera": goal,
        "view_plane": start,
        "limited": turned_towards(start, goal, np.radians(max_turn_deg)),
    }[align]
    right = unit(np.cross([0, 1, 0], normal))
    up = np.cross(normal, right)
    corners = [(x.min(), y.min()), (x.max(), y.min()), (x.max(), y.max()), (x.min(), y.max())]
    return number, np.array([center + right * u + up * v for u, v in corners])


def random_cameras(count, seed=2):
    rng = np.random.default_rng(seed)
    cameras = []
    for index in range(count):
        eye, target, up = rng.normal(size=(3, 3)) * [[8, 3, 8], [2, 2, 2], [1, 1, 1]]
        if index % 2:
            camera = tl.Camera.perspective(eye, target, size=(8, 8), up=up)
        else:
            camera = tl.Camera.orthographic(eye, target, height=4, size=(8, 8), up=up)
        cameras.append(camera)
    return cameras


@pytest.mark.parametrize("axis", ["vertical", "free"])
@pytest.mark.parametrize("align", ALIGNS)
def test_quads_stand_where_the_definition_puts_them(align, axis):
    plant = random_crown(40, trunk=True)
    lod = tl.Billboard.build(plant, align=align, axis=axis, max_turn_deg=5.0, **SMALL)
    differing = 0
    for camera in random_cameras(40):
        (quad,) = lod.quads(camera)
        number, corners = twin_quad(plant, camera, align=align, axis=axis, max_turn_deg=5.0)
        assert (quad.picture, quad.share) == (number, 1.0)
        np.testing.assert_allclose(quad.corners, corners, atol=1e-9)
        # the control: an other alignment stands elsewhere, where there is a difference at all
        other = ALIGNS[(ALIGNS.index(align) + 1) % 3]
        wrong = twin_quad(plant, camera, align=other, axis=axis, max_turn_deg=5.0)[1]
        differing += not np.allclose(quad.corners, wrong, atol=1e-9)
    assert differing >= 10


def test_limited_lies_between_the_two():
    plant = random_crown(40)
    for axis in ("vertical", "free"):
        built = {
            name: tl.Billboard.build(plant, axis=axis, **params, **SMALL)
            for name, params in {
                "camera": {"align": "camera"},
                "view_plane": {"align": "view_plane"},
                "none": {"align": "limited", "max_turn_deg": 0.0},
                "all": {"align": "limited", "max_turn_deg": 180.0},
            }.items()
        }
        for camera in random_cameras(20):
            corners = {name: lod.quads(camera)[0].corners for name, lod in built.items()}
            np.testing.assert_array_equal(corners["none"], corners["view_plane"])
            np.testing.assert_array_equal(corners["all"], corners["camera"])


def test_from_where_it_was_taken_the_picture_is_the_plant():
    # two thin leaves span a box of 2 m a side, so that texels are square from all four sides
    leaves, colors = random_leaves(80)
    leaves = [(0.85 * np.asarray(middle), *sides) for middle, *sides in leaves]
    leaves += [((0, 0.99, 0), (1, 0, 0), (0, 0.01, 0)), ((0, -0.99, 0), (0, 0, 1), (0, 0.01, 0))]
    plant = crown(leaves, np.vstack([colors, np.ones((2, 4))]))
    np.testing.assert_allclose(plant.bounds, [[-1] * 3, [1] * 3], atol=1e-6)
    full = tl.FullMesh.build(plant)
    lod = tl.Billboard.build(plant, **SMALL)
    references = []
    for toward in ((0, 0, 1), (1, 0, 0), (0, 0, -1), (-1, 0, 0)):
        eye = 20 * np.array(toward)
        camera = tl.Camera.orthographic(eye, (0, 0, 0), height=2, size=(32, 32))
        # a sample in the middle of each texel: others would mix it with its neighbours
        shown = tl.render(lod, camera, samples=1).color
        references.append(tl.render(full, camera, samples=16).color)
        # what is stored has eight bits of sRGB and of alpha
        np.testing.assert_allclose(shown, references[-1], atol=0.01)
    for one, other in itertools.pairwise(references):
        assert np.abs(one - other).mean() > 0.1, "other pictures are other"


@pytest.mark.parametrize("elevation", [0.0, 40.0])
def test_pictures_between_the_axes_are_in_place(elevation):
    # the box's middle is not that of what is seen from there
    leaves, colors = random_leaves(60, size=0.2)
    # all on one side of the plane x + y + z = 0 but for a few at its ends
    leaves = [leaf for leaf in leaves if sum(leaf[0]) > 0]
    plant = crown(leaves, colors[: len(leaves)])
    full = tl.FullMesh.build(plant)
    lod = tl.Billboard.build(
        plant, axis="free", elevations_deg=(elevation,), view_count=8, resolution=128
    )
    center = np.mean(plant.bounds, axis=0)
    step, up = np.radians(45), np.radians(elevation)
    asides = []
    for number in range(8):
        angle = number * step
        toward = np.array([np.sin(angle) * np.cos(up), np.sin(up), np.cos(angle) * np.cos(up)])
        camera = tl.Camera.orthographic(center + 9 * toward, center, height=4, size=(64, 64))
        assert lod.quads(camera)[0].picture == number
        middles = [middle_of(tl.render(each, camera, samples=16).color) for each in (full, lod)]
        np.testing.assert_allclose(*middles, atol=0.1)
        corners = lod.pictures[number].corners
        asides.append(np.linalg.norm(corners.mean(axis=0) - center) * 16)
    assert max(asides) > 1, "pixels by which a picture's middle is beside the plant's"


def middle_of(color):
    """Column and row of the middle of what is covered, in pixels."""
    rows, columns = np.indices(color.shape[:2])
    alpha = color[..., 3]
    return [float((alpha * places).sum() / alpha.sum()) for places in (columns, rows)]


PATTERN = 0.016
"""Five standard deviations of the share of 40 x 40 x 16 samples that a fade picks, at one half."""


def shares_shown(color, alone):
    """Of each of two pictures, one red and one green, the share of every pixel's samples."""
    return [color[..., k] / alone[k][..., k].max() for k in (0, 1)]


def test_two_pictures_sum_to_the_whole():
    # from all sides a full square, so that a sample without a picture would show
    side = [((0, 0, z), (1, 0, 0), (0, 1, 0)) for z in (-1, 1)]
    front = [((x, 0, 0), (0, 0, 1), (0, 1, 0)) for x in (-1, 1)]
    plant = crown(side + front, [(1, 0, 0, 1)] * 2 + [(0, 1, 0, 1)] * 2)
    # light from everywhere, so that a picture is of one colour
    plant = plant.lit(tl.Lighting(sun=(0, 0, 0), sky=(0.5,) * 3, ground=(0.5,) * 3))

    def camera_at(azimuth):
        angle = np.radians(azimuth)
        eye = (9 * np.sin(angle), 0, 9 * np.cos(angle))
        return tl.Camera.orthographic(eye, (0, 0, 0), height=1.5, size=(40, 40))

    for drawing in ("test", "coverage", "blend"):
        lod = tl.Billboard.build(plant, view_blend="cross_fade", drawing=drawing, **SMALL)
        # each picture by itself, which is of one colour
        alone = [tl.render(lod, camera_at(azimuth), samples=16).color for azimuth in (0, 90)]
        for k, color in enumerate(alone):
            assert color[..., k].min() == pytest.approx(color[..., k].max(), rel=1e-6)
            assert color[..., k].min() > 0.1
            assert color[..., 1 - k].max() == 0
        shown = {}
        for azimuth in (15, 30, 60):
            camera, share = camera_at(azimuth), azimuth / 90
            quads = {quad.picture: quad.share for quad in lod.quads(camera)}
            assert quads == {0: pytest.approx(1 - share), 1: pytest.approx(share)}
            shown[azimuth] = tl.render(lod, camera, samples=16).color
            # every sample shows one picture or the other: the sums are exact but for float32
            np.testing.assert_allclose(shown[azimuth][..., 3], 1.0, atol=1e-6)
            shares = shares_shown(shown[azimuth], alone)
            np.testing.assert_allclose(sum(shares), 1.0, atol=1e-5)
            np.testing.assert_allclose(shares[0] * 16, np.rint(shares[0] * 16), atol=1e-3)
            assert shares[0].mean() == pytest.approx(1 - share, abs=PATTERN)
        # the control: shares of two patterns that do not fit together
        mixed = np.stack([shown[30][..., 0], shown[60][..., 1]], axis=-1)
        wrong = shares_shown(mixed, alone)
        assert np.abs(sum(wrong) - 1).max() > 1 / 16 - 1e-3
        assert abs(wrong[0].mean() - (1 - 60 / 90)) > 10 * PATTERN


def test_a_wall_in_the_wind_keeps_its_foot():
    plant = crown([((0, 2, 0), (1, 0, 0), (0, 2, 0)), ((0, 2, 0), (0, 0, 1), (0, 2, 0))])
    lod = tl.Billboard.build(plant, drawing="test", **SMALL)
    camera = tl.Camera.orthographic((0, 2, 9), (0, 2, 0), height=6, size=(60, 60))
    blown = tl.Scene([(lod, None)], wind=tl.Wind(lean=0.25, sway=0.0))
    picture = tl.render(blown, camera, samples=1).color[..., 3] > 0
    heights = 3.95 - 0.1 * np.arange(40)
    np.testing.assert_allclose(picture[10:50].argmax(axis=1), 20 + 2.5 * heights, atol=0.51)
    assert (picture[10:50].sum(axis=1) == 20).all()
    # a billboard leans as its plant does
    full = tl.Scene([(tl.FullMesh.build(plant), None)], wind=tl.Wind(lean=0.25, sway=0.0))
    expected = tl.render(full, camera, samples=1).color[..., 3] > 0
    assert (picture ^ expected).sum() <= 40


def test_copies_swing_at_phases_of_their_own():
    plant = crown([((0, 2, 0), (1, 0, 0), (0, 2, 0)), ((0, 2, 0), (0, 0, 1), (0, 2, 0))])
    lod = tl.Billboard.build(plant, drawing="test", **SMALL)
    places = np.tile(np.eye(4), (6, 1, 1))
    places[:, 0, 3] = 6.0 * np.arange(6)
    # 20 pixels a metre, the middle of a copy in the middle of its 120 columns
    camera = tl.Camera.orthographic((15, 2, 9), (15, 2, 0), height=4, size=(720, 80))
    scene = tl.Scene([(lod, places)], wind=tl.Wind(sway=0.25, period_secs=2.0))

    def tops(time_secs):
        color = tl.render(scene, camera.at(time_secs), samples=1).color
        row = color[0, :, 3].reshape(6, 120) > 0
        return np.array([np.flatnonzero(columns).mean() - 59.5 for columns in row])

    # a quarter of a swing apart, so that one is the sine and the other the cosine of the phase
    sine, cosine = tops(0.0), tops(0.5)
    # the middle of the upper row is 3.975 m up: a quarter of that, within a pixel
    np.testing.assert_allclose(np.hypot(sine, cosine), 20 * 3.975 * 0.25, atol=1.0)
    phases = np.arctan2(sine, cosine)
    assert min(abs(one - other) for one, other in itertools.combinations(phases, 2)) > 0.05
    np.testing.assert_array_equal(tops(2.0), sine)
    again = tl.Scene([(lod, places)], wind=tl.Wind(sway=0.25, period_secs=2.0, seed=1))
    assert (tl.render(again, camera.at(0.0)).color != tl.render(scene, camera.at(0.0)).color).any()


def test_variety_is_what_it_says():
    plant = crown([facing(0, 1, 0, 1), ((0.9, 2.2, 0), (0.1, 0, 0), (0, 0.2, 0))])
    variety = tl.Variety(size=0.15, hue_deg=30.0, value=0.1, seed=3)
    transforms = np.tile(np.eye(4), (12, 1, 1))
    transforms[:, 0, 3] = 4.0 * np.arange(12)
    camera = tl.Camera.orthographic((22, 1, 30), (22, 1, 0), height=4, size=(960, 80))
    for technique in (tl.FullMesh, tl.Billboard):
        params = {"drawing": "test", "resolution": 64} if technique is tl.Billboard else {}
        lod = technique.build(plant, **params)
        scene = tl.Scene([(lod, transforms)], variety=variety)
        still = tl.render(tl.Scene([(lod, transforms)]), camera, samples=16).color
        varied = tl.render(scene, camera, samples=16).color
        mirrored_count = 0
        for copy in range(12):
            variant = variety.of(0, copy)
            assert 0.85 <= variant.scale <= 1.15
            # 20 pixels a metre; a copy stands in the middle of its 80 columns
            columns = slice(80 * copy, 80 * copy + 80)
            here = varied[:, columns]
            top = np.argmax(here[..., 3].max(axis=1) > 0.5)
            # the top is 2.4 m high, the picture's upper edge at 3 m
            assert abs((3.0 - top / 20) - 2.4 * variant.scale) < 0.11, technique.name
            knob = here[top + 1, :, 3] > 0.5
            assert knob.any()
            is_left = np.flatnonzero(knob).mean() < 39.5
            assert is_left == variant.mirrored
            mirrored_count += variant.mirrored
            base = still[40, 80 * copy + 40, :3]
            np.testing.assert_allclose(
                here[40, 40, :3], base * np.array(variant.tint), rtol=0.02, atol=1e-3
            )
        assert 2 <= mirrored_count <= 10
    assert variety.of(0, 0) == tl.Variety(size=0.15, hue_deg=30.0, value=0.1, seed=3).of(0, 0)
    assert variety.of(0, 0) != variety.of(1, 0)


def test_copies_grow_from_their_foot():
    full = tl.FullMesh.build(crown([facing(2, 4, 0, 1)]))
    variety = tl.Variety(size=0.15, seed=1)
    low, high = tl.Scene([(full, None)], variety=variety).bounds
    scale = variety.of(0, 0).scale
    assert abs(scale - 1) > 0.01
    np.testing.assert_allclose([low[1], high[1]], [3, 3 + 2 * scale], atol=1e-6)
    np.testing.assert_allclose([low[0], high[0]], [2 - scale, 2 + scale], atol=1e-6)


def test_a_hue_is_turned_as_hsv_turns_it():
    import colorsys

    color = np.array([0.09, 0.15, 0.03])
    encoded = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1 / 2.4) - 0.055)
    hue, saturation, value = colorsys.rgb_to_hsv(*encoded)
    variety = tl.Variety(size=0, hue_deg=60.0, value=0, mirror=False, color=tuple(color))
    angles = []
    for copy in range(20):
        turned = color * variety.of(0, copy).tint
        code = np.where(turned <= 0.0031308, 12.92 * turned, 1.055 * turned ** (1 / 2.4) - 0.055)
        found = colorsys.rgb_to_hsv(*code)
        assert found[1:] == pytest.approx((saturation, value), abs=1e-5)
        angles.append(360 * (found[0] - hue))
    assert 45.0 < max(np.abs(angles)) <= 60.0
    assert min(angles) < -30 < 30 < max(angles)


def test_a_forest_shares_a_texture():
    plants = [random_crown(30, seed=seed) for seed in (1, 2, 3)]
    lods = tl.Billboard.forest(plants, **SMALL)
    alone = [tl.Billboard.build(plant, **SMALL) for plant in plants]
    camera = tl.Camera.perspective((0, 6, 40), (0, 0, 0), size=(96, 72))
    transforms = tl.scatter(30, 5.0)

    def scene(built):
        return tl.Scene([(lod, transforms[k::3]) for k, lod in enumerate(built)])

    together, apart = (tl.render(scene(built), camera) for built in (lods, alone))
    assert (together.stats.items, together.stats.textures) == (1, 1)
    assert apart.stats.textures == 3
    assert apart.stats.items > 3
    np.testing.assert_allclose(together.color, apart.color, atol=0.01)
    assert together.color[..., 3].mean() > 0.01
    texture = lods[0].textures[0]
    stored = sum(level.nbytes for level in texture.levels)
    assert sum(lod.footprint.texture_bytes for lod in lods) == stored
    assert [lod.footprint.cards for lod in lods] == [4, 4, 4]
    for k, lod in enumerate(lods):
        for ours, theirs in zip(lod.pictures, alone[k].pictures, strict=True):
            (x, y, wide, high), (u, v, *size) = ours.texels, theirs.texels
            assert [wide, high] == size
            np.testing.assert_array_equal(
                texture.levels[0][y : y + high, x : x + wide],
                alone[k].textures[0].levels[0][v : v + high, u : u + wide],
            )


@pytest.mark.parametrize(
    ("stored", "share"),
    [("rgb5a1", 1 / 2), ("rgb8", 3 / 4), ("bc1", 1 / 8), ("bc3", 1 / 4), ("bc7", 1 / 4)],
)
def test_formats_take_their_bytes(stored, share):
    plant = random_crown(40)
    plain = tl.Billboard.build(plant, **SMALL)
    lod = tl.Billboard.build(plant, format=stored, **SMALL)
    # blocks of 4 x 4 texels are whole in the finest level, and padded in the coarsest
    found = lod.footprint.texture_bytes / plain.footprint.texture_bytes
    assert found == pytest.approx(share, rel=0.1 if stored.startswith("bc") else 1e-9)
    one, other = (built.textures[0].levels[0].astype(int) for built in (plain, lod))
    opaque = (one[..., 3] == 255) & (other[..., 3] > 0)
    assert opaque.sum() > 100
    assert np.abs(one - other)[opaque].mean() < 12


def test_only_what_is_seen_is_baked():
    plant = random_crown(40)
    cameras = tl.orbit(plant, 2, distance=12.0, size=(64, 64))
    lod = tl.Billboard.build(plant, views=cameras, **SMALL)
    assert [picture.number for picture in lod.pictures] == [0, 2]
    everything = tl.Billboard.build(plant, **SMALL)
    assert lod.footprint.texture_bytes < everything.footprint.texture_bytes / 2
    for camera in cameras:
        np.testing.assert_array_equal(
            lod.quads(camera)[0].corners, everything.quads(camera)[0].corners
        )
    with pytest.raises(ValueError, match="camera needs picture 1"):
        tl.render(lod, tl.orbit(plant, 4)[1])


def test_the_same_bytes_on_any_thread_count():
    plant = random_crown(60, trunk=True)
    built = [tl.Billboard.build(plant, threads=count, **SMALL) for count in (1, 2)]
    levels = [lod.textures[0].levels for lod in built]
    for one, two in zip(*levels, strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("leaf_count", [60, 400])
def test_tested_pictures_cover_what_they_should(leaf_count):
    plant = random_crown(leaf_count, seed=4)
    for resolution in (16, 32, 64):
        lod = tl.Billboard.build(plant, drawing="test", view_count=1, resolution=resolution)
        height = np.ptp(lod.pictures[0].corners[:, 1])
        camera = tl.Camera.orthographic(
            (0, 0, 20), lod.pictures[0].corners.mean(axis=0), height=height, size=(200, 200)
        )
        covered = tl.render(lod, camera, samples=16).color[..., 3].mean()
        reference = tl.render(tl.FullMesh.build(plant), camera, samples=16).color[..., 3].mean()
        assert 0.2 < reference < 0.9
        assert covered == pytest.approx(reference, abs=0.02)


@pytest.mark.parametrize(
    ("params", "name"),
    [
        ({"align": "sideways"}, "align"),
        ({"axis": "tilted"}, "axis"),
        ({"max_turn_deg": -1.0}, "max_turn_deg"),
        ({"max_turn_deg": np.nan}, "max_turn_deg"),
        ({"view_count": 0}, "view_count"),
        ({"elevations_deg": ()}, "elevations_deg"),
        ({"elevations_deg": (0.0, 30.0)}, "elevations_deg"),
        ({"axis": "free", "elevations_deg": (0.0, np.nan)}, "elevations_deg"),
        ({"view_blend": "both"}, "view_blend"),
        ({"resolution": 0}, "resolution"),
        ({"resolution": 100_000}, "resolution"),
        ({"resolution": 8192, "view_count": 64}, "resolution"),
        ({"samples": 5}, "samples"),
        ({"drawing": "ink"}, "drawing"),
        ({"format": "bc2"}, "format"),
        ({"wood_as": "stone"}, "wood_as"),
        ({"views": []}, "views"),
        ({"threads": 0}, "threads"),
    ],
)
def test_bad_arguments_are_refused(params, name):
    with pytest.raises(ValueError, match=name):
        tl.Billboard.build(random_crown(10), **params)


def test_nothing_to_see_is_refused():
    trunk = tl.grow_plant("chestnut", leaf_count=5)
    bare = tl.Plant.from_arrays(
        wood={"positions": trunk.wood.positions, "triangles": trunk.wood.triangles}
    )
    assert tl.Billboard.build(bare, **SMALL).footprint.cards == 4
    for params in ({"wood": False}, {"wood_as": "mesh"}):
        with pytest.raises(ValueError, match="foliage"):
            tl.Billboard.build(bare, **params, **SMALL)
    with pytest.raises(ValueError, match="plants"):
        tl.Billboard.forest([])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("size", 0.95),
        ("hue_deg", 181.0),
        ("value", np.nan),
        ("color", (0.1, 0.2)),
        ("color", (0.0, 0.1, 0.1)),
        ("seed", -1),
    ],
)
def test_bad_varieties_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        tl.Variety(**{field: value})
