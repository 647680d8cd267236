"""
What a plant file holds: triangles and materials, checked, in the file's own frame.

`read` is the one door. Whatever is wrong inside a file comes out of it as `PlantFileError` with the
file's name and the thing that is wrong; a file is never trusted with an index, a size or a path.
"""

import os
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from treelod.errors import LimitError, PlantFileError
from treelod.plant_files.model import MaterialFacts, Model, Piece
from treelod.plant_files.sources import Source

__all__ = ["SUFFIXES", "MaterialFacts", "Model", "Piece", "read"]

SUFFIXES = (".glb", ".gltf", ".obj", ".ply")
"""File names that are read, in any case."""


def read(path: str | os.PathLike[str]) -> Model:
    """
    Read the triangles and materials of a plant file.

    Parameters
    ----------
    path : path-like
        A ``.glb``, ``.gltf``, ``.obj`` or ``.ply`` file. What it refers to must lie in its folder
        or below.

    Returns
    -------
    Model

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    PlantFileError
        If the file is damaged, refused, without triangles, or of a kind that is not read.
    LimitError
        If it holds more triangles than the limit.
    """
    source = Source(Path(path))
    suffix = source.path.suffix.lower()
    if suffix not in SUFFIXES:
        msg = f"{path}: files ending in {suffix!r} are not read, only {', '.join(SUFFIXES)}"
        raise PlantFileError(msg)
    try:
        # a transform may carry positions out of range; `check` then says which
        with warnings.catch_warnings(), np.errstate(over="ignore", invalid="ignore"):
            # NumPy only warns where a text holds something that is no number
            warnings.filterwarnings(
                "error", category=DeprecationWarning, message=".*string or file"
            )
            model = _reader(suffix)(source)
        model.check()
    except LimitError as error:
        msg = f"{path}: {error}"
        raise LimitError(msg) from error
    except PlantFileError as error:
        msg = f"{path}: {error}"
        raise PlantFileError(msg) from error
    except Exception as error:
        # whatever a parser stumbles over in a damaged file
        reason = str(error) or "no reason given"
        msg = f"{path}: damaged, or no {suffix[1:].upper()} file ({type(error).__name__}: {reason})"
        raise PlantFileError(msg) from error
    for text in model.warnings:
        warnings.warn(f"{path}: {text}", UserWarning, stacklevel=3)
    return model


def _reader(suffix: str) -> Callable[[Source], Model]:
    # imported at need: trimesh takes a third of a second
    if suffix == ".obj":
        from treelod.plant_files import obj

        return obj.read
    if suffix == ".ply":
        from treelod.plant_files import ply

        return ply.read
    from treelod.plant_files import gltf

    return gltf.read
