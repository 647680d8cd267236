"""
PLY, text or binary, parsed by trimesh after its header was checked.

trimesh takes the header's counts on trust (a text that ends early just gives fewer rows) and loads
a picture without looking at its size, so both are done here. Vertex colours are taken as sRGB,
which is what scanners and modellers write; a file with texture coordinates is coloured by its
picture (``comment TextureFile``) alone. All faces of a binary file must have the same number of
corners.
"""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from treelod.color import linear_from_srgb
from treelod.errors import PlantFileError
from treelod.plant_files.model import AlphaMode, MaterialFacts, Model, Piece, check_counts
from treelod.plant_files.sources import Source

__all__ = ["read"]

MAX_HEADER_BYTES = 1 << 16
"""A header is a few hundred bytes."""

MASK_CUTOFF = 0.5


def read(source: Source) -> Model:
    """Read a ``.ply`` file and the picture that it names."""
    import trimesh

    data = source.read()
    counts, properties, picture = _header(data)
    if counts.get("face", 0) == 0:
        return Model(pieces=[], materials=[])
    check_counts(counts["face"])
    # an edge makes trimesh read the file as a drawing, not a mesh
    if "edge" in counts:
        msg = "edges are not read; write the mesh without them"
        raise PlantFileError(msg)
    texture = None
    if picture is not None:
        texture = source.read_picture(picture, "TextureFile", "its TextureFile")
    scene = trimesh.load_scene(
        io.BytesIO(data), file_type="ply", process=False, skip_materials=True
    )
    (mesh,) = scene.geometry.values()
    raw = mesh.metadata["_ply_raw"]
    for name, count in counts.items():
        if count and len(_rows(raw[name]["data"])) != count:
            msg = f"cut short: it states {count} elements {name!r} and holds fewer"
            raise PlantFileError(msg)
    uvs = getattr(mesh.visual, "uv", None)
    if uvs is not None:
        uvs = np.column_stack([uvs[:, 0], 1 - uvs[:, 1]]).astype(np.float32)
    if texture is not None and uvs is None:
        msg = "it names a picture but has no texture coordinates"
        raise PlantFileError(msg)
    name = source.path.stem
    has_normals = {"nx", "ny", "nz"} <= properties and "vertex_normals" in mesh._cache
    piece = Piece(
        mesh=name,
        material=0,
        positions=np.array(mesh.vertices, dtype=np.float64),
        triangles=np.array(mesh.faces, dtype=np.int64),
        colors=_colors(mesh),
        normals=np.array(mesh.vertex_normals, dtype=np.float64) if has_normals else None,
        uvs=uvs,
    )
    mode: AlphaMode = "opaque"
    if texture is not None and int(texture[..., 3].min()) < 255:
        mode = "mask"
    facts = MaterialFacts(
        name=name, texture=texture, alpha_mode=mode, alpha_cutoff=MASK_CUTOFF, double_sided=True
    )
    return Model(pieces=[piece], materials=[facts])


def _header(data: bytes) -> tuple[dict[str, int], set[str], str | None]:
    """Element counts, properties of the vertices, and the name of the picture."""
    end = data.find(b"end_header", 0, MAX_HEADER_BYTES)
    if not data.startswith(b"ply") or end < 0:
        msg = "no PLY file: its header does not begin with ply or does not end"
        raise PlantFileError(msg)
    counts: dict[str, int] = {}
    properties = set()
    picture = None
    for line in data[:end].decode("latin-1").splitlines():
        words = line.split()
        if words[:1] == ["element"]:
            if len(words) != 3 or not words[2].isdigit():
                msg = f"its header says {line!r}"
                raise PlantFileError(msg)
            counts[words[1]] = int(words[2])
        elif words[:1] == ["property"] and list(counts) == ["vertex"]:
            properties.add(words[-1])
        elif words[:1] == ["comment"] and "texturefile" in line.lower():
            picture = line[line.lower().index("texturefile") + len("texturefile") :].strip()
    # whatever an element holds, it takes a byte at least
    if sum(counts.values()) > len(data) - end:
        msg = f"cut short: it states {sum(counts.values())} elements in {len(data) - end} bytes"
        raise PlantFileError(msg)
    return counts, properties, picture


def _rows(data: Any) -> Any:
    """Rows of an element as trimesh keeps them: a table, or a column for each property."""
    if isinstance(data, dict):
        return next(iter(data.values()))
    return () if data is None else data


def _colors(mesh: Any) -> NDArray[np.float32]:
    count = len(mesh.vertices)
    if mesh.visual.kind != "vertex":
        return np.ones((count, 4), np.float32)
    codes = np.asarray(mesh.visual.vertex_colors) / 255
    return np.column_stack([linear_from_srgb(codes[:, :3]), codes[:, 3]]).astype(np.float32)
