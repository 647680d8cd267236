"""
Wavefront OBJ, parsed by trimesh after its lines were brought into one form.

trimesh reads the numbers, but counts negative indices from the end of the whole file instead of the
lines so far, takes index 0 for 1, and silently drops texture coordinates and normals where one face
lacks them or one index is out of range. So faces are checked here and, unless they are plain
triangles of one form, rewritten; objects and materials get numbers for names, so that it is known
whose a mesh is; and the MTL is read by `mtl`.

Vertex colours (x y z r g b) are taken as sRGB, and count only for meshes without a material and
without texture coordinates.
"""

import io
import itertools
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treelod.color import linear_from_srgb
from treelod.errors import PlantFileError
from treelod.plant_files import mtl
from treelod.plant_files.model import MaterialFacts, Model, Piece, check_counts
from treelod.plant_files.sources import Source

__all__ = ["read"]

KINDS = ("v", "vt", "vn")

_INDEX = r"[1-9]\d*"
PLAIN_FACES = {
    kinds: re.compile(rf"(?:f {corner} {corner} {corner}\n)+")
    for kinds, corner in {
        ("v",): _INDEX,
        ("v", "vt"): f"{_INDEX}/{_INDEX}",
        ("v", "vn"): f"{_INDEX}//{_INDEX}",
        ("v", "vt", "vn"): f"{_INDEX}/{_INDEX}/{_INDEX}",
    }.items()
}
"""Triangles that need no rewriting: in all lines of a file the corners have the same form."""


def read(source: Source) -> Model:
    """Read an ``.obj`` file, and the ``.mtl`` files and pictures that it names."""
    import trimesh

    lines = _Lines(_decoded(source.read()))
    check_counts(lines.triangle_count)
    if lines.triangle_count == 0:
        return Model(pieces=[], materials=[])
    defined: dict[str, mtl.Entry] = {}
    for name in dict.fromkeys(lines.libraries):
        defined |= mtl.parse(_decoded(source.read_name(name, "mtllib", limit=mtl.MAX_BYTES)))
    warnings = ["points and lines are ignored"] if lines.has_lines else []
    facts = []
    for name in lines.materials:
        if name in defined:
            facts.append(defined[name].facts(source, warnings))
        else:
            warnings.append(f"the material {name!r} is not defined")
            facts.append(MaterialFacts(name=name, double_sided=True))
    facts.append(MaterialFacts(name="default", double_sided=True))
    numbered = "".join(f"newmtl {number}\n" for number in range(len(lines.materials)))
    scene = trimesh.load_scene(
        io.BytesIO("\n".join(["mtllib numbered", *lines.out, ""]).encode()),
        file_type="obj",
        resolver={"numbered": numbered.encode()},
        process=False,
        split_objects=True,
    )
    pieces = []
    for name, mesh in scene.geometry.items():
        slot = _material_slot(mesh, len(facts) - 1)
        entry = defined.get(facts[slot].name) if slot < len(lines.materials) else None
        pieces.append(
            Piece(
                mesh=lines.objects[int(name.split("_")[0])],
                material=slot,
                positions=np.array(mesh.vertices, dtype=np.float64),
                triangles=np.array(mesh.faces, dtype=np.int64),
                colors=_colors(mesh, entry),
                normals=_normals(mesh, lines),
                uvs=_uvs(mesh, lines),
            )
        )
    if all(piece.material != len(facts) - 1 for piece in pieces):
        facts.pop()
    # trimesh hands the meshes over last first
    return Model(pieces=pieces[::-1], materials=facts, warnings=warnings)


def _decoded(data: bytes) -> str:
    """Text with single line ends; bytes that are no UTF-8 are taken as Latin-1."""
    if b"\0" in data:
        msg = "it is no text"
        raise PlantFileError(msg)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")


class _Lines:
    """The lines of an OBJ file in the form that trimesh reads rightly."""

    def __init__(self, text: str) -> None:
        self.libraries: list[str] = []
        self.materials: list[str] = []
        self.objects = ["object 0"]
        self.has_lines = False
        self.counts = dict.fromkeys(KINDS, 0)
        self.out = ["o 0"]
        self.face_rows: list[int] = []
        has_objects = re.search(r"^\s*o\s", text, re.MULTILINE) is not None
        for number, line in enumerate(text.split("\n"), 1):
            words = line.split(None, 1)
            if not words or words[0][0] == "#":
                continue
            key, rest = words[0], words[1].strip() if len(words) > 1 else ""
            if key in self.counts:
                self.counts[key] += 1
                self.out.append(f"{key} {rest}")
            elif key == "f":
                self.face_rows.append(len(self.out))
                if "-" in rest:
                    rest = self.absolute(rest, number)
                self.out.append("f " + " ".join(rest.split()))
            elif key == "usemtl":
                if rest not in self.materials:
                    self.materials.append(rest)
                self.out.append(f"usemtl {self.materials.index(rest)}")
            elif key == "o" or (key == "g" and not has_objects):
                self.out.append(f"o {len(self.objects)}")
                self.objects.append(rest or f"object {len(self.objects)}")
            elif key == "mtllib":
                self.libraries.append(rest)
            elif key in ("l", "p"):
                self.has_lines = True
        self.kinds = self.unify()
        self.triangle_count = len(self.face_rows)

    def absolute(self, corners: str, number: int) -> str:
        """Turn indices counted back from the latest line into ones counted from the first."""

        def resolved(corner: str) -> str:
            parts = []
            for kind, part in zip(KINDS, corner.split("/"), strict=False):
                if part.startswith("-"):
                    index = int(part) + self.counts[kind] + 1
                    if index < 1:
                        msg = f"line {number}: there is no {kind} {part}"
                        raise PlantFileError(msg)
                    part = str(index)
                parts.append(part)
            return "/".join(parts)

        return " ".join(resolved(corner) for corner in corners.split())

    def unify(self) -> tuple[str, ...]:
        """Bring all faces into one form, and tell which kinds of indices they have."""
        joined = "".join(self.out[row] + "\n" for row in self.face_rows)
        for kinds, pattern in PLAIN_FACES.items():
            if pattern.fullmatch(joined):
                numbers = np.fromstring(
                    joined.replace("f", " ").replace("/", " "), dtype=np.int64, sep=" "
                ).reshape(-1, len(kinds))
                for kind, highest in zip(kinds, numbers.max(axis=0), strict=True):
                    self.check_index(kind, int(highest))
                return kinds
        return self.rewrite() if self.face_rows else ("v",)

    def check_index(self, kind: str, index: int) -> None:
        if not 1 <= index <= self.counts[kind]:
            msg = f"a face refers to {kind} {index}, but there are {self.counts[kind]}"
            raise PlantFileError(msg)

    def rewrite(self) -> tuple[str, ...]:
        """Fans of triangles, with every index; those that a face lacks point to a zero."""
        lacking = {kind: f"{self.counts[kind] + 1}" for kind in ("vt", "vn")}
        fans = []
        for row in self.face_rows:
            corners = []
            for corner in self.out[row].split()[1:]:
                parts = [*corner.split("/"), "", ""][:3]
                indices = []
                for kind, part in zip(KINDS, parts, strict=True):
                    if part or kind == "v":
                        self.check_index(kind, int(part))
                        indices.append(part)
                    else:
                        indices.append(lacking[kind])
                corners.append("/".join(indices))
            if len(corners) < 3:
                msg = f"a face has {len(corners)} corners"
                raise PlantFileError(msg)
            fans.append([f"f {corners[0]} {b} {c}" for b, c in itertools.pairwise(corners[1:])])
        for row, fan_rows in zip(self.face_rows, fans, strict=True):
            self.out[row] = "\n".join(fan_rows)
        self.face_rows = [row for row, fan in zip(self.face_rows, fans, strict=True) for _ in fan]
        has = tuple(kind for kind in KINDS if self.counts[kind])
        # v runs up, so this is (0, 0) once it runs down
        self.out += ["vt 0 1", "vn 0 0 0"]
        return has


def _material_slot(mesh: Any, default: int) -> int:
    name = getattr(getattr(mesh.visual, "material", None), "name", None)
    return int(name) if isinstance(name, str) and name.isdigit() else default


def _colors(mesh: Any, entry: mtl.Entry | None) -> NDArray[np.float32]:
    """Return the material's colour, else vertex colours (sRGB) where there are any, else white."""
    count = len(mesh.vertices)
    if entry is not None:
        return np.tile(np.array(entry.color, np.float32), (count, 1))
    if mesh.visual.kind == "vertex":
        codes = np.asarray(mesh.visual.vertex_colors)[:, :3] / 255
        return np.column_stack([linear_from_srgb(codes), np.ones(count)]).astype(np.float32)
    return np.ones((count, 4), np.float32)


def _normals(mesh: Any, lines: _Lines) -> NDArray[np.float64] | None:
    if "vn" not in lines.kinds:
        return None
    # without normals of its own a mesh would compute some
    if "vertex_normals" not in mesh._cache:
        msg = "its normals could not be read"
        raise PlantFileError(msg)
    return np.array(mesh.vertex_normals, dtype=np.float64)


def _uvs(mesh: Any, lines: _Lines) -> NDArray[np.float32] | None:
    if "vt" not in lines.kinds:
        return None
    uvs = getattr(mesh.visual, "uv", None)
    if uvs is None or len(uvs) != len(mesh.vertices):
        msg = "its texture coordinates could not be read"
        raise PlantFileError(msg)
    return np.column_stack([uvs[:, 0], 1 - uvs[:, 1]]).astype(np.float32)
