"""recover on captures whose lights are not known well."""

import json

import numpy as np
import pytest

from tests.builders.command_line import angle, dome_lights, read_map, render_oracle, run_cli, smooth_maps, write_card
from tests.builders.lights import apart, gains, off
from tests.builders.near_card import write_near_card

LIGHTS = dome_lights(12)
HELD_OUT = 7


@pytest.fixture(scope="module")
def truth():
    return smooth_maps((20, 24), {}, tilt=35)


@pytest.fixture(scope="module")
def factors():
    return gains(12, np.random.default_rng(1))


@pytest.fixture(scope="module")
def capture(tmp_path_factory, truth, factors):
    """A matte card under lights of unequal strength, of which the capture says nothing."""
    images = render_oracle("lambert", truth, LIGHTS) * factors[:, None, None]
    return write_card(tmp_path_factory.mktemp("unequal") / "card", images, LIGHTS)


def recover(capture, out, *options):
    code, said, error = run_cli("recover", capture, "-o", out, "--model", "lambert", "--json", *options)
    assert code == 0, error
    return json.loads(said), json.loads((out / "report.json").read_text())


def test_estimated_intensities_correct_the_maps_and_relight_held_out_images(tmp_path, capture, truth, factors):
    said, report = recover(capture, tmp_path / "out", "--intensities", "estimate", "--hold-out", HELD_OUT)
    assert off(np.array(report["lights"]["intensities"]), factors).max() < 0.02
    assert report["settings"]["intensities"] == "estimate"
    assert report["seconds"]["lights"] > 0
    assert np.median(angle(read_map(tmp_path / "out" / "normal.exr"), truth["normal"])) < 0.5
    assert min(report["relighting_psnr_db"].values()) > 40
    assert said["warnings"] == []


def test_wrong_default_intensities_get_a_warning_with_the_remedy(tmp_path, capture, truth):
    _, report = recover(capture, tmp_path / "out", "--set", "prior_rounds=0", "--intensities", "given")
    assert any("--intensities estimate" in line for line in report["warnings"])
    assert "lights" not in report
    assert np.median(angle(read_map(tmp_path / "out" / "normal.exr"), truth["normal"])) > 5


def test_contradicted_intensities_are_estimated_and_reported(tmp_path, capture, truth, factors):
    # Tiles need no wide halo.
    narrow = (
        "--set",
        "prior_rounds=0",
        "--set",
        "prefit_indirect_shadow=0.0",
        "--set",
        "prefit_sheen_gain=0.0",
        "--set",
        "surface_rounds=0",
    )
    _, report = recover(capture, tmp_path / "whole", *narrow)
    assert off(np.array(report["lights"]["intensities"]), factors).max() < 0.02
    assert ["so they were estimated" in line for line in report["warnings"]] == [True]
    normal = read_map(tmp_path / "whole" / "normal.exr")
    assert np.median(angle(normal, truth["normal"])) < 0.5
    _, tiled = recover(capture, tmp_path / "tiles", *narrow, "--memory", "device=300K")
    assert tiled["settings"]["tiles"] > 1
    np.testing.assert_array_equal(read_map(tmp_path / "tiles" / "normal.exr"), normal)


def test_correct_intensities_are_not_changed(tmp_path, truth):
    capture = write_card(tmp_path / "equal", render_oracle("lambert", truth, LIGHTS), LIGHTS)
    _, report = recover(capture, tmp_path / "out", "--set", "prior_rounds=0")
    assert "lights" not in report and report["warnings"] == []


def test_close_lights_do_not_determine_their_intensities(tmp_path, truth, factors):
    narrow = dome_lights(12, widest=22)
    images = render_oracle("lambert", truth, narrow) * factors[:, None, None]
    _, report = recover(write_card(tmp_path / "narrow", images, narrow), tmp_path / "out", "--set", "prior_rounds=0")
    assert "lights" not in report
    assert any("too close together" in line for line in report["warnings"])


def test_directions_are_refined_and_correct_ones_raise_no_warning(tmp_path, truth):
    rng = np.random.default_rng(3)
    wrong = LIGHTS + np.radians(2) * rng.normal(size=LIGHTS.shape)
    wrong /= np.linalg.norm(wrong, axis=-1, keepdims=True)
    capture = write_card(tmp_path / "card", render_oracle("lambert", truth, LIGHTS), wrong)
    _, report = recover(capture, tmp_path / "out", "--refine-directions", 2)
    found = np.array(report["lights"]["lights"])[:, :3]
    assert apart(found, LIGHTS).mean() < 0.6 * apart(wrong, LIGHTS).mean()
    np.testing.assert_allclose(np.array(report["lights"]["intensities"]), 1)
    assert report["warnings"] == []


def test_directions_of_lamps_with_a_cosine_are_not_refined(tmp_path):
    """Their beam, by which samples were divided, would stay where the lamp was: normals got worse by 5 degrees."""
    folder = write_near_card(tmp_path / "card")
    table = folder / "capture.toml"
    beam = "light_axis = [0, 0, -1]\nlight_cosine = true\ncamera ="
    table.write_text(table.read_text().replace("camera =", beam, 1))
    code, _, error = run_cli("recover", folder, "-o", tmp_path / "out", "--refine-directions", 2)
    assert code == 2 and "the light of 'lamp 0' falls off from its axis (light_cosine)" in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("degrees", ["-1", "21", "nan"])
def test_directions_too_far_off_are_refused_before_anything_is_written(tmp_path, capture, degrees):
    code, _, error = run_cli("recover", capture, "-o", tmp_path / "out", f"--refine-directions={degrees}")
    assert code == 2
    assert "--refine-directions" in error and "20" in error
    assert not (tmp_path / "out").exists()
