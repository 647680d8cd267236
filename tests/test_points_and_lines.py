"""Points and lines: the formulas in Python, and what a user can ask for."""

import math
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import treelod as tl
from treelod import _core

MODELS = os.environ.get("TREELOD_MODELS", "")
needs_models = pytest.mark.skipif(not MODELS, reason="TREELOD_MODELS names no folder of plants")


@pytest.fixture(scope="module")
def chestnut(treelod_plant):
    return treelod_plant("chestnut", leaf_count=600, seed=3)


@pytest.fixture(scope="module")
def pine(treelod_plant):
    return treelod_plant("pine", leaf_count=3000, seed=3)


def sample_spacing(lod, camera):
    """Give d': the wanted distance between samples at distance 1, or anywhere in parallel views."""
    rows = camera.size[1]
    if camera.fov_y_deg is None:
        return lod.params["sample_distance_px"] * camera.height / rows
    return (
        lod.params["sample_distance_px"] * 2 * math.tan(math.radians(camera.fov_y_deg) / 2) / rows
    )


def reference_points(p, k, sampling):
    """Triangles and points drawn of a group of points, as the paper's figure 6 has them."""
    if p <= 2 * k:
        return 0, p
    if p >= 3 * k or sampling == "area":
        return k, 0
    t = p - 2 * k
    return t, 2 * k - 2 * t


def check_selection(lod, camera):
    """Compare every group of a view with the formulas; return the kinds of levels met."""
    spacing = sample_spacing(lod, camera)
    seen = set()
    for chosen in lod.selection(camera):
        group = lod.groups[chosen.group]
        part = lod.parts[group.part]
        d = spacing / part.importance
        parallel = camera.fov_y_deg is None
        r = 1.0 if parallel else math.dist(camera.eye, group.center)
        assert chosen.distance == pytest.approx(r, rel=1e-9)
        p = group.seen_area / r**2 / d**2
        assert chosen.needed == pytest.approx(p, rel=1e-9)
        width = lod.params["sample_distance_px"] / part.importance
        assert chosen.line_width_px == pytest.approx(width)
        if group.drawn_as == "points":
            k = group.opaque_triangle_count
            # rounded up or down, as the group's own offset has it
            allowed = [reference_points(n, k, group.sampling) for n in (int(p), int(p) + 1)]
            assert (min(chosen.triangles, k), chosen.points) in allowed
            expected = 3 * min(chosen.triangles, k) + chosen.points
            if group.sampling == "stratified" and chosen.triangles < k:
                assert expected in (int(p), int(p) + 1), "vertices drawn = p"
            factor = lod.params["splat_factor"]
            assert chosen.point_size_px == pytest.approx(width * math.sqrt(factor))
            seen.add("points" if chosen.triangles == 0 else "blend" if chosen.points else "mesh")
        if group.drawn_as == "lines":
            length = group.line_length * lod.params["orientation_factor"] / r
            q = group.seen_area / r**2 / (d * length)
            assert chosen.line_share == pytest.approx(q, rel=1e-9)
            t = max(q, group.deviation / (r * d))
            if t >= 1.5:
                assert (chosen.triangles, chosen.lines) == (group.triangle_count, 0)
                seen.add("line mesh")
            elif t <= 1.0:
                assert chosen.triangles == 0
                assert abs(chosen.lines - min(q, 1) * group.line_count) < 1
                seen.add("lines")
            else:
                leaves = (2 * t - 2) * group.line_count
                assert abs(chosen.lines - min(q, 1) * (group.line_count - leaves)) < 2
                seen.add("line blend")
    return seen


@pytest.mark.parametrize("plant_name", ["chestnut", "pine"])
def test_selection_is_the_formulas(plant_name, request):
    plant = request.getfixturevalue(plant_name)
    seen = set()
    for params in (
        {},
        {"sampling": "area", "importance": {"foliage": 2.0}},
        {"sample_distance_px": 2.5, "octree_depth": 0},
        {"splat_factor": 1.7, "sampling": "stratified", "cell_triangle_count": 300},
    ):
        lod = tl.PointsAndLines.build(plant, **{"splat_factor": 1.3, **params})
        for distance in (1.5, 3.0, 5.0, 8.0, 13.0, 40.0, 200.0):
            camera = tl.orbit(plant, count=5, elevation_deg=20, distance=distance)[2]
            seen |= check_selection(lod, camera)
        center = np.mean(plant.bounds, axis=0)
        for height in (10.0, 100.0, 1000.0):
            eye = tuple(center + np.array([0.0, 0.0, 50.0]))
            camera = tl.Camera.orthographic(eye, tuple(center), height=height, size=(80, 60))
            seen |= check_selection(lod, camera)
    wanted = {"chestnut": {"points", "blend", "mesh", "lines", "line mesh"}, "pine": {"lines"}}
    assert wanted[plant_name] <= seen, "every kind of level was compared"


def test_the_comparison_notices_what_is_wrong(chestnut):
    lod = tl.PointsAndLines.build(chestnut, splat_factor=1.3)
    camera = tl.orbit(chestnut, count=5, elevation_deg=20, distance=8.0)[2]
    check_selection(lod, camera)
    lod.params["sample_distance_px"] = 1.01
    with pytest.raises(AssertionError):
        check_selection(lod, camera)


def test_areas_and_counts_are_the_plant_s(chestnut):
    lod = tl.PointsAndLines.build(chestnut, wood=False, splat_factor=1.3)
    leaves = chestnut.foliage
    corners = leaves.mesh.positions[leaves.mesh.triangles].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1).sum() / 2
    assert sum(group.seen_area for group in lod.groups) == pytest.approx(area / 2, rel=1e-5)
    assert lod.parts[0].area == pytest.approx(area, rel=1e-5)
    assert lod.parts[0].piece_count == leaves.leaf_count
    assert lod.footprint.triangles == len(leaves.mesh.triangles)
    assert lod.footprint.points == 2 * lod.footprint.triangles
    assert lod.footprint.geometry_bytes == lod.sample_bytes + lod.triangle_bytes
    full = tl.FullMesh.build(chestnut, wood=False)
    assert lod.triangle_bytes == full.footprint.geometry_bytes


def test_what_is_drawn_is_what_was_selected(chestnut):
    lod = tl.PointsAndLines.build(chestnut, splat_factor=1.3)
    camera = tl.orbit(chestnut, count=5, elevation_deg=20, distance=10.0)[2]
    chosen = lod.selection(camera)
    stats = tl.render(lod, camera).stats
    assert stats.points == sum(c.points for c in chosen) > 100
    assert stats.triangles == sum(c.triangles for c in chosen)
    assert stats.lines == sum(c.lines for c in chosen)


def test_successive_levels_are_nested(chestnut):
    # at a fixed view each level shows points of the one before, and no others
    lod = tl.PointsAndLines.build(chestnut, wood=False, octree_depth=0, splat_factor=1.0)
    camera = tl.orbit(chestnut, count=5, elevation_deg=20, distance=30.0, size=(200, 200))[2]
    before = None
    for spacing in (1.0, 1.1, 1.3, 2.0):
        thinner = lod.drawn(sample_distance_px=spacing, splat_factor=1.0 / spacing**2)
        (chosen,) = thinner.selection(camera)
        assert chosen.triangles == 0
        assert chosen.point_size_px == pytest.approx(1.0)
        shown = tl.render(thinner, camera, samples=4).color[..., 3] > 0
        if before is not None:
            assert not (shown & ~before).any(), "a point that the level before did not have"
            assert shown.sum() < before.sum()
        before = shown
    again = tl.render(lod, camera, samples=4).color
    assert (again == tl.render(lod, camera, samples=4).color).all(), "nothing flickers"


def test_splats_cover_as_random_ones_do(chestnut):
    # independent splats of total area sL on a silhouette cover 1 - exp(-sL) of it
    lod = tl.PointsAndLines.build(chestnut, wood=False, octree_depth=0, splat_factor=1.0)
    ball = np.mean(chestnut.bounds, axis=0)
    camera = tl.Camera.orthographic(
        tuple(ball + np.array([0.0, 0.0, 50.0])), tuple(ball), height=60.0, size=(240, 240)
    )
    for factor in (0.5, 1.0, 2.0):
        coverage = float(
            tl.render(lod.drawn(splat_factor=factor), camera, samples=16).color[..., 3].sum()
        )
        (chosen,) = lod.selection(camera)
        total = chosen.points * factor
        # the law holds where splats are spread evenly; in clumps they cover less, but no less than
        # if all of them stood on an eighth of the box
        low, high = chestnut.bounds
        box = (high[0] - low[0]) * (high[1] - low[1]) * (240.0 / 60.0) ** 2
        assert coverage < box * (1 - math.exp(-total / box)) * 1.02
        assert coverage > box / 8 * (1 - math.exp(-total / (box / 8)))


def test_splats_that_reach_into_the_picture_are_drawn(chestnut):
    lod = tl.PointsAndLines.build(
        chestnut, wood=False, octree_depth=0, splat_factor=256.0, sample_distance_px=4.0
    )
    low, high = chestnut.bounds
    middle, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
    for beyond, is_seen in ((0.99, True), (1.3, True), (6.0, False)):
        # half of the picture is 100 m, a splat 26 m
        eye = middle + np.array([100 + radius * beyond, 0, 50])
        target = eye - np.array([0, 0, 50])
        camera = tl.Camera.orthographic(tuple(eye), tuple(target), height=200, size=(500, 500))
        covered = tl.render(lod, camera).color[..., 3].sum()
        assert (covered > 0) == is_seen, beyond


def test_importance_without_a_name_is_refused(chestnut):
    for importance in ({"": 5.0}, {"": float("nan")}, {"no such": 2.0}):
        with pytest.raises(ValueError, match="importance"):
            tl.PointsAndLines.build(chestnut, importance=importance)
    given = {"foliage": 2.0}
    lod = tl.PointsAndLines.build(chestnut, importance=given)
    given["foliage"] = 9.0
    assert lod.params["importance"] == {"foliage": 2.0}


def test_wrong_types_are_named(chestnut):
    for name, value in (("sampling", None), ("pair_order", 1), ("antialias", 3)):
        with pytest.raises(TypeError, match=rf"^{name} must be a str"):
            tl.PointsAndLines.build(chestnut, **{name: value})
    with pytest.raises(TypeError, match=r"^classes must be a str"):
        tl.PointsAndLines.build(chestnut, classes={"wood": None})


def test_factors_are_those_in_use(chestnut):
    lod = tl.PointsAndLines.build(chestnut, splat_factor="coverage")
    assert len(lod.splat_factors) > 0
    assert len(lod.drawn(splat_factor=1.0).splat_factors) == 0


def test_parts_can_be_named(chestnut):
    lod = tl.PointsAndLines.build(
        chestnut, classes={"foliage": "lines", "wood": "mesh"}, importance={"foliage:leaves": 3}
    )
    facts = {part.name: (part.drawn_as, part.importance) for part in lod.parts}
    assert facts["foliage:leaves"] == ("lines", 3.0)
    assert facts["wood:wood"][0] == "mesh"
    assert lod.footprint.points == 0
    assert lod.footprint.lines == chestnut.foliage.leaf_count
    even = tl.PointsAndLines.build(chestnut, importance=1.0)
    assert {part.importance for part in even.parts} == {1.0}


@pytest.mark.parametrize(
    ("params", "error", "message"),
    [
        ({"splat_factor": 0.0}, ValueError, "splat_factor must be in"),
        ({"splat_factor": "best"}, ValueError, 'splat_factor must be "coverage"'),
        ({"splat_factor": math.nan}, ValueError, "splat_factor must be in"),
        ({"sample_distance_px": -1.0}, ValueError, "sample_distance_px must be in"),
        ({"sample_distance_px": "1"}, TypeError, "sample_distance_px must be a number"),
        ({"sampling": "random"}, ValueError, "sampling must be"),
        ({"pair_order": "both"}, ValueError, "pair_order must be"),
        ({"antialias": "yes"}, ValueError, "antialias must be"),
        ({"classes": {"stem": "lines"}}, ValueError, "classes: no part is called"),
        ({"classes": {"wood": "planks"}}, ValueError, "classes must be"),
        ({"classes": "lines"}, TypeError, "classes must map"),
        ({"importance": {"leaf": 2.0}}, ValueError, "importance: no part is called"),
        ({"importance": 0.5}, ValueError, "importance must be in"),
        ({"importance": "high"}, ValueError, 'importance must be "auto"'),
        ({"orientation_factor": 2.0}, ValueError, "orientation_factor must be in"),
        ({"octree_depth": 9}, ValueError, "octree_depth must be in"),
        ({"octree_depth": 1.5}, TypeError, "octree_depth must be a whole number"),
        ({"cell_triangle_count": 0}, ValueError, "cell_triangle_count must be at least 1"),
        ({"seed": -1}, ValueError, "seed must be at least 0"),
        ({"threads": 0}, ValueError, "threads must be"),
    ],
)
def test_what_is_wrong_is_named(chestnut, params, error, message):
    with pytest.raises(error, match=message):
        tl.PointsAndLines.build(chestnut, **params)


def test_drawn_keeps_what_is_not_given(chestnut):
    lod = tl.PointsAndLines.build(chestnut, splat_factor=1.5, sample_distance_px=2.0)
    other = lod.drawn(antialias="coverage")
    assert (other.params["splat_factor"], other.params["sample_distance_px"]) == (1.5, 2.0)
    assert other.params["antialias"] == "coverage"
    assert len(lod.splat_factors) == 0
    fitted = lod.drawn(splat_factor="coverage")
    assert len(fitted.splat_factors) > 2
    with pytest.raises(ValueError, match="sample_distance_px must be in"):
        lod.drawn(sample_distance_px=0.0)


@needs_models
@pytest.mark.parametrize(
    "path", ["ez_oak_large/ez_oak_large.glb", "quaternius_common/CommonTree_1.gltf"]
)
def test_what_a_texture_leaves_out_is_no_leaf(path):
    """The opaque area of the leaves, against the texels under random points of it."""
    plant = tl.load_plant(Path(MODELS) / path)
    lod = tl.PointsAndLines.build(plant, wood=False)
    mesh = plant.foliage.mesh
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(cross, axis=1) / 2
    rng = np.random.default_rng(20240611)
    opaque = 0.0
    for material_id in np.unique(mesh.material_ids):
        material = plant.materials[material_id]
        own = mesh.material_ids == material_id
        if material.texture is None or material.alpha_mode == "opaque":
            opaque += areas[own].sum()
            continue
        u, v = rng.random((2, own.sum(), 200))
        u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
        at = mesh.uvs[mesh.triangles[own]].astype(np.float64)
        weights = np.stack([1 - u - v, u, v], axis=-1)
        uv = np.einsum("tcx,tnc->tnx", at, weights)
        height, width = material.texture.shape[:2]
        x = (np.floor(uv[..., 0] * width).astype(int)) % width
        y = (np.floor(uv[..., 1] * height).astype(int)) % height
        is_there = material.texture[y, x, 3] / 255.0 >= material.alpha_cutoff
        opaque += (areas[own] * is_there.mean(axis=1)).sum()
    assert lod.parts[0].area == pytest.approx(opaque, rel=0.01)
    assert opaque < 0.95 * areas.sum(), "something is left out"


def test_a_million_splats_on_one_pixel():
    positions = np.zeros((1_000_000, 3), np.float32)
    positions[0, 2] = 1e-3  # the nearest
    colors = np.tile(np.float32([0.2, 0.4, 0.6]), (1_000_000, 1))
    colors[0] = [0.9, 0.1, 0.1]
    for size_px, pixel_count in ((1.0, 1), (3.0, 9)):
        cloud = _core.cloud(positions, colors, lines=False, size_px=size_px)
        scene = tl.Scene([(SimpleNamespace(_core=cloud), None)])
        # the middle of an odd picture is the middle of a pixel
        camera = tl.Camera.orthographic((0, 0, 5), (0, 0, 0), height=9, size=(9, 9))
        for threads in (1, 3):
            color = tl.render(scene, camera, samples=1, threads=threads).color
            assert color[..., 3].sum() == pixel_count
            np.testing.assert_array_equal(color[4, 4], np.float32([0.9, 0.1, 0.1, 1.0]))
