"""
Runs the notebooks from top to bottom, and stores each with its outputs beside its text.

`make notebooks` runs all of them, from nothing: rows of earlier sweeps are thrown away. Names as
arguments (`02 06`) run some. The text is NAME.py, which is what to edit; NAME.ipynb is made here.
What differs from run to run without need is left out, and pictures are stored with 256 colours.
"""

from __future__ import annotations

import base64
import io
import os
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import jupytext
import nbformat
from nbclient import NotebookClient
from PIL import Image

if TYPE_CHECKING:
    from nbformat import NotebookNode

HERE = Path(__file__).parent
SWEEPS = HERE / "sweeps"
"""Where the notebooks keep the rows of their sweeps."""

TIMEOUT_SECS = 900


def texts(names: list[str]) -> list[Path]:
    """List the notebooks whose names begin so; all of them without a name."""
    found = sorted(HERE.glob("[0-9][0-9]_*.py"))
    return [path for path in found if not names or any(path.name.startswith(n) for n in names)]


def execute(path: Path) -> NotebookNode:
    """Run a notebook in a process of its own, in this folder."""
    notebook = jupytext.read(path)
    for number, cell in enumerate(notebook.cells, start=1):
        # ids by place: random ones would differ each time
        cell.id = f"cell-{number:02d}"
    client = NotebookClient(
        notebook,
        timeout=TIMEOUT_SECS,
        resources={"metadata": {"path": str(HERE)}},
        record_timing=False,
    )
    client.execute()
    return plain(notebook)


def plain(notebook: NotebookNode) -> NotebookNode:
    """Leave out what a reader does not see: the Python's version, names of pictures in memory."""
    notebook.metadata.pop("language_info", None)
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                output.data = {"image/png": smaller(output.data["image/png"])}
    return notebook


def smaller(text: str) -> str:
    """Store a picture, as a notebook holds it, with the 256 colours that suit it best."""
    file = io.BytesIO()
    with Image.open(io.BytesIO(base64.b64decode(text))) as picture:
        # rare colours too: the ends of a scale
        colors = picture.convert("RGB").quantize(
            256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
        )
    colors.save(file, "png", optimize=True)
    return base64.b64encode(file.getvalue()).decode()


def main() -> None:
    """Run the notebooks that the command line names."""
    shutil.rmtree(SWEEPS, ignore_errors=True)
    # tiny settings are for tests
    os.environ.pop("TREELOD_NOTEBOOK_SCALE", None)
    for path in texts(sys.argv[1:]):
        start, before = time.perf_counter(), os.times()
        notebook = execute(path)
        after = os.times()
        target = path.with_suffix(".ipynb")
        nbformat.write(notebook, target)
        spent = after.children_user - before.children_user
        spent += after.children_system - before.children_system
        print(
            f"{target.name}: {time.perf_counter() - start:.0f} s, {spent:.0f} s of processors, "
            f"{target.stat().st_size / 1000:.0f} kB",
            flush=True,
        )


if __name__ == "__main__":
    main()
