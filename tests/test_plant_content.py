"""Is a plant the same after it has travelled, and do two different ones have different names?"""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import treelod as tl
from made_plants import quads, random_crown, random_leaves
from treelod.errors import StoreError
from treelod.plants import PRESETS


def travelled(plant):
    return pickle.loads(pickle.dumps(plant))


def textured(**changes):
    """Leaves of two materials that share a texture, and one of its own, far from the origin."""
    rng = np.random.default_rng(5)
    shared, own = rng.integers(0, 256, (2, 8, 4, 4), dtype=np.uint8)
    leaves, colors = random_leaves(30)
    mesh, offsets = quads(leaves, colors)
    mesh["uvs"] = rng.uniform(-1, 2, (120, 2))
    mesh["material_ids"] = np.repeat(np.arange(60) // 2 % 3, 1)
    materials = [
        tl.Material(name="a", texture=shared, alpha_mode="mask", alpha_cutoff=0.3),
        tl.Material(name="b", texture=shared, alpha_mode="blend", wrap=("mirror", "clamp")),
        tl.Material(name="c", texture=own, double_sided=False),
    ]
    facts = {
        "foliage": mesh,
        "leaf_offsets": offsets,
        "materials": materials,
        "name": "textured",
        "origin": (1e6, 0.1, -2e6),
        "lighting": tl.Lighting(sun=(1 / 3, 0.5, 0.7), translucency=0.4, occlusion=0.5),
    }
    return tl.Plant.from_arrays(**{**facts, **changes})


def assert_same(first, second):
    """Same arrays, same footprint, and the same picture in every byte."""
    assert second.name == first.name
    assert second.digest == first.digest
    assert second.summary() == first.summary()
    assert second.lighting == first.lighting
    assert np.array_equal(second.origin, first.origin)
    for name in ("positions", "normals", "uvs", "base", "front", "back", "triangles"):
        for part in ("wood", "foliage"):
            one, two = (getattr(p, part) for p in (first, second))
            one, two = (getattr(m, "mesh", m) for m in (one, two))
            assert getattr(one, name).tobytes() == getattr(two, name).tobytes(), (part, name)
    for technique in (tl.FullMesh, tl.PointsAndLines):
        one, two = (technique.build(plant) for plant in (first, second))
        assert one.footprint == two.footprint
        for distance in (2.5, 20.0):
            (camera,) = tl.orbit(first, 1, distance=distance, elevation_deg=20, size=(96, 96))
            frames = [
                tl.render(lod, camera, outputs=("color", "depth", "ids")) for lod in (one, two)
            ]
            for plane in ("color", "depth", "ids"):
                one_plane, two_plane = (getattr(frame, plane) for frame in frames)
                assert one_plane.tobytes() == two_plane.tobytes(), (technique, plane)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_grown_plant_travels(preset):
    # what grows on which branch counts: points and lines order their splats by it
    count = {"grove": None, "sunflower": None, "daisy": None}.get(preset, 60)
    plant = tl.grow_plant(preset, seed=3, leaf_count=count)
    back = travelled(plant)
    assert_same(plant, back)
    assert (back._core.structure is None) == (plant._core.structure is None)
    for name, array in (plant._core.structure or {}).items():
        assert np.array_equal(back._core.structure[name], array), name


def test_a_textured_plant_travels_and_its_materials_still_share():
    plant = textured()
    back = travelled(plant)
    assert_same(plant, back)
    first, second, third = (material.texture for material in back.materials)
    assert first is second
    assert first is not third
    # 128 bytes each, and two of them
    assert tl.FullMesh.build(back).footprint.texture_bytes == 2 * 128


def test_a_real_plant_travels(models):
    plant = tl.load_plant(next(iter(sorted(models.glob("quaternius_common/*.gl*")))))
    assert any(material.texture is not None for material in plant.materials)
    assert_same(plant, travelled(plant))


def test_a_plant_of_wood_alone_travels():
    wood, _ = quads([((0, 0, 0), (1, 0, 0), (0, 1, 0))])
    plant = tl.Plant.from_arrays(wood=wood)
    back = travelled(plant)
    assert back.digest == plant.digest
    assert back.foliage.leaf_count == 0


# Names


def test_names_do_not_count_and_all_else_does():
    plant = textured()
    assert len(plant.digest) == 64
    assert textured(name="other").digest == plant.digest
    arrays = {
        "positions": lambda mesh: mesh["positions"] + [0, 0, 1e-6],
        "uvs": lambda mesh: mesh["uvs"] * 2,
        "colors": lambda mesh: mesh["colors"] * 0.5,
        "triangles": lambda mesh: np.roll(mesh["triangles"], 1, axis=1),
        "material_ids": lambda mesh: 2 - mesh["material_ids"],
    }
    base = plant.foliage.mesh
    mesh = {
        "positions": base.positions,
        "triangles": base.triangles,
        "normals": base.normals,
        "uvs": base.uvs,
        "colors": base.base,
        "material_ids": base.material_ids,
    }
    materials = plant.materials
    changed = {name: {"foliage": {**mesh, name: of(mesh)}} for name, of in arrays.items()}
    changed |= {
        "leaves": {"leaf_offsets": [0, *plant.foliage.leaf_offsets[2:]]},
        "origin": {"origin": (1e6, 0.1, -2e6 + 1)},
        "sun": {"lighting": tl.Lighting(sun=(1 / 3, 0.5, 0.71), translucency=0.4, occlusion=0.5)},
        "mode": {"materials": [replace(materials[0], alpha_mode="opaque"), *materials[1:]]},
        "cutoff": {"materials": [replace(materials[0], alpha_cutoff=0.31), *materials[1:]]},
        "wrap": {"materials": [replace(materials[0], wrap=("clamp", "repeat")), *materials[1:]]},
        "name of a material": {"materials": [replace(materials[0], name="x"), *materials[1:]]},
        "texture": {
            "materials": [replace(materials[0], texture=materials[2].texture), *materials[1:]]
        },
        "as wood": {"wood": mesh, "foliage": None, "leaf_offsets": None},
    }
    digests = {name: textured(**change).digest for name, change in changed.items()}
    assert textured(foliage=mesh).digest == plant.digest, "the control: the same arrays again"
    assert len({plant.digest, *digests.values()}) == 1 + len(digests), digests


def test_seeds_give_names():
    digests = {tl.grow_plant("grass", seed=seed, leaf_count=9).digest for seed in (1, 2, 1)}
    assert len(digests) == 2
    assert random_crown(60).digest == random_crown(60).digest


# What is no plant


def flipped(data):
    """One bit in the middle of an array, where the archive's own checksum tells."""
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: b"",
        lambda data: b"PK\x03\x04 no archive",
        lambda data: data[:-100],
        lambda data: data[: len(data) // 2],
        # in the middle of an array, where the archive's own checksum tells
        flipped,
    ],
    ids=["empty", "no archive", "torn", "half", "flipped"],
)  # fmt: skip
def test_damaged_plants_are_refused(spoil):
    data = random_crown(60).to_bytes()
    with pytest.raises(StoreError, match="stored plant"):
        tl.Plant.from_bytes(spoil(data))


def test_another_format_is_refused(tmp_path):
    path = tmp_path / "later.npz"
    np.savez(path, header=np.frombuffer(b'{"format": "treelod plant 2"}', np.uint8))
    with pytest.raises(StoreError, match="its format is 'treelod plant 2', not 'treelod plant 1'"):
        tl.Plant.from_bytes(path.read_bytes())


def test_nothing_in_a_plant_is_executed(tmp_path):
    # an object array would be unpickled, if that were allowed
    path = tmp_path / "evil.npz"
    np.savez(path, header=np.array([print], dtype=object))
    with pytest.raises(StoreError, match=r"damaged, or no plant.*allow_pickle=False"):
        tl.Plant.from_bytes(path.read_bytes())


def test_branches_that_do_not_fit_are_refused():
    plant = tl.grow_plant("chestnut", leaf_count=60)
    core = plant._core
    good = core.structure
    leaves = core.leaves[0]

    def made(**changes):
        mesh = {
            k: core.foliage[k] for k in ("positions", "normals", "uvs", "triangles", "material_ids")
        }
        wood = {k: core.wood[k] for k in mesh}
        return type(core)(
            "x", core.origin, core.materials,
            {**wood, "colors": core.wood["base"]}, {**mesh, "colors": core.foliage["base"]},
            leaves, core.lighting, {**good, **changes},
        )  # fmt: skip

    assert made().structure.keys() == good.keys()
    beyond = good["leaves"].copy()
    beyond[-1] = (0, 61)
    gap = good["wood_triangles"].copy()
    gap[1, 0] += 1
    short = good["wood_triangles"].copy()
    short[-1] = short[-1, 0]
    count = len(core.wood["triangles"])
    after = good["leaves"].copy()
    after[-1] = (0, 60)
    other = good["leaf_branches"].copy()
    other[0] -= 1
    parted = good["parents"].copy()
    # a branch on the trunk parts what comes before it from what comes after
    limb = int(np.flatnonzero(parted == 0)[-1])
    parted[-1] = limb - 1
    assert limb < len(parted) - 1
    for changes, message in (
        ({"radii": good["radii"][1:]}, "structure has [0-9]+ parents and rows of"),
        ({"parents": good["parents"] - 2}, "structure: branch 0 has the parent -3"),
        ({"parents": np.arange(len(good["parents"]))}, "branch 0 comes before its parent"),
        ({"leaves": beyond}, r"has leaves 0\.\.61 of 60"),
        ({"leaf_branches": good["leaf_branches"][1:]}, "leaf_branches has 59 values for 60"),
        ({"wood_triangles": gap}, "branch 1 has wood triangles .*, not from [0-9]+ on"),
        ({"wood_triangles": short}, f"the branches have [0-9]+ wood triangles of {count}"),
        ({"leaves": after}, r"has leaves 0\.\.60, not from [0-9]+ on"),
        ({"leaf_branches": other}, "leaf_branches and the leaves of branch [0-9]+ disagree"),
        ({"parents": parted}, f"branch {len(parted) - 1} is parted from its parent's other"),
    ):
        with pytest.raises(ValueError, match=message):
            made(**changes)
