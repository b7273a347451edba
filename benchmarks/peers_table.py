"""The program against its peers: same capture, machine and run, every method in a process of its own.

Usage: python -m benchmarks.peers_table [--quick] [--again] [--output FOLDER]
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import peer_child, report, subjects
from benchmarks.report import short
from irpso_addon.gpu import context

REPEATS = 3  # of the program, spread over the run: the median of its seconds counts
NEGLIGIBLE = 0.01  # degrees, or % of a range: smaller differences are float32 rounding
NEARLY = 1.05  # over its final error: below it a peer has converged
TITLES = {"clean": "Two lobes, clean", "dirty": "Two lobes, dirty", peer_child.BUNNY: "bunny_specular, one lobe"}


def measure(quick: bool) -> dict[str, Any]:
    """Run every method on every capture; the program first, in the middle and last."""
    with tempfile.TemporaryDirectory() as folder:
        captures = {}
        for capture in ("dirty",) if quick else peer_child.CAPTURES:
            if capture == peer_child.BUNNY and not (peer_child.DATA / capture).is_dir():
                report.say(f"peers: {capture} is not in {peer_child.DATA}, left out; set IRPSO_DATA")
                continue
            captures[capture] = _capture(capture, Path(folder), quick)
    return {"captures": captures, "sizes": peer_child.ITERATIVE}


def _capture(capture: str, folder: Path, quick: bool) -> dict[str, Any]:
    ours = list(peer_child.PRODUCT)
    peers = [*peer_child.LINEAR, *peer_child.ITERATIVE]
    half = len(peers) // 2
    order = ours if quick else [*ours, *peers[:half], *ours, *peers[half:], *ours]
    order = [*ours, *peers] if quick else order
    runs: dict[str, list[dict[str, Any]]] = {}
    for method in order:
        runs.setdefault(method, []).append(_child(capture, method, folder, quick))
        last = runs[method][-1]
        report.say(
            f"peers: {capture}, {method}: {last['errors']['normal'].mean():.4f}°, {last['seconds'] * 1e3:.2f} ms"
        )
    own = {name: _median_of(runs[name]) for name in ours}
    rows = {name: _row(own[name], own[ours[0]]) for name in ours}
    rows |= {name: _row(runs[name][0], own[ours[0]]) for name in peers}
    return {"texels": len(own[ours[0]]["texels"]), "rows": rows}


def _child(capture: str, method: str, folder: Path, quick: bool) -> dict[str, Any]:
    target = folder / "result.npz"
    command = [sys.executable, "-m", "benchmarks.peer_child", capture, method, str(target)]
    # On shared cores two threads that synchronise only spin.
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    subprocess.run(
        [*command, "--quick"] if quick else command, cwd=report.ROOT, check=True, env={**os.environ, **threads},
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    with np.load(target) as arrays:
        facts = json.loads(str(arrays["facts"]))
        errors = {name.removeprefix("error_"): arrays[name] for name in arrays.files if name.startswith("error_")}
        trace = {name.removeprefix("trace_"): arrays[name] for name in arrays.files if name.startswith("trace_")}
        return {**facts, "texels": arrays["texels"], "errors": errors, "trace": trace, "times": arrays["times"]}


def _median_of(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return one of several runs with equal results, with the median of their times."""
    times = np.median([run["times"] for run in runs], axis=0)
    seconds = [run["seconds"] for run in runs]
    return {**runs[0], "times": times, "seconds": float(np.median(seconds)), "all_seconds": seconds}


def _row(run: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Return the data of one method's row, with the program's on the same texels."""
    at = _places(own["texels"], run["texels"])
    same = {name: report.mean_interval(error[at]) for name, error in own["errors"].items()}
    less = {
        name: report.mean_interval(own["errors"][name][at] - error)
        for name, error in run["errors"].items() if name in own["errors"]
    }  # fmt: skip
    return {
        "texels": len(run["texels"]), "seconds": run["seconds"], "wall": run["wall"], "evaluations": run["evaluations"],
        "memory": run["memory"], "settings": run["settings"], "all_seconds": run.get("all_seconds", [run["seconds"]]),
        "errors": {name: report.mean_interval(error) for name, error in run["errors"].items()},
        "program": same, "less": less, "arrival": _arrival(run), "reach": _reach(run, own, at),
    }  # fmt: skip


def _places(whole: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return the indices of the texels ``part`` (T, 2) in ``whole``."""
    index = {tuple(texel): i for i, texel in enumerate(whole.tolist())}
    return np.array([index[tuple(texel)] for texel in part.tolist()])


def _arrival(run: dict[str, Any]) -> float | None:
    """Return the seconds a texel after which a peer's normals stay within ``NEARLY`` of its own final error."""
    if not len(run["times"]):
        return None
    mean = run["trace"]["normal"].mean(axis=1)
    worse = np.flatnonzero(mean > NEARLY * run["errors"]["normal"].mean())
    return float(run["times"][min(worse[-1] + 1 if len(worse) else 0, len(mean) - 1), 0])


def _reach(run: dict[str, Any], own: dict[str, Any], at: np.ndarray) -> dict[str, float | None]:
    """Return the program's seconds a texel to a peer's own final mean error, of the normal and of all its parameters.

    Time: of all texels of the capture, with setup, over their number. Error: over the peer's texels.
    """
    traces = {name: errors[:, at].mean(axis=1) for name, errors in own["trace"].items()}
    reached = {n: trace <= run["errors"][n].mean() for n, trace in traces.items() if n in run["errors"]}
    seconds = {}
    for what, met in (("normal", reached["normal"]), ("all", np.all(list(reached.values()), axis=0))):
        first = np.flatnonzero(met)
        seconds[what] = float(own["times"][first[0], 0]) if len(first) else None
    return seconds


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines, with one plot."""
    lines = [
        "Every method solves the same texels of the same capture, each in its own process, one after another in one"
        " run on one machine. Errors are means over texels with their 95 % confidence interval (bootstrap): normals"
        " in degrees, others in % of the parameter's range. The Lambertian methods and the program solve all"
        " texels; the others solve a random sample"
        f" ({', '.join(f'{name} {n}' for name, n in data['sizes'].items())} texels), because each of their texels"
        " costs the same. Compare the row of a method on a sample with the program's error on the same texels, in"
        f" the column beside it. Bold: the program is significantly worse there, by more than {NEGLIGIBLE:g}.",
        "",
        "Seconds a texel: processor time over all threads, divided by the number of texels, because other load on"
        " the machine hardly changes it (with a GPU, the program's time is wall time). The program's time includes"
        f" setup and compilation, and is the median of {REPEATS} runs; a peer's time starts when its process has"
        " loaded. Peers have one thread each, the program two, and the work of both counts. Evaluations: renders of"
        " all observations; a gradient counts as three. Memory: the process's peak; it includes the capture, and"
        " for the program Blender.",
        "",
        "Speed-up: the peer's time to its own final normal error, divided by the program's time to its first state"
        " with the same error or less. In brackets: the same over all parameters that the peer solves. Speed-up,"
        f" converged: the same with the time after which the peer stays within {NEARLY - 1:.0%} of its final normal"
        " error.",
        "",
    ]
    for capture, result in data["captures"].items():
        names = list(result["rows"]["standard"]["errors"])
        lines += [f"## {TITLES[capture]}", "", _about(capture, result["texels"]), ""]
        header = ["method", "texels", *(f"{n} {subjects.unit_of(n)}" for n in names), "program, same texels: normal",
                  "evaluations", "ms a texel", "wall ms", "MB", "speed-up", "speed-up, converged"]  # fmt: skip
        lines += report.table(header, [_cells(name, row, names) for name, row in result["rows"].items()])
    _draw(data["captures"], folder)
    lines += report.image("peers", "Normal error against seconds a texel, of all methods")
    lines += ["## Settings", "", *_settings(data)]
    return lines


def _about(capture: str, texels: int) -> str:
    if capture == peer_child.BUNNY:
        return f"{texels} texels, 50 lights, perspective camera, model `principled`; normals alone have a ground truth."
    return f"{texels} texels, 100 lights, {subjects.DEGRADATIONS[capture].title}; all unknown."


def _interval(values: list[float]) -> str:
    mean, low, high = values
    return f"{short(mean)} ({short(low)}–{short(high)})"


def _cells(name: str, row: dict[str, Any], names: list[str]) -> list[str]:
    cells = []
    for n in names:
        worse = n in row["less"] and row["less"][n][1] > NEGLIGIBLE
        text = _interval(row["errors"][n]) if n in row["errors"] else "–"
        cells.append(f"**{text}**" if worse else text)
    reached = [row["seconds"] / row["reach"][k] if row["reach"][k] else None for k in ("normal", "all")]
    arrived = row["arrival"] / row["reach"]["normal"] if row["arrival"] and row["reach"]["normal"] else None
    own = name in peer_child.PRODUCT
    return [
        name, str(row["texels"]), *cells, "" if name == "standard" else _interval(row["program"]["normal"]),
        short(row["evaluations"]), short(1e3 * row["seconds"]), short(1e3 * row["wall"]), f"{row['memory']:.0f}",
        "" if own else f"{short(reached[0])} ({short(reached[1])})", "" if own else short(arrived),
    ]  # fmt: skip


def _settings(data: dict[str, Any]) -> list[str]:
    captures = data["captures"]
    settings_of: dict[str, list[str]] = {}
    for result in captures.values():
        for name, row in result["rows"].items():
            settings_of.setdefault(name, []).append(", ".join(f"{k} {v}" for k, v in row["settings"].items()))
    rows = [
        [name, "<br>".join(dict.fromkeys(f"{c}: {t}" if len(set(texts)) > 1 else t for c, t in zip(captures, texts,
                                                                                            strict=True)))]
        for name, texts in settings_of.items() if any(texts)
    ]  # fmt: skip
    note = "For each Lambertian method the best of SETTINGS in benchmarks/peers/lambertian.py, chosen by the truth."
    return [note, "", *report.table(["method", "settings"], rows)]


def _draw(captures: dict[str, Any], folder: Path) -> None:
    with report.plot(
        folder, "peers", "Normal error against seconds of work a texel, 95 % intervals", len(captures),
        figsize=(4.6 * len(captures), 4),
    ) as axes:  # fmt: skip
        for axis, (capture, result) in zip(axes[0], captures.items(), strict=True):
            for i, (name, row) in enumerate(result["rows"].items()):
                mean, low, high = row["errors"]["normal"]
                mark, color = "osD^vP*"[i // len(report.COLORS)], report.COLORS[i % len(report.COLORS)]
                bars = [[max(mean - low, 0)], [max(high - mean, 0)]]
                axis.errorbar(
                    [1e3 * row["seconds"]], [mean], yerr=bars, fmt=mark, color=color, label=name, markersize=5,
                    linewidth=1,
                )  # fmt: skip
            axis.set(xscale="log", yscale="log", xlabel="ms of work a texel", title=TITLES[capture])
        axes[0][0].set_ylabel("mean normal error, °")
        axes[0][-1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    parts = []
    for capture, result in data["captures"].items():
        rows = {name: row["errors"]["normal"][0] for name, row in result["rows"].items()}
        best = min((name for name in rows if name in peer_child.LINEAR), key=rows.get)
        parts.append(f"{capture}: standard {short(rows['standard'])}°, best Lambertian {short(rows[best])}° ({best})")
    return "; ".join(parts)


PROGRAM = report.Program(
    "peers", "The program and its peers", __file__, measure, write, headline,
    (*report.CAPTURE, "benchmarks/peer_child.py"),
)  # fmt: skip

if __name__ == "__main__":
    report.run(PROGRAM)
    context.exit_process(0)
