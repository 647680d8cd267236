"""
How a picture gets into a page: at a size that can be judged, without blur that it did not have.

Small pictures are enlarged by a whole factor without filtering; large ones are shown small as a
whole, and their worst part is shown enlarged.
"""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from PIL import Image

from treelod import _core
from treelod.color import quantize

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

__all__ = [
    "COLUMN_PX",
    "data_uri",
    "detail_window",
    "magma",
    "overview",
    "png",
    "strip",
]

COLUMN_PX = 336
"""Width of one of three pictures side by side, in CSS pixels."""

DETAIL_PX = 112
"""Side of the part shown enlarged: a third of a column, so that it is enlarged three times."""

_OVERVIEW_PX = 512
"""Widest picture of a whole plant in the page; the files beside it have every pixel."""


_GAP_PX = 8
"""Between the pictures of a strip."""


def magma(difference: NDArray[np.float32]) -> NDArray[np.uint8]:
    """
    Colour an error map: black is 0, through purple and orange to pale yellow at 1.

    Parameters
    ----------
    difference : ndarray of shape (h, w)
        Errors in [0, 1].

    Returns
    -------
    ndarray of shape (h, w, 3), dtype uint8
        sRGB.
    """
    colors: NDArray[Any] = mpl.colormaps["magma"](np.clip(difference, 0.0, 1.0))
    return quantize(colors[..., :3])


def png(picture: NDArray[np.uint8]) -> bytes:
    """
    Return a picture as a PNG file.

    Parameters
    ----------
    picture : ndarray of shape (h, w, 3), dtype uint8
        sRGB.

    Returns
    -------
    bytes
        A complete file.
    """
    return _core.encode_png(np.ascontiguousarray(picture))


def strip(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """
    Put pictures side by side.

    Parameters
    ----------
    pictures : sequence of ndarray of shape (h, w, 3), dtype uint8
        Pictures of one size.

    Returns
    -------
    ndarray of shape (H, W, 3), dtype uint8
        From left to right with 8 white pixels between, small ones enlarged by a whole factor as
        in `overview`.
    """
    height, width = pictures[0].shape[:2]
    factor = _factor(width, height)
    gap = np.full((height * factor, _GAP_PX, 3), 255, np.uint8)
    row = [part for picture in pictures for part in (gap, _enlarged(picture, factor))]
    return np.concatenate(row[1:], axis=1)


def overview(picture: NDArray[np.uint8]) -> tuple[str, int]:
    """
    Prepare a whole picture for one column of the page.

    Parameters
    ----------
    picture : ndarray of shape (h, w, 3), dtype uint8
        sRGB.

    Returns
    -------
    uri : str
        Data URI. Up to a column wide: lossless, enlarged by a whole factor. Up to 512 pixels:
        lossless, as it is. Wider: filtered down to 512 pixels.
    width : int
        CSS pixels to show it at, at most `COLUMN_PX`.
    """
    height, width = picture.shape[:2]
    # portrait pictures are bound by their height, or a tall palm would fill two screens
    longest = max(width, height)
    if longest <= COLUMN_PX:
        factor = _factor(width, height)
        return data_uri(png(_enlarged(picture, factor)), "image/png"), width * factor
    shown = max(round(width * COLUMN_PX / longest), 1)
    if longest <= _OVERVIEW_PX:
        return data_uri(png(picture), "image/png"), shown
    scale = _OVERVIEW_PX / longest
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    small = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))
    return data_uri(_encoded(small, format="WEBP", quality=92, method=6), "image/webp"), shown


def detail_window(difference: NDArray[np.float32]) -> tuple[int, int, int, int] | None:
    """
    Find the part of a picture that differs most.

    Parameters
    ----------
    difference : ndarray of shape (h, w)
        Errors of the pixels.

    Returns
    -------
    tuple of 4 ints or None
        Left, top, right, bottom (exclusive) of the 112 x 112 pixels with the largest mean error
        (of equal ones the topmost, then leftmost); None if the picture is small enough to be
        shown enlarged as a whole.
    """
    height, width = difference.shape
    if max(width, height) < 2 * DETAIL_PX:
        return None
    side_y, side_x = min(DETAIL_PX, height), min(DETAIL_PX, width)
    sums = np.zeros((height + 1, width + 1))
    sums[1:, 1:] = difference.cumsum(0, dtype=np.float64).cumsum(1)
    windows = (
        sums[side_y:, side_x:]
        - sums[:-side_y, side_x:]
        - sums[side_y:, :-side_x]
        + sums[:-side_y, :-side_x]
    )
    top, left = (int(i) for i in np.unravel_index(windows.argmax(), windows.shape))
    return left, top, left + side_x, top + side_y


def data_uri(data: bytes, media_type: str) -> str:
    """
    Return a file as a link that carries it.

    Parameters
    ----------
    data : bytes
        The file.
    media_type : str
        ``"image/png"`` for example.

    Returns
    -------
    str
        ``data:`` URI, base64.
    """
    return f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"


def _factor(width: int, height: int) -> int:
    """By how much a picture is enlarged to fill a column; 1 if it is wider or higher than one."""
    return max(COLUMN_PX // max(width, height), 1)


def _enlarged(picture: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)


def _encoded(picture: NDArray[np.uint8], **options: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).save(file, **options)
    return file.getvalue()
