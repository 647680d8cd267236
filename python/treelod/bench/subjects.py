"""
What do the benchmarks of frames draw? Parts that two processes build alike, seen from one camera.

A grown mesh is stored as what it grows from, points and lines as arrays. Whoever loads a subject
has the same draw lists as whoever stored it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod import _core
from treelod.plants import grow_plant
from treelod.techniques import FullMesh

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["COUNTS", "Cloud", "GrownMesh", "Part", "Subject"]

COUNTS = ("triangles", "cards", "lines", "points", "items")
"""What says of a drawn frame how much was in its list."""


@dataclass(frozen=True, kw_only=True)
class GrownMesh:
    """
    The triangles of a grown plant, where it grew.

    Attributes
    ----------
    preset : str
        What kind of plant, as in `treelod.grow_plant`.
    leaf_count : int or None
        How many leaves; None is the preset's own number.
    wood : bool
        Whether trunk and limbs are drawn.
    """

    preset: str
    leaf_count: int | None
    wood: bool = True

    def representation(self) -> _core.Representation:
        """Grow it."""
        plant = grow_plant(self.preset, leaf_count=self.leaf_count)
        return FullMesh.build(plant, wood=self.wood)._core


@dataclass(frozen=True, kw_only=True, eq=False)
class Cloud:
    """
    Points or lines in flat colours.

    Attributes
    ----------
    positions : ndarray of shape (N, 3), dtype float32
        World positions in metres; of lines, both ends of each.
    colors : ndarray of shape (N, 3), dtype float32
        Linear colours in [0, 1].
    lines : bool
        Whether every two positions are a line.
    size_px : float
        Side of a point or width of a line.
    """

    positions: NDArray[np.float32]
    colors: NDArray[np.float32]
    lines: bool
    size_px: float

    @property
    def count(self) -> int:
        """How many points or lines there are."""
        return len(self.positions) // (2 if self.lines else 1)

    def representation(self) -> _core.Representation:
        """Make what a scene draws."""
        return _core.cloud(self.positions, self.colors, lines=self.lines, size_px=self.size_px)


Part = GrownMesh | Cloud


class Subject:
    """
    Parts that are drawn together, and the camera that sees them.

    Parameters
    ----------
    parts : sequence of GrownMesh or Cloud
        What is drawn.
    camera : dict
        From where, as `treelod.render.camera_facts` gives it.
    """

    def __init__(self, parts: Sequence[Part], camera: _core._CameraFacts) -> None:
        self._parts = tuple(parts)
        self._camera = camera
        here = np.eye(4)[np.newaxis]
        self._scene = _core.Scene([(part.representation(), here) for part in parts])

    def store(self, path: Path) -> None:
        """
        Write it into a file.

        Parameters
        ----------
        path : Path
            File to write, with the ending ``.npz``.
        """
        facts: list[dict[str, Any]] = []
        arrays: dict[str, NDArray[Any]] = {}
        for index, part in enumerate(self._parts):
            if isinstance(part, GrownMesh):
                facts.append(asdict(part))
            else:
                facts.append({"lines": part.lines, "size_px": part.size_px})
                arrays[f"positions {index}"] = part.positions
                arrays[f"colors {index}"] = part.colors
        text = np.array(json.dumps({"parts": facts, "camera": self._camera}))
        np.savez(path, text=text, **arrays)  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: Path) -> Subject:
        """
        Read one that was stored, and build it.

        Parameters
        ----------
        path : Path
            File to read.

        Returns
        -------
        Subject
        """
        with np.load(path) as stored:
            facts = json.loads(str(stored["text"]))
            parts: list[Part] = [
                GrownMesh(**part)
                if "preset" in part
                else Cloud(
                    positions=stored[f"positions {index}"],
                    colors=stored[f"colors {index}"],
                    **part,
                )
                for index, part in enumerate(facts["parts"])
            ]
        camera = facts["camera"]
        camera["size"] = tuple(camera["size"])
        return cls(parts, camera)

    def secs(
        self,
        renderer: _core.Renderer,
        *,
        samples: int,
        threads: int,
        backend: str = "cpu",
        adapter: str | None = None,
    ) -> float:
        """
        Draw a frame and return what it took: emit and draw, in seconds.

        Parameters
        ----------
        renderer : Renderer
            What remembers between frames.
        samples, threads, backend, adapter
            As in `treelod.render`.

        Returns
        -------
        float
        """
        stats = renderer.time(
            self._scene,
            self._camera,
            samples=samples,
            threads=threads,
            backend=backend,
            adapter=adapter,
        )
        return float(stats["emit_millis"] + stats["draw_millis"]) / 1e3

    def picture(
        self,
        renderer: _core.Renderer,
        *,
        samples: int,
        backend: str = "cpu",
        adapter: str | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """
        Draw a frame and return linear colour, shape (H, W, 4), and its stats.

        Parameters
        ----------
        renderer : Renderer
            What remembers between frames.
        samples, backend, adapter
            As in `treelod.render`.

        Returns
        -------
        color : ndarray of shape (H, W, 4), dtype float32
        stats : dict
        """
        planes, stats = renderer.render(
            self._scene,
            self._camera,
            samples=samples,
            background=(0.0, 0.0, 0.0, 0.0),
            outputs=("color",),
            threads=None,
            backend=backend,
            adapter=adapter,
        )
        return planes["color"], stats

    def naive_secs(self) -> float:
        """Draw a frame of one sample with the slow twin and return its seconds."""
        return _core.time_naive(self._scene, self._camera, samples=1)
