"""Does ``treelod sweep`` do what its file says, write what it promises, and fail in one line?"""

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from typer.testing import CliRunner

import treelod as tl
from made_results import comparison
from treelod.cli import app
from treelod.sweeps import command, worker
from treelod.sweeps.results import SweepResults

CONFIG = """
[plants]
lawn = { preset = "grass", leaf_count = 20 }
"a/b" = { preset = "grass", seed = 5, leaf_count = 20 }

[cameras]
azimuths = 2
elevations = 10
distances = [2.5, 10]
size = [48, 40]

[techniques.stochastic_pruning]
shrink = [0.1, 0.4]

[settings]
reference_samples = 16
repeats = 1
warmup = 0
"""


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Run the command in this process, on a file with this text."""
    monkeypatch.setenv("COLUMNS", "200")
    config = tmp_path / "grid.toml"

    def run(*arguments, text=CONFIG):
        config.write_text(text, encoding="utf-8")
        command = ["sweep", str(config), "-o", str(tmp_path / "out"), *map(str, arguments)]
        return CliRunner().invoke(app, command)

    return run


def test_writes_rows_tables_and_plots(run, tmp_path, monkeypatch):
    out = tmp_path / "out"
    done = run()
    assert done.exit_code == 0, done.output
    # 2 plants, 3 representations, 4 cameras
    table = pd.read_parquet(out / "results.parquet")
    assert len(table) == len(pd.read_csv(out / "results.csv")) == 24
    stored = tl.load_results(out)
    assert set(stored["key"]) == set(table["key"])
    assert table["seed"].tolist() == [1] * 12 + [5] * 12
    assert set(table["plant"]) == {"lawn", "a/b"}
    names = [
        f"{plant}_{plot}.png"
        for plant in ("00_lawn", "01_a_b")
        for plot in (
            "error_against_shrink",
            "error_by_azimuth",
            "error_by_distance",
            "memory_against_error",
            "speed_against_error",
        )
    ]
    assert sorted(path.name for path in (out / "plots").iterdir()) == names
    with Image.open(out / "plots" / names[0]) as picture:
        assert min(picture.size) > 200
    assert "lawn: medians and means over all views" in done.stdout
    assert "a/b: medians and means over all views" in done.stdout
    assert done.stdout.count("stochastic_pruning:shrink=0.4") == 2
    assert f"table: {out / 'results.csv'}, plots: {out / 'plots'}" in done.stdout
    assert f"next: treelod sweep {tmp_path / 'grid.toml'} -o {out}" in done.stdout
    # again: nothing is left to do
    monkeypatch.setattr(worker, "_row", lambda *_: pytest.fail("a cell was computed again"))
    again = run()
    assert again.exit_code == 0, again.output
    pd.testing.assert_frame_equal(pd.read_parquet(out / "results.parquet"), table)


def test_untimed_rows_have_no_plot_of_speed(run, tmp_path):
    text = CONFIG.replace('"a/b" = { preset = "grass", seed = 5, leaf_count = 20 }', "")
    done = run("--timing", "none", text=text)
    assert done.exit_code == 0, done.output
    plots = sorted(path.name for path in (tmp_path / "out" / "plots").iterdir())
    assert plots == [
        "error_against_shrink.png",
        "error_by_azimuth.png",
        "error_by_distance.png",
        "memory_against_error.png",
    ]
    assert "nan" not in done.stdout
    assert pd.read_parquet(tmp_path / "out" / "results.parquet")["frame_millis"].isna().all()


def test_plots_of_an_earlier_run_are_replaced_and_others_left_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(command.plots, "encode", lambda *_: b"")
    # of two plants, then of one: as the command writes them
    table = comparison(distances=(2.5,)).table().assign(timing="exclusive", threads=2)
    two = pd.concat([table, table.assign(plant="a/b")], ignore_index=True)
    command._write(SweepResults(two), tmp_path)
    names = {path.name for path in (tmp_path / "plots").iterdir()}
    assert "01_a_b_speed_against_error.png" in names
    assert len(names) == 8
    own = tmp_path / "plots" / "my_error_by_distance.png"
    own.write_bytes(b"mine")
    half = np.arange(len(table)) % 2 == 0
    command._write(SweepResults(table.assign(threads=np.where(half, 2, 8))), tmp_path)
    names = sorted(path.name for path in (tmp_path / "plots").iterdir())
    assert names == [
        "error_by_azimuth.png",
        "error_by_distance.png",
        "memory_against_error.png",
        "my_error_by_distance.png",
        "speed_against_error_2_threads.png",
        "speed_against_error_8_threads.png",
    ]
    assert own.read_bytes() == b"mine"


def test_options_go_before_the_file(run, tmp_path):
    done = run("--threads", 1, "--timing", "exclusive", "--workers", 1)
    assert done.exit_code == 0, done.output
    table = pd.read_parquet(tmp_path / "out" / "results.parquet")
    assert set(table["threads"]) == {1}
    assert set(table["timing"]) == {"exclusive"}


BAD = CONFIG.replace("shrink = [0.1, 0.4]", "shrink = [0.1, 7.0]")


def test_a_failed_cell_is_one_line_and_exit_code_1(run, tmp_path):
    done = run(text=BAD)
    assert done.exit_code == 1
    assert "error: plant 'lawn', stochastic_pruning(shrink=7.0), view 0: ValueError: shrink" in (
        done.stderr
    )
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out" / "results.csv").exists()


def test_keep_going_writes_the_rest_and_lists_what_failed(run, tmp_path):
    done = run("--keep-going", text=BAD)
    assert done.exit_code == 1
    assert len(pd.read_csv(tmp_path / "out" / "results.csv")) == 16
    assert done.stdout.count("failed: ") == 8
    assert "failed: lawn, stochastic_pruning, view 3: ValueError: shrink" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "text", "message"),
    [
        ((), "[plants", "grid.toml: it is no TOML"),
        ((), CONFIG.replace("shrink", "shrnk"), "stochastic_pruning: shrnk is no parameter"),
        ((), CONFIG.replace("reference_samples = 16", "reference_samples = 2"), "samples must be"),
        (("--threads", 0), CONFIG, "threads"),
        ((), f"{CONFIG}samples = '1'", "grid.toml: samples must be a whole number, got '1'"),
        ((), f"{CONFIG}threads = 1.5", "grid.toml: threads must be a whole number, got 1.5"),
        ((), f"{CONFIG}yee = 'no'", "grid.toml: yee must be True or False, got 'no'"),
        ((), f"{CONFIG}retries = -1", "grid.toml: retries must be at least 0, got -1"),
        ((), CONFIG.replace("azimuths = 2", "azimuths = 0"), "azimuths must be at least 1, got 0"),
        ((), CONFIG.replace("[48, 40]", "['a', 2]"), "size must be a whole number, got 'a'"),
        ((), CONFIG.replace("[2.5, 10]", "-1"), "distances must be finite and above 0"),
        (
            (),
            CONFIG.replace('{ preset = "grass", leaf_count = 20 }', "{ file = 5 }", 1),
            "plants.lawn: file must be text, got 5",
        ),
        (("--timing", "alone"), CONFIG, "timing must be 'shared', 'exclusive' or 'none'"),
        (("--scheduler", "tcp://127.0.0.1:1", "--workers", 1), CONFIG, "do not mix"),
    ],
)
def test_refuses(run, tmp_path, arguments, text, message):
    done = run(*arguments, text=text)
    assert done.exit_code in (1, 2)
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists(), "refused before a folder is made"


def test_a_folder_of_something_else_is_left_alone(run, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    done = run()
    assert done.exit_code == 1
    assert "is not empty and holds no sweep" in done.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]
