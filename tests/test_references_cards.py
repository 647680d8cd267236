"""Cut-out leaves whose clear parts are left out for mitsuba: do they cover what they covered?"""

import numpy as np
import pytest

import treelod as tl
from made_plants import facing, quads
from treelod.references import mitsuba
from treelod.references.cards import SIDE_PARTS, _Counts, parted
from treelod.references.soup import plant_soup
from treelod.references.texels import wrapped
from treelod.references.views import camera_settings, check_cameras

WRAPS = ["repeat", "mirror", "clamp"]


def spotted():
    """A board of 3 x 3 clear and opaque fields of 24 x 24 cells, with two half-clear cells."""
    patches = (np.indices((3, 3)).sum(axis=0) % 2).astype(np.uint8)
    mask = np.kron(patches * 255, np.ones((24, 24), np.uint8))
    mask[7, 7:9] = 100
    return mask


def inside(points, triangle):
    """Barycentric coordinates of points of the plane z = 0 in a triangle, in f64."""
    a, b, c = triangle[:, :2].astype(np.float64)
    matrix = np.stack([b - a, c - a], axis=1)
    second_third = np.linalg.solve(matrix, (points - a).T).T
    return np.column_stack([1 - second_third.sum(axis=1), second_third])


def opacity_at(points, corners, uvs, opaque, mask, wrap):
    """How much of each point is covered, and by how many triangles, one by one."""
    height, width = mask.shape
    opacity, hits = np.zeros(len(points)), np.zeros(len(points), int)
    for triangle, own_uvs, full in zip(corners, uvs, opaque, strict=True):
        weights = inside(points, triangle)
        hit = (weights >= 0.0).all(axis=1)
        place = weights[hit] @ own_uvs.astype(np.float64) * (width, height)
        column, row = np.floor(place).astype(np.int64).T
        read = mask[wrapped(row, height, wrap), wrapped(column, width, wrap)] / 255
        opacity[hit] += 1.0 if full else read
        hits[hit] += 1
    return opacity, hits


def card(shift=0.0, scale=1.0):
    """Two triangles of one square, with texture coordinates that run from `shift`."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    # an odd size, so that nothing is exact
    corners = corners * np.float32(1.3)
    uvs = (corners[:, :2] / np.float32(1.3) * np.float32(scale) + np.float32(shift))[:, ::-1]
    # the common side runs in opposite directions and begins at another corner of each
    order = [[0, 1, 2], [3, 0, 2]]
    return corners[order], np.ascontiguousarray(uvs[order])


@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize(("shift", "scale"), [(0.0, 1.0), (-0.7, 1.9), (0.31, 0.4)])
@pytest.mark.parametrize("side_count", [1, 3, 8])
def test_parts_cover_each_point_as_the_card_did(wrap, shift, scale, side_count):
    mask = spotted()
    corners, uvs = card(shift, scale)
    parts = parted(corners, uvs, mask, wrap, side_count)
    points = np.random.default_rng(2).uniform(0.0, 1.3, (4000, 2))
    before, _ = opacity_at(points, corners, uvs, [False, False], mask, wrap)
    after, hits = opacity_at(points, *parts, mask, wrap)
    assert hits.max() == 1, "no point lies in two parts"
    # a point within rounding of a cell's edge may read either cell
    assert (before != after).sum() <= 1
    if (side_count, shift) == (8, 0.0):
        kinds = len(parts.opaque), parts.opaque.sum()
        assert 0 < kinds[1] < kinds[0] < 2 * 64, "some of each kind"
        assert set(after[(hits == 0)]) == {0.0}
        # the control: without one opaque part its points are missing, a 128th of 4000
        fewer = [np.delete(array, parts.opaque.argmax(), axis=0) for array in parts]
        assert (opacity_at(points, *fewer, mask, wrap)[0] != before).sum() > 10


def test_parts_share_their_corners_to_the_bit():
    mask = np.full((16, 16), 255, np.uint8)
    rng = np.random.default_rng(3)
    for _ in range(20):
        places = rng.normal(size=(4, 3)).astype(np.float32) * 1000
        order = [[0, 1, 2], [3, 0, 2]]
        corners = places[order]
        uvs = rng.uniform(size=(4, 2)).astype(np.float32)[order]
        parts = parted(corners, uvs, mask, "repeat", 7)
        assert len(parts.corners) == 2 * 49
        found = {point.tobytes() for point in parts.corners.reshape(-1, 3)}
        # of two grids of 36 points that have a side of 8 in common
        assert len(found) == 2 * 36 - 8
        assert {p.tobytes() for p in places} <= found, "the card's own corners stay"


@pytest.mark.parametrize("wrap", WRAPS)
def test_boxes_are_looked_at_cell_by_cell(wrap):
    rng = np.random.default_rng(4)
    kinds = set()
    for _ in range(400):
        cells = rng.uniform(size=(5, 7)) < 0.9
        low = rng.integers(-20, 20, (1, 2))
        high = low + rng.integers(0, 9, (1, 2))
        columns, rows = (np.arange(low[0, k], high[0, k] + 1) for k in (0, 1))
        read = cells[np.ix_(wrapped(rows, 5, wrap), wrapped(columns, 7, wrap))]
        got = bool(_Counts(cells).all_in(low, high, wrap)[0])
        if wrap == "mirror" and (read.shape[0] >= 5 or read.shape[1] >= 7):
            # counts as if it read all, though it may read half of it twice
            assert not got or read.all()
        else:
            assert got == read.all()
        kinds.add(got)
    assert kinds == {False, True}


def masked_plant():
    """Cards one behind the other, cut out in spots."""
    texture = np.full((72, 72, 4), 255, np.uint8)
    texture[..., 3] = spotted()
    material = tl.Material(name="spots", alpha_mode="mask", texture=texture)
    mesh, offsets = quads([facing(0.1 * k, 0.07 * k, -k, 1) for k in range(8)])
    mesh["uvs"] = np.tile([(0, 0), (1, 0), (1, 1), (0, 1)], (8, 1))
    mesh["material_ids"] = np.zeros(16, np.uint32)
    return tl.Plant.from_arrays(foliage=mesh, leaf_offsets=offsets, materials=[material])


MASK_NOISE = 0.0012
"""Of a mean of 64 x 64 x 256 samples that cover half: four standard deviations of two such."""


def test_mitsuba_covers_the_same_with_parts_as_with_cards(tmp_path, monkeypatch):
    monkeypatch.setenv("TREELOD_CACHE", str(tmp_path))
    plant = masked_plant()
    soup = plant_soup(plant)
    camera = check_cameras(plant, (64, 64))["perspective"]
    whole = {
        "soup": 0,
        "view": camera_settings(camera, plant.origin),
        "quantity": "alpha",
        "spp": 256,
        "seed": 1,
        "sampler": "independent",
    }
    pictures = [whole, {**whole, "side_parts": SIDE_PARTS, "seed": 2}]
    (cards, parts), _ = mitsuba.draw([soup], pictures)
    assert abs(float(cards.mean(dtype=float) - parts.mean(dtype=float))) < MASK_NOISE
    # texel by texel: the noise of 256 samples a side, five times over at the worst
    assert np.abs(cards - parts).max() < 5 * np.sqrt(2 * 0.25 / 256)
    assert 0.1 < cards.mean() < 0.9
    # and in bands, where rows are told apart
    bands = [
        mitsuba.draw([soup], [{**whole, "rows": [row, row + 16]}])[0][0] for row in range(0, 64, 16)
    ]
    assert np.abs(np.concatenate(bands) - cards).max() < 5 * np.sqrt(2 * 0.25 / 256)
    assert np.abs(np.concatenate(bands[::-1]) - cards).max() > 0.5
