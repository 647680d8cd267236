"""Are the errors the numbers that pencil, paper and the published programs give?"""

from types import SimpleNamespace

import flip_evaluator
import numpy as np
import pytest

import treelod as tl
from made_plants import random_crown
from treelod.cameras import Camera
from treelod.color import composite, linear_from_srgb, srgb_from_linear
from treelod.metrics import compare, compare_arrays, flip_map, measured_region, popping

FLIP_TOLERANCE = 1e-4
"""OpenImageIO and NVIDIA's evaluator differ by up to 7e-5 in f32 on white noise."""


def frame_of(color, bounds=None, eye=(0, 0, 5)):
    """Wrap a picture as the part of a frame that metrics read."""
    color = np.asarray(color, np.float32)
    height, width = color.shape[:2]
    camera = Camera.perspective(eye, (0, 0, 0), size=(width, height))
    return SimpleNamespace(color=color, bounds_px=bounds or (0, 0, width, height), camera=camera)


def flat(value, alpha=1.0, size=(48, 40)):
    """One colour everywhere, premultiplied."""
    picture = np.empty((size[1], size[0], 4), np.float32)
    picture[..., :3] = value
    picture[..., 3] = alpha
    return picture


def plant_like(size, seed):
    """Soft blobs with alpha, premultiplied linear: the kind of picture a frame holds."""
    rng = np.random.default_rng(seed)
    width, height = size
    y, x = np.mgrid[0:height, 0:width] + 0.5
    alpha = np.zeros((height, width))
    color = np.zeros((height, width, 3))
    for _ in range(30):
        cx, cy, radius = rng.random() * width, rng.random() * height, 2 + rng.random() * 6
        a = np.clip(radius - np.hypot(x - cx, y - cy), 0, 1)[..., None]
        color = color * (1 - a) + a * rng.random(3) * 0.8
        alpha = alpha * (1 - a[..., 0]) + a[..., 0]
    return np.dstack([color, alpha]).astype(np.float32)


def test_identical_pictures_have_no_error():
    frame = frame_of(plant_like((65, 51), 1))
    errors = compare(frame, frame, yee=True)
    for on in (errors, errors.on["black"], errors.on["white"]):
        assert on.rmse == 0.0
        assert on.flip == 0.0
        assert on.max == 0.0
        assert on.psnr == np.inf
        assert on.ssim == 1.0
        assert on.yee == 0.0
    assert errors.coverage_bias == 0.0
    assert errors.coverage_error == 0.0


def test_known_difference_by_hand():
    # opaque greys whose sRGB codes are 0.5 and 0.7: every difference is 0.2, on any background
    reference, image = (flat(linear_from_srgb(v)) for v in (0.5, 0.7))
    errors = compare(frame_of(reference), frame_of(image))
    assert errors.rmse == pytest.approx(0.2, abs=1e-6)
    assert errors.max == pytest.approx(0.2, abs=1e-6)
    assert errors.psnr == pytest.approx(-20 * np.log10(0.2), abs=1e-4)  # 13.979 dB
    # no variance: SSIM is (2 a b + c) / (a^2 + b^2 + c) with c = 0.01^2
    assert errors.ssim == pytest.approx((2 * 0.35 + 1e-4) / (0.25 + 0.49 + 1e-4), abs=1e-6)
    assert errors.on["black"] == errors.on["white"]
    assert errors.coverage_bias == 0.0


def test_one_wrong_channel_of_one_pixel():
    reference, image = flat(0.0), flat(0.0)
    image[3, 5, 1] = linear_from_srgb(0.6)
    errors = compare(frame_of(reference), frame_of(image))
    assert errors.max == pytest.approx(0.6, abs=1e-6)
    assert errors.rmse == pytest.approx(0.6 / np.sqrt(40 * 48 * 3), rel=1e-5)


def test_missing_foliage_shows_on_one_background_only():
    # a black leaf that is not drawn at all: invisible on black, all of the difference on white
    errors = compare(frame_of(flat(0.0, alpha=1.0)), frame_of(flat(0.0, alpha=0.0)))
    assert errors.on["black"].rmse == 0.0
    assert errors.on["black"].flip == 0.0
    assert errors.on["white"].rmse == pytest.approx(1.0)
    assert errors.rmse == errors.on["white"].rmse
    assert errors.flip == errors.on["white"].flip > 0.9
    assert errors.psnr == pytest.approx(0.0, abs=1e-6)
    assert errors.ssim == errors.on["white"].ssim
    assert errors.worse_background == "white"
    # a white leaf that is not drawn is the other way round
    errors = compare(frame_of(flat(1.0, alpha=1.0)), frame_of(flat(0.0, alpha=0.0)))
    assert errors.on["white"].rmse == 0.0
    assert errors.rmse == pytest.approx(1.0)
    assert errors.worse_background == "black"


def test_composites_in_linear_light_and_clips():
    # half-covered white over black is linear 0.5, sRGB 0.7354; brighter than white is white
    errors = compare(frame_of(flat(0.5, alpha=0.5)), frame_of(flat(7.0)))
    assert errors.on["black"].rmse == pytest.approx(1 - 0.735357, abs=1e-6)
    assert errors.on["white"].rmse == 0.0


def test_coverage_has_a_sign():
    reference, image = flat(0.0, alpha=0.5), flat(0.0, alpha=0.5)
    image[:20, :, 3] = 0.75  # half of the picture is too dense, the other too thin
    image[20:, :, 3] = 0.125
    errors = compare(frame_of(reference), frame_of(image))
    assert errors.coverage_bias == pytest.approx((0.25 - 0.375) / 2)
    assert errors.coverage_error == pytest.approx((0.25 + 0.375) / 2)


@pytest.mark.parametrize("size", [(64, 64), (65, 51), (33, 129), (7, 7), (3, 5), (1, 1)])
@pytest.mark.parametrize("ppd", [67.02, 30.0])
def test_flip_agrees_with_nvidia(size, ppd):
    first, second = plant_like(size, 2), plant_like(size, 3)
    errors = compare_arrays(
        first, second, color_space="linear", data_range=1, alpha="premultiplied", ppd=ppd
    )
    for name, background in (("black", 0.0), ("white", 1.0)):
        encoded = [
            srgb_from_linear(composite(p, background)).astype(np.float32) for p in (first, second)
        ]
        _, mean, _ = flip_evaluator.evaluate(
            encoded[0], encoded[1], "LDR", applyMagma=False, parameters={"ppd": ppd}
        )
        assert mean > 0.01, "two different pictures"
        assert errors.on[name].flip == pytest.approx(mean, abs=FLIP_TOLERANCE)


def test_flip_check_can_fail():
    # the same pictures without the encoding: what an untagged buffer would have given
    first, second = plant_like((64, 64), 2), plant_like((64, 64), 3)
    errors = compare_arrays(
        first, second, color_space="linear", data_range=1, alpha="premultiplied"
    )
    linear = [composite(p, 0.0).astype(np.float32) for p in (first, second)]
    _, mean, _ = flip_evaluator.evaluate(
        linear[0], linear[1], "LDR", applyMagma=False, parameters={"ppd": 67.02}
    )
    assert abs(errors.on["black"].flip - mean) > 10 * FLIP_TOLERANCE


def test_flip_map_averages_to_the_error():
    reference = frame_of(plant_like((90, 70), 4), bounds=(20, 20, 60, 50))
    frame = frame_of(plant_like((90, 70), 5))
    errors = compare(reference, frame)
    assert errors.region == (12, 12, 68, 58)
    for background in ("black", "white"):
        difference = flip_map(reference, frame, background=background)
        assert difference.shape == (58 - 12, 68 - 12)
        assert difference.mean(dtype=np.float64) == errors.on[background].flip


def test_error_is_of_the_plant_not_of_the_window():
    # the same 20 x 20 fault in windows of two sizes
    errors = []
    for side in (64, 256):
        reference, image = flat(0.0, 0.0, (side, side)), flat(0.0, 0.0, (side, side))
        image[10:30, 10:30] = 1.0
        errors.append(compare(frame_of(reference, (10, 10, 30, 30)), frame_of(image)))
    assert errors[0] == errors[1]
    assert errors[0].region == (2, 2, 38, 38)


@pytest.mark.parametrize(
    ("bounds", "size", "expected"),
    [
        ((100, 90, 300, 200), (640, 480), (92, 82, 308, 208)),
        ((3, 2, 639, 480), (640, 480), (0, 0, 640, 480)),  # clamped
        ((0, 0, 1, 1), (640, 480), (0, 0, 32, 32)),  # grown away from the corner
        ((639, 479, 640, 480), (640, 480), (608, 448, 640, 480)),
        ((320, 240, 321, 241), (640, 480), (305, 225, 337, 257)),  # 17 px, 15 more: 7 to the left
        ((4, 4, 6, 6), (20, 640), (0, 0, 20, 32)),  # as large as the frame allows
        ((0, 0, 0, 0), (640, 480), (0, 0, 640, 480)),  # out of view
        ((5, 9, 5, 20), (640, 480), (0, 0, 640, 480)),
    ],
)
def test_measured_region(bounds, size, expected):
    assert measured_region(bounds, size) == expected


def test_plant_out_of_view():
    empty = frame_of(flat(0.0, 0.0), bounds=(0, 0, 0, 0))
    assert compare(empty, empty).flip == 0.0
    # something drawn where nothing should be counts, wherever it is
    stray = flat(0.0, 0.0)
    stray[39, 47] = 1.0
    assert compare(empty, frame_of(stray)).max == 1.0


def test_no_similarity_under_seven_pixels():
    small = frame_of(flat(0.5, size=(40, 6)))
    errors = compare(small, small)
    assert errors.ssim is None
    assert errors.on["black"].ssim is None
    assert errors.flip == 0.0


def test_yee_sees_a_plain_difference_and_none_at_the_limit_of_float():
    assert compare(frame_of(flat(0.1)), frame_of(flat(0.1))).yee is None
    seen = compare(frame_of(flat(0.1)), frame_of(flat(0.8)), yee=True)
    assert seen.yee == 1.0
    unseen = compare(frame_of(flat(0.5)), frame_of(flat(np.float32(0.5) + 1e-6)), yee=True)
    assert unseen.yee == 0.0
    assert unseen.rmse > 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["reference", "frame"])
def test_refuses_what_is_not_finite(bad, where):
    good, wrong = flat(0.5), flat(0.5)
    wrong[7, 9, 3] = bad
    pair = (wrong, good) if where == "reference" else (good, wrong)
    with pytest.raises(ValueError, match=f"{where}.color must be finite: row 7, column 9, .* 3"):
        compare(*(frame_of(p) for p in pair))


def test_refuses_other_sizes_cameras_and_types():
    frame = frame_of(flat(0.5))
    with pytest.raises(ValueError, match=r"one shape, got \(40, 48, 4\) and \(40, 50, 4\)"):
        compare(frame, frame_of(flat(0.5, size=(50, 40))))
    with pytest.raises(ValueError, match="same camera"):
        compare(frame, frame_of(flat(0.5), eye=(0, 0, 6)))
    with pytest.raises(TypeError, match="compare_arrays takes arrays"):
        compare(frame, flat(0.5))
    with pytest.raises(ValueError, match="ppd must be"):
        compare(frame, frame, ppd=0)
    with pytest.raises(ValueError, match="background must be"):
        flip_map(frame, frame, background="grey")
    with pytest.raises(ValueError, match="frame holds no colour"):
        compare(frame, SimpleNamespace(color=None, bounds_px=(0, 0, 0, 0)))
    with pytest.raises(ValueError, match=r"reference.color must have shape"):
        compare(SimpleNamespace(color=np.zeros((0, 4, 4)), bounds_px=(0, 0, 0, 0)), frame)


def test_arrays_in_every_notation_agree():
    premultiplied = [plant_like((40, 34), seed).astype(np.float64) for seed in (6, 7)]
    straight = []
    for picture in premultiplied:
        color = picture[..., :3] / np.maximum(picture[..., 3:], 1e-12)
        straight.append(np.dstack([color, picture[..., 3]]))
    encoded = [np.dstack([srgb_from_linear(p[..., :3]), p[..., 3]]) * 255.0 for p in straight]
    results = [
        compare_arrays(*premultiplied, color_space="linear", data_range=1, alpha="premultiplied"),
        compare_arrays(*straight, color_space="linear", data_range=1, alpha="straight"),
        compare_arrays(*encoded, color_space="srgb", data_range=255, alpha="straight"),
        compare(*(frame_of(p) for p in premultiplied)),
    ]
    for result in results[1:]:
        assert result.flip == pytest.approx(results[0].flip, abs=1e-6)
        assert result.rmse == pytest.approx(results[0].rmse, abs=1e-6)
        assert result.coverage_bias == pytest.approx(results[0].coverage_bias, abs=1e-7)


def test_arrays_without_alpha_have_no_coverage():
    picture = np.full((10, 12, 3), 128, np.uint8)
    errors = compare_arrays(
        picture, picture + np.uint8(51), color_space="srgb", data_range=255, alpha="none"
    )
    assert errors.coverage_bias is None
    assert errors.coverage_error is None
    assert errors.rmse == pytest.approx(0.2, abs=1e-6)  # 51 / 255


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"color_space": "adobe"}, "color_space must be"),
        ({"alpha": "mixed"}, "alpha must be"),
        ({"color_space": "srgb", "alpha": "premultiplied"}, "needs color_space='linear'"),
        ({"alpha": "none"}, r"shape \(H, W, 3\)"),
        ({"data_range": 0}, "data_range must be"),
        ({"data_range": np.nan}, "data_range must be"),
    ],
)
def test_arrays_refuse(change, message):
    keywords = {"color_space": "linear", "data_range": 1, "alpha": "straight"}
    compare_arrays(flat(0.5), flat(0.5), **keywords)
    with pytest.raises(ValueError, match=message):
        compare_arrays(flat(0.5), flat(0.5), **(keywords | change))


def test_arrays_refuse_pictures_that_do_not_fit():
    keywords = {"color_space": "linear", "data_range": 1, "alpha": "straight"}
    with pytest.raises(ValueError, match="one shape"):
        compare_arrays(flat(0.5), flat(0.5, size=(48, 41)), **keywords)
    with pytest.raises(ValueError, match="image must be finite"):
        compare_arrays(flat(0.5), flat(np.nan), **keywords)
    with pytest.raises(ValueError, match="reference must have shape"):
        compare_arrays(np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), **keywords)


def test_popping_is_what_the_two_sides_differ_by():
    plant = random_crown(60)
    camera = tl.orbit(plant, count=1, size=(64, 48))[0]
    sides = tl.FullMesh.build(plant), tl.Slicings.build(plant, slice_count=2, resolution=16)
    frames = [tl.render(side, camera, samples=16) for side in sides]
    found = popping(*sides, camera, samples=16, ppd=40.0)
    assert found == compare(*frames, ppd=40.0)
    assert found.flip > 0.01
    # the first decides the region, as a reference does
    assert popping(*sides[::-1], camera, samples=16).coverage_bias == pytest.approx(
        -found.coverage_bias, rel=0.2
    )
    assert popping(sides[0], sides[0], camera, samples=1).flip == 0.0
    for bad, name in (
        ({"ppd": 0}, "ppd"),
        ({"samples": 2}, "samples"),
        ({"threads": 0}, "threads"),
    ):
        with pytest.raises(ValueError, match=name):
            popping(*sides, camera, **bad)
