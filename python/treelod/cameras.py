"""
Where a picture is taken from, and which pixel a point lands on.

Right-handed, y up, metres. A camera looks along its own -z; row 0 is on top and pixel centres lie
at +0.5. There is no far plane.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from treelod.plants import Plant

__all__ = [
    "DEFAULT_AZIMUTH_COUNT",
    "DEFAULT_DISTANCES",
    "DEFAULT_ELEVATIONS_DEG",
    "Camera",
    "default_cameras",
    "orbit",
]

DEFAULT_AZIMUTH_COUNT = 8
"""Cameras on each circle of a comparison."""

DEFAULT_ELEVATIONS_DEG = (0.0, 25.0)
"""Heights of the circles of a comparison."""

DEFAULT_DISTANCES = (2.5, 10.0, 40.0)
"""Radii of the circles of a comparison, in radii of the plant's bounding sphere."""

MAX_SIZE = 16384
"""Largest width or height of a picture in pixels."""

MAX_TIME_SECS = 1e9
"""Farthest time from 0 in seconds: thirty years."""

NEAR_REL = 1e-3
"""Default near plane, as a share of the distance from eye to target."""

PARALLEL = 1e-6
"""Sine of the angle between `up` and the view below which `up` gives no direction."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """
    A perspective or an orthographic view; use `perspective` and `orthographic` to make one.

    Attributes
    ----------
    eye, target : tuple of 3 floats
        World positions in metres; they must differ.
    up : tuple of 3 floats
        Direction that points up in the picture, any length above 0. Where it is parallel to the
        view (straight down, say), -z takes its place, or +y if the view is along z.
    fov_y_deg : float or None
        Full vertical angle of view in degrees, in (0, 180); None for an orthographic camera.
    height : float or None
        Height of an orthographic view in metres, above 0; None for a perspective camera.
    size : tuple of 2 ints
        Width and height in pixels, each in 1..=16384.
    near : float
        Distance of the near plane from the eye in metres, along the view, above 0.
    time_secs : float
        When the picture is taken, in seconds, in [-1e9, 1e9]: what a `Wind` moves moves with it.
        Default: 0.

    Raises
    ------
    ValueError
        If a number is out of range or not finite, if `eye` equals `target`, or unless exactly one
        of `fov_y_deg` and `height` is given.
    """

    eye: Vector
    target: Vector
    up: Vector
    fov_y_deg: float | None
    height: float | None
    size: tuple[int, int]
    near: float
    time_secs: float = 0.0

    def __post_init__(self) -> None:
        """Check every field and store plain floats and ints."""
        for name in ("eye", "target", "up"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))
        object.__setattr__(self, "size", _size(self.size))
        distance = math.dist(self.eye, self.target)
        if not 0.0 < distance < math.inf:
            msg = f"eye and target must differ and be less than 1e308 m apart, got {self.eye}"
            raise ValueError(msg)
        if math.hypot(*self.up) == 0.0:
            msg = "up must not be the zero vector"
            raise ValueError(msg)
        if (self.fov_y_deg is None) == (self.height is None):
            msg = "exactly one of fov_y_deg (perspective) and height (orthographic) must be given"
            raise ValueError(msg)
        if self.fov_y_deg is not None:
            fov = _positive("fov_y_deg", self.fov_y_deg)
            if fov >= 180.0:
                msg = f"fov_y_deg must be in (0, 180), got {fov}"
                raise ValueError(msg)
            object.__setattr__(self, "fov_y_deg", fov)
        if self.height is not None:
            object.__setattr__(self, "height", _positive("height", self.height))
        object.__setattr__(self, "near", _positive("near", self.near))
        time_secs = float(self.time_secs)
        if not -MAX_TIME_SECS <= time_secs <= MAX_TIME_SECS:
            msg = f"time_secs must be in [{-MAX_TIME_SECS:g}, {MAX_TIME_SECS:g}], got {time_secs}"
            raise ValueError(msg)
        object.__setattr__(self, "time_secs", time_secs)

    @classmethod
    def perspective(
        cls,
        eye: Sequence[float],
        target: Sequence[float],
        fov_y_deg: float = 45.0,
        size: tuple[int, int] = (1024, 768),
        up: Sequence[float] = (0.0, 1.0, 0.0),
        near: float | None = None,
    ) -> Camera:
        """
        Make a camera with perspective.

        Parameters
        ----------
        eye, target : sequence of 3 floats
            World positions in metres.
        fov_y_deg : float, default 45
            Full vertical angle of view in degrees, in (0, 180).
        size : tuple of 2 ints, default (1024, 768)
            Width and height in pixels, each in 1..=16384.
        up : sequence of 3 floats, default +y
            Direction that points up in the picture.
        near : float, optional
            Near plane in metres, above 0. Default: 1e-3 of the distance from eye to target.

        Returns
        -------
        Camera

        Raises
        ------
        ValueError
            If an argument is out of range or not finite.

        Examples
        --------
        >>> camera = Camera.perspective((0, 0, 10), (0, 0, 0), size=(640, 480))
        >>> camera.near
        0.01
        """
        return cls(
            eye=_vector("eye", eye),
            target=_vector("target", target),
            up=_vector("up", up),
            fov_y_deg=fov_y_deg,
            height=None,
            size=size,
            near=_default_near(eye, target) if near is None else near,
        )

    @classmethod
    def orthographic(
        cls,
        eye: Sequence[float],
        target: Sequence[float],
        *,
        height: float,
        size: tuple[int, int],
        up: Sequence[float] = (0.0, 1.0, 0.0),
        near: float | None = None,
    ) -> Camera:
        """
        Make a camera without perspective.

        Parameters
        ----------
        eye, target : sequence of 3 floats
            World positions in metres; only what lies beyond the near plane in front of `eye` is
            drawn.
        height : float
            Height of the view in metres, above 0; its width follows from `size`.
        size : tuple of 2 ints
            Width and height in pixels, each in 1..=16384.
        up : sequence of 3 floats, default +y
            Direction that points up in the picture.
        near : float, optional
            Near plane in metres, above 0. Default: 1e-3 of the distance from eye to target.

        Returns
        -------
        Camera

        Raises
        ------
        ValueError
            If an argument is out of range or not finite.

        Examples
        --------
        >>> Camera.orthographic((0, 0, 10), (0, 0, 0), height=4, size=(64, 64)).height
        4.0
        """
        return cls(
            eye=_vector("eye", eye),
            target=_vector("target", target),
            up=_vector("up", up),
            fov_y_deg=None,
            height=height,
            size=size,
            near=_default_near(eye, target) if near is None else near,
        )

    def at(self, time_secs: float) -> Camera:
        """
        Return the same camera at another time.

        Parameters
        ----------
        time_secs : float
            In seconds, in [-1e9, 1e9].

        Returns
        -------
        Camera

        Raises
        ------
        ValueError
            If it is out of range or not finite.

        Examples
        --------
        >>> Camera.perspective((0, 0, 10), (0, 0, 0)).at(2.5).time_secs
        2.5
        """
        return replace(self, time_secs=time_secs)

    @property
    def is_perspective(self) -> bool:
        """Whether far things look smaller."""
        return self.fov_y_deg is not None

    def view_rotation(self) -> NDArray[np.float64]:
        """
        Return the rotation from world to view axes.

        Returns
        -------
        ndarray of shape (3, 3), dtype float64
            Rows are the unit vectors right, up and back (from target to eye) in world axes.
        """
        back = _unit(np.subtract(self.eye, self.target))
        for up in (self.up, (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)):
            right = np.cross(_unit(np.asarray(up)), back)
            if np.linalg.norm(right) > PARALLEL:
                break
        right = _unit(right)
        return np.stack([right, np.cross(back, right), back])

    def pixels_per_metre(self, depth: float) -> float:
        """
        Return how many pixels a metre across the view covers at a view depth.

        Parameters
        ----------
        depth : float
            View depth in metres, above 0; without meaning for an orthographic camera.

        Returns
        -------
        float
            Pixels a metre.
        """
        if self.fov_y_deg is None:
            return self.size[1] / float(self.height or math.inf)
        return self.size[1] / (2.0 * depth * math.tan(math.radians(self.fov_y_deg) / 2.0))

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """
        Map world points to pixels.

        Parameters
        ----------
        points : array_like of shape (N, 3)
            World positions in metres.

        Returns
        -------
        ndarray of shape (N, 3), dtype float64
            Pixel x (to the right), pixel y (down; row 0 on top, the first pixel's centre is at
            0.5) and view depth in metres (along the view, not along the ray). Points at or behind
            the eye's plane have NaN pixels under perspective, and their depth.

        Raises
        ------
        ValueError
            If `points` is not of shape (N, 3).

        Examples
        --------
        >>> camera = Camera.perspective((0, 0, 2), (0, 0, 0), fov_y_deg=90, size=(200, 100))
        >>> camera.project([[0, 0, 0], [1, 1, 0]]).round(6).tolist()
        [[100.0, 50.0, 2.0], [125.0, 25.0, 2.0]]
        """
        world = np.asarray(points, dtype=np.float64)
        if world.ndim != 2 or world.shape[1] != 3:
            msg = f"points must have shape (N, 3), got {world.shape}"
            raise ValueError(msg)
        view = (world - np.asarray(self.eye)) @ self.view_rotation().T
        depth = -view[:, 2]
        width, height = self.size
        if self.fov_y_deg is None:
            scale = np.full(len(depth), self.pixels_per_metre(1.0))
        else:
            scale = np.full(len(depth), math.nan)
            np.divide(self.pixels_per_metre(1.0), depth, out=scale, where=depth > 0.0)
        x = width / 2.0 + view[:, 0] * scale
        y = height / 2.0 - view[:, 1] * scale
        return np.stack([x, y, depth], axis=1)


def orbit(
    plant: Plant,
    count: int = 8,
    elevation_deg: float = 0.0,
    distance: float = 2.5,
    size: tuple[int, int] = (1024, 768),
    fov_y_deg: float = 45.0,
) -> list[Camera]:
    """
    Place cameras on a circle around a plant, all looking at its centre.

    Parameters
    ----------
    plant : Plant
        The plant; its bounding sphere (``plant.sphere``) gives centre and unit of distance.
    count : int, default 8
        Number of cameras, at least 1, evenly spaced: azimuth 0 is +z, then counter-clockwise seen
        from above (towards +x).
    elevation_deg : float, default 0
        Angle above the horizon in degrees, in [-90, 90]. At the poles the azimuth is lost: -z is
        up in the picture.
    distance : float, default 2.5
        From the centre, in radii of the bounding sphere; above 0.
    size : tuple of 2 ints, default (1024, 768)
        Width and height in pixels.
    fov_y_deg : float, default 45
        Full vertical angle of view in degrees.

    Returns
    -------
    list of Camera
        `count` cameras by rising azimuth.

    Raises
    ------
    ValueError
        If an argument is out of range, or if the plant's sphere has no radius.
    """
    if operator.index(count) < 1:
        msg = f"count must be at least 1, got {count}"
        raise ValueError(msg)
    if not -90.0 <= elevation_deg <= 90.0:
        msg = f"elevation_deg must be in [-90, 90], got {elevation_deg}"
        raise ValueError(msg)
    distance = _positive("distance", distance)
    center, radius = plant.sphere
    if not 0.0 < radius < math.inf:
        msg = f"plant has a bounding sphere of radius {radius}; an orbit needs one above 0"
        raise ValueError(msg)
    elevation = math.radians(elevation_deg)
    cameras = []
    for index in range(count):
        azimuth = 2.0 * math.pi * index / count
        out = np.array(
            [
                math.sin(azimuth) * math.cos(elevation),
                math.sin(elevation),
                math.cos(azimuth) * math.cos(elevation),
            ]
        )
        eye = np.asarray(center, dtype=np.float64) + out * (distance * radius)
        cameras.append(
            Camera.perspective(
                _vector("eye", eye), _vector("target", center), fov_y_deg=fov_y_deg, size=size
            )
        )
    return cameras


def default_cameras(
    plant: Plant,
    *,
    azimuth_count: int = DEFAULT_AZIMUTH_COUNT,
    elevations_deg: Sequence[float] = DEFAULT_ELEVATIONS_DEG,
    distances: Sequence[float] = DEFAULT_DISTANCES,
    size: tuple[int, int] = (1024, 768),
) -> list[Camera]:
    """
    Place the cameras of a comparison: circles at several heights and distances.

    Parameters
    ----------
    plant : Plant
        What they look at.
    azimuth_count : int, default 8
        Cameras on each circle, at least 1.
    elevations_deg : sequence of float, default (0, 25)
        Degrees above the horizon.
    distances : sequence of float, default (2.5, 10, 40)
        In radii of the plant's bounding sphere.
    size : tuple of 2 ints, default (1024, 768)
        Width and height in pixels.

    Returns
    -------
    list of Camera
        By distance, then elevation, then azimuth.

    Raises
    ------
    ValueError
        If a number is out of range, or if there is no elevation or distance.
    """
    if not len(elevations_deg) or not len(distances):
        msg = "elevations_deg and distances must each hold at least one number"
        raise ValueError(msg)
    return [
        camera
        for distance in distances
        for elevation in elevations_deg
        for camera in orbit(plant, azimuth_count, elevation, distance, size)
    ]


def _vector(name: str, value: ArrayLike) -> Vector:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        msg = f"{name} must be 3 finite numbers, got {value!r}"
        raise ValueError(msg)
    return float(array[0]), float(array[1]), float(array[2])


def _size(value: Sequence[int]) -> tuple[int, int]:
    try:
        width, height = (operator.index(side) for side in value)
    except (TypeError, ValueError):
        msg = f"size must be (width, height) in whole pixels, got {value!r}"
        raise ValueError(msg) from None
    if not (1 <= width <= MAX_SIZE and 1 <= height <= MAX_SIZE):
        msg = f"size must be 1 to {MAX_SIZE} pixels each way, got {width} x {height}"
        raise ValueError(msg)
    return width, height


def _positive(name: str, value: float) -> float:
    number = float(value)
    if not 0.0 < number < math.inf:
        msg = f"{name} must be finite and above 0, got {number}"
        raise ValueError(msg)
    return number


def _default_near(eye: Sequence[float], target: Sequence[float]) -> float:
    # a distance of 0 is refused by the camera itself, with a better message than near's
    distance = math.dist(_vector("eye", eye), _vector("target", target))
    return NEAR_REL * distance if distance > 0.0 else NEAR_REL


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    # scaled first: squares of lengths near 1e200 overflow
    scaled: NDArray[np.float64] = vector / np.abs(vector).max()
    return scaled / np.linalg.norm(scaled)
