"""``irpso calibrate`` with balls, on the command line."""

import pytest

from irpso_addon.capture.read import read_capture
from tests.builders.command_line import run_cli
from tests.builders.near_balls import FOV, write_near_balls


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """A folder of photographs of two matte balls under near lamps, and the options that name the balls."""
    folder = tmp_path_factory.mktemp("near balls") / "photographs"
    balls = [word for place in write_near_balls(folder) for word in ("--ball", place)]
    return folder, [*balls, "--kind", "matte", "--fov", FOV]


def calibrate(photographs, out, *options):
    """Run ``calibrate`` on the photographs; return its exit code, output and errors."""
    return run_cli("calibrate", photographs[0], *photographs[1], "-o", out, *options)


def test_the_lamps_distance_has_two_spellings_of_which_messages_use_the_first(photographs, tmp_path):
    lights = []
    for name in ("--lamp-distance", "--distance"):
        code, said, _ = calibrate(photographs, tmp_path / name[2:], "--radius", 10, name, 160)
        assert code == 0 and "near, 160 from the balls, by --lamp-distance" in said
        lights.append(read_capture(tmp_path / name[2:]).lights)
    assert lights[0] == lights[1]
    code, _, said = calibrate(photographs, tmp_path / "none", "--radius", 10, "--distance", -1)
    assert code == 2 and "--lamp-distance -1: give a number above 0" in said
