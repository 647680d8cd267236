"""
Which technique costs how much and looks how wrong: every technique, from every camera.

The truth is the full mesh at many samples a pixel. Errors and times come from different frames: a
technique's *error frame* has as many samples as the truth, so its error is the technique's and not
the sampling's; its *time frames* have the few samples that an application would use. The full mesh
at those few samples is a row of its own, whose error is aliasing alone.

A graphics card may draw the time frames. Truth and error frames are always the processor's, so
errors do not depend on the card.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod import metrics
from treelod.cameras import Camera, default_cameras, orbit
from treelod.color import composite, linear_from_srgb, quantize, srgb_from_linear
from treelod.plants import Plant
from treelod.provenance import provenance
from treelod.render import (
    check_backend,
    check_size,
    frame_times,
    opened_card,
    render,
    sample_count,
    thread_count,
)
from treelod.results import Bake, Comparison, Picture, Row, View
from treelod.techniques import REGISTRY, FullMesh, Technique

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.render import Frame, Times

__all__ = [
    "Progress",
    "compare_techniques",
    "error_frames",
    "tinted",
]

Progress = Callable[[str, int, int], None]
"""Called with the name of a stage, how many steps of it are done, and how many there are."""

WOOD_TINT = (213, 94, 0)
"""sRGB of wood in the picture that shows the split; told apart from foliage by the colour-blind."""

FOLIAGE_TINT = (0, 158, 115)
"""sRGB of foliage in the picture that shows the split."""

PORTRAIT_PX = 480
"""Side of the plant's own pictures."""


def compare_techniques(
    plant: Plant,
    techniques: Mapping[str, Mapping[str, Any] | Technique],
    cameras: Sequence[Camera] | None = None,
    *,
    samples: int = 4,
    reference_samples: int = 64,
    repeats: int = 9,
    warmup: int = 2,
    threads: int | None = None,
    ppd: float = metrics.DEFAULT_PPD,
    yee: bool = False,
    source: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    backend: str = "cpu",
    adapter: str | None = None,
) -> Comparison:
    """
    Build techniques for a plant, draw them from every camera, and measure errors and times.

    Parameters
    ----------
    plant : Plant
        The plant.
    techniques : mapping of str to (mapping or Technique)
        What to compare, by label: the parameters to build it with, or a built technique. With
        parameters, the label up to its first colon is the technique's name in
        `techniques.REGISTRY`; the rest is free, so ``{"slicings:few": {"slice_count": 3},
        "slicings:many": {"slice_count": 7}}`` compares two slicings. The full mesh is always
        compared and need not be named.
    cameras : sequence of Camera, optional
        Default: `default_cameras`.
    samples : int, default 4
        Samples a pixel of the frames that are timed.
    reference_samples : int, default 64
        Samples a pixel of the reference and of the frames that are measured.
    repeats : int, default 9
        Timed frames for each technique and camera, interleaved between the techniques.
    warmup : int, default 2
        Frames drawn before those, not counted.
    threads : int, optional
        Threads that draw. Default: all.
    ppd : float, default 67.02
        Pixels a degree of sight, for FLIP.
    yee : bool, default False
        Whether to measure Yee's metric too, which takes seconds a frame.
    source : mapping of str to object, optional
        Where the plant came from, stored with every row: ``sha256`` and ``seed`` become columns.
    progress : callable, optional
        Called with the stage ("building", "baking LABEL", "reference frames", "error frames" or
        "timing"), how many of its steps are done, and how many there are.
    backend : {'cpu', 'gpu'}, default 'cpu'
        What draws the frames that are timed: the processor, or a graphics card. Errors, and the
        counts of what is drawn, are the processor's with either.
    adapter : str, optional
        Which graphics card, with ``backend="gpu"``, as in `render`.

    Returns
    -------
    Comparison
        One row a technique and camera.

    Raises
    ------
    ValueError
        If a technique is unknown, a parameter is out of range, or there is no camera.
    TypeError
        If a technique has no such parameter.
    NoAdapterError
        If there is no graphics card of that name, or none at all; before anything is built.
    DeviceError
        If the graphics card was lost, ran out of memory or refused a command.
    """
    report = progress or (lambda _stage, _done, _total: None)
    views = [View.of(plant, i, c) for i, c in enumerate(_checked(plant, cameras))]
    if repeats < 1 or warmup < 0:
        msg = f"repeats must be at least 1 and warmup at least 0, got {repeats} and {warmup}"
        raise ValueError(msg)
    # before anything is baked
    sample_count(samples)
    sample_count(reference_samples)
    thread_count(threads)
    metrics.check_ppd(ppd)
    for view in views:
        check_size(view.camera.size)
    check_backend(backend, adapter)
    if backend == "gpu":
        opened_card(adapter)
    built = _build(plant, techniques, report, threads)
    full = built[FullMesh.name]
    keep = _kept_views(views)

    measured: dict[tuple[str, int], tuple[metrics.Errors, int, Any]] = {}
    pictures: dict[tuple[str, str], tuple[int, metrics.Errors, dict[str, Any]]] = {}
    error_frame_count = (len(built) - 1) * len(views)
    for view in views:
        truth = render(full, view.camera, samples=reference_samples, threads=threads)
        report("reference frames", view.index + 1, len(views))
        for position, (label, technique) in enumerate(built.items()):
            quick, frame, frame_samples = error_frames(
                technique,
                view.camera,
                samples=samples,
                # the yardstick's error is aliasing alone
                reference_samples=samples if technique is full else reference_samples,
                threads=threads,
            )
            errors = metrics.compare(truth, frame, ppd=ppd, yee=yee)
            measured[label, view.index] = errors, frame_samples, quick.stats
            reasons = [why for why, index in keep.items() if index == view.index]
            worst = pictures.get((label, "worst"))
            if worst is None or errors.flip > worst[1].flip:
                reasons.append("worst")
            if reasons:
                drawn = _drawn(truth, frame, errors)
                for why in reasons:
                    pictures[label, why] = view.index, errors, drawn
            if technique is not full:
                done = view.index * (len(built) - 1) + position
                report("error frames", done, error_frame_count)
        del truth

    times: dict[tuple[str, int], Times] = {}
    for view in views:
        found = frame_times(
            built,
            view.camera,
            samples=samples,
            warmup=warmup,
            repeats=repeats,
            threads=threads,
            backend=backend,
            adapter=adapter,
        )
        times |= {(label, view.index): of_label for label, of_label in found.items()}
        report("timing", view.index + 1, len(views))

    rows = {
        (label, view.index): Row(
            label=label,
            view=view,
            errors=measured[label, view.index][0],
            error_samples=measured[label, view.index][1],
            frame_millis=times[label, view.index].frame_millis,
            stats=measured[label, view.index][2],
            gpu_millis=times[label, view.index].gpu_millis,
        )
        for label in built
        for view in views
    }
    portrait, split_portrait = _portraits(plant, full, threads)
    drawn_threads = next(iter(rows.values())).stats.threads
    timed = next(iter(times.values()))
    return Comparison(
        plant=_facts(plant),
        portrait=portrait,
        split_portrait=split_portrait,
        reference_label=FullMesh.name,
        bakes=[
            Bake(
                label=label,
                technique=technique.name,
                params=dict(technique.params),
                build_secs=technique.build_secs,
                footprint=technique.footprint,
            )
            for label, technique in built.items()
        ],
        views=views,
        rows=list(rows.values()),
        pictures=[
            Picture(row=rows[label, index], why=why, **drawn)
            for (label, why), (index, _, drawn) in pictures.items()
        ],
        settings={
            "time_samples": samples,
            "reference_samples": reference_samples,
            "repeats": repeats,
            "warmup": warmup,
            "threads": drawn_threads,
            "ppd": ppd,
            "backend": backend,
            "adapter": timed.adapter,
            "driver": timed.driver,
        },
        source=dict(source or {}),
        provenance=provenance(),
    )


def error_frames(
    technique: Technique,
    camera: Camera,
    *,
    samples: int,
    reference_samples: int,
    threads: int | None,
) -> tuple[Frame, Frame, int]:
    """
    Draw a frame as it is timed, and the one whose error is the technique's, on the processor.

    Parameters
    ----------
    technique : Technique
        What to draw.
    camera : Camera
        From where.
    samples : int
        Samples a pixel of frames that are timed.
    reference_samples : int
        Samples a pixel of the frame that is measured. If it equals `samples`, one frame is both.
    threads : int or None
        Threads that draw.

    Returns
    -------
    quick, frame : Frame
        As it is timed, and as it is measured.
    error_samples : int
        Samples a pixel of the latter.
    """
    quick = render(technique, camera, samples=samples, threads=threads)
    if reference_samples == samples:
        return quick, quick, samples
    frame = render(technique, camera, samples=reference_samples, threads=threads)
    return quick, frame, reference_samples


def tinted(plant: Plant) -> Plant:
    """
    Return a plant whose wood is orange and whose foliage is green, to show how it was split.

    Parameters
    ----------
    plant : Plant
        Any plant.

    Returns
    -------
    Plant
        The same shapes, transparency and light; textures keep their alpha and lose their colour.
    """
    materials = []
    for material in plant.materials:
        texture = material.texture
        if texture is not None:
            texture = texture.copy()
            texture[..., :3] = 255
        materials.append(replace(material, texture=texture))
    parts = {}
    for name, mesh, tint in (
        ("wood", plant.wood, WOOD_TINT),
        ("foliage", plant.foliage.mesh, FOLIAGE_TINT),
    ):
        colors = mesh.base.copy()
        colors[:, :3] = linear_from_srgb(np.asarray(tint) / 255.0)
        parts[name] = {
            "positions": mesh.positions,
            "triangles": mesh.triangles,
            "normals": mesh.normals,
            "uvs": mesh.uvs,
            "colors": colors,
            "material_ids": mesh.material_ids,
        }
    x, y, z = (float(value) for value in plant.origin)
    return Plant.from_arrays(
        wood=parts["wood"],
        foliage=parts["foliage"],
        leaf_offsets=plant.foliage.leaf_offsets,
        materials=materials,
        name=plant.name,
        origin=(x, y, z),
        lighting=plant.lighting,
    )


def _checked(plant: Plant, cameras: Sequence[Camera] | None) -> Sequence[Camera]:
    cameras = default_cameras(plant) if cameras is None else cameras
    if not len(cameras):
        msg = "cameras is empty: there is nothing to compare"
        raise ValueError(msg)
    return cameras


def _build(
    plant: Plant,
    techniques: Mapping[str, Mapping[str, Any] | Technique],
    report: Progress,
    threads: int | None,
) -> dict[str, Technique]:
    """Build what is not built yet, the full mesh first; refuse unknown names before any work."""
    asked: dict[str, Mapping[str, Any] | Technique] = {FullMesh.name: {}, **techniques}
    wanted: dict[str, Technique | Callable[[], Technique]] = {}
    for label, value in asked.items():
        if label == FullMesh.name and value != {}:
            msg = f"the label {label!r} is the reference's; use '{label}:...' instead"
            raise ValueError(msg)
        if isinstance(value, Technique):
            wanted[label] = value
            continue
        name = label.partition(":")[0]
        if name not in REGISTRY:
            msg = f"unknown technique {name!r}; there are {', '.join(sorted(REGISTRY))}"
            raise ValueError(msg)
        build = REGISTRY[name].build
        offered: dict[str, Any] = {
            "threads": threads,
            "progress": functools.partial(report, f"baking {label}"),
        }
        # not every technique bakes
        known = inspect.signature(build).parameters
        extra = {key: offered[key] for key in offered if key in known}
        wanted[label] = functools.partial(build, plant, **(extra | dict(value)))
    built: dict[str, Technique] = {}
    report("building", 0, len(wanted))
    for label, made in wanted.items():
        built[label] = made if isinstance(made, Technique) else made()
        report("building", len(built), len(wanted))
    return built


def _kept_views(views: Sequence[View]) -> dict[str, int]:
    """Choose the first camera of the nearest and of the farthest distance."""
    nearest = min(views, key=lambda view: (view.distance, view.index))
    farthest = max(views, key=lambda view: (view.distance, -view.index))
    kept = {"near": nearest.index}
    if farthest.distance > nearest.distance:
        kept["far"] = farthest.index
    return kept


def _drawn(truth: Frame, frame: Frame, errors: metrics.Errors) -> dict[str, Any]:
    background = errors.worse_background
    difference = metrics.flip_map(
        truth,
        frame,
        background=background,  # type: ignore[arg-type]
        ppd=errors.ppd,
    )
    return {
        "background": background,
        "reference": _shown(truth, errors.region, metrics.BACKGROUNDS[background]),
        "image": _shown(frame, errors.region, metrics.BACKGROUNDS[background]),
        "difference": difference,
    }


def _shown(frame: Frame, region: tuple[int, int, int, int], background: float) -> NDArray[np.uint8]:
    left, top, right, bottom = region
    color = np.asarray(frame.color)[top:bottom, left:right]
    return quantize(srgb_from_linear(composite(color, background)))


def _portraits(
    plant: Plant, full: Technique, threads: int | None
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    (camera,) = orbit(plant, 1, 10.0, 2.75, (PORTRAIT_PX, PORTRAIT_PX))
    pictures = []
    for subject in (full, FullMesh.build(tinted(plant))):
        frame = render(subject, camera, samples=16, threads=threads)
        pictures.append(
            _shown(frame, metrics.measured_region(frame.bounds_px, camera.size), background=1.0)
        )
    return pictures[0], pictures[1]


def _facts(plant: Plant) -> dict[str, Any]:
    low, high = plant.bounds
    _, radius = plant.sphere
    return {
        "name": plant.name,
        "summary": plant.summary(),
        "triangle_count": plant.triangle_count,
        "wood_triangle_count": len(plant.wood.triangles),
        "foliage_triangle_count": len(plant.foliage.triangles),
        "leaf_count": plant.foliage.leaf_count,
        "leaf_area": float(plant.foliage.areas.sum(dtype=np.float64)),
        "material_count": len(plant.materials),
        "extent": tuple(float(side) for side in high - low),
        "radius": float(radius),
    }
