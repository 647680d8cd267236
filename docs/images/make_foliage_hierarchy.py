"""
Draw what `docs/foliage_hierarchy.md` shows, and measure what it states.

Run it from the project's root: ``uv run python docs/images/make_foliage_hierarchy.py [NAME ...]``,
each name a function below without its ``show_`` or ``print_``. It needs the real plants, which
`TREELOD_MODELS` says where to find, and takes some minutes. Figures are printed as they come.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont

import treelod as tl
from treelod import criteria
from treelod.color import composite, quantize, srgb_from_linear

MODELS = Path(__file__).parents[3] / "shared" / "models"
"""Real plants, where `TREELOD_MODELS` says nothing."""

HERE = Path(__file__).parent
BACKGROUND = (0.80, 0.86, 0.92)
"""Linear colour behind the plants."""

FILES = {
    "ez_oak_large": "ez_oak_large/ez_oak_large.glb",
    "ez_aspen_large": "ez_aspen_large/ez_aspen_large.glb",
    "CommonTree_1": "quaternius_common/CommonTree_1.gltf",
    "Bush_Common_Flowers": "quaternius_common/Bush_Common_Flowers.gltf",
}
ALL = ("chestnut", "ez_oak_large", "ez_aspen_large", "CommonTree_1", "pine")
THREE = ("chestnut", "ez_oak_large", "CommonTree_1")
CAPTION = 24
COLORS = 192
STYLE = {"font.size": 9, "axes.spines.right": False, "axes.spines.top": False}


@cache
def plant_of(name: str) -> tl.Plant:
    """Grow or load a plant."""
    if name in FILES:
        return tl.load_plant(Path(os.environ.get("TREELOD_MODELS") or MODELS) / FILES[name])
    return tl.grow_plant(name)


def note(*parts: object) -> None:
    """Print a line of figures at once."""
    print(*parts, flush=True)


def orbit(
    plant: tl.Plant,
    distance: float,
    size: tuple[int, int],
    elevations: Iterable[float] = (0.0, 25.0),
    count: int = 4,
) -> list[tl.Camera]:
    """Return views from all around, at some elevations."""
    return [
        camera
        for elevation in elevations
        for camera in tl.orbit(
            plant, count=count, elevation_deg=elevation, distance=distance, size=size
        )
    ]


def plain(axis: Any) -> None:
    """Label a logarithmic axis by 1, 2, 5, 10, ..."""
    for set_formatter in (axis.set_major_formatter, axis.set_minor_formatter):
        set_formatter(lambda at, _: f"{at:,.0f}" if f"{at:.0f}"[0] in "125" else "")


def picture(lod: Any, camera: tl.Camera, samples: int = 64) -> Image.Image:
    """Draw a technique on the background."""
    color = tl.render(lod, camera, samples=samples).color
    return Image.fromarray(quantize(srgb_from_linear(np.clip(composite(color, BACKGROUND), 0, 1))))


def filling(plant: tl.Plant, size: tuple[int, int], azimuth_deg: float = 0.0) -> tl.Camera:
    """Return a parallel view that the plant fills."""
    center, _ = plant.sphere
    extent = plant.bounds[1] - plant.bounds[0]
    up, around = np.deg2rad(8.0), np.deg2rad(azimuth_deg)
    away = np.array([np.sin(around) * np.cos(up), np.sin(up), np.cos(around) * np.cos(up)])
    fill = max(extent[1], max(extent[0], extent[2]) * size[1] / size[0]) * 1.12
    eye = center + away * float(np.linalg.norm(extent)) * 4
    return tl.Camera.orthographic(tuple(eye), tuple(center), height=float(fill), size=size)


def sheet(panels: list[tuple[str, Image.Image]], columns: int) -> Image.Image:
    """Set panels in rows, each with its caption."""
    width, height = panels[0][1].size
    rows = -(-len(panels) // columns)
    image = Image.new("RGB", (columns * width, rows * (height + CAPTION)), "white")
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=13)
    for number, (caption, panel) in enumerate(panels):
        x, y = number % columns * width, number // columns * (height + CAPTION)
        image.paste(panel, (x, y + CAPTION))
        draw.text((x + 6, y + 5), caption, fill=(20, 30, 40), font=font)
    return image.quantize(COLORS, dither=Image.Dither.NONE)


def show_sheet() -> None:
    """Write ``foliage_hierarchy.png``: four plants with ever fewer quads."""
    panels = []
    for name in ("chestnut", "ez_oak_large", "CommonTree_1", "Bush_Common_Flowers"):
        plant = plant_of(name)
        camera = filling(plant, (230, 270))
        triangle_count = len(plant.foliage.mesh.triangles)
        full = picture(tl.FullMesh.build(plant), camera)
        panels.append((f"full mesh: {triangle_count:,} triangles", full))
        lod = tl.FoliageHierarchy.build(plant, wood_levels=False)
        for share in (1.0, 0.5, 0.2, 0.05):
            count = round(lod.leaf_count * share)
            caption = f"{share:.0%}: {count:,} quads"
            panels.append((caption, picture(lod.at(leaf_count=count), camera)))
    sheet(panels, 5).save(HERE / "foliage_hierarchy.png", optimize=True)


KEPT = [
    ("paper's rule", "#000000", {"choice": "paper", "keep_area": False, "keep_coverage": False}),
    ("corners alone", "#888888", {"keep_area": False, "keep_coverage": False}),
    ("paper, area", "#E69F00", {"choice": "paper", "keep_coverage": False}),
    ("area", "#D55E00", {"keep_coverage": False}),
    ("paper, coverage", "#56B4E9", {"choice": "paper", "keep_area": False}),
    ("coverage", "#009E73", {"keep_area": False}),
    ("paper, both", "#CC79A7", {"choice": "paper"}),
    ("both: default", "#0072B2", {}),
]
"""Ways to scale nodes: label, colour, parameters."""
SHARES = (0.7, 0.5, 0.35, 0.2, 0.1, 0.05)


def coverage(lod: Any, cameras: list[tl.Camera]) -> float:
    """Mean alpha over some views."""
    frames = [tl.render(lod, camera, samples=4, outputs=("color",)) for camera in cameras]
    return float(np.mean([frame.color[..., 3].mean() for frame in frames]))


def drawn_area(forest: tl.LeafForest, leaf_count: int) -> float:
    """Area of the quads of a level as they are drawn."""
    a, b, c, d = forest.quads()[forest.level(leaf_count=leaf_count)].transpose(1, 0, 2)
    halves = [np.cross(b - a, c - a), np.cross(c - a, d - a)]
    return float(sum(np.linalg.norm(half, axis=1).sum() for half in halves)) / 2


def show_kept() -> None:
    """Write ``foliage_hierarchy_kept.png``: area and coverage against the number of quads."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 5.2), layout="constrained")
        axes = figure.subplots(2, len(ALL), sharex=True)
        for column, name in enumerate(ALL):
            plant = plant_of(name)
            cameras = orbit(plant, 2.5, (256, 256), (10.0,), 8)
            full = coverage(tl.FullMesh.build(plant, wood=False), cameras)
            for label, color, params in KEPT:
                lod = tl.FoliageHierarchy.build(plant, wood=False, **params)
                counts = [round(lod.leaf_count * share) for share in SHARES]
                total = lod.forest.areas[: lod.leaf_count].sum()
                areas = [drawn_area(lod.forest, n) / total for n in (lod.leaf_count, *counts)]
                covered = [
                    coverage(lod.at(leaf_count=n), cameras) / full
                    for n in (lod.leaf_count, *counts)
                ]
                dash = "--" if params.get("choice") == "paper" else "-"
                for row, values in enumerate((areas, covered)):
                    axes[row][column].plot(
                        (1.0, *SHARES), values, dash, color=color, label=label, linewidth=1.3
                    )
                cells = [f"{a:.3f} / {c:.2f}" for a, c in zip(areas, covered, strict=True)]
                note("| " + " | ".join([name, label, *cells]) + " |")
            for row in (0, 1):
                axes[row][column].axhline(1.0, color="#bbbbbb", linewidth=0.7, zorder=0)
            axes[1][column].axhspan(0.85, 1.15, color="#eeeeee", zorder=-1)
            axes[0][column].set_title(name, loc="left", fontsize=9)
            axes[1][column].set_xscale("log")
            axes[1][column].set_xticks([1, 0.5, 0.2, 0.1, 0.05], ["1", ".5", ".2", ".1", ".05"])
            axes[1][column].set_xticks([], minor=True)
            axes[1][column].invert_xaxis()
            axes[1][column].set_xlabel("share of the leaves left")
        axes[0][0].set_ylabel("area, of all leaves'")
        axes[1][0].set_ylabel("coverage, of all leaves'")
        figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside right", frameon=False)
        figure.savefig(HERE / "foliage_hierarchy_kept.png", dpi=100)


def show_collapses() -> None:
    """Write ``foliage_hierarchy_collapses.png``: cost, area and flatness of every collapse."""
    kinds = (("cost", "costs"), ("area / area below, - 1", "area_drifts"), ("V / S", "planarities"))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 6.5), layout="constrained")
        axes = figure.subplots(3, len(ALL), sharey="row")
        for column, name in enumerate(ALL):
            plant = plant_of(name)
            for choice, color in (("balanced", "#0072B2"), ("paper", "#D55E00")):
                forest = tl.FoliageHierarchy.build(
                    plant, choice=choice, keep_coverage=False, wood=False
                ).forest
                for row, (label, attribute) in enumerate(kinds):
                    values = getattr(forest, attribute)
                    parts = np.array_split(np.arange(len(values)), min(80, len(values)))
                    at = [(part[0] + part[-1]) / 2 / forest.leaf_count for part in parts]
                    low, middle, high = np.array(
                        [np.nanquantile(values[part], [0.1, 0.5, 0.9]) for part in parts]
                    ).T
                    axis = axes[row][column]
                    axis.plot(at, middle, color=color, linewidth=1.2, label=choice)
                    axis.fill_between(at, low, high, color=color, alpha=0.2, linewidth=0)
                    axes[row][0].set_ylabel(label)
                    if row == 0:
                        axis.set_yscale("log")
                drift, flat = forest.area_drifts, forest.planarities
                half = forest.leaf_count // 2
                last = slice(forest.leaf_count * 4 // 5, forest.leaf_count * 19 // 20)
                note(
                    f"| {name} | {choice} | {np.nanmedian(forest.costs[:half]):.2g} "
                    f"| {np.nanmedian(forest.costs[last]):.2g} | {np.nanmedian(drift[:half]):+.2f} "
                    f"| {np.nanmedian(drift[last]):+.2f} | {np.nanmedian(flat[:half]):.3f} "
                    f"| {np.nanmedian(flat[last]):.3f} | {np.nanquantile(flat[last], 0.1):.3f} |"
                )
            axes[0][column].set_title(name, loc="left", fontsize=9)
            axes[2][column].set_xlabel("collapses by leaves")
        axes[0][0].legend(frameon=False)
        figure.savefig(HERE / "foliage_hierarchy_collapses.png", dpi=100)


def polygons(forest: tl.LeafForest, nodes: Any, camera: tl.Camera) -> Image.Image:
    """Draw nodes as flat polygons, green for leaves to red for what stands for many."""
    quads = forest.quads()[nodes]
    below = forest.areas[nodes] / forest.areas[: forest.leaf_count].mean()
    level = np.clip(np.log2(np.maximum(below, 1.0)) / 8, 0, 1)
    image = Image.new("RGB", camera.size, "white")
    draw = ImageDraw.Draw(image)
    toward = np.asarray(camera.eye) - np.asarray(camera.target)
    places = camera.project(quads.reshape(-1, 3))[:, :2].reshape(-1, 4, 2)
    for index in np.argsort(quads.mean(axis=1) @ toward):
        share = level[index]
        fill = (int(60 + 180 * share), int(150 - 90 * share), 50)
        draw.polygon([tuple(p) for p in places[index]], fill=fill, outline=(30, 40, 30))
    return image


def show_views() -> None:
    """Write ``foliage_hierarchy_views.png``: after the paper's figures 7, 11 and 12."""
    plant = plant_of("chestnut")
    lod = tl.FoliageHierarchy.build(plant, wood_levels=False)
    center, radius = plant.sphere
    middle = plant.foliage.centers.mean(axis=0)
    eye = tl.orbit(plant, count=1, elevation_deg=8, distance=2.5, size=(300, 320))[0]
    near = tl.Camera.perspective(
        (center[0], center[1], center[2] + radius * 1.15), tuple(center), size=(300, 320)
    )
    side = filling(plant, (300, 320), 90.0)
    panels = []
    for caption, zone, camera in (
        ("coarse in a sphere of 0.35 R", criteria.sphere(middle, radius * 0.35), eye),
        ("coarse in a sphere of 0.5 R", criteria.sphere(middle, radius * 0.5), eye),
        ("finer in front of a plane", criteria.plane(middle, (0.0, 0.0, 1.0)), eye),
        ("balls of 24 pixels, eye close by", criteria.screen_size(24), near),
    ):
        variable = lod.view_dependent(zone)
        (active,) = variable.active([camera])
        panels += [
            (f"{caption}: {2 * len(active.nodes):,}", picture(variable, camera)),
            ("seen from its right", polygons(lod.forest, active.nodes, side)),
        ]
        note(f"| {caption} | {2 * len(active.nodes):,} |")
    sheet(panels, 4).save(HERE / "foliage_hierarchy_views.png", optimize=True)


def reaching(plant: tl.Plant, triangle_count: int, method: str) -> tl.SimplifiedMesh:
    """Simplify so that as many triangles are left as asked for, or as near below as can be."""
    low, high = triangle_count, len(plant.foliage.mesh.triangles)
    best = tl.SimplifiedMesh.build(plant, triangle_count=low, method=method)
    if method == "simplify":
        return best
    while high - low > max(1, triangle_count // 100):
        middle = (low + high) // 2
        found = tl.SimplifiedMesh.build(plant, triangle_count=middle, method=method)
        if found.triangle_count <= triangle_count:
            low, best = middle, found
        else:
            high = middle
    return best


def show_errors() -> None:
    """Write ``foliage_hierarchy_errors.png``: error and coverage against triangles of foliage."""
    found = {}
    for name in THREE:
        plant = plant_of(name)
        cameras = orbit(plant, 2.5, (320, 240))
        full = tl.FullMesh.build(plant)
        references = [tl.render(full, camera, samples=16) for camera in cameras]
        covered = float(np.mean([_covered(frame) for frame in references]))
        lod = tl.FoliageHierarchy.build(plant, wood_levels=False)
        lines = found[name] = {key: [] for key in BASELINES}
        for share in (0.5, 0.2, 0.1, 0.05, 0.02):
            count = 2 * round(lod.leaf_count * share)
            subjects = {
                "uniform": lod.at(leaf_count=count // 2),
                "variable": with_triangles(lod, count, cameras),
                "simplify": reaching(plant, count, "simplify"),
                "sloppy": reaching(plant, count, "sloppy"),
            }
            for label, subject in subjects.items():
                frames = [tl.render(subject, camera, samples=16) for camera in cameras]
                errors = list(map(tl.metrics.compare, references, frames))
                left = np.mean([frame.stats.triangles for frame in frames])
                left -= len(plant.wood.triangles)
                flip = float(np.mean([error.flip for error in errors]))
                bias = float(np.mean([error.coverage_bias for error in errors])) / covered
                lines[label].append((float(left), flip, bias))
            cells = [
                f"{n:,.0f}: {flip:.3f} / {bias:+.0%}"
                for n, flip, bias in (line[-1] for line in lines.values())
            ]
            note(f"| {name} | {share:.0%} | " + " | ".join(cells) + " |")
    draw_errors(found)


BASELINES = {
    "uniform": "#0072B2",
    "variable": "#009E73",
    "simplify": "#E69F00",
    "sloppy": "#D55E00",
}
"""Colours of what is compared at the same number of triangles."""


def draw_errors(found: dict[str, dict[str, list[tuple[float, float, float]]]]) -> None:
    """Draw triangles, FLIP and bias, by plant and label."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 5.4), layout="constrained")
        axes = figure.subplots(2, len(found), sharex="col", sharey="row")
        for column, (name, lines) in enumerate(found.items()):
            for label, line in lines.items():
                kept = np.array([point for point in line if point[0] > 0])
                for row in (0, 1):
                    axes[row][column].plot(
                        kept[:, 0],
                        kept[:, row + 1],
                        color=BASELINES[label],
                        marker="o",
                        markersize=3,
                        label=label,
                    )
            axes[1][column].axhline(0.0, color="#888888", linewidth=0.7)
            axes[1][column].set_xscale("log")
            plain(axes[1][column].xaxis)
            axes[1][column].set_xlabel("triangles of foliage")
            axes[0][column].set_title(name, loc="left", fontsize=9)
        axes[0][0].set_ylabel("FLIP error, worse background")
        axes[1][0].set_ylabel("coverage bias, of what is covered")
        axes[0][0].legend(frameon=False)
        figure.savefig(HERE / "foliage_hierarchy_errors.png", dpi=100)


def with_triangles(
    lod: tl.FoliageHierarchy, triangle_count: int, cameras: list[tl.Camera]
) -> tl.FoliageHierarchy:
    """Draw balls of the size that leaves so many triangles, in the mean over some views."""
    low, high = np.log(0.5), np.log(2000.0)
    for _ in range(9):
        middle = (low + high) / 2
        variable = lod.view_dependent(criteria.screen_size(float(np.exp(middle))))
        found = np.mean([2 * len(active.nodes) for active in variable.active(cameras)])
        low, high = (middle, high) if found > triangle_count else (low, middle)
    return lod.view_dependent(criteria.screen_size(float(np.exp(high))))


def _covered(frame: tl.Frame) -> float:
    """Return mean coverage over the part that metrics look at."""
    left, top, right, bottom = frame.bounds_px
    width, height = frame.camera.size
    rows = slice(max(top - 8, 0), min(bottom + 8, height))
    columns = slice(max(left - 8, 0), min(right + 8, width))
    return float(frame.color[rows, columns, 3].mean())


def show_walk() -> None:
    """Write ``foliage_hierarchy_walk.png``: the paper's scene test."""
    plant = plant_of("chestnut")
    lod = tl.FoliageHierarchy.build(plant)
    middle = plant.foliage.centers.mean(axis=0)
    subjects = {
        "geometry": tl.FullMesh.build(plant),
        "uniform": lod.uniform(quad_px=WALK_PX["uniform"]),
        "variable, sphere": lod.view_dependent(
            criteria.sphere(middle, 0.0, growth=WALK_PX["sphere"])
        ),
        "variable, screen size": lod,
    }
    found = tl.walks.walk(
        plant, subjects, tree_counts=(1, 2, 4, 8, 16), frame_count=18, laps=2, size=(512, 384)
    )
    table = found.table
    draw_walk(table)
    for name in subjects:
        rows = table[table["label"] == name]
        cells = [
            f"{n:,.0f} / {ms:.0f}"
            for n, ms in zip(rows["primitives"], rows["frame_millis"], strict=True)
        ]
        note(f"| {name} | " + " | ".join(cells) + " |")


WALKERS = ("geometry", "uniform", "variable, sphere", "variable, screen size")


def draw_walk(table: pd.DataFrame) -> None:
    """Draw what a walk has found."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.4), layout="constrained")
        axes = figure.subplots(1, 2)
        for axis, key, label in (
            (axes[0], "primitives", "triangles a frame"),
            (axes[1], "frame_millis", "milliseconds a frame"),
        ):
            for name, color in zip(
                WALKERS, ("#000000", "#E69F00", "#D55E00", "#0072B2"), strict=True
            ):
                mine = table[table["label"] == name]
                axis.plot(mine["tree_count"], mine[key], color=color, marker="o", label=name)
            axis.set_xscale("log", base=2)
            axis.set_yscale("log")
            axis.set_xticks([1, 2, 4, 8, 16], ["1", "2", "4", "8", "16"])
            axis.set_xlabel("trees")
            axis.set_ylabel(label)
            plain(axis.yaxis)
        axes[0].legend(frameon=False)
        figure.savefig(HERE / "foliage_hierarchy_walk.png", dpi=100)


WALK_PX = {"uniform": 4.0, "sphere": 0.1}
"""Side of the uniform level's quads; by how much the sphere grows with the distance."""


def print_popping() -> None:
    """Print FLIP between neighbouring levels, and between steps of a slow approach."""
    for name in THREE[:2]:
        plant = plant_of(name)
        lod = tl.FoliageHierarchy.build(plant)
        full = tl.FullMesh.build(plant)
        for before, after in ((1.0, 0.5), (0.5, 0.25), (0.25, 0.125), (0.125, 0.0625)):
            cells = []
            for distance in (2.5, 10.0, 40.0):
                (camera,) = orbit(plant, distance, (512, 384), (10.0,), 1)
                flip = [
                    popping(full, one, two, camera)
                    for one, two in (
                        (at_share(lod, before), at_share(lod, after)),
                        (at_share(lod, before), at_share(lod, before * 0.99)),
                    )
                ]
                cells.append(f"{flip[0]:.3f} ({flip[1]:.4f})")
            note(f"| {name} | {before:.1%} to {after:.1%} | " + " | ".join(cells) + " |")
        distances = np.geomspace(40.0, 2.5, 24)
        flips, swaps = [], []
        for distance in distances:
            (far,) = orbit(plant, float(distance) * 1.01, (512, 384), (10.0,), 1)
            (near,) = orbit(plant, float(distance), (512, 384), (10.0,), 1)
            one, two = lod.active([far, near])
            swaps.append(two.split_count + two.forced_split_count + two.collapse_count)
            frozen = [frozen_at(lod, active.nodes) for active in (one, two)]
            flips.append(popping(full, frozen[0], frozen[1], near))
        worst = int(np.argmax(flips))
        note(
            f"{name}: FLIP mean {np.mean(flips):.4f}, largest {flips[worst]:.4f} at "
            f"{distances[worst]:.1f} radii; steps {min(swaps)} to {max(swaps)}"
        )


def popping(full: Any, before: Any, after: Any, camera: tl.Camera) -> float:
    """Return FLIP between two sides of a switch, over the region of the full mesh."""
    region = tl.render(full, camera, samples=1, outputs=("color",)).bounds_px
    one, two = (tl.render(side, camera, samples=64, outputs=("color",)) for side in (before, after))
    return tl.metrics.compare(replace(one, bounds_px=region), two).flip


def at_share(lod: tl.FoliageHierarchy, share: float) -> tl.FoliageHierarchy:
    """Draw a share of the leaves."""
    return lod.at(leaf_count=round(lod.leaf_count * share))


def frozen_at(lod: tl.FoliageHierarchy, active: Any) -> tl.FoliageHierarchy:
    """Draw the same nodes from everywhere: what is right above them is replaced."""

    def above(nodes: criteria.Nodes, _: tl.Camera) -> Any:
        mask = np.zeros(len(nodes.parents), dtype=bool)
        parents = nodes.parents[active]
        mask[parents[parents >= 0]] = True
        return mask

    return lod.view_dependent(above)


def print_bare() -> None:
    """Print what bare wood covers, by its error in pixels."""
    plant = tl.grow_plant("chestnut", leaf_count=1)
    full = tl.FullMesh.build(plant)
    for error in (0.1, 0.25, 0.5, 1.0, 2.0):
        lod = tl.FoliageHierarchy.build(plant, ball_px=0, wood_error_px=error)
        cells = []
        for distance in (2.5, 10.0, 40.0):
            cameras = orbit(plant, distance, (512, 384), (10.0,))
            alphas = [
                np.mean([tl.render(one, camera, samples=64).color[..., 3] for camera in cameras])
                for one in (lod, full)
            ]
            cells.append(f"{alphas[0] / alphas[1]:.2f}")
        note("| " + " | ".join([f"{error:g}", *cells]) + " |")


def print_kept() -> None:
    """Print FLIP by how nodes are scaled and how corners are chosen."""
    for name in THREE:
        plant = plant_of(name)
        cameras = orbit(plant, 2.5, (320, 240), count=2)
        full = tl.FullMesh.build(plant)
        references = [tl.render(full, camera, samples=16) for camera in cameras]
        for label, _, params in (KEPT[0], KEPT[1], KEPT[3], KEPT[6], KEPT[7]):
            lod = tl.FoliageHierarchy.build(plant, wood_levels=False, **params)
            cells = []
            for share in (0.5, 0.2, 0.05):
                frames = [tl.render(at_share(lod, share), c, samples=16) for c in cameras]
                errors = map(tl.metrics.compare, references, frames)
                cells.append(f"{np.mean([error.flip for error in errors]):.3f}")
            note("| " + " | ".join([name, label, *cells]) + " |")


def print_defaults() -> None:
    """Print error, triangles and time by size of the balls and by error of the wood."""
    every: list[dict[str, float]] = [
        *({"ball_px": ball, "wood_error_px": 0.0} for ball in (2.0, 4.0, 8.0, 16.0, 32.0)),
        *({"ball_px": 0.0, "wood_error_px": error} for error in (0.25, 0.5, 1.0, 2.0)),
    ]
    for name in THREE[:2]:
        plant = plant_of(name)
        full = tl.FullMesh.build(plant)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "leaves"
            tl.FoliageHierarchy.build(plant).save(file)
            subjects: dict[str, Any] = {"full mesh": full} | {
                f"{params['ball_px']:g}, {params['wood_error_px']:g}": tl.FoliageHierarchy.load(
                    file, plant, **params
                )
                for params in every
            }
        for distance in (2.5, 10.0, 40.0):
            cameras = orbit(plant, distance, (512, 384), count=2)
            references = [tl.render(full, camera, samples=64) for camera in cameras]
            times = tl.time_frames(subjects, cameras[0], repeats=5)
            for label, subject in subjects.items():
                frames = [tl.render(subject, camera, samples=4) for camera in cameras]
                errors = list(map(tl.metrics.compare, references, frames))
                flip = np.mean([error.flip for error in errors])
                triangles = np.mean([frame.stats.triangles for frame in frames])
                millis = np.min(times[label])
                note(
                    f"| {name} | {distance:g} | {label} | {triangles:,.0f} | {flip:.3f} "
                    f"| {millis:.1f} |"
                )


EVERY: dict[str, Callable[[], None]] = {
    "sheet": show_sheet,
    "kept": show_kept,
    "collapses": show_collapses,
    "views": show_views,
    "errors": show_errors,
    "walk": show_walk,
    "popping": print_popping,
    "kept_flip": print_kept,
    "bare": print_bare,
    "defaults": print_defaults,
}


def main() -> None:
    """Draw and measure what is named on the command line, or all."""
    for name in sys.argv[1:] or EVERY:
        EVERY[name]()


if __name__ == "__main__":
    main()
