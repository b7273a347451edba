"""What a graphics processor does: both entries, where it saturates, Fig. 7 in full, one swarm, twelve megapixels.

Usage: python -m benchmarks.gpu [--quick] [--again] [--output FOLDER]; python -m benchmarks.gpu PART FILE measures one
part alone. Some minutes on a GPU; without one it refuses, since the other pages say all of that.

Every part runs in a process of its own and leaves its result in .cache/bench/gpu: a run that was stopped goes on.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks import report
from benchmarks.fig7 import ITERATIONS, KNOWN, LIGHTS, ROUGHNESS, SIZES

_ENTRIES = ("fragment", "compute")
_MODEL = "principled"
_CAPTURE, _OBSERVATIONS = (224, 224), 96  # of the recovery with each entry
_SIDES, _PHOTOGRAPHS = (256, 512, 1024, 2048), 24
_CHUNKS = 3  # of what is timed for a rate
_TILED = 1200 * 1800  # texels of Fig. 7 from which on they are tiled
_BUDGET, _TEXTURE = 60 << 30, 8 << 30  # bytes on the device for Fig. 7, and of one texture
_MOST_SECONDS = 150  # of one size of it
_PARTICLES, _SWARM_ITERATIONS, _REPEATS = (8192, 50000), 100, 3


def facts(quick: bool) -> dict[str, Any]:
    """Return the device and what its probe found."""
    from irpso_addon.gpu import probe

    return {**probe.probe(), "machine": report.machine()}


def speed(quick: bool) -> dict[str, Any]:
    """Return what ``doctor --benchmark`` says."""
    from irpso_addon.pipeline.speed import measure_speed

    return measure_speed(32 if quick else None).as_dict()


def entries(quick: bool) -> dict[str, Any]:
    """Recover one capture with either entry; return seconds, errors, and how far apart the maps are."""
    from benchmarks.killed import write_card
    from benchmarks.subjects import NOISY, make_card

    folder = report.CACHE / "gpu" / "entries"
    shape, lights = ((16, 16), 12) if quick else (_CAPTURE, _OBSERVATIONS)
    write_card(folder / "capture", shape, lights, _MODEL)
    truth = make_card(shape, lights, NOISY, model=_MODEL).truth
    found: dict[str, Any] = {"texels": shape[0] * shape[1], "observations": lights}
    for entry in _ENTRIES:
        out = folder / entry
        words = ["recover", folder / "capture", "-o", out, "--model", _MODEL, "--entry", entry, "--quiet"]
        command = [sys.executable, "-m", "irpso_addon", *map(str, words)]
        started = time.perf_counter()
        subprocess.run(command, cwd=report.ROOT, check=True, capture_output=True)
        told = json.loads((out / "report.json").read_text(encoding="utf-8"))
        found[entry] = {
            "seconds": time.perf_counter() - started, "search": told["seconds"]["solve"],
            **compared(maps_of(out), truth),
        }  # fmt: skip
    found["apart"] = compared(*(maps_of(folder / entry) for entry in _ENTRIES))
    return found


def maps_of(folder: Path) -> dict[str, np.ndarray]:
    """Return the maps in a folder that a recovery wrote."""
    from irpso_addon.reflectance.model import load_model
    from irpso_addon.results.read import read_maps

    return read_maps(folder, load_model(_MODEL))


def compared(values: Mapping[str, np.ndarray], others: Mapping[str, np.ndarray]) -> dict[str, list[float]]:
    """Return parameter → [mean, median, 99th percentile] of how far apart they are, as ``subjects.errors_of``."""
    from benchmarks.subjects import errors_of

    off = errors_of(_MODEL, values, others)
    return {name: [float(v.mean()), *np.quantile(v, (0.5, 0.99)).tolist()] for name, v in off.items()}


def rates(quick: bool) -> dict[str, Any]:
    """Return texel·observations·evaluations a second by the size of the card, the steps of the phases in turn."""
    from benchmarks.timed import Job, measure

    alone = {"search": ["all"], "cycles": 1, "iterations": 60, "prefit_iterations": 0, "refinement_iterations": 0,
             "refinement_rounds": 0}  # fmt: skip
    cases = (("`paper`, roughness stage", "paper", ROUGHNESS, KNOWN), ("`standard`, swarm", "standard", alone, ()))
    rows = []
    for side in (16, 24) if quick else _SIDES:
        for title, preset, changes, fixed in cases:
            for entry in _ENTRIES:
                # So many iterations that reading the maps, which waits for them, is a small part.
                count = max(2, 64 * 256**2 // side**2)
                job = Job(side, side, _PHOTOGRAPHS, preset, changes, fixed, min(count, 16), _CHUNKS, entry)
                found = measure(job)
                pairs = zip(found["evaluations"], found["clock"], strict=True)
                rate = [_PHOTOGRAPHS * evaluations / seconds for evaluations, seconds in pairs]
                rows.append({"side": side, "title": title, "entry": entry, "rate": statistics.median(rate),
                             "low": min(rate), "high": max(rate)})  # fmt: skip
                report.say(f"{title}, {side}², {entry}: {rows[-1]['rate'] / 1e6:.1f} million a second")
    return {"rows": rows}


def fig7(quick: bool) -> dict[str, Any]:
    """Run all sizes of the paper's Fig. 7 in full, with the entry that the probe prefers."""
    from irpso_addon.gpu import probe

    entry, rows = probe.chosen_entry(probe.probe()), []
    for height, width in [(h // 12, w // 12) for h, w in SIZES[:2]] if quick else SIZES:
        lights, iterations = (20, 20) if quick else (LIGHTS, ITERATIONS)
        job = {
            "rows": height, "columns": width, "lights": lights, "changes": ROUGHNESS, "fixed": KNOWN,
            "iterations": iterations, "entry": entry, "warm": 0,
            "budget": _BUDGET if height * width > _TILED else 0,
        }  # fmt: skip
        command = [sys.executable, "-m", "benchmarks.gpu", "job", json.dumps(job)]
        try:
            done = subprocess.run(
                command, cwd=report.ROOT, stdout=subprocess.PIPE, text=True, check=True, timeout=_MOST_SECONDS
            )
        except subprocess.SubprocessError as error:
            rows.append({"height": height, "width": width, "failed": str(error)[-200:]})
            continue
        rows.append({"height": height, "width": width, "lights": lights, **json.loads(done.stdout.splitlines()[-1])})
        report.say(f"{height} × {width}: {rows[-1]['clock'][0]:.1f} s for {iterations} iterations")
    return {"entry": entry, "iterations": iterations, "rows": rows}


def run_job(text: str) -> None:
    """Print what timed.measure finds of a job, where one texture may be larger than on software renderers."""
    from benchmarks import timed
    from irpso_addon.solver.planning import plan

    def planned(*arguments: Any) -> plan.Plan:
        return plan.plan_recovery(*arguments, limits=plan.Limits(texture=_TEXTURE))

    with patch.object(timed, "plan_recovery", planned):
        print(json.dumps(timed.measure(timed.Job(**json.loads(text)))))


def swarm(quick: bool) -> dict[str, Any]:
    """Time Fig. 8's swarm on the gpu module."""
    from benchmarks.swarm_scaling import on_gpu

    count, repeats = (5, 1) if quick else (_SWARM_ITERATIONS, _REPEATS)
    return {"rows": [
        {"particles": particles, "every": every, "entry": entry, **on_gpu(particles, every, count, repeats, entry)}
        for particles in _PARTICLES for every in (1, 10) for entry in _ENTRIES
    ]}  # fmt: skip


def cuda(quick: bool) -> dict[str, Any]:
    """Time the same swarm by CUDA, in whichever Python has numba-cuda."""
    from benchmarks.swarm_scaling import on_cuda

    count, repeats = (5, 1) if quick else (_SWARM_ITERATIONS, _REPEATS)
    return {"rows": [
        {"particles": particles, "every": every, **(on_cuda(particles, every, count, repeats) or {})}
        for particles in _PARTICLES for every in (1, 10)
    ]}  # fmt: skip


def card(quick: bool) -> dict[str, Any]:
    """Recover twelve megapixels from JPEGs, with the memory that the device has."""
    from benchmarks import full_size

    return full_size.recovered(full_size.SMALL if quick else full_size.SIZE, "device=40G,host=60G")


PARTS: dict[str, Callable[[bool], dict[str, Any]]] = {
    part.__name__: part for part in (facts, speed, entries, rates, fig7, swarm, cuda, card)
}


def measure(quick: bool) -> dict[str, Any]:
    """Measure all parts that have no result yet; one that fails is noted as such."""
    from irpso_addon.gpu import context

    folder = report.CACHE / "gpu"
    data = {}
    for name in PARTS:
        path = folder / f"{name}{'-quick' if quick else ''}.json"
        if not path.is_file():
            subprocess.run([sys.executable, "-m", "benchmarks.gpu", name, str(path)], cwd=report.ROOT, check=False)
        data[name] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        if name == "facts" and not quick and context.is_software(str(data[name].get("renderer", "llvmpipe"))):
            raise SystemExit("benchmarks.gpu: no GPU here")
    return data


def run_part(name: str, path: Path) -> None:
    """Measure one part and write its JSON file."""
    found = PARTS[name](path.stem.endswith("-quick"))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["job"]:
        run_job(sys.argv[2])
    elif sys.argv[1:2] and sys.argv[1] in PARTS:
        run_part(sys.argv[1], Path(sys.argv[2]))
    if "bpy" in sys.modules:
        from irpso_addon.gpu import context

        context.exit_process(0)
