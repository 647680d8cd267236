"""
Draw what the documents show of plots: ``plots_*.png``.

Run it from the project's root: ``uv run python docs/images/make_plots.py [STORE]``. The sweep takes
some minutes; it is kept in the folder STORE, if one is given, and gone on with from there.
"""

import io
import sys
import tempfile
from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

import treelod as tl
from treelod import plots
from treelod.cameras import default_cameras

HERE = Path(__file__).parent
COLORS = 256
DPI = 110

GRID = {
    "slicings": {"slice_count": [1, 2, 3, 5, 7], "resolution": 96},
    "leaf_clusters": {
        "cluster_count": [8, 16, 32, 64],
        "alpha_rel": [0.01, 0.1],
        "resolution": 128,
    },
    "points_and_lines": {"splat_factor": [0.5, 1.0, 2.0, 4.0]},
}
FEW = (
    "full_mesh",
    "slicings:slice_count=5",
    "leaf_clusters:cluster_count=32,alpha_rel=0.01",
    "points_and_lines:splat_factor=1",
)


def swept(plant: tl.Plant, store: str) -> pd.DataFrame:
    """Measure the grid from 8 azimuths, 3 elevations and 3 distances."""
    cameras = default_cameras(plant, elevations_deg=(0, 20, 50), size=(240, 180))
    return tl.sweep(plant, GRID, cameras, store=store, reference_samples=16, repeats=3, warmup=1)


def switched(plant: tl.Plant) -> pd.DataFrame:
    """Walk away from leaf clusters that change level at three distances, in two ways."""
    near, far = (tl.orbit(plant, 1, 10.0, distance, (320, 240))[0] for distance in (3.0, 24.0))
    tables = []
    for label, change in {
        "exchanged": {"morph": False, "fade_share": 0.0},
        "moved": {"morph": True, "fade_share": 0.0},
        "moved and faded": {"morph": True, "fade_share": 0.1},
    }.items():
        lod = tl.LeafClusters.build(
            plant,
            cluster_count=(64, 32, 16, 8),
            resolution=128,
            level_distances=(4, 8, 16),
            two_sided=False,
            **change,
        )
        tables.append(tl.switches(lod, [near, far], plant=plant, label=label, samples=16))
    return pd.concat(tables, ignore_index=True)


def strip(plant: tl.Plant) -> Any:
    """Show two techniques from one camera."""
    (camera,) = tl.orbit(plant, 1, 10.0, 3.0, (240, 200))
    truth = tl.render(tl.FullMesh.build(plant), camera, samples=64)
    lods = {
        "slicings:slice_count=5": tl.Slicings.build(plant, resolution=96),
        "leaf_clusters:cluster_count=32": tl.LeafClusters.build(plant, resolution=128),
    }
    frames = {name: tl.render(lod, camera, samples=64) for name, lod in lods.items()}
    return plots.picture_strip(frames, truth)


def save(name: str, figure: Any) -> None:
    """Write a figure, with as few colours as it needs."""
    picture = Image.open(io.BytesIO(plots.encode(figure, "png", dpi=DPI))).convert("RGB")
    small = picture.quantize(COLORS, dither=Image.Dither.NONE)
    small.save(HERE / f"plots_{name}.png", optimize=True)


def main() -> None:
    """Write every picture."""
    plant = tl.grow_plant("chestnut", leaf_count=2000)
    with tempfile.TemporaryDirectory() as folder:
        table = swept(plant, sys.argv[1] if len(sys.argv) > 1 else folder)
    few = table[table["label"].isin(FEW)]
    if few["label"].nunique() != len(FEW):
        msg = f"labels are {sorted(table['label'].unique())}"
        raise RuntimeError(msg)
    save("speed", plots.speed_against_error(table))
    save("memory", plots.memory_against_error(table))
    save("parameter", plots.error_against_parameter(table, "cluster_count"))
    save("azimuth", plots.error_by_azimuth(few))
    save("distance", plots.error_by_distance(few))
    save("heat_map", plots.error_heat_map(few))
    save("coverage", plots.coverage(few))
    save("popping", plots.popping(switched(plant), "distance"))
    save("strip", strip(plant))


if __name__ == "__main__":
    main()
