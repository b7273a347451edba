"""What starts a checkout: scripts/environment.sh, which finds a Python, and ./irpso, without an environment."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="shell scripts")


@pytest.fixture
def checkout(tmp_path):
    """A folder with a space in its name and the scripts; environment.py prints the interpreter that runs it."""
    folder = tmp_path / "a folder"
    (folder / "scripts").mkdir(parents=True)
    shutil.copy(ROOT / "irpso", folder)
    shutil.copy(ROOT / "scripts" / "environment.sh", folder / "scripts")
    (folder / "scripts" / "libraries.py").touch()
    (folder / "scripts" / "environment.py").write_text("import sys; print(sys.executable)", encoding="utf-8")
    return folder


def started(checkout, **variables):
    wanted = f"{sys.version_info[0]}.{sys.version_info[1]}"
    command = [checkout / "scripts" / "environment.sh", "venv", "runtime"]
    return subprocess.run(command, env={"WANTED": wanted, **variables}, capture_output=True, text=True)


@pytest.mark.parametrize("home", [{}, {"HOME": "/nowhere"}], ids=["without HOME", "HOME"])
def test_a_python_on_the_path_is_found(checkout, home):
    said = started(checkout, PATH=f"{Path(sys.executable).parent}:/usr/bin:/bin", **home)
    assert (said.returncode, said.stderr) == (0, "") and said.stdout.strip()


def test_a_chosen_python_may_have_a_space_in_its_path_and_no_other_is_taken(checkout):
    chosen = checkout / "python3"
    chosen.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n', encoding="utf-8")
    chosen.chmod(0o755)
    assert started(checkout, PYTHON=str(chosen), PATH="/usr/bin:/bin").returncode == 0
    said = started(checkout, PYTHON="/no where/python3", PATH=f"{Path(sys.executable).parent}:/usr/bin:/bin")
    assert said.returncode == 2 and "PYTHON=/no where/python3 does not serve" in said.stderr


def test_the_hint_without_an_environment_can_be_pasted(checkout):
    said = subprocess.run([checkout / "irpso"], capture_output=True, text=True)
    assert said.returncode == 2 and f"run: make -C '{checkout}' doctor" in said.stderr
