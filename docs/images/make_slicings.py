"""
Draw the picture and measure the tables of `docs/slicings.md`.

Needs the real plants: TREELOD_MODELS, else `shared/models` beside the project.
"""

import os
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import treelod as tl
from treelod.color import srgb_from_linear

ROOT = Path(__file__).parents[2]
MODELS = Path(os.environ.get("TREELOD_MODELS") or ROOT.parent / "shared" / "models")

SAMPLES = 16
SIDE, CAPTION = 240, 16
ON_AXIS, BETWEEN = (0.0, 120.0), (30.0, 150.0)
"""Azimuths of slicings when there are six, and half way between two of them."""


def plants() -> dict[str, tl.Plant]:
    """Load three crowns: of blades, of crossed cards, of large cards."""
    return {
        "chestnut": tl.grow_plant("chestnut"),
        "ez_oak_large": tl.load_plant(MODELS / "ez_oak_large" / "ez_oak_large.glb"),
        "CommonTree_1": tl.load_plant(MODELS / "quaternius_common" / "CommonTree_1.gltf"),
    }


def view(plant: tl.Plant, azimuth_deg: float, size: tuple[int, int]) -> tl.Camera:
    """Look at a plant from a multiple of 30 degrees, level, from 2.5 radii."""
    circle = tl.orbit(plant, count=12, elevation_deg=0, distance=2.5, size=size)
    return circle[round(azimuth_deg / 30.0) % 12]


def on_white(frame: tl.Frame) -> Image.Image:
    """Composite a frame on white."""
    color = frame.color[..., :3] + 1.0 - frame.color[..., 3:]
    return Image.fromarray((srgb_from_linear(np.clip(color, 0, 1)) * 255 + 0.5).astype(np.uint8))


def draw(plant: tl.Plant) -> None:
    """Draw mesh and slicings from two sides above, the slices of one slicing below."""
    mesh, lod = tl.FullMesh.build(plant), tl.Slicings.build(plant)
    panels = [
        (f"{what}, {where}", subject, azimuth)
        for where, azimuth in (("along a slicing", 0.0), ("half way between two", 30.0))
        for what, subject in (("full mesh", mesh), ("slicings", lod))
    ]
    slices = [texture for texture in lod.textures if texture.corners is not None][:5]
    width = SIDE * len(panels)
    low = width // len(slices)
    sheet = Image.new("RGB", (width, SIDE + low + 2 * CAPTION), "white")
    canvas = ImageDraw.Draw(sheet)
    for column, (label, subject, azimuth) in enumerate(panels):
        camera = view(plant, azimuth, (SIDE, SIDE))
        picture = on_white(tl.render(subject, camera, samples=SAMPLES))
        sheet.paste(picture, (column * SIDE, CAPTION))
        canvas.text((column * SIDE + 6, 2), label, fill="black")
    for column, texture in enumerate(slices):
        picture = Image.fromarray(texture.levels[0], "RGBA").resize((low - 6, low - 6))
        sheet.paste(picture, (column * low + 3, SIDE + 2 * CAPTION + 3), picture)
        canvas.text((column * low + 6, SIDE + CAPTION + 2), texture.name, fill="black")
    picture = sheet.quantize(128, dither=Image.Dither.NONE)
    picture.save(Path(__file__).with_name("slicings.png"), optimize=True)


def errors_of(
    lod: tl.Slicings, references: list[tuple[tl.Camera, tl.Frame]]
) -> tuple[float, float]:
    """Return FLIP and coverage bias, each the mean over the views."""
    errors = [
        tl.metrics.compare(reference, tl.render(lod, camera, samples=SAMPLES))
        for camera, reference in references
    ]
    return (
        float(np.mean([e.flip for e in errors])),
        float(np.mean([e.coverage_bias for e in errors])),
    )


def seen(plant: tl.Plant, azimuths: tuple[float, ...]) -> list[tuple[tl.Camera, tl.Frame]]:
    """Draw the full mesh from azimuths."""
    mesh = tl.FullMesh.build(plant)
    cameras = [view(plant, azimuth, (320, 240)) for azimuth in azimuths]
    return [(c, tl.render(mesh, c, samples=SAMPLES)) for c in cameras]


def measure(rows: dict[str, tl.Plant]) -> None:
    """Print three tables: by slices, by slicings and by correction."""
    axis = {name: seen(plant, ON_AXIS) for name, plant in rows.items()}
    between = {name: seen(plant, BETWEEN) for name, plant in rows.items()}

    def line(head: str, **params: object) -> None:
        cells, sizes = [], []
        for name, plant in rows.items():
            lod = tl.Slicings.build(plant, **params)
            # the plant's own textures are no part of it
            bakes = [t for t in lod.textures if t.corners is not None]
            sizes.append(sum(level.nbytes for t in bakes for level in t.levels))
            for views in (axis[name], between[name]):
                flip, bias = errors_of(lod, views)
                cells.append(f"{flip:.3f} / {bias:+.3f}")
        print(f"| {head} | {max(sizes) / 1e6:.1f} MB | {' | '.join(cells)} |", flush=True)

    for count in (1, 2, 3, 5, 7):
        line(str(count), slice_count=count)
    for side in (64, 128, 512):
        line(str(side), resolution=side)
    for correction in (0.0, 0.25, 0.5, 1.0, "fit", "optical"):
        line(f"`{correction!r}`", correction=correction)


if __name__ == "__main__":
    loaded = plants()
    draw(loaded["chestnut"])
    measure(loaded)
