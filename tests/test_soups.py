"""
Does each sample see the right triangle? Random soups against a NumPy twin of the definition.

The twin projects in 64-bit floats, snaps to 1/256 pixel and asks every triangle at every sample
with integer edge functions and the top-left rule. A soup that once failed stays as its own test.
"""

import numpy as np
import pytest
from hypothesis import given, note
from hypothesis import strategies as st

import treelod as tl
from treelod.render import EMPTY_ID

SIZE = (40, 24)

STEPS = 256
"""Sub-pixel steps a pixel."""

VULKAN = {
    1: [(8, 8)],
    4: [(6, 2), (14, 6), (2, 10), (10, 14)],
    8: [(9, 5), (7, 11), (13, 9), (5, 3), (3, 13), (1, 7), (11, 15), (15, 1)],
    16: [
        (9, 9), (7, 5), (5, 10), (12, 7), (3, 6), (10, 13), (13, 11), (11, 3),
        (6, 14), (8, 1), (4, 2), (2, 12), (0, 8), (15, 4), (14, 15), (1, 0),
    ],
}  # fmt: skip
"""Sample places in 1/16 pixel, from "Standard sample locations" of the Vulkan 1.3 specification."""

WHITE_LIGHT = tl.Lighting(sun=(0, 0, 0), sky=(1, 1, 1), ground=(1, 1, 1), translucency=0.0)
"""Under which a surface has its own colour, whichever way it faces."""

DEPTH_TOLERANCE = 2e-5
"""32-bit planes over depths of a few metres, for triangles that are no slivers."""

SLIVER_AREA_PX = 4.0
"""Twice the area below which a plane's slopes cancel, so that only its corners bound a depth."""

EDGE_TOLERANCE_PX = 1.25 / STEPS
"""How far snapping and rounding may move an edge: each corner by half a step on both axes."""


POSITION_ERROR = 2e-6
"""Metres: 32-bit positions of up to 3 m relative to an eye as far out, each term rounded."""

KEY_TOLERANCE = 1e-3
"""Share of 1 / depth: clipping cuts a triangle into ones that may be thin."""


# --- the picture's definition --------------------------------------------------------------------


def sample_places(samples):
    """Steps from the picture's corner, shape (pixels, samples, 2)."""
    width, height = SIZE
    rows, columns = np.mgrid[:height, :width]
    pixels = np.stack([columns.ravel(), rows.ravel()], axis=1) * STEPS
    return pixels[:, None] + np.array(VULKAN[samples]) * (STEPS // 16)


def edge_values(corners, at):
    """Twice the area left of each directed edge as seen at each place, and the edges."""
    along = np.roll(corners, -1, axis=1) - corners
    from_start = at[None, None] - corners[:, :, None]
    values = along[:, :, None, 0] * from_start[..., 1] - along[:, :, None, 1] * from_start[..., 0]
    return values, along


def covered(corners_px, at):
    """Which triangles (T, 3, 2) cover which places (N, 2) in steps: shape (T, N)."""
    corners = np.floor(corners_px * STEPS + 0.5).astype(np.int64)
    values, along = edge_values(corners, at)
    # on an edge, the side of a place a hair to the right, on a level edge of one a hair below
    aside = np.where(along[..., 1] != 0, -np.sign(along[..., 1]), np.sign(along[..., 0]))
    sides = np.where(values != 0, np.sign(values), aside[:, :, None])
    return (sides == 1).all(axis=1) | (sides == -1).all(axis=1)


def planes(corners_px, heights, at):
    """Linear interpolation of corner values at places in steps, between the corners' extremes."""
    (a, b, c) = np.moveaxis(corners_px, 1, 0)
    first, second = b - a, c - a
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    safe = np.where(area == 0, 1, area)
    offset = at[None] / STEPS - a[:, None]
    rise = heights - heights[:, :1]
    slope_x = (rise[:, 1] * second[:, 1] - rise[:, 2] * first[:, 1]) / safe
    slope_y = (rise[:, 2] * first[:, 0] - rise[:, 1] * second[:, 0]) / safe
    value = heights[:, :1] + slope_x[:, None] * offset[..., 0] + slope_y[:, None] * offset[..., 1]
    return np.clip(value, heights.min(axis=1)[:, None], heights.max(axis=1)[:, None]), area


def colors_of(count):
    """Colours that differ, and whose means do."""
    index = np.arange(count)
    return np.stack([index % 3 / 2, index // 3 % 3 / 2, (index + 1) / 32, np.ones(count)], axis=1)


def drawn(triangles, camera, samples):
    """Picture of triangles (T, 3, 3) in the world, one leaf each."""
    count = len(triangles)
    plant = tl.Plant.from_arrays(
        foliage={
            "positions": triangles.reshape(-1, 3),
            "triangles": np.arange(3 * count).reshape(-1, 3),
            "colors": np.repeat(colors_of(count), 3, axis=0),
        },
        leaf_offsets=np.arange(count + 1),
        lighting=WHITE_LIGHT,
    )
    mesh = tl.FullMesh.build(plant)
    return tl.render(mesh, camera, samples=samples, outputs=("color", "depth", "ids"))


# --- parallel views: exact coverage --------------------------------------------------------------

PARALLEL = tl.Camera.orthographic(
    (SIZE[0] / 2, -SIZE[1] / 2, 16), (SIZE[0] / 2, -SIZE[1] / 2, 0), height=SIZE[1], size=SIZE
)
"""Pixels are metres, x to the right and -y down from the picture's corner; z = 0 has depth 16."""


@st.composite
def parallel_soups(draw, *, level):
    """Triangles (T, 3, 3) as (x, y, z) with y down, in half steps of the renderer's grid."""
    samples = draw(st.sampled_from([1, 4, 8, 16]))
    half_steps = st.integers(-8 * 2 * STEPS, 48 * 2 * STEPS)
    anywhere = st.tuples(half_steps, half_steps)
    pixel = st.tuples(st.integers(0, SIZE[0] - 1), st.integers(0, SIZE[1] - 1))
    on_sample = st.builds(
        lambda at, place: tuple(2 * (at[i] * STEPS + place[i] * STEPS // 16) for i in range(2)),
        pixel,
        st.sampled_from(VULKAN[samples]),
    )
    places = draw(st.lists(anywhere | on_sample, min_size=3, max_size=8))
    # a neighbour a few half steps away makes slivers; the same place again makes ties
    x, y = places[draw(st.integers(0, len(places) - 1))]
    places.append((x + draw(st.integers(-3, 3)), y + draw(st.integers(-3, 3))))
    corner = st.integers(0, len(places) - 1)
    faces = draw(st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=10))
    heights = st.integers(-8, 8)
    rows = [draw(heights)] * 3 if level else [draw(heights) for _ in places]
    triangles = []
    for face in faces:
        z = [draw(heights)] * 3 if level else [rows[corner] for corner in face]
        triangles.append([(*places[c], h / 4) for c, h in zip(face, z, strict=True)])
    soup = np.array(triangles, dtype=np.float64)
    soup[..., :2] /= 2 * STEPS
    return soup, samples


def check_parallel(soup, samples, frame=None):
    """Compare the picture of a soup, or another, with the twin's, sample by sample."""
    frame = frame or drawn(soup * [1, -1, 1], PARALLEL, samples)
    at = sample_places(samples)
    flat = at.reshape(-1, 2)
    inside = covered(soup[..., :2], flat)
    height, area = planes(soup[..., :2], soup[..., 2], flat)
    depth = np.where(inside, 16 - height, np.inf)
    level = (soup[..., 2] == soup[:, :1, 2]).all(axis=1)
    # a sliver's depth may be any between its corners'
    spread = np.ptp(soup[..., 2], axis=1)
    slack = np.where(level, 0, np.where(np.abs(area) < SLIVER_AREA_PX, spread, DEPTH_TOLERANCE))
    nearest = (depth + slack[:, None]).min(axis=0)
    may_be_seen = inside & (depth - slack[:, None] <= nearest)
    # an exact tie goes to the earlier: later level triangles at the same height are not seen
    first = np.argmax(may_be_seen, axis=0)
    tied = level[:, None] & level[first][None] & (depth == depth[first, np.arange(len(flat))])
    may_be_seen &= ~tied | (np.arange(len(soup))[:, None] == first)
    # nor are exact copies
    for later, triangle in enumerate(soup):
        if any(np.array_equal(triangle, earlier) for earlier in soup[:later]):
            may_be_seen[later] = False

    shape = (len(soup), SIZE[1] * SIZE[0], samples)
    may_be_seen, depth = may_be_seen.reshape(shape), depth.reshape(shape)
    share = inside.reshape(shape).any(axis=0).mean(axis=1)
    np.testing.assert_allclose(frame.color[..., 3].ravel(), share, rtol=0, atol=1e-6)
    ids, seen_depth = frame.ids.ravel(), frame.depth.ravel()
    np.testing.assert_array_equal(ids == EMPTY_ID, share == 0)
    np.testing.assert_array_equal(np.isinf(seen_depth), share == 0)
    pixels = np.flatnonzero(share > 0)
    of_id = depth[ids[pixels], pixels]
    wrong = np.abs(of_id - seen_depth[pixels, None]) > slack[ids[pixels], None] + 1e-6
    allowed = may_be_seen[ids[pixels], pixels] & ~wrong
    assert allowed.any(axis=1).all(), "an id and its depth belong to a sample of the pixel"
    furthest = nearest.reshape(-1, samples).min(axis=1)[pixels]
    assert (seen_depth[pixels] <= furthest + 1e-6).all(), "the nearest of a pixel's samples"
    # colour where every sample sees one certain triangle or none
    certain = (may_be_seen.sum(axis=0) <= 1).all(axis=1)
    mean = np.einsum("tps,tc->pc", may_be_seen, colors_of(len(soup))) / samples
    color = frame.color.reshape(-1, 4)
    np.testing.assert_allclose(color[certain], mean[certain], rtol=0, atol=1e-6)
    return certain.mean()


@given(parallel_soups(level=True))
def test_level_soups_agree_sample_by_sample(soup):
    note(f"{soup}")
    assert check_parallel(*soup) == 1, "no height is uncertain"


@given(parallel_soups(level=False))
def test_slanted_soups_agree_sample_by_sample(soup):
    note(f"{soup}")
    check_parallel(*soup)


@pytest.mark.parametrize("change", ["nothing", "a step", "a height", "a swap"])
def test_the_twin_notices(change):
    large = [(1, 1, 0), (3, 22, 0.5), (37, 5, -1)]
    small = [(10, 8, 2), (11, 15, 2), (19, 10, 2)]
    soup = np.array([large, small], dtype=np.float64)
    other = soup.copy()
    if change == "nothing":
        assert check_parallel(soup, 16) == 1
        return
    if change == "a step":
        other[0, :, 0] += 1 / STEPS
    elif change == "a height":
        other[0, :, 2] -= 1e-4
    else:
        other = soup[::-1]
    with pytest.raises(AssertionError):
        check_parallel(soup, 16, drawn(other * [1, -1, 1], PARALLEL, 16))


# --- perspective, the eye anywhere ---------------------------------------------------------------


@st.composite
def free_soups(draw):
    """Triangles around an eye that may stand among them, in eighths of a metre."""
    eighths = st.integers(-24, 24)
    point = st.tuples(eighths, eighths, eighths)
    points = draw(st.lists(point, min_size=3, max_size=8))
    corner = st.integers(0, len(points) - 1)
    faces = draw(st.lists(st.tuples(corner, corner, corner), min_size=1, max_size=8))
    eye = np.array(draw(point)) / 8
    way = draw(st.tuples(*[st.integers(-3, 3)] * 3).filter(any))
    triangles = np.array([[points[c] for c in face] for face in faces]) / 8
    return triangles, tuple(eye), tuple(eye + way)


@given(free_soups())
def test_soups_around_the_eye_agree(soup):
    # a corner behind the eye has no pixel, but an edge always has a line: a sample is asked how far
    # inside of all three lines it lies, and left out where that is within rounding
    note(f"{soup}")
    triangles, eye, target = soup
    camera = tl.Camera.perspective(eye, target, fov_y_deg=80, size=SIZE, near=1 / 16)
    frame = drawn(triangles, camera, 1)
    focal = camera.pixels_per_metre(1.0)
    corners = (triangles - eye) @ camera.view_rotation().T * [focal, -focal, -1]
    rays = sample_places(1).reshape(-1, 2) / STEPS - np.array(SIZE) / 2
    rays = np.column_stack([rays, np.ones(len(rays))])
    edges = np.cross(np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1))
    volume = np.einsum("tc,tc->t", corners[:, 0], edges[:, 0])
    has_area = np.abs(volume) > 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        lines = edges / np.linalg.norm(edges[..., :2], axis=2)[..., None]
        # corners on one another bound nothing
        distances = np.nan_to_num(np.einsum("tec,nc->ten", lines, rays), nan=0.0)
        distances *= np.where(volume < 0, -1, 1)[:, None, None]
        plane = edges.sum(axis=1) / np.where(has_area, volume, 1)[:, None]
        key = plane @ rays.T  # 1 / depth
        to_near = (1 / camera.near - key) / np.linalg.norm(plane[:, :2], axis=1)[:, None]
    inset = np.fmin(distances.min(axis=1), to_near)
    rim = rims(corners, focal, camera.near)[:, None]
    # seen from the side, a triangle may show on its own line
    on_line = (np.abs(distances) <= rim[..., None]).all(axis=1)
    outside = np.where(has_area[:, None], inset < -rim, ~on_line)
    inside = has_area[:, None] & (inset > rim)
    sure = (inside | outside).all(axis=0)
    shown = inside.any(axis=0)
    ids, depth, alpha = frame.ids.ravel(), frame.depth.ravel(), frame.color[..., 3].ravel()
    np.testing.assert_array_equal(alpha[sure], shown[sure])
    np.testing.assert_array_equal((ids != EMPTY_ID)[sure], shown[sure])
    seen_key = np.where(inside, key, 0)
    nearest, winner = seen_key.max(axis=0), seen_key.argmax(axis=0)
    rivals = (seen_key > nearest * (1 - KEY_TOLERANCE)).sum(axis=0) > 1
    certain = sure & shown & ~rivals
    np.testing.assert_array_equal(ids[certain], winner[certain])
    # well inside, where the triangle is no sliver
    clear = certain & (inset[winner, np.arange(len(rays))] > 1)
    np.testing.assert_allclose(1 / depth[clear], nearest[clear], rtol=KEY_TOLERANCE)


def rims(corners, focal, near):
    """How far from its lines in pixels rounding may move each triangle's rim."""
    depth = corners[..., 2]
    # what reaches behind the near plane is clipped in 64 bits
    is_rounded = (depth >= near).all(axis=1)
    safe = np.where(is_rounded[:, None], depth, 1)
    slope = np.abs(corners[..., :2]).max(axis=2) / focal / safe
    moved = POSITION_ERROR * focal / safe * (1 + slope)
    return EDGE_TOLERANCE_PX + np.where(is_rounded, moved.max(axis=1), 0)
