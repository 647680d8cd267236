"""
Draw the pictures of the grown plants in the documents: ``plants.png`` and ``occlusion.png``.

Run it from the project's root: ``uv run python docs/images/make_plants.py``.
"""

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import treelod as tl
from treelod.color import composite, quantize, srgb_from_linear
from treelod.plants import PRESETS

HERE = Path(__file__).parent
PANEL = (300, 370)
BACKGROUND = (0.80, 0.86, 0.92)
"""Linear colour behind the plants."""

CAPTION = 30
"""Rows above a panel."""

SAMPLES = 64
COLORS = 192
"""Colours of a sheet's palette, which keeps the files small."""

AZIMUTHS = {"sunflower": 1, "palm": 2}
"""Where a plant shows its face, in eighths of a turn; elsewhere 0."""

OVERCAST = {"sun": (0.0, 0.0, 0.0), "sky": (0.85, 0.9, 0.95), "ground": (0.2, 0.18, 0.15)}


def picture(plant: tl.Plant, azimuth: int, elevation_deg: float = 8.0) -> Image.Image:
    """Draw a plant so that it fills a panel."""
    center, _ = plant.sphere
    size = plant.bounds[1] - plant.bounds[0]
    around = 2 * np.pi * azimuth / 8
    up = np.deg2rad(elevation_deg)
    away = np.array([np.sin(around) * np.cos(up), np.sin(up), np.cos(around) * np.cos(up)])
    width, height = PANEL
    fill = max(size[1], max(size[0], size[2]) * height / width) * 1.06
    eye = center + away * float(np.linalg.norm(size)) * 4
    camera = tl.Camera.orthographic(tuple(eye), tuple(center), height=float(fill), size=PANEL)
    color = tl.render(tl.FullMesh.build(plant), camera, samples=SAMPLES).color
    return Image.fromarray(quantize(srgb_from_linear(np.clip(composite(color, BACKGROUND), 0, 1))))


def sheet(panels: list[tuple[str, Image.Image]], columns: int) -> Image.Image:
    """Set panels in rows, each with its caption."""
    width, height = PANEL
    rows = -(-len(panels) // columns)
    height += CAPTION
    sky = quantize(srgb_from_linear(np.array(BACKGROUND)))
    image = Image.new("RGB", (columns * width, rows * height), tuple(sky.tolist()))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=17)
    for number, (caption, panel) in enumerate(panels):
        x, y = number % columns * width, number // columns * height
        image.paste(panel, (x, y + CAPTION))
        draw.text((x + 10, y + 8), caption, fill=(20, 30, 40), font=font)
    return image.quantize(COLORS, dither=Image.Dither.NONE)


def main() -> None:
    """Write both pictures."""
    panels = []
    for preset in PRESETS:
        plant = tl.grow_plant(preset)
        height = plant.bounds[1, 1]
        shown = f"{height:.1f} m" if height >= 1 else f"{height * 100:.0f} cm"
        panels.append((f"{preset}, {shown}", picture(plant, AZIMUTHS.get(preset, 0))))
    sheet(panels, 4).save(HERE / "plants.png", optimize=True)

    plant = tl.grow_plant("chestnut")
    panels = [
        (
            f"{light}, occlusion {occlusion:g}",
            picture(plant.lit(tl.Lighting(occlusion=occlusion, **colors)), 4),
        )
        for light, colors in (("sun from behind", {}), ("overcast", OVERCAST))
        for occlusion in (0.0, 1.0)
    ]
    sheet(panels, 4).save(HERE / "occlusion.png", optimize=True)


if __name__ == "__main__":
    main()
