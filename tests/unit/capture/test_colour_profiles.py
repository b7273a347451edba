"""Colour profiles of PNG, JPEG, TIFF and HEIC files, against LittleCMS (Pillow's ImageCms) and published numbers."""

import io
import struct
from functools import partial

import numpy as np
import pytest
from PIL import Image, ImageCms

from irpso_addon.capture import CaptureError, Picture
from irpso_addon.capture.images.colour_profile import linear_from_rec709, profile_of_h273, profile_of_icc
from irpso_addon.capture.images.headers import read_header
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.capture.images.linearise import samples_of_picture
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.core.encode import linear_from_srgb, srgb_from_linear
from tests.builders.captures import LIGHTS, chunk, decode_png, write_png
from tests.builders.profiles import ADOBE_RGB, P3, PROPHOTO, SRGB_CURVE, icc, parametric, png_icc, table

CODES = np.random.default_rng(3).integers(0, 255, (16, 24, 3))
GAMMA_18, GAMMA_22 = table([round(1.8 * 256)]), parametric(0, [2.19921875])
PROFILES = {
    "P3": (P3, None),
    "Adobe RGB": (ADOBE_RGB, GAMMA_22),
    "ProPhoto": (PROPHOTO, GAMMA_18),
    "linear P3": (P3, table([])),
    "a table": (ADOBE_RGB, table([round(65535 * (k / 63) ** 2.2) for k in range(64)])),
    "kind 1": (P3, parametric(1, [2.0, 0.9, 0.1])),
    "kind 2": (P3, parametric(2, [2.0, 0.9, 0.05, 0.02])),
    "kind 4": (P3, parametric(4, [2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045, 0.0, 0.0])),
}


def by_littlecms(codes, profile):
    """Return the sRGB codes, 0…255, that LittleCMS gives for 8-bit codes: an independent transform, of 8 bits."""
    source = ImageCms.ImageCmsProfile(io.BytesIO(profile))
    intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
    image = Image.fromarray(codes.astype(np.uint8))
    made = ImageCms.profileToProfile(image, source, ImageCms.createProfile("sRGB"), renderingIntent=intent)
    return np.asarray(made).astype(float)


def read(path, space="auto"):
    return ImageStore(decode_png).samples(ImageRef(path, colour_space=space))


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_gives_the_colours_that_littlecms_gives(name, tmp_path):
    profile = icc(*PROFILES[name])
    write_png(tmp_path / "a.png", CODES, extra=png_icc(profile))
    found = 255 * srgb_from_linear(np.minimum(read(tmp_path / "a.png").rgba[::-1, :, :3], 1))
    # LittleCMS rounds to codes, and has up to two more of error where a curve is steep near black.
    difference = np.abs(found - by_littlecms(CODES, profile))
    assert difference.mean() < 0.4 and np.quantile(difference, 0.99) < 1.5 and difference.max() < 4


def test_display_p3_red_is_brighter_than_rec709_can_say_and_its_green_is_0():
    # Linear P3 red in Rec. 709 is (1.2249, -0.0420, -0.0197): the matrix of both standards' primaries.
    matrix = profile_of_h273(12, 13).matrix
    np.testing.assert_allclose(matrix[:, 0], [1.2249, -0.0420, -0.0197], atol=1e-4)
    np.testing.assert_allclose(profile_of_icc(icc(P3)).matrix, matrix, atol=1e-3)
    picture = Picture(np.array([[[0.5, 0, 0]]], np.float32), 8, profile_of_icc(icc(P3)))
    found = samples_of_picture(picture)
    assert found.rgba[0, 0, 0] == pytest.approx(1.2249 * 0.21404, abs=2e-4)
    assert (found.rgba[0, 0, 1:3] == 0).all() and found.rgba[0, 0, 3] == 1 and not found.negative.any()


def test_16_bits_with_a_profile_keep_their_precision(tmp_path):
    linear = np.geomspace(1e-3, 0.9, 24)[None, :, None] * np.ones((4, 1, 3))
    codes = np.rint(65535 * srgb_from_linear(linear)).astype(int)
    write_png(tmp_path / "a.png", codes, 16, png_icc(icc(P3)))
    np.testing.assert_allclose(read(tmp_path / "a.png").rgba[::-1, :, :3], linear, rtol=2e-3)
    write_png(tmp_path / "b.png", codes, 16)  # without one it is linear
    np.testing.assert_allclose(read(tmp_path / "b.png").rgba[::-1, :, :3], codes / 65535, rtol=1e-5)
    write_png(tmp_path / "c.png", codes, 16, png_icc(icc(P3, table([]))))
    np.testing.assert_allclose(read(tmp_path / "c.png").rgba[::-1, :, :3], codes / 65535, rtol=2e-3)


@pytest.mark.parametrize("extra", [b"", png_icc(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())])
def test_an_srgb_profile_changes_no_bit(extra, tmp_path):
    write_png(tmp_path / "a.png", CODES, extra=extra)
    expected = linear_from_srgb((CODES[::-1] / 255).astype(np.float32))
    np.testing.assert_array_equal(read(tmp_path / "a.png").rgba[..., :3], expected)


def test_a_given_colour_space_overrides_the_profile(tmp_path):
    write_png(tmp_path / "a.png", CODES, extra=png_icc(icc(P3)))
    np.testing.assert_allclose(read(tmp_path / "a.png", "linear").rgba[::-1, :, :3], CODES / 255, rtol=1e-6)
    srgb = linear_from_srgb(CODES / 255)
    np.testing.assert_allclose(read(tmp_path / "a.png", "srgb").rgba[::-1, :, :3], srgb, rtol=1e-5)


def test_jpeg_and_tiff_headers_have_the_profile_too(tmp_path):
    image, profile = Image.fromarray(CODES.astype(np.uint8)), icc(P3)
    for name in ("a.jpg", "a.tif"):
        image.save(tmp_path / name, icc_profile=profile)
        assert read_header(tmp_path / name).icc == profile
        assert ImageStore(decode_png).encoding(ImageRef(tmp_path / name)) == ("srgb", "file")
    image.save(tmp_path / "b.tif", icc_profile=icc(P3, table([])))
    assert ImageStore(decode_png).encoding(ImageRef(tmp_path / "b.tif")) == ("linear", "file")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("gamma", [99999, 100400, 55556, 50000, 45455, 45000, 0])
def test_a_png_gives_the_power_that_its_gamma_states(gamma, bits, tmp_path):
    # Portable Network Graphics, third edition, 13.13: light is the sample to the power 100 000 / gAMA.
    values = (CODES[::-1] / 255).astype(np.float32)
    path = tmp_path / "a.png"
    write_png(path, CODES * (257 if bits == 16 else 1), bits, chunk(b"gAMA", struct.pack(">I", gamma)))
    found = read(path).rgba[..., :3]
    encoding, known_by = ImageStore(decode_png).encoding(ImageRef(path))
    if gamma == 0:  # meaningless (11.2.2): as without
        write_png(tmp_path / "b.png", CODES * (257 if bits == 16 else 1), bits)
        np.testing.assert_array_equal(found, read(tmp_path / "b.png").rgba[..., :3])
        assert known_by == ("guess" if bits == 8 else "depth")
        return
    assert (encoding, known_by) == ("linear" if gamma > 99000 else "srgb", "file")
    if gamma > 99000:
        np.testing.assert_array_equal(found, values)
    elif gamma < 46000:  # programs write 1 / 2.2 for sRGB
        np.testing.assert_array_equal(found, linear_from_srgb(values))
    else:
        np.testing.assert_allclose(found, values.astype(float) ** (1e5 / gamma), rtol=1e-5, atol=1e-9)


def test_the_chunk_srgb_and_a_profile_override_gamma(tmp_path):
    gamma = chunk(b"gAMA", struct.pack(">I", 55556))
    write_png(tmp_path / "a.png", CODES, extra=gamma + chunk(b"sRGB", b"\0"))
    expected = linear_from_srgb((CODES[::-1] / 255).astype(np.float32))
    np.testing.assert_array_equal(read(tmp_path / "a.png").rgba[..., :3], expected)
    write_png(tmp_path / "b.png", CODES, extra=gamma + png_icc(icc(P3, table([]))))
    assert read_header(tmp_path / "b.png").gamma == 0
    assert ImageStore(decode_png).encoding(ImageRef(tmp_path / "b.png")) == ("linear", "file")


def test_a_grey_profile_has_a_curve_alone(tmp_path):
    grey = CODES[..., :1]
    write_png(tmp_path / "a.png", grey, extra=png_icc(icc(None, GAMMA_18, b"GRAY")))
    expected = np.repeat((grey / 255) ** (461 / 256), 3, axis=-1)
    np.testing.assert_allclose(read(tmp_path / "a.png").rgba[::-1, :, :3], expected, rtol=1e-5)


def test_a_float_picture_takes_the_primaries_alone():
    values = np.array([[[0.5, 2.0, 0.25]]], np.float32)
    found = samples_of_picture(Picture(values, 32, profile_of_icc(icc(P3)))).rgba[0, 0, :3]
    np.testing.assert_allclose(found, profile_of_h273(12, 13).matrix @ values[0, 0], atol=3e-3)


def test_where_one_channel_is_clipped_a_mixing_profile_makes_all_of_them_bounds():
    values = np.array([[[1.0, 0.5, 0.5], [0.5, 0.5, 0.5]]], np.float32)
    found = samples_of_picture(Picture(values, 16, profile_of_icc(icc(P3))))
    assert found.rgba[0, :, 3].tolist() == [0, 1] and found.bounds[0, 0, 3] == -7.5
    assert samples_of_picture(Picture(values, 16)).bounds[0, 0, 3] == -1.5


def test_png_states_its_colours_by_h273_before_a_profile(tmp_path):
    write_png(
        tmp_path / "a.png", CODES, extra=png_icc(icc(ADOBE_RGB, GAMMA_22)) + chunk(b"cICP", bytes((12, 13, 0, 1)))
    )
    write_png(tmp_path / "b.png", CODES, extra=png_icc(icc(P3)))
    a, b = read(tmp_path / "a.png"), read(tmp_path / "b.png")
    np.testing.assert_allclose(a.rgba, b.rgba, atol=1e-3)
    write_png(tmp_path / "c.png", CODES, extra=chunk(b"cICP", bytes((1, 13, 0, 1))))  # sRGB itself
    np.testing.assert_array_equal(
        read(tmp_path / "c.png").rgba[::-1, :, :3], linear_from_srgb((CODES / 255).astype("f4"))
    )


def test_a_mask_ignores_its_profile(tmp_path):
    write_png(tmp_path / "a.png", 255 * (CODES > 128), extra=chunk(b"cICP", bytes((9, 16, 0, 1))))
    assert ImageStore(decode_png).mask(ImageRef(tmp_path / "a.png")).any()


@pytest.mark.parametrize(
    "extra, why",
    [
        (chunk(b"cICP", bytes((9, 16, 0, 1))), "an HDR picture"),
        (chunk(b"cICP", bytes((9, 18, 0, 1))), "an HDR picture"),
        (png_icc(icc(P3, extra={b"cicp": b"cicp" + bytes(4) + bytes((9, 18, 0, 1))})), "an HDR picture"),
        (chunk(b"cICP", bytes((3, 13, 0, 1))), "primaries .* not known"),
        (chunk(b"cICP", bytes((1, 8, 0, 0))), "narrow range of video"),
        (png_icc(icc(None)), "no matrix with curves"),
        (png_icc(icc(P3)[:200]), "damaged"),
        (png_icc(b"nonsense"), "damaged"),
    ],
)
def test_a_profile_that_is_not_read_is_refused_with_the_remedy(extra, why, tmp_path):
    write_png(tmp_path / "a.png", CODES, extra=extra)
    with pytest.raises(CaptureError, match=rf"a\.png: .*{why}.*; save it .*--colour-space srgb"):
        read(tmp_path / "a.png")
    assert read(tmp_path / "a.png", "srgb").rgba.any()


def test_the_rec709_curve_has_the_values_of_its_standard():
    # Rec. ITU-R BT.709-6: V = 4.5 L below L = 0.018, else 1.099 L^0.45 - 0.099; mid grey 0.18 is 0.409.
    linear = np.array([0, 0.01, 0.018, 0.18, 0.5, 1.0])
    signal = np.where(linear < 0.018, 4.5 * linear, 1.099 * linear**0.45 - 0.099)
    np.testing.assert_allclose(linear_from_rec709(signal), linear, atol=1e-4)
    write = partial(srgb_from_linear, linear)
    assert np.abs(write() - signal).max() > 0.04  # it is not the curve of sRGB


def test_the_srgb_curve_of_a_profile_is_taken_for_srgb():
    rec709 = np.array([[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.71410]])
    assert profile_of_icc(icc(rec709, parametric(3, SRGB_CURVE))).srgb
    assert not profile_of_icc(icc(rec709, GAMMA_18)).srgb and not profile_of_icc(icc(P3)).srgb


def test_inspect_names_the_profiles(tmp_path):
    for k in range(len(LIGHTS)):
        write_png(tmp_path / f"{k}.png", CODES + k, extra=png_icc(icc(P3)) if k else b"")
    (tmp_path / "filenames.txt").write_text("".join(f"{k}.png\n" for k in range(len(LIGHTS))))
    np.savetxt(tmp_path / "light_directions.txt", LIGHTS)
    assert ("colours", "4 Test P3, converted to Rec. 709") in inspect_capture(tmp_path, decode_png).facts


@pytest.mark.parametrize("index", ["R03", "R98"])
def test_a_jpeg_that_a_camera_marks_as_adobe_rgb_is_read_as_such(tmp_path, index):
    block = Image.Exif()
    block[0x8769] = {0xA001: 0xFFFF, 0xA005: {1: index}}
    patches = np.array([[200, 60, 60], [60, 200, 60], [60, 60, 200], [128, 128, 128]], np.uint8)
    shown = Image.fromarray(np.kron(patches.reshape(2, 2, 3), np.ones((16, 16, 1), np.uint8)))
    shown.save(tmp_path / "a.jpg", exif=block, quality=100, subsampling=0)
    codes = np.asarray(Image.open(tmp_path / "a.jpg"))
    store = ImageStore(lambda path: Picture(codes[::-1] / np.float32(255), 8))
    found = 255 * srgb_from_linear(np.minimum(store.samples(ImageRef(tmp_path / "a.jpg")).rgba[::-1, :, :3], 1))
    expected = by_littlecms(codes, icc(ADOBE_RGB, GAMMA_22)) if index == "R03" else codes
    np.testing.assert_allclose(found, expected, atol=1.5)
