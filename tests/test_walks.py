"""Walks around groves: where trees and cameras stand, and what is counted and timed."""

import json
import math

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import treelod as tl
from made_plants import random_crown
from treelod import cli, plots, walks
from treelod.report.walk import write_walk

PLANT = random_crown(40, trunk=True)
MESH = tl.FullMesh.build(PLANT)
HALF = tl.SimplifiedMesh.build(PLANT, keep_fraction=0.5)
CLUSTERS = tl.LeafClusters.build(PLANT, cluster_count=(4, 2), resolution=16)
TINY = {"tree_counts": (1, 3), "frame_count": 5, "laps": 2, "size": (32, 24), "samples": 1}


@pytest.fixture(scope="module")
def found():
    subjects = {
        "mesh": MESH,
        "half": HALF,
        "clusters": CLUSTERS,
        "by distance": lambda distance: MESH if distance < 3.0 else HALF,
    }
    return walks.walk(PLANT, subjects, **TINY)


# --- the grove -----------------------------------------------------------------------------------


def test_the_first_copy_stands_and_more_follow():
    about = (3.0, 1.0, -2.0)
    grove = tl.scatter(40, 5.0, seed=3, about=about)
    np.testing.assert_array_equal(grove[0], np.eye(4))
    for count in (0, 1, 7):
        np.testing.assert_array_equal(tl.scatter(count, 5.0, seed=3, about=about), grove[:count])
    places = grove @ [*about, 1.0]
    np.testing.assert_allclose(places[:, 1], 1.0)
    # turned about the vertical, and nothing else
    np.testing.assert_allclose(np.linalg.det(grove[:, :3, :3]), 1.0)
    np.testing.assert_allclose(grove[:, 1, :], np.tile([0, 1, 0, 0], (40, 1)), atol=1e-15)
    assert len(np.unique(grove[:, 0, 0].round(6))) == 40


@pytest.mark.parametrize("seed", range(4))
def test_neighbours_are_about_as_far_apart_as_asked_for(seed):
    places = tl.scatter(200, 5.0, seed=seed)[:, [0, 2], 3]
    apart = np.linalg.norm(places[:, np.newaxis] - places, axis=-1)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(axis=0)
    assert nearest.min() >= 2.5
    assert 4.0 < np.median(nearest) < 6.0


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        ((-1, 5.0), {}, "count"),
        ((3, 0.0), {}, "spacing"),
        ((3, float("inf")), {}, "spacing"),
        ((3, 5.0), {"seed": -1}, "seed"),
        ((3, 5.0), {"about": (1, 2)}, "about"),
        ((3, 5.0), {"about": (1, 2, float("nan"))}, "about"),
    ],
)
def test_bad_scatters_are_named(arguments, keywords, message):
    with pytest.raises(ValueError, match=message):
        tl.scatter(*arguments, **keywords)


# --- the cameras ---------------------------------------------------------------------------------


def test_a_circle_around_one_tree_is_an_orbit():
    cameras = walks.circle(PLANT, np.eye(4)[np.newaxis], 8, elevation_deg=20, size=(64, 48))
    orbit = tl.orbit(PLANT, count=8, elevation_deg=20, size=(64, 48))
    for camera, expected in zip(cameras, orbit, strict=True):
        np.testing.assert_allclose(camera.eye, expected.eye, atol=1e-12)
        np.testing.assert_allclose(camera.target, expected.target, atol=1e-12)


def test_a_circle_keeps_its_distance_from_every_tree():
    center, radius = PLANT.sphere
    grove = tl.scatter(30, 2 * radius, about=center)
    centers = (grove @ [*center, 1.0])[:, :3]
    for camera in walks.circle(PLANT, grove, 12, distance=3.0):
        nearest = np.linalg.norm(centers - camera.eye, axis=1).min()
        assert nearest >= 3.0 * radius * (1 - 1e-9)
    near = [
        np.linalg.norm(centers - camera.eye, axis=1).min()
        for camera in walks.circle(PLANT, grove, 36, distance=3.0, elevation_deg=0)
    ]
    assert min(near) < 3.5 * radius, "and comes about as near as that to one of them"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"frame_count": 0}, "frame_count"),
        ({"distance": 0.0}, "distance"),
        ({"elevation_deg": 91.0}, "elevation_deg"),
    ],
)
def test_bad_circles_are_named(given, message):
    with pytest.raises(ValueError, match=message):
        walks.circle(PLANT, np.eye(4)[np.newaxis], **given)


def test_a_path_leads_through_the_grove_at_eye_height():
    center, radius = PLANT.sphere
    grove = tl.scatter(30, 2 * radius, about=center)
    centers = (grove @ [*center, 1.0])[:, :3]
    middle = centers.mean(axis=0)
    cameras = walks.through(PLANT, grove, 500, size=(64, 48))
    eyes = np.array([camera.eye for camera in cameras])
    low, high = PLANT.bounds
    np.testing.assert_allclose(eyes[:, 1], low[1] + 0.22 * (high[1] - low[1]))
    away = np.linalg.norm((eyes - middle)[:, [0, 2]], axis=1)
    outermost = np.linalg.norm((centers - middle)[:, [0, 2]], axis=1).max()
    assert away.max() == pytest.approx(outermost + 2.5 * radius, rel=1e-3), "out of the grove"
    assert away.min() < 0.2 * outermost, "and into its middle"
    steps = np.linalg.norm(np.diff(eyes, axis=0, append=eyes[:1]), axis=1)
    assert steps.max() < 5 * np.median(steps), "closed, without jumps"
    # it looks where it goes
    ahead = np.array([camera.target for camera in cameras]) - eyes
    cosines = np.sum(ahead * np.roll(np.diff(eyes, axis=0, append=eyes[:1]), -1, axis=0), axis=1)
    assert (cosines > 0.8 * np.linalg.norm(ahead, axis=1) * np.roll(steps, -1)).all()


def test_a_path_needs_a_frame():
    with pytest.raises(ValueError, match="frame_count"):
        walks.through(PLANT, np.eye(4)[np.newaxis], 0)


# --- the worst case ------------------------------------------------------------------------------


def test_of_130_windows_the_seven_largest_are_left_out():
    # window w takes w everywhere but for one frame, which makes up for another
    millis = np.repeat(np.arange(130.0), 20).reshape(130, 20)
    millis[:, 0] += 10.0
    millis[:, 1] -= 10.0
    shuffled = np.random.default_rng(0).permutation(millis)
    assert walks.worst_case_millis(shuffled.ravel()) == 122.0
    # a window that is not full is not counted
    assert walks.worst_case_millis([*shuffled.ravel(), *[1e6] * 19]) == 122.0
    assert walks.worst_case_millis([3.0, 1.0], window=1, dropped_share=0.0) == 3.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([1.0] * 19,), "none is left"),
        (([1.0] * 20,), "none is left"),
        (([[1.0]],), "one-dimensional"),
        (([1.0], 0), "window"),
        (([1.0], 1, 1.0), "dropped_share"),
    ],
)
def test_bad_worst_cases_are_named(given, message):
    with pytest.raises(ValueError, match=message):
        walks.worst_case_millis(*given)


def test_a_path_has_a_worst_case_and_may_leave_windows_out():
    calls = []
    found = walks.walk(
        PLANT,
        {"mesh": MESH, "half": HALF},
        tree_counts=(2,),
        path="through",
        frame_count=800,
        size=(8, 6),
        samples=1,
        every={"mesh": 2},
        progress=lambda *args: calls.append(args),
    )
    table = found.table.set_index("label")
    assert table["frames"].to_dict() == {"mesh": 400, "half": 800}
    for _, row in table.iterrows():
        assert row["frame_millis_low"] <= row["frame_millis_mean"] <= row["frame_millis_high"]
        assert row["frame_millis_mean"] < row["frame_millis_worst"] <= row["frame_millis_high"]
    assert table.loc["half", "primitives_max"] == 88
    assert table.loc["half", "primitives"] < 88, "trees leave the picture"
    assert (found.settings["path"], found.settings["every"]) == ("through", {"mesh": 2})
    assert calls[-1] == ("walking", 820, 820), "20 frames are not counted"


def test_of_few_frames_there_is_no_worst_case(found):
    assert found.table["frame_millis_worst"].isna().all()
    assert found.table["frames"].eq(5).all()


# --- the walk ------------------------------------------------------------------------------------


def test_primitives_are_those_of_the_frames(found):
    table = found.table.set_index(["label", "tree_count"])
    assert list(table.index) == [
        (label, count) for count in (1, 3) for label in ("mesh", "half", "clusters", "by distance")
    ]
    for count in (1, 3):
        # all trees are in view: 80 triangles of leaves, 4 of wood
        assert table.loc[("mesh", count), "primitives"] == 84 * count
        assert table.loc[("half", count), "triangles"] == 44 * count
        # four cards or fewer, of two triangles each
        assert 4 * count < table.loc[("clusters", count), "primitives"] <= 12 * count
    # one tree at 2.5 radii is near; of three, some are farther than 3
    assert table.loc[("by distance", 1), "primitives"] == 84
    assert 44 * 3 < table.loc[("by distance", 3), "primitives"] < 84 * 3
    kinds = found.table[["triangles", "cards", "lines", "points"]].sum(axis=1)
    np.testing.assert_allclose(found.table["primitives"], kinds)
    assert (found.table["primitives_max"] >= found.table["primitives"]).all()


def test_times_are_medians_between_their_ends(found):
    table = found.table
    assert (table["frame_millis_low"] > 0).all()
    assert (table["frame_millis_low"] <= table["frame_millis"]).all()
    assert (table["frame_millis"] <= table["frame_millis_high"]).all()
    assert (table[["emit_millis", "draw_millis"]] > 0).all(axis=None)


def test_medians_are_taken_over_laps_first():
    def frame(emit, draw, triangles):
        kinds = {"triangles": triangles, "cards": 0, "lines": 0, "points": 1}
        return {"emit_millis": emit, "draw_millis": draw, "gpu_millis": draw / 2, **kinds}

    laps = [
        [frame(1, 10, 5), frame(1, 20, 7)],
        [frame(1, 12, 5), frame(3, 90, 7)],
        [frame(1, 99, 5), frame(2, 21, 7)],
    ]
    row = walks._row("x", 2, laps)
    assert (row["primitives"], row["primitives_max"], row["triangles"]) == (7.0, 8, 6.0)
    # medians of (11, 13, 100) and of (21, 93, 23)
    assert (row["frame_millis_low"], row["frame_millis_high"]) == (13.0, 23.0)
    assert (row["frame_millis"], row["emit_millis"], row["draw_millis"]) == (18.0, 1.5, 16.5)
    assert row["gpu_millis"] == 8.25


def test_a_first_lap_is_not_counted(monkeypatch):
    seen = []

    def row(label, tree_count, laps):
        seen.append([len(lap) for lap in laps])
        return {}

    monkeypatch.setattr(walks, "_row", row)
    walks.walk(PLANT, {"x": MESH}, **TINY)
    assert seen == [[5, 5], [5, 5]], "two laps of five frames around each grove"


def test_what_is_chosen_is_drawn():
    seen = []

    def choose(distance):
        seen.append(distance)
        return MESH

    _, radius = PLANT.sphere
    walks.walk(PLANT, {"x": choose}, **{**TINY, "tree_counts": (2,)}, spacing=4 * radius)
    assert len(seen) == 2 * 5, "once for each tree and camera, not for each lap"
    assert min(seen) >= 2.5 * (1 - 1e-9)
    assert max(seen) < 2.5 + 4 * 4
    plain, chosen = (
        walks.walk(PLANT, {"x": subject}, **TINY).table["primitives"].tolist()
        for subject in (MESH, lambda distance: MESH)
    )
    assert plain == chosen


def test_settings_say_what_was_done(found):
    assert found.plant == PLANT.name
    assert found.settings["tree_counts"] == [1, 3]
    assert found.settings["spacing"] == pytest.approx(1.5 * PLANT.sphere[1])
    assert found.settings["frame_count"] == 5
    assert found.made.treelod == tl.__version__


def test_progress_counts_frames():
    calls = []
    walks.walk(PLANT, {"x": MESH}, **TINY, progress=lambda *args: calls.append(args))
    assert calls == [("walking", done, 30) for done in range(1, 31)], "2 groves, 3 laps, 5 frames"


@pytest.mark.parametrize(
    ("subjects", "given", "error", "message"),
    [
        ({}, {}, ValueError, "subjects"),
        ({"x": "slicings"}, {}, TypeError, "subjects: 'x'"),
        ({"x": lambda distance: "mesh"}, {}, TypeError, "must return a technique"),
        ({"x": MESH}, {"tree_counts": ()}, ValueError, "tree_counts"),
        ({"x": MESH}, {"tree_counts": (0, 1)}, ValueError, "tree_counts"),
        ({"x": MESH}, {"tree_counts": (2, 2)}, ValueError, "tree_counts"),
        ({"x": MESH}, {"laps": 0}, ValueError, "laps"),
        ({"x": MESH}, {"path": "up"}, ValueError, "path"),
        ({"x": MESH}, {"every": {"y": 2}}, ValueError, "every names 'y'"),
        ({"x": MESH}, {"every": {"x": 0}}, ValueError, "every: 'x'"),
        ({"x": MESH}, {"frame_count": 0}, ValueError, "frame_count"),
        ({"x": MESH}, {"spacing": -1.0}, ValueError, "spacing"),
        ({"x": MESH}, {"samples": 3}, ValueError, "samples"),
        ({"x": MESH}, {"size": (0, 4)}, ValueError, "size"),
    ],
)
def test_bad_walks_are_named(subjects, given, error, message):
    with pytest.raises(error, match=message):
        walks.walk(PLANT, subjects, **{**TINY, **given})


# --- what a camera remembers ---------------------------------------------------------------------


def test_a_fresh_state_and_a_used_one_give_the_same_picture():
    glass = tl.Plant.from_arrays(
        foliage={
            "positions": np.random.default_rng(2).normal(size=(90, 3)),
            "triangles": np.arange(90, dtype=np.uint32).reshape(-1, 3),
            "material_ids": np.zeros(30, np.uint32),
        },
        leaf_offsets=np.arange(31),
        materials=[tl.Material(name="glass", alpha_mode="blend")],
    )
    state = tl.ViewState()
    grove = tl.scatter(4, 3.0, seed=1)
    subjects = [
        tl.Scene([(lod, grove)])
        for lod in (
            MESH,
            CLUSTERS,
            tl.FullMesh.build(glass),
            tl.Slicings.build(PLANT, resolution=8),
        )
    ]
    for subject in [*subjects, *subjects]:
        for camera in walks.circle(PLANT, grove, 3, size=(32, 24)):
            fresh = tl.render(subject, camera)
            used = tl.render(subject, camera, state=state)
            np.testing.assert_array_equal(used.color, fresh.color)
            np.testing.assert_array_equal(used.depth, fresh.depth)
            assert used.stats.triangles == fresh.stats.triangles


def test_a_state_is_a_state():
    camera = tl.orbit(PLANT, count=1, size=(8, 8))[0]
    with pytest.raises(TypeError, match="state"):
        tl.render(MESH, camera, state={})


# --- the report ----------------------------------------------------------------------------------


def test_the_plot_has_a_line_a_technique(found):
    figure = plots.walk_costs(found.table)
    primitives, millis = figure.axes
    assert len(primitives.lines) == 4
    mesh = primitives.lines[0]
    np.testing.assert_allclose(mesh.get_ydata(), [84, 252])
    assert len(millis.containers) == 4
    figure.canvas.draw()
    for axes in (primitives, millis):
        labels = [tick.get_text() for tick in axes.get_yticklabels() + axes.get_xticklabels()]
        assert all(label.replace(",", "").replace(".", "").isdigit() for label in labels), labels
        inside = [
            tick for tick in axes.get_yticks() if np.prod(np.subtract(axes.get_ylim(), tick)) < 0
        ]
        assert len(inside) >= 2, "enough to read values from"
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "mesh",
        "half",
        "clusters",
        "by distance",
    ]
    with pytest.raises(ValueError, match="empty"):
        plots.walk_costs(found.table.iloc[:0])


def test_the_worst_case_is_plotted_beside_the_mean_and_over_the_mesh():
    rows = [
        (label, count, mean * count, worst * count)
        for label, mean, worst in [("full_mesh", 30.0, 60.0), ("slicings", 2.0, 4.0)]
        for count in (1, 10)
    ]
    names = ["label", "tree_count", "frame_millis_mean", "frame_millis_worst"]
    table = pd.DataFrame(rows, columns=names)
    millis, ratio = plots.worst_case(table).axes
    drawn = [tuple(line.get_ydata()) for line in millis.lines]
    assert drawn == [(60.0, 600.0), (30.0, 300.0), (4.0, 40.0), (2.0, 20.0)]
    assert [line.get_markerfacecolor() == "white" for line in millis.lines] == [False, True] * 2
    over, jakulin = ratio.lines
    assert over.get_ydata().tolist() == [15.0, 15.0]
    assert list(jakulin.get_ydata()) == [20.0, 20.0]
    assert len(plots.worst_case(table, baseline=None).axes) == 1
    with pytest.raises(ValueError, match="baseline 'full_mesh' has no row"):
        plots.worst_case(table.iloc[1:])
    with pytest.raises(ValueError, match="at least 200 drawn frames"):
        plots.worst_case(table.assign(frame_millis_worst=[1.0, 2.0, 3.0, math.nan]))


def test_the_report_is_one_page_with_tables_beside_it(found, tmp_path):
    evil = found.table.assign(label="<b>x</b>")
    walk = walks.Walk(plant="a & b", table=evil, settings=found.settings, made=found.made)
    page = write_walk(walk, tmp_path / "deep" / "out")
    html = page.read_text(encoding="utf-8")
    assert "<b>x</b>" not in html
    assert "&lt;b&gt;x&lt;/b&gt;" in html
    assert "a &amp; b" in html
    assert "data:image/svg+xml" in html
    assert html.count("<tr>") == 1 + 8
    texts = dict.fromkeys(("adapter", "driver"), "string")
    read = pd.read_csv(page.with_name("walk.csv"), dtype=texts)
    pd.testing.assert_frame_equal(read, evil)
    pd.testing.assert_frame_equal(pd.read_parquet(page.with_name("walk.parquet")), evil)
    assert page.with_name("walk_costs.png").stat().st_size > 1000
    assert json.dumps(found.settings)


def test_the_command_walks(tmp_path):
    runner = CliRunner()
    options = ["--trees", "1,2", "--frames", 3, "--laps", 1, "--size", "32x24", "--samples", 1]
    specs = ["-t", "full_mesh", "-t", "simplified_mesh:triangle_count=100"]
    arguments = ["walk", "chestnut", "-o", tmp_path, "--leaf-count", 30, *options, *specs]
    done = runner.invoke(cli.app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    assert f"report: {tmp_path / 'walk.html'}" in done.output
    table = pd.read_csv(tmp_path / "walk.csv")
    assert table["label"].tolist() == ["full_mesh", "simplified_mesh:triangle_count=100"] * 2
    mesh, simple = (table[table["label"] == label] for label in table["label"].unique())
    assert (mesh["primitives"].to_numpy() - simple["primitives"].to_numpy()).tolist() == [200, 400]


def test_the_command_walks_through(tmp_path):
    specs = ["-t", "full_mesh", "-t", "simplified_mesh:triangle_count=100"]
    options = ["--trees", "2", "--frames", "220", "--size", "8x6", "--samples", "1"]
    every = ["--every", "simplified_mesh:triangle_count=100=2"]
    arguments = ["walk", "chestnut", "-o", str(tmp_path), "--leaf-count", "30", "--path", "through"]
    done = CliRunner().invoke(cli.app, [*arguments, *options, *specs, *every])
    assert done.exit_code == 0, done.output
    table = pd.read_csv(tmp_path / "walk.csv")
    assert table["frames"].tolist() == [220, 120]
    assert table["frame_millis_worst"].isna().tolist() == [False, True]
    html = (tmp_path / "walk.html").read_text(encoding="utf-8")
    assert "a walk through groves" in html
    assert "one of 2 windows of 20 frames" in html
    assert html.count("data:image/svg+xml") == 1, "no worst case for each row, so no plot of it"
    assert not (tmp_path / "walk_worst_case.png").exists()
    done = CliRunner().invoke(cli.app, [*arguments, *options, *specs])
    assert done.exit_code == 0, done.output
    html = (tmp_path / "walk.html").read_text(encoding="utf-8")
    assert html.count("data:image/svg+xml") == 2
    assert (tmp_path / "walk_worst_case.png").stat().st_size > 1000
    done = CliRunner().invoke(cli.app, [*arguments, *options, "--every", "full_mesh"])
    assert done.exit_code == 2
    assert "SPEC=COUNT" in done.output


@pytest.mark.parametrize("trees", ["2,1", "0", "1,2.5", "few"])
def test_the_command_refuses_groves(tmp_path, trees):
    arguments = ["walk", "chestnut", "-o", str(tmp_path), "--leaf-count", "5", "--trees", trees]
    done = CliRunner().invoke(cli.app, arguments)
    assert done.exit_code in (1, 2)
    assert "trees" in done.output or "tree_counts" in done.output
