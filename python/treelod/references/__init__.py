"""
Whether treelod is right, by programs that share no code with it: mitsuba, embree and trimesh.

Each renderer runs in a process of its own, because one that aborts must not take a session with it,
and its pictures are kept by the hash of what went in. Needs ``pip install 'treelod[validate]'``.
"""

import importlib
from typing import TYPE_CHECKING, Any

from treelod.references.checks import Check, Panel, Section
from treelod.references.runner import ReferenceFailedError, require

if TYPE_CHECKING:
    from treelod.references.validation import Validation, validate

__all__ = [
    "Check",
    "Panel",
    "ReferenceFailedError",
    "Section",
    "Validation",
    "require",
    "validate",
]


def __getattr__(name: str) -> Any:
    # each child process imports this package, and need not wait for what only the parent uses
    if name in {"Validation", "validate"}:
        return getattr(importlib.import_module("treelod.references.validation"), name)
    msg = f"module 'treelod.references' has no attribute {name!r}"
    raise AttributeError(msg)
