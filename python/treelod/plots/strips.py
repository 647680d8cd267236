"""What errors look like: rows of reference, technique and difference, each with its numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np

from treelod import metrics
from treelod.color import composite, quantize, srgb_from_linear
from treelod.plots.style import STYLE, ShownFigure
from treelod.render import Frame

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from treelod.results import Picture

__all__ = ["picture_strip"]

_PANEL_INCHES = 2.0
_TEXT_INCHES = 1.25
_LONGEST = 2.2
"""Pictures this many times wider than high, or higher than wide, are shown no longer."""


@dataclass(frozen=True)
class _Row:
    title: str
    text: str
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]


def picture_strip(
    pictures: Sequence[Picture] | Mapping[str, Frame],
    reference: Frame | None = None,
    *,
    background: Literal["black", "white"] | None = None,
    ppd: float = metrics.DEFAULT_PPD,
) -> Figure:
    """
    Show what errors look like: one row of reference, technique and difference for each picture.

    Parameters
    ----------
    pictures : sequence of Picture, or mapping of str to Frame
        As from ``Comparison.pictures``, or frames by label.
    reference : Frame, optional
        The truth, of the same camera; needed with frames, refused with pictures, which hold
        theirs.
    background : {"black", "white"}, optional
        What frames are shown on. Default: for each the one with the larger FLIP error.
    ppd : float, default 67.02
        Pixels a degree of sight, for frames.

    Returns
    -------
    matplotlib.figure.Figure
        Of each row the label, where the camera stood, FLIP and the difference in coverage, then
        the three pictures, pixel by pixel. The difference is FLIP's, in the colours of its authors.

    Raises
    ------
    TypeError
        If `pictures` holds something else.
    ValueError
        If there is no picture, if `reference` is missing or not wanted, or as for
        `metrics.compare`.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> camera = tl.orbit(plant, count=1, size=(64, 64))[0]
    >>> full, pruned = tl.FullMesh.build(plant), tl.StochasticPruning.build(plant)
    >>> figure = tl.plots.picture_strip(
    ...     {"pruned": tl.render(pruned, camera)}, reference=tl.render(full, camera)
    ... )
    >>> [axes.get_title(loc="left") for axes in figure.axes[1:4]]
    ['reference', 'technique', 'difference (FLIP)']
    """
    rows = _rows(pictures, reference, background, ppd)
    if not rows:
        msg = "pictures is empty: there is nothing to show"
        raise ValueError(msg)
    heights = [_height(row) for row in rows]
    with mpl.rc_context(STYLE | {"axes.grid": False}):
        width = _TEXT_INCHES + 3 * _PANEL_INCHES + 0.75
        figure = ShownFigure(
            figsize=(width, sum(heights) + 0.12 * len(rows) + 0.35), layout="constrained"
        )
        figure.get_layout_engine().set(w_pad=0.03, h_pad=0.03, wspace=0.0, hspace=0.0)  # type: ignore[union-attr,call-arg]
        grid = figure.subplots(
            len(rows),
            4,
            squeeze=False,
            gridspec_kw={
                "width_ratios": [_TEXT_INCHES, *[_PANEL_INCHES] * 3],
                "height_ratios": heights,
            },
        )
        difference: Any = None
        for row, line in zip(rows, grid, strict=True):
            line[0].axis("off")
            line[0].text(
                0.0, 1.0, row.title, va="top", ha="left", fontsize=8.5, weight="bold", wrap=False
            )
            drop = 0.16 * (1 + row.title.count("\n")) / _height(row)
            line[0].text(
                0.0, 1.0 - drop, row.text, va="top", ha="left", fontsize=8, color="#333333"
            )
            for axes, picture in zip(line[1:3], row.pictures[:2], strict=True):
                axes.imshow(picture, interpolation="nearest")
            difference = line[3].imshow(
                row.pictures[2], cmap="magma", vmin=0.0, vmax=1.0, interpolation="nearest"
            )
            for axes in line[1:]:
                axes.set_xticks([])
                axes.set_yticks([])
                for spine in axes.spines.values():
                    spine.set_visible(True)
                    spine.set_color("#cccccc")
        names = ("reference", "technique", "difference (FLIP)")
        for axes, name in zip(grid[0][1:], names, strict=True):
            axes.set_title(name)
        # beside tall strips no longer than two rows, at the top
        bar = figure.colorbar(
            difference,
            ax=grid[:, 3],
            shrink=min(0.9, 2.0 / len(rows)),
            anchor=(0.0, 1.0),
            aspect=18,
            pad=0.02,
        )
        bar.set_label("FLIP error of a pixel")
        bar.outline.set_linewidth(0.5)
    return figure


def _rows(
    pictures: Sequence[Picture] | Mapping[str, Frame],
    reference: Frame | None,
    background: str | None,
    ppd: float,
) -> list[_Row]:
    if hasattr(pictures, "items"):
        if reference is None:
            msg = "reference is needed with frames: the full mesh from the same camera"
            raise ValueError(msg)
        if background not in (None, *metrics.BACKGROUNDS):
            msg = f"background must be one of {sorted(metrics.BACKGROUNDS)}, got {background!r}"
            raise ValueError(msg)
        return [
            _frame_row(str(label), reference, frame, background, ppd)
            for label, frame in pictures.items()
        ]
    if reference is not None or background is not None:
        msg = "reference and background are for frames: pictures hold theirs"
        raise ValueError(msg)
    if isinstance(pictures, Frame) or not hasattr(pictures, "__iter__"):
        msg = f"pictures must be Pictures, or Frames by label, got {type(pictures).__name__}"
        raise TypeError(msg)
    return [_picture_row(picture) for picture in pictures]


def _frame_row(
    label: str, reference: Frame, frame: Frame, background: str | None, ppd: float
) -> _Row:
    errors = metrics.compare(reference, frame, ppd=ppd)
    name: Any = background or errors.worse_background
    left, top, right, bottom = errors.region
    shown = [
        quantize(
            srgb_from_linear(
                composite(
                    np.asarray(picture.color)[top:bottom, left:right], metrics.BACKGROUNDS[name]
                )
            )
        )
        for picture in (reference, frame)
    ]
    difference = metrics.flip_map(reference, frame, background=name, ppd=ppd)
    return _Row(_folded(label), _numbers(errors, name), (shown[0], shown[1], difference))


def _picture_row(picture: Picture) -> _Row:
    if not hasattr(picture, "difference"):
        msg = f"pictures must be Pictures, or Frames by label, got {type(picture).__name__}"
        raise TypeError(msg)
    view = picture.row.view
    where = (
        f"{picture.why}: {view.distance:.4g} radii\n"
        f"azimuth {view.azimuth_deg:g}°, elevation {view.elevation_deg:g}°\n"
    )
    text = where + _numbers(picture.row.errors, picture.background)
    return _Row(
        _folded(picture.row.label), text, (picture.reference, picture.image, picture.difference)
    )


def _numbers(errors: metrics.Errors, background: str) -> str:
    lines = [f"FLIP {errors.on[background].flip:.3f} on {background}"]
    if errors.coverage_bias is not None:
        lines.append(f"coverage {errors.coverage_bias:+.3f}")
    return "\n".join(lines)


def _folded(label: str, width: int = 19) -> str:
    """Break a label after a colon or comma, and within words that are too long."""
    lines = [""]
    for part in label.replace(":", ":\0").replace(",", ",\0").split("\0"):
        rest = part
        if lines[-1] and len(lines[-1]) + len(rest) > width:
            lines.append("")
        while len(lines[-1]) + len(rest) > width:
            room = width - len(lines[-1])
            lines[-1] += rest[:room]
            rest = rest[room:]
            lines.append("")
        lines[-1] += rest
    return "\n".join(line for line in lines if line)


def _height(row: _Row) -> float:
    """Inches of a row: the pictures' as wide as a panel, between bounds."""
    height, width = row.pictures[2].shape
    return float(
        np.clip(_PANEL_INCHES * height / width, _PANEL_INCHES / _LONGEST, _PANEL_INCHES * 1.3)
    )
