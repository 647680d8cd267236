"""Pictures through the public face: their planes, their numbers, and what is refused."""

import dataclasses
import io
import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from PIL import Image

import treelod as tl
from made_plants import crown, facing, random_crown
from treelod.color import quantize, srgb_from_linear
from treelod.render import EMPTY_ID, OUTPUTS

SIZE = (48, 32)
CAMERA = tl.Camera.perspective((1.5, 0.5, 5), (0, -0.5, 0), size=SIZE)


@pytest.fixture(scope="module")
def plant():
    return random_crown(trunk=True)


@pytest.fixture(scope="module")
def mesh(plant):
    return tl.FullMesh.build(plant)


@pytest.fixture(scope="module")
def slicings(plant):
    return tl.Slicings.build(plant, slicing_count=4, slice_count=3, resolution=32)


def test_every_plane_has_its_shape_and_type(mesh):
    frame = tl.render(mesh, CAMERA, outputs=OUTPUTS)
    expected = {
        "color": ((32, 48, 4), np.float32),
        "depth": ((32, 48), np.float32),
        "ids": ((32, 48), np.uint32),
        "normal": ((32, 48, 3), np.float32),
        "albedo": ((32, 48, 4), np.float32),
        "color8": ((32, 48, 4), np.uint8),
    }
    assert set(expected) == set(OUTPUTS)
    for name, (shape, dtype) in expected.items():
        plane = getattr(frame, name)
        assert (plane.shape, plane.dtype) == (shape, dtype), name
        assert plane.flags.c_contiguous, name
    assert frame.camera is CAMERA
    assert repr(frame) == "Frame(48 x 32, color, depth, ids, normal, albedo, color8)"


def test_planes_that_were_not_asked_for_are_none(mesh):
    assert repr(tl.render(mesh, CAMERA)) == "Frame(48 x 32, color, depth)"
    whole = tl.render(mesh, CAMERA, outputs=OUTPUTS)
    for name in OUTPUTS:
        frame = tl.render(mesh, CAMERA, outputs=[name])
        planes = {other: getattr(frame, other) for other in OUTPUTS}
        assert [other for other, plane in planes.items() if plane is not None] == [name]
        np.testing.assert_array_equal(planes[name], getattr(whole, name))


def test_a_notebook_shows_the_picture_on_white(mesh):
    frame = tl.render(mesh, CAMERA)
    shown = np.asarray(Image.open(io.BytesIO(frame._repr_png_())))
    white = tl.render(mesh, CAMERA, background=(1, 1, 1)).color
    np.testing.assert_array_equal(shown, quantize(srgb_from_linear(white[..., :3])))
    assert (shown[0, 0] == 255).all(), "nothing is drawn in this corner"
    assert len(np.unique(shown)) > 2
    assert tl.render(mesh, CAMERA, outputs=["depth"])._repr_png_() is None


def test_a_square_is_where_the_camera_projects_it():
    # 2 x 2 m at z = 1 in a view of 8 x 6 m with 4 pixels a metre, seen from z = 6
    plant = crown([facing(1, 0.5, 1, 1)], [(0.2, 0.4, 0.6, 1)])
    camera = tl.Camera.orthographic((0, 0, 6), (0, 0, 0), height=6, size=(32, 24))
    frame = tl.render(tl.FullMesh.build(plant), camera, samples=4, outputs=OUTPUTS)
    inside = np.zeros((24, 32), bool)
    inside[6:14, 16:24] = True
    np.testing.assert_array_equal(frame.color[..., 3], inside)
    np.testing.assert_array_equal(frame.depth, np.where(inside, 5, np.inf).astype(np.float32))
    # two triangles of one leaf, the first of the plant
    assert set(np.unique(frame.ids[inside])) == {0, 1}
    assert (frame.ids[~inside] == EMPTY_ID).all()
    np.testing.assert_allclose(frame.normal[inside], [[0, 0, 1]] * 64, atol=1e-6)
    np.testing.assert_allclose(frame.albedo[inside], [[0.2, 0.4, 0.6, 1]] * 64, atol=1e-6)
    front = plant.foliage.mesh.front[0]
    np.testing.assert_allclose(frame.color[inside][:, :3], [front] * 64, atol=1e-6)
    assert frame.bounds_px == (16, 6, 24, 14)
    assert not frame.color[~inside].any()


def test_the_background_lies_behind_everything(mesh):
    plain = tl.render(mesh, CAMERA, outputs=("color", "albedo"))
    for background, rgba in [
        ((0.1, 0.2, 0.3), (0.1, 0.2, 0.3, 1.0)),
        ((0.1, 0.2, 0.3, 0.5), (0.1, 0.2, 0.3, 0.5)),
        (None, (0, 0, 0, 0)),
    ]:
        frame = tl.render(mesh, CAMERA, background=background, outputs=("color", "albedo"))
        for name in ("color", "albedo"):
            over = getattr(plain, name)
            expected = over + (1 - over[..., 3:]) * np.array(rgba, np.float32)
            np.testing.assert_allclose(getattr(frame, name), expected, atol=1e-6)
    assert plain.color[0, 0, 3] == 0.0, "a corner shows the background"


def test_color8_is_the_colour_in_srgb(mesh):
    frame = tl.render(mesh, CAMERA, outputs=("color", "color8"), background=(0.2, 0.1, 0.4))
    expected = quantize(srgb_from_linear(frame.color[..., :3]))
    # f32 may fall on the other side of a half code
    assert np.abs(frame.color8[..., :3].astype(int) - expected).max() <= 1
    assert (frame.color8[..., :3] == expected).mean() > 0.999
    assert (frame.color8[..., 3] == 255).all()


def test_more_samples_come_nearer_to_many(mesh):
    many = tl.render(mesh, CAMERA, samples=1024).color
    errors = [
        np.abs(tl.render(mesh, CAMERA, samples=n).color - many).mean() for n in (1, 4, 16, 64)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.15 * errors[0]


@pytest.mark.parametrize("samples", [1, 4, 17])
def test_any_number_of_threads_draws_the_same_bytes(mesh, slicings, samples):
    for subject in (mesh, slicings):
        one, four = (
            tl.render(subject, CAMERA, samples=samples, outputs=OUTPUTS, threads=threads)
            for threads in (1, 4)
        )
        assert (one.stats.threads, four.stats.threads) == (1, 4)
        for name in OUTPUTS:
            assert getattr(one, name).tobytes() == getattr(four, name).tobytes(), name


def test_stats_count_what_was_drawn(plant, mesh, slicings):
    stats = tl.render(mesh, CAMERA, samples=8, threads=2).stats
    assert (stats.triangles, stats.cards, stats.lines, stats.points) == (
        plant.triangle_count,
        0,
        0,
        0,
    )
    assert (stats.samples, stats.threads, stats.backend) == (8, 2, "cpu")
    assert stats.frame_millis == stats.emit_millis + stats.draw_millis
    assert min(stats.emit_millis, stats.draw_millis) > 0
    # every vertex is near the picture, and each is transformed once or more
    assert stats.vertices >= 4 * plant.foliage.leaf_count
    drawn = (tl.render(mesh, CAMERA, samples=8).color[..., 3] > 0).sum()
    assert stats.fragments >= drawn
    two = tl.Scene([(mesh, np.stack([np.eye(4), np.eye(4)]))])
    assert tl.render(two, CAMERA).stats.triangles == 2 * plant.triangle_count
    # between two of four slicings: two of three slices each; four wood triangles
    stats = tl.render(slicings, CAMERA).stats
    assert (stats.triangles, stats.cards) == (4, 6)
    on_axis = tl.Camera.perspective((0, 0, 5), (0, 0, 0), size=SIZE)
    assert tl.render(slicings, on_axis).stats.cards == 3


def test_fragments_count_covered_pixels():
    # 8 x 8 pixels twice, the hidden square included
    plant = crown([facing(0, 0, 0, 1), facing(0, 0, 1, 1)])
    camera = tl.Camera.orthographic((0, 0, 6), (0, 0, 0), height=4, size=(16, 16))
    stats = tl.render(tl.FullMesh.build(plant), camera, samples=1).stats
    assert stats.fragments == 2 * 8 * 8


def test_what_is_out_of_view_leaves_the_picture_empty(mesh):
    away = tl.Camera.perspective((0, 0, 5), (0, 0, 10), size=SIZE)
    frame = tl.render(mesh, away, outputs=OUTPUTS)
    assert not frame.color.any()
    assert np.isinf(frame.depth).all()
    assert (frame.ids == EMPTY_ID).all()
    left, _, right, _ = frame.bounds_px
    assert left == right
    assert frame.stats.triangles == 0, "nothing is submitted for what no camera sees"


def test_bounds_hold_everything_drawn(mesh, slicings):
    for subject in (mesh, slicings):
        for camera in (CAMERA, tl.Camera.perspective((0, 1, 2), (1, 1, 0), size=SIZE)):
            frame = tl.render(subject, camera, samples=16)
            rows, columns = np.nonzero(frame.color[..., 3])
            left, top, right, bottom = frame.bounds_px
            assert 0 <= left <= columns.min() <= columns.max() < right <= SIZE[0]
            assert 0 <= top <= rows.min() <= rows.max() < bottom <= SIZE[1]


def test_a_plant_far_away_is_drawn_as_at_the_origin(plant):
    # a dyadic place, so that camera and plant keep every bit
    place = np.array([2.0**20, -(2.0**19), 2.0**21])
    foliage, wood = plant.foliage.mesh, plant.wood
    parts = {
        name: {
            "positions": part.positions,
            "triangles": part.triangles,
            "normals": part.normals,
            "colors": part.base,
        }
        for name, part in (("foliage", foliage), ("wood", wood))
    }
    far = tl.Plant.from_arrays(
        **parts, leaf_offsets=plant.foliage.leaf_offsets, origin=tuple(place)
    )
    eye, target = np.array([1.5, 0.5, 5.0]), np.array([0.0, -0.5, 0.0])
    cameras = [tl.Camera.perspective(eye + at, target + at, size=SIZE) for at in (0.0, place)]
    for technique in (tl.FullMesh, tl.Slicings):
        frames = [
            tl.render(technique.build(subject), camera, outputs=OUTPUTS)
            for subject, camera in zip((plant, far), cameras, strict=True)
        ]
        assert frames[0].color.any()
        for name in OUTPUTS:
            np.testing.assert_array_equal(*(getattr(frame, name) for frame in frames), name)
        assert frames[0].bounds_px == frames[1].bounds_px


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"samples": 0}, "samples"),
        ({"samples": 2}, "samples must be in 1, 4, 8, 16"),
        ({"samples": 10**9}, "samples"),
        ({"samples": -1}, "samples"),
        ({"background": (0, 0)}, "background"),
        ({"background": (0, 0, np.nan)}, "background"),
        ({"background": 1.0}, "background"),
        ({"outputs": ()}, "outputs"),
        ({"outputs": "color"}, "outputs"),
        ({"outputs": ("colour",)}, "outputs"),
        ({"backend": "metal"}, "backend"),
        ({"threads": 0}, "threads"),
        ({"threads": 10**6}, "threads"),
    ],
)
def test_bad_arguments_are_named(mesh, arguments, message):
    with pytest.raises(ValueError, match=message):
        tl.render(mesh, CAMERA, **arguments)


def test_only_techniques_and_scenes_are_drawn(plant):
    for wrong in (plant, None, "tree"):
        with pytest.raises(TypeError, match="techniques"):
            tl.render(wrong, CAMERA)
    with pytest.raises(TypeError):
        tl.render(tl.FullMesh.build(plant), CAMERA, samples=4.5)


@pytest.mark.parametrize("size", [(0, 0), (0, 8), (8, -1), (8, 16385), (10**6, 10**6)])
def test_no_picture_of_that_size(size):
    with pytest.raises(ValueError, match="size"):
        tl.Camera.perspective((0, 0, 5), (0, 0, 0), size=size)


def test_a_picture_of_too_many_pixels_is_refused_at_once(mesh):
    huge = dataclasses.replace(CAMERA, size=(16384, 16384))
    with pytest.raises(tl.LimitError, match="pixels"):
        tl.render(mesh, huge)


def test_one_pixel_is_a_picture(mesh):
    frame = tl.render(mesh, dataclasses.replace(CAMERA, size=(1, 1)), samples=64)
    assert 0.0 < frame.color[0, 0, 3] < 1.0


def test_times_are_one_a_repeat(mesh, slicings):
    times = tl.time_frames({"mesh": mesh, "slicings": slicings}, CAMERA, warmup=1, repeats=3)
    assert list(times) == ["mesh", "slicings"]
    for millis in times.values():
        assert (millis.shape, millis.dtype) == ((3,), np.float64)
        assert (millis > 0).all()
    assert tl.time_frames({}, CAMERA) == {}
    for wrong in ({"repeats": 0}, {"warmup": -1}, {"samples": 2}, {"threads": 0}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            tl.time_frames({"mesh": mesh}, CAMERA, **wrong)
    with pytest.raises(TypeError, match=r"^subjects must be a mapping .*, got FullMesh"):
        tl.time_frames(mesh, CAMERA)


@pytest.mark.parametrize("samples", [4.0, "4", None])
def test_samples_are_whole(mesh, samples):
    with pytest.raises(TypeError, match=r"^samples must be an int, got "):
        tl.render(mesh, CAMERA, samples=samples)


def test_a_frame_never_changes(mesh):
    frame = tl.render(mesh, CAMERA)
    with pytest.raises(dataclasses.FrozenInstanceError):
        frame.color = None
    before = frame.color.copy()
    tl.render(mesh, dataclasses.replace(CAMERA, eye=(0.0, 0.0, 3.0)))
    np.testing.assert_array_equal(frame.color, before)


INTERRUPTED = """
    import os, signal, threading, time
    import treelod as tl
    plant = tl.grow_plant("chestnut", leaf_count=2000)
    camera = tl.orbit(plant, count=1, size=(1024, 768))[0]
    mesh = tl.FullMesh.build(plant)
    sent = []
    def interrupt():
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)
    threading.Timer(0.3, interrupt).start()
    try:
        {call}
        print("finished")
    except KeyboardInterrupt:
        print(time.monotonic() - sent[0])
    tl.render(mesh, camera, samples=1)
    print("and goes on")
"""


@pytest.mark.parametrize(
    "call",
    [
        "tl.render(mesh, camera, samples=65536)",
        "tl.time_frames({'mesh': mesh}, camera, samples=16, repeats=10**6)",
        "tl.Slicings.build(plant, resolution=4096, samples=256)",
        "tl.Slicings.build(plant, slice_count=400, resolution=8, correction='fit')",
    ],
    ids=["render", "time", "build", "fit"],
)
def test_ctrl_c_ends_long_work_within_a_second(call):
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(INTERRUPTED).replace("{call}", call)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={**os.environ, "TREELOD_NUM_THREADS": "2"},
    )
    secs, after = done.stdout.splitlines()
    assert float(secs) < 1.0
    assert after == "and goes on"
