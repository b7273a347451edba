"""``irpso calibrate`` with balls, on the command line."""

import pytest

from irpso_addon.capture.read import read_capture
from tests.builders.command_line import listing, run_cli
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


def test_replace_replaces_what_a_former_calibration_wrote_and_nothing_else(photographs, tmp_path):
    out = tmp_path / "out"
    assert calibrate(photographs, out, "--radius", 10)[0] == 0
    (out / "mine.jpg").write_bytes(b"a photograph")
    before = listing(out)
    code, _, said = calibrate(photographs, out, "--radius", 20)
    assert code == 2 and "or --replace a former calibration there" in said and listing(out) == before
    near = read_capture(out).lights
    assert calibrate(photographs, out, "--radius", 20, "--replace")[0] == 0
    assert read_capture(out).lights[0].vector == pytest.approx([2 * v for v in near[0].vector], rel=1e-4)
    assert (out / "light_positions.txt").is_file()
    assert calibrate(photographs, out, "--lights", "distant", "--replace")[0] == 0
    lists = ["filenames.txt", "light_directions.txt", "light_intensities.txt"]
    assert sorted(path.name for path in out.iterdir()) == [
        "balls.png", "capture.toml", *lists, "mine.jpg", "report.json"
    ]  # fmt: skip
    assert (out / "mine.jpg").read_bytes() == b"a photograph"


def test_replace_treats_a_table_like_a_folder(photographs, tmp_path):
    table = tmp_path / "new.toml"
    assert calibrate(photographs, table, "--radius", 10)[0] == 0
    code, _, said = calibrate(photographs, table)
    assert code == 2 and "new.toml: exists; choose another name for -o, or --replace a former calibration" in said
    assert calibrate(photographs, table, "--lights", "distant", "--replace")[0] == 0
    assert read_capture(table).lights[0].distant
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new.toml", "new_balls.png", "new_report.json"]


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"capture.toml": "mine"}, "no calibration wrote it, so that --replace does not apply; choose a new folder"),
        ({"photograph.png": "mine"}, "no calibration wrote it, so that --replace does not apply"),
        ({"report.json": '{"files": ["normal.png", "report.json"]}'}, "no calibration wrote it"),
        (
            {"capture.toml": "x", "report.json": '{"files": ["capture.toml", "report.json"]}', "balls.png": "mine"},
            "balls.png: would be replaced, but no calibration wrote it; choose another -o, or move it",
        ),
    ],
)
def test_files_that_no_calibration_wrote_are_not_replaced(photographs, tmp_path, files, words):
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    before = listing(tmp_path)
    code, _, said = calibrate(photographs, tmp_path, "--replace")
    assert code == 2 and words in said and said.count("\n") == 1 and listing(tmp_path) == before


def test_a_former_calibration_stays_if_the_new_one_fails_or_cannot_be_written(photographs, tmp_path, monkeypatch):
    out = tmp_path / "out"
    calibrate(photographs, out)
    before = listing(out)
    assert calibrate(photographs, out, "--replace", "--fov", 200)[0] == 2 and listing(out) == before

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("irpso_addon.calibration.write.os.replace", full)
    code, _, said = calibrate(photographs, out, "--replace")
    assert code == 2 and "cannot be written (No space left on device)" in said and listing(out) == before
