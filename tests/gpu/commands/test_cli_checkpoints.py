"""Runs that are killed, and checkpoints that cannot be written: nothing is lost but what came after the last one."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from irpso_addon.capture.images.exr import read_exr
from irpso_addon.commands import recover
from irpso_addon.core.errors import InputError
from irpso_addon.core.files import replacing_file
from irpso_addon.pipeline import drive
from irpso_addon.solver.engine.engine import Capabilities
from irpso_addon.solver.engine.progress import Progress
from irpso_addon.solver.state import checkpoint
from tests.builders import command_line as cli_maker
from tests.builders.command_line import run_cli

ROOT = Path(__file__).resolve().parents[3]
OPTIONS = ["--model", "lambert", "--preset", "swarm", "--iterations", "400", "--seed", "3", "--entry", "fragment"]


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("killed")
    lights = cli_maker.dome_lights(12, widest=70)
    values = cli_maker.smooth_maps((20, 24), {}, seed=2)
    return cli_maker.write_card(folder / "card", cli_maker.render_oracle("lambert", values, lights), lights)


def all_maps(folder):
    return {name: np.stack(list(part.values())) for name, part in read_exr(folder / "maps.exr").items()}


def start(capture, out, *more):
    command = [sys.executable, "-m", "irpso_addon", "recover", capture, *OPTIONS, "--checkpoint-every", "0", "--quiet",
               "-o", out, *more]  # fmt: skip
    return subprocess.Popen([str(word) for word in command], cwd=ROOT, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("option", ["--preview", "--no-preview"])
def test_a_resumed_run_keeps_its_own_preview_and_no_older_one(capture, tmp_path, option):
    out, checkpoint = tmp_path / "out", tmp_path / "out" / "checkpoint.npz"
    assert run_cli("recover", capture, *OPTIONS, "--preview", "--quiet", "-o", out)[0] == 0
    run = start(capture, out, option)
    deadline = time.monotonic() + 100
    while not checkpoint.exists():
        assert run.poll() is None and time.monotonic() < deadline, run.stderr.read()
        time.sleep(0.002)
    run.kill()
    run.wait()
    assert run_cli("recover", capture, *OPTIONS, "--resume", "--quiet", "-o", out)[0] == 0
    assert (out / "preview").exists() == (option == "--preview")


def test_a_run_killed_repeatedly_gives_the_same_maps_bit_for_bit(capture, tmp_path):
    assert run_cli("recover", capture, *OPTIONS, "--quiet", "-o", tmp_path / "whole")[0] == 0
    out, checkpoint = tmp_path / "out", tmp_path / "out" / "checkpoint.npz"
    chosen = random.Random(4)
    for killed in range(3):
        run = start(capture, out, *(["--resume"] if killed else []))
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        deadline = time.monotonic() + 100
        while not (checkpoint.exists() and checkpoint.stat().st_mtime_ns > before):
            assert run.poll() is None and time.monotonic() < deadline, run.stderr.read()
            time.sleep(0.002)
        time.sleep(chosen.uniform(0, 0.05))
        run.send_signal(signal.SIGKILL)
        run.communicate()
        assert not (out / "maps.exr").exists()
    assert run_cli("recover", capture, *OPTIONS, "--quiet", "--resume", "-o", out)[0] == 0
    whole, resumed = all_maps(tmp_path / "whole"), all_maps(out)
    assert set(whole) == set(resumed)
    for name, values in whole.items():
        np.testing.assert_array_equal(resumed[name], values)
    assert {path.name for path in out.iterdir()} == {path.name for path in (tmp_path / "whole").iterdir()}


@pytest.mark.parametrize("step", ["pictures_of", "write_maps", "make_material"])
def test_a_signal_while_the_result_is_written_loses_nothing(capture, tmp_path, monkeypatch, step):
    real = getattr(recover, step)
    monkeypatch.setattr(recover, step, lambda *words: (os.kill(os.getpid(), signal.SIGINT), real(*words))[1])
    code, said, _ = run_cli("recover", capture, *OPTIONS[:4], "--iterations", 3, "--json", "-o", tmp_path / "out")
    assert code == 0 and json.loads(said)["interrupted"]
    assert {"report.json", "normal.png", "material.blend"} <= {path.name for path in (tmp_path / "out").iterdir()}


def test_a_resumed_run_keeps_its_kind_of_pass(capture, tmp_path):
    out = tmp_path / "out"
    run = start(capture, out, "--entry", "compute")
    deadline = time.monotonic() + 100
    while not (out / "checkpoint.npz").exists():
        assert run.poll() is None and time.monotonic() < deadline
        time.sleep(0.002)
    run.send_signal(signal.SIGKILL)
    run.communicate()
    code, answer, err = run_cli("recover", capture, *OPTIONS[:-2], "--json", "--resume", "-o", out)
    assert (code, err) == (0, "")
    assert json.loads((out / "report.json").read_text(encoding="utf-8"))["settings"]["entry"] == "compute"


class FullDisk:
    """A recovery of five iterations whose checkpoints find no room."""

    capabilities = Capabilities("none", reconfigure=False)
    settled = True

    def __init__(self, fails):
        self.saved, self._fails = 0, fails
        self.progress = Progress(
            stage=0, stages=1, title="", iteration=0, iterations=5, iteration_in_all=0, iterations_in_all=5,
            fraction=0.0, stage_end=1.0, evaluations=0, done=False,
        )  # fmt: skip
        self._made = 0

    def step(self, iterations=None, time_budget_s=None):
        self._made += 1
        self.progress = replace(self.progress, done=self._made == 5)
        return self.progress

    def save(self, path, extra_arrays, running=None):
        self.saved += 1
        if self._fails:
            with replacing_file(path):
                raise OSError(28, "No space left on device")
        return True


class NoHistory:
    arrays = MappingProxyType({})

    def until_next(self, most):
        return 1

    def record_due(self):
        pass

    def take(self, arrays):
        assert not arrays


def test_the_seconds_of_a_run_sum_over_its_resumes(tmp_path):
    class GoneOnWith(FullDisk):
        def load(self, path):
            return {"seconds": np.array(700.0)}

        def save(self, path, extra_arrays, running=None):
            self.noted = float(extra_arrays["seconds"])
            return True

    run = GoneOnWith(fails=False)
    seconds, _ = drive.drive(run, NoHistory(), drive.Saving(tmp_path / "checkpoint.npz", True, 0.0), silent=True)
    assert 700 < run.noted <= seconds < 760


def test_a_useless_checkpoint_is_refused_before_anything_slow(capture, tmp_path, monkeypatch):
    monkeypatch.setattr("irpso_addon.gpu.probe.probe", lambda: pytest.fail("it asked the GPU"))
    (tmp_path / "checkpoint.npz").write_bytes(b"PK cut")
    code, _, err = run_cli("recover", capture, *OPTIONS, "--resume", "-o", tmp_path)
    assert code == 2 and "damaged" in err and err.count("\n") == 1
    (tmp_path / "checkpoint.npz").unlink()
    (tmp_path / "checkpoint.npz").mkdir()
    code, _, err = run_cli("recover", capture, *OPTIONS, "-o", tmp_path)
    assert code == 2 and "is a folder" in err


@pytest.mark.parametrize("name", ["words.txt", "weights.npz", "array.npy"])
def test_a_users_own_checkpoint_file_is_neither_deleted_nor_replaced(capture, tmp_path, name):
    own = tmp_path / name
    if name == "words.txt":
        own.write_text("my own training checkpoint")
    elif name == "array.npy":
        np.save(own, np.arange(3))
    else:
        np.savez(own, weights=np.arange(3))
    own = own.rename(tmp_path / "checkpoint.npz")
    before = own.read_bytes()
    for more in ([], ["--dry-run"], ["--checkpoint-every", "0", "--live"]):
        code, _, err = run_cli("recover", capture, *OPTIONS[:4], "--iterations", 2, "-o", tmp_path, *more)
        assert code == 2 and err.count("\n") == 1 and "move or delete it" in err
        assert own.read_bytes() == before and [path.name for path in tmp_path.iterdir()] == ["checkpoint.npz"]


def test_an_own_checkpoint_of_any_version_is_replaced_without_resume(capture, tmp_path, monkeypatch):
    with monkeypatch.context() as former:
        former.setattr(checkpoint, "_VERSION", 2)
        checkpoint.write(tmp_path / "checkpoint.npz", {"seed": 1}, checkpoint.Checkpoint(0, 1, 1, {}))
    code, _, err = run_cli("recover", capture, *OPTIONS[:4], "--iterations", 2, "--quiet", "-o", tmp_path)
    assert code == 0, err
    assert not (tmp_path / "checkpoint.npz").exists() and (tmp_path / "maps.exr").is_file()


def test_a_checkpoint_without_disk_space_is_reported_once_and_keeps_the_old_one(tmp_path, capsys):
    path = tmp_path / "checkpoint.npz"
    path.write_bytes(b"the one before")
    run = FullDisk(fails=True)
    _, warnings = drive.drive(run, NoHistory(), drive.Saving(path, every=0.0), silent=True)
    assert run.saved == 4 and len(warnings) == 1
    assert warnings[0] == f"no checkpoint: {path}: cannot be written (No space left on device); choose another place"
    assert capsys.readouterr().err == f"irpso: warning: {warnings[0]}\n"
    assert path.read_bytes() == b"the one before" and [p.name for p in tmp_path.iterdir()] == [path.name]


def test_checkpoints_are_written_at_their_interval(tmp_path):
    runs = [FullDisk(fails=False) for _ in range(3)]
    for run, every in zip(runs, (0.0, 3600.0, None), strict=True):
        drive.drive(run, NoHistory(), drive.Saving(tmp_path / "checkpoint.npz", every=every), silent=True)
    assert [run.saved for run in runs] == [4, 0, 0]


def test_slow_checkpoints_take_at_most_a_twentieth_of_the_time(tmp_path, monkeypatch):
    clock = [0.0]

    class Slow(FullDisk):
        def step(self, iterations=None, time_budget_s=None):
            clock[0] += 10
            self.progress = replace(self.progress, done=clock[0] > 10000)
            return self.progress

        def save(self, path, extra_arrays, running=None):
            clock[0] += 30
            return super().save(path, extra_arrays, running)

    monkeypatch.setattr(drive.time, "perf_counter", lambda: clock[0])
    run = Slow(fails=False)
    drive.drive(run, NoHistory(), drive.Saving(tmp_path / "checkpoint.npz", every=10.0), silent=True)
    assert 12 <= run.saved <= 1 + 10000 / 600


def test_a_checkpoint_waits_until_tiles_are_at_the_same_iteration(tmp_path):
    class InTurns(FullDisk):
        @property
        def settled(self):
            return self._made == 3

    run = InTurns(fails=False)
    drive.drive(run, NoHistory(), drive.Saving(tmp_path / "checkpoint.npz", every=0.0), silent=True)
    assert run.saved == 1


def test_the_begin_of_a_stage_is_written_once(tmp_path):
    class OfStages(FullDisk):
        def step(self, iterations=None, time_budget_s=None):
            super().step()
            self.progress = replace(self.progress, stage=self._made // 3)
            return self.progress

        def save(self, path, extra_arrays, running=None):
            super().save(path, extra_arrays, running)
            return False  # a later one would hold no more

    run = OfStages(fails=False)
    drive.drive(run, NoHistory(), drive.Saving(tmp_path / "checkpoint.npz", every=0.0), silent=True)
    assert run.saved == 2


def test_the_next_run_removes_half_written_files(tmp_path):
    left, other = tmp_path / ".checkpoint.partial-123.npz", tmp_path / "notes.partial-1.npz"
    left.touch(), other.touch()
    drive.drive(FullDisk(fails=False), NoHistory(), drive.Saving(tmp_path / "checkpoint.npz"), silent=True)
    assert not left.exists() and other.exists()


@pytest.mark.parametrize("seconds", ["-1", "nan", "inf"])
def test_an_invalid_checkpoint_interval_is_refused(seconds, capture, tmp_path):
    code, _, err = run_cli("recover", capture, "--checkpoint-every", seconds, "-o", tmp_path / "out")
    assert code == 2 and "--checkpoint-every" in err and not (tmp_path / "out").exists()
    with pytest.raises(InputError):
        drive.check_every(float(seconds))
