"""
Draw the picture and measure the table of `docs/simplified_mesh.md`.

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

WIDTH, HEIGHT, CAPTION = 220, 230, 16
COLUMNS = [
    ("full mesh", None),
    ("simplify, 20 %", {"keep_fraction": 0.2}),
    ("simplify, 5 %", {"keep_fraction": 0.05}),
    ("attributes, 5 %", {"keep_fraction": 0.05, "method": "attributes"}),
    ("sloppy, 20 %", {"keep_fraction": 0.2, "method": "sloppy"}),
    ("sloppy, 5 %", {"keep_fraction": 0.05, "method": "sloppy"}),
]


def plants() -> dict[str, tl.Plant]:
    """Load the three crowns: of blades, of crossed cards, of large cards."""
    return {
        "chestnut": tl.grow_plant("chestnut"),
        "ez_oak_large": tl.load_plant(MODELS / "ez_oak_large" / "ez_oak_large.glb"),
        "CommonTree_1": tl.load_plant(MODELS / "quaternius_common" / "CommonTree_1.gltf"),
    }


def on_white(frame: tl.Frame) -> Image.Image:
    """Composite a frame on white."""
    color = frame.color[..., :3] + 1.0 - frame.color[..., 3:]
    return Image.fromarray((srgb_from_linear(np.clip(color, 0, 1)) * 255 + 0.5).astype(np.uint8))


def draw(rows: dict[str, tl.Plant]) -> None:
    """Draw one row a plant, one column a method."""
    sheet = Image.new("RGB", (WIDTH * len(COLUMNS), (HEIGHT + CAPTION) * len(rows)), "white")
    canvas = ImageDraw.Draw(sheet)
    for row, plant in enumerate(rows.values()):
        top = row * (HEIGHT + CAPTION)
        camera = tl.orbit(plant, count=1, elevation_deg=10, distance=2.5, size=(WIDTH, HEIGHT))[0]
        for column, (label, params) in enumerate(COLUMNS):
            if params is None:
                lod, count = tl.FullMesh.build(plant), len(plant.foliage.mesh.triangles)
            else:
                lod = tl.SimplifiedMesh.build(plant, **params)
                count = lod.triangle_count
            picture = on_white(tl.render(lod, camera, samples=64))
            sheet.paste(picture, (column * WIDTH, top + CAPTION))
            canvas.text((column * WIDTH + 6, top + 2), f"{label}: {count:,}", fill="black")
    picture = sheet.quantize(128, dither=Image.Dither.NONE)
    picture.save(Path(__file__).with_name("simplified_mesh.png"), optimize=True)


def measure(rows: dict[str, tl.Plant]) -> None:
    """Print the table, a line of Markdown a method and share."""
    for name, plant in rows.items():
        total = len(plant.foliage.mesh.triangles)
        cameras = [
            camera
            for elevation in (0, 25)
            for camera in tl.orbit(
                plant, count=4, elevation_deg=elevation, distance=2.5, size=(512, 384)
            )
        ]
        references = [tl.render(tl.FullMesh.build(plant), camera, samples=64) for camera in cameras]
        for fraction in (0.5, 0.2, 0.05):
            for method in ("simplify", "attributes", "sloppy"):
                lod = tl.SimplifiedMesh.build(plant, keep_fraction=fraction, method=method)
                errors = [
                    tl.metrics.compare(reference, tl.render(lod, reference.camera, samples=64))
                    for reference in references
                ]
                flip = np.mean([error.flip for error in errors])
                bias = np.mean([error.coverage_bias for error in errors])
                covered = np.mean([_covered(reference) for reference in references])
                left = lod.triangle_count / total
                print(
                    f"| {name} | {fraction:.0%} | {method} | {lod.triangle_count:,} ({left:.1%}) "
                    f"| {lod.error:.3g} | {flip:.3f} | {bias:+.3f} | {bias / covered:+.0%} |"
                )


def _covered(frame: tl.Frame) -> float:
    """Return mean coverage over the part that metrics look at."""
    left, top, right, bottom = frame.bounds_px
    width, height = frame.camera.size
    rows = slice(max(top - 8, 0), min(bottom + 8, height))
    columns = slice(max(left - 8, 0), min(right + 8, width))
    return float(frame.color[rows, columns, 3].mean())


if __name__ == "__main__":
    found = plants()
    draw(found)
    measure(found)
