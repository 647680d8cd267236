"""Plants against mitsuba, embree and trimesh; and what these must find if something is wrong."""

import dataclasses
import json
import os
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import treelod as tl
from made_plants import crown, facing, quads, random_crown
from treelod import _core, references
from treelod.cli import app
from treelod.references import baked, color, coverage, geometry, mitsuba, slices, visibility
from treelod.references.clusters import ClusterSettings
from treelod.references.coverage import SliceSettings
from treelod.references.soup import foliage_soup
from treelod.references.validation import QUICK, Extent

SMALL = Extent(
    rays=(256, 192),
    view=(64, 64),
    color_spp=128,
    alpha_spp=128,
    slices=SliceSettings(side=64, precise_count=1, precise_spp=128, slicing_count=1, spp=64),
    clusters=ClusterSettings(
        side=128,
        cluster_count=8,
        card_count=1,
        turned_count=1,
        precise_count=1,
        precise_spp=128,
        spp=64,
        rays=(256, 192),
    ),
)
"""
One view, one slice and one card of each kind a plant with many samples; the slicing's other slices
and the cards' backs with 64.
"""

PLANTS = [
    "chestnut",
    "broadleaf",
    "ez_oak_large/ez_oak_large.glb",
    "ez_aspen_large/ez_aspen_large.glb",
    "ez_bush_1/ez_bush_1.glb",
    "quaternius_common/CommonTree_1.gltf",
    "quaternius_common/CommonTree_3.gltf",
    "quaternius_common/Pine_4.gltf",
    "quaternius_common/Bush_Common_Flowers.gltf",
    "quaternius_common/Grass_Common_Tall.gltf",
    "polyhaven_fern/fern_02.glb",
    "khronos_vase_flowers/GlassVaseFlowers.gltf",
]

SMALLEST = PLANTS[-5:-2]
"""What CI takes where all would take minutes."""

HEAVY = {PLANTS[2], PLANTS[4], PLANTS[5], PLANTS[6], PLANTS[8]}
"""
Half a minute each on two cores, for the layers of cut-out leaves that rays pass. Each has a kindred
one beside it that is quicker.
"""


@pytest.fixture(scope="module", autouse=True)
def _kept(request):
    """Keep what references draw beside pytest's own cache: the next run takes it from there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TREELOD_CACHE", str(request.config.cache.mkdir("treelod")))
        yield


@pytest.fixture
def load(request):
    def load(name):
        if name in tl.plants.PRESETS:
            return tl.grow_plant(name)
        with warnings.catch_warnings():
            # the vase's transmission is ignored
            warnings.simplefilter("ignore", UserWarning)
            return tl.load_plant(request.getfixturevalue("models") / name)

    return load


def failures(sections):
    return [
        f"{check.name}: {check.value:.6g}, not {check.relation} {check.limit:g} ({check.note})"
        for section in sections
        for check in section.checks
        if not check.passed
    ]


def quiet(*_):
    """No progress."""


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in HEAVY)) for n in PLANTS]
)
def test_a_plant_is_as_the_references_draw_it(load, name):
    found = references.validate(load(name), extent=SMALL)
    assert failures(found.sections) == []
    assert found.left_out == []
    assert len([check for section in found.sections for check in section.checks]) == 42


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", SMALLEST if "CI" in os.environ else PLANTS)
def test_a_plant_at_1024_pixels_is_as_rays_see_it(load, name):
    section = visibility.visibility_section(load(name), QUICK.rays, quiet)
    assert failures([section]) == []
    assert len(section.checks) == 8, "shares of rays, too"


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", SMALLEST[-1:] if "CI" in os.environ else PLANTS)
def test_every_slice_is_as_mitsuba_draws_it(load, name):
    settings = SliceSettings(side=128, precise_count=5, precise_spp=256, slicing_count=6, spp=64)
    assert failures([coverage.slices_section(load(name), settings, quiet)]) == []


# What must be found


@pytest.fixture(scope="module")
def leaves():
    """A crown whose leaf 40 is in its middle and in the open."""
    return random_crown(120, seed=4)


def with_leaf_moved(soup, leaf, by):
    corners = soup.corners.copy()
    corners[2 * leaf : 2 * leaf + 2] += by
    return dataclasses.replace(soup, corners=corners)


def nearest_leaf(plant):
    """The leaf nearest to the cameras, so that none hides it."""
    camera = visibility.check_cameras(plant, (64, 48))["perspective"]
    return int(np.linalg.norm(plant.foliage.centers - camera.eye, axis=1).argmin())


@pytest.mark.parametrize("by", [0.0, 0.01, 9.0], ids=["not", "a hundredth", "away"])
def test_rays_find_a_leaf_that_moved(leaves, monkeypatch, by):
    soup = with_leaf_moved(visibility.plant_soup(leaves), nearest_leaf(leaves), by)
    monkeypatch.setattr(visibility, "plant_soup", lambda _: soup)
    section = visibility.visibility_section(leaves, (256, 192), quiet)
    assert bool(failures([section])) == (by != 0.0)


@pytest.mark.parametrize("by", [0.0, 0.1, 9.0], ids=["not", "a tenth", "away"])
def test_mitsuba_finds_a_leaf_that_moved(leaves, monkeypatch, by):
    # cameras and rectangles stay: they come from the plant, or from leaves further out
    leaf = int(np.linalg.norm(leaves.foliage.centers, axis=1).argmin())
    real = slices.foliage_soup

    def moved(plant):
        return with_leaf_moved(real(plant), leaf, by)

    monkeypatch.setattr(slices, "foliage_soup", moved)
    if by == 9.0:
        # too far for the rectangle: out of sight along the view instead
        monkeypatch.setattr(slices, "foliage_soup", lambda plant: without_leaf(real(plant), leaf))
    section = coverage.slices_section(leaves, SMALL.slices, quiet)
    assert bool(failures([section])) == (by != 0.0)


def without_leaf(soup, leaf):
    """The leaf as a point at its first corner."""
    corners = soup.corners.copy()
    corners[2 * leaf : 2 * leaf + 2] = corners[2 * leaf, 0]
    return dataclasses.replace(soup, corners=corners)


def test_colours_of_another_light_are_found(leaves, monkeypatch):
    soup = visibility.plant_soup(leaves.lit(tl.Lighting(sun_direction=(-1, 0.5, 0.2))))
    assert not failures([color.color_section(leaves, (64, 64), 256, quiet)])
    monkeypatch.setattr(color, "plant_soup", lambda _: soup)
    assert failures([color.color_section(leaves, (64, 64), 256, quiet)])


def test_light_that_shines_through_is_not_lamberts(monkeypatch):
    assert not failures([color.lambert_section(quiet)])
    opaque = color.lambert_plant()
    lighting = dataclasses.replace(opaque.lighting, translucency=0.25)
    monkeypatch.setattr(color, "lambert_plant", lambda: opaque.lit(lighting))
    assert failures([color.lambert_section(quiet)])


@pytest.mark.parametrize(
    ("measure", "name"),
    [("areas", "leaf areas"), ("centers", "leaf centres"), ("normals", "leaf normals")],
)
def test_a_wrong_measure_of_one_leaf_is_found(measure, name):
    plant = random_crown(30)
    assert not failures([geometry.geometry_section(plant)])
    values = getattr(plant.foliage, measure).copy()
    values[17] *= 1.001
    plant.__dict__["foliage"] = dataclasses.replace(plant.foliage, **{measure: values})
    (failure,) = failures([geometry.geometry_section(plant)])
    assert failure.startswith(name)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        # wider on both sides of its middle by a millionth: every vertex stays inside
        (lambda own: own.mean(axis=0) + (own - own.mean(axis=0)) * 1.000001, "area difference"),
        # moved along its plane by a hundredth of its side: as large as before
        (lambda own: own + 0.01 * (own[1] - own[0]), "overhang"),
    ],
)
def test_a_wrong_rectangle_of_one_leaf_is_found(change, name):
    plant = random_crown(30)
    assert not failures(geometry_rectangles(plant))
    corners = plant.foliage.rectangles.copy()
    corners[17] = change(corners[17])
    plant.foliage.__dict__["rectangles"] = corners
    (failure,) = failures(geometry_rectangles(plant))
    assert name in failure


def geometry_rectangles(plant):
    return [SimpleNamespace(checks=geometry.rectangles(plant))]


@pytest.mark.parametrize(
    ("axes", "count"),
    [
        ([((1, 2, 3), (4, 8, 12))], 1),  # a line
        ([((0, 0, 0), (0, 0, 0))], 1),  # a point
        ([((1, 0, 0), (0, 1e-3, 0)), ((1, 0, 0), (0, 1e-9, 0))], 1),  # narrow, and all but a line
    ],
)
def test_leaves_that_are_lines_have_rectangles_without_height(axes, count):
    plant = crown([((0, 0, k), *own) for k, own in enumerate(axes)])
    area, overhang = geometry.rectangles(plant)
    assert area.passed
    assert overhang.passed
    assert area.note.startswith(f"{count} leaves are lines")
    plant.foliage.__dict__["rectangles"] = plant.foliage.rectangles + [0.0, 0.1, 0.0] * np.array(
        [[0.0], [0.0], [1.0], [1.0]]
    )
    assert not all(check.passed for check in geometry.rectangles(plant))


def test_leaves_that_touch_are_one_component():
    # two squares with an edge in common, and one apart
    plant = crown(
        [
            ((0, 0, 0), (1, 0, 0), (0, 1, 0)),
            ((2, 0, 0), (1, 0, 0), (0, 1, 0)),
            ((9, 0, 0), (1, 0, 0), (0, 1, 0)),
        ]
    )
    check = geometry._components(plant)
    assert (check.value, check.note) == (0.0, "2 components")


def test_blocks_find_a_leaf_of_two_texels_and_no_noise():
    rng = np.random.default_rng(11)
    share = rng.uniform(0, 1, (64, 64)) * (rng.uniform(size=(64, 64)) < 0.5)
    ours, theirs = (rng.binomial(n, share) / n for n in (16, 64))
    assert baked.largest_z(ours, theirs, 64) < baked.MAX_Z
    bare = np.zeros((64, 64))
    leaf = bare.copy()
    leaf[20:22, 30] = 1.0
    assert baked.largest_z(bare, bare, 64) == 0.0
    assert baked.largest_z(leaf, bare, 64) > baked.MAX_Z


def test_pieces_that_touch_and_count_as_two_are_found(monkeypatch):
    touching = crown([((0, 0, 0), (1, 0, 0), (0, 1, 0)), ((2, 0, 0), (1, 0, 0), (0, 1, 0))])
    assert geometry._components(touching).passed
    # a splitter that tells rectangles apart whatever they share
    monkeypatch.setattr(geometry.Plant, "from_mesh", lambda *_, **__: touching)
    assert not geometry._components(touching).passed


def test_bounds_that_leave_out_a_corner_are_found():
    plant = random_crown(30)
    assert geometry._bounds(plant).passed
    plant.__dict__["bounds"] = plant.bounds + np.array([[0.0] * 3, [0.0, -1e-4, 0.0]])
    assert not geometry._bounds(plant).passed


def test_a_view_without_one_leaf_is_found(leaves, monkeypatch):
    assert not failures([coverage.view_section(leaves, (64, 64), 128, quiet)])
    soup = without_leaf(coverage.plant_soup(leaves), nearest_leaf(leaves))
    monkeypatch.setattr(coverage, "plant_soup", lambda _: soup)
    (failure,) = failures([coverage.view_section(leaves, (64, 64), 128, quiet)])
    assert failure.startswith("alpha of the view, bias")


def test_slices_together_without_one_slice_are_found(leaves, monkeypatch):
    real = coverage.stored_alpha

    def without_the_middle(lod, slicing, slice_count, side):
        alphas = real(lod, slicing, slice_count, side)
        if slice_count > 1:
            alphas[slice_count // 2] *= 0.0
        return alphas

    assert all(check.passed for check in coverage.together(leaves, 64))
    monkeypatch.setattr(coverage, "stored_alpha", without_the_middle)
    assert [check.passed for check in coverage.together(leaves, 64)] == [False, False]


def test_a_rectangle_with_one_corner_elsewhere_is_found(leaves):
    lod = coverage._build(leaves, 16, coverage.SLICE_COUNT, 1)
    toward = np.array(_core.circle_directions(coverage.SLICING_COUNT))[0]
    sliced = slices.Crown.of(leaves, toward, coverage.SLICE_COUNT)
    assert coverage._corner_error(leaves, lod, 0, sliced) <= coverage.MAX_CORNER_ERROR
    first, *others = lod.textures
    corners = first.corners.copy()
    corners[2] += 2 * coverage.MAX_CORNER_ERROR * sliced.reach * sliced.up
    moved = SimpleNamespace(textures=[dataclasses.replace(first, corners=corners), *others])
    assert coverage._corner_error(leaves, moved, 0, sliced) > coverage.MAX_CORNER_ERROR


@pytest.mark.parametrize("value", [0.0, 1 / 255, 1.0])
def test_a_wrong_texture_fails_where_mitsuba_finds_nothing(value):
    empty = np.zeros((8, 8))
    ours = empty.copy()
    ours[3, 4] = value
    share = baked.precise("slice 2", ours, empty, empty)[1]
    assert share.passed == (value == 0.0)


# Plants that are legal and odd

TINY = Extent(
    rays=(64, 48),
    view=(32, 32),
    color_spp=64,
    alpha_spp=64,
    slices=SliceSettings(side=32, precise_count=1, precise_spp=64, slicing_count=1, spp=64),
    clusters=ClusterSettings(
        # a straight edge along texels is off by up to a 32nd of one, which a small texture shows
        side=128,
        cluster_count=2,
        card_count=1,
        turned_count=1,
        precise_count=1,
        precise_spp=64,
        spp=64,
        rays=(64, 48),
    ),
)


def masked(wrap):
    texture = np.full((8, 8, 4), 255, np.uint8)
    texture[2:6, 2:6, 3] = 0
    material = tl.Material(name="cut", alpha_mode="mask", texture=texture, wrap=wrap)
    mesh, offsets = quads([facing(0, 0, 0, 1), facing(2.5, 0, 1, 1)])
    mesh["uvs"] = np.tile([(0, 0), (1.5, 0), (1.5, 1.5), (0, 1.5)], (2, 1))
    mesh["material_ids"] = np.zeros(4, np.uint32)
    return tl.Plant.from_arrays(foliage=mesh, leaf_offsets=offsets, materials=[material])


@pytest.mark.parametrize("wrap", [("repeat", "clamp"), ("mirror", "mirror")])
def test_masks_wrapped_in_two_ways_are_left_out_and_said_so(wrap):
    found = references.validate(masked(wrap), extent=TINY)
    assert failures(found.sections) == []
    titles = [section.title for section in found.sections]
    for title in ("Coverage of slices", "Leaf clusters"):
        assert (title in titles) == (wrap[0] == wrap[1])
    assert len(found.left_out) == (wrap[0] != wrap[1])
    assert "Lit colour" in titles, "embree wraps each axis on its own"


@pytest.mark.parametrize("places", [[0.0], [0.0, 3.0]], ids=["one leaf", "one plane"])
def test_a_flat_crown_is_one_slice(places):
    plant = crown([facing(x, 0, 0, 1) for x in places])
    first = slices.Crown.of(plant, np.array([0.0, 0.0, 1.0]), 5)
    assert [part.triangle_count for part in first.slices] == [2 * len(places), 0, 0, 0, 0]
    found = references.validate(plant, extent=TINY)
    assert (failures(found.sections), found.left_out) == ([], [])


def test_a_plant_that_is_a_point_has_no_picture():
    plant = crown([facing(1, 2, 3, 0.0)])
    found = references.validate(plant, extent=TINY)
    assert failures(found.sections) == []
    assert found.left_out == ["pictures: the plant is a point"]


def test_mitsuba_is_given_points_and_nothing():
    soup = foliage_soup(crown([facing(1, 2, 3, 0.0)]))
    center, scale = mitsuba._placing([soup])
    np.testing.assert_array_equal(center, soup.corners[0, 0])
    assert scale == 1.0
    assert mitsuba._placing([soup.take(np.array([], np.int64))])[1] == 1.0


# The command


def test_the_command_writes_figures_and_pictures(tmp_path, monkeypatch):
    file = tmp_path / "crown.glb"
    file.write_bytes(tl.export.plant_glb(random_crown(60)))
    monkeypatch.setattr(references.validation, "QUICK", SMALL)
    done = CliRunner().invoke(app, ["validate", str(file), "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    figures = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert figures["passed"]
    assert figures["source"]["file"] == "crown.glb"
    page = (tmp_path / "out" / "validation.html").read_text()
    for check in figures["checks"]:
        assert check["name"].replace("'", "&#39;") in page
    assert page.count("<img") == 3 * len(list((tmp_path / "out" / "pictures").iterdir()))


def test_the_command_fails_if_a_check_does(tmp_path, monkeypatch):
    file = tmp_path / "crown.glb"
    file.write_bytes(tl.export.plant_glb(random_crown(60)))
    monkeypatch.setattr(references.validation, "QUICK", SMALL)
    monkeypatch.setattr(color, "MAX_RMSE", 1e-9)
    done = CliRunner().invoke(app, ["validate", str(file), "-o", str(tmp_path / "out")])
    assert done.exit_code == 1
    assert "failed: Lit colour: lit colour, RMSE" in done.stdout
    assert "A check failed" in (tmp_path / "out" / "validation.html").read_text()
