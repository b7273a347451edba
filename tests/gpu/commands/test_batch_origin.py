"""``batch``: whose result is in the output folder, by the captures and other files of lists in several folders."""

import json
from pathlib import Path

import pytest

from irpso_addon.commands import recover
from tests.builders import command_line as cli_maker
from tests.builders.command_line import run_cli


def two_days(folder):
    """Return two folders with equal lists, of captures that differ in their photographs only."""
    lights = cli_maker.dome_lights(8, widest=70)
    for day, seed in (("day1", 1), ("day2", 2)):
        values = cli_maker.smooth_maps((9, 12), {}, seed=seed)
        (folder / day).mkdir()
        cli_maker.write_card(folder / day / "icon", cli_maker.render_oracle("lambert", values, lights), lights)
        text = '[[job]]\nmodel = "lambert"\niterations = 2\ncapture = "icon"\n'
        (folder / day / "list.toml").write_text(text, encoding="utf-8")
    return folder / "day1", folder / "day2"


def test_equal_lists_of_other_photographs_do_not_share_a_result(tmp_path):
    first, second = two_days(tmp_path)
    out = tmp_path / "out"
    assert run_cli("batch", first / "list.toml", "-o", out)[0] == 0
    kept, state = (out / "icon" / "maps.exr").read_bytes(), (out / "icon.json").read_bytes()
    for _ in range(2):
        code, _, err = run_cli("batch", second / "list.toml", "-o", out)
        assert code == 2 and f"is of {first / 'icon'}; choose another name or -o, or delete {out / 'icon.json'}" in err
        assert json.loads((out / "batch.json").read_text(encoding="utf-8"))["failed"] == ["icon"]
        assert (out / "icon" / "maps.exr").read_bytes() == kept and (out / "icon.json").read_bytes() == state
    assert "icon: done before" in run_cli("batch", first / "list.toml", "-o", out)[1]
    (out / "icon.json").unlink()
    assert run_cli("batch", second / "list.toml", "-o", out)[0] == 0
    assert (out / "icon" / "maps.exr").read_bytes() != kept


@pytest.fixture
def named_results(monkeypatch):
    """Recoveries write the paths of their capture and mesh instead of maps."""

    def write(options):
        folder = Path(options.output)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "report.json").write_text(f"{options.capture} {options.blend}")
        return {}

    monkeypatch.setattr(recover, "run", write)


def batch_of(folder, job, out):
    """Write a list of one job into a folder and run it; return exit code, output and errors."""
    folder.mkdir(exist_ok=True)
    (folder / "list.toml").write_text(f"[[job]]\n{job}\n", encoding="utf-8")
    return run_cli("batch", folder / "list.toml", "-o", out)


def test_lists_whose_captures_have_one_name_do_not_share_a_result(tmp_path, named_results):
    out = tmp_path / "out"
    for name in "ab":
        (tmp_path / name / "icon").mkdir(parents=True)
    assert batch_of(tmp_path, 'capture = "a/icon"', out)[0] == 0
    kept = (out / "icon" / "report.json").read_text()
    code, _, err = batch_of(tmp_path, 'capture = "b/icon"', out)
    assert code == 2 and f"icon: is of {tmp_path / 'a' / 'icon'}; choose another name or -o" in err
    assert (out / "icon" / "report.json").read_text() == kept
    assert "icon: done before" in batch_of(tmp_path, 'capture = "a/icon"', out)[1]
    assert batch_of(tmp_path, 'capture = "a/icon"\nseed = 2', out)[:2] == (0, "icon: starts\n1 of 1 done\n")


@pytest.mark.parametrize(
    ("key", "file"),
    [('blend = "v.blend"', "v.blend"), ('fixed = "normal=n.exr"', "n.exr"), ('model = "m.toml"', "m.toml")],
)
def test_equal_lists_beside_other_files_do_not_share_a_result(tmp_path, named_results, key, file):
    job, out = f'name = "v"\ncapture = "../shared"\n{key}', tmp_path / "out"
    for name in ("shared", "a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).write_text(name)
    assert batch_of(tmp_path / "a", job, out)[0] == 0
    code, _, err = batch_of(tmp_path / "b", job, out)
    assert code == 2 and f"v: is of {tmp_path / 'a' / file}; choose another name or -o" in err
    assert "v: done before" in batch_of(tmp_path / "a", job, out)[1]
    assert batch_of(tmp_path / "a", f"{job}\nseed = 2", out)[:2] == (0, "v: starts\n1 of 1 done\n")
    (tmp_path / "b" / file).write_text("a")  # as if the folder had moved
    assert "v: done before" in batch_of(tmp_path / "b", f"{job}\nseed = 2", out)[1]


def test_the_shader_of_a_model_beside_the_list_belongs_to_it(tmp_path, named_results):
    job, out = 'capture = "../shared"\nmodel = "m.toml"', tmp_path / "out"
    for name in ("shared", "a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "m.toml").write_text("equal")
        (tmp_path / name / "m.glsl").write_text(name)
    assert [batch_of(tmp_path / name, job, out)[0] for name in "aba"] == [0, 2, 0]


@pytest.mark.parametrize("with_output", [True, False])
def test_photographs_that_have_moved_with_their_list_are_the_same(tmp_path, with_output):
    first, _ = two_days(tmp_path)
    out = first / "out"
    assert run_cli("batch", first / "list.toml", "-o", out)[0] == 0
    if with_output:  # its place is enough: the photographs may be gone
        (first / "icon" / "000.exr").unlink()
    else:
        out = out.rename(tmp_path / "out")
    there = first.rename(tmp_path / "elsewhere")
    assert "icon: done before" in run_cli("batch", there / "list.toml", "-o", there / "out" if with_output else out)[1]


def test_a_capture_under_a_rig_is_not_used_for_the_photographs_of_another_list(tmp_path, monkeypatch):
    days, out = two_days(tmp_path), tmp_path / "out"
    monkeypatch.setattr(recover, "run", lambda options: {})
    for day in days:
        assert run_cli("rig", "save", day / "icon", "-o", day / "dome")[0] == 0
        (day / "icon" / "capture.toml").unlink()
        (day / "list.toml").write_text('[[job]]\ncapture = "icon"\nrig = "dome"\n', encoding="utf-8")
    assert run_cli("batch", days[0] / "list.toml", "-o", out)[0] == 0
    code, _, err = run_cli("batch", days[1] / "list.toml", "-o", out)
    assert code == 2 and "icon_capture: may be of other photographs" in err


def test_an_unfinished_job_of_other_photographs_is_kept(tmp_path):
    first, second = two_days(tmp_path)
    out = tmp_path / "out"
    assert run_cli("batch", first / "list.toml", "-o", out)[0] == 0
    state = json.loads((out / "icon.json").read_text(encoding="utf-8"))
    (out / "icon.json").write_text(json.dumps({**state, "state": "begun"}), encoding="utf-8")
    (out / "icon" / "report.json").unlink()
    (out / "icon" / "checkpoint.npz").write_bytes(b"of the first")
    code, _, err = run_cli("batch", second / "list.toml", "-o", out)
    assert code == 2 and f"is of {first / 'icon'}" in err
    assert (out / "icon" / "checkpoint.npz").read_bytes() == b"of the first"
