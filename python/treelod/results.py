"""
What a comparison gives back: rows, footprints, pictures, and the table made of them.

A table holds one row a technique and camera, with parameters, errors, costs and provenance in
plain columns, so that tables of different runs can be joined and still be told apart.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.metrics import Errors
    from treelod.plants import Plant
    from treelod.provenance import Provenance
    from treelod.techniques import Footprint

__all__ = ["Bake", "Comparison", "Picture", "Row", "View"]

_OPTIONAL_FLOATS = (
    "ssim",
    "ssim_black",
    "ssim_white",
    "yee",
    "coverage_bias",
    "coverage_error",
    "fov_y_deg",
    "ortho_height",
)


@dataclass(frozen=True, kw_only=True)
class View:
    """
    A camera and where it stands relative to the plant.

    Attributes
    ----------
    index : int
        Position in the list of cameras.
    camera : Camera
        The camera.
    azimuth_deg : float
        Of the eye around the centre of the plant's sphere, in [0, 360); 0 is +z, 90 is +x.
    elevation_deg : float
        Of the eye above the centre's horizon, in [-90, 90].
    distance : float
        Of the eye from the centre, in radii of the plant's bounding sphere.
    """

    index: int
    camera: Camera
    azimuth_deg: float
    elevation_deg: float
    distance: float

    @classmethod
    def of(cls, plant: Plant, index: int, camera: Camera) -> View:
        """
        Measure where a camera stands.

        Parameters
        ----------
        plant : Plant
            What it looks at.
        index : int
            Position in the list of cameras.
        camera : Camera
            The camera.

        Returns
        -------
        View
            With angles rounded to 1e-6 degrees and the distance to 9 digits: an orbit's cameras
            then carry exactly the numbers that were asked for, and group by them.
        """
        center, radius = plant.sphere
        offset = np.subtract(camera.eye, center)
        distance = float(np.linalg.norm(offset))
        azimuth = math.degrees(math.atan2(offset[0], offset[2])) % 360.0
        elevation = math.degrees(math.atan2(offset[1], math.hypot(offset[0], offset[2])))
        return cls(
            index=index,
            camera=camera,
            azimuth_deg=round(azimuth, 6) % 360.0,
            # + 0.0 turns -0.0 into 0.0
            elevation_deg=round(elevation, 6) + 0.0,
            distance=float(f"{distance / radius:.9g}") if radius > 0.0 else math.inf,
        )


@dataclass(frozen=True, kw_only=True)
class Bake:
    """
    What one technique is made of.

    Attributes
    ----------
    label : str
        Names the technique in rows and plots.
    technique : str
        Its name in the registry.
    params : dict of str to object
        What it was built with, defaults included.
    build_secs : float
        How long building took, in seconds.
    footprint : Footprint
        Primitives and bytes.
    """

    label: str
    technique: str
    params: dict[str, Any]
    build_secs: float
    footprint: Footprint


@dataclass(frozen=True, kw_only=True)
class Row:
    """
    One technique from one camera.

    Attributes
    ----------
    label : str
        The technique; see `Bake`.
    view : View
        The camera.
    errors : Errors
        Against the reference at `error_samples` a pixel.
    error_samples : int
        Samples a pixel of the frame that was measured.
    frame_millis : ndarray of shape (repeats,), dtype float64
        Times of the frames that were timed, in milliseconds.
    stats : object
        Counts of a frame at the timed sample count; see ``Frame.stats``.
    """

    label: str
    view: View
    errors: Errors
    error_samples: int
    frame_millis: NDArray[np.float64]
    stats: Any


@dataclass(frozen=True, kw_only=True)
class Picture:
    """
    What the errors of one row look like, over the measured region.

    Attributes
    ----------
    row : Row
        Whose picture it is.
    why : str
        Why it was kept: "near", "far" or "worst".
    background : str
        "black" or "white", whichever has the larger FLIP error.
    reference, image : ndarray of shape (h, w, 3), dtype uint8
        sRGB, over that background.
    difference : ndarray of shape (h, w), dtype float32
        FLIP error of each pixel on that background, in [0, 1].
    """

    row: Row
    why: str
    background: str
    reference: NDArray[np.uint8]
    image: NDArray[np.uint8]
    difference: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """
    All results of one run of `compare_techniques`.

    Attributes
    ----------
    plant : dict of str to object
        Facts: name, summary, triangle, leaf and material counts, size in metres.
    portrait, split_portrait : ndarray of shape (h, w, 3), dtype uint8
        The plant on white, as it is and with wood and foliage tinted; sRGB.
    reference_label : str
        Label of the full mesh at the timed sample count.
    bakes : list of Bake
        One a technique, the full mesh first.
    views : list of View
        One a camera.
    rows : list of Row
        One a technique and camera, by technique, then camera.
    pictures : list of Picture
        For every technique from a near and a far camera and from the one where it is worst.
    settings : dict of str to object
        Samples, repeats, warm-up, threads, pixels a degree.
    source : dict of str to object
        Where the plant came from: file and its SHA-256, or preset and seed.
    provenance : Provenance
        Versions and machine.
    """

    plant: dict[str, Any]
    portrait: NDArray[np.uint8]
    split_portrait: NDArray[np.uint8]
    reference_label: str
    bakes: list[Bake]
    views: list[View]
    rows: list[Row]
    pictures: list[Picture]
    settings: dict[str, Any]
    source: dict[str, Any]
    provenance: Provenance

    def table(self) -> pd.DataFrame:
        """
        Return every row with its parameters, errors, costs and provenance in plain columns.

        Returns
        -------
        pandas.DataFrame
            One row a technique and camera. Times are milliseconds, sizes bytes, errors as in
            `metrics.Errors`; ``psnr`` is infinite where a picture equals the reference.
            ``speedup`` is the full mesh's median time over the row's, from the same camera.
        """
        bakes = {bake.label: bake for bake in self.bakes}
        base_millis = {
            row.view.index: float(np.median(row.frame_millis))
            for row in self.rows
            if row.label == self.reference_label
        }
        constants = self._constants()
        records = [
            {
                "plant": self.plant["name"],
                **_bake_columns(bakes[row.label]),
                **_view_columns(row.view),
                **_error_columns(row),
                **_time_columns(row, base_millis[row.view.index]),
                **constants,
            }
            for row in self.rows
        ]
        table = pd.DataFrame.from_records(records)
        # a column without any value still has the type it has elsewhere, so files can be joined
        for name in _OPTIONAL_FLOATS:
            table[name] = table[name].astype("float64")
        return table.astype({"seed": "Int64", "git_commit": "string", "plant_sha256": "string"})

    def summary(self, by: Sequence[str] = ()) -> pd.DataFrame:
        """
        Return errors and costs of each technique over all its views.

        Parameters
        ----------
        by : sequence of str, default ()
            Further columns of `table` to keep apart, ``"distance"`` for example.

        Returns
        -------
        pandas.DataFrame
            One row a technique (and group), in the order of `bakes`. Means over views for errors
            (``_worst`` for the worst view), medians over views for times; ``speedup`` is the full
            mesh's median over the technique's.
        """
        table = self.table()
        keys = ["label", *by]
        groups = table.groupby(keys, sort=False)
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
        # every technique has the same groups, in the same order, the full mesh first
        group_count = len(summary) // len(self.bakes)
        base_millis = np.tile(summary["frame_millis"].to_numpy()[:group_count], len(self.bakes))
        # of the times beside it: a median of the views' own ratios can contradict them
        summary["speedup"] = base_millis / summary["frame_millis"]
        return summary

    def _constants(self) -> dict[str, Any]:
        made = self.provenance
        versions = {f"{name.replace('-', '_')}_version": v for name, v in made.packages.items()}
        return {
            **self.settings,
            "source": json.dumps(self.source, sort_keys=True),
            "plant_sha256": self.source.get("sha256"),
            "seed": self.source.get("seed"),
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


def _bake_columns(bake: Bake) -> dict[str, Any]:
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


def _view_columns(view: View) -> dict[str, Any]:
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


def _error_columns(row: Row) -> dict[str, Any]:
    errors = row.errors
    columns: dict[str, Any] = {
        "flip": errors.flip,
        "rmse": errors.rmse,
        "psnr": errors.psnr,
        "max_error": errors.max,
        "ssim": errors.ssim,
        "yee": errors.yee,
        "coverage_bias": errors.coverage_bias,
        "coverage_error": errors.coverage_error,
        "error_samples": row.error_samples,
    }
    for background, on in errors.on.items():
        columns[f"flip_{background}"] = on.flip
        columns[f"rmse_{background}"] = on.rmse
        columns[f"psnr_{background}"] = on.psnr
        columns[f"ssim_{background}"] = on.ssim
    names = ("region_left", "region_top", "region_right", "region_bottom")
    columns.update(zip(names, errors.region, strict=True))
    return columns


def _time_columns(row: Row, base_millis: float) -> dict[str, Any]:
    millis = row.frame_millis
    q25, median, q75 = np.quantile(millis, [0.25, 0.5, 0.75])
    stats = row.stats
    return {
        "frame_millis": float(median),
        "frame_millis_q25": float(q25),
        "frame_millis_q75": float(q75),
        "frame_millis_min": float(millis.min()),
        "frame_millis_max": float(millis.max()),
        "speedup": base_millis / float(median),
        "drawn_triangles": stats.triangles,
        "drawn_cards": stats.cards,
        "drawn_lines": stats.lines,
        "drawn_points": stats.points,
        "drawn_vertices": stats.vertices,
        "fragments": stats.fragments,
    }
