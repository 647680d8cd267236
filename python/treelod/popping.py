"""
Where a technique switches on a camera's way, and how much of that the eye sees.

Between two cameras that are a hair apart a picture changes by next to nothing, unless what is
drawn changes in a jump: another level, other cards, another order. So a path is walked in steps,
each step whose ends draw different things is halved until its ends are as good as the same camera,
and the error between the pictures of the two ends is that of the switch alone.
"""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from treelod import _core, metrics
from treelod.cameras import Camera
from treelod.render import camera_facts, render, sample_count, thread_count
from treelod.results import View
from treelod.scenes import Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.plants import Plant
    from treelod.techniques.technique import Technique

__all__ = ["MOTION_TOLERANCE_PX", "switches"]

MOTION_TOLERANCE_PX = 1e-4
"""Motion of any corner of the subject's box between the two sides of a switch, in pixels, at most.

A vertex is placed to 1/256 of a pixel, so of 40 vertices one moves, by that much.
"""

_HAIR_PX = MOTION_TOLERANCE_PX / 4.0
"""Of one halved step, so that two and the gap between them are still within the tolerance."""

Signature = tuple[tuple[str, int, int], ...]

_COLUMNS = (
    "label", "path", "distance", "azimuth_deg", "elevation_deg", "flip", "coverage_bias",
    "motion_px", "what", "complete", "changed_steps",
)  # fmt: skip


def switches(
    subject: Technique | Scene,
    cameras: Sequence[Camera],
    *,
    plant: Plant | None = None,
    label: str | None = None,
    step_count: int = 32,
    max_switches: int = 64,
    samples: int = 64,
    ppd: float = metrics.DEFAULT_PPD,
    threads: int | None = None,
) -> pd.DataFrame:
    """
    Find where what is drawn changes in a jump along a path, and measure how much of it is seen.

    Parameters
    ----------
    subject : Technique or Scene
        What is looked at.
    cameras : sequence of Camera
        At least two, of one size and kind. The path leads from each to the next: eye, target, up,
        angle or height, and near plane move in straight lines.
    plant : Plant, optional
        Whose sphere distances are told in, and around which azimuths are. Default: the ball around
        the box of what is drawn, which is larger than the plant's sphere.
    label : str, optional
        Names the subject in the table and in plots. Default: the technique's name, or "scene".
    step_count : int, default 32
        Steps between two neighbouring cameras, at least 1. What changes and changes back within a
        step is not found.
    max_switches : int, default 64
        Switches that are measured, at least 1. Of more, one in each step is, then another, and so
        on; of more steps than that, those evenly between the first and the last.
    samples : int, default 64
        Samples a pixel of the two pictures, as in `treelod.render`.
    ppd : float, default 67.02
        Pixels a degree of sight, for FLIP.
    threads : int, optional
        As in `treelod.render`.

    Returns
    -------
    pandas.DataFrame
        A row a switch, in the order of the path. ``path`` is how far along it is: 1.5 is half way
        between the second camera and the third. ``distance`` (radii), ``azimuth_deg`` and
        ``elevation_deg`` say where the eye is. ``flip`` and ``coverage_bias`` are those of the far
        side against the near one, as in `metrics.popping`; ``motion_px`` is how far the two
        cameras' pictures are apart. ``what`` says which primitives come and go, or that their order
        does. ``complete`` says whether every switch found is in the table, and ``changed_steps``
        how many steps of the path have any, the same in all rows, so that tables can be joined.
        ``attrs`` holds both, also of a table without rows, and "step_count" of the whole path.

    Raises
    ------
    TypeError
        If a camera is none.
    ValueError
        If there are fewer than two cameras, if they differ in size or kind, if an argument is out
        of range, or if the technique was built for other cameras.

    Notes
    -----
    What is drawn is told by primitives, buffers, textures, blending and order. Fades, tints and
    transforms are not looked at, so a change that is faded in is a switch whose error is next to 0.
    Of scenes, which copy of a plant comes first in the order is not looked at.

    Examples
    --------
    Of four slicings, two change places half way between their directions, at 45 degrees around
    the crown's own centre, which is not quite the plant's:

    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> lod = tl.Slicings.build(plant, slicing_count=4, slice_count=3, resolution=32)
    >>> way = tl.orbit(plant, count=24, size=(64, 64))[1:6]
    >>> found = tl.switches(lod, way, plant=plant, samples=4)
    >>> found["azimuth_deg"].round(1).tolist(), found["what"].tolist()
    ([45.8], ['paint order'])
    """
    path = _Path(cameras)
    for name, value in (("step_count", step_count), ("max_switches", max_switches)):
        if operator.index(value) < 1:
            msg = f"{name} must be at least 1, got {value}"
            raise ValueError(msg)
    sample_count(samples)
    thread_count(threads)
    metrics.check_ppd(ppd)
    scene = subject if isinstance(subject, Scene) else Scene([(subject, None)])
    if label is None:
        label = "scene" if isinstance(subject, Scene) else subject.name
    walker = _Walker(scene, path)
    places = np.linspace(0.0, path.length, step_count * int(path.length) + 1)
    signatures = [walker.signature(float(place)) for place in places]
    found, complete, changed = _all_switches(walker, places, signatures, max_switches)
    rows = []
    for near, far in found:
        before, after = (
            render(scene, path.at(side.place), samples=samples, outputs=("color",), threads=threads)
            for side in (near, far)
        )
        # a hair apart, which `motion_px` tells: as good as one camera
        errors = metrics.compare(before, replace(after, camera=before.camera), ppd=ppd)
        view = View.of(plant or _Ball.of(scene), 0, path.at(near.place))  # type: ignore[arg-type]
        rows.append(
            {
                "label": label,
                "path": near.place,
                "distance": view.distance,
                "azimuth_deg": view.azimuth_deg,
                "elevation_deg": view.elevation_deg,
                "flip": errors.flip,
                "coverage_bias": errors.coverage_bias,
                "motion_px": walker.motion_px(near.place, far.place),
                "what": _difference(near.signature, far.signature),
                "complete": complete,
                "changed_steps": changed,
            }
        )
    table = pd.DataFrame(rows, columns=list(_COLUMNS))
    others = {"label": "object", "what": "object", "complete": "bool", "changed_steps": "int64"}
    table = table.astype({name: others.get(name, "float64") for name in _COLUMNS})
    table.attrs = {"complete": complete, "changed_steps": changed, "step_count": len(places) - 1}
    return table


@dataclass(frozen=True)
class _Side:
    place: float
    signature: Signature


@dataclass(frozen=True)
class _Ball:
    """Stands for a plant where only its sphere is asked for."""

    sphere: tuple[NDArray[np.float64], float]

    @classmethod
    def of(cls, scene: Scene) -> _Ball:
        bounds = scene._core.bounds
        low, high = np.array(bounds if bounds is not None else ([0.0] * 3, [0.0] * 3))
        return cls(((low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0))


class _Path:
    """Cameras with straight ways between them; place 1.5 is half way from number 1 to number 2."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self.cameras = list(cameras)
        if len(self.cameras) < 2:
            msg = f"cameras must hold at least two, got {len(self.cameras)}"
            raise ValueError(msg)
        for camera in self.cameras:
            if not isinstance(camera, Camera):
                msg = f"cameras must hold Cameras, got {type(camera).__name__}"
                raise TypeError(msg)
        for a, b in pairwise(self.cameras):
            if a.size != b.size or a.is_perspective != b.is_perspective:
                msg = "cameras must be of one size, and all with perspective or all without"
                raise ValueError(msg)
        self.length = float(len(self.cameras) - 1)

    def at(self, place: float) -> Camera:
        """Return the camera at a place in [0, length]."""
        number = min(int(place), len(self.cameras) - 2)
        share = place - number
        a, b = self.cameras[number], self.cameras[number + 1]

        def mixed(name: str) -> Any:
            first, second = getattr(a, name), getattr(b, name)
            if first is None:
                return None
            values = np.multiply(first, 1.0 - share) + np.multiply(second, share)
            return tuple(values) if values.ndim else float(values)

        names = ("eye", "target", "up", "fov_y_deg", "height", "near")
        return replace(a, **{name: mixed(name) for name in names})


class _Walker:
    """Tells what is drawn at places on a path."""

    def __init__(self, scene: Scene, path: _Path) -> None:
        self.scene, self.path = scene, path
        self.renderer = _core.Renderer()
        low, high = scene._core.bounds or ([0.0] * 3, [0.0] * 3)
        axes = list(zip(low, high, strict=True))
        self.corners = np.array(np.meshgrid(*axes)).reshape(3, -1).T

    def signature(self, place: float) -> Signature:
        facts = camera_facts(self.path.at(place))
        return tuple(self.renderer.signature(self.scene._core, facts))

    def motion_px(self, a: float, b: float) -> float:
        """Largest motion of a corner of the box that both cameras see, in pixels."""
        first, second = (self.path.at(place).project(self.corners)[:, :2] for place in (a, b))
        moved = np.linalg.norm(second - first, axis=1)
        moved = moved[np.isfinite(moved)]
        return float(moved.max()) if len(moved) else 0.0

    def first_switch(self, near: _Side, far: _Side) -> tuple[_Side, _Side]:
        """Halve a step whose ends differ until they are a hair apart."""
        while self.motion_px(near.place, far.place) > _HAIR_PX:
            middle = (near.place + far.place) / 2.0
            # far from the origin a hair may be finer than numbers are
            if not near.place < middle < far.place:
                break
            signature = self.signature(middle)
            if signature == near.signature:
                near = _Side(middle, signature)
            else:
                far = _Side(middle, signature)
        return near, far


def _all_switches(
    walker: _Walker,
    places: NDArray[np.float64],
    signatures: Sequence[Signature],
    most: int,
) -> tuple[list[tuple[_Side, _Side]], bool, int]:
    """Switches in the order of the path; whether those are all; how many steps have any."""
    sides = [_Side(float(place), sig) for place, sig in zip(places, signatures, strict=True)]
    steps = [(a, b) for a, b in pairwise(sides) if a.signature != b.signature]
    changed, complete = len(steps), len(steps) <= most
    if not complete:
        picks = np.unique(np.linspace(0, len(steps) - 1, most).round().astype(int))
        steps = [steps[pick] for pick in picks]
    found: list[tuple[_Side, _Side]] = []
    # one in each step, then another in those that still have one
    while steps and len(found) < most:
        rest = []
        for number, (near, far) in enumerate(steps):
            if len(found) == most:
                rest += steps[number:]
                break
            switch = walker.first_switch(near, far)
            found.append(switch)
            if switch[1].signature != far.signature:
                rest.append((switch[1], far))
        steps = rest
    found.sort(key=lambda switch: switch[0].place)
    return _merged(walker, found), complete and not steps, changed


def _merged(walker: _Walker, found: Sequence[tuple[_Side, _Side]]) -> list[tuple[_Side, _Side]]:
    """Join switches that are a hair apart: what is drawn in between is never seen."""
    merged: list[tuple[_Side, _Side]] = []
    for near, far in found:
        if merged and (
            walker.motion_px(merged[-1][1].place, near.place) <= _HAIR_PX
            and merged[-1][1].signature == near.signature
        ):
            near, _ = merged.pop()
            if near.signature == far.signature:
                continue
        merged.append((near, far))
    return merged


def _difference(before: Signature, after: Signature) -> str:
    """Say what comes and goes between two lists."""
    counts = [Counter[str](), Counter[str]()]
    for count, signature in zip(counts, (before, after), strict=True):
        for kind, primitives, _ in signature:
            count[kind] += primitives
    kinds = [
        kind for kind in ("triangles", "cards", "lines", "points") if any(c[kind] for c in counts)
    ]
    changed = [
        f"{kind} {counts[0][kind]} to {counts[1][kind]}"
        for kind in kinds
        if counts[0][kind] != counts[1][kind]
    ]
    if changed:
        return ", ".join(changed)
    if sorted(before) == sorted(after):
        return "paint order"
    others = Counter(before)
    others.subtract(Counter(after))
    kinds = sorted({item[0] for item, times in others.items() if times > 0})
    return f"other {' and '.join(kinds)}" if kinds else "paint order"
