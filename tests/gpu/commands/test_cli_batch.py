"""``batch``: several recoveries from a list, stopped and started again."""

import json
import os
import signal

import numpy as np
import pytest

from irpso_addon.capture.images.exr import read_exr
from irpso_addon.cli import build_parser
from irpso_addon.commands import batch, recover
from irpso_addon.pipeline.lock import locked_folder
from irpso_addon.solver.views.history import History
from tests.builders import command_line as cli_maker
from tests.builders.command_line import run_cli

LIST = """
[defaults]
model = "lambert"
preset = "swarm"
iterations = 60
entry = "fragment"

[[job]]
capture = "first"
seed = 3

[[job]]
name = "none"
capture = "not there"

[[job]]
capture = "second"
set = ["particles=20", "loss=l1"]
"""


@pytest.fixture
def listed(tmp_path):
    """Return a folder with a list of three jobs, the second of which has no capture."""
    lights = cli_maker.dome_lights(8, widest=70)
    for name, seed in (("first", 1), ("second", 2)):
        values = cli_maker.smooth_maps((9, 12), {}, seed=seed)
        cli_maker.write_card(tmp_path / name, cli_maker.render_oracle("lambert", values, lights), lights)
    (tmp_path / "list.toml").write_text(LIST, encoding="utf-8")
    return tmp_path


def maps_of(folder):
    return {name: np.stack(list(part.values())) for name, part in read_exr(folder / "maps.exr").items()}


def test_a_batch_writes_its_recoveries_and_one_report_and_skips_finished_jobs(listed, monkeypatch):
    out = listed / "out"
    code, _, err = run_cli("batch", listed / "list.toml", "-o", out)
    assert code == 2 and "irpso: job 'none' failed: " in err and "not there" in err
    report = json.loads((out / "batch.json").read_text(encoding="utf-8"))
    assert [job["state"] for job in report["jobs"]] == ["done", "failed", "done"] and report["failed"] == ["none"]
    for name, options in (("first", ["--seed", "3"]), ("second", ["--set", "particles=20", "--set", "loss=l1"])):
        alone = listed / f"{name} alone"
        common = ["--model", "lambert", "--preset", "swarm", "--iterations", "60", "--entry", "fragment", "--quiet"]
        assert run_cli("recover", listed / name, *common, *options, "-o", alone)[0] == 0
        for part, values in maps_of(alone).items():
            np.testing.assert_array_equal(maps_of(out / name)[part], values)
    begun = []
    kept, run = (out / "first" / "maps.exr").stat().st_mtime_ns, recover.run
    monkeypatch.setattr(recover, "run", lambda options: begun.append(options.output) or run(options))
    assert run_cli("batch", listed / "list.toml", "-o", out, "--json")[0] == 2
    assert begun == [str(out / "none")] and (out / "first" / "maps.exr").stat().st_mtime_ns == kept


@pytest.mark.parametrize("late", [True, False])
def test_a_signal_at_the_end_of_a_job_ends_the_batch_and_keeps_the_job(listed, monkeypatch, late):
    """In the last iterations of the search, and while the result is written."""
    where, name = (recover, "write_maps") if late else (History, "record_due")
    out, real = listed / "out", getattr(where, name)

    def signalled(*words):
        if late or words[0]._recovery.progress.done:
            os.kill(os.getpid(), signal.SIGINT)
        return real(*words)

    monkeypatch.setattr(where, name, signalled)
    code, _, err = run_cli("batch", listed / "list.toml", "-o", out, "--quiet")
    assert code == 130 and "start the batch again" in err and not (out / "second").exists()
    monkeypatch.setattr(where, name, real)
    assert "first: done before" in run_cli("batch", listed / "list.toml", "-o", out)[1]


def test_a_job_with_changed_options_or_a_missing_result_runs_again(listed, monkeypatch):
    out, begun = listed / "out", []
    result = {"texels": 1}

    def fake(options):
        begun.append((options.output.rsplit("/", 1)[-1], options.resume))
        (out / begun[-1][0]).mkdir(parents=True, exist_ok=True)
        (out / begun[-1][0] / "report.json").write_text("{}")
        return result

    monkeypatch.setattr(recover, "run", fake)
    arguments = ["batch", listed / "list.toml", "-o", out, "--quiet"]
    assert run_cli(*arguments)[0] == 0 and begun == [("first", False), ("none", False), ("second", False)]
    (listed / "list.toml").write_text(LIST.replace("seed = 3", "seed = 4"), encoding="utf-8")
    (out / "none" / "report.json").unlink()
    begun.clear()
    assert run_cli(*arguments)[0] == 0 and begun == [("first", False), ("none", False)]
    # What was stopped in its middle goes on from its checkpoint, but not from one of other options.
    state = json.loads((out / "second.json").read_text(encoding="utf-8"))
    (out / "second.json").write_text(json.dumps({**state, "state": "begun"}), encoding="utf-8")
    (out / "second" / "checkpoint.npz").touch()
    (out / "first" / "checkpoint.npz").touch()
    (listed / "list.toml").write_text(LIST, encoding="utf-8")
    begun.clear()
    assert run_cli(*arguments)[0] == 0 and begun == [("first", False), ("second", True)]
    begun.clear()
    (out / "second.json").write_text("{", encoding="utf-8")
    assert run_cli(*arguments, "--only", "second")[0] == 0 and begun == [("second", False)]


def test_a_job_with_a_former_name_of_a_setting_fails_with_the_present_one(listed):
    (listed / "list.toml").write_text(LIST.replace("particles=20", "seeded=0.5"), encoding="utf-8")
    code, _, err = run_cli("batch", listed / "list.toml", "-o", listed / "out", "--only", "second")
    assert code == 2 and err.count("\n") == 1
    assert "job 'second' failed: " in err and "there is no setting 'seeded'; it is 'start_fraction' now" in err


@pytest.mark.parametrize("begun", [True, False])
def test_a_useless_checkpoint_does_not_block_its_job(listed, begun):
    out, (job, *_) = listed / "out", batch.read_list(listed / "list.toml", build_parser().parse_args)
    (out / "first").mkdir(parents=True)
    (out / "first" / "checkpoint.npz").write_bytes(b"cut off in its middle")
    (out / "first" / "checkpoint.damaged.npz").write_bytes(b"an earlier one")
    if begun:
        (out / "first.json").write_text(json.dumps({"words": job.listed, "state": "begun"}), encoding="utf-8")
    code, message, _ = run_cli("batch", listed / "list.toml", "-o", out, "--only", "first")
    assert code == 0 and f"first: {'continues' if begun else 'starts'}" in message
    assert "starts again" in message and "it is checkpoint.damaged_1.npz now" in message
    assert (out / "first" / "maps.exr").is_file() and not (out / "first" / "checkpoint.npz").exists()
    assert (out / "first" / "checkpoint.damaged_1.npz").read_bytes() == b"cut off in its middle"
    assert (out / "first" / "checkpoint.damaged.npz").read_bytes() == b"an earlier one"


def test_a_second_batch_into_a_folder_is_refused(listed):
    with locked_folder(listed / "out"):
        code, _, err = run_cli("batch", listed / "list.toml", "-o", listed / "out")
    assert code == 2 and err.count("\n") == 1 and "another process writes its result there now" in err
    assert not (listed / "out").exists()


@pytest.mark.parametrize("name", ["first.json", "second.json", "batch.json"])
@pytest.mark.parametrize("text", ['{"mine": 1}', "[1, 2]", "// a note\n{}", '{"name": "first", "state": 3}'])
def test_a_users_file_with_the_name_of_a_state_file_is_not_replaced(listed, monkeypatch, name, text):
    monkeypatch.setattr(recover, "run", lambda options: pytest.fail("a job has begun"))
    out = listed / "out"
    out.mkdir()
    (out / name).write_text(text, encoding="utf-8")
    code, _, err = run_cli("batch", listed / "list.toml", "-o", out)
    assert code == 2 and err.count("\n") == 1 and f"{out / name}: would be replaced" in err
    assert [path.name for path in out.iterdir()] == [name] and (out / name).read_text(encoding="utf-8") == text


def test_a_renamed_or_moved_list_has_the_same_jobs(listed, monkeypatch):
    out = listed / "out"
    assert run_cli("batch", listed / "list.toml", "-o", out, "--only", "first", "--quiet")[0] == 0
    monkeypatch.chdir(listed)
    assert "first: done before" in run_cli("batch", "list.toml", "-o", "out", "--only", "first")[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "lists no job"),
        ("[[job]]\nseed = 1", "has no capture"),
        ('[[job]]\ncapture = "a"\n[[job]]\ncapture = "b/A"', "called 'a'"),
        ('[[job]]\ncapture = "Batch"', "job Batch: would write batch.json, as batch itself does"),
        ('[[job]]\ncapture = "A"\nrig = "r"\n[[job]]\ncapture = "a_Capture"', "would write a_capture, as job A does"),
        ('[[job]]\ncapture = "a"\n[[job]]\nname = "A.json"\ncapture = "b"', "would write a.json, as job a does"),
        ('[[job]]\ncapture = "a"\nwrong = 1', "unrecognized arguments"),
        ('[[job]]\ncapture = "a"\niteration = 5', "unrecognized arguments"),
        ('[[job]]\ncapture = "a"\nheigth = false', "unrecognized arguments"),
        ('[[job]]\ncapture = "a"\nseed = "x"', "--seed"),
        ('[[job]]\ncapture = "a"\nname = "../b"', "name"),
        ('[[job]]\ncapture = "a"\nresume = true', "resume is not an option of jobs"),
        ('jobs = 1\n[[job]]\ncapture = "a"', "[[job]]"),
        ("[[job]\n", "is not valid TOML"),
    ],
)
def test_an_invalid_list_is_reported_before_any_job_runs(text, message, tmp_path):
    path = tmp_path / "list.toml"
    path.write_text(text, encoding="utf-8")
    code, _, err = run_cli("batch", path, "-o", tmp_path / "out")
    assert code == 2 and err.count("\n") == 1 and str(path) in err and message in err
    assert not (tmp_path / "out").exists()


def test_a_file_in_place_of_the_batchs_folder_is_named(listed):
    (listed / "out").write_text("mine", encoding="utf-8")
    code, _, err = run_cli("batch", listed / "list.toml", "-o", listed / "out")
    assert code == 2 and err.count("\n") == 1 and f"{listed / 'out'}: is a file, so nothing can be written" in err
    assert (listed / "out").read_text(encoding="utf-8") == "mine"


def test_an_unknown_job_name_is_refused(listed):
    code, _, err = run_cli("batch", listed / "list.toml", "-o", listed / "out", "--only", "third")
    assert code == 2 and "first, none, second" in err


def test_mesh_defaults_do_not_apply_to_cards(tmp_path):
    text = '[defaults]\nresolution = 64\n[[job]]\ncapture = "a"\n[[job]]\ncapture = "b"\nblend = "b.blend"\n'
    (tmp_path / "list.toml").write_text(text, encoding="utf-8")
    card, mesh = batch.read_list(tmp_path / "list.toml", build_parser().parse_args)
    assert "--resolution" not in card.words and "--resolution" in mesh.words
    text = '[defaults]\nblend = "b.blend"\nresolution = 64\ncrop = "1,2,3,4"\n[[job]]\ncapture = "a"\nblend = false\n'
    (tmp_path / "list.toml").write_text(text, encoding="utf-8")
    (card,) = batch.read_list(tmp_path / "list.toml", build_parser().parse_args)
    assert "--resolution" not in card.words and "--crop" in card.words and "--blend" not in card.words


def test_a_job_without_a_name_has_that_of_its_captures_folder(tmp_path):
    names = {
        "vase/capture.toml": "vase", "cup/capture.toml": "cup", "tile.1": "tile.1", "tile.2/": "tile.2",
        "dome/filenames.txt": "dome", "b/turned.toml": "turned", "b/scan.2.lp": "scan.2", "b/Room.blend": "Room",
        ".": tmp_path.name, "x/../y": "y",
    }  # fmt: skip
    text = "".join(f'[[job]]\ncapture = "{capture}"\n' for capture in names)
    (tmp_path / "list.toml").write_text(text, encoding="utf-8")
    jobs = batch.read_list(tmp_path / "list.toml", build_parser().parse_args)
    assert [job.name for job in jobs] == list(names.values())


@pytest.mark.parametrize("only", ["first", "capture", None])
def test_a_result_under_the_default_name_of_a_former_version_is_continued(listed, monkeypatch, only):
    text = '[[job]]\ncapture = "first/capture.toml"\n[[job]]\ncapture = "second/capture.toml"\n'
    (listed / "list.toml").write_text(text, encoding="utf-8")
    out, begun = listed / "out", []
    monkeypatch.setattr(recover, "run", lambda options: begun.append(options.output) or {})
    (job, other) = batch.read_list(listed / "list.toml", build_parser().parse_args)
    (out / "capture").mkdir(parents=True)
    (out / "capture" / "report.json").write_text("{}")
    state = {"name": "capture", "words": list(job.listed), "state": "done"}
    (out / "capture.json").write_text(json.dumps(state), encoding="utf-8")
    code, message, _ = run_cli("batch", listed / "list.toml", "-o", out, *(["--only", only] if only else []))
    assert code == 0 and "capture: done before" in message
    assert begun == ([] if only else [str(out / "second")]) and other.name == "second"
    # It is not the result of a job that has the name now, nor of other options.
    (listed / "list.toml").write_text(text.replace("second/capture.toml", "other/capture"), encoding="utf-8")
    begun.clear()
    run_cli("batch", listed / "list.toml", "-o", out)
    assert begun == [str(out / "first"), str(out / "capture")]


def words_of(folder, *lines, head=""):
    text = f'{head}[[job]]\ncapture = "a"\n' + "\n".join(lines)
    (folder / "list.toml").write_text(text, encoding="utf-8")
    (job,) = batch.read_list(folder / "list.toml", build_parser().parse_args)
    return list(job.words[2:-2])


def test_a_list_of_values_is_one_option_unless_it_may_be_repeated(tmp_path):
    assert words_of(tmp_path, "hold_out = [3, 11]") == ["--hold-out", "3,11"]
    assert words_of(tmp_path, "crop = [-2, 0, 10, 10]") == ["--crop=-2,0,10,10"]
    assert words_of(tmp_path, 'tag = ["a", "b"]') == ["--tag", "a", "--tag", "b"]


def test_false_switches_off_what_is_on(tmp_path):
    assert words_of(tmp_path, "shadows = false", "height = false") == ["--no-shadows"]
    defaults = '[defaults]\nhold_out = "auto"\nno_shadows = true\nauthor = "me"\n'
    assert words_of(tmp_path, 'blend = "b.blend"', "hold_out = false", "shadows = true", head=defaults)[2:] == []
    assert words_of(tmp_path, "shadows = true", "height = true", "preview = false") == ["--height", "--no-preview"]


def test_paths_are_relative_to_the_list(listed):
    jobs = batch.read_list(listed / "list.toml", build_parser().parse_args)
    assert jobs[0].words[:2] == ("recover", str(listed / "first"))
    text = '[[job]]\ncapture = "a"\nmodel = "own.toml"\nfixed = ["normal=given.exr", "roughness=0.5"]\nasset = "lib"'
    (listed / "other.toml").write_text(text, encoding="utf-8")
    (other,) = batch.read_list(listed / "other.toml", build_parser().parse_args)
    assert {str(listed / "own.toml"), f"normal={listed / 'given.exr'}", "roughness=0.5"} <= set(other.words)
    assert str(listed / "lib") in other.words
    assert words_of(listed, 'fixed = ["normal=0, 0,1", "a = n.exr"]') == [
        "--fixed", "normal=0, 0,1", "--fixed", f"a ={listed / 'n.exr'}"
    ]  # fmt: skip
    udim = f"normal={listed / 'n.<UDIM>.exr'}"
    assert words_of(listed, 'fixed = "normal=n.<UDIM>.exr"') == ["--fixed", udim]
    assert jobs[2].words.count("--set") == 2 and jobs[0].words[-2:] == ("--checkpoint-every", "60")


def test_a_job_with_a_rig_reads_photographs_under_its_lamps(listed, monkeypatch):
    common = ["--model", "lambert", "--preset", "swarm", "--iterations", "60", "--entry", "fragment", "--quiet"]
    assert run_cli("recover", listed / "second", *common, "-o", listed / "alone")[0] == 0
    assert run_cli("rig", "save", listed / "first", "-o", listed / "dome")[0] == 0
    (listed / "second" / "capture.toml").unlink()  # photographs without lights
    text = LIST.partition("[[job]]")[0] + '[[job]]\nname = "one"\ncapture = "second"\nrig = "dome"\n'
    (listed / "rigged.toml").write_text(text, encoding="utf-8")
    assert run_cli("batch", listed / "rigged.toml", "-o", listed / "out")[0] == 0
    assert (listed / "out" / "one_capture" / "capture.toml").is_file()
    for part, values in maps_of(listed / "alone").items():
        np.testing.assert_array_equal(maps_of(listed / "out" / "one")[part], values)
    begun = []
    monkeypatch.setattr(recover, "run", lambda options: begun.append(options.capture) or {})
    (listed / "rigged.toml").write_text(text + "seed = 2\n", encoding="utf-8")
    assert run_cli("batch", listed / "rigged.toml", "-o", listed / "out")[0] == 0 and len(begun) == 1
    # Other photographs: the capture is not theirs.
    (listed / "rigged.toml").write_text(text.replace('capture = "second"', 'capture = "first"'), encoding="utf-8")
    for _ in range(2):
        code, _, err = run_cli("batch", listed / "rigged.toml", "-o", listed / "out")
        assert code == 2 and "one_capture: may be of other photographs" in err and len(begun) == 1
    # Nor are those known of which the state is gone.
    (listed / "rigged.toml").write_text(text, encoding="utf-8")
    (listed / "out" / "one.json").unlink()
    code, _, err = run_cli("batch", listed / "rigged.toml", "-o", listed / "out")
    assert code == 2 and "one_capture: may be of other photographs" in err and len(begun) == 1


def test_a_fault_of_the_program_in_one_job_does_not_stop_the_others(listed, monkeypatch):
    def failing(options):
        raise ZeroDivisionError("unforeseen")

    monkeypatch.setattr(recover, "run", failing)
    code, _, err = run_cli("batch", listed / "list.toml", "-o", listed / "out")
    assert code == 2 and err.count("ZeroDivisionError: unforeseen") >= 2


def test_a_list_can_leave_the_preview_out():
    from irpso_addon.commands.batch import _words

    assert _words("preview", False, None) == ["--no-preview"] and _words("preview", True, None) == ["--preview"]
