"""Where the real plants are that some tests load."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def models():
    """Folder of the real plants: TREELOD_MODELS, else `shared/models` beside the project."""
    stated = os.environ.get("TREELOD_MODELS")
    folder = Path(stated) if stated else Path(__file__).parents[2] / "shared" / "models"
    if not folder.is_dir():
        if stated:
            pytest.fail(f"TREELOD_MODELS names {folder}, which is no folder")
        pytest.skip(f"needs the real plants: no {folder}; set TREELOD_MODELS")
    return folder
