"""
What a comparison gives back: rows, footprints, pictures, and the table made of them.

A table holds one row a technique and camera, with parameters, errors, costs and provenance in
plain columns, so that tables of different runs can be joined and still be told apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from treelod.columns import (
    bake_columns,
    count_columns,
    error_columns,
    provenance_columns,
    source_columns,
    summarised,
    time_columns,
    typed,
    view_columns,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.metrics import Errors
    from treelod.plants import Plant
    from treelod.provenance import Provenance
    from treelod.techniques import Footprint

__all__ = ["Bake", "Comparison", "Picture", "Row", "View"]


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
        Counts of a frame at the timed sample count, drawn by the processor; see ``Frame.stats``.
    gpu_millis : ndarray of shape (repeats,), dtype float64, or None, default None
        What the graphics card says that it took itself, in milliseconds; None where the processor
        draws, and for cards that do not tell.
    """

    label: str
    view: View
    errors: Errors
    error_samples: int
    frame_millis: NDArray[np.float64]
    stats: Any
    gpu_millis: NDArray[np.float64] | None = None


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
        Samples, repeats, warm-up, threads, pixels a degree; ``backend``, and the graphics card's
        ``adapter`` and ``driver`` (None on the processor).
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
            ``backend``, ``adapter`` and ``driver`` say what drew the frames that were timed;
            ``gpu_millis`` is the median of what the graphics card says that it took itself.
        """
        bakes = {bake.label: bake for bake in self.bakes}
        base_millis = {
            row.view.index: float(np.median(row.frame_millis))
            for row in self.rows
            if row.label == self.reference_label
        }
        constants = {
            **self.settings,
            **source_columns(self.source),
            **provenance_columns(self.provenance),
        }
        records = [
            {
                "plant": self.plant["name"],
                **bake_columns(bakes[row.label]),
                **view_columns(row.view),
                **error_columns(row.errors, row.error_samples),
                **time_columns(row.frame_millis, base_millis[row.view.index], row.gpu_millis),
                **count_columns(row.stats),
                **constants,
            }
            for row in self.rows
        ]
        return typed(pd.DataFrame.from_records(records))

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
        return summarised(self.table(), by, reference_label=self.reference_label)
