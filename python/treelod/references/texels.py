"""How a texture is read, by the definition: bilinear on level 0, premultiplied and linear."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from treelod.color import linear_from_srgb

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["bilinear", "bilinear_alpha", "decoded", "wrapped"]


def decoded(texture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """
    Return a stored texture as numbers to mix.

    Parameters
    ----------
    texture : ndarray of shape (H, W, 4), dtype uint8
        sRGB with straight alpha.

    Returns
    -------
    ndarray of shape (H, W, 4)
        Linear, premultiplied.
    """
    table = linear_from_srgb(np.arange(256) / 255.0)
    alpha = texture[..., 3:] / 255.0
    return np.concatenate([table[texture[..., :3]] * alpha, alpha], axis=2)


def wrapped(index: NDArray[np.int64], side: int, wrap: str) -> NDArray[np.int64]:
    """
    Bring texel indices into a texture.

    Parameters
    ----------
    index : ndarray of int64
        Any.
    side : int
        Texels along that axis.
    wrap : {'repeat', 'mirror', 'clamp'}
        What lies outside.

    Returns
    -------
    ndarray of int64
        In ``0..side``.
    """
    if wrap == "clamp":
        return np.clip(index, 0, side - 1)
    if wrap == "mirror":
        turned = np.mod(index, 2 * side)
        return np.asarray(np.minimum(turned, 2 * side - 1 - turned))
    return np.asarray(np.mod(index, side))


def bilinear(
    texels: NDArray[np.float64], uvs: NDArray[np.float64], wrap: tuple[str, str]
) -> NDArray[np.float64]:
    """
    Read a texture between its texels.

    Parameters
    ----------
    texels : ndarray of shape (H, W, C)
        Numbers to mix; row 0 on top.
    uvs : ndarray of shape (N, 2)
        Coordinates; v = 0 is the top row's upper edge.
    wrap : pair of str
        For u and v, as `wrapped`.

    Returns
    -------
    ndarray of shape (N, C)
    """
    height, width = texels.shape[:2]
    place = uvs * (width, height) - 0.5
    corner = np.floor(place).astype(np.int64)
    share = place - corner
    columns = [wrapped(corner[:, 0] + step, width, wrap[0]) for step in (0, 1)]
    rows = [wrapped(corner[:, 1] + step, height, wrap[1]) for step in (0, 1)]
    x, y = share[:, :1], share[:, 1:]
    upper, lower = (
        texels[row, columns[0]] * (1.0 - x) + texels[row, columns[1]] * x for row in rows
    )
    return np.asarray(upper * (1.0 - y) + lower * y)


def bilinear_alpha(
    texel_alpha: NDArray[np.uint8], wrap: tuple[str, str], factor: int
) -> NDArray[np.float32]:
    """
    Return a texture's alpha on a grid `factor` times as fine, as filtering makes it.

    Parameters
    ----------
    texel_alpha : ndarray of shape (H, W), dtype uint8
        Alpha in 1/255.
    wrap : pair of str
        For u and v, as `wrapped`.
    factor : int
        Cells a texel along each axis.

    Returns
    -------
    ndarray of shape (H * factor, W * factor), dtype float32
        Alpha in the middle of each cell.
    """
    alpha = (texel_alpha / 255.0).astype(np.float32)
    for axis in (0, 1):
        side = alpha.shape[axis]
        place = (np.arange(side * factor) + 0.5) / factor - 0.5
        first = np.floor(place).astype(np.int64)
        share = (place - first).astype(np.float32)
        share = share[:, np.newaxis] if axis == 0 else share[np.newaxis, :]
        low, high = (
            np.take(alpha, wrapped(first + step, side, wrap[1 - axis]), axis=axis)
            for step in (0, 1)
        )
        alpha = low + (high - low) * share
    return alpha
