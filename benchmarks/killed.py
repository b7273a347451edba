"""Recoveries killed with signal 9 at random moments and resumed, compared bit for bit with an uninterrupted one.

Usage: python -m benchmarks.killed [--quick] [--again] [--output FOLDER]; mpirun is looked for beside Python.

A small card is recovered once without interruption. Then repeatedly: started, killed at a random moment (reading,
searching, writing a checkpoint or the result), started again, with --resume if there is a checkpoint, until a run ends.
With ranks, a random one of them is killed.
"""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.swarm_scaling import launcher, rank_environment
from irpso_addon.core.optional import present

_KILLS = 100  # of each chain
_CHAINS = (1, 2)  # ranks
_TEXELS, _LIGHTS = (40, 50), 16
_OPTIONS = ("--model", "lambert", "--preset", "swarm", "--iterations", "800", "--entry", "fragment", "--quiet",
            "--checkpoint-every", "0.2")  # fmt: skip


def measure(quick: bool) -> dict[str, Any]:
    """Run the chains in parallel, each in its own folder."""
    folder = report.CACHE / "killed"
    shutil.rmtree(folder, ignore_errors=True)
    capture = write_card(folder / "capture", _TEXELS, _LIGHTS)
    whole = folder / "whole"
    took = _finished(_start(capture, whole, 1, False))
    reference = _maps(whole)
    kills = 4 if quick else _KILLS
    chains = [n for n in _CHAINS if n == 1 or launcher() is not None]
    with ThreadPoolExecutor(len(chains)) as pool:
        results = pool.map(
            lambda ranks: _chain(capture, folder / f"ranks-{ranks}", ranks, kills, took, reference), chains
        )
        return {"chains": list(results), "seconds": took, "iterations": 800}


def _chain(
    capture: Path, folder: Path, ranks: int, kills: int, took: float, reference: dict[str, np.ndarray]
) -> dict[str, Any]:
    chosen = random.Random(ranks)
    done = {"ranks": ranks, "kills": 0, "resumed": 0, "whole": 0, "equal": 0, "failed": 0}
    out, number, life = folder / "0", 0, 1.2 * took  # 1.2: some kills come while the result is being written
    while done["kills"] < kills:
        resume = (out / "checkpoint.npz").exists()
        run = _start(capture, out, ranks, resume)
        try:
            run.wait(chosen.uniform(0, life))
        except subprocess.TimeoutExpired:
            _kill(run, ranks, chosen)
            done["kills"] += 1
            done["resumed"] += resume
            continue
        if run.returncode:
            done["failed"] += 1
            report.say(present(run.stderr).read().decode())
            break
        done["whole"] += 1
        done["equal"] += _same(_maps(out), reference)
        number += 1
        out = folder / str(number)
    if (out / "checkpoint.npz").exists():  # the last one gets through as well
        _finished(_start(capture, out, ranks, True))
        done["whole"] += 1
        done["equal"] += _same(_maps(out), reference)
    report.say(f"{done}")
    return done


def _start(capture: Path, out: Path, ranks: int, resume: bool) -> subprocess.Popen:
    words = [sys.executable, "-m", "irpso_addon", "recover", capture, *_OPTIONS, "-o", out]
    words += ["--resume"] if resume else []
    before = [launcher(), "-n", ranks, "--oversubscribe", "--bind-to", "none"] if ranks > 1 else []
    return subprocess.Popen(
        [str(word) for word in (*before, *words)], cwd=report.ROOT, env=rank_environment(1), stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip


def _kill(run: subprocess.Popen, ranks: int, chosen: random.Random) -> None:
    """Kill the process, or one of its ranks; then the launcher must end the others."""
    if ranks > 1 and (children := _ranks_of(run.pid)):
        with contextlib.suppress(ProcessLookupError):  # where it has ended by itself meanwhile
            os.kill(chosen.choice(children), signal.SIGKILL)
        try:
            run.wait(20)
            return
        except subprocess.TimeoutExpired:
            report.say("the other ranks did not end within 20 s")
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()


def _ranks_of(launched: int) -> list[int]:
    """Return the launcher's child processes that run the program."""
    listed = subprocess.run(["ps", "-eo", "pid,ppid,args"], capture_output=True, text=True).stdout.splitlines()[1:]
    rows = [line.split(None, 2) for line in listed]
    return [int(pid) for pid, parent, words in rows if int(parent) == launched and "irpso_addon" in words]


def _finished(run: subprocess.Popen) -> float:
    """Wait for a run; return the seconds. Raises CalledProcessError if it fails."""
    began = time.monotonic()
    _, stderr = run.communicate()
    if run.returncode:
        report.say(stderr.decode())
        raise subprocess.CalledProcessError(run.returncode, run.args)
    return time.monotonic() - began


def write_card(folder: Path, shape: tuple[int, int], lights: int, model: str = "lambert") -> Path:
    """Write the capture of a noisy card of (H, W) texels by subjects.make_card; return its folder."""
    from benchmarks.subjects import NOISY, make_card
    from irpso_addon.capture.camera import Camera
    from irpso_addon.capture.types import Capture, Light, Observation
    from irpso_addon.capture.write import write_capture

    domain = make_card(shape, lights, NOISY, model=model).domain
    height, width = domain.shape
    shots = tuple(
        Observation(f"light {k}", lambda image=image: image, Light(tuple(map(float, light[:3]))))
        for k, (image, light) in enumerate(zip(domain.stack.layers(), domain.lights, strict=True))
    )
    camera = Camera.orthographic(width, height, 2.0)
    write_capture(Capture("card", shots, (camera,), (np.ones((height, width), bool),)), folder)
    return folder


def _maps(folder: Path) -> dict[str, np.ndarray]:
    from irpso_addon.capture.images.exr import read_exr

    parts = read_exr(folder / "maps.exr")
    return {f"{part}.{name}": values for part, channels in parts.items() for name, values in channels.items()}


def _same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name], equal_nan=True) for name in a)


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    header = ("ranks", "killed", "of them resumed", "finished runs", "with the same maps, bit for bit",
              "refused to resume")  # fmt: skip
    rows = [[c["ranks"], c["kills"], c["resumed"], c["whole"], c["equal"], c["failed"]] for c in data["chains"]]
    return [
        f"A card of {_TEXELS[1]} × {_TEXELS[0]} texels under {_LIGHTS} lights, {data['iterations']} iterations, a"
        " checkpoint every 0.2 s. Each run is killed with signal 9 at random moments and restarted, until it"
        " finishes. With ranks, one rank is killed, and the launcher ends the others. A run takes many kills until"
        " it finishes; if it was killed before its first checkpoint, it starts anew. Source:"
        " [killed.py](../../benchmarks/killed.py).",
        "",
        *report.table(header, rows),
    ]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    kills, whole, equal, failed = (sum(c[k] for c in data["chains"]) for k in ("kills", "whole", "equal", "failed"))
    refused = f", {failed} refused to resume" if failed else ""
    return f"{kills} kills: {equal} of {whole} runs ended in the same maps{refused}"


PROGRAM = report.Program(
    "killed", "Killed and resumed", __file__, measure, write, headline,
    (*report.RECOVER, "benchmarks/swarm_scaling.py", "benchmarks/swarms"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
