"""Octahedral impostors through the public face: against the full mesh, and a twin in NumPy."""

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, quads, random_crown
from treelod.color import linear_from_srgb

SIZE = (40, 30)


@pytest.fixture(scope="module")
def plant():
    return random_crown()


@pytest.fixture(scope="module")
def lod(plant):
    return tl.OctahedralImpostor.build(
        plant, frame_count=5, resolution=32, drawing="blend", depth_bits=16
    )


# A twin: the definition, one line a step, in float64


def square_of(direction, *, hemisphere):
    """Where a direction lies on the square of the octahedral map."""
    x, y, z = direction
    if hemisphere:
        x, _, z = np.array([x, max(y, 0.0), z]) / (abs(x) + max(y, 0.0) + abs(z))
        return np.array([x + z, x - z])
    x, y, z = np.array([x, y, z]) / (abs(x) + abs(y) + abs(z))
    if y >= 0:
        return np.array([x, z])
    return np.array([(1 - abs(z)) * np.sign(x), (1 - abs(x)) * np.sign(z)])


def triangle_of(direction, side, *, hemisphere):
    """Frames around a direction with their weights, by solving for barycentric coordinates."""
    at = (square_of(direction, hemisphere=hemisphere) + 1) / 2 * (side - 1)
    u, v = np.clip(np.floor(at), 0, side - 2).astype(int)
    third = (u + 1, v) if at[0] - u >= at[1] - v else (u, v + 1)
    corners = [(u, v), third, (u + 1, v + 1)]
    matrix = np.vstack([np.array(corners, float).T, np.ones(3)])
    weights = np.linalg.solve(matrix, [*at, 1.0])
    return {v * side + u: w for (u, v), w in zip(corners, weights, strict=True) if w > 1e-9}


def same_direction(frame, side):
    """Which frames of the unfolded octahedron have the direction of one, by its coordinates."""
    u, v = np.meshgrid(np.arange(side), np.arange(side))
    on_rim = (u % (side - 1) == 0) | (v % (side - 1) == 0)
    a, b = frame % side, frame // side
    mirrored = (u == a) & (v == side - 1 - b) & (a in (0, side - 1))
    mirrored |= (v == b) & (u == side - 1 - a) & (b in (0, side - 1))
    corner = (u % (side - 1) == 0) & (v % (side - 1) == 0)
    same = (u == a) & (v == b)
    if corner.ravel()[frame]:
        same |= corner
    return (same | (mirrored & on_rim)).ravel()


def bilinear(level, uv):
    """Values of a level between its texels, clamped at its edges."""
    height, width = level.shape[:2]
    at = uv * [width, height] - 0.5
    low = np.floor(at).astype(int)
    share = at - low
    x0, x1 = (np.clip(low[..., 0] + step, 0, width - 1) for step in (0, 1))
    y0, y1 = (np.clip(low[..., 1] + step, 0, height - 1) for step in (0, 1))
    top = level[y0, x0] * (1 - share[..., :1]) + level[y0, x1] * share[..., :1]
    bottom = level[y1, x0] * (1 - share[..., :1]) + level[y1, x1] * share[..., :1]
    return top * (1 - share[..., 1:]) + bottom * share[..., 1:]


def premultiplied(texels):
    alpha = texels[..., 3:] / 255
    return np.concatenate([linear_from_srgb(texels[..., :3] / 255.0) * alpha, alpha], axis=-1)


def twin(plant, lod, camera, steps, tolerance=None):
    """Blended colours of a parallel camera's pixels, from level 0 of the atlas."""
    color, depth = lod.textures[:2]
    colors = premultiplied(color.levels[0].astype(float))
    codes = depth.levels[0].astype(float)
    depths = ((codes[..., 0] * 256 + codes[..., 1]) / 65535)[..., np.newaxis]
    width, height = camera.size
    eye, target, up = (np.array(v, float) for v in (camera.eye, camera.target, camera.up))
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    pixel = camera.height / height
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x, y = (x - width / 2) * pixel, (height / 2 - y) * pixel
    rays = target + x[..., np.newaxis] * right + y[..., np.newaxis] * np.cross(back, right)
    from_center = rays - lod.center
    # where rays enter and leave the box around the plant, a texel larger than it
    texel = 2 * lod.radius / lod.params["resolution"]
    half = (plant.bounds[1] - plant.bounds[0]) / 2 + texel + 1e-5 * lod.radius
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([(half - from_center) / -back, (-half - from_center) / -back])
    near = np.nanmax(sides.min(axis=0), axis=-1)
    far = np.nanmin(sides.max(axis=0), axis=-1)
    side, hemisphere = lod.params["frame_count"], lod.params["hemisphere"]
    mixed = triangle_of(back, side, hemisphere=hemisphere)
    total, trusted = np.zeros((height, width, 4)), np.zeros((height, width, 1))
    for corner, weight in mixed.items():
        frame = corner if hemisphere else min(np.flatnonzero(same_direction(corner, side)))
        toward, across, upward = (
            getattr(lod.frames, name)[frame] for name in ("toward", "right", "up")
        )
        cosine = back @ toward
        # metres along the ray, away from the viewer
        along = (from_center @ toward) / cosine
        along = np.clip(along, near, np.maximum(near, far)) if steps else along
        for step in range(steps + 1):
            point = from_center - along[..., np.newaxis] * back
            shares = np.stack([point @ across, -(point @ upward)], -1) / (2 * lod.radius) + 0.5
            uv = lod.frames.corner[frame] + np.clip(shares, 0, 1) * lod.frames.size[frame]
            offset = (bilinear(depths, uv)[..., 0] * 2 - 1) * lod.radius
            if step == steps:
                break
            along = (from_center @ toward - offset) / cosine
        inside = ((shares >= 0) & (shares <= 1)).all(-1) & (near <= far)
        # how far the ray's point is from the depth that is stored there
        off = np.abs(point @ toward - offset) / lod.radius
        trust = 1 / (1 + (off / tolerance) ** 2) if steps and tolerance else np.ones_like(off)
        trust = np.where(inside, trust, 1)[..., np.newaxis] * weight
        total += np.where(inside[..., np.newaxis], bilinear(colors, uv) * trust, 0)
        trusted += trust
    return total / trusted


def parallel(toward, lod, *, size=(64, 64)):
    toward = np.array(toward, float) / np.linalg.norm(toward)
    return tl.Camera.orthographic(
        tuple(lod.center + 20 * toward),
        tuple(lod.center),
        # texels of 1/16 of the ball and pixels of 1/36: level 0 is read
        height=2 * lod.radius * 64 / 72,
        size=size,
    )


DIRECTIONS = [(0.3, 0.5, 1.0), (-1.0, 0.05, 0.2), (0.1, 2.0, -0.3), (1.0, 0.7, -0.9)]


def close_share(found, wanted):
    """Share of pixels that agree within rounding."""
    return (np.abs(found - wanted).max(-1) < 2e-4).mean()


@pytest.mark.parametrize(
    ("steps", "tolerance"), [(0, 0.05), (1, 0.2), (2, None), (2, 0.05), (1, 0.05)]
)
@pytest.mark.parametrize("hemisphere", [True, False])
def test_the_picture_is_the_twins(plant, steps, tolerance, hemisphere):
    lod = tl.OctahedralImpostor.build(
        plant,
        frame_count=5,
        hemisphere=hemisphere,
        resolution=32,
        drawing="blend",
        depth_bits=16,
        parallax_steps=steps,
        depth_tolerance=tolerance,
    )
    below = [] if hemisphere else [(0.4, -1.0, 0.3)]
    for toward in DIRECTIONS + below:
        camera = parallel(toward, lod)
        frame = tl.render(lod, camera, samples=1)
        wanted = twin(plant, lod, camera, steps, tolerance)
        assert wanted[..., 3].mean() > 0.1
        # f32 against f64 moves a point across the edge of a frame or of the box here and there
        assert close_share(frame.color, wanted) > 0.998
        more = twin(plant, lod, camera, steps + 1, tolerance)
        for wrong in (np.roll(wanted, 1, axis=1), more):
            assert close_share(frame.color, wrong) < 0.7


@pytest.mark.parametrize("hemisphere", [True, False])
def test_frames_and_weights_are_the_twins(plant, hemisphere):
    lod = tl.OctahedralImpostor.build(plant, frame_count=6, hemisphere=hemisphere, resolution=4)
    rng = np.random.default_rng(5)
    seen = set()
    for toward in rng.normal(size=(60, 3)):
        if hemisphere:
            toward[1] = abs(toward[1])
        found = lod.mixed(parallel(toward, lod))
        wanted = triangle_of(toward, 6, hemisphere=hemisphere)
        summed = {}
        for frame, weight in wanted.items():
            # on the rim of the unfolded octahedron frames of equal directions stand for one another
            first = frame if hemisphere else min(np.flatnonzero(same_direction(frame, 6)))
            summed[first] = summed.get(first, 0) + weight
        assert sum(found.values()) == pytest.approx(1)
        for frame, weight in summed.items():
            assert found[frame] == pytest.approx(weight, abs=1e-9)
        seen |= found.keys()
    assert len(seen) > 20


# Against the full mesh


def test_from_a_frames_direction_it_is_the_mesh_at_the_frames_resolution(plant, lod):
    # straight from +z, which is a corner of the grid, with a pixel for each texel
    eye = lod.center + np.array([0, 0, 9])
    camera = tl.Camera.orthographic(
        tuple(eye), tuple(lod.center), height=2 * lod.radius, size=(32, 32)
    )
    assert lod.mixed(camera) == {4: 1.0}
    full = tl.render(tl.FullMesh.build(plant), camera, samples=16)
    frame = tl.render(lod, camera, samples=1)
    # half a code of sRGB is at most 0.0045 in linear light, half a step of alpha 0.002
    assert np.abs(frame.color - full.color).max() < 0.0066
    assert 0.1 < full.color[..., 3].mean() < 0.9


def test_layers_are_kept_and_counted(plant):
    def build(**params):
        return tl.OctahedralImpostor.build(plant, frame_count=5, resolution=64, **params)

    baked, relit = build(), build(shading="relit")
    names = [texture.name.split(":")[0] for texture in baked.textures]
    assert names == ["color", "depth"]
    assert [texture.name.split(":")[0] for texture in relit.textures] == [
        "albedo",
        "depth",
        "normal, and the share of leaves in alpha",
    ]
    count = sum(level.shape[0] * level.shape[1] for level in baked.textures[0].levels)
    assert baked.footprint.texture_bytes == 5 * count
    assert relit.footprint.texture_bytes == 9 * count
    assert build(depth_bits=16, format="rgb5a1").footprint.texture_bytes == 4 * count
    assert build(format="rgb5a1", shading="relit").footprint.texture_bytes == 7 * count


def test_kept_albedo_and_normals_are_the_meshs(plant):
    camera = tl.Camera.perspective((1, 2, 6), (0, 0, 0), size=(120, 90))

    def drawn(lod):
        frame = tl.render(lod, camera, samples=4, outputs=("color", "albedo", "normal"))
        lengths = np.linalg.norm(frame.normal, axis=-1, keepdims=True)
        return frame, frame.normal / np.maximum(lengths, 1e-6)

    baked, relit = (
        drawn(tl.OctahedralImpostor.build(plant, frame_count=9, resolution=128, shading=shading))
        for shading in ("baked", "relit")
    )
    np.testing.assert_array_equal(baked[0].albedo, baked[0].color)
    full = drawn(tl.FullMesh.build(plant))
    there = (full[0].color[..., 3] == 1) & (relit[0].color[..., 3] > 0.9)
    assert there.sum() > 200
    errors = [
        (
            np.abs(frame.albedo - full[0].albedo)[there].mean(),
            np.arccos(np.clip((normal * full[1]).sum(-1), -1, 1))[there].mean(),
        )
        for frame, normal in (relit, baked)
    ]
    assert errors[0][0] < 0.4 * errors[1][0]
    assert errors[0][1] < 0.4 * errors[1][1]


EVENING = tl.Lighting(sun_direction=(-0.8, 0.3, 0.2), sun=(1.0, 0.4, 0.1), sky=(0.1, 0.1, 0.3))


def test_light_changes_without_a_bake(plant):
    def build(plant, shading):
        return tl.OctahedralImpostor.build(plant, frame_count=5, resolution=64, shading=shading)

    camera = tl.Camera.perspective((1, 2, 6), (0, 0, 0), size=SIZE)
    evening = plant.lit(EVENING)
    lod = build(plant, "relit")
    late = lod.relit(EVENING)
    frames = [tl.render(shown, camera, samples=4) for shown in (late, build(evening, "relit"))]
    np.testing.assert_array_equal(frames[0].color, frames[1].color)
    assert late.footprint == lod.footprint
    assert late.params == lod.params
    # one that was baked in the evening is near, and noon is not
    right = tl.render(build(evening, "baked"), camera, samples=4).color
    errors = [
        np.abs(tl.render(shown, camera, samples=4).color - right).mean() for shown in (late, lod)
    ]
    assert errors[0] < 0.25 * errors[1]
    with pytest.raises(ValueError, match="shading"):
        build(plant, "baked").relit(EVENING)
    with pytest.raises(ValueError, match="occlusion"):
        lod.relit(tl.Lighting(occlusion=0.5))
    with pytest.raises(ValueError, match="shading"):
        build(plant.lit(tl.Lighting(occlusion=0.5)), "relit")


def test_from_below_the_upper_half_shows_the_horizon(plant, lod):
    for level, below in [((3, 0, 4), (3, -9, 4)), ((-1, 0, 0), (-1, -2, 0))]:
        assert lod.mixed(parallel(below, lod)) == pytest.approx(lod.mixed(parallel(level, lod)))


@pytest.mark.parametrize("blend", ["three", "nearest"])
def test_from_below_the_upper_half_thins_out_and_vanishes(plant, blend):
    half, whole = (
        tl.OctahedralImpostor.build(plant, frame_count=side, resolution=32, blend=blend, **kind)
        for side, kind in ((5, {}), (9, {"hemisphere": False}))
    )
    full = tl.FullMesh.build(plant)
    down = np.radians([0, 50, 70, 80, 88])
    toward = np.stack([0.6 * np.cos(down), -np.sin(down), 0.8 * np.cos(down)], axis=1)
    cameras = [parallel(direction, half) for direction in toward]
    # straight down, the picture needs an up of its own
    eye = half.center - [0, 20, 0]
    below = [
        tl.Camera.orthographic(
            tuple(eye), tuple(half.center), height=2 * half.radius, size=(64, 64), up=up
        )
        for up in ((0, 0, 1), (1, 0, 0), (1, 0, 1))
    ]

    def shares(lod, cameras):
        """Covered by an impostor, as shares of what the mesh covers."""
        alphas = [
            [tl.render(each, camera, samples=4).color[..., 3].mean() for camera in cameras]
            for each in (lod, full)
        ]
        return np.divide(*alphas)

    found = shares(half, cameras)
    assert found[0] > 0.9
    assert (np.diff(found) < 0).all(), "thinner and thinner"
    assert found[-1] < 0.1
    for camera in below:
        frame = tl.render(half, camera, samples=4)
        assert not frame.color.any()
        assert np.isinf(frame.depth).all()
    # the control: the whole sphere has frames from there
    assert (shares(whole, [*cameras, *below]) > 0.7).all()
    # an eye near by sees the plant at angles, and of some of it a little
    near = tl.Camera.perspective(
        tuple(half.center - [0, 3 * half.radius, 0]), tuple(half.center), size=SIZE, up=(1, 0, 0)
    )
    assert shares(half, [near]) < 0.5


def test_threads_give_the_same_bytes(plant):
    one, two = (
        tl.OctahedralImpostor.build(plant, frame_count=4, resolution=24, threads=threads)
        for threads in (1, 2)
    )
    for a, b in zip(one.textures, two.textures, strict=True):
        for first, second in zip(a.levels, b.levels, strict=True):
            np.testing.assert_array_equal(first, second)


def test_progress_counts_frames(plant):
    calls = []
    tl.OctahedralImpostor.build(
        plant, frame_count=4, resolution=8, progress=lambda done, total: calls.append((done, total))
    )
    assert calls[-1] == (16, 16)


def test_known_views_bake_what_they_see(plant):
    cameras = tl.orbit(plant, count=3, elevation_deg=10, distance=30, size=SIZE)
    lod = tl.OctahedralImpostor.build(plant, frame_count=8, resolution=128, views=cameras)
    seen = set().union(*(lod.mixed(camera) for camera in cameras))
    assert {frame for frame, baked in enumerate(lod.baked) if baked} == seen
    assert len(seen) <= 9
    whole = tl.OctahedralImpostor.build(plant, frame_count=8, resolution=128)
    assert lod.footprint.texture_bytes < 0.05 * whole.footprint.texture_bytes
    assert np.isnan(lod.frames.toward).any(axis=1).sum() == 64 - len(seen)
    for camera in cameras:
        assert tl.render(lod, camera).color.any()
    other = tl.orbit(plant, count=1, elevation_deg=80, distance=30, size=SIZE)[0]
    with pytest.raises(ValueError, match="camera: this camera needs frame"):
        tl.render(lod, other)


def test_a_plant_of_one_leaf_or_wood_alone_has_a_picture():
    trunk, _ = quads([facing(0, 0, 0, 1)])
    for plant in (crown([facing(0, 0, 0, 1)]), tl.Plant.from_arrays(wood=trunk)):
        lod = tl.OctahedralImpostor.build(plant, frame_count=3, resolution=32)
        camera = tl.Camera.orthographic((0, 0, 9), (0, 0, 0), height=4, size=(64, 64))
        # a square of 2 m in 4 m
        assert tl.render(lod, camera).color[..., 3].mean() == pytest.approx(0.25, abs=0.01)
    with pytest.raises(ValueError, match="foliage is empty"):
        tl.OctahedralImpostor.build(tl.Plant.from_arrays(wood=trunk), wood=False)


@pytest.mark.parametrize(
    ("params", "error", "match"),
    [
        ({"frame_count": 1}, ValueError, "frame_count"),
        ({"frame_count": 65}, ValueError, "frame_count"),
        ({"frame_count": 2, "hemisphere": False}, ValueError, "frame_count"),
        ({"frame_count": 65, "hemisphere": False}, ValueError, "frame_count"),
        ({"frame_count": 3.5}, TypeError, "frame_count"),
        ({"resolution": 0}, ValueError, "resolution"),
        ({"resolution": 16385}, ValueError, "resolution"),
        ({"resolution": 8193}, tl.LimitError, "resolution"),
        ({"resolution": 961}, tl.LimitError, "resolution"),
        ({"frame_count": 64, "resolution": 121}, tl.LimitError, "resolution"),
        ({"frame_count": 3, "hemisphere": False, "resolution": 3201}, tl.LimitError, "resolution"),
        ({"samples": 3}, ValueError, "samples"),
        ({"blend": "four"}, ValueError, "blend"),
        ({"drawing": "tested"}, ValueError, "drawing"),
        ({"drawing": 3}, TypeError, "drawing"),
        ({"drawing": "test", "cutoff": float("nan")}, ValueError, "cutoff"),
        ({"drawing": "test", "cutoff": 0.0}, ValueError, "cutoff"),
        ({"drawing": "coverage", "cutoff": float("nan")}, ValueError, "cutoff"),
        ({"drawing": "coverage", "cutoff": 0.0039}, ValueError, "cutoff"),
        ({"drawing": "blend", "cutoff": 1.001}, ValueError, "cutoff"),
        ({"parallax_steps": -1}, ValueError, "parallax_steps"),
        ({"parallax_steps": 65}, ValueError, "parallax_steps"),
        ({"depth_tolerance": 0.0}, ValueError, "depth_tolerance"),
        ({"depth_tolerance": "far"}, TypeError, "depth_tolerance"),
        ({"depth_bits": 12}, ValueError, "depth_bits"),
        ({"shading": "lit"}, ValueError, "shading"),
        ({"shading": None}, TypeError, "shading"),
        ({"format": "png"}, ValueError, "format"),
        ({"views": []}, ValueError, "views"),
        ({"hemisphere": "yes"}, TypeError, "hemisphere"),
        ({"wood_triangle_count": 0}, ValueError, "wood_triangle_count"),
        ({"threads": 0}, ValueError, "threads"),
    ],
)
def test_bad_arguments_are_refused_by_name(plant, params, error, match):
    with pytest.raises(error, match=match):
        tl.OctahedralImpostor.build(plant, **params)


@pytest.mark.parametrize(
    ("params", "frames"),
    [
        ({"frame_count": 2}, 4),
        ({"frame_count": 64}, 64**2),
        ({"frame_count": 3, "hemisphere": False}, 6),
        ({"frame_count": 64, "hemisphere": False}, 63**2),
        ({"frame_count": 2, "drawing": "test", "cutoff": 1 / 255}, 4),
        ({"frame_count": 2, "drawing": "blend", "cutoff": 1.0}, 4),
        ({"frame_count": 2, "parallax_steps": 0}, 4),
        ({"frame_count": 2, "parallax_steps": 64}, 4),
        ({"frame_count": 2, "depth_tolerance": 1e-6}, 4),
        ({"frame_count": 2, "depth_tolerance": 1e6}, 4),
    ],
)
def test_the_ends_of_ranges_are_taken(params, frames):
    lod = tl.OctahedralImpostor.build(random_crown(20), resolution=1, samples=1, **params)
    assert sum(lod.baked) == frames


def test_as_many_texels_as_one_frame_could_have_may_be_asked_for():
    plant = random_crown(20)
    far = tl.Camera.perspective((0, 0, 400), (0, 0, 0), size=SIZE)
    lod = tl.OctahedralImpostor.build(plant, resolution=8192, views=[far])
    assert lod.textures[0].levels[0].size < 1000
    near = tl.Camera.perspective((0, 0, 3), (0, 0, 0), size=(8000, 8000))
    with pytest.raises(tl.LimitError, match="resolution"):
        tl.OctahedralImpostor.build(plant, resolution=8192, views=[near])
