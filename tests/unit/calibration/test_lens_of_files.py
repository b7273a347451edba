"""The lens of photographs from their EXIF, against the angles of a full-frame camera's lenses."""

import math
from pathlib import Path

import pytest

from irpso_addon.calibration.photographs import lens_of_files, read_photographs, with_camera
from irpso_addon.capture.images import image
from irpso_addon.capture.images.exif import field_of_view
from irpso_addon.core.errors import InputError
from tests.builders.exif import exif, jpeg


def angle(width_mm, focal_mm):
    return math.degrees(2 * math.atan(width_mm / 2 / focal_mm))


def decoder(path):
    raise AssertionError("only headers are read")


@pytest.mark.parametrize(
    ("size", "focal", "expected"),
    [
        ((3600, 2400), 50, angle(36, 50)),
        ((2400, 3600), 50, angle(24, 50)),
        ((4000, 3000), 26, angle(0.8 * math.hypot(36, 24), 26)),  # 4 : 3, of the same diagonal
    ],
)
def test_the_angle_over_the_width(size, focal, expected):
    assert field_of_view(jpeg(*size, exif(focal_35mm=focal)), *size) == pytest.approx(expected)


def test_a_crop_and_a_file_without_a_lens_tell_nothing():
    assert field_of_view(jpeg(80, 60, exif()), 80, 60) is None
    whole = jpeg(80, 60, exif(focal_35mm=26, size=(4000, 3000)))
    assert field_of_view(whole, 80, 60) is not None
    assert field_of_view(whole, 60, 80) is not None  # turned
    assert field_of_view(whole, 80, 50) is None


def folder_of(path, *blocks):
    for number, block in enumerate(blocks):
        (path / f"{number}.jpg").write_bytes(jpeg(4000, 3000, block))
    return read_photographs(path)


def test_photographs_of_one_lens_tell_their_camera(tmp_path):
    spec = folder_of(tmp_path, *[exif(focal_35mm=26, orientation=8)] * 3)
    keys = lens_of_files(spec, decoder)
    portrait = angle(0.6 * math.hypot(36, 24), 26)
    assert keys == {"fov_degrees": pytest.approx(portrait, abs=1e-4)}
    assert lens_of_files(with_camera(spec, keys, "EXIF"), decoder) == {}


def test_only_the_beginning_of_a_jpeg_file_is_read(tmp_path, monkeypatch):
    def whole(path):
        raise AssertionError("the beginning is enough")

    spec = folder_of(tmp_path, *[exif(focal_35mm=26, orientation=8)] * 2)
    monkeypatch.setattr(Path, "read_bytes", whole)
    monkeypatch.setattr(image, "read_header", whole)
    assert lens_of_files(spec, decoder).keys() == {"fov_degrees"}


def test_a_jpeg_file_with_a_large_preview_before_its_size_tells_its_lens(tmp_path):
    preview = (b"\xff\xe2\x80\x00" + bytes(0x7FFE)) * 12  # twelve segments of 32 KiB
    spec = folder_of(tmp_path, *[exif(focal_35mm=26)] * 2)
    expected = lens_of_files(spec, decoder)
    for path in tmp_path.iterdir():
        data = path.read_bytes()
        path.write_bytes(data.replace(b"\xff\xc2", preview + b"\xff\xc2"))
    assert lens_of_files(spec, decoder) == expected != {}


def test_photographs_of_two_lenses_or_none_tell_nothing(tmp_path):
    assert lens_of_files(folder_of(tmp_path, exif(focal_35mm=26), exif(focal_35mm=52)), decoder) == {}
    assert lens_of_files(folder_of(tmp_path, exif(), exif()), decoder) == {}


@pytest.mark.parametrize(
    "other", [exif(focal_35mm=52), exif(focal_35mm=26, size=(2000, 2000))], ids=["zoomed", "cropped"]
)
def test_a_zoom_or_a_crop_between_the_first_and_the_last_photograph_is_noticed(other, tmp_path):
    blocks = [exif(focal_35mm=26)] * 2 + [other] + [exif(focal_35mm=26)] * 2
    assert lens_of_files(folder_of(tmp_path, *blocks), decoder) == {}


def test_a_retouched_photograph_without_a_lens_takes_that_of_the_others(tmp_path):
    blocks = [exif()] + [exif(focal_35mm=26)] * 2
    assert lens_of_files(folder_of(tmp_path, *blocks), decoder).keys() == {"fov_degrees"}


def test_photographs_that_were_all_cropped_tell_nothing(tmp_path):
    blocks = [exif(focal_35mm=26, size=(2000, 2000))] * 2
    assert lens_of_files(folder_of(tmp_path, *blocks), decoder) == {}


def test_a_photograph_that_has_gone_is_named(tmp_path):
    spec = folder_of(tmp_path, *[exif(focal_35mm=26)] * 3)
    (tmp_path / "1.jpg").unlink()
    with pytest.raises(InputError, match=r"1\.jpg: this image is not there"):
        lens_of_files(spec, decoder)


def test_a_capture_that_states_its_lens_keeps_it(tmp_path):
    (tmp_path / "camera.toml").write_text("fov_degrees = 30.0\n")
    assert lens_of_files(folder_of(tmp_path, exif(focal_35mm=26), exif(focal_35mm=26)), decoder) == {}


def test_four_photographs_without_a_lens_decide_for_all(tmp_path):
    blocks = [*[exif()] * 3, exif(focal_35mm=26)]
    assert lens_of_files(folder_of(tmp_path, *blocks), decoder).keys() == {"fov_degrees"}
    assert lens_of_files(folder_of(tmp_path, exif(), *blocks), decoder) == {}
