"""Stochastic pruning: its formulas, and what a user can ask for."""

import math

import numpy as np
import pytest

import treelod as tl


@pytest.fixture(scope="module")
def plant(treelod_plant):
    return treelod_plant("chestnut", leaf_count=800, seed=5)


def reference_level(plant, lod, camera):
    """The formulas, one line each."""
    params = lod.params
    leaves = plant.foliage
    width = math.sqrt(leaves.areas.astype(np.float64).sum() / leaves.leaf_count)
    centers = leaves.centers.astype(np.float64)
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2 + np.asarray(plant.origin)
    distance = math.dist(middle, camera.eye)
    pixel = 2 * distance * math.tan(math.radians(camera.fov_y_deg) / 2) / camera.size[1]
    z = params["leaf_width_px"] / (width / pixel)
    u = 1.0 if z <= 1 else z ** (-math.log(2) / math.log(params["half_ratio"]))
    u = max(u, 1 / leaves.leaf_count)
    w = params["shrink"] * min(u, 1 - u)
    in_pixel = (pixel / width) ** 2
    contrast = math.sqrt(max(1, in_pixel * u) / max(1, in_pixel)) if params["contrast"] else 1.0
    return u, w, 1 / (u - w / 2), contrast


def facts(level):
    return level.kept_share, level.window, level.area_scale, level.contrast


@pytest.mark.parametrize(
    "params", [{}, {"half_ratio": 1.5, "shrink": 0.0}, {"leaf_width_px": 9.0, "contrast": False}]
)
def test_levels_are_the_formulas(plant, params):
    lod = tl.StochasticPruning.build(plant, **params)
    shares = []
    for distance in (1.5, 4.0, 10.0, 30.0, 100.0, 1000.0):
        camera = tl.orbit(plant, count=3, elevation_deg=10, distance=distance)[1]
        level = facts(lod.level(camera))
        assert level == pytest.approx(reference_level(plant, lod, camera), rel=1e-5)
        shares.append(level[0])
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 2 * shares[-1], "something is pruned"


def test_the_comparison_notices_what_is_wrong(plant):
    lod = tl.StochasticPruning.build(plant)
    camera = tl.orbit(plant, count=3, elevation_deg=10, distance=30.0)[1]
    lod.params["half_ratio"] = 2.1
    assert facts(lod.level(camera)) != pytest.approx(reference_level(plant, lod, camera), rel=1e-3)


def test_as_many_triangles_are_drawn_as_leaves_are_left(plant):
    lod = tl.StochasticPruning.build(plant, wood=False, shrink=0.5)
    camera = tl.orbit(plant, count=3, elevation_deg=10, distance=5.0)[1]
    full = tl.render(tl.FullMesh.build(plant, wood=False), camera)
    near = tl.render(lod.at(kept_share=1.0), camera)
    assert (near.color == full.color).all()
    for share in (0.5, 0.1):
        stats = tl.render(lod.at(kept_share=share), camera).stats
        assert stats.triangles == math.ceil(share * 800) * 10


def test_coverage_hardly_changes(plant):
    lod = tl.StochasticPruning.build(plant, wood=False)
    camera = tl.orbit(plant, count=3, elevation_deg=10, distance=10.0)[1]
    covered = [
        float(tl.render(lod.at(kept_share=share), camera, samples=16).color[..., 3].sum())
        for share in (1.0, 0.5, 0.25)
    ]
    # larger leaves overlap as smaller ones do, but for chance
    assert covered[1:] == pytest.approx([covered[0]] * 2, rel=0.05)


@pytest.mark.parametrize(
    ("params", "error", "message"),
    [
        ({"leaf_width_px": 0.0}, ValueError, "leaf_width_px must be in"),
        ({"half_ratio": 1.0}, ValueError, "half_ratio must be in"),
        ({"half_ratio": math.nan}, ValueError, "half_ratio must be in"),
        ({"shrink": 1.5}, ValueError, "shrink must be in"),
        ({"contrast": "yes"}, TypeError, "contrast must be True or False"),
        ({"seed": -1}, ValueError, "seed must be at least 0"),
        ({"wood_triangle_count": 0}, ValueError, "wood_triangle_count must be at least 1"),
    ],
)
def test_what_is_wrong_is_named(plant, params, error, message):
    with pytest.raises(error, match=message):
        tl.StochasticPruning.build(plant, **params)
    with pytest.raises(ValueError, match="kept_share must be in"):
        tl.StochasticPruning.build(plant).at(kept_share=0.0)


def test_large_leaves_stay_inside_the_bounds(treelod_plant):
    plant = treelod_plant("chestnut", leaf_count=2000)
    for share in (1e-9, 1e-3, 0.1, 1.0):
        lod = tl.StochasticPruning.build(plant, wood=False).at(kept_share=share)
        low, high = tl.Scene([(lod, None)]).bounds
        middle, size = (low + high) / 2, np.linalg.norm(high - low) * 2
        camera = tl.Camera.orthographic(
            tuple(middle + np.array([0, 0, size])), tuple(middle), height=size, size=(200, 200)
        )
        frame = tl.render(lod, camera, outputs=("color",))
        rows, columns = np.nonzero(frame.color[..., 3])
        left, top, right, bottom = frame.bounds_px
        assert left <= columns.min() <= columns.max() < right
        assert top <= rows.min() <= rows.max() < bottom
