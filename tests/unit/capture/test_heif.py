"""HEIC photographs: written by pillow-heif's encoder, read upright, in all their bits, with their tags and colours."""

import sys

import numpy as np
import pytest

from irpso_addon.calibration.photographs import lens_of_files, read_photographs
from irpso_addon.calibration.radiometry.brackets import exif_amount
from irpso_addon.capture import CaptureError, read_capture
from irpso_addon.capture.images.exif import Exposure, exposure_of
from irpso_addon.capture.images.headers import read_header
from irpso_addon.capture.images.image import ImageRef, ImageStore
from irpso_addon.core.encode import linear_from_srgb
from tests.builders.captures import LIGHTS
from tests.builders.exif import exif
from tests.builders.heif import heic
from tests.builders.profiles import P3, icc

Y, X = np.mgrid[:1:48j, :1:64j]
SMOOTH = np.rint(np.stack([40 + 180 * X, 40 + 180 * Y, 120 + 0 * X], axis=-1)).astype(int)  # top row first
ERROR = 3 / 255  # of HEVC at its finest, with 4:4:4


@pytest.fixture(autouse=True)
def encoder():
    heif = pytest.importorskip("pillow_heif")
    if not heif.libheif_info()["encoders"]:
        pytest.skip("this libheif writes no HEIC")


def picture(path, data):
    path.write_bytes(data)
    return ImageStore().picture(ImageRef(path))


def test_a_heic_file_is_read_as_srgb_without_a_decoder_of_blenders(tmp_path):
    found = picture(tmp_path / "a.heic", heic(SMOOTH))
    assert found.bits == 8 and found.profile is None
    np.testing.assert_allclose(found.values[::-1], SMOOTH / 255, atol=ERROR)
    samples = ImageStore().samples(ImageRef(tmp_path / "a.heic"))
    np.testing.assert_array_equal(samples.rgba[..., :3], linear_from_srgb(found.values))
    assert ImageStore().encoding(ImageRef(tmp_path / "a.heic")) == ("srgb", "file")


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_turned_photograph_is_turned_once(orientation, tmp_path):
    # Its container (irot, imir) and its EXIF both tell the turn. The upright picture has these corners (TIFF 6.0).
    path = tmp_path / "a.heic"
    found = picture(path, heic(SMOOTH, exif=exif(orientation=orientation))).values[::-1]
    header, turned = read_header(path), orientation >= 5
    assert (header.width, header.height, header.orientation) == ((48, 64, 1) if turned else (64, 48, 1))
    assert ImageStore().size(ImageRef(path)) == (header.width, header.height) == found.shape[1::-1]
    rows, columns = {1: (1, 1), 2: (1, -1), 3: (-1, -1), 4: (-1, 1), 5: (1, 1), 6: (1, -1), 7: (-1, -1), 8: (-1, 1)}[
        orientation
    ]
    expected = (SMOOTH.swapaxes(0, 1) if turned else SMOOTH)[::rows, ::columns]
    np.testing.assert_allclose(found, expected / 255, atol=ERROR)


def test_libheif_turns_all_photographs_of_a_camera_that_stands_still_alike(tmp_path):
    for name, orientation in {"a.heic": 1, "b.heic": 3, "c.heic": 1}.items():
        (tmp_path / name).write_bytes(heic(SMOOTH, exif=exif(orientation=orientation)))
    (tmp_path / "filenames.txt").write_text("a.heic\nb.heic\nc.heic\n")
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0 1 1\n1 0 1\n")
    with pytest.raises(CaptureError, match=r"b\.heic: its EXIF orientation is 3 where .* have 1"):
        read_capture(tmp_path)


def test_10_bits_are_kept(tmp_path):
    codes = np.rint(np.stack([200 + 600 * X, 200 + 600 * Y, 500 + 0 * X], axis=-1)).astype(int)
    codes[:16, :16] = 1023
    found = picture(tmp_path / "a.heic", heic(codes, bits=10))
    assert found.bits == 10 and read_header(tmp_path / "a.heic").bits == 10
    np.testing.assert_allclose(found.values[::-1][20:], codes[20:] / 1023, atol=ERROR / 3)
    steps = np.unique(np.rint(found.values * 1023))
    np.testing.assert_allclose(found.values * 1023, np.rint(found.values * 1023), atol=1e-3)
    assert (steps % 4 != 0).any()
    samples = ImageStore().samples(ImageRef(tmp_path / "a.heic"))
    assert samples.clipped[::-1][2:12, 2:12].all() and not samples.clipped[::-1][20:].any()


def test_display_p3_of_a_phone_is_converted(tmp_path):
    grey = np.full((48, 64, 3), 128)
    red = np.broadcast_to([200, 60, 60], (48, 64, 3))
    (tmp_path / "grey.heic").write_bytes(heic(grey, icc=icc(P3)))
    (tmp_path / "red.heic").write_bytes(heic(red, icc=icc(P3)))
    store = ImageStore()
    np.testing.assert_allclose(
        store.samples(ImageRef(tmp_path / "grey.heic")).rgba[..., :3],
        linear_from_srgb(np.float64(128 / 255)),
        rtol=0.02,
    )
    matrix = [[1.2249, -0.2249, 0], [-0.0420, 1.0420, 0], [-0.0197, -0.0786, 1.0983]]  # Display P3 to Rec. 709
    expected = matrix @ linear_from_srgb(red[0, 0] / 255)
    found = store.samples(ImageRef(tmp_path / "red.heic")).rgba[..., :3].mean(axis=(0, 1))
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_exposure_and_lens_are_read(tmp_path):
    data = heic(SMOOTH, exif=exif((1, 60), (18, 10), 100, focal_35mm=26, size=(64, 48), orientation=6))
    assert exposure_of(data) == Exposure(1 / 60, 1.8, 100.0)
    for name in ("a.HEIC", "b.heic"):
        (tmp_path / name).write_bytes(data)
    assert exif_amount(tmp_path / "a.HEIC") == pytest.approx(1 / 60 / 1.8**2)
    spec = read_photographs(tmp_path)
    assert [shot.name for shot in spec.observations] == ["a.HEIC", "b.heic"]
    # Turned upright it is 48 wide: its half width over 26 mm of a diagonal of 43.27 mm.
    focal = 26 * 80 / np.hypot(36, 24)
    assert lens_of_files(spec) == {"fov_degrees": pytest.approx(2 * np.degrees(np.arctan(24 / focal)))}


def test_a_capture_of_heic_files_needs_no_other_decoder(tmp_path):
    for k in range(len(LIGHTS)):
        (tmp_path / f"{k}.heic").write_bytes(heic(SMOOTH))
    (tmp_path / "filenames.txt").write_text("".join(f"{k}.heic\n" for k in range(len(LIGHTS))))
    np.savetxt(tmp_path / "light_directions.txt", LIGHTS)
    capture = read_capture(tmp_path)
    assert capture.observations[0].read().shape == (48, 64, 4) and capture.observations[0].coarse


def test_without_pillow_heif_a_heic_file_is_refused_with_the_remedy(tmp_path, monkeypatch):
    (tmp_path / "a.heic").write_bytes(heic(SMOOTH))
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(
        CaptureError, match=r"a\.heic: HEIC needs pillow-heif; run '.* -m pip install pillow-heif'"
    ) as e:
        ImageStore().size(ImageRef(tmp_path / "a.heic"))
    assert e.value.code == "no_decoder"


def test_a_cut_heic_file_is_refused_by_name(tmp_path):
    whole = heic(SMOOTH)
    for length in (16, 100, len(whole) // 2, len(whole) - 5):
        (tmp_path / "a.heic").write_bytes(whole[:length])
        with pytest.raises(CaptureError, match=r"a\.heic: .*copy or export it again"):
            picture(tmp_path / "a.heic", whole[:length])


def test_an_hdr_photograph_is_refused(tmp_path):
    (tmp_path / "a.heic").write_bytes(heic(SMOOTH, transfer=18))
    with pytest.raises(CaptureError, match=r"a\.heic: it is an HDR picture \(PQ or HLG\)"):
        ImageStore().samples(ImageRef(tmp_path / "a.heic"))
