"""
The scene test: a camera goes around or through growing groves; techniques are timed and counted.

A grove is made of copies of one plant. Techniques that choose by the view choose for each copy by
itself, and remember what they chose from one frame to the next. A callable chooses a technique for
each copy by its distance, which is how engines switch between discrete levels.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pandas as pd

from treelod import _core
from treelod.cameras import Camera
from treelod.provenance import provenance
from treelod.render import (
    camera_facts,
    check_backend,
    opened_card,
    sample_count,
    thread_count,
)
from treelod.scenes import Scene, scatter
from treelod.techniques.technique import Technique

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from treelod.plants import Plant
    from treelod.provenance import Provenance

__all__ = ["Chooser", "Walk", "circle", "through", "walk", "worst_case_millis"]

Chooser = Callable[[float], Technique]
"""Gives a technique for a copy's distance: from the eye to the centre of its bounding sphere, in
radii of that sphere."""

KINDS = ("triangles", "cards", "lines", "points")
"""Primitives that are counted."""

WINDOW_FRAMES = 20
"""Frames that are averaged for the worst case (Jakulin 2000, section 3)."""

DROPPED_SHARE = 0.05
"""Share of the slowest windows that is left out of it: they are the operating system's."""

FEWEST_WINDOWS = 10
"""Of fewer windows a worst case means nothing; with one drawn in ten, 2600 frames give 13."""

EYE_HEIGHT = 0.22
"""Of the eye on a path through a grove, as a share of a tree's height: 1.7 m at a tree of 7.7 m."""

TURNS = 5
"""Times that a path through a grove goes around its middle."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk:
    """
    What a walk has measured.

    Attributes
    ----------
    plant : str
        Its name.
    table : pandas.DataFrame
        One row for each technique and number of trees: ``label``, ``tree_count``; ``primitives``
        (all kinds, mean over the frames), ``primitives_max`` (of one frame) and the means of
        ``triangles``, ``cards``, ``lines``, ``points``; ``frame_millis`` (median over the frames of
        each frame's median over the laps), ``frame_millis_low`` and ``frame_millis_high`` (the
        quickest and the slowest frame), ``emit_millis`` and ``draw_millis`` (medians alike);
        ``frame_millis_mean`` and ``frame_millis_worst``, the mean and `worst_case_millis` over the
        same frames (NaN where less than 10 windows of 20 frames are drawn); ``frames``, how many
        frames of a lap were drawn; ``gpu_millis``, what the graphics card says that it took itself,
        a median as ``frame_millis``; ``backend``, ``adapter`` and ``driver``, what drew. On the
        processor the card's three are null.
    settings : dict
        What the walk was asked for.
    made : Provenance
        By what, on what machine.
    """

    plant: str
    table: pd.DataFrame
    settings: dict[str, Any]
    made: Provenance


def circle(
    plant: Plant,
    transforms: NDArray[np.float64],
    frame_count: int = 36,
    *,
    distance: float = 2.5,
    elevation_deg: float = 10.0,
    size: tuple[int, int] = (512, 384),
    fov_y_deg: float = 45.0,
) -> list[Camera]:
    """
    Place cameras on a circle around a grove, all looking at its middle.

    Parameters
    ----------
    plant : Plant
        What stands there; its bounding sphere gives the unit of distance.
    transforms : ndarray of shape (N, 4, 4)
        Where the copies stand; N is at least 1.
    frame_count : int, default 36
        Cameras, at least 1.
    distance : float, default 2.5
        Of the circle from the grove, in radii of the plant's bounding sphere, above 0. The circle's
        radius is that, and the distance of the outermost copy's centre from the middle.
    elevation_deg : float, default 10
        Angle of the eye above the horizon in degrees, in [-90, 90].
    size : tuple of 2 ints, default (512, 384)
        Width and height in pixels.
    fov_y_deg : float, default 45
        Full vertical angle of view in degrees.

    Returns
    -------
    list of Camera
        By rising azimuth, from +z.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    if operator.index(frame_count) < 1:
        msg = f"frame_count must be at least 1, got {frame_count}"
        raise ValueError(msg)
    if not 0.0 < distance < math.inf:
        msg = f"distance must be above 0 and finite, got {distance}"
        raise ValueError(msg)
    if not -90.0 <= elevation_deg <= 90.0:
        msg = f"elevation_deg must be in [-90, 90], got {elevation_deg}"
        raise ValueError(msg)
    centers = _centers(plant, transforms)
    middle = centers.mean(axis=0)
    outermost = float(np.linalg.norm(centers - middle, axis=1).max())
    radius = outermost + distance * plant.sphere[1]
    elevation = math.radians(elevation_deg)
    cameras = []
    for azimuth in 2.0 * np.pi * np.arange(frame_count) / frame_count:
        away = np.array(
            [
                math.sin(azimuth) * math.cos(elevation),
                math.sin(elevation),
                math.cos(azimuth) * math.cos(elevation),
            ]
        )
        eye = tuple(float(x) for x in middle + radius * away)
        target = tuple(float(x) for x in middle)
        cameras.append(Camera.perspective(eye, target, fov_y_deg=fov_y_deg, size=size))
    return cameras


def through(
    plant: Plant,
    transforms: NDArray[np.float64],
    frame_count: int = 2600,
    *,
    size: tuple[int, int] = (640, 480),
    fov_y_deg: float = 45.0,
) -> list[Camera]:
    """
    Lead a camera through a grove, on a closed and smooth curve at the height of a walker's eyes.

    The curve goes around the middle five times while it swings out and back in three times, from a
    twentieth of the grove to its edge and one tree beyond. The camera looks ahead along it, so that
    trees come near, pass by and leave the picture; some of them stand in its way.

    Parameters
    ----------
    plant : Plant
        What stands there; its bounds give the height of the eye and the room around a tree.
    transforms : ndarray of shape (N, 4, 4)
        Where the copies stand; N is at least 1.
    frame_count : int, default 2600
        Cameras, at least 1: as many as in Jakulin (2000), whose path itself is not known.
    size : tuple of 2 ints, default (640, 480)
        Width and height in pixels.
    fov_y_deg : float, default 45
        Full vertical angle of view in degrees.

    Returns
    -------
    list of Camera

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    if operator.index(frame_count) < 1:
        msg = f"frame_count must be at least 1, got {frame_count}"
        raise ValueError(msg)
    centers = _centers(plant, transforms)
    middle = centers.mean(axis=0)
    outermost = float(np.linalg.norm((centers - middle)[:, [0, 2]], axis=1).max())
    low, high = (np.asarray(corner, np.float64) for corner in plant.bounds)
    reach = outermost + 2.5 * plant.sphere[1]
    height = low[1] + EYE_HEIGHT * (high[1] - low[1])

    def place(share: NDArray[np.float64]) -> NDArray[np.float64]:
        angle = 2.0 * np.pi * TURNS * share
        radius = reach * (0.525 - 0.475 * np.cos(2.0 * np.pi * 3.0 * share))
        x, z = middle[0] + radius * np.sin(angle), middle[2] + radius * np.cos(angle)
        return np.stack([x, np.full_like(x, height), z], axis=1)

    share = np.arange(frame_count) / frame_count
    # a chord ahead: a tangent alone would look the same, but a chord is defined for any curve
    eyes, ahead = place(share), place(share + 0.01)
    return [
        Camera.perspective(
            tuple(float(x) for x in eye),
            tuple(float(x) for x in target),
            fov_y_deg=fov_y_deg,
            size=size,
        )
        for eye, target in zip(eyes, ahead, strict=True)
    ]


def worst_case_millis(
    frame_millis: ArrayLike, window: int = WINDOW_FRAMES, dropped_share: float = DROPPED_SHARE
) -> float:
    """
    Return the worst time of a path as Jakulin (2000) defines it, robust against the system's noise.

    Frames are averaged over windows that follow one another, the windows are sorted, and the
    largest ``ceil(dropped_share * windows)`` are left out. The largest that is left is the figure:
    of 2600 frames there are 130 windows, and 7 are left out.

    Parameters
    ----------
    frame_millis : array_like of shape (N,)
        Times of the frames in their order, in milliseconds. A last window that is not full is not
        counted.
    window : int, default 20
        Frames of a window, at least 1.
    dropped_share : float, default 0.05
        In [0, 1).

    Returns
    -------
    float
        In milliseconds.

    Raises
    ------
    ValueError
        If no window is left, or an argument is out of range.

    Examples
    --------
    >>> worst_case_millis([1, 1, 5, 7, 2, 2, 90, 90], window=2, dropped_share=0.25)
    6.0
    """
    millis = np.asarray(frame_millis, np.float64)
    if millis.ndim != 1:
        msg = f"frame_millis must be one-dimensional, got shape {millis.shape}"
        raise ValueError(msg)
    if operator.index(window) < 1:
        msg = f"window must be at least 1, got {window}"
        raise ValueError(msg)
    if not 0.0 <= dropped_share < 1.0:
        msg = f"dropped_share must be in [0, 1), got {dropped_share}"
        raise ValueError(msg)
    count = len(millis) // window
    dropped = math.ceil(dropped_share * count)
    if dropped >= count:
        msg = f"frame_millis has {count} windows of {window} frames, of which none is left"
        raise ValueError(msg)
    means = np.sort(millis[: count * window].reshape(count, window).mean(axis=1))
    return float(means[count - 1 - dropped])


def walk(
    plant: Plant,
    subjects: Mapping[str, Technique | Chooser],
    *,
    tree_counts: Sequence[int] = (1, 2, 4, 8),
    spacing: float | None = None,
    path: Literal["circle", "through"] = "circle",
    frame_count: int | None = None,
    laps: int | None = None,
    every: Mapping[str, int] | None = None,
    distance: float = 2.5,
    elevation_deg: float = 10.0,
    size: tuple[int, int] | None = None,
    samples: int = 4,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[str, int, int], object] | None = None,
    backend: str = "cpu",
    adapter: str | None = None,
) -> Walk:
    """
    Go around or through growing groves of a plant, and count and time what each technique draws.

    At each camera the techniques take turns, which spreads whatever else the machine does over all
    of them. Each has a memory of its own, which lasts for all frames of a grove. A first lap (of a
    path through a grove its first 20 frames) is not counted.

    Parameters
    ----------
    plant : Plant
        What the techniques stand for.
    subjects : mapping of str to (Technique or callable)
        By label. A callable takes the distance of a copy, in radii of its bounding sphere, and
        returns the technique to draw it with; its own time is not counted.
    tree_counts : sequence of int, default (1, 2, 4, 8)
        Copies in each grove, rising, each at least 1.
    spacing : float, optional
        About how far neighbours are apart in metres; see `scatter`. Default: 1.5 radii of the
        plant's bounding sphere.
    path : {"circle", "through"}, default "circle"
        Where the camera goes: see `circle` and `through`.
    frame_count : int, optional
        Frames of a lap. Default: 36 around, 2600 through.
    laps : int, optional
        Laps that are counted, at least 1. Default: 3 around, 1 through.
    every : mapping of str to int, optional
        By label: only every so many windows of 20 frames are drawn, the first one among them, which
        spares time where a technique is slow. Default: all windows.
    distance, elevation_deg
        As in `circle`; not used through a grove.
    size : tuple of 2 ints, optional
        Width and height in pixels. Default: (512, 384) around, (640, 480) through.
    samples : int, default 4
        Samples a pixel, as in `treelod.render`.
    seed : int, default 0
        Of the grove.
    threads : int, optional
        Threads that draw. Default: ``TREELOD_NUM_THREADS``, else all cores.
    progress : callable, optional
        Called as ``progress("walking", done, total)`` with frames.
    backend : {'cpu', 'gpu'}, default 'cpu'
        What draws: the processor, or a graphics card.
    adapter : str, optional
        Which graphics card, with ``backend="gpu"``, as in `treelod.render`.

    Returns
    -------
    Walk

    Raises
    ------
    ValueError
        If an argument is out of range, or if there is no subject.
    TypeError
        If a subject is neither, or a callable returns no technique.
    NoAdapterError, DeviceError
        As in `treelod.render`.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> far = tl.SimplifiedMesh.build(plant, keep_fraction=0.2)
    >>> mesh = tl.FullMesh.build(plant)
    >>> levels = lambda distance: mesh if distance < 4 else far
    >>> found = tl.walks.walk(
    ...     plant, {"mesh": mesh, "levels": levels}, tree_counts=(1, 3), frame_count=4, laps=1,
    ...     size=(64, 48),
    ... )
    >>> found.table["tree_count"].tolist()
    [1, 1, 3, 3]
    """
    if not subjects:
        msg = "subjects must name at least one technique"
        raise ValueError(msg)
    for label, subject in subjects.items():
        if not isinstance(subject, Technique) and not callable(subject):
            msg = f"subjects: {label!r} is no technique and no callable: {type(subject).__name__}"
            raise TypeError(msg)
    counts = [operator.index(count) for count in tree_counts]
    if not counts or counts[0] < 1 or any(b <= a for a, b in itertools.pairwise(counts)):
        msg = f"tree_counts must rise from at least 1, got {list(tree_counts)}"
        raise ValueError(msg)
    if path not in _DEFAULTS:
        msg = f"path must be 'circle' or 'through', got {path!r}"
        raise ValueError(msg)
    default = _DEFAULTS[path]
    frame_count = default.frame_count if frame_count is None else operator.index(frame_count)
    laps = default.laps if laps is None else operator.index(laps)
    size = default.size if size is None else size
    if laps < 1:
        msg = f"laps must be at least 1, got {laps}"
        raise ValueError(msg)
    strides = _strides(subjects, every or {})
    samples, threads = sample_count(samples), thread_count(threads)
    check_backend(backend, adapter)
    if backend == "gpu":
        opened_card(adapter)
    center, radius = plant.sphere
    if spacing is None:
        spacing = 1.5 * radius
    grove = scatter(counts[-1], spacing, seed=seed, about=[float(x) for x in center])
    rows = []
    total = len(counts) * (laps * frame_count + min(default.warmup or frame_count, frame_count))
    done = 0
    for count in counts:
        transforms = grove[:count]
        if path == "circle":
            cameras = circle(
                plant,
                transforms,
                frame_count,
                distance=distance,
                elevation_deg=elevation_deg,
                size=size,
            )
        else:
            cameras = through(plant, transforms, frame_count, size=size)
        centers = _centers(plant, transforms)
        # made ahead: no Python is timed
        scenes = {
            label: _scenes(label, subject, transforms, centers, radius, cameras)
            for label, subject in subjects.items()
        }
        renderers = {label: _core.Renderer() for label in subjects}
        stats: dict[str, list[list[dict[str, Any]]]] = {label: [] for label in subjects}
        for lap in range(-1, laps):
            for of_lap in stats.values():
                of_lap.append([])
            for index, camera in enumerate(cameras if lap >= 0 else cameras[: default.warmup]):
                facts = camera_facts(camera)
                for label, renderer in renderers.items():
                    if index // WINDOW_FRAMES % strides[label]:
                        continue
                    scene = scenes[label][index]
                    found = renderer.time(
                        scene._core,
                        facts,
                        samples=samples,
                        threads=threads,
                        backend=backend,
                        adapter=adapter,
                    )
                    stats[label][lap + 1].append(found)
                done += 1
                if progress is not None:
                    progress("walking", done, total)
        rows += [_row(label, count, of_label[1:]) for label, of_label in stats.items()]
    settings = {
        "tree_counts": counts,
        "spacing": float(spacing),
        "path": path,
        "frame_count": frame_count,
        "laps": laps,
        "every": {label: stride for label, stride in strides.items() if stride > 1},
        "distance": float(distance),
        "elevation_deg": float(elevation_deg),
        "size": tuple(size),
        "samples": samples,
        "seed": seed,
        "threads": int(found["threads"]),
        # as the frames say, and not as they were asked for
        **{name: found[name] for name in ("backend", "adapter", "driver")},
    }
    table = pd.DataFrame(rows).assign(
        **{name: settings[name] for name in ("backend", "adapter", "driver")}
    )
    # of their type also where all are null, so that files can be joined
    table = table.astype({"adapter": "string", "driver": "string"})
    return Walk(plant=plant.name, table=table, settings=settings, made=provenance())


@dataclass(frozen=True, kw_only=True)
class _Defaults:
    """What a path takes where nothing is asked; `warmup` frames are drawn first, None for a lap."""

    frame_count: int
    laps: int
    size: tuple[int, int]
    warmup: int | None


_DEFAULTS = {
    "circle": _Defaults(frame_count=36, laps=3, size=(512, 384), warmup=None),
    "through": _Defaults(frame_count=2600, laps=1, size=(640, 480), warmup=WINDOW_FRAMES),
}


def _strides(subjects: Mapping[str, object], every: Mapping[str, int]) -> dict[str, int]:
    """Of how many windows one is drawn, by label."""
    for label, stride in every.items():
        if label not in subjects:
            msg = f"every names {label!r}, which is none of the subjects: {', '.join(subjects)}"
            raise ValueError(msg)
        if operator.index(stride) < 1:
            msg = f"every: {label!r} must be at least 1, got {stride}"
            raise ValueError(msg)
    return {label: operator.index(every.get(label, 1)) for label in subjects}


def _centers(plant: Plant, transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the copies' bounding spheres have their centres, shape (N, 3)."""
    center = np.append(np.asarray(plant.sphere[0], np.float64), 1.0)
    return np.asarray(transforms[:, :3] @ center)


def _scenes(
    label: str,
    subject: Technique | Chooser,
    transforms: NDArray[np.float64],
    centers: NDArray[np.float64],
    radius: float,
    cameras: Sequence[Camera],
) -> list[Scene]:
    """One scene a camera; the same one for all where nothing is chosen by distance."""
    if isinstance(subject, Technique):
        return [Scene([(subject, transforms)])] * len(cameras)
    scenes = []
    for camera in cameras:
        groups: dict[int, tuple[Technique, list[int]]] = {}
        for index, away in enumerate(np.linalg.norm(centers - camera.eye, axis=1)):
            chosen = subject(float(away / radius))
            if not isinstance(chosen, Technique):
                msg = f"subjects: {label!r} must return a technique, got {type(chosen).__name__}"
                raise TypeError(msg)
            groups.setdefault(id(chosen), (chosen, []))[1].append(index)
        scenes.append(Scene([(chosen, transforms[rows]) for chosen, rows in groups.values()]))
    return scenes


def _row(label: str, tree_count: int, laps: list[list[dict[str, Any]]]) -> dict[str, Any]:
    def of(kind: str) -> NDArray[np.float64]:
        # null where the processor draws becomes NaN
        return np.array([[frame[kind] for frame in lap] for lap in laps], dtype=np.float64)

    counts = {kind: of(kind)[0] for kind in KINDS}
    primitives = np.sum(list(counts.values()), axis=0)
    emit, draw = of("emit_millis"), of("draw_millis")
    millis = np.median(emit + draw, axis=0)
    windows = len(millis) // WINDOW_FRAMES
    worst = worst_case_millis(millis) if windows >= FEWEST_WINDOWS else math.nan
    return {
        "label": label,
        "tree_count": tree_count,
        "frames": len(millis),
        "primitives": float(primitives.mean()),
        "primitives_max": int(primitives.max()),
        **{kind: float(count.mean()) for kind, count in counts.items()},
        "frame_millis": float(np.median(millis)),
        "frame_millis_low": float(millis.min()),
        "frame_millis_high": float(millis.max()),
        "frame_millis_mean": float(millis.mean()),
        "frame_millis_worst": worst,
        "emit_millis": float(np.median(np.median(emit, axis=0))),
        "draw_millis": float(np.median(np.median(draw, axis=0))),
        "gpu_millis": float(np.median(np.median(of("gpu_millis"), axis=0))),
    }
