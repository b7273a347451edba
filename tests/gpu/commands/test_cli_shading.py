"""``calibrate --ball none``: lights of a subject from itself, through the public command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.capture.read import read_capture
from irpso_addon.core.errors import InputError
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.build import card_steps
from irpso_addon.pipeline import uncalibrated
from irpso_addon.reflectance.model import load_model
from tests.builders import command_line as cli_maker
from tests.builders.command_line import angle, run_cli
from tests.builders.relief import ball, lamps

LIGHTS = 24


@pytest.fixture(scope="module")
def solid(tmp_path_factory):
    """Return the folder of photographs of a glazed ball, and the lights that they were taken under."""
    normals, mask = ball()
    directions, strengths = lamps(LIGHTS, uneven=0.2)
    ranges = {"roughness": (0.3, 0.5), "metallic": (0.0, 0.0), "specular": (0.5, 0.5)}
    values = cli_maker.smooth_maps(mask.shape, ranges, seed=2) | {"normal": normals}
    images = cli_maker.render_oracle("metallic_roughness", values, directions) * strengths[:, None, None, None]
    folder = cli_maker.write_card(
        tmp_path_factory.mktemp("solid") / "ball", np.where(mask[..., None], images, 0), directions, mask
    )
    table = folder / "capture.toml"
    lines = table.read_text().splitlines(keepends=True)
    wrong = ["light_direction = [0.0, 0.0, 1.0]\n" if line.startswith("light_direction") else line for line in lines]
    table.write_text("".join(wrong))
    return folder, directions, strengths


def test_lights_without_a_ball(solid, tmp_path):
    folder, directions, strengths = solid
    code, answer, err = run_cli("calibrate", folder, "--ball", "none", "-o", tmp_path / "out", "--json")
    assert (code, err) == (0, ""), err
    assert json.loads(answer.splitlines()[-1])["lights"] == LIGHTS
    found = read_capture(tmp_path / "out").lights
    off = angle(np.array([light.vector for light in found]), directions)
    power = np.array([light.intensity for light in found]).mean(axis=-1) / strengths
    print(f"lights off by {off.mean():.2f}°, strengths by {np.std(np.log(power)):.1%}")
    assert off.mean() < 2.5
    assert np.std(np.log(power)) < 0.05
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["kind"] == "shading"
    assert report["warnings"] == []
    stated = np.mean([light["error_degrees"] for light in report["lights"]])
    assert off.mean() / 3 < stated < 3.0


def test_a_surface_that_contradicts_the_lights_is_refused(solid, monkeypatch):
    angle = np.radians(15)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    monkeypatch.setattr(uncalibrated, "rotation", lambda *_: turn)
    capture = read_capture(solid[0])
    with pytest.raises(InputError, match="turned by 15° against those from the visible surface"):
        run_steps(uncalibrated.uncalibrated_steps(capture, load_model("metallic_roughness")))


@pytest.mark.parametrize(("errors", "refused"), [(3.0, False), (0.0, True)])
def test_a_subject_whose_parts_disagree_is_tried_under_strict_limits(solid, monkeypatch, errors, refused):
    monkeypatch.setattr(uncalibrated, "_UNSURE_DISAGREEMENT", 0.0)
    monkeypatch.setattr(uncalibrated, "_STRICT", replace(uncalibrated._STRICT, errors=errors))
    steps = uncalibrated.uncalibrated_steps(read_capture(solid[0]), load_model("metallic_roughness"))
    if refused:
        with pytest.raises(InputError, match="with its recovered material; put a ball .* use --flat"):
            run_steps(steps)
    else:
        assert run_steps(steps).errors.mean() < 3


def test_texels_in_a_hollow_are_left_out(tmp_path):
    """A pit sees less of the sky, a bump of the same shape and the plane around them all of it, or nearly."""
    y, x = np.mgrid[:60, :60] / 30 - 1
    bump, pit = (np.exp(-((x - middle) ** 2 + y**2) / 0.04) for middle in (-0.4, 0.4))
    slopes = np.gradient(4 * (bump - pit), axis=(1, 0))
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    directions, _ = lamps(16)
    images = cli_maker.render_oracle("lambert", cli_maker.smooth_maps(x.shape, {}, 2) | {"normal": normals}, directions)
    capture = read_capture(cli_maker.write_card(tmp_path / "pit", images, directions))
    domain = run_steps(card_steps(replace(capture, card_distance=1.0)))
    kept = uncalibrated.open_texels(domain, capture.cameras[0]).solvable
    pits, bumps = kept[pit > 0.5], kept[bump > 0.5]
    print(f"kept: {kept.mean():.0%}, of the pit {pits.mean():.0%}, of the bump {bumps.mean():.0%}")
    assert not pits.any()
    assert bumps.all()
    assert kept.mean() > 0.8


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--kind", "mirror"], "--kind: applies to balls"),
        (["--radius", "2"], "--radius: applies to balls"),
        (["--lights", "near"], "--lights near: places of lamps need balls"),
        (["--ball", "3,4,5"], "omit the other --ball"),
    ],
)
def test_options_of_balls_are_refused(solid, tmp_path, options, said):
    code, _, err = run_cli("calibrate", solid[0], "--ball", "none", "-o", tmp_path / "out", *options)
    assert code == 2
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_inside_out_is_of_shading_alone(solid, tmp_path):
    code, _, err = run_cli("calibrate", solid[0], "--inside-out", "-o", tmp_path / "out")
    assert (code, err.count("\n")) == (2, 1)
    assert "--inside-out: needs --ball none" in err


def test_a_flat_subject_is_refused(tmp_path):
    directions, _ = lamps(16)
    values = cli_maker.smooth_maps((40, 40), {}, seed=2) | {"normal": np.broadcast_to((0.0, 0.0, 1.0), (40, 40, 3))}
    images = cli_maker.render_oracle("lambert", values, directions)
    folder = cli_maker.write_card(tmp_path / "flat", images, directions)
    code, _, err = run_cli("calibrate", folder, "--ball", "none", "-o", tmp_path / "out", "--quiet")
    assert (code, err.count("\n")) == (2, 1)
    assert "put a ball" in err
    assert not (tmp_path / "out").exists()
