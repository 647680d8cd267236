"""
Draw the worst case of paths through groves: ``worst_case.png``; print the table of it.

Run it from the project's root: ``uv run python docs/images/make_worst_case.py [TABLE]``. It takes
some twenty minutes on two processors that do nothing else. What it measures is kept in TABLE, a CSV
file, if one is given, and drawn from there the next time.
"""

import io
import sys
from pathlib import Path

import pandas as pd
from PIL import Image

import treelod as tl
from treelod import plots

HERE = Path(__file__).parent
COLORS = 64
DPI = 130

TREES = {1: 1, 3: 1, 10: 2, 30: 5, 100: 10}
"""Trees of a grove, and of how many windows the full mesh draws one."""


def measured() -> pd.DataFrame:
    """Walk through each grove with the mesh and with the paper's slicings."""
    plant = tl.grow_plant("grove", seed=1)
    subjects = {
        "full_mesh": tl.FullMesh.build(plant),
        "slicings": tl.Slicings.build(plant, wood_triangle_count=200, format="rgb5a1"),
    }
    tables = []
    for trees, stride in TREES.items():
        found = tl.walks.walk(
            plant,
            subjects,
            path="through",
            tree_counts=(trees,),
            every={"full_mesh": stride},
            samples=1,
        )
        tables.append(found.table)
        print(found.table.to_string(), file=sys.stderr)
    return pd.concat(tables, ignore_index=True)


def main() -> None:
    """Measure, or read what was measured, and draw it."""
    kept = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    if kept is not None and kept.exists():
        table = pd.read_csv(kept)
    else:
        table = measured()
        if kept is not None:
            table.to_csv(kept, index=False)
    worst = table.pivot_table(index="tree_count", columns="label", values="frame_millis_worst")
    mean = table.pivot_table(index="tree_count", columns="label", values="frame_millis_mean")
    print("| trees | mesh, worst | mean | slicings, worst | mean | worst by worst |")
    print("|---|---|---|---|---|---|")
    for trees in worst.index:
        mesh, slices = worst.loc[trees, ["full_mesh", "slicings"]]
        means = mean.loc[trees, ["full_mesh", "slicings"]]
        print(
            f"| {trees} | {mesh:.1f} ms | {means.iloc[0]:.1f} ms | {slices:.1f} ms "
            f"| {means.iloc[1]:.1f} ms | {mesh / slices:.1f} |"
        )
    drawn = plots.encode(plots.worst_case(table), "png", dpi=DPI)
    with Image.open(io.BytesIO(drawn)) as picture:
        few = picture.convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
        few.save(HERE / "worst_case.png", optimize=True)


if __name__ == "__main__":
    main()
