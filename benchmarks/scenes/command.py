"""Runs the public command in a process."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def recover(capture: Path, out: Path, *arguments: object) -> float:
    """Run ``recover CAPTURE -o OUT`` with further arguments, into a new folder; return its seconds."""
    shutil.rmtree(out, ignore_errors=True)
    started = time.perf_counter()
    command = [
        sys.executable, "-m", "irpso_addon", "recover", capture, *arguments, "-o", out, "--json", "--quiet",
    ]  # fmt: skip
    subprocess.run([str(part) for part in command], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started
