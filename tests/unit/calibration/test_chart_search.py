"""The 24-patch chart is found in photographs whose chart, camera, lamp and clutter are known; and not where none is."""

import json
import sys

import numpy as np
import pytest

from irpso_addon.calibration.charts.lattice import lattices
from irpso_addon.calibration.charts.search import find_chart
from irpso_addon.calibration.radiometry.colour_fit import Mirrored
from irpso_addon.commands import develop
from tests.builders.captures import decode_png, write_png
from tests.builders.chart_scenes import scene
from tests.builders.command_line import listing, run_cli


def off(found, corners):
    """Return the largest distance of corners from the true ones, in widths of a patch with its gap."""
    return np.abs(found - corners).max() / (np.linalg.norm(corners[1] - corners[0]) / 6)


@pytest.mark.parametrize("seed", [301, 305, 310, 316])
def test_a_chart_is_found_in_any_turn_with_its_colours(seed):
    shown = scene(seed)
    found = find_chart(shown.rgba, "photograph")
    assert found is not None and off(found.corners, shown.corners) < 0.15
    assert np.nanmean(found.fit.after) < 2


@pytest.mark.parametrize("seed", [312, 313, 317])
def test_tiles_checks_and_cards_are_no_chart(seed):
    assert find_chart(scene(seed, chart=False).rgba, "photograph") is None


def test_a_turned_photograph_gives_the_same_corners_turned():
    rgba = scene(305).rgba
    found, turned = find_chart(rgba, ""), find_chart(np.ascontiguousarray(rgba[::-1, ::-1]), "")
    height, width = rgba.shape[:2]
    assert off((width, height) - turned.corners, found.corners) < 0.1


def test_a_mirrored_photograph_is_refused():
    with pytest.raises(Mirrored, match="a.jpg: the photograph shows the chart mirrored"):
        find_chart(scene(318, mirrored=True).rgba, "a.jpg")


def test_a_lattice_in_perspective_keeps_its_places():
    places = np.stack(np.meshgrid(np.arange(6), np.arange(4)), axis=-1).reshape(-1, 2).astype(float)
    matrix = np.array([(40, 6, 100), (-5, 35, 120), (0.02, 0.015, 1)])

    def seen(points):
        found = np.column_stack([points, np.ones(len(points))]) @ matrix.T
        return found[:, :2] / found[:, 2:]

    half = np.array([(-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4)])
    left = np.delete(places, [0, 9, 23], axis=0)  # patches that were not seen
    quads = np.array([seen(place + half) for place in left])
    (lattice,) = lattices(np.concatenate([quads, [[(5, 5), (60, 5), (60, 90), (5, 90)]]]))
    cells = lattice.cells - lattice.cells.min(axis=0)
    assert len(cells) == 21 and sorted(cells.max(axis=0)) == [3, 5]
    centres = np.array([seen(place[None])[0] for place in left])
    apart = np.linalg.norm(lattice.at(lattice.cells)[:, None] - centres, axis=-1).min(axis=1)
    assert apart.max() < 1.0


@pytest.fixture
def photographs(tmp_path, monkeypatch):
    """Three photographs, the second of which shows a chart."""
    monkeypatch.setattr(develop, "decode", decode_png)
    folder = tmp_path / "photographs"
    folder.mkdir()
    shown = scene(333)
    others = np.stack([shown.rgba[::-1, ::-1, :3] * 0 + 0.2, shown.rgba[..., :3], shown.rgba[..., :3] * 0 + 0.1])
    for n, linear in enumerate(others):
        write_png(folder / f"{n}.png", np.rint(linear[::-1] * 65535).astype(int), 16)
    return folder, shown.corners


def test_develop_searches_the_photographs_and_says_where_the_chart_is(photographs, tmp_path):
    folder, corners = photographs
    code, out, err = run_cli("develop", folder, "-o", tmp_path / "out", "--colour-chart", "auto", "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)["colour_chart"]
    assert found["file"].endswith("1.png") and found["found"] is True
    assert off(np.reshape(found["corners"], (4, 2)), corners) < 0.15
    assert found["delta_e_2000"]["after"]["mean"] < 2 < found["delta_e_2000"]["before"]["mean"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--chart", "photographs/0.png"], "--colour-chart auto: no 24-patch chart is found in photographs/0.png"),
        (["--white", "1,1,1"], "give one of them"),
    ],
)
def test_where_no_chart_is_found_one_line_says_so(photographs, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    before = listing(tmp_path)
    command = "develop", "photographs", "-o", "out", "--colour-chart", "auto", "--quiet"
    code, _, err = run_cli(*command, *options)
    assert code == 2 and words in err and err.count("\n") == 1 and listing(tmp_path) == before


def test_without_opencv_one_line_says_how_to_install_it(photographs, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    code, _, err = run_cli("develop", photographs[0], "-o", tmp_path / "out", "--colour-chart", "auto", "--quiet")
    assert code == 2 and "needs OpenCV" in err and "pip install opencv-python-headless" in err
