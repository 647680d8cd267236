"""Writes a validation down: ``validation.html``, ``validation.json`` and the pictures."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import numpy as np

from treelod.color import quantize
from treelod.files import atomic_write
from treelod.references.checks import words_for
from treelod.report import images, text
from treelod.report.page import check_folder

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from treelod.references import Panel, Validation

__all__ = ["write_validation"]


def write_validation(validation: Validation, directory: str | os.PathLike[str]) -> Path:
    """
    Write the report of a validation.

    Parameters
    ----------
    validation : Validation
        From `treelod.references.validate`.
    directory : path-like
        Folder for the files; made with its parents if it is missing.

    Returns
    -------
    Path
        The page, ``validation.html``, self-contained. Beside it ``validation.json`` with all
        figures, and ``pictures/*.png``: ours, the reference and the difference side by side.

    Raises
    ------
    NotADirectoryError
        If `directory`, or a part of its path, is a file.
    OSError
        If a file cannot be written.
    """
    folder = Path(directory)
    check_folder(folder)
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    figures = validation.figures()
    data = json.dumps(figures, indent=1, allow_nan=False, default=str)
    atomic_write(folder / "validation.json", data.encode())
    sections = []
    for section in validation.sections:
        rows = []
        for panel in section.panels:
            parts = _parts(panel)
            name = re.sub(r"[^A-Za-z0-9]+", "_", f"{section.title} {panel.title}").lower()[:60]
            strip = images.strip(list(parts.values()))
            atomic_write(folder / "pictures" / f"{name}.png", images.png(strip))
            shown = []
            for title, picture in parts.items():
                uri, width = images.overview(picture)
                shown.append({"title": title, "uri": uri, "width": width})
            rows.append({"title": panel.title, "scale": _scale(panel), "parts": shown})
        sections.append(
            {
                "title": section.title,
                "what": section.what,
                "passed": section.passed,
                "checks": section.checks,
                "rows": rows,
            }
        )
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("treelod.report", "."),
        # names of plants and files come from outside
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = figure
    environment.filters["count"] = text.count
    page = environment.get_template("validation.html.j2").render(
        validation=validation, sections=sections, column_px=images.COLUMN_PX
    )
    path = folder / "validation.html"
    atomic_write(path, page.encode("utf-8"))
    return path


def figure(value: float) -> str:
    """
    Write a figure or its limit.

    Parameters
    ----------
    value : float
        Any.

    Returns
    -------
    str
        Whole numbers in full, shares near 1 with the digits that tell them from 1, others with
        three digits; words for what is not finite.
    """
    words = words_for(value)
    if words:
        return words
    if value == round(value):
        return text.count(round(value))
    if 0.99 < value < 1.0:
        # rounded down, so that nothing short of 1 is shown as 1
        return f"{np.floor(value * 1e5) / 1e5:.5f}"
    return f"{value:.3g}"


def _parts(panel: Panel) -> dict[str, NDArray[np.uint8]]:
    # what is not finite is the largest difference there is
    difference = np.nan_to_num(panel.difference / _scale(panel), nan=1.0, posinf=1.0, neginf=1.0)
    return {
        "treelod": _shown(panel.ours),
        "reference": _shown(panel.reference),
        "difference": images.magma(difference.astype(np.float32)),
    }


def _scale(panel: Panel) -> float:
    """Return what the brightest colour of the difference stands for: the next power of ten."""
    finite = panel.difference[np.isfinite(panel.difference)]
    largest = float(finite.max(initial=0.0))
    return float(10.0 ** np.ceil(np.log10(largest))) if largest > 0.0 else 1.0


def _shown(values: NDArray[Any]) -> NDArray[np.uint8]:
    picture = quantize(np.nan_to_num(values, nan=0.0))
    if picture.ndim == 2:
        picture = np.repeat(picture[..., np.newaxis], 3, axis=2)
    return picture
