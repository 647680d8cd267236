"""
What a plant consists of, as bytes: how it travels to other processes, and what names it.

A plant that is read back is the same plant: it draws the same bytes, has the same footprint and
the same digest. Colours under its light are not stored: they follow from the rest, exactly.
"""

from __future__ import annotations

import hashlib
import io
import json
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from treelod import _core
from treelod.errors import StoreError

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["content_digest", "core_from_bytes", "core_to_bytes"]

_FORMAT = "treelod plant 1"

_MESH_ARRAYS = {
    "positions": "positions",
    "normals": "normals",
    "uvs": "uvs",
    "base": "colors",
    "triangles": "triangles",
    "material_ids": "material_ids",
}
"""Arrays of a mesh that the others follow from, and what the constructor calls them."""


def content_digest(core: _core.Plant) -> str:
    """
    Name a plant by all that it draws: two plants of one digest are the same but for their names.

    Parameters
    ----------
    core : _core.Plant
        The plant.

    Returns
    -------
    str
        SHA-256 of its meshes, leaves, branches, materials, textures, light and origin, in 64
        hexadecimal digits.
    """
    facts, arrays = _parts(core)
    del facts["name"]
    digest = hashlib.sha256(_json(facts))
    for name, array in arrays:
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def core_to_bytes(core: _core.Plant, extra: object = None) -> bytes:
    """
    Write a plant down.

    Parameters
    ----------
    core : _core.Plant
        The plant.
    extra : object, optional
        Anything that JSON holds, given back by `core_from_bytes`.

    Returns
    -------
    bytes
        An uncompressed NumPy archive.
    """
    facts, arrays = _parts(core)
    header = _json({"format": _FORMAT, "facts": facts, "extra": extra})
    out = io.BytesIO()
    named: dict[str, Any] = {"header": np.frombuffer(header, np.uint8), **dict(arrays)}
    np.savez(out, **named)
    return out.getvalue()


def core_from_bytes(data: bytes) -> tuple[_core.Plant, Any]:
    """
    Read a plant that `core_to_bytes` has written.

    Parameters
    ----------
    data : bytes
        The archive. It is data: nothing in it is executed.

    Returns
    -------
    _core.Plant, object
        The plant, and what was written with it.

    Raises
    ------
    StoreError
        If it is no plant, or damaged.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            header = json.loads(archive["header"].tobytes())
            if header["format"] != _FORMAT:
                msg = f"stored plant: its format is {header['format']!r}, not {_FORMAT!r}"
                raise StoreError(msg)
            arrays = {name: archive[name] for name in archive.files if name != "header"}
        facts = header["facts"]
        return _core.Plant(**_arguments(facts, arrays)), header["extra"]
    except StoreError:
        raise
    # zipfile, json, NumPy and the core each have words of their own for what is no plant
    except Exception as error:
        msg = f"stored plant: it is damaged, or no plant ({error})"
        raise StoreError(msg) from error


def _parts(core: _core.Plant) -> tuple[dict[str, Any], list[tuple[str, NDArray[Any]]]]:
    """Split a plant into plain facts and named arrays; a texture that is shared comes once."""
    arrays: list[tuple[str, NDArray[Any]]] = []
    for part, mesh in (("wood", core.wood), ("foliage", core.foliage)):
        facts_of = cast("dict[str, NDArray[Any]]", mesh)
        arrays.extend((f"{part}_{name}", facts_of[name]) for name in _MESH_ARRAYS)
    arrays.append(("leaf_offsets", core.leaves[0]))
    structure = cast("dict[str, NDArray[Any]] | None", core.structure)
    arrays.extend((f"structure_{name}", array) for name, array in (structure or {}).items())
    textures: list[NDArray[np.uint8]] = []
    materials = []
    for material in core.materials:
        texture = material["texture"]
        index = None
        if texture is not None:
            known = [i for i, other in enumerate(textures) if other is texture]
            index = known[0] if known else len(textures)
            if not known:
                textures.append(texture)
        materials.append({**material, "texture": index})
    arrays.extend((f"texture_{index}", texture) for index, texture in enumerate(textures))
    facts = {
        "name": core.name,
        "origin": list(core.origin),
        "materials": materials,
        "lighting": dict(core.lighting),
        "has_structure": structure is not None,
    }
    return facts, arrays


def _arguments(facts: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Return what the core's constructor takes."""

    def mesh(part: str) -> dict[str, NDArray[Any]]:
        return {called: arrays[f"{part}_{name}"] for name, called in _MESH_ARRAYS.items()}

    materials = [
        {
            **material,
            "wrap": tuple(material["wrap"]),
            "texture": None
            if material["texture"] is None
            else arrays[f"texture_{material['texture']}"],
        }
        for material in facts["materials"]
    ]
    prefix = "structure_"
    structure = {
        name.removeprefix(prefix): array
        for name, array in arrays.items()
        if name.startswith(prefix)
    }
    return {
        "name": facts["name"],
        "origin": facts["origin"],
        "materials": materials,
        "wood": mesh("wood"),
        "foliage": mesh("foliage"),
        "leaf_offsets": arrays["leaf_offsets"],
        "lighting": facts["lighting"],
        "structure": structure if facts["has_structure"] else None,
    }


def _json(facts: object) -> bytes:
    # floats are written so that they are read back exactly
    return json.dumps(facts, sort_keys=True, allow_nan=False).encode()
