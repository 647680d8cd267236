"""Do the commands do what their help says, and fail in one line?"""

import json
import os
import pty
import re
import select
import subprocess
import sys
import time

import pandas as pd
import pytest
from typer.testing import CliRunner

import treelod
from treelod.cli import app, options
from treelod.techniques import REGISTRY

FEW = ["--azimuths", "1", "--elevations", "0", "--size", "64x48", "--distances", "2.5"]
FAST = [*FEW, "--repeats", "1", "--reference-samples", "4", "--leaf-count", "300"]
COARSE = ["--technique", "slicings:resolution=16,slicing_count=2"]


@pytest.fixture
def run(monkeypatch):
    """Run a command in this process: a new one would spend its time on imports."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments):
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    return run


def test_runs_as_a_module_and_says_its_version():
    command = [sys.executable, "-W", "error", "-m", "treelod", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"treelod {treelod.__version__}\n"


def test_help_does_not_wait_for_large_libraries():
    code = (
        "import sys, treelod.cli; "
        "sys.exit(str({'matplotlib', 'pandas', 'OpenImageIO', 'skimage'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr == "set()\n"


@pytest.mark.parametrize("command", ["compare", "demo", "grow", "sweep", "validate", "walk"])
def test_help_explains_every_option(run, command):
    done = run(command, "--help")
    assert done.exit_code == 0
    options = re.findall(r"--[a-z-]+", done.stdout)
    assert "--output" in options
    # no square brackets lost to markup
    if command == "compare":
        assert "[default: 1024x768]" in done.stdout
        assert "slicings" in done.stdout
        assert "chestnut" in done.stdout


def test_grow_writes_a_plant_that_loads(run, tmp_path):
    file = tmp_path / "c.glb"
    done = run("grow", "chestnut", "-o", file, "--leaf-count", 200, "--seed", 3)
    assert done.exit_code == 0, done.stderr
    assert str(file) in done.stdout
    grown, loaded = treelod.grow_plant("chestnut", seed=3, leaf_count=200), treelod.load_plant(file)
    assert loaded.triangle_count == grown.triangle_count
    assert loaded.foliage.leaf_count == 200
    again = tmp_path / "d.glb"
    run("grow", "chestnut", "-o", again, "--leaf-count", 200, "--seed", 3)
    assert again.read_bytes() == file.read_bytes()


@pytest.mark.parametrize(("target", "why"), [("no/a.glb", "no folder"), ("a.glb", "is a folder")])
def test_grow_refuses_a_file_it_cannot_write_before_it_grows(
    run, tmp_path, monkeypatch, target, why
):
    (tmp_path / "a.glb").mkdir()
    monkeypatch.setattr("treelod.cli.subjects.grow_plant", lambda *_, **__: pytest.fail("it grows"))
    done = run("grow", "chestnut", "-o", str(tmp_path / target))
    assert done.exit_code == 1
    assert why in done.stderr


def test_compare_grown_and_loaded(run, tmp_path):
    out = tmp_path / "new" / "folder"
    done = run("compare", "chestnut", "-o", out, *FAST, *COARSE, "--seed", 2, "--threads", 1)
    assert done.exit_code == 0, done.stderr
    assert str(out / "report.html") in done.stdout
    assert "slicings:resolution=16,slicing_count=2" in done.stdout
    assert "full_mesh (4 samples)" in done.stdout
    # a line a stage, nothing that moves
    stages = [line.partition(":")[0] for line in done.stderr.splitlines()]
    assert stages == [
        "growing chestnut",
        "baking slicings",
        "building",
        "reference frames",
        "error frames",
        "timing",
        "writing the report",
    ]
    table = pd.read_parquet(out / "results.parquet")
    assert len(table) == 2
    assert set(table["seed"]) == {2}
    assert set(table["threads"]) == {1}
    assert json.loads(table["params"][1])["resolution"] == [16, 16]

    file = tmp_path / "plant.glb"
    assert run("grow", "chestnut", "-o", file, "--leaf-count", 300).exit_code == 0
    done = run("compare", file, "-o", tmp_path / "b", *FAST[:-2], *COARSE)
    assert done.exit_code == 0, done.stderr
    assert len(set(pd.read_csv(tmp_path / "b" / "results.csv")["plant_sha256"])) == 1


def test_demo_small_by_default_into_demo(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run("demo", "--small")
    assert done.exit_code == 0, done.stderr
    assert done.stdout.rstrip().endswith("report: demo/report.html")
    table = pd.read_parquet(tmp_path / "demo" / "results.parquet")
    assert set(table["technique"]) == set(REGISTRY)
    # none of them bakes for longer than a glance: the textures are small
    assert table["texture_bytes"].max() < 2**24


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("16", 16),
        ("0.5", 0.5),
        ("1e+5", 1e5),
        ("+5", 5),
        ("None", None),
        ("true", True),
        ("rotate", "rotate"),
        ("16+8", (16, 8)),
        ("2.5+10+40", (2.5, 10, 40)),
        ("16+", "16+"),
        ("16+few", "16+few"),
    ],
)
def test_values_of_parameters(text, value):
    read = options.value_of(text)
    assert (read, type(read)) == (value, type(value))


def test_compare_leaf_clusters(run, tmp_path):
    specs = [
        "leaf_clusters:cluster_count=8,flatten=rotate,resolution=32",
        "leaf_clusters:cluster_count=8+4,resolution=32+16,level_distances=3.5,drawing=coverage",
    ]
    options = [option for spec in specs for option in ("-t", spec)]
    done = run("compare", "chestnut", "-o", tmp_path / "out", *FAST, *options)
    assert done.exit_code == 0, done.stderr
    table = pd.read_parquet(tmp_path / "out" / "results.parquet")
    assert set(specs) < set(table["label"])
    params = {row.label: json.loads(row.params) for row in table.itertuples()}
    assert params[specs[0]]["flatten"] == "rotate"
    assert params[specs[0]]["cluster_count"] == 8
    assert params[specs[1]]["cluster_count"] == [8, 4]
    assert params[specs[1]]["resolution"] == [32, 16]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["compare", "nowhere.glb", "-o", "out"], 1, "there is no file nowhere.glb"),
        (["compare", "taken", "-o", "out"], 1, "error: "),  # a file of no known format
        (["compare", "chestnut", "-o", "taken"], 1, "taken is a file"),
        (["compare", "chestnut"], 2, "--output"),
        (["compare", "chestnut", "-o", "out", "-t", "sketches"], 2, "no technique 'sketches'"),
        (["compare", "chestnut", "-o", "out", "-t", "slicings:x=1"], 2, "parameters of slicings"),
        (["compare", "chestnut", "-o", "out", "-t", "slicings:resolution"], 2, "'resolution' in"),
        (["compare", "chestnut", "-o", "out", "-t", "slicings:resolution=0"], 1, "resolution"),
        (
            ["compare", "chestnut", "-o", "out", "-t", "leaf_clusters:cluster_count=8+16"],
            1,
            "cluster_count",
        ),
        (
            ["compare", "chestnut", "-o", "out", "-t", "leaf_clusters:level_distances=3"],
            1,
            "level_distances",
        ),
        (["compare", "chestnut", "-o", "out", "--size", "big"], 2, "not WIDTHxHEIGHT"),
        (["compare", "chestnut", "-o", "out", "--size", "0x9"], 1, "size must be 1 to 16384"),
        (["compare", "chestnut", "-o", "out", "--size", "16384x16384"], 1, "268435456 pixels"),
        (["compare", "chestnut", "-o", "out", "--distances", "a,b"], 2, "list of numbers"),
        (["compare", "chestnut", "-o", "out", "--distances", "-1"], 1, "distance must be"),
        (["compare", "chestnut", "-o", "out", "--azimuths", "0"], 2, "--azimuths"),
        (["compare", "chestnut", "-o", "out", "--foliage", "leaf"], 2, "is grown"),
        (["compare", "taken", "-o", "out", "--seed", "1"], 2, "is a file"),
        (["grow", "oak", "-o", "a.glb"], 2, "no preset 'oak'; there are"),
        (["grow", "chestnut", "-o", "a.obj"], 2, "must end in .glb"),
        (["grow", "chestnut", "-o", "no/folder/a.glb", "--leaf-count", "1"], 1, "no folder"),
        (["frobnicate"], 2, "frobnicate"),
    ],
)
def test_fails_in_one_line_and_leaves_nothing_behind(
    run, tmp_path, monkeypatch, arguments, code, message
):
    (tmp_path / "taken").write_text("mine")
    monkeypatch.chdir(tmp_path)
    done = run(*arguments)
    assert (done.exit_code, done.stdout) == (code, "")
    assert message in done.stderr
    assert done.exception is None or isinstance(done.exception, SystemExit)
    if code == 1:
        assert sum(line.startswith("error: ") for line in done.stderr.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["taken"]
    assert (tmp_path / "taken").read_text() == "mine"


def test_verbose_shows_the_traceback(run, tmp_path):
    done = run("compare", "nowhere.glb", "-o", tmp_path / "out", "-v")
    assert done.exit_code == 1
    # the interpreter prints what is not caught
    assert isinstance(done.exception, FileNotFoundError)


def test_names_with_markup_are_shown_as_they_are(run, tmp_path):
    done = run("compare", "[bold]x[/bold].glb", "-o", tmp_path / "out")
    assert "there is no file [bold]x[/bold].glb" in done.stderr


def test_bars_in_a_terminal(tmp_path):
    leader, follower = pty.openpty()
    command = [sys.executable, "-m", "treelod", "compare", "chestnut", "-o", str(tmp_path / "out")]
    process = subprocess.Popen(
        [*command, *FAST, *COARSE],
        stdout=subprocess.DEVNULL,
        stderr=follower,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "100"},
    )
    os.close(follower)
    seen, deadline = b"", time.monotonic() + 60
    while time.monotonic() < deadline:
        if select.select([leader], [], [], 0.2)[0]:
            try:
                chunk = os.read(leader, 65536)
            except OSError:  # Linux: the other side has closed
                break
            if not chunk:
                break
            seen += chunk
    os.close(leader)
    assert process.wait(timeout=60) == 0
    for stage in ("growing chestnut", "building", "error frames", "timing", "writing the report"):
        assert stage in seen.decode(errors="replace")
    assert b"\x1b[" in seen, "something moves"
