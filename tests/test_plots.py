"""Do plots show the numbers of the table, all of them, whatever the numbers and names are?"""

import io
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from made_results import comparison
from treelod import plots

TABLE = comparison().table()


def points_of(axes):
    """Return the (x, y) of every marker drawn without a line."""
    return [
        (float(x), float(y))
        for line in axes.get_lines()
        if line.get_marker() not in ("None", "", None, "|", "_") and len(line.get_xdata()) == 1
        for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)
    ]


@pytest.mark.parametrize(
    ("cost", "error", "front"),
    [
        ([1, 2, 3], [3, 2, 1], [0, 1, 2]),
        ([3, 2, 1], [1, 2, 3], [2, 1, 0]),  # by rising cost, whatever the order
        ([1, 2, 3], [1, 2, 3], [0]),  # one beats all
        ([1, 1, 1], [2, 1, 1], [1]),  # equal cost: the least error; equal points: the first
        ([2, 1], [1, 1], [1]),  # equal error: the least cost
        ([1, 2], [np.inf, 5], [0, 1]),
        ([1, 2, np.nan], [np.nan, 5, 0], [1]),
        ([], [], []),
    ],
)
def test_pareto_front(cost, error, front):
    assert plots.pareto_front(cost, error).tolist() == front


def test_pareto_front_against_the_definition():
    rng = np.random.default_rng(3)
    cost, error = rng.integers(0, 30, (2, 60)).astype(float)
    beaten = [
        any(
            c <= cost[i] and e <= error[i] and (c < cost[i] or e < error[i])
            for c, e in zip(cost, error, strict=True)
        )
        for i in range(60)
    ]
    front = plots.pareto_front(cost, error)
    unbeaten = {(cost[i], error[i]) for i in range(60) if not beaten[i]}
    assert {(cost[i], error[i]) for i in front} == unbeaten


def test_pareto_front_refuses_other_shapes():
    with pytest.raises(ValueError, match="one-dimensional and equal"):
        plots.pareto_front([1, 2], [1])


def test_speed_against_error_shows_medians_and_means():
    figure = plots.speed_against_error(TABLE)
    assert [axes.get_title(loc="left") for axes in figure.axes] == [
        "distance 2.5 radii",
        "distance 10 radii",
    ]
    # by hand: 8 and 4 ms at 2.5 radii, half of that at 10; the sine cancels over 4 azimuths
    for axes, scale in zip(figure.axes, (1.0, 0.5), strict=True):
        points = points_of(axes)
        np.testing.assert_allclose(points, [(8 * scale, 0.0), (4 * scale, 0.02)], atol=1e-12)
        assert axes.get_xscale() == "log"
        assert "ms" in axes.get_xlabel()


def test_the_front_of_coverage_bias_is_that_of_its_magnitude_over_views():
    # the mesh is slow and never far off; slicings are quicker, but now too dense, now too thin
    sign = np.where(np.arange(len(TABLE)) % 2 == 0, 1.0, -1.0)
    is_mesh = (TABLE["label"] == "full_mesh").to_numpy()
    table = TABLE.assign(coverage_bias=np.where(is_mesh, 0.1, 0.3 * sign))
    figure = plots.speed_against_error(table, "coverage_bias")
    for axes in figure.axes:
        (front,) = [line for line in axes.get_lines() if line.get_drawstyle() == "steps-post"]
        np.testing.assert_allclose(front.get_ydata(), [0.0, 0.1], atol=1e-12)
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts[-1] == "Pareto front of mean magnitudes"


def test_error_by_azimuth_closes_the_circle():
    figure = plots.error_by_azimuth(TABLE)
    for axes in figure.axes:
        lines = [line for line in axes.get_lines() if len(line.get_xdata()) > 1]
        assert len(lines) == 4  # 2 techniques, 2 elevations
        for line in lines:
            assert list(line.get_xdata()) == [0, 90, 180, 270, 360]
            assert line.get_ydata()[0] == line.get_ydata()[-1]
        assert len({line.get_linestyle() for line in lines}) == 2


def test_an_arc_is_left_open():
    arc = TABLE[TABLE["azimuth_deg"] < 200.0]
    for axes in (*plots.error_by_azimuth(arc).axes, plots.coverage(arc).axes[1]):
        lines = [line for line in axes.get_lines() if line.get_marker() in ("o", "s")]
        assert lines
        assert all(list(line.get_xdata()) == [0, 90, 180] for line in lines)


def test_infinite_psnr_is_drawn_above_all_finite_ones_and_named():
    figure = plots.error_by_distance(TABLE, ("psnr",))
    (axes,) = figure.axes
    identical, other = [line for line in axes.get_lines() if line.get_marker() in ("o", "s")]
    finite = TABLE["psnr"][np.isfinite(TABLE["psnr"])]
    assert np.isfinite(identical.get_ydata()).all()
    assert min(identical.get_ydata()) > finite.max() > max(other.get_ydata())
    assert axes.get_ylim()[1] > max(identical.get_ydata())
    assert any("∞" in text.get_text() for text in axes.texts)
    # nothing infinite: no such line
    (axes,) = plots.error_by_distance(TABLE[TABLE["label"] == "slicings"], ("psnr",)).axes
    assert not axes.texts


def test_all_infinite_psnr_still_draws():
    same = TABLE[TABLE["label"] == "full_mesh"]
    assert plots.encode(plots.speed_against_error(same, "psnr"), "png").startswith(b"\x89PNG")


def test_names_that_mean_something_to_matplotlib_are_shown_as_they_are():
    labels = ("full_mesh", "_hidden", r"a$\frac$b", "<&>")
    figure = plots.speed_against_error(comparison(labels).table())
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == [*labels, "Pareto front"]
    plots.encode(figure)  # a formula with \frac alone would raise here


def test_techniques_differ_in_color_and_marker():
    labels = tuple(f"t{i}" for i in range(7))
    figure = plots.speed_against_error(comparison(labels).table())
    handles = figure.legends[0].legend_handles[:-1]
    assert len({handle.get_color() for handle in handles}) == 7
    assert len({handle.get_marker() for handle in handles}) == 7


def test_of_many_distances_a_few_are_shown():
    figure = plots.speed_against_error(comparison(distances=(2, 3, 4, 5, 6, 7, 8)).table())
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == [f"distance {d} radii" for d in (2, 4, 6, 8)]


@pytest.mark.parametrize(
    "plot", [plots.speed_against_error, plots.memory_against_error, plots.error_by_azimuth]
)
def test_distances_that_are_left_out_are_counted_on_the_figure(plot):
    for distances, note in (((2, 3, 4, 5, 6, 7, 8), "4 of 7 distances"), ((2, 3, 4, 5), "")):
        figure = plot(comparison(distances=distances).table())
        notes = [axes.get_title(loc="right") for axes in figure.axes]
        assert notes == ["", "", "", note]


def test_the_heat_map_counts_distances_that_are_left_out():
    table = comparison(distances=(2, 3, 4, 5, 6, 7, 8)).table()
    assert plots.error_heat_map(table).get_supxlabel() == "4 of 7 distances"
    assert plots.error_heat_map(TABLE).get_supxlabel() == ""


@pytest.mark.parametrize("metric", sorted(plots.METRICS))
def test_every_metric_has_an_axis(metric):
    for figure in (
        plots.speed_against_error(TABLE, metric),
        plots.error_by_azimuth(TABLE, metric),
        plots.error_by_distance(TABLE, (metric,)),
    ):
        assert figure.axes[0].get_ylabel() == plots.METRICS[metric].label


@pytest.mark.parametrize("spread", [1.0, 1.3, 5.0, 30.0, 5000.0])
def test_time_axes_have_several_plain_labels(spread):
    table = TABLE.assign(frame_millis=np.where(TABLE["label"] == "slicings", 47.0, 47.0 * spread))
    for axes in plots.speed_against_error(table).axes:
        low, high = axes.get_xlim()
        ticks = [tick for tick in axes.get_xticks() if low <= tick <= high]
        assert 2 <= len(ticks) <= 8
        labels = [axes.xaxis.get_major_formatter()(tick, 0) for tick in ticks]
        assert [float(label) for label in labels] == pytest.approx(ticks, rel=1e-3)


def test_one_view_is_enough():
    one = TABLE[TABLE["view"] == 0]
    for figure in (
        plots.speed_against_error(one),
        plots.error_by_azimuth(one),
        plots.error_by_distance(one),
    ):
        picture = Image.open(io.BytesIO(plots.encode(figure, "png", dpi=100)))
        assert min(picture.size) > 150


def test_same_bytes_again():
    first, second = (plots.encode(plots.error_by_distance(TABLE)) for _ in range(2))
    assert first == second
    assert b"<svg" in first
    assert plots.encode(plots.error_by_distance(TABLE[TABLE["view"] < 3])) != first


def test_refuses():
    with pytest.raises(ValueError, match="metric must be one of flip"):
        plots.speed_against_error(TABLE, "beauty")
    with pytest.raises(ValueError, match="table is empty"):
        plots.error_by_azimuth(TABLE[:0])
    with pytest.raises(ValueError, match="at least one error"):
        plots.error_by_distance(TABLE, ())
    with pytest.raises(ValueError, match="kind must be"):
        plots.encode(plots.error_by_azimuth(TABLE), "gif")


def test_pyplot_is_left_alone():
    code = "import treelod.plots, sys; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
