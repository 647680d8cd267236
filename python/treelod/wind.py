"""Wind: how far plants lean, and how they swing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from treelod.techniques.technique import number, whole

if TYPE_CHECKING:
    from treelod import _core

__all__ = ["Wind"]


@dataclass(frozen=True, kw_only=True)
class Wind:
    """
    A steady lean and a swing about it, for the copies of a `Scene`.

    A plant in the wind is sheared: its foot stays, and a point `h` metres above it moves
    ``h * (lean + sway * sin(2 * pi * (time_secs / period_secs + phase)))`` metres sideways, level
    with the ground [1]_. The foot is the middle of the lower side of the box around wood and
    leaves. The time is that of the camera: see `Camera.at`. Each copy has a phase of its own, drawn
    from `seed` and the copy's place in its scene.

    Attributes
    ----------
    sway : float, default 0.03
        Largest distance that the top swings to either side, in plant heights, in [0, 1].
    lean : float, default 0
        How far the top is moved at all times, in plant heights, in [-1, 1].
    period_secs : float, default 4
        Seconds a swing, in [0.001, 1e6].
    azimuth_deg : float, optional
        Where the wind blows to, in degrees from +z towards +x, in [-360, 360]. Default: to the
        right of the picture, level with the ground.
    seed : int, default 0
        Of the phases, in [0, 2**64).

    Raises
    ------
    ValueError
        If a number is out of range.

    References
    ----------
    .. [1] D. Sanchez-Crespo Dalmau. Core Techniques and Algorithms in Game Programming, chapter 20:
       "leaving the base vertices unchanged while translating the top vertices". New Riders, 2003.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> scene = tl.Scene([(tl.FullMesh.build(plant), None)], wind=tl.Wind(sway=0.05))
    >>> camera = tl.orbit(plant, size=(32, 32))[0]
    >>> frames = [tl.render(scene, camera.at(time_secs)) for time_secs in (0.0, 0.5, 1.0)]
    """

    sway: float = 0.03
    lean: float = 0.0
    period_secs: float = 4.0
    azimuth_deg: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Check every field and store plain numbers."""
        ranges = {"sway": (0.0, 1.0), "lean": (-1.0, 1.0), "period_secs": (1e-3, 1e6)}
        if self.azimuth_deg is not None:
            ranges["azimuth_deg"] = (-360.0, 360.0)
        for name, (low, high) in ranges.items():
            value = number(name, getattr(self, name))
            if not (math.isfinite(value) and low <= value <= high):
                msg = f"{name} must be in [{low:g}, {high:g}], got {value}"
                raise ValueError(msg)
            object.__setattr__(self, name, value)
        object.__setattr__(self, "seed", whole("seed", self.seed, 0, 2**64))


def wind_facts(wind: Wind | None) -> _core._WindFacts | None:
    """
    Return a wind as the core takes it.

    Parameters
    ----------
    wind : Wind or None
        What blows, if anything does.

    Returns
    -------
    dict or None

    Raises
    ------
    TypeError
        If it is anything else.
    """
    if wind is None:
        return None
    if not isinstance(wind, Wind):
        msg = f"wind must be a Wind or None, got {type(wind).__name__}"
        raise TypeError(msg)
    return {
        "lean": wind.lean,
        "sway": wind.sway,
        "period_secs": wind.period_secs,
        "azimuth_deg": wind.azimuth_deg,
        "seed": wind.seed,
    }
