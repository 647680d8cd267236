"""
Texture images, decoded to 8-bit RGBA.

The header is read first: a picture of a few kilobytes can claim billions of texels, and decoding it
would fill the memory before anything could object.
"""

import io
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from treelod.errors import PlantFileError

__all__ = ["MAX_BYTES", "MAX_SIDE", "MAX_TEXEL_COUNT", "decode"]

MAX_SIDE = 16384
"""Largest width or height in texels."""

MAX_TEXEL_COUNT = 1 << 26
"""Most texels: 256 MiB as RGBA."""

MAX_BYTES = 4 * MAX_TEXEL_COUNT + (1 << 20)
"""
Longest picture file: the most texels as RGBA of 8 bits, not packed, and a MiB for headers and
notes. A packed picture is shorter, and a deeper one that is longer holds more than is kept of it.
"""

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")


def decode(data: bytes, what: str, charge: Callable[[int], None]) -> NDArray[np.uint8]:
    """
    Decode a picture.

    Parameters
    ----------
    data : bytes
        A PNG, JPEG, WebP, BMP, TGA or TIFF file.
    what : str
        What to call it in messages.
    charge : callable
        Called with the number of texels before they are decoded; raises if that is too many.

    Returns
    -------
    ndarray of shape (H, W, 4), dtype uint8
        Values as stored, straight alpha, row 0 on top. Grey and palettes are expanded, a palette's
        transparency included; 16 bits are cut to the upper 8.

    Raises
    ------
    PlantFileError
        If it is damaged, of another format, or larger than 16384 a side or 2**26 texels.
    """
    try:
        with warnings.catch_warnings():
            # Pillow's own alarm is for larger pictures than the limit below
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            picture = Image.open(io.BytesIO(data), formats=FORMATS)
        with picture:
            width, height = picture.size
            if max(width, height) > MAX_SIDE or width * height > MAX_TEXEL_COUNT:
                msg = (
                    f"{what} is {width} x {height}; the limit is {MAX_SIDE} a side "
                    f"and {MAX_TEXEL_COUNT} texels"
                )
                raise PlantFileError(msg)
            charge(width * height)
            if picture.mode.startswith(("I", "F")):
                return _from_deep_grey(picture)
            # "RGBA" alone knows about transparency outside the pixels (a palette's, a colour key)
            return np.array(picture.convert("RGBA"))
    except PlantFileError:
        raise
    except Image.DecompressionBombError as error:
        msg = f"{what} is too large: {error}"
        raise PlantFileError(msg) from error
    except Exception as error:
        # decoders raise whatever a damaged stream leads them to
        reason = "nothing known" if isinstance(error, UnidentifiedImageError) else error
        msg = f"{what} is damaged, or no {', '.join(FORMATS)} picture ({reason})"
        raise PlantFileError(msg) from error


def _from_deep_grey(picture: Image.Image) -> NDArray[np.uint8]:
    """Pillow clips 16-bit grey to white where it should scale it."""
    values = np.asarray(picture)
    if values.dtype.kind == "f":
        grey = np.clip(values * 255 + 0.5, 0, 255).astype(np.uint8)
    else:
        grey = (values.astype(np.int64).clip(0, 65535) >> 8).astype(np.uint8)
    return np.dstack([grey, grey, grey, np.full_like(grey, 255)])
