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
# # 2 How many slices?
#
# *Slicings* draw a crown as parallel cards. Each card, a *slice*, shows the leaves of one slab of
# the crown. One set of parallel slices is a *slicing*; six of them look in six directions around
# the tree, and between two directions both are drawn, half transparent.
#
# **The question.** How many slices does a slicing need?
#
# **What we sweep.** `slice_count`, from 1 (a plain billboard for each direction) to 14, then the
# number of directions, `slicing_count`.
#
# **What the paper says** (A. Jakulin, *Interactive Vegetation Rendering with Slicing and
# Blending*, 2000): 3 to 7 slices are usually best, the default here is 5; 6 directions are enough,
# and 12 look no better.

# %%
import os

import treelod as tl

# %% tags=["parameters"]
small = os.environ.get("TREELOD_NOTEBOOK_SCALE") == "small"

slice_counts = [1, 3] if small else [1, 2, 3, 5, 7, 10, 14]
slicing_counts = [3, 6] if small else [3, 4, 6, 8, 12]
distances = (3, 10)
picture_size = (96, 72) if small else (280, 210)
sweep_size = (64, 48) if small else (240, 180)

# %% [markdown]
# The plant is this program's own grown version of the tree in the paper: 19,657 triangles of
# leaves and twigs.

# %%
plant = tl.grow_plant("grove", seed=1)
print(plant.summary())

# %% [markdown]
# ## Look first
#
# From 3 radii, exactly in the direction of one slicing. Each row is the mesh, the slices, and
# their difference.

# %%
camera = tl.orbit(plant, count=6, elevation_deg=5, distance=3, size=picture_size)[1]
truth = tl.render(tl.FullMesh.build(plant), camera, samples=16)
frames = {
    f"slice_count {count}": tl.render(
        tl.Slicings.build(plant, slice_count=count, resolution=128), camera, samples=16
    )
    for count in slice_counts
    if count in (1, 3, 7)
}
tl.plots.picture_strip(frames, reference=truth, background="white")

# %% [markdown]
# All three get the outline right, roughly. But a single card lies at one depth, while leaves on
# the near side of the crown should look larger than those on the far side, and the trunk is seen
# on one side of the card only. The more slices, the nearer each leaf is to its own depth.
#
# ## Sweep
#
# Seven cameras 30 degrees apart, so that every second one looks along a slicing and the others
# half way between two, which is the worst case.


# %%
def cameras(plant):
    """Place cameras every 30 degrees, at each distance."""
    count = 2 if small else 7
    return [
        camera
        for distance in distances
        for camera in tl.orbit(plant, 12, 5, distance, sweep_size)[1 : 1 + count]
    ]


table = tl.sweep(
    plant,
    {"slicings": {"slice_count": slice_counts, "resolution": 128}},
    cameras,
    store="sweeps/02_slice_count",
    reference_samples=16,
    repeats=3,
)

# %% [markdown]
# ## The curve
#
# The line is the mean over the cameras, the band reaches from the best to the worst of them. The
# dotted line is the mesh with 4 samples a pixel: who gets below it is as good as the mesh.

# %%
tl.plots.error_against_parameter(table, "slice_count")

# %% [markdown]
# The same as numbers, with what each step down the list gains:

# %%
by_count = table.summary(by=["distance"]).merge(
    table[["label", "param_slice_count"]].drop_duplicates(), on="label"
)
flip = by_count.dropna(subset="param_slice_count").pivot(
    index="param_slice_count", columns="distance", values="flip"
)
flip.join(flip.diff().add_prefix("step at ")).round(3)

# %% [markdown]
# From 1 to 7 slices the error falls to a little over half near by, and to less than half from
# further away. After that it flattens: at 10 radii 14 slices gain only 0.002 over 7. Near by it
# goes on falling, though more and more slowly, because there a slab's thickness is still many
# pixels of parallax. So the paper's 3 to 7 holds for the distances that slicings are made for.
#
# The first step is the odd one: near by 2 slices are no better than 1.
#
# ## What it costs
#
# Bytes grow with every slice, and so do fragments: each slice covers nearly the whole crown again.

# %%
tl.plots.memory_against_error(table)

# %%
tl.plots.error_against_parameter(table, "slice_count", "fragments")

# %% [markdown]
# Fragments grow in proportion to slices. At 5 slices they are more than twice those of the mesh,
# which is why slices want hardware that fills pixels quickly, and few of them.
#
# ## Where it is worst
#
# The error by direction shows six valleys, one for each slicing (here those that the cameras saw),
# and peaks half way between.

# %%
tl.plots.error_by_azimuth(table)

# %% [markdown]
# ## More directions instead?
#
# If the worst case is half way between two directions, why not take more of them?

# %%
directions = tl.sweep(
    plant,
    {"slicings": {"slicing_count": slicing_counts, "slice_count": 5, "resolution": 128}},
    # 7.5 degrees apart: some look along a slicing, others half way between two
    lambda plant: tl.orbit(plant, 48, 5, 10, sweep_size)[: 2 if small else 12],
    store="sweeps/02_slice_count",
    reference_samples=16,
    timing="none",
)
tl.plots.error_against_parameter(directions, "slicing_count")

# %%
directions.summary().set_index("label")[["flip", "flip_worst", "total_bytes"]].round(3)

# %% [markdown]
# Up to 6 directions the error falls quickly, then slowly, while bytes grow in proportion. On
# average 12 gain only 0.004 over 6, as the paper says. The worst camera, half way between two
# directions, gains more: 0.047 becomes 0.036.
#
# ## What next
#
# - Sweep `correction`, which decides how opaque two half-transparent slicings are together: `0.0`,
#   `0.5` (the paper's), `"fit"` and `"optical"`. Notebook 6 shows where it goes wrong.
# - Cross `slice_count` with `resolution`: `{"slice_count": [3, 5, 7], "resolution": [64, 128,
#   256]}`. Lists of one dict are crossed. Are three sharp slices better than seven soft ones?
# - Try 4 and 6 slices: do even counts lag behind odd ones?
