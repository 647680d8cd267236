"""Tiny glTF files for the loader's tests: one right one, to be made wrong in one place."""

import base64
import copy
import io
import json
import struct
import zlib

import numpy as np
from PIL import Image

COMPONENTS = {"f4": 5126, "u4": 5125, "u2": 5123, "u1": 5121, "i2": 5122, "i1": 5120}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}

#  2 - 3
#  | \ |     in z = 0, counter-clockwise from +z
#  0 - 1
POSITIONS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
TRIANGLES = [[0, 1, 2], [1, 3, 2]]


class Gltf:
    """A header that grows, and its one buffer."""

    def __init__(self):
        self.header = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"name": "leaf", "primitives": []}],
            "materials": [],
            "accessors": [],
            "bufferViews": [],
            "buffers": [{}],
        }
        self.blob = b""

    def __getitem__(self, key):
        return self.header[key]

    def __setitem__(self, key, value):
        self.header[key] = value

    def view(self, data):
        self.blob += b"\0" * (-len(self.blob) % 4)
        view = {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data)}
        self["bufferViews"].append(view)
        self.blob += data
        return len(self["bufferViews"]) - 1

    def accessor(self, values, dtype="f4", **fields):
        array = np.asarray(values, dtype=dtype)
        array = array.reshape(len(array), -1)
        self["accessors"].append(
            {
                "bufferView": self.view(array.astype("<" + dtype).tobytes()),
                "componentType": COMPONENTS[dtype],
                "count": len(array),
                "type": TYPES[array.shape[1]],
                **fields,
            }
        )
        return len(self["accessors"]) - 1

    def primitive(self, positions=POSITIONS, triangles=TRIANGLES, mesh=0, **fields):
        attributes = {"POSITION": self.accessor(positions)}
        attributes |= fields.pop("attributes", {})
        primitive = {"attributes": attributes, **fields}
        if triangles is not None:
            primitive["indices"] = self.accessor(np.ravel(triangles), "u2")
        self["meshes"][mesh]["primitives"].append(primitive)
        return primitive

    def finished(self):
        header = copy.deepcopy(self.header)
        if self.blob and "byteLength" not in header["buffers"][0]:
            header["buffers"][0]["byteLength"] = len(self.blob)
        return {key: value for key, value in header.items() if value != []}

    def write(self, path):
        """As text, with the buffer inside unless it has a URI of its own."""
        header = self.finished()
        if "buffers" in header and "uri" not in header["buffers"][0]:
            data = base64.b64encode(self.blob).decode()
            header["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{data}"
        path.write_text(json.dumps(header))
        return path

    def glb(self):
        text = json.dumps(self.finished()).encode()
        text += b" " * (-len(text) % 4)
        blob = self.blob + b"\0" * (-len(self.blob) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def quad(**fields):
    """A square leaf of two triangles."""
    made = Gltf()
    made.primitive(**fields)
    return made


def textured(texels, **material):
    """A square leaf with a picture as its base colour."""
    made = Gltf()
    uvs = made.accessor([[0, 1], [1, 1], [0, 0], [1, 0]])
    made.primitive(attributes={"TEXCOORD_0": uvs}, material=0)
    made["images"] = [{"bufferView": made.view(png(texels)), "mimeType": "image/png"}]
    made["textures"] = [{"source": 0}]
    made["materials"] = [
        {"name": "green", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, **material}
    ]
    return made


def png(texels):
    stream = io.BytesIO()
    Image.fromarray(np.asarray(texels, np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def huge_png(width, height):
    """A small file that states a huge size: rows of zeros, packed a thousand to one."""

    def chunk(kind, data):
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    rows = zlib.compress(bytes(min((width // 8 + 1) * height, 1 << 22)), 9)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    )
