"""Orthogonal slices through the public face: exact clipping, both laws, and a twin in NumPy."""

import itertools

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, quads, random_crown, random_leaves
from treelod.color import linear_from_srgb

SIZE = (40, 30)
AXES = {"z": np.array([0.0, 0, 1]), "x": np.array([1.0, 0, 0]), "y": np.array([0.0, 1, 0])}


@pytest.fixture(scope="module")
def plant():
    return random_crown()


# Clipping, against areas by polygons


def clipped(polygon, axis, low, high):
    """Sutherland and Hodgman: the part of a polygon between two planes across an axis."""
    for sign, limit in ((1, high), (-1, -low)):
        corners = []
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            at, to = sign * a @ axis - limit, sign * b @ axis - limit
            if at <= 0:
                corners.append(a)
            if at * to < 0:
                corners.append(a + (b - a) * (at / (at - to)))
        if not corners:
            return np.empty((0, 3))
        polygon = np.array(corners)
    return polygon


def area_seen(polygon, axis):
    """Area of a polygon as seen along an axis."""
    if len(polygon) < 3:
        return 0.0
    edges = polygon[1:] - polygon[0]
    return abs(np.cross(edges[:-1], edges[1:]).sum(axis=0) @ axis) / 2


def test_the_twin_clips_a_square():
    square = np.array([(0.0, 0, 0), (4, 0, 4), (4, 1, 4), (0, 1, 0)])
    quarter = clipped(square, AXES["z"], 1, 2)
    assert area_seen(quarter, AXES["z"]) == pytest.approx(1)
    assert area_seen(square, AXES["z"]) == pytest.approx(4)
    assert len(clipped(square, AXES["z"], 5, 6)) == 0


@pytest.mark.parametrize("slice_count", [1, 2, 5, 7])
def test_slabs_hold_the_areas_of_the_clipped_leaves(slice_count):
    # large leaves that no axis sees behind one another
    parts = [
        ((-1, -1, -1), (0.9, 0.2, 0.7), (-0.3, 0.8, 0.5)),
        ((1, 1, 1), (0.6, 0.1, -0.7), (0.2, 0.7, 0.3)),
    ]
    leaves = [tuple(np.array(part, float) for part in leaf) for leaf in parts]
    plant = crown(leaves)
    lod = tl.OrthogonalSlices.build(
        plant, axes=3, slice_count=slice_count, resolution=256, samples=16
    )
    polygons = [
        np.array([m + x * a + y * b for x, y in [(-1, -1), (1, -1), (1, 1), (-1, 1)]])
        for m, a, b in leaves
    ]
    found = {texture.name: texture for texture in lod.textures}
    for name, axis in AXES.items():
        heights = np.concatenate(polygons) @ axis
        borders = np.linspace(heights.min(), heights.max(), slice_count + 1)
        for number, (low, high) in enumerate(itertools.pairwise(borders)):
            wanted = sum(area_seen(clipped(p, axis, low, high), axis) for p in polygons)
            texture = found.get(f"axis {name}, slice {number}")
            seen = 0.0
            if texture is not None:
                a, b, _, d = texture.corners
                card = np.linalg.norm(b - a) * np.linalg.norm(d - a)
                seen = texture.levels[0][..., 3].mean() / 255 * card
                middle = texture.corners.mean(axis=0) @ axis
                assert middle == pytest.approx((low + high) / 2, abs=1e-6)
            # edges of a few metres, on each metre of which a texel of 4 mm / sqrt(16) is missed
            assert seen == pytest.approx(wanted, abs=4e-3), (name, number)


def test_the_slabs_of_an_axis_are_seen_as_the_foliage(plant):
    lod = tl.OrthogonalSlices.build(plant, axes=3, slice_count=6, resolution=256, samples=1)
    for name, axis in AXES.items():
        # a pixel for each texel, seen along the axis
        texture = next(t for t in lod.textures if t.name.startswith(f"axis {name}"))
        a, b, _, d = texture.corners
        width, height = np.linalg.norm(b - a), np.linalg.norm(d - a)
        middle = texture.corners.mean(axis=0)
        size = (round(256 * width / height), 256)
        up = (d - a) / height
        eye = middle - (middle @ axis) * axis + 9 * axis
        camera = tl.Camera.orthographic(
            tuple(eye), tuple(eye - axis), height=height, size=size, up=tuple(up)
        )
        full = tl.render(tl.FullMesh.build(plant), camera, samples=4).color[..., 3]
        cut = tl.render(lod, camera, samples=4).color[..., 3]
        # texels are not quite square, so that pixels and texels differ
        assert cut.mean() == pytest.approx(full.mean(), abs=0.006)
        assert np.abs(cut - full).mean() < 0.1


# Against a twin


def twin_texel(level, u, v):
    """Bilinear, premultiplied and linear, clamped at the edge."""
    height, width = level.shape[:2]
    rgba = np.concatenate([linear_from_srgb(level[..., :3] / 255), level[..., 3:] / 255], axis=2)
    rgba[..., :3] *= rgba[..., 3:]
    x, y = u * width - 0.5, v * height - 0.5
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - x0, y - y0
    columns, rows = (np.clip([at, at + 1], 0, side - 1) for at, side in ((x0, width), (y0, height)))
    top, bottom = (rgba[row, columns[0]] * (1 - fx) + rgba[row, columns[1]] * fx for row in rows)
    return top * (1 - fy) + bottom * fy


def on_card(texture, eye, ray):
    """Distance along a ray to a card, in rays, and the texture coordinates that it meets."""
    corner = texture.corners[0]
    across, along = texture.corners[1] - corner, texture.corners[3] - corner
    normal = np.cross(across, along)
    distance = np.dot(corner - eye, normal) / np.dot(ray, normal)
    hit = eye + ray * distance - corner
    return distance, hit @ across / (across @ across), 1 - hit @ along / (along @ along)


def twin_pixel(lod, camera, pixel, *, k, m, exact):
    """
    Colour of a pixel's middle by a ray through cards, and how near it is to an edge of one.

    The second is 0 where a card is so steep that a coarser level would be read.
    """
    right, up, back = camera.view_rotation()
    width, height = camera.size
    scale = 2 * np.tan(np.radians(camera.fov_y_deg) / 2) / height
    x, y = pixel[0] + 0.5 - width / 2, height / 2 - pixel[1] - 0.5
    ray, beside, below = (
        ((x + dx) * right + (y - dy) * up) * scale - back for dx, dy in [(0, 0), (1, 0), (0, 1)]
    )
    eye = np.array(camera.eye)
    toward = eye / np.linalg.norm(eye)
    facing = {name: abs(axis @ toward) ** k for name, axis in AXES.items() if name != "y"}
    shares = {name: value / sum(facing.values()) for name, value in facing.items()}
    factor = 1 + m * (1 - max(shares.values()))
    hits, margin = [], np.inf
    for name, share in shares.items():
        cards = [t for t in lod.textures if t.name.startswith(f"axis {name}")]
        planes = [abs(eye @ AXES[name] - t.corners.mean(axis=0) @ AXES[name]) for t in cards]
        for place, number in enumerate(np.argsort(planes)[::-1]):
            texture = cards[number]
            distance, u, v = on_card(texture, eye, ray)
            margin = min(margin, *np.abs([u, 1 - u, v, 1 - v]))
            if 0 <= u <= 1 and 0 <= v <= 1 and distance > 0:
                side = texture.levels[0].shape[0]
                steps = [np.subtract(on_card(texture, eye, r)[1:], (u, v)) for r in (beside, below)]
                if max(np.linalg.norm(step) for step in steps) * side > 0.95:
                    margin = 0.0
                texel = twin_texel(texture.levels[0], u, v) * min(share * factor, 1)
                # in turns, the lesser share first; or by distance
                hits.append((-distance if exact else (place, share), texel))
    color = np.zeros(4)
    for _, texel in sorted(hits, key=lambda hit: hit[0]):
        color = texel + (1 - texel[3]) * color
    return color, margin


@pytest.mark.parametrize("order", ["slices", "exact"])
@pytest.mark.parametrize("azimuth", [25, 40, 230, 300.5])
def test_a_picture_is_that_of_rays_through_the_cards(plant, order, azimuth):
    # so near that a texel is several pixels: only the finest level is read
    lod = tl.OrthogonalSlices.build(plant, slice_count=4, resolution=8, k=1.5, paint_order=order)
    angle = np.radians(azimuth)
    eye = (4 * np.sin(angle), 1.0, 4 * np.cos(angle))
    camera = tl.Camera.perspective(eye, (0, 0, 0), fov_y_deg=40, size=(60, 60))
    frame = tl.render(lod, camera, samples=1, outputs=("color",))
    compared, worst = 0, 0.0
    for x, y in np.random.default_rng(5).integers(0, 60, (80, 2)):
        kwargs = {"k": 1.5, "m": 0.8}
        expected, margin = twin_pixel(lod, camera, (x, y), exact=order == "exact", **kwargs)
        other, _ = twin_pixel(lod, camera, (x, y), exact=order != "exact", **kwargs)
        if margin > 0.02:  # an edge is drawn in steps of 1/256 pixel
            np.testing.assert_allclose(frame.color[y, x], expected, atol=6e-4)
            worst = max(worst, np.abs(other - frame.color[y, x]).max())
            compared += expected[3] > 0.05
    assert compared > 20
    # the control: with the other order the same comparison fails
    assert worst > 5e-3


# What is built


def test_facts_of_a_build(plant):
    seen = []
    lod = tl.OrthogonalSlices.build(
        plant,
        slice_count=3,
        resolution=(16, 8),
        progress=lambda done, total: seen.append((done, total)),
    )
    assert lod.params == {
        "axes": 2,
        "slice_count": 3,
        "resolution": (16, 8),
        "samples": 16,
        "blend": "power",
        "k": 2.0,
        "correction": 0.8,
        "paint_order": "slices",
        "treetop_slice_count": 0,
        "treetop_height_rel": 0.3,
        "format": "rgba8",
        "views": None,
        "bake_wood": False,
        "wood": True,
        "wood_triangle_count": None,
    }
    assert seen[-1] == (6, 6)
    assert (lod.m, lod.fitted, lod.baked, lod.treetop_leaf_count) == (0.8, None, [True, True], 0)
    assert 0.05 < lod.tau < 3
    assert [texture.name for texture in lod.textures] == [
        f"axis {axis}, slice {index}" for axis in "zx" for index in range(3)
    ]
    footprint = lod.footprint
    assert (footprint.triangles, footprint.cards) == (0, 6)
    assert footprint.texture_bytes == 6 * 4 * (128 + 32 + 8 + 2 + 1)
    exact = tl.OrthogonalSlices.build(plant, slice_count=3, resolution=8, paint_order="exact")
    assert exact.footprint.cards == 6 * 4
    short = tl.OrthogonalSlices.build(plant, slice_count=3, resolution=(16, 8), format="rgb5a1")
    assert short.footprint.texture_bytes * 2 == footprint.texture_bytes


def test_threads_do_not_change_a_bake(plant):
    params = {"axes": 3, "resolution": 32, "correction": "fit", "treetop_slice_count": 2}
    one, four = (tl.OrthogonalSlices.build(plant, threads=n, **params) for n in (1, 4))
    assert (one.m, one.tau) == (four.m, four.tau)
    for a, b in zip(one.textures, four.textures, strict=True):
        for level_a, level_b in zip(a.levels, b.levels, strict=True):
            np.testing.assert_array_equal(level_a, level_b)


def test_wood_is_a_mesh_or_baked_in():
    leaves, colors = random_leaves(60)
    plant = crown(leaves, colors, trunk=True)
    mesh, baked, none = (
        tl.OrthogonalSlices.build(plant, resolution=64, **params)
        for params in ({}, {"bake_wood": True}, {"bake_wood": True, "wood": False})
    )
    assert [lod.footprint.triangles for lod in (mesh, baked, none)] == [4, 0, 0]
    camera = tl.Camera.orthographic((0, -1, 9), (0, -1, 0), height=5, size=(50, 50))
    # below the leaves
    of_mesh, of_wood, of_slices, of_none = (
        tl.render(lod, camera).color[30:45, 20:30].sum(axis=(0, 1))
        for lod in (tl.FullMesh.build(plant), mesh, baked, none)
    )
    assert of_mesh[3] > 25
    np.testing.assert_allclose(of_wood, of_mesh, rtol=1e-6)
    # its edges are blurred by a texel
    np.testing.assert_allclose(of_slices, of_mesh, rtol=0.05)
    np.testing.assert_array_equal(of_none, 0)


def test_a_corner_of_three_axes_is_corrected(plant):
    camera = tl.Camera.orthographic((5, 5, 5), (0, 0, 0), height=4, size=(64, 64))
    full = tl.render(tl.FullMesh.build(plant), camera).color[..., 3].mean()
    alphas = {
        correction: tl.render(
            tl.OrthogonalSlices.build(plant, axes=3, resolution=64, correction=correction), camera
        )
        .color[..., 3]
        .mean()
        for correction in (0.0, 0.5, "optical", "fit")
    }
    assert alphas[0.0] < alphas[0.5]
    assert alphas[0.0] < alphas["optical"]
    assert abs(alphas["fit"] - full) < abs(alphas[0.0] - full)


def test_wind_moves_the_treetop_by_itself(plant):
    camera = tl.Camera.perspective((0, 0, 9), (0, 0, 0), fov_y_deg=30, size=(60, 60))
    kwargs = {"slice_count": 3, "resolution": 32}
    stiff = tl.OrthogonalSlices.build(plant, **kwargs)
    loose = tl.OrthogonalSlices.build(plant, treetop_slice_count=1, **kwargs)
    assert loose.treetop_leaf_count > 10

    def frame(lod, wind, time_secs):
        return tl.render(tl.Scene([(lod, None)], wind=wind), camera.at(time_secs)).color

    wind = tl.Wind(sway=0.3, azimuth_deg=90)
    still = frame(loose, None, 0.0)
    moved = [frame(loose, wind, time) for time in (0.0, 1.0)]
    bent = [frame(stiff, wind, time) for time in (0.0, 1.0)]
    assert np.abs(moved[0] - moved[1]).max() > 0.1
    assert np.abs(bent[0] - bent[1]).max() > 0.1
    # as much is there, wherever it is
    for color in moved:
        assert color[..., 3].sum() == pytest.approx(still[..., 3].sum(), rel=0.1)
    steady = tl.Wind(sway=0.0, lean=0.2, azimuth_deg=90)
    upright = frame(stiff, None, 0.0)[..., 3]
    leaning = frame(stiff, steady, 0.0)[..., 3]

    def middle(alpha, rows):
        return (alpha[rows] * np.arange(60)).sum() / alpha[rows].sum()

    # the top moves, the foot stays
    assert middle(leaning, slice(10, 20)) - middle(upright, slice(10, 20)) > 3
    assert abs(middle(leaning, slice(42, 50)) - middle(upright, slice(42, 50))) < 2.5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"axes": 1}, "axes"),
        ({"axes": 4}, "axes"),
        ({"slice_count": 0}, "slice_count"),
        ({"slice_count": 10**6}, "slice_count"),
        ({"resolution": 0}, "resolution"),
        ({"resolution": 16384}, "resolution"),
        ({"samples": 2}, "samples"),
        ({"blend": "square"}, "blend"),
        ({"k": -1}, "k must"),
        ({"k": np.nan}, "k must"),
        ({"k": np.nan, "blend": "linear"}, "k must"),
        ({"k": -1, "blend": "linear"}, "k must"),
        ({"k": 100}, "k must"),
        ({"correction": "none"}, "correction"),
        ({"correction": -1}, "correction"),
        ({"paint_order": "random"}, "paint_order"),
        ({"treetop_slice_count": -1}, "treetop_slice_count"),
        ({"treetop_slice_count": 1, "treetop_height_rel": 0}, "treetop_height_rel"),
        ({"treetop_slice_count": 1, "treetop_height_rel": 1}, "treetop_height_rel"),
        ({"format": "dxt1"}, "format"),
        ({"views": []}, "views"),
        ({"wood_triangle_count": 0}, "wood_triangle_count"),
        ({"threads": 0}, "threads"),
    ],
)
def test_bad_arguments_are_named(plant, arguments, message):
    with pytest.raises(ValueError, match=message):
        tl.OrthogonalSlices.build(plant, **arguments)


def test_arguments_of_another_kind_are_refused(plant):
    bad = [{"axes": 2.5}, {"k": "high"}, {"blend": 2}, {"bake_wood": "yes"}, {"paint_order": None}]
    for arguments in bad:
        with pytest.raises(TypeError):
            tl.OrthogonalSlices.build(plant, **arguments)


def test_a_plant_without_leaves_has_no_slices():
    wood, _ = quads([facing(0, 0, 0, 1)])
    for bake_wood in (False, True):
        with pytest.raises(ValueError, match="foliage is empty"):
            tl.OrthogonalSlices.build(tl.Plant.from_arrays(wood=wood), bake_wood=bake_wood)
