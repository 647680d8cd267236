"""Does a comparison measure the right frames, and keep errors and times apart?"""

import math

import numpy as np
import pytest

from treelod import Plant, comparison, metrics
from treelod.cameras import Camera, default_cameras, orbit
from treelod.comparison import compare_techniques, tinted
from treelod.errors import LimitError
from treelod.render import render
from treelod.techniques import REGISTRY, FullMesh

SIZE = (96, 80)


def sapling(leaf_count=60, seed=5):
    """A thin trunk and a ball of small leaves: minimal, but with holes and edges to get wrong."""
    rng = np.random.default_rng(seed)
    centers = rng.normal((0, 2, 0), 0.5, (leaf_count, 1, 3))
    corners = centers + rng.normal(0, 0.12, (leaf_count, 3, 3))
    return Plant.from_arrays(
        name="sapling",
        wood={
            "positions": [[-0.1, 0, 0], [0.1, 0, 0], [0, 2, 0.05]],
            "triangles": [[0, 1, 2]],
            "colors": [[0.3, 0.2, 0.1]] * 3,
        },
        foliage={
            "positions": corners.reshape(-1, 3),
            "triangles": np.arange(3 * leaf_count).reshape(-1, 3),
            "colors": np.tile([0.2, 0.6, 0.1], (3 * leaf_count, 1)),
        },
        leaf_offsets=np.arange(leaf_count + 1),
    )


PLANT = sapling()
CAMERAS = default_cameras(
    PLANT, azimuth_count=2, elevations_deg=(0, 25), distances=(2.5, 10), size=SIZE
)
COUNTS = {"repeats": 3, "warmup": 1, "reference_samples": 16}


@pytest.fixture(scope="module")
def calls():
    return []


@pytest.fixture(scope="module")
def result(calls):
    return compare_techniques(
        PLANT,
        # a built technique that is the reference itself: its error frame must be the reference
        {"same": FullMesh.build(PLANT)},
        CAMERAS,
        **COUNTS,
        source={"file": "sapling.glb", "sha256": "ab" * 32},
        progress=lambda *call: calls.append(call),
    )


def test_one_row_a_technique_and_camera(result):
    assert [(row.label, row.view.index) for row in result.rows] == [
        (label, index) for label in ("full_mesh", "same") for index in range(8)
    ]
    assert [bake.label for bake in result.bakes] == ["full_mesh", "same"]
    assert result.reference_label == "full_mesh"
    assert len(result.table()) == 16


def test_error_frames_have_the_reference_sample_count(result):
    # the reference compared with itself has no error at all; had it been drawn with 4 samples,
    # it would have the full mesh's
    for row in result.rows:
        if row.label == "same":
            assert row.error_samples == 16
            assert row.errors.flip == 0.0
            assert row.errors.rmse == 0.0
        else:
            assert row.error_samples == 4
            assert row.errors.rmse > 0.0
            assert row.errors.flip > 0.0


def test_full_mesh_error_is_aliasing(result):
    full = FullMesh.build(PLANT)
    for index in (0, 7):
        camera = CAMERAS[index]
        expected = metrics.compare(
            render(full, camera, samples=16), render(full, camera, samples=4)
        )
        assert result.rows[index].errors == expected


def test_times_are_kept_apart_and_all_there(result):
    for row in result.rows:
        assert row.frame_millis.shape == (3,)
        assert (row.frame_millis > 0).all()
        assert row.stats.samples == 4, "counts are of a frame as it is timed"
    table = result.table()
    np.testing.assert_array_equal(table["time_samples"], 4)
    np.testing.assert_array_equal(table["reference_samples"], 16)
    full = table[table["label"] == "full_mesh"]
    np.testing.assert_array_equal(full["speedup"], 1.0)
    same = table[table["label"] == "same"]
    np.testing.assert_allclose(
        same["speedup"], full["frame_millis"].to_numpy() / same["frame_millis"].to_numpy()
    )


def test_views_carry_what_was_asked_for(result):
    assert [(v.distance, v.elevation_deg, v.azimuth_deg) for v in result.views] == [
        (distance, elevation, azimuth)
        for distance in (2.5, 10.0)
        for elevation in (0.0, 25.0)
        for azimuth in (0.0, 180.0)
    ]


def test_pictures_are_near_far_and_worst(result):
    for label in ("full_mesh", "same"):
        kept = {p.why: p for p in result.pictures if p.row.label == label}
        assert set(kept) == {"near", "far", "worst"}
        assert kept["near"].row.view.index == 0
        assert kept["far"].row.view.index == 4
        worst = max(
            (row for row in result.rows if row.label == label), key=lambda row: row.errors.flip
        )
        assert kept["worst"].row.errors.flip == worst.errors.flip
    for picture in result.pictures:
        left, top, right, bottom = picture.row.errors.region
        assert picture.reference.shape == (bottom - top, right - left, 3)
        assert picture.image.shape == picture.reference.shape
        errors = picture.row.errors.on[picture.background]
        assert picture.difference.mean(dtype=np.float64) == errors.flip
        assert errors.flip == picture.row.errors.flip
        same = np.array_equal(picture.image, picture.reference)
        assert same == (picture.row.label == "same")


def test_progress_reaches_the_end_of_every_stage(result, calls):
    assert result is not None
    for stage, steps in (
        ("building", 2),
        ("reference frames", 8),
        ("error frames", 8),
        ("timing", 8),
    ):
        done = [call[1] for call in calls if call[0] == stage]
        assert done == sorted(done)
        assert done[-1] == steps
        assert {call[2] for call in calls if call[0] == stage} == {steps}


def test_rows_say_where_they_come_from(result):
    table = result.table()
    assert set(table["plant_sha256"]) == {"ab" * 32}
    for column in (
        "treelod_version",
        "numpy_version",
        "openimageio_version",
        "python_version",
        "build_profile",
        "cpu",
        "core_count",
        "threads",
        "date",
        "params",
        "total_bytes",
    ):
        assert table[column].notna().all(), column
    assert table["threads"].ge(1).all()
    assert result.source["file"] == "sapling.glb"


def test_same_errors_on_one_thread_and_on_two():
    first, second = (
        compare_techniques(PLANT, {}, CAMERAS[:2], **COUNTS, threads=threads) for threads in (1, 2)
    )
    assert [row.errors for row in first.rows] == [row.errors for row in second.rows]
    assert (first.settings["threads"], second.settings["threads"]) == (1, 2)


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_every_registered_technique_can_be_compared(name):
    label = f"{name}:again" if name == FullMesh.name else name
    result = compare_techniques(PLANT, {label: {}}, CAMERAS[:1], **COUNTS)
    row = next(row for row in result.rows if row.label == label)
    assert 0.0 <= row.errors.flip < 0.6
    assert abs(row.errors.coverage_bias) < 0.3
    (bake,) = (bake for bake in result.bakes if bake.label == label)
    assert bake.technique == name
    assert bake.footprint.total_bytes > 0


def test_one_technique_with_two_sets_of_parameters():
    result = compare_techniques(
        PLANT,
        {
            "slicings:few": {"slice_count": 1, "resolution": 16},
            "slicings:many": {"slice_count": 5, "resolution": 64},
        },
        CAMERAS[:1],
        **COUNTS,
    )
    few, many = (
        next(r for r in result.rows if r.label == f"slicings:{n}") for n in ("few", "many")
    )
    assert few.errors.rmse > many.errors.rmse
    assert [bake.params.get("slice_count") for bake in result.bakes] == [None, 1, 5]


def test_summary_is_the_mean_over_views(result):
    summary = result.summary().set_index("label")
    assert summary.index.tolist() == ["full_mesh", "same"]
    flips = [row.errors.flip for row in result.rows if row.label == "full_mesh"]
    assert summary.loc["full_mesh", "flip"] == pytest.approx(np.mean(flips))
    assert summary.loc["full_mesh", "flip_worst"] == max(flips)
    assert summary.loc["same", "psnr_worst"] == math.inf
    assert summary.loc["same", "views"] == 8
    times = summary["frame_millis"]
    assert summary["speedup"].tolist() == [1.0, times["full_mesh"] / times["same"]]
    near = result.summary(by=("distance",)).set_index(["label", "distance"])
    assert near.loc[("full_mesh", 2.5), "flip"] == pytest.approx(np.mean(flips[:4]))
    for distance in (2.5, 10.0):
        millis = near["frame_millis"].xs(distance, level="distance")
        assert near.loc[("full_mesh", distance), "speedup"] == 1.0
        assert near.loc[("same", distance), "speedup"] == millis["full_mesh"] / millis["same"]


def test_plant_out_of_view_has_no_error():
    (camera,) = orbit(PLANT, 1, size=SIZE)
    away = np.subtract(camera.eye, camera.target) + camera.eye
    behind = Camera.perspective(camera.eye, away, size=SIZE)
    result = compare_techniques(PLANT, {}, [behind], **COUNTS)
    assert result.rows[0].errors.rmse == 0.0
    assert result.rows[0].errors.region == (0, 0, *SIZE)


def test_tinted_plant_keeps_its_shape_and_shows_the_split():
    plant = tinted(PLANT)
    np.testing.assert_array_equal(plant.foliage.positions, PLANT.foliage.positions)
    np.testing.assert_array_equal(plant.wood.triangles, PLANT.wood.triangles)
    assert plant.foliage.leaf_count == PLANT.foliage.leaf_count
    wood, foliage = plant.wood.base[0], plant.foliage.mesh.base[0]
    assert wood[0] > wood[1] > wood[2], "orange"
    assert foliage[1] > foliage[2] > foliage[0], "green"
    (camera,) = orbit(PLANT, 1, size=SIZE)
    plain, tint = (render(FullMesh.build(p), camera) for p in (PLANT, plant))
    np.testing.assert_array_equal(plain.color[..., 3], tint.color[..., 3])
    assert not np.array_equal(plain.color, tint.color)


@pytest.mark.parametrize(
    ("techniques", "settings", "message"),
    [
        ({"sketches": {}}, {}, "unknown technique 'sketches'; there are billboard"),
        ({"full_mesh": {"wood": False}}, {}, "label 'full_mesh' is the reference's"),
        ({}, {"cameras": []}, "cameras is empty"),
        ({}, {"repeats": 0}, "repeats must be at least 1"),
        ({}, {"warmup": -1}, "warmup at least 0"),
    ],
)
def test_refuses(techniques, settings, message):
    arguments = {"cameras": CAMERAS[:1], **COUNTS, **settings}
    with pytest.raises(ValueError, match=message):
        compare_techniques(PLANT, techniques, **arguments)


def test_refuses_before_any_work(monkeypatch):
    def unexpected(*_, **__):
        pytest.fail("something was drawn")

    monkeypatch.setattr(comparison, "render", unexpected)
    with pytest.raises(ValueError, match="unknown technique"):
        compare_techniques(PLANT, {"slicings": {}, "sketches": {}}, CAMERAS[:1])
    with pytest.raises(TypeError, match="no_such"):
        compare_techniques(PLANT, {"slicings": {"no_such": 1}}, CAMERAS[:1])
    huge = Camera.perspective((0, 0, 9), (0, 0, 0), size=(16384, 16384))
    monkeypatch.setattr(comparison, "_build", unexpected)
    with pytest.raises(LimitError, match="size needs 268435456 pixels"):
        compare_techniques(PLANT, {"slicings": {}}, [CAMERAS[0], huge])
