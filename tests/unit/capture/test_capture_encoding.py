"""Linear or sRGB: what the fall-off of light in 8-bit images tells, what files state, and what is read and said."""

import struct

import numpy as np
import pytest

from irpso_addon.capture import Picture, read_capture
from irpso_addon.capture.errors import CaptureError
from irpso_addon.capture.images.headers import read_header
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.capture.inspect.falloff import encoding_test
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.core.encode import linear_from_srgb
from tests.builders.captures import chunk, decode_png, sphere, write_png
from tests.builders.command_line import dome_lights
from tests.builders.exif import jpeg as jpeg_of
from tests.builders.exif import tiff
from tests.oracles import reflectance as oracles

VIEW = np.array([0.0, 0.0, 1.0])
# Model and parameters of the oracles' surfaces; the matt ones have to be told right.
MATT = {
    "white": ("lambert", {"base_color": (0.8, 0.8, 0.8)}),
    "red": ("lambert", {"base_color": (0.6, 0.2, 0.1)}),
    "clay": ("principled", {"base_color": (0.6, 0.4, 0.2), "roughness": 0.8, "specular": 0.5}),
    "glazed": ("principled", {"base_color": (0.7, 0.7, 0.6), "roughness": 0.15, "specular": 0.5}),
    "plastic": ("principled", {"base_color": (0.1, 0.3, 0.6), "roughness": 0.5, "specular": 0.5}),
}
OTHERS = {
    "black": ("principled", {"base_color": (0.02, 0.02, 0.02), "roughness": 0.5, "specular": 0.5}),
    **{
        f"metal {roughness}": (
            "principled_metallic",
            {"base_color": (0.7, 0.6, 0.5), "roughness": roughness, "specular": 0.5, "metallic": 1.0},
        )
        for roughness in (0.3, 0.5, 0.55, 0.65)
    },
}
WIDE, NARROW = dome_lights(24, 65), dome_lights(12, 22)
OBLIQUE = oracles.unit(NARROW + (0.5, 0.3, 0.0))


def photographed(surface, lights, normals, seed=0):
    """Return (K, H, W, 3) linear images 0…1 of a surface, exposed to the 99th percentile, with a sensor's noise."""
    model, values = surface
    maps = {
        "normal": normals,
        **{name: np.broadcast_to(v, (*normals.shape[:2], *np.shape(v))) for name, v in values.items()},
    }
    images = np.stack([oracles.MODELS[model](maps, light, VIEW) for light in lights])
    images *= 0.9 / np.percentile(images[:, normals[..., 2] > 0], 99)
    noise = np.random.default_rng(seed).normal(size=images.shape)
    return np.clip(images + 0.004 * np.sqrt(np.maximum(images, 0) + 0.02) * noise, 0, 1)


def encoded(images, encoding):
    """Return 8-bit codes."""
    if encoding == "srgb":
        images = np.where(images <= 0.0031308, 12.92 * images, 1.055 * images ** (1 / 2.4) - 0.055)
    return np.rint(255 * images).astype(int)


def decided(surface, encoding, lights, normals, mask):
    codes = encoded(photographed(surface, lights, normals), encoding)[:, mask] / 255
    return encoding_test(codes, (codes < 1).all(axis=-1), lights, np.ones(len(lights))).sure


def write_capture_of(folder, codes, lights, mask, bits=8, extra=b""):
    """Write codes (K, H, W, 3), row 0 at the bottom, as PNG files in the DiLiGenT layout; return the folder."""
    folder.mkdir()
    names = [f"{k:03d}.png" for k in range(len(codes))]
    for name, frame in zip(names, codes, strict=True):
        write_png(folder / name, frame[::-1], bits, extra)
    (folder / "filenames.txt").write_text("\n".join(names))
    np.savetxt(folder / "light_directions.txt", lights)
    write_png(folder / "mask.png", 255 * mask[::-1, :, None])
    return folder


@pytest.fixture(scope="module")
def ball():
    return sphere(24)


@pytest.mark.parametrize("lights", [WIDE, NARROW, OBLIQUE], ids=["24 wide", "12 narrow", "12 oblique"])
@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_the_fall_off_decides_dielectrics_right_and_metals_never_wrong(ball, encoding, lights):
    found = {name: decided(surface, encoding, lights, *ball) for name, surface in {**MATT, **OTHERS}.items()}
    assert {name: found[name] for name in MATT} == dict.fromkeys(MATT, encoding)
    assert not [name for name, answer in found.items() if answer not in ("", encoding)], found


@pytest.mark.parametrize("power", [0.9, 1.0, 1.2, 1.4])
def test_srgb_files_under_lamps_that_are_weaker_the_lower_they_stand_are_not_read_as_linear(ball, power):
    """(n·l) l_z goes with the square of the cosine at a sphere's middle, as linear values do that are decoded."""
    normals, mask = ball
    wide = dome_lights(12, 60)
    for surface in (MATT["white"], MATT["clay"]):
        images = photographed(surface, wide, normals) * wide[:, 2, None, None, None] ** power
        codes = encoded(images / images.max(), "srgb")[:, mask] / 255
        test = encoding_test(codes, (codes < 1).all(axis=-1), wide, np.ones(12))
        assert test.sure != "linear"
        stated = encoding_test(codes, (codes < 1).all(axis=-1), wide, wide[:, 2] ** power)
        assert stated.sure != "linear"


def test_a_subject_that_faces_one_way_decides_nothing(ball):
    normals = oracles.unit(ball[0] * (0.15, 0.15, 0) + (0, 0, 1.0))
    for surface in (MATT["white"], OTHERS["metal 0.65"]):
        assert decided(surface, "linear", NARROW, normals, ball[1]) == ""
        assert decided(surface, "srgb", NARROW, normals, ball[1]) == ""


def test_unlabelled_linear_8_bit_files_are_read_as_linear_with_a_finding(tmp_path, ball):
    normals, mask = ball
    codes = encoded(photographed(MATT["clay"], NARROW, normals), "linear")
    folder = write_capture_of(tmp_path / "ball", codes, NARROW, mask)
    capture = read_capture(folder, decode_png)
    np.testing.assert_array_equal(
        capture.observations[5].read(), read_capture(folder, decode_png, "linear").observations[5].read()
    )
    report = inspect_capture(folder, decode_png)
    (finding,) = (f for f in report.findings if f.code == "encoding")
    assert finding.severity == "warning"
    assert "are read as linear values" in finding.message and "--colour-space srgb" in finding.message
    assert dict(report.facts)["encoding"].startswith("read as linear (not stated); fall-off 1.")


@pytest.mark.parametrize("name", ["clay", "metal 0.55", "black"])
def test_unlabelled_srgb_files_stay_srgb(tmp_path, ball, name):
    normals, mask = ball
    surface = {**MATT, **OTHERS}[name]
    codes = encoded(photographed(surface, WIDE, normals), "srgb")
    folder = write_capture_of(tmp_path / "ball", codes, WIDE, mask)
    expected = linear_from_srgb((codes[3] / 255).astype(np.float32))
    np.testing.assert_array_equal(read_capture(folder, decode_png).observations[3].read()[..., :3], expected)
    assert "encoding" not in inspect_capture(folder, decode_png).codes


@pytest.mark.parametrize(
    ("values", "bits", "extra", "asked", "read_as", "said"),
    [
        ("linear", 8, chunk(b"sRGB", b"\0"), "auto", "srgb", "are read as sRGB values and hold linear values"),
        ("linear", 8, chunk(b"gAMA", struct.pack(">I", 45455)), "auto", "srgb", "--colour-space linear"),
        ("linear", 8, chunk(b"gAMA", struct.pack(">I", 100000)), "auto", "linear", ""),
        ("srgb", 16, b"", "auto", "linear", "--colour-space srgb"),
        ("srgb", 16, chunk(b"sRGB", b"\0"), "auto", "srgb", ""),
        ("srgb", 16, chunk(b"gAMA", struct.pack(">I", 45455)), "auto", "srgb", ""),
        ("linear", 16, chunk(b"sRGB", b"\0"), "auto", "srgb", "--colour-space linear"),
        ("linear", 16, chunk(b"gAMA", struct.pack(">I", 100000)), "auto", "linear", ""),
        ("linear", 8, b"", "srgb", "srgb", ""),
    ],
    ids=[
        "sRGB chunk",
        "gAMA of sRGB",
        "gAMA of linear",
        "16 bits",
        "16 sRGB chunk",
        "16 gAMA of sRGB",
        "16 linear in spite of its sRGB chunk",
        "16 gAMA of linear",
        "asked for",
    ],
)
def test_a_stated_encoding_is_used_and_a_contradiction_is_a_warning(
    tmp_path, ball, values, bits, extra, asked, read_as, said
):
    normals, mask = ball
    codes = encoded(photographed(MATT["white"], NARROW, normals), values) * (257 if bits == 16 else 1)
    folder = write_capture_of(tmp_path / "ball", codes, NARROW, mask, bits, extra)
    expected = (codes[2] / (2**bits - 1)).astype(np.float32)
    expected = linear_from_srgb(expected) if read_as == "srgb" else expected
    np.testing.assert_array_equal(read_capture(folder, decode_png, asked).observations[2].read()[..., :3], expected)
    messages = [f.message for f in inspect_capture(folder, decode_png, asked).findings if f.code == "encoding"]
    assert len(messages) == bool(said) and all(said in text for text in messages)


def test_the_header_of_every_image_is_read_once(tmp_path, ball, monkeypatch):
    normals, mask = ball
    codes = encoded(photographed(MATT["clay"], NARROW, normals), "linear")
    folder = write_capture_of(tmp_path / "ball", codes, NARROW, mask)
    read = []
    monkeypatch.setattr(
        "irpso_addon.capture.images.image.read_header", lambda path: read.append(path) or read_header(path)
    )
    read_capture(folder, decode_png)
    photographs = [path for path in read if path.name != "mask.png"]
    assert len(photographs) == len(set(photographs)) == len(NARROW)


def test_an_image_that_cannot_be_read_is_reported_once(tmp_path, ball):
    normals, mask = ball
    codes = encoded(photographed(MATT["white"], NARROW, normals), "linear")
    folder = write_capture_of(tmp_path / "ball", codes, NARROW, mask)
    write_png(folder / "004.png", np.zeros((24, 24, 3), int))
    whole = (folder / "004.png").read_bytes()
    (folder / "004.png").write_bytes(whole.replace(b"IDAT", b"IDAX"))

    def decode(path):
        if path.name == "004.png":
            from irpso_addon.core.errors import InputError

            raise InputError(f"{path}: damaged")
        return decode_png(path)

    report = inspect_capture(folder, decode)
    assert [f.message for f in report.findings if f.severity == "error"] == [f"{folder / '004.png'}: damaged"]
    assert "read as linear" in dict(report.facts)["encoding"]


def jpeg(blocks):
    size = b"\xff\xc0" + struct.pack(">HBHHB", 8, 8, 30, 40, 1) + b"\0"
    return b"\xff\xd8" + blocks + size + b"\xff\xd9" + bytes(8)


def test_a_video_may_follow_a_jpeg_and_a_thumbnail_is_not_its_end(tmp_path):
    whole = jpeg_of(40, 30, b"thumbnail \xff\xd9")
    (tmp_path / "motion.jpg").write_bytes(whole + bytes(300_000))
    assert read_header(tmp_path / "motion.jpg").width == 40
    (tmp_path / "filled.jpg").write_bytes(whole[:2] + b"\xff\xff" + whole[2:])
    assert read_header(tmp_path / "filled.jpg").width == 40
    (tmp_path / "cut.jpg").write_bytes(whole[:-2])
    with pytest.raises(CaptureError, match="cut short"):
        read_header(tmp_path / "cut.jpg")


def block_of(space):
    """An EXIF block whose directory has ColorSpace."""
    inner = struct.pack("<HHHII", 1, 40961, 3, 1, space) + bytes(4)
    outer = struct.pack("<HHHII", 1, 34665, 4, 1, 26) + bytes(4)
    return b"II*\0" + struct.pack("<I", 8) + outer + inner


def exif_of(space):
    body = b"Exif\0\0" + block_of(space)
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body


@pytest.mark.parametrize(
    ("data", "states"),
    [
        (jpeg(b""), ""),
        (jpeg(exif_of(1)), "srgb"),
        (jpeg(exif_of(65535)), ""),
        (jpeg(b"\xff\xe2" + struct.pack(">H", 30) + b"ICC_PROFILE\0\1\1" + bytes(14)), "srgb"),
    ],
    ids=["nothing", "EXIF sRGB", "EXIF uncalibrated", "profile"],
)
def test_a_jpeg_states_its_encoding_by_exif_or_a_profile(tmp_path, data, states):
    (tmp_path / "a.jpg").write_bytes(data)
    assert read_header(tmp_path / "a.jpg").states == states


def png_of(dtype, *chunks):
    def write(path):
        bits = 8 * np.dtype(dtype).itemsize
        write_png(path, np.full((2, 3, 3), 2 ** (bits - 1)), bits, b"".join(chunk(*one) for one in chunks))

    return write


def tiff_of(dtype, space=None, tags=()):
    bits = 8 * np.dtype(dtype).itemsize
    codes = np.full((2, 3, 3), 2 ** (bits - 1), dtype)
    return lambda path: path.write_bytes(tiff(codes, tags, space))


SRGB_EXIF, UNCALIBRATED_EXIF = (b"eXIf", block_of(1)), (b"eXIf", block_of(65535))


@pytest.mark.parametrize(
    ("write", "expected"),
    [
        (tiff_of("u2", 1), ("srgb", "file")),
        (tiff_of("u1", 1), ("srgb", "file")),
        (png_of("u2", SRGB_EXIF), ("srgb", "file")),
        (png_of("u1", SRGB_EXIF), ("srgb", "file")),
        (png_of("u2", (b"gAMA", struct.pack(">I", 100000)), SRGB_EXIF), ("linear", "file")),
        (tiff_of("f4", 1, [(339, 3, [3, 3, 3])]), ("linear", "format")),
        (tiff_of("u2", 65535), ("linear", "depth")),
        (tiff_of("u1", 65535), ("srgb", "guess")),
        (png_of("u2", UNCALIBRATED_EXIF), ("linear", "depth")),
        (tiff_of("u2"), ("linear", "depth")),
    ],
    ids=[
        "TIFF 16", "TIFF 8", "PNG 16", "PNG 8", "a chunk overrides EXIF", "floats", "TIFF 16 uncalibrated",
        "TIFF 8 uncalibrated", "PNG 16 uncalibrated", "TIFF 16 without EXIF",
    ],
)  # fmt: skip
def test_png_and_tiff_state_their_encoding_by_exif_too(tmp_path, write, expected):
    path = tmp_path / "image"
    write(path)
    image, bits = ImageRef(path), read_header(path).bits
    store = ImageStore(lambda path: Picture(np.full((2, 3, 3), np.float32(0.5)), bits))
    assert store.encoding(image) == expected
    # IEC 61966-2-1: code 0.5 is 0.21404114 of linear light.
    np.testing.assert_allclose(store.samples(image).rgba[..., :3], 0.21404 if expected[0] == "srgb" else 0.5, rtol=0.01)
