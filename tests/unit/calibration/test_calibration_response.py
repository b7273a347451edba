"""Response curves of brackets and of grey patches, against curves that are known; and their files."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.calibration.radiometry.curve_file import read_response, write_response
from irpso_addon.calibration.radiometry.response import (
    bracket_step,
    monotone,
    response_from_brackets,
    response_from_patches,
)
from irpso_addon.commands import response as command
from irpso_addon.core.errors import InputError
from irpso_addon.core.png import png_bytes
from tests.builders.command_line import run_cli


def srgb(light):
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def film(light):
    """An S-shaped picture profile over logarithms of light."""
    return (1 + np.exp(-2.2 * 0.9)) / (1 + np.exp(-(np.log2(np.maximum(light, 1e-6)) + 2.2) * 0.9))


def shoulder(light):
    return srgb(1 - np.exp(-2 * light)) / srgb(1 - np.exp(-2.0))


CURVES = {"linear": lambda light: light, "gamma 1.8": lambda light: light ** (1 / 1.8), "srgb": srgb, "film": film,
          "shoulder": shoulder}  # fmt: skip


def photographed(curve, times, seed=0, count=3000, noise=True, outliers=0):
    """Return 8-bit codes (N, F, 3) / 255 of pixels whose light is known to nobody, with shot and read noise."""
    rng = np.random.default_rng(seed)
    light = np.exp(rng.uniform(np.log(0.01), np.log(40), (count, 1, 3))) * times[:, None]
    if noise:
        light = light + np.sqrt(light / 20000 + 1e-7) * rng.standard_normal(light.shape)
    codes = np.rint(255 * np.clip(curve(np.clip(light, 0, 1)), 0, 1)) / 255
    moved = rng.random(count) < outliers
    codes[moved] = rng.random((moved.sum(), len(times), 3))
    return codes


def relative_error(response, curve, channel):
    """Return |error| of linear values, up to one scale, over codes in the range that was seen."""
    light = np.linspace(1e-4, 1, 4000)
    codes = curve(light)
    found = response(np.repeat(codes[:, None], 3, axis=1))[:, channel]
    low, high = response.used[channel]
    seen = (codes > low) & (codes < high)
    ratio = found[seen] / light[seen]
    return np.abs(ratio / np.median(ratio) - 1)


@pytest.mark.parametrize("name", CURVES)
def test_a_known_curve_is_found_within_one_percent_from_one_stop_brackets(name):
    times = 2.0 ** np.arange(-4, 1)
    response = response_from_brackets([photographed(CURVES[name], times)], [times])
    for channel in range(3):
        error = relative_error(response, CURVES[name], channel)
        assert error.mean() < 0.01 and np.quantile(error, 0.98) < 0.03
    assert (response.used[:, 0] < 0.05).all() and (response.used[:, 1] > 0.9).all()
    assert (np.diff(response.linear, axis=0) >= 0).all() and np.allclose(response.linear[[0, -1]], [[0] * 3, [1] * 3])


def test_brackets_of_uneven_steps_find_what_equal_wide_ones_leave_open():
    wide, uneven = 2.0 ** np.array([-6, -3, 0]), 2.0 ** np.array([-6.0, -5, -3.5, -1.3, 0])
    errors = []
    for times in (wide, uneven):
        response = response_from_brackets([photographed(film, times)], [times])
        errors.append(relative_error(response, film, 1).mean())
    assert errors[1] < 0.5 * errors[0]


def test_channels_have_curves_of_their_own():
    times = 2.0 ** np.arange(-4, 1)
    names = ("linear", "srgb", "film")
    codes = np.stack([photographed(CURVES[n], times, seed)[..., 0] for seed, n in enumerate(names)], axis=-1)
    response = response_from_brackets([codes], [times])
    for channel, name in enumerate(names):
        assert relative_error(response, CURVES[name], channel).mean() < 0.01


def test_pixels_that_moved_hardly_bend_the_curve():
    times = 2.0 ** np.arange(-4, 1)
    response = response_from_brackets([photographed(srgb, times, outliers=0.1)], [times])
    assert relative_error(response, srgb, 1).mean() < 0.01


def test_a_curve_rises_even_where_the_photographs_contradict_each_other():
    times = 2.0 ** np.arange(-4, 1)
    response = response_from_brackets([np.random.default_rng(0).random((200, 5, 3))], [times])
    assert (np.diff(response.linear, axis=0) >= 0).all() and np.isfinite(response.linear).all()


def test_several_brackets_of_other_lights_count_together():
    times = [2.0 ** np.arange(-4, 1), 3 * 2.0 ** np.arange(-2, 1)]
    samples = [photographed(srgb, t / t.max(), seed, 1500) for seed, t in enumerate(times)]
    assert bracket_step(times) == pytest.approx(1)
    assert relative_error(response_from_brackets(samples, times), srgb, 0).mean() < 0.01


def test_brackets_that_cannot_give_a_curve_are_refused():
    times = 2.0 ** np.arange(-4, 1)
    with pytest.raises(InputError, match=r"longest exposure is at least 1\.5 times the shortest \(0\.6 stop\)"):
        response_from_brackets([np.full((100, 1, 3), 0.5)], [np.ones(1)])
    with pytest.raises(InputError, match=r"longest exposure is at least 1\.5 times the shortest \(0\.6 stop\)"):
        response_from_brackets([np.full((100, 2, 3), 0.5)], [np.array([1.0, 1.2])])
    for value in (0.0, 1.0):
        with pytest.raises(InputError, match="0 pixels are neither black nor clipped.*red"):
            response_from_brackets([np.full((100, 5, 3), value)], [times])


def test_monotone_is_the_least_squares_fit_that_does_not_fall():
    # By hand: 3, 1 pool to 2, 2; then 5; 4, 0 pool with 5 to 3, 3, 3.
    np.testing.assert_allclose(monotone(np.array([3.0, 1, 5, 4, 0])), [2, 2, 3, 3, 3])
    np.testing.assert_allclose(monotone(np.array([1.0, 2, 3])), [1, 2, 3])


def test_few_grey_patches_give_their_gamma():
    reflectances = np.array([0.9, 0.03, 0.18])
    codes = (0.8 * reflectances) ** (1 / 2.2)
    response = response_from_patches(np.repeat(codes[:, None], 3, axis=1), reflectances)
    light = np.linspace(0, 1, 50)
    found = response(np.repeat((light ** (1 / 2.2))[:, None], 3, axis=1))
    np.testing.assert_allclose(found[:, 1], light, atol=2e-4)
    assert response.residual < 1e-9


def test_a_step_chart_gives_the_curve_through_its_patches():
    reflectances = 0.9 * 2.0 ** (-np.arange(12) / 2)
    exact = film(reflectances)
    response = response_from_patches(np.repeat(exact[:, None], 3, axis=1), reflectances)
    found = response(np.repeat(exact[:, None], 3, axis=1))[:, 1]
    np.testing.assert_allclose(found / found[0], reflectances / reflectances[0], rtol=0.01)
    between = 0.9 * 2.0 ** (-np.arange(0.5, 11) / 2)
    found = response(np.repeat(film(between)[:, None], 3, axis=1))[:, 1] / found[0]
    np.testing.assert_allclose(found, between / reflectances[0], rtol=0.02)


@pytest.mark.parametrize(
    ("codes", "reflectances", "words"),
    [
        ([0.5], [0.18], "--white"),
        ([0.5, 0.7], [0.18, 0.0], "above 0"),
        ([0.5, 0.7], [0.18, float("nan")], "above 0"),
        ([0.5, 0.4], [0.18, 0.5], "higher code values"),
        ([0.5, 0.5], [0.18, 0.18], "higher code values"),
        ([0.5, 1.0], [0.18, 0.9], "black or clipped"),
        ([0.0, 0.5], [0.03, 0.9], "black or clipped"),
    ],
)
def test_patches_that_cannot_give_a_curve_are_refused(codes, reflectances, words):
    with pytest.raises(InputError, match=words):
        response_from_patches(np.repeat(np.array(codes)[:, None], 3, axis=1), reflectances)


def test_a_curve_comes_back_from_its_file(tmp_path):
    times = 2.0 ** np.arange(-4, 1)
    response = response_from_brackets([photographed(shoulder, times, count=500)], [times])
    write_response(tmp_path / "a.toml", response)
    back = read_response(tmp_path / "a.toml")
    np.testing.assert_allclose(back.linear, response.linear, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(back.used, response.used, rtol=1e-5)
    assert back.residual == pytest.approx(response.residual, rel=1e-5)


def test_a_curve_without_a_residual_is_written_and_says_so(tmp_path, monkeypatch):
    curve = response_from_patches(np.array([[0.3] * 3, [0.7] * 3]), [0.1, 0.5])
    monkeypatch.setattr(command, "patch_response", lambda *arguments: replace(curve, residual=float("nan")))
    run = "response", tmp_path / "chart.png", "-o", tmp_path / "a.toml", "--grey-card", "1,1,9,9=0.1"
    code, out, err = run_cli(*run, "--grey-card", "20,1,9,9=0.5")
    assert (code, err) == (0, "") and "a.toml: residual unknown, measured at codes of red 0.300 to 0.700" in out


@pytest.mark.parametrize("shape", [(1, 20), (20, 1), (1, 1)])
def test_brackets_of_one_row_or_column_give_the_pixels_of_the_same_one_twice(shape):
    codes = np.random.default_rng(0).uniform(0.1, 0.9, (*shape, 3, 3))
    twice = codes.repeat(1 + (shape[0] == 1), axis=0).repeat(1 + (shape[1] == 1), axis=1)
    found, expected = (command.spread_samples(one, 1000) for one in (codes, twice))
    np.testing.assert_array_equal(np.unique(found, axis=0), np.unique(expected, axis=0))


def test_a_partly_clipped_patch_is_refused(tmp_path):
    """A third of the brightest patch at the largest code changes its mean, and the curve, by a few percent."""
    codes = np.full((20, 60, 3), 60, np.uint8)
    codes[:, 20:40], codes[:, 40:] = 120, 240
    patches = [word for k, grey in enumerate("169") for word in ("--grey-card", f"{20 * k},0,20,20=0.{grey}")]
    run = ["response", tmp_path / "a.png", *patches, "-o", tmp_path / "a.toml"]
    for rows, exit_code in ((7, 2), (0, 0)):
        codes[:rows, 40:, 0] = 255
        (tmp_path / "a.png").write_bytes(png_bytes(codes / 255, 8))
        code, _, err = run_cli(*run)
        assert code == exit_code and ("a.png: 35% of the patch 40,0,20,20 are clipped" in err) == bool(rows)
        codes[:rows, 40:] = 240


def test_a_curve_may_be_lines_of_numbers(tmp_path):
    (tmp_path / "a.csv").write_text("# code, linear\n0, 0\n0.5, 0.25\n1, 2\n")
    np.testing.assert_allclose(read_response(tmp_path / "a.csv")(np.array([[0.25, 0.5, 1.0]])), [[0.0625, 0.125, 1]])
    (tmp_path / "b.csv").write_text("0,0,0,0\n1,1,2,4\n")
    np.testing.assert_allclose(read_response(tmp_path / "b.csv")(np.full((1, 3), 0.5)), 0.5)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.toml", "format = 1\ncodes = [0, 1]\nred = [0, 1]\ngreen = [0, 1]\n", "'blue'"),
        ("a.toml", "format = 2\n", "not a response curve"),
        ("a.toml", "colour = 1\n", "unknown key 'colour'"),
        ("a.toml", "format = ", "not valid TOML"),
        ("a.toml", "format = 1\ncodes = [0, 1]\nred = [0, 1]\ngreen = [0, 1]\nblue = [0, 1, 2]\n", "as many numbers"),
        ("a.toml", "format = 1\ncodes = [0, 1]\nred = [1, 0]\ngreen = [0, 1]\nblue = [0, 1]\n", "must rise"),
        ("a.toml", "format = 1\ncodes = [0, 0]\nred = [0, 1]\ngreen = [0, 1]\nblue = [0, 1]\n", "codes must rise"),
        ("a.toml", "format = 1\ncodes = [0, 1]\nred = [0, nan]\ngreen = [0, 1]\nblue = [0, 1]\n", "codes must rise"),
        ("a.toml", 'format = 1\ncodes = ["a"]\nred = [0]\ngreen = [0]\nblue = [0]\n', "'codes'"),
        ("a.csv", "0 0\n255 1\n", "code value / largest code"),
        ("a.csv", "0 0 0\n1 1 1\n", "code red green blue"),
        ("a.csv", "0 zero\n", "'zero' is not a number"),
        ("a.csv", "", "is empty"),
        ("a.csv", "0 0\n0.3 0.1\n0.6 0.3\n", "its last code is 0.6; add the line of code 1"),
        ("a.csv", "0.2 0.04\n1 1\n", "its first code is 0.2; add the line of code 0"),
        ("a.csv", "0 0\n0.3 0.1\n0.6 0.3\n", "its last code is 0.6; add the line of code 1"),
    ],
)
def test_broken_curve_files_are_refused_by_name(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words) as error:
        read_response(tmp_path / name)
    assert name in str(error.value)


def test_a_missing_curve_file_is_an_error(tmp_path):
    for name in ("no.toml", "no.csv"):
        with pytest.raises(InputError, match=name):
            read_response(tmp_path / name)
