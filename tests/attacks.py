"""
Plant files that mean harm, made by code: a file, or a few, for each way in which one can.

An attack is a function that writes into an empty folder and returns the file to load; `ATTACKS` has
for each the exception that must come and what its message must name. `BOMBS` are small files that
ask for much memory, or long work.
"""

import io
import os
import struct
import zlib
from typing import NamedTuple

import numpy as np
from PIL import Image

from made_gltf import POSITIONS, Gltf, huge_png, png, quad, textured
from treelod.errors import LimitError, PlantFileError

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n"

PLY = (
    "ply\nformat {format} 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list {count} int vertex_indices\nend_header\n"
)

ASCII_PLY = PLY.format(format="ascii", count="uchar")


class Attack(NamedTuple):
    """How to write it, and what must come of it."""

    write: object
    message: str
    error: type = PlantFileError


def gltf(made, **changes):
    """Writer of a glTF text, some of whose top-level keys are replaced."""

    def write(folder):
        for key, value in changes.items():
            made[key] = value
        return made.write(folder / "a.gltf")

    return write


def text(name, content, **others):
    """Writer of a text, and of others beside it by stem: an MTL each."""

    def write(folder):
        for stem, other in others.items():
            (folder / f"{stem}.mtl").write_text(other)
        (folder / name).write_text(content)
        return folder / name

    return write


def glb(change):
    """Writer of a GLB whose bytes are changed."""

    def write(folder):
        data = bytearray(textured([[[1, 2, 3]]]).glb())
        change(data)
        (folder / "a.glb").write_bytes(data)
        return folder / "a.glb"

    return write


def picture(data):
    """Writer of a plant whose picture is a file of these bytes."""

    def write(folder):
        (folder / "a.bin").write_bytes(data)
        made = textured([[[1, 2, 3]]])
        made["images"] = [{"uri": "a.bin"}]
        return made.write(folder / "a.gltf")

    return write


def moved(*translation):
    """Writer of a quad that a node moves."""
    return gltf(quad(), nodes=[{"mesh": 0, "translation": translation}])


def buffer_at(uri):
    """Writer of a quad whose buffer lies somewhere else."""
    return gltf(quad(), buffers=[{"uri": uri, "byteLength": 60}])


def link(target):
    """Writer of a plant whose buffer is a link to somewhere."""

    def write(folder):
        (folder / "a.bin").symlink_to(target)
        made = quad()
        made["buffers"] = [{"uri": "a.bin", "byteLength": 60}]
        return made.write(folder / "a.gltf")

    return write


def pipe(folder):
    os.mkfifo(folder / "a.bin")
    made = quad()
    made["buffers"] = [{"uri": "a.bin", "byteLength": 60}]
    return made.write(folder / "a.gltf")


def torn(folder):
    """Two writers at once: the head of one file, the tail of another."""
    first, second = quad().glb(), textured(np.zeros((9, 9, 3))).glb()
    (folder / "a.glb").write_bytes(first[: len(first) // 2] + second[len(first) // 2 :])
    return folder / "a.glb"


# --- bombs ---------------------------------------------------------------------------------------


def stating(kind, width, height):
    """A tiny picture of a format whose header states another size."""
    stream = io.BytesIO()
    Image.new("L", (16, 16)).save(stream, kind)
    data = bytearray(stream.getvalue())
    if kind == "JPEG":
        at = data.index(b"\xff\xc0")
        data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    elif kind == "BMP":
        data[18:26] = struct.pack("<ii", width, height)
    elif kind == "TGA":
        data[12:16] = struct.pack("<HH", width, height)
    else:  # TIFF: tags 256 and 257
        start = struct.unpack_from("<I", data, 4)[0]
        for entry in range(struct.unpack_from("<H", data, start)[0]):
            at = start + 2 + 12 * entry
            tag = struct.unpack_from("<H", data, at)[0]
            if tag in (256, 257):
                size = width if tag == 256 else height
                struct.pack_into("<HHII", data, at, tag, 4, 1, size)
    return bytes(data)


def webp(width, height):
    """Header of a lossless WebP of a stated size."""
    bits = struct.pack("<I", (width - 1) | (height - 1) << 14)
    return b"RIFF" + struct.pack("<I", 22) + b"WEBPVP8L" + struct.pack("<I", 9) + b"\x2f" + bits * 2


def packed_chunk(kind):
    """A PNG with 256 MiB of zeros packed into a chunk that is no picture."""
    body = kind + b"a\0\0" + zlib.compress(bytes(1 << 28), 9)
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    whole = png([[[1, 2, 3]]])
    return whole[:33] + chunk + whole[33:]


def huge_buffer(folder):
    """A file of 3 GiB that takes no space, of which a plant needs 60 bytes and one too many."""
    made = quad(triangles=[[0, 1, 4], [0, 1, 2]])
    with (folder / "a.bin").open("wb") as file:
        file.write(made.blob)
        file.truncate(3 << 30)
    made["buffers"] = [{"uri": "a.bin", "byteLength": 60}]
    return made.write(folder / "a.gltf")


def many_nodes(folder):
    made = quad()
    made["nodes"] = [{"mesh": 0}] * 140_000
    made["scenes"] = [{"nodes": list(range(140_000))}]
    return made.write(folder / "a.gltf")


def many_primitives(folder):
    made = quad()
    made["meshes"][0]["primitives"] *= 1000
    made["nodes"] = [{"mesh": 0}] * 140
    made["scenes"] = [{"nodes": list(range(140))}]
    return made.write(folder / "a.gltf")


def many_libraries(folder):
    (folder / "a.mtl").write_text("newmtl m\nKd 1 1 x\n")
    (folder / "a.obj").write_text("mtllib a.mtl\n" * 50_000 + OBJ + "usemtl m\nf 1 2 3\n")
    return folder / "a.obj"


def tower(folder):
    made = quad()
    made["nodes"] = [{"children": [i + 1, i + 1]} for i in range(200)] + [{"mesh": 0}]
    return made.write(folder / "a.gltf")


def chain(folder):
    """Nodes nested as deep as allowed, the last with one child many times over."""
    made = quad()
    made["nodes"] = [{"children": [i + 1]} for i in range(249)] + [{"children": [0] * 100_000}]
    return made.write(folder / "a.gltf")


def sparse(path, start=b""):
    """Write a file of 600 MiB that takes no space."""
    with path.open("wb") as file:
        file.write(start)
        file.truncate(600 << 20)


def long_picture(folder):
    path = picture(png([[[1, 2, 3]]]))(folder)
    sparse(folder / "a.bin", png([[[1, 2, 3]]]))
    return path


def long_picture_of_obj(folder):
    (folder / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    sparse(folder / "a.png", png([[[1, 2, 3]]]))
    return text("a.obj", "mtllib a.mtl\n" + OBJ + "usemtl m\nf 1 2 3\n")(folder)


def long_library(folder):
    sparse(folder / "a.mtl", b"newmtl m\n")
    return text("a.obj", "mtllib a.mtl\n" + OBJ + "usemtl m\nf 1 2 3\n")(folder)


def instances(folder):
    made = quad()
    made["nodes"] = [{"children": list(range(1, 301))}]
    shifts = made.accessor(np.zeros((70_000, 3)))
    extension = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": shifts}}}
    made["nodes"] += [{"mesh": 0, "extensions": extension}] * 300
    return made.write(folder / "a.gltf")


def accessor(**fields):
    """Writer of a quad whose positions' accessor states something else."""

    def write(folder):
        made = quad()
        made["accessors"][0] |= fields
        return made.write(folder / "a.gltf")

    return write


def view(**fields):
    """Writer of a quad whose positions' buffer view states something else."""

    def write(folder):
        made = quad()
        made["bufferViews"][0] |= fields
        return made.write(folder / "a.gltf")

    return write


def binary_ply(count_type, *numbers):
    """Writer of a PLY whose one face has these numbers: how many corners, and which."""

    def write(folder):
        header = PLY.format(format="binary_little_endian", count=count_type).encode()
        (folder / "a.ply").write_bytes(header + bytes(36) + struct.pack("<4i", *numbers))
        return folder / "a.ply"

    return write


TOO_LARGE = "image 0 is (too large|.* x .*; the limit is)"

BOMBS = {
    "PNG": Attack(picture(huge_png(30_000, 30_000)), TOO_LARGE),
    "PNG at the limit": Attack(picture(huge_png(8192, 8192)), "image 0 is damaged"),
    "JPEG": Attack(picture(stating("JPEG", 65_500, 65_500)), TOO_LARGE),
    "BMP": Attack(picture(stating("BMP", 60_000, 60_000)), TOO_LARGE),
    "TGA": Attack(picture(stating("TGA", 65_535, 65_535)), TOO_LARGE),
    "TIFF": Attack(picture(stating("TIFF", 100_000, 100_000)), TOO_LARGE),
    "WebP": Attack(picture(webp(16_384, 16_384)), TOO_LARGE),
    "text in a PNG": Attack(picture(packed_chunk(b"zTXt")), "image 0 is damaged"),
    "profile in a PNG": Attack(picture(packed_chunk(b"iCCP")), "image 0 is damaged"),
    "buffer on disk": Attack(huge_buffer, "vertex index 4, but it has 4 vertices"),
    "values that are not there": Attack(accessor(count=2**40), "values end at byte"),
    "rows of a PLY": Attack(
        text("a.ply", ASCII_PLY.replace("vertex 3", "vertex 4000000000")),
        "cut short: it states 4000000001 elements",
    ),
    "corners of a PLY": Attack(binary_ply("uint", -1, 0, 1, 2), "a.ply: damaged, or no PLY file"),
    "long picture": Attack(long_picture, "'a.bin': 629145600 bytes, the limit is 269484032"),
    "long picture of an OBJ": Attack(long_picture_of_obj, "'a.png': 629145600 bytes, the limit"),
    "long library": Attack(long_library, "'a.mtl': 629145600 bytes, the limit is 4194304"),
    "chain of nodes": Attack(chain, "reached twice"),
    "tower of nodes": Attack(tower, "reached twice"),
    "nodes": Attack(many_nodes, "140000 nodes or primitives, the limit is 131072", LimitError),
    "primitives": Attack(many_primitives, "131073 nodes or primitives, the limit", LimitError),
    "instances": Attack(instances, "42000000 triangles, the limit is 33554432", LimitError),
    "libraries": Attack(many_libraries, "material 'm': 1 1 x|x where a number"),
    "deep JSON": Attack(text("a.gltf", "[" * 200_000), "RecursionError|JSONDecodeError"),
    "long number": Attack(
        text("a.gltf", '{"asset": {"version": "2.0"}, "scene": ' + "9" * 100_000 + "}"),
        "Exceeds the limit",
    ),
}  # fmt: skip

# --- one or more for each class ------------------------------------------------------------------

INSIDE = "buffer 0 refers to .*; only relative paths"

ATTACKS = {
    # sizes that leave the range of an integer
    "count of 2^63": Attack(accessor(count=2**63), "values end at byte"),
    "offset of 2^64": Attack(accessor(byteOffset=2**64), "values end at byte"),
    "stride of 2^62": Attack(view(byteStride=2**62), "values end at byte"),
    "length of 2^64": Attack(view(byteLength=2**64), "of a buffer of 60 bytes"),
    "negative length": Attack(view(byteLength=-(2**63)), "byteLength is -9223372036854775808"),
    # what is no number
    "NaN": Attack(
        gltf(quad(positions=[[0, 0, 0], [1, 0, 0], [0, np.nan, 0], [1, 1, 0]])),
        "the position of vertex 2 is not finite",
    ),
    "infinity": Attack(moved(1e999, 0, 0), "Infinity in the JSON is no number"),
    "number of 400 digits": Attack(moved(10**400, 0, 0), "translation is not finite"),
    "beyond a float": Attack(
        gltf(quad(positions=np.array(POSITIONS) * 3e38)), r"a coordinate lies beyond 1e\+12"
    ),
    # indices
    "index of a corner": Attack(
        gltf(quad(triangles=[[0, 1, 65535], [0, 1, 2]])),
        "vertex index 65535, but it has 4 vertices",
    ),
    "index of a scene": Attack(gltf(quad(), scene=7), "scenes index 7, but there are 1"),
    "index of an OBJ": Attack(text("a.obj", OBJ + "f 1 2 9\n"), "a face refers to v 9"),
    "index of a PLY": Attack(binary_ply("int", 3, 0, 1, 99), "vertex index 99"),
    # cycles
    "cycle": Attack(
        gltf(quad(), nodes=[{"mesh": 0, "children": [1]}, {"children": [0]}]),
        "node 0 is reached twice",
    ),
    "link to itself": Attack(link("a.bin"), "a.bin"),
    # paths
    "up": Attack(buffer_at("../a.bin"), INSIDE),
    "up, percent": Attack(buffer_at("%2E%2e%2Fa.bin"), INSIDE),
    "absolute": Attack(buffer_at("/etc/passwd"), INSIDE),
    "scheme": Attack(buffer_at("file:///etc/passwd"), INSIDE),
    "network": Attack(buffer_at("http://127.0.0.1:9/a"), INSIDE),
    "link": Attack(link("/etc/passwd"), INSIDE),
    "device": Attack(link("/dev/zero"), INSIDE),
    "pipe": Attack(pipe, "buffer 0 refers to 'a.bin', which does not exist"),
    # silent drops
    "required extension": Attack(
        gltf(quad(), extensionsRequired=["VENDOR_secret"]), "it requires VENDOR_secret"
    ),
    "nameless extension": Attack(gltf(quad(), extensionsRequired=[{}]), "not a list of names"),
    # cut, torn, foreign
    "cut": Attack(glb(lambda data: data.__delitem__(slice(-30, None))), "cut short"),
    "torn": Attack(torn, "the GLB's binary chunk is cut short"),
    "length of a chunk": Attack(
        glb(lambda data: data.__setitem__(slice(12, 16), b"\xff" * 4)), "cut short or damaged"
    ),
    "another format": Attack(text("a.glb", '{"metadata": {"type": "Object"}}'), "no asset"),
    # wrong kinds
    "list for an object": Attack(gltf(quad(), materials=[[]]), "materials is not a list of obj"),
    "text for a number": Attack(accessor(count="4"), "count is '4'"),
    "fraction for a count": Attack(accessor(count=4.5), "count is 4.5"),
    "truth for an index": Attack(gltf(quad(), nodes=[{"mesh": True}]), "mesh index is True"),
    "object for a type": Attack(accessor(type={}), r"its accessor is \{\} of"),
    "list for a component": Attack(accessor(componentType=[5126]), r"of \[5126\]"),
    "list for an alpha mode": Attack(
        gltf(textured([[[1, 2, 3]]]), materials=[{"alphaMode": []}]), r"alphaMode \[\]"
    ),
    "number for a primitive": Attack(
        gltf(Gltf(), meshes=[{"primitives": [5]}]), "primitive 0 is not an object"
    ),
    "number for extensions": Attack(
        gltf(quad(), nodes=[{"mesh": 0, "extensions": 5}]), "extensions is not an object"
    ),
    # nothing there
    "no bytes": Attack(text("a.gltf", ""), "a.gltf: damaged"),
    "no triangles": Attack(text("a.obj", "v 0 0 0\n"), "it holds no triangles"),
}
