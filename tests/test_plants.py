"""Plants: loaded as they are, split into wood and leaves, lit."""

import json

import numpy as np
import pytest

import treelod as tl
from made_gltf import Gltf, quad, textured
from treelod.export import plant_glb
from treelod.plant_files import gltf_header

# Triangles, leaves, wood triangles and bounds as counted by trimesh 5.2 after welding (2026-11-18);
# what is a leaf was decided by looking at the plants.
REAL = {
    "ez_oak_large/ez_oak_large.glb": (
        22566, 5280, 12006, [[-49.931, 0.0, -44.828], [47.867, 102.023, 53.871]],
    ),
    "ez_aspen_large/ez_aspen_large.glb": (
        13668, 3234, 7200, [[-23.221, 0.0, -25.182], [22.703, 102.29, 22.386]],
    ),
    "ez_bush_1/ez_bush_1.glb": (
        13872, 2496, 8880, [[-11.217, -3.176, -18.015], [19.743, 26.898, 14.159]],
    ),
    "quaternius_common/Bush_Common_Flowers.gltf": (
        1368, 486, 0, [[-0.923, -0.235, -0.974], [0.991, 1.347, 0.991]],
    ),
    "quaternius_common/CommonTree_1.gltf": (
        6265, 960, 4345, [[-2.194, -0.243, -2.225], [2.117, 7.022, 2.353]],
    ),
    "quaternius_common/CommonTree_3.gltf": (
        3505, 900, 1705, [[-1.986, -0.243, -2.061], [2.076, 9.182, 2.18]],
    ),
    "quaternius_common/Grass_Common_Tall.gltf": (
        326, 14, 0, [[-0.404, -0.031, -0.479], [0.492, 1.841, 0.514]],
    ),
    "quaternius_common/Pine_4.gltf": (
        3370, 55, 2160, [[-2.872, -0.235, -2.946], [2.93, 10.001, 2.425]],
    ),
    "polyhaven_fern/fern_02.glb": (
        6232, 53, 0, [[-0.528, -0.031, -0.422], [1.444, 0.397, 1.302]],
    ),
    "khronos_vase_flowers/GlassVaseFlowers.gltf": (
        14036, 70, 6400, [[-0.054, 0.0, -0.068], [0.164, 0.203, 0.074]],
    ),
}  # fmt: skip

transmission = pytest.mark.filterwarnings("ignore:.*KHR_materials_transmission:UserWarning")


@transmission
@pytest.mark.parametrize("name", REAL)
def test_real_plant(models, name):
    triangles, leaves, wood, bounds = REAL[name]
    plant = tl.load_plant(models / name)
    assert plant.triangle_count == triangles
    assert plant.foliage.leaf_count == leaves
    assert len(plant.wood.triangles) == wood
    # stated to three decimals
    np.testing.assert_allclose(plant.bounds, bounds, atol=5.1e-4)
    np.testing.assert_array_equal(plant.origin, 0)
    check_whole(plant)


def check_whole(plant):
    """What holds for every plant."""
    foliage, wood = plant.foliage, plant.wood
    offsets = foliage.leaf_offsets.astype(int)
    assert offsets[0] == 0
    assert offsets[-1] == len(foliage.triangles)
    assert (np.diff(offsets) > 0).all()
    for mesh in (wood, foliage.mesh):
        count = len(mesh.positions)
        # every vertex is used, and nothing else
        assert np.unique(mesh.triangles).tolist() == list(range(count))
        lengths = np.linalg.norm(mesh.normals, axis=1)
        assert ((abs(lengths - 1) < 1e-6) | (lengths == 0)).all()
        for array in (mesh.positions, mesh.uvs, mesh.base, mesh.front, mesh.back):
            assert len(array) == count
            assert np.isfinite(array).all()
            assert not array.flags.writeable
        for colors in (mesh.front, mesh.back):
            assert (colors >= 0).all()
            # white facing the sun is 1; a little towards the zenith the sky adds 0.2 %
            assert (colors <= 1.005).all()
        # materials come in runs
        assert np.count_nonzero(np.diff(mesh.material_ids.astype(int))) < len(plant.materials)
    # areas and centres of the leaves, anew from the triangles
    corners = foliage.positions[foliage.triangles].astype(np.float64)
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    areas /= 2
    of_leaves = np.add.reduceat(areas, offsets[:-1])
    np.testing.assert_allclose(foliage.areas, of_leaves, rtol=1e-6)
    moments = np.add.reduceat(areas[:, None] * corners.mean(axis=1), offsets[:-1])
    size = np.ptp(plant.bounds, axis=0).max()
    np.testing.assert_allclose(foliage.centers, moments / of_leaves[:, None], atol=1e-6 * size)
    center, radius = plant.sphere
    used = np.concatenate([wood.positions, foliage.positions]) + plant.origin
    np.testing.assert_allclose(np.linalg.norm(used - center, axis=1).max(), radius, rtol=1e-6)


def test_leaves_do_not_share_positions(models):
    plant = tl.load_plant(models / "quaternius_common/CommonTree_1.gltf")
    offsets = plant.foliage.leaf_offsets.astype(int)
    leaf_of = np.repeat(np.arange(plant.foliage.leaf_count), np.diff(offsets))
    rows = plant.foliage.positions[plant.foliage.triangles].reshape(-1, 3)
    _, position = np.unique(rows, axis=0, return_inverse=True)
    pairs = np.unique(np.column_stack([position.ravel(), np.repeat(leaf_of, 3)]), axis=0)
    assert len(pairs) == len(np.unique(pairs[:, 0]))


def test_materials_of_a_real_plant(models):
    plant = tl.load_plant(models / "ez_oak_large/ez_oak_large.glb")
    bark, leaves = plant.materials
    assert (bark.name, bark.alpha_mode, bark.wrap) == ("bark", "opaque", ("repeat", "repeat"))
    assert (leaves.name, leaves.alpha_mode, leaves.alpha_cutoff) == ("leaves", "mask", 0.5)
    assert bark.texture.shape == (1024, 512, 4)
    # a palette picture whose transparency is a table beside it
    assert leaves.texture.shape == (1024, 1024, 4)
    assert np.mean(leaves.texture[..., 3] < 128) == pytest.approx(0.744, abs=1e-3)
    # the colour factor as in the file's JSON, not rounded to 8 bits
    factor = [0.665387298282272, 0.665387298282272, 0.6104955708078648, 1]
    np.testing.assert_array_equal(
        plant.foliage.mesh.base, np.tile(np.float32(factor), (len(plant.foliage.positions), 1))
    )


@transmission
def test_two_nodes_share_a_mesh(models):
    plant = tl.load_plant(models / "khronos_vase_flowers/GlassVaseFlowers.gltf")
    # the second bunch stands 12 cm along x from the first (the nodes' translations)
    x = plant.foliage.centers[:, 0]
    first, second = plant.foliage.centers[x < 0.06], plant.foliage.centers[x >= 0.06]
    assert len(first) == len(second) == 35
    np.testing.assert_allclose(first + np.array([0.12, 0, 0]), second, atol=1e-6)


def test_transmission_warns(models):
    path = models / "khronos_vase_flowers/GlassVaseFlowers.gltf"
    with pytest.warns(UserWarning, match="KHR_materials_transmission is ignored"):
        tl.load_plant(path)


@pytest.mark.parametrize("one_material", [True, False])
@pytest.mark.parametrize("preset", tl.plants.PRESETS)
def test_grown_plants_split_rightly(preset, one_material):
    grown = tl.grow_plant(preset)
    wood, leaves = grown.wood, grown.foliage
    ids = np.concatenate([wood.material_ids, leaves.mesh.material_ids])
    if one_material:
        ids = np.zeros_like(ids)
    mesh = {
        "positions": np.concatenate([wood.positions, leaves.positions]),
        "normals": np.concatenate([wood.normals, leaves.mesh.normals]),
        "triangles": np.concatenate([wood.triangles, leaves.triangles + len(wood.positions)]),
        "material_ids": ids,
    }
    plant = tl.Plant.from_mesh(mesh, materials=[tl.Material(name=name) for name in "abc"])
    assert plant.foliage.leaf_count == leaves.leaf_count
    assert len(plant.wood.triangles) == len(wood.triangles)
    # leaves come back by material
    np.testing.assert_array_equal(np.sort(plant.foliage.areas), np.sort(leaves.areas))


@pytest.mark.parametrize("preset", tl.plants.PRESETS)
def test_a_written_plant_comes_back(preset, tmp_path):
    # the least that every preset takes, twigs and petals included
    grown = tl.grow_plant(preset, leaf_count=1_500)
    path = tmp_path / "grown.glb"
    path.write_bytes(plant_glb(grown))
    plant = tl.load_plant(path)
    assert plant.foliage.leaf_count == 1_500
    assert len(plant.wood.triangles) == len(grown.wood.triangles)
    np.testing.assert_array_equal(plant.bounds, grown.bounds)
    np.testing.assert_allclose(
        np.sort(plant.foliage.areas), np.sort(grown.foliage.areas), rtol=1e-6
    )


# --- names, units and axes -----------------------------------------------------------------------


def two_named(tmp_path):
    """A mesh of two materials and one of one; all are sheets."""
    made = Gltf()
    made["materials"] = [{"name": "bark"}, {"name": "green"}]
    made["meshes"] = [{"name": "tree", "primitives": []}, {"name": "post", "primitives": []}]
    made["nodes"] = [{"mesh": 0}, {"mesh": 1}]
    made["scenes"] = [{"nodes": [0, 1]}]
    made.primitive(np.add([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [0, 0, 0]), material=0)
    made.primitive(np.add([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [5, 0, 0]), material=1)
    made.primitive([[9, 0, 0], [10, 0, 0], [9, 1, 0]], [[0, 1, 2]], mesh=1, material=1)
    return made.write(tmp_path / "two.gltf")


@pytest.mark.parametrize(
    ("names", "leaf_triangles", "wood_triangles"),
    [(None, 5, 0), (["green"], 3, 2), (["post"], 1, 4), (["tree"], 4, 1), (["bark", "post"], 3, 2),
     ([], 0, 5)],
)  # fmt: skip
def test_foliage_by_name(tmp_path, names, leaf_triangles, wood_triangles):
    plant = tl.load_plant(two_named(tmp_path), names)
    assert len(plant.foliage.triangles) == leaf_triangles
    assert len(plant.wood.triangles) == wood_triangles


def test_unknown_names_are_answered_with_the_known_ones(tmp_path):
    path = two_named(tmp_path)
    with pytest.raises(
        ValueError, match="named 'leafs'; there are 'bark', 'green', 'post', 'tree'"
    ):
        tl.load_plant(path, ["green", "leafs"])
    with pytest.raises(TypeError, match="sequence of names"):
        tl.load_plant(path, "green")


@pytest.mark.parametrize(("up", "corner"), [("y", [2, 4, 6]), ("z", [2, 6, -4]), ("x", [-4, 2, 6])])
def test_unit_and_up(tmp_path, up, corner):
    # corner 1 at (1, 2, 3) in units of two metres
    corners = [[0, 0, 0], [1, 2, 3], [0, 0, 1]]
    made = Gltf()
    # the cross product of its edges, as the file's own normal
    normals = made.accessor([[2, -1, 0]] * 3)
    made.primitive(corners, [[0, 1, 2]], attributes={"NORMAL": normals})
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"), unit=2, up=up)
    assert corner in plant.foliage.positions.tolist()
    # a turn, not a mirror: the normals still agree with the winding
    a, b, c = plant.foliage.positions[plant.foliage.triangles[0]]
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across)
    np.testing.assert_allclose(plant.foliage.normals, [across], atol=1e-6)
    np.testing.assert_allclose(plant.foliage.mesh.normals, [across] * 3, atol=1e-6)


@pytest.mark.parametrize("unit", [0, -1, 1e-7, 1e7, float("nan"), "m"])
def test_unit_is_checked(tmp_path, unit):
    with pytest.raises(ValueError, match=r"unit must be a number in \[1e-6, 1e6\]"):
        tl.load_plant(tmp_path / "a.glb", unit=unit)


def test_up_is_checked(tmp_path):
    with pytest.raises(ValueError, match="up must be 'x', 'y' or 'z', got 'Z'"):
        tl.load_plant(tmp_path / "a.glb", up="Z")


def test_far_plants_keep_their_detail(tmp_path):
    made = quad()
    made["nodes"][0]["translation"] = [1e7, 0, -2e7]
    plant = tl.load_plant(made.write(tmp_path / "far.gltf"))
    np.testing.assert_array_equal(plant.origin, [1e7 + 0.5, 0.5, -2e7])
    np.testing.assert_array_equal(plant.bounds, [[1e7, 0, -2e7], [1e7 + 1, 1, -2e7]])
    np.testing.assert_array_equal(abs(plant.foliage.positions[:, :2]), 0.5)
    # eight radii away is near enough: the radius of the square is 0.5 sqrt(2)
    made["nodes"][0]["translation"] = [5, 0, 0]
    np.testing.assert_array_equal(tl.load_plant(made.write(tmp_path / "near.gltf")).origin, 0)


# --- glTF ----------------------------------------------------------------------------------------


def test_glb_and_gltf_with_files_beside_it(tmp_path):
    made = textured([[[10, 20, 30]]])
    glb = tmp_path / "a.glb"
    glb.write_bytes(made.glb())
    (tmp_path / "some data").mkdir()
    (tmp_path / "some data" / "a.bin").write_bytes(made.blob)
    made["buffers"][0]["uri"] = "some%20data/a.bin"
    for path in (glb, made.write(tmp_path / "a.gltf")):
        plant = tl.load_plant(path)
        assert plant.triangle_count == 2
        assert plant.materials[0].texture.tolist() == [[[10, 20, 30, 255]]]


def test_defaults_of_a_material(tmp_path):
    made = textured([[[1, 2, 3]]])
    (plain,) = tl.load_plant(made.write(tmp_path / "a.gltf")).materials
    assert (plain.alpha_mode, plain.alpha_cutoff, plain.double_sided) == ("opaque", 0.5, False)
    made["materials"][0] |= {"alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": True}
    made["samplers"] = [{"wrapS": 33071, "wrapT": 33648}]
    made["textures"][0]["sampler"] = 0
    (mask,) = tl.load_plant(made.write(tmp_path / "a.gltf")).materials
    assert (mask.alpha_mode, mask.alpha_cutoff, mask.double_sided) == ("mask", 0.25, True)
    assert mask.wrap == ("clamp", "mirror")


@pytest.mark.parametrize(
    ("values", "dtype", "fields", "expected"),
    [
        ([[1, 0.5, 0.25]] * 4, "f4", {}, [0.5, 0.5, 0.0625, 0.5]),
        ([[1.0625, 0.5, 0, 0.5]] * 4, "f4", {}, [0.5, 0.5, 0, 0.25]),
        ([[65535, 0, 0, 65535]] * 4, "u2", {"normalized": True}, [0.5, 0, 0, 0.5]),
        ([[255, 0, 255]] * 4, "u1", {"normalized": True}, [0.5, 0, 0.25, 0.5]),
    ],
)
def test_base_is_factor_times_vertex_colour(tmp_path, values, dtype, fields, expected):
    made = Gltf()
    color = made.accessor(values, dtype, **fields)
    if dtype == "u1":  # rows of three bytes are padded to four
        made["bufferViews"][-1]["byteStride"] = 4
        padded = np.pad(np.array(values, np.uint8), ((0, 0), (0, 1))).tobytes()
        made.blob = made.blob[: made["bufferViews"][-1]["byteOffset"]] + padded
        made["bufferViews"][-1]["byteLength"] = len(padded)
    made["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 1, 0.25, 0.5]}}]
    made.primitive(attributes={"COLOR_0": color}, material=0)
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    np.testing.assert_array_equal(plant.foliage.mesh.base, [np.float32(expected)] * 4)


def test_texture_coordinates_are_the_files(tmp_path):
    # set 1 is the one that the material names; 12.3 and 1e-9 come back as they are
    given = [[12.3, 0.1], [1e-9, 1], [0, -3], [0.5, 0.25]]
    made = textured([[[1, 2, 3]]])
    primitive = made["meshes"][0]["primitives"][0]
    primitive["attributes"]["TEXCOORD_1"] = made.accessor(given)
    texture = made["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]
    texture["texCoord"] = 1
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    np.testing.assert_array_equal(
        plant.foliage.mesh.uvs, np.float32(given)[np.unique([0, 1, 2, 3])]
    )
    # scale, then a quarter turn counter-clockwise (v down: u becomes -v), then the offset
    texture["extensions"] = {
        "KHR_texture_transform": {
            "scale": [2, 4], "rotation": np.pi / 2, "offset": [0.5, 0.25], "texCoord": 1,
        }
    }  # fmt: skip
    plant = tl.load_plant(made.write(tmp_path / "b.gltf"))
    expected = [[4 * v + 0.5, -2 * u + 0.25] for u, v in given]
    np.testing.assert_allclose(plant.foliage.mesh.uvs, expected, atol=1e-6)


def test_transforms_of_the_scene(tmp_path):
    # scaled by 2, turned a quarter about z (x becomes y), under a parent that is shifted
    made = quad()
    made["nodes"] = [
        {"children": [1], "translation": [10, 0, 0]},
        {"mesh": 0, "scale": [2, 2, 2], "rotation": [0, 0, 0.5**0.5, 0.5**0.5]},
    ]
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    expected = [[10, 0, 0], [10, 2, 0], [8, 0, 0], [8, 2, 0]]
    np.testing.assert_allclose(plant.foliage.positions, expected, atol=1e-6)
    made["nodes"][1] = {"mesh": 0, "matrix": np.diag([2.0, 3, 4, 1]).ravel().tolist()}
    plant = tl.load_plant(made.write(tmp_path / "b.gltf"))
    np.testing.assert_allclose(plant.bounds, [[10, 0, 0], [12, 3, 0]], atol=1e-6)


def test_a_mirrored_mesh_is_wound_the_other_way(tmp_path):
    made = Gltf()
    # normals that lean towards +x
    normals = made.accessor([[0.6, 0, 0.8]] * 4)
    made.primitive(attributes={"NORMAL": normals})
    made["nodes"][0]["scale"] = [-2, 1, 1]
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    np.testing.assert_array_equal(plant.foliage.normals, [[0, 0, 1]])
    # normals go with the inverse transpose: (-0.6 / 2, 0, 0.8), then unit length
    expected = np.array([-0.3, 0, 0.8]) / np.hypot(0.3, 0.8)
    np.testing.assert_allclose(plant.foliage.mesh.normals, [expected] * 4, atol=1e-6)


def test_missing_and_zero_normals_are_smooth(tmp_path):
    #  two squares that meet at right angles along an edge stored twice; the file knows one normal
    made = Gltf()
    positions = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 0, 1], [1, 0, 1], [1, 0, 0], [1, 1, 1],
                 [1, 1, 0]]  # fmt: skip
    triangles = [[0, 1, 2], [1, 3, 2], [5, 4, 7], [4, 6, 7]]
    half = 0.5**0.5
    smooth = [[0, 1, 0], [0, 1, 0], [-half, half, 0], [-half, half, 0]]
    made.primitive(positions, triangles)
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    by_position = dict(
        zip(map(tuple, plant.foliage.positions.tolist()), plant.foliage.mesh.normals, strict=True)
    )
    # at (1, 0, 0) area 1/2 faces up and area 1 faces -x, at (1, 0, 1) the other way round
    expected = {(0, 0, 0): [0, 1, 0], (1, 1, 1): [-1, 0, 0]}
    for position, normal in expected.items():
        np.testing.assert_allclose(by_position[position], normal, atol=1e-7)
    edge = by_position[1, 0, 0] + by_position[1, 0, 1]
    np.testing.assert_allclose(edge / np.linalg.norm(edge), smooth[2], atol=1e-7)
    made = Gltf()
    normals = made.accessor([[0, 0, 1], [0, 0, 0], [0, 0, 5e-200], [0, 0, 1]], "f4")
    made.primitive(attributes={"NORMAL": normals})
    plant = tl.load_plant(made.write(tmp_path / "b.gltf"))
    np.testing.assert_array_equal(plant.foliage.mesh.normals, [[0, 0, 1]] * 4)


def test_strips_and_unindexed_triangles(tmp_path):
    made = quad(mode=5)
    made["accessors"][-1]["count"] = 4  # corners 0 1 2 1: two triangles on one place
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    assert plant.triangle_count == 2
    plant = tl.load_plant(
        quad(positions=[[0, 0, 0], [1, 0, 0], [0, 1, 0]] * 2, triangles=None).write(
            tmp_path / "b.gltf"
        )
    )
    assert plant.triangle_count == 2


@pytest.mark.parametrize("kind", ["translation", "all"])
def test_instances(tmp_path, kind):
    made = quad()
    attributes = {"TRANSLATION": made.accessor([[0, 0, 0], [10, 0, 0], [20, 0, 5]])}
    if kind == "all":
        # turned a half about y as normalised shorts, and doubled
        attributes["ROTATION"] = made.accessor([[0, 32767, 0, 0]] * 3, "i2", normalized=True)
        attributes["SCALE"] = made.accessor([[2, 2, 2]] * 3)
    made["nodes"][0] |= {
        "translation": [0, 100, 0],
        "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}},
    }
    made["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    assert plant.foliage.leaf_count == 3
    at = np.array([[0, 100, 0], [10, 100, 0], [20, 100, 5]])
    middle = [0.5, 0.5, 0] if kind == "translation" else [-1, 1, 0]
    centers = plant.foliage.centers + plant.origin
    np.testing.assert_allclose(centers, at + middle, atol=1e-5)


def test_quantised_positions(tmp_path):
    made = Gltf()
    corners = (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]) * 32767).astype("<i2")
    made.primitive(attributes={"POSITION": made.accessor(corners, "i2", normalized=True)})
    made["extensionsRequired"] = ["KHR_mesh_quantization"]
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    np.testing.assert_array_equal(plant.bounds, [[0, 0, 0], [1, 1, 0]])


def test_interleaved_attributes(tmp_path):
    made = quad()
    rows = np.arange(24, dtype="<f4").reshape(4, 6)
    view = made.view(rows.tobytes())
    made["bufferViews"][view]["byteStride"] = 24
    shared = {"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC3"}
    made["accessors"] += [shared | {"byteOffset": 12}]
    made["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = len(made["accessors"]) - 1
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    np.testing.assert_array_equal(plant.foliage.positions, rows[:, 3:])


def test_points_and_lines_are_ignored_with_a_warning(tmp_path):
    made = quad()
    made.primitive(mode=1)
    with pytest.warns(UserWarning, match=r"points and lines are ignored \(in leaf\)"):
        plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    assert plant.triangle_count == 2


def test_only_the_default_scene_is_loaded(tmp_path):
    made = quad()
    made["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]
    made["scenes"] = [{"nodes": [0]}, {"nodes": [1]}]
    made["scene"] = 1
    plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
    np.testing.assert_array_equal(plant.bounds, [[5, 0, 0], [6, 1, 0]])


def test_alpha_decides_by_the_texels_used(tmp_path):
    # a closed box, so that its shape alone says wood; opaque or cut out by its texture
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    triangles = [[f[0], f[i], f[i + 1]] for f in faces for i in (1, 2)]
    for alphas, mode, is_leaf in [
        ([255, 255], "MASK", False),
        ([255, 0], "MASK", True),
        ([255, 0], "OPAQUE", False),
        ([255, 140], "MASK", False),
        ([255, 0], "BLEND", True),
    ]:
        made = textured([[[9, 9, 9, alpha] for alpha in alphas]], alphaMode=mode)
        made["meshes"][0]["primitives"] = []
        uvs = made.accessor(corners[:, :2])
        made.primitive(corners, triangles, attributes={"TEXCOORD_0": uvs}, material=0)
        plant = tl.load_plant(made.write(tmp_path / "a.gltf"))
        assert (plant.foliage.leaf_count == 1) is is_leaf, (alphas, mode)


def test_extension_lists_are_disjoint():
    assert not gltf_header.READ_EXTENSIONS & gltf_header.HARMLESS_EXTENSIONS


# --- the plant itself ----------------------------------------------------------------------------

SQUARE = {"positions": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
          "triangles": [[0, 1, 2], [0, 2, 3]]}  # fmt: skip


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"occlusion": "x"}, "occlusion must be a number, got 'x'"),
        ({"translucency": None}, "translucency must be a number, got None"),
        ({"sun": 1.0}, "sun must be 3 numbers, got 1.0"),
        ({"sky": (1, 1)}, r"sky must be 3 numbers, got \(1, 1\)"),
        ({"ground": "123"}, "ground must be 3 numbers, got '123'"),
        ({"sun_direction": (0, "1", 0)}, "sun_direction must be 3 numbers"),
    ],
)
def test_light_that_is_no_number_is_refused_at_once(given, message):
    with pytest.raises(TypeError, match=message):
        tl.Lighting(**given)
    tl.Lighting(sun_direction=np.array([0, 1, 0]), occlusion=np.float32(0.5), translucency=1)


def test_lit_gives_another_plant():
    plant = tl.Plant.from_arrays(foliage=SQUARE, leaf_offsets=[0, 2], wood=SQUARE)
    assert plant.lighting == tl.Lighting()
    noon = tl.Lighting(
        sun_direction=(0, 0, 1), sun=(0.5, 0.25, 0), sky=(0, 0, 0), ground=(0, 0, 0),
        translucency=0.25,
    )  # fmt: skip
    lit = plant.lit(noon)
    assert lit.lighting == noon
    np.testing.assert_array_equal(lit.wood.front, [[0.5, 0.25, 0]] * 4)
    np.testing.assert_array_equal(lit.wood.back, 0)
    np.testing.assert_array_equal(lit.foliage.mesh.front, [[0.375, 0.1875, 0]] * 4)
    np.testing.assert_array_equal(lit.foliage.mesh.back, [[0.125, 0.0625, 0]] * 4)
    assert plant.lighting == tl.Lighting()
    with pytest.raises(ValueError, match=r"translucency must be in \[0, 1\], got 1.5"):
        plant.lit(tl.Lighting(translucency=1.5))
    with pytest.raises(ValueError, match="sun must be finite"):
        plant.lit(tl.Lighting(sun=(0, float("nan"), 0)))


def test_default_light_is_loaded(tmp_path):
    path = quad().write(tmp_path / "a.gltf")
    dark = tl.Lighting(sun=(0, 0, 0), sky=(0, 0, 0), ground=(0, 0, 0))
    assert tl.load_plant(path).lighting == tl.Lighting()
    assert tl.load_plant(path).foliage.mesh.front.min() > 0
    assert not tl.load_plant(path, lighting=dark).foliage.mesh.front.any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"positions": [[0, 0]]}, r"positions must have shape \(N, 3\), got \(1, 2\)"),
        ({"positions": [[0, 0, 0], [1, 0, np.nan], [1, 1, 0], [0, 1, 0]]}, "positions must be fin"),
        ({"triangles": [[0, 1, 4], [0, 2, 3]]}, "4 vertices"),
        ({"triangles": [[0, 1, -1]]}, "must be in"),
        ({"triangles": [[0.0, 1, 2]]}, "must be integers"),
        ({"triangles": [0, 1, 2]}, r"must have shape \(N, 3\)"),
        ({"normals": [[0, 0, 1]]}, "normals: has 1 rows for 4 vertices"),
        ({"uvs": [[0, 0, 0]] * 4}, r"uvs must have shape \(N, 2\)"),
        ({"colors": [[1, 1]] * 4}, r"colors must have shape \(N, 4\)"),
        ({"material_ids": [0, 1]}, "material 1 of 1"),
        ({"material_ids": [0]}, "material_ids has 1 rows for 2 triangles"),
        ({"weights": [1]}, r"unknown arrays \['weights'\]"),
    ],
)
def test_arrays_are_checked(changes, message):
    with pytest.raises(ValueError, match=message):
        tl.Plant.from_mesh(SQUARE | changes)
    with pytest.raises(ValueError, match=message):
        tl.Plant.from_arrays(wood=SQUARE | changes)


def test_empty_plants_are_refused():
    with pytest.raises(ValueError, match="plant is empty: it has no triangles"):
        tl.Plant.from_arrays()
    with pytest.raises(ValueError, match="plant is empty"):
        tl.Plant.from_mesh({"positions": np.empty((0, 3)), "triangles": np.empty((0, 3), int)})
    with pytest.raises(ValueError, match="leaf_offsets is required"):
        tl.Plant.from_arrays(foliage=SQUARE)
    with pytest.raises(ValueError, match="leaf_offsets: must rise from 0 to the triangle count 2"):
        tl.Plant.from_arrays(foliage=SQUARE, leaf_offsets=[0, 1])


@pytest.mark.parametrize("layout", ["f8", ">f4", "fortran", "reversed", "read-only"])
def test_any_layout_gives_the_same(layout):
    positions = np.array(SQUARE["positions"], np.float32)
    given = {
        "f8": positions.astype(np.float64),
        ">f4": positions.astype(">f4"),
        "fortran": np.asfortranarray(positions),
        "reversed": positions[::-1].copy()[::-1],
        "read-only": positions.copy(),
    }[layout]
    given.flags.writeable = layout != "read-only"
    plant = tl.Plant.from_mesh(SQUARE | {"positions": given})
    np.testing.assert_array_equal(plant.foliage.positions, positions)


def test_materials_share_a_texture_and_come_back():
    texels = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)
    material = tl.Material(
        name="a", texture=texels, wrap=("mirror", "clamp"), alpha_mode="mask", alpha_cutoff=0.25,
        double_sided=False,
    )  # fmt: skip
    (back,) = tl.Plant.from_mesh(SQUARE, materials=[material]).materials
    np.testing.assert_array_equal(back.texture, texels)
    for name in ("name", "wrap", "alpha_mode", "alpha_cutoff", "double_sided"):
        assert getattr(back, name) == getattr(material, name)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"texture": np.zeros((1, 1, 3), np.uint8)}, r"texture must have shape \(H, W, 4\)"),
        ({"texture": np.zeros((0, 1, 4), np.uint8)}, "texture must be in"),
        ({"wrap": ("repeat", "tile")}, "wrap: must be 'repeat', 'mirror' or 'clamp'"),
        ({"alpha_mode": "cutout"}, "alpha_mode must be"),
        ({"alpha_mode": "mask", "alpha_cutoff": -1.0}, "alpha_cutoff must be in"),
    ],
)
def test_materials_are_checked(changes, message):
    with pytest.raises(ValueError, match=message):
        tl.Plant.from_mesh(SQUARE, materials=[tl.Material(name="a", **changes)])


@transmission
def test_summary_says_what_and_why(models):
    text = tl.load_plant(models / "khronos_vase_flowers/GlassVaseFlowers.gltf").summary()
    assert text.startswith("GlassVaseFlowers: 14,036 triangles, 0.2173 x 0.2032 x 0.1425 m")
    assert "70 leaves, 7,636 triangles" in text
    rows = [line.split() for line in text.split("\n")[3:]]
    assert [row[:2] for row in rows] == [
        ["Flowers", "foliage"], ["Flowers", "foliage"], ["Flowers", "foliage"],
        ["GlassAlpha", "wood"], ["GlassTransmission", "wood"],
    ]  # fmt: skip
    assert "open sheets; mask at 0.5, texture 1024 x 1024" in text


def test_summary_of_a_plant_from_arrays():
    text = tl.Plant.from_arrays(wood=SQUARE, name="post").summary()
    assert text.split("\n") == [
        "post: 2 triangles, 1 x 1 x 0 m (x, y, z)",
        "  foliage: 0 leaves, 0 triangles",
        "  wood: 2 triangles",
    ]


def test_lit_keeps_the_summary(tmp_path):
    plant = tl.load_plant(two_named(tmp_path))
    assert plant.lit(tl.Lighting(translucency=0)).summary() == plant.summary()


def test_a_million_leaves():
    # takes 2.6 s on two cores; the limit is for a slow machine with other work to do
    leaf_count = 1_000_000
    rng = np.random.default_rng(7)
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * 0.02
    positions = rng.uniform(-5, 5, (leaf_count, 1, 3)) + corners
    triangles = 4 * np.arange(leaf_count)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    mesh = {"positions": positions.reshape(-1, 3), "triangles": triangles.reshape(-1, 3)}
    plant = tl.Plant.from_mesh(mesh)
    assert plant.foliage.leaf_count == leaf_count
    assert len(json.dumps(plant.summary())) < 1000
