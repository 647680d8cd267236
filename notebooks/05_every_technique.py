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
# # 5 Every technique on your plant
#
# **The question.** Which technique suits *this* plant, at the distances at which it will be seen?
#
# **What we sweep.** Everything in `treelod.techniques.REGISTRY`, each technique with its defaults.
# Nothing below names a technique, so one that is added to the registry joins when this is run
# again, and only its own rows are computed.

# %%
import os
from pathlib import Path

from IPython.display import display

import treelod as tl
from treelod.techniques import REGISTRY

# %% [markdown]
# Put your plant here: the name of a preset, or a file (GLB, glTF, OBJ, PLY). Pictures of 240 x 180
# pixels are quick. Errors depend on the size of the picture, so set it to yours when it matters.

# %% tags=["parameters"]
small = os.environ.get("TREELOD_NOTEBOOK_SCALE") == "small"

plant_source = "grove"  # or "my_tree.glb"
distances = (3, 15) if small else (3, 10, 30)  # in radii of the ball around the plant
elevations_deg = (0, 40)  # above the horizon
azimuth_count = 2 if small else 4  # cameras on each circle
picture_size = (64, 48) if small else (240, 180)
reference_samples = 16
repeats = 1 if small else 3  # timed frames of each technique and camera

# %%
source = Path(plant_source)
plant = tl.load_plant(source) if source.suffix else tl.grow_plant(plant_source, seed=1)
print(plant.summary())

# %% [markdown]
# If leaves were taken for wood or the other way round, name the materials: `tl.load_plant(source,
# foliage=["leaves"])`.
#
# ## The techniques
#
# One line each, from their own documentation.

# %%
for name, technique in REGISTRY.items():
    about = technique.__doc__.strip().partition("; see")[0]
    print(f"{name:20} {about}")

# %% [markdown]
# ## Sweep
#
# A technique that cannot stand for this plant (one without leaves, for example) is recorded and
# left out, instead of ending the sweep.


# %%
def cameras(plant):
    """Place cameras on circles at several heights and distances."""
    return [
        camera
        for distance in distances
        for elevation in elevations_deg
        for camera in tl.orbit(plant, azimuth_count, elevation, distance, picture_size)
    ]


table = tl.sweep(
    plant,
    list(REGISTRY),
    cameras,
    store="sweeps/05_every_technique",
    reference_samples=reference_samples,
    repeats=repeats,
    on_error="record",
)
for failure in table.attrs["failed"]:
    print(f"left out: {failure['technique']}, view {failure['view']}: {failure['error']}")

# %% [markdown]
# ## Errors
#
# FLIP, from 0 (the same picture) to 1, mean over the cameras of a distance. `full_mesh` is the
# mesh with the 4 samples a pixel of a real-time picture: its error is aliasing, and the measure of
# all others.

# %%
summary = table.summary(by=["distance"])
summary.pivot(index="label", columns="distance", values="flip").round(3)

# %% [markdown]
# Vertices of a frame, mean over the cameras of a distance. Some techniques draw less from afar,
# others always the same:

# %%
drawn = table.groupby(["label", "distance"], sort=False)["drawn_vertices"].mean()
drawn.unstack().round().astype(int)

# %% [markdown]
# ## Speed against error
#
# Left is fast, down is right. On the dashed front nothing else is better in both. Frames are drawn
# by this program's own renderer on the processors of this machine, among whatever else it does:
# take the order of magnitude, and run it on a quiet machine for more.

# %%
tl.plots.speed_against_error(table)

# %% [markdown]
# ## Memory against error

# %%
tl.plots.memory_against_error(table)

# %% [markdown]
# ## Too thin or too dense
#
# A crown that changes its density when one technique takes over from another is seen at once.
# Where a line leaves 0, the technique lets too much background through, or too little.

# %%
tl.plots.coverage(table)

# %% [markdown]
# ## From where
#
# Errors by direction, darker is better, for all that holds pictures in textures: what is baked
# from some directions suffers from others.

# %%
for label, rows in table.groupby("label", sort=False):
    if (rows["texture_bytes"] > 0).all():
        display(tl.plots.error_heat_map(table, label))

# %% [markdown]
# ## What it looks like
#
# Numbers rank, eyes decide. From the nearest circle, the three techniques with the least error and
# the three with the most, each from the camera where it is worst.

# %%
near = table[(table["distance"] == table["distance"].min()) & (table["label"] != "full_mesh")]
mesh = tl.FullMesh.build(plant)
ranked = near.groupby("label")["flip"].mean().sort_values().index
for label in [*ranked[:3], *ranked[3:][-3:]]:
    rows = near[near["label"] == label]
    camera = cameras(plant)[rows.loc[rows["flip"].idxmax(), "view"]]
    truth = tl.render(mesh, camera, samples=reference_samples)
    lod = REGISTRY[rows["technique"].iloc[0]].build(plant)
    frame = tl.render(lod, camera, samples=reference_samples)
    display(tl.plots.picture_strip({label: frame}, reference=truth, background="white"))

# %% [markdown]
# ## On the grove
#
# This is what the stored outputs show; another plant says something else.
#
# - At 3 radii the foliage hierarchy and pruning are nearly right, because they still draw most of
#   the crown. That is honest, and saves little.
# - At 10 radii points are the quickest of those that look like the mesh, and at 30 one billboard
#   is as quick. At 30 radii all but the simplified mesh and layered billboards are within 0.02 of
#   the mesh's own error.
# - Slicings and orthogonal slices are good from the side, and worse from 40 degrees above, where
#   slices are seen at a slant and the crown fades. Layered billboards were baked from one
#   direction, and all other azimuths count here.
# - From 10 radii on the octahedral impostor is nearest to the mesh. Near by it is the slowest: each
#   pixel follows rays into three pictures.
# - Leaf clusters hold most: 32 cards with two sides of 512 x 512 texels are a hundred megabytes.
#   Smaller `resolution` saves them nearly all of it; see notebook 3.
# - The simplified mesh is the cheapest and the worst: it throws leaves away without making others
#   larger.
#
# ## What next
#
# - Give each technique more than its defaults: `{"slicings": {"slice_count": [3, 5, 7]},
#   "points_and_lines": {"sample_distance_px": [1, 2, 4]}}` in place of `list(REGISTRY)`. Plots
#   then join the settings of one technique by a line.
# - Put several plants into one sweep: `tl.sweep({"mine": plant, "pine": tl.grow_plant("pine")},
#   ...)`.
# - `treelod compare my_tree.glb` does the same from the command line, with a report in one file.
