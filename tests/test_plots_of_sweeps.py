"""Do plots of sweeps, maps, strips and switches draw what their tables say?"""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh

import treelod as tl
from made_plants import random_crown
from made_results import comparison
from treelod import plots
from treelod.plots import settings, style

COUNTS = (2, 4, 8, 16)
ALPHAS = (0.0, 0.1)

LABELS = (
    "full_mesh",
    *(f"slicings:slice_count={count}" for count in reversed(COUNTS)),
    *(f"leaf_clusters:alpha_rel={a},cluster_count={c}" for a in ALPHAS for c in (8, 16)),
)
"""Slicings stand in the wrong order, to be put right."""


def sweep(*, columns):
    """
    A table of a mesh, 4 slicings by one parameter, and 4 leaf clusters by two.

    Parameters stand in columns, or in JSON alone as in a comparison. A label at position i has
    errors of 0.02 i and takes 8 / (i + 1) ms at 2.5 radii; see `made_results.comparison`.
    """
    table = comparison(LABELS).table()
    params = {label: {} for label in LABELS}
    for label in LABELS[1:]:
        pairs = label.partition(":")[2].split(",")
        params[label] = {name: json.loads(value) for name, value in (p.split("=") for p in pairs)}
    table["params"] = [json.dumps(params[label] | {"samples": 16}) for label in table["label"]]
    if columns:
        names = dict.fromkeys(name for one in params.values() for name in one)
        for name in names:
            values = [params[label].get(name, math.nan) for label in table["label"]]
            table[f"param_{name}"] = values
        table = table.drop(columns="params")
    # 1000 bytes a step of the position, so that bytes are known too
    table["total_bytes"] = [1000 * (LABELS.index(label) + 1) for label in table["label"]]
    return table


@pytest.fixture(params=[True, False], ids=["columns", "json"])
def table(request):
    return sweep(columns=request.param)


def mean_flip(table, label, distance):
    return table[(table["label"] == label) & (table["distance"] == distance)]["flip"].mean()


def lines_of(axes, *, least=2):
    """Data of every line of some points and its colour, without horizontal rules."""
    return [
        (np.column_stack(line.get_data()).astype(float), line.get_color())
        for line in axes.get_lines()
        if len(line.get_xdata()) >= least and line.get_transform() == axes.transData
    ]


def texts_of(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


# What belongs together


def test_settings_of_a_technique_are_ordered_by_what_was_swept(table):
    mesh, slicings, clusters = settings.families(table)
    assert (mesh.swept, mesh.labels) == (None, ["full_mesh"])
    assert slicings.swept == "slice_count"
    (path,) = slicings.paths
    assert path.values == list(COUNTS)
    assert path.labels == [f"slicings:slice_count={count}" for count in COUNTS]
    assert clusters.swept == "alpha_rel"
    assert [path.values for path in clusters.paths] == [list(ALPHAS)] * 2
    assert [path.others for path in clusters.paths] == ["cluster_count 8", "cluster_count 16"]


def test_a_technique_has_one_colour_and_its_settings_shades(table):
    looks = settings.looks(table)
    assert list(looks) == list(LABELS), "in the order of appearance"
    assert len({look.color for look in looks.values()}) == 3
    shades = [looks[f"slicings:slice_count={count}"].shade for count in COUNTS]
    assert len(set(shades)) == 4
    assert shades[-1].upper() == looks[LABELS[1]].color.upper(), "the last is the full colour"


def test_values_that_are_lists_texts_or_missing_are_told_apart():
    table = sweep(columns=True)
    kinds = {"full_mesh": None, LABELS[1]: "fit", LABELS[2]: 0.5, LABELS[3]: True}
    table["param_correction"] = [kinds.get(label) for label in table["label"]]
    table["param_levels"] = [(4, 2) if label == LABELS[4] else None for label in table["label"]]
    found = settings.parameter_values(table, "correction")
    assert {type(value) for value in found} == {type(None), str, float, bool}
    assert set(settings.parameter_values(table, "levels")) == {None, (4, 2)}
    assert settings.shown((4, 2)) == "4,2"


# Fronts


@pytest.mark.parametrize(
    ("plot", "column"),
    [(plots.speed_against_error, "frame_millis"), (plots.memory_against_error, "total_bytes")],
)
def test_fronts_join_a_techniques_settings_in_order(table, plot, column):
    figure = plot(table)
    for axes, distance in zip(figure.axes, (2.5, 10.0), strict=True):
        points = {}
        for label in LABELS:
            rows = table[(table["label"] == label) & (table["distance"] == distance)]
            points[label] = (rows[column].median(), rows["flip"].mean())
        drawn = {
            tuple(np.round(np.asarray(xy, float), 12))
            for line, _ in lines_of(axes, least=1)
            for xy in line
        }
        assert {tuple(np.round(np.asarray(xy, float), 12)) for xy in points.values()} <= drawn
        orange = settings.looks(table)[LABELS[1]].color
        (joined,) = [line for line, color in lines_of(axes) if color == orange]
        expected = [points[f"slicings:slice_count={count}"] for count in COUNTS]
        np.testing.assert_allclose(joined, expected, rtol=1e-12)
        front = points["full_mesh"]
        steps = [line for line, color in lines_of(axes, least=1) if color == style.FRONT["color"]]
        assert any(np.allclose(xy, front) for xy in steps[0]), "the mesh has no error"
        assert axes.get_xscale() == "log"
    assert texts_of(figure) == [
        "full_mesh",
        "slicings: slice_count 2 to 16",
        "leaf_clusters: alpha_rel 0 to 0.1",
        "Pareto front",
    ]


def test_bytes_are_named_on_their_axis():
    (axes, _) = plots.memory_against_error(sweep(columns=True)).axes
    labels = [axes.xaxis.get_major_formatter()(tick, 0) for tick in axes.get_xticks()]
    assert {"1 kB", "3 kB"} <= set(labels)


def test_labels_of_ends_lie_apart_and_inside():
    figure = plots.speed_against_error(sweep(columns=True))
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    for axes in figure.axes:
        boxes = [text.get_window_extent(renderer) for text in axes.texts]
        assert {"2", "16"} <= {text.get_text() for text in axes.texts}
        for index, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in boxes[:index])
            frame = axes.get_window_extent(renderer).padded(12)
            assert frame.x0 <= box.x0 <= box.x1 <= frame.x1


def test_a_label_without_any_room_is_left_out():
    figure, (axes,) = style.panels(1)
    axes.plot([0, 1], [0, 1])
    style.place_labels(figure, [(axes, 0.5, 0.5, "x" * 200, "k"), (axes, 0.5, 0.5, "y", "k")])
    assert [text.get_text() for text in axes.texts] == ["y"]


# Parameters


def test_error_against_a_parameter_shows_means_and_bands(table):
    figure = plots.error_against_parameter(table, "slice_count")
    for axes, distance in zip(figure.axes, (2.5, 10.0), strict=True):
        ((line, _),) = lines_of(axes)
        expected = [(c, mean_flip(table, f"slicings:slice_count={c}", distance)) for c in COUNTS]
        np.testing.assert_allclose(line, expected, rtol=1e-12)
        (band,) = axes.collections
        rows = table[(table["label"] == "slicings:slice_count=2") & (table["distance"] == distance)]
        edge = [y for x, y in band.get_paths()[0].vertices if x == 2]
        assert min(edge) == pytest.approx(rows["flip"].min())
        assert max(edge) == pytest.approx(rows["flip"].max())
        assert axes.get_xscale() == "log", "2, 4, 8, 16 are spaced so"
        assert axes.get_xticks().tolist() == list(COUNTS)
    assert texts_of(figure) == ["slicings", "full_mesh"]


def test_other_parameters_that_vary_have_lines_of_their_own(table):
    (axes,) = plots.error_against_parameter(table, "alpha_rel", by=None).axes
    lines = [line for line, _ in lines_of(axes)]
    assert len(lines) == 2
    for line, count in zip(lines, (8, 16), strict=True):
        rows = [
            table[table["label"] == f"leaf_clusters:alpha_rel={a},cluster_count={count}"]
            for a in ALPHAS
        ]
        expected = [(a, row["flip"].mean()) for a, row in zip(ALPHAS, rows, strict=True)]
        np.testing.assert_allclose(line, expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ((1, 2, 3, 4), "linear"),
        ((0.01, 0.1, 1.0, 10.0), "log"),
        ((0.0, 0.01, 0.1, 1.0), "symlog"),
        (("a", "b", "c", "d"), "linear"),
    ],
)
def test_the_axis_suits_the_values(values, scale):
    table = sweep(columns=True)
    by_label = dict(zip(LABELS[1:5], values, strict=True))
    table["param_x"] = [by_label.get(label) for label in table["label"]]
    table = table.drop(columns="param_slice_count")
    axes = plots.error_against_parameter(table, "x").axes[0]
    assert axes.get_xscale() == scale
    ticks = [axes.xaxis.get_major_formatter()(tick, 0) for tick in axes.get_xticks()]
    assert ticks == [settings.shown(value) for value in values]


def test_costs_can_be_plotted_too(table):
    (axes,) = plots.error_against_parameter(table, "slice_count", "total_bytes", by=None).axes
    ((line, _),) = lines_of(axes)
    # the positions of slicings among the labels: 4, 3, 2, 1
    np.testing.assert_array_equal(line[:, 1], [5000, 4000, 3000, 2000])
    assert axes.get_yscale() == "log"


# Directions


def test_the_heat_map_has_the_tables_means():
    table = comparison(("full_mesh", "slicings")).table()
    figure = plots.error_heat_map(table, "slicings")
    maps = [mesh for axes in figure.axes for mesh in axes.collections if type(mesh) is QuadMesh]
    for mesh, distance in zip(maps[:2], (2.5, 10.0), strict=True):
        rows = table[(table["label"] == "slicings") & (table["distance"] == distance)]
        expected = rows.pivot_table(values="flip", index="elevation_deg", columns="azimuth_deg")
        np.testing.assert_allclose(mesh.get_array(), expected.to_numpy())
        assert mesh.get_clim()[0] == 0.0
    axes = figure.axes[0]
    assert [axes.xaxis.get_major_formatter()(tick, 0) for tick in axes.get_xticks()] == [
        "0", "90", "180", "270",
    ]  # fmt: skip
    assert [axes.yaxis.get_major_formatter()(tick, 0) for tick in axes.get_yticks()] == ["0", "25"]
    # every cell says its number
    assert len(axes.texts) == 8


def test_the_heat_map_of_several_labels_has_a_row_each_on_one_scale():
    table = comparison(("full_mesh", "slicings", "b")).table()
    figure = plots.error_heat_map(table, ["slicings", "b"])
    maps = [m for axes in figure.axes for m in axes.collections if type(m) is QuadMesh]
    assert len({mesh.get_clim() for mesh in maps[:4]}) == 1
    titles = [axes.get_title(loc="left") for axes in figure.axes[:4]]
    assert titles[0].startswith("slicings\n")
    assert titles[2] == "b"
    assert len(plots.error_heat_map(table).axes) == 3 * 2 + 1


def test_the_heat_map_of_two_labels_names_its_angle_once():
    # beside maps of two elevations a name each would run into one another
    figure = plots.error_heat_map(sweep(columns=True), LABELS[:2])
    assert figure.get_supylabel() == "elevation (degrees)"
    assert not any(axes.get_ylabel() == "elevation (degrees)" for axes in figure.axes)


def test_the_heat_map_shows_what_is_missing_and_which_way_is_wrong():
    table = comparison(("full_mesh", "slicings")).table()
    figure = plots.error_heat_map(table.drop(index=table.index[-1]), "slicings")
    mesh = figure.axes[1].collections[0]
    assert np.ma.getmaskarray(mesh.get_array()).sum() == 1
    assert len(figure.axes[1].texts) == 7
    bias = plots.error_heat_map(table, "slicings", "coverage_bias").axes[0].collections[0]
    low, high = bias.get_clim()
    assert low == -high, "no difference is in the middle of the colours"


def test_coverage_shows_its_sign_by_distance_and_azimuth():
    table = comparison(("full_mesh", "slicings")).table()
    by_distance, by_azimuth = plots.coverage(table).axes
    rows = table[table["label"] == "slicings"]
    line = next(line for line, color in lines_of(by_distance) if color == style.COLORS[1])
    expected = rows.groupby("distance")["coverage_bias"].mean()
    np.testing.assert_allclose(line[:, 1], expected)
    assert (line[:, 1] < 0).all()
    line = next(line for line, color in lines_of(by_azimuth) if color == style.COLORS[1])
    expected = rows.groupby("azimuth_deg")["coverage_bias"].mean()
    np.testing.assert_allclose(line[:-1], np.column_stack([expected.index, expected]))
    assert by_distance.get_ylim()[0] < rows["coverage_bias"].min() < 0 <= by_distance.get_ylim()[1]


def test_of_many_labels_the_mean_over_elevations_is_drawn():
    table = sweep(columns=True)
    axes = plots.error_by_azimuth(table).axes[0]
    lines = lines_of(axes)
    assert len(lines) == len(LABELS)
    rows = table[(table["label"] == LABELS[1]) & (table["distance"] == 2.5)]
    expected = rows.groupby("azimuth_deg")["flip"].mean()
    np.testing.assert_allclose(lines[1][0][:-1, 1], expected)


def test_more_labels_than_a_legend_holds_are_named_by_technique():
    labels = ["full_mesh", *(f"slicings:slice_count={count}" for count in range(1, 14))]
    table = comparison(labels).table()
    table["param_slice_count"] = [
        float(label.partition("=")[2]) if "=" in label else math.nan for label in table["label"]
    ]
    for plot in (plots.error_by_azimuth, plots.error_by_distance, plots.coverage):
        assert texts_of(plot(table))[:2] == [
            "full_mesh",
            "slicings: slice_count 1 to 13 (pale to full)",
        ]


# Pictures


def test_a_strip_shows_the_pictures_and_their_numbers():
    pictures = comparison().pictures
    figure = plots.picture_strip(pictures)
    rows = np.array(figure.axes[: 4 * len(pictures)]).reshape(-1, 4)
    for (text, *shown), picture in zip(rows, pictures, strict=True):
        for axes, pixels in zip(
            shown, (picture.reference, picture.image, picture.difference), strict=True
        ):
            np.testing.assert_array_equal(axes.get_images()[0].get_array(), pixels)
        title, numbers = (note.get_text() for note in text.texts)
        assert title == picture.row.label
        flip = picture.row.errors.on["black"].flip
        assert f"FLIP {flip:.3f} on black" in numbers
        assert f"{picture.row.view.distance:g} radii" in numbers


def test_a_strip_of_frames_measures_them():
    plant = random_crown(40)
    (camera,) = tl.orbit(plant, 1, size=(48, 48))
    truth = tl.render(tl.FullMesh.build(plant), camera, samples=16)
    pruned = tl.render(tl.StochasticPruning.build(plant, wood=False), camera)
    figure = plots.picture_strip({"pruned": pruned}, truth, background="white")
    errors = tl.metrics.compare(truth, pruned)
    numbers = figure.axes[0].texts[1].get_text()
    assert f"FLIP {errors.on['white'].flip:.3f} on white" in numbers
    difference = figure.axes[3].get_images()[0].get_array()
    assert difference.mean() == pytest.approx(errors.on["white"].flip, rel=1e-6)


# Switches


def switch_table():
    return pd.DataFrame(
        {
            "label": ["a", "a", "b"],
            "path": [0.5, 1.5, 1.0],
            "distance": [5.0, 7.0, 6.0],
            "azimuth_deg": [10.0, 20.0, 350.0],
            "flip": [0.1, 0.02, 0.0],
            "what": ["cards 4 to 2", "cards 2 to 1", "paint order"],
        }
    )


def test_popping_draws_a_stem_a_switch():
    table = switch_table()
    (axes,) = plots.popping(table, "distance").axes
    marks = lines_of(axes, least=1)
    np.testing.assert_array_equal(marks[0][0], [(5.0, 0.1), (7.0, 0.02)])
    np.testing.assert_array_equal(marks[1][0], [(6.0, 0.0)])
    tops = [segment[1].tolist() for stem in axes.collections for segment in stem.get_segments()]
    assert tops == [[5.0, 0.1], [7.0, 0.02], [6.0, 0.0]]
    # what is not seen needs no name
    assert {text.get_text() for text in axes.texts} == {"cards 4 to 2", "cards 2 to 1"}
    assert axes.get_xscale() == "linear"
    (axes,) = plots.popping(table.assign(distance=[5.0, 50.0, 6.0]), "distance").axes
    assert axes.get_xscale() == "log"
    (axes,) = plots.popping(table, "azimuth_deg").axes
    assert axes.get_xticks().tolist() == [0, 90, 180, 270, 360]


def test_popping_says_that_not_all_was_measured():
    table = switch_table()
    assert texts_of(plots.popping(table)) == ["a", "b"]
    table["complete"], table["changed_steps"] = [False, False, True], [30, 30, 1]
    assert texts_of(plots.popping(table)) == ["a (2 of at least 30 measured)", "b"]
    # several in one step
    table["changed_steps"] = 1
    assert texts_of(plots.popping(table)) == ["a (2 of at least 3 measured)", "b"]


# All of them


def test_every_plot_refuses_an_empty_table_and_a_missing_column():
    table = comparison().table()
    for plot, column in (
        (plots.speed_against_error, "frame_millis"),
        (plots.memory_against_error, "total_bytes"),
        (plots.error_by_azimuth, "azimuth_deg"),
        (plots.error_by_distance, "distance"),
        (plots.error_heat_map, "elevation_deg"),
        (plots.coverage, "coverage_bias"),
        (plots.popping, "what"),
    ):
        with pytest.raises(ValueError, match="empty"):
            plot((switch_table() if plot is plots.popping else table)[:0])
        with pytest.raises(ValueError, match=f"no column '{column}'"):
            plot(table.drop(columns=column, errors="ignore"))
    with pytest.raises(ValueError, match="no column 'tree_count'"):
        plots.walk_costs(table)


def test_refuses():
    table = sweep(columns=True)
    cases = [
        (lambda: plots.error_against_parameter(table, "colour"), "no row .* parameter 'colour'"),
        (lambda: plots.error_against_parameter(table, "slice_count", "beauty"), "metric must be"),
        (lambda: plots.error_against_parameter(table, "slice_count", by="view"), "by must be"),
        (
            lambda: plots.error_against_parameter(
                table[table["label"].isin(LABELS[:2])], "slice_count"
            ),
            "'slice_count' has one value, 16",
        ),
        (lambda: plots.error_heat_map(table, "nobody"), "no label 'nobody'"),
        (lambda: plots.error_heat_map(table, []), "at least one label"),
        (
            lambda: plots.speed_against_error(table.assign(flip=math.nan)),
            "no value of 'flip'",
        ),
        (
            lambda: plots.speed_against_error(table.assign(frame_millis=math.nan)),
            "no value of 'frame_millis'",
        ),
        (lambda: plots.memory_against_error(table.assign(total_bytes=0)), "above 0"),
        (lambda: plots.picture_strip([]), "pictures is empty"),
        (lambda: plots.picture_strip({"a": None}), "reference is needed"),
        (lambda: plots.picture_strip([], background="white"), "are for frames"),
        (lambda: plots.popping(switch_table(), "flip"), "against must be one of"),
    ]
    for plot, match in cases:
        with pytest.raises(ValueError, match=match):
            plot()
    for pictures in (5, [5]):
        with pytest.raises(TypeError, match="pictures must be Pictures"):
            plots.picture_strip(pictures)


def test_a_table_of_several_plants_or_settings_is_refused_by_name():
    table = sweep(columns=True).assign(timing="concurrent", threads=2, kernel_version="a")
    half = np.arange(len(table)) % 2 == 0
    errors = (
        plots.memory_against_error,
        plots.error_by_azimuth,
        plots.error_by_distance,
        plots.error_heat_map,
        plots.coverage,
        lambda mixed: plots.error_against_parameter(mixed, "slice_count"),
    )
    times = (
        plots.speed_against_error,
        lambda mixed: plots.error_against_parameter(mixed, "slice_count", "frame_millis"),
    )
    for name, values in {
        "plant": ("oak", "ash"),
        "time_samples": (4, 8),
        "reference_samples": (64, 16),
        "ppd": (67.02, 30.0),
        "kernel_version": ("a", "b"),
        "timing": ("concurrent", "exclusive"),
        "threads": (2, 1),
    }.items():
        mixed = table.assign(**{name: np.where(half, *values)})
        advice = re.escape(f"table[table['{name}'] == {values[0]!r}]")
        of_times = name in ("timing", "threads")
        for plot in times if of_times else errors + times:
            with pytest.raises(ValueError, match=f"2 values of '{name}'.*{advice}"):
                plot(mixed)
        if of_times:
            plots.memory_against_error(mixed)
    # of what was not timed it does not matter
    untimed = table.assign(threads=np.where(half, 2, 1))
    plots.speed_against_error(untimed.assign(frame_millis=table["frame_millis"].where(half)))


def test_plants_in_panels_of_their_own_and_missing_values_are_no_mixture():
    table = sweep(columns=True)
    half = np.arange(len(table)) % 2 == 0
    plants = table.assign(plant=np.where(half, "oak", "ash"))
    assert len(plots.error_against_parameter(plants, "slice_count", by="plant").axes) == 2
    # a comparison, which has no such column, joined to a sweep
    plots.error_by_distance(table.assign(kernel_version=np.where(half, "a", None)))


def test_every_plot_shows_itself_in_a_notebook_once():
    # a formatter without matplotlib's own printers: no pyplot, no magic command
    from IPython.core.formatters import DisplayFormatter

    table = sweep(columns=True)
    crown = random_crown(5)
    frame = tl.render(tl.FullMesh.build(crown), tl.orbit(crown, 1, size=(32, 32))[0])
    for figure in (
        plots.error_heat_map(table, LABELS[0]),
        plots.popping(switch_table()),
        plots.picture_strip({"a": frame}, frame),
    ):
        data, _ = DisplayFormatter().format(figure)
        assert data["image/png"].startswith(b"\x89PNG")
        assert "image/svg+xml" not in data


def test_every_plot_is_a_picture_of_the_same_bytes():
    table = sweep(columns=True)
    for plot in (
        lambda: plots.speed_against_error(table),
        lambda: plots.error_heat_map(table),
        lambda: plots.popping(switch_table()),
    ):
        first, second = (plots.encode(plot(), "png", dpi=60) for _ in range(2))
        assert first == second
        assert first.startswith(b"\x89PNG")
