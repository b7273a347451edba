"""Bursts of one light, averaged by develop, against the light that they show."""

import json

import numpy as np
import pytest

from irpso_addon.capture import read_exr
from irpso_addon.commands import develop
from irpso_addon.core.encode import srgb_from_linear
from tests.builders.captures import chunk, decode_png, write_png
from tests.builders.command_line import run_cli
from tests.builders.exif import exif
from tests.builders.video import direction, lit, scene

NORMALS, ALBEDO = scene(64, 96)
LIGHTS = [direction(0.8 * k, 0.9) for k in range(3)]
COUNT, NOISE = 4, 0.01  # photographs of a burst; deviation of linear light


@pytest.fixture(autouse=True)
def reader(monkeypatch):
    monkeypatch.setattr(develop, "decode", decode_png)


def photographed(folder, times=True, change=lambda light, n, k: light):
    """Write a burst of each light, whose photographs are a tenth of a second apart, and the bursts 4 s."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    for n, towards in enumerate(LIGHTS):
        for k in range(COUNT):
            light = change(lit(NORMALS, ALBEDO, towards), n, k)
            light = np.clip(light + NOISE * rng.standard_normal(light.shape), 0, 1)
            taken = exif((1, 60), time=f"2026:05:01 12:00:{4 * n:02d}.{k}" if times else None)
            codes = np.rint(255 * srgb_from_linear(light)).astype(int)
            write_png(folder / f"IMG_{COUNT * n + k:03d}.png", codes, 8, chunk(b"eXIf", taken))
    return folder


def developed(folder, by, *options):
    code, out, err = run_cli("develop", folder, "-o", folder.parent / "out", "--bursts", by, "--json", *options)
    return code, json.loads(out) if code == 0 else None, err


def image(path):
    channels = read_exr(path)[""]
    return np.stack([channels[c] for c in "RGB"], axis=-1)[::-1], channels.get("A", np.ones(1))[::-1]


@pytest.mark.parametrize("by", ["exif", "pictures"])
def test_the_photographs_of_each_light_are_averaged(by, tmp_path):
    folder = photographed(tmp_path / "photos", times=by == "exif")
    code, said, err = developed(folder, by)
    assert (code, err) == (0, "") and said["images"] == len(LIGHTS)
    for n, towards in enumerate(LIGHTS):
        off = image(tmp_path / "out" / f"IMG_{COUNT * n:03d}.exr")[0] - lit(NORMALS, ALBEDO, towards)
        assert abs(off[ALBEDO > 0.3].std() - NOISE / np.sqrt(COUNT)) < 0.15 * NOISE  # of one photograph: NOISE
        assert abs(off.mean()) < 0.002


def test_a_pixel_that_clips_in_one_photograph_has_no_weight(tmp_path):
    # The mean of the photographs in which noise left it below the clip would be too dark.
    ramp = np.broadcast_to(np.linspace(0.9, 1.1, 96)[:, None], NORMALS.shape)
    code, _, _ = developed(photographed(tmp_path / "photos", change=lambda light, n, k: ramp), "exif")
    assert code == 0
    rgb, weight = image(tmp_path / "out" / "IMG_000.exr")
    truth = ramp[..., 0]
    assert (weight[truth > 1.05] == 0).all() and (weight[truth < 0.95] == 1).all()
    at_the_clip = np.abs(truth - 1) < 0.5 * NOISE
    assert (weight[at_the_clip] > 0).mean() < 0.02  # 0.1, if one photograph decided
    assert np.abs((rgb - ramp)[weight > 0].mean()) < 0.001


def moved(light, n, k):
    return np.roll(light, (3, 2), (0, 1)) if (n, k) == (1, 3) else light


@pytest.mark.parametrize(
    ("by", "said"),
    [
        ("exif", "IMG_007.png: the camera moved by 3.0 pixels within its burst; leave it out, or add --register"),
        ("pictures", "IMG_007.png: shows the light of IMG_004.png, but the camera moved by 3.6 pixels; leave it out"),
    ],
)
def test_a_camera_that_moves_within_a_burst_is_refused(by, said, tmp_path):
    code, _, err = developed(photographed(tmp_path / "photos", change=moved), by)
    assert code == 2 and said in err and not (tmp_path / "out").exists()


def test_with_register_a_moved_photograph_is_moved_back(tmp_path):
    code, _, err = developed(photographed(tmp_path / "photos", change=moved), "exif", "--register")
    assert (code, err) == (0, "")
    off = image(tmp_path / "out" / "IMG_004.exr")[0] - lit(NORMALS, ALBEDO, LIGHTS[1])
    assert off[8:-8, 8:-8].std() < 0.8 * NOISE


def test_a_light_that_changes_within_the_time_of_a_burst_is_refused(tmp_path):
    folder = photographed(
        tmp_path / "photos", change=lambda a, n, k: lit(NORMALS, ALBEDO, LIGHTS[2]) if (n, k) == (0, 0) else a
    )
    code, _, err = developed(folder, "exif")
    assert code == 2 and "IMG_000.png: its light differs from that of IMG_002.png, which is in its burst" in err


def test_a_burst_of_another_number_is_warned_of(tmp_path):
    folder = photographed(tmp_path / "photos")
    (folder / "IMG_006.png").unlink()
    _, said, _ = developed(folder, "pictures")
    assert said["warnings"] == [
        f"{folder / 'IMG_004.png'}: its burst has 3 photographs, the usual one 4; check that none is missing"
    ]


def test_lights_that_look_the_same_are_not_averaged(tmp_path):
    # A flat matt card: the lamp changes nothing but its brightness, by 5 %, which noise and bursts do not.
    flat = np.broadcast_to([0.0, 0.0, 1.0], NORMALS.shape)
    steps = [direction(0.8, 0.9 + 0.07 * n) for n in range(len(LIGHTS))]
    folder = photographed(tmp_path / "photos", change=lambda light, n, k: lit(flat, ALBEDO, steps[n]))
    assert developed(folder, "pictures")[1]["images"] == len(LIGHTS)
    for path in folder.iterdir():
        if int(path.stem[-3:]) >= COUNT:
            path.unlink()
    (tmp_path / "out").rename(tmp_path / "former")
    assert "its 4 photographs show 1 light by --bursts exif; 3 or more are needed" in developed(folder, "exif")[2]


def test_photographs_without_bursts_or_times_are_one_line(tmp_path):
    folder = photographed(tmp_path / "photos", times=False)
    assert "IMG_000.png: has no time in its EXIF; use --bursts pictures" in developed(folder, "exif")[2]
    for path in folder.iterdir():
        if int(path.stem[-3:]) % COUNT:
            path.unlink()
    assert "no two photographs make a burst; omit --bursts" in developed(folder, "pictures")[2]
    assert "--bursts averages photographs of one exposure" in developed(folder, "exif", "--brackets", "exif")[2]
