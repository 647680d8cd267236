"""Does a graphics card draw what the processor draws, and what happens where it does not?"""

import dataclasses
import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import treelod as tl
from treelod import _core
from treelod.render import OUTPUTS
from treelod.techniques import REGISTRY

pytestmark = pytest.mark.gpu

SIZE = (160, 120)

COLOR_TOLERANCE = 1 / 128
"""
Of a channel: texels are halves on a card, some cards filter with weights in steps of 1/256, levels
of detail are measured over two by two pixels, and blended layers add such differences up.
"""

DEPTH_TOLERANCE = 1e-3
"""Of a depth, as a share: a pixel of a slanted card is deep, and samples lie on a grid of 1/256."""

RIM = {1: 0.01, 4: 0.035, 8: 0.012}
"""
Share of the covered pixels that may differ by more, by samples: rims that rounding moves over a
sample. With four samples at once a card takes the colour of an untextured pixel at a place of its
own choice inside what is covered, the processor in the middle of the samples covered.
"""

FLIP = 0.006
"""Mean FLIP of the two pictures, at most. Seen: 0.0046; 0.012 with six tenths of the triangles."""

OPTIONS = {
    "full_mesh": [{"filter": "trilinear"}],
    "slicings": [{"format": "rgb8"}, {"mirrored": True, "quadtree": 16}],
    "orthogonal_slices": [{"bake_wood": True}],
    "leaf_clusters": [
        {"texturing": "indirect", "drawing": "coverage"},
        {"drawing": "blend"},
    ],
    "foliage_hierarchy": [{"criterion": tl.criteria.screen_size(6.0)}],
    "simplified_mesh": [{"keep_fraction": 0.3}],
    "points_and_lines": [{"antialias": "blend"}, {"antialias": "coverage"}],
    "layered_billboards": [{"drawing": "test"}],
    "stochastic_pruning": [{}],
    "billboard": [{"drawing": "coverage", "view_blend": "cross_fade"}],
    "octahedral_impostor": [{"shading": "relit", "hemisphere": False}, {"drawing": "test"}],
}
"""Other ways than the default in which techniques draw."""

RESOLUTION = {name: 64 for name in REGISTRY if "resolution" in REGISTRY[name].build.__kwdefaults__}


@pytest.fixture(scope="module", autouse=True)
def card():
    """The graphics card of these tests; where the whole project is checked there must be one."""
    cards = tl.gpu.adapters()
    if not cards and os.environ.get("CI") == "true":
        pytest.fail("there is no graphics adapter, and a check of the whole project needs one")
    if not cards:
        pytest.skip("needs a graphics adapter: Debian has llvmpipe in mesa-vulkan-drivers")
    return cards[0]


@pytest.fixture(scope="module")
def plant():
    return tl.grow_plant("chestnut", leaf_count=250)


@pytest.fixture(scope="module")
def camera(plant):
    return tl.orbit(plant, count=3, elevation_deg=10, size=SIZE)[1]


def build(name, plant, **options):
    resolution = {"resolution": RESOLUTION[name]} if name in RESOLUTION else {}
    return REGISTRY[name].build(plant, **resolution, **options)


def both(subject, camera, **arguments):
    """The processor's picture and the card's."""
    card = tl.render(subject, camera, backend="gpu", **arguments)
    return tl.render(subject, camera, **arguments), card


def shares(processor, card):
    """Shares of the covered pixels whose colour and depth differ by more than the tolerances."""
    covered = max(int(((processor.color[..., 3] > 0) | (card.color[..., 3] > 0)).sum()), 1)
    colors = np.abs(processor.color - card.color).max(axis=-1) > COLOR_TOLERANCE
    with np.errstate(invalid="ignore"):
        near = np.abs(processor.depth - card.depth) <= DEPTH_TOLERANCE * processor.depth
    same = near | (np.isinf(processor.depth) & np.isinf(card.depth))
    return colors.sum() / covered, (~same).sum() / covered


def check_alike(subject, camera, samples=1):
    processor, card = both(subject, camera, samples=samples)
    assert processor.color[..., 3].max() > 0.5, "there is something to see"
    color, depth = shares(processor, card)
    assert color <= RIM[samples], f"colour: {color:.4f} of the pixels differ"
    assert depth <= RIM[samples], f"depth: {depth:.4f} of the pixels differ"
    flip = tl.metrics.compare(processor, card).flip
    assert flip <= FLIP, f"FLIP {flip:.4f}"


# --- the same picture ----------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [1, 4, 8])
@pytest.mark.parametrize("name", REGISTRY)
def test_every_technique_is_drawn_alike(name, samples, plant, camera):
    check_alike(build(name, plant), camera, samples)


@pytest.mark.parametrize(
    ("name", "options"), [(name, options) for name in OPTIONS for options in OPTIONS[name]]
)
def test_every_way_of_drawing_is_alike(name, options, plant, camera):
    check_alike(build(name, plant, **options), camera)


def test_the_options_leave_no_technique_out():
    assert OPTIONS.keys() == REGISTRY.keys()


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("file", ["quaternius_common/CommonTree_1.gltf", "ez_bush_1/ez_bush_1.glb"])
def test_textured_plants_are_drawn_alike(file, samples, models):
    plant = tl.load_plant(models / file)
    camera = tl.orbit(plant, count=1, elevation_deg=15, size=SIZE)[0]
    for name in ("full_mesh", "leaf_clusters", "slicings"):
        check_alike(build(name, plant), camera, samples)


@pytest.mark.parametrize("orthographic", [False, True])
def test_scenes_are_drawn_alike(orthographic, plant):
    # mirrored, tinted and leaning copies, of cards, meshes and blended layers, far and near
    placed = [np.eye(4) for _ in range(9)]
    for number, transform in enumerate(placed):
        transform[:3, 3] = [(number % 3) * 7.0 - 7.0, 0.0, -(number // 3) * 14.0]
    subjects = [build(name, plant) for name in ("leaf_clusters", "slicings", "full_mesh")]
    scene = tl.Scene(
        [(subject, np.array(placed[first::3])) for first, subject in enumerate(subjects)],
        wind=tl.Wind(),
        variety=tl.Variety(seed=3),
    )
    eye, target = (3.0, 5.0, 25.0), (0.0, 4.0, -10.0)
    if orthographic:
        camera = tl.Camera.orthographic(eye, target, height=18.0, size=SIZE)
    else:
        camera = tl.Camera.perspective(eye, target, fov_y_deg=45, size=SIZE)
    check_alike(scene, camera)
    check_alike(scene, camera, 4)


def test_a_plant_at_the_end_of_the_world_is_drawn_alike(plant):
    # f32 has half a metre between numbers here
    far = np.eye(4)
    far[:3, 3] = [5e6, 0.0, -3e6]
    scene = tl.Scene([(tl.FullMesh.build(plant), far[np.newaxis])])
    eye = (5e6 + 3.0, 5.0, -3e6 + 25.0)
    camera = tl.Camera.perspective(eye, (5e6, 5.0, -3e6), fov_y_deg=30, size=SIZE)
    check_alike(scene, camera)


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_plant_far_from_the_eye_is_drawn_alike(orthographic, plant):
    # through a telescope: what f32 keeps of 100 km is 8 mm, a pixel is 10 cm
    mesh = tl.FullMesh.build(plant)
    eye, target = (0.0, 8.0, 1e5), (0.0, 8.0, 0.0)
    if orthographic:
        camera = tl.Camera.orthographic(eye, target, height=14.0, size=SIZE)
    else:
        fov_y_deg = float(np.rad2deg(14.0 / 1e5))
        camera = tl.Camera.perspective(eye, target, fov_y_deg=fov_y_deg, size=SIZE)
    processor, card = both(mesh, camera, samples=1)
    # which of two leaves is nearer cannot be told where they are closer than that, on either
    off = np.abs(processor.color[..., 3] - card.color[..., 3]) > COLOR_TOLERANCE
    assert off.sum() <= RIM[1] * (processor.color[..., 3] > 0).sum()
    assert shares(processor, card)[0] <= 10 * RIM[1]


def test_all_planes_are_alike(plant, camera):
    subject = build("leaf_clusters", plant)
    processor, card = both(subject, camera, samples=1, outputs=OUTPUTS)
    covered = (processor.color[..., 3] > 0).sum()
    assert (processor.ids != card.ids).sum() <= RIM[1] * covered
    for plane in ("albedo", "normal"):
        off = np.abs(getattr(processor, plane) - getattr(card, plane)).max(axis=-1)
        assert (off > COLOR_TOLERANCE).sum() <= RIM[1] * covered, plane
    off = np.abs(processor.color8.astype(int) - card.color8).max(axis=-1)
    assert (off > 2).sum() <= RIM[1] * covered


def test_depth_of_blended_layers_is_where_half_is_hidden(plant, camera):
    subject = build("slicings", plant)
    processor, card = both(subject, camera, samples=1, outputs=("color", "depth", "ids"))
    assert np.isfinite(card.depth).sum() > 1000
    _, depth = shares(processor, card)
    assert depth <= RIM[1]
    assert (processor.ids != card.ids).mean() <= RIM[1]


def test_a_background_lies_behind(plant, camera):
    processor, card = both(tl.FullMesh.build(plant), camera, samples=1, background=(0.2, 0.4, 0.1))
    np.testing.assert_allclose(card.color[0, 0], [0.2, 0.4, 0.1, 1.0], atol=1e-6)
    assert shares(processor, card)[0] <= RIM[1]


def test_what_is_drawn_otherwise_is_noticed(plant, camera):
    # the checks above must be able to fail
    mesh = build("full_mesh", plant)
    _, card = both(mesh, camera, samples=1)
    moved = dataclasses.replace(camera, eye=tuple(x + 0.01 for x in camera.eye))
    other = tl.render(mesh, moved, samples=1)
    assert min(shares(other, card)) > 4 * RIM[1]
    fewer = build("simplified_mesh", plant, keep_fraction=0.6)
    assert tl.metrics.compare(tl.render(fewer, camera, samples=1), card).flip > 1.5 * FLIP


# --- what it says --------------------------------------------------------------------------------


def test_stats_name_the_card(plant, camera, card):
    stats = tl.render(tl.FullMesh.build(plant), camera, backend="gpu").stats
    assert (stats.backend, stats.adapter, stats.driver) == ("gpu", card.name, card.driver)
    assert stats.threads == 0
    assert stats.fragments is None
    assert stats.triangles == plant.triangle_count
    assert 0 < stats.draw_millis < 60_000
    if stats.gpu_millis is not None:
        # the card's clock starts later and ends earlier
        assert 0 < stats.gpu_millis <= stats.draw_millis * 1.05
    stats = tl.render(tl.FullMesh.build(plant), camera).stats
    assert (stats.backend, stats.adapter, stats.driver, stats.gpu_millis) == ("cpu", *[None] * 3)


def test_frames_are_timed(plant, camera):
    subjects = {"mesh": tl.FullMesh.build(plant), "cards": build("leaf_clusters", plant)}
    millis = tl.time_frames(subjects, camera, repeats=3, backend="gpu")
    assert {label: values.shape for label, values in millis.items()} == {
        "mesh": (3,),
        "cards": (3,),
    }
    assert all((values > 0).all() for values in millis.values())


def test_the_same_bytes_each_time(plant, camera):
    subject = build("slicings", plant)
    frames = [tl.render(subject, camera, backend="gpu") for _ in range(2)]
    np.testing.assert_array_equal(frames[0].color, frames[1].color)
    np.testing.assert_array_equal(frames[0].depth, frames[1].depth)


# --- choosing a card -----------------------------------------------------------------------------


def test_cards_are_chosen_by_name_and_kind(plant, camera, card, monkeypatch):
    mesh = tl.FullMesh.build(plant)
    place = f"#{tl.gpu.adapters().index(card)}"
    for name in (card.name, card.name[:5].upper(), card.kind, card.api, place):
        assert tl.render(mesh, camera, backend="gpu", adapter=name).stats.adapter == card.name
    for wrong in ("Nonesuch", "#99", "#"):
        said = f'^adapter is "{wrong.lower()}", and .* there are .*{card.name[:4]}'
        with pytest.raises(tl.NoAdapterError, match=said):
            tl.render(mesh, camera, backend="gpu", adapter=wrong)
    monkeypatch.setenv("TREELOD_ADAPTER", "nonesuch")
    with pytest.raises(tl.NoAdapterError, match=r'^TREELOD_ADAPTER is "nonesuch"'):
        tl.render(mesh, camera, backend="gpu")
    with pytest.raises(tl.NoAdapterError, match="nonesuch"):
        tl.render(mesh, camera, backend="gpu", adapter=" ")
    # a call's own word comes first, and an empty one is none
    assert tl.render(mesh, camera, backend="gpu", adapter=card.name).stats.adapter == card.name
    monkeypatch.setenv("TREELOD_ADAPTER", " ")
    assert tl.render(mesh, camera, backend="gpu").stats.adapter


def test_what_names_no_backend_is_refused(plant, camera):
    mesh = tl.FullMesh.build(plant)
    for call in (
        lambda **wrong: tl.render(mesh, camera, **wrong),
        lambda **wrong: tl.time_frames({"mesh": mesh}, camera, **wrong),
    ):
        with pytest.raises(ValueError, match="backend must be 'cpu' or 'gpu', got 'metal'"):
            call(backend="metal")
        with pytest.raises(ValueError, match="adapter names a graphics card"):
            call(adapter="llvmpipe")
        with pytest.raises(TypeError, match="adapter must be a str"):
            call(backend="gpu", adapter=3)


def run_python(code, **environment):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=60,
        env={**os.environ, **environment},
    )


SCENE = """
    import faulthandler, os, signal, sys, threading, time
    import treelod as tl
    faulthandler.dump_traceback_later(50, exit=True)
    plant = tl.grow_plant("chestnut", leaf_count=300)
    camera = tl.orbit(plant, count=1, size=(160, 120))[0]
    mesh = tl.FullMesh.build(plant)
    def draw(**arguments):
        return tl.render(mesh, camera, backend="gpu", **arguments)
"""


def test_without_a_driver_it_says_what_to_install():
    code = (
        SCENE
        + """
    assert tl.gpu.adapters() == []
    try:
        draw()
    except tl.NoAdapterError as error:
        print(error)
    print(tl.render(mesh, camera).stats.backend)
    """
    )
    nowhere = {"VK_DRIVER_FILES": "/nonexistent", "VK_ICD_FILENAMES": "/nonexistent"}
    done = run_python(code, **nowhere)
    assert done.returncode == 0, done.stderr
    said, backend = done.stdout.splitlines()
    assert "there is no graphics adapter: install" in said
    assert "mesa-vulkan-drivers" in said
    assert backend == "cpu"


# --- failures ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "said"),
    [("lost", "was lost"), ("memory", "out of memory"), ("command", "refused a command")],
)
def test_a_device_that_fails_is_an_exception_and_the_next_call_works(kind, said, plant, camera):
    subject = build("leaf_clusters", plant)
    before = tl.render(subject, camera, backend="gpu")
    with pytest.raises(tl.DeviceError, match=said):
        _core._fail_for_test(kind)
    after = tl.render(subject, camera, backend="gpu")
    np.testing.assert_array_equal(after.color, before.color)


def test_a_picture_too_large_for_the_card_is_refused_at_once(plant, card):
    mesh = tl.FullMesh.build(plant)
    camera = tl.orbit(plant, count=1, size=(16384, 8192))[0]
    if card.kind == "cpu":
        # what draws on the processor holds 128 MiB in one piece; a large card may hold the picture
        with pytest.raises(tl.LimitError, match=r"size needs \d+ bytes of this card's memory"):
            tl.render(mesh, camera, backend="gpu", samples=1)
    # with more pixels than any picture has none is asked
    camera = dataclasses.replace(camera, size=(16384, 16384))
    with pytest.raises(tl.LimitError, match=r"size needs 268435456 pixels"):
        tl.render(mesh, camera, backend="gpu", samples=1)


def test_ctrl_c_ends_a_picture_within_a_second():
    code = (
        SCENE
        + """
    draw()
    sent = []
    def interrupt():
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)
    for call in (
        lambda: draw(samples=65536),
        lambda: tl.time_frames({"mesh": mesh}, camera, repeats=10**6, backend="gpu"),
    ):
        threading.Timer(0.3, interrupt).start()
        try:
            call()
            print("finished")
        except KeyboardInterrupt:
            print(time.monotonic() - sent[-1])
    print(draw().stats.backend)
    """
    )
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    *secs, backend = done.stdout.split()
    assert backend == "gpu"
    assert all(float(took) < 1.0 for took in secs), secs


def test_the_process_ends_while_others_still_draw():
    code = (
        SCENE
        + """
    draw()
    threading.Thread(target=lambda: draw(samples=65536), daemon=True).start()
    time.sleep(0.3)
    print("ends")
    """
    )
    done = run_python(code)
    assert (done.returncode, done.stdout.split()) == (0, ["ends"]), done.stderr


def test_a_lost_device_is_the_loss_of_one_thread_alone():
    code = (
        SCENE
        + """
    from treelod import _core
    draw()
    ends = []
    def work():
        try:
            draw(samples=200)
            ends.append("drew")
        except tl.DeviceError:
            ends.append("lost")
    def lose():
        try:
            _core._fail_for_test("lost")
        except tl.DeviceError:
            pass
    for _ in range(3):
        workers = [threading.Thread(target=work) for _ in range(4)]
        workers.insert(1, threading.Thread(target=lose))
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
    print(ends == ["drew"] * 12)
    """
    )
    done = run_python(code, TREELOD_NUM_THREADS="8")
    assert (done.returncode, done.stdout.split()) == (0, ["True"]), done.stderr


def test_a_released_card_draws_again(plant, camera):
    subject = build("leaf_clusters", plant)
    before = tl.render(subject, camera, backend="gpu")
    tl.gpu.release()
    after = tl.render(subject, camera, backend="gpu")
    np.testing.assert_array_equal(after.color, before.color)


def test_threads_share_a_card():
    code = (
        SCENE
        + """
    wanted = draw().color.tobytes()
    same = []
    workers = [
        threading.Thread(target=lambda: same.append(draw().color.tobytes() == wanted))
        for _ in range(6)
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    print(same == [True] * 6)
    """
    )
    done = run_python(code)
    assert (done.returncode, done.stdout.split()) == (0, ["True"]), done.stderr


def test_children_open_devices_of_their_own():
    # a fork before the first picture has nothing to inherit; one after it is told so
    code = (
        SCENE.replace("plant = ", "child = os.fork()\n    plant = ", 1)
        + """
    if child:
        os.waitpid(child, 0)
    print(draw().stats.backend, flush=True)
    if not child:
        os._exit(0)
    late = os.fork()
    if late == 0:
        try:
            draw()
        except tl.errors.ForkedError:
            print("forked", flush=True)
        os._exit(0)
    os.waitpid(late, 0)
    """
    )
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["gpu", "gpu", "forked"]
