"""
How a plant becomes a file that other programs open: binary glTF 2.0.

Written directly rather than through a mesh library: positions, normals and colours keep every bit,
and a plant that is written and loaded again draws the same picture.
"""

from __future__ import annotations

import io
import json
import struct
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.plants import Material, Mesh, Plant

__all__ = ["plant_glb"]

# names of the glTF 2.0 specification
_FLOAT, _UNSIGNED_INT = 5126, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_WRAPS = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
_LINEAR, _LINEAR_MIPMAP_LINEAR = 9729, 9987
_GLB_MAGIC, _JSON_CHUNK, _BIN_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942


def plant_glb(plant: Plant) -> bytes:
    """
    Return a plant as a binary glTF 2.0 file (``.glb``).

    Parameters
    ----------
    plant : Plant
        Any plant.

    Returns
    -------
    bytes
        A complete file: a node ``wood`` and a node ``foliage`` (each if it has triangles), one
        primitive a material in the order of the triangles, metres, y up. Base colours go into
        ``COLOR_0``; the plant's light is not stored.
    """
    writer = _Writer()
    material_indices = [writer.material(material) for material in plant.materials]
    for name, mesh in (("wood", plant.wood), ("foliage", plant.foliage.mesh)):
        if len(mesh.triangles):
            writer.node(name, mesh, material_indices, plant.origin)
    return writer.glb(plant.name)


class _Writer:
    """Collects the parts of one file; indices into its lists are what glTF refers by."""

    def __init__(self) -> None:
        self.parts: dict[str, list[dict[str, Any]]] = {}
        self.binary = bytearray()

    def add(self, kind: str, part: dict[str, Any]) -> int:
        parts = self.parts.setdefault(kind, [])
        parts.append(part)
        return len(parts) - 1

    def view(self, data: bytes, **fields: Any) -> int:
        # accessors must start at a multiple of their component's size
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        part = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **fields}
        self.binary.extend(data)
        return self.add("bufferViews", part)

    def floats(self, values: NDArray[np.float32], *, bounds: bool = False) -> int:
        data = np.ascontiguousarray(values, dtype="<f4")
        part: dict[str, Any] = {
            "bufferView": self.view(data.tobytes(), target=_ARRAY_BUFFER),
            "componentType": _FLOAT,
            "count": len(data),
            "type": f"VEC{data.shape[1]}",
        }
        if bounds:
            part |= {"min": data.min(0).tolist(), "max": data.max(0).tolist()}
        return self.add("accessors", part)

    def indices(self, values: NDArray[np.uint32]) -> int:
        data = np.ascontiguousarray(values, dtype="<u4").ravel()
        return self.add(
            "accessors",
            {
                "bufferView": self.view(data.tobytes(), target=_ELEMENT_ARRAY_BUFFER),
                "componentType": _UNSIGNED_INT,
                "count": len(data),
                "type": "SCALAR",
            },
        )

    def material(self, material: Material) -> int:
        surface: dict[str, Any] = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        if material.texture is not None:
            file = io.BytesIO()
            Image.fromarray(np.ascontiguousarray(material.texture)).save(file, format="PNG")
            image = {"bufferView": self.view(file.getvalue()), "mimeType": "image/png"}
            u, v = material.wrap
            sampler = {
                "wrapS": _WRAPS[u],
                "wrapT": _WRAPS[v],
                "magFilter": _LINEAR,
                "minFilter": _LINEAR_MIPMAP_LINEAR,
            }
            texture = {
                "source": self.add("images", image),
                "sampler": self.add("samplers", sampler),
            }
            surface["baseColorTexture"] = {"index": self.add("textures", texture)}
        part: dict[str, Any] = {
            "name": material.name,
            "pbrMetallicRoughness": surface,
            "alphaMode": material.alpha_mode.upper(),
            "doubleSided": material.double_sided,
        }
        if material.alpha_mode == "mask":
            part["alphaCutoff"] = material.alpha_cutoff
        return self.add("materials", part)

    def node(
        self, name: str, mesh: Mesh, material_indices: list[int], origin: NDArray[np.float64]
    ) -> None:
        attributes = {
            "POSITION": self.floats(mesh.positions, bounds=True),
            "NORMAL": self.floats(_unit_normals(mesh.normals)),
            "TEXCOORD_0": self.floats(mesh.uvs),
            "COLOR_0": self.floats(mesh.base),
        }
        primitives = [
            {
                "attributes": attributes,
                "indices": self.indices(mesh.triangles[mesh.material_ids == material]),
                "material": material_indices[material],
            }
            for material in np.unique(mesh.material_ids)
        ]
        index = self.add("meshes", {"name": name, "primitives": primitives})
        node: dict[str, Any] = {"name": name, "mesh": index}
        if np.any(origin != 0.0):
            node["translation"] = [float(value) for value in origin]
        self.add("nodes", node)

    def glb(self, name: str) -> bytes:
        self.binary.extend(b"\0" * (-len(self.binary) % 4))
        document = {
            "asset": {"version": "2.0", "generator": "treelod"},
            "scene": 0,
            "scenes": [{"name": name, "nodes": list(range(len(self.parts["nodes"])))}],
            "buffers": [{"byteLength": len(self.binary)}],
            **self.parts,
        }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + len(self.binary)
        return b"".join(
            (
                struct.pack("<III", _GLB_MAGIC, 2, total),
                struct.pack("<II", len(text), _JSON_CHUNK),
                text,
                struct.pack("<II", len(self.binary), _BIN_CHUNK),
                self.binary,
            )
        )


def _unit_normals(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Give unknown normals, which are zero here, the unit length that the format demands."""
    unknown = ~normals.any(axis=1)
    if not unknown.any():
        return normals
    filled = normals.copy()
    filled[unknown] = (0.0, 1.0, 0.0)
    return filled
