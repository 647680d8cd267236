"""
How wrong a picture of a plant looks: the errors of one frame against a reference frame.

Both frames are composited in linear light on black and on white, clipped to [0, 1] and encoded as
sRGB, since that is what people see. A technique that is too thin looks right on one background
and wrong on the other, so each error is taken on both and the worse one is the headline.

All errors are means over the plant's projected bounds plus a margin, not over the window: with
the window, the same picture of a tree gets better by moving the camera away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import OpenImageIO as oiio  # noqa: N813
from skimage.metrics import structural_similarity

from treelod.color import composite, linear_from_srgb, srgb_from_linear
from treelod.errors import InternalError
from treelod.render import render

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from treelod.cameras import Camera
    from treelod.render import Frame
    from treelod.scenes import Scene
    from treelod.techniques.technique import Technique

__all__ = [
    "BACKGROUNDS",
    "DEFAULT_PPD",
    "BackgroundErrors",
    "Errors",
    "compare",
    "compare_arrays",
    "flip_map",
    "measured_region",
    "popping",
]

DEFAULT_PPD = 67.02
"""Pixels a degree of sight: a 0.7 m wide screen of 3840 pixels seen from 0.7 m, FLIP's default."""

BACKGROUNDS: Mapping[str, float] = MappingProxyType({"black": 0.0, "white": 1.0})
"""Linear value of each background that errors are taken on."""

MARGIN_PX = 8
"""Added around the plant's bounds: filtered cards reach a little beyond the plant."""

MIN_REGION_PX = 32
"""Smallest side of the measured region, where the frame allows it."""

SSIM_WINDOW_PX = 7
"""Side of the window of structural similarity; smaller regions have none."""

YEE_LUMINANCE = 100.0
"""Luminance of white in candela per square metre, for the Yee metric."""

# rows: linear Adobe RGB (1998) from linear Rec. 709, both D65; the Yee metric expects the former
_ADOBE_FROM_REC709 = np.array(
    [[0.7151256, 0.2848744, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0411619, 0.9588381]]
)

Region = tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class BackgroundErrors:
    """
    Errors of one picture on one background.

    Attributes
    ----------
    flip : float
        Mean FLIP error in [0, 1]; 0 is identical.
    rmse : float
        Root mean square difference of the sRGB-encoded values, over pixels and channels, in
        [0, 1].
    psnr : float
        Peak signal-to-noise ratio ``20 log10(1 / rmse)`` in dB; infinite if identical.
    max : float
        Largest difference of any channel of any pixel, in [0, 1].
    ssim : float or None
        Mean structural similarity in [-1, 1], 1 if identical (7 x 7 window, the three channels
        averaged); None if the region is under 7 pixels wide or high.
    yee : float or None
        Share of pixels in which Yee's model of sight sees a difference, in [0, 1]; None unless
        asked for.
    """

    flip: float
    rmse: float
    psnr: float
    max: float
    ssim: float | None
    yee: float | None


@dataclass(frozen=True, kw_only=True)
class Errors:
    """
    Errors of one picture against its reference.

    Attributes
    ----------
    on : mapping of str to BackgroundErrors
        Errors on ``"black"`` and on ``"white"``.
    coverage_bias : float or None
        Mean alpha of the picture minus mean alpha of the reference, in [-1, 1]: positive is too
        dense, negative too thin. None for pictures without alpha.
    coverage_error : float or None
        Mean absolute difference of alpha, in [0, 1]. None for pictures without alpha.
    region : tuple of 4 ints
        Left, top, right, bottom (exclusive) of the measured pixels.
    ppd : float
        Pixels a degree of sight that FLIP and Yee were told.

    Notes
    -----
    `flip`, `rmse`, `psnr`, `max`, `ssim` and `yee` of this class are those of the worse
    background, chosen for each error by itself.
    """

    on: Mapping[str, BackgroundErrors]
    coverage_bias: float | None
    coverage_error: float | None
    region: Region
    ppd: float

    @property
    def flip(self) -> float:
        """Mean FLIP error on the worse background: the larger one."""
        return max(errors.flip for errors in self.on.values())

    @property
    def rmse(self) -> float:
        """Root mean square difference on the worse background: the larger one."""
        return max(errors.rmse for errors in self.on.values())

    @property
    def psnr(self) -> float:
        """Peak signal-to-noise ratio in dB on the worse background: the smaller one."""
        return min(errors.psnr for errors in self.on.values())

    @property
    def max(self) -> float:
        """Largest difference on the worse background: the larger one."""
        return max(errors.max for errors in self.on.values())

    @property
    def ssim(self) -> float | None:
        """Structural similarity on the worse background: the smaller one; None under 7 px."""
        values = [errors.ssim for errors in self.on.values() if errors.ssim is not None]
        return min(values, default=None)

    @property
    def yee(self) -> float | None:
        """Share of visibly different pixels on the worse background: the larger one, or None."""
        values = [errors.yee for errors in self.on.values() if errors.yee is not None]
        return max(values, default=None)

    @property
    def worse_background(self) -> str:
        """The background with the larger FLIP error; black if they are equal."""
        return max(self.on, key=lambda name: (self.on[name].flip, name == "black"))


def measured_region(bounds_px: Region, size: tuple[int, int]) -> Region:
    """
    Return the pixels that errors are taken over.

    Parameters
    ----------
    bounds_px : tuple of 4 ints
        Left, top, right, bottom (exclusive) of the plant's projected box, as in
        ``Frame.bounds_px``.
    size : tuple of 2 ints
        Width and height of the frame in pixels.

    Returns
    -------
    tuple of 4 ints
        `bounds_px` grown by 8 pixels and clamped to the frame, then grown about its middle to at
        least 32 x 32 pixels where the frame is that large. If `bounds_px` is empty (the plant is
        out of view) the whole frame: both pictures should be empty, and whatever is drawn in one
        of them counts.

    Examples
    --------
    >>> measured_region((100, 90, 300, 200), (640, 480))
    (92, 82, 308, 208)
    >>> measured_region((0, 100, 2, 102), (640, 480))
    (0, 85, 32, 117)
    """
    left, top, right, bottom = bounds_px
    width, height = size
    if right <= left or bottom <= top:
        return 0, 0, width, height
    left, right = _grow(left, right, width)
    top, bottom = _grow(top, bottom, height)
    return left, top, right, bottom


def compare(
    reference: Frame, frame: Frame, *, ppd: float = DEFAULT_PPD, yee: bool = False
) -> Errors:
    """
    Measure how far a frame is from a reference frame of the same camera.

    Parameters
    ----------
    reference : Frame
        The truth: the full plant at many samples a pixel. Its bounds set the measured region, so
        all techniques are measured over the same pixels.
    frame : Frame
        The picture to judge.
    ppd : float, default 67.02
        Pixels a degree of sight, above 0.
    yee : bool, default False
        Whether to run Yee's model of sight too, which takes seconds a picture.

    Returns
    -------
    Errors
        On black, on white, and of the worse of the two.

    Raises
    ------
    TypeError
        If an argument is not a frame; `compare_arrays` takes arrays.
    ValueError
        If the frames differ in size or camera, if a pixel is NaN or infinite, or if `ppd` is not
        above 0.

    Notes
    -----
    RMSE, PSNR and the largest difference are by OpenImageIO's ``compare``, FLIP [1]_ by its
    ``FLIP_diff`` (low dynamic range), structural similarity [2]_ by scikit-image; all on the
    sRGB-encoded composites. Yee [3]_ is by OpenImageIO on the linear composites.

    References
    ----------
    .. [1] P. Andersson, J. Nilsson, T. Akenine-Moller, M. Oskarsson, K. Astrom, M. D. Fairchild.
       FLIP: a difference evaluator for alternating images. 2020.
    .. [2] Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli. Image quality assessment: from
       error visibility to structural similarity. 2004.
    .. [3] H. Yee. A perceptual metric for production testing. 2004.
    """
    first, second = _pair(reference, frame)
    region = _region_of(reference)
    return _measure(_crop(first, region), _crop(second, region), region, ppd=ppd, yee=yee)


def compare_arrays(
    reference: ArrayLike,
    image: ArrayLike,
    *,
    color_space: Literal["linear", "srgb"],
    data_range: float,
    alpha: Literal["premultiplied", "straight", "none"],
    ppd: float = DEFAULT_PPD,
    yee: bool = False,
) -> Errors:
    """
    Measure how far a picture is from a reference, for pictures made elsewhere.

    Parameters
    ----------
    reference, image : array_like of shape (H, W, 3) or (H, W, 4)
        Two pictures of one shape, any real type; measured in full.
    color_space : {"linear", "srgb"}
        What the colours are: linear, or sRGB-encoded. Alpha is linear always.
    data_range : float
        The value of white and of full alpha: 1 for floats, 255 for 8-bit pictures.
    alpha : {"premultiplied", "straight", "none"}
        What the fourth channel is; "none" if there are three. Premultiplied colours must be
        linear, since encoding does not commute with multiplying.
    ppd : float, default 67.02
        Pixels a degree of sight, above 0.
    yee : bool, default False
        Whether to run Yee's model of sight too, which takes seconds a picture.

    Returns
    -------
    Errors
        As for `compare`; the coverage figures are None for ``alpha="none"``.

    Raises
    ------
    ValueError
        If shapes differ or do not fit `alpha`, if a pixel is NaN or infinite, or if a keyword has
        no such value.
    """
    if color_space not in ("linear", "srgb"):
        msg = f"color_space must be 'linear' or 'srgb', got {color_space!r}"
        raise ValueError(msg)
    if alpha not in ("premultiplied", "straight", "none"):
        msg = f"alpha must be 'premultiplied', 'straight' or 'none', got {alpha!r}"
        raise ValueError(msg)
    if alpha == "premultiplied" and color_space == "srgb":
        msg = "alpha='premultiplied' needs color_space='linear': decode before multiplying"
        raise ValueError(msg)
    if not 0.0 < data_range < math.inf:
        msg = f"data_range must be finite and above 0, got {data_range}"
        raise ValueError(msg)
    pictures = []
    for name, value in (("reference", reference), ("image", image)):
        picture = np.asarray(value)
        channels = 3 if alpha == "none" else 4
        if picture.ndim != 3 or picture.shape[2] != channels or picture.size == 0:
            msg = (
                f"{name} must have shape (H, W, {channels}) with alpha={alpha!r}, "
                f"got {picture.shape}"
            )
            raise ValueError(msg)
        _check_finite(name, picture)
        pictures.append(_premultiplied(picture.astype(np.float64) / data_range, color_space, alpha))
    _check_same_shape(*pictures)
    height, width = pictures[0].shape[:2]
    return _measure(
        pictures[0],
        pictures[1],
        (0, 0, width, height),
        ppd=ppd,
        yee=yee,
        has_alpha=alpha != "none",
    )


def flip_map(
    reference: Frame,
    frame: Frame,
    *,
    background: Literal["black", "white"],
    ppd: float = DEFAULT_PPD,
) -> NDArray[np.float32]:
    """
    Return where a frame differs visibly from a reference frame.

    Parameters
    ----------
    reference, frame : Frame
        As for `compare`.
    background : {"black", "white"}
        What both are composited over.
    ppd : float, default 67.02
        Pixels a degree of sight, above 0.

    Returns
    -------
    ndarray of shape (h, w), dtype float32
        FLIP error in [0, 1] of each pixel of ``measured_region(reference.bounds_px, size)``. Its
        mean is ``compare(reference, frame).on[background].flip``.

    Raises
    ------
    TypeError, ValueError
        As for `compare`.
    """
    if background not in BACKGROUNDS:
        msg = f"background must be one of {sorted(BACKGROUNDS)}, got {background!r}"
        raise ValueError(msg)
    first, second = _pair(reference, frame)
    region = _region_of(reference)
    encoded = [
        srgb_from_linear(composite(_crop(color, region), BACKGROUNDS[background]))
        for color in (first, second)
    ]
    return _flip(encoded[0], encoded[1], ppd)


def popping(
    before: Technique | Scene,
    after: Technique | Scene,
    camera: Camera,
    *,
    samples: int = 64,
    ppd: float = DEFAULT_PPD,
    yee: bool = False,
    threads: int | None = None,
) -> Errors:
    """
    Measure what the eye sees jump when a subject is exchanged for another.

    Parameters
    ----------
    before, after : Technique or Scene
        The two sides of a switch: two levels, or one at two moments of a transition.
    camera : Camera
        From which both are seen. Between two cameras parallax would be measured.
    samples : int, default 64
        Samples a pixel, as in `treelod.render`.
    ppd, yee
        As for `compare`.
    threads : int, optional
        As in `treelod.render`.

    Returns
    -------
    Errors
        Of `after` against `before`, over the region of `before`.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=200)
    >>> lod = tl.LeafClusters.build(plant, cluster_count=(16, 8), resolution=64)
    >>> camera = tl.orbit(plant, count=1, size=(64, 64))[0]
    >>> swap = tl.metrics.popping(lod.at(level=0, t=1.0), lod.at(level=1), camera, samples=4)
    >>> swap.flip
    0.0
    """
    check_ppd(ppd)
    first, second = (
        render(subject, camera, samples=samples, outputs=("color",), threads=threads)
        for subject in (before, after)
    )
    return compare(first, second, ppd=ppd, yee=yee)


def _pair(reference: Frame, frame: Frame) -> tuple[NDArray[Any], NDArray[Any]]:
    colors = []
    for name, value in (("reference", reference), ("frame", frame)):
        if isinstance(value, np.ndarray) or not hasattr(value, "bounds_px"):
            msg = f"{name} must be a Frame, got {type(value).__name__}; compare_arrays takes arrays"
            raise TypeError(msg)
        if value.color is None:
            msg = f"{name} holds no colour: draw it with 'color' among the outputs"
            raise ValueError(msg)
        color = np.asarray(value.color)
        if color.ndim != 3 or color.shape[2] != 4 or color.size == 0:
            msg = f"{name}.color must have shape (H, W, 4), got {color.shape}"
            raise ValueError(msg)
        _check_finite(f"{name}.color", color)
        colors.append(color)
    _check_same_shape(*colors)
    if reference.camera != frame.camera:
        msg = "reference and frame must be of the same camera; across cameras parallax is measured"
        raise ValueError(msg)
    return colors[0], colors[1]


def _measure(
    reference: NDArray[Any],
    image: NDArray[Any],
    region: Region,
    *,
    ppd: float,
    yee: bool,
    has_alpha: bool = True,
) -> Errors:
    check_ppd(ppd)
    on = {}
    for name, background in BACKGROUNDS.items():
        linear = [np.clip(composite(c, background), 0.0, 1.0) for c in (reference, image)]
        on[name] = _errors_on(linear[0], linear[1], ppd=ppd, yee=yee)
    bias = error = None
    if has_alpha:
        difference = image[..., 3].astype(np.float64) - reference[..., 3]
        bias, error = float(difference.mean()), float(np.abs(difference).mean())
    return Errors(
        on=MappingProxyType(on), coverage_bias=bias, coverage_error=error, region=region, ppd=ppd
    )


def _errors_on(
    reference_linear: NDArray[Any], image_linear: NDArray[Any], *, ppd: float, yee: bool
) -> BackgroundErrors:
    reference, image = srgb_from_linear(reference_linear), srgb_from_linear(image_linear)
    result = oiio.ImageBufAlgo.compare(_buffer(reference), _buffer(image), 0.0, 0.0)
    similarity = None
    if min(reference.shape[:2]) >= SSIM_WINDOW_PX:
        similarity = float(
            structural_similarity(  # type: ignore[no-untyped-call]
                reference, image, win_size=SSIM_WINDOW_PX, data_range=1.0, channel_axis=-1
            )
        )
    return BackgroundErrors(
        # numpy sums pairwise in f64; the map is f32
        flip=float(_flip(reference, image, ppd).mean(dtype=np.float64)),
        rmse=float(result.rms_error),
        psnr=float(result.PSNR),
        max=float(result.maxerror),
        ssim=similarity,
        yee=_yee(reference_linear, image_linear, ppd) if yee else None,
    )


def check_ppd(ppd: float) -> None:
    """Refuse pixels a degree that are not finite and above 0."""
    if not 0.0 < ppd < math.inf:
        msg = f"ppd must be finite and above 0, got {ppd}"
        raise ValueError(msg)


def _flip(reference: NDArray[Any], image: NDArray[Any], ppd: float) -> NDArray[np.float32]:
    buffers = [_buffer(picture) for picture in (reference, image)]
    for buffer in buffers:
        # an untagged buffer is taken as linear, and every figure is wrong by a fifth
        buffer.specmod().attribute("oiio:ColorSpace", "srgb_rec709_scene")
    result = oiio.ImageBufAlgo.FLIP_diff(buffers[0], buffers[1], hdr=0, ppd=ppd)
    if result.has_error:
        msg = f"OpenImageIO could not compute FLIP: {result.geterror()}"
        raise InternalError(msg)
    pixels = np.asarray(result.get_pixels(oiio.FLOAT), dtype=np.float32)
    return pixels.reshape(reference.shape[:2])


def _yee(reference: NDArray[Any], image: NDArray[Any], ppd: float) -> float:
    height, width = reference.shape[:2]
    buffers = [_buffer(picture @ _ADOBE_FROM_REC709.T) for picture in (reference, image)]
    result = oiio.CompareResults()
    # its field of view spans the width of what it is given: the region, not the window
    oiio.ImageBufAlgo.compare_Yee(
        buffers[0], buffers[1], result, luminance=YEE_LUMINANCE, fov=width / ppd
    )
    return int(result.nfail) / float(width * height)


def _buffer(picture: NDArray[Any]) -> Any:
    return oiio.ImageBuf(np.ascontiguousarray(picture, dtype=np.float32))


def _premultiplied(picture: NDArray[Any], color_space: str, alpha: str) -> NDArray[Any]:
    color = picture[..., :3]
    if color_space == "srgb":
        color = linear_from_srgb(color)
    if alpha == "none":
        return np.concatenate([color, np.ones_like(picture[..., :1])], axis=2)
    coverage = picture[..., 3:]
    return np.concatenate([color * coverage if alpha == "straight" else color, coverage], axis=2)


def _check_finite(name: str, picture: NDArray[Any]) -> None:
    # every library behind this module passes over NaN in silence
    if not np.isfinite(picture).all():
        row, column, channel = np.argwhere(~np.isfinite(picture))[0]
        msg = f"{name} must be finite: row {row}, column {column}, channel {channel} is not"
        raise ValueError(msg)


def _check_same_shape(reference: NDArray[Any], image: NDArray[Any]) -> None:
    # OpenImageIO takes missing pixels as black
    if reference.shape != image.shape:
        msg = f"pictures must have one shape, got {reference.shape} and {image.shape}"
        raise ValueError(msg)


def _region_of(reference: Frame) -> Region:
    height, width = np.asarray(reference.color).shape[:2]
    return measured_region(reference.bounds_px, (width, height))


def _crop(color: NDArray[Any], region: Region) -> NDArray[Any]:
    left, top, right, bottom = region
    return color[top:bottom, left:right]


def _grow(low: int, high: int, size: int) -> tuple[int, int]:
    low, high = max(low - MARGIN_PX, 0), min(high + MARGIN_PX, size)
    wanted = min(MIN_REGION_PX, size)
    if high - low < wanted:
        low = min(max(low - (wanted - (high - low)) // 2, 0), size - wanted)
        high = low + wanted
    return low, high
