"""Roofline of every pass: reads, writes and operations per texel, bounds of some devices, and rates on this machine.

Usage: python -m benchmarks.roofline [--quick] [--again] [--output FOLDER]; needs glslang-tools and spirv-tools.

Passes are recorded while *Standard* recovers a card; their operations and fetches are counted in SPIR-V (spirv.py).
"""

from __future__ import annotations

import shutil
import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks import product, report
from benchmarks.spirv import counts
from irpso_addon.core.paths import DEFAULT_MODEL
from irpso_addon.geometry.domain import Domain
from irpso_addon.gpu import context, probe, textures
from irpso_addon.gpu.kernel import Entry, Kernel, Output
from irpso_addon.gpu.passes import Pass
from irpso_addon.gpu.program import ProgramCache
from irpso_addon.pipeline.speed import make_card
from irpso_addon.reflectance.model import ReflectanceModel, load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.settings.schedule import Schedule, load_schedule
from irpso_addon.solver.state.texel_subset import MAX_TEXELS

_SMALL, _REPEATS = 16, 5
_SIDE = {True: 192, False: 1024}  # texels of the card, on a software renderer or not
_WIDTH, _LAYERS = {True: 512, False: 2048}, 24  # of the stack that the bandwidth kernel reads
_CHAINS, _TURNS = 32, {True: 256, False: 8192}  # of the arithmetic kernel: operations a turn of its loop, and turns
_RUNS = {True: 1, False: 20}  # of these kernels that are timed together
_TEXELS = 12 * 10**6
_STACK = "u_stack"
_OF_SAMPLE = "alternatives.glsl"  # the pass of the shared materials that runs on a sample of the texels
_SHOWN = 0.01  # least share of all operations or bytes of a pass in the table


@dataclass(frozen=True)
class Device:
    """Published peaks: float32 operations a second, a multiply-add counting two, and bytes a second of memory."""

    title: str
    operations: float
    bytes: float


_DEVICES = (
    Device("laptop, inside the processor (Iris Xe, 96 units: 2.1 Tflop/s, 68 GB/s)", 2.1e12, 68e9),
    Device("laptop, of its own (RTX 4060: 11.6 Tflop/s, 256 GB/s)", 11.6e12, 256e9),
    Device("farm (H100 SXM: 67 Tflop/s, 3350 GB/s)", 67e12, 3350e9),
)


@dataclass
class Recorded:
    """All runs of one pass in one phase, over the whole card. runs: of all rows.

    targets: texels that it writes. read: sampler → texels of its texture, without tables, which caches hold. each:
    sampler → bytes of a texel. written: bytes. known: possible bounds of its loops.
    """

    phase: int
    kernel: Kernel
    targets: int
    read: Mapping[str, int]
    each: Mapping[str, int]
    written: int
    known: Mapping[str, int | float]
    runs: float = 0.0


def measure(quick: bool) -> dict[str, Any]:
    """Record a recovery, count the work of its passes, and measure the ceilings of this machine."""
    if missing := [name for name in ("glslangValidator", "spirv-opt", "spirv-dis") if shutil.which(name) is None]:
        raise SystemExit(f"{', '.join(missing)} not found; install glslang-tools and spirv-tools")
    context.ensure()
    software, entry = product.software_renderer(), probe.faster_entry()
    side = _SMALL if quick else _SIDE[software]
    model, schedule = load_model(DEFAULT_MODEL), load_schedule("standard")
    with closing(ProgramCache()):
        recorded(make_card(model, _SMALL), model, schedule, entry)  # compiles
        domain = make_card(model, side)
        phases, passes = recorded(domain, model, schedule, entry)
    for each in passes:
        if Path(each.kernel.source).name == _OF_SAMPLE:
            each.runs *= MAX_TEXELS / _TEXELS
    rows = [row(each, int(domain.solvable.sum()), domain.observations) for each in passes]
    here = ceilings(software, entry)
    return {
        "side": side, "observations": domain.observations, "phases": phases, "passes": rows, "here": here,
        "entry": entry,
    }  # fmt: skip


def recorded(
    domain: Domain, model: ReflectanceModel, schedule: Schedule, entry: Entry
) -> tuple[list[dict[str, Any]], list[Recorded]]:
    """Recover a card, waiting for every pass; return its phases and their passes."""
    passes: dict[tuple, Recorded] = {}
    stage, run = 0, Pass.run

    def recording(
        self: Pass,
        targets: Sequence[Any],
        read: Mapping[str, Any],
        constants: Mapping[str, int | float] = {},
        rows: tuple[int, int] | None = None,
    ) -> None:
        run(self, targets, read, constants, rows)
        self.fence(targets)  # so that a phase's seconds are its own
        key = stage, str(self.kernel.source), repr(sorted(self.kernel.defines.items()))
        if key not in passes:
            names = self.compile().samplers
            large = [name for name in names if _area(read[name]) >= domain.solvable.sum()]
            passes[key] = Recorded(
                stage, self.kernel, _area(targets[0]),
                {name: _area(read[name]) * (domain.observations if name == _STACK else 1) for name in large},
                {name: _bytes(read[name]) for name in large},
                sum(_area(target) * _bytes(target) for target in targets),
                {**constants, **{name: read[name].width for name in names}},
            )  # fmt: skip
        first, last = rows or (0, targets[0].height)
        passes[key].runs += (last - first) / targets[0].height

    phases = []
    with patch.object(Pass, "run", recording), Recovery(domain, model, schedule, entry=entry) as recovery:
        progress = recovery.progress
        while not progress.done:
            stage, title, started = progress.stage, progress.title, time.perf_counter()
            while progress.stage == stage and not progress.done:
                progress = recovery.step(1)
            phases.append({"title": title, "seconds": time.perf_counter() - started})
    return phases, list(passes.values())


def row(recorded: Recorded, texels: int, observations: int) -> dict[str, Any]:
    """Return the data of a pass, per texel of the card and run; ``fixed``: the part without photographs."""
    known = {"u_observations": observations, **recorded.known}
    whole, fixed = counts(recorded.kernel, known, {**known, "u_observations": 0})
    scale = recorded.targets / texels
    fetched, fixed_fetched = (
        {name: scale * times * recorded.each[name] for name, times in counted.fetches.items() if name in recorded.each}
        for counted in (whole, fixed)
    )
    return {
        "phase": recorded.phase, "source": str(recorded.kernel.source), "runs": recorded.runs,
        "written": recorded.written / texels,
        "once": sum(count * recorded.each[name] for name, count in recorded.read.items()) / texels,
        "fetched": sum(fetched.values()), "fixed_fetched": sum(fixed_fetched.values()), "stack": fetched.get(_STACK, 0),
        "operations": scale * whole.operations, "fixed_operations": scale * fixed.operations,
    }  # fmt: skip


def ceilings(software: bool, entry: Entry) -> dict[str, float]:
    """Return the machine's peak operations, and bytes from memory, a second."""
    folder, width, turns, runs = Path(__file__).parent / "ceilings", _WIDTH[software], _TURNS[software], _RUNS[software]
    target = textures.empty(width, width)
    stack = textures.upload_layers(np.ones((_LAYERS, width, width, 4)))
    constants = {"u_count": "INT", "u_factor": "FLOAT"}
    computing = Pass(Kernel(folder / "operations.glsl", (Output("o_sum"),), {}, constants, {}), entry)
    reading = Pass(
        Kernel(folder / "reads.glsl", (Output("o_sum"),), {"u_stack": "FLOAT_2D_ARRAY"}, constants, {}), entry
    )

    def seconds(one: Pass, count: int) -> float:
        times = []
        for _ in range(_REPEATS + 1):  # the first compiles
            started = time.perf_counter()
            for _ in range(runs):
                one.run([target], {"u_stack": stack}, {"u_count": count, "u_factor": 0.999})
            one.fence([target])
            times.append((time.perf_counter() - started) / runs)
        return statistics.median(times[1:])

    return {
        "operations": _CHAINS * turns * width**2 / seconds(computing, turns),
        "bytes": 16 * _LAYERS * width**2 / seconds(reading, _LAYERS),
    }


def _area(texture: Any) -> int:
    return int(texture.width * texture.height)


def _bytes(texture: Any) -> int:
    """Return the bytes of a texel; the solver's channels have 32 bits."""
    return 4 * textures.CHANNELS[texture.format]


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    phases, passes, here, photographs = data["phases"], data["passes"], data["here"], data["observations"]
    whole = {name: sum(p["runs"] * p[name] for p in passes) for name in ("operations", "fetched", "stack")}
    return [
        f"*Standard* recovers a card of {data['side']}² texels from {photographs} photographs, {DEFAULT_MODEL}; every"
        " pass is recorded. Its operations and fetches are counted in SPIR-V, which glslang compiles and spirv-opt"
        " inlines and optimises ([spirv.py](../../benchmarks/spirv.py)): sums, products, comparisons and conversions of"
        " single numbers count one, roots and exponentials four, divisions five; all branches count. *Fetched*: bytes"
        " of all reads, as if there were no cache. *Once*: bytes of the textures that a pass reads, as if a cache held"
        " all of them. The truth lies between. Tables of lights and materials are left out: they stay in caches. All"
        " per texel of the card and run of the pass.",
        "",
        *report.table(
            ["phase", "pass", "runs", "operations", "of these a photograph", "bytes fetched", "once", "written",
             "operations a byte fetched", "once"],
            _of_passes(data, whole),
        ),
        "",
        f"Passes of less than {_SHOWN:.0%} of all operations and of all bytes are not shown. All together:"
        f" {whole['operations'] / 1e6:.1f} M operations and {whole['fetched'] / 1e3:.0f} kB fetched, of which the"
        f" samples of the photographs are {whole['stack'] / whole['fetched']:.0%}. `{_OF_SAMPLE}`, which the shared"
        f" materials run on {MAX_TEXELS} texels, counts as on a card of {_TEXELS / 1e6:.0f} million.",
        "",
        "## What bounds them",
        "",
        f"Seconds for {_TEXELS / 1e6:.0f} million texels from {photographs} photographs at published peaks, none of"
        " them measured; all texels active. Cells: operations; bytes fetched; bytes read once and written. What is"
        " largest bounds the phase; shaders reach a part of a peak. A pass costs about 10 µs besides, assumed:"
        f" {_runs(passes):.0f} passes {_runs(passes) * 1e-5:.3f} s.",
        "",
        *report.table(["phase", "passes", *(device.title for device in _DEVICES)], _foreseen(phases, passes)),
        "",
        "Samples of half the bytes would take off, of the fetched, "
        + "; ".join(f"{_TEXELS * whole['stack'] / 2 / device.bytes:.1f} s" for device in _DEVICES) + ".",
        "",
        "## This machine",
        "",
        f"Its ceilings, found by two kernels ([ceilings](../../benchmarks/ceilings)): {here['operations'] / 1e9:.1f} G"
        f" operations/s, {here['bytes'] / 1e9:.1f} GB/s. Rates are those that it would need if all texels were active:"
        " above the ceiling most are skipped, since they are done or the phase does not concern them. The step that"
        " ends a phase also places the next one's swarms.",
        "",
        *report.table(
            ["phase", "seconds", "G operations/s", "of the ceiling", "GB/s fetched"], _reached(data)
        ),
        "",
        *_by_hand(data),
    ]  # fmt: skip


def _of_passes(data: dict[str, Any], whole: Mapping[str, float]) -> Iterator[list[str]]:
    """Yield the rows of the passes above ``_SHOWN``."""
    for p in data["passes"]:
        if any(p["runs"] * p[name] > _SHOWN * whole[name] for name in ("operations", "fetched")):
            each = (p["operations"] - p["fixed_operations"]) / data["observations"]
            yield [
                data["phases"][p["phase"]]["title"], f"`{p['source']}`", f"{p['runs']:.0f}", f"{p['operations']:.0f}",
                f"{each:.0f}", f"{p['fetched']:.0f}", f"{p['once']:.0f}", f"{p['written']:.0f}",
                report.short(p["operations"] / p["fetched"], 2),
                report.short(p["operations"] / (p["once"] + p["written"]), 2),
            ]  # fmt: skip


def _runs(passes: Sequence[Mapping[str, Any]]) -> float:
    return sum(p["runs"] for p in passes)


def _sums(passes: Sequence[Mapping[str, Any]], phase: int) -> dict[str, float]:
    """Return a phase's cost per texel, summed over all runs of its passes."""
    names = ("operations", "fetched", "once", "written")
    return {name: sum(p["runs"] * p[name] for p in passes if p["phase"] == phase) for name in names}


def _foreseen(phases: Sequence[Mapping[str, Any]], passes: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    """Yield the rows of the devices' table, the last one the sums."""
    costs = [_sums(passes, number) for number in range(len(phases))]
    titles = [phase["title"] for phase in phases]
    runs = [_runs([p for p in passes if p["phase"] == number]) for number in range(len(phases))]
    costs.append({name: sum(cost[name] for cost in costs) for name in costs[0]})
    for title, count, cost in zip([*titles, "**all**"], [*runs, sum(runs)], costs, strict=True):
        cells = [
            (cost["operations"] / device.operations, cost["fetched"] / device.bytes,
             (cost["once"] + cost["written"]) / device.bytes)
            for device in _DEVICES
        ]  # fmt: skip
        yield [title, f"{count:.0f}", *("; ".join(f"{_TEXELS * each:.2f}" for each in cell) for cell in cells)]


def _reached(data: dict[str, Any]) -> Iterator[list[str]]:
    """Yield the rows of this machine's table."""
    for number, phase in enumerate(data["phases"]):
        cost = _sums(data["passes"], number)
        rate = data["side"] ** 2 / phase["seconds"]
        operations = rate * cost["operations"]
        yield [
            phase["title"], f"{phase['seconds']:.2f}", f"{operations / 1e9:.1f}",
            f"{operations / data['here']['operations']:.0%}", f"{rate * cost['fetched'] / 1e9:.1f}",
        ]  # fmt: skip


def _by_hand(data: dict[str, Any]) -> list[str]:
    """Return the lines that compare three of the counts with counts by hand."""
    by_pass = {(data["phases"][p["phase"]]["title"], p["source"]): p for p in data["passes"]}
    step = by_pass["refinement", "refine/step.glsl"]
    commit = by_pass["prefit of the normals", "swarm/synchronous/commit.glsl"]
    keep = by_pass["refinement", "refine/keep.glsl"]
    each = (step["fetched"] - step["fixed_fetched"]) / data["observations"]
    return [
        "## Counted by hand",
        "",
        f"- `refine/step.glsl` has two loops over the photographs, of equations and of candidates, and each reads one"
        f" sample of 16 bytes: 32 bytes fetched a photograph. Counted: {each:.0f}.",
        "- `swarm/synchronous/commit.glsl` of four dimensions has 9 tiles (8 particles in a square of 3 × 3), and"
        " writes place, speed and best place (16 bytes each) and fitness (4): 9 × 52 = 468 bytes. Counted:"
        f" {commit['written']:.0f}.",
        "- `refine/keep.glsl` converts the place (2) and the state (1), compares the state and two fitnesses (2),"
        " selects a status of four numbers (4) and takes the larger of two (1): 10 operations. Counted:"
        f" {keep['operations']:.0f}.",
    ]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    operations, fetched = (sum(p["runs"] * p[name] for p in data["passes"]) for name in ("operations", "fetched"))
    return f"{operations / 1e6:.1f} M operations a texel, {operations / fetched:.0f} a byte fetched"


PROGRAM = report.Program(
    "roofline", "What a pass reads, writes and computes", __file__, measure, write, headline,
    ("irpso_addon/pipeline", "benchmarks/spirv.py"),
)  # fmt: skip

if __name__ == "__main__":
    report.run(PROGRAM)
