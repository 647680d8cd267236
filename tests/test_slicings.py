"""Slicings through the public face: against the full mesh, and against a twin in NumPy."""

import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, quads, random_crown, random_leaves
from treelod.color import linear_from_srgb

SIZE = (40, 30)


@pytest.fixture(scope="module")
def plant():
    return random_crown()


@pytest.fixture(scope="module")
def lod(plant):
    return tl.Slicings.build(plant, slicing_count=6, slice_count=3, resolution=16)


def rectangle(lod, slicing):
    """Middle, width and height of a slicing's rectangle, from a slice's corners."""
    name = f"slicing {slicing}, slice 0"
    corners = next(texture.corners for texture in lod.textures if texture.name == name)
    return corners.mean(axis=0), *np.linalg.norm(corners[1:3] - corners[0:2], axis=1)


# Against the full mesh


@pytest.mark.parametrize(("slice_count", "most_different"), [(1, 0.0), (5, 0.12)])
def test_on_an_axis_a_parallel_view_shows_the_full_foliage(slice_count, most_different):
    # a rectangle of 4 x 2 m and 64 x 32 texels, seen with a pixel for each texel
    leaves, colors = random_leaves(150)
    leaves = [(0.8 * np.multiply(m, (2, 1, 1)), a, b) for m, a, b in leaves]
    leaves += [((x, y, y), (0.1, 0, 0), (0, 0.1, 0)) for x, y in [(-1.9, -0.9), (1.9, 0.9)]]
    plant = crown(leaves, np.vstack([colors, np.ones((2, 4))]))
    lod = tl.Slicings.build(
        plant, slicing_count=4, slice_count=slice_count, resolution=(64, 32), samples=1
    )
    _, width, height = rectangle(lod, 0)
    assert (width, height) == pytest.approx((4, 2), abs=1e-6)
    camera = tl.Camera.orthographic((0, 0, 9), (0, 0, 0), height=height, size=(64, 32))
    full = tl.render(tl.FullMesh.build(plant), camera, samples=1)
    sliced = tl.render(lod, camera, samples=1)
    # one sample a texel: a texel is covered or not, and slices in turn cover what leaves cover
    np.testing.assert_array_equal(sliced.color[..., 3], full.color[..., 3])
    assert 0.3 < full.color[..., 3].mean() < 0.9
    # Leaves are sorted by centre, so one that reaches into the next slab may lie behind what it
    # hides: few. Elsewhere colours differ by their storage in 8 bits: half a code of sRGB is at
    # most 0.0045 in linear light.
    different = np.abs(sliced.color - full.color).max(axis=2) > 0.0046
    assert different.mean() <= most_different


def test_textures_hold_the_mean_of_their_samples():
    plant = random_crown()
    one, many = (
        tl.Slicings.build(plant, slicing_count=1, slice_count=2, resolution=128, samples=samples)
        for samples in (1, 64)
    )
    for a, b in zip(one.textures, many.textures, strict=True):
        coverage = [texture.levels[0][..., 3].mean() / 255 for texture in (a, b)]
        # 128^2 texels of which one in five lies on an edge: 0.5 sqrt(3000) / 16384 = 0.0017
        assert coverage[0] == pytest.approx(coverage[1], abs=0.004)
        assert set(np.unique(a.levels[0][..., 3])) == {0, 255}
        assert len(np.unique(b.levels[0][..., 3])) > 30


def test_depth_is_that_of_the_slice_that_makes_it_opaque(plant):
    lod = tl.Slicings.build(plant, slicing_count=4, slice_count=3, resolution=64)
    camera = tl.Camera.perspective((2, 1, 6), (0, 0, 0), size=SIZE)
    frame = tl.render(lod, camera, samples=1)
    opaque = frame.color[..., 3]
    assert (opaque > 0.501).any()
    assert (opaque < 0.499).any()
    assert np.isfinite(frame.depth[opaque > 0.501]).all()
    assert np.isinf(frame.depth[opaque < 0.499]).all()
    center, radius = plant.sphere
    far = np.linalg.norm(np.subtract(camera.eye, center))
    seen = frame.depth[np.isfinite(frame.depth)]
    assert far - 2 * radius < seen.min() < seen.max() < far + 2 * radius


# Against a twin


def twin_shares(count, eye, center):
    """The pair on an even circle: {slicing: share}, by the two smallest angles."""
    toward = np.subtract(eye, center)[[0, 2]]
    azimuths = np.arange(count) * 2 * np.pi / count
    axes = np.stack([np.sin(azimuths), np.cos(azimuths)], axis=1)
    gamma = np.arccos(np.clip(axes @ toward / np.linalg.norm(toward), -1, 1))
    primary, secondary = np.argsort(gamma, kind="stable")[:2]
    share = gamma[secondary] / (gamma[primary] + gamma[secondary])
    return {int(secondary): 1 - share, int(primary): share}


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


def twin_pixel(lod, camera, pixel, *, slicing_count, slice_count, m):
    """Colour of a pixel's middle by rays and cards, and how far it is from any card's edge."""
    right, up, back = camera.view_rotation()
    width, height = camera.size
    scale = 2 * np.tan(np.radians(camera.fov_y_deg) / 2) / height
    x, y = pixel[0] + 0.5 - width / 2, height / 2 - pixel[1] - 0.5
    ray = (x * right + y * up) * scale - back
    eye = np.array(camera.eye)
    shares = twin_shares(slicing_count, eye, np.zeros(3))
    factor = 1 + m * min(shares.values())
    textures = {texture.name: texture for texture in lod.textures}
    color, margin = np.zeros(4), np.inf
    for index in range(slice_count):  # far to near
        for slicing, share in shares.items():  # the secondary first
            texture = textures[f"slicing {slicing}, slice {index}"]
            corner, across, along = (
                texture.corners[0],
                texture.corners[1] - texture.corners[0],
                texture.corners[3] - texture.corners[0],
            )
            normal = np.cross(across, along)
            hit = eye + ray * (np.dot(corner - eye, normal) / np.dot(ray, normal)) - corner
            u, v = hit @ across / (across @ across), 1 - hit @ along / (along @ along)
            margin = min(margin, *np.abs([u, 1 - u, v, 1 - v]))
            if 0 <= u <= 1 and 0 <= v <= 1:
                texel = twin_texel(texture.levels[0], u, v) * min(share * factor, 1)
                color = texel + (1 - texel[3]) * color
    return color, margin


@pytest.mark.parametrize("azimuth", [20, 40, 175, 300.5])
def test_a_picture_is_that_of_rays_through_the_cards(lod, azimuth):
    # so near that a texel is several pixels: only the finest level is read
    angle = np.radians(azimuth)
    eye = (4 * np.sin(angle), 1.0, 4 * np.cos(angle))
    camera = tl.Camera.perspective(eye, (0, 0, 0), fov_y_deg=40, size=(60, 60))
    frame = tl.render(lod, camera, samples=1, outputs=("color",))
    compared = 0
    for x, y in np.random.default_rng(5).integers(0, 60, (120, 2)):
        expected, margin = twin_pixel(lod, camera, (x, y), slicing_count=6, slice_count=3, m=0.5)
        if margin > 0.02:  # an edge is drawn in steps of 1/256 pixel
            np.testing.assert_allclose(frame.color[y, x], expected, atol=5e-4)
            compared += expected[3] > 0.05
    assert compared > 30


def test_the_twin_tells_orders_apart(lod):
    # the control of the test above: with the pair the other way round it must fail
    camera = tl.Camera.perspective(
        (4 * np.sin(0.35), 1, 4 * np.cos(0.35)), (0, 0, 0), size=(60, 60)
    )
    frame = tl.render(lod, camera, samples=1, outputs=("color",))
    worst = 0.0
    for x, y in np.random.default_rng(5).integers(15, 45, (40, 2)):
        kwargs = {"slicing_count": 6, "slice_count": 3}
        worst = max(
            worst,
            np.abs(twin_pixel(lod, camera, (x, y), m=0.4, **kwargs)[0] - frame.color[y, x]).max(),
        )
    assert worst > 5e-3


@pytest.mark.parametrize("azimuth", [20, 175])
def test_cells_are_those_of_rays_with_shares_of_their_own(plant, azimuth):
    # one slice, so that no order counts within a slicing, and few cells
    kwargs = {"slicing_count": 4, "slice_count": 1, "resolution": 8, "correction": 0.5}
    lod = tl.Slicings.build(plant, sub_slices=3, **kwargs)
    angle = np.radians(azimuth)
    eye = np.array([2.6 * np.sin(angle), 0.4, 2.6 * np.cos(angle)])
    camera = tl.Camera.perspective(tuple(eye), (0, 0, 0), fov_y_deg=60, size=(60, 60))
    frame = tl.render(lod, camera, samples=1, outputs=("color",))
    right, up, back = camera.view_rotation()
    scale = 2 * np.tan(np.radians(30)) / 60
    cards = {int(t.name.split()[1][:-1]): t for t in lod.textures}
    # the order of the slicings: by the opacity of all their cells
    totals = dict.fromkeys(cards, 0.0)
    opacities = {}
    for number, texture in cards.items():
        corner, b, _, d = texture.corners
        for column in range(3):
            for row in range(3):
                u, v = (column + 0.5) / 3, (row + 0.5) / 3
                middle = corner + u * (b - corner) + (1 - v) * (d - corner)
                shares = twin_shares(4, eye, middle)
                factor = 1 + 0.5 * min(shares.values())
                opacity = min(shares.get(number, 0.0) * factor, 1)
                opacities[number, column, row] = opacity
                totals[number] += opacity
    order = sorted(cards, key=lambda number: (totals[number], -number))
    compared, plain_worst = 0, 0.0
    plain = tl.render(tl.Slicings.build(plant, **kwargs), camera, samples=1, outputs=("color",))

    def on_card(number, x, y):
        ray = ((x + 0.5 - 30) * right + (30 - y - 0.5) * up) * scale - back
        corner, b, _, d = cards[number].corners
        across, along = b - corner, d - corner
        normal = np.cross(across, along)
        distance = np.dot(corner - eye, normal) / np.dot(ray, normal)
        hit = eye + ray * distance - corner
        return distance, hit @ across / (across @ across), 1 - hit @ along / (along @ along)

    for x, y in np.random.default_rng(5).integers(5, 55, (100, 2)):
        color, margin = np.zeros(4), np.inf
        for number in order:
            distance, u, v = on_card(number, x, y)
            margin = min(margin, *np.abs([3 * u - np.round(3 * u), 3 * v - np.round(3 * v)]))
            if 0 <= u < 1 and 0 <= v < 1 and distance > 0:
                beside = [on_card(number, x + 1, y)[1:], on_card(number, x, y + 1)[1:]]
                if max(np.linalg.norm(np.subtract(at, (u, v))) for at in beside) * 8 > 0.95:
                    margin = 0.0  # so steep that a coarser level would be read
                opacity = opacities[number, int(3 * u), int(3 * v)]
                texel = twin_texel(cards[number].levels[0], u, v) * opacity
                color = texel + (1 - texel[3]) * color
        if margin > 0.04:
            np.testing.assert_allclose(frame.color[y, x], color, atol=6e-4)
            compared += color[3] > 0.05
            plain_worst = max(plain_worst, np.abs(plain.color[y, x] - color).max())
    assert compared > 25
    # the control: whole slices have other opacities
    assert plain_worst > 0.02


# What is built


def test_facts_of_a_build(plant):
    seen = []
    lod = tl.Slicings.build(
        plant,
        slicing_count=2,
        slice_count=3,
        resolution=(16, 8),
        progress=lambda done, total: seen.append((done, total)),
    )
    assert lod.params == {
        "slicing_count": 2,
        "slice_count": 3,
        "level_error_px": 1.0,
        "level_distances": None,
        "resolution": (16, 8),
        "samples": 16,
        "correction": 0.5,
        "large_leaves": "split",
        "orientations": "circle",
        "vertical": False,
        "mirrored": False,
        "drop_back": 0,
        "sub_slices": 1,
        "quadtree": None,
        "branch_level": None,
        "format": "rgba8",
        "views": None,
        "wood": True,
        "wood_triangle_count": None,
    }
    assert seen[-1] == (6, 6)
    assert (lod.m, lod.fitted, lod.baked) == (0.5, None, [True, True])
    assert 0.05 < lod.tau < 3
    assert lod.build_secs > 0
    textures = lod.textures
    assert [texture.name for texture in textures] == [
        f"slicing {slicing}, slice {index}" for slicing in range(2) for index in range(3)
    ]
    for texture in textures:
        shapes = [level.shape for level in texture.levels]
        assert shapes == [(8, 16, 4), (4, 8, 4), (2, 4, 4), (1, 2, 4), (1, 1, 4)]
        assert {level.dtype for level in texture.levels} == {np.dtype(np.uint8)}
        assert texture.corners.shape == (4, 3)
    footprint = lod.footprint
    assert (footprint.triangles, footprint.cards) == (0, 6)
    assert footprint.texture_bytes == 6 * 4 * (128 + 32 + 8 + 2 + 1)
    # planes at -1/3, 0 and 1/3 of the depth of 2.4 m, first towards +z
    depths = [texture.corners[:, 2].mean() for texture in textures[:3]]
    np.testing.assert_allclose(depths, [-0.8, 0, 0.8], atol=1e-6)


def test_half_the_bytes_with_one_bit_of_alpha(plant):
    params = {"slicing_count": 2, "slice_count": 2, "resolution": 16}
    long, short = (tl.Slicings.build(plant, format=name, **params) for name in ("rgba8", "rgb5a1"))
    assert short.footprint.texture_bytes * 2 == long.footprint.texture_bytes
    for texture in short.textures:
        for level in texture.levels:
            assert set(np.unique(level[..., 3])) <= {0, 255}
            assert len(np.unique(level[..., :3])) <= 32


@pytest.mark.parametrize(
    "options",
    [
        {"slicing_count": 3, "correction": "fit"},
        {"slicing_count": 4, "slice_count": (4, 2), "quadtree": 16, "vertical": True},
    ],
)
def test_threads_do_not_change_a_bake(plant, options):
    one, four = (
        tl.Slicings.build(plant, resolution=32, threads=threads, **options) for threads in (1, 4)
    )
    assert (one.m, one.tau) == (four.m, four.tau)
    for a, b in zip(one.textures, four.textures, strict=True):
        for level_a, level_b in zip(a.levels, b.levels, strict=True):
            np.testing.assert_array_equal(level_a, level_b)


def test_a_fit_makes_the_crown_as_opaque_between_axes_as_on_them(plant):
    def mean_alpha(lod, azimuths):
        views = [
            tl.Camera.orthographic(
                (9 * np.sin(a), 0, 9 * np.cos(a)), (0, 0, 0), height=4, size=(64, 64)
            )
            for a in np.radians(azimuths)
        ]
        return np.mean([tl.render(lod, view).color[..., 3].mean() for view in views])

    lods = {
        correction: tl.Slicings.build(plant, slicing_count=4, resolution=64, correction=correction)
        for correction in (0.0, "fit", "optical")
    }
    wanted = mean_alpha(lods[0.0], range(0, 360, 90))
    around = {key: mean_alpha(lod, range(0, 360, 10)) for key, lod in lods.items()}
    assert around[0.0] < 0.95 * wanted
    assert lods["fit"].fitted is True
    assert 0 < lods["fit"].m < 4
    # measured there in pictures of another size: 1 %
    assert around["fit"] == pytest.approx(wanted, rel=0.01)
    # its law is that of leaves, and knows nothing of cards that are seen at an angle
    assert around[0.0] < around["optical"] < wanted
    assert (lods["optical"].m, lods["optical"].fitted) == (None, None)


def test_views_bake_only_what_they_show(plant):
    cameras = tl.orbit(plant, count=8, distance=10, size=(64, 64))[:2]  # azimuths 0 and 45
    kwargs = {"slicing_count": 6, "slice_count": 3, "resolution": 256}
    lod = tl.Slicings.build(plant, views=cameras, **kwargs)
    assert lod.params["views"] == 2
    # the orbit's centre is the plant's, so azimuth 0 may lie a hair off the first slicing
    assert lod.baked[:2] == [True, True]
    assert sum(lod.baked) <= 3
    widths = [texture.levels[0].shape[1] for texture in lod.textures]
    assert max(widths) < 64, "no more texels than the nearest view has pixels"
    for camera in cameras:
        assert tl.render(lod, camera).color.any()
    away = tl.Camera.perspective((0, 0, -20), (0, 0, 0), size=SIZE)
    with pytest.raises(ValueError, match="needs slicing 3"):
        tl.render(lod, away)
    with pytest.raises(ValueError, match="views is empty"):
        tl.Slicings.build(plant, views=[], **kwargs)
    with pytest.raises(ValueError, match="fit"):
        tl.Slicings.build(plant, views=cameras, correction="fit", **kwargs)


def test_large_leaves_are_cut_or_stay_a_mesh():
    long = ((0, 0, 0), (0.05, 0, 1.0), (0, 0.3, 0))
    plant = crown([facing(-1, 0.5, -1, 0.1), long, facing(1, -0.5, 1, 0.1)], trunk=True)
    kwargs = {"slicing_count": 4, "slice_count": 5, "resolution": 32}
    cut, kept = (
        tl.Slicings.build(plant, large_leaves=choice, **kwargs) for choice in ("split", "mesh")
    )
    assert cut.footprint.triangles == 4
    assert kept.footprint.triangles == 6
    assert cut.large_leaf_count == kept.large_leaf_count == 2, "seen along +z and along -z"
    camera = tl.Camera.orthographic((9, 0, 0), (0, 0, 0), height=4, size=(64, 64))
    ids = tl.render(kept, camera, outputs=("ids",)).ids
    assert {6, 7} <= set(np.unique(ids).tolist()), "wood has 0 to 3, the first leaf 4 and 5"
    full = tl.render(tl.FullMesh.build(plant), camera).color[..., 3].mean()
    for lod in (cut, kept):
        # the small leaves are edge on; a texel's half width of blur at the long one's outline
        assert tl.render(lod, camera).color[..., 3].mean() == pytest.approx(full, abs=0.01)


@pytest.mark.parametrize("count", [4, 5, 6, 12])
def test_slicings_on_the_sphere_are_seen_from_everywhere(plant, count):
    lod = tl.Slicings.build(
        plant, orientations="sphere", slicing_count=count, slice_count=3, resolution=32
    )
    rng = np.random.default_rng(3)
    full = tl.FullMesh.build(plant)
    for toward in [(0, 1, 0), (0, -1, 0), *rng.normal(size=(6, 3))]:
        eye = 9 * np.array(toward) / np.linalg.norm(toward)
        camera = tl.Camera.perspective(eye, (0, 0, 0), fov_y_deg=30, size=(48, 48))
        frame = tl.render(lod, camera)
        assert 3 <= frame.stats.cards <= 9
        assert frame.color[..., 3].max() <= 1 + 1e-6
        alphas = [f.color[..., 3].mean() for f in (frame, tl.render(full, camera))]
        # cards of four directions are seen at up to 70 degrees, a third of their width
        assert 0.3 * alphas[1] < alphas[0] < 1.1 * alphas[1]


def test_given_orientations(plant):
    kwargs = {"slice_count": 2, "resolution": 16}
    above = tl.Slicings.build(plant, orientations=[(0, 5, 0)], **kwargs)
    down = tl.Camera.orthographic((0, 9, 0), (0, 0, 0), height=4, size=(32, 32))
    assert tl.render(above, down).color[..., 3].max() > 0.5
    uneven = tl.Slicings.build(plant, orientations=[(1, 0, 0), (0, 0, 2)], **kwargs)
    assert uneven.params["slicing_count"] == 2
    assert uneven.params["orientations"] == [[1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]
    cube = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    assert tl.Slicings.build(plant, orientations=cube, **kwargs).footprint.cards == 16


HEMISPHERE = [(1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1), (0, 1, 0)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"slicing_count": 0}, "slicing_count"),
        ({"slicing_count": 10**6}, "slicing_count"),
        ({"slice_count": 0}, "slice_count"),
        ({"slice_count": -3}, "slice_count"),
        ({"slice_count": 10**6}, "slice_count"),
        ({"resolution": 0}, "resolution"),
        ({"resolution": 10**6}, "resolution"),
        ({"resolution": (16, 0)}, "resolution"),
        ({"resolution": (16, 16, 16)}, "resolution"),
        ({"resolution": 16384}, "resolution"),
        ({"resolution": 8192}, "resolution"),
        ({"samples": 0}, "samples"),
        ({"samples": 2}, "samples"),
        ({"samples": 10**9}, "samples"),
        ({"correction": -1}, "correction"),
        ({"correction": np.nan}, "correction"),
        ({"correction": "automatic"}, "correction"),
        ({"large_leaves": "drop"}, "large_leaves"),
        ({"format": "dxt1"}, "format"),
        ({"orientations": "cube"}, "orientations"),
        ({"orientations": "sphere", "slicing_count": 3}, "slicing_count"),
        ({"orientations": [(0, 0)]}, "orientations"),
        ({"orientations": np.empty((0, 3))}, "orientations"),
        ({"orientations": [(0, 0, 0)]}, "orientations"),
        ({"orientations": [(0, 0, np.nan)]}, "orientations"),
        ({"orientations": [(1, 0, 0), (2, 0, 0)]}, "orientations"),
        ({"orientations": [(1, 0, 0), (0, 1, 0)]}, "orientations"),
        ({"orientations": HEMISPHERE}, "orientations"),
        ({"threads": 0}, "threads"),
        ({"slice_count": ()}, "slice_count is empty"),
        ({"slice_count": (3, 5)}, "slice_count: must fall"),
        ({"slice_count": (5, 3), "level_error_px": -1}, "level_error_px"),
        ({"slice_count": (5, 3), "level_distances": (1, 2)}, "level_distances"),
        ({"vertical": True, "orientations": "sphere"}, "vertical"),
        ({"mirrored": True, "slicing_count": 5}, "mirrored"),
        ({"drop_back": 5}, "drop_back"),
        ({"drop_back": -1}, "drop_back"),
        ({"sub_slices": 0}, "sub_slices"),
        ({"sub_slices": 100}, "sub_slices"),
        ({"quadtree": 24}, "quadtree"),
        ({"quadtree": 8}, "quadtree"),
        ({"quadtree": 64, "resolution": 100}, "resolution"),
        ({"branch_level": 1}, "branch_level"),
        ({"branch_level": 1, "vertical": True}, "vertical: .* only one slicing"),
        ({"branch_level": 1, "sub_slices": 2}, "sub_slices: .* only one slicing"),
        ({"sub_slices": 64, "slice_count": 65, "slicing_count": 4}, "sub_slices needs 1064960"),
    ],
)
def test_bad_arguments_are_named(plant, arguments, message):
    with pytest.raises(ValueError, match=message):
        tl.Slicings.build(plant, **arguments)


def test_arguments_of_another_kind_are_refused(plant):
    for arguments in ({"slice_count": 2.5}, {"resolution": 64.0}, {"samples": None}):
        with pytest.raises(TypeError):
            tl.Slicings.build(plant, **arguments)


def test_a_plant_without_leaves_has_no_slices():
    wood, _ = quads([facing(0, 0, 0, 1)])
    with pytest.raises(ValueError, match="foliage is empty"):
        tl.Slicings.build(tl.Plant.from_arrays(wood=wood))


def test_leaves_without_area_are_an_empty_picture():
    plant = crown([((0, 0, 0), (0, 0, 0), (0, 0, 0)), ((1, 0, 0), (1, 0, 0), (0, 0, 0))])
    for correction in (0.5, "fit", "optical"):
        lod = tl.Slicings.build(plant, resolution=8, correction=correction)
        assert lod.footprint.cards == 0
        camera = tl.Camera.perspective((0, 0, 5), (0, 0, 0), size=SIZE)
        frame = tl.render(lod, camera)
        assert not frame.color.any()
        assert np.isinf(frame.depth).all()


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_size_does_not_matter(scale):
    def at(scale):
        leaves, colors = random_leaves(60)
        scaled = [tuple(np.multiply(part, scale) for part in leaf) for leaf in leaves]
        lod = tl.Slicings.build(crown(scaled, colors), slice_count=3, resolution=32)
        eye = np.array([2, 1, 5]) * scale
        return tl.render(lod, tl.Camera.perspective(eye, (0, 0, 0), size=SIZE)).color

    # rounding moves an edge across a sample here and there
    assert (np.abs(at(scale) - at(1.0)).max(axis=2) > 0.02).mean() < 0.01


def test_a_build_says_where_it_is_from_another_thread_too(plant):
    # progress comes from the caller's thread and may stop the build
    class EnoughError(Exception):
        pass

    def stop(done, total):
        raise EnoughError

    with pytest.raises(EnoughError):
        tl.Slicings.build(plant, slicing_count=64, resolution=256, progress=stop)


def test_memory_is_refused_before_it_is_used():
    # in a process of its own with little memory to spare
    code = """
        import resource, treelod as tl
        plant = tl.grow_plant("chestnut", leaf_count=50)
        resource.setrlimit(resource.RLIMIT_AS, (resource.getpagesize() * 2**20,) * 2)
        try:
            tl.Slicings.build(plant, slicing_count=4096, slice_count=4096, resolution=256)
        except tl.LimitError as error:
            print(error)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={**os.environ, "TREELOD_NUM_THREADS": "2"},
    )
    assert done.stdout.startswith("resolution needs 1099511627776 texels")


# Options


def test_levels_are_chosen_by_pixels_and_by_distance(plant):
    kwargs = {"slicing_count": 4, "resolution": 128, "samples": 4}
    lod = tl.Slicings.build(plant, slice_count=(5, 3, 1), level_error_px=4, **kwargs)
    assert lod.params["slice_count"] == (5, 3, 1)
    assert [level.slice_count for level in lod.levels] == [5, 3, 1]
    # a crown 2.4 m deep, seen at up to 45 degrees
    expected = [2.4 / n / 2 * np.sin(np.pi / 4) for n in (5, 3, 1)]
    np.testing.assert_allclose([level.error for level in lod.levels], expected, rtol=1e-6)

    def cards(lod, distance):
        camera = tl.Camera.perspective((0, 0, distance), (0, 0, 0), fov_y_deg=45, size=(64, 64))
        return tl.render(lod, camera, outputs=("color",)).stats.cards

    assert [cards(lod, distance) for distance in (5, 12, 40)] == [5, 3, 1]
    stated = tl.Slicings.build(plant, slice_count=(5, 3), level_distances=10, **kwargs)
    radius = np.linalg.norm(np.array(plant.bounds), axis=1).max()
    assert [cards(stated, r * radius) for r in (8, 12)] == [5, 3]
    single = tl.Slicings.build(plant, slice_count=5, **kwargs).footprint.texture_bytes
    assert single < lod.footprint.texture_bytes < 1.3 * single, "coarse levels have few texels"


def test_options_save_bytes(plant):
    kwargs = {"slicing_count": 4, "slice_count": 3, "resolution": 128}
    plain = tl.Slicings.build(plant, **kwargs)
    mirrored = tl.Slicings.build(plant, mirrored=True, **kwargs)
    assert mirrored.footprint.texture_bytes * 2 == plain.footprint.texture_bytes
    assert mirrored.baked == [True] * 4
    squares = tl.Slicings.build(plant, quadtree=16, **kwargs)
    assert squares.footprint.texture_bytes == sum(
        level.shape[0] * level.shape[1] * 4 for t in squares.textures for level in t.levels
    )
    # every texel of a square is that of the whole picture at the same place
    whole = {t.name: t for t in plain.textures}
    square = next(t for t in squares.textures if t.name == "slicing 1, slice 1, square 0")
    texture = whole["slicing 1, slice 1"]
    corner, right, _, top = texture.corners
    offset = square.corners[3] - top
    width, height = np.linalg.norm(right - corner), np.linalg.norm(top - corner)
    x = round(offset @ (right - corner) / width**2 * 128)
    y = round(-offset @ (top - corner) / height**2 * 128)
    side = square.levels[0].shape[0]
    rows, columns = (np.clip(np.arange(at, at + side), 0, 127) for at in (y, x))
    np.testing.assert_array_equal(square.levels[0], texture.levels[0][np.ix_(rows, columns)])


def test_a_vertical_slicing_shows_the_crown_from_above(plant):
    kwargs = {"resolution": 64, "slice_count": 3}
    down = tl.Camera.orthographic((0, 9, 0), (0, 0, 0), height=4, size=(64, 64))
    full = tl.render(tl.FullMesh.build(plant), down).color[..., 3].mean()
    alphas = [
        tl.render(tl.Slicings.build(plant, vertical=vertical, **kwargs), down).color[..., 3].mean()
        for vertical in (False, True)
    ]
    assert alphas[0] == 0, "cards seen edge on"
    assert alphas[1] == pytest.approx(full, abs=0.01)


def test_branches_of_a_grown_plant():
    plant = tl.grow_plant("chestnut", leaf_count=800)
    lod = tl.Slicings.build(plant, branch_level=1, slice_count=3, resolution=64)
    assert lod.part_count == 57
    names = {t.name.split(",")[0] for t in lod.textures if t.corners is not None}
    assert len(names) == lod.part_count
    assert all(name.startswith("branch ") for name in names)
    mesh = tl.FullMesh.build(plant)
    for camera in tl.orbit(plant, elevation_deg=20, size=(64, 64)):
        full, found = (tl.render(shown, camera).color[..., 3].mean() for shown in (mesh, lod))
        # branches seen edge on: measured are 0.808 to 0.852 of the coverage
        assert found / full == pytest.approx(0.83, abs=0.03)


def test_slices_lean_in_the_wind_and_stay_at_the_foot(plant):
    lod = tl.Slicings.build(plant, slicing_count=4, slice_count=3, resolution=32)
    camera = tl.Camera.orthographic((0, 0, 9), (0, 0, 0), height=4, size=(80, 80))
    wind = tl.Wind(sway=0.0, lean=0.25, azimuth_deg=90)
    still = tl.render(tl.Scene([(lod, None)]), camera).color[..., 3]
    leaning = tl.render(tl.Scene([(lod, None)], wind=wind), camera).color[..., 3]
    foot = plant.bounds[0][1]
    for row in (20, 40, 55):
        height = 2 - (row + 0.5) / 20 - foot
        shift = height * 0.25 * 20
        moved = np.interp(np.arange(80) - shift, np.arange(80), still[row])
        # moved by a part of a pixel, where edges are sharp
        assert np.abs(moved - leaning[row]).mean() < 0.05
        assert np.abs(still[row] - leaning[row]).mean() > np.abs(moved - leaning[row]).mean()
