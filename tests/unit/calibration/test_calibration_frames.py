"""Dark frames, flat fields, white balance and merged brackets, against scenes that are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from irpso_addon.calibration.developing.greys import patch_response
from irpso_addon.calibration.radiometry.frames import (
    Flat,
    Frame,
    Patch,
    divided_by,
    mean_dark,
    mean_flat,
    patch_mean,
    read_codes,
    read_frame,
    white_gains,
    without_dark,
)
from irpso_addon.calibration.radiometry.hdr import merge
from irpso_addon.calibration.radiometry.response import Response
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.capture.images.linearise import Picture
from irpso_addon.core.errors import InputError

SHAPE = (40, 60)
Y, X = np.meshgrid(np.linspace(-1, 1, SHAPE[0]), np.linspace(-1, 1, SHAPE[1]), indexing="ij")
VIGNETTE = np.stack([1 - 0.5 * (X**2 + Y**2) / 2, 1 - 0.4 * (X**2 + Y**2) / 2, np.cos(0.8 * X) ** 4], axis=-1)
WELL, READ = 30000.0, 5.0  # electrons


def frame(rgb, bits=16, clip=True):
    """A frame of linear values as a file has them."""
    rgb = np.asarray(rgb, np.float64)
    rgb = np.broadcast_to(rgb, (*rgb.shape[:2], 3))
    codes = np.clip(rgb, 0, 1) if clip else rgb
    weight = np.ones(rgb.shape[:2])
    if clip:
        weight[(codes >= 1).any(axis=-1)] = 0
    return Frame(codes.astype(np.float32), weight, codes.max(axis=-1), codes.min(axis=-1), bits)


def sensed(light, rng):
    """Return linear values of light (1 is the full well) with the shot noise of electrons and read noise."""
    return (rng.poisson(np.maximum(light, 0) * WELL) + READ * rng.standard_normal(light.shape)) / WELL


def test_the_mean_of_dark_frames_is_subtracted():
    rng = np.random.default_rng(0)
    offset = rng.uniform(0.01, 0.05, (*SHAPE, 3))
    darks = [(None, offset + 0.004 * rng.standard_normal(offset.shape)) for _ in range(16)]
    scene = 0.3 + 0.2 * VIGNETTE
    found = without_dark(frame(scene + offset), mean_dark(darks).of(None, "a"), "a")
    assert np.abs(found.rgb - scene).mean() == pytest.approx(0.001 * np.sqrt(2 / np.pi), rel=0.1)


def test_each_exposure_has_its_own_dark_frame():
    levels = [(1.0, np.full((2, 2, 3), 0.01)), (4.0, np.full((2, 2, 3), 0.03)), (1.02, np.full((2, 2, 3), 0.02))]
    dark = mean_dark(levels)
    assert dark.of(1.0, "a")[0, 0, 0] == pytest.approx(0.015) and dark.of(4.1, "a")[0, 0, 0] == pytest.approx(0.03)
    with pytest.raises(InputError, match="flat.png: its exposure is unknown, and the dark frames have several"):
        dark.of(None, "flat.png")
    with pytest.raises(InputError, match="photo 3: no dark frame has its exposure; .*--scale-dark"):
        dark.of(2.0, "photo 3")


def test_a_scaled_dark_frame_lies_on_the_line_through_its_neighbours():
    bias, rate = 0.01, 0.005
    dark = mean_dark([(t, np.full((2, 2, 3), bias + rate * t)) for t in (1.0, 4.0, 16.0)], scaled=True)
    for t in (0.25, 2.0, 7.0, 40.0):
        assert dark.of(t, "a")[0, 0, 0] == pytest.approx(bias + rate * t, rel=1e-5)
    one = mean_dark([(2.0, np.full((2, 2, 3), 0.02))], scaled=True)
    assert one.of(8.0, "a")[0, 0, 0] == pytest.approx(0.08)


def test_a_dark_frame_brighter_than_the_photograph_is_refused():
    with pytest.raises(InputError, match="photo 1: is no brighter than the dark frame"):
        without_dark(frame(np.full((*SHAPE, 3), 0.1)), np.full((*SHAPE, 3), 0.2), "photo 1")


def test_a_known_vignette_is_divided_out():
    rng = np.random.default_rng(1)
    tint = np.array([0.9, 0.7, 0.5])  # the lamp's colour stays: it is no fault of the lens
    flats = [frame(sensed(level * tint * VIGNETTE, rng)) for level in (0.8, 0.6, 0.8, 0.7)]
    flat = mean_flat(flats)
    assert flat.usable.all()
    np.testing.assert_allclose(flat.field.mean(axis=(0, 1)), 1, atol=1e-5)
    scene = np.stack([0.3 + 0.2 * np.sin(5 * X), 0.4 + 0.1 * Y, 0.5 + 0 * X], axis=-1)
    found = divided_by(frame(scene * VIGNETTE), flat).rgb / VIGNETTE.mean(axis=(0, 1))
    # Noise of four flats at 15 000 electrons: 0.4 % a pixel.
    assert np.abs(found / scene - 1).mean() < 0.006
    blocks = (found / scene)[:, :, 0].reshape(4, 10, 6, 10).mean(axis=(1, 3))
    assert np.abs(blocks - 1).max() < 0.002


def test_pixels_where_the_flat_is_black_or_clipped_have_weight_0():
    values = np.full((*SHAPE, 3), 0.5)
    values[3, 4], values[7, 8, 1] = 0.01, 1.0
    flat = mean_flat([frame(values), frame(np.full((*SHAPE, 3), 0.5))], floor=0.6)
    expected = np.ones(SHAPE, bool)
    expected[3, 4] = expected[7, 8] = False
    np.testing.assert_array_equal(flat.usable, expected)
    found = divided_by(frame(values), flat)
    np.testing.assert_array_equal(found.weight > 0, expected)
    assert np.isfinite(found.rgb).all()


@pytest.mark.parametrize(("value", "words"), [(1.0, "clipped"), (0.0, "black"), (-0.5, "black in a channel")])
def test_a_flat_field_that_is_useless_is_refused(value, words):
    values = np.full((*SHAPE, 3), value)
    values[:5] = 0.9
    with pytest.raises(InputError, match=words):
        mean_flat([frame(values, clip=value > 0)])


def test_a_patch_is_counted_from_the_upper_left_corner():
    image = np.arange(40 * 60).reshape(40, 60)[::-1, :, None] * np.ones(3)  # row 0 at the bottom
    mean = patch_mean(image, np.ones(SHAPE), Patch(10, 2, 3, 4), "a")
    assert mean.tolist() == [np.mean([60 * y + x for y in range(2, 6) for x in range(10, 13)])] * 3


@pytest.mark.parametrize("patch", [Patch(58, 0, 3, 3), Patch(0, 38, 3, 3), Patch(0, 0, 0, 1), Patch(99, 99, 1, 1)])
def test_a_patch_outside_the_image_is_refused(patch):
    with pytest.raises(InputError, match="not inside its 60×40 pixels"):
        patch_mean(np.ones((*SHAPE, 3)), np.ones(SHAPE), patch, "a")


def test_a_clipped_patch_is_refused():
    weight = np.ones(SHAPE)
    weight[-5:, :5] = 0
    with pytest.raises(InputError, match="of the patch 0,0,10,10 are clipped"):
        patch_mean(np.ones((*SHAPE, 3)), weight, Patch(0, 0, 10, 10), "a")


def test_white_gains_make_the_patch_neutral_or_its_reflectance():
    mean = np.array([0.2, 0.4, 0.1])
    np.testing.assert_allclose(white_gains(mean, None, "a") * mean, 0.4)
    np.testing.assert_allclose(white_gains(mean, 0.18, "a") * mean, 0.18)
    with pytest.raises(InputError, match="black in a channel"):
        white_gains(np.array([0.2, 0.0, 0.1]), None, "a")


def test_merged_brackets_are_unbiased_and_as_sharp_as_their_noise_allows():
    rng = np.random.default_rng(2)
    truth = np.exp(np.linspace(np.log(2e-6), np.log(0.95), 60))[None, :, None] * np.ones((600, 1, 3))
    amounts = [1.0, 4.0, 16.0, 64.0]
    frames = [frame(sensed(truth * t, rng), clip=False) for t in amounts]
    frames = [Frame(np.minimum(f.rgb, 1), (f.high < 1).astype(float), f.high, f.low, 16) for f in frames]
    merged = merge(frames, amounts)
    assert (merged[..., 3] == 1).all()
    error = merged[..., :3] / truth - 1
    # The best possible: the information of the frames that do not clip, 1 / Σ t² / (t X + r²), in units of the well.
    best = np.zeros(60)
    for t in amounts:
        x = truth[0, :, 0] * t * WELL
        best += np.where(x < 0.98 * WELL, t**2 / (x + READ**2), 0) * WELL**2
    best = 1 / np.sqrt(best) / truth[0, :, 0]
    spread = error.std(axis=(0, 2))
    assert np.abs(error.mean(axis=(0, 2)) / best).max() < 0.15  # 1800 samples: 0.02 of a deviation by chance
    assert np.median(spread / best) == pytest.approx(1, abs=0.03) and (spread / best).max() < 1.15
    plain = np.mean([f.rgb / t for f, t in zip(frames, amounts, strict=True)], axis=0)
    assert (plain[:, :10] / truth[:, :10] - 1).std() > 3 * error[:, :10].std()


def test_a_pixel_clipped_in_all_exposures_has_weight_0_and_a_lower_bound():
    truth = np.array([[0.5, 3.0]])[..., None] * np.ones(3)
    merged = merge([frame(truth * t) for t in (1.0, 8.0)], [1.0, 8.0])
    np.testing.assert_allclose(merged[0, :, 0], [0.5, 1.0], rtol=1e-6)
    assert merged[0, :, 3].tolist() == [1, 0]


def test_the_shortest_exposure_is_used_up_to_where_it_clips():
    merged = merge([frame(np.full((1, 1, 3), v)) for v in (0.99, 1.0)], [1.0, 4.0])
    assert merged[0, 0].tolist() == pytest.approx([0.99] * 3 + [1])


def test_black_codes_are_left_out_where_a_longer_exposure_shows_the_pixel():
    # Code 1 of 255 stands for anything up to 1.5 of 255.
    dark, light = frame(np.full((1, 1, 3), 1 / 255), bits=8), frame(np.full((1, 1, 3), 0.4), bits=8)
    np.testing.assert_allclose(merge([dark, light], [1.0, 64.0])[0, 0, :3], 0.4 / 64, rtol=1e-5)
    alone = merge([frame(np.zeros((1, 1, 3)), bits=8), frame(np.full((1, 1, 3), 2 / 255), bits=8)], [1.0, 2.0])
    np.testing.assert_allclose(alone[0, 0, :3], 1 / 255, rtol=1e-5)


def test_a_pixel_black_in_short_exposures_and_clipped_in_the_long_one_is_still_shown():
    frames = [frame(np.full((1, 1, 3), v), bits=8) for v in (0.0, 2 / 255, 1.0)]
    merged = merge(frames, [1.0, 2.0, 500.0])
    np.testing.assert_allclose(merged[0, 0], [1 / 255] * 3 + [1], rtol=1e-5)


def test_floats_above_1_are_not_taken_for_clipped():
    merged = merge([frame(np.full((1, 1, 3), v), bits=32, clip=False) for v in (2.0, 8.0)], [1.0, 4.0])
    np.testing.assert_allclose(merged[0, 0], [2, 2, 2, 1])


RAW = ImageRef(Path("a.dng"))
EVEN = Flat(np.ones((4, 4, 3), np.float32), np.ones((4, 4), bool))


def decoded(monkeypatch, rgb, bits=16, top=2.0):
    """Return a store whose file has these pixels (H, W, 3): by default of a raw file, whose colours reach ``top``."""
    picture = Picture(
        np.concatenate([rgb, np.ones((*np.shape(rgb)[:2], 1))], axis=-1).astype(np.float32), bits, top=top
    )
    monkeypatch.setattr(ImageStore, "picture", lambda store, image: picture)
    return ImageStore()


def test_colours_of_raw_files_beyond_a_response_curve_have_weight_0(monkeypatch):
    colours = np.array([[[0.9, 0.2, 0.1], [1.0, 1.0, 1.0], [1.001, 0.2, 0.1], [1.5, 0.2, 0.1], [0.1, 0.2, 1.2]]])
    store = decoded(monkeypatch, colours)
    codes = np.linspace(0, 1, 256)
    curve = Response(codes, np.repeat(codes[:, None] ** 2, 3, axis=1), np.zeros((3, 2)))
    found = read_frame(store, RAW, curve)
    assert found.weight.tolist() == [[1, 1, 0, 0, 0]]
    np.testing.assert_allclose(found.rgb[0, :2], colours[0, :2] ** 2, atol=1e-5)
    plain = read_frame(store, RAW)
    assert plain.weight.tolist() == [[1] * 5]
    np.testing.assert_array_equal(plain.rgb, colours.astype(np.float32))


def test_a_grey_patch_of_a_raw_file_has_no_colour_beyond_1(monkeypatch):
    rgb = np.full((10, 20, 3), 0.2)
    rgb[:, 10:] = 0.8
    rgb[:4, 10:, 0] = 1.3
    store, patches = decoded(monkeypatch, rgb), (Patch(0, 0, 10, 10, 0.1), Patch(10, 0, 10, 10, 0.7))
    with pytest.raises(InputError, match="a.dng: 40% of the patch 10,0,10,10 are clipped"):
        patch_response(store, RAW, patches)


def test_strong_colours_of_raw_brackets_come_from_all_frames_that_saturate_no_photosite(monkeypatch):
    """The optimal mean of independent frames: weights of the inverse variance 1 / (X + k / t) (Hasinoff 2010)."""
    amounts, read_noise = (1.0, 4.0), READ**2 / WELL
    frames = []
    for values in ((0.36, 0.05, 0.02), (1.52, 0.19, 0.09)):
        frames.append(read_frame(decoded(monkeypatch, np.full((4, 4, 3), values)), RAW))
    x, t = np.stack([f.rgb[0, 0] for f in frames]).astype(np.float64), np.array(amounts)[:, None]
    w = 1 / (x.sum(axis=0) / t.sum() + read_noise / t)
    best = (w * x).sum(axis=0) / (w * t).sum(axis=0)
    for bracket in (frames, [without_dark(divided_by(f, EVEN), np.zeros((4, 4, 3)), "a") for f in frames]):
        np.testing.assert_allclose(merge(bracket, amounts)[0, 0], (*best, 1), rtol=1e-5)
    lower = merge(frames, amounts, saturated=0.9)
    np.testing.assert_allclose(lower[0, 0], (0.36, 0.05, 0.02, 1), rtol=1e-5)
    png = [replace(f, raw=False) for f in frames]
    np.testing.assert_allclose(merge(png, amounts)[0, 0], (0.36, 0.05, 0.02, 1), rtol=1e-5)


@pytest.mark.parametrize("suffix", ["exr", "hdr"])
def test_floats_have_no_codes(monkeypatch, suffix):
    store = decoded(monkeypatch, np.full((4, 4, 3), 0.5), bits=32, top=1.0)
    with pytest.raises(InputError, match=f"a.{suffix}: holds linear floats, .*; omit --grey-card, or give the camera"):
        read_codes(store, ImageRef(Path(f"a.{suffix}")))
