"""Blender's image loader, measured; and real captures read through it. Needs Blender's data, no GPU."""

import struct

import numpy as np
import pytest

from irpso_addon.blender.images import decode
from irpso_addon.capture import Picture, read_capture, read_exr
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.core.errors import InputError
from irpso_addon.core.png import encode_png
from tests.builders.captures import chunk, read_png, write_png

pytest.importorskip("bpy", reason="Blender's Python module is not installed")
pytestmark = pytest.mark.bpy_only
RNG = np.random.default_rng(9)


def write_tiff(path, values, sample_format, orientation=1):
    """Write (H, W) uint8, uint16 or float32, top row first, as an uncompressed little-endian TIFF."""
    height, width = values.shape
    bits, data = values.dtype.itemsize * 8, values.tobytes()
    tags = [(256, width), (257, height), (258, bits), (259, 1), (262, 1), (273, 8), (274, orientation), (277, 1),
            (278, height), (279, len(data)), (339, sample_format)]  # fmt: skip
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", t, 4, 1, v) for t, v in tags)
    path.write_bytes(b"II*\0" + struct.pack("<I", 8 + len(data)) + data + directory + bytes(4))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_png_code_values_arrive_exactly_whatever_their_alpha(tmp_path, bits, channels):
    codes = RNG.integers(0, 2**bits, (5, 7, channels))
    codes[0, 0], codes[0, 1] = 0, 2**bits - 1
    write_png(tmp_path / "a.png", codes, bits)
    found = decode(tmp_path / "a.png")
    assert isinstance(found, Picture) and found.bits == bits
    back = found.values[::-1] * np.float64(2**bits - 1)
    colours = min(channels, 3)
    np.testing.assert_allclose(back[..., :3], np.broadcast_to(codes[..., :colours], (5, 7, 3)), atol=0.01)
    np.testing.assert_allclose(back[..., 3], codes[..., 3] if channels == 4 else 2**bits - 1, atol=0.01)


def test_eight_bits_are_linearised_by_the_exact_srgb_curve(tmp_path):
    codes = np.arange(256).reshape(16, 16, 1).repeat(3, axis=-1)
    write_png(tmp_path / "a.png", codes, 8)
    (tmp_path / "x.lp").write_text("1\na.png 0 0 1\n")
    found = read_capture(tmp_path, decode).observations[0].read()[::-1]
    encoded = codes / 255
    exact = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(found[..., :3], exact, rtol=1e-6, atol=1e-9)
    assert found[..., 3].ravel().tolist() == [1] * 255 + [-7.5]  # white: all three channels are bounds


def test_tiff_of_8_16_and_float_bits_arrives_exactly(tmp_path):
    for name, kind, sample_format, bits in (("8", np.uint8, 1, 8), ("16", np.uint16, 1, 16), ("f", np.float32, 3, 32)):
        codes = (RNG.random((4, 6)) * (200 if bits != 16 else 60000)).astype(kind)
        write_tiff(tmp_path / f"{name}.tif", codes, sample_format)
        found = decode(tmp_path / f"{name}.tif")
        assert found.bits == bits
        scale = 1 if bits == 32 else 2**bits - 1
        np.testing.assert_allclose(found.values[::-1, :, 1] * np.float64(scale), codes, atol=0.01 if bits < 32 else 0)


def test_hdr_arrives_linear(tmp_path):
    # RGBE of Ward 1991: mantissa / 256 · 2^(exponent − 128).
    pixels = bytes([128, 64, 32, 130]) * 8
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + pixels)
    found = decode(tmp_path / "a.hdr")
    assert found.bits == 32 and found.values.shape[:2] == (2, 4)
    np.testing.assert_array_equal(found.values[..., :3], np.broadcast_to([2, 1, 0.5], (2, 4, 3)))


def test_the_exposure_and_colour_correction_of_an_hdr_file_are_divided_out(tmp_path):
    # Radiance file formats: the original radiance is the value over the product of all these lines.
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2.0\nCOLORCORR= 1 0.5 2\nVIEW= -vf EXPOSURE=8\nEXPOSURE=4\n"
    (tmp_path / "a.hdr").write_bytes(head + b"\n-Y 2 +X 4\n" + bytes([128, 64, 32, 130]) * 8)
    found = decode(tmp_path / "a.hdr").values
    expected = np.array([2, 1, 0.5]) / (2 * 4) / (1, 0.5, 2)
    np.testing.assert_allclose(found[..., :3], np.broadcast_to(expected, (2, 4, 3)), rtol=1e-6)
    assert (found[..., 3] == 1).all()
    for wrong in (b"EXPOSURE=0", b"EXPOSURE=bright", b"COLORCORR=1 2", b"EXPOSURE=nan"):
        (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\n" + wrong + b"\n\n-Y 2 +X 4\n" + bytes(32))
        with pytest.raises(InputError, match=f"{wrong[:8].decode()}.*; correct"):
            decode(tmp_path / "a.hdr")


@pytest.mark.parametrize(("down", "along"), [("-Y", "+X"), ("-Y", "-X"), ("+Y", "-X"), ("+Y", "+X")])
def test_the_signs_of_an_hdr_header_say_where_its_first_pixel_lies(tmp_path, down, along):
    # Radiance file formats: -Y is from the top down, +X from left to right.
    pixels = RNG.integers(128, 256, (3, 4, 4)).astype(np.uint8)
    pixels[..., 3] = 128
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n{down} 3 {along} 4\n"
    (tmp_path / "a.hdr").write_bytes(head.encode() + pixels.tobytes())
    expected = pixels[:: 1 if down == "-Y" else -1, :: 1 if along == "+X" else -1, :3] / 256
    np.testing.assert_array_equal(decode(tmp_path / "a.hdr").values[::-1, :, :3], expected)


@pytest.mark.parametrize("kind", ["png", "tif", "jpg"])
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_pictures_are_turned_upright_by_their_tag(tmp_path, kind, orientation):
    import bpy

    stored = np.zeros((16, 32), np.uint8)
    stored[:8, :16] = 200  # bright at the top left, as stored
    path = tmp_path / f"a.{kind}"
    entry = struct.pack("<HHIHH", 274, 3, 1, orientation, 0)
    exif = b"II*\0" + struct.pack("<IH", 8, 1) + entry + bytes(4)
    if kind == "tif":
        write_tiff(path, stored, 1, orientation)
    elif kind == "png":
        write_png(path, stored[..., None], 8, chunk(b"eXIf", exif))
    else:
        image = bpy.data.images.new("a", 32, 16)
        pixels = np.ones((16, 32, 4), np.float32)
        pixels[..., :3] = stored[::-1, :, None] / 255
        image.pixels.foreach_set(pixels.ravel())
        image.file_format = "JPEG"
        image.filepath_raw = str(path)
        image.save()
        bpy.data.images.remove(image)
        data, block = path.read_bytes(), b"Exif\0\0" + exif
        path.write_bytes(data[:2] + b"\xff\xe1" + struct.pack(">H", 2 + len(block)) + block + data[2:])
    # np.rot90 turns against the clock: the tags say what a viewer has to do to the stored picture.
    expected = np.rot90(stored, {1: 0, 3: 2, 6: -1, 8: 1}[orientation])
    found = decode(path).values[::-1, :, 1] * 255
    np.testing.assert_allclose(found, expected, atol=12 if kind == "jpg" else 0.01)


def test_decoding_leaves_no_image_behind(tmp_path):
    import bpy

    before = len(bpy.data.images)
    write_png(tmp_path / "a.png", np.zeros((2, 2, 3)), 8)
    decode(tmp_path / "a.png")
    write_png(tmp_path / "bad.png", np.zeros((2, 2, 3)), 8)
    data = (tmp_path / "bad.png").read_bytes()
    at = data.index(b"IDAT") + 4
    (tmp_path / "bad.png").write_bytes(data[:at] + bytes(4) + data[at + 4 :])
    with pytest.raises(InputError, match="bad.png: .*damaged"):
        decode(tmp_path / "bad.png")
    assert len(bpy.data.images) == before


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_a_written_png_holds_the_exact_code_values(tmp_path, bits, channels):
    top = 2**bits - 1
    codes = RNG.integers(0, top + 1, (9, 13, channels))
    codes[0, 0], codes[8, 12] = 0, top
    encode_png(tmp_path / "a.png", (codes[::-1] / top).astype(np.float32), bits)
    found, found_bits = read_png(tmp_path / "a.png")
    assert found_bits == bits
    np.testing.assert_array_equal(found, codes)
    if channels != 2:
        np.testing.assert_allclose(
            decode(tmp_path / "a.png").values[::-1, :, 0] * np.float64(top), codes[..., 0], atol=0.01
        )


def test_values_out_of_range_are_clamped_and_nan_is_0(tmp_path):
    encode_png(tmp_path / "a.png", np.array([[-1.0, 2.0, np.nan, 0.5]]), 8)
    assert read_png(tmp_path / "a.png")[0].ravel().tolist() == [0, 255, 0, 128]


@pytest.mark.parametrize(
    ("name", "degrees"), [("bunny_lambert_noshadow", 1.01), ("bunny_lambert", 4.16), ("bunny_specular", 18.47)]
)
def test_least_squares_on_the_bunnies_has_the_published_errors(shared_data, name, degrees):
    capture = read_capture(shared_data / name, decode)
    mask = capture.masks[0]
    assert mask.sum() == 20317
    grey = np.stack([o.read()[..., :3].mean(axis=-1)[mask] for o in capture.observations])
    scaled = np.linalg.lstsq(np.array([o.light.vector for o in capture.observations]), grey, rcond=None)[0].T
    found = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    channels = read_exr(shared_data / name / "normal_gt.exr")[""]
    truth = np.stack([channels[c][mask] for c in "RGB"], axis=-1).astype(float)
    errors = np.degrees(np.arccos(np.clip((found * truth).sum(axis=1), -1, 1)))
    assert errors.mean() == pytest.approx(degrees, abs=0.005)


def test_the_icon_is_read_from_its_lp_file(shared_data):
    capture = read_capture(shared_data / "rti_icon", decode)
    assert len(capture.observations) == 72 and (capture.cameras[0].width, capture.cameras[0].height) == (402, 395)
    np.testing.assert_allclose(capture.observations[1].light.vector, (0.452022, -0.402937, 0.795813), atol=1e-6)
    image = capture.observations[0].read()
    assert image.shape == (395, 402, 4) and 0.05 < image[..., :3].mean() < 0.9


@pytest.mark.parametrize("name", ["bunny_lambert_noshadow", "bunny_lambert", "bunny_specular"])
def test_inspect_accepts_the_bunnies_and_reports_their_mirror_images(shared_data, tmp_path, name):
    assert inspect_capture(shared_data / name, decode).findings == ()
    for path in (shared_data / name).iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "light_directions.txt").unlink()
    lights = np.loadtxt(shared_data / name / "light_directions.txt")
    np.savetxt(tmp_path / "light_directions.txt", lights * [1, -1, 1])
    report = inspect_capture(tmp_path, decode)
    assert report.codes == {"mirrored"} and "negate y" in report.findings[0].message


def test_inspect_finds_only_the_clipped_gold_of_the_icon(shared_data):
    assert inspect_capture(shared_data / "rti_icon", decode).codes == {"clipped"}


def test_a_real_capture_of_8_bits_that_states_no_encoding_stays_srgb(shared_data):
    if not (folder := shared_data / "rti_icon").is_dir():
        pytest.skip(f"{folder} is not there")
    encoding = read_capture(folder, decode).encoding
    assert (encoding.known_by, encoding.colour_space, encoding.message()) == ("guess", "srgb", "")
