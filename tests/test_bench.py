"""Do benchmarks give rows, and do all tools in them draw the same?"""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import treelod
from treelod import Camera, NoAdapterError, _core
from treelod.bench import GROUPS, Row, bake, interleaved, splats
from treelod.bench.llvmpipe import Llvmpipe
from treelod.bench.raster import least_operations
from treelod.bench.subjects import COUNTS, Cloud, GrownMesh, Subject
from treelod.cli import app
from treelod.plants import grow_plant
from treelod.render import camera_facts

KEYS = [
    "group",
    "case",
    "ours_secs",
    "peer",
    "peer_secs",
    "speedup",
    "ours_error",
    "peer_error",
    "error_kind",
    "aim",
    "version",
    "cpu",
    "threads",
    "spread",
]

SAME_PICTURE = 0.02
"""Share by which the errors of two rasterisers with the same samples may differ: they round
vertices alike, but not colours."""


def test_a_row_is_a_line_of_json_with_its_keys_in_order():
    row = Row(group="raster", case="c", ours_secs=0.5, peer="p", peer_secs=4.0, aim=8.0)
    facts = json.loads(row.to_json())
    assert list(facts) == KEYS
    assert (facts["speedup"], facts["ours_error"], facts["error_kind"]) == (8.0, None, "")
    with pytest.raises(ValueError, match="JSON"):
        Row(group="raster", case="c", ours_secs=0.5, peer="p", peer_secs=float("inf")).to_json()


def test_runs_take_turns_and_medians_ignore_warm_up_and_lead_in():
    turns = []

    def run(name, secs):
        times = iter(secs)

        def once():
            turns.append(name)
            return next(times)

        return once

    medians = interleaved(
        {"a": run("a", [9.0, 1.0, 5.0, 2.0]), "b": run("b", [9.0, 4.0, 4.0, 3.0])}, repeats=3
    )
    assert medians == {"a": 2.0, "b": 4.0}
    # quartiles of 1, 2, 5 are 1.5 and 3.5; of 3, 4, 4 they are 3.5 and 4
    row = Row(group="g", case="c", ours_secs=medians["a"], peer="p", peer_secs=medians["b"])
    assert row.spread == 0.5
    facts = json.loads(row.to_json())
    assert (facts["ours_secs"], facts["spread"]) == (2.0, 0.5)
    assert facts["version"] == treelod.__version__
    assert facts["cpu"]
    assert facts["threads"] >= 1
    assert turns == ["a", "b"] * 4
    turns.clear()
    reports = [9.0, 9.0, 1.0, 9.0, 9.0, 2.0]
    led_in = interleaved({"a": run("a", reports)}, repeats=1, lead_in=2)
    assert (led_in, turns) == ({"a": 2.0}, ["a"] * 6)
    with pytest.raises(ValueError, match="repeats"):
        interleaved({}, repeats=0)
    with pytest.raises(ValueError, match="nan seconds"):
        interleaved({"a": lambda: float("nan")}, repeats=1)


def seen(*parts, camera=None):
    from_front = Camera.perspective((0.0, 4.0, 20.0), (0.0, 4.0, 0.0), size=(80, 60))
    return Subject(parts, camera_facts(camera or from_front))


def test_least_operations_grow_with_what_is_drawn():
    plant = grow_plant("chestnut", leaf_count=20)
    vertices = len(plant.wood.positions) + len(plant.foliage.mesh.positions)
    hidden = least_operations(plant, 0)
    assert hidden == 42 * vertices + 143 * plant.triangle_count
    assert least_operations(plant, 1000) == hidden + 19_000


def small_parts():
    # no edge of a point meets the middle of a pixel
    at = np.array([[0.1, 1.1, 0], [2.3, 6.2, 0], [-3.1, 2, 1], [-2, 3.3, 1]], np.float32)
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.5, 0.7]], np.float32)
    return (
        GrownMesh(preset="chestnut", leaf_count=200, wood=False),
        Cloud(positions=at, colors=colors, lines=False, size_px=3.0),
        # nearer, so that no line lies in the depth of a point
        Cloud(positions=at + np.float32([0, 0.4, 0.5]), colors=colors, lines=True, size_px=2.0),
    )


def other_pixels(a, b):
    """Share of pixels whose colours differ by more than rounding makes them."""
    return (np.abs(a - b).max(axis=-1) > 0.01).mean()


def skipped_without_adapter(make):
    """Skip where there is no llvmpipe; where CI is set, nothing may be missing."""
    try:
        with make():
            pass
    except NoAdapterError as missing:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip(f"needs llvmpipe (Debian has it in mesa-vulkan-drivers): {missing}")


@pytest.fixture(scope="session")
def needs_llvmpipe():
    skipped_without_adapter(lambda: Llvmpipe(seen(*small_parts()), samples=1, threads=1))


def test_tests_of_llvmpipe_are_skipped_without_one_and_fail_in_ci(monkeypatch):
    def missing():
        msg = "none"
        raise NoAdapterError(msg)

    def broken():
        msg = "broken"
        raise RuntimeError(msg)

    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match="llvmpipe"):
        skipped_without_adapter(missing)
    with pytest.raises(RuntimeError, match="broken"):
        skipped_without_adapter(broken)
    monkeypatch.setenv("CI", "true")
    with pytest.raises(NoAdapterError, match="none"):
        skipped_without_adapter(missing)


@pytest.mark.parametrize(
    "camera",
    [
        None,
        Camera.orthographic((0.0, 4.0, 20.0), (0.0, 4.0, 0.0), height=9.0, size=(60, 80)),
    ],
    ids=["perspective", "orthographic"],
)
def test_a_stored_subject_draws_what_it_drew_before(tmp_path, camera):
    before = seen(*small_parts(), camera=camera)
    before.store(tmp_path / "subject.npz")
    color, stats = before.picture(_core.Renderer(), samples=4)
    loaded = Subject.load(tmp_path / "subject.npz")
    again, again_stats = loaded.picture(_core.Renderer(), samples=4)
    np.testing.assert_array_equal(again, color)
    assert {name: again_stats[name] for name in COUNTS} == {name: stats[name] for name in COUNTS}
    assert (stats["triangles"], stats["lines"], stats["points"]) == (2000, 2, 4)
    # each part is seen: without it the picture is another one
    for missing in range(3):
        parts = small_parts()
        fewer = seen(*parts[:missing], *parts[missing + 1 :], camera=camera)
        assert (fewer.picture(_core.Renderer(), samples=4)[0] != color).any()


@pytest.mark.usefixtures("needs_llvmpipe")
@pytest.mark.parametrize("threads", [1, 2])
def test_llvmpipe_draws_the_same_with_as_many_threads_as_it_is_told(threads):
    subject = seen(*small_parts())
    with Llvmpipe(subject, samples=1, threads=threads) as peer:
        assert "llvmpipe" in peer.driver
        assert 0.0 < peer.draw() < 60.0
        ours, _ = subject.picture(_core.Renderer(), samples=1)
        assert other_pixels(peer.picture(), ours) < 0.001
        no_mesh, _ = seen(*small_parts()[1:]).picture(_core.Renderer(), samples=1)
        assert other_pixels(no_mesh, ours) > 0.005, "what is missing is seen"
        if sys.platform == "linux":
            names = Path(f"/proc/{peer._process.pid}/task").glob("*/comm")
            workers = [name for name in names if name.read_text().startswith("llvmpipe-")]
            assert len(workers) == (0 if threads == 1 else threads)
        folder = Path(peer._folder.name)
        assert folder.is_dir()
    assert not folder.exists()
    assert peer._process.returncode == 0


@pytest.mark.usefixtures("needs_llvmpipe")
def test_a_process_that_draws_another_list_is_refused():
    class Other(Subject):
        def store(self, path):
            seen(*small_parts()[:2]).store(path)

    subject = Other(small_parts(), seen()._camera)
    with pytest.raises(RuntimeError, match=r"llvmpipe was given .*'lines': 0.* not .*'lines': 2"):
        Llvmpipe(subject, samples=1, threads=1)


@pytest.mark.usefixtures("needs_llvmpipe")
def test_a_process_that_has_died_says_so():
    with Llvmpipe(seen(*small_parts()), samples=1, threads=1) as peer:
        peer._process.kill()
        peer._process.wait()
        with pytest.raises(RuntimeError, match="llvmpipe ended with status -9"):
            peer.draw()


def test_a_process_that_fails_is_quoted():
    class Broken(Subject):
        def store(self, path):
            path.write_bytes(b"no subject")

    subject = Broken(small_parts(), seen()._camera)
    with pytest.raises(RuntimeError, match=r"llvmpipe ended with status 1: \w+Error: .*pickle"):
        Llvmpipe(subject, samples=1, threads=1)


def test_a_machine_without_drivers_has_no_llvmpipe(monkeypatch):
    # what Vulkan's loader looks at, by its old and its new name
    monkeypatch.setenv("VK_ICD_FILENAMES", os.devnull)
    monkeypatch.setenv("VK_DRIVER_FILES", os.devnull)
    with pytest.raises(NoAdapterError, match="no graphics adapter"):
        Llvmpipe(seen(*small_parts()), samples=1, threads=1)


@pytest.mark.timeout(300)
@pytest.mark.usefixtures("needs_llvmpipe")
def test_raster_rows_compare_the_same_picture(tmp_path):
    file = tmp_path / "rows.jsonl"
    command = ["bench", "raster", "--small", "--repeats", "1", "--output", str(file)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.stderr
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert {row["peer"].split(" Mesa")[0] for row in rows} == {
        "llvmpipe",
        "ours, scalar",
        "the slow twin",
        "bound: a copy of the bytes touched",
        "bound: arithmetic in full vectors",
    }
    compared = [row for row in rows if row["peer_error"] is not None]
    assert [row["aim"] for row in compared] == [8.0, 8.0, 4.0, 4.0, None, None]
    assert [row["case"].split(", ", 3)[3] for row in compared] == [
        f"samples={samples}, threads={threads}" for samples in (1, 4, 16) for threads in (1, 2)
    ]
    for row in compared:
        assert row["peer_error"] == pytest.approx(row["ours_error"], rel=SAME_PICTURE)
    # a picture with other samples is not the same
    errors = [row["peer_error"] for row in compared]
    assert errors[0] > (1.0 + SAME_PICTURE) * errors[2] > (1.0 + SAME_PICTURE) ** 2 * errors[4]


def test_pixels_of_one_alone_are_a_share_of_those_that_either_covers():
    ours, theirs = np.array([0.5, 1.0, 0.0, 0.0]), np.array([3, 0, 255, 0], np.uint8)
    assert splats._alone(ours, theirs) == 2 / 3
    assert splats._alone(ours, ours) == 0.0


@pytest.mark.timeout(300)
@pytest.mark.usefixtures("needs_llvmpipe")
def test_splat_rows_compare_the_same_points(tmp_path):
    file = tmp_path / "rows.jsonl"
    command = ["bench", "splats", "--small", "--repeats", "1", "--output", str(file)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.stderr
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert {row["peer"].split()[0] for row in rows} == {"VTK", "llvmpipe", "the", "ours,"}
    with_vtk = [row for row in rows if row["peer"].startswith("VTK")]
    compared = [row for row in with_vtk if row["peer_error"] is not None]
    assert {row["case"].split()[1] for row in compared} == {"points", "lines"}
    for row in compared:
        # a point of a pixel covers one pixel of either; where it is on a border, another one
        limit = 0.02 if " points of" in row["case"] else 0.25
        assert row["peer_error"] < limit, row["case"]
    with_llvmpipe = [row for row in rows if row["peer"].startswith("llvmpipe")]
    kinds = [row["case"].split(" of")[0].split(",")[0] for row in with_llvmpipe]
    assert kinds == ["10000 points"] * 2 + ["4000 lines"] * 2 + ["4600 triangles"] * 2
    samples = ["samples=1" in row["case"] for row in with_llvmpipe]
    assert samples == [True, False] * 3
    for row in with_llvmpipe:
        # the same lists by the same rules: what differs are borders, by rounding
        assert row["peer_error"] < 0.002, row["case"]


@pytest.mark.timeout(300)
def test_bake_rows_compare_the_same_textures(tmp_path):
    file = tmp_path / "rows.jsonl"
    command = ["bench", "bake", "--small", "--repeats", "1", "--output", str(file)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.stderr
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert [list(row) for row in rows] == [KEYS] * 4
    assert [row["aim"] for row in rows] == [50.0, None, 10.0, None]
    assert [row["error_kind"].split(" RMSE")[0] for row in rows] == [
        "linear premultiplied colour",
        *["alpha"] * 3,
    ]
    for row in rows:
        # 16 samples: ours and embree's are spread evenly, mitsuba's are random
        assert 0.0 < row["ours_error"] < row["peer_error"] * 1.2
        assert row["peer_error"] < 0.05


@pytest.mark.timeout(300)
def test_cluster_rows_compare_the_same_leaves(tmp_path):
    file = tmp_path / "rows.jsonl"
    command = ["bench", "clusters", "--small", "--repeats", "1", "--output", str(file)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.stderr
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    frames = [row for row in rows if row["peer"] == "full mesh, leaves alone"]
    assert len(frames) == 2, "at 1 and 4 samples"
    for row in frames:
        # the mesh errs by aliasing alone, its cards by being flat as well
        assert 0.0 < row["peer_error"] < row["ours_error"] < 1.0
    rows = [row for row in rows if row not in frames]
    assert [list(row) for row in rows] == [KEYS] * (4 * 2 * 2 * 2 + 1)
    assert [row["aim"] for row in rows[:4]] == [10.0, 3.0, None, None]
    compared = [row for row in rows if row["peer_error"] is not None]
    assert len(compared) == 8, "sizes, planes, threads"
    for row in compared:
        # planes are fitted to planes: better than what is grouped by points
        assert 0.0 < row["ours_error"] < row["peer_error"]
    assert "exponent" in rows[-1]["error_kind"]


def test_aims_are_met_against_a_peers_best_time_only():
    secs = {"ours 1": 1.0, "ours 2": 0.5, "color 1": 20.0, "color 2": 40.0}
    secs |= {"alpha 1": 9.0, "alpha 2": 5.0, "trimesh": 6.0, "embreex": 3.0}
    errors = dict.fromkeys(
        ["ours color", "ours alpha", "color", "alpha", "trimesh", "embreex"], 0.01
    )
    rows = list(bake.compared("c", secs, errors, 256))
    assert [(row.speedup, row.aim) for row in rows] == [
        (20.0, None),
        (9.0, None),
        (6.0, None),
        (3.0, None),
        (40.0, 50.0),
        (10.0, None),
        (12.0, 10.0),
        (6.0, None),
    ]
    assert [row.peer[-9:] for row in rows] == ["threads=1"] * 5 + ["threads=2"] + ["threads=1"] * 2


def test_a_folder_that_is_not_there_is_refused_before_anything_is_measured(tmp_path):
    file = tmp_path / "missing" / "rows.jsonl"
    done = CliRunner().invoke(app, ["bench", "raster", "--output", str(file)])
    assert done.exit_code == 2
    assert "there is no folder" in done.stderr


def test_unknown_groups_are_refused():
    done = CliRunner().invoke(app, ["bench", "nothing"])
    assert done.exit_code == 2
    for name in GROUPS:
        assert name in done.stderr
