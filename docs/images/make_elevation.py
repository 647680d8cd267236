"""
Draw the error of every technique by the direction it is seen from: ``elevation.png``.

Run it from the project's root: ``uv run python docs/images/make_elevation.py [STORE]``. The sweep
takes some minutes; it is kept in the folder STORE, if one is given, and gone on with from there.
"""

import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

import treelod as tl
from treelod import plots
from treelod.techniques import REGISTRY

HERE = Path(__file__).parent
COLORS = 128
DPI = 80

ELEVATIONS_DEG = (-15, 0, 15, 30, 50, 70, 89)
DISTANCES = (3.0, 12.0)


def main() -> None:
    """Sweep all techniques with their default parameters, and draw the map."""
    plant = tl.grow_plant("chestnut", leaf_count=2000)
    cameras = [
        camera
        for distance in DISTANCES
        for elevation in ELEVATIONS_DEG
        for camera in tl.orbit(plant, 8, elevation, distance, (160, 160))
    ]
    grid = {name: {} for name in REGISTRY if name != tl.FullMesh.name}
    with tempfile.TemporaryDirectory() as folder:
        store = sys.argv[1] if len(sys.argv) > 1 else folder
        table = tl.sweep(plant, grid, cameras, store=store, reference_samples=64, repeats=1)
    means = table.pivot_table(index="label", columns=["distance", "elevation_deg"], values="flip")
    print(means.round(3).to_string())
    drawn = plots.encode(plots.error_heat_map(table), "png", dpi=DPI)
    with Image.open(io.BytesIO(drawn)) as picture:
        few = picture.convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
        few.save(HERE / "elevation.png", optimize=True)


if __name__ == "__main__":
    main()
