"""Are the references right themselves: twin, cuts, texels, and the process around them?"""

import json
import os
import shutil
import subprocess
import sys
import textwrap
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, random_crown
from treelod.provenance import provenance
from treelod.references import Panel, Section, Validation, runner, twin
from treelod.references.checks import Check
from treelod.references.slices import Crown
from treelod.references.soup import foliage_soup, geometry_only, plant_soup
from treelod.references.texels import bilinear, bilinear_alpha, wrapped
from treelod.references.views import (
    bands,
    camera_settings,
    check_cameras,
    pixel_rays,
    sample_positions,
)
from treelod.references.visibility import seen_triangles
from treelod.report.validation import write_validation

# Where pictures are sampled


@pytest.mark.parametrize("count", [1, 17, 256, 1000])
def test_sample_positions_are_the_renderers(count):
    # a square from somewhere in the pixel to beyond its edge covers the samples right of that
    positions = sample_positions(count)
    assert ((positions >= 0) & (positions < 1)).all()
    camera = tl.Camera.orthographic((0.5, 0.5, 1), (0.5, 0.5, 0), height=1, size=(1, 1))
    for edge in (0.25, 0.5, 0.75):
        for axis in (0, 1):
            # between two steps of the grid, so that no sample lies on the edge
            start = edge + 1 / 512
            middle = [0.5, 0.5, 0.0]
            middle[axis] = start + 2 if axis == 0 else 1 - start - 2
            plant = crown([facing(*middle, 2)])
            alpha = tl.render(tl.FullMesh.build(plant), camera, samples=count).color[0, 0, 3]
            assert alpha == pytest.approx((positions[:, axis] > start).mean(), abs=1e-6)


def test_rays_go_where_the_camera_projects():
    plant = random_crown(20)
    points = np.array([[0.5, 0.5], [30.25, 7.75], [63.5, 47.5]])
    for camera in check_cameras(plant, (64, 48)).values():
        origins, directions = pixel_rays(camera_settings(camera, plant.origin), points)
        placed = camera.project(origins + 3.0 * directions)
        np.testing.assert_allclose(placed[:, :2], points, atol=1e-9)
        np.testing.assert_allclose(placed[:, 2], 3.0, atol=1e-12)


def test_cameras_fill_the_picture():
    plant = random_crown(50, trunk=True)
    world = plant_soup(plant).corners.reshape(-1, 3) + plant.origin
    for camera in check_cameras(plant, (64, 48)).values():
        placed = camera.project(world)[:, :2]
        low, high = placed.min(axis=0), placed.max(axis=0)
        assert (low >= -1e-9).all()
        assert (high <= np.array(camera.size) + 1e-9).all()
        reach = np.maximum(high / camera.size, 1 - low / camera.size)
        assert reach.max() == pytest.approx(1.0), "one side touches the edge"


def test_bands_hold_every_row_once():
    assert bands((64, 64), 256, 1 << 20) == [(0, 64)]
    assert bands((10, 7), 3, 100) == [(0, 2), (2, 4), (4, 7)]
    assert bands((10, 3), 1000, 1) == [(0, 1), (1, 2), (2, 3)], "no band is without a row"


# The f64 twin

SQUARE = np.array([[[0, 0], [8, 0], [8, 8]], [[0, 0], [8, 8], [0, 8]]], float)


def scene(*layers):
    """Squares of 8 x 8 pixels, each of two triangles, at the given depths."""
    points = np.concatenate([SQUARE] * len(layers))
    keys = np.repeat(np.array(layers, float), 2)[:, np.newaxis] * np.ones(3)
    return twin.Projected(points, keys, perspective=False)


@pytest.mark.parametrize(
    ("point", "shown", "right"),
    [
        ((6, 2), 0, True),
        ((6, 2), 1, False),  # it lies on the other side of the diagonal
        ((6, 2), 2, False),  # it lies behind
        ((6, 2), -1, False),  # something is there
        ((20, 2), -1, True),
        ((20, 2), 0, False),  # nothing is there
        ((4.002, 4), 1, True),  # half a step from the diagonal
        ((4.01, 4), 1, False),  # 1.8 steps from it
        ((8.003, 2), 0, True),
        ((8.003, 2), -1, True),
        ((8.005, 2), 0, False),
        ((7.997, 2), -1, True),
        ((7.995, 2), -1, False),
        ((7.997, 2), 2, True),  # what is in front may end here
        ((7.99, 2), 2, False),
    ],
)
def test_the_twin_knows_what_may_be_seen(point, shown, right):
    answer = twin.is_exact_within_a_step(
        scene(3, 5), np.array([point], float), np.array([shown]), size=1.0
    )
    assert answer.tolist() == [right]


def test_the_twin_lets_either_of_equal_depths_be_seen():
    for gap, right in ((0.0, True), (1e-7, True), (1e-4, False)):
        answer = twin.is_exact_within_a_step(
            scene(3, 3 + gap), np.array([[6.0, 2.0]]), np.array([2]), size=1.0
        )
        assert answer.tolist() == [right], gap


def test_where_triangles_cross_either_is_seen_within_a_step():
    # one rises from depth 0 to 16 across 16 pixels, the other is flat at 8: they meet at x = 8
    points = np.array([[[0, 0], [16, 0], [0, 16]]] * 2, float)
    keys = np.array([[0, 16, 0], [8, 8, 8]], float)
    crossing = twin.Projected(points, keys, perspective=False)
    for x, right in ((8.003, True), (8.05, False), (7.0, True)):
        answer = twin.is_exact_within_a_step(
            crossing, np.array([[x, 2.0]]), np.array([0]), size=1e-9
        )
        assert answer.tolist() == [right], x


@pytest.mark.parametrize("kind", ["orthographic", "perspective"])
def test_every_pixel_is_right_by_the_twin_alone(kind):
    plant = random_crown(600, trunk=True)
    camera = check_cameras(plant, (40, 30))[kind]
    frame = tl.render(tl.FullMesh.build(geometry_only(plant)), camera, samples=1, outputs=("ids",))
    ids = seen_triangles(frame)
    rows, columns = np.indices(ids.shape)
    points = np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5
    projected = twin.project(plant_soup(plant).corners + plant.origin, camera)
    size = 2 * plant.sphere[1]
    assert twin.is_exact_within_a_step(projected, points, ids.ravel(), size=size).all()
    assert 0.1 < (ids >= 0).mean() < 0.9
    # the control: a picture that is one pixel off
    moved = np.roll(ids, 1, axis=1).ravel()
    wrong = ~twin.is_exact_within_a_step(projected, points, moved, size=size)
    assert wrong.sum() > 0.5 * (moved != ids.ravel()).sum()


# Cutting and slicing


def area(soup):
    sides = soup.corners[:, 1:] - soup.corners[:, :1]
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2


def test_a_cut_keeps_one_side_and_its_attributes():
    plant = crown([facing(0, 0, 0, 1)], [(0.5, 0.5, 0.5, 1)])
    soup = foliage_soup(plant)
    right = soup.cut(np.array([1.0, 0, 0]), 0.5)
    assert area(right) == pytest.approx(1.0), "from x = 0.5 to 1, 2 high"
    assert right.corners[..., 0].min() == pytest.approx(0.5)
    np.testing.assert_allclose(right.front, soup.front[0, 0] * np.ones_like(right.front))
    assert soup.cut(np.array([1.0, 0, 0]), 2.0).triangle_count == 0
    assert soup.cut(np.array([1.0, 0, 0]), -2.0).triangle_count == 2


def test_both_sides_of_a_cut_make_the_whole():
    soup = foliage_soup(random_crown(60))
    normal = np.array([0.6, 0.0, 0.8])
    above, below = soup.cut(normal, 0.1), soup.cut(-normal, -0.1)
    assert area(above) + area(below) == pytest.approx(area(soup), rel=1e-12)
    assert above.triangle_count + below.triangle_count > soup.triangle_count, "some are cut"
    assert (above.corners @ normal >= 0.1 - 1e-12).all()
    assert (below.corners @ normal <= 0.1 + 1e-12).all()
    # orientation survives, or front and back would change sides

    def facing_up(part):
        sides = part.corners[:, 1:] - part.corners[:, :1]
        return np.cross(sides[:, 0], sides[:, 1]).sum(axis=0)

    np.testing.assert_allclose(facing_up(above) + facing_up(below), facing_up(soup), atol=1e-12)


def test_slices_hold_every_leaf_once():
    plant = random_crown(80)
    for slice_count in (1, 4, 40):
        sliced = Crown.of(plant, np.array([0.0, 0.0, 1.0]), slice_count)
        assert sum(area(part) for part in sliced.slices) == pytest.approx(area(sliced.whole))
    assert sliced.large_count > 0, "at 40 slices leaves are cut"


# Texels


def test_texels_are_mixed_by_hand():
    texels = np.array([[[0.0], [4.0]], [[8.0], [12.0]]])
    uvs = np.array([[0.25, 0.25], [0.5, 0.25], [0.5, 0.5], [0.0, 0.25], [1.25, 0.25]])
    read = [bilinear(texels, uvs, (wrap, wrap))[:, 0].tolist() for wrap in ("repeat", "clamp")]
    # left of the first texel's middle: half the last texel of the row, or the first alone
    assert read == [[0, 2, 6, 2, 0], [0, 2, 6, 0, 4]]
    assert wrapped(np.arange(-3, 6), 3, "mirror").tolist() == [2, 1, 0, 0, 1, 2, 2, 1, 0]


def test_fine_alpha_is_what_filtering_gives():
    rng = np.random.default_rng(3)
    texture = rng.integers(0, 256, (5, 7, 4), dtype=np.uint8)
    fine = bilinear_alpha(texture[..., 3], ("repeat", "repeat"), 4)
    rows, columns = np.indices(fine.shape)
    uvs = np.stack([(columns.ravel() + 0.5) / 28, (rows.ravel() + 0.5) / 20], axis=1)
    read = bilinear(texture[..., 3:] / 255, uvs, ("repeat", "repeat"))
    np.testing.assert_allclose(fine.ravel(), read[:, 0], atol=1e-6)


# Checks


def test_a_check_knows_its_side_and_no_nan_passes():
    def passed(value, relation):
        return Check(name="x", value=value, relation=relation, limit=1.0).passed

    assert [passed(v, "<=") for v in (0.5, 1.0, 1.5, float("nan"))] == [True, True, False, False]
    assert [passed(v, ">=") for v in (0.5, 1.0, 1.5, float("nan"))] == [False, True, True, False]


@pytest.mark.parametrize(
    ("value", "words"),
    [(np.nan, "not a number"), (np.inf, "infinite"), (-np.inf, "infinite")],
)
@pytest.mark.parametrize("relation", ["<=", ">="])
def test_a_figure_that_is_no_number_fails_and_is_written(tmp_path, value, words, relation):
    picture = np.array([[0.0, value], [0.25, 1.0]])
    panel = Panel(title="odd", ours=picture, reference=picture, difference=np.abs(picture))
    odd = Check(name="odd", value=value, relation=relation, limit=0.5)
    fine = Check(name="fine", value=0.5, relation=relation, limit=0.5)
    section = Section(title="Odd", what="w", checks=[fine, odd], panels=[panel])
    found = Validation(
        plant="p",
        summary="s",
        sections=[section],
        left_out=[],
        full=False,
        secs=1.0,
        source={},
        made=asdict(provenance()),
    )
    page = write_validation(found, tmp_path).read_text()
    assert f"<td>odd</td><td>{words}</td>" in page
    figures = json.loads((tmp_path / "validation.json").read_text())
    assert not figures["passed"]
    assert [(c["value"], c["passed"], c.get("value_is")) for c in figures["checks"]] == [
        (0.5, True, None),
        (None, False, words),
    ]
    assert len(list((tmp_path / "pictures").iterdir())) == 1


# The process around a reference


@pytest.fixture
def job(tmp_path, monkeypatch):
    """Make `body` the function of a job named "made"."""
    monkeypatch.setenv("TREELOD_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(runner.JOBS, "made", "made_job")

    def make(body):
        source = f"""
            import os, pathlib, signal, time
            import numpy as np
            count = pathlib.Path({str(tmp_path / "count")!r})
            def run(arrays, settings):
                calls = int(count.read_text()) + 1 if count.exists() else 1
                count.write_text(str(calls))
                {body}
                return {{"twice": 2 * arrays["x"], "calls": np.array(calls)}}
        """
        (tmp_path / "made_job.py").write_text(textwrap.dedent(source))

    return make


def ask(x=1.0, **kwargs):
    return runner.reference("made", {"x": np.array([x])}, {}, **kwargs)


def test_results_are_kept_by_what_went_in(job, tmp_path):
    job("pass")
    assert [int(ask(x)["calls"]) for x in (1.0, 1.0, 2.0, 1.0)] == [1, 1, 2, 1]
    assert int(ask(cached=False)["calls"]) == 3
    job("calls += 100")
    assert int(ask()["calls"]) == 104, "an edited reference is asked again"
    (kept, *_) = sorted((tmp_path / "cache" / "references").iterdir())
    kept.write_bytes(kept.read_bytes()[:50])
    assert all(ask(x)["twice"] == [2 * x] for x in (1.0, 2.0)), "a damaged file is made again"


def test_results_are_kept_by_what_references_import(job, tmp_path, monkeypatch):
    folder = tmp_path / "treelod" / "references"
    shutil.copytree(runner._REFERENCES, folder)
    color = shutil.copy(runner._COLOR, folder.parent)
    monkeypatch.setattr(runner, "_REFERENCES", folder)
    monkeypatch.setattr(runner, "_COLOR", Path(color))
    job("pass")
    assert [int(ask()["calls"]) for _ in range(2)] == [1, 1]
    imported = [folder / "views.py", folder / "texels.py", Path(color)]
    for calls, edited in enumerate(imported, start=2):
        edited.write_text(edited.read_text() + "\n# edited\n")
        assert int(ask()["calls"]) == calls, edited.name


def test_a_reference_that_dies_gets_a_second_chance(job, caplog):
    job("if calls == 1: os.kill(os.getpid(), signal.SIGBUS)")
    assert int(ask()["calls"]) == 2
    assert "attempt 1 of 2" in caplog.text


def test_a_reference_that_dies_twice_says_why(job, tmp_path):
    job("raise RuntimeError('no such plug-in')")
    with pytest.raises(tl.TreelodError, match="no such plug-in"):
        ask()
    assert (tmp_path / "count").read_text() == "2"


def test_a_reference_that_hangs_is_ended(job):
    job("time.sleep(60)")
    with pytest.raises(runner.ReferenceFailedError, match="took more than 2 s"):
        ask(timeout_secs=2.0)


def test_calls_in_parallel_come_back_in_order(job):
    job("pass")
    told = []
    calls = [lambda x=x: float(ask(x)["twice"][0]) for x in (1.0, 2.0, 3.0)]
    assert runner.in_parallel(calls, lambda *steps: told.append(steps)) == [2.0, 4.0, 6.0]
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert runner.in_parallel([]) == []


def test_a_call_that_fails_ends_the_others(job):
    job("time.sleep(60)")

    def fail():
        time.sleep(0.5)
        msg = "no"
        raise RuntimeError(msg)

    start = time.monotonic()
    with pytest.raises(RuntimeError, match="no"):
        runner.in_parallel([fail, lambda: ask(2.0), lambda: ask(3.0)])
    assert time.monotonic() - start < 5.0


def test_a_run_that_was_stopped_goes_on_where_it_stopped(job, tmp_path):
    job("pass")
    calls = [lambda x=x: int(ask(x)["calls"]) for x in (1.0, 2.0, 3.0, 4.0)]

    def stop(done, _):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runner.in_parallel(calls, stop)
    kept = len(list((tmp_path / "cache" / "references").iterdir()))
    assert kept >= 2
    before = int((tmp_path / "count").read_text())
    assert len(runner.in_parallel(calls)) == 4
    assert int((tmp_path / "count").read_text()) - before <= 4 - kept


def test_a_child_ends_with_its_parent(job, tmp_path):
    # the parent is killed and can end nothing; the child notes its id and sleeps
    job("pathlib.Path(settings['note']).write_text(str(os.getpid())); time.sleep(60)")
    note = tmp_path / "child"
    code = f"""
        from treelod.references import runner
        runner.JOBS["made"] = "made_job"
        runner.reference("made", {{}}, {{"note": {str(note)!r}}})
    """
    parent = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)])
    try:
        assert soon(lambda: note.exists() and note.read_text())
    finally:
        parent.kill()
        parent.wait()
    assert soon(lambda: not alive(int(note.read_text())))


def soon(holds, secs=20.0):
    deadline = time.monotonic() + secs
    while not holds():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def alive(process_id):
    """Whether it runs; one that has ended and waits for its parent does not."""
    try:
        state = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def test_a_missing_extra_names_the_line_that_installs_it(monkeypatch):
    monkeypatch.setitem(runner._PACKAGES, "mitsuba", "no_such_module")
    with pytest.raises(ImportError, match=r"mitsuba missing: pip install 'treelod\[validate\]'"):
        runner.require()
