"""``calibrate --ball none``: lights of a subject from itself, through the public command."""

import json

import numpy as np
import pytest

from irpso_addon.capture.read import read_capture
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
    found = [shot.light for shot in read_capture(tmp_path / "out").observations]
    off = angle(np.array([light.vector for light in found]), directions)
    power = np.array([light.intensity for light in found]).mean(axis=-1) / strengths
    print(f"lights off by {off.mean():.2f}°, strengths by {np.std(np.log(power)):.1%}")
    assert off.mean() < 2.5
    assert np.std(np.log(power)) < 0.05
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["kind"] == "shading"
    assert report["warnings"] == []


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--kind", "mirror"], "--kind: is of balls"),
        (["--radius", "2"], "--radius: is of balls"),
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
    assert "--inside-out: goes with --ball none" in err


def test_a_flat_subject_is_refused(tmp_path):
    directions, _ = lamps(16)
    values = cli_maker.smooth_maps((40, 40), {}, seed=2) | {"normal": np.broadcast_to((0.0, 0.0, 1.0), (40, 40, 3))}
    images = cli_maker.render_oracle("lambert", values, directions)
    folder = cli_maker.write_card(tmp_path / "flat", images, directions)
    code, _, err = run_cli("calibrate", folder, "--ball", "none", "-o", tmp_path / "out", "--quiet")
    assert (code, err.count("\n")) == (2, 1)
    assert "put a ball" in err
    assert not (tmp_path / "out").exists()
