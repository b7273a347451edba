"""Runs commands under mpirun, for the tests of recoveries over ranks."""

import functools
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 900  # limit of one job on a busy machine


@functools.cache
def launcher():
    """Return the path of an mpirun that works with mpi4py, or None."""
    beside = Path(sys.executable).with_name("mpirun")
    mpirun = str(beside) if beside.exists() else shutil.which("mpirun")
    if importlib.util.find_spec("mpi4py") is None or mpirun is None:
        return None
    done = subprocess.run([mpirun, "--version"], capture_output=True, text=True)
    return mpirun if done.returncode == 0 and "Open MPI" in done.stdout else None


def needs_mpi():
    """Return the mark of tests that start several processes."""
    reason = "mpirun (Open MPI) and mpi4py are not installed: the dependency group cluster"
    return pytest.mark.skipif(launcher() is None, reason=reason)


def environment(**more):
    """Return the environment of a job: for root, Open MPI requires two variables."""
    allowed = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "LP_NUM_THREADS": "0"}
    return {**os.environ, **allowed, **more}


def job(ranks, *arguments, before="", **more):
    """Return the command of ``irpso`` on ``ranks`` ranks, and its environment. before: shell code of each rank."""
    command = [sys.executable, "-m", "irpso_addon", *map(str, arguments)]
    if before:
        command = ["sh", "-c", before + ' exec "$@"', "sh", *command]
    placed = ["--oversubscribe", "--bind-to", "none"]
    return [launcher(), *placed, "-n", str(ranks), *command], environment(**more)


def start(ranks, *command):
    """Run a command on ``ranks`` ranks; it must succeed."""
    placed = [launcher(), "--oversubscribe", "--bind-to", "none", "-n", str(ranks)]
    done = subprocess.run(
        [*placed, *map(str, command)], cwd=ROOT, env=environment(), capture_output=True, text=True, timeout=SECONDS
    )
    assert done.returncode == 0, done.stderr


def run(ranks, *arguments, before="", **more):
    """Run a job to its end; return exit code, the JSON line of standard output or None, and standard error."""
    command, variables = job(ranks, *arguments, before=before, **more)
    done = subprocess.run(command, cwd=ROOT, env=variables, capture_output=True, text=True, timeout=SECONDS)
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    assert len(lines) <= 1, done.stdout  # only one rank prints
    return done.returncode, json.loads(lines[0]) if lines else None, done.stderr
