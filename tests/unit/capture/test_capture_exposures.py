"""Photographs of one capture that differ in exposure, by EXIF."""

import numpy as np
import pytest

from irpso_addon.capture import read_capture
from irpso_addon.capture.images import headers, image
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.pipeline.result import capture_warnings
from tests.builders.captures import LIGHTS, chunk, decode_png, write_png
from tests.builders.exif import dng, exif

ALIKE = [(1, 60)] * len(LIGHTS)
UNLIKE = [(1, 60), (1, 60), (1, 30), (1, 60), (1, 60)]


def photographed(folder, exposures, intensities=None, cameras=None, iso=None):
    """Write a capture of photographs with these exposure times, None for no EXIF. Returns the folder."""
    rng = np.random.default_rng(0)
    text = "".join(f'[[camera]]\nname = "{name}"\n' for name in sorted(set(cameras or ["a"])))
    for k, seconds in enumerate(exposures):
        extra = chunk(b"eXIf", exif(seconds, (28, 10), iso[k] if iso else 100)) if seconds else b""
        write_png(folder / f"{k}.png", rng.integers(20, 200, (6, 8, 3)), 8, extra)
        text += f'[[observation]]\nimage = "{k}.png"\nlight_direction = {LIGHTS[k].tolist()}\n'
        text += f"light_intensity = {intensities[k]}\n" if intensities else ""
        text += f'camera = "{cameras[k]}"\n' if cameras else ""
    (folder / "capture.toml").write_text(text)
    return folder


def test_another_exposure_is_a_finding_of_the_check_and_a_warning_of_the_report(tmp_path):
    folder = photographed(tmp_path, UNLIKE)
    (message,) = [f.message for f in inspect_capture(folder, decode_png).findings if f.code == "exposure"]
    assert message.startswith(f"{folder / '2.png'}: its exposure by EXIF is 1.0 stops above the median (1 of 5 ")
    capture = read_capture(folder, decode_png)
    assert message in capture_warnings(capture, reads=False)
    assert message not in capture_warnings(capture, reads=False, exposures=False)  # estimated intensities


@pytest.mark.parametrize(
    "case",
    [
        {"exposures": ALIKE},
        {"exposures": [None] * 5},
        {"exposures": [(10, 600), (10, 610), (10, 600), (10, 590), None]},
        {"exposures": UNLIKE, "intensities": [1, 1, 2, 1, 1]},
        {"exposures": UNLIKE, "iso": [100, 100, 50, 100, 100]},
        {"exposures": ALIKE, "iso": [400, 400, None, 400, 400]},
        {"exposures": UNLIKE, "cameras": ["a", "a", "b", "a", "a"]},
    ],
    ids=[
        "alike",
        "no EXIF",
        "within a sixth of a stop",
        "stated intensities",
        "other ISO",
        "one without ISO",
        "another camera",
    ],
)
def test_equal_and_accounted_exposures_are_no_warning(tmp_path, case):
    assert read_capture(photographed(tmp_path, **case), decode_png).warnings == ()


def test_the_exposure_comes_with_the_header_in_one_reading(tmp_path, monkeypatch):
    folder, read = photographed(tmp_path, UNLIKE), []
    original = headers.read_bytes
    monkeypatch.setattr(headers, "read_bytes", lambda path: read.append(path.name) or original(path))
    read_capture(folder, decode_png)
    assert sorted(read) == [f"{k}.png" for k in range(5)]


def test_raw_files_have_an_exposure_too(tmp_path):
    (tmp_path / "a.dng").write_bytes(dng(np.full((8, 8), 900, np.uint16), seconds=(1, 8)))
    assert image.ImageStore().exposure(image.ImageRef(tmp_path / "a.dng")).seconds == pytest.approx(1 / 8)
