"""
Draw and measure what the documents show of octahedral impostors.

Run it from the project's root: ``uv run python docs/images/make_octahedral_impostor.py [NAME ...]``
with ``pictures``, ``ghosts``, ``frames``, ``sweep``, ``times``, ``spheres``, ``relit``,
``bytes`` or ``popping``; all by default, which takes some minutes. A plant is a file, which
`TREELOD_MODELS` says where to find. Tables are printed.
"""

import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import treelod as tl
from treelod.color import composite, quantize, srgb_from_linear
from treelod.techniques import Technique

MODELS = Path(os.environ.get("TREELOD_MODELS") or Path(__file__).parents[3] / "shared" / "models")
"""Real plants, where `TREELOD_MODELS` says nothing."""

HERE = Path(__file__).parent
BACKGROUND = (0.80, 0.86, 0.92)
"""Linear colour behind the plants."""

PANEL = (240, 270)
CAPTION = 26
COLORS = 192

SIZE = (256, 192)
DISTANCES = (2.5, 10.0, 40.0)
SAMPLES = 16
REPEATS = 15
"""Frames that are timed, in turns."""

ELEVATIONS = (-50, -20, 2, 25, 55, 85)
BELOW = (0, -20, -50, -70, -80, -85, -88, -89)
EVENING = tl.Lighting(sun_direction=(-0.9, 0.25, 0.3), sun=(1.0, 0.55, 0.25), sky=(0.18, 0.2, 0.32))
"""A low sun from the other side."""

VIEWS = ((2, 12.0), (2, 200.0), (25, 80.0), (55, 300.0))
"""Elevation and azimuth in degrees, none of them that of a frame."""

CASES: dict[str, dict[str, Any]] = {
    "default": {},
    "4 x 4": {"frame_count": 4},
    "6 x 6": {"frame_count": 6},
    "12 x 12": {"frame_count": 12},
    "16 x 16": {"frame_count": 16},
    "64 texels": {"resolution": 64},
    "192 texels": {"resolution": 192},
    "256 texels": {"resolution": 256},
    "no parallax": {"parallax_steps": 0},
    "1 step": {"parallax_steps": 1},
    "4 steps": {"parallax_steps": 4},
    "no tolerance": {"depth_tolerance": None},
    "tolerance 0.02": {"depth_tolerance": 0.02},
    "tolerance 0.2": {"depth_tolerance": 0.2},
    "16-bit depth": {"depth_bits": 16},
    'blend="nearest"': {"blend": "nearest"},
    'drawing="test"': {"drawing": "test"},
    'drawing="blend"': {"drawing": "blend"},
    'shading="relit"': {"shading": "relit"},
    'format="bc7"': {"format": "bc7"},
    'format="bc1"': {"format": "bc1"},
    'format="palette8"': {"format": "palette8"},
}


TIMED = (
    "default",
    "4 x 4",
    "256 texels",
    "no parallax",
    "1 step",
    "4 steps",
    "no tolerance",
    'blend="nearest"',
    'drawing="test"',
    'shading="relit"',
)
"""Cases of which times are shown."""


def plants() -> dict[str, tl.Plant]:
    """Grow a crown of blades, and load one of crossed cards."""
    return {
        "chestnut": tl.grow_plant("chestnut"),
        "ez_oak_large": tl.load_plant(MODELS / "ez_oak_large" / "ez_oak_large.glb"),
    }


def cameras(
    plant: tl.Plant, distance: float, views: tuple[tuple[int, float], ...] = VIEWS
) -> list[tl.Camera]:
    """Look from elevations and azimuths."""
    found = []
    for elevation, azimuth in views:
        around = tl.orbit(plant, count=90, elevation_deg=elevation, distance=distance, size=SIZE)
        found.append(around[round(azimuth / 4)])
    return found


def panel(lod: Technique, camera: tl.Camera) -> Image.Image:
    """Draw a technique on the sky."""
    color = tl.render(lod, camera, samples=64).color
    return Image.fromarray(quantize(srgb_from_linear(np.clip(composite(color, BACKGROUND), 0, 1))))


def sheet(panels: list[tuple[str, Image.Image]], columns: int) -> Image.Image:
    """Set panels in rows, each with its caption."""
    width, height = panels[0][1].size
    rows = -(-len(panels) // columns)
    height += CAPTION
    sky = quantize(srgb_from_linear(np.array(BACKGROUND)))
    image = Image.new("RGB", (columns * width, rows * height), tuple(sky.tolist()))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=13)
    for number, (caption, picture) in enumerate(panels):
        x, y = number % columns * width, number // columns * height
        image.paste(picture, (x, y + CAPTION))
        draw.text((x + 8, y + 7), caption, fill=(20, 30, 40), font=font)
    return image.quantize(COLORS, dither=Image.Dither.NONE)


def whole_plant(plant: tl.Plant, elevation_deg: float, azimuth_deg: float) -> tl.Camera:
    """Look in parallel, so that the plant's ball fills a panel."""
    center, radius = plant.sphere
    up, around = np.deg2rad([elevation_deg, azimuth_deg])
    away = np.array([np.cos(up) * np.sin(around), np.sin(up), np.cos(up) * np.cos(around)])
    eye = center + away * 8 * radius
    height = 2.0 * radius * PANEL[1] / PANEL[0]
    return tl.Camera.orthographic(tuple(eye), tuple(center), height=height, size=PANEL)


def show_pictures() -> None:
    """Write ``octahedral_impostor.png``: plants from the side and from above, beside their mesh."""
    panels = []
    for name, plant in plants().items():
        full, lod = tl.FullMesh.build(plant), tl.OctahedralImpostor.build(plant)
        for elevation, azimuth in ((10, 12), (65, 100)):
            camera = whole_plant(plant, elevation, azimuth)
            near = tl.OctahedralImpostor.build(
                plant, frame_count=16, resolution=256, views=[camera]
            )
            panels.append((f"{name}, {elevation} degrees", panel(full, camera)))
            panels.append(("8 x 8 of 128 texels", panel(lod, camera)))
            panels.append(("16 x 16 of 256 texels", panel(near, camera)))
    sheet(panels, 6).save(HERE / "octahedral_impostor.png", optimize=True)


def show_ghosts() -> None:
    """Write ``octahedral_ghosts.png``: what parallax and its tolerance do between frames."""
    plant = plants()["ez_oak_large"]
    camera = whole_plant(plant, 12, 135)
    panels = [("mesh", panel(tl.FullMesh.build(plant), camera))]
    for label, params in (
        ("no parallax", {"parallax_steps": 0}),
        ("1 step, as in engines", {"parallax_steps": 1, "depth_tolerance": None}),
        ("2 steps", {"depth_tolerance": None}),
        ("2 steps, tolerance 0.05", {}),
    ):
        lod = tl.OctahedralImpostor.build(plant, **params)
        panels.append((label, panel(lod, camera)))
    sheet(panels, 5).save(HERE / "octahedral_ghosts.png", optimize=True)


def show_frames() -> None:
    """Write ``octahedral_frames.png``: all that a small grid of frames may hold."""
    plant = tl.grow_plant("chestnut")
    size: dict[str, Any] = {"frame_count": 5, "resolution": 72}
    lit = tl.OctahedralImpostor.build(plant, **size)
    kept = tl.OctahedralImpostor.build(plant, shading="relit", **size)
    color = lit.textures[0].levels[0]
    albedo, depth, normal = (texture.levels[0] for texture in kept.textures)
    alpha = color[..., 3:] / 255
    sky = quantize(srgb_from_linear(np.array(BACKGROUND)))

    def over_sky(texels: NDArray[np.uint8]) -> Image.Image:
        return Image.fromarray((texels[..., :3] * alpha + sky * (1 - alpha)).astype(np.uint8))

    panels = [
        ("lit colour", over_sky(color)),
        ("albedo", over_sky(albedo)),
        ("normal", over_sky(normal)),
        ("depth, near is bright", Image.fromarray(np.repeat(depth[..., :1], 3, axis=2))),
    ]
    sheet(panels, 4).save(HERE / "octahedral_frames.png", optimize=True)


def errors_of(lod: Technique, references: list[tl.Frame]) -> tuple[float, float]:
    """Mean FLIP and coverage bias."""
    errors = [
        tl.metrics.compare(reference, tl.render(lod, reference.camera, samples=SAMPLES))
        for reference in references
    ]
    flip = float(np.mean([error.flip for error in errors]))
    return flip, float(np.mean([error.coverage_bias for error in errors]))


def references_of(
    plant: tl.Plant, views: tuple[tuple[int, float], ...] = VIEWS
) -> list[list[tl.Frame]]:
    """Draw the mesh for each distance and view."""
    full = tl.FullMesh.build(plant)
    return [
        [tl.render(full, camera, samples=SAMPLES) for camera in cameras(plant, distance, views)]
        for distance in DISTANCES
    ]


def row(label: str, lod: Technique, references: list[list[tl.Frame]]) -> str:
    """Make a line of Markdown."""
    cells = []
    for at_distance in references:
        flip, bias = errors_of(lod, at_distance)
        cells.append(f"{flip:.3f}, {bias:+.3f}")
    return f"| {label} | {baked_bytes(lod) / 1e6:.2f} | {' | '.join(cells)} |"


def measure_times() -> None:
    """Print the least milliseconds of a frame of 4 samples, on one thread, beside the mesh."""
    for name, plant in plants().items():
        lods: dict[str, Technique] = {"full mesh": tl.FullMesh.build(plant)}
        for label in TIMED:
            lods[label] = tl.OctahedralImpostor.build(plant, **CASES[label])
        best = {label: [np.inf] * len(DISTANCES) for label in lods}
        for _ in range(REPEATS):
            for label, lod in lods.items():
                for place, distance in enumerate(DISTANCES):
                    camera = cameras(plant, distance)[2]
                    stats = tl.render(lod, camera, samples=4, threads=1).stats
                    best[label][place] = min(best[label][place], stats.frame_millis)
        for label, times in best.items():
            secs = f"{lods[label].build_secs:.1f}"
            cells = " | ".join(f"{millis:.1f}" for millis in times)
            print(f"| {name}, {label} | {secs} | {cells} |", flush=True)


def measure_sweep() -> None:
    """Print errors by parameter."""
    for name, plant in plants().items():
        references = references_of(plant)
        for label, params in CASES.items():
            lod = tl.OctahedralImpostor.build(plant, **params)
            print(row(f"{name}, {label}", lod, references), flush=True)


def measure_spheres() -> None:
    """Print errors by elevation, for the upper half and for the whole, of as many frames."""
    plant = tl.grow_plant("chestnut")
    whole = {"hemisphere": False, "frame_count": 8}
    cases = {
        "upper half, 8 x 8": {},
        "whole, 8 x 8": whole,
        "whole, 12 x 12": {**whole, "frame_count": 12},
    }
    for label, params in cases.items():
        lod = tl.OctahedralImpostor.build(plant, **params)
        cells = []
        for elevation in ELEVATIONS:
            views = tuple((elevation, azimuth) for azimuth in (12.0, 200.0, 300.0))
            flip, bias = errors_of(lod, references_of(plant, views)[0])
            cells.append(f"{flip:.3f}, {bias:+.3f}")
        print(f"| {label} | {baked_bytes(lod) / 1e6:.2f} | {' | '.join(cells)} |", flush=True)


def measure_below() -> None:
    """Print how much of the mesh's area is covered from below, in parallel views."""
    plant = tl.grow_plant("chestnut")
    full = tl.FullMesh.build(plant)
    for label, hemisphere in (("upper half", True), ("whole", False)):
        lod = tl.OctahedralImpostor.build(plant, hemisphere=hemisphere)
        cells = []
        for elevation in BELOW:
            views = [whole_plant(plant, elevation, azimuth) for azimuth in (12.0, 200.0, 300.0)]
            covered = [
                sum(
                    float(tl.render(each, view, samples=SAMPLES).color[..., 3].sum())
                    for view in views
                )
                for each in (lod, full)
            ]
            cells.append(f"{covered[0] / covered[1]:.2f}")
        print(f"| {label} | {' | '.join(cells)} |", flush=True)


def measure_relit() -> None:
    """Print what frames show under another light: baked for it, lit anew, and left as they were."""
    for name, plant in plants().items():
        late = plant.lit(EVENING)
        references = references_of(late)
        relit = tl.OctahedralImpostor.build(plant, shading="relit")
        cases = {
            "baked in that light": tl.OctahedralImpostor.build(late),
            "`relit` in that light": relit.relit(EVENING),
            "as baked before": tl.OctahedralImpostor.build(plant),
        }
        for label, lod in cases.items():
            cells = [f"{errors_of(lod, at_distance)[0]:.3f}" for at_distance in references]
            print(f"| {name}, {label} | {' | '.join(cells)} |", flush=True)


def baked_bytes(lod: Technique) -> int:
    """Bytes of what was baked, without the textures of a wood that stays a mesh."""
    if isinstance(lod, tl.OctahedralImpostor):
        return lod.footprint.texture_bytes
    baked = (texture for texture in lod.textures if texture.name.startswith(("slicing", "level")))
    return sum(level.nbytes for texture in baked for level in texture.levels)


def of_bytes(
    technique: type[Technique], plant: tl.Plant, wanted: int, params: Mapping[str, Any]
) -> Technique:
    """Build a technique with the resolution whose bakes take about so many bytes."""
    resolution = 128
    for _ in range(3):
        lod = technique.build(plant, resolution=resolution, **params)
        resolution = max(round(resolution * (wanted / baked_bytes(lod)) ** 0.5), 1)
    return technique.build(plant, resolution=resolution, **params)


def measure_bytes() -> None:
    """Print errors of techniques whose textures take as many bytes."""
    for name, plant in plants().items():
        references = references_of(plant)
        mine = tl.OctahedralImpostor.build(plant)
        wanted = baked_bytes(mine)
        print(row(f"{name}, octahedral impostor", mine, references), flush=True)
        for label, technique, params in techniques():
            lod = of_bytes(technique, plant, wanted, params)
            print(row(f"{name}, {label}", lod, references), flush=True)


def techniques() -> Iterator[tuple[str, type[Technique], dict[str, Any]]]:
    """Name what impostors are compared with."""
    yield "6 slicings of 5", tl.Slicings, {}
    yield "32 leaf clusters", tl.LeafClusters, {"drawing": "coverage"}


def measure_popping() -> None:
    """Print what changes where a direction leaves a triangle, for both ways to mix frames."""
    plant = tl.grow_plant("chestnut")
    for blend in ("three", "nearest"):
        lod = tl.OctahedralImpostor.build(plant, blend=blend)
        for distance in DISTANCES:
            jumps = []
            for camera in cameras(plant, distance):
                jumps.append(jump(lod, plant, camera))
            print(f"| {blend} | {distance:g} | {np.mean(jumps):.4f} |", flush=True)


def jump(lod: tl.OctahedralImpostor, plant: tl.Plant, camera: tl.Camera) -> float:
    """FLIP between the two sides of the first swap of the heaviest frame on a camera's circle."""
    center, _ = plant.sphere

    def turned(degrees: float) -> tl.Camera:
        angle = np.deg2rad(degrees)
        x, y, z = np.array(camera.eye) - center
        cos, sin = np.cos(angle), np.sin(angle)
        eye = center + np.array([x * cos + z * sin, y, z * cos - x * sin])
        return tl.Camera.perspective(
            tuple(eye), tuple(center), fov_y_deg=camera.fov_y_deg, size=camera.size
        )

    def heaviest(degrees: float) -> int:
        mixed = lod.mixed(turned(degrees))
        return max(mixed, key=lambda frame: (mixed[frame], -frame))

    first = heaviest(0.0)
    high = next(degrees for degrees in np.arange(0.5, 60, 0.5) if heaviest(degrees) != first)
    low = high - 0.5
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if heaviest(middle) == first else (low, middle)
    before, after = (tl.render(lod, turned(degrees), samples=SAMPLES) for degrees in (low, high))
    # the cameras differ by less than a millionth of a degree
    return tl.metrics.compare(before, replace(after, camera=before.camera)).flip


def main() -> None:
    """Do what is named on the command line, or all."""
    every = {
        "pictures": show_pictures,
        "ghosts": show_ghosts,
        "frames": show_frames,
        "sweep": measure_sweep,
        "times": measure_times,
        "spheres": measure_spheres,
        "below": measure_below,
        "relit": measure_relit,
        "bytes": measure_bytes,
        "popping": measure_popping,
    }
    for name in sys.argv[1:] or every:
        every[name]()


if __name__ == "__main__":
    main()
