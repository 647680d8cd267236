"""
For tests of techniques and renderers: is this frame as near to that one as it should be?

`assert_frame_close` measures what `metrics.compare` measures, and leaves a picture when it fails.
Where pytest runs the test, treelod's plugin tells where the picture goes and offers two fixtures,
``treelod_plant`` and ``treelod_reference``.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections import OrderedDict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from treelod import metrics
from treelod.color import composite, quantize, srgb_from_linear
from treelod.files import atomic_write
from treelod.plants import grow_plant, load_plant
from treelod.render import render
from treelod.techniques import FullMesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.cameras import Camera
    from treelod.plants import Plant
    from treelod.render import Frame

__all__ = ["PlantFactory", "ReferenceFactory", "assert_frame_close"]

_PANEL_PX = 320
"""Smaller pictures are enlarged by a whole factor to at most this, larger ones stay as they are."""

_CAPTION_PX = 20
_GAP_PX = 8

_CACHE_BYTES = 1 << 28
"""Of reference frames that are kept; the one that was used longest ago goes first."""


def assert_frame_close(
    frame: Frame,
    reference: Frame,
    *,
    flip: float | None = None,
    coverage_bias: float | None = None,
    rmse: float | None = None,
    ssim: float | None = None,
    ppd: float = metrics.DEFAULT_PPD,
    out: str | os.PathLike[str] | None = None,
) -> metrics.Errors:
    """
    Assert that a frame is near to a reference frame of the same camera.

    Parameters
    ----------
    frame : Frame
        The picture to judge.
    reference : Frame
        The truth; its bounds set the pixels that are measured.
    flip : float, optional
        Largest mean FLIP error on the worse background, in [0, 1].
    coverage_bias : float, optional
        Largest difference of mean alpha, too dense or too thin, in [0, 1].
    rmse : float, optional
        Largest root mean square difference of sRGB values on the worse background, in [0, 1].
    ssim : float, optional
        Least structural similarity on the worse background, in [-1, 1].
    ppd : float, default 67.02
        Pixels a degree of sight, for FLIP.
    out : path-like, optional
        File for the picture of a failure, a PNG. Default: a file in the folder of
        ``--treelod-pictures``, else in the test's ``tmp_path``, else in a new temporary folder.

    Returns
    -------
    metrics.Errors
        Everything that was measured.

    Raises
    ------
    AssertionError
        If a tolerance is broken. The message has every number and names a picture: expected,
        difference and actual side by side, on the background with the larger FLIP error.
    TypeError
        If an argument is no frame.
    ValueError
        If no tolerance is given or one is out of range, if the frames differ in size or camera, or
        if a pixel is NaN or infinite.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> camera = tl.orbit(plant, count=1, size=(64, 64))[0]
    >>> mesh = tl.FullMesh.build(plant)
    >>> few, many = (tl.render(mesh, camera, samples=samples) for samples in (16, 64))
    >>> assert_frame_close(few, many, flip=0.05, coverage_bias=0.01).flip < 0.05
    True
    """
    __tracebackhide__ = True
    tolerances = {"flip": flip, "coverage_bias": coverage_bias, "rmse": rmse, "ssim": ssim}
    _check_tolerances(tolerances)
    errors = metrics.compare(reference, frame, ppd=ppd)
    lines, broken = _lines(errors, tolerances)
    if not broken:
        return errors
    left, top, right, bottom = errors.region
    background = errors.worse_background
    file = _picture_file(out)
    atomic_write(file, _picture(frame, reference, errors))
    msg = "\n".join(
        [
            f"frame is not close to its reference: {' and '.join(broken)}",
            *lines,
            f"  over {right - left} x {bottom - top} pixels from ({left}, {top})",
            f"  expected | difference | actual on {background}: {file}",
        ]
    )
    raise AssertionError(msg)


class PlantFactory:
    """
    Plants by preset or file, each made once; what the fixture ``treelod_plant`` gives.

    Examples
    --------
    >>> treelod_plant = PlantFactory()
    >>> plant = treelod_plant("chestnut", leaf_count=50)
    >>> treelod_plant("chestnut", leaf_count=50) is plant
    True
    """

    def __init__(self) -> None:
        self._made: dict[Any, Plant] = {}

    def __call__(self, source: str | os.PathLike[str], **params: Any) -> Plant:
        """
        Grow or load a plant.

        Parameters
        ----------
        source : str or path-like
            A path object or a name with a dot is a file, for `load_plant`; any other name a preset,
            for `grow_plant`.
        **params
            As that function's.

        Returns
        -------
        Plant
            The same one for the same arguments.

        Raises
        ------
        FileNotFoundError, ValueError
            As from `load_plant` or `grow_plant`.
        """
        is_file = not isinstance(source, str) or "." in source
        where = str(Path(source).resolve()) if is_file else str(source)
        key = where, repr(sorted(params.items()))
        if key not in self._made:
            make: Any = load_plant if is_file else grow_plant
            self._made[key] = make(where, **params)
        return self._made[key]


class ReferenceFactory:
    """
    Frames of a plant's full mesh, kept while there is room; the fixture ``treelod_reference``.

    256 MiB of frames are kept.

    Examples
    --------
    >>> import treelod as tl
    >>> treelod_reference, plant = ReferenceFactory(), tl.grow_plant("chestnut", leaf_count=50)
    >>> camera = tl.orbit(plant, count=1, size=(64, 64))[0]
    >>> treelod_reference(plant, camera).stats.samples
    64
    """

    def __init__(self) -> None:
        # plants are kept with their meshes: an id is only theirs while they live
        self._meshes: dict[int, tuple[Plant, FullMesh]] = {}
        self._frames: OrderedDict[Any, Frame] = OrderedDict()

    def __call__(self, plant: Plant, camera: Camera, samples: int = 64) -> Frame:
        """
        Draw the plant as it is.

        Parameters
        ----------
        plant : Plant
            The plant.
        camera : Camera
            From where.
        samples : int, default 64
            Samples a pixel, as in `treelod.render`.

        Returns
        -------
        Frame
            With colour and depth.

        Raises
        ------
        ValueError
            As from `treelod.render`.
        """
        key = id(plant), camera, samples
        if key not in self._frames:
            if id(plant) not in self._meshes:
                self._meshes[id(plant)] = plant, FullMesh.build(plant)
            self._frames[key] = render(self._meshes[id(plant)][1], camera, samples=samples)
            while len(self._frames) > 1 and self._held_bytes() > _CACHE_BYTES:
                self._frames.popitem(last=False)
        self._frames.move_to_end(key)
        return self._frames[key]

    def _held_bytes(self) -> int:
        planes = ((f.color, f.depth) for f in self._frames.values())
        return sum(plane.nbytes for pair in planes for plane in pair if plane is not None)


def _check_tolerances(tolerances: dict[str, float | None]) -> None:
    if all(value is None for value in tolerances.values()):
        msg = f"give at least one tolerance: {', '.join(tolerances)}"
        raise ValueError(msg)
    for name, value in tolerances.items():
        low = -1.0 if name == "ssim" else 0.0
        if value is not None and not low <= value <= 1.0:
            msg = f"{name} must be in [{low:g}, 1], got {value}"
            raise ValueError(msg)


def _lines(
    errors: metrics.Errors, tolerances: dict[str, float | None]
) -> tuple[list[str], list[str]]:
    """Write every number with its tolerance; also name those that are broken."""
    names = {"flip": "FLIP", "coverage_bias": "coverage bias", "rmse": "RMSE", "ssim": "SSIM"}
    values = {name: getattr(errors, name) for name in names}
    lines, broken = [], []
    for name, shown in names.items():
        value, limit = values[name], tolerances[name]
        number = "none" if value is None else f"{value:{'+' if name == 'coverage_bias' else ''}.6g}"
        line = f"  {shown:<13} {number:<12}"
        if limit is None:
            lines.append(f"{line} (no tolerance)")
            continue
        # the region is under 7 pixels, or something is no number: nothing is shown to be near
        far = value is None or (not value >= limit if name == "ssim" else not abs(value) <= limit)
        sign = ">=" if name == "ssim" else "<="
        asked = f"|bias| {sign} {limit:g}" if name == "coverage_bias" else f"{sign} {limit:g}"
        lines.append(f"{line} {asked}{'  BROKEN' if far else ''}")
        if far:
            broken.append(shown)
    on = ", ".join(f"{name} {on.flip:.6g}" for name, on in errors.on.items())
    psnr = "infinite" if math.isinf(errors.psnr) else f"{errors.psnr:.6g} dB"
    lines += [
        f"  {'FLIP on':<13} {on}",
        f"  {'PSNR':<13} {psnr}",
        f"  {'largest':<13} {errors.max:.6g}",
    ]
    return lines, broken


def _picture_file(out: str | os.PathLike[str] | None) -> Path:
    """Find a name that is not taken."""
    if out is not None:
        file = Path(out)
        file.parent.mkdir(parents=True, exist_ok=True)
        return file
    # pytest has loaded its plugin, or this is no test of pytest's
    plugin = sys.modules.get("pytest_treelod")
    place = plugin.picture_place() if plugin is not None else None
    folder, name = place or (Path(tempfile.mkdtemp(prefix="treelod-")), "frame")
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1_000_000):
        file = folder / (f"{name}.png" if number == 0 else f"{name}-{number + 1}.png")
        if not file.exists():
            break
    return file


def _picture(frame: Frame, reference: Frame, errors: metrics.Errors) -> bytes:
    """Put expected, difference and actual side by side, with captions, into a PNG."""
    # matplotlib, for its colours alone, and only once something is wrong
    from treelod.report.images import magma, png

    name: Any = errors.worse_background
    left, top, right, bottom = errors.region
    expected, actual = (
        quantize(
            srgb_from_linear(
                composite(
                    np.asarray(picture.color)[top:bottom, left:right], metrics.BACKGROUNDS[name]
                )
            )
        )
        for picture in (reference, frame)
    )
    difference = magma(metrics.flip_map(reference, frame, background=name, ppd=errors.ppd))
    height, width = difference.shape[:2]
    factor = max(_PANEL_PX // max(width, height), 1)
    # as wide as its caption at least
    column = max(width * factor, 130)
    sheet = Image.new(
        "RGB", (3 * column + 2 * _GAP_PX, height * factor + _CAPTION_PX), (255, 255, 255)
    )
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=13)
    captions = (
        "expected",
        f"difference, FLIP {errors.on[name].flip:.3g}",
        "actual",
    )
    for number, (caption, pixels) in enumerate(
        zip(captions, (expected, difference, actual), strict=True)
    ):
        x = number * (column + _GAP_PX)
        draw.text((x + 2, 2), caption, fill=(20, 20, 20), font=font)
        sheet.paste(Image.fromarray(_enlarged(pixels, factor)), (x, _CAPTION_PX))
    return png(np.asarray(sheet))


def _enlarged(pixels: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    return np.ascontiguousarray(pixels.repeat(factor, axis=0).repeat(factor, axis=1))
