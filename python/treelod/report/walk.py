"""Writes a walk down: ``walk.html``, ``walk.csv``, ``walk.parquet`` and the plot."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2

from treelod import plots
from treelod.files import atomic_write
from treelod.report import images, text
from treelod.report.page import check_folder
from treelod.techniques import FullMesh

if TYPE_CHECKING:
    import os

    from treelod.walks import Walk

__all__ = ["write_walk"]


def write_walk(walk: Walk, directory: str | os.PathLike[str]) -> Path:
    """
    Write the report of a walk.

    Parameters
    ----------
    walk : Walk
        From `treelod.walks.walk`.
    directory : path-like
        Folder for the files; made with its parents if it is missing.

    Returns
    -------
    Path
        The page, ``walk.html``, self-contained. Beside it ``walk.csv`` and ``walk.parquet`` with
        all columns, and the plots as ``walk_costs`` and, where every row has a worst case,
        ``walk_worst_case``, both ``.svg`` and ``.png``.

    Raises
    ------
    NotADirectoryError
        If `directory`, or a part of its path, is a file.
    OSError
        If a file cannot be written.
    """
    folder = Path(directory)
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    atomic_write(folder / "walk.csv", walk.table.to_csv(index=False).encode())
    parquet = io.BytesIO()
    walk.table.to_parquet(parquet, index=False)
    atomic_write(folder / "walk.parquet", parquet.getvalue())
    figures = {"walk_costs": plots.walk_costs(walk.table)}
    if not walk.table["frame_millis_worst"].isna().any():
        baseline = FullMesh.name if FullMesh.name in set(walk.table["label"]) else None
        figures["walk_worst_case"] = plots.worst_case(walk.table, baseline)
    drawn = {}
    for name, figure in figures.items():
        drawn[name] = plots.encode(figure, "svg")
        atomic_write(folder / f"{name}.svg", drawn[name])
        atomic_write(folder / f"{name}.png", plots.encode(figure, "png"))
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("treelod.report", "."),
        # labels and names of plants come from outside
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["count"] = text.count
    environment.filters["millis"] = text.millis
    page = environment.get_template("walk.html.j2").render(
        walk=walk,
        rows=walk.table.to_dict("records"),
        plots={name: images.data_uri(svg, "image/svg+xml") for name, svg in drawn.items()},
    )
    path = folder / "walk.html"
    atomic_write(path, page.encode("utf-8"))
    return path
