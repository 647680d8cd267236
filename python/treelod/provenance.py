"""
Where a number comes from: versions, machine, source revision, input file.

Every stored row carries these, so that two results can be told apart years later.
"""

from __future__ import annotations

import datetime
import hashlib
import importlib.metadata
import os
import platform
import subprocess
from dataclasses import dataclass
from pathlib import Path

__all__ = ["PACKAGES", "Provenance", "core_count", "cpu_name", "file_sha256", "provenance"]

PACKAGES = ("numpy", "openimageio", "scikit-image", "trimesh", "pandas", "matplotlib")
"""Distributions besides treelod whose versions can change a number or a plot."""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """
    What produced a result.

    Attributes
    ----------
    treelod : str
        Version of treelod.
    git_commit : str or None
        Revision of the checkout treelod runs from, with ``+changes`` if its files differ from it;
        None outside a checkout.
    build_profile : str
        How the Rust core was compiled: "release" or "debug".
    packages : dict of str to str
        Versions of the libraries in `PACKAGES`.
    python, platform, cpu : str
        Version of Python, operating system, name of the processor.
    core_count : int
        Logical processors this process may run on.
    date : str
        When, in UTC, ISO 8601, to the second.
    """

    treelod: str
    git_commit: str | None
    build_profile: str
    packages: dict[str, str]
    python: str
    platform: str
    cpu: str
    core_count: int
    date: str


def provenance() -> Provenance:
    """
    Collect what this process is made of.

    Returns
    -------
    Provenance
    """
    return Provenance(
        treelod=_version("treelod"),
        git_commit=_git_commit(),
        build_profile=_build_profile(),
        packages={name: _version(name) for name in PACKAGES},
        python=platform.python_version(),
        platform=f"{platform.system()} {platform.release()} {platform.machine()}",
        cpu=cpu_name(),
        core_count=core_count(),
        date=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )


def core_count() -> int:
    """
    Return how many logical processors this process may run on.

    Returns
    -------
    int
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cpu_name() -> str:
    """
    Return the name of the processor.

    Returns
    -------
    str
        As the system has it; "unknown" where it has none.
    """
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() in ("model name", "Model"):
                return value.strip()
    return platform.processor() or platform.machine() or "unknown"


def file_sha256(path: str | os.PathLike[str]) -> str:
    """
    Return the SHA-256 of a file's bytes.

    Parameters
    ----------
    path : path-like
        The file; files it refers to are not read.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def _git_commit() -> str | None:
    folder = Path(__file__).resolve().parent

    def git(*arguments: str) -> str | None:
        command = ["git", "-C", str(folder), *arguments]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    # an installed copy may lie inside somebody else's repository, which does not track it
    if git("ls-files", "--error-unmatch", Path(__file__).name) is None:
        return None
    commit = git("rev-parse", "HEAD")
    if commit is None:
        return None
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ":/src", ":/python")
    return f"{commit}+changes" if changed else commit


def _build_profile() -> str:
    from treelod import _core

    return str(getattr(_core, "build_profile", "unknown"))
