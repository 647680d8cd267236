"""
GLB and glTF 2.0, decoded by trimesh after everything in the header was checked.

trimesh decodes accessors, strips and the scene graph, but it takes indices, sizes and loops on
trust, rounds colour factors to 8 bits, forgets how textures wrap, and passes over required
extensions and instances. So it gets a header written here, with only what was checked: one mesh for
each primitive, raw attributes under private names, no materials, no pictures, numbered buffers.
Materials, pictures and instances are read here.
"""

import io
import itertools
import json
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treelod.errors import PlantFileError
from treelod.plant_files import checks, images
from treelod.plant_files.checks import Json
from treelod.plant_files.model import (
    MAX_NODE_COUNT,
    AlphaMode,
    MaterialFacts,
    Model,
    Piece,
    Wrap,
    check_counts,
)
from treelod.plant_files.sources import Source

__all__ = ["read"]

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

WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
ALPHA_MODES: dict[str, AlphaMode] = {"OPAQUE": "opaque", "MASK": "mask", "BLEND": "blend"}

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

INSTANCE_TYPES = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}

TRIANGLES, STRIP, FAN = 4, 5, 6


def read(source: Source) -> Model:
    """Read a ``.glb`` or ``.gltf`` file; which of the two is decided by its first bytes."""
    header, blob = _chunks(source.read())
    return _File(source, header, blob).model()


def _chunks(data: bytes) -> tuple[Json, bytes | None]:
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


@dataclass(frozen=True)
class _Primitive:
    """A triangle primitive that was checked, and how to place it."""

    mesh_name: str
    material: int
    triangle_count: int
    vertex_count: int
    attributes: dict[str, int]
    indices: int | None
    mode: int
    label: str


class _File:
    """One file while it is being read."""

    def __init__(self, source: Source, header: Json, blob: bytes | None) -> None:
        self.source = source
        self.header = header
        self.blob = blob
        self.warnings: list[str] = []
        self.lists: dict[str, list[Json]] = {}
        self.buffers: dict[int, bytes] = {}
        self.pictures: dict[int, NDArray[np.uint8]] = {}

    def model(self) -> Model:
        self.check_extensions()
        placed = list(itertools.islice(self.placed_primitives(), MAX_NODE_COUNT + 1))
        used = sorted({prim.material for _, prim, _ in placed})
        check_counts(
            sum(prim.triangle_count * count for _, prim, count in placed),
            sum(prim.vertex_count * count for _, prim, count in placed),
            len(placed),
        )
        if not any(prim.triangle_count for _, prim, _ in placed):
            return Model(pieces=[], materials=[])
        # materials that nothing uses are left out, and their pictures are never decoded
        slot_of = {index: slot for slot, index in enumerate(used)}
        facts = [self.material(index) for index in used]
        pieces = self.decode(placed, slot_of)
        return Model(pieces=pieces, materials=facts, warnings=self.warnings)

    # --- the header ---------------------------------------------------------------------------

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
        values = self.all(name)
        return values[checks.index(index, len(values), f"{what}: {name} index")]

    def check_extensions(self) -> None:
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

    def placed_primitives(self) -> Iterator[tuple[int, _Primitive, int]]:
        """Node, primitive and number of instances of everything that is drawn."""
        nodes = self.all("nodes")
        skipped = set()
        drawn = False
        known: dict[int, list[_Primitive]] = {}
        for index, _ in self.nodes():
            node = nodes[index]
            if "mesh" not in node:
                continue
            mesh = checks.index(node["mesh"], len(self.all("meshes")), f"node {index}: mesh index")
            if mesh not in known:
                known[mesh] = [prim for prim in self.primitives(mesh) if prim is not None]
                if len(known[mesh]) < len(self.all("meshes")[mesh].get("primitives", [])):
                    skipped.add(self.mesh_name(mesh))
            for prim in known[mesh]:
                drawn = True
                yield index, prim, self.instance_count(index)
        if skipped and drawn:
            names = ", ".join(sorted(skipped))
            self.warnings.append(f"points and lines are ignored (in {names})")

    def mesh_name(self, index: int) -> str:
        return str(self.all("meshes")[index].get("name") or f"mesh {index}")

    def primitives(self, mesh: int) -> Iterator[_Primitive | None]:
        """Yield the checked triangle primitives of a mesh; None for points and lines."""
        primitives = self.all("meshes")[mesh].get("primitives")
        name = self.mesh_name(mesh)
        if not isinstance(primitives, list) or not primitives:
            msg = f"mesh {name!r} has no primitives"
            raise PlantFileError(msg)
        for number, primitive in enumerate(primitives):
            label = f"mesh {name!r}, primitive {number}"
            if not isinstance(primitive, dict):
                msg = f"{label} is not an object"
                raise PlantFileError(msg)
            mode = primitive.get("mode", TRIANGLES)
            if mode in (0, 1, 2, 3):
                yield None
                continue
            if mode == FAN:
                msg = f"{label} is a triangle fan, which is not read"
                raise PlantFileError(msg)
            if mode not in (TRIANGLES, STRIP):
                msg = f"{label}: mode {mode!r}"
                raise PlantFileError(msg)
            yield self.primitive(primitive, name, label, mode)

    def primitive(self, primitive: Json, name: str, label: str, mode: int) -> _Primitive:
        given = primitive.get("attributes")
        if not isinstance(given, dict) or "POSITION" not in given:
            msg = f"{label} has no positions"
            raise PlantFileError(msg)
        materials = self.all("materials")
        material = len(materials)
        uv_set = 0
        if "material" in primitive:
            material = checks.index(primitive["material"], material, f"{label}: material index")
            uv_set = _uv_set(_base_texture(materials[material]))
        wanted = {
            "POSITION": ("POSITION", {"VEC3"}),
            "_NORMAL": ("NORMAL", {"VEC3"}),
            "_UV": (f"TEXCOORD_{uv_set}", {"VEC2"}),
            "_COLOR": ("COLOR_0", {"VEC3", "VEC4"}),
        }
        attributes = {}
        counts = set()
        for key, (attribute, types) in wanted.items():
            if attribute in given:
                accessor = self.accessor(given[attribute], f"{label}, {attribute}", types)
                attributes[key] = given[attribute]
                counts.add(accessor["count"])
        if len(counts) != 1:
            msg = f"{label}: its attributes have different lengths {sorted(counts)}"
            raise PlantFileError(msg)
        indices = primitive.get("indices")
        vertex_count = corner_count = counts.pop()
        if indices is not None:
            accessor = self.accessor(indices, f"{label}, indices", {"SCALAR"})
            if accessor["componentType"] not in (5121, 5123, 5125):
                msg = f"{label}: its indices are no unsigned integers"
                raise PlantFileError(msg)
            corner_count = accessor["count"]
        if mode == TRIANGLES and corner_count % 3:
            msg = f"{label}: {corner_count} corners make no whole triangles"
            raise PlantFileError(msg)
        triangle_count = corner_count // 3 if mode == TRIANGLES else max(corner_count - 2, 0)
        return _Primitive(
            name, material, triangle_count, vertex_count, attributes, indices, mode, label
        )

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
        accessor = self.all("accessors")[index]
        values = raw.astype(np.float64)
        if accessor.get("normalized") and raw.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(raw.dtype).max, -1)
        return values

    def view_bytes(self, index: object, label: str) -> memoryview:
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

    # --- materials ----------------------------------------------------------------------------

    def material(self, index: int) -> MaterialFacts:
        """Read a material; one past the last is the default of primitives without one."""
        if index == len(self.all("materials")):
            return MaterialFacts(name="default")
        stated = self.all("materials")[index]
        name = str(stated.get("name") or f"material {index}")
        what = f"material {name!r}"
        mode = stated.get("alphaMode", "OPAQUE")
        if not checks.one_of(mode, ALPHA_MODES):
            msg = f"{what}: alphaMode {mode!r}"
            raise PlantFileError(msg)
        cutoff = checks.floats([stated.get("alphaCutoff", 0.5)], 1, f"{what}: alphaCutoff")[0]
        if cutoff < 0:
            msg = f"{what}: alphaCutoff {cutoff} is below 0"
            raise PlantFileError(msg)
        texture = None
        wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
        info = _base_texture(stated)
        if info is not None:
            texture, wrap = self.texture(info.get("index"), what)
        return MaterialFacts(
            name=name,
            texture=texture,
            wrap=wrap,
            alpha_mode=ALPHA_MODES[mode],
            alpha_cutoff=float(cutoff),
            double_sided=bool(stated.get("doubleSided", False)),
        )

    def colors(self, index: int, given: NDArray[np.float64] | None, count: int) -> NDArray[Any]:
        """Linear base colour (V, 4) of a material's vertices: its factor times their colours."""
        colors = np.ones((count, 4))
        if given is not None:
            # files are found with values slightly above 1
            colors[:, : given.shape[1]] = np.clip(given, 0, 1)
        if index < len(self.all("materials")):
            base = _base(self.all("materials")[index])
            factor = base.get("baseColorFactor", base.get("diffuseFactor", [1, 1, 1, 1]))
            colors *= np.clip(checks.floats(factor, 4, f"material {index}: base colour"), 0, 1)
        return colors.astype(np.float32)

    def texture(self, index: object, what: str) -> tuple[NDArray[np.uint8], tuple[Wrap, Wrap]]:
        texture = self.item("textures", index, what)
        webp = checks.extension(texture, "EXT_texture_webp")
        number = webp.get("source", texture.get("source"))
        if number is None:
            names = ", ".join(sorted(checks.extensions(texture))) or "no picture"
            msg = f"{what}: its texture has {names}, which is not read; PNG, JPEG and WebP are"
            raise PlantFileError(msg)
        picture = self.picture(
            checks.index(number, len(self.all("images")), f"{what}: image index")
        )
        sampler = {}
        if "sampler" in texture:
            sampler = self.item("samplers", texture["sampler"], what)
        modes = [sampler.get(key, 10497) for key in ("wrapS", "wrapT")]
        for mode in modes:
            if not checks.one_of(mode, WRAPS):
                msg = f"{what}: wrap mode {mode!r}"
                raise PlantFileError(msg)
        return picture, (WRAPS[modes[0]], WRAPS[modes[1]])

    def picture(self, number: int) -> NDArray[np.uint8]:
        if number not in self.pictures:
            image = self.all("images")[number]
            what = f"image {number}"
            if "bufferView" in image:
                data = bytes(self.view_bytes(image["bufferView"], what))
            else:
                data = self.source.read_uri(image.get("uri"), what, limit=images.MAX_BYTES)
            self.pictures[number] = images.decode(data, what, self.source.charge_texels)
        return self.pictures[number]

    # --- geometry -----------------------------------------------------------------------------

    def instance_attributes(self, node: int) -> dict[str, int]:
        """Accessors of a node's EXT_mesh_gpu_instancing that place its instances."""
        extension = checks.extension(self.all("nodes")[node], "EXT_mesh_gpu_instancing")
        given = extension.get("attributes", {})
        if not isinstance(given, dict):
            msg = f"node {node}: the attributes of its instances are not an object"
            raise PlantFileError(msg)
        return {name: given[name] for name in INSTANCE_TYPES if name in given}

    def instance_count(self, node: int) -> int:
        """How many instances a node draws; 1 without the extension."""
        counts = {
            self.accessor(index, f"node {node}, instances' {name}", {INSTANCE_TYPES[name]})["count"]
            for name, index in self.instance_attributes(node).items()
        }
        if len(counts) > 1:
            msg = f"node {node}: its instances' attributes have different lengths {sorted(counts)}"
            raise PlantFileError(msg)
        return counts.pop() if counts else 1

    def instances(self, node: int) -> NDArray[np.float64]:
        """Matrices (N, 4, 4) of a node's instances; one identity without the extension."""
        what = f"node {node}"
        arrays = {
            name: self.values(index, what, {INSTANCE_TYPES[name]})
            for name, index in self.instance_attributes(node).items()
        }
        matrices = np.tile(np.eye(4), (self.instance_count(node), 1, 1))
        if "ROTATION" in arrays:
            matrices[:, :3, :3] = _rotations(arrays["ROTATION"], what)
        if "SCALE" in arrays:
            matrices[:, :3, :3] *= arrays["SCALE"][:, None, :]
        if "TRANSLATION" in arrays:
            matrices[:, :3, 3] = arrays["TRANSLATION"]
        if not np.isfinite(matrices).all():
            msg = f"{what}: its instances' transforms are not finite"
            raise PlantFileError(msg)
        return matrices

    def decode(
        self,
        placed: list[tuple[int, _Primitive, int]],
        slot_of: dict[int, int],
    ) -> list[Piece]:
        """Let trimesh decode what was checked, then place it."""
        import trimesh

        header, names = self.checked_header(placed)
        scene = trimesh.load_scene(
            io.BytesIO(json.dumps(header).encode()),
            file_type="gltf",
            resolver={f"{number}": data for number, data in self.buffers.items()},
            process=False,
        )
        pieces = []
        for (node, prim, count), name in zip(placed, names, strict=True):
            matrix, geometry = scene.graph[name]
            mesh = scene.geometry[geometry]
            arrays = {
                key: self.as_floats(np.asarray(mesh.vertex_attributes[key]), index)
                for key, index in prim.attributes.items()
                if key != "POSITION"
            }
            position = prim.attributes["POSITION"]
            dtype = np.dtype(COMPONENTS[self.all("accessors")[position]["componentType"]])
            vertices = np.asarray(mesh.vertices)
            if dtype.kind in "iu":
                vertices = self.as_floats(vertices.astype(dtype), position)
            triangles = np.asarray(mesh.faces, dtype=np.int64)
            colors = self.colors(prim.material, arrays.get("_COLOR"), len(vertices))
            texture = None
            if prim.material < len(self.all("materials")):
                texture = _base_texture(self.all("materials")[prim.material])
            uvs = None
            if "_UV" in arrays:
                uvs = _transformed_uvs(arrays["_UV"], texture).astype(np.float32)
            matrices = matrix @ self.instances(node)
            positions, normals, triangles = _placed(
                matrices, vertices, arrays.get("_NORMAL"), triangles
            )
            pieces.append(
                Piece(
                    mesh=prim.mesh_name,
                    material=slot_of[prim.material],
                    positions=positions,
                    triangles=triangles,
                    colors=np.tile(colors, (count, 1)),
                    normals=normals,
                    uvs=None if uvs is None else np.tile(uvs, (count, 1)),
                )
            )
        return pieces

    def checked_header(self, placed: list[tuple[int, _Primitive, int]]) -> tuple[Json, list[str]]:
        """Make a header of what was checked, and name each placed primitive's node."""
        accessors = _Chosen()
        views = _Chosen()
        buffers = _Chosen()
        meshes = _Chosen()
        mesh_list: list[Json] = []
        nodes: list[Json] = [{"name": f"n{index}"} for index in range(len(self.all("nodes")))]
        roots = []
        for index, parent in self.nodes():
            nodes[index] |= _local_transform(self.all("nodes")[index], f"node {index}")
            if parent is None:
                roots.append(index)
            else:
                nodes[parent].setdefault("children", []).append(index)
        names: list[str] = []
        for index, prim, _ in placed:
            if prim.label not in meshes.slots:
                mesh = {
                    "mode": prim.mode,
                    "attributes": {k: accessors.slot(a) for k, a in prim.attributes.items()},
                }
                if prim.indices is not None:
                    mesh["indices"] = accessors.slot(prim.indices)
                mesh_list.append({"name": f"m{len(mesh_list)}", "primitives": [mesh]})
            names.append(f"p{len(names)}")
            nodes[index].setdefault("children", []).append(len(nodes))
            nodes.append({"name": names[-1], "mesh": meshes.slot(prim.label)})
        accessor_list = []
        for index in accessors.slots:
            accessor = self.all("accessors")[index]
            kept = {k: accessor[k] for k in ("componentType", "count", "type")}
            kept["byteOffset"] = accessor.get("byteOffset", 0)
            kept["bufferView"] = views.slot(accessor["bufferView"])
            accessor_list.append(kept)
        view_list = []
        for index in views.slots:
            view = self.all("bufferViews")[index]
            kept = {k: view[k] for k in ("byteOffset", "byteLength", "byteStride") if k in view}
            view_list.append(kept | {"buffer": buffers.slot(view["buffer"])})
        buffer_list = [
            {"uri": f"{number}", "byteLength": len(self.buffers[number])}
            for number in buffers.slots
        ]
        header = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": roots}],
            "nodes": nodes,
            "meshes": mesh_list,
            "accessors": accessor_list,
            "bufferViews": view_list,
            "buffers": buffer_list,
        }
        return header, names


class _Chosen:
    """Numbers things in the order in which they are first asked for."""

    def __init__(self) -> None:
        self.slots: dict[Any, int] = {}

    def slot(self, key: object) -> int:
        return self.slots.setdefault(key, len(self.slots))


def _base(material: Json) -> Json:
    """Return the part of a material that holds the base colour."""
    base = material.get("pbrMetallicRoughness")
    if base is None:
        base = checks.extension(material, "KHR_materials_pbrSpecularGlossiness")
    if not isinstance(base, dict):
        msg = "pbrMetallicRoughness is not an object"
        raise PlantFileError(msg)
    return base


def _base_texture(material: Json) -> Json | None:
    base = _base(material)
    texture = base.get("baseColorTexture", base.get("diffuseTexture"))
    if texture is not None and not isinstance(texture, dict):
        msg = "baseColorTexture is not an object"
        raise PlantFileError(msg)
    return texture


def _uv_set(texture: Json | None) -> int:
    if texture is None:
        return 0
    transform = checks.extension(texture, "KHR_texture_transform")
    return checks.integer(transform.get("texCoord", texture.get("texCoord", 0)), 0, "texCoord")


def _transformed_uvs(uvs: NDArray[np.float64], texture: Json | None) -> NDArray[np.float64]:
    """Apply KHR_texture_transform: scale, turn counter-clockwise as seen with v down, shift."""
    transform = checks.extension(texture or {}, "KHR_texture_transform")
    if not transform:
        return uvs
    what = "KHR_texture_transform"
    scale = checks.floats(transform.get("scale", [1, 1]), 2, what)
    offset = checks.floats(transform.get("offset", [0, 0]), 2, what)
    angle = checks.floats([transform.get("rotation", 0)], 1, what)[0]
    c, s = math.cos(angle), math.sin(angle)
    turned: NDArray[np.float64] = (uvs * scale) @ np.array([[c, -s], [s, c]]) + offset
    return turned


def _placed(
    matrices: NDArray[np.float64],
    positions: NDArray[np.float64],
    normals: NDArray[np.float64] | None,
    triangles: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, NDArray[np.int64]]:
    """World positions, normals and triangles of all instances; mirrored ones are wound anew."""
    if np.array_equal(matrices, np.eye(4)[None]):
        return positions, normals, triangles
    linear = matrices[:, :3, :3]
    world = positions @ linear.transpose(0, 2, 1) + matrices[:, None, :3, 3]
    # the cofactors are the inverse transpose times the determinant, and exist for any matrix
    cofactors = np.cross(linear[:, [1, 2, 0]], linear[:, [2, 0, 1]])
    mirrored = np.linalg.det(linear) < 0
    cofactors[mirrored] *= -1
    turned = None
    if normals is not None:
        turned = (normals @ cofactors.transpose(0, 2, 1)).reshape(-1, 3)
    starts = np.arange(len(matrices)) * len(positions)
    wound = triangles + starts[:, None, None]
    wound[mirrored] = wound[mirrored][:, :, ::-1]
    return world.reshape(-1, 3), turned, wound.reshape(-1, 3)


def _rotations(quaternions: NDArray[np.float64], what: str) -> NDArray[np.float64]:
    """Rotation matrices (N, 3, 3) of quaternions (N, 4) in the order x, y, z, w."""
    lengths = np.linalg.norm(quaternions, axis=1)
    if not (lengths > 0).all():
        msg = f"{what}: a rotation of length 0"
        raise PlantFileError(msg)
    x, y, z, w = (quaternions / lengths[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _local_transform(node: Json, what: str) -> Json:
    transform = {}
    for key, length in {"matrix": 16, "translation": 3, "rotation": 4, "scale": 3}.items():
        if key in node:
            transform[key] = checks.floats(node[key], length, f"{what}: {key}").tolist()
    if "rotation" in transform and not any(transform["rotation"]):
        msg = f"{what}: a rotation of length 0"
        raise PlantFileError(msg)
    return transform


def _children(node: Json) -> list[int]:
    return checks.index_list(node.get("children", []), "children")
