"""Foliage simplified by meshoptimizer: what is left of it, and what that looks like."""

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, quads, random_crown
from treelod.render import EMPTY_ID

METHODS = ("simplify", "attributes", "sloppy")
CAMERA = tl.Camera.perspective((0, 0, 9), (0, 0, 0), size=(96, 96))


def coverage(lod, camera=CAMERA):
    return float(tl.render(lod, camera, samples=16).color[..., 3].mean())


def test_all_of_it_is_the_full_mesh():
    plant = random_crown(60, trunk=True)
    full = tl.render(tl.FullMesh.build(plant), CAMERA, outputs=("color", "depth", "ids"))
    for method in METHODS:
        for given in ({"triangle_count": 120}, {"triangle_count": 10**9}, {"keep_fraction": 1.0}):
            lod = tl.SimplifiedMesh.build(plant, method=method, **given)
            assert (lod.triangle_count, lod.error) == (120, 0.0)
            frame = tl.render(lod, CAMERA, outputs=("color", "depth", "ids"))
            for plane in ("color", "depth", "ids"):
                np.testing.assert_array_equal(getattr(frame, plane), getattr(full, plane))


@pytest.mark.parametrize("method", METHODS)
def test_fewer_triangles_cover_less_and_cost_more_error(method):
    plant = random_crown(400)
    lods = [
        tl.SimplifiedMesh.build(plant, triangle_count=count, method=method)
        for count in (800, 400, 100, 20)
    ]
    counts, errors = zip(*((lod.triangle_count, lod.error) for lod in lods), strict=True)
    assert list(counts) == sorted(counts, reverse=True)
    if method != "sloppy":
        assert counts == (800, 400, 100, 20)
        assert list(errors) == sorted(errors)
        covered = [coverage(lod) for lod in lods]
        assert covered == sorted(covered, reverse=True)
        assert covered[-1] < 0.2 * covered[0], "leaves are gone, and nothing stands for them"
    for lod in lods:
        assert lod.footprint.triangles == lod.triangle_count
        assert lod.error <= 2.6, "no more than the crown is wide"


def test_locked_borders_keep_flat_leaves():
    plant = random_crown(40)
    locked = tl.SimplifiedMesh.build(plant, triangle_count=10, lock_border=True, prune=False)
    assert (locked.triangle_count, locked.error) == (80, 0.0)
    pruned = tl.SimplifiedMesh.build(plant, triangle_count=10, lock_border=True)
    assert pruned.triangle_count <= 10
    assert pruned.error > 0.05, "a leaf's radius"


def test_textures_stay_where_they_were():
    # the left half of the texture is red, the right half green; each leaf shows all of it
    texture = np.zeros((8, 8, 4), np.uint8)
    texture[:, :4], texture[:, 4:] = (255, 0, 0, 255), (0, 255, 0, 255)
    mesh, offsets = quads([facing(-1, 0, 0, 0.5), facing(1, 0, 0, 0.4)])
    mesh["uvs"] = [[0, 1], [1, 1], [1, 0], [0, 0]] * 2
    plant = tl.Plant.from_arrays(
        foliage={**mesh, "material_ids": np.zeros(4, np.uint32)},
        leaf_offsets=offsets,
        materials=[tl.Material(name="halves", texture=texture)],
    )
    camera = tl.Camera.orthographic((0, 0, 9), (0, 0, 0), height=4, size=(80, 80))
    full = tl.render(tl.FullMesh.build(plant), camera, samples=1)
    for method in ("simplify", "attributes"):
        lod = tl.SimplifiedMesh.build(plant, triangle_count=3, method=method)
        frame = tl.render(lod, camera, samples=1)
        left = frame.color[..., 3] > 0
        assert left.sum() < (full.color[..., 3] > 0).sum()
        # what is left shows what was there
        np.testing.assert_allclose(frame.color[left], full.color[left], atol=1e-6)
        assert [texture.name for texture in lod.textures] == ["halves"]


def test_ids_count_wood_first():
    plant = crown([facing(0, 1, 0, 0.5), facing(0, 3, 0, 0.1)], trunk=True)
    camera = tl.Camera.orthographic((0, 0, 9), (0, 0, 0), height=8, size=(40, 40))
    for wood in (True, False):
        lod = tl.SimplifiedMesh.build(plant, triangle_count=2, wood=wood)
        ids = set(np.unique(tl.render(lod, camera, outputs=("ids",)).ids).tolist())
        assert ids == {*((0, 1) if wood else ()), 4, 5, EMPTY_ID}


def test_a_tenth_unless_told_otherwise():
    plant = random_crown(100)
    lod = tl.SimplifiedMesh.build(plant)
    assert lod.triangle_count == 20
    assert lod.params["keep_fraction"] == 0.1
    assert lod.params["triangle_count"] is None
    assert tl.SimplifiedMesh.build(plant, triangle_count=20).params["keep_fraction"] is None


def test_the_same_again():
    plant = random_crown(300)
    for method in METHODS:
        one, two = (
            tl.render(tl.SimplifiedMesh.build(plant, triangle_count=50, method=method), CAMERA)
            for _ in range(2)
        )
        np.testing.assert_array_equal(one.color, two.color)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"triangle_count": 0}, ValueError, "triangle_count"),
        ({"triangle_count": 1.5}, TypeError, "triangle_count"),
        ({"triangle_count": 2**32}, ValueError, "triangle_count"),
        ({"keep_fraction": 0.0}, ValueError, "keep_fraction"),
        ({"keep_fraction": 1.5}, ValueError, "keep_fraction"),
        ({"keep_fraction": float("nan")}, ValueError, "keep_fraction"),
        ({"keep_fraction": "half"}, TypeError, "keep_fraction"),
        ({"keep_fraction": 0.5, "triangle_count": 5}, ValueError, "keep_fraction"),
        ({"method": "careful"}, ValueError, "method"),
        ({"filter": "cubic"}, ValueError, "filter"),
        ({"target_error_rel": -0.1}, ValueError, "target_error_rel"),
        ({"target_error_rel": 1.1}, ValueError, "target_error_rel"),
        ({"prune": "yes"}, TypeError, "prune"),
        ({"lock_border": 2}, TypeError, "lock_border"),
        ({"method": "attributes", "normal_weight": -1.0}, ValueError, "normal_weight"),
        ({"method": "attributes", "uv_weight": 1e9}, ValueError, "uv_weight"),
        ({"wood_triangle_count": 0}, ValueError, "wood_triangle_count"),
    ],
)
def test_bad_arguments_are_named(given, error, message):
    with pytest.raises(error, match=message):
        tl.SimplifiedMesh.build(random_crown(3), **given)


def test_without_leaves_there_is_nothing_to_simplify():
    wood, _ = quads([facing(0, 0, 0, 1)])
    with pytest.raises(ValueError, match="foliage"):
        tl.SimplifiedMesh.build(tl.Plant.from_arrays(wood=wood))


def test_progress_counts_materials():
    seen = []
    tl.SimplifiedMesh.build(random_crown(3), progress=lambda *args: seen.append(args))
    assert seen[-1] == (1, 1)


def test_sloppy_may_leave_nothing(models):
    # a game tree of few large leaf cards, which all fall into the same cells of a grid
    plant = tl.load_plant(models / "quaternius_common" / "CommonTree_1.gltf")
    lod = tl.SimplifiedMesh.build(plant, keep_fraction=0.05, method="sloppy", wood=False)
    assert lod.triangle_count == 0
    assert not tl.render(lod, tl.orbit(plant, count=1, size=(32, 32))[0]).color.any()


@pytest.mark.parametrize(
    "file", ["ez_oak_large/ez_oak_large.glb", "quaternius_common/CommonTree_1.gltf"]
)
def test_real_crowns_grow_thin(models, file):
    plant = tl.load_plant(models / file)
    camera = tl.orbit(plant, count=1, elevation_deg=10, size=(128, 96))[0]
    full = coverage(tl.FullMesh.build(plant), camera)
    total = len(plant.foliage.mesh.triangles)
    kept = []
    for fraction in (0.5, 0.2, 0.05):
        lod = tl.SimplifiedMesh.build(plant, keep_fraction=fraction)
        assert lod.triangle_count == round(fraction * total)
        kept.append(coverage(lod, camera) / full)
    assert kept == sorted(kept, reverse=True)
    assert kept[0] > 0.8
    assert kept[2] < 0.75
