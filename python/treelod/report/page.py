"""
Writes a comparison down: ``report.html``, ``results.parquet``, ``results.csv`` and the pictures.

The page is one file that needs nothing else, so it can be mailed, archived and printed. Numbers
become text here; the template beside this file arranges them.
"""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jinja2
import pandas as pd

from treelod import plots
from treelod.columns import without_infinity
from treelod.files import atomic_write
from treelod.report import images, text

if TYPE_CHECKING:
    import os

    from treelod.results import Comparison, Picture

__all__ = ["check_folder", "write_report"]

_REASONS = {
    "near": "Near",
    "far": "Far",
    "worst": "Worst",
}

_CAPTIONS = {
    "speed_against_error": (
        "Speed against error",
        "Each point is a technique: median frame time against mean error over the views of one "
        "distance; the bars reach from the best to the worst view. Lower left is better. The "
        "dashed staircase is the Pareto front: no technique beats one on it in both.",
    ),
    "error_by_azimuth": (
        "Error around the plant",
        "Error as the camera circles the plant, for each distance and elevation. Waves show "
        "directions for which a technique has no picture of its own.",
    ),
    "error_by_distance": (
        "Error by distance",
        "Mean over the views of each distance; the bars reach from the best to the worst view. "
        "Where a technique's line meets the full mesh's, which is aliasing alone, it is as good as "
        "the mesh that one would draw instead.",
    ),
}

_PICTURE_NAME = re.compile(r"\d{2,}_.*_(near|far|worst)_(reference|image|difference|strip)\.png")
"""What a report calls its pictures; nothing else in their folder is ever removed."""


def write_report(comparison: Comparison, directory: str | os.PathLike[str]) -> Path:
    """
    Write the report of a comparison.

    Parameters
    ----------
    comparison : Comparison
        From `compare_techniques`.
    directory : path-like
        Folder for the files; made with its parents if it is missing. Files of an earlier report
        are replaced or removed, others left alone.

    Returns
    -------
    Path
        The page, ``report.html``, self-contained. Beside it ``results.parquet`` and
        ``results.csv`` (one row a technique and view; infinite PSNR is null), ``plots/*.png`` and
        ``pictures/*.png`` (every pixel of the pictures in the page; ``*_strip.png`` is reference,
        technique and difference side by side).

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
    table = comparison.table()
    for name in ("plots", "pictures"):
        (folder / name).mkdir(exist_ok=True)

    stored = without_infinity(table)
    parquet = io.BytesIO()
    stored.to_parquet(parquet, index=False)
    atomic_write(folder / "results.parquet", parquet.getvalue())
    atomic_write(folder / "results.csv", stored.to_csv(index=False).encode())

    figures = []
    for name, figure in {
        "speed_against_error": plots.speed_against_error(table),
        "error_by_azimuth": plots.error_by_azimuth(table),
        "error_by_distance": plots.error_by_distance(table),
    }.items():
        atomic_write(folder / "plots" / f"{name}.png", plots.encode(figure, "png"))
        title, caption = _CAPTIONS[name]
        uri = images.data_uri(plots.encode(figure), "image/svg+xml")
        figures.append({"title": title, "caption": caption, "uri": uri})

    strips = []
    written = set()
    for index, picture in enumerate(_in_order(comparison)):
        # the number keeps apart labels that differ only in signs a file name cannot hold
        stem = f"{index:02d}_{_file_name(picture.row.label)}_{picture.why}"
        parts = {
            "reference": picture.reference,
            "image": picture.image,
            "difference": images.magma(picture.difference),
        }
        for part, pixels in (parts | {"strip": images.strip(list(parts.values()))}).items():
            written.add(f"{stem}_{part}.png")
            atomic_write(folder / "pictures" / f"{stem}_{part}.png", images.png(pixels))
        strips.append(_strip(picture, parts))
    for name, pixels in (
        ("plant", comparison.portrait),
        ("plant_split", comparison.split_portrait),
    ):
        atomic_write(folder / "pictures" / f"{name}.png", images.png(pixels))

    for path in (folder / "pictures").iterdir():
        if _PICTURE_NAME.fullmatch(path.name) and path.name not in written:
            path.unlink()

    page = _template().render(**_context(comparison, table), figures=figures, strips=strips)
    path = folder / "report.html"
    atomic_write(path, page.encode("utf-8"))
    return path


def check_folder(directory: str | os.PathLike[str]) -> None:
    """
    Refuse a folder that a report cannot be written to, before minutes of work for it.

    Parameters
    ----------
    directory : path-like
        As for `write_report`; nothing is made.

    Raises
    ------
    NotADirectoryError
        If it, or a part of its path, is a file.
    """
    folder = Path(directory)
    for part in (folder, *folder.parents):
        if part.exists() and not part.is_dir():
            msg = f"cannot write the report to {folder}: {part} is a file"
            raise NotADirectoryError(msg)


def _template() -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("treelod.report", "."),
        # names of plants, files and parameters come from outside
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update({name: getattr(text, name) for name in text.__all__})
    return environment.get_template("report.html.j2")


def _context(comparison: Comparison, table: pd.DataFrame) -> dict[str, Any]:
    overall = _records(comparison.summary())
    by_distance = _records(comparison.summary(by=("distance",)))
    distances = sorted({row["distance"] for row in by_distance})
    groups = []
    for distance in distances:
        rows = [row for row in by_distance if row["distance"] == distance]
        front = plots.pareto_front(
            [row["frame_millis"] for row in rows], [row["flip"] for row in rows]
        )
        for index, row in enumerate(rows):
            row["on_front"] = index in front
        height = table.loc[table["distance"] == distance, ["region_top", "region_bottom"]]
        groups.append(
            {
                "distance": distance,
                "rows": rows,
                "pixels": float((height["region_bottom"] - height["region_top"]).median()),
            }
        )
    portraits = []
    for title, picture in (
        ("The plant as drawn by the full mesh.", comparison.portrait),
        ("Wood (orange) and foliage (green), as told apart.", comparison.split_portrait),
    ):
        uri, width = images.overview(picture)
        portraits.append({"title": title, "uri": uri, "width": width})
    return {
        "plant": comparison.plant,
        "portraits": portraits,
        "reference_label": comparison.reference_label,
        "overall": overall,
        # graphics cards tell their own times, most of them
        "has_card_times": bool(table["gpu_millis"].notna().all()),
        "groups": groups,
        "bakes": [
            {
                "label": bake.label,
                "technique": bake.technique,
                "params": {name: _value(value) for name, value in sorted(bake.params.items())},
                "footprint": bake.footprint,
                "build_secs": bake.build_secs,
            }
            for bake in comparison.bakes
        ],
        "settings": comparison.settings,
        "source": comparison.source,
        "made": comparison.provenance,
        "views": _views(table),
        "column_px": images.COLUMN_PX,
    }


def _views(table: pd.DataFrame) -> dict[str, Any]:
    sizes = sorted({(int(w), int(h)) for w, h in zip(table["width"], table["height"], strict=True)})
    return {
        "count": int(table["view"].nunique()),
        "azimuth_count": int(table["azimuth_deg"].nunique()),
        "elevations": ", ".join(f"{v:g}°" for v in sorted(table["elevation_deg"].unique())),
        "distances": ", ".join(f"{v:.4g}" for v in sorted(table["distance"].unique())),
        "sizes": ", ".join(f"{w} \N{MULTIPLICATION SIGN} {h}" for w, h in sizes),
    }


def _in_order(comparison: Comparison) -> list[Picture]:
    labels = [bake.label for bake in comparison.bakes]
    reasons = list(_REASONS)
    # the full mesh comes last: its difference is aliasing, which is not what readers look for first
    labels = labels[1:] + labels[:1]
    return sorted(
        comparison.pictures,
        key=lambda picture: (labels.index(picture.row.label), reasons.index(picture.why)),
    )


def _strip(picture: Picture, parts: dict[str, Any]) -> dict[str, Any]:
    row = picture.row
    view = row.view
    titles = {
        "reference": "reference",
        "image": row.label,
        "difference": "FLIP difference",
    }
    panels = []
    for part, pixels in parts.items():
        uri, width = images.overview(pixels)
        panels.append({"title": titles[part], "uri": uri, "width": width})
    details = []
    window = images.detail_window(picture.difference)
    if window is not None:
        left, top, right, bottom = window
        for part, pixels in parts.items():
            uri, width = images.overview(pixels[top:bottom, left:right])
            details.append({"title": titles[part], "uri": uri, "width": width})
    height, width = picture.difference.shape
    return {
        "label": row.label,
        "why": _REASONS[picture.why],
        "azimuth": view.azimuth_deg,
        "elevation": view.elevation_deg,
        "distance": view.distance,
        "background": picture.background,
        "errors": row.errors,
        "on": row.errors.on[picture.background],
        "panels": panels,
        "details": details,
        "pixels": (width, height),
        "enlarged": max(images.COLUMN_PX // max(width, height), 1),
    }


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    records: list[dict[str, Any]] = table.to_dict("records")  # type: ignore[assignment]
    return records


def _file_name(label: str) -> str:
    return re.sub(r"[^A-Za-z0-9._=-]+", "_", label)[:80]


def _value(value: Any) -> str:
    # as the command line takes it
    if value is None:
        return "none"
    return value if isinstance(value, str) else json.dumps(value, default=str)
