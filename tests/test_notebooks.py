"""Do the notebooks run from top to bottom, and do their stored outputs belong to their texts?"""

import base64
import copy
import io
import os
import re
import subprocess
import sys
from pathlib import Path

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).parents[1] / "notebooks"
TEXTS = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
NAMES = [path.stem for path in TEXTS]

MAX_BYTES = 500_000
"""Of a notebook with its outputs: code hosts show no large ones, and every version is kept."""

FOREIGN = re.compile(
    r"/(home|root|tmp|work|Users|mnt|var)/|[A-Z]:\\\\|0x[0-9a-f]{6,}|127\.0\.0\.1:\d+"
)
"""What says on which machine a notebook ran: paths, addresses in memory, ports."""


def source_of(notebook):
    """What a notebook and its text have in common."""
    return [(c.cell_type, c.source, c.metadata.get("tags", [])) for c in notebook.cells]


def outputs_of(notebook):
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def texts_of(outputs):
    """All that is to be read in outputs."""
    found = []
    for output in outputs:
        found.append(output.get("text", ""))
        data = output.get("data", {})
        found += [data[kind] for kind in ("text/plain", "text/html") if kind in data]
    return found


def faults(notebook, text):
    """What is wrong with a stored notebook, in words."""
    found = []
    if source_of(notebook) != source_of(text):
        found.append("text and notebook differ")
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    if [cell.execution_count for cell in code] != list(range(1, len(code) + 1)):
        found.append("not run from top to bottom")
    outputs = outputs_of(notebook)
    if any(output.output_type == "error" for output in outputs):
        found.append("an error")
    if any(output.get("name") == "stderr" for output in outputs):
        found.append("a warning")
    if not any("image/png" in output.get("data", {}) for output in outputs):
        found.append("no picture")
    if any("widget" in kind for output in outputs for kind in output.get("data", {})):
        found.append("a widget, which is nothing without a kernel")
    if any(FOREIGN.search(part) for part in texts_of(outputs)):
        found.append("a trace of the machine")
    if notebook.metadata.get("kernelspec", {}).get("name") != "python3":
        found.append("no kernel")
    if sum("parameters" in cell.metadata.get("tags", []) for cell in code) != 1:
        found.append("not one cell of parameters")
    return found


def read(name):
    return nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)


@pytest.mark.parametrize("name", NAMES)
def test_the_stored_notebook_is_the_text_run_from_top_to_bottom(name):
    notebook = read(name)
    nbformat.validate(notebook)
    assert not faults(notebook, jupytext.read(FOLDER / f"{name}.py")), "run `make notebooks`"
    assert (FOLDER / f"{name}.ipynb").stat().st_size < MAX_BYTES


def test_every_notebook_has_a_text():
    assert sorted(path.stem for path in FOLDER.glob("*.ipynb")) == NAMES
    assert len(NAMES) >= 7


@pytest.mark.parametrize("name", NAMES)
def test_every_stored_picture_shows_something(name):
    for output in outputs_of(read(name)):
        if "image/png" in output.get("data", {}):
            with Image.open(io.BytesIO(base64.b64decode(output.data["image/png"]))) as picture:
                assert min(picture.size) > 100, picture.size
                assert len(picture.convert("RGB").getcolors(1 << 24)) > 8, "one colour, or nearly"


def _set(path, value):
    """Change one thing of a notebook: where, and to what."""

    def change(notebook):
        *way, last = path
        part = notebook
        for key in way:
            part = part[key]
        part[last] = value

    return change


FIRST_CODE = 1
CHANGES = {
    "text and notebook differ": _set(("cells", 0, "source"), "# Another title"),
    "not run from top to bottom": _set(("cells", FIRST_CODE, "execution_count"), None),
    "an error": _set(
        ("cells", FIRST_CODE, "outputs"),
        [nbformat.v4.new_output("error", ename="ValueError", evalue="", traceback=[])],
    ),
    "a warning": _set(
        ("cells", FIRST_CODE, "outputs"),
        [nbformat.v4.new_output("stream", name="stderr", text="!")],
    ),
    "a widget, which is nothing without a kernel": _set(
        ("cells", FIRST_CODE, "outputs"),
        [
            nbformat.v4.new_output(
                "display_data",
                {"application/vnd.jupyter.widget-view+json": {}, "text/plain": "bar"},
            )
        ],
    ),
    "a trace of the machine": _set(
        ("cells", FIRST_CODE, "outputs"),
        [nbformat.v4.new_output("stream", name="stdout", text="<Plant at 0x7f3a5c0012d0>")],
    ),
    "no kernel": _set(("metadata", "kernelspec"), {}),
    "not one cell of parameters": _set(("cells", FIRST_CODE, "metadata", "tags"), ["parameters"]),
}


@pytest.mark.parametrize("fault", CHANGES)
def test_each_fault_is_found(fault):
    text = jupytext.read(TEXTS[0])
    notebook = read(NAMES[0])
    assert notebook.cells[FIRST_CODE].cell_type == "code"
    assert not faults(notebook, text)
    CHANGES[fault](notebook)
    assert fault in faults(notebook, text)


def test_a_notebook_without_pictures_is_found():
    notebook = copy.deepcopy(read(NAMES[0]))
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = []
    assert faults(notebook, jupytext.read(TEXTS[0])) == ["no picture"]


def test_a_sweep_shows_one_line_in_a_notebook(tmp_path):
    code = f"""
        import treelod as tl
        plant = tl.grow_plant("chestnut", leaf_count=40)
        cameras = tl.orbit(plant, count=3, size=(40, 40))
        settings = {{"reference_samples": 16, "store": {str(tmp_path / "rows")!r}}}
        for timing in ("none", "exclusive"):
            table = tl.sweep(plant, ["stochastic_pruning"], cameras, timing=timing, **settings)
        quiet = tl.sweep(plant, [], cameras, timing="none", progress=False, **settings)
    """
    cell = nbformat.v4.new_code_cell(
        "\n".join(line.strip() for line in code.splitlines()).replace("\ntable", "\n    table")
    )
    notebook = nbformat.v4.new_notebook(cells=[cell])
    NotebookClient(notebook, timeout=100, kernel_name="python3").execute()
    shown = [(output.output_type, dict(output.data)) for output in cell.outputs]
    assert shown == [
        ("display_data", {"text/plain": "cells: 6 of 6"}),
        ("display_data", {"text/plain": "cells: 6 of 6, timing: 6 of 6"}),
    ]


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_on_small_settings(name):
    """As `pytest --nbmake` does, in a process of its own: it also says which cell failed."""
    run = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-o", "addopts=", "-q", "--timeout=300"),
            *("--nbmake", "--nbmake-timeout=300", f"notebooks/{name}.ipynb"),
        ],
        cwd=FOLDER.parent,
        env={**os.environ, "TREELOD_NOTEBOOK_SCALE": "small"},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "1 passed" in run.stdout
