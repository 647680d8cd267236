"""
Draw the pictures and measure the tables of `docs/layered_billboards.md`.

Needs the real plants: TREELOD_MODELS, else `shared/models` beside the project. With names as
arguments it makes those alone: picture, layers, wind, sideways, baked, table.
"""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw

import treelod as tl
from treelod.color import srgb_from_linear

mpl.use("agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).parents[2]
MODELS = Path(os.environ.get("TREELOD_MODELS") or ROOT.parent / "shared" / "models")
HERE = Path(__file__).parent

WIDTH, HEIGHT, CAPTION = 210, 230, 16
DISTANCE = 2.6
"""From the plant's centre, in radii of its sphere."""

SIZE, SAMPLES = (256, 192), 16
"""Of the pictures whose errors are measured."""

BAKED = 256
"""Texels of layers that are seen from where they were baked, a pixel a texel."""

STORED = 0.0046
"""Half a code of 8-bit sRGB in linear light, at most."""

KINDS: dict[str, dict[str, Any]] = {
    "branches": {},
    "slabs": {"groups": "slabs"},
    "turning, on a mesh": {"turn": "viewer"},
}


def plants() -> dict[str, Callable[[], tl.Plant]]:
    """Name a grown tree, a conifer and two real trees."""
    return {
        "chestnut": lambda: tl.grow_plant("chestnut", seed=1),
        "pine": lambda: tl.grow_plant("pine", seed=1),
        "ez_oak_large": lambda: tl.load_plant(MODELS / "ez_oak_large" / "ez_oak_large.glb"),
        "CommonTree_1": lambda: tl.load_plant(MODELS / "quaternius_common" / "CommonTree_1.gltf"),
    }


def camera(plant: tl.Plant, azimuth_deg: float, size: tuple[int, int]) -> tl.Camera:
    """Look at a plant's middle from an azimuth."""
    center, radius = plant.sphere
    azimuth = np.radians(azimuth_deg)
    toward = np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    eye = np.asarray(center) + DISTANCE * radius * toward
    return tl.Camera.perspective(tuple(eye), tuple(center), fov_y_deg=45, size=size)


def baked_view(lod: tl.LayeredBillboards) -> tl.Camera:
    """Look along the direction of the bake, in parallel, with a pixel for each texel."""
    shown = [layer for layer in lod.layers if layer.corners is not None]
    corners = np.concatenate([layer.corners for layer in shown if layer.corners is not None])
    low, high = corners.min(axis=0), corners.max(axis=0)
    first = shown[0]
    assert first.corners is not None, "it shows something"
    assert first.texels is not None, "so it has texels"
    texel = (first.corners[1, 0] - first.corners[0, 0]) / first.texels[2]
    width, height = np.round((high - low)[:2] / texel).astype(int)
    x, y, _ = (low + high) / 2
    return tl.Camera.orthographic(
        (x, y, high[2] + 20),
        (x, y, 0),
        height=float(high[1] - low[1]),
        size=(int(width), int(height)),
    )


def sideways(plant: tl.Plant, angle_deg: float, size: tuple[int, int]) -> tl.Camera:
    """
    Move across the direction of the bake until a plant is seen at an angle, and look at it.

    The view narrows as the plant gets farther, which keeps its size on the picture: a smaller one
    has a smaller error whatever is drawn.
    """
    center, radius = plant.sphere
    angle = np.radians(angle_deg)
    eye = np.asarray(center) + DISTANCE * radius * np.array([np.tan(angle), 0.0, 1.0])
    fov_y = 2 * np.arctan(np.tan(np.radians(22.5)) * np.cos(angle))
    return tl.Camera.perspective(
        tuple(eye), tuple(center), fov_y_deg=float(np.degrees(fov_y)), size=size
    )


def on_white(frame: tl.Frame) -> Image.Image:
    """Composite a frame on white."""
    color = frame.color[..., :3] + 1.0 - frame.color[..., 3:]
    return Image.fromarray((srgb_from_linear(np.clip(color, 0, 1)) * 255 + 0.5).astype(np.uint8))


def picture() -> None:
    """Draw the chestnut: its mesh and three kinds of layers, from the front and from aside."""
    plant = plants()["chestnut"]()
    lods = {"full mesh": tl.FullMesh.build(plant)}
    for label, params in KINDS.items():
        lods[label] = tl.LayeredBillboards.build(plant, **params)
    angles = (0, 10, 20, 40)
    sheet = Image.new("RGB", (WIDTH * len(lods), (HEIGHT + CAPTION) * len(angles)), "white")
    canvas = ImageDraw.Draw(sheet)
    for row, angle in enumerate(angles):
        for column, (label, lod) in enumerate(lods.items()):
            at = (column * WIDTH, row * (HEIGHT + CAPTION))
            frame = tl.render(lod, camera(plant, angle, (WIDTH, HEIGHT)), samples=64)
            sheet.paste(on_white(frame), (at[0], at[1] + CAPTION))
            canvas.text((at[0] + 6, at[1] + 2), f"{label}, {angle} degrees", fill="black")
    quantised = sheet.quantize(128, dither=Image.Dither.NONE)
    quantised.save(HERE / "layered_billboards.png", optimize=True)


def layers() -> None:
    """Draw the chestnut's layers side by side, each with its anchor."""
    plant = plants()["chestnut"]()
    lod = tl.LayeredBillboards.build(plant, layer_count=9, resolution=220)
    texture = lod.textures[0].levels[0]
    tiles = []
    for layer in lod.layers:
        assert layer.texels is not None, "wood is baked, so every layer shows something"
        assert layer.corners is not None, "wood is baked, so every layer shows something"
        x, y, width, height = layer.texels
        tile = Image.new("RGB", (width + 8, height + CAPTION + 8), "white")
        tile.paste(
            Image.fromarray(texture[y : y + height, x : x + width, :3]),
            (4, CAPTION),
            Image.fromarray(texture[y : y + height, x : x + width, 3]),
        )
        texel = (layer.corners[1, 0] - layer.corners[0, 0]) / width
        across = (layer.anchor[0] - layer.corners[0, 0]) / texel + 4
        down = (layer.corners[3, 1] - layer.anchor[1]) / texel + CAPTION
        canvas = ImageDraw.Draw(tile)
        canvas.text((4, 2), layer.name, fill="black")
        canvas.ellipse((across - 3, down - 3, across + 3, down + 3), outline="red", width=2)
        tiles.append(tile)
    width = sum(tile.width for tile in tiles)
    sheet = Image.new("RGB", (width, max(tile.height for tile in tiles)), "white")
    left = 0
    for tile in tiles:
        sheet.paste(tile, (left, 0))
        left += tile.width
    quantised = sheet.quantize(128, dither=Image.Dither.NONE)
    quantised.save(HERE / "layered_billboards_layers.png", optimize=True)


def wind() -> None:
    """Draw a swing of two chestnuts, as an animated PNG."""
    plant = plants()["chestnut"]()
    lod = tl.LayeredBillboards.build(plant)
    beside = np.eye(4)
    beside[0, 3] = 9.0
    blowing = tl.Wind(sway=0.03, lean=0.03, period_secs=3.0, seed=2)
    scene = tl.Scene([(lod, [np.eye(4), beside])], wind=blowing)
    center, radius = plant.sphere
    target = np.asarray(center) + np.array([4.5, 0.0, 0.0])
    eye = target + np.array([0.0, 0.0, 3.0 * radius])
    view = tl.Camera.perspective(tuple(eye), tuple(target), fov_y_deg=45, size=(320, 220))
    count = 24
    frames = []
    for step in range(count):
        frame = tl.render(scene, view.at(3.0 * step / count), samples=16)
        frames.append(on_white(frame))
    # one palette for all, or colours would flicker
    palette = frames[0].quantize(48, dither=Image.Dither.NONE)
    stills = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    path = HERE / "layered_billboards_wind.png"
    stills[0].save(
        path, save_all=True, append_images=stills[1:], duration=3000 // count, loop=0, optimize=True
    )
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


def plot() -> None:
    """Plot the error against the angle that a viewer has moved aside by."""
    angles = np.arange(0, 61, 5)
    kinds: dict[str, dict[str, Any]] = {
        "branches": {},
        "branches, not tilted": {"tilt": False},
        "slabs": {"groups": "slabs"},
        "turning, on a mesh": {"turn": "viewer"},
    }
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), sharey=True, layout="constrained")
    for axis, name in zip(axes, ("chestnut", "ez_oak_large"), strict=True):
        plant = plants()[name]()
        full = tl.FullMesh.build(plant)
        lods: dict[str, tl.techniques.Technique] = {
            label: tl.LayeredBillboards.build(plant, **params) for label, params in kinds.items()
        }
        lods["slicings, 6 x 5"] = tl.Slicings.build(plant)
        flips: dict[str, list[float]] = {label: [] for label in lods}
        for angle in angles:
            view = sideways(plant, float(angle), SIZE)
            reference = tl.render(full, view, samples=SAMPLES)
            for label, lod in lods.items():
                errors = tl.metrics.compare(reference, tl.render(lod, view, samples=SAMPLES))
                flips[label].append(errors.flip)
        for label, values in flips.items():
            style = "--" if label.startswith("slicings") else "-"
            axis.plot(angles, values, style, label=label)
            print(name, label, " ".join(f"{value:.3f}" for value in values))
        axis.set(title=name, xlabel="moved aside by, degrees", ylim=(0, None))
        axis.grid(visible=True, alpha=0.3)
    axes[0].set_ylabel("FLIP")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), fontsize=8)
    figure.savefig(HERE / "layered_billboards_sideways.png", dpi=110)


def baked() -> None:
    """Print what is wrong where layers were baked from, a pixel a texel and a sample each."""
    for name, grow in plants().items():
        plant = grow()
        full = tl.FullMesh.build(plant)
        for count in (10, 25, 50):
            cells = []
            for groups in ("slabs", "branches"):
                lod = tl.LayeredBillboards.build(
                    plant, groups=groups, layer_count=count, resolution=BAKED, samples=1
                )
                view = baked_view(lod)
                reference = tl.render(full, view, samples=1)
                found = tl.render(lod, view, samples=1)
                unlike = np.abs(found.color - reference.color).max(axis=2) > STORED
                covered = reference.color[..., 3] > 0.5
                outline = ((found.color[..., 3] > 0.5) != covered).sum()
                flip = tl.metrics.compare(reference, found).flip
                cells += [f"{unlike.sum() / covered.sum():.2%}", f"{flip:.4f}", f"{outline}"]
            print(f"| {name} | {count} | {covered.sum()} | {' | '.join(cells)} |", flush=True)


def table() -> None:
    """Print errors at the direction of the bake and aside, bytes and build seconds, as Markdown."""
    rows: dict[str, dict[str, Any]] = {
        "branches": {},
        "branches, 10 layers": {"layer_count": 10},
        "branches, 50 layers": {"layer_count": 50},
        "branches, not tilted": {"tilt": False},
        "branches, tested": {"drawing": "test"},
        "branches, wood a mesh": {"wood_as": "mesh"},
        "slabs": {"groups": "slabs"},
        "slabs, 10 layers": {"groups": "slabs", "layer_count": 10},
        "turning, on a mesh": {"turn": "viewer"},
    }
    for name, grow in plants().items():
        plant = grow()
        full = tl.FullMesh.build(plant)
        views = [sideways(plant, angle, SIZE) for angle in (0, 10, 20, 40)]
        views.append(camera(plant, 90, SIZE))
        references = [tl.render(full, view, samples=SAMPLES) for view in views]
        for label, params in rows.items():
            lod = tl.LayeredBillboards.build(plant, **params)
            errors = [
                tl.metrics.compare(reference, tl.render(lod, reference.camera, samples=SAMPLES))
                for reference in references
            ]
            cells = [f"{error.flip:.3f}" for error in errors]
            print(
                f"| {name} | {label} | {' | '.join(cells)} | {errors[0].coverage_bias:+.3f} "
                f"| {lod.footprint.cards} | {lod.footprint.total_bytes / 1e6:.1f} "
                f"| {lod.build_secs:.2f} |",
                flush=True,
            )


MAKERS = {
    "picture": picture,
    "layers": layers,
    "wind": wind,
    "sideways": plot,
    "baked": baked,
    "table": table,
}

if __name__ == "__main__":
    for wanted in sys.argv[1:] or MAKERS:
        MAKERS[wanted]()
