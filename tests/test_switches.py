"""Are switches found where they are known to be, and is what is seen of them measured?"""

import math

import numpy as np
import pandas as pd
import pytest

import treelod as tl
from made_plants import random_crown
from treelod.popping import MOTION_TOLERANCE_PX
from treelod.techniques import REGISTRY

CROWN = random_crown(60)
"""Its centre is at 0, and so is its leaves'."""

RADIUS = CROWN.sphere[1]

ACROSS = 1e-5
"""Of a distance: 64 pixels grow by a ten thousandth of one when the eye comes nearer by 4e-6."""

COLUMNS = ["label", "path", "distance", "azimuth_deg", "elevation_deg", "flip", "coverage_bias",
           "motion_px", "what", "complete", "changed_steps"]  # fmt: skip


def camera(azimuth_deg=0.0, distance=4.0, size=(64, 64)):
    """A camera on a level circle around 0, `distance` radii away."""
    angle = math.radians(azimuth_deg)
    eye = (math.sin(angle) * distance * RADIUS, 0.0, math.cos(angle) * distance * RADIUS)
    return tl.Camera.perspective(eye, (0, 0, 0), size=size)


def switches(lod, cameras, **kwargs):
    """With the plant's own sphere, and few samples."""
    found = tl.switches(lod, cameras, plant=CROWN, **{"samples": 4, "step_count": 7} | kwargs)
    assert (found["motion_px"] <= MOTION_TOLERANCE_PX).all()
    assert found["path"].is_monotonic_increasing
    return found


@pytest.fixture(scope="module")
def slicings():
    return tl.Slicings.build(CROWN, slicing_count=4, slice_count=3, resolution=32)


def test_slicings_change_places_half_way_between_two_directions(slicings):
    found = switches(slicings, [camera(10), camera(80)])
    assert found["azimuth_deg"].tolist() == pytest.approx([45.0], abs=1e-4)
    assert found["what"].tolist() == ["paint order"]
    assert found["flip"].item() > 1e-3, "the interleaved slices pop"
    assert found.attrs == {"complete": True, "changed_steps": 1, "step_count": 7}


def test_what_changes_around_the_axis_of_a_slicing(slicings):
    # one step ends on the axis itself, where one slicing stands alone: still one switch
    found = switches(slicings, [camera(-60), camera(60)], step_count=10)
    # View.of tells azimuths in [0, 360)
    around = (found["azimuth_deg"] + 180) % 360 - 180
    # Leaf centres reach from -1.2 to 1.2, so the planes across x stand at -0.8, 0 and 0.8. The eye
    # walks along z = 2 radii; at x = 0.4 it is as far from one of them as from the next.
    slice_order = math.degrees(math.atan(0.4 / (2.0 * RADIUS)))
    expected = [-45.0, -slice_order, 0.0, slice_order, 45.0]
    assert around.tolist() == pytest.approx(expected, abs=1e-4)
    order = "paint order"
    assert found["what"].tolist() == [order, order, "other cards", order, order]
    assert found["flip"][2] < 1e-4 < 1e-3 < found["flip"][0], "its share is next to nothing there"


def test_the_way_along_the_path_counts_cameras(slicings):
    way = [camera(azimuth) for azimuth in (10, 30, 60, 80)]
    found = switches(slicings, way)
    # 45 degrees is half way between the second camera and the third
    assert found["path"].tolist() == pytest.approx([1.5], abs=1e-5)
    assert found.attrs["step_count"] == 21


def levels(**kwargs):
    """Leaf clusters that go from 8 cards to 4 at 5 radii, and from 4 to 2 at 7."""
    return tl.LeafClusters.build(
        CROWN,
        cluster_count=(8, 4, 2),
        resolution=32,
        level_distances=(5.0, 7.0),
        **{"two_sided": False, "morph": False, "fade_share": 0.0} | kwargs,
    )


def test_levels_change_at_their_distances():
    lod = levels()
    found = switches(lod, [camera(20, 3.0), camera(20, 9.0)])
    assert found["distance"].tolist() == pytest.approx([5.0, 7.0], rel=ACROSS)
    assert found["what"].tolist() == ["triangles 16 to 8", "triangles 8 to 4"]
    for row, (distance, level) in zip(found.itertuples(), ((5.0, 0), (7.0, 1)), strict=True):
        # the definition: both levels from one camera
        swap = tl.metrics.popping(
            lod.at(level=level), lod.at(level=level + 1), camera(20, distance), samples=4
        )
        assert row.flip == pytest.approx(swap.flip, abs=2e-4)
        assert row.coverage_bias == pytest.approx(swap.coverage_bias, abs=2e-4)
        assert row.flip > 0.01


def test_both_switches_of_one_step_are_found():
    found = switches(levels(), [camera(20, 3.0), camera(20, 9.0)], step_count=1)
    assert found["distance"].tolist() == pytest.approx([5.0, 7.0], rel=ACROSS)
    assert found.attrs == {"complete": True, "changed_steps": 1, "step_count": 1}


def test_a_fade_hides_a_switch():
    still = switches(levels(), [camera(20, 3.0), camera(20, 9.0)], step_count=40)
    faded = switches(levels(fade_share=0.2), [camera(20, 3.0), camera(20, 9.0)], step_count=40)
    # each fade has a beginning and an end
    assert len(still) == 2
    assert len(faded) == 4
    assert faded["flip"].max() < 1e-4 < still["flip"].min()


def test_the_full_mesh_never_switches():
    found = switches(tl.FullMesh.build(CROWN), [camera(a, d) for a, d in ((0, 3), (90, 9))])
    assert len(found) == 0
    assert list(found.columns) == COLUMNS
    assert found.attrs == {"complete": True, "changed_steps": 0, "step_count": 7}


def test_what_changes_all_the_way_is_bounded_and_spread_over_the_path():
    lod = tl.PointsAndLines.build(CROWN)
    found = switches(lod, [camera(0, 3), camera(0, 30)], step_count=24, max_switches=5)
    assert len(found) == 5
    assert not found.attrs["complete"]
    assert found.attrs["changed_steps"] > 5
    assert found["path"].iloc[0] < 0.2
    assert found["path"].iloc[-1] > 0.8
    # enough room: still all, and more in a step than one
    few = switches(lod, [camera(0, 3), camera(0, 3.5)], step_count=1, max_switches=4)
    assert len(few) == 4
    assert few.attrs["changed_steps"] == 1
    # and in rows: joined tables keep them
    both = pd.concat([found, few], ignore_index=True)
    assert both["changed_steps"].tolist() == [found.attrs["changed_steps"]] * 5 + [1] * 4
    assert not both["complete"].any()
    assert not few.attrs["complete"]


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_every_technique_can_be_walked_past(name):
    small = {"slicings": {"resolution": 32}, "leaf_clusters": {"resolution": 32}}
    lod = REGISTRY[name].build(CROWN, **small.get(name, {}))
    found = switches(lod, [camera(0, 3), camera(70, 20)], max_switches=3)
    assert set(found["label"]) <= {name}
    assert ((found["flip"] >= 0) & (found["flip"] <= 1)).all()
    again = switches(lod, [camera(0, 3), camera(70, 20)], max_switches=3, threads=1)
    assert again.equals(found)


def test_scenes_and_orthographic_cameras():
    lod = levels()
    scene = tl.Scene([(lod, np.eye(4)[np.newaxis])])
    way = [
        tl.Camera.orthographic((0, 0, d * RADIUS), (0, 0, 0), height=3 * RADIUS, size=(48, 48))
        for d in (3, 6)
    ]
    found = tl.switches(scene, way, samples=4, step_count=5)
    assert found["label"].tolist() == ["scene"]
    assert found["what"].tolist() == ["triangles 16 to 8"]
    # without a plant distances are told in radii of the ball around the box, which is larger
    assert found["distance"].item() < 5.0


def test_refuses(slicings):
    two = [camera(0), camera(10)]
    cases = [
        ({"cameras": two[:1]}, ValueError, "at least two"),
        ({"cameras": [two[0], "b"]}, TypeError, "cameras must hold Cameras"),
        ({"cameras": [two[0], camera(10, size=(32, 64))]}, ValueError, "one size"),
        ({"cameras": two, "step_count": 0}, ValueError, "step_count"),
        ({"cameras": two, "max_switches": 0}, ValueError, "max_switches"),
        ({"cameras": two, "samples": 3}, ValueError, "samples"),
        ({"cameras": two, "ppd": -1}, ValueError, "ppd"),
    ]
    for kwargs, error, match in cases:
        with pytest.raises(error, match=match):
            tl.switches(slicings, **kwargs)
