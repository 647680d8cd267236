"""
What a glTF file says of itself: its container, its lists, its nodes, its accessors; all checked.

Nothing here knows a material or a mesh.
"""

import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treelod.errors import PlantFileError
from treelod.plant_files import checks
from treelod.plant_files.checks import Json
from treelod.plant_files.model import check_counts
from treelod.plant_files.sources import Source

__all__ = ["COMPONENTS", "HARMLESS_EXTENSIONS", "READ_EXTENSIONS", "Header", "chunks"]

READ_EXTENSIONS = {
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
}
"""Extensions that are read."""

HARMLESS_EXTENSIONS = {
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_xmp_json_ld",
    "MSFT_lod",
}
"""Extensions that may be required: they change no shape, no base colour and no alpha."""

TRANSMISSION = "KHR_materials_transmission"

MAX_DEPTH = 256
"""Deepest nesting of nodes."""

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def chunks(data: bytes) -> tuple[Json, bytes | None]:
    """JSON and binary chunk of a GLB, or the JSON alone."""
    blob = None
    text = data
    if data[:4] == b"glTF":
        if len(data) < 20:
            msg = "the GLB ends in its header"
            raise PlantFileError(msg)
        version, length, json_length = struct.unpack_from("<III", data, 4)
        if version != 2:
            msg = f"GLB version {version}; only version 2 is read"
            raise PlantFileError(msg)
        if length > len(data) or 20 + json_length > length or data[16:20] != b"JSON":
            msg = f"the GLB is cut short or damaged: {len(data)} bytes, it states {length}"
            raise PlantFileError(msg)
        text = data[20 : 20 + json_length]
        rest = data[20 + json_length : length]
        if len(rest) >= 8:
            blob_length = struct.unpack_from("<I", rest)[0]
            if 8 + blob_length > len(rest):
                msg = f"the GLB's binary chunk is cut short: {len(rest) - 8} of {blob_length} bytes"
                raise PlantFileError(msg)
            if rest[4:8] == b"BIN\0":
                blob = rest[8 : 8 + blob_length]
    header = json.loads(text, parse_constant=_refuse_constant)
    if not isinstance(header, dict) or not isinstance(header.get("asset"), dict):
        msg = "the JSON is no glTF: it has no asset"
        raise PlantFileError(msg)
    version = str(header["asset"].get("version"))
    if version.split(".")[0] != "2":
        msg = f"glTF version {version}; only version 2 is read"
        raise PlantFileError(msg)
    return header, blob


def _refuse_constant(name: str) -> float:
    msg = f"{name} in the JSON is no number"
    raise PlantFileError(msg)


class Header:
    """The JSON of a file and the buffers it refers to."""

    def __init__(self, source: Source, header: Json, blob: bytes | None) -> None:
        self.source = source
        self.header = header
        self.blob = blob
        self.warnings: list[str] = []
        self.lists: dict[str, list[Json]] = {}
        self.buffers: dict[int, bytes] = {}

    def all(self, name: str) -> list[Json]:
        """One of the header's lists of objects; empty if it is not there."""
        if name not in self.lists:
            values = self.header.get(name, [])
            if not isinstance(values, list) or not all(isinstance(v, dict) for v in values):
                msg = f"{name} is not a list of objects"
                raise PlantFileError(msg)
            self.lists[name] = values
        return self.lists[name]

    def item(self, name: str, index: object, what: str) -> Json:
        """Return one object of a list, after checking that it is there."""
        values = self.all(name)
        return values[checks.index(index, len(values), f"{what}: {name} index")]

    def check_extensions(self) -> None:
        """Refuse a file that requires what is not read, and note what is ignored."""
        required = self.header.get("extensionsRequired", [])
        if not isinstance(required, list) or not all(isinstance(name, str) for name in required):
            msg = "extensionsRequired is not a list of names"
            raise PlantFileError(msg)
        unknown = set(required) - READ_EXTENSIONS - HARMLESS_EXTENSIONS - {TRANSMISSION}
        if unknown:
            names = ", ".join(sorted(unknown))
            msg = f"it requires {names}, which is not read"
            raise PlantFileError(msg)
        used = self.header.get("extensionsUsed", [])
        if isinstance(used, list) and TRANSMISSION in used:
            self.warnings.append(f"{TRANSMISSION} is ignored: such surfaces are drawn opaque")

    def nodes(self) -> Iterator[tuple[int, int | None]]:
        """Every node of the default scene once, with its parent; None for a root."""
        nodes = self.all("nodes")
        check_counts(node_count=len(nodes))
        scenes = self.all("scenes")
        if scenes:
            roots = self.item("scenes", self.header.get("scene", 0), "scene").get("nodes", [])
        else:
            children = {child for node in nodes for child in _children(node)}
            roots = [index for index in range(len(nodes)) if index not in children]
        # a node is seen when it goes on the stack, so that the stack never outgrows the nodes
        seen: set[int] = set()
        stack: list[tuple[int, int | None, int]] = []
        self.push(stack, seen, checks.index_list(roots, "scene"), None, 1)
        while stack:
            index, parent, depth = stack.pop()
            yield index, parent
            self.push(stack, seen, _children(nodes[index]), index, depth + 1)

    def push(
        self,
        stack: list[tuple[int, int | None, int]],
        seen: set[int],
        indices: list[int],
        parent: int | None,
        depth: int,
    ) -> None:
        """Put nodes on the stack, the first on top; none may have been seen."""
        if indices and depth > MAX_DEPTH:
            msg = f"nodes are nested more than {MAX_DEPTH} deep"
            raise PlantFileError(msg)
        count = len(self.all("nodes"))
        for index in reversed(indices):
            checks.index(index, count, "scene: node index")
            if index in seen:
                msg = f"node {index} is reached twice: the nodes are no tree, or run in a circle"
                raise PlantFileError(msg)
            seen.add(index)
            stack.append((index, parent, depth))

    # --- accessors ----------------------------------------------------------------------------

    def accessor(self, index: object, label: str, types: set[str]) -> Json:
        """Return an accessor after checking that its values lie inside its buffer."""
        accessor = self.item("accessors", index, label)
        kind, component = accessor.get("type"), accessor.get("componentType")
        if not (checks.one_of(kind, types) and checks.one_of(component, COMPONENTS)):
            kind = f"{kind} of {component}"
            msg = f"{label}: its accessor is {kind}, expected {' or '.join(sorted(types))}"
            raise PlantFileError(msg)
        if "sparse" in accessor or "bufferView" not in accessor:
            msg = f"{label}: a sparse or empty accessor is not read"
            raise PlantFileError(msg)
        count = checks.integer(accessor.get("count"), 1, f"{label}: count")
        start = checks.integer(accessor.get("byteOffset", 0), 0, f"{label}: byteOffset")
        view = self.item("bufferViews", accessor["bufferView"], label)
        length = len(self.view_bytes(accessor["bufferView"], label))
        size = np.dtype(COMPONENTS[accessor["componentType"]]).itemsize * WIDTHS[accessor["type"]]
        stride = checks.integer(view.get("byteStride", size), size, f"{label}: byteStride")
        needed = start + (count - 1) * stride + size
        if needed > length:
            msg = f"{label}: its values end at byte {needed} of a buffer view of {length} bytes"
            raise PlantFileError(msg)
        return accessor

    def values(self, index: int, label: str, types: set[str]) -> NDArray[np.float64]:
        """Values of an accessor as floats, normalised if it says so: shape (N, C)."""
        accessor = self.accessor(index, label, types)
        data = self.view_bytes(accessor["bufferView"], label)
        view = self.all("bufferViews")[accessor["bufferView"]]
        dtype = np.dtype("<" + COMPONENTS[accessor["componentType"]])
        width = WIDTHS[accessor["type"]]
        stride = view.get("byteStride", dtype.itemsize * width)
        raw = np.ndarray(
            (accessor["count"], width),
            dtype,
            data,
            offset=accessor.get("byteOffset", 0),
            strides=(stride, dtype.itemsize),
        )
        return self.as_floats(raw, index)

    def as_floats(self, raw: NDArray[Any], index: int) -> NDArray[np.float64]:
        """Turn values of an accessor into floats, normalised if it says so."""
        accessor = self.all("accessors")[index]
        values = raw.astype(np.float64)
        if accessor.get("normalized") and raw.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(raw.dtype).max, -1)
        return values

    def view_bytes(self, index: object, label: str) -> memoryview:
        """Return the bytes of a buffer view after checking that its buffer has them."""
        view = self.item("bufferViews", index, label)
        start = checks.integer(view.get("byteOffset", 0), 0, f"{label}: byteOffset")
        length = checks.integer(view.get("byteLength"), 1, f"{label}: byteLength")
        number = checks.index(
            view.get("buffer"), len(self.all("buffers")), f"{label}: buffer index"
        )
        data = self.buffer(number)
        if start + length > len(data):
            msg = f"{label}: bytes {start} to {start + length} of a buffer of {len(data)} bytes"
            raise PlantFileError(msg)
        return memoryview(data)[start : start + length]

    def buffer(self, number: int) -> bytes:
        """Return a buffer's bytes, at least as many as it states; read once."""
        if number not in self.buffers:
            stated = self.all("buffers")[number]
            what = f"buffer {number}"
            length = checks.integer(stated.get("byteLength"), 1, f"{what}: byteLength")
            if "uri" in stated:
                data = self.source.read_uri(stated["uri"], what, length)
            elif number == 0 and self.blob is not None:
                data = self.blob
            else:
                msg = f"{what} has no data"
                raise PlantFileError(msg)
            if length > len(data):
                msg = f"{what} is cut short: {len(data)} of {length} bytes"
                raise PlantFileError(msg)
            self.buffers[number] = data
        return self.buffers[number]


def _children(node: Json) -> list[int]:
    return checks.index_list(node.get("children", []), "children")
