"""
Which code computes the numbers: results of two versions must not be mixed by accident.

The version is a hash of the Rust core's sources and its locked libraries, of the Python modules
below that take part in a row of results, and of the libraries that measure. Documents, plots,
reports, the command line and the sweep's own bookkeeping are not in it.
"""

from __future__ import annotations

import functools
import hashlib
from importlib import metadata
from pathlib import Path

from treelod import _core

__all__ = ["LIBRARIES", "MODULES", "kernel_version"]

MODULES = (
    "cameras.py",
    "clusters.py",
    "collapse.py",
    "color.py",
    "columns.py",
    "comparison.py",
    "criteria.py",
    "mesh_arrays.py",
    "metrics.py",
    "plant.py",
    "plant_content.py",
    "render.py",
    "results.py",
    "scenes.py",
    "sweeps/worker.py",
    "techniques/*.py",
    "variety.py",
    "wind.py",
)
"""Python files that take part in a row of results, relative to the package."""

LIBRARIES = ("numpy", "openimageio", "scikit-image", "scipy")
"""Distributions whose versions can change a number."""


@functools.cache
def kernel_version() -> str:
    """
    Name the code that computes.

    Returns
    -------
    str
        32 hexadecimal digits. A build without optimisation has another version, since its times
        say nothing.
    """
    digest = hashlib.sha256(f"{_core.source_hash} {_core.build_profile}\n".encode())
    for name in LIBRARIES:
        digest.update(f"{name} {metadata.version(name)}\n".encode())
    package = Path(__file__).parent
    for pattern in MODULES:
        for file in sorted(package.glob(pattern)):
            text = file.read_bytes().replace(b"\r", b"")
            digest.update(f"{file.relative_to(package).as_posix()} {len(text)}\n".encode())
            digest.update(text)
    return digest.hexdigest()[:32]
