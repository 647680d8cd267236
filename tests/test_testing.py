"""Does `treelod.testing` fail where it should, say why, and leave pytest alone otherwise?"""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import treelod as tl
from made_plants import random_crown
from treelod import metrics, testing
from treelod.color import composite, quantize, srgb_from_linear
from treelod.testing import PlantFactory, ReferenceFactory, assert_frame_close

pytest_plugins = ["pytester"]

CROWN = random_crown(60)
(CAMERA,) = tl.orbit(CROWN, 1, size=(64, 48))


@pytest.fixture(scope="module")
def truth():
    return tl.render(tl.FullMesh.build(CROWN), CAMERA, samples=16)


@pytest.fixture(scope="module")
def thinner(truth):
    """The truth with all alpha and colour times 0.8."""
    return replace(truth, color=truth.color * np.float32(0.8))


def message(frame, reference, **tolerances):
    with pytest.raises(AssertionError) as caught:
        assert_frame_close(frame, reference, **tolerances)
    return str(caught.value)


def test_returns_what_was_measured(truth, thinner):
    assert (
        assert_frame_close(truth, truth, flip=0.0, coverage_bias=0.0, rmse=0.0, ssim=1.0).flip == 0
    )
    errors = assert_frame_close(thinner, truth, flip=1.0)
    assert errors == metrics.compare(truth, thinner)


@pytest.mark.parametrize(
    ("name", "shown"),
    [("flip", "FLIP"), ("coverage_bias", "coverage bias"), ("rmse", "RMSE"), ("ssim", "SSIM")],
)
def test_each_tolerance_breaks_by_itself(truth, thinner, tmp_path, name, shown):
    errors = metrics.compare(truth, thinner)
    value = getattr(errors, name)
    edge = abs(value)
    assert edge > 0
    assert_frame_close(thinner, truth, **{name: edge})
    tighter = edge + 1e-9 if name == "ssim" else edge - 1e-9
    text = message(thinner, truth, **{name: tighter}, out=tmp_path / "a.png")
    assert text.splitlines()[0] == f"frame is not close to its reference: {shown}"
    broken = [line for line in text.splitlines() if "BROKEN" in line]
    assert len(broken) == 1
    assert f"{value:.6g}" in broken[0]
    # every number is there, asked for or not
    for number in (errors.flip, errors.coverage_bias, errors.rmse, errors.ssim, errors.psnr):
        assert f"{abs(number):.6g}" in text
    assert text.count("(no tolerance)") == 3


def test_too_dense_breaks_like_too_thin(truth, thinner, tmp_path):
    out = tmp_path / "a.png"
    assert "-0." in message(thinner, truth, coverage_bias=0.01, out=out)
    assert "+0." in message(truth, thinner, coverage_bias=0.01, out=out)


def test_the_picture_is_expected_difference_and_actual(truth, thinner, tmp_path):
    text = message(thinner, truth, flip=0.0, out=tmp_path / "new" / "a.png")
    assert str(tmp_path / "new" / "a.png") in text
    with Image.open(tmp_path / "new" / "a.png") as file:
        picture = np.asarray(file.convert("RGB"))
    errors = metrics.compare(truth, thinner)
    left, top, right, bottom = errors.region
    factor = 320 // max(right - left, bottom - top)
    below = picture[testing._CAPTION_PX :][::factor]
    assert below.shape[0] == bottom - top
    width = (right - left) * factor
    panels = [below[:, number * (width + 8) :][:, :width:factor] for number in range(3)]
    background = metrics.BACKGROUNDS[errors.worse_background]
    for panel, frame in zip((panels[0], panels[2]), (truth, thinner), strict=True):
        linear = composite(frame.color[top:bottom, left:right], background)
        np.testing.assert_array_equal(panel, quantize(srgb_from_linear(linear)))
    assert (panels[0] != panels[2]).any()
    same = metrics.flip_map(truth, thinner, background=errors.worse_background) < 1e-3
    assert panels[1][same].max() < 10, "black where nothing differs"
    assert panels[1].max() > 30


def test_a_region_without_structural_similarity_breaks_its_tolerance(tmp_path):
    (camera,) = tl.orbit(CROWN, 1, size=(6, 6))
    frame = tl.render(tl.FullMesh.build(CROWN), camera)
    assert_frame_close(frame, frame, flip=0.0)
    assert "SSIM" in message(frame, frame, ssim=0.5, out=tmp_path / "a.png")


def test_refuses(truth):
    nan = replace(truth, color=np.full_like(truth.color, np.nan))
    small = tl.render(tl.FullMesh.build(CROWN), tl.orbit(CROWN, 1, size=(32, 32))[0])
    cases = [
        ((truth, truth), {}, ValueError, "at least one tolerance"),
        ((truth, truth), {"flip": -0.1}, ValueError, r"flip must be in \[0, 1\]"),
        ((truth, truth), {"flip": math.nan}, ValueError, "flip must be in"),
        ((truth, truth), {"ssim": 1.5}, ValueError, r"ssim must be in \[-1, 1\]"),
        ((nan, truth), {"flip": 1.0}, ValueError, "frame.color must be finite"),
        ((truth, nan), {"flip": 1.0}, ValueError, "reference.color must be finite"),
        ((small, truth), {"flip": 1.0}, ValueError, "one shape"),
        ((truth.color, truth), {"flip": 1.0}, TypeError, "must be a Frame"),
    ]
    for frames, tolerances, error, match in cases:
        with pytest.raises(error, match=match):
            assert_frame_close(*frames, **tolerances)


def test_pictures_go_into_the_tests_own_folder(truth, thinner, tmp_path):
    first, second = (message(thinner, truth, flip=0.0) for _ in range(2))
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "test_testing.py_test_pictures_go_into_the_tests_own_folder-2.png",
        "test_testing.py_test_pictures_go_into_the_tests_own_folder.png",
    ]
    assert str(tmp_path) in first
    assert "-2.png" in second


# Fixtures


def test_plants_are_made_once(treelod_plant, tmp_path):
    plant = treelod_plant("chestnut", leaf_count=50)
    assert plant.foliage.leaf_count == 50
    assert treelod_plant("chestnut", leaf_count=50) is plant
    assert treelod_plant("chestnut", leaf_count=60) is not plant
    file = tmp_path / "a.ply"
    file.write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    loaded = treelod_plant(file)
    assert loaded.triangle_count == 1
    assert treelod_plant(str(file)) is loaded, "a name with a dot is a file"
    with pytest.raises(FileNotFoundError):
        treelod_plant("no.glb")
    with pytest.raises(ValueError, match="preset"):
        treelod_plant("nobody")


def test_references_are_drawn_once_and_held_while_there_is_room(monkeypatch):
    factory, plant = ReferenceFactory(), PlantFactory()("chestnut", leaf_count=50)
    cameras = tl.orbit(plant, 3, size=(32, 32))
    frames = [factory(plant, camera, samples=4) for camera in cameras[:2]]
    assert [factory(plant, camera, samples=4) for camera in cameras[:2]] == frames
    assert factory(plant, cameras[0], samples=1) is not frames[0]
    direct = tl.render(tl.FullMesh.build(plant), cameras[0], samples=4)
    np.testing.assert_array_equal(frames[0].color, direct.color)
    # room for two frames: colour of 16 bytes and depth of 4
    monkeypatch.setattr(testing, "_CACHE_BYTES", 2 * 32 * 32 * 20)
    factory(plant, cameras[0], samples=4)
    factory(plant, cameras[2], samples=4)
    assert len(factory._frames) == 2
    assert factory(plant, cameras[0], samples=4) is frames[0], "used last but one"


def test_the_fixtures_last_for_the_session(treelod_reference, treelod_plant, request):
    assert isinstance(treelod_reference, ReferenceFactory)
    assert isinstance(treelod_plant, PlantFactory)
    assert request.session.config.pluginmanager.hasplugin("treelod")


# The plugin, in runs of pytest of its own


def test_a_session_that_does_not_use_it_imports_nothing(pytester):
    pytester.makepyfile(
        """
        import sys

        def test_plain():
            loaded = {"numpy", "treelod", "treelod._core", "PIL", "OpenImageIO"} & set(sys.modules)
            assert not loaded
            assert "pytest_treelod" in sys.modules
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider", "-p", "no:hypothesispytest")
    result.assert_outcomes(passed=1)


FAILING = """
    from dataclasses import replace

    import treelod as tl
    from treelod.testing import assert_frame_close

    def test_thin(treelod_plant, treelod_reference):
        plant = treelod_plant("chestnut", leaf_count=50)
        camera = tl.orbit(plant, 1, size=(48, 48))[0]
        truth = treelod_reference(plant, camera, samples=4)
        assert_frame_close(replace(truth, color=truth.color / 2), truth, flip=0.001)
"""


def test_a_failure_names_a_picture_that_is_there(pytester):
    pytester.makepyfile(FAILING)
    result = pytester.runpytest_inprocess()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["E*frame is not close to its reference: FLIP"])
    text = result.stdout.str()
    # the test's line is shown, and none of treelod's own
    assert "testing.py:" not in re.sub(r"test_\w+\.py:", "", text)
    # pytest shows the message a second time, in its summary, where CI is set
    (name,) = set(re.findall(r"expected \| difference \| actual on \w+: (\S+)", text))
    with Image.open(name) as picture:
        assert picture.size[0] > 400
    assert "test_thin" in name


def test_pictures_go_where_they_are_asked_to(pytester):
    pytester.makepyfile(FAILING)
    result = pytester.runpytest_inprocess("--treelod-pictures=seen")
    result.assert_outcomes(failed=1)
    (file,) = (pytester.path / "seen").iterdir()
    assert file.name.endswith("test_thin.png")


def test_it_can_be_turned_off(pytester):
    pytester.makepyfile(
        """
        from dataclasses import replace

        import pytest

        import treelod as tl
        from treelod.testing import assert_frame_close

        def test_thin():
            plant = tl.grow_plant("chestnut", leaf_count=50)
            camera = tl.orbit(plant, 1, size=(48, 48))[0]
            truth = tl.render(tl.FullMesh.build(plant), camera)
            with pytest.raises(AssertionError, match="treelod-"):
                assert_frame_close(replace(truth, color=truth.color / 2), truth, flip=0.001)

        def test_no_fixture(treelod_plant):
            pass
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:treelod")
    result.assert_outcomes(passed=1, errors=1)
    result.stdout.fnmatch_lines(["*fixture 'treelod_plant' not found*"])
    result = pytester.runpytest_inprocess("-p", "no:treelod", "--treelod-pictures=x")
    assert result.ret == pytest.ExitCode.USAGE_ERROR


def test_the_documents_example_runs(pytester):
    text = (Path(__file__).parents[1] / "docs/testing.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    pytester.makepyfile(example)
    pytester.runpytest_inprocess().assert_outcomes(passed=1)
    # it can fail: four texels are no crown
    pytester.makepyfile(example.replace("resolution=64", "resolution=2"))
    pytester.runpytest_inprocess().assert_outcomes(failed=1)
