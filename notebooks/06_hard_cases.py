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
# # 6 Hard cases
#
# Papers show where a method works. This notebook shows where the formulas of the papers, or the
# obvious ways to fill their gaps, go wrong, and what is done here about it. Each section stands
# alone:
#
# 1. a plane fitted *across* its leaves, 2. crowns that grow thin, or too dense, between two
# directions, 3. slices from above, 4. leaves that lose their area when they collapse, 5. splats
# far away, 6. mips that make leaves vanish, 7. plants that are hardly plants, and what is refused.

# %%
import os

import numpy as np
import pandas as pd

import treelod as tl
from treelod.techniques import REGISTRY

# %% tags=["parameters"]
small = os.environ.get("TREELOD_NOTEBOOK_SCALE") == "small"

leaf_count = 400 if small else 2500
sparse_count, dense_count = (300, 900) if small else (3000, 12000)  # leaves of random crowns
picture_size = (96, 72) if small else (280, 210)
view_count = 2 if small else 4

# %% [markdown]
# Two helpers. The first makes a crown of square leaves at random places in a ball of 1 m radius,
# which face anywhere; the second tells how much of a picture is covered, mean over cameras.


# %%
def random_crown(count, size, seed=1, **settings):
    """Make a plant of square leaves, `size` metres a side, scattered in a ball."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (3 * count, 3))
    places = places[np.linalg.norm(places, axis=1) < 1][:count]
    across, other = rng.normal(size=(2, len(places), 3))
    along = np.cross(across, other)
    across *= size / 2 / np.linalg.norm(across, axis=1, keepdims=True)
    along *= size / 2 / np.linalg.norm(along, axis=1, keepdims=True)
    return squares(places, across, along, **settings)


def squares(places, across, along, **settings):
    """Make a plant of one rectangle a leaf: its middle, and what leads from there to two sides."""
    places, across, along = (np.asarray(part, float) for part in (places, across, along))
    count = len(places)
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    corners = np.stack([places + x * across + y * along for x, y in signs], axis=1)
    first = 4 * np.arange(count)[:, np.newaxis, np.newaxis]
    foliage = {
        "positions": corners.reshape(-1, 3),
        "triangles": (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
        "uvs": np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], (count, 1)),
        "colors": np.tile([0.15, 0.4, 0.1], (4 * count, 1)),
    }
    return tl.Plant.from_arrays(foliage=foliage, leaf_offsets=2 * np.arange(count + 1), **settings)


def covered(lod, cameras, samples=16):
    """Tell which share of the pictures is covered."""
    return np.mean(
        [tl.render(lod, camera, samples=samples).color[..., 3].mean() for camera in cameras]
    )


# %% [markdown]
# ## 1 A plane across its leaves
#
# Leaf clusters (Garcia et al. 2005) fit a plane to each cluster of leaves: the one of least error,
# whose normal is the eigenvector of the *smallest* eigenvalue of a matrix $A$. The paper finds it
# by power iteration on $A^{-1}$. That finds the eigenvalue of smallest *magnitude*. As soon as the
# weight of the angle matters, $A$ has eigenvalues far below zero, and the iteration finds another
# eigenvector: a plane that stands across the leaves.
#
# Clusters of a chestnut, each fitted both ways:

# %%
plant = tl.grow_plant("chestnut", seed=1, leaf_count=leaf_count)
leaves = plant.foliage
box = np.array([leaves.centers.min(axis=0), leaves.centers.max(axis=0)])
radius = np.linalg.norm(leaves.positions - box.mean(axis=0), axis=1).max()  # of the crown
rows = []
for alpha_rel in (0.001, 0.01, 0.1, 1.0):
    alpha = alpha_rel * radius**2
    ids = tl.cluster_leaves(
        leaves.centers, leaves.normals, cluster_count=32, alpha=alpha
    ).cluster_ids
    misses = tl.plane_misses(leaves.centers, leaves.normals, ids, alpha=alpha)
    rows.append(
        {
            "alpha_rel": alpha_rel,
            "clusters": len(misses.missed),
            "missed": int(misses.missed.sum()),
            "error, worst cluster": misses.ratio.max(),
            "error, all": misses.total_ratio,
        }
    )
pd.DataFrame(rows).set_index("alpha_rel").round(1)

# %% [markdown]
# The errors are those of the paper's planes over those of the best planes. What that does to a
# crown, at a weight of 0.1:

# %%
camera = tl.orbit(plant, 5, 10, 2.5, picture_size)[1]
truth = tl.render(tl.FullMesh.build(plant), camera, samples=16)
frames = {
    f'eigen="{eigen}"': tl.render(
        tl.LeafClusters.build(plant, alpha_rel=0.1, eigen=eigen, resolution=128, samples=4),
        camera,
        samples=16,
    )
    for eigen in ("exact", "paper")
}
tl.plots.picture_strip(frames, reference=truth, background="white")

# %% [markdown]
# Where the weight is small both agree. At 0.1 the paper's planes are worse in nearly all clusters.
# Leaves are then projected along a direction they do not face, and become slivers: the crown has
# lost twice as much of its coverage. By default planes come from an eigensolver that looks for the
# smallest eigenvalue; `eigen="paper"` is there to show the difference.
#
# ## 2 Between two directions
#
# Slicings (Jakulin 2000) draw two half-transparent sets of cards half way between two directions.
# Two layers of half the opacity hide less than one of all of it, so opacities are raised: by the
# paper's factor $1 + m \alpha_s$ with $m = 0.5$, or by a law for leaves scattered at random
# (`"optical"`). Two crowns, one sparse and one dense, half way between two directions; the numbers
# are coverage over that of the mesh, and should be 1:

# %%
crowns = {
    "sparse": random_crown(sparse_count, 0.04),
    "dense": random_crown(dense_count, 0.04),
}
between = [np.radians(30 + 60 * k) for k in range(view_count)]
rows = []
for name, crown in crowns.items():
    mesh = tl.FullMesh.build(crown)
    lods = {
        f"correction={correction}": tl.Slicings.build(
            crown, correction=correction, resolution=128, samples=4
        )
        for correction in (0.0, 0.5, "optical")
    }
    for pixels in (96, 24, 6):
        cameras = [
            tl.Camera.orthographic(
                (5 * np.sin(angle), 0, 5 * np.cos(angle)),
                (0, 0, 0),
                height=2.4,
                size=(pixels, pixels),
            )
            for angle in between
        ]
        truth = covered(mesh, cameras, samples=64)
        rows.append(
            {"crown": name, "pixels across": pixels, "covered": truth}
            | {label: covered(lod, cameras) / truth for label, lod in lods.items()}
        )
pd.DataFrame(rows).set_index(["crown", "pixels across"]).round(2)

# %% [markdown]
# Without correction both crowns are too thin, the sparse one by an eighth, and the paper's factor
# mends that well near by. Far away it covers too much, most of all in the dense crown: by 16 % at
# 6 pixels. There a texel holds a mean over leaves and gaps, and over crown and sky; and means that
# are laid over each other cover more than what they are the means of.
#
# The optical law takes leaves to be independent in both slicings. But a leaf is one and the same
# in both, so near by crowns stay too thin.
#
# So no constant is right for all crowns and distances. `correction="fit"` measures the $m$ that a
# crown needs, at one size of picture.
#
# ## 3 From above
#
# Slices stand upright. The paper is for views below 45 degrees of elevation, and the sweep shows
# why:

# %%
grove = tl.grow_plant("grove", seed=1)
elevations = (0, 60) if small else (0, 15, 30, 45, 60, 75)
above = tl.sweep(
    grove,
    {"slicings": {"resolution": 128}, "leaf_clusters": {"resolution": 128, "samples": 4}},
    lambda plant: [
        camera
        for elevation in elevations
        for camera in tl.orbit(plant, 12, elevation, 3, (96, 72) if small else (200, 150))[
            1 : 1 + 2
        ]
    ],
    store="sweeps/06_hard_cases",
    reference_samples=16,
    timing="none",
)
above.groupby(["elevation_deg", "label"], sort=False)[
    ["flip", "coverage_bias"]
].mean().unstack().round(3)

# %%
camera = tl.orbit(grove, 12, 75, 3, picture_size)[1]
truth = tl.render(tl.FullMesh.build(grove), camera, samples=16)
frame = tl.render(tl.Slicings.build(grove, resolution=128), camera, samples=16)
tl.plots.picture_strip({"slicings": frame}, reference=truth, background="white")

# %% [markdown]
# Up to 15 degrees nothing happens. From 30 on slices are seen at a slant, gaps open between them,
# and what they showed from the side is not what is seen from above: at 75 degrees the crown is a
# grey veil. Leaf clusters lie in any plane and do not mind; here they even get better. For views
# from above, slicings take `orientations="sphere"`.
#
# ## 4 Leaves that collapse
#
# A foliage hierarchy (Remolar et al. 2003) collapses two leaves into one larger leaf, again and
# again. A new leaf takes two corners of each parent, and no new vertex. The paper wants its area
# to be similar to that of all leaves below it. Three ways, by how many of the leaves are left; the
# numbers are coverage over that of the mesh:

# %%
ways = {
    "the paper's": {"keep_area": False, "keep_coverage": False, "choice": "paper"},
    "area kept": {"keep_area": True, "keep_coverage": False},
    "area and coverage kept": {},
}
shares = (1.0, 0.5, 0.2, 0.05)
full_count = 800 if small else 11_291  # leaves of the paper's chestnut
rows = {}
for tree in (plant, tl.grow_plant("chestnut", seed=1, leaf_count=full_count)):
    count = tree.foliage.leaf_count
    cameras = tl.orbit(tree, view_count, 10, 2.5, picture_size)
    truth = covered(tl.FullMesh.build(tree, wood=False), cameras)
    for way, settings in ways.items():
        lod = tl.FoliageHierarchy.build(tree, wood=False, **settings)
        rows[f"{count} leaves", way] = {
            f"{share:.0%}": covered(lod.at(leaf_count=round(share * count)), cameras) / truth
            for share in shares
        }
pd.DataFrame(rows).T.round(2)

# %% [markdown]
# On the chestnut of all its leaves the paper's rule covers less and less. Leaves cross and overlap
# there, and two corners of each cannot hold the area of both. On the thin one it covers too much,
# since another error works the other way: fewer and larger leaves hide one another less. Keeping
# the area mends the first error alone, and covers up to a third too much. By default both are
# kept: levels are measured, and scaled until they cover what all leaves do. (At 100 % there is an
# error already, because leaves have become rectangles.)
#
# ## 5 Splats far away
#
# Points and lines (Deussen et al. 2002) draw ever fewer points of ever larger leaves, each a splat
# of $s$ times the area that it stands for. The paper's $s$ is between 1.2 and 1.5. Foliage alone,
# coverage over that of the mesh:

# %%
mesh = tl.FullMesh.build(grove, wood=False)
factors = (1.0, 1.3, "coverage")
lods = {s: tl.PointsAndLines.build(grove, wood=False, splat_factor=s) for s in factors}
rows = {}
for distance in (5, 20, 80, 320):
    cameras = tl.orbit(grove, view_count, 10, distance, (480, 360))
    truth = covered(mesh, cameras, samples=64)
    rows[distance] = {"points": tl.render(lods[1.0], cameras[0]).stats.points} | {
        f"s = {s}": covered(lod, cameras, samples=64) / truth for s, lod in lods.items()
    }
pd.DataFrame(rows).T.rename_axis("distance").round(2)

# %% [markdown]
# The further away, the more a fixed factor covers too much, since leaves hide one another within a
# pixel and splats hardly do: at 320 radii $s = 1.3$ covers twice what is right. The measured
# factor stays within 3 % as long as there are points to measure. With 5 points on a tree the
# picture is chance, and no factor helps.
#
# ## 6 Mips that make leaves vanish
#
# Cards of cut-out leaves are *alpha-tested*: a texel is there if its alpha is at least one half.
# Coarser mip levels hold means. If a fifth of a card is leaf, the mean alpha of its coarsest level
# is 0.2, and nothing passes the test. Cards with seventy small round leaves each:

# %%
texels = 128
texture = np.zeros((texels, texels, 4), np.uint8)
texture[..., :3] = 255  # times the green of the leaves
y, x = np.mgrid[0:texels, 0:texels]
for middle in np.random.default_rng(3).uniform(6, texels - 6, (70, 2)):
    texture[np.hypot(x - middle[0], y - middle[1]) < 4, 3] = 255
print(f"covered by leaves: {(texture[..., 3] > 0).mean():.2f} of a card")
material = tl.Material(name="card", texture=texture, alpha_mode="mask")
cards = random_crown(60, 0.8, materials=[material])
camera = tl.orbit(cards, 1, 10, 2.5, picture_size)[0]
tl.render(tl.FullMesh.build(cards), camera, samples=16)

# %% [markdown]
# The same mesh, read from level 0 (the truth), and with mips; and leaf clusters, whose textures
# are baked from those cards. Coverage over that of the truth, by the size of the picture:

# %%
mesh = tl.FullMesh.build(cards)
lods = {
    "mesh, trilinear": tl.FullMesh.build(cards, filter="trilinear"),
    "leaf_clusters": tl.LeafClusters.build(cards, resolution=128, samples=4),
}
rows = {}
for pixels in (256, 64, 16, 8):
    cameras = [
        tl.Camera.orthographic(
            (5 * np.sin(a), 1, 5 * np.cos(a)), (0, 0, 0), height=3, size=(pixels, pixels)
        )
        for a in (0, 1, 2, 3, 4, 5)
    ]
    truth = covered(mesh, cameras, samples=64)
    rows[pixels] = {label: covered(lod, cameras, samples=64) / truth for label, lod in lods.items()}
pd.DataFrame(rows).T.rename_axis("pixels across").round(2)

# %% [markdown]
# With plain means nearly two thirds of the leaves are gone at 8 pixels: trees become bare as they
# recede. Leaf clusters scale the alpha of each level so that the share above one half stays (after
# Castano 2010), and hold their coverage at every size.
#
# Cards that are *blended*, as slices are, must not do that: of them the mean is what shows.
#
# ## 7 Hardly plants
#
# Formulas divide by areas, depths and sizes of crowns. What if those are 0? Each technique with
# its defaults, on plants that are hardly any; the numbers are FLIP against the mesh:

# %%
right, up = np.eye(3)[:2] * 0.2
rng = np.random.default_rng(5)
flat = np.column_stack([rng.uniform(-1, 1, (40, 2)), np.zeros(40)])
plants = {
    "one leaf": squares([(0, 0, 0)], [right], [up]),
    "two equal leaves": squares([(0, 0, 0)] * 2, [right] * 2, [up] * 2),
    "one of them without area": squares([(0, 0, 0), (1, 0, 0)], [right, 0 * right], [up, up]),
    "all in one plane": squares(flat, [right] * 40, [up] * 40),
    "the same, a million metres away": squares(flat, [right] * 40, [up] * 40, origin=(1e6, 0, 1e6)),
    "the same, a tenth of a millimetre wide": squares(
        flat * 5e-5, [right * 5e-5] * 40, [up * 5e-5] * 40
    ),
    "all on a line": squares([(0, y, 0) for y in np.linspace(-1, 1, 9)], [right] * 9, [up / 2] * 9),
}
rows = {}
for name, odd in plants.items():
    camera = tl.orbit(odd, 12, 10, 2.5, (96, 72))[1]
    truth = tl.render(tl.FullMesh.build(odd), camera, samples=16)
    rows[name] = {}
    for technique, kind in REGISTRY.items():
        if technique != "full_mesh":
            frame = tl.render(kind.build(odd), camera, samples=16)
            rows[name][technique] = tl.metrics.compare(truth, frame).flip
pd.DataFrame(rows).T.round(2)

# %% [markdown]
# Each has a result, and the same one every time. Size and place do not matter: the same crown far
# away, or tiny, has the same numbers. But the table also shows who assumes a crown of many leaves.
# One leaf alone:

# %%
odd = plants["one leaf"]
camera = tl.orbit(odd, 12, 10, 2.5, (140, 105))[1]
truth = tl.render(tl.FullMesh.build(odd), camera, samples=16)
frames = {
    kind.name: tl.render(kind.build(odd), camera, samples=16)
    for kind in (tl.Slicings, tl.SimplifiedMesh)
}
tl.plots.picture_strip(frames, reference=truth, background="white")

# %% [markdown]
# Half way between two directions, slicings show the leaf twice, flattened into two planes, each
# half transparent. Among ten thousand leaves nobody sees that. The simplified mesh keeps a tenth
# of two triangles, rounded up: one. Of two equal leaves it keeps none at all.
#
# ## What is refused
#
# NaN compares as equal to nothing, so that it slips through most checks, and ends as a hole in a
# picture hours later. Such input is refused at the door, with the name of the argument:

# %%
square = {
    "positions": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
    "triangles": [[0, 1, 2], [0, 2, 3]],
}
wrong = {
    "NaN in a corner": lambda: tl.Plant.from_arrays(
        foliage=square | {"positions": [[0, 0, np.nan], [1, 0, 0], [1, 1, 0], [0, 1, 0]]},
        leaf_offsets=[0, 2],
    ),
    "a corner that is not there": lambda: tl.Plant.from_arrays(
        foliage=square | {"triangles": [[0, 1, 2], [0, 2, 4]]}, leaf_offsets=[0, 2]
    ),
    "no slices": lambda: tl.Slicings.build(odd, slice_count=0),
    "slices of no leaves": lambda: tl.Slicings.build(tl.Plant.from_arrays(wood=square)),
    "a negative weight": lambda: tl.LeafClusters.build(odd, alpha_rel=-1.0),
    "a picture of nothing": lambda: tl.Camera.perspective((0, 0, 1), (0, 0, 0), size=(0, 10)),
    "pictures of two sizes": lambda: tl.metrics.compare(
        truth, tl.render(tl.FullMesh.build(odd), tl.orbit(odd, 1, size=(50, 50))[0])
    ),
}
for what, call in wrong.items():
    try:
        call()
    except ValueError as error:
        print(f"{what}:\n    {error}")

# %% [markdown]
# ## What next
#
# - Put a plant of your own through section 3 and 5. Which of the two does it mind more?
# - Sweep `correction` over `[0, 0.25, 0.5, 0.75, 1]` for your plant, at the distance you need.
#   Where does its coverage bias cross 0?
# - The documentation of each technique lists where it differs from its paper, and why.
