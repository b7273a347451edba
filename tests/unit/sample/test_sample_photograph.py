"""Photographs as a phone writes them."""

import io

import numpy as np
import pytest

from irpso_addon.capture.images.exif import exposure_of
from irpso_addon.sample.photograph import MAKE, MODEL, developed, write_photograph

PIL = pytest.importorskip("PIL.Image")


def smooth(height=48, width=64):
    y, x = np.mgrid[:height, :width] / height
    return np.stack([0.05 + 0.5 * y, 0.2 + 0.2 * x, 0.6 - 0.3 * y], axis=-1)


def test_the_file_has_the_radiance_in_srgb_with_the_first_row_at_the_top(tmp_path):
    write_photograph(tmp_path / "a.jpg", developed(smooth(), 1), 52)
    codes = np.asarray(PIL.open(tmp_path / "a.jpg"), np.float64)[::-1] / 255
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    assert np.abs(linear - smooth()).mean() < 0.01


def test_exif_says_focal_length_orientation_and_that_no_camera_took_it(tmp_path):
    write_photograph(tmp_path / "a.jpg", developed(smooth(), 1), 52)
    exif = PIL.open(tmp_path / "a.jpg").getexif()
    assert (exif[271], exif[272], exif[274]) == (MAKE, MODEL, 1) and "rendered" in MODEL
    inner = exif.get_ifd(34665)
    assert (inner[41989], inner[40961], inner[40962], inner[40963]) == (52, 1, 64, 48)
    exposure = exposure_of((tmp_path / "a.jpg").read_bytes())
    assert exposure.seconds == pytest.approx(1 / 60) and exposure.iso == 64 and exposure.f_number == pytest.approx(2.8)


def test_noise_follows_the_seed_and_highlights_are_clipped():
    bright = smooth()
    bright[0, 0], bright[0, 1] = np.inf, 40.0
    first, again, other = (developed(bright, seed) for seed in (1, 1, 2))
    assert (first == again).all() and (first != other).mean() > 0.3
    assert (first[-1, :2] == 255).all()


def test_the_same_codes_give_the_same_bytes(tmp_path):
    for name in ("a.jpg", "b.jpg"):
        write_photograph(tmp_path / name, developed(smooth(), 1), 52)
    assert (tmp_path / "a.jpg").read_bytes() == (tmp_path / "b.jpg").read_bytes()
    assert PIL.open(io.BytesIO((tmp_path / "a.jpg").read_bytes())).format == "JPEG"
