"""
Draw the picture and measure the tables of `docs/full_mesh.md`.

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

SAMPLES = (1, 4, 8, 16)
REFERENCE_SAMPLES = 64
ENLARGED = 4
WINDOW, CAPTION = 60, 16


def plants() -> dict[str, tl.Plant]:
    """Load a crown of blades without textures, and one of cards with them."""
    return {
        "chestnut": tl.grow_plant("chestnut"),
        "ez_oak_large": tl.load_plant(MODELS / "ez_oak_large" / "ez_oak_large.glb"),
    }


def on_white(frame: tl.Frame) -> Image.Image:
    """Composite a frame on white."""
    color = frame.color[..., :3] + 1.0 - frame.color[..., 3:]
    return Image.fromarray((srgb_from_linear(np.clip(color, 0, 1)) * 255 + 0.5).astype(np.uint8))


def draw(plant: tl.Plant) -> None:
    """Draw the plant, and a part of it enlarged, by samples a pixel."""
    mesh = tl.FullMesh.build(plant)
    side = WINDOW * ENLARGED
    camera = tl.orbit(plant, count=1, elevation_deg=10, distance=2.75, size=(side, side))[0]
    columns = (1, 4, 16, REFERENCE_SAMPLES)
    sheet = Image.new("RGB", (side * (1 + len(columns)), side + CAPTION), "white")
    canvas = ImageDraw.Draw(sheet)
    left, top = side * 5 // 8, side * 3 // 8
    box = (left, top, left + WINDOW, top + WINDOW)
    whole = on_white(tl.render(mesh, camera, samples=REFERENCE_SAMPLES))
    ImageDraw.Draw(whole).rectangle(box, outline="black")
    sheet.paste(whole, (0, CAPTION))
    canvas.text((6, 2), f"{plant.triangle_count:,} triangles", fill="black")
    for column, samples in enumerate(columns, start=1):
        part = on_white(tl.render(mesh, camera, samples=samples)).crop(box)
        part = part.resize((side - 4, side), Image.Resampling.NEAREST)
        sheet.paste(part, (column * side + 4, CAPTION))
        label = f"{samples} sample{'s' * (samples > 1)} a pixel"
        canvas.text((column * side + 8, 2), label, fill="black")
    picture = sheet.quantize(128, dither=Image.Dither.NONE)
    picture.save(Path(__file__).with_name("full_mesh.png"), optimize=True)


def mean_errors(
    subject: tl.techniques.Technique,
    reference: tl.FullMesh,
    plant: tl.Plant,
    radii: float,
    samples: int,
) -> tuple[float, float]:
    """Return FLIP and coverage bias over 8 views."""
    errors = [
        tl.metrics.compare(
            tl.render(reference, camera, samples=REFERENCE_SAMPLES),
            tl.render(subject, camera, samples=samples),
        )
        for elevation in (0, 25)
        for camera in tl.orbit(
            plant, count=4, elevation_deg=elevation, distance=radii, size=(512, 384)
        )
    ]
    return (
        float(np.mean([e.flip for e in errors])),
        float(np.mean([e.coverage_bias for e in errors])),
    )


def measure(rows: dict[str, tl.Plant]) -> None:
    """Print three tables: by samples, by filter and by triangles of the wood."""
    distances = (2.5, 10.0, 40.0)
    for name, plant in rows.items():
        mesh = tl.FullMesh.build(plant)
        for radii in distances:
            cells = [f"{mean_errors(mesh, mesh, plant, radii, n)[0]:.3f}" for n in SAMPLES]
            print(f"| {name} | {radii:g} | {' | '.join(cells)} |")
    plant = rows["ez_oak_large"]
    mesh = tl.FullMesh.build(plant)
    for kind in ("nearest", "bilinear", "trilinear"):
        other = tl.FullMesh.build(plant, filter=kind)
        found = [mean_errors(other, mesh, plant, radii, 4) for radii in distances]
        print(f"| `{kind}` | {' | '.join(f'{flip:.3f} / {bias:+.3f}' for flip, bias in found)} |")
    plant = rows["chestnut"]
    mesh = tl.FullMesh.build(plant)
    for count in (None, 20000, 8000, 2000, 500):
        other = tl.FullMesh.build(plant, wood_triangle_count=count)
        left = other.footprint.triangles - len(plant.foliage.triangles)
        found = [mean_errors(other, mesh, plant, radii, 4)[0] for radii in distances]
        print(f"| {count} | {left:,} | {' | '.join(f'{flip:.3f}' for flip in found)} |")


if __name__ == "__main__":
    loaded = plants()
    draw(loaded["chestnut"])
    measure(loaded)
