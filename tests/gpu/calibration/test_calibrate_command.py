"""``irpso calibrate`` with balls, on the command line."""

import os
from pathlib import Path

import pytest

from irpso_addon.capture.read import read_capture
from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.write import check_replaces_nothing
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
        ({"capture.toml": "mine"}, "lists no files of a calibration (version 0.1.0 listed none); choose a new folder"),
        ({"photograph.png": "mine"}, "its report.json lists no files of a calibration"),
        ({"report.json": '{"files": ["normal.png", "report.json"]}'}, "lists no files of a calibration"),
        (
            {
                "capture.toml": "x",
                "balls.png": "mine",
                "report.json": '{"calibration_files": ["capture.toml", "report.json"]}',
            },
            "balls.png: would be replaced, but its report lists no such file of a calibration; choose another -o, or",
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

    real = os.replace

    def full(source, target):
        if Path(target).name == last:
            raise OSError(28, "No space left on device")
        real(source, target)

    monkeypatch.setattr("irpso_addon.calibration.write.os.replace", full)
    for last in ("balls.png", "report.json"):  # the first and the last file
        code, _, said = calibrate(photographs, out, "--replace", "--radius", 10)
        assert code == 2 and "cannot be written (No space left on device)" in said
        if last == "balls.png":
            assert listing(out) == before
    monkeypatch.undo()
    assert calibrate(photographs, out, "--replace", "--radius", 10)[0] == 0  # it still lists what it wrote


def test_a_recovery_does_not_replace_a_calibration(photographs, tmp_path):
    assert calibrate(photographs, tmp_path / "out")[0] == 0
    with pytest.raises(InputError, match="no recovery wrote it"):
        check_replaces_nothing(tmp_path / "out", load_model("metallic_roughness"))


def test_a_distance_of_another_unit_is_warned_of(photographs, tmp_path):
    out = tmp_path / "out"
    assert calibrate(photographs, out, "--radius", 10)[0] == 0
    again = out, photographs[1]
    assert "stays, but the table under the balls is" in "".join(calibrate(again, tmp_path / "two", "--radius", 20)[1:])
    assert "stays, but" not in "".join(calibrate(again, tmp_path / "one", "--radius", 10)[1:])
