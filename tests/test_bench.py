"""Do benchmarks give rows, and do all tools in them draw the same?"""

import importlib.util
import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

import treelod
from treelod.bench import GROUPS, Row, bake, interleaved
from treelod.cli import app

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


def test_runs_take_turns_and_medians_ignore_the_warm_up():
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
    with pytest.raises(ValueError, match="repeats"):
        interleaved({}, repeats=0)
    with pytest.raises(ValueError, match="nan seconds"):
        interleaved({"a": lambda: float("nan")}, repeats=1)


def has_llvmpipe():
    folders = [Path("/usr/share/vulkan/icd.d"), Path("/usr/local/share/vulkan/icd.d")]
    drivers = [driver for folder in folders for driver in folder.glob("lvp_icd.*")]
    return bool(drivers) and importlib.util.find_spec("wgpu") is not None


@pytest.mark.skipif(
    not has_llvmpipe() and "CI" not in os.environ,
    reason="llvmpipe is not installed (Debian has it in mesa-vulkan-drivers)",
)
def test_raster_rows_compare_the_same_picture(tmp_path):
    file = tmp_path / "rows.jsonl"
    command = ["bench", "raster", "--small", "--repeats", "1", "--output", str(file)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.stderr
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert {row["peer"].split(" (")[0] for row in rows} == {
        "llvmpipe",
        "ours, scalar",
        "the slow twin",
        "bound: a copy of the bytes touched",
    }
    compared = [row for row in rows if row["peer_error"] is not None]
    assert len(compared) == 4, "at 1 and 4 samples, on 1 and 2 threads"
    for row in compared:
        assert row["peer_error"] == pytest.approx(row["ours_error"], rel=SAME_PICTURE)


@pytest.mark.skipif(
    (not has_llvmpipe() or importlib.util.find_spec("vtk") is None) and "CI" not in os.environ,
    reason="VTK and llvmpipe are not installed (treelod[bench], and mesa-vulkan-drivers on Debian)",
)
def test_splat_rows_compare_the_same_points(tmp_path):
    file = tmp_path / "rows.jsonl"
    command = ["bench", "splats", "--small", "--repeats", "1", "--output", str(file)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.stderr
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    assert {row["peer"].split()[0] for row in rows} == {"VTK", "the", "ours,"}
    compared = [row for row in rows if row["peer_error"] is not None]
    assert {row["case"].split()[1] for row in compared} == {"points", "lines"}
    for row in compared:
        # a point of a pixel covers one pixel of either; where it is on a border, another one
        limit = 0.02 if " points of" in row["case"] else 0.25
        assert row["peer_error"] < limit, row["case"]


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
