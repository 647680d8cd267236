"""
Measure the tables of `docs/slicings.md` and `docs/orthogonal_slices.md`, and draw their pictures.

Run it from the project's root: ``uv run python docs/images/make_slices.py``, with any of
``options``, ``levels``, ``laws``, ``orders``, ``azimuths``, ``slicings`` and ``pictures`` for a
part of it. Real plants are looked for where `TREELOD_MODELS` says, else in `shared/models` beside
the project. Tables are printed as they come.
"""

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import treelod as tl
from treelod.color import composite, quantize, srgb_from_linear

HERE = Path(__file__).parent
MODELS = Path(os.environ.get("TREELOD_MODELS") or HERE.parents[2] / "shared" / "models")

SIZE = (256, 192)
SAMPLES = 16
BACKGROUND = (0.80, 0.86, 0.92)
"""Linear colour behind the plants."""
PANEL = (230, 260)
CAPTION = 24
COLORS = 224

OPTIONS: dict[str, dict[str, Any]] = {
    "6 x 5, as by default": {},
    "`drop_back=1`": {"drop_back": 1},
    "`drop_back=2`": {"drop_back": 2},
    "3 slices": {"slice_count": 3},
    "1 slice": {"slice_count": 1},
    "`mirrored=True`": {"mirrored": True},
    "`vertical=True`": {"vertical": True},
    "`sub_slices=2`": {"sub_slices": 2},
    "`sub_slices=4`": {"sub_slices": 4},
    "`quadtree=16`": {"quadtree": 16},
    "`quadtree=32`": {"quadtree": 32},
    "`quadtree=64`": {"quadtree": 64},
    '`format="rgb5a1"`': {"format": "rgb5a1"},
    "`branch_level=1`": {"branch_level": 1},
    "`branch_level=2`": {"branch_level": 2},
}

LAWS: dict[str, dict[str, Any]] = {
    "linear": {"blend": "linear"},
    "power, k = 1": {"k": 1.0},
    "power, k = 2": {"k": 2.0},
    "power, k = 4": {"k": 4.0},
}


def plants() -> dict[str, tl.Plant]:
    """Load a grown tree, and one of leaf cards."""
    return {
        "chestnut": tl.grow_plant("chestnut"),
        "CommonTree_1": tl.load_plant(MODELS / "quaternius_common" / "CommonTree_1.gltf"),
    }


def orbit(plant: tl.Plant, elevation: float, distance: float = 2.5) -> list[Any]:
    """Three cameras: 0, 15 and 30 degrees from a slicing of six, or from an axis of two."""
    circle = tl.orbit(plant, count=24, elevation_deg=elevation, distance=distance, size=SIZE)
    return [circle[0], circle[5], circle[14]]


def baked_bytes(lod: Any) -> int:
    """Bytes of the textures that were baked, without those of the plant itself."""
    own = sum(level.nbytes for t in lod.textures if t.corners is None for level in t.levels)
    return int(lod.footprint.texture_bytes - own)


def errors(
    plant: tl.Plant, cases: Mapping[str, Any], cameras: Mapping[str, Sequence[Any]]
) -> dict[str, dict[str, tuple[float, float, float, float]]]:
    """FLIP, bias, fragments and cards of each case, each the mean over a set of cameras."""
    full = tl.FullMesh.build(plant)
    found: dict[str, dict[str, tuple[float, float, float, float]]] = {name: {} for name in cases}
    for which, views in cameras.items():
        rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in cases}
        for camera in views:
            reference = tl.render(full, camera, samples=SAMPLES)
            for name, lod in cases.items():
                frame = tl.render(lod, camera, samples=SAMPLES)
                error = tl.metrics.compare(reference, frame)
                stats = frame.stats
                row = (error.flip, error.coverage_bias, float(stats.fragments), float(stats.cards))
                rows[name].append(row)
        for name, values in rows.items():
            means = np.mean(values, axis=0)
            found[name][which] = (means[0], means[1], means[2], means[3])
    return found


def millis(cases: Mapping[str, Any], camera: Any) -> dict[str, float]:
    """Frame times over that of the first case."""
    times = tl.time_frames(cases, camera, samples=4, warmup=1, repeats=7)
    median = {name: float(np.median(each)) for name, each in times.items()}
    first = next(iter(median.values()))
    return {name: value / first for name, value in median.items()}


def show_options() -> None:
    """Print what each option of slicings costs and gives, for two plants."""
    for name, plant in plants().items():
        cases = {}
        for label, params in OPTIONS.items():
            if "branch_level" in params and name != "chestnut":
                continue
            cases[label] = tl.Slicings.build(plant, **params)
        # from close by, too
        cameras = {"0": orbit(plant, 0), "25": orbit(plant, 25), "60": orbit(plant, 60)}
        near = {"near": orbit(plant, 10, distance=1.3)}
        measured = errors(plant, cases, cameras | near)
        ratios = millis(cases, cameras["25"][0])
        print(
            f"\n{name}: MB, cards, fragments, time, FLIP at 0, 25, 60 degrees and near, bias at 25"
        )
        base = measured[next(iter(cases))]["25"][2]
        for label, lod in cases.items():
            row = measured[label]
            flips = " | ".join(f"{row[which][0]:.3f}" for which in ("0", "25", "60", "near"))
            size = baked_bytes(lod) / 1e6
            print(
                f"| {label} | {size:.2f} | {row['25'][3]:.0f} | {row['25'][2] / base:.2f} | "
                f"{ratios[label]:.2f} | {flips} | {row['25'][1]:+.3f} |",
                flush=True,
            )


def show_levels() -> None:
    """Print errors of one, three and five slices by distance, and of the levels that choose."""
    for name, plant in plants().items():
        print(f"\n{name}: FLIP by distance (pixels of the crown)")
        cases = {str(count): tl.Slicings.build(plant, slice_count=count) for count in (5, 3, 1)}
        for error_px in (1.0, 2.0, 4.0, 8.0):
            cases[f"levels, {error_px:g} px"] = tl.Slicings.build(
                plant, slice_count=(5, 3, 1), level_error_px=error_px
            )
        distances = (5, 10, 20, 40, 80, 160)
        cameras = {str(d): orbit(plant, 10, distance=d) for d in distances}
        measured = errors(plant, cases, cameras)
        for label, lod in cases.items():
            row = measured[label]
            cells = " | ".join(f"{row[str(d)][0]:.3f} ({row[str(d)][3]:.0f})" for d in distances)
            print(f"| {label} | {baked_bytes(lod) / 1e6:.2f} | {cells} |", flush=True)
        print([level.error for level in lod.levels])


def show_laws() -> None:
    """Print errors of the laws of orthogonal slices."""
    for name, plant in plants().items():
        print(f"\n{name}: axes, law, correction: m; FLIP and bias at 0, 25 and 60 degrees")
        cameras = {str(e): orbit(plant, e) for e in (0, 25, 60)}
        cases = {}
        for axes in (2, 3):
            for law, params in LAWS.items():
                if axes == 3 and law == "linear":
                    continue
                for correction in (0.5, "optical", "fit"):
                    cases[f"| {axes} | {law} | {correction} |"] = tl.OrthogonalSlices.build(
                        plant, axes=axes, correction=correction, **params
                    )
        for label, row in errors(plant, cases, cameras).items():
            m = cases[label].m
            cells = " | ".join(f"{row[e][0]:.3f} | {row[e][1]:+.3f}" for e in cameras)
            print(f"{label} {'' if m is None else f'{m:.2f}'} | {cells} |", flush=True)


def show_orders() -> None:
    """Print what exact order, wood baked in and counts of slices cost and give."""
    for name, plant in plants().items():
        cases = {
            "slicings, 6 x 5": tl.Slicings.build(plant),
            **{
                label: tl.OrthogonalSlices.build(plant, **params)
                for label, params in {
                    "2 x 7": {},
                    '2 x 7, `paint_order="exact"`': {"paint_order": "exact"},
                    "3 x 7": {"axes": 3},
                    '3 x 7, `paint_order="exact"`': {"axes": 3, "paint_order": "exact"},
                    "2 x 5": {"slice_count": 5},
                    "2 x 8": {"slice_count": 8},
                    "2 x 7, `bake_wood=True`": {"bake_wood": True},
                    "2 x 7, `treetop_slice_count=2`": {"treetop_slice_count": 2},
                    '2 x 7, `format="rgb5a1"`': {"format": "rgb5a1"},
                    "2 x 4, 64 x 64": {"slice_count": 4, "resolution": 64},
                }.items()
            },
        }
        cameras = {str(e): orbit(plant, e) for e in (0, 25, 60)}
        measured = errors(plant, cases, cameras)
        ratios = millis(cases, cameras["25"][0])
        print(f"\n{name}: MB, build seconds, cards, fragments, time, FLIP at 0, 25, 60, bias at 25")
        base = measured["2 x 7"]["25"][2]
        for label, row in measured.items():
            lod = cases[label]
            flips = " | ".join(f"{row[e][0]:.3f}" for e in cameras)
            ratio = ratios[label] / ratios["2 x 7"]
            print(
                f"| {label} | {baked_bytes(lod) / 1e6:.2f} | {lod.build_secs:.1f} | "
                f"{row['25'][3]:.0f} | {row['25'][2] / base:.2f} | {ratio:.2f} | {flips} | "
                f"{row['25'][1]:+.3f} |",
                flush=True,
            )


def show_azimuths() -> None:
    """Print coverage against the full mesh by azimuth, for the laws without and with correction."""
    plant = tl.grow_plant("chestnut")
    full = tl.FullMesh.build(plant)
    cameras = tl.orbit(plant, count=24, elevation_deg=0, distance=10, size=SIZE)[:4]
    cases = {
        f"{law}, {correction}": tl.OrthogonalSlices.build(
            plant, correction=correction, wood=False, **params
        )
        for law, params in LAWS.items()
        for correction in (0.0, 0.8)
    }
    full = tl.FullMesh.build(plant, wood=False)
    wanted = [tl.render(full, camera, samples=SAMPLES).color[..., 3].sum() for camera in cameras]
    print("\nchestnut: coverage over that of the leaves, at 0, 15, 30 and 45 degrees from an axis")
    for label, lod in cases.items():
        found = [tl.render(lod, camera, samples=SAMPLES).color[..., 3].sum() for camera in cameras]
        cells = " | ".join(f"{a / b:.3f}" for a, b in zip(found, wanted, strict=True))
        print(f"| {label} | {cells} |", flush=True)


def picture(
    lod: Any, plant: tl.Plant, azimuth: float, elevation: float, fill: float
) -> Image.Image:
    """Draw a technique so that the plant fills a panel, from outside or from close by."""
    center, radius = plant.sphere
    angle, up = np.deg2rad([azimuth, elevation])
    away = np.array([np.sin(angle) * np.cos(up), np.sin(up), np.cos(angle) * np.cos(up)])
    eye = np.asarray(center) + away * radius * 2.6 / fill
    head = (0, 1, 0) if elevation < 89 else (0, 0, -1)
    camera = tl.Camera.perspective(tuple(eye), tuple(center), fov_y_deg=45, size=PANEL, up=head)
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
    font = ImageFont.load_default(size=13)
    for number, (caption, panel) in enumerate(panels):
        x, y = number % columns * width, number // columns * height
        image.paste(panel, (x, y + CAPTION))
        draw.text((x + 8, y + 7), caption, fill=(20, 30, 40), font=font)
    return image.quantize(COLORS, dither=Image.Dither.NONE)


VIEWS = {"on the diagonal": (45, 8, 1.0), "near": (20, 5, 2.2), "60 degrees up": (20, 60, 1.0)}


def show_pictures() -> None:
    """Write ``orthogonal_slices.png``: mesh and slices, from three places."""
    plant = tl.grow_plant("chestnut")
    cases = {
        "full mesh": tl.FullMesh.build(plant),
        "2 axes": tl.OrthogonalSlices.build(plant),
        "2, exact order": tl.OrthogonalSlices.build(plant, paint_order="exact"),
        "3 axes": tl.OrthogonalSlices.build(plant, axes=3),
        "2, wood baked in": tl.OrthogonalSlices.build(plant, bake_wood=True),
    }
    panels = [
        (f"{label}, {view}", picture(lod, plant, *place))
        for view, place in VIEWS.items()
        for label, lod in cases.items()
    ]
    sheet(panels, len(cases)).save(HERE / "orthogonal_slices.png", optimize=True)


def show_slicings() -> None:
    """Write ``slicings_options.png``: what the options look like where they count."""
    plant = tl.grow_plant("chestnut")
    full, plain = tl.FullMesh.build(plant), tl.Slicings.build(plant)
    above, near = (20, 60, 1.0), (30, 5, 2.4)
    cells = tl.Slicings.build(plant, sub_slices=4)
    branches = tl.Slicings.build(plant, branch_level=1)
    vertical = tl.Slicings.build(plant, vertical=True)
    mirrored = tl.Slicings.build(plant, mirrored=True)
    level = (30, 5, 1.0)
    behind = (200, 5, 1.0)
    panels = [
        ("full mesh, 60 degrees up", picture(full, plant, *above)),
        ("6 x 5", picture(plain, plant, *above)),
        ("vertical=True", picture(vertical, plant, *above)),
        ("branch_level=1", picture(branches, plant, *above)),
        ("full mesh, near", picture(full, plant, *near)),
        ("6 x 5", picture(plain, plant, *near)),
        ("sub_slices=4", picture(cells, plant, *near)),
        ("branch_level=1", picture(branches, plant, *near)),
        ("full mesh", picture(full, plant, *level)),
        ("drop_back=2", picture(tl.Slicings.build(plant, drop_back=2), plant, *level)),
        ("full mesh, from behind", picture(full, plant, *behind)),
        ("mirrored=True, from behind", picture(mirrored, plant, *behind)),
    ]
    sheet(panels, 4).save(HERE / "slicings_options.png", optimize=True)


def main() -> None:
    """Make the parts that are named on the command line, or all."""
    every = {
        "options": show_options,
        "levels": show_levels,
        "laws": show_laws,
        "orders": show_orders,
        "azimuths": show_azimuths,
        "pictures": show_pictures,
        "slicings": show_slicings,
    }
    for name in sys.argv[1:] or every:
        every[name]()


if __name__ == "__main__":
    main()
