"""Lit colours of a view, and the light itself, against mitsuba, embree and NumPy."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from treelod.cameras import Camera
from treelod.color import srgb_from_linear
from treelod.plants import Lighting, Plant
from treelod.references import mitsuba
from treelod.references.checks import Check, Panel, Section, rmse
from treelod.references.coverage import MANY_SAMPLES
from treelod.references.runner import in_parallel
from treelod.references.shading import shade
from treelod.references.soup import plant_soup
from treelod.references.views import (
    bands,
    camera_settings,
    check_cameras,
    sample_positions,
)
from treelod.render import render
from treelod.techniques import FullMesh

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

__all__ = ["color_section", "lambert_section"]

MAX_RMSE = 0.01
"""Of linear premultiplied colour: what is left of the noise at some hundred samples a pixel."""

RAYS_A_BAND = 1 << 23
"""Half a minute of one processor: what a run that is stopped may lose."""

SUN = (0.3, 0.4, 0.866)
"""Towards the sun: so near to the viewer that the leaves' shadows fall between the leaves."""


def color_section(
    plant: Plant, size: tuple[int, int], spp: int, progress: Callable[[int, int], None]
) -> Section:
    """
    Check the lit colours of the whole plant in a perspective view.

    Parameters
    ----------
    plant : Plant
        Any. Without textures mitsuba draws the reference, else embree and NumPy do.
    size : tuple of 2 ints
        Pixels.
    spp : int
        Samples a pixel of mitsuba; rays go through our own sample positions.
    progress : callable
        Called with bands of the picture done and all.

    Returns
    -------
    Section
    """
    camera = check_cameras(plant, size)["perspective"]
    view = camera_settings(camera, plant.origin)
    soup = plant_soup(plant)
    opaque = all(
        material.texture is None and material.alpha_mode == "opaque" for material in plant.materials
    )
    calls: list[Callable[[], NDArray[Any]]]
    if opaque:
        picture = {
            "soup": 0,
            "view": view,
            "quantity": "color",
            "spp": spp,
            "seed": 1,
            "sampler": "multijitter",
        }
        calls = list(mitsuba.banded(soup, picture))
        who = f"mitsuba at {spp}"
    else:
        positions = sample_positions(MANY_SAMPLES)
        calls = [
            functools.partial(shade, soup, view, positions, rows=rows)
            for rows in bands(size, MANY_SAMPLES, RAYS_A_BAND)
        ]
        who = "embree's hits, coloured in NumPy, at the same samples"
    theirs = np.concatenate(in_parallel(calls, progress))[..., :3]
    frame = render(FullMesh.build(plant), camera, samples=MANY_SAMPLES, outputs=("color",))
    assert frame.color is not None
    ours = frame.color[..., :3]
    return Section(
        title="Lit colour",
        what=f"The full mesh, {size[0]} x {size[1]} pixels, {MANY_SAMPLES} samples, linear, "
        f"against {who}.",
        checks=[
            Check(
                name="lit colour, RMSE",
                value=rmse(ours, theirs),
                relation="<=",
                limit=MAX_RMSE,
                note="mitsuba" if opaque else "embree",
            )
        ],
        panels=[
            Panel(
                title="lit colour",
                ours=srgb_from_linear(ours),
                reference=srgb_from_linear(theirs),
                difference=np.abs(ours - theirs).max(axis=2),
            )
        ],
    )


def lambert_section(progress: Callable[[int, int], None]) -> Section:
    """
    Check the light: leaves under a sun alone, without translucency.

    Parameters
    ----------
    progress : callable
        Called with views done and all.

    Returns
    -------
    Section
    """
    progress(0, 1)
    plant = lambert_plant()
    camera = Camera.orthographic((0, 0, 10), (0, 0, 0), height=8.0, size=(64, 64))
    mesh = plant.foliage.mesh
    base = mesh.base[mesh.triangles][..., :3].astype(np.float64)
    picture = {
        "soup": 0,
        "view": camera_settings(camera, plant.origin),
        "quantity": "sunlit",
        "sun": list(SUN),
        "spp": MANY_SAMPLES,
        "seed": 1,
        "sampler": "multijitter",
    }
    (theirs,), _ = mitsuba.draw([replace(plant_soup(plant), front=base, back=base)], [picture])
    frame = render(FullMesh.build(plant), camera, samples=MANY_SAMPLES, outputs=("color",))
    assert frame.color is not None
    ours = frame.color[..., :3]
    progress(1, 1)
    return Section(
        title="Light",
        what="Leaves of all orientations under a directional light, without sky, ground and "
        "translucency, against diffuse surfaces under mitsuba's.",
        checks=[
            Check(
                name="Lambert's law, RMSE", value=rmse(ours, theirs), relation="<=", limit=MAX_RMSE
            )
        ],
        panels=[
            Panel(
                title="leaves in the sun",
                ours=srgb_from_linear(ours),
                reference=srgb_from_linear(theirs),
                difference=np.abs(ours - theirs).max(axis=2),
            )
        ],
    )


def lambert_plant() -> Plant:
    """Return 49 coloured leaves, turned every way, so far apart that none shades another."""
    rng = np.random.default_rng(7)
    axis = np.arange(-3.0, 4.0)
    middles = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    middles = np.column_stack([middles, np.zeros(len(middles))])
    across, other = rng.normal(size=(2, len(middles), 3))
    along = np.cross(across, other)
    across *= 0.2 / np.linalg.norm(across, axis=1, keepdims=True)
    along *= 0.2 / np.linalg.norm(along, axis=1, keepdims=True)
    corners = [middles + x * across + y * along for x, y in [(-1, -1), (1, -1), (1, 1), (-1, 1)]]
    first = 4 * np.arange(len(middles))[:, np.newaxis, np.newaxis]
    colors = np.repeat(rng.uniform(0.1, 1.0, (len(middles), 3)), 4, axis=0)
    return Plant.from_arrays(
        foliage={
            "positions": np.stack(corners, axis=1).reshape(-1, 3),
            "triangles": (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
            "colors": colors,
        },
        leaf_offsets=2 * np.arange(len(middles) + 1),
        lighting=Lighting(
            sun_direction=SUN,
            sun=(1.0, 1.0, 1.0),
            sky=(0.0, 0.0, 0.0),
            ground=(0.0, 0.0, 0.0),
            translucency=0.0,
        ),
    )
