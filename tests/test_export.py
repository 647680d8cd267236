"""Does a written plant come back as it was, in a program that knows nothing of this one?"""

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from treelod import Material, Plant
from treelod.export import plant_glb

#   2 - 3
#   | / |     two leaves: the quad below, and one triangle
#   0 - 1
QUAD = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
TEXTURE = np.array(
    [[[255, 0, 0, 255], [0, 255, 0, 0]], [[0, 0, 255, 128], [9, 8, 7, 255]]], np.uint8
)


def plant(**changes):
    fields = {
        "wood": {"positions": [[0, 0, 0], [0, -1, 0], [0.1, 0, 0]], "triangles": [[0, 1, 2]]},
        "foliage": {
            "positions": QUAD,
            "triangles": [[0, 1, 3], [0, 3, 2], [0, 1, 2]],
            "uvs": [[0, 1], [1, 1], [0, 0], [12.5, 0]],
            "colors": [[0.1, 0.7, 0.3, 1.0]] * 4,
            "material_ids": [1, 1, 0],
        },
        "leaf_offsets": [0, 2, 3],
        "materials": [
            Material(name="bark"),
            Material(
                name="leaf",
                texture=TEXTURE,
                wrap=("mirror", "clamp"),
                alpha_mode="mask",
                alpha_cutoff=0.25,
            ),
        ],
        "name": "sapling",
    }
    return Plant.from_arrays(**(fields | changes))


def parts_of(data):
    """Split a GLB by the specification, without a library."""
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    document = json.loads(data[20 : 20 + size])
    binary_size, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0"
    assert 28 + size + binary_size == len(data)
    assert size % 4 == 0
    assert binary_size % 4 == 0
    return document, data[28 + size :]


def array(document, binary, accessor):
    accessor = document["accessors"][accessor]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    start = view["byteOffset"]
    assert start % 4 == 0
    values = np.frombuffer(binary[start : start + view["byteLength"]], dtype)
    assert len(values) == accessor["count"] * width
    return values.reshape(-1, width)


def test_every_number_is_in_the_file_as_it_was():
    made = plant()
    document, binary = parts_of(plant_glb(made))
    assert [node["name"] for node in document["nodes"]] == ["wood", "foliage"]
    assert document["scenes"][0]["nodes"] == [0, 1]
    first, second = document["meshes"][1]["primitives"]
    mesh = made.foliage.mesh
    for name, values in (
        ("POSITION", mesh.positions),
        ("NORMAL", mesh.normals),
        ("TEXCOORD_0", mesh.uvs),
        ("COLOR_0", mesh.base),
    ):
        got = array(document, binary, first["attributes"][name])
        np.testing.assert_array_equal(got, values)
    assert array(document, binary, first["indices"]).ravel().tolist() == [0, 1, 2]
    assert array(document, binary, second["indices"]).ravel().tolist() == [0, 1, 3, 0, 3, 2]
    assert [first["material"], second["material"]] == [0, 1]
    bounds = document["accessors"][first["attributes"]["POSITION"]]
    assert (bounds["min"], bounds["max"]) == ([0, 0, 0], [1, 1, 0])


def test_materials():
    document, binary = parts_of(plant_glb(plant()))
    bark, leaf = document["materials"]
    assert (bark["name"], bark["alphaMode"]) == ("bark", "OPAQUE")
    assert "alphaCutoff" not in bark
    assert (leaf["alphaMode"], leaf["alphaCutoff"]) == ("MASK", 0.25)
    texture = document["textures"][leaf["pbrMetallicRoughness"]["baseColorTexture"]["index"]]
    sampler = document["samplers"][texture["sampler"]]
    assert (sampler["wrapS"], sampler["wrapT"]) == (33648, 33071)
    view = document["bufferViews"][document["images"][texture["source"]]["bufferView"]]
    raw = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(raw))), TEXTURE)


def test_trimesh_reads_it():
    scene = trimesh.load_scene(io.BytesIO(plant_glb(plant())), file_type="glb", process=False)
    triangles = sum(len(mesh.faces) for mesh in scene.geometry.values())
    assert triangles == 4
    np.testing.assert_allclose(scene.bounds, [[0, -1, 0], [1, 1, 0]])
    areas = sorted(mesh.area for mesh in scene.geometry.values())
    assert areas == pytest.approx([0.05, 0.5, 1.0])


def test_place_in_the_world_is_kept():
    scene = trimesh.load_scene(
        io.BytesIO(plant_glb(plant(origin=(1e6, 0.0, -3.0)))), file_type="glb", process=False
    )
    np.testing.assert_allclose(scene.bounds, [[1e6, -1, -3], [1e6 + 1, 1, -3]], rtol=0, atol=1e-6)


def test_unknown_normals_get_the_length_that_the_format_demands():
    flat = {"positions": QUAD, "triangles": [[0, 0, 1]], "normals": np.zeros((4, 3))}
    document, binary = parts_of(plant_glb(plant(wood=flat)))
    normals = array(
        document, binary, document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    )
    np.testing.assert_array_equal(np.linalg.norm(normals, axis=1), 1.0)


def test_parts_without_triangles_are_left_out():
    document, _ = parts_of(plant_glb(plant(foliage=None, leaf_offsets=None)))
    assert [node["name"] for node in document["nodes"]] == ["wood"]
