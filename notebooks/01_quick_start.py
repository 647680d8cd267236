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
# # 1 Quick start
#
# A tree in a game or a film may have a hundred thousand leaves. From afar nobody sees them one by
# one, so one draws something cheaper in their place: a few pictures on cards, a cloud of points,
# fewer and larger leaves. Each of these is a *level of detail*, and each is wrong in its own way.
#
# **The question.** For this plant, seen like this: how wrong does a cheaper stand-in look, and
# what does it save?
#
# This notebook grows a tree, replaces it by one such technique, measures the error, and then lets
# several techniques compete. It needs no file and no graphics card. Run it from top to bottom.

# %%
import os

import pandas as pd

import treelod as tl

# %% [markdown]
# Settings stand in one cell, so that they are easy to change. With `TREELOD_NOTEBOOK_SCALE=small`
# everything is tiny, to test in seconds that the notebook still runs; what the text says about the
# results is then not to be expected of them.

# %% tags=["parameters"]
small = os.environ.get("TREELOD_NOTEBOOK_SCALE") == "small"

preset = "grove"  # or "chestnut", "broadleaf", "pine", "palm", "sunflower", "daisy", "grass"
picture_size = (96, 72) if small else (320, 240)  # of single pictures, in pixels
sweep_size = (64, 48) if small else (240, 180)  # of the many pictures of a sweep
azimuth_count = 2 if small else 5  # cameras around the plant

# %% [markdown]
# ## A plant
#
# Plants are grown from a preset and a seed, the same on every machine. `tl.load_plant("tree.glb")`
# takes one of yours instead. A plant has *wood*, which is solid, and *foliage*, which is cut into
# leaves: techniques treat them differently.

# %%
plant = tl.grow_plant(preset, seed=1)
print(plant.summary())

# %% [markdown]
# ## The truth
#
# The full mesh with many samples a pixel is what everything else is compared with. A frame is its
# own picture in a notebook.

# %%
camera = tl.orbit(plant, count=12, elevation_deg=5, distance=2.5, size=picture_size)[1]
mesh = tl.FullMesh.build(plant)
truth = tl.render(mesh, camera, samples=64)
truth

# %% [markdown]
# ## A technique
#
# *Slicings* (Jakulin 2000) cut the crown into a few parallel slabs, flatten each into one textured
# card, and do so for several directions. The wood stays a mesh. `build` takes the plant and the
# technique's parameters, and says what the result weighs.

# %%
slicings = tl.Slicings.build(plant, slice_count=5, resolution=128)
slicings.footprint

# %%
frame = tl.render(slicings, camera, samples=64)
frame

# %% [markdown]
# ## The error
#
# `metrics.compare` looks at both pictures on black and on white, since a crown that lets too much
# background through may show on one of them only. These are the numbers to know:
#
# - `flip`: how different two pictures look when they alternate in place, from 0 (the same) to 1.
#   This is the headline.
# - `coverage_bias`: how much more of the picture the technique covers than the truth does. Below 0
#   the crown is too thin, above 0 too dense.
# - `psnr`, `ssim`: the classics. They mind a leaf that moved by a pixel as much as one that is
#   gone.

# %%
errors = tl.metrics.compare(truth, frame)
print(f"FLIP {errors.flip:.3f}, coverage bias {errors.coverage_bias:+.4f}")
print(f"PSNR {errors.psnr:.1f} dB, SSIM {errors.ssim:.3f}")

# %% [markdown]
# Always look at the pictures too. The strip shows truth, technique, and where they differ:
# brighter is worse. Outline and density are right, as the small coverage bias said. But the crown
# is soft: leaves are a few texels large on a card, and this camera stands half way between two
# directions of slicing, so two half-transparent sets of cards are laid over each other, and limbs
# shine through that leaves had hidden.

# %%
tl.plots.picture_strip({"slicings": frame}, reference=truth)

# %% [markdown]
# ## Several techniques, many views
#
# One view proves little. `tl.sweep` builds every technique with every parameter of a *grid*, draws
# each from many cameras, and measures errors and times. Here five techniques run with nearly all
# of their defaults, at three distances, told in radii of the ball around the plant.
#
# Rows go to a *store*, a folder. Run the cell again and it is done at once; stop it half way and
# it goes on from there.


# %%
def cameras(plant):
    """Place cameras around the plant, at three distances."""
    return [
        camera
        for distance in (3, 10, 30)
        for camera in tl.orbit(plant, azimuth_count, 5, distance, sweep_size)
    ]


grid = {
    "slicings": {"resolution": 128},
    "leaf_clusters": {"resolution": 128, "samples": 4},
    "points_and_lines": {},
    "stochastic_pruning": {},
    "simplified_mesh": {},
}
table = tl.sweep(
    plant,
    grid,
    cameras,
    store="sweeps/01_quick_start",
    reference_samples=16,
    repeats=3,
)

# %% [markdown]
# The result is a `pandas.DataFrame` with one row for each technique and camera. Errors, costs and
# where all of it came from are columns. Of the many, these:

# %%
columns = ["label", "distance", "azimuth_deg", "flip", "coverage_bias", "drawn_vertices"]
pd.DataFrame(table)[columns].groupby("label", sort=False).head(1).round(3)

# %% [markdown]
# The row `full_mesh` is the mesh with the 4 samples a pixel that one would draw in a game, against
# the same mesh with many. Its error is aliasing. A technique below it is as good as the mesh
# itself.
#
# `summary` averages over the cameras. FLIP by technique and distance:

# %%
summary = table.summary(by=["distance"])
summary.pivot(index="label", columns="distance", values="flip").round(3)

# %% [markdown]
# Every error falls with distance, as it must: the same wrong leaf is fewer pixels. At 3 radii
# pruning has no error at all, because it draws all leaves while they are large. From 10 radii on
# slicings are below the full mesh. And by how much is each too dense (above 0) or too thin (below
# 0)?

# %%
summary.pivot(index="label", columns="distance", values="coverage_bias").round(3)

# %% [markdown]
# `simplified_mesh` is a simplifier for solid things, let loose on leaves. It cannot join what
# hangs apart, so it eats leaves until the number is right: the crown is the thinnest of all.
#
# ## Speed against error
#
# The plot that decides: to the left is fast, down is right. What lies on the dashed front is
# beaten by nothing else in both at once; all other settings can be left alone at that distance.
#
# Times are those of the program's own renderer on the processors that this notebook ran on, with
# whatever else they had to do. Another machine has other times, and on a graphics card cards are
# cheaper against triangles. Errors are the same everywhere.

# %%
tl.plots.speed_against_error(table)

# %% [markdown]
# At 10 and at 30 radii points are the quickest of those that look right. At 3 radii the mesh
# itself is hard to beat: this tree has only twenty thousand triangles, and large cards cost
# pixels.
#
# ## What next
#
# - Change `preset` above, or load a plant of your own, and run everything again.
# - Notebooks 2 to 4 each turn one knob of one technique: the number of slices, the weight of a
#   leaf's angle, the size of splats. Notebook 5 runs every technique there is, 6 collects what
#   breaks them, and 7 shares a sweep among many processes.
