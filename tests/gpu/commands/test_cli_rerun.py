"""``recover`` interrupted, resumed and run again, its live picture and its preview."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from irpso_addon.blender import images as blender_images
from irpso_addon.cluster.transport import Ranks
from irpso_addon.solver.state import checkpoint
from tests.builders import command_line as cli_maker
from tests.builders.command_line import angle, read_map, run_cli
from tests.builders.recovered import FILES, OTHERS, SHAPE, recovered_models

ROOT = Path(__file__).resolve().parents[3]
recovered = pytest.fixture(recovered_models, scope="module")


def test_running_again_into_a_folder_updates_it_and_leaves_the_users_files(recovered, tmp_path):
    _, out, _ = recovered("principled")
    capture = recovered("lambert")[1].parent / "lambert"
    folder = tmp_path / "out"
    shutil.copytree(out, folder)
    (folder / "notes.txt").write_text("of the user")
    code, _, _ = run_cli("recover", capture, "--model", "lambert", "--iterations", 20, "-o", folder, "--quiet")
    assert code == 0
    pictures = {f"{stem}.{kind}" for stem in FILES["lambert"] for kind in ("png", "exr")}
    assert {path.name for path in folder.iterdir()} == pictures | OTHERS | {"notes.txt"}
    assert json.loads((folder / "report.json").read_text(encoding="utf-8"))["model"] == "lambert"


def test_an_interrupted_recovery_resumes_to_the_same_maps_bit_for_bit(recovered, tmp_path):
    _, out, _ = recovered("principled")
    capture = out.parent / "principled"
    options = ["recover", capture, "--iterations", "1200", "--seed", "9"]
    folder = tmp_path / "out"

    def interrupted(number, *more):
        command = [sys.executable, "-m", "irpso_addon", *map(str, (*options, *more, "-o", folder))]
        process = subprocess.Popen(
            command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])},
        )  # fmt: skip
        percents = []
        for line in process.stderr:
            if found := re.match(r"recover \[.*\] +(\d+) %", line):
                percents.append(int(found[1]))
                if percents[-1] >= 10:
                    process.send_signal(number)
                    break
        rest = process.stderr.read()
        assert process.wait(60) == 130
        assert [path.name for path in folder.iterdir()] == ["checkpoint.npz"]
        assert f"{folder / 'checkpoint.npz'} holds the run so far, go on with --resume" in rest
        return percents[0]

    assert interrupted(signal.SIGINT) == 0
    assert interrupted(signal.SIGTERM, "--resume") >= 10, "it began anew"
    assert run_cli(*options, "--resume", "--quiet", "-o", folder)[0] == 0
    assert not (folder / "checkpoint.npz").exists()
    assert run_cli(*options, "--quiet", "-o", tmp_path / "whole")[0] == 0
    names = {path.name for path in folder.iterdir()}
    assert names == {path.name for path in (tmp_path / "whole").iterdir()}
    for name in names - {"report.json", "material.blend"}:
        assert (folder / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def live_pictures(monkeypatch, read):
    """Return a list that gets what ``read`` returns of the file of every live picture of a run."""
    from irpso_addon.pipeline import live

    show, seen = live.LivePicture.show, []

    def shown(self, maps):
        show(self, maps)
        seen.append(read(self._path))

    monkeypatch.setattr(live.LivePicture, "show", shown)
    return seen


def test_a_live_picture_shows_the_current_maps_until_the_result_exists(recovered, tmp_path, monkeypatch):
    _, out, _ = recovered("lambert")
    folder = tmp_path / "out"
    seen = live_pictures(monkeypatch, lambda path: blender_images.decode(path).values[..., :3])
    options = ["recover", out.parent / "lambert", "--model", "lambert", "--iterations", 120, "--json", "-o", folder]
    assert run_cli(*options, "--live")[0] == 0
    assert len(seen) >= 40 and not (folder / "live.png").exists()
    # Base colour, normal and residual side by side, whose texels have become what the finished maps hold.
    found = blender_images.decode(folder / "base_color.png").values[..., :3]
    assert seen[0].shape == seen[-1].shape and seen[0].shape[1] > 3 * found.shape[1]
    assert np.abs(seen[-1] - seen[0]).max() > 0.1
    colours = {tuple(np.rint(255 * c)) for c in found.reshape(-1, 3)}
    shown_colours = {tuple(np.rint(255 * c)) for c in seen[-1].reshape(-1, 3)}
    assert len(colours & shown_colours) > 0.9 * len(colours)


def test_a_preview_has_a_quarter_of_the_size_and_changes_nothing(recovered, tmp_path):
    _, out, _ = recovered("lambert")
    options = ["recover", out.parent / "lambert", "--model", "lambert", "--iterations", 40]
    code, _, err = run_cli(*options, "--preview", "-o", tmp_path / "with")
    assert code == 0 and re.search(r"preview of 1/4: .*preview; at this speed the whole takes", err)
    assert run_cli(*options, "--quiet", "-o", tmp_path / "without")[0] == 0
    assert not (tmp_path / "without" / "preview").exists()
    large, same = (read_map(tmp_path / name / "normal.exr") for name in ("with", "without"))
    small = read_map(tmp_path / "with" / "preview" / "normal.exr")
    np.testing.assert_array_equal(large, same)
    assert small.shape == (4, 6, 3)
    rows, columns = (((np.arange(n) + 0.5) * side / n).astype(int) for n, side in zip((4, 6), SHAPE, strict=True))
    assert np.median(angle(small, large[rows][:, columns])) < 5
    assert not list((tmp_path / "with" / "preview").glob("checkpoint*"))
    page = ["export", tmp_path / "with" / "preview", "--format", "web", "--photographs", 2, "-o", tmp_path / "page"]
    assert run_cli(*page)[0] == 0
    (tmp_path / "with" / "preview" / "notes.txt").write_text("mine")
    assert run_cli(*options, "--quiet", "-o", tmp_path / "with" / "preview" / "preview")[0] == 0
    assert run_cli(*options, "--quiet", "-o", tmp_path / "with")[0] == 0
    left = tmp_path / "with" / "preview"
    assert sorted(path.name for path in left.iterdir()) == ["notes.txt", "preview"], "a former run's preview is gone"
    assert (left / "preview" / "normal.exr").is_file()


def test_a_preview_that_cannot_be_is_refused(recovered, tmp_path, monkeypatch):
    _, out, _ = recovered("lambert")
    options = ["recover", out.parent / "lambert", "--model", "lambert", "--preview", "-o", tmp_path / "out"]
    code, _, err = run_cli(*options, "--fixed", f"base_color={out / 'base_color.exr'}")
    assert code == 2 and "--preview: a map of --fixed has the full size" in err
    monkeypatch.setattr("irpso_addon.commands.recover.joined", Ranks)  # as under mpirun
    code, _, err = run_cli(*options)
    assert code == 2 and "--preview: a run over ranks writes no preview" in err
    assert not (tmp_path / "out").exists()


def test_a_live_picture_replaces_none_of_the_users(recovered, tmp_path):
    _, out, _ = recovered("lambert")
    mine = tmp_path / "live.png"
    mine.write_bytes(b"mine")
    words = ["recover", out.parent / "lambert", "--model", "lambert", "--live", "-o", tmp_path]
    code, _, err = run_cli(*words)
    assert code == 2 and "live.png: would be replaced by --live" in err
    assert run_cli(*words, "--dry-run")[0] == 0 and mine.read_bytes() == b"mine"
    checkpoint.write(tmp_path / "checkpoint.npz", {}, checkpoint.Checkpoint(0, 1, 1, {}))  # of an interrupted run
    assert run_cli(*words, "--iterations", 1, "--quiet")[0] == 0 and not mine.exists()


def test_a_live_picture_of_a_killed_run_without_a_checkpoint_is_replaced(recovered, tmp_path, monkeypatch):
    _, out, _ = recovered("lambert")
    folder, pictures = tmp_path / "out", live_pictures(monkeypatch, Path.read_bytes)
    words = ["recover", out.parent / "lambert", "--model", "lambert", "--live", "--iterations", 1, "--quiet"]
    assert run_cli(*words, "-o", folder)[0] == 0
    left = tmp_path / "next" / "live.png"
    left.parent.mkdir()
    left.write_bytes(pictures[0])
    with Image.open(left) as picture:
        assert picture.text == {"Software": "irpso recover --live"}
        picture.save(tmp_path / "edited.png")
    assert run_cli(*words, "-o", left.parent)[0] == 0 and not left.exists()
    left.write_bytes((tmp_path / "edited.png").read_bytes())
    assert run_cli(*words, "-o", left.parent)[0] == 2 and left.exists()


def test_a_live_picture_that_cannot_be_written_does_not_stop_the_run(recovered, tmp_path, monkeypatch):
    from irpso_addon.core.errors import InputError
    from irpso_addon.pipeline import live

    def full(path, *_, **__):
        raise InputError(f"{path}: cannot be written (No space left on device); choose another place")

    monkeypatch.setattr(live, "encode_png", full)
    _, out, _ = recovered("lambert")
    options = ["recover", out.parent / "lambert", "--model", "lambert", "--iterations", 40, "--json"]
    code, answer, err = run_cli(*options, "--live", "-o", tmp_path / "out")
    assert code == 0 and err.count("live.png: cannot be written") == 1
    assert sum("live.png" in text for text in json.loads(answer.splitlines()[-1])["warnings"]) == 1


def test_an_interrupt_before_the_first_iteration_leaves_nothing(recovered, tmp_path, monkeypatch):
    from irpso_addon.pipeline import run

    _, out, _ = recovered("lambert")
    monkeypatch.setattr(run, "card_steps", lambda *_, **__: signal.raise_signal(signal.SIGINT))
    code, answer, err = run_cli("recover", out.parent / "lambert", "-o", tmp_path / "out")
    assert (code, answer, err.strip().splitlines()[-1]) == (130, "", "irpso: interrupted")
    assert not list(tmp_path.iterdir())


def test_a_checkpoint_of_other_settings_is_refused_by_what_differs(recovered, tmp_path):
    from irpso_addon.solver.engine.recovery import Recovery

    _, out, _ = recovered("lambert")
    folder = tmp_path / "out"
    options = ["recover", out.parent / "lambert", "--model", "lambert", "--iterations", 40, "-o", folder, "--quiet"]
    step = Recovery.step

    def stopped(self, *_):
        signal.raise_signal(signal.SIGINT)
        return step(self, 1)

    Recovery.step = stopped
    try:
        assert run_cli(*options)[0] == 130
    finally:
        Recovery.step = step
    before = cli_maker.listing(folder)
    assert set(before) == {"checkpoint.npz"}
    code, _, err = run_cli(*options, "--resume", "--seed", 3)
    assert (code, cli_maker.listing(folder)) == (2, before)
    assert err.count("\n") == 1 and "checkpoint.npz: is of another recovery: seed differ" in err
