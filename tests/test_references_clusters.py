"""Leaf clusters against trimesh, mitsuba and rays; and what these must find if all is not well."""

import dataclasses

import numpy as np
import pytest

import treelod as tl
from made_plants import crown, facing, random_crown
from treelod.references import card_depth, clusters, impostors, rays
from treelod.references.baked import card_checks
from treelod.references.card_depth import card_alpha, depth_agreement, first_cards, leaf_distance
from treelod.references.clusters import ClusterSettings, build, clusters_of
from treelod.references.views import camera_settings, check_cameras

SETTINGS = ClusterSettings(
    side=64,
    cluster_count=6,
    card_count=1,
    turned_count=1,
    precise_count=1,
    precise_spp=128,
    spp=64,
    rays=(128, 96),
)


@pytest.fixture(scope="module", autouse=True)
def _kept(request):
    """Keep what references draw beside pytest's own cache: the next run takes it from there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TREELOD_CACHE", str(request.config.cache.mkdir("treelod")))
        yield


@pytest.fixture(scope="module")
def plant():
    # off the origin and off the axes: nothing is 0 by chance
    made = random_crown(120, seed=4)
    mesh = made.foliage.mesh
    arrays = {name: getattr(mesh, name) for name in ("positions", "triangles")}
    return tl.Plant.from_arrays(
        foliage={**arrays, "colors": mesh.base},
        leaf_offsets=made.foliage.leaf_offsets,
        origin=(100.0, -20.0, 3.0),
    )


def quiet(*_):
    """No progress."""


def failed(checks):
    return [check.name for check in checks if not check.passed]


class Faulty:
    """Leaf clusters of which one thing is not as the core made it."""

    def __init__(self, lod, **changed):
        self._lod = lod
        self.__dict__.update(changed)

    def __getattr__(self, name):
        return getattr(self._lod, name)

    @property
    def params(self):
        return self._lod.params

    def at(self, **_):
        return self


def with_sides(lod, change):
    """The same with every card side changed."""
    return Faulty(lod, card_sides_at=lambda level: [change(s) for s in lod.card_sides_at(level)])


# Pictures of leaves


def picture_failures(plant, lod, *, precise=2):
    own = clusters_of(plant, lod)
    cards = impostors._fullest(plant, lod, own, 1, "")
    checks, _ = card_checks(
        cards, many=precise, many_spp=128, spp=64, others="others", progress=quiet
    )
    return failed(checks)


@pytest.mark.parametrize("flatten", ["project", "rotate"])
def test_cards_show_exactly_their_leaves(plant, flatten):
    lod = build(plant, 6, resolution=64, flatten=flatten)
    assert picture_failures(plant, lod) == []
    assert picture_failures(plant, lod, precise=0) == []
    assert failed(impostors.place_checks(plant, lod, clusters_of(plant, lod))) == []


def without_a_leaf(soup):
    """The leaf nearest to the middle as a point at its first corner."""
    corners = soup.corners.copy()
    middle = np.linalg.norm(corners.mean(axis=1) - corners.mean(axis=(0, 1)), axis=1)
    leaf = int(middle.argmin()) // 2
    corners[2 * leaf : 2 * leaf + 2] = corners[2 * leaf, 0]
    return dataclasses.replace(soup, corners=corners)


@pytest.mark.parametrize("precise", [2, 0], ids=["many samples", "64 samples"])
def test_a_leaf_that_is_missing_is_found(plant, monkeypatch, precise):
    lod = build(plant, 6, resolution=64)
    real = clusters.clusters_of(plant, lod)
    biggest = impostors._by_size(real)[0]
    changed = [
        dataclasses.replace(own, leaves=without_a_leaf(own.leaves)) if own is biggest else own
        for own in real
    ]
    cards = impostors._fullest(plant, lod, changed, 1, "")
    settings = {"many_spp": 128, "spp": 64, "others": "others", "progress": quiet}
    checks, _ = card_checks(cards, many=precise, **settings)
    assert failed(checks)


def mirrored(side):
    return dataclasses.replace(side, texels=side.texels[:, ::-1])


def upside_down(side):
    return dataclasses.replace(side, texels=side.texels[::-1])


def rolled(side):
    return dataclasses.replace(side, texels=np.roll(side.texels, 1, axis=1))


def shifted(side):
    texel = (side.corners[1] - side.corners[0]) / side.texels.shape[1]
    return dataclasses.replace(side, corners=side.corners + texel)


def turned_round(side):
    # its corners as seen from the other side: the picture would be seen mirrored
    return dataclasses.replace(side, corners=side.corners[[1, 0, 3, 2]])


@pytest.mark.parametrize("fault", [mirrored, upside_down, rolled, shifted, turned_round])
def test_a_picture_in_the_wrong_place_is_found(plant, fault):
    lod = build(plant, 6, resolution=64)
    assert picture_failures(plant, with_sides(lod, fault))
    assert picture_failures(plant, with_sides(lod, fault), precise=0)


def test_leaves_that_are_not_turned_are_found(plant):
    lod = build(plant, 6, resolution=64, flatten="rotate")
    flat = build(plant, 6, resolution=64)
    # the same clusters, but the pictures and rectangles of the other way of flattening
    assert (flat.cluster_ids == lod.cluster_ids).all()
    swapped = Faulty(lod, card_sides_at=flat.card_sides_at)
    assert picture_failures(plant, swapped)
    own = clusters_of(plant, lod)
    assert len(failed(impostors.place_checks(plant, swapped, own))) >= 2


# Rectangles and errors


def scaled(side):
    middle = side.corners.mean(axis=0)
    return dataclasses.replace(side, corners=middle + (side.corners - middle) * (1 + 2e-6))


def lifted(side):
    normal = np.cross(side.corners[1] - side.corners[0], side.corners[3] - side.corners[0])
    return dataclasses.replace(side, corners=side.corners + 1e-5 * normal / np.linalg.norm(normal))


@pytest.mark.parametrize(
    ("fault", "name"),
    [(scaled, "area difference"), (shifted, "overhang"), (lifted, "off their plane")],
)
def test_a_wrong_rectangle_is_found(plant, fault, name):
    lod = build(plant, 6, resolution=64)
    found = failed(impostors.place_checks(plant, with_sides(lod, fault), clusters_of(plant, lod)))
    assert len(found) == 1
    assert name in found[0]


def test_a_wrong_error_of_a_level_is_found(plant):
    lod = build(plant, 6, resolution=8)
    wrong = Faulty(lod, level_errors=[lod.level_errors[0] * 1.00001])
    (name,) = failed(impostors.place_checks(plant, wrong, clusters_of(plant, lod)))
    assert name.startswith("error of the level")


def test_lines_and_points_have_no_rectangle_to_compare():
    plant = crown([((k, 0, 0), (0.3, 0, 0), (0, 0, 0)) for k in range(4)])
    lod = build(plant, 2, resolution=8)
    checks = impostors.place_checks(plant, lod, clusters_of(plant, lod))
    assert failed(checks) == []
    assert "lines or points" in checks[0].note


# Colour


def test_lit_colours_of_another_light_are_found(plant, monkeypatch):
    assert failed(impostors.color_checks(plant, SETTINGS)[0]) == []
    other = plant.lit(tl.Lighting(sun_direction=(-1, 0.5, 0.2)))
    monkeypatch.setattr(impostors, "clusters_of", lambda plant, lod: clusters_of(other, lod))
    assert failed(impostors.color_checks(plant, SETTINGS)[0])


def exchanged(side):
    # coverage from behind is that from the front mirrored; only colour tells the two apart
    return dataclasses.replace(side, texels=side.texels[:, ::-1], is_back=not side.is_back)


def test_a_front_that_shows_the_back_is_found(plant, monkeypatch):
    real = impostors.build
    monkeypatch.setattr(impostors, "build", lambda *a, **kw: with_sides(real(*a, **kw), exchanged))
    assert failed(impostors.color_checks(plant, SETTINGS)[0])


# Depth


def test_alpha_is_mixed_by_hand():
    texels = np.zeros((2, 2, 4), np.uint8)
    texels[..., 3] = [[255, 0], [51, 255]]
    uvs = np.array([[0.25, 0.25], [0.5, 0.25], [0.25, 0.5], [0.0, 0.25], [0.0, 0.0]])
    # half way to nothing on the edge, a quarter on the corner
    np.testing.assert_allclose(card_alpha(texels, uvs), [1.0, 0.5, 0.6, 0.5, 0.25], atol=1e-12)


def frame_of(plant, lod, kind):
    camera = check_cameras(plant, (128, 96))[kind]
    return camera, tl.render(lod, camera, samples=1, outputs=("depth", "ids"))


@pytest.fixture(scope="module")
def seen(plant):
    """Cards with texels of some pixels, and what is needed to look at them."""
    density = (
        check_cameras(plant, (128, 96))["orthographic"].pixels_per_metre(1.0) / card_depth.TEXEL_PX
    )
    # planes along the leaves: those that a smaller weight finds lie across many of them
    return build(plant, 6, alpha_rel=0.1, texels_per_metre=density)


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_cards_are_where_rays_meet_them(plant, seen, kind):
    camera, frame = frame_of(plant, seen, kind)
    depth = frame.depth.astype(np.float64)
    planes, size = seen.planes_at(0), 2 * plant.sphere[1]
    hits = first_cards(seen.card_sides_at(0), planes, camera, plant.origin)
    checks = depth_agreement(depth, hits, kind, size=size)
    assert failed(checks) == []
    # enough of the picture is compared
    assert (np.isfinite(depth) & ~hits.unsure).mean() > 0.05
    # the card that is seen most, a hundredth of the crown further off
    ids = frame.ids[np.isfinite(depth)].astype(np.int64) - len(plant.wood.triangles)
    most = int(np.bincount(ids[ids >= 0]).argmax())
    step = 0.01 * planes[most, :3]
    moved = [
        dataclasses.replace(s, corners=s.corners + step) if s.cluster == most else s
        for s in seen.card_sides_at(0)
    ]
    found = depth_agreement(
        depth, first_cards(moved, planes, camera, plant.origin), kind, size=size
    )
    assert any("equal depth" in name for name in failed(found))
    # pictures that are mirrored, and backs in place of fronts
    for change in (mirrored, lambda s: dataclasses.replace(s, is_back=not s.is_back)):
        sides = [change(side) for side in seen.card_sides_at(0)]
        found = depth_agreement(
            depth, first_cards(sides, planes, camera, plant.origin), kind, size=size
        )
        assert any("hit or miss" in name for name in failed(found)), change


@pytest.mark.parametrize("kind", ["perspective", "orthographic"])
def test_cards_are_as_far_from_leaves_as_their_planes(plant, seen, kind):
    camera, frame = frame_of(plant, seen, kind)
    own = clusters_of(plant, seen)
    corners = np.concatenate([cluster.leaves.corners for cluster in own])
    (leaves,) = rays.trace(corners, [camera_settings(camera, plant.origin)])
    numbers = frame.ids.astype(np.int64)

    def passed(depth, numbers):
        size = 2 * plant.sphere[1]
        args = own, leaves, camera, plant.origin
        return leaf_distance(depth.astype(np.float64), numbers, *args, size=size)

    check = passed(frame.depth, numbers)
    assert check.passed
    assert int(check.note.split()[0]) > 200, "rays"
    # the control: all a metre deeper than they are, and cards that bear the next one's number
    assert not passed(frame.depth + 1.0, numbers).passed
    shown = np.isfinite(frame.depth)
    assert not passed(frame.depth, np.where(shown, (numbers + 1) % 6, numbers)).passed


def test_the_section_holds_all_of_it(plant):
    section = impostors.clusters_section(plant, SETTINGS, quiet)
    assert failed(section.checks) == []
    names = [check.name for check in section.checks]
    assert len(names) == len(set(names)) == 22
    assert len(section.panels) == 2 + 2 + 2


def test_one_leaf_is_one_card():
    plant = crown([facing(0, 0, 0, 1)])
    small = SETTINGS._replace(side=16, rays=(64, 48))
    assert failed(impostors.clusters_section(plant, small, quiet).checks) == []
