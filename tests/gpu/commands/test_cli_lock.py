"""Two runs into one folder at once: the second is refused, and a killed run blocks none."""

import errno
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.pipeline import lock
from irpso_addon.pipeline.lock import lock_file, locked_folder
from tests.builders import command_line as cli_maker
from tests.builders.command_line import run_cli

ROOT = Path(__file__).resolve().parents[3]
OPTIONS = ["--model", "lambert", "--preset", "swarm", "--iterations", "2", "--quiet"]
HOLDER = """
import sys, time
from pathlib import Path
from irpso_addon.pipeline.lock import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(100)
"""


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    lights = cli_maker.dome_lights(6, widest=60)
    values = cli_maker.smooth_maps((7, 9), {}, seed=2)
    folder = tmp_path_factory.mktemp("locked") / "card"
    return cli_maker.write_card(folder, cli_maker.render_oracle("lambert", values, lights), lights)


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock of ``out``."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "out")]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()


def test_a_second_run_into_a_folder_is_refused_and_changes_nothing(capture, holder, tmp_path):
    out = tmp_path / "out"
    (out / ".irpso-result-abc").mkdir(parents=True)  # of the first run, which is writing
    (out / ".checkpoint.partial-7.npz").touch()
    before = sorted(path.name for path in out.iterdir())
    for more in ([], ["--live", "--preview"]):
        code, _, err = run_cli("recover", capture, *OPTIONS, *more, "-o", out)
        assert code == 2 and err.count("\n") == 1 and "another process writes its result there now" in err
        assert sorted(path.name for path in out.iterdir()) == before
    assert run_cli("recover", capture, *OPTIONS, "--dry-run", "-o", out)[0] == 0  # it writes nothing


def test_the_lock_of_a_killed_run_ends_with_it(capture, holder, tmp_path):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert not (tmp_path / "out").exists() and lock_file(tmp_path / "out").exists()
    assert run_cli("recover", capture, *OPTIONS, "-o", tmp_path / "out")[0] == 0
    assert (tmp_path / "out" / "maps.exr").is_file() and not lock_file(tmp_path / "out").exists()


def test_a_failed_run_leaves_neither_lock_nor_folder(capture, tmp_path):
    out = tmp_path / "deep" / "out"
    assert run_cli("recover", capture, *OPTIONS, "--set", "particles=0", "-o", out)[0] == 2
    assert list(tmp_path.iterdir()) == [] and not lock_file(out).exists()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL])
def test_a_system_without_locks_writes(tmp_path, monkeypatch, number):
    def unsupported(handle):
        raise OSError(number, "no locks")

    monkeypatch.setattr(lock, "_lock", unsupported)
    with locked_folder(tmp_path / "out"), locked_folder(tmp_path / "out"):
        pass
    assert not lock_file(tmp_path / "out").exists()


def test_a_folder_has_one_lock_by_all_its_names(tmp_path, monkeypatch):
    (tmp_path / "link").symlink_to(tmp_path / "out")
    monkeypatch.chdir(tmp_path)
    with locked_folder(tmp_path / "out"):
        for name in ("out", "./out/", "link"):
            with pytest.raises(InputError, match="another process"), locked_folder(Path(name)):
                pass


def test_a_lock_file_that_its_owner_has_just_removed_protects_nothing(tmp_path, monkeypatch):
    real, calls, path = lock._lock, [], lock_file(tmp_path)

    def removed_before(handle):
        real(handle)
        if not calls:
            path.unlink()
        calls.append(handle)

    monkeypatch.setattr(lock, "_lock", removed_before)
    with locked_folder(tmp_path):
        assert len(calls) == 2 and path.exists()
        with pytest.raises(InputError, match="another process"), locked_folder(tmp_path):
            pass
        assert path.exists()
    assert not path.exists() and list(tmp_path.iterdir()) == []
