"""
What a row of results says: one technique from one camera, in plain columns.

A comparison and a sweep give the same columns, with the same names and types, so that their tables
can be joined and the same plots drawn from them.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from treelod.techniques.full_mesh import FullMesh

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from treelod.metrics import Errors
    from treelod.provenance import Provenance
    from treelod.render import Stats
    from treelod.results import Bake, View

__all__ = [
    "TIME_COLUMNS",
    "bake_columns",
    "count_columns",
    "error_columns",
    "provenance_columns",
    "source_columns",
    "summarised",
    "time_columns",
    "typed",
    "view_columns",
    "without_infinity",
]

TIME_COLUMNS = (
    "frame_millis",
    "frame_millis_q25",
    "frame_millis_q75",
    "frame_millis_min",
    "frame_millis_max",
    "speedup",
    "gpu_millis",
)
"""Columns that are null where nothing was timed."""

_OPTIONAL_FLOATS = (
    *TIME_COLUMNS,
    "ssim",
    "ssim_black",
    "ssim_white",
    "yee",
    "coverage_bias",
    "coverage_error",
    "fov_y_deg",
    "ortho_height",
)


def bake_columns(bake: Bake) -> dict[str, Any]:
    """
    Return what a technique is made of.

    Parameters
    ----------
    bake : Bake
        A built technique.

    Returns
    -------
    dict of str to object
    """
    footprint = bake.footprint
    return {
        "label": bake.label,
        "technique": bake.technique,
        "params": json.dumps(bake.params, sort_keys=True, default=str),
        "build_secs": bake.build_secs,
        "triangles": footprint.triangles,
        "cards": footprint.cards,
        "lines": footprint.lines,
        "points": footprint.points,
        "geometry_bytes": footprint.geometry_bytes,
        "texture_bytes": footprint.texture_bytes,
        "total_bytes": footprint.total_bytes,
    }


def view_columns(view: View) -> dict[str, Any]:
    """
    Return where a camera stands.

    Parameters
    ----------
    view : View
        The camera, relative to the plant.

    Returns
    -------
    dict of str to object
    """
    camera = view.camera
    columns: dict[str, Any] = {
        "view": view.index,
        "azimuth_deg": view.azimuth_deg,
        "elevation_deg": view.elevation_deg,
        "distance": view.distance,
        "width": camera.size[0],
        "height": camera.size[1],
        "fov_y_deg": camera.fov_y_deg,
        "ortho_height": camera.height,
        "near": camera.near,
    }
    for name in ("eye", "target", "up"):
        for axis, value in zip("xyz", getattr(camera, name), strict=True):
            columns[f"{name}_{axis}"] = value
    return columns


def error_columns(errors: Errors, error_samples: int) -> dict[str, Any]:
    """
    Return how wrong a picture is.

    Parameters
    ----------
    errors : Errors
        Against the reference.
    error_samples : int
        Samples a pixel of the frame that was measured.

    Returns
    -------
    dict of str to object
    """
    columns: dict[str, Any] = {
        "flip": errors.flip,
        "rmse": errors.rmse,
        "psnr": errors.psnr,
        "max_error": errors.max,
        "ssim": errors.ssim,
        "yee": errors.yee,
        "coverage_bias": errors.coverage_bias,
        "coverage_error": errors.coverage_error,
        "error_samples": error_samples,
    }
    for background, on in errors.on.items():
        columns[f"flip_{background}"] = on.flip
        columns[f"rmse_{background}"] = on.rmse
        columns[f"psnr_{background}"] = on.psnr
        columns[f"ssim_{background}"] = on.ssim
    names = ("region_left", "region_top", "region_right", "region_bottom")
    columns.update(zip(names, errors.region, strict=True))
    return columns


def time_columns(
    frame_millis: NDArray[np.float64] | None,
    base_millis: float | None = None,
    gpu_millis: NDArray[np.float64] | None = None,
) -> dict[str, Any]:
    """
    Return how long frames took.

    Parameters
    ----------
    frame_millis : ndarray of shape (repeats,), dtype float64, or None
        Times in milliseconds; None where nothing was timed.
    base_millis : float, optional
        The full mesh's median from the same camera.
    gpu_millis : ndarray of shape (repeats,), dtype float64, optional
        What the graphics card says that it took itself, in milliseconds. Default: there is none,
        or it does not tell.

    Returns
    -------
    dict of str to object
    """
    if frame_millis is None or base_millis is None:
        return dict.fromkeys(TIME_COLUMNS)
    q25, q75 = np.quantile(frame_millis, [0.25, 0.75])
    # of an even number of frames a quantile rounds otherwise than a median, which the base is
    median = np.median(frame_millis)
    return {
        "frame_millis": float(median),
        "frame_millis_q25": float(q25),
        "frame_millis_q75": float(q75),
        "frame_millis_min": float(frame_millis.min()),
        "frame_millis_max": float(frame_millis.max()),
        "speedup": base_millis / float(median),
        "gpu_millis": None if gpu_millis is None else float(np.median(gpu_millis)),
    }


def count_columns(stats: Stats) -> dict[str, Any]:
    """
    Return what was drawn.

    Parameters
    ----------
    stats : Stats
        Counts of a frame at the timed sample count.

    Returns
    -------
    dict of str to object
    """
    return {
        "drawn_triangles": stats.triangles,
        "drawn_cards": stats.cards,
        "drawn_lines": stats.lines,
        "drawn_points": stats.points,
        "drawn_vertices": stats.vertices,
        "fragments": stats.fragments,
    }


def source_columns(source: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return where a plant came from.

    Parameters
    ----------
    source : mapping of str to object
        File and its SHA-256, or preset and seed.

    Returns
    -------
    dict of str to object
    """
    return {
        "source": json.dumps(dict(source), sort_keys=True),
        "plant_sha256": source.get("sha256"),
        "seed": source.get("seed"),
    }


def provenance_columns(made: Provenance) -> dict[str, Any]:
    """
    Return versions and machine.

    Parameters
    ----------
    made : Provenance
        Of the process that drew.

    Returns
    -------
    dict of str to object
    """
    versions = {f"{name.replace('-', '_')}_version": v for name, v in made.packages.items()}
    return {
        "treelod_version": made.treelod,
        "git_commit": made.git_commit,
        "build_profile": made.build_profile,
        **versions,
        "python_version": made.python,
        "platform": made.platform,
        "cpu": made.cpu,
        "core_count": made.core_count,
        "date": made.date,
    }


def typed(table: pd.DataFrame) -> pd.DataFrame:
    """
    Give columns their type, also those without any value, so that files can be joined.

    Parameters
    ----------
    table : pandas.DataFrame
        Rows of these columns.

    Returns
    -------
    pandas.DataFrame
        A copy.
    """
    return table.astype(
        dict.fromkeys(_OPTIONAL_FLOATS, "float64")
        | dict.fromkeys(("adapter", "driver", "git_commit", "plant_sha256"), "string")
        | {"seed": "Int64"}
    )


def without_infinity(table: pd.DataFrame) -> pd.DataFrame:
    """
    Return a table for files that hold no infinity: where a picture equals the reference.

    Parameters
    ----------
    table : pandas.DataFrame
        Rows with these columns.

    Returns
    -------
    pandas.DataFrame
        A copy in which infinite PSNR is null.
    """
    columns = [name for name in table.columns if name.startswith("psnr")]
    return table.assign(**{name: table[name].replace(np.inf, np.nan) for name in columns})


def summarised(
    table: pd.DataFrame, by: Sequence[str] = (), *, reference_label: str = FullMesh.name
) -> pd.DataFrame:
    """
    Return errors and costs of each technique over all its views.

    Parameters
    ----------
    table : pandas.DataFrame
        Rows with these columns.
    by : sequence of str, default ()
        Further columns to keep apart.
    reference_label : str, default 'full_mesh'
        Label of the yardstick.

    Returns
    -------
    pandas.DataFrame
        One row a label (and group), in the table's order. Means over views for errors (``_worst``
        for the worst view), medians over views for times; ``speedup`` is the full mesh's median
        over the technique's in the same group.
    """
    groups = table.groupby(["label", *by], sort=False, dropna=False)
    summary = groups.agg(
        flip=("flip", "mean"),
        flip_worst=("flip", "max"),
        rmse=("rmse", "mean"),
        psnr_worst=("psnr", "min"),
        ssim=("ssim", "mean"),
        coverage_bias=("coverage_bias", "mean"),
        coverage_error=("coverage_error", "mean"),
        frame_millis=("frame_millis", "median"),
        frame_millis_q25=("frame_millis_q25", "median"),
        frame_millis_q75=("frame_millis_q75", "median"),
        gpu_millis=("gpu_millis", "median"),
        build_secs=("build_secs", "first"),
        triangles=("triangles", "first"),
        cards=("cards", "first"),
        lines=("lines", "first"),
        points=("points", "first"),
        geometry_bytes=("geometry_bytes", "first"),
        texture_bytes=("texture_bytes", "first"),
        total_bytes=("total_bytes", "first"),
        views=("view", "count"),
    )
    summary = summary.reset_index()
    # the full mesh has no parameters: it is the yardstick for any of theirs
    shared = [name for name in by if not name.startswith("param_")]
    full = summary[summary["label"] == reference_label]
    base_of = dict(zip(_keys(full, shared), full["frame_millis"], strict=True))
    # of the times beside it: a median of the views' own ratios can contradict them
    base_millis = np.array(
        [base_of.get(key, np.nan) for key in _keys(summary, shared)], dtype=np.float64
    )
    summary["speedup"] = base_millis / summary["frame_millis"]
    return summary


def _keys(table: pd.DataFrame, names: list[str]) -> list[tuple[Any, ...]]:
    return list(zip(*(table[name] for name in names), strict=True)) if names else [()] * len(table)
