"""
Draw what the documents show of leaf clusters: ``leaf_clusters.png``, ``alpha.png``, ``levels.png``.

Run it from the project's root: ``uv run python docs/images/make_leaf_clusters.py``. ``alpha.png``
takes two files of real plants as well, which `TREELOD_MODELS` says where to find, and some minutes.
Figures are printed as they come.
"""

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont

import treelod as tl
from treelod.color import composite, quantize, srgb_from_linear

MODELS = Path(__file__).parents[3] / "shared" / "models"
"""Real plants, where `TREELOD_MODELS` says nothing."""

HERE = Path(__file__).parent
BACKGROUND = (0.80, 0.86, 0.92)
"""Linear colour behind the plants."""

PANEL = (300, 370)
CAPTION = 30
SAMPLES = 64
COLORS = 192

ALPHAS = (0.0, 0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
SEEDS = (0, 1)
REAL_PLANTS = ("ez_oak_large/ez_oak_large.glb", "quaternius_common/CommonTree_1.gltf")
LEVELS = (128, 64, 32, 16, 8)


def picture(lod: Any, plant: tl.Plant, elevation_deg: float = 8.0) -> Image.Image:
    """Draw a technique so that the plant fills a panel."""
    center, _ = plant.sphere
    size = plant.bounds[1] - plant.bounds[0]
    up = np.deg2rad(elevation_deg)
    away = np.array([0.0, np.sin(up), np.cos(up)])
    width, height = PANEL
    fill = max(size[1], max(size[0], size[2]) * height / width) * 1.06
    eye = center + away * float(np.linalg.norm(size)) * 4
    camera = tl.Camera.orthographic(tuple(eye), tuple(center), height=float(fill), size=PANEL)
    color = tl.render(lod, camera, samples=SAMPLES).color
    return Image.fromarray(quantize(srgb_from_linear(np.clip(composite(color, BACKGROUND), 0, 1))))


def sheet(panels: list[tuple[str, Image.Image]], columns: int) -> Image.Image:
    """Set panels in rows, each with its caption."""
    width, height = PANEL
    rows = -(-len(panels) // columns)
    height += CAPTION
    sky = quantize(srgb_from_linear(np.array(BACKGROUND)))
    image = Image.new("RGB", (columns * width, rows * height), tuple(sky.tolist()))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=15)
    for number, (caption, panel) in enumerate(panels):
        x, y = number % columns * width, number // columns * height
        image.paste(panel, (x, y + CAPTION))
        draw.text((x + 8, y + 8), caption, fill=(20, 30, 40), font=font)
    return image.quantize(COLORS, dither=Image.Dither.NONE)


def show_techniques() -> None:
    """Write ``leaf_clusters.png``: the chestnut, its cards, and both kinds of texture."""
    plant = tl.grow_plant("chestnut")
    panels = [("full mesh", picture(tl.FullMesh.build(plant), plant))]
    for caption, params in {
        "128 cards": {"cluster_count": 128, "resolution": 256},
        "32 cards": {},
        "8 cards": {"cluster_count": 8},
        "32, indirect": {"texturing": "indirect"},
        "32, at the same bytes": {"resolution": 184},
    }.items():
        lod = tl.LeafClusters.build(plant, **params)
        size = lod.footprint.texture_bytes / 1e6
        print(f"{caption}: {size:.1f} MB", file=sys.stderr)
        panels.append((f"{caption}, {size:.1f} MB", picture(lod, plant)))
    sheet(panels, 3).save(HERE / "leaf_clusters.png", optimize=True)


def alpha_rows(plant: tl.Plant) -> Iterator[dict[str, Any]]:
    """Errors of a plant by weight and way of flattening, each the mean over views and seeds."""
    cameras = [
        camera
        for elevation in (0, 25)
        for camera in tl.orbit(
            plant, count=4, elevation_deg=elevation, distance=2.5, size=(320, 240)
        )
    ]
    full = tl.FullMesh.build(plant)
    references = [tl.render(full, camera, samples=16) for camera in cameras]
    for flatten in ("project", "rotate"):
        for alpha in ALPHAS:
            errors = []
            for seed in SEEDS:
                lod = tl.LeafClusters.build(
                    plant, alpha_rel=alpha, flatten=flatten, seed=seed, resolution=256
                )
                frames = [tl.render(lod, camera, samples=16) for camera in cameras]
                errors += map(tl.metrics.compare, references, frames)
            row = {
                "plant": plant.name,
                "flatten": flatten,
                "alpha_rel": alpha,
                "flip": float(np.mean([e.flip for e in errors])),
                "bias": float(np.mean([e.coverage_bias for e in errors])),
                "error": lod.level_errors[0],
            }
            print(row, file=sys.stderr, flush=True)
            yield row


def show_alpha() -> None:
    """Write ``alpha.png``: error and coverage against the weight of the angle."""
    models = Path(os.environ.get("TREELOD_MODELS") or MODELS)
    plants = [tl.grow_plant("chestnut"), *(tl.load_plant(models / name) for name in REAL_PLANTS)]
    with mpl.rc_context({"font.size": 9, "axes.spines.right": False, "axes.spines.top": False}):
        figure = Figure(figsize=(9.0, 5.0), layout="constrained")
        axes = figure.subplots(2, len(plants), sharex=True)
        for column, plant in enumerate(plants):
            rows = list(alpha_rows(plant))
            for flatten, color, marker in (("project", "#0072B2", "o"), ("rotate", "#D55E00", "s")):
                mine = [row for row in rows if row["flatten"] == flatten]
                # 0 has no logarithm: it stands a step to the left
                at = [max(row["alpha_rel"], 0.0003) for row in mine]
                for line, key in enumerate(("flip", "bias")):
                    values = [row[key] for row in mine]
                    axes[line][column].plot(at, values, color=color, marker=marker, label=flatten)
            axes[0][column].set_title(plant.name, loc="left", fontsize=9)
            axes[1][column].axhline(0.0, color="#888888", linewidth=0.7)
            axes[1][column].set_xscale("log")
            axes[1][column].set_xlabel("alpha_rel (leftmost: 0)")
        axes[0][0].set_ylabel("FLIP error, worse background")
        axes[1][0].set_ylabel("coverage bias")
        axes[0][0].legend(title="flatten", frameon=False)
        figure.savefig(HERE / "alpha.png", dpi=110)


def show_levels() -> None:
    """Write ``levels.png``: the levels where they are meant to be seen, and half way between."""
    plant = tl.grow_plant("chestnut")
    lod = tl.LeafClusters.build(plant, cluster_count=LEVELS, texturing="indirect")
    panels = []
    for level, count in enumerate(LEVELS):
        for t in (0.0, 0.5) if level + 1 < len(LEVELS) else (0.0,):
            caption = f"{count} cards" if t == 0.0 else f"on the way to {LEVELS[level + 1]}"
            panels.append((caption, picture(lod.at(level=level, t=t), plant)))
    sheet(panels[::2] + panels[1::2], len(LEVELS)).save(HERE / "levels.png", optimize=True)


def main() -> None:
    """Write the pictures that are named on the command line, or all."""
    every = {"leaf_clusters": show_techniques, "alpha": show_alpha, "levels": show_levels}
    for name in sys.argv[1:] or every:
        every[name]()


if __name__ == "__main__":
    main()
