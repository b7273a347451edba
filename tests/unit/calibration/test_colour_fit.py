"""A colour matrix from a chart, through ``develop`` and by itself, against cameras and lamps that are known."""

import json

import numpy as np
import pytest

from irpso_addon.calibration.radiometry.colour_chart import patch_colours
from irpso_addon.calibration.radiometry.colour_difference import delta_e_2000, lab_of_linear
from irpso_addon.calibration.radiometry.colour_fit import NAMES, chart_warnings, fitted, orient_chart, sample_chart
from irpso_addon.capture import read_exr
from irpso_addon.commands import develop
from irpso_addon.core.encode import linear_from_srgb, srgb_from_linear
from irpso_addon.core.errors import InputError
from tests.builders import chart
from tests.builders.captures import chunk, decode_png, write_png
from tests.builders.command_line import listing, run_cli
from tests.builders.exif import exif

CORNERS = chart.CORNERS
TEXT = ",".join(f"{value:g}" for value in CORNERS.ravel())


def encoded(light):
    """Return what an 8-bit sRGB file holds of linear light."""
    return linear_from_srgb(np.rint(255 * np.minimum(srgb_from_linear(light), 1)) / 255.0)


def true_matrix(camera, tint, exposure):
    return np.linalg.inv(exposure * tint[:, None] * camera)


def differences(matrix, camera, tint, exposure):
    """Return (24,) ΔE2000 that a matrix leaves of patches that camera and lamp show without noise."""
    known = patch_colours().reshape(-1, 3)
    seen = exposure * tint * (known @ camera.T)
    return delta_e_2000(lab_of_linear(seen @ matrix.T), lab_of_linear(known))


def test_a_noiseless_chart_gives_the_inverse_of_camera_and_lamp():
    light = chart.photographed(exposure=0.7)
    _, found, fit = orient_chart(chart.whole(light), CORNERS, "x")
    assert found.usable.all()
    expected = true_matrix(chart.CAMERA, chart.TINT, 0.7)
    np.testing.assert_allclose(fit.matrix, expected, atol=0.01 * np.abs(expected).max())
    np.testing.assert_allclose(fit.shading, chart.SHADING, atol=0.01)
    assert np.nanmax(fit.after) < 0.3 and np.nanmean(fit.before) > 9


@pytest.mark.parametrize("seed", range(12))
def test_random_cameras_lamps_and_gradients_in_8_bits_come_out_below_2(seed):
    rng = np.random.default_rng(seed)
    camera, tint = chart.random_camera(rng), np.exp(rng.uniform(-0.7, 0, 3))
    shading, off = rng.uniform(-0.35, 0.35, 2), rng.uniform(-2, 2, (4, 2))
    light = chart.photographed(camera=camera, tint=tint, shading=shading, exposure=0.75, noise=0.005, seed=seed)
    _, found, fit = orient_chart(chart.whole(encoded(light)), CORNERS + off, "x")
    assert np.nanmean(fit.after) < 2 and np.nanmean(fit.after) < 0.5 * np.nanmean(fit.before)
    left = differences(fit.matrix, camera, tint, 0.75)  # of the truth, which the fit does not know
    assert left.mean() < 2
    white = 0.75 * tint * camera.sum(axis=1)
    np.testing.assert_allclose(fit.matrix @ white, 1, atol=0.03)


@pytest.mark.parametrize("seed", range(4))
def test_the_shine_of_a_varnish_stays_out_of_the_matrix(seed):
    rng = np.random.default_rng(seed)
    camera, tint = chart.random_camera(rng), np.exp(rng.uniform(-0.7, 0, 3))
    shown = {"camera": camera, "tint": tint, "shading": rng.uniform(-0.35, 0.35, 2), "noise": 0.005, "seed": seed}
    # Fresnel's 4 % at roughness 0.7 under a lamp in front add 0.027 to every reflectance, in the lamp's colour.
    light = chart.photographed(patches=patch_colours() + 0.027, **shown)
    _, _, fit = orient_chart(chart.whole(encoded(light)), CORNERS, "x")
    assert differences(fit.matrix, camera, tint, 0.7).mean() < 1 and abs(fit.gloss - 0.027) < 0.005  # was 3.4
    _, _, matt = orient_chart(chart.whole(encoded(chart.photographed(**shown))), CORNERS, "x")
    assert matt.gloss == 0


def test_a_chart_that_shines_too_much_is_warned_of():
    rgba = chart.whole(chart.photographed(patches=patch_colours() + 0.12))
    order, found, fit = orient_chart(rgba, CORNERS, "x")
    assert "the chart shines (10% of white)" in " ".join(chart_warnings("x", CORNERS, order, found, fit))


def test_greys_stay_neutral_whatever_the_colours_say():
    # Pigments whose colours no matrix explains: the greys pull against them.
    rgba = chart.whole(chart.photographed(exposure=0.7))
    found = sample_chart(rgba, CORNERS, "x")
    found.values[:18] *= np.exp(np.random.default_rng(1).normal(0, 0.2, (18, 3)))
    fit = fitted(found)
    ratio = found.values[18:] @ fit.matrix.T / patch_colours().reshape(-1, 3)[18:]  # these are not quite grey
    assert (np.ptp(ratio, axis=1) / ratio.mean(axis=1)).max() < 0.005


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("backward", (False, True))
def test_corners_in_any_order_are_recognised(first, backward):
    given = np.roll(CORNERS[::-1] if backward else CORNERS, first, axis=0)
    order, _, fit = orient_chart(chart.whole(chart.photographed()), given, "x")
    np.testing.assert_array_equal(order, CORNERS)
    assert np.nanmean(fit.after) < 0.3


def test_a_mirrored_photograph_is_refused():
    rgba = chart.whole(chart.photographed())[:, ::-1]
    given = CORNERS * (-1, 1) + (chart.SIZE[0], 0)
    with pytest.raises(InputError, match="shows the chart mirrored"):
        orient_chart(rgba, given, "x")


def test_another_chart_is_refused_though_its_grey_row_is_right():
    patches = patch_colours()
    patches[:3] = np.random.default_rng(0).permutation(patches[:3].reshape(-1, 3)).reshape(3, -1, 3)
    with pytest.raises(InputError, match="enclose no 24-patch chart"):
        orient_chart(chart.whole(chart.photographed(patches=patches)), CORNERS, "x")


def test_a_clipped_patch_is_left_out_and_named():
    light = chart.photographed(exposure=1.2, tint=np.ones(3), shading=(0, 0))
    _, found, fit = orient_chart(chart.whole(light), CORNERS, "x")
    assert found.left_out["clipped"] == ["white"] and np.isnan(fit.after[NAMES.index("white")])
    assert np.nanmax(fit.after) < 0.5


def write(path, light, curve=srgb_from_linear):
    codes = np.rint(255 * np.clip(curve(np.clip(light, 0, 1)), 0, 1)).astype(int)
    write_png(path, codes[::-1], 8, chunk(b"eXIf", exif((1, 60))))


@pytest.fixture
def photographs(tmp_path, monkeypatch):
    """A folder of a chart and a subject of one colour, under one warm lamp."""
    monkeypatch.setattr(develop, "decode", decode_png)
    folder = tmp_path / "photographs"
    folder.mkdir()
    write(folder / "chart.png", chart.photographed())
    write(folder / "dark.png", chart.photographed(exposure=0.001))
    write(folder / "bright.png", chart.photographed(exposure=9))
    for n in range(2):
        write(folder / f"{n}.png", subject())
    return folder


COLOUR = np.array([0.5, 0.2, 0.1])


def subject():
    seen = 0.7 * chart.TINT * (chart.CAMERA @ COLOUR)
    return np.broadcast_to(seen, (*chart.SIZE[::-1], 3))


def test_develop_applies_the_matrix_to_all_images(photographs, tmp_path):
    before = listing(photographs)
    run = "develop", photographs, "-o", tmp_path / "out", "--chart", photographs / "chart.png", "--colour-chart", TEXT
    code, out, err = run_cli(*run, "--json", "--quiet")
    assert (code, err) == (0, "") and listing(photographs) == before
    figures = json.loads(out)["colour_chart"]["delta_e_2000"]
    assert figures["after"]["mean"] < 1 < 9 < figures["before"]["mean"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["colour_chart"] == json.loads(out)["colour_chart"]
    for name in ("0", "1"):
        channels = read_exr(tmp_path / "out" / f"{name}.exr")[""]
        found = np.array([channels[c].mean() for c in "RGB"])
        assert delta_e_2000(lab_of_linear(found), lab_of_linear(COLOUR)) < 1


def test_a_response_curve_comes_before_the_matrix(photographs, tmp_path):
    for name, light in (("chart", chart.photographed()), ("0", subject()), ("1", subject())):
        write(photographs / f"{name}.png", light, lambda v: v ** (1 / 1.6))
    codes = np.linspace(0, 1, 256)
    curve = "".join(f"{code:.6f} {code**1.6:.8f}\n" for code in codes)
    (tmp_path / "curve.csv").write_text(curve)
    run = "develop", photographs, "-o", tmp_path / "out", "--chart", photographs / "chart.png", "--colour-chart", TEXT
    code, out, err = run_cli(*run, "--response", tmp_path / "curve.csv", "--json", "--quiet")
    assert (code, err) == (0, "")
    assert json.loads(out)["colour_chart"]["delta_e_2000"]["after"]["mean"] < 1
    channels = read_exr(tmp_path / "out" / "0.exr")[""]
    found = np.array([channels[c].mean() for c in "RGB"])
    assert delta_e_2000(lab_of_linear(found), lab_of_linear(COLOUR)) < 1


def test_a_chart_given_upside_down_is_read_and_said(photographs, tmp_path):
    text = ",".join(f"{value:g}" for value in np.roll(CORNERS, 2, axis=0).ravel())
    run = "develop", photographs, "-o", tmp_path / "out", "--chart", photographs / "chart.png", "--colour-chart", text
    code, out, err = run_cli(*run)
    assert code == 0 and "dark skin patch, which is at 40,30: corrected" in err
    assert out.startswith("colour chart: ΔE2000 mean ") and out.count("\n") == 1


BROKEN = [
    ("chart.png", TEXT, ["--white", "3,4,6,6"], "--white and --colour-chart both give the white balance"),
    ("chart.png", "1,2,3", [], "write X1,Y1,X2,Y2,X3,Y3,X4,Y4"),
    ("chart.png", "nan,0,9,0,9,9,0,9", [], "write X1,Y1,X2,Y2,X3,Y3,X4,Y4"),
    ("chart.png", "40,30,305,42,196,150,33,141", [], "a corner lies outside the photograph's 240×180 pixels"),
    ("chart.png", "40,30,196,150,205,42,33,141", [], "do not go around the chart"),
    ("chart.png", "40,30,60,30,60,42,40,42", [], "only 0 of 24 patches can be measured (too small: dark skin"),
    ("chart.png", "60,45,180,50,230,170,10,160", [], "the corners enclose no 24-patch chart"),
    ("bright.png", TEXT, [], "can be measured (clipped: "),
    ("dark.png", TEXT, [], "can be measured (black: "),
]


@pytest.mark.parametrize(("file", "corners", "more", "words"), BROKEN, ids=[row[-1] for row in BROKEN])
def test_bad_charts_are_one_line_and_leave_nothing(photographs, tmp_path, file, corners, more, words):
    before = listing(tmp_path)
    run = "develop", photographs, "-o", tmp_path / "out", "--chart", photographs / file, "--colour-chart", corners
    code, out, err = run_cli(*run, *more, "--quiet")
    assert (code, out) == (2, "") and words in err and err.count("\n") == 1
    assert listing(tmp_path) == before
