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
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treelod.errors import PlantFileError
from treelod.plant_files import checks, images
from treelod.plant_files.checks import Json
from treelod.plant_files.gltf_header import COMPONENTS, Header, chunks
from treelod.plant_files.gltf_transforms import (
    local_transform,
    placed_instances,
    rotations,
    transformed_uvs,
)
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

WRAPS: dict[int, Wrap] = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
ALPHA_MODES: dict[str, AlphaMode] = {"OPAQUE": "opaque", "MASK": "mask", "BLEND": "blend"}

INSTANCE_TYPES = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}

TRIANGLES, STRIP, FAN = 4, 5, 6


def read(source: Source) -> Model:
    """Read a ``.glb`` or ``.gltf`` file; which of the two is decided by its first bytes."""
    header, blob = chunks(source.read())
    return _File(source, header, blob).model()


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


class _File(Header):
    """One file while it is being read."""

    def __init__(self, source: Source, header: Json, blob: bytes | None) -> None:
        super().__init__(source, header, blob)
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

    # --- meshes -------------------------------------------------------------------------------

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
            matrices[:, :3, :3] = rotations(arrays["ROTATION"], what)
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
                uvs = transformed_uvs(arrays["_UV"], texture).astype(np.float32)
            matrices = matrix @ self.instances(node)
            positions, normals, triangles = placed_instances(
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
            nodes[index] |= local_transform(self.all("nodes")[index], f"node {index}")
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
