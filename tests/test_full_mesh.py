"""The plant as it is, and how much of its wood."""

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, quads, random_crown
from treelod.render import EMPTY_ID


def test_everything_is_drawn():
    plant = random_crown(20, trunk=True)
    mesh = tl.FullMesh.build(plant)
    footprint = mesh.footprint
    assert (footprint.triangles, footprint.cards) == (44, 0)
    # 12 floats of vectors, 2 of uvs and 4 of colour a vertex; 3 indices a triangle
    assert footprint.geometry_bytes == 88 * 18 * 4 + 44 * 3 * 4
    assert (footprint.texture_bytes, footprint.total_bytes) == (0, footprint.geometry_bytes)
    assert mesh.textures == []
    assert mesh.params == {"wood": True, "wood_triangle_count": None, "filter": "bilinear"}
    assert mesh.build_secs > 0.0
    assert repr(mesh) == "FullMesh(wood=True, wood_triangle_count=None, filter='bilinear')"


def test_ids_count_wood_first():
    plant = crown([facing(0, 1, 0, 0.5)], trunk=True)
    camera = tl.Camera.orthographic((0, 0, 9), (0, -0.5, 0), height=5, size=(20, 20))
    ids = {
        wood: set(
            np.unique(
                tl.render(tl.FullMesh.build(plant, wood=wood), camera, outputs=("ids",)).ids
            ).tolist()
        )
        for wood in (True, False)
    }
    # the trunk's first card faces the camera, its second is seen edge on
    assert ids == {True: {0, 1, 4, 5, EMPTY_ID}, False: {4, 5, EMPTY_ID}}


def test_without_wood_the_plant_is_smaller():
    plant = random_crown(20, trunk=True)
    camera = tl.Camera.orthographic((0, 0, 9), (0, 0, 0), height=8, size=(80, 80))
    whole, leaves = (
        tl.render(tl.FullMesh.build(plant, wood=wood), camera).bounds_px for wood in (True, False)
    )
    assert whole[3] == 70, "the trunk ends at y = -3, of a view from 4 to -4"
    assert leaves[3] < 55, "the crown ends about y = -1"
    assert leaves[:3] == whole[:3]


def test_wood_can_be_simplified():
    plant = tl.grow_plant("chestnut", leaf_count=20)
    wood = len(plant.wood.triangles)
    mesh = tl.FullMesh.build(plant, wood_triangle_count=2000)
    found = mesh.footprint.triangles - len(plant.foliage.mesh.triangles)
    # fewer where pruning drops whole twigs
    assert 1700 <= found <= 2010
    assert tl.FullMesh.build(plant, wood_triangle_count=10**9).footprint.triangles == wood + 200
    camera = tl.orbit(plant, count=1, size=(96, 96))[0]
    coverage = [
        tl.render(tl.FullMesh.build(plant, wood_triangle_count=count), camera).color[..., 3].mean()
        for count in (None, 30_000, 10_000, 2000)
    ]
    # the same tree, with ever fewer twigs
    assert coverage == sorted(coverage, reverse=True)
    assert coverage[1] > 0.9 * coverage[0]
    assert coverage[3] > 0.5 * coverage[0]


@pytest.mark.parametrize("count", [0, -5])
def test_no_wood_is_not_a_count(count):
    plant = random_crown(3, trunk=True)
    for technique in (tl.FullMesh, tl.Slicings):
        with pytest.raises(ValueError, match="wood_triangle_count"):
            technique.build(plant, wood_triangle_count=count)


def test_bad_arguments_are_named():
    plant = random_crown(3)
    with pytest.raises(ValueError, match="filter"):
        tl.FullMesh.build(plant, filter="cubic")
    with pytest.raises(TypeError):
        tl.FullMesh.build(plant, wood_triangle_count=1.5)


def test_wood_alone_is_a_plant_and_nothing_is_none():
    wood, _ = quads([facing(0, 0, 0, 1)])
    plant = tl.Plant.from_arrays(wood=wood)
    assert tl.FullMesh.build(plant).footprint.triangles == 2
    with pytest.raises(ValueError, match="nothing to draw"):
        tl.FullMesh.build(plant, wood=False)


def test_leaves_alone_are_a_plant():
    mesh = tl.FullMesh.build(random_crown(3), wood=False, wood_triangle_count=7)
    assert mesh.footprint.triangles == 6


def test_blended_triangles_are_drawn_far_to_near():
    # half-transparent squares, the nearest first in the file
    material = tl.Material(name="glass", alpha_mode="blend")
    colors = [(1, 0, 0, 0.5), (0, 1, 0, 0.5), (0, 0, 1, 0.5)]
    plant = crown([facing(0, 0, z, 1) for z in (1, 0, -1)], colors, materials=[material])
    for eye, weights in [((0, 0, 9), (0.5, 0.25, 0.125)), ((0, 0, -9), (0.125, 0.25, 0.5))]:
        camera = tl.Camera.orthographic(eye, (0, 0, 0), height=1, size=(4, 4))
        frame = tl.render(tl.FullMesh.build(plant), camera, outputs=("albedo",))
        expected = np.tile([*weights, 0.875], (4, 4, 1))
        np.testing.assert_allclose(frame.albedo, expected, atol=1e-6)


def test_trilinear_reads_mips_where_texels_are_small():
    # a black and white checkerboard of single texels, seen with 16 texels a pixel
    texture = np.zeros((64, 64, 4), np.uint8)
    texture[..., 3] = 255
    texture[np.indices((64, 64)).sum(axis=0) % 2 == 0, :3] = 255
    mesh, offsets = quads([facing(0, 0, 0, 1)])
    mesh["uvs"] = [[0, 1], [1, 1], [1, 0], [0, 0]]
    mesh["normals"] = [[0, 0, 1]] * 4
    plant = tl.Plant.from_arrays(
        foliage={**mesh, "material_ids": np.zeros(2, np.uint32)},
        leaf_offsets=offsets,
        materials=[tl.Material(name="checker", texture=texture)],
    )
    camera = tl.Camera.orthographic((0.01, 0.01, 5), (0.01, 0.01, 0), height=2.0, size=(4, 4))
    spread = {}
    for filter_ in ("nearest", "bilinear", "trilinear"):
        mesh = tl.FullMesh.build(plant, filter=filter_)
        inside = tl.render(mesh, camera, samples=1).color[1:3, 1:3, 1]
        spread[filter_] = float(np.ptp(inside))
    # level 4 is the mean of 16 x 16 texels, the same everywhere
    assert spread["trilinear"] < 0.01
    assert tl.FullMesh.build(plant, filter="trilinear").footprint.texture_bytes == 4 * 5461
    white = tl.render(tl.FullMesh.build(plant, filter="nearest"), camera, samples=1).color
    gray = tl.render(tl.FullMesh.build(plant, filter="trilinear"), camera, samples=1).color
    assert abs(gray[1, 1, 1] - white[1, 1, 1]) > 0.1
