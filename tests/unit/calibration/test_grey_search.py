"""A grey card and a chart's grey row are found in photographs whose card, camera, lamp and clutter are known."""

import json

import numpy as np
import pytest

from irpso_addon.calibration.charts.grey_card import SeveralGreys, find_grey_card
from irpso_addon.calibration.radiometry.curve_file import read_response
from irpso_addon.commands import develop, response
from tests.builders.captures import decode_png, write_png
from tests.builders.chart_scenes import scene
from tests.builders.command_line import run_cli

pytest.importorskip("cv2", reason="OpenCV is not installed")


def with_card(seed):
    return scene(seed, chart=False, card=True, dimmest=0.85)


def inside(patch, corners):
    """Return whether a patch lies in a quadrilateral that goes clockwise on the screen."""
    x, y = np.array([patch.x, patch.x + patch.width]), np.array([patch.y, patch.y + patch.height])
    ways = np.roll(corners, -1, axis=0) - corners
    for point in np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2):
        away = point - corners
        if not (ways[:, 0] * away[:, 1] > ways[:, 1] * away[:, 0]).all():
            return False
    return True


def tone(light):
    """Return a film-like picture profile's codes 0…1 of linear light."""
    root = np.clip(light, 0, 1) ** (1 / 2.2)
    return 0.6 * root * root * (3 - 2 * root) + 0.4 * root


@pytest.fixture(autouse=True)
def reader(monkeypatch):
    for command in (develop, response):
        monkeypatch.setattr(command, "decode", decode_png)


@pytest.mark.parametrize("seed", [340, 345, 348])
def test_the_card_is_found_in_any_turn(seed):
    shown = with_card(seed)
    assert inside(find_grey_card(shown.rgba, "x"), shown.corners)


def test_what_could_be_the_card_as_well_is_named_with_the_remedy():
    rgba = np.full((240, 320, 4), 0.4, np.float32)
    rgba[..., 0] = 0.2
    for x in (30, 180):
        rgba[80:160, x : x + 90, :3] = 0.18
    with pytest.raises(SeveralGreys, match=r"2 things may be the grey card, at .*; give the one that is, as X,Y,W,H"):
        find_grey_card(rgba, "a.jpg")
    rgba[80:160, 180:270, :3] = (0.3, 0.18, 0.1)  # a brown one is none
    assert find_grey_card(rgba, "a.jpg").x < 100


@pytest.mark.parametrize("seed", [341, 344])
def test_cards_of_other_colours_and_tiles_are_none(seed):
    assert find_grey_card(scene(seed, chart=False, dimmest=0.85).rgba, "x") is None


def test_develop_balances_and_scales_by_the_card_it_finds(tmp_path):
    (tmp_path / "photos").mkdir()
    shown = with_card(340)
    write_png(tmp_path / "photos" / "0.png", np.rint(shown.rgba[::-1, :, :3] * 65535).astype(int), 16)
    run = "develop", tmp_path / "photos", "-o", tmp_path / "out", "--colour-space", "linear", "--white", "auto=0.18"
    code, out, err = run_cli(*run, "--json")
    assert (code, err) == (0, "") and json.loads(out)["grey_card"]["file"].endswith("0.png")
    card = find_grey_card(shown.rgba, "x")
    seen = shown.rgba[::-1][card.y : card.y + card.height, card.x : card.x + card.width, :3].mean(axis=(0, 1))
    np.testing.assert_allclose(json.loads(out)["white_gains"], 0.18 / seen, rtol=0.01)


def test_photographs_without_a_card_are_one_line(tmp_path):
    (tmp_path / "photos").mkdir()
    write_png(tmp_path / "photos" / "0.png", np.full((60, 80, 3), 90), 8)
    code, _, err = run_cli("develop", tmp_path / "photos", "-o", tmp_path / "out", "--white", "auto")
    assert code == 2 and "--white auto: no grey card, an even and neutral rectangle, is found in" in err
    code, _, err = run_cli("develop", tmp_path / "photos", "-o", tmp_path / "out", "--grey-card", "auto")
    assert code == 2 and "--grey-card auto: no 24-patch chart, whose grey row gives the curve" in err
    code, _, err = run_cli("response", tmp_path / "photos" / "0.png", "-o", tmp_path / "c.toml", "--grey-card", "auto")
    assert code == 2 and "0.png: no 24-patch chart, whose grey row gives the curve" in err
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


@pytest.mark.parametrize("seed", [307, 311])
def test_the_grey_row_of_a_chart_gives_the_curve(seed, tmp_path):
    shown = scene(seed, coded=False).rgba[::-1, :, :3]
    write_png(tmp_path / "chart.png", np.rint(255 * tone(shown)).astype(int), 8)
    run = "response", tmp_path / "chart.png", "-o", tmp_path / "c.toml", "--grey-card", "auto", "--quiet"
    code, _, err = run_cli(*run)
    assert code == 0 and "chart.png: the curve is right only if the chart is matt" in err
    curve = read_response(tmp_path / "c.toml")
    light = np.geomspace(0.05, 0.6, 40)
    found = curve(np.repeat(tone(light)[:, None], 3, axis=1))
    ratio = found / light[:, None]
    assert (
        np.abs(ratio / np.exp(np.log(ratio).mean(axis=0)) - 1).max() < 0.06
    )  # as sRGB it would be 0.27; with the lamp's fall-off 0.19
