"""Does a sweep measure every cell once, keep it, and say in its table what it is?"""

import math
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import treelod as tl
from made_sweeps import ERRORS, GRID, OTHER, PLANT, QUICK, SIZE, cameras, errors_of, record
from treelod.comparison import compare_techniques
from treelod.errors import LimitError, StoreError, SweepError, SweepWarning
from treelod.kernel_version import LIBRARIES, MODULES, kernel_version
from treelod.sweeps import driver, worker

LABELS = [
    "full_mesh",
    "slicings:slice_count=1,resolution=8",
    "slicings:slice_count=1,resolution=16",
    "slicings:slice_count=3,resolution=8",
    "slicings:slice_count=3,resolution=16",
    "stochastic_pruning:shrink=0.1",
    "stochastic_pruning:shrink=0.4",
]


def run(folder, plants=PLANT, grid=GRID, views=cameras, **settings):
    return tl.sweep(plants, grid, views, store=folder, **{**QUICK, **settings})


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Table and folder of two plants."""
    folder = tmp_path_factory.mktemp("sweep") / "rows"
    table = run(
        folder,
        {"crown": PLANT, "other": OTHER},
        sources={"other": {"sha256": "ab" * 32, "seed": 7}},
    )
    return table, folder


# The table


def test_one_row_a_cell_in_the_order_of_the_grid(swept):
    table, _ = swept
    assert isinstance(table, tl.SweepResults)
    assert isinstance(table, pd.DataFrame)
    assert [*zip(table["plant"], table["label"], table["view"], strict=True)] == [
        (plant, label, view)
        for plant in ("crown", "other")
        for label in LABELS
        for view in (0, 1, 2)
    ]
    assert table.index.tolist() == [*range(42)]
    assert table["key"].is_unique


def test_errors_and_costs_are_those_of_a_comparison(swept):
    table, _ = swept
    compared = compare_techniques(
        PLANT,
        {
            label: {}
            if label == "full_mesh"
            else {
                name: float(value) if "." in value else int(value)
                for name, value in (pair.split("=") for pair in label.split(":")[1].split(","))
            }
            for label in LABELS
        },
        cameras(PLANT),
        reference_samples=16,
        repeats=1,
        warmup=0,
    ).table()
    own = table[table["plant"] == "crown"].reset_index(drop=True)
    # times differ from run to run, and how often frames were timed was asked for differently
    differ = {"date", "build_secs", "speedup", "plant", "repeats"}
    differ |= {name for name in compared if name.startswith("frame_millis")}
    assert set(compared) <= set(own), "every column of a comparison"
    for name in compared:
        if name not in differ:
            pd.testing.assert_series_equal(own[name], compared[name], check_exact=True)


def test_types_are_those_of_a_comparison_too(swept):
    table, _ = swept
    compared = compare_techniques(PLANT, {}, cameras(PLANT, 1), repeats=1, warmup=0).table()
    assert table.dtypes[compared.columns].to_dict() == compared.dtypes.to_dict()
    joined = pd.concat([compared, table])
    assert len(joined) == len(table) + 1


def test_columns_say_what_a_cell_is(swept):
    table, _ = swept
    columns = {
        "plant_digest": [PLANT.digest] * 21 + [OTHER.digest] * 21,
        "kernel_version": [kernel_version()] * 42,
        "timing": ["shared"] * 42,
        "backend": ["cpu"] * 42,
        "time_samples": [4] * 42,
        "reference_samples": [16] * 42,
        "repeats": [2] * 42,
        "warmup": [0] * 42,
        "width": [SIZE[0]] * 42,
    }
    for name, expected in columns.items():
        assert table[name].tolist() == expected, name
    assert table["adapter"].isna().all(), "a processor is no adapter"
    assert str(table["adapter"].dtype) == "string"
    assert table["plant_sha256"].isna().tolist() == [True] * 21 + [False] * 21
    assert table["seed"].dropna().tolist() == [7] * 21
    for name in ("cpu", "treelod_version", "numpy_version", "date", "core_count", "threads"):
        assert table[name].notna().all(), name


def test_parameters_have_columns_of_their_type(swept):
    table, _ = swept
    assert [name for name in table if name.startswith("param_")] == [
        "param_slice_count",
        "param_resolution",
        "param_shrink",
    ]
    own = table[table["view"] == 0].iloc[:7]
    assert own["param_slice_count"].fillna(-1).tolist() == [-1, 1, 1, 3, 3, -1, -1]
    assert own["param_resolution"].fillna(-1).tolist() == [-1, 8, 16, 8, 16, -1, -1]
    assert own["param_shrink"].fillna(-1).tolist() == [-1, -1, -1, -1, -1, 0.1, 0.4]
    assert str(own["param_slice_count"].dtype) == "Int64"
    assert str(own["param_shrink"].dtype) == "float64"


def test_parameters_of_mixed_types_are_text(tmp_path):
    grid = {
        "slicings": {"correction": [0.25, "fit"], "resolution": [(8, 4)], "wood": [True]},
        "points_and_lines": {},
    }
    table = run(tmp_path / "rows", grid=grid, views=cameras(PLANT, 1), timing="none")
    assert table["param_correction"].fillna("").tolist() == ["", "0.25", "fit", ""]
    assert table["param_resolution"].fillna("").tolist() == ["", "[8,4]", "[8,4]", ""]
    # a parameter that a technique has, and that was not given for it, has its default
    assert table["param_wood"].tolist() == [True] * 4
    assert str(table["param_wood"].dtype) == "boolean"
    back = tl.load_results(tmp_path / "rows")
    assert back["param_correction"].dtype == table["param_correction"].dtype


def test_overdraw_is_fragments_a_covered_pixel(swept):
    table, _ = swept
    row = table.iloc[0]
    frame = tl.render(tl.FullMesh.build(PLANT), cameras(PLANT)[0], samples=4)
    covered = int((frame.color[..., 3] > 0).sum())
    assert row["fragments"] == frame.stats.fragments
    assert row["overdraw"] == frame.stats.fragments / covered
    assert (table["overdraw"] >= 1.0).all()


def test_overdraw_is_the_mean_of_the_sets_of_samples(tmp_path):
    table = run(tmp_path / "rows", grid={}, views=cameras(PLANT, 1), samples=33, timing="none")
    frame = tl.render(tl.FullMesh.build(PLANT), cameras(PLANT, 1)[0], samples=33)
    # 16, 16 and 1: each is drawn, and counted, by itself
    covered = int((frame.color[..., 3] > 0).sum())
    assert table["overdraw"][0] == frame.stats.fragments / covered / 3


def test_a_view_of_nothing_has_no_overdraw(tmp_path):
    (camera,) = cameras(PLANT, 1)
    away = tl.Camera.perspective(camera.eye, np.subtract(camera.eye, camera.target) * 9, size=SIZE)
    table = run(tmp_path / "rows", grid={}, views=[away], timing="none")
    assert math.isnan(table["overdraw"][0])
    assert table["rmse"][0] == 0.0


def test_speedup_is_of_the_same_run(swept):
    table, _ = swept
    full = table["label"] == "full_mesh"
    assert (table.loc[full, "speedup"] == 1.0).all()
    assert (table["speedup"] > 0).all()
    assert (table["frame_millis_min"] <= table["frame_millis"]).all()
    assert (table["frame_millis"] <= table["frame_millis_max"]).all()


def test_summary_keeps_plants_apart(swept):
    table, _ = swept
    summary = table.summary()
    assert [*zip(summary["plant"], summary["label"], strict=True)] == [
        (plant, label) for plant in ("crown", "other") for label in LABELS
    ]
    rows = table[(table["plant"] == "other") & (table["label"] == LABELS[3])]
    row = summary.iloc[10]
    assert row["flip"] == pytest.approx(rows["flip"].mean())
    assert row["views"] == 3
    base = (rows["speedup"] * rows["frame_millis"]).median()
    assert row["speedup"] == pytest.approx(base / row["frame_millis"])
    assert (summary.loc[summary["label"] == "full_mesh", "speedup"] == 1.0).all()
    by = table.summary(by=["param_slice_count"])
    assert by["speedup"].notna().all(), "the full mesh is the yardstick for every parameter"


def test_summary_compares_with_the_full_mesh_of_the_same_run(swept):
    table, _ = swept
    # the yardstick's own rows were drawn while the machine was busy
    full = table["label"] == "full_mesh"
    slower = table.copy()
    slower.loc[full, "frame_millis"] *= 10.0
    rest = [*set(LABELS) - {"full_mesh"}]
    before = table.summary().set_index(["label", "plant"])["speedup"].loc[rest]
    assert slower.summary().set_index(["label", "plant"])["speedup"].loc[rest].equals(before)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("time_samples", 16),
        ("reference_samples", 64),
        ("ppd", 30.0),
        ("timing", "exclusive"),
        ("kernel_version", "0" * 32),
    ],
)
def test_summary_keeps_apart_what_was_measured_otherwise(swept, column, value):
    table, _ = swept
    other = table.assign(**{column: value, "flip": table["flip"] + 1.0})
    both = tl.SweepResults(pd.concat([pd.DataFrame(table), pd.DataFrame(other)]))
    summary = both.summary()
    assert len(summary) == 28
    assert summary["flip"].tolist()[:14] == table.summary()["flip"].tolist()
    assert [*summary.columns[:3]] == ["plant", "label", column]


def test_parameters_that_no_signed_integer_holds(tmp_path):
    grid = {"stochastic_pruning": {"seed": [1, 2**64 - 1]}}
    table = run(tmp_path / "rows", grid=grid, views=cameras(PLANT, 1), timing="none")
    assert table["param_seed"].dropna().tolist() == [1, 2**64 - 1]
    back = tl.load_results(tmp_path / "rows")
    pd.testing.assert_frame_equal(pd.DataFrame(back), pd.DataFrame(table), check_exact=True)
    assert table.to_xarray()["seed"].values.tolist() == [1, 2**64 - 1]


def test_a_plant_of_two_names_has_its_latest_one(tmp_path, monkeypatch):
    folder = tmp_path / "rows"
    monkeypatch.setattr(worker, "_provenance", worker._provenance.__wrapped__)
    run(folder, {"a": PLANT}, grid={}, timing="none")
    run(folder, {"b": PLANT}, grid={"stochastic_pruning": {}}, timing="none")
    table = tl.load_results(folder)
    # the clock counts seconds: where both are of one, the later letter
    assert set(table["plant"]) == {"b"}
    assert len(table.summary()) == 2


def test_sources_that_are_given_replace_those_that_are_stored(tmp_path):
    folder = tmp_path / "rows"
    run(folder, grid={}, timing="none", sources={"crown": {"seed": 1}})
    assert run(folder, grid={}, timing="none")["seed"].tolist() == [1] * 3
    table = run(folder, grid={}, timing="none", sources={"crown": {"seed": np.int64(2)}})
    assert table["seed"].tolist() == [2] * 3
    assert table["source"].tolist() == ['{"seed": 2}'] * 3


def test_zero_has_no_sign(tmp_path, monkeypatch):
    (camera,) = cameras(PLANT, 1)
    calls = count_cells(monkeypatch)
    for zero in (0.0, -0.0):
        grid = {"stochastic_pruning": {"shrink": zero}}
        moved = replace(camera, target=(zero, *camera.target[1:]))
        run(tmp_path / "rows", grid=grid, views=[moved], timing="none")
    assert len(calls) == 2


def test_times_of_another_sweep_are_not_written_over(tmp_path, monkeypatch):
    folder = tmp_path / "rows"
    calls, begun = count_cells(monkeypatch), []

    def progress(*call):
        if call[0] == "cells" and not begun:
            begun.append(True)
            # another one, that ends while this one has yet to begin
            run(folder, grid={}, timing="exclusive")
            begun.append(tl.load_results(folder)["frame_millis"].tolist())

    table = run(folder, grid={}, timing="exclusive", progress=progress)
    assert table["frame_millis"].tolist() == begun[1]
    assert [what for _, what in calls] == ["errors"] * 3 + ["times"] * 3 + ["errors"] * 3


def test_a_part_of_a_table_is_one_too(swept):
    table, _ = swept
    part = table[table["plant"] == "crown"]
    assert isinstance(part, tl.SweepResults)
    assert len(part.summary()) == 7


# The store


def test_a_store_gives_the_same_table(swept):
    table, folder = swept
    back = tl.load_results(folder)
    assert isinstance(back, tl.SweepResults)
    pd.testing.assert_frame_equal(pd.DataFrame(back), pd.DataFrame(table), check_exact=True)


def count_cells(monkeypatch):
    """Count the cells that this process measures."""
    calls = []
    measure = worker._row

    def counted(job, *rest):
        calls.append((job.variant.technique, job.what))
        return measure(job, *rest)

    monkeypatch.setattr(worker, "_row", counted)
    return calls


def test_only_what_is_missing_is_computed(tmp_path, monkeypatch):
    folder = tmp_path / "rows"
    calls = count_cells(monkeypatch)
    first = run(folder, grid={"slicings": {"slice_count": [1, 3], "resolution": 8}})
    assert len(calls) == 9
    assert first.attrs["work"]["stored"] == 0
    calls.clear()
    again = run(folder, grid={"slicings": {"slice_count": [1, 3], "resolution": 8}})
    assert calls == []
    pd.testing.assert_frame_equal(pd.DataFrame(again), pd.DataFrame(first), check_exact=True)
    # a larger grid, other names and another order
    larger = {
        "stochastic_pruning": {},
        "slicings": [{"slice_count": [3, 5, 1], "resolution": 8}],
    }
    table = run(folder, {"renamed": PLANT}, grid=larger)
    assert calls == [("stochastic_pruning", "all")] * 3 + [("slicings", "all")] * 3
    assert table.attrs["work"]["stored"] == 9
    assert set(table["plant"]) == {"renamed"}
    assert table["label"].unique().tolist() == [
        "full_mesh",
        "stochastic_pruning",
        "slicings:slice_count=3",
        "slicings:slice_count=5",
        "slicings:slice_count=1",
    ]
    calls.clear()
    # a file that is gone
    next((folder / "cells").iterdir()).unlink()
    run(folder, grid=larger)
    assert len(calls) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"samples": 1},
        {"reference_samples": 17},
        {"repeats": 3},
        {"warmup": 1},
        {"threads": 1},
        {"ppd": 60.0},
        {"timing": "none"},
        {"timing": "exclusive"},
        {"plants": OTHER},
        {"views": lambda plant: tl.orbit(plant, count=3, size=(48, 48))},
        {"grid": {"slicings": {"slice_count": 1, "resolution": 8, "samples": 4}}},
    ],
    ids=lambda change: next(iter(change)) + str(next(iter(change.values())))[:9],
)
def test_whatever_decides_a_row_makes_it_another(tmp_path, monkeypatch, change):
    folder, grid = tmp_path / "rows", {"slicings": {"slice_count": 1, "resolution": 8}}
    run(folder, grid=grid)
    calls = count_cells(monkeypatch)
    run(folder, **{"grid": grid, **change})
    # the full mesh has no parameters that could change; exclusive cells are met twice
    fresh = {"grid": 3}.get(next(iter(change)), 6) * (2 if "exclusive" in change.values() else 1)
    assert len(calls) == fresh


def test_untimed_rows_do_not_depend_on_how_they_would_be_timed(tmp_path, monkeypatch):
    folder = tmp_path / "rows"
    table = run(folder, grid={}, timing="none", repeats=2)
    assert table[["frame_millis", "speedup"]].isna().all(axis=None)
    assert table["repeats"].tolist() == [0, 0, 0]
    calls = count_cells(monkeypatch)
    run(folder, grid={}, timing="none", repeats=9, warmup=3)
    assert calls == []


def test_other_code_is_another_row(tmp_path, monkeypatch):
    folder = tmp_path / "rows"
    run(folder, grid={}, timing="none")
    for module in (driver, worker):
        monkeypatch.setattr(module, "kernel_version", lambda: "0" * 32)
    calls = count_cells(monkeypatch)
    table = run(folder, grid={}, timing="none")
    assert len(calls) == 3
    assert set(table["kernel_version"]) == {"0" * 32}
    both = tl.load_results(folder)
    assert both["kernel_version"].nunique() == 2
    assert both["view"].tolist() == [0, 0, 1, 1, 2, 2]


def test_equal_cameras_are_one_cell(tmp_path, monkeypatch):
    calls = count_cells(monkeypatch)
    (camera,) = cameras(PLANT, 1)
    table = run(tmp_path / "rows", grid={}, views=[camera, camera], timing="none")
    assert len(calls) == 1
    assert table["view"].tolist() == [0, 1]


def test_cameras_of_several_sweeps_are_numbered_apart(tmp_path):
    folder = tmp_path / "rows"
    run(folder, grid={}, views=cameras(PLANT, 2), timing="none")
    run(folder, grid={}, views=cameras(PLANT, 4), timing="none")
    # azimuths 0, 180 and then 0, 90, 180, 270: numbered by what they were called first
    table = tl.load_results(folder)
    assert sorted(table["view"]) == [0, 1, 2, 3]
    assert sorted(table["azimuth_deg"]) == [0.0, 90.0, 180.0, 270.0]


# Times


def test_cells_overlap_unless_they_are_timed_alone(tmp_path, monkeypatch):
    from concurrent.futures import ThreadPoolExecutor

    for timing, kinds in (("shared", 2), ("exclusive", 2)):
        spans = record(monkeypatch)
        with ThreadPoolExecutor(2) as pool:
            run(tmp_path / timing, timing=timing, executor=pool)
        assert len({kind for kind, *_ in spans.found}) == kinds
        assert sum(kind == "frame_times" for kind, *_ in spans.found) == 21
        overlaps = spans.overlapping("frame_times")
        if timing == "shared":
            assert overlaps, "two workers on 21 cells meet: else this test shows nothing"
        else:
            assert overlaps == []
            assert spans.overlapping("error_frames"), "errors are measured in parallel"


def test_times_come_after_errors_and_only_once(tmp_path, monkeypatch):
    folder = tmp_path / "rows"
    calls = count_cells(monkeypatch)
    stop = []

    def progress(stage, done, total):
        if stage == "timing" and done == 2:
            stop.append(total)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(folder, timing="exclusive", progress=progress)
    assert stop == [21]
    half = tl.load_results(folder)
    assert len(half) == 21
    assert half["frame_millis"].notna().sum() == 2
    assert half["flip"].notna().all()
    errors = errors_of(half)
    calls.clear()
    table = run(folder, timing="exclusive")
    assert {what for _, what in calls} == {"times"}
    assert len(calls) == 19
    assert table["frame_millis"].notna().all()
    assert (table.loc[table["label"] == "full_mesh", "speedup"] == 1.0).all()
    assert errors_of(table) == errors
    calls.clear()
    run(folder, timing="exclusive")
    assert calls == []


# Failures


BAD = {"slicings": {"slice_count": [1, 0, 3], "resolution": 8}}


def test_a_failure_names_the_cell(tmp_path):
    with pytest.raises(SweepError) as caught:
        run(tmp_path / "rows", grid=BAD)
    assert str(caught.value).startswith(
        "plant 'crown', slicings(slice_count=0, resolution=8), view 0: ValueError: slice_count"
    )
    assert isinstance(caught.value.__cause__, ValueError)
    assert "worker.py" in caught.value.__notes__[0]
    # what was done before it is kept
    assert len(tl.load_results(tmp_path / "rows")) == 6


def test_failures_can_be_recorded(tmp_path, monkeypatch):
    folder = tmp_path / "rows"
    with pytest.warns(SweepWarning, match="3 of 12 cells failed, the first at plant 'crown', slic"):
        table = run(folder, grid=BAD, on_error="record", timing="exclusive")
    assert len(table) == 9
    assert table["frame_millis"].notna().all()
    failed = table.attrs["failed"]
    assert [(f["plant"], f["technique"], f["view"]) for f in failed] == [
        ("crown", "slicings", view) for view in range(3)
    ]
    assert failed[0]["params"]["slice_count"] == 0
    assert failed[0]["error"].startswith("ValueError: slice_count")
    # it is tried again the next time, once for all views
    builds = []
    representation = worker._representation
    monkeypatch.setattr(
        worker, "_representation", lambda *a: builds.append(a[0].variant) or representation(*a)
    )
    with pytest.warns(SweepWarning, match="3 of 12"):
        run(folder, grid=BAD, on_error="record", timing="exclusive")
    assert len(builds) == 1


def test_a_failure_of_one_view_spares_the_others(tmp_path, monkeypatch):
    measure = worker._row

    def unlucky(job, plant, technique, full, view, *rest):
        if view.index == 1 and technique is not full:
            msg = "no luck"
            raise MemoryError(msg)
        return measure(job, plant, technique, full, view, *rest)

    monkeypatch.setattr(worker, "_row", unlucky)
    with pytest.warns(SweepWarning, match="6 of 21 cells failed.*MemoryError: no luck"):
        table = run(tmp_path / "rows", on_error="record")
    assert len(table) == 15
    assert set(table[table["view"] == 1]["label"]) == {"full_mesh"}


# Arguments


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"plants": []}, ValueError, "plants is empty"),
        ({"plants": {}}, ValueError, "plants is empty"),
        ({"plants": "oak"}, TypeError, "plants must be a Plant, a list or a mapping"),
        ({"plants": [7]}, TypeError, "plants must be Plants by name"),
        ({"plants": {"a": "b"}}, TypeError, "plants must be Plants by name, got 'a': 'b'"),
        ({"plants": [PLANT, PLANT]}, ValueError, "two are named 'crown'; give a mapping"),
        ({"plants": {"a": PLANT, "b": PLANT}}, ValueError, "'a' and 'b' are the same plant"),
        ({"views": []}, ValueError, "cameras is empty"),
        ({"views": lambda _: []}, ValueError, "cameras is empty"),
        ({"views": [7]}, TypeError, "cameras must be Cameras, got 7"),
        ({"grid": {"sketches": {}}}, ValueError, "unknown technique 'sketches'"),
        ({"grid": {"slicings": {"x": 1}}}, ValueError, "slicings: x is no parameter of it"),
        ({"samples": 3}, ValueError, "samples must be in"),
        ({"reference_samples": 2}, ValueError, "samples must be in"),
        ({"repeats": 0}, ValueError, "repeats must be at least 1"),
        ({"warmup": -1}, ValueError, "warmup at least 0"),
        ({"timing": "alone"}, ValueError, "timing must be 'shared', 'exclusive' or 'none', got"),
        ({"threads": 0}, ValueError, "threads must be in"),
        ({"ppd": 0}, ValueError, "ppd"),
        ({"retries": -1}, ValueError, "retries must be at least 0, got -1"),
        ({"on_error": "ignore"}, ValueError, "on_error must be 'raise' or 'record'"),
        ({"sources": {"oak": {}}}, ValueError, "sources names 'oak', which is no plant"),
        ({"sources": {"crown": {"file": Path("x")}}}, TypeError, "sources: crown must hold what"),
        ({"sources": {"crown": {"seed": 2**64 - 1}}}, ValueError, "sources: crown: seed must be"),
        ({"sources": {"crown": {"sha256": 7}}}, TypeError, "sources: crown: sha256 must be text"),
        ({"sources": {"crown": 7}}, TypeError, "sources: crown must map words"),
        ({"samples": "1"}, TypeError, "^samples must be a whole number, got '1'"),
        ({"reference_samples": 2}, ValueError, "^reference_samples must be in"),
        ({"threads": 1.5}, TypeError, "threads must be a whole number, got 1.5"),
        ({"yee": "no"}, TypeError, "yee must be True or False, got 'no'"),
        ({"ppd": "67"}, TypeError, "ppd must be a number, got '67'"),
        ({"progress": "bar"}, TypeError, "progress must be True, False or callable, got 'bar'"),
        ({"executor": 0}, ValueError, "executor must be at least 1 worker"),
        ({"executor": "pool"}, TypeError, "executor must be None, a number of workers, or"),
        ({"executor": True}, TypeError, "executor must be None"),
        ({"executor": lambda: 7}, TypeError, "executor made 7, which is no"),
    ],
)  # fmt: skip
def test_refuses(tmp_path, monkeypatch, change, error, message):
    def unexpected(*_, **__):
        pytest.fail("something was drawn")

    monkeypatch.setattr(worker, "run", unexpected)
    with pytest.raises(error, match=message):
        run(tmp_path / "rows", **change)
    assert not (tmp_path / "rows").exists()


def test_refuses_pictures_that_are_too_large(tmp_path):
    huge = tl.Camera.perspective((0, 0, 9), (0, 0, 0), size=(16384, 16384))
    with pytest.raises(LimitError, match="size needs 268435456 pixels"):
        run(tmp_path / "rows", views=[huge])
    assert not (tmp_path / "rows").exists()


def test_refuses_a_folder_of_something_else(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(StoreError, match="is not empty"):
        run(tmp_path)


def test_plants_may_be_a_list_and_cameras_the_default(tmp_path, monkeypatch):
    monkeypatch.setattr(driver, "default_cameras", lambda plant: cameras(plant, 1))
    table = run(tmp_path / "rows", [PLANT, OTHER], {}, None, timing="none")
    assert table["plant"].tolist() == ["crown", "shrub"]


# While it runs


def test_progress_reaches_the_end_of_every_stage(tmp_path):
    calls = []
    settings = {"timing": "exclusive", "progress": lambda *call: calls.append(call)}
    run(tmp_path / "rows", **settings)
    for stage in ("cells", "timing"):
        done = [call[1] for call in calls if call[0] == stage]
        assert done == [*range(22)]
        assert {call[2] for call in calls if call[0] == stage} == {21}
    calls.clear()
    run(tmp_path / "rows", **settings)
    assert calls == [("cells", 21, 21)]


def test_nothing_is_printed_where_nobody_looks(tmp_path, capfd):
    run(tmp_path / "rows", grid={}, timing="none", progress=True)
    assert capfd.readouterr() == ("", "")


def test_a_representation_is_built_once_and_a_reference_drawn_once(tmp_path):
    table = run(tmp_path / "rows", timing="none")
    ((_, work),) = table.attrs["work"]["workers"].items()
    assert work == {"builds": 7, "references": 3, "cells": 21}


def test_ctrl_c_ends_a_serial_sweep_and_keeps_what_is_done(tmp_path):
    code = """
        import sys, treelod as tl
        from made_sweeps import PLANT, cameras
        grid = {"slicings": {"slice_count": list(range(1, 200)), "resolution": 64}}
        tl.sweep(PLANT, grid, cameras, store=sys.argv[1], reference_samples=64)
    """
    folder = tmp_path / "rows"
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), str(folder)],
        cwd=Path(__file__).parent,
        stderr=subprocess.PIPE,
        text=True,
    )
    cells = folder / "cells"
    while not (cells.is_dir() and len([*cells.glob("*.parquet")]) > 3):
        assert child.poll() is None
        time.sleep(0.05)
    start = time.monotonic()
    child.send_signal(signal.SIGINT)
    _, text = child.communicate(timeout=30)
    assert time.monotonic() - start < 5, "within a second, and slack for a loaded machine"
    assert "KeyboardInterrupt" in text
    assert child.returncode != 0
    assert len(tl.load_results(folder)) > 3


# What names the code


def test_every_module_is_in_the_kernel_version_or_is_known_not_to_be():
    package = Path(driver.__file__).parents[1]
    named = {file for pattern in MODULES for file in package.glob(pattern)}
    assert all([*package.glob(pattern)] for pattern in MODULES)
    apart = {
        "__init__.py", "__main__.py", "cli", "errors.py", "export.py", "files.py", "gpu.py",
        "kernel_version.py", "loading.py", "plants.py", "plots.py", "provenance.py", "terminal.py",
        "walks.py", "bench", "plant_files", "plots", "popping.py", "references", "report", "sweeps",
        "notebook.py", "testing.py",
    }  # fmt: skip
    rest = {
        file.relative_to(package).parts[0] for file in package.glob("**/*.py") if file not in named
    }
    assert rest <= apart, "a module that computes numbers belongs to kernel_version.MODULES"


def test_the_kernel_version_follows_the_code(monkeypatch, tmp_path):
    import treelod.kernel_version as module

    def version():
        return module.kernel_version.__wrapped__()

    base = version()
    assert base == kernel_version()
    monkeypatch.setattr(module._core, "source_hash", "other")
    assert version() != base
    monkeypatch.undo()
    monkeypatch.setattr(module._core, "build_profile", "debug")
    assert version() != base
    monkeypatch.undo()
    monkeypatch.setattr(module.metadata, "version", lambda name: "0")
    assert version() != base
    monkeypatch.undo()
    assert "openimageio" in LIBRARIES, "it computes FLIP"
    # a copy of the package: the same code has the same version, and a changed line another
    copy = tmp_path / "treelod"
    for pattern in MODULES:
        for file in Path(module.__file__).parent.glob(pattern):
            target = copy / file.relative_to(Path(module.__file__).parent)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_bytes())
    monkeypatch.setattr(module, "__file__", str(copy / "kernel_version.py"))
    assert version() == base
    (copy / "plots.py").write_text("other")
    assert version() == base
    with (copy / "metrics.py").open("a") as file:
        file.write("\nMARGIN_PX = 9\n")
    assert version() != base


# xarray


def test_one_technique_has_its_parameters_as_axes(swept):
    table, _ = swept
    data = table[table["technique"] != "stochastic_pruning"].to_xarray()
    assert data.sizes == {"plant": 2, "slice_count": 2, "resolution": 2, "view": 3}
    assert data["slice_count"].values.tolist() == [1, 3]
    assert data["resolution"].values.tolist() == [8, 16]
    assert data["plant"].values.tolist() == ["crown", "other"]
    assert data["azimuth_deg"].values.tolist() == [0.0, 120.0, 240.0]
    row = table[(table["plant"] == "other") & (table["label"] == LABELS[3])].iloc[1]
    cell = data["flip"].sel(plant="other", slice_count=3, resolution=8, view=1)
    assert float(cell) == row["flip"]
    for name in [name for name in ERRORS if name != "fragments"]:
        assert data[name].dims == ("plant", "slice_count", "resolution", "view"), name
    pruned = table.to_xarray("stochastic_pruning")
    assert pruned.sizes == {"plant": 2, "shrink": 2, "view": 3}


def test_a_table_of_something_else_is_an_array_by_its_index(swept):
    table, _ = swept
    data = table[["flip"]].to_xarray()
    assert data.sizes == {"index": 42}
    assert data["flip"].values.tolist() == table["flip"].tolist()
    with pytest.raises(ValueError, match="technique: there is no column 'plant'"):
        table[["flip"]].to_xarray("slicings")


def test_several_techniques_have_their_labels_as_an_axis(swept):
    table, _ = swept
    data = table.to_xarray()
    assert data.sizes == {"plant": 2, "label": 7, "view": 3}
    assert data["label"].values.tolist() == LABELS
    assert not data["flip"].isnull().any()


def test_what_was_not_computed_is_nan(swept):
    table, _ = swept
    only = table[table["technique"] == "slicings"]
    data = only[(only["param_slice_count"] == 1) | (only["param_resolution"] == 8)].to_xarray()
    assert data["flip"].isnull().sum() == 6
    assert data["flip"].sel(slice_count=3, resolution=16).isnull().all()


def test_arrays_are_refused_where_two_rows_would_meet(tmp_path):
    folder = tmp_path / "rows"
    for samples in (1, 4):
        run(folder, grid={}, samples=samples, timing="none")
    table = tl.load_results(folder)
    with pytest.raises(
        ValueError, match=r"two rows for {'plant': 'crown', 'label': 'full_mesh', 'v"
    ):
        table.to_xarray()
    assert table[table["time_samples"] == 4].to_xarray().sizes["view"] == 3
    with pytest.raises(ValueError, match="there are no rows of 'slicings'"):
        table.to_xarray("slicings")
