"""Plant files made to do harm, or simply broken: a named exception, soon, and nothing else."""

import json
import os
import struct
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

import treelod as tl
from made_gltf import Gltf, huge_png, png, quad, textured
from treelod.errors import LimitError, PlantFileError

LIMIT_SECS = 1.0
SECRET = b"what lies outside the folder"


def refuses(path, message, error=PlantFileError):
    """Loading raises `error`, its message names the file and the thing, within a second."""
    start = time.perf_counter()
    with pytest.raises(error, match=message or None) as caught:
        tl.load_plant(path)
    assert time.perf_counter() - start < LIMIT_SECS
    assert str(caught.value).startswith(f"{path}: ")


def written(tmp_path, made, name="a.gltf"):
    return made.write(tmp_path / name)


# --- files ---------------------------------------------------------------------------------------


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"missing\.glb"):
        tl.load_plant(tmp_path / "missing.glb")


def test_a_folder(tmp_path):
    (tmp_path / "a.glb").mkdir()
    refuses(tmp_path / "a.glb", "not a file")


def test_a_pipe_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "a.glb")
    refuses(tmp_path / "a.glb", "not a file")


@pytest.mark.parametrize("name", ["a.fbx", "a", "a.gltf.zip"])
def test_unknown_suffix(tmp_path, name):
    (tmp_path / name).write_bytes(b"whatever")
    refuses(tmp_path / name, r"are not read, only \.glb, \.gltf, \.obj, \.ply")


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".obj", ".ply"])
@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 100, b"\x89PNG\r\n\x1a\n" + b"\0" * 50, b"<html></html>", b"{}", b"[1]",
     b"\xff" * 999,      b"glTF", b"ply\n", b"v 0 0\n"],
)  # fmt: skip
def test_foreign_bytes(tmp_path, suffix, data):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data)
    refuses(path, "")


def test_every_cut_of_a_glb(tmp_path):
    whole = textured([[[1, 2, 3]]]).glb()
    path = tmp_path / "a.glb"
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        refuses(path, "")
    path.write_bytes(whole)
    assert tl.load_plant(path).triangle_count == 2


def test_every_cut_of_a_binary_ply(tmp_path):
    mesh = trimesh.creation.box()
    whole = mesh.export(file_type="ply")
    path = tmp_path / "a.ply"
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        refuses(path, "")


def test_every_damaged_byte_of_a_header(tmp_path):
    # any one byte changed: loads or is refused, but never crashes and never takes long
    whole = bytearray(textured([[[1, 2, 3]]]).glb())
    path = tmp_path / "a.glb"
    json_length = struct.unpack_from("<I", whole, 12)[0]
    rng = np.random.default_rng(3)
    outcomes = set()
    for position in rng.choice(20 + json_length, 400, replace=False):
        damaged = whole.copy()
        damaged[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        start = time.perf_counter()
        try:
            tl.load_plant(path)
            outcomes.add("loaded")
        except PlantFileError:
            outcomes.add("refused")
        assert time.perf_counter() - start < LIMIT_SECS
    assert outcomes == {"loaded", "refused"}


# --- glTF: structure -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"asset": {"version": "2.0"}', "JSONDecodeError"),
        ("[" * 100_000, "RecursionError|JSONDecodeError"),
        ('{"asset": {"version": "1.0"}}', "glTF version 1.0; only version 2 is read"),
        ('{"asset": 2}', "no asset"),
        ('{"asset": {"version": "2.0"}}', "no triangles"),
        ('{"asset": {"version": "2.0"}, "nodes": 3}', "nodes is not a list"),
        ('{"asset": {"version": "2.0"}, "scenes": [{"nodes": ["a"]}]}', "node index is 'a'"),
        ('{"asset": {"version": "2.0"}, "scenes": [{"nodes": [7]}]}', "node index 7, but there"),
        ('{"asset": {"version": "2.0"}, "scene": 1, "scenes": [{}]}', "scenes index 1"),
        ('{"asset": {"version": "2.0"}, "x": NaN}', "NaN in the JSON is no number"),
    ],
)  # fmt: skip
def test_bad_json(tmp_path, text, message):
    path = tmp_path / "a.gltf"
    path.write_text(text)
    refuses(path, message)


def change(made, path, value):
    """Set a value deep in the header, by keys and indices."""
    *parents, last = path
    target = made.header
    for key in parents:
        target = target[key]
    target[last] = value
    return made


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["nodes", 0, "mesh"], 1, "node 0: mesh index 1, but there are 1"),
        (["nodes", 0, "mesh"], -1, "mesh index is -1"),
        (["nodes", 0, "mesh"], True, "mesh index is True"),
        (["nodes", 0, "matrix"], [1, 2], "matrix is .*, not 16 numbers"),
        (["nodes", 0, "translation"], [0, "1", 0], "translation is .*, not 3 numbers"),
        (["nodes", 0, "scale"], [1e999, 1, 1], "Infinity|not finite"),
        (["nodes", 0, "rotation"], [0, 0, 0, 0], "a rotation of length 0"),
        (["nodes", 0, "scale"], [1e308, 1e308, 1e308], "a coordinate lies beyond 1e\\+12"),
        (["meshes", 0, "primitives"], [], "has no primitives"),
        (["meshes", 0, "primitives", 0, "attributes"], {}, "has no positions"),
        (["meshes", 0, "primitives", 0, "mode"], 6, "triangle fan, which is not read"),
        (["meshes", 0, "primitives", 0, "mode"], 9, "mode 9"),
        (["meshes", 0, "primitives", 0, "material"], 0, "material index 0, but there are 0"),
        (["meshes", 0, "primitives", 0, "indices"], 99, "accessors index 99, but there are 2"),
        (["meshes", 0, "primitives", 0, "indices"], 0, "its accessor is VEC3"),
        (["meshes", 0, "primitives", 0, "attributes", "POSITION"], 1, "its accessor is SCALAR"),
        (["meshes", 0, "primitives", 0, "attributes", "NORMAL"], 99, "NORMAL: accessors index 99"),
        (["accessors", 0, "type"], "MAT4", "its accessor is MAT4"),
        (["accessors", 0, "componentType"], 5124, "its accessor is VEC3 of 5124"),
        (["accessors", 0, "count"], 5, "values end at byte 60 of a buffer view of 48 bytes"),
        (["accessors", 0, "count"], 2**62, "values end at byte"),
        (["accessors", 0, "count"], 0, "count is 0"),
        (["accessors", 0, "byteOffset"], 4, "values end at byte 52"),
        (["accessors", 0, "byteOffset"], -12, "byteOffset is -12"),
        (["accessors", 0, "bufferView"], 9, "bufferViews index 9"),
        (["accessors", 0, "sparse"], {"count": 1}, "sparse or empty accessor"),
        (["accessors", 1, "componentType"], 5122, "its indices are no unsigned integers"),
        (["accessors", 1, "count"], 5, "5 corners make no whole triangles"),
        (["bufferViews", 0, "byteStride"], 4, "byteStride is 4"),
        (["bufferViews", 0, "byteStride"], 2**40, "values end at byte"),
        (["bufferViews", 0, "byteOffset"], 2**40, "of a buffer of 60 bytes"),
        (["bufferViews", 0, "byteLength"], 2**40, "of a buffer of 60 bytes"),
        (["bufferViews", 0, "byteLength"], -5, "byteLength is -5"),
        (["bufferViews", 0, "buffer"], 1, "buffer index 1"),
        (["buffers", 0, "byteLength"], 61, "buffer 0 is cut short: 60 of 61 bytes"),
        (["buffers", 0, "uri"], 5, "the URI of buffer 0 is no text"),
        (["buffers", 0, "uri"], "data:,abc", "not base64"),
        (["buffers", 0, "uri"], "data:;base64,a~b", "is damaged"),
        (["extensionsRequired"], ["VENDOR_secret"], "it requires VENDOR_secret, which is not read"),
        (["extensionsRequired"], ["KHR_draco_mesh_compression"], "it requires KHR_draco"),
        (["extensionsRequired"], ["EXT_meshopt_compression"], "it requires EXT_meshopt"),
        (["extensionsRequired"], ["KHR_texture_basisu"], "it requires KHR_texture_basisu"),
        (["extensionsRequired"], 3, "extensionsRequired is not a list"),
    ],
)
def test_bad_header(tmp_path, path, value, message):
    refuses(written(tmp_path, change(quad(), path, value)), message)


def test_required_extensions_that_change_nothing(tmp_path):
    made = quad()
    made["extensionsRequired"] = ["KHR_materials_unlit", "KHR_materials_clearcoat"]
    assert tl.load_plant(written(tmp_path, made)).triangle_count == 2


def test_index_out_of_range(tmp_path):
    refuses(
        written(tmp_path, quad(triangles=[[0, 1, 4], [0, 1, 2]])),
        "mesh 'leaf': vertex index 4, but it has 4 vertices",
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_positions_that_are_not_finite(tmp_path, value):
    positions = [[0, 0, 0], [1, 0, 0], [0, value, 0], [1, 1, 0]]
    refuses(written(tmp_path, quad(positions=positions)), "the position of vertex 2 is not finite")


@pytest.mark.parametrize(
    ("attribute", "width", "thing"),
    [("NORMAL", 3, "normal"), ("TEXCOORD_0", 2, "texture coordinate"), ("COLOR_0", 3, "colour")],
)
def test_attributes_that_are_not_finite(tmp_path, attribute, width, thing):
    made = Gltf()
    values = np.zeros((4, width))
    values[3, 1] = np.nan
    made.primitive(attributes={attribute: made.accessor(values)})
    refuses(written(tmp_path, made), f"the {thing} of vertex 3 is not finite")


def test_attributes_of_different_length(tmp_path):
    made = Gltf()
    made.primitive(attributes={"TEXCOORD_0": made.accessor(np.zeros((3, 2)))})
    refuses(written(tmp_path, made), r"different lengths \[3, 4\]")


@pytest.mark.parametrize(
    "nodes",
    [
        [{"mesh": 0, "children": [0]}],
        [{"children": [1]}, {"mesh": 0, "children": [0]}],
        [{"children": [1, 1]}, {"mesh": 0}],
        [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}],
    ],
)
def test_nodes_that_are_no_tree(tmp_path, nodes):
    made = quad()
    made["nodes"] = nodes
    refuses(written(tmp_path, made), "reached twice")


def test_a_tower_of_doubling_nodes(tmp_path):
    # 2**60 leaves if every path counted
    made = quad()
    made["nodes"] = [{"children": [i + 1, i + 1]} for i in range(60)] + [{"mesh": 0}]
    refuses(written(tmp_path, made), "reached twice")


def test_deep_nodes(tmp_path):
    made = quad()
    made["nodes"] = [{"children": [i + 1]} for i in range(10_000)] + [{"mesh": 0}]
    refuses(written(tmp_path, made), "nested more than 256 deep")
    made["nodes"] = [{"children": [i + 1]} for i in range(255)] + [{"mesh": 0}]
    assert tl.load_plant(written(tmp_path, made)).triangle_count == 2


def test_too_many_instances(tmp_path):
    # a few kilobytes that ask for 2 * 70,000 * 300 triangles
    made = quad()
    made["nodes"] = [{"children": list(range(1, 301))}]
    shifts = made.accessor(np.zeros((70_000, 3)))
    instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": shifts}}}
    made["nodes"] += [{"mesh": 0, "extensions": instances}] * 300
    refuses(written(tmp_path, made), "42000000 triangles, the limit is 33554432", LimitError)


def test_too_many_vertices(tmp_path):
    # one triangle each, but of 2000 vertices
    made = quad(positions=np.zeros((2000, 3)), triangles=[[0, 1, 2]])
    attributes = {"TRANSLATION": made.accessor(np.zeros((70_000, 3)))}
    made["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    refuses(written(tmp_path, made), "140000000 vertices, the limit is 100663296", LimitError)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("ROTATION", [[0, 0, 0, 0]], "a rotation of length 0"),
        ("TRANSLATION", [[0, np.nan, 0]], "not finite"),
        ("SCALE", [[1, 1]], "its accessor is VEC2"),
    ],
)
def test_bad_instances(tmp_path, name, values, message):
    made = quad()
    attributes = {name: made.accessor(values)}
    made["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    refuses(written(tmp_path, made), message)


def test_zero_triangles(tmp_path):
    made = Gltf()
    refuses(written(tmp_path, change(made, ["nodes", 0], {})), "it holds no triangles")
    made = Gltf()
    made.primitive(mode=0)
    refuses(written(tmp_path, made), "it holds no triangles")
    made = quad(mode=5)
    made["accessors"][1]["count"] = 2
    refuses(written(tmp_path, made), "it holds no triangles")


# --- what a file refers to -----------------------------------------------------------------------


@pytest.fixture
def inside(tmp_path):
    """A folder with a file beside it that nothing in the folder may read."""
    (tmp_path / "secret.bin").write_bytes(SECRET)
    folder = tmp_path / "inside"
    folder.mkdir()
    return folder


def escapes(tmp_path):
    secret = tmp_path / "secret.bin"
    return {
        "up": "../secret.bin",
        "percent": "%2e%2e/secret.bin",
        "percent slash": "..%2Fsecret.bin",
        "down and up": "a/../../secret.bin",
        "up and down again": "../inside/a.gltf",
        "backslash": "..\\secret.bin",
        "absolute": str(secret),
        "percent absolute": str(secret).replace("/", "%2F"),
        "file": f"file://{secret}",
        "file in capitals": f"FILE://{secret}",
        "http": "http://127.0.0.1:9/secret.bin",
        "https": "https://127.0.0.1:9/secret.bin",
        "drive": "C:\\secret.bin",
        "host": "//127.0.0.1/secret.bin",
        "zero": "secret.bin%00.png",
        "link": "link.bin",
        "linked folder": "linked/secret.bin",
    }


KINDS = sorted(escapes(Path("/")))


@pytest.mark.parametrize("kind", KINDS)
def test_buffers_stay_in_the_folder(inside, kind):
    (inside / "link.bin").symlink_to(inside.parent / "secret.bin")
    (inside / "linked").symlink_to(inside.parent)
    uri = escapes(inside.parent)[kind]
    made = change(quad(), ["buffers", 0], {"uri": uri, "byteLength": 60})
    refuses(written(inside, made), "buffer 0 refers to .*; only relative paths below")


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_stay_in_the_folder(inside, kind):
    (inside / "link.bin").symlink_to(inside.parent / "secret.bin")
    (inside / "linked").symlink_to(inside.parent)
    made = change(textured([[[1, 2, 3]]]), ["images", 0], {"uri": escapes(inside.parent)[kind]})
    refuses(written(inside, made), "image 0 refers to .*; only relative paths below")


PLAIN = [kind for kind in KINDS if not kind.startswith("percent") and kind != "zero"]


@pytest.mark.parametrize("kind", PLAIN)
@pytest.mark.parametrize("where", ["mtllib", "map_Kd", "map_d", "TextureFile"])
def test_obj_and_ply_stay_in_the_folder(inside, kind, where):
    (inside / "link.bin").symlink_to(inside.parent / "secret.bin")
    (inside / "linked").symlink_to(inside.parent)
    name = escapes(inside.parent)[kind]
    if where == "TextureFile":
        path = inside / "a.ply"
        path.write_text(PLY.replace("ascii 1.0\n", f"ascii 1.0\ncomment TextureFile {name}\n"))
    else:
        path = inside / "a.obj"
        library = name if where == "mtllib" else "a.mtl"
        (inside / "a.mtl").write_text(f"newmtl m\n{where} {name}\n")
        path.write_text(f"mtllib {library}\nusemtl m\n{OBJ}")
    refuses(path, "refers to .*; only relative paths below")


def test_a_link_inside_the_folder_is_fine(inside):
    (inside / "real.bin").write_bytes(quad().blob)
    (inside / "link.bin").symlink_to("real.bin")
    made = change(quad(), ["buffers", 0], {"uri": "link.bin", "byteLength": 60})
    assert tl.load_plant(written(inside, made)).triangle_count == 2


@pytest.mark.parametrize("name", ["missing.bin", "%252e%252e/secret.bin", ".", ""])
def test_missing_buffer(inside, name):
    made = change(quad(), ["buffers", 0], {"uri": name, "byteLength": 60})
    refuses(
        written(inside, made), "buffer 0 refers to .*, which does not exist|only relative paths"
    )


# --- pictures ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("width", "height"), [(16385, 1), (1, 16385), (8193, 8193), (30_000, 30_000), (2**31 - 1, 2)]
)
def test_picture_bombs(tmp_path, width, height):
    resource = pytest.importorskip("resource")
    made = textured([[[1, 2, 3]]])
    made["images"] = [{"bufferView": made.view(huge_png(width, height))}]
    path = written(tmp_path, made)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refuses(path, f"image 0 is {width} x {height}; the limit is|image 0 is too large")
    # in KiB; the smallest of them would be 64 MiB of texels, the rest 256 MiB and up
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


def test_the_largest_side_is_accepted(tmp_path):
    plant = tl.load_plant(written(tmp_path, textured(np.zeros((1, 16384, 3)))))
    assert plant.materials[0].texture.shape == (1, 16384, 4)


@pytest.mark.parametrize("length", [0, 20, 45])
def test_damaged_pictures(tmp_path, length):
    made = textured([[[1, 2, 3]]])
    made["images"] = [{"uri": "a.png"}]
    (tmp_path / "a.png").write_bytes(png([[[1, 2, 3]]])[:length])
    refuses(written(tmp_path, made), "image 0 is damaged, or no PNG")


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["textures", 0, "source"], 5, "image index 5"),
        (
            ["textures", 0],
            {"extensions": {"KHR_texture_basisu": {"source": 0}}},
            "KHR_texture_basi",
        ),
        (["textures", 0], {}, "no picture"),
        (["textures", 0, "sampler"], 0, "samplers index 0"),
        (["materials", 0, "alphaMode"], "CUT", "material 'green': alphaMode 'CUT'"),
        (["materials", 0, "alphaCutoff"], "a", "alphaCutoff"),
        (["materials", 0, "alphaCutoff"], -1, "alphaCutoff -1.0 is below 0"),
        (["materials", 0, "pbrMetallicRoughness", "baseColorFactor"], [1, 1], "base colour"),
        (["materials", 0, "pbrMetallicRoughness", "baseColorTexture"], 3, "is not an object"),
        (["materials", 0, "pbrMetallicRoughness"], 3, "is not an object"),
        (["images", 0], {}, "the URI of image 0 is no text"),
        (["images", 0, "bufferView"], 77, "bufferViews index 77"),
    ],
)
def test_bad_materials(tmp_path, path, value, message):
    refuses(written(tmp_path, change(textured([[[1, 2, 3]]]), path, value)), message)


def test_wrap_mode_is_checked(tmp_path):
    made = textured([[[1, 2, 3]]])
    made["samplers"] = [{"wrapS": 5}]
    made["textures"][0]["sampler"] = 0
    refuses(written(tmp_path, made), "wrap mode 5")


def test_webp_and_a_basis_fallback_are_read(tmp_path):
    from PIL import Image

    Image.new("RGB", (3, 2), (9, 9, 9)).save(tmp_path / "a.webp", lossless=True)
    made = textured([[[1, 2, 3]]])
    made["images"].append({"uri": "a.webp"})
    made["textures"][0] = {"extensions": {"EXT_texture_webp": {"source": 1}}}
    texture = tl.load_plant(written(tmp_path, made)).materials[0].texture
    assert texture.tolist() == [[[9, 9, 9, 255]] * 3] * 2
    made["textures"][0] = {"source": 0, "extensions": {"KHR_texture_basisu": {"source": 1}}}
    texture = tl.load_plant(written(tmp_path, made)).materials[0].texture
    assert texture.tolist() == [[[1, 2, 3, 255]]]


@pytest.mark.parametrize(
    ("mode", "color", "expected"),
    [("L", 7, [7, 7, 7, 255]), ("LA", (7, 9), [7, 7, 7, 9]), ("1", 1, [255, 255, 255, 255]),
     ("I;16", 0x1234, [0x12, 0x12, 0x12, 255]), ("RGBA", (1, 2, 3, 4), [1, 2, 3, 4])],
)  # fmt: skip
def test_kinds_of_png(tmp_path, mode, color, expected):
    from PIL import Image

    Image.new(mode, (1, 1), color).save(tmp_path / "a.png")
    made = change(textured([[[1, 2, 3]]]), ["images", 0], {"uri": "a.png"})
    assert tl.load_plant(written(tmp_path, made)).materials[0].texture.tolist() == [[expected]]


def test_a_palette_with_transparency(tmp_path):
    from PIL import Image

    picture = Image.new("P", (2, 1))
    picture.putpalette([10, 20, 30, 40, 50, 60])
    picture.putpixel((1, 0), 1)
    picture.save(tmp_path / "a.png", transparency=bytes([0, 128]))
    made = change(textured([[[1, 2, 3]]]), ["images", 0], {"uri": "a.png"})
    texture = tl.load_plant(written(tmp_path, made)).materials[0].texture
    assert texture.tolist() == [[[10, 20, 30, 0], [40, 50, 60, 128]]]


# --- OBJ -----------------------------------------------------------------------------------------

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing\n", "it holds no triangles"),
        ("v 0 0 0\n", "it holds no triangles"),
        ("v 0 0 0\nv 1 0 0\nl 1 2\n", "it holds no triangles"),
        (OBJ + "f 1 2 4\n", "a face refers to v 4, but there are 3"),
        (OBJ + "f 0 1 2\n", "a face refers to v 0"),
        (OBJ + "f -4 -3 -2\n", "there is no v -4"),
        (OBJ + "f 1/1 2/1 3/2\n", "a face refers to vt 2"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/2\n", "a face refers to vt 2"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//9 3//1\n", "a face refers to vn 9"),
        (OBJ + "f 1//1 2//1 3//7\n", "a face refers to vn 7"),
        (OBJ + "f 1 2\n", "a face has 2 corners"),
        (OBJ + "f\n", "a face has 0 corners"),
        (OBJ + "f a b c\n", "ValueError"),
        (OBJ + "f 1 2 99999999999999999999\n", r"a face refers to v \d{19}"),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "the position of vertex 0 is not finite"),
        ("v 0 0 1e999\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "is not finite"),
        ("v 0 0 x\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", ""),
        ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", ""),
        ("mtllib lost.mtl\n" + OBJ, "mtllib refers to 'lost.mtl', which does not exist"),
    ],
)
def test_bad_obj(tmp_path, text, message):
    path = tmp_path / "a.obj"
    path.write_text(text)
    refuses(path, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Kd 0.5 red 0", r"material 'm': red where a number in \[0, 1\] is due"),
        ("Kd 0.5 0.5", "nothing where a number"),
        ("Kd 0.5 0.5 7", "7 where a number"),
        ("d nan", "nan where a number"),
        ("d", "nothing where a number"),
        ("map_Kd", "a map without a file"),
        ("map_Kd -clamp on", "a map without a file"),
        ("map_Kd -secret on a.png", "unknown map option -secret"),
        ("map_Kd lost.png", "'lost.png', which does not exist"),
        ("map_d lost.png", "'lost.png', which does not exist"),
        ("map_Kd a.mtl", "the map_Kd of material 'm' is damaged"),
    ],
)
def test_bad_mtl(tmp_path, text, message):
    (tmp_path / "a.mtl").write_text(f"newmtl m\n{text}\n")
    path = tmp_path / "a.obj"
    path.write_text(f"mtllib a.mtl\nusemtl m\n{OBJ}")
    refuses(path, message)


# --- PLY -----------------------------------------------------------------------------------------

PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)


def test_the_ply_itself_is_right(tmp_path):
    path = tmp_path / "a.ply"
    path.write_text(PLY)
    assert tl.load_plant(path).triangle_count == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("end_header", "header_end", "does not end"),
        ("element vertex 3", "element vertex 4000000000", "cut short: it states 4000000001"),
        ("element vertex 3", "element vertex -3", "its header says"),
        ("element vertex 3", "element vertex", "its header says"),
        ("element face 1", "element face 2", "cut short: it states 2 elements 'face'"),
        ("element face 1", "element face 0", "it holds no triangles"),
        ("element face 1", "element edge 1\nelement face 1", "edges are not read"),
        ("property float x", "property quad x", ""),
        ("property float x\n", "", ""),
        ("3 0 1 2\n", "3 0 1 3\n", "vertex index 3, but it has 3 vertices"),
        ("3 0 1 2\n", "3 0 1 -1\n", "vertex index -1"),
        ("3 0 1 2\n", "", "cut short|damaged"),
        ("3 0 1 2\n", "2 0 1\n", ""),
        ("0 1 0\n", "0 nan 0\n", "the position of vertex 2 is not finite"),
        ("0 1 0\n", "0 one 0\n", ""),
        ("ascii 1.0\n", "ascii 1.0\ncomment TextureFile lost.png\n", "which does not exist"),
        ("format ascii", "format binary_little_endian", ""),
    ],
)
def test_bad_ply(tmp_path, old, new, message):
    assert old in PLY
    path = tmp_path / "a.ply"
    path.write_text(PLY.replace(old, new))
    refuses(path, message)


def test_nothing_is_written(tmp_path):
    written(tmp_path, change(quad(), ["nodes", 0, "mesh"], 7))
    with pytest.raises(PlantFileError):
        tl.load_plant(tmp_path / "a.gltf")
    assert [path.name for path in tmp_path.iterdir()] == ["a.gltf"]
    assert json.loads((tmp_path / "a.gltf").read_text())["nodes"] == [{"mesh": 7}]
