"""
How pictures become what a screen shows: compositing in linear light, then sRGB.

Frames are linear and premultiplied. Everything that is looked at or measured passes through
`composite` and `srgb_from_linear`, so that a picture and its error are of the same pixels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

__all__ = ["composite", "linear_from_srgb", "quantize", "srgb_from_linear"]


def composite(color: ArrayLike, background: float | Sequence[float]) -> NDArray[np.float64]:
    """
    Put a premultiplied linear picture over a background, in linear light.

    Parameters
    ----------
    color : array_like of shape (H, W, 4)
        Linear, premultiplied RGBA.
    background : float or sequence of 3 floats
        Linear colour of the background; 0 is black, 1 is white.

    Returns
    -------
    ndarray of shape (H, W, 3), dtype float64
        Linear RGB, not clipped.

    Examples
    --------
    >>> composite([[[0.25, 0.0, 0.0, 0.5]]], 1.0).tolist()
    [[[0.75, 0.5, 0.5]]]
    """
    rgba = np.asarray(color, dtype=np.float64)
    return rgba[..., :3] + (1.0 - rgba[..., 3:]) * np.asarray(background, dtype=np.float64)


def srgb_from_linear(linear: ArrayLike) -> NDArray[np.float64]:
    """
    Clip linear values to [0, 1] and encode them as sRGB (IEC 61966-2-1).

    Parameters
    ----------
    linear : array_like
        Linear values of any shape.

    Returns
    -------
    ndarray, dtype float64
        Encoded values in [0, 1], of the same shape.

    Examples
    --------
    >>> srgb_from_linear([-1.0, 0.0, 0.5, 2.0]).round(4).tolist()
    [0.0, 0.0, 0.7354, 1.0]
    """
    value = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    encoded = 1.055 * np.power(value, 1.0 / 2.4) - 0.055
    # 1.055 - 0.055 is not exactly 1 in binary
    encoded = np.minimum(encoded, 1.0)
    return np.where(value <= 0.0031308, 12.92 * value, encoded)


def linear_from_srgb(encoded: ArrayLike) -> NDArray[np.float64]:
    """
    Decode sRGB values (IEC 61966-2-1) to linear ones.

    Parameters
    ----------
    encoded : array_like
        Encoded values in [0, 1], of any shape; clipped to that range.

    Returns
    -------
    ndarray, dtype float64
        Linear values in [0, 1], of the same shape.

    Examples
    --------
    >>> linear_from_srgb([0.0, 0.5, 1.0]).round(4).tolist()
    [0.0, 0.214, 1.0]
    """
    value = np.clip(np.asarray(encoded, dtype=np.float64), 0.0, 1.0)
    return np.where(value <= 0.04045, value / 12.92, np.power((value + 0.055) / 1.055, 2.4))


def quantize(encoded: ArrayLike) -> NDArray[np.uint8]:
    """
    Round values in [0, 1] to 8 bits.

    Parameters
    ----------
    encoded : array_like
        Values in [0, 1], of any shape; clipped to that range.

    Returns
    -------
    ndarray, dtype uint8
        ``round(255 * encoded)``, of the same shape.

    Examples
    --------
    >>> quantize([0.0, 0.5, 1.0]).tolist()
    [0, 128, 255]
    """
    value = np.clip(np.asarray(encoded, dtype=np.float64), 0.0, 1.0)
    return np.floor(value * 255.0 + 0.5).astype(np.uint8)
