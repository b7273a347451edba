"""Code values to radiance, clipping, masks, orientation tags and file headers."""

import struct

import numpy as np
import pytest

from irpso_addon.capture import CaptureError, Picture, read_capture
from irpso_addon.capture.images.exif import orientation_of, tiff_tags, upright, upright_axes
from irpso_addon.capture.images.headers import read_header
from irpso_addon.capture.images.linearise import mask_of_picture, samples_of_picture
from irpso_addon.core.encode import linear_from_srgb
from tests.builders.captures import chunk, write_png
from tests.builders.exif import exif, jpeg, tiff


def picture(codes, bits):
    return Picture((np.asarray(codes) / (2**bits - 1)).astype(np.float32), bits)


def test_the_srgb_curve_has_the_values_of_its_standard():
    # IEC 61966-2-1: code 0.5 is 0.21404114 of linear light; the straight part has slope 1/12.92.
    found = linear_from_srgb(np.array([0.0, 0.02, 0.04045, 0.048, 0.5, 1.0]))
    np.testing.assert_allclose(found, [0, 0.02 / 12.92, 0.0031308, (0.103 / 1.055) ** 2.4, 0.21404114, 1], rtol=1e-5)


def test_8_bits_are_srgb_and_16_bits_linear_by_default():
    codes = np.full((2, 3, 3), 188)
    np.testing.assert_allclose(samples_of_picture(picture(codes, 8)).rgba[0, 0, 0], 0.50289, atol=1e-5)
    np.testing.assert_allclose(samples_of_picture(picture(codes, 8), "linear").rgba[0, 0, 0], 188 / 255)
    codes = np.full((2, 3, 3), 32768)
    np.testing.assert_allclose(samples_of_picture(picture(codes, 16)).rgba[0, 0, 0], 32768 / 65535)
    np.testing.assert_allclose(samples_of_picture(picture(codes, 16), "srgb").rgba[0, 0, 0], 0.21405, atol=1e-5)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_clipped_sample_carries_no_weight(bits):
    top = 2**bits - 1
    codes = np.full((3, 3, 3), top - 1)
    codes[1, 2, 0] = top
    found = samples_of_picture(picture(codes, bits))
    expected = np.ones((3, 3))
    expected[1, 2] = 0
    np.testing.assert_array_equal(found.rgba[..., 3], expected)
    assert found.clipped.sum() == 1


def test_a_float_picture_above_1_is_not_clipped():
    found = samples_of_picture(Picture(np.full((2, 2, 3), 7.5, np.float32), 32))
    assert (found.rgba[..., :3] == 7.5).all() and (found.rgba[..., 3] == 1).all()


def test_grey_and_alpha_become_rgb_and_weight():
    values = np.array([[[0.25, 0.5]]], np.float32)
    assert samples_of_picture(Picture(values, 16)).rgba.tolist() == [[[0.25, 0.25, 0.25, 0.5]]]


@pytest.mark.parametrize("scale", [1.0, 1 / 255])
def test_a_mask_may_be_grey_rgb_or_alpha_of_any_brightness(scale):
    wanted = np.array([[True, False], [False, True]])
    white = np.where(wanted, scale, 0).astype(np.float32)
    plain = np.ones_like(white)
    for values in ([white], [white] * 3, [white] * 3 + [plain], [plain] * 3 + [white], [white * 0] * 3 + [white]):
        found = mask_of_picture(Picture(np.stack(values, axis=-1), 8))
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("orientation", range(10))
def test_the_orientation_is_read_from_hand_made_bytes(orientation, order, tmp_path):
    block, expected = exif(order=order, orientation=orientation), orientation if 1 <= orientation <= 8 else 1
    assert orientation_of(tiff_tags(block)) == expected
    (tmp_path / "a.jpg").write_bytes(jpeg(30, 40, block))
    assert read_header(tmp_path / "a.jpg").orientation == expected


def test_damaged_tags_mean_upright():
    for data in (b"", b"II*\0", b"II*\0" + struct.pack("<I", 10**9), exif(orientation=6)[:15]):
        assert orientation_of(tiff_tags(data)) == 1


def test_turning_upright_follows_the_eight_cases_of_the_standard():
    # TIFF 6.0: where row 0 and column 0 of the stored picture lie in the upright one. The mark is at both their zero.
    stored = np.zeros((2, 3), int)
    stored[0] = [1, 2, 3]  # top row, as stored; the rest is 0
    upright_pictures = {
        1: [[1, 2, 3], [0, 0, 0]], 2: [[3, 2, 1], [0, 0, 0]], 3: [[0, 0, 0], [3, 2, 1]], 4: [[0, 0, 0], [1, 2, 3]],
        5: [[1, 0], [2, 0], [3, 0]], 6: [[0, 1], [0, 2], [0, 3]], 7: [[0, 3], [0, 2], [0, 1]],
        8: [[3, 0], [2, 0], [1, 0]],
    }  # fmt: skip
    for orientation, expected in upright_pictures.items():
        found = upright(stored[::-1], orientation)[::-1]
        np.testing.assert_array_equal(found, expected, err_msg=str(orientation))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_axes_turn_with_the_picture(orientation):
    def places(height, width):  # right and up from the middle, row 0 at the bottom
        return np.stack(np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2), axis=-1)

    turned = upright(places(4, 6), orientation)
    expected = places(*turned.shape[:2])
    np.testing.assert_array_equal(turned @ upright_axes(orientation)[:2, :2].T, expected)


def test_headers_give_kind_size_and_depth(tmp_path):
    codes = np.zeros((4, 6, 3), int)
    write_png(tmp_path / "a.png", codes, 16)
    header = read_header(tmp_path / "a.png")
    assert (header.kind, header.width, header.height, header.bits) == ("PNG", 6, 4, 16)
    write_png(tmp_path / "b.png", codes, 8, chunk(b"eXIf", exif(orientation=6)))
    header = read_header(tmp_path / "b.png")
    assert (header.width, header.height, header.bits, header.orientation) == (4, 6, 8, 6)
    (tmp_path / "c.jpg").write_bytes(jpeg(30, 40))
    header = read_header(tmp_path / "c.jpg")
    assert (header.kind, header.width, header.height, header.bits) == ("JPEG", 30, 40, 8)
    (tmp_path / "d.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 5 +X 7\n" + bytes(140))
    header = read_header(tmp_path / "d.hdr")
    assert (header.kind, header.width, header.height, header.bits) == ("HDR", 7, 5, 32)
    tags = [(256, 9), (257, 8), (258, 16), (339, 1)]
    entries = b"".join(struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in tags)
    (tmp_path / "e.tif").write_bytes(b"II*\0" + struct.pack("<IH", 8, 4) + entries + bytes(4))
    header = read_header(tmp_path / "e.tif")
    assert (header.kind, header.width, header.height, header.bits) == ("TIFF", 9, 8, 16)


@pytest.mark.parametrize("size", [b"+X 7 -Y 5", b"-X 7 +Y 5"])
def test_an_hdr_file_of_columns_is_refused_as_such(tmp_path, size):
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + size + b"\n" + bytes(140))
    with pytest.raises(CaptureError, match=r"a\.hdr: stores columns, not rows .*; save it"):
        read_header(tmp_path / "a.hdr")


def test_a_truncated_png_is_refused_at_any_length(tmp_path):
    write_png(tmp_path / "a.png", np.arange(60).reshape(4, 5, 3))
    whole = (tmp_path / "a.png").read_bytes()
    for length in range(len(whole)):
        (tmp_path / "a.png").write_bytes(whole[:length])
        with pytest.raises(CaptureError, match="a.png"):
            read_header(tmp_path / "a.png")


@pytest.mark.parametrize("start", [b"\xff\xd8", b"II*\0", b"MM\0*", b"#?", b"\x89PNG\r\n\x1a\n", b"", b"GIF89a"])
def test_junk_after_a_good_beginning_is_refused_by_name(tmp_path, start):
    rng = np.random.default_rng(1)
    for length in (0, 1, 7, 30, 400):
        path = tmp_path / "junk.png"
        path.write_bytes(start + rng.bytes(length))
        with pytest.raises(CaptureError, match="junk.png: .*; "):
            read_header(path)


def test_a_camera_that_stands_still_does_not_turn_some_of_its_photographs(tmp_path):
    turns = {"a.jpg": 1, "b.jpg": 3, "c.jpg": 1}  # as a phone guesses that looks straight down
    for name, turn in turns.items():
        (tmp_path / name).write_bytes(jpeg(8, 6, exif(orientation=turn)))
    (tmp_path / "filenames.txt").write_text("\n".join(turns))
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0 1 1\n1 0 1\n")
    with pytest.raises(CaptureError, match=r"b\.jpg: its EXIF orientation is 3 where .* have 1") as refused:
        read_capture(tmp_path, lambda path: None)
    assert refused.value.code == "orientation"


@pytest.mark.parametrize("space", ["auto", "linear"])
@pytest.mark.parametrize("bits", [8, 10, 12])
def test_pictures_with_alpha_give_the_samples_of_those_without_where_they_are_opaque(bits, space):
    rng, top = np.random.default_rng(bits), 2**bits - 1
    codes = np.concatenate([rng.integers(0, top + 1, (40, 50, 3)), np.full((40, 50, 1), top)], axis=-1)
    codes[:4, :, 1] = top
    codes[2:7, :, 3] = 0
    values = (codes / np.float32(top)).astype(np.float32)
    whole, opaque = (samples_of_picture(Picture(v, bits), space) for v in (values, values[..., :3].copy()))
    for name in ("clipped", "not_finite", "negative"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(opaque, name))
    for name in ("rgba", "bounds"):
        np.testing.assert_array_equal(getattr(whole, name)[7:], getattr(opaque, name)[7:])
        np.testing.assert_array_equal(getattr(whole, name)[:2], getattr(opaque, name)[:2])
    assert (whole.rgba[2:7, :, 3] == 0).all() and (whole.bounds[4:7, :, 3] <= 0).all()


@pytest.mark.parametrize("dtype", ["u2", "f4"])
def test_a_deep_tiff_with_zero_as_white_is_refused_because_decoders_do_not_invert_it(dtype, tmp_path):
    codes = np.full((4, 6, 1), 10000).astype(dtype)
    sample_format = (339, 3, [3 if dtype == "f4" else 1])
    (tmp_path / "white.tif").write_bytes(tiff(codes, [(262, 3, [0]), sample_format]))
    with pytest.raises(CaptureError, match="white.tif: stores white as 0 .*; save it with black as 0") as refused:
        read_header(tmp_path / "white.tif")
    assert refused.value.code == "image_unknown"
    (tmp_path / "black.tif").write_bytes(tiff(codes, [sample_format]))
    assert read_header(tmp_path / "black.tif").width == 6
    (tmp_path / "eight.tif").write_bytes(tiff(codes.astype("u1"), [(262, 3, [0])]))
    assert read_header(tmp_path / "eight.tif").bits == 8
