"""Small plants made by hand, for tests of what is drawn."""

import numpy as np

import treelod as tl


def quads(leaves, colors=None):
    """
    Arrays of a mesh with one rectangle a leaf, and the offsets of its leaves.

    Each leaf is (middle, across, along): the last two lead from the middle to two of its sides.
    `colors` has one RGBA colour a leaf; white by default.
    """
    middles, across, along = (np.array([leaf[part] for leaf in leaves], float) for part in range(3))
    corners = [middles + x * across + y * along for x, y in [(-1, -1), (1, -1), (1, 1), (-1, 1)]]
    first = 4 * np.arange(len(leaves), dtype=np.uint32)[:, np.newaxis, np.newaxis]
    rgba = np.ones((len(leaves), 4)) if colors is None else np.asarray(colors, float)
    mesh = {
        "positions": np.stack(corners, axis=1).reshape(-1, 3),
        "triangles": (first + np.array([[0, 1, 2], [0, 2, 3]], np.uint32)).reshape(-1, 3),
        "colors": np.repeat(rgba, 4, axis=0),
    }
    return mesh, 2 * np.arange(len(leaves) + 1)


def facing(x, y, z, half):
    """A square of side `2 half` that faces +z."""
    return ((x, y, z), (half, 0, 0), (0, half, 0))


def random_leaves(count, seed=1, size=0.12):
    """Rectangles of all orientations in a cube of side 2, and a colour for each."""
    rng = np.random.default_rng(seed)
    middles = rng.uniform(-1, 1, (count, 3))
    across, other = rng.normal(size=(2, count, 3))
    along = np.cross(across, other)
    across *= size / np.linalg.norm(across, axis=1, keepdims=True)
    along *= size / np.linalg.norm(along, axis=1, keepdims=True)
    colors = np.column_stack([rng.uniform(0.1, 1, (count, 3)), np.ones(count)])
    return list(zip(middles, across, along, strict=True)), colors


def crown(leaves, colors=None, *, trunk=False, **kwargs):
    """A plant of rectangles; `trunk` adds two crossed ones below as its wood."""
    foliage, offsets = quads(leaves, colors)
    wood = None
    if trunk:
        wood, _ = quads(
            [((0, -2, 0), (0.1, 0, 0), (0, 1, 0)), ((0, -2, 0), (0, 0, 0.1), (0, 1, 0))],
            [(0.4, 0.2, 0.1, 1)] * 2,
        )
    return tl.Plant.from_arrays(wood=wood, foliage=foliage, leaf_offsets=offsets, **kwargs)


def random_crown(count=150, seed=1, **kwargs):
    """A plant of `random_leaves`, two of them placed so that the crown's centre is at 0."""
    leaves, colors = random_leaves(count - 2, seed)
    leaves += [((x, x, x), (0.1, 0, 0), (0, 0.1, 0.1)) for x in (-1.2, 1.2)]
    return crown(leaves, np.vstack([colors, np.ones((2, 4))]), **kwargs)
