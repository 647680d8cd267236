"""
The scene test: a camera circles growing groves, and techniques are timed and counted on the way.

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
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from treelod import _core
from treelod.cameras import Camera
from treelod.provenance import provenance
from treelod.render import camera_facts, sample_count, thread_count
from treelod.scenes import Scene, scatter
from treelod.techniques.technique import Technique

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.plants import Plant
    from treelod.provenance import Provenance

__all__ = ["Chooser", "Walk", "circle", "walk"]

Chooser = Callable[[float], Technique]
"""Gives a technique for a copy's distance: from the eye to the centre of its bounding sphere, in
radii of that sphere."""

KINDS = ("triangles", "cards", "lines", "points")
"""Primitives that are counted."""


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
        quickest and the slowest frame), ``emit_millis`` and ``draw_millis`` (medians alike).
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


def walk(
    plant: Plant,
    subjects: Mapping[str, Technique | Chooser],
    *,
    tree_counts: Sequence[int] = (1, 2, 4, 8),
    spacing: float | None = None,
    frame_count: int = 36,
    laps: int = 3,
    distance: float = 2.5,
    elevation_deg: float = 10.0,
    size: tuple[int, int] = (512, 384),
    samples: int = 4,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[str, int, int], object] | None = None,
) -> Walk:
    """
    Circle growing groves of a plant, and count and time what each technique draws.

    At each camera the techniques take turns, which spreads whatever else the machine does over all
    of them. Each has a memory of its own, which lasts for all frames of a grove. A first lap is not
    counted.

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
    frame_count : int, default 36
        Frames of a lap.
    laps : int, default 3
        Laps that are counted, at least 1.
    distance, elevation_deg, size
        As in `circle`.
    samples : int, default 4
        Samples a pixel, as in `treelod.render`.
    seed : int, default 0
        Of the grove.
    threads : int, optional
        Threads that draw. Default: ``TREELOD_NUM_THREADS``, else all cores.
    progress : callable, optional
        Called as ``progress("walking", done, total)`` with frames.

    Returns
    -------
    Walk

    Raises
    ------
    ValueError
        If an argument is out of range, or if there is no subject.
    TypeError
        If a subject is neither, or a callable returns no technique.

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
    if operator.index(laps) < 1:
        msg = f"laps must be at least 1, got {laps}"
        raise ValueError(msg)
    samples, threads = sample_count(samples), thread_count(threads)
    center, radius = plant.sphere
    if spacing is None:
        spacing = 1.5 * radius
    grove = scatter(counts[-1], spacing, seed=seed, about=[float(x) for x in center])
    rows = []
    total = len(counts) * (laps + 1) * operator.index(frame_count)
    done = 0
    for count in counts:
        transforms = grove[:count]
        cameras = circle(
            plant,
            transforms,
            frame_count,
            distance=distance,
            elevation_deg=elevation_deg,
            size=size,
        )
        centers = _centers(plant, transforms)
        # made ahead: no Python is timed
        scenes = {
            label: _scenes(label, subject, transforms, centers, radius, cameras)
            for label, subject in subjects.items()
        }
        renderers = {label: _core.Renderer() for label in subjects}
        stats: dict[str, list[list[dict[str, float]]]] = {label: [] for label in subjects}
        for lap in range(-1, laps):
            for of_lap in stats.values():
                of_lap.append([])
            for index, camera in enumerate(cameras):
                facts = camera_facts(camera)
                for label, renderer in renderers.items():
                    scene = scenes[label][index]
                    found = renderer.time(scene._core, facts, samples=samples, threads=threads)
                    stats[label][lap + 1].append(found)
                done += 1
                if progress is not None:
                    progress("walking", done, total)
        rows += [_row(label, count, of_label[1:]) for label, of_label in stats.items()]
    settings = {
        "tree_counts": counts,
        "spacing": float(spacing),
        "frame_count": frame_count,
        "laps": laps,
        "distance": float(distance),
        "elevation_deg": float(elevation_deg),
        "size": tuple(size),
        "samples": samples,
        "seed": seed,
        "threads": int(found["threads"]),
    }
    return Walk(plant=plant.name, table=pd.DataFrame(rows), settings=settings, made=provenance())


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


def _row(label: str, tree_count: int, laps: list[list[dict[str, float]]]) -> dict[str, Any]:
    def of(kind: str) -> NDArray[np.float64]:
        return np.array([[frame[kind] for frame in lap] for lap in laps])

    counts = {kind: of(kind)[0] for kind in KINDS}
    primitives = np.sum(list(counts.values()), axis=0)
    emit, draw = of("emit_millis"), of("draw_millis")
    millis = np.median(emit + draw, axis=0)
    return {
        "label": label,
        "tree_count": tree_count,
        "primitives": float(primitives.mean()),
        "primitives_max": int(primitives.max()),
        **{kind: float(count.mean()) for kind, count in counts.items()},
        "frame_millis": float(np.median(millis)),
        "frame_millis_low": float(millis.min()),
        "frame_millis_high": float(millis.max()),
        "emit_millis": float(np.median(np.median(emit, axis=0))),
        "draw_millis": float(np.median(np.median(draw, axis=0))),
    }
