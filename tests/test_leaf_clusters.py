"""Leaf clusters through the public face: what is built, what each option changes, what is drawn."""

import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, quads, random_crown
from treelod.color import linear_from_srgb

SIZE = (48, 36)


def build(plant, **params):
    return tl.LeafClusters.build(plant, **{"cluster_count": 6, "resolution": 32, **params})


def picture(lod, camera, samples=4, **kwargs):
    return tl.render(lod, camera, samples=samples, outputs=("color",), **kwargs).color


def texel_bytes(lod):
    return b"".join(level.tobytes() for texture in lod.textures for level in texture.levels)


@pytest.fixture(scope="module")
def plant():
    return random_crown(150, trunk=True)


@pytest.fixture(scope="module")
def lod(plant):
    return build(plant)


@pytest.fixture(scope="module")
def camera(plant):
    return tl.orbit(plant, count=5, size=SIZE)[1]


def two_planes():
    """Two squares side by side in the plane z = 0 and two in z = 3, off the origin by 1 m."""
    leaves = [facing(x, 1, z, 0.5) for z in (0, 3) for x in (-1, 1)]
    return crown(leaves, [(1, 0.5, 0.25, 1)] * 4)


# What is built


def test_facts_of_a_build():
    seen = []
    lod = tl.LeafClusters.build(
        two_planes(),
        cluster_count=2,
        resolution=16,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert lod.params == {
        "cluster_count": 2,
        "alpha_rel": 0.01,
        "alpha": None,
        "init": "plus_plus",
        "seed": 0,
        "restarts": 1,
        "max_iterations": 100,
        "eigen": "exact",
        "flatten": "project",
        "two_sided": True,
        "resolution": (16, 16),
        "texels_per_metre": None,
        "samples": 16,
        "format": "rgba8",
        "texturing": "direct",
        "layers": 2,
        "rotation_count": 64,
        "leaf_resolution": 64,
        "texels_per_leaf": 4,
        "drawing": "test",
        "outline": None,
        "level_error_px": 1.0,
        "level_distances": None,
        "morph": True,
        "fade_share": 0.1,
        "views": None,
        "wood": True,
        "wood_triangle_count": None,
    }
    assert seen[-1] == (4, 4), "two sides of two cards"
    assert lod.build_secs > 0
    assert (lod.level_count, lod.converged) == (1, True)
    assert lod.level_errors == [0.0]
    assert lod.kmeans_errors[-1] == 0.0
    # R reaches from the middle (0, 1, 1.5) to a corner
    assert lod.alpha == pytest.approx(0.01 * (1.5**2 + 0.5**2 + 1.5**2), rel=1e-12)
    assert lod.cluster_ids.dtype == np.uint32
    assert sorted(lod.cluster_ids.tolist()) == [0, 0, 1, 1]
    assert lod.planes.shape == (2, 4)
    assert (lod.planes[:, 3] >= 0).all()
    depths = -lod.planes[lod.cluster_ids, 3] * lod.planes[lod.cluster_ids, 2]
    np.testing.assert_allclose(depths, [0, 0, 3, 3], atol=1e-6)
    assert lod.parents_at(0).shape == (0,)


def test_a_footprint_by_hand():
    lod = tl.LeafClusters.build(two_planes(), cluster_count=2, resolution=16)
    (texture,) = lod.textures
    assert texture.name == "level 0, 2 cards"
    # four pictures of 16 x 16, a texel between any two and around all
    assert [level.shape for level in texture.levels] == [(35, 35, 4)]
    assert lod.atlas_fills == [pytest.approx(4 * 16**2 / 35**2)]
    footprint = lod.footprint
    assert (footprint.triangles, footprint.cards, footprint.lines, footprint.points) == (0, 2, 0, 0)
    assert footprint.texture_bytes == 4 * 35**2
    # a side has 4 corners of 18 floats and 2 triangles; four sides
    assert footprint.geometry_bytes == 4 * (4 * 18 * 4 + 2 * 3 * 4)


def test_sides_of_cards_by_hand():
    lod = tl.LeafClusters.build(two_planes(), cluster_count=2, resolution=(24, 8))
    sides = lod.card_sides_at(0)
    assert [(side.cluster, side.is_back) for side in sides] == [
        (k, b) for k in (0, 1) for b in (0, 1)
    ]
    for side in sides:
        assert side.texels.shape == (8, 24, 4)
        assert side.texels.dtype == np.uint8
        # leaf, gap, leaf: a third each, and the same from behind
        assert (side.texels[:, :8, 3] == 255).all()
        assert (side.texels[:, 8:16, 3] == 0).all()
        assert (side.texels[:, 16:, 3] == 255).all()
        right, up = side.corners[1] - side.corners[0], side.corners[3] - side.corners[0]
        np.testing.assert_allclose([np.abs(right), up], [(3, 0, 0), (0, 1, 0)], atol=1e-6)
        np.testing.assert_allclose(sorted(side.outline.tolist()), sorted(side.corners.tolist()))
    for front, back in zip(sides[::2], sides[1::2], strict=True):
        np.testing.assert_allclose(front.corners[[1, 0, 3, 2]], back.corners)
    depths = sorted(float(side.corners[:, 2].mean()) for side in sides)
    np.testing.assert_allclose(depths, [0, 0, 3, 3], atol=1e-6)


def test_levels_are_nested(plant):
    lod = build(plant, cluster_count=(16, 8, 3), resolution=16)
    assert lod.params["cluster_count"] == (16, 8, 3)
    assert lod.level_count == 3
    assert [len(lod.planes_at(level)) for level in range(3)] == [16, 8, 3]
    assert [texture.name for texture in lod.textures] == [
        f"level {level}, {count} cards" for level, count in enumerate((16, 8, 3))
    ]
    assert lod.level_errors == sorted(lod.level_errors)
    assert lod.footprint.cards == 27
    for level in range(2):
        parents = lod.parents_at(level)
        np.testing.assert_array_equal(
            parents[lod.cluster_ids_at(level)], lod.cluster_ids_at(level + 1)
        )
        assert set(parents.tolist()) == set(range(len(lod.planes_at(level + 1))))
    assert len(lod.card_sides_at(2)) == 6
    np.testing.assert_array_equal(lod.cluster_ids_at(0), build(plant, cluster_count=16).cluster_ids)


def test_fewer_planes_than_asked_for():
    plant = two_planes()
    assert len(tl.LeafClusters.build(plant, cluster_count=100, resolution=8).planes) <= 4
    one = tl.LeafClusters.build(crown([facing(0, 0, 0, 1)]), cluster_count=(4, 2), resolution=8)
    assert (one.level_count, len(one.planes)) == (1, 1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"level": 3}, "level must be in"),
        ({"level": -1}, "level must be at least 0"),
        ({"level": 0, "t": -0.1}, "t must be in"),
        ({"level": 0, "t": 1.1}, "t must be in"),
        ({"level": 0, "t": np.nan}, "t must be in"),
        ({"level": 2, "t": 0.1}, "t must be in"),
    ],
)
def test_levels_out_of_range(plant, arguments, message):
    lod = build(plant, cluster_count=(8, 4, 2), resolution=8)
    with pytest.raises(ValueError, match=message):
        lod.at(**arguments)
    for name in ("cluster_ids_at", "planes_at", "parents_at", "card_sides_at"):
        with pytest.raises(IndexError, match="level 3 of 3"):
            getattr(lod, name)(3)
        with pytest.raises(ValueError, match="level"):
            getattr(lod, name)(-1)


def test_a_held_level_shares_everything(plant, camera):
    lod = build(plant, cluster_count=(8, 4), level_distances=4)
    held = lod.at(level=1)
    assert (held.params["level"], held.params["t"]) == (1, 0.0)
    assert {key: held.params[key] for key in lod.params} == lod.params
    assert held.footprint == lod.footprint
    fewer = tl.render(held, camera).stats.triangles
    assert fewer == 4 + 2 * 4
    assert tl.render(lod.at(level=0), camera).stats.triangles == 4 + 2 * 8
    with pytest.raises(TypeError):
        lod.at(level=0.5)


# What each option changes


@pytest.mark.parametrize("init", ["plus_plus", "random"])
def test_a_seed_decides_every_choice(plant, init):
    one, same, other = (
        build(plant, init=init, seed=seed, max_iterations=3, resolution=8) for seed in (1, 1, 2)
    )
    assert one.params["init"] == init
    np.testing.assert_array_equal(one.cluster_ids, same.cluster_ids)
    assert texel_bytes(one) == texel_bytes(same)
    assert (one.cluster_ids != other.cluster_ids).any()


@pytest.mark.parametrize("dtype", [np.int64, np.uint8, ">i4"])
def test_clusters_start_from_given_ids(plant, dtype):
    ids = np.arange(plant.foliage.leaf_count)[::-1] % 6
    lod = build(plant, init=ids.astype(dtype), max_iterations=1)
    assert lod.params["init"] == "ids"
    assert len(lod.planes) == 6
    # a plane for each: an iteration later most leaves have moved to another
    again = build(plant, init=lod.cluster_ids, max_iterations=100)
    further = build(plant, init=ids, max_iterations=100)
    assert again.kmeans_errors[-1] == pytest.approx(further.kmeans_errors[-1], rel=1e-9)
    assert build(plant, init=ids.tolist(), max_iterations=1).planes.tolist() == lod.planes.tolist()


def test_clusters_start_from_given_planes():
    plant = two_planes()
    planes = np.array([[0, 0, 1, -2.9], [0, 0, 1, -0.1]])
    for order in (planes, planes[::-1], planes.astype(np.float32), np.asfortranarray(planes)):
        lod = tl.LeafClusters.build(plant, cluster_count=2, init=order, resolution=8)
        assert lod.params["init"] == "planes"
        near = np.abs(np.asarray(order, float)[:, 3]) < 1
        assert (near[lod.cluster_ids] == [True, True, False, False]).all()
        np.testing.assert_allclose(np.abs(lod.planes[near]), [[0, 0, 1, 0]], atol=1e-6)
        np.testing.assert_allclose(np.abs(lod.planes[~near]), [[0, 0, 1, 3]], atol=1e-6)


def test_given_planes_are_in_the_world():
    leaves = [facing(x, 1, z, 0.5) for z in (0, 3) for x in (-1, 1)]
    plant = crown(leaves, origin=(0.0, 0.0, 100.0))
    planes = [[0, 0, 1, -100.2], [0, 0, 1, -102.8]]
    lod = tl.LeafClusters.build(plant, cluster_count=2, init=planes, resolution=8)
    np.testing.assert_allclose(np.abs(lod.planes[:, 3]), [100, 103], atol=1e-5)
    assert {side.corners[0, 2].round(3) for side in lod.card_sides_at(0)} == {100.0, 103.0}


def test_alpha_weighs_the_angle(plant):
    flat, steep = (build(plant, alpha=alpha, resolution=8) for alpha in (0.0, 1e3))
    assert (flat.alpha, steep.alpha) == (0.0, 1e3)
    relative = [build(plant, alpha_rel=share, resolution=8).alpha for share in (0.1, 0.2)]
    assert relative[1] == pytest.approx(2 * relative[0])
    # with the angle alone planes are far from leaves, and leaves lie in them
    assert flat.level_errors[0] < 0.8 * steep.level_errors[0]

    def lean(lod):
        normals = lod.planes[lod.cluster_ids, :3]
        return np.abs((plant.foliage.normals * normals).sum(axis=1)).mean()

    assert lean(steep) > 1.3 * lean(flat)


def test_restarts_take_the_best_of_several(plant):
    params = {"init": "random", "resolution": 8, "seed": 5}
    one, many = (build(plant, restarts=count, **params) for count in (1, 12))
    assert many.kmeans_errors[-1] < one.kmeans_errors[-1]


def test_iterations_are_limited(plant):
    short, long = (build(plant, max_iterations=count, resolution=8) for count in (1, 100))
    assert len(short.kmeans_errors) <= 2
    assert not short.converged
    assert long.converged
    assert long.kmeans_errors[-1] < short.kmeans_errors[-1]
    assert long.kmeans_errors == sorted(long.kmeans_errors, reverse=True)


def test_the_papers_iteration_finds_worse_planes(plant):
    exact, paper = (
        build(plant, eigen=eigen, alpha=10.0, max_iterations=1, resolution=8, seed=2)
        for eigen in ("exact", "paper")
    )
    assert exact.kmeans_errors[-1] < paper.kmeans_errors[-1]


def test_leaves_that_are_turned_keep_their_area():
    # two leaves that lean by 60 degrees to either side of the plane between them
    across = (0, 0.25, 0.25 * 3**0.5)
    leaves = [((0, 0, 0), (1, 0, 0), across), ((0, 3, 0), (1, 0, 0), (*across[:2], -across[2]))]
    plant = crown(leaves)
    kwargs = {"cluster_count": 1, "alpha": 0.01}

    def area(flatten):
        lod = tl.LeafClusters.build(plant, flatten=flatten, resolution=128, **kwargs)
        side = lod.card_sides_at(0)[0]
        sides = np.linalg.norm(side.corners[[1, 3]] - side.corners[0], axis=1)
        return side.texels[..., 3].mean() / 255 * sides.prod()

    # 2 x 1 m each; half a texel of blur around
    assert area("rotate") == pytest.approx(4.0, rel=0.01)
    assert area("project") == pytest.approx(4.0 * 0.5, rel=0.01)


def test_one_picture_serves_both_sides(plant, camera):
    two, one = (build(plant, two_sided=sides, resolution=64) for sides in (True, False))
    assert len(two.card_sides_at(0)) == 2 * len(one.card_sides_at(0)) == 12
    assert not any(side.is_back for side in one.card_sides_at(0))
    assert one.footprint.texture_bytes < 0.6 * two.footprint.texture_bytes
    # what is seen from above has the same picture
    for own, side in zip(one.card_sides_at(0), two.card_sides_at(0)[::2], strict=True):
        np.testing.assert_array_equal(own.texels, side.texels)
    assert (picture(one, camera) != picture(two, camera)).any()
    assert picture(one, camera)[..., 3].mean() == pytest.approx(
        picture(two, camera)[..., 3].mean(), rel=0.05
    )


def test_texels_by_number_or_by_size(plant):
    for side in build(plant, resolution=(20, 10)).card_sides_at(0):
        assert side.texels.shape == (10, 20, 4)
    dense = build(plant, texels_per_metre=7.5)
    for side in dense.card_sides_at(0):
        metres = np.linalg.norm(side.corners[[3, 1]] - side.corners[0], axis=1)
        assert side.texels.shape[:2] == tuple(np.ceil(7.5 * metres).astype(int))
    assert dense.params["texels_per_metre"] == 7.5


def test_samples_are_steps_of_alpha(plant):
    for samples, most in ((1, 2), (16, 17)):
        lod = build(plant, samples=samples)
        codes = {code for s in lod.card_sides_at(0) for code in np.unique(s.texels[..., 3])}
        assert 2 <= len(codes) <= most
        assert {0, 255} <= codes


def test_half_the_bytes_with_one_bit_of_alpha(plant):
    long, short = (build(plant, format=name) for name in ("rgba8", "rgb5a1"))
    assert short.footprint.texture_bytes * 2 == long.footprint.texture_bytes
    for texture in short.textures:
        for level in texture.levels:
            assert set(np.unique(level[..., 3])) <= {0, 255}
            assert len(np.unique(level[..., :3])) <= 32


INDIRECT = {"layers": 4, "rotation_count": 16, "leaf_resolution": 16, "texels_per_leaf": 2}


def test_indirect_texturing_names_leaves(plant, camera):
    direct = build(plant, resolution=64, alpha_rel=0.1)
    base = build(plant, alpha_rel=0.1, texturing="indirect", **{**INDIRECT, "texels_per_leaf": 4})
    assert [texture.name for texture in base.textures] == ["leaf at every angle"]
    assert all(side.texels is None for side in base.card_sides_at(0))
    # leaves of one kind: as much is covered, though other leaves are left out where many lie
    alphas = [picture(lod, camera)[..., 3].mean() for lod in (direct, base)]
    assert alphas[1] == pytest.approx(alphas[0], rel=0.15)
    for ignored in ({"resolution": 8}, {"texels_per_metre": 3.0}, {"format": "rgb5a1"}):
        texels = {**INDIRECT, "texels_per_leaf": 4}
        again = build(plant, alpha_rel=0.1, texturing="indirect", **texels, **ignored)
        assert (picture(again, camera) == picture(base, camera)).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [("layers", 1), ("rotation_count", 4), ("leaf_resolution", 8), ("texels_per_leaf", 8)],
)
def test_options_of_indirect_texturing(plant, camera, name, value):
    base, other = (
        build(plant, texturing="indirect", **params)
        for params in (INDIRECT, {**INDIRECT, name: value})
    )
    assert other.params[name] == value
    smaller = name != "texels_per_leaf"
    assert (other.footprint.texture_bytes < base.footprint.texture_bytes) == smaller
    assert (picture(other, camera) != picture(base, camera)).any()
    if name in ("rotation_count", "leaf_resolution"):
        # all versions side by side in one texture, with borders
        side = other.textures[0].levels[0].shape[0] * other.textures[0].levels[0].shape[1]
        assert other.params["rotation_count"] * other.params["leaf_resolution"] ** 2 < side


def test_ways_of_drawing(plant):
    test, coverage, blend = (build(plant, drawing=d) for d in ("test", "coverage", "blend"))
    bare = [build(plant, drawing=d, wood=False) for d in ("test", "coverage", "blend")]
    camera = tl.orbit(plant, count=5, size=(96, 72))[1]
    frames = [tl.render(lod, camera, samples=1) for lod in bare]
    alphas = [frame.color[..., 3] for frame in frames]
    # there or not on each sample; blended, every share of it
    assert [set(np.unique(alpha)) <= {0.0, 1.0} for alpha in alphas] == [True, True, False]
    assert len(np.unique(alphas[2])) > 100
    covered = [picture(lod, camera, 16)[..., 3].mean() for lod in bare]
    assert covered[1] == pytest.approx(covered[2], rel=0.02), "masks hold as many samples as alpha"
    for frame in frames[:2]:
        np.testing.assert_array_equal(np.isfinite(frame.depth), frame.color[..., 3] > 0)
    assert len({texel_bytes(lod) for lod in (test, coverage, blend)}) == 2, "mips keep other things"


def test_cards_are_cut_to_an_outline(plant, camera):
    whole, cut = (build(plant, outline=corners, resolution=64) for corners in (None, 8))
    assert {len(side.outline) for side in whole.card_sides_at(0)} == {4}
    counts = [len(side.outline) for side in cut.card_sides_at(0)]
    assert max(counts) <= 8
    assert max(counts) > 4
    # more pixels, so that the edges between a card's triangles count for little
    larger = tl.orbit(plant, count=5, size=(320, 240))[1]
    fragments = [tl.render(lod, larger, samples=16).stats.fragments for lod in (whole, cut)]
    assert fragments[1] < 0.95 * fragments[0]
    # nothing that is opaque lies outside: edges are drawn in steps of 1/256 pixel
    pictures = [picture(lod, camera, 16) for lod in (whole, cut)]
    assert np.abs(pictures[0] - pictures[1]).max(axis=2).mean() < 1e-3
    for side in cut.card_sides_at(0):
        places = (side.outline - side.corners[0]) @ (side.corners[[1, 3]] - side.corners[0]).T
        lengths = ((side.corners[[1, 3]] - side.corners[0]) ** 2).sum(axis=1)
        assert ((places / lengths > -1e-9) & (places / lengths < 1 + 1e-9)).all()


def shown_level(lod, counts, camera):
    """The level whose cards a frame draws, the wood left out; None on the way between two."""
    cards = tl.render(lod, camera, samples=1).stats.triangles // 2
    return counts.index(cards) if cards in counts else None


def test_levels_by_error_in_pixels(plant):
    counts = (16, 8, 4)
    cameras = [tl.orbit(plant, count=5, distance=d, size=SIZE)[1] for d in (1.2, 8, 50, 1000)]
    params = {"cluster_count": counts, "resolution": 8, "wood": False, "fade_share": 0.0}

    def levels(error_px):
        lod = build(plant, level_error_px=error_px, **params)
        return [shown_level(lod, counts, camera) for camera in cameras]

    fine, normal, coarse = (levels(error_px) for error_px in (0.01, 1.0, 1e6))
    assert fine[:2] == [0, 0]
    assert (normal[0], normal[-1]) == (0, 2)
    assert normal == sorted(normal)
    assert coarse == [2, 2, 2, 2]
    lod = build(plant, **params)
    camera = cameras[2]
    # the rule by hand: the error over a pixel's size where the crown is nearest
    middles = plant.foliage.centers
    center = (middles.min(axis=0) + middles.max(axis=0)) / 2 + plant.origin
    reach = np.linalg.norm(plant.foliage.positions + plant.origin - center, axis=1).max()
    near = np.linalg.norm(np.subtract(camera.eye, center)) - reach
    pixels = np.array(lod.level_errors) * camera.pixels_per_metre(near)
    assert normal[2] == int((pixels <= 1.0).sum()) - 1


def test_levels_by_distance(plant):
    counts = (16, 8, 4)
    lod = build(
        plant,
        cluster_count=counts,
        resolution=8,
        level_distances=np.array([4, 9]),
        morph=False,
        fade_share=0.0,
        wood=False,
    )
    assert lod.params["level_distances"] == [4.0, 9.0]
    middles = plant.foliage.centers
    center = (middles.min(axis=0) + middles.max(axis=0)) / 2
    reach = np.linalg.norm(plant.foliage.positions - center, axis=1).max()
    for distance, level in ((1.5, 0), (3.99, 0), (4.01, 1), (8.99, 1), (9.01, 2), (100, 2)):
        eye = center + reach * distance * np.array([0.6, 0.0, 0.8])
        view = tl.Camera.perspective(tuple(eye), tuple(center), size=SIZE)
        assert shown_level(lod, counts, view) == level, distance


def test_morphing_moves_cards(plant, camera):
    params = {"cluster_count": (12, 4), "fade_share": 0.0, "resolution": 32}
    still, moving = (build(plant, morph=morph, **params) for morph in (False, True))
    start, half = (picture(moving.at(level=0, t=t), camera) for t in (0.0, 0.5))
    assert (start != half).any()
    assert (picture(still.at(level=0, t=0.0), camera) == start).all()
    assert (picture(still.at(level=0, t=0.5), camera) == start).all()
    # at the end every card lies in its parent's plane
    frame = tl.render(moving.at(level=0, t=1.0), camera, samples=1, outputs=("depth", "ids"))
    rows, columns = np.nonzero((frame.ids >= 4) & (frame.ids < 16))
    assert len(rows) > 50
    right, up, back = camera.view_rotation()
    scale = 1 / camera.pixels_per_metre(1.0)
    x, y = columns + 0.5 - SIZE[0] / 2, SIZE[1] / 2 - rows - 0.5
    rays = scale * (x[:, np.newaxis] * right + y[:, np.newaxis] * up) - back
    points = np.array(camera.eye) + rays * frame.depth[rows, columns, np.newaxis]
    planes = moving.planes_at(1)[moving.parents_at(0)[frame.ids[rows, columns] - 4]]
    # depth is f32
    off = np.abs((points * planes[:, :3]).sum(axis=1) + planes[:, 3])
    assert off.max() < 1e-5 * 2 * plant.sphere[1]


def test_the_next_level_is_faded_in(plant, camera):
    lod = build(plant, cluster_count=(12, 4), morph=False, fade_share=0.5, wood=False)
    fine, coarse = (picture(lod.at(level=level), camera, 16) for level in (0, 1))
    for t in (0.2, 0.5):
        assert (picture(lod.at(level=0, t=t), camera, 16) == fine).all()
    assert (picture(lod.at(level=0, t=1.0), camera, 16) == coarse).all()
    half = tl.render(lod.at(level=0, t=0.75), camera, samples=16)
    assert half.stats.triangles == 2 * (12 + 4)
    # some samples show one, some the other
    mean = np.abs(half.color - (fine + coarse) / 2).mean()
    assert mean < 0.5 * min(np.abs(half.color - fine).mean(), np.abs(half.color - coarse).mean())


def test_views_limit_texels_and_sides(plant):
    cameras = tl.orbit(plant, count=8, distance=10, size=(64, 64))[:1]
    lod = build(plant, views=cameras, resolution=256)
    assert lod.params["views"] == 1
    sides = lod.card_sides_at(0)
    assert len(sides) == 6, "one side of each card"
    assert max(max(side.texels.shape[:2]) for side in sides) < 64
    assert picture(lod, cameras[0]).any()
    # from elsewhere a card shows the side that it has
    assert picture(lod, tl.orbit(plant, count=2, distance=10, size=(64, 64))[1]).any()
    with pytest.raises(ValueError, match="views is empty"):
        build(plant, views=[])


def test_wood_is_a_mesh_or_left_out(plant, camera):
    with_wood, without = (build(plant, wood=wood) for wood in (True, False))
    assert (with_wood.footprint.triangles, without.footprint.triangles) == (4, 0)
    ids = tl.render(with_wood, camera, outputs=("ids",)).ids
    assert {0, 1, 2, 3} & set(np.unique(ids).tolist())
    chestnut = tl.grow_plant("chestnut", leaf_count=50)
    few = build(chestnut, wood_triangle_count=500, resolution=8)
    assert few.footprint.triangles < 1000 < len(chestnut.wood.triangles)


# What is drawn


def twin_texel(texels, u, v):
    """Bilinear, premultiplied and linear; nothing around the card."""
    alpha = texels[..., 3:] / 255
    rgba = np.pad(
        np.concatenate([linear_from_srgb(texels[..., :3] / 255) * alpha, alpha], axis=2),
        ((1, 1), (1, 1), (0, 0)),
    )
    height, width = texels.shape[:2]
    x, y = u * width + 0.5, v * height + 0.5
    x0, y0 = int(x), int(y)
    fx, fy = x - x0, y - y0
    top, bottom = (rgba[row, x0] * (1 - fx) + rgba[row, x0 + 1] * fx for row in (y0, y0 + 1))
    return top * (1 - fy) + bottom * fy


def twin_pixel(lod, camera, pixel):
    """Colour of a pixel's middle by a ray through alpha-tested cards, and how sure that is."""
    right, up, back = camera.view_rotation()
    width, height = camera.size
    scale = 2 * np.tan(np.radians(camera.fov_y_deg) / 2) / height
    x, y = pixel[0] + 0.5 - width / 2, height / 2 - pixel[1] - 0.5
    ray = (x * right + y * up) * scale - back
    eye = np.array(camera.eye)
    planes = lod.planes_at(0)
    color, nearest, margin = np.zeros(4), np.inf, np.inf
    for side in lod.card_sides_at(0):
        plane = planes[side.cluster] * (-1 if planes[side.cluster, 1] < 0 else 1)
        if (plane[:3] @ eye + plane[3] < 0) != side.is_back:
            continue
        corner = side.corners[0]
        across, along = side.corners[1] - corner, side.corners[3] - corner
        distance = -(plane[:3] @ eye + plane[3]) / (plane[:3] @ ray)
        hit = eye + distance * ray - corner
        u, v = hit @ across / (across @ across), 1 - hit @ along / (along @ along)
        if not (0 <= u <= 1 and 0 <= v <= 1 and distance > 0):
            continue
        texel = twin_texel(side.texels, u, v)
        margin = min(margin, abs(texel[3] - 0.5))
        if texel[3] >= 0.5 and distance < nearest:
            nearest, color = distance, texel / texel[3]
    return color, margin


@pytest.mark.parametrize("azimuth", [20, 110, 200, 300.5])
def test_a_picture_is_that_of_rays_through_the_cards(plant, azimuth):
    lod = build(plant, resolution=24, wood=False)
    angle = np.radians(azimuth)
    # so near that a texel is several pixels: only the finest level is read
    eye = (4 * np.sin(angle), 1.0, 4 * np.cos(angle))
    view = tl.Camera.perspective(eye, (0, 0, 0), fov_y_deg=40, size=(240, 240))
    colors = tl.render(lod, view, samples=1, outputs=("color",)).color
    rng = np.random.default_rng(5)
    shown = np.argwhere(colors[..., 3] > 0)
    places = np.concatenate([rng.integers(0, 240, (60, 2)), rng.choice(shown, 90)])
    compared = 0
    for y, x in places:
        expected, margin = twin_pixel(lod, view, (x, y))
        if margin > 0.02:  # corners are snapped to 1/256 pixel
            np.testing.assert_allclose(colors[y, x], expected, atol=2e-3)
            compared += expected[3] > 0.5
    assert compared > 20


def test_threads_do_not_change_a_build(plant, camera):
    params = {"cluster_count": (12, 5), "restarts": 3, "flatten": "rotate"}
    for more in ({}, {"texturing": "indirect", **INDIRECT}):
        one, four = (build(plant, threads=threads, **params, **more) for threads in (1, 4))
        assert texel_bytes(one) == texel_bytes(four)
        for level in range(2):
            assert one.planes_at(level).tobytes() == four.planes_at(level).tobytes()
            assert one.cluster_ids_at(level).tobytes() == four.cluster_ids_at(level).tobytes()
        pictures = [picture(one.at(level=0, t=0.97), camera, threads=n) for n in (1, 4)]
        assert pictures[0].tobytes() == pictures[1].tobytes()


# What is refused

NAMED = [
    ({"cluster_count": 0}, "cluster_count"),
    ({"cluster_count": -1}, "cluster_count"),
    ({"cluster_count": 4097}, "cluster_count"),
    ({"cluster_count": 2**40}, "cluster_count"),
    ({"cluster_count": ()}, "cluster_count"),
    ({"cluster_count": (8, 8)}, "cluster_count"),
    ({"cluster_count": (4, 8)}, "cluster_count"),
    ({"cluster_count": (4, 0)}, "cluster_count"),
    ({"alpha_rel": -1}, "alpha_rel"),
    ({"alpha_rel": np.nan}, "alpha_rel"),
    ({"alpha": -1}, "alpha"),
    ({"alpha": np.inf}, "alpha"),
    ({"init": "kmeans"}, "init"),
    ({"init": [0, 1]}, "init"),
    ({"init": np.full(150, -1)}, "init"),
    ({"init": np.full(150, 2**40)}, "init"),
    ({"init": np.zeros(150)}, "init"),
    ({"init": np.zeros((2, 3))}, "init"),
    ({"init": np.zeros((2, 4))}, "init"),
    ({"init": [[0, 0, 1, np.nan]]}, "init"),
    ({"init": np.empty((0, 4))}, "init"),
    ({"seed": -1}, "seed"),
    ({"seed": 2**64}, "seed"),
    ({"restarts": 0}, "restarts"),
    ({"max_iterations": 0}, "max_iterations"),
    ({"eigen": "power"}, "eigen"),
    ({"flatten": "bend"}, "flatten"),
    ({"resolution": 0}, "resolution"),
    ({"resolution": 10**6}, "resolution"),
    ({"resolution": (16, 0)}, "resolution"),
    ({"resolution": (16, 16, 16)}, "resolution"),
    ({"resolution": 16384}, "resolution"),
    ({"texels_per_metre": 0}, "texels_per_metre"),
    ({"texels_per_metre": np.nan}, "texels_per_metre"),
    ({"texels_per_metre": 1e6}, "texels_per_metre"),
    ({"samples": 0}, "samples"),
    ({"samples": 2}, "samples"),
    ({"format": "dxt1"}, "format"),
    ({"texturing": "none"}, "texturing"),
    ({"texturing": "indirect", "layers": 0}, "layers"),
    ({"texturing": "indirect", "layers": 9}, "layers"),
    ({"texturing": "indirect", "rotation_count": 0}, "rotation_count"),
    ({"texturing": "indirect", "rotation_count": 129}, "rotation_count"),
    ({"texturing": "indirect", "leaf_resolution": 0}, "leaf_resolution"),
    ({"texturing": "indirect", "leaf_resolution": 1025}, "leaf_resolution"),
    ({"texturing": "indirect", "texels_per_leaf": 0}, "texels_per_leaf"),
    ({"texturing": "indirect", "texels_per_leaf": 65}, "texels_per_leaf"),
    ({"drawing": "sketch"}, "drawing"),
    ({"outline": 2}, "outline"),
    ({"outline": 65}, "outline"),
    ({"level_error_px": -1}, "level_error_px"),
    ({"level_error_px": np.nan}, "level_error_px"),
    ({"level_distances": 3.0}, "level_distances"),
    ({"cluster_count": (8, 4), "level_distances": []}, "level_distances"),
    ({"cluster_count": (8, 4), "level_distances": [0.0]}, "level_distances"),
    ({"cluster_count": (8, 4), "level_distances": [np.inf]}, "level_distances"),
    ({"cluster_count": (8, 4, 2), "level_distances": [5, 5]}, "level_distances"),
    ({"fade_share": -0.1}, "fade_share"),
    ({"fade_share": 1.1}, "fade_share"),
    ({"wood_triangle_count": 0}, "wood_triangle_count"),
    ({"threads": 0}, "threads"),
]


@pytest.mark.parametrize(("arguments", "message"), NAMED)
def test_bad_arguments_are_named(plant, arguments, message):
    with pytest.raises(ValueError, match=message):
        build(plant, **arguments)


def test_arguments_of_another_kind_are_refused(plant):
    for arguments in (
        {"cluster_count": "8"},
        {"cluster_count": 2.5},
        {"cluster_count": (8, 2.5)},
        {"cluster_count": (8, 4), "level_distances": "far"},
        {"cluster_count": (8, 4), "level_distances": ["far"]},
        {"resolution": 64.0},
        {"resolution": "large"},
        {"samples": None},
        {"outline": 4.5},
        {"views": [1]},
    ):
        with pytest.raises((TypeError, AttributeError)):
            build(plant, **arguments)


def test_a_plant_without_leaves_has_no_clusters():
    wood, _ = quads([facing(0, 0, 0, 1)])
    with pytest.raises(ValueError, match="foliage is empty"):
        build(tl.Plant.from_arrays(wood=wood))


def test_counts_of_other_kinds_are_the_same(plant):
    base = build(plant, cluster_count=(8, 4), resolution=8)
    for counts in ([8, 4], np.array([8, 4]), np.array([8, 4], np.uint8), range(8, 0, -4)):
        again = build(plant, cluster_count=counts, resolution=8)
        assert again.params["cluster_count"] == (8, 4)
        assert texel_bytes(again) == texel_bytes(base)
    assert build(plant, cluster_count=np.int64(8), resolution=8).params["cluster_count"] == 8


def test_leaves_without_area_are_empty_cards(camera):
    plant = crown([((0, 0, 0), (0, 0, 0), (0, 0, 0)), ((1, 0, 0), (1, 0, 0), (0, 0, 0))])
    for flatten in ("project", "rotate"):
        for texturing in ("direct", "indirect"):
            lod = build(plant, flatten=flatten, texturing=texturing)
            assert not picture(lod, camera).any()


def test_a_build_may_be_stopped_by_its_progress(plant):
    class EnoughError(Exception):
        pass

    def stop(done, total):
        raise EnoughError

    with pytest.raises(EnoughError):
        build(plant, cluster_count=64, resolution=256, progress=stop)


def test_memory_is_refused_before_it_is_used():
    # in a process of its own with little memory to spare
    code = """
        import resource, treelod as tl
        plant = tl.grow_plant("chestnut", leaf_count=5000)
        resource.setrlimit(resource.RLIMIT_AS, (resource.getpagesize() * 2**20,) * 2)
        for texels in ({"resolution": 8192}, {"texels_per_metre": 1e5}):
            try:
                tl.LeafClusters.build(plant, cluster_count=64, **texels)
            except tl.LimitError as error:
                print(error)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={**os.environ, "TREELOD_NUM_THREADS": "2"},
    )
    resolution, density = done.stdout.splitlines()
    assert resolution.startswith(f"resolution needs {64 * 2 * 8192**2} texels")
    assert density.startswith("texels_per_metre needs")
