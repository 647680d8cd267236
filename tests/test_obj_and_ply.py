"""Plants from OBJ and PLY files: materials, names, corners and colours as the files mean them."""

import numpy as np
import pytest

import treelod as tl
from made_gltf import png
from treelod.plant_files import images

OBJ = """\
mtllib tree.mtl
o trunk
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl bark
f 1/1 2/2 3/3 4/4
o crown
usemtl green leaf
v 5 0 0
v 6 0 0
v 5 1 0
f -3/1 -2/2 -1/4
v 8 0 0
v 9 0 0
v 8 1 0
f -3 -2 -1
"""
MTL = """\
newmtl bark
Kd 0.5 0.25 0.125
d 0.75
newmtl green leaf
Kd 0 0 0
map_Kd -clamp on leaf picture.png
map_d opacity.png
"""


def obj_files(tmp_path):
    from PIL import Image

    Image.new("RGB", (4, 2), (10, 200, 30)).save(tmp_path / "leaf picture.png")
    opacity = Image.new("L", (2, 1), 255)
    opacity.putpixel((0, 0), 0)
    opacity.save(tmp_path / "opacity.png")
    (tmp_path / "tree.mtl").write_text(MTL)
    path = tmp_path / "tree.obj"
    path.write_text(OBJ)
    return path


def test_obj_with_materials(tmp_path):
    plant = tl.load_plant(obj_files(tmp_path))
    bark, green = plant.materials
    assert (bark.name, bark.texture, bark.alpha_mode) == ("bark", None, "blend")
    assert (green.name, green.wrap, green.alpha_mode) == ("green leaf", ("clamp",) * 2, "mask")
    assert green.texture[0].tolist() == [[10, 200, 30, a] for a in (0, 0, 255, 255)]
    assert plant.triangle_count == 4
    ids = plant.foliage.mesh.material_ids
    base = plant.foliage.mesh.base[plant.foliage.triangles[:, 0]]
    assert base[ids == 0].tolist() == [[0.5, 0.25, 0.125, 0.75]] * 2
    assert base[ids == 1].tolist() == [[1, 1, 1, 1]] * 2
    # indices counted back from the line that they stand in
    corners = plant.foliage.positions[plant.foliage.triangles]
    assert corners[2].tolist() == [[5, 0, 0], [6, 0, 0], [5, 1, 0]]
    assert corners[3].tolist() == [[8, 0, 0], [9, 0, 0], [8, 1, 0]]
    # v runs up in OBJ; the last triangle has no texture coordinates
    uvs = plant.foliage.mesh.uvs[plant.foliage.triangles]
    assert uvs[2].tolist() == [[0, 1], [1, 1], [0, 0]]
    assert not uvs[3].any()


def test_obj_names(tmp_path):
    path = obj_files(tmp_path)
    assert tl.load_plant(path, ["crown"]).foliage.leaf_count == 2
    assert tl.load_plant(path, ["bark"]).foliage.leaf_count == 1
    with pytest.raises(ValueError, match="there are 'bark', 'crown', 'green leaf', 'trunk'"):
        tl.load_plant(path, ["leaves"])


def test_obj_materials_that_share_a_picture_decode_it_once(tmp_path, monkeypatch):
    decoded = []
    plain = images.decode
    monkeypatch.setattr(images, "decode", lambda *given: decoded.append(given[1]) or plain(*given))
    (tmp_path / "a.png").write_bytes(png([[[1, 2, 3]]]))
    (tmp_path / "a.mtl").write_text(
        "newmtl m\nmap_Kd a.png\nnewmtl n\nmap_Kd ./a.png\nnewmtl o\nmap_Kd a.png\nmap_d a.png\n"
    )
    path = tmp_path / "a.obj"
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n"
    faces = "".join(f"usemtl {name}\nf 1/1 2/1 3/1\n" for name in "mno")
    path.write_text("mtllib a.mtl\n" + corners + faces)
    textures = [material.texture.tolist() for material in tl.load_plant(path).materials]
    # the last is cut out by the brightness of the same picture, which leaves the others alone
    assert textures == [[[[1, 2, 3, 255]]], [[[1, 2, 3, 255]]], [[[1, 2, 3, 1]]]]
    assert len(decoded) == 1


@pytest.mark.parametrize("corner", ["{0}", "{0}/{0}", "{0}//{0}", "{0}/{0}/{0}"])
@pytest.mark.parametrize("plain", [True, False])
def test_obj_forms_of_corners(tmp_path, corner, plain):
    lines = [f"v {x} {y} 0" for x, y in [(0, 0), (1, 0), (0, 1), (1, 1)]]
    lines += [f"vt {x} {y}" for x, y in [(0, 0), (0.5, 0), (0, 0.25), (1, 1)]]
    lines += ["vn 0 0 1"] * 3 + ["vn 0 0.6 0.8"]
    faces = [(1, 2, 3), (2, 4, 3)] if plain else [(1, 2, 4, 3)]
    lines += ["f  " + "\t".join(corner.format(i) for i in face) for face in faces]
    path = tmp_path / "a.obj"
    path.write_text("\r\n".join(lines) + "\r\nl 1 2\r\n")
    with pytest.warns(UserWarning, match="points and lines are ignored"):
        plant = tl.load_plant(path)
    mesh = plant.foliage.mesh
    assert plant.triangle_count == 2
    assert plant.foliage.areas.tolist() == [1]
    order = [mesh.positions.tolist().index(p) for p in [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]]
    last = order[3]
    parts = corner.count("/")
    if parts and "//" not in corner:
        assert mesh.uvs[order].tolist() == [[0, 1], [0.5, 1], [0, 0.75], [1, 0]]
    else:
        assert not mesh.uvs.any()
    normal = [0, 0.6, 0.8] if parts == 2 else [0, 0, 1]
    np.testing.assert_allclose(mesh.normals[last], normal, atol=1e-7)


def test_obj_vertex_colours_are_srgb(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0 1 0 0.5\nv 1 0 0 1 0 0.5\nv 0 1 0 1 0 0.5\nf 1 2 3\n")
    base = tl.load_plant(path).foliage.mesh.base
    # 0.5 is stored as code 127 or 128: linear 0.2122 or 0.2159
    np.testing.assert_allclose(base, [[1, 0, 0.214, 1]] * 3, atol=0.0025)


def test_undefined_obj_material_warns(tmp_path):
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl lost\nf 1 2 3\n")
    with pytest.warns(UserWarning, match="the material 'lost' is not defined"):
        plant = tl.load_plant(path)
    assert [material.name for material in plant.materials] == ["lost"]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply(tmp_path, encoding):
    import trimesh

    mesh = trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [0, 2, 0]], [[0, 1, 2]], process=False)
    mesh.visual.vertex_colors = [[255, 0, 0, 255], [0, 128, 0, 255], [0, 0, 255, 51]]
    path = tmp_path / "leaf.ply"
    path.write_bytes(mesh.export(file_type="ply", encoding=encoding))
    plant = tl.load_plant(path, ["leaf"])
    assert plant.foliage.areas.tolist() == [2]
    green = ((128 / 255 + 0.055) / 1.055) ** 2.4
    expected = [[1, 0, 0, 1], [0, green, 0, 1], [0, 0, 1, 0.2]]
    np.testing.assert_allclose(plant.foliage.mesh.base, expected, rtol=1e-6)
    np.testing.assert_array_equal(plant.foliage.mesh.normals, [[0, 0, 1]] * 3)


def test_ply_with_a_picture_and_quads(tmp_path):
    from PIL import Image

    Image.new("RGBA", (2, 2), (1, 2, 3, 0)).save(tmp_path / "skin.png")
    path = tmp_path / "a.ply"
    path.write_text(
        "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 4\n"
        "property float x\nproperty float y\nproperty float z\nproperty float s\nproperty float t\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n4 0 1 2 3\n"
    )
    plant = tl.load_plant(path)
    assert plant.triangle_count == 2
    assert plant.materials[0].texture.tolist() == [[[1, 2, 3, 0]] * 2] * 2
    assert plant.materials[0].alpha_mode == "mask"
    mesh = plant.foliage.mesh
    np.testing.assert_array_equal(mesh.uvs[:, 0], mesh.positions[:, 0])
    np.testing.assert_array_equal(mesh.uvs[:, 1], 1 - mesh.positions[:, 1])
