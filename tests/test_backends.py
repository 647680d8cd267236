"""Do comparisons, sweeps and walks time a graphics card, and leave all else to the processor?"""

import json
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import treelod as tl
from made_plants import random_crown
from made_sweeps import errors_of
from treelod import cli, comparison, walks
from treelod.cli.summaries import print_summary
from treelod.render import _times, frame_times, opened_card
from treelod.report import write_report
from treelod.report.walk import write_walk
from treelod.results import View
from treelod.sweeps import worker
from treelod.sweeps.cells import Cell, Settings
from treelod.sweeps.executors import Crew
from treelod.sweeps.grid import expand

PLANT = random_crown(30, trunk=True, name="crown")
CAMERAS = tl.orbit(PLANT, count=2, size=(40, 32))
GRID = {"slicings": {"slice_count": [1, 2], "resolution": 8}}
QUICK = {"reference_samples": 16, "repeats": 3, "warmup": 1}
WALK = {"tree_counts": (1, 2), "frame_count": 3, "laps": 1, "size": (32, 24), "samples": 1}
COMMAND = ["chestnut", "--leaf-count", "100", "-t", "stochastic_pruning"]
VIEWS = ["--azimuths", "1", "--elevations", "0", "--distances", "2.5", "--size", "48x32"]

on_card = pytest.mark.gpu


@pytest.fixture(scope="module")
def card():
    """Name and driver of the graphics card that is taken where nobody chooses."""
    try:
        return opened_card(None)
    except tl.NoAdapterError as error:
        if os.environ.get("CI") == "true":
            pytest.fail(f"there must be a graphics card, or llvmpipe, where CI is set: {error}")
        pytest.skip(f"needs a graphics card, or llvmpipe: {error}")


@pytest.fixture
def command(monkeypatch):
    """Run a command in this process."""
    monkeypatch.setenv("COLUMNS", "200")
    return lambda *arguments: CliRunner().invoke(cli.app, [str(part) for part in arguments])


def compare(**settings):
    return comparison.compare_techniques(
        PLANT, {"slicings": {"slice_count": 1, "resolution": 8}}, CAMERAS, **QUICK, **settings
    )


def sweep(folder, **settings):
    quick = {**QUICK, "progress": False, **settings}
    return tl.sweep(PLANT, GRID, CAMERAS, store=folder, **quick)


def no_work(*_, **__):
    pytest.fail("something was built before the arguments were refused")


ENTRIES = {
    "compare": lambda folder, **wrong: compare(**wrong),
    "sweep": lambda folder, **wrong: sweep(folder, **wrong),
    "walk": lambda folder, **wrong: walks.walk(
        PLANT, {"mesh": tl.FullMesh.build(PLANT)}, **WALK, **wrong
    ),
}


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("entry", ENTRIES)
@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        ({"backend": "metal"}, ValueError, "backend must be 'cpu' or 'gpu', got 'metal'"),
        ({"backend": None}, ValueError, "backend must be 'cpu' or 'gpu', got None"),
        ({"adapter": "x"}, ValueError, "adapter names a graphics card, which backend='cpu'"),
        ({"backend": "gpu", "adapter": 1}, TypeError, "adapter must be a str or None, got int"),
    ],
)
def test_bad_names_are_refused_before_any_work(tmp_path, monkeypatch, entry, wrong, error, message):
    monkeypatch.setattr(comparison, "_build", no_work)
    monkeypatch.setattr(walks, "_scenes", no_work)
    with pytest.raises(error, match=message):
        ENTRIES[entry](tmp_path / "rows", **wrong)
    assert not (tmp_path / "rows").exists()


@on_card
@pytest.mark.parametrize("entry", ENTRIES)
def test_an_unknown_card_is_refused_before_any_work(tmp_path, monkeypatch, card, entry):
    monkeypatch.setattr(comparison, "_build", no_work)
    monkeypatch.setattr(walks, "_scenes", no_work)
    with pytest.raises(tl.NoAdapterError) as caught:
        ENTRIES[entry](tmp_path / "rows", backend="gpu", adapter="no such card")
    assert '"no such card"' in str(caught.value)
    assert card[0] in str(caught.value), "it lists those there are"
    assert not (tmp_path / "rows").exists()


# --- comparisons ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def compared(card):
    return compare(), compare(backend="gpu", adapter=card[0])


@on_card
def test_a_comparison_on_a_card_has_the_processors_errors_and_counts(compared):
    here, there = (result.table() for result in compared)
    of_times = {name for name in here if name.startswith("frame_millis")} | {
        "speedup", "gpu_millis", "backend", "adapter", "driver", "build_secs", "date",
    }  # fmt: skip
    assert list(here) == list(there)
    assert here.dtypes.equals(there.dtypes)
    for name in set(here) - of_times:
        pd.testing.assert_series_equal(here[name], there[name], check_exact=True)
    assert there["fragments"].gt(0).all(), "those of the processor: a card counts none"


@on_card
def test_a_comparison_says_what_drew(compared, card):
    here, there = (result.table() for result in compared)
    assert set(here["backend"]) == {"cpu"}
    assert here[["adapter", "driver", "gpu_millis"]].isna().all(axis=None)
    assert set(there["backend"]) == {"gpu"}
    assert (set(there["adapter"]), set(there["driver"])) == ({card[0]}, {card[1]})
    assert there["gpu_millis"].isna().nunique() == 1, "a card tells for all rows or for none"
    # of the same frames, of which it is a part
    told = there["gpu_millis"].notna()
    assert (there["gpu_millis"] <= there["frame_millis_max"])[told].all()
    assert (there["gpu_millis"] > 0)[told].all()


@on_card
def test_the_report_names_card_and_driver(compared, card, tmp_path):
    page = write_report(compared[1], tmp_path).read_text()
    assert "Drawn on the CPU with" not in page
    assert f"Drawn by a graphics card, {card[0]} (driver: {card[1]})" in page
    assert f"<td>graphics card</td><td>{card[0]}, driver {card[1]}" in page
    stored = pd.read_parquet(tmp_path / "results.parquet")
    assert set(stored["adapter"]) == {card[0]}


@on_card
def test_tables_hold_what_a_card_told_and_nothing_of_the_processor(compared, tmp_path, capsys):
    here, there = compared
    print_summary("here", here.summary(), 4)
    assert "card ms" not in capsys.readouterr().out
    assert "its clock, ms" not in write_report(here, tmp_path / "here").read_text()
    summary = there.summary().assign(gpu_millis=[1234.0, 777.0])
    told = there.table().groupby("label", sort=False)["gpu_millis"].median()
    pd.testing.assert_series_equal(there.summary().set_index("label")["gpu_millis"], told)
    print_summary("there", summary, 4)
    printed = capsys.readouterr().out
    assert all(words in printed for words in ("card ms", "1,234", "777"))
    print_summary("part of it", summary.assign(gpu_millis=[1234.0, np.nan]), 4)
    assert "1,234" in capsys.readouterr().out
    page = write_report(there, tmp_path / "there").read_text()
    assert page.count("its clock, ms") == (0 if told.isna().any() else 2), "in either table"


def test_times_are_those_that_the_frames_took():
    mesh = tl.FullMesh.build(PLANT)
    settings = {"samples": 1, "warmup": 0, "repeats": 2, "threads": 1}
    times = frame_times({"mesh": mesh}, CAMERAS[0], backend="cpu", adapter=None, **settings)["mesh"]
    assert times.frame_millis.shape == (2,)
    assert times.frame_millis.dtype == np.float64
    assert (times.gpu_millis, times.adapter, times.driver) == (None, None, None)
    frame = {"emit_millis": 1.0, "draw_millis": 2.5, "adapter": "a", "driver": "b"}
    told = _times([{**frame, "gpu_millis": 2.0}, {**frame, "gpu_millis": 1.5}])
    assert told.frame_millis.tolist() == [3.5, 3.5]
    assert told.gpu_millis.tolist() == [2.0, 1.5]
    assert (told.adapter, told.driver) == ("a", "b")
    # a median over frames of which some are not told says nothing
    assert _times([{**frame, "gpu_millis": 2.0}, {**frame, "gpu_millis": None}]).gpu_millis is None


# --- sweeps --------------------------------------------------------------------------------------


def cell(**settings):
    view = View.of(PLANT, 0, CAMERAS[0])
    (variant,) = expand({"full_mesh": {}})
    checked = Settings.checked(**settings)
    if checked.backend == "gpu":
        checked = checked.on_card(checked.adapter)
    return Cell.of("crown", PLANT.digest, variant, view, checked, "0" * 32)


def test_keys_tell_backends_and_cards_apart():
    one, other = ({"backend": "gpu", "adapter": name} for name in ("one card", "another"))
    assert len({cell(**which).key for which in ({}, one, other)}) == 3
    assert cell(**one).key == cell(**one).key
    # a card draws nothing but what is timed
    untimed = cell(timing="none", **one)
    assert untimed.key == cell(timing="none").key
    assert "backend" not in json.dumps(untimed.identity)


def test_errors_are_looked_for_under_the_processors_keys():
    card = {"backend": "gpu", "adapter": "one card", "repeats": 3}
    assert cell(**card).same_errors() == [cell(repeats=3).key, cell(timing="none").key]
    assert cell(repeats=3).same_errors() == []
    assert cell(timing="none").same_errors() == []


@pytest.fixture(scope="module")
def swept(card, tmp_path_factory):
    """A sweep on the processor, then the same on a card, in one store."""
    folder = tmp_path_factory.mktemp("sweep") / "rows"
    return sweep(folder), sweep(folder, backend="gpu"), folder


@on_card
def test_a_row_of_the_processor_is_none_of_a_card(swept, card):
    here, there, folder = swept
    assert not set(here["key"]) & set(there["key"])
    assert set(here["backend"]) == {"cpu"}
    assert here[["adapter", "driver", "gpu_millis"]].isna().all(axis=None)
    assert set(there["backend"]) == {"gpu"}
    assert (set(there["adapter"]), set(there["driver"])) == ({card[0]}, {card[1]})
    assert there["frame_millis"].notna().all()
    assert (here["frame_millis"].to_numpy() != there["frame_millis"].to_numpy()).all()
    # each is found again, under a part of the name too
    for again, known in (
        (sweep(folder), here),
        (sweep(folder, backend="gpu", adapter=card[0].upper()[:6]), there),
    ):
        assert again.attrs["work"] == {"stored": len(known), "workers": {}}
        pd.testing.assert_frame_equal(again, known)


@on_card
def test_errors_are_not_measured_again_for_a_card(swept):
    here, there, _ = swept
    assert errors_of(here) == errors_of(there)
    (work,) = there.attrs["work"]["workers"].values()
    assert there.attrs["work"]["stored"] == 0
    assert work["cells"] == len(there)
    assert work.get("references", 0) == 0, "references are drawn for errors alone"
    (before,) = here.attrs["work"]["workers"].values()
    assert before["references"] == len(CAMERAS), "else the line above shows nothing"


@on_card
@pytest.mark.parametrize("timing", ["shared", "exclusive"])
def test_a_store_without_errors_gives_the_same_rows(swept, tmp_path, timing):
    _, there, _ = swept
    fresh = sweep(tmp_path / "rows", backend="gpu", timing=timing)
    assert errors_of(fresh) == errors_of(there)
    same = ["label", "view", "backend", "adapter", "driver", "params", "fragments"]
    pd.testing.assert_frame_equal(pd.DataFrame(fresh[same]), pd.DataFrame(there[same]))
    assert fresh["frame_millis"].notna().all()
    assert set(fresh["timing"]) == {timing}
    assert fresh.dtypes.equals(there.dtypes)


@on_card
def test_untimed_rows_serve_a_card_too(card, tmp_path, monkeypatch):
    folder = tmp_path / "rows"
    bare = sweep(folder, timing="none", backend="gpu")
    assert card
    assert set(bare["backend"]) == {"cpu"}, "nothing was drawn with a card"
    monkeypatch.setattr(worker, "error_frames", no_work)
    timed = sweep(folder, timing="exclusive", backend="gpu")
    assert errors_of(timed) == errors_of(bare)
    assert timed["frame_millis"].notna().all()
    assert timed["repeats"].tolist() == [3] * len(timed)
    assert set(timed["timing"]) == {"exclusive"}


@on_card
def test_both_backends_in_one_table_are_kept_apart(swept):
    here, there, folder = swept
    both = tl.load_results(folder)
    assert len(both) == len(here) + len(there)
    summary = both.summary()
    assert len(summary) == 2 * here["label"].nunique()
    assert summary.groupby("label")["backend"].apply(sorted).tolist() == [["cpu", "gpu"]] * 3
    of_card = summary[summary["backend"] == "gpu"].set_index("label")["frame_millis"]
    expected = there.groupby("label")["frame_millis"].median()
    pd.testing.assert_series_equal(of_card, expected, check_names=False)
    with pytest.raises(ValueError, match=r"two rows for .*backend"):
        both.to_xarray()
    with pytest.raises(ValueError, match="2 values of 'backend'"):
        tl.plots.speed_against_error(both)
    assert tl.plots.memory_against_error(both).axes, "which is of no time"


@on_card
def test_processes_open_devices_of_their_own(swept, card, tmp_path):
    _, there, _ = swept
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        table = sweep(tmp_path / "rows", backend="gpu", executor=pool)
    assert errors_of(table) == errors_of(there)
    assert set(table["adapter"]) == {card[0]}
    (name,) = table.attrs["work"]["workers"]
    assert not name.endswith(f":{os.getpid()}")


@on_card
def test_own_processes_open_devices_too(card, tmp_path):
    # after this process has opened one: a fork of it could not
    table = sweep(tmp_path / "rows", backend="gpu", executor=1, reference_samples=4)
    assert set(table["adapter"]) == {card[0]}
    assert table["frame_millis"].notna().all()


@on_card
def test_a_worker_with_another_card_fails_its_cells(card, tmp_path, monkeypatch):
    # a machine of a cluster, say, whose only card is another one
    monkeypatch.setattr(Crew, "card", lambda *_: card[0][:8])
    with pytest.raises(tl.SweepError, match=r"draws with .*, and not with") as caught:
        sweep(tmp_path / "rows", backend="gpu")
    assert isinstance(caught.value.__cause__, tl.NoAdapterError)


# --- walks ---------------------------------------------------------------------------------------


@on_card
def test_a_walk_on_a_card(card, tmp_path):
    subjects = {"mesh": tl.FullMesh.build(PLANT)}
    here = walks.walk(PLANT, subjects, **WALK)
    there = walks.walk(PLANT, subjects, **WALK, backend="gpu", adapter=card[0])
    counted = ["label", "tree_count", "frames", "primitives", *walks.KINDS]
    pd.testing.assert_frame_equal(here.table[counted], there.table[counted])
    assert here.table.dtypes.equals(there.table.dtypes)
    assert here.table[["gpu_millis", "adapter", "driver"]].isna().all(axis=None)
    assert set(here.table["backend"]) == {"cpu"}
    assert set(there.table["backend"]) == {"gpu"}
    assert (set(there.table["adapter"]), set(there.table["driver"])) == ({card[0]}, {card[1]})
    assert there.settings["adapter"] == card[0]
    assert (
        f"on the graphics card\n{card[0]} (driver: {card[1]})"
        in write_walk(there, tmp_path / "there").read_text()
    )
    assert "graphics card" not in write_walk(here, tmp_path / "here").read_text()


# --- commands ------------------------------------------------------------------------------------


@on_card
def test_commands_draw_with_a_card(command, card, tmp_path):
    chosen = ["--backend", "gpu", "--adapter", card[0][:6]]
    out = tmp_path / "compare"
    quick = [*VIEWS, "--repeats", 1, "--reference-samples", 4]
    done = command("compare", *COMMAND, "-o", out, *quick, *chosen)
    assert done.exit_code == 0, done.stderr
    assert f"times of {card[0]}" in done.stdout
    assert set(pd.read_parquet(out / "results.parquet")["adapter"]) == {card[0]}

    out = tmp_path / "walk"
    few = ["--trees", "1", "--frames", "2", "--laps", "1", "--size", "32x24", "--samples", "1"]
    done = command("walk", *COMMAND, "-o", out, *few, *chosen)
    assert done.exit_code == 0, done.stderr
    assert card[0] in done.stdout
    assert set(pd.read_parquet(out / "walk.parquet")["adapter"]) == {card[0]}


FILE = """
[plants]
c = { preset = "chestnut", leaf_count = 60 }
[cameras]
azimuths = 1
elevations = [0]
distances = [2.5]
size = [40, 32]
[techniques.stochastic_pruning]
[settings]
reference_samples = 4
repeats = 1
backend = "gpu"
adapter = "cpu"
"""


@on_card
def test_a_file_may_name_backend_and_card_and_the_command_another(command, card, tmp_path):
    file, out = tmp_path / "grid.toml", tmp_path / "rows"
    kinds = {adapter.kind for adapter in tl.gpu.adapters()}
    file.write_text(FILE if "cpu" in kinds else FILE.replace('"cpu"', json.dumps(card[0])))
    done = command("sweep", file, "-o", out)
    assert done.exit_code == 0, done.stderr
    table = pd.read_parquet(out / "results.parquet")
    assert set(table["backend"]) == {"gpu"}
    assert f"times of {table['adapter'][0]}" in done.stdout
    done = command("sweep", file, "-o", out, "--backend", "cpu")
    assert done.exit_code == 0, done.stderr
    table = pd.read_parquet(out / "results.parquet")
    assert set(table["backend"]) == {"cpu"}
    assert table["adapter"].isna().all()
    unknown = ["--adapter", "no such card"]
    done = command("sweep", file, "-o", tmp_path / "new", *unknown)
    assert done.exit_code == 1
    assert "no such card" in done.stderr
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["compare", "walk", "demo", "sweep"])
def test_commands_refuse_bad_names_before_a_plant_is_grown(command, tmp_path, monkeypatch, name):
    monkeypatch.setattr("treelod.cli.subjects.grow_plant", no_work)
    monkeypatch.setattr("treelod.sweeps.config.grow_plant", no_work)
    file = tmp_path / "grid.toml"
    file.write_text(FILE.replace('backend = "gpu"\nadapter = "cpu"\n', ""))
    subject = {"demo": [], "sweep": [file]}.get(name, COMMAND)
    done = command(name, *subject, "-o", tmp_path / "out", "--backend", "metal")
    assert done.exit_code == 2
    assert "'metal' is not one of 'cpu', 'gpu'" in done.stderr
    done = command(name, *subject, "-o", tmp_path / "out", "--adapter", "x")
    assert done.exit_code == 1
    assert "adapter names a graphics card" in done.stderr
    assert not (tmp_path / "out").exists()


@on_card
def test_gpu_lists_the_cards(command, card):
    done = command("gpu")
    assert done.exit_code == 0, done.stderr
    for adapter in tl.gpu.adapters():
        assert adapter.name in done.stdout
        assert adapter.driver in done.stdout
    places = [line.split()[1] for line in done.stdout.splitlines() if "#" in line[:8]]
    assert places == [f"#{place}" for place in range(len(tl.gpu.adapters()))]
    assert card[0] in done.stdout


def test_gpu_says_what_to_install_where_there_is_none(command, monkeypatch):
    def missing(_):
        msg = "there is no graphics adapter: install one"
        raise tl.NoAdapterError(msg)

    monkeypatch.setattr("treelod.cli.gpu.adapters", list)
    monkeypatch.setattr("treelod.cli.gpu.opened_card", missing)
    done = command("gpu")
    assert done.exit_code == 1
    assert done.stderr == "error: there is no graphics adapter: install one\n"
