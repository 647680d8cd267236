"""
What pytest loads of treelod by itself: an option and two fixtures, and no more until they are used.

It is a package of its own because pytest imports it in every session of an environment that has
treelod, and importing anything from ``treelod`` imports numpy and the extension. What tests call is
in `treelod.testing`.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Generator

    from treelod.testing import PlantFactory, ReferenceFactory

_running: list[pytest.Item] = []
"""Tests that run; more than one where a test runs pytest."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--treelod-pictures``."""
    parser.getgroup("treelod").addoption(
        "--treelod-pictures",
        metavar="DIR",
        default=None,
        help="folder for the pictures of frames that are not close; default: the test's own",
    )


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, None]:
    """Remember which test runs, for where its pictures go."""
    _running.append(item)
    try:
        yield
    finally:
        _running.pop()


def picture_place() -> tuple[Path, str] | None:
    """
    Say where the running test's pictures go.

    Returns
    -------
    tuple of Path and str, or None
        Folder and the beginning of a file's name; None where no test runs.
    """
    if not _running:
        return None
    item = _running[-1]
    name = re.sub(r"[^\w.-]+", "_", item.nodeid.rpartition("/")[2])[-100:].strip("_.")
    asked = item.config.getoption("--treelod-pictures")
    if asked is not None:
        # relative to where pytest was started, wherever the test has gone since
        return Path(item.config.invocation_params.dir, asked), name
    request = getattr(item, "_request", None)
    return None if request is None else (Path(request.getfixturevalue("tmp_path")), name)


@pytest.fixture(scope="session")
def treelod_plant() -> PlantFactory:
    """Plants by preset or file, each made once a session; see `treelod.testing.PlantFactory`."""
    from treelod.testing import PlantFactory

    return PlantFactory()


@pytest.fixture(scope="session")
def treelod_reference() -> ReferenceFactory:
    """Frames of full meshes, each drawn once; see `treelod.testing.ReferenceFactory`."""
    from treelod.testing import ReferenceFactory

    return ReferenceFactory()
