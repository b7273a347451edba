"""Speed on a GPU: both entries, rates by size, Fig. 7 in full, one swarm, twelve megapixels.

Usage: python -m benchmarks.gpu [--quick] [--again] [--output FOLDER]; python -m benchmarks.gpu PART FILE measures one
part alone. Ten minutes on a GPU; without one it ends at once, because the other pages measure software rendering.

Every part runs in a process of its own and writes its result to .cache/bench/gpu: a stopped run resumes.
"""

from __future__ import annotations

import hashlib
import json
import os
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
_SOFTWARE, _MESA = "software", Path("/usr/share/glvnd/egl_vendor.d/50_mesa.json")
_CAPTURE, _OBSERVATIONS = (224, 224), 96  # of the recovery with each entry
_SIDES, _PHOTOGRAPHS = (256, 512, 1024, 2048), 24
_CHUNKS, _TIMED = 3, 1 << 26  # timed chunks of a rate, and texels × iterations of each: a second of fragment passes
_OPERATIONS = 195  # of a particle of Fig. 7's stage under one light, counted in SPIR-V (spirv.py)
_TILED = 1200 * 1800  # texels of Fig. 7 above which a domain is tiled
_BUDGET, _TEXTURE = 60 << 30, 8 << 30  # bytes on the device for Fig. 7, and of one texture
_LARGE, _MAX_SECONDS = 10**5, 150  # least texels in the slope of Fig. 7; limit of one size
_SOURCES = ("gpu", "timed", "roofline", "full_size", "swarm_scaling", "killed")  # modules that the results depend on
_PARTICLES, _SWARM_ITERATIONS, _REPEATS = (8192, 50000), 100, 3


def facts(quick: bool) -> dict[str, Any]:
    """Return the device and the results of its probe."""
    from irpso_addon.gpu import probe

    return {**probe.probe(), "machine": report.machine()}


def speed(quick: bool) -> dict[str, Any]:
    """Return the results of ``doctor --benchmark``."""
    from irpso_addon.pipeline.speed import measure_speed

    return measure_speed(32 if quick else None).as_dict()


def entries(quick: bool) -> dict[str, Any]:
    """Recover one capture with each entry and on software GL; return seconds, errors, differences between the maps."""
    from benchmarks.killed import write_card
    from benchmarks.subjects import NOISY, make_card

    folder = report.CACHE / "gpu" / "entries"
    shape, lights = ((16, 16), 12) if quick else (_CAPTURE, _OBSERVATIONS)
    write_card(folder / "capture", shape, lights, _MODEL)
    truth = make_card(shape, lights, NOISY, model=_MODEL).truth
    result: dict[str, Any] = {"texels": shape[0] * shape[1], "observations": lights}
    software = {_SOFTWARE: "fragment"} if _MESA.is_file() else {}
    for way, entry in {**{entry: entry for entry in _ENTRIES}, **software}.items():
        out = folder / way
        words = ["recover", folder / "capture", "-o", out, "--model", _MODEL, "--entry", entry, "--quiet"]
        command = [sys.executable, "-m", "irpso_addon", *map(str, words)]
        mesa = {"__EGL_VENDOR_LIBRARY_FILENAMES": str(_MESA), "LIBGL_ALWAYS_SOFTWARE": "1"} if way == _SOFTWARE else {}
        started = time.perf_counter()
        subprocess.run(command, cwd=report.ROOT, env=os.environ | mesa, check=True, capture_output=True)
        summary = json.loads((out / "report.json").read_text(encoding="utf-8"))
        result[way] = {
            "seconds": time.perf_counter() - started, "search": summary["seconds"]["solve"],
            **compared(maps_of(out), truth),
        }  # fmt: skip
    result["apart"] = compared(*(maps_of(folder / entry) for entry in _ENTRIES))
    if software:
        result["software_apart"] = compared(maps_of(folder / "compute"), maps_of(folder / _SOFTWARE))
    return result


def maps_of(folder: Path) -> dict[str, np.ndarray]:
    """Return the maps in a recovery's output folder."""
    from irpso_addon.reflectance.model import load_model
    from irpso_addon.results.read import read_maps

    return read_maps(folder, load_model(_MODEL))


def compared(values: Mapping[str, np.ndarray], others: Mapping[str, np.ndarray]) -> dict[str, list[float]]:
    """Return parameter → [mean, median, 99th percentile] of the differences, as ``subjects.errors_of``."""
    from benchmarks.subjects import errors_of

    errors = errors_of(_MODEL, values, others)
    return {name: [float(v.mean()), *np.quantile(v, (0.5, 0.99)).tolist()] for name, v in errors.items()}


def rates(quick: bool) -> dict[str, Any]:
    """Return texel·observations·evaluations a second for every size of the card, phase and entry."""
    from benchmarks.timed import Job, measure

    alone = {
        "search": ["all"], "cycles": 1, "prefit_iterations": 0, "refinement_iterations": 0, "refinement_rounds": 0
    }  # fmt: skip
    cases = (("`paper`, roughness stage", "paper", ROUGHNESS, KNOWN), ("`standard`, swarm", "standard", alone, ()))
    rows = []
    for side in (16, 24) if quick else _SIDES:
        for title, preset, changes, fixed in cases:
            for entry in _ENTRIES:
                count = 2 if quick else max(2, _TIMED // side**2)
                enough = {**changes, "iterations": 1 + count * (_CHUNKS + 1)}
                result = measure(Job(side, side, _PHOTOGRAPHS, preset, enough, fixed, count, _CHUNKS, entry))
                pairs = zip(result["evaluations"], result["clock"], strict=True)
                rate = [_PHOTOGRAPHS * evaluations / seconds for evaluations, seconds in pairs]
                rows.append({"side": side, "title": title, "entry": entry, "rate": statistics.median(rate),
                             "low": min(rate), "high": max(rate)})  # fmt: skip
                report.say(f"{title}, {side}², {entry}: {rows[-1]['rate'] / 1e6:.1f} million a second")
    return {"rows": rows}


def fig7(quick: bool) -> dict[str, Any]:
    """Run all sizes of the paper's Fig. 7 in full, with the entry that the probe chose."""
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
                command, cwd=report.ROOT, stdout=subprocess.PIPE, text=True, check=True, timeout=_MAX_SECONDS
            )
        except subprocess.SubprocessError as error:
            rows.append({"height": height, "width": width, "failed": str(error)[-200:]})
            continue
        rows.append({"height": height, "width": width, "lights": lights, **json.loads(done.stdout.splitlines()[-1])})
        report.say(f"{height} × {width}: {rows[-1]['clock'][0]:.1f} s for {iterations} iterations")
    return {"entry": entry, "iterations": iterations, "rows": rows}


def run_job(text: str) -> None:
    """Print the result of timed.measure for a job in JSON, with larger textures than on software renderers."""
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
    """Time the same swarm by CUDA, where this Python has numba-cuda."""
    from benchmarks.swarm_scaling import on_cuda

    count, repeats = (5, 1) if quick else (_SWARM_ITERATIONS, _REPEATS)
    return {"rows": [
        {"particles": particles, "every": every, **(on_cuda(particles, every, count, repeats) or {})}
        for particles in _PARTICLES for every in (1, 10)
    ]}  # fmt: skip


def card(quick: bool) -> dict[str, Any]:
    """Recover twelve megapixels from JPEGs, with all memory of this machine."""
    from benchmarks import full_size

    return full_size.recovered(full_size.SMALL if quick else full_size.SIZE, "")


def ceilings(quick: bool) -> dict[str, Any]:
    """Return the device's peak operations and bytes a second, with its faster entry."""
    from benchmarks import roofline
    from irpso_addon.gpu import probe

    return roofline.ceilings(quick, probe.faster_entry())


PARTS: dict[str, Callable[[bool], dict[str, Any]]] = {
    part.__name__: part for part in (facts, ceilings, speed, entries, rates, fig7, swarm, cuda, card)
}


def measure(quick: bool) -> dict[str, Any]:
    """Measure all parts without a result; {} for a part that fails."""
    from irpso_addon.gpu import context

    sources = [report.digest(str(Path(__file__).with_name(f"{name}.py"))) for name in _SOURCES]
    folder = report.CACHE / "gpu" / hashlib.sha256("".join(sources).encode()).hexdigest()[:16]  # others measure anew
    data = {}
    for name in PARTS:
        path = folder / f"{name}{'-quick' if quick else ''}.json"
        if not path.is_file():
            subprocess.run([sys.executable, "-m", "benchmarks.gpu", name, str(path)], cwd=report.ROOT, check=False)
        data[name] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        if name == "facts" and not quick and context.is_software(str(data[name].get("renderer", "llvmpipe"))):
            report.say("gpu: no GPU here")
            raise SystemExit(0)
    return data


def run_part(name: str, path: Path) -> None:
    """Measure one part and write its JSON file."""
    result = PARTS[name](path.stem.endswith("-quick"))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1), encoding="utf-8")


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines for the measured parts."""
    if not (facts := data["facts"]):
        return ["The device could not be examined.", ""]
    ratio = facts["fragment_seconds"] / facts["compute_seconds"]
    lines = [
        f"{facts['renderer']}, driver {facts['version']}, {facts['machine']['processor']}. The probe is right both"
        f" ways; compute runs {ratio:.1f} times as fast as fragment passes. Largest texture"
        f" {facts['max_texture_size']} texels, {facts['max_texture_layers']} layers. Source:"
        " [gpu.py](../../benchmarks/gpu.py).",
        "",
    ]
    if here := data["ceilings"]:
        lines += [
            f"Ceilings, found by two kernels ([ceilings](../../benchmarks/ceilings)): {here['operations'] / 1e12:.1f} T"
            f" operations/s, {here['bytes'] / 1e12:.2f} TB/s.",
            "",
        ]
    sections = {"speed": _speed, "entries": _entries, "rates": _rates, "fig7": _fig7, "swarm": _swarm, "card": _card}
    for name, section in sections.items():
        if data[name]:
            lines += section(data)
    missing = [name for name in PARTS if not data[name]]
    return [*lines, *([f"Not measured: {', '.join(missing)}.", ""] if missing else [])]


def _speed(data: dict[str, Any]) -> list[str]:
    part = data["speed"]
    total = sum(phase["seconds"] for phase in part["phases"].values())
    return [
        "## The phases of a recovery",
        "",
        f"`doctor --benchmark`: {part['texels']} texels, {part['photographs']} photographs, {part['model']},"
        f" {part['preset']}. Shaders took {part['compiling_seconds']:.1f} s to compile. A texture goes to the device"
        f" with {part['upload_bytes_per_second'] / 1e9:.1f} GB/s and comes back with"
        f" {part['download_bytes_per_second'] / 1e9:.1f} GB/s. All together {total:.1f} s.",
        "",
        *report.table(
            ["phase", "s", "million texel·photograph·evaluations a second"],
            [[title, f"{phase['seconds']:.2f}", f"{phase['renders_per_second'] / 1e6:.0f}"]
             for title, phase in part["phases"].items()],
        ),
    ]  # fmt: skip


def _entries(data: dict[str, Any]) -> list[str]:
    part = data["entries"]
    ways = [name for name in (*_ENTRIES, _SOFTWARE) if name in part]
    pairs = {"fragment and compute": part["apart"], "compute and software GL": part.get("software_apart")}
    header = ["", "s of the search", *part["apart"]]
    return [
        "## One capture with either kind of pass",
        "",
        f"`recover`, {part['texels']} texels under {part['observations']} lights, noise 0.003, {_MODEL}, *Standard*."
        " Mean and 99th percentile of errors: the normal's in degrees, others in % of the range; then how far two ways"
        f" are apart. Software: Mesa's renderer{part.get('software_on', '')}.",
        "",
        *report.table(header, [
            *([name, report.short(part[name].get("search")), *(_error(part[name][p]) for p in part["apart"])]
              for name in ways),
            *([f"{title} apart", "", *(_error(each[p]) for p in part["apart"])]
              for title, each in pairs.items() if each),
        ]),
    ]  # fmt: skip


def _error(three: list[float]) -> str:
    return f"{report.short(three[0], 2)}, {report.short(three[2], 2)}"


def _rates(data: dict[str, Any]) -> list[str]:
    rows = data["rates"]["rows"]
    cases, sides = (list(dict.fromkeys(row[name] for row in rows)) for name in ("title", "side"))
    ways = [(title, entry) for title in cases for entry in _ENTRIES]
    cells = {(r["side"], r["title"], r["entry"]): f"{r['rate'] / 1e9:.2f} ({r['low'] / 1e9:.2f}–{r['high'] / 1e9:.2f})"
             for r in rows}  # fmt: skip
    return [
        "## Where it saturates",
        "",
        f"Thousand million texel·photograph·evaluations a second of {_PHOTOGRAPHS} photographs: median, minimum and"
        f" maximum of {_CHUNKS} times some iterations.",
        "",
        *report.table(
            ["texels", *(", ".join(way) for way in ways)],
            [[f"{side}²", *(cells.get((side, *way), "not measured") for way in ways)] for side in sides],
        ),
    ]


def _fig7(data: dict[str, Any]) -> list[str]:
    part, here = data["fig7"], data["ceilings"]
    done = [row for row in part["rows"] if "clock" in row]
    cells = []
    for row in part["rows"]:
        size = f"{row['height']} × {row['width']}"
        if "clock" not in row:
            cells.append([size, f"not finished in {_MAX_SECONDS} s", "", "", ""])
            continue
        rate = row["texels"] * row["lights"] * part["iterations"] / row["clock"][0]
        share = f"{rate * _OPERATIONS / here['operations']:.0%}, {16 * rate / here['bytes']:.0%}" if here else ""
        cells.append([size, f"{row['clock'][0]:.2f}", f"{row['setup'][0] + row['placing'][0]:.1f}",
                      f"{rate / 1e9:.1f}", share])  # fmt: skip
    large = [row for row in done if row["texels"] >= _LARGE]
    slope = [report.slope([row["texels"] for row in rows], [row["clock"][0] for row in rows])
             for rows in (done, large) if len(rows) > 1]  # fmt: skip
    return [
        "## The paper's Fig. 7 in full",
        "",
        f"As in [fig7.md](fig7.md): two-lobe roughness, 16 particles of which one moves in an iteration, {LIGHTS}"
        f" lights, all {part['iterations']} iterations, {part['entry']} passes. A particle takes {_OPERATIONS}"
        " operations a light and reads 16 bytes. Shares are of the ceilings above: operations, bytes.",
        "",
        *report.table(["texels", "s", "s before: samples to the device, swarms placed",
                       "thousand million texel·lights a second", "of the ceilings"], cells),
        f"Log–log slope of all sizes, and of those from {_LARGE} texels on, which do not wait for the passes' starts:"
        f" {', '.join(f'{value:.2f}' for value in slope)}.",
        "",
    ]  # fmt: skip


def _swarm(data: dict[str, Any]) -> list[str]:
    rows = [{"how": f"gpu module, {row['entry']}", **row} for row in data["swarm"]["rows"]]
    rows += [
        {"how": "CUDA, double precision", **row} for row in (data["cuda"] or {"rows": []})["rows"] if "runs" in row
    ]
    return [
        "## One swarm: the paper's Fig. 8",
        "",
        f"{_SWARM_ITERATIONS} iterations on griewank's function in 30 dimensions, as in"
        " [swarm_scaling.md](swarm_scaling.md); medians of three.",
        "",
        *report.table(["particles", "a reduction every", "how", "s", "value found"], [
            [row["particles"], row["every"], row["how"],
             f"{statistics.median(run['seconds'] for run in row['runs']):.4f}", report.short(row["value"], 6)]
            for row in rows
        ]),
    ]  # fmt: skip


def _card(data: dict[str, Any]) -> list[str]:
    from benchmarks import full_size

    return ["## Twelve megapixels", "", *full_size.write(data["card"], Path()), ""]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    name = str(data["facts"].get("renderer", "")).partition("/")[0]
    done = [row for row in data["fig7"].get("rows", []) if "clock" in row]
    if not done:
        return name
    row, iterations = done[-1], data["fig7"]["iterations"]
    rate = row["texels"] * row["lights"] * iterations / row["clock"][0]
    return (
        f"{name}: {row['height']} × {row['width']} texels, {row['lights']} lights, {iterations} iterations:"
        f" {row['clock'][0]:.1f} s, {rate / 1e9:.0f} thousand million texel·lights a second"
    )


PROGRAM = report.Program(
    "gpu",
    "On a graphics processor",
    __file__,
    measure,
    write,
    headline,
    (*report.RECOVER, "benchmarks"),  # fmt: skip
)

if __name__ == "__main__":
    if sys.argv[1:2] == ["job"]:
        run_job(sys.argv[2])
    elif sys.argv[1:2] and sys.argv[1] in PARTS:
        run_part(sys.argv[1], Path(sys.argv[2]))
    else:
        report.run(PROGRAM)
    if "bpy" in sys.modules:
        from irpso_addon.gpu import context

        context.exit_process(0)
