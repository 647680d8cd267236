"""
Measure and draw what `docs/billboard.md` shows.

Run it from the project's root: ``uv run python docs/images/make_billboard.py``, with the names of
some of its jobs, or none for all. Figures are printed as they come, a line of Markdown each;
``billboard.png``, ``billboard_forest.png`` and ``billboard_wind.png`` are written. Needs the real
plants: TREELOD_MODELS, else `shared/models` beside the project.
"""

import colorsys
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

import treelod as tl
from treelod.color import composite, linear_from_srgb, quantize, srgb_from_linear

ROOT = Path(__file__).parents[2]
MODELS = Path(os.environ.get("TREELOD_MODELS") or ROOT.parent / "shared" / "models")
HERE = Path(__file__).parent
BACKGROUND = (0.80, 0.86, 0.92)
"""Linear colour behind the plants."""

SIZE = (512, 384)
SAMPLES = 16
AZIMUTHS = 7
"""Prime to all counts of pictures, so that views lie at all angles from them."""

DISTANCES = (2.5, 10.0, 40.0)


def plants() -> dict[str, tl.Plant]:
    """Load a grown and a real tree."""
    return {
        "chestnut": tl.grow_plant("chestnut", seed=1),
        "ez_oak_large": tl.load_plant(MODELS / "ez_oak_large" / "ez_oak_large.glb"),
    }


class Judge:
    """Compares techniques with the full mesh of one plant, from all around."""

    def __init__(self, plant: tl.Plant, distance: float, elevations: tuple[float, ...]) -> None:
        full = tl.FullMesh.build(plant)
        # far away only the middle of the picture is needed
        side = min(1.0, 8.0 / distance)
        size = (max(32, int(SIZE[0] * side)), max(32, int(SIZE[1] * side)))
        fov = 2 * np.arctan(np.tan(np.deg2rad(22.5)) * size[1] / SIZE[1])
        self.references = []
        for elevation in elevations:
            for near in tl.orbit(plant, AZIMUTHS, elevation, distance):
                camera = tl.Camera.perspective(
                    near.eye, near.target, fov_y_deg=float(np.rad2deg(fov)), size=size
                )
                self.references.append(tl.render(full, camera, samples=SAMPLES))

    def of(self, lod: Any) -> str:
        """Mean FLIP and mean coverage bias of a technique, as a cell."""
        errors = [
            tl.metrics.compare(frame, tl.render(lod, frame.camera, samples=SAMPLES))
            for frame in self.references
        ]
        flip = np.mean([error.flip for error in errors])
        bias = np.mean([error.coverage_bias for error in errors])
        return f"{flip:.3f} / {bias:+.3f}"


def kib(lod: Any) -> str:
    """Bytes of textures."""
    return f"{lod.footprint.texture_bytes / 1024:,.0f}"


def sizes() -> None:
    """Print triangles and bytes of both trees, and of their billboards."""
    for name, plant in plants().items():
        for lod in (tl.FullMesh.build(plant), tl.Billboard.build(plant)):
            frame = tl.render(lod, tl.orbit(plant, 1)[0], samples=1)
            geometry = f"{lod.footprint.geometry_bytes / 1024:,.1f}"
            cells = f"{frame.stats.triangles:,} | {geometry} | {kib(lod)} | {lod.build_secs:.2f}"
            print(f"| {name} | `{lod.name}` | {cells} |", flush=True)


def by_distance(rows: str, settings: list[tuple[str, dict[str, Any]]]) -> None:
    """Print a row of errors for each setting, level and from all around."""
    for name, plant in plants().items():
        judges = [Judge(plant, distance, (0.0,)) for distance in DISTANCES]
        for label, params in settings:
            lod = tl.Billboard.build(plant, **params)
            cells = " | ".join(judge.of(lod) for judge in judges)
            print(f"| {name} | {label} | {kib(lod)} | {cells} |", flush=True)
    print(f"({rows})")


def views() -> None:
    """Print error against the number of pictures, shown nearest and cross-faded."""
    settings: list[tuple[str, dict[str, Any]]] = [
        (f"{count} | {blend}", {"view_count": count, "view_blend": blend})
        for count in (1, 2, 4, 8, 16, 32)
        for blend in ("nearest", "cross_fade")
    ]
    by_distance("view_count, view_blend", settings)


def resolutions() -> None:
    """Print error against texels."""
    settings = [(f"{side}", {"resolution": side}) for side in (32, 64, 128, 256, 512, 1024)]
    by_distance("resolution", settings)


def drawings() -> None:
    """Print error of tested, covering and blended quads."""
    by_distance(
        "drawing", [(f"`'{name}'`", {"drawing": name}) for name in ("test", "coverage", "blend")]
    )


def formats() -> None:
    """Print error of every format of texels."""
    names = ("rgba8", "rgb5a1", "rgb8", "palette8", "bc1", "bc3", "bc7")
    by_distance("format", [(f"`'{name}'`", {"format": name}) for name in names])


def alignments() -> None:
    """Print error of axes and rings by elevation, and of alignments off the picture's middle."""
    for name, plant in plants().items():
        judges = [Judge(plant, 10.0, (high,)) for high in (0.0, 12.0, 25.0, 50.0, 80.0)]
        for label, params in (
            ("vertical", {}),
            ("free", {"axis": "free"}),
            ("free, 0/25/50/80", {"axis": "free", "elevations_deg": (0.0, 25.0, 50.0, 80.0)}),
        ):
            lod = tl.Billboard.build(plant, **params)
            cells = " | ".join(judge.of(lod) for judge in judges)
            print(f"| {name} | {label} | {kib(lod)} | {cells} |", flush=True)
        center, radius = plant.sphere
        full = tl.FullMesh.build(plant)
        for distance in (2.0, 4.0, 10.0):
            cells = []
            for params in (
                {"align": "camera"},
                {"align": "limited", "max_turn_deg": 15.0},
                {"align": "view_plane"},
            ):
                lod = tl.Billboard.build(plant, view_count=16, **params)
                flips = []
                for azimuth in range(0, 360, 45):
                    angle = np.deg2rad(azimuth)
                    out = np.array([np.sin(angle), 0.0, np.cos(angle)])
                    aside = np.array([out[2], 0.0, -out[0]])
                    eye = np.asarray(center) + out * (distance * radius)
                    # 30 degrees off the middle of a wide picture
                    target = eye - out + aside * np.tan(np.deg2rad(30.0))
                    camera = tl.Camera.perspective(
                        tuple(eye), tuple(target), fov_y_deg=70.0, size=(512, 288)
                    )
                    reference = tl.render(full, camera, samples=SAMPLES)
                    shown = tl.render(lod, camera, samples=SAMPLES)
                    flips.append(tl.metrics.compare(reference, shown).flip)
                cells.append(f"{np.mean(flips):.3f}")
            print(f"| {name} | {distance:g} | {' | '.join(cells)} |", flush=True)


def popping() -> None:
    """Print how much a picture changes where the nearest picture becomes another."""
    for name, plant in plants().items():
        for count in (8, 16, 32):
            cells = []
            for blend in ("nearest", "cross_fade"):
                lod = tl.Billboard.build(plant, view_count=count, view_blend=blend)
                center, radius = plant.sphere
                flips = []
                for number in range(4):
                    frames = []
                    for side in (-0.01, 0.01):
                        angle = np.deg2rad((number + 0.5) * 360 / count + side)
                        out = np.array([np.sin(angle), 0.0, np.cos(angle)]) * (10 * radius)
                        camera = tl.Camera.perspective(
                            np.asarray(center) + out, tuple(center), size=SIZE
                        )
                        frames.append(tl.render(lod, camera, samples=SAMPLES))
                    # a fiftieth of a degree of parallax is left
                    after = replace(frames[1], camera=frames[0].camera)
                    flips.append(tl.metrics.compare(frames[0], after).flip)
                cells.append(f"{np.mean(flips):.3f}")
            print(f"| {name} | {count} | {' | '.join(cells)} |", flush=True)


def hues() -> None:
    """Print how far a tint is from turning every hue."""
    for name, plant in plants().items():
        lod = tl.Billboard.build(plant, view_count=1)
        texels = lod.textures[0].levels[0].reshape(-1, 4)
        texels = np.unique(texels[texels[:, 3] > 128][:, :3], axis=0) / 255.0
        rng = np.random.default_rng(1)
        texels = texels[rng.permutation(len(texels))[:4000]]
        mean = linear_from_srgb(texels).mean(axis=0)
        print(f"{name}: mean linear colour {np.round(mean, 3)}")
        variety = tl.Variety(size=0, hue_deg=20.0, value=0, mirror=False)
        base = colorsys.rgb_to_hsv(*srgb_from_linear(np.array(variety.color)))[0]
        for copy in range(6):
            tint = np.array(variety.of(0, copy).tint)
            target = srgb_from_linear(np.array(variety.color) * tint)
            angle = (colorsys.rgb_to_hsv(*target)[0] - base) * 360
            tinted = srgb_from_linear(np.clip(linear_from_srgb(texels) * tint, 0, 1))
            turns = []
            for before, after in zip(texels, tinted, strict=True):
                a, b = colorsys.rgb_to_hsv(*before), colorsys.rgb_to_hsv(*after)
                if a[1] > 0.1:
                    turns.append(((b[0] - a[0]) * 360 + 180) % 360 - 180)
            low, middle, high = np.quantile(turns, [0.05, 0.5, 0.95])
            print(f"| {name} | {angle:+.1f} | {middle:+.1f} | {low:+.1f} to {high:+.1f} |")


def forest() -> None:
    """Write ``billboard_forest.png`` and print items, textures and milliseconds of a forest."""
    species = [
        tl.grow_plant(preset, seed=seed)
        for preset, seed in (("chestnut", 1), ("broadleaf", 2), ("pine", 3))
    ]
    heights = [plant.bounds[1][1] - plant.bounds[0][1] for plant in species]
    transforms = tl.scatter(1000, 0.8 * float(np.mean(heights)), seed=4)
    reach = float(np.abs(transforms[:, [0, 2], 3]).max())
    camera = tl.Camera.perspective(
        (0.0, 0.25 * reach, 1.15 * reach), (0.0, 0.0, 0.2 * reach), size=(900, 420)
    )
    wind, variety = tl.Wind(), tl.Variety()
    together: list[Any] = list(tl.Billboard.forest(species))
    apart: list[Any] = [tl.Billboard.build(plant) for plant in species]
    meshes: list[Any] = [tl.FullMesh.build(plant) for plant in species]
    built = {"one texture": together, "a texture each": apart, "full mesh": meshes}
    for drawing in ("test", "coverage"):
        built[f"one texture, {drawing}"] = list(tl.Billboard.forest(species, drawing=drawing))
    scenes: dict[str, Any] = {}
    for label, lods in built.items():
        groups = [(lod, transforms[k :: len(species)]) for k, lod in enumerate(lods)]
        scenes[label] = tl.Scene(groups, wind=wind, variety=variety)
    frames = {label: tl.render(scene, camera) for label, scene in scenes.items()}
    for label in ("one texture", "a texture each"):
        total = sum(lod.footprint.texture_bytes for lod in built[label])
        print(f"{label}: {total / 1024:,.0f} KiB of textures")
    cheap = {label: scene for label, scene in scenes.items() if label != "full mesh"}
    millis = tl.time_frames(cheap, camera)
    millis |= tl.time_frames({"full mesh": scenes["full mesh"]}, camera, warmup=0, repeats=1)
    for label, frame in frames.items():
        stats = frame.stats
        print(
            f"| {label} | {stats.items} | {stats.textures} | {stats.triangles:,} "
            f"| {np.median(millis[label]):.0f} |",
            flush=True,
        )
    sheet = Image.new("RGB", (900, 840), "white")
    for row, label in enumerate(("full mesh", "one texture")):
        sheet.paste(picture(frames[label]), (0, 420 * row))
    sheet.quantize(128, dither=Image.Dither.NONE).save(HERE / "billboard_forest.png", optimize=True)


def picture(frame: tl.Frame) -> Image.Image:
    """Composite a frame on the sky."""
    color = np.clip(composite(frame.color, BACKGROUND), 0, 1)
    return Image.fromarray(quantize(srgb_from_linear(color)))


def wind() -> None:
    """Write ``billboard_wind.png``: the mesh and its billboard at four moments of a swing."""
    plant = tl.grow_plant("chestnut", seed=1)
    camera = tl.orbit(plant, 1, distance=2.6, size=(220, 240))[0]
    sheet = Image.new("RGB", (880, 480), "white")
    for row, lod in enumerate((tl.FullMesh.build(plant), tl.Billboard.build(plant))):
        scene = tl.Scene([(lod, None)], wind=tl.Wind(sway=0.12))
        for column in range(4):
            frame = tl.render(scene, camera.at(float(column)), samples=16)
            sheet.paste(picture(frame), (220 * column, 240 * row))
    sheet.quantize(128, dither=Image.Dither.NONE).save(HERE / "billboard_wind.png", optimize=True)


def pictures() -> None:
    """Write ``billboard.png``: both trees beside their billboards, from near to far."""
    columns = [
        ("full mesh", None),
        ("blend", {}),
        ("test", {"drawing": "test"}),
        ("coverage", {"drawing": "coverage"}),
        ("cross-fade", {"view_blend": "cross_fade"}),
    ]
    # radii, and how often a pixel of a picture of 768 rows is shown
    rows = [(2.5, 1), (10.0, 1), (40.0, 4)]
    side, caption = 220, 16
    found = plants()
    high = (side + caption) * len(rows)
    sheet = Image.new("RGB", (side * len(columns), high * len(found)), "white")
    canvas = ImageDraw.Draw(sheet)
    top = 0
    for plant in found.values():
        lods: list[Any] = [
            tl.FullMesh.build(plant) if params is None else tl.Billboard.build(plant, **params)
            for _, params in columns
        ]
        for distance, zoom in rows:
            window = side // zoom
            for column, (label, _) in enumerate(columns):
                # 17 degrees from a picture, of 22.5 at most
                near = tl.orbit(plant, 21, 8.0, distance)[1]
                fov = 2 * np.arctan(np.tan(np.deg2rad(22.5)) * window / 768)
                camera = tl.Camera.perspective(
                    near.eye, near.target, fov_y_deg=float(np.rad2deg(fov)), size=(window, window)
                )
                frame = picture(tl.render(lods[column], camera, samples=16))
                frame = frame.resize((side, side), Image.Resampling.NEAREST)
                sheet.paste(frame, (column * side, top + caption))
                text = f"{label}, {distance:g} radii"
                canvas.text((column * side + 6, top + 2), text, fill="black")
            top += side + caption
    sheet.quantize(192, dither=Image.Dither.NONE).save(HERE / "billboard.png", optimize=True)


JOBS = {
    job.__name__: job
    for job in (
        pictures,
        sizes,
        views,
        resolutions,
        drawings,
        formats,
        alignments,
        popping,
        hues,
        forest,
        wind,
    )
}


def main() -> None:
    """Do the jobs that were named, or all."""
    for name in sys.argv[1:] or JOBS:
        print(f"--- {name}", flush=True)
        JOBS[name]()


if __name__ == "__main__":
    main()
