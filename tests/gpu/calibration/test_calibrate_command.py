"""``irpso calibrate`` with balls, on the command line."""

import pytest

from irpso_addon.capture.read import read_capture
from tests.builders.command_line import run_cli
from tests.builders.near_balls import FOV, write_near_balls
from tests.builders.near_card import DISTANCE


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


def test_the_cards_distance_is_written_and_distance_overrides_it(photographs, tmp_path):
    table = tmp_path / "out" / "capture.toml"
    code, said, _ = calibrate(photographs, tmp_path / "out", "--radius", 10)
    distance = read_capture(table).card_distance
    assert code == 0 and distance == pytest.approx(DISTANCE, rel=0.01)
    assert f"card_distance = {distance:g} written to {table}" in said
    for words, shown in (([], distance), (["--distance", 410], 410)):
        assert f"{shown:g} from its camera" in run_cli("inspect", table, *words)[1]


def test_a_stated_distance_stays_and_the_summary_says_so(photographs, tmp_path):
    calibrate(photographs, tmp_path / "out", "--radius", 10)
    table = tmp_path / "out" / "capture.toml"
    table.write_text("card_distance = 415.0\n" + "\n".join(table.read_text().splitlines()[3:]))
    code, said, _ = run_cli("calibrate", table, *photographs[1], "--radius", 10, "-o", tmp_path / "again")
    assert code == 0 and "the capture's own card_distance or card_width stays" in said
    assert read_capture(tmp_path / "again").card_distance == 415.0
