# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 4 How large should a splat be?
#
# From afar a leaf is less than a pixel. *Points and lines* then draw no leaves but random points
# on them, each as a small square, a *splat*. The further away, the fewer points. A splat of $s$
# times the area that one point stands for has the *splat factor* $s$.
#
# **The question.** Which $s$ gives the best picture?
#
# **What we sweep.** `splat_factor` from 0.5 to 3, at four distances.
#
# **What the paper says** (O. Deussen, C. Colditz, M. Stamminger, G. Drettakis, *Interactive
# Visualization of Complex Plant Ecosystems*, 2002): splats should be slightly larger than $s = 1$,
# because random points leave gaps; 1.2 to 1.5 are usually sufficient.

# %%
import os

import pandas as pd

import treelod as tl

# %% tags=["parameters"]
small = os.environ.get("TREELOD_NOTEBOOK_SCALE") == "small"

factors = [0.7, 1.3] if small else [0.5, 0.7, 1.0, 1.3, 1.6, 2.0, 3.0]
distances = (10, 40) if small else (5, 10, 20, 80)
azimuth_count = 1 if small else 5
sweep_size = (96, 72) if small else (480, 360)

# %%
plant = tl.grow_plant("grove", seed=1)
print(plant.summary())

# %% [markdown]
# ## Look first
#
# Too small, the paper's, and too large: a picture of few pixels, enlarged.

# %%
camera = tl.orbit(plant, 5, 10, distance=10, size=(180, 135), fov_y_deg=16)[1]
truth = tl.render(tl.FullMesh.build(plant), camera, samples=64)
lod = {factor: tl.PointsAndLines.build(plant, splat_factor=factor) for factor in (0.5, 1.3, 3.0)}
frames = {f"s = {s:g}": tl.render(points, camera, samples=64) for s, points in lod.items()}
tl.plots.picture_strip(frames, reference=truth, background="white")

# %% [markdown]
# With 0.5 the trunk shows through holes. With 3 the crown is a solid mass, and all that is fine at
# its edge has grown together. The paper's 1.3 has no holes, but is plainly denser than the truth:
# its background no longer shows through.
#
# ## Sweep


# %%
def cameras(plant):
    """Place cameras around the plant, at each distance."""
    return [
        camera
        for distance in distances
        for camera in tl.orbit(plant, azimuth_count, 10, distance, sweep_size)
    ]


settings = {
    "store": "sweeps/04_splat_factor",
    "reference_samples": 16 if small else 64,
    "timing": "none",
}
table = tl.sweep(plant, {"points_and_lines": {"splat_factor": factors}}, cameras, **settings)

# %% [markdown]
# ## The curve

# %%
tl.plots.error_against_parameter(table, "splat_factor")

# %% [markdown]
# Each distance has its best factor, inside the range, and it *shrinks with distance*: near 1 at 5
# and 10 radii, about 0.7 at 20 and 80. At none of them is it as large as 1.2 to 1.5.
#
# ## Holes and excess
#
# Why? The mean coverage says it: below 0 there are holes, above 0 the crown is too dense.

# %%
tl.plots.error_against_parameter(table, "splat_factor", "coverage_bias")

# %% [markdown]
# Coverage rises with every step of $s$, and crosses 0 close to where the error is least. Near by
# that is at about $s = 1$, where splats together have the area of the polygons they stand for. Far
# away many leaves fall on one pixel. Leaves *overlap* there, and hide one another; splats one
# pixel apart do so less. The same area in splats then covers more than in leaves.
#
# ## Measure it instead
#
# `splat_factor="coverage"`, the default here, does not guess. While building, it measures at which
# factor points cover what the polygons cover, for several distances between points, and each view
# takes the one that suits it. These rows go to the same store; nothing above is computed again.

# %%
measured = tl.sweep(plant, {"points_and_lines": {"splat_factor": "coverage"}}, cameras, **settings)
measured = measured[measured["technique"] == "points_and_lines"].assign(
    label="points_and_lines:splat_factor=coverage"
)
both = pd.concat([table.drop(columns="param_splat_factor"), measured])
few = both[both["label"].str.fullmatch(r"full_mesh|.*=(0\.7|1|1\.3|coverage)")]
few.pivot_table(index="label", columns="distance", values="flip", sort=False).round(3)

# %%
tl.plots.coverage(few)

# %% [markdown]
# The measured factor has an error as small as that of the best fixed one at every distance, or
# nearly, and a coverage bias of next to 0 at all of them. No fixed factor does that.
#
# ## What it costs
#
# Nothing: how many points there are depends on the distance alone, and not on the factor. Twice as
# far is a quarter of them, which is what makes points attractive. The other vertices are those of
# the wood, most of which is still triangles at 10 and at 20 radii.

# %%
counts = measured.groupby("distance")[["drawn_points", "drawn_vertices"]].mean()
counts.round().astype(int)

# %% [markdown]
# ## What next
#
# - Half as many points, twice as large: sweep `sample_distance_px` (1, 1.5, 2, 4) together with
#   the factor. How much error does a quarter of the points cost?
# - Try another plant: a `pine` is drawn as lines, which splat factors do not concern.
# - Far beyond 80 radii a tree is a handful of points, and the picture is chance. Notebook 6 goes
#   there.
