"""Exposure tags, and raw files of cameras: with rawpy itself, with a stand-in, and without it."""

import sys
import types

import numpy as np
import pytest

from irpso_addon.capture import CaptureError, read_capture
from irpso_addon.capture.bounds import weight_and_clipped
from irpso_addon.capture.images.exif import Exposure, exposure_of
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.capture.images.raw import decode_raw, is_raw, raw_header
from tests.builders.captures import LIGHTS, chunk, write_png
from tests.builders.exif import XYZ_TO_REC709, bayer, dng, exif, jpeg

Y, X = np.mgrid[:40, :60]
SCENE = np.stack([0.2 + 0.5 * X / 60, 0.3 + 0.3 * Y / 40, 0.4 + 0 * X], axis=-1)  # top row first


@pytest.mark.parametrize("order", "<>")
def test_the_exposure_is_read_from_hand_made_bytes(order, tmp_path):
    block = exif((1, 60), (56, 10), 200, order)
    expected = Exposure(1 / 60, 5.6, 200.0)
    assert exposure_of(jpeg(2, 2, block)) == expected
    assert exposure_of(block) == expected  # as a TIFF file has it
    write_png(tmp_path / "a.png", np.zeros((2, 2, 3), int), extra=chunk(b"eXIf", block))
    assert exposure_of((tmp_path / "a.png").read_bytes()) == expected
    assert expected.amount == pytest.approx(1 / 60 * 2 / 5.6**2)


def test_an_exposure_without_aperture_and_iso_uses_its_time_only():
    assert exposure_of(exif((2, 1))).amount == 2.0


@pytest.mark.parametrize("block", [exif(), exif((1, 0)), exif((0, 1)), exif((1, 60))[:30], b"", b"\xff\xd8\xff\xe1\0"])
def test_damaged_or_missing_exposures_are_none(block):
    assert exposure_of(block) is None
    assert exposure_of(jpeg(2, 2, block)) is None


def test_without_rawpy_a_raw_file_is_refused_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    path = tmp_path / "a.NEF"
    path.write_bytes(dng(np.zeros((4, 4), int)))
    assert is_raw(path)
    for read in (raw_header, decode_raw):
        with pytest.raises(
            CaptureError, match=r"a\.NEF: .*raw file, which needs rawpy: .*-m pip install rawpy"
        ) as error:
            read(path)
        assert error.value.code == "no_decoder"


class _File:
    """What rawpy gives of a 3 × 2 photograph whose camera was turned: flip 6 is a quarter turn clockwise."""

    sizes = types.SimpleNamespace(iwidth=12, iheight=8, flip=6)
    camera_white_level_per_channel = None
    white_level, black_level_per_channel = 1000, [100] * 4
    raw_image_visible = np.full((8, 12), 300)
    camera_whitebalance = [1.0, 1.0, 1.0, 0.0]

    def __enter__(self):
        return self

    def __exit__(self, *what):
        pass

    def postprocess(self, **how):
        self.how.update(how)
        return np.full((12, 8, 3), 13107, np.uint16)


@pytest.fixture
def rawpy_stub(monkeypatch):
    _File.how = {}
    module = types.ModuleType("rawpy")
    module.imread = lambda path: _File()
    module.LibRawError = type("LibRawError", (Exception,), {})
    module.ColorSpace = types.SimpleNamespace(sRGB="Rec. 709")
    module.HighlightMode = types.SimpleNamespace(Clip="clip", Ignore="ignore")
    monkeypatch.setitem(sys.modules, "rawpy", module)
    return module


def test_a_raw_file_is_developed_without_curve_or_brightening(tmp_path, rawpy_stub):
    (tmp_path / "a.dng").write_bytes(b"raw")
    picture = decode_raw(tmp_path / "a.dng")
    assert (picture.values.shape, picture.bits) == ((12, 8, 4), 16)
    np.testing.assert_allclose(picture.values[..., :3], 0.2)
    assert raw_header(tmp_path / "a.dng") == (8, 12, 6)
    how = _File.how
    assert how["gamma"] == (1, 1) and how["no_auto_bright"] and how["adjust_maximum_thr"] == 0
    assert (how["output_bps"], how["output_color"], how["use_camera_wb"]) == (16, "Rec. 709", True)
    decode_raw(tmp_path / "a.dng", camera_white=False)
    assert _File.how["user_wb"] == [1, 1, 1, 1]


def test_a_saturated_photosite_has_weight_0_at_its_upright_position(tmp_path, rawpy_stub, monkeypatch):
    (tmp_path / "a.dng").write_bytes(b"raw")
    sensor = np.full((8, 12), 300)
    sensor[1, 2] = 1000
    monkeypatch.setattr(_File, "raw_image_visible", sensor)
    weight = decode_raw(tmp_path / "a.dng").values[::-1, :, 3]
    # Turned clockwise, row 1 of 8 becomes column 6, column 2 becomes row 2; demosaicing spreads it by 2 pixels.
    expected = np.ones((12, 8))
    expected[0:5, 4:8] = 0
    np.testing.assert_array_equal(weight, expected)


def test_a_capture_of_raw_files_needs_no_other_decoder(tmp_path, rawpy_stub):
    for k in range(len(LIGHTS)):
        (tmp_path / f"{k}.dng").write_bytes(b"raw")
    (tmp_path / "filenames.txt").write_text("".join(f"{k}.dng\n" for k in range(len(LIGHTS))))
    np.savetxt(tmp_path / "light_directions.txt", LIGHTS)
    capture = read_capture(tmp_path)
    np.testing.assert_allclose(capture.observations[0].read(), [0.2, 0.2, 0.2, 1] * np.ones((12, 8, 4)))


# What follows runs where rawpy is installed: LibRaw itself reads files that were written byte by byte.


def test_libraw_recovers_the_mosaics_source(tmp_path):
    pytest.importorskip("rawpy", reason="the extra rawpy is not installed")
    path, neutral = tmp_path / "a.dng", np.array([0.5, 1.0, 0.7])
    for scale in (0.5, 0.85, 1.3):  # LibRaw's own guess of white would change from one to the next
        codes = np.rint(1024 + bayer(scale * SCENE * neutral) * (15000 - 1024)).astype(int)
        path.write_bytes(dng(codes, 1024, 15000, neutral, seconds=(1, 30)))
        found = decode_raw(path)
        np.testing.assert_allclose(found.values[::-1][4:-4, 4:-4, :3], scale * SCENE[4:-4, 4:-4], atol=2e-3)
        assert (found.values[..., 3] == 1).all()
    assert exposure_of(path.read_bytes()).seconds == pytest.approx(1 / 30)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_libraw_turns_pictures_and_clipped_places_alike(tmp_path, orientation):
    pytest.importorskip("rawpy", reason="the extra rawpy is not installed")
    scene = SCENE.copy()
    scene[5:8, 40:44] = 2
    path = tmp_path / "a.dng"
    path.write_bytes(dng(np.rint(np.minimum(bayer(scene), 1) * 60000).astype(int), 0, 60000, orientation=orientation))
    found = decode_raw(path).values
    size = (60, 40) if orientation < 5 else (40, 60)
    assert raw_header(path) == (found.shape[1], found.shape[0], orientation) == (*size, orientation)
    bright, bad = (found[..., :3] > 0.99).all(axis=-1), found[..., 3] == 0
    assert bright.any() and not (bright & ~bad).any() and bad.sum() == (3 + 4) * (4 + 4)


# Rec. 709 to a camera whose filters overlap, before its white balance.
MIXED = np.array([[0.62, 0.30, 0.08], [0.20, 0.68, 0.12], [0.06, 0.30, 0.64]])


@pytest.mark.parametrize("mosaic", [True, False])
@pytest.mark.parametrize(
    "radiance", [(0.4, 0.4, 0.4), (1.2, 0.1, 0.05), (1.9, 0.3, 0.1), (0.1, 0.2, 1.4), (0.9, 1.0, 0.9)]
)
def test_libraws_white_balance_clips_no_unsaturated_colour(tmp_path, radiance, mosaic):
    pytest.importorskip("rawpy", reason="the extra rawpy is not installed")
    neutral = np.array([0.5, 1.0, 0.6])  # multipliers of 2, 1 and 1.67
    photosites = neutral * (MIXED @ radiance)
    assert photosites.max() < 0.98
    rgb = np.ones((32, 32, 3)) * photosites
    codes = np.rint((bayer(rgb) if mosaic else rgb) * 65535).astype(int)
    path, matrix = tmp_path / "a.dng", np.diag(neutral) @ MIXED @ XYZ_TO_REC709
    path.write_bytes(dng(codes, neutral=neutral, matrix=matrix))
    samples = ImageStore().samples(ImageRef(path))
    np.testing.assert_allclose(samples.bounds[8:-8, 8:-8], np.broadcast_to((*radiance, 1), (16, 16, 4)), atol=2e-3)


def test_libraw_marks_a_colour_beyond_its_range_as_a_lower_bound(tmp_path):
    """Of a strong red the sensor still has room, but not LibRaw's 16 bits after the matrix."""
    pytest.importorskip("rawpy", reason="the extra rawpy is not installed")
    neutral, radiance = np.array([0.5, 1.0, 0.6]), (2.4, 0.3, 0.1)
    codes = np.rint(bayer(np.ones((32, 32, 3)) * neutral * (MIXED @ radiance)) * 65535).astype(int)
    path = tmp_path / "a.dng"
    path.write_bytes(dng(codes, neutral=neutral, matrix=np.diag(neutral) @ MIXED @ XYZ_TO_REC709))
    samples = ImageStore().samples(ImageRef(path))
    weight, clipped = weight_and_clipped(samples.bounds[8:-8, 8:-8, 3])
    assert (weight == 1).all() and (clipped == (True, False, False)).all()
    np.testing.assert_allclose(samples.bounds[8:-8, 8:-8, :3] - (2, 0.3, 0.1), 0, atol=2e-3)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_libraw_reads_linear_files_whose_clipped_pixels_do_not_spread(tmp_path, orientation):
    """As ProRAW and demosaiced DNG files are; rows and columns go where the tag's definition in EXIF 2.3 says."""
    pytest.importorskip("rawpy", reason="the extra rawpy is not installed")
    scene = 0.8 * SCENE
    scene[5:8, 40:44, 1] = 1
    path = tmp_path / "a.dng"
    path.write_bytes(dng(np.rint(scene * 60000).astype(int), 0, 60000, orientation=orientation))
    turn = {1: lambda v: v, 3: lambda v: v[::-1, ::-1], 6: lambda v: np.rot90(v, -1), 8: np.rot90}[orientation]
    found = decode_raw(path).values[::-1]
    weighted = turn(scene[..., 1] < 1)
    np.testing.assert_array_equal(found[..., 3], weighted)
    np.testing.assert_allclose(found[weighted][:, :3], turn(scene)[weighted], atol=1e-3)


def test_libraw_refuses_a_cut_file_by_name(tmp_path):
    pytest.importorskip("rawpy", reason="the extra rawpy is not installed")
    (tmp_path / "a.dng").write_bytes(dng(np.zeros((40, 60), int))[:300])
    with pytest.raises(CaptureError, match=r"a\.dng: LibRaw cannot read it"):
        decode_raw(tmp_path / "a.dng")


def test_libraw_turns_all_raw_files_of_a_camera_that_stands_still_alike(tmp_path):
    pytest.importorskip("rawpy", reason="rawpy is not installed")
    mosaic = np.rint(bayer(SCENE) * 60000).astype(int)
    for name, orientation in {"a.dng": 1, "b.dng": 3, "c.dng": 1}.items():
        (tmp_path / name).write_bytes(dng(mosaic, 0, 60000, orientation=orientation))
    (tmp_path / "filenames.txt").write_text("a.dng\nb.dng\nc.dng\n")
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0 1 1\n1 0 1\n")
    with pytest.raises(CaptureError, match=r"b\.dng: its EXIF orientation is 3 where .* have 1"):
        read_capture(tmp_path)
