"""
Measure and draw what the documents show of points and lines and of stochastic pruning.

Run it from the project's root: ``uv run python docs/images/make_points_and_lines.py``, with the
names of some of its jobs, or none for all. Real plants are files that `TREELOD_MODELS` says where
to find.
Figures are printed as they come; ``points_and_lines.png``, ``points_coverage.png``,
``points_transition.png``, ``points_sweep.png`` and ``stochastic_pruning.png`` are written.
"""

import itertools
import os
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image, ImageDraw, ImageFont

import treelod as tl
from treelod.color import composite, quantize, srgb_from_linear

PANEL = 400
"""Pixels a side of an enlarged picture: a whole plant from 6 radii, at two for each."""

MODELS = Path(__file__).parents[3] / "shared" / "models"
"""Real plants, where `TREELOD_MODELS` says nothing."""

HERE = Path(__file__).parent
BACKGROUND = (0.80, 0.86, 0.92)
"""Linear colour behind the plants."""

REAL_PLANTS = ("ez_oak_large/ez_oak_large.glb", "quaternius_common/CommonTree_1.gltf")
SIZE = (640, 480)
SAMPLES = 16
AZIMUTHS = 6
DISTANCES = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
FACTORS = (1.0, 1.2, 1.3, 1.5, 1.75, 2.0)
SPACINGS = (0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 4.0)


def real_plants() -> list[tl.Plant]:
    """Load the real plants."""
    folder = Path(os.environ.get("TREELOD_MODELS") or MODELS)
    return [tl.load_plant(folder / path) for path in REAL_PLANTS]


def covered(lod: Any, camera: tl.Camera) -> float:
    """Mean coverage of a picture, times its pixels."""
    return float(tl.render(lod, camera, samples=SAMPLES).color[..., 3].sum())


def vertices(lod: tl.PointsAndLines, camera: tl.Camera) -> int:
    """Vertices that a view needs."""
    return sum(chosen.vertices for chosen in lod.selection(camera))


def law() -> None:
    """Print what points cover against ``1 - exp(-s L)``, block by block of 4 x 4 pixels."""
    plant = tl.grow_plant("chestnut", seed=1)
    lod = tl.PointsAndLines.build(plant, wood=False, octree_depth=0, importance=1.0)
    center, radius = plant.sphere
    height, rows = float(2 * radius), 256
    eye = tuple(np.asarray(center) + np.array([0.0, 0.0, 4 * radius]))
    camera = tl.Camera.orthographic(eye, tuple(center), height=height, size=(rows, rows))
    positions = lod._samples.samples[0][0]
    for spacing in (1.0, 2.0, 4.0):
        (chosen,) = lod.drawn(sample_distance_px=spacing).selection(camera)
        drawn = positions[: chosen.points]
        at = (drawn[:, :2] - np.asarray(center)[:2]) / height * [1, -1] + 0.5
        blocks, _, _ = np.histogram2d(*at.T, bins=rows // 4, range=[[0, 1], [0, 1]])
        for factor in (0.5, 1.0, 1.3, 2.0):
            expected = float((1 - np.exp(-blocks * factor * spacing**2 / 16)).sum() * 16)
            found = covered(lod.drawn(sample_distance_px=spacing, splat_factor=factor), camera)
            print(
                f"{chosen.points} points {spacing:g} px apart, s = {factor}: cover {found:.0f}, "
                f"expected {expected:.0f}: {found / expected - 1:+.3f}"
            )


def coverage() -> None:
    """Write ``points_coverage.png``: coverage of points over that of polygons, by distance."""
    figure = Figure(figsize=(12, 4), layout="constrained")
    plants = [tl.grow_plant("chestnut", seed=1), *real_plants()]
    for axes, plant in zip(figure.subplots(1, len(plants), sharey=True), plants, strict=True):
        full = tl.FullMesh.build(plant, wood=False)
        built = {
            order: tl.PointsAndLines.build(
                plant,
                wood=False,
                pair_order=order,
                importance=1.0,
                splat_factor="coverage",
                classes={"*": "points"},
            )
            for order in ("split", "paired")
        }
        print(plant.name, "factors", np.round(built["split"].splat_factors, 2))
        lines: dict[str, list[float]] = {}
        for distance in DISTANCES:
            # far away only the middle of the picture is needed
            size = tuple(max(32, int(side * min(1.0, 12.0 / distance))) for side in SIZE)
            fov = np.rad2deg(2 * np.arctan(np.tan(np.deg2rad(22.5)) * size[1] / SIZE[1]))
            near = tl.orbit(plant, count=AZIMUTHS, elevation_deg=10, distance=distance)
            cameras = [
                tl.Camera.perspective(c.eye, c.target, fov_y_deg=float(fov), size=size)
                for c in near
            ]
            polygons = np.array([covered(full, camera) for camera in cameras])
            for order, lod in built.items():
                for factor in (1.0, 1.3, "coverage"):
                    drawn = lod.drawn(splat_factor=factor)
                    found = np.array([covered(drawn, camera) for camera in cameras])
                    ratios = found / polygons
                    label = f"{order}, s = {factor}"
                    lines.setdefault(label, []).append(float(ratios.mean()))
                    worst = float(np.abs(ratios - 1).max())
                    points = sum(c.points for c in drawn.selection(cameras[0]))
                    print(
                        f"{plant.name} {distance:g} radii, {label}: {ratios.mean():.3f}, "
                        f"worst {worst:.3f}, {points} points"
                    )
        colors = ["C0", "C1", "C2"] * 2
        for (label, ratios), color in zip(lines.items(), colors, strict=True):
            style = "-" if label.startswith("split") else ":"
            axes.plot(DISTANCES, ratios, style, color=color, label=label)
        axes.axhline(1.0, color="black", linewidth=0.6)
        axes.set(xscale="log", title=plant.name, xlabel="distance (radii)")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    figure.axes[0].set_ylabel("coverage of points / of polygons")
    figure.savefig(HERE / "points_coverage.png", dpi=100)


def transition() -> None:
    """Write ``points_transition.png``: change from one step to the next, triangles to points."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for plant in [tl.grow_plant("chestnut", seed=1), *real_plants()[:1]]:
        for order, style in (("split", "-"), ("paired", ":")):
            lod = tl.PointsAndLines.build(
                plant,
                wood=False,
                octree_depth=0,
                pair_order=order,
                importance=1.0,
                sampling="stratified",
                splat_factor="coverage",
            )
            camera = tl.orbit(plant, count=3, elevation_deg=5, distance=4.0, size=SIZE)[1]
            (chosen,) = lod.drawn(sample_distance_px=1.0).selection(camera)
            count = lod.groups[0].opaque_triangle_count
            steps = np.linspace(3.0, 1.5, 16)
            levels = [
                lod.drawn(sample_distance_px=float(np.sqrt(chosen.needed / (p * count))))
                for p in steps
            ]
            for name, view in (("same camera", camera),):
                jumps = [
                    tl.metrics.popping(a, b, view, samples=SAMPLES).flip
                    for a, b in itertools.pairwise(levels)
                ]
                whole = tl.metrics.popping(levels[0], levels[10], view, samples=SAMPLES).flip
                print(
                    f"{plant.name} {order}, {name}: largest step {max(jumps):.4f}, "
                    f"all at once {whole:.4f}, steps {np.round(jumps, 4).tolist()}"
                )
                axes.plot(steps[1:], jumps, style, label=f"{plant.name}, {order}")
    axes.axvline(2.0, color="black", linewidth=0.6)
    axes.set(
        xlabel="vertices needed for each triangle (3: all triangles, 2: all points)",
        ylabel="FLIP from one step to the next",
    )
    axes.invert_xaxis()
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(HERE / "points_transition.png", dpi=100)


def sweep() -> None:
    """Write ``points_sweep.png``: error and coverage by vertices, factors and spacings."""
    figure = Figure(figsize=(13, 6), layout="constrained")
    plants = [tl.grow_plant("pine", seed=1), tl.grow_plant("palm", seed=1), *real_plants()]
    for column, plant in zip(figure.subplots(2, len(plants)).T, plants, strict=True):
        full = tl.FullMesh.build(plant)
        lod = tl.PointsAndLines.build(plant)
        cameras = tl.orbit(plant, count=4, elevation_deg=10, distance=15.0)
        references = [tl.render(full, camera, samples=SAMPLES) for camera in cameras]
        everything = sum(3 * group.triangle_count for group in lod.groups)
        for factor in (*FACTORS, "coverage"):
            rows = []
            for spacing in SPACINGS:
                drawn = lod.drawn(splat_factor=factor, sample_distance_px=spacing)
                frames = [tl.render(drawn, camera, samples=SAMPLES) for camera in cameras]
                errors = list(map(tl.metrics.compare, references, frames))
                rows.append(
                    (
                        float(np.mean([vertices(drawn, camera) for camera in cameras])),
                        float(np.mean([e.flip for e in errors])),
                        float(np.mean([e.coverage_bias for e in errors])),
                    )
                )
                count, flip, bias = rows[-1]
                print(
                    f"{plant.name} s = {factor}, {spacing:g} px: {count:.0f} of {everything} "
                    f"vertices, FLIP {flip:.4f}, bias {bias:+.4f}"
                )
            for axes, number in zip(column, (1, 2), strict=True):
                style = "k--" if factor == "coverage" else "-"
                line = [row[number] for row in rows]
                axes.plot([row[0] for row in rows], line, style, label=f"s = {factor}")
        for axes, name in zip(column, ("FLIP", "coverage bias"), strict=True):
            axes.set(xscale="log", ylabel=name, xlabel="vertices drawn")
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 4)))
            axes.xaxis.set_major_formatter(FuncFormatter(lambda count, _: f"{count / 1e3:g} K"))
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.grid(alpha=0.3)
        column[1].axhline(0.0, color="black", linewidth=0.6)
        column[0].set_title(plant.name, fontsize=10)
    figure.axes[0].legend(fontsize=7)
    figure.savefig(HERE / "points_sweep.png", dpi=90)


def antialias() -> None:
    """Print errors of splats thinner than a pixel, by how they are drawn."""
    plant = tl.grow_plant("chestnut", seed=1)
    full = tl.FullMesh.build(plant)
    lod = tl.PointsAndLines.build(plant, splat_factor=1.0, sample_distance_px=0.5)
    for distance in (20.0, 60.0):
        cameras = tl.orbit(plant, count=4, elevation_deg=10, distance=distance)
        references = [tl.render(full, camera, samples=64) for camera in cameras]
        for samples in (1, 4, 16):
            for way in ("off", "coverage", "blend"):
                drawn = lod.drawn(antialias=way)
                frames = [tl.render(drawn, camera, samples=samples) for camera in cameras]
                errors = list(map(tl.metrics.compare, references, frames))
                millis = np.median([frame.stats.draw_millis for frame in frames])
                print(
                    f"{distance:g} radii, {samples} samples, {way}: "
                    f"FLIP {np.mean([e.flip for e in errors]):.4f}, "
                    f"bias {np.mean([e.coverage_bias for e in errors]):+.4f}, {millis:.1f} ms"
                )


def memory() -> None:
    """Print bytes of points and lines against those of the mesh."""
    for plant in [
        *(tl.grow_plant(name, seed=1) for name in ("chestnut", "pine", "palm")),
        *real_plants(),
    ]:
        lod = tl.PointsAndLines.build(plant)
        mesh = tl.FullMesh.build(plant).footprint.geometry_bytes
        facts = lod.footprint
        print(
            f"{plant.name}: mesh {mesh / 1e6:.2f} MB, "
            f"{facts.points} points and {facts.lines} lines "
            f"{lod.sample_bytes / 1e6:.2f} MB: in all {facts.geometry_bytes / mesh:.2f} times"
        )


def panel(lod: Any, camera: tl.Camera, zoom: int) -> Image.Image:
    """Draw the middle of a picture, enlarged."""
    color = tl.render(lod, camera, samples=SAMPLES).color
    image = quantize(srgb_from_linear(np.clip(composite(color, BACKGROUND), 0, 1)))
    height, width = image.shape[:2]
    side = PANEL // zoom
    top, left = (height - side) // 2, (width - side) // 2
    part = Image.fromarray(image[top : top + side, left : left + side])
    return part.resize((PANEL, PANEL), Image.Resampling.NEAREST)


def sheet(panels: list[tuple[str, Image.Image]], columns: int) -> Image.Image:
    """Set panels in rows, each with its caption."""
    sky = quantize(srgb_from_linear(np.array(BACKGROUND)))
    rows = -(-len(panels) // columns)
    image = Image.new("RGB", (columns * PANEL, rows * (PANEL + 30)), tuple(sky.tolist()))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=14)
    for number, (caption, part) in enumerate(panels):
        x, y = number % columns * PANEL, number // columns * (PANEL + 30)
        image.paste(part, (x, y + 30))
        draw.text((x + 6, y + 8), caption, fill=(20, 30, 40), font=font)
    return image.quantize(192, dither=Image.Dither.NONE)


def pictures() -> None:
    """Write ``points_and_lines.png``: mesh and samples, near and far, enlarged."""
    panels = []
    for name in ("chestnut", "palm", "sunflower"):
        plant = tl.grow_plant(name, seed=1)
        full = tl.FullMesh.build(plant)
        lod = tl.PointsAndLines.build(plant, splat_factor="coverage")
        for distance, zoom in ((6.0, 2), (18.0, 6)):
            camera = tl.orbit(plant, count=8, elevation_deg=8, distance=distance, size=(480, 480))
            chosen = lod.selection(camera[1])
            counts = [
                sum(getattr(c, kind) for c in chosen) for kind in ("triangles", "points", "lines")
            ]
            caption = "{} triangles, {} points, {} lines".format(*counts)
            panels.append((f"{name}, mesh, {distance:g} radii", panel(full, camera[1], zoom)))
            panels.append((caption, panel(lod, camera[1], zoom)))
    sheet(panels, 4).save(HERE / "points_and_lines.png", optimize=True)


def pruning() -> None:
    """Write ``stochastic_pruning.png``; print errors of pruning and of points at equal vertices."""
    panels = []
    plant = tl.grow_plant("chestnut", seed=1)
    full = tl.FullMesh.build(plant, wood=False)
    cases = [
        ("with contrast", {}),
        ("without", {"contrast": False}),
        ("no shrinking", {"shrink": 0.0}),
    ]
    pruned = {
        name: tl.StochasticPruning.build(plant, wood=False, **params) for name, params in cases
    }
    points = tl.PointsAndLines.build(plant, wood=False, octree_depth=0, importance=1.0)
    for distance in (5.0, 10.0, 20.0, 40.0, 80.0):
        cameras = tl.orbit(plant, count=4, elevation_deg=10, distance=distance)
        references = [tl.render(full, camera, samples=SAMPLES) for camera in cameras]
        share = pruned["with contrast"].level(cameras[0]).kept_share
        count = 3 * full.footprint.triangles * share
        (chosen,) = points.selection(cameras[0])
        spacing = float(np.clip(np.sqrt(chosen.needed / count), 0.01, 256.0))
        same = points.drawn(sample_distance_px=spacing, splat_factor="coverage")
        plain = points.drawn(splat_factor="coverage")
        for name, lod in [*pruned.items(), ("points, as many vertices", same), ("points", plain)]:
            frames = [tl.render(lod, camera, samples=SAMPLES) for camera in cameras]
            errors = list(map(tl.metrics.compare, references, frames))
            print(
                f"{distance:g} radii, u = {share:.3f}, {name}: FLIP "
                f"{np.mean([e.flip for e in errors]):.4f}, bias "
                f"{np.mean([e.coverage_bias for e in errors]):+.4f}, vertices "
                f"{3 * frames[0].stats.triangles + frames[0].stats.points}, "
                f"{np.median([frame.stats.frame_millis for frame in frames]):.1f} ms"
            )
    camera = tl.orbit(plant, count=8, elevation_deg=8, distance=6.0, size=(480, 480))[1]
    lod = pruned["with contrast"]
    panels = [("mesh", panel(full, camera, 2))]
    for share in (0.5, 0.2, 0.05):
        panels.append((f"{share:.0%} of the leaves", panel(lod.at(kept_share=share), camera, 2)))
    sheet(panels, 4).save(HERE / "stochastic_pruning.png", optimize=True)


JOBS = {
    job.__name__: job
    for job in (law, coverage, transition, sweep, antialias, memory, pictures, pruning)
}

if __name__ == "__main__":
    mpl.rcParams["svg.hashsalt"] = "treelod"
    for chosen_job in sys.argv[1:] or list(JOBS):
        print(f"-- {chosen_job}", flush=True)
        JOBS[chosen_job]()
