"""
Draw a technique or a scene from a camera, and time it.

A frame's time is what the core needs to emit a draw list and to draw it into warm memory: clear,
transform, bin, raster, resolve. No Python, no metrics and no file is in it, and no upload of what
frames share to a graphics card.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod import _core
from treelod.cameras import Camera
from treelod.color import composite, quantize, srgb_from_linear
from treelod.errors import LimitError
from treelod.scenes import Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from treelod.techniques.technique import Technique

__all__ = [
    "BACKENDS",
    "EMPTY_ID",
    "OUTPUTS",
    "Frame",
    "Stats",
    "ViewState",
    "render",
    "time_frames",
]

EMPTY_ID = 0xFFFFFFFF
"""Value of `Frame.ids` where nothing is drawn."""

OUTPUTS = ("color", "depth", "ids", "normal", "albedo", "color8")
"""Planes that `render` can make."""

BACKENDS = ("cpu", "gpu")
"""What can draw."""

MAX_PIXEL_COUNT = 1 << 27
"""Most pixels of a picture: 2 GiB of colour."""


@dataclass(frozen=True, kw_only=True)
class Stats:
    """
    What drawing a frame took.

    Attributes
    ----------
    frame_millis : float
        `emit_millis` + `draw_millis`.
    emit_millis : float
        Making the draw list, in milliseconds.
    draw_millis : float
        Drawing it, in milliseconds.
    triangles, cards, lines, points : int
        Primitives submitted, copies counted.
    items : int
        Calls that a renderer would need which draws primitives of one look at a time.
    textures : int
        Textures that they read.
    vertices : int
        Vertices transformed, over all sets of samples; on a graphics card, corners submitted.
    fragments : int or None
        (primitive, pixel) pairs of which a sample is covered, hidden ones included, over all sets
        of up to 16 samples; None on a graphics card, which does not count them.
    samples : int
        Samples a pixel.
    threads : int
        Threads of the pool that drew it; 0 where a graphics card did.
    backend : {'cpu', 'gpu'}
        What drew it.
    gpu_millis : float or None
        What the graphics card says it took from its first command to its last, in milliseconds;
        None on the processor, and for cards that do not tell. `draw_millis` is wall time, and holds
        the upload of what is this frame's own and the recording of commands besides.
    adapter, driver : str or None
        The graphics card's name and its driver; None on the processor.
    """

    frame_millis: float
    emit_millis: float
    draw_millis: float
    triangles: int
    cards: int
    lines: int
    points: int
    items: int
    textures: int
    vertices: int
    fragments: int | None
    samples: int
    threads: int
    backend: str
    gpu_millis: float | None
    adapter: str | None
    driver: str | None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Frame:
    """
    A picture. Planes that were not asked for are None; row 0 is on top.

    Attributes
    ----------
    color : ndarray of shape (H, W, 4), dtype float32, or None
        Linear, premultiplied.
    depth : ndarray of shape (H, W), dtype float32, or None
        Distance along the viewing direction of the nearest sample in metres, inf where there is
        none. Where only blended cards are seen, the first of them, front to back, at which the
        opacity reaches one half.
    ids : ndarray of shape (H, W), dtype uint32, or None
        Source triangle of the nearest sample, wood first; `EMPTY_ID` where there is none.
    normal : ndarray of shape (H, W, 3), dtype float32, or None
        World-space normal of the side seen, times opacity.
    albedo : ndarray of shape (H, W, 4), dtype float32, or None
        As `color`, without light.
    color8 : ndarray of shape (H, W, 4), dtype uint8, or None
        sRGB of the premultiplied colour; alpha linear.
    stats : Stats
        What it took.
    camera : Camera
        From where.
    bounds_px : tuple of 4 ints
        Pixels (left, top, right, bottom; ends exclusive) that the box around everything drawn can
        touch, inside the picture; left = right where it is out of view.
    """

    color: NDArray[np.float32] | None
    depth: NDArray[np.float32] | None
    ids: NDArray[np.uint32] | None
    normal: NDArray[np.float32] | None
    albedo: NDArray[np.float32] | None
    color8: NDArray[np.uint8] | None
    stats: Stats
    camera: Camera
    bounds_px: tuple[int, int, int, int]

    def __repr__(self) -> str:
        width, height = self.camera.size
        planes = [name for name in OUTPUTS if getattr(self, name) is not None]
        return f"Frame({width} x {height}, {', '.join(planes)})"

    def _repr_png_(self) -> bytes | None:
        """Show the picture in a notebook, on white; None without `color`."""
        if self.color is None:
            return None
        shown = quantize(srgb_from_linear(composite(self.color, 1.0)))
        return _core.encode_png(np.ascontiguousarray(shown))


class ViewState:
    """
    What one camera remembers between frames: pass it to `render` again and again.

    It only makes the next frame quicker: techniques that choose by the view go on from their last
    choice, and buffers stay warm. A fresh state and a used one give the same picture. It may be
    used for other cameras and subjects, by one thread at a time.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> mesh, state = tl.FullMesh.build(plant), tl.ViewState()
    >>> walk = [tl.render(mesh, c, state=state) for c in tl.orbit(plant, count=3, size=(64, 64))]
    """

    def __init__(self) -> None:
        self._core = _core.Renderer()


def render(
    subject: Technique | Scene,
    camera: Camera,
    *,
    backend: str = "cpu",
    samples: int = 4,
    background: Sequence[float] | None = None,
    outputs: Sequence[str] = ("color", "depth"),
    threads: int | None = None,
    state: ViewState | None = None,
    adapter: str | None = None,
) -> Frame:
    """
    Draw a technique's plant, or a scene.

    Parameters
    ----------
    subject : Technique or Scene
        A technique stands where its plant's file put it.
    camera : Camera
        From where, and how large.
    backend : {'cpu', 'gpu'}, default 'cpu'
        What draws: the processor, or a graphics card. Both draw the same picture.
    samples : int, default 4
        Samples a pixel: 1, 4, 8, 16, or any number from 17 to 65536. The picture is the mean of
        that many one-sample pictures at fixed positions.
    background : sequence of 3 or 4 floats, optional
        Linear colour behind everything, premultiplied if it has an alpha. Default: transparent.
    outputs : sequence of str, default ('color', 'depth')
        Planes to make, from `OUTPUTS`.
    threads : int, optional
        Threads that draw; the picture is the same for any number. Default: ``TREELOD_NUM_THREADS``,
        else all cores.
    state : ViewState, optional
        What is remembered from the frame before. Default: nothing is.
    adapter : str, optional
        Which graphics card, with ``backend="gpu"``: a part of its name, in any case, its kind, or
        its place in the list of `gpu.adapters`, as ``"#1"`` for the second. Default:
        ``TREELOD_ADAPTER``, else the first one.

    Returns
    -------
    Frame

    Raises
    ------
    ValueError
        If an argument is out of range or names nothing, or if the technique was built for other
        cameras.
    LimitError
        If the picture would be too large, or something for the graphics card to hold.
    NoAdapterError
        If there is no graphics card of that name, or none at all.
    DeviceError
        If the graphics card was lost, ran out of memory or refused a command. The next call
        starts afresh.

    Examples
    --------
    >>> import treelod as tl
    >>> plant = tl.grow_plant("chestnut", leaf_count=50)
    >>> camera = tl.orbit(plant, count=1, size=(64, 64))[0]
    >>> frame = tl.render(tl.FullMesh.build(plant), camera)
    >>> frame.color.shape, bool(frame.color.max() <= 1.0)
    ((64, 64, 4), True)
    """
    check_backend(backend, adapter)
    samples = sample_count(samples)
    if isinstance(outputs, str) or not outputs:
        msg = f"outputs must be a sequence of names from {OUTPUTS}, got {outputs!r}"
        raise ValueError(msg)
    if state is not None and not isinstance(state, ViewState):
        msg = f"state must be a ViewState or None, got {type(state).__name__}"
        raise TypeError(msg)
    scene = _scene(subject)
    facts = camera_facts(camera)
    planes, stats = (state or ViewState())._core.render(
        scene._core,
        facts,
        samples=samples,
        background=_background(background),
        outputs=list(outputs),
        threads=thread_count(threads),
        backend=backend,
        adapter=adapter,
    )
    return Frame(
        **{name: planes.get(name) for name in OUTPUTS},
        stats=_stats(stats, samples),
        camera=camera,
        bounds_px=scene._core.bounds_px(facts),
    )


def time_frames(
    subjects: Mapping[str, Technique | Scene],
    camera: Camera,
    *,
    samples: int = 4,
    warmup: int = 2,
    repeats: int = 9,
    threads: int | None = None,
    backend: str = "cpu",
    adapter: str | None = None,
) -> dict[str, NDArray[np.float64]]:
    """
    Time frames of several subjects from one camera, taking turns.

    Taking turns spreads whatever else the machine does over all subjects alike. Only colour is
    drawn, into memory that stays warm.

    Parameters
    ----------
    subjects : mapping of str to (Technique or Scene)
        What to draw, by label.
    camera : Camera
        From where.
    samples : int, default 4
        Samples a pixel, as in `render`.
    warmup : int, default 2
        Rounds that are drawn first and not counted, at least 0.
    repeats : int, default 9
        Rounds that are counted, at least 1.
    threads, backend, adapter : optional
        As in `render`.

    Returns
    -------
    dict of str to ndarray of shape (repeats,), dtype float64
        Milliseconds of each frame: emit and draw, until the picture is there. On a graphics card
        that is the wall time from the first upload of what is the frame's own until the card is
        idle; what frames share was uploaded before, and nothing is read back.

    Raises
    ------
    ValueError
        If an argument is out of range.
    NoAdapterError, DeviceError
        As in `render`.
    """
    times = frame_times(
        subjects,
        camera,
        samples=samples,
        warmup=warmup,
        repeats=repeats,
        threads=threads,
        backend=backend,
        adapter=adapter,
    )
    return {label: of_label.frame_millis for label, of_label in times.items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Times:
    """
    What timed frames of one subject took, and what drew them.

    Attributes
    ----------
    frame_millis : ndarray of shape (repeats,), dtype float64
        As `time_frames` returns them.
    gpu_millis : ndarray of shape (repeats,), dtype float64, or None
        What the graphics card says that it took itself; None on the processor, and for cards that
        do not tell.
    adapter, driver : str or None
        The graphics card's name and its driver; None on the processor.
    """

    frame_millis: NDArray[np.float64]
    gpu_millis: NDArray[np.float64] | None
    adapter: str | None
    driver: str | None


def frame_times(
    subjects: Mapping[str, Technique | Scene],
    camera: Camera,
    *,
    samples: int,
    warmup: int,
    repeats: int,
    threads: int | None,
    backend: str,
    adapter: str | None,
) -> dict[str, Times]:
    """Time frames as `time_frames` does, and tell what drew them."""
    check_backend(backend, adapter)
    if operator.index(warmup) < 0 or operator.index(repeats) < 1:
        msg = f"warmup must be at least 0 and repeats at least 1, got {warmup} and {repeats}"
        raise ValueError(msg)
    if not isinstance(subjects, Mapping):
        msg = (
            "subjects must be a mapping of labels to techniques or scenes, got "
            f"{type(subjects).__name__}"
        )
        raise TypeError(msg)
    samples, threads = sample_count(samples), thread_count(threads)
    facts = camera_facts(camera)
    runs = {label: (_core.Renderer(), _scene(subject)._core) for label, subject in subjects.items()}
    found: dict[str, list[dict[str, Any]]] = {label: [] for label in runs}
    for turn in range(-warmup, repeats):
        for label, (renderer, scene) in runs.items():
            stats = renderer.time(
                scene, facts, samples=samples, threads=threads, backend=backend, adapter=adapter
            )
            if turn >= 0:
                found[label].append(stats)
    return {label: _times(frames) for label, frames in found.items()}


def opened_card(adapter: str | None) -> tuple[str, str]:
    """Draw nothing on a graphics card, to refuse one that is not there; return name and driver."""
    camera = Camera.perspective((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), size=(1, 1))
    stats = render(Scene([]), camera, backend="gpu", adapter=adapter, samples=1).stats
    assert stats.adapter is not None, "a card says its name"
    assert stats.driver is not None, "a card says its driver"
    return stats.adapter, stats.driver


def check_size(size: tuple[int, int]) -> None:
    """
    Refuse pictures that the core would refuse, before anything is done for them.

    Parameters
    ----------
    size : tuple of 2 ints
        Width and height in pixels.

    Raises
    ------
    LimitError
        If there are more than 2**27 pixels.
    """
    pixel_count = size[0] * size[1]
    if pixel_count > MAX_PIXEL_COUNT:
        msg = f"size needs {pixel_count} pixels, the limit is {MAX_PIXEL_COUNT}"
        raise LimitError(msg)


def camera_facts(camera: Camera) -> _core._CameraFacts:
    """Return a camera as the core takes it: with an `up` that is never parallel to the view."""
    if not hasattr(camera, "view_rotation"):
        msg = f"camera must be a Camera, got {type(camera).__name__}"
        raise TypeError(msg)
    up = camera.view_rotation()[1]
    return {
        "eye": camera.eye,
        "target": camera.target,
        "up": (float(up[0]), float(up[1]), float(up[2])),
        "fov_y_deg": camera.fov_y_deg,
        "height": camera.height,
        "size": camera.size,
        "near": camera.near,
        "time_secs": camera.time_secs,
    }


def _scene(subject: Technique | Scene) -> Scene:
    return subject if isinstance(subject, Scene) else Scene([(subject, None)])


def check_backend(backend: str, adapter: str | None) -> None:
    """Refuse what names no backend, and graphics cards for the processor."""
    if backend not in BACKENDS:
        msg = f"backend must be 'cpu' or 'gpu', got {backend!r}"
        raise ValueError(msg)
    if adapter is not None and not isinstance(adapter, str):
        msg = f"adapter must be a str or None, got {type(adapter).__name__}"
        raise TypeError(msg)
    if adapter is not None and backend != "gpu":
        msg = f"adapter names a graphics card, which backend={backend!r} does not draw with"
        raise ValueError(msg)


def sample_count(samples: int) -> int:
    """Refuse sample counts for which there are no positions."""
    try:
        count = operator.index(samples)
    except TypeError:
        msg = f"samples must be an int, got {type(samples).__name__}"
        raise TypeError(msg) from None
    if count not in (1, 4, 8, 16) and not 17 <= count <= 65536:
        msg = f"samples must be in 1, 4, 8, 16 or 17..=65536, got {count}"
        raise ValueError(msg)
    return count


def thread_count(threads: int | None) -> int | None:
    """Refuse thread counts that the core cannot even be asked for."""
    if threads is not None and not 1 <= operator.index(threads) <= 1024:
        msg = f"threads must be in 1..=1024 or None, got {threads}"
        raise ValueError(msg)
    return threads


def _background(background: Sequence[float] | None) -> tuple[float, float, float, float]:
    if background is None:
        return (0.0, 0.0, 0.0, 0.0)
    color = np.asarray(background, dtype=np.float64)
    if color.shape not in ((3,), (4,)):
        msg = f"background must have 3 or 4 components, got shape {color.shape}"
        raise ValueError(msg)
    red, green, blue = (float(channel) for channel in color[:3])
    return (red, green, blue, float(color[3]) if len(color) == 4 else 1.0)


def _times(frames: Sequence[Mapping[str, Any]]) -> Times:
    cards = [frame["gpu_millis"] for frame in frames]
    return Times(
        frame_millis=np.array([frame["emit_millis"] + frame["draw_millis"] for frame in frames]),
        gpu_millis=None if None in cards else np.array(cards),
        adapter=frames[-1]["adapter"],
        driver=frames[-1]["driver"],
    )


def _stats(facts: Mapping[str, Any], samples: int) -> Stats:
    total = facts["emit_millis"] + facts["draw_millis"]
    counted = {"fragments": None, **facts}
    return Stats(**counted, frame_millis=total, samples=samples)
