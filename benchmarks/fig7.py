"""The paper's Fig. 7: seconds for 1000 iterations against the size of the domain; memory; texel·lights a second.

Usage: python -m benchmarks.fig7 [--quick] [--again] [--output FOLDER]
"""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import product, report
from benchmarks.report import short
from benchmarks.timed import Job, start

ITERATIONS = 1000
SIZES = ((150, 225), (300, 450), (600, 900), (1200, 1800), (2400, 3600))
LIGHTS = 200
COUNTS = (25, 50, 100, 200, 400)
PARTICLES = 16  # largest synchronous swarm
BUDGET = 5 << 30  # bytes of textures, which a software renderer takes from main memory
REPEATS = 3  # interleaved runs of each case
SOFTWARE = (
    "This machine has no GPU: shaders run on its processor. Seconds are processor time over all cores, which other"
    " load hardly changes, unless wall time is stated. Two idle cores take about half of them."
)
ROUGHNESS = {"search": ["r1", "r2", "w"], "cycles": 1, "iterations": ITERATIONS}
KNOWN = ("base_color", "normal")


def measure(quick: bool) -> dict[str, Any]:
    """Time all sizes (the full run first), numbers of lights, rates and the refinement."""
    sizes = [(h // 12, w // 12) for h, w in SIZES] if quick else SIZES
    lights, counts = (20, COUNTS[:3]) if quick else (LIGHTS, COUNTS)
    data = {"lights": lights, "sizes": _sizes(sizes, lights, quick), "software": product.software_renderer()}
    shape = (40, 60) if quick else SIZES[1]
    data["counts"] = [
        {"lights": n, **_with_medians(start(Job(*shape, n, changes=ROUGHNESS, fixed=KNOWN, iterations=5, chunks=3)), 5)}
        for n in counts
    ]
    report.say("fig7: numbers of lights done")
    data["rates"] = _rates((40, 60) if quick else (120, 180), 20 if quick else 100, 1 if quick else REPEATS)
    report.say("fig7: rates done")
    data["refinement"] = _refinement((20, 30) if quick else (75, 112), 20 if quick else 100)
    return data


def _with_medians(result: dict[str, Any], iterations: int) -> dict[str, Any]:
    clock, work = (statistics.median(result[key]) / iterations for key in ("clock", "work"))
    return {**result, "iteration": clock, "computed": work}


def _sizes(sizes: list[tuple[int, int]], lights: int, quick: bool) -> list[dict[str, Any]]:
    rows = []
    for number, (height, width) in enumerate(sizes):
        full = number == 0
        iterations, chunks = (20 if quick else ITERATIONS, 1) if full else (5, 2 if number < 3 else 1)
        job = Job(
            height, width, lights, changes=ROUGHNESS, fixed=KNOWN, iterations=iterations, chunks=chunks,
            budget=BUDGET if number > 1 else 0, part=2 if number > 2 else 0, warm=0 if full else 1,
        )  # fmt: skip
        result = _with_medians(start(job), iterations)
        # Of tiles that take turns only some were solved; the others are assumed equal.
        share = result.get("tiles", 1) / result.get("solved", 1)
        seconds, computed = (
            share * (result["setup"][i] + result["placing"][i] + ITERATIONS * result[key])
            for i, key in enumerate(("iteration", "computed"))
        )
        measured = full and not quick
        rows.append({
            **result, "height": height, "width": width, "full": measured, "timed": iterations * chunks,
            "all": height * width, "iteration": share * result["iteration"], "computed": share * result["computed"],
            "seconds": seconds, "computed_all": computed,
        })  # fmt: skip
        report.say(f"fig7: {height}×{width}: {seconds:.0f} s for {ITERATIONS} iterations")
    return rows


def _rates(shape: tuple[int, int], lights: int, repeats: int) -> list[dict[str, Any]]:
    """Return texel·lights a second of several variants, interleaved."""
    bare = {"search": ["all"], "cycles": 1, "iterations": 60, "prefit_iterations": 0, "refinement_iterations": 0,
            "refinement_rounds": 0}  # fmt: skip
    shared = {**bare, "linear": "search", "particles": PARTICLES, "particles_per_dimension": 0.0}
    one, whole = ({**shared, "update": update} for update in ("one", "all"))
    cases = {
        f"{title}, {entry}": Job(*shape, lights, preset, changes, fixed, count, 2, entry, covered)
        for title, preset, changes, fixed, count, covered in (
            ("`paper`, roughness stage: one particle an iteration", "paper", ROUGHNESS, KNOWN, 10, 1.0),
            (
                "`standard`'s swarm of 16, nothing in closed form: one particle an iteration",
                "standard",
                one,
                (),
                PARTICLES,
                1.0,
            ),
            ("the same: all particles an iteration", "standard", whole, (), 1, 1.0),
            ("`standard`'s swarm as it is: all particles, weights in closed form", "standard", bare, (), 2, 1.0),
            ("the same, half of the texels covered", "standard", bare, (), 2, 0.5),
        )
        for entry in ("fragment", "compute")
    }
    results: dict[str, list[dict[str, Any]]] = {name: [] for name in cases}
    for _ in range(repeats):
        for name, job in cases.items():
            results[name].append(start(job))
    rows = []
    for name, runs in results.items():
        rates = [e * lights / s for run in runs for e, s in zip(run["evaluations"], run["work"], strict=True)]
        evaluations = runs[0]["evaluations"][0] / runs[0]["texels"] / cases[name].iterations
        cost = statistics.median(s for run in runs for s in run["work"]) / cases[name].iterations / evaluations
        rows.append({"name": name, "rate": statistics.median(rates), "low": min(rates), "high": max(rates),
                     "evaluations": evaluations, "evaluation": cost, "covered": runs[0]["texels"]})  # fmt: skip
    return rows


def _refinement(shape: tuple[int, int], lights: int) -> dict[str, Any]:
    """Return the seconds of each step of a refinement, which fall as texels converge."""
    schedule = product.schedule_of(product.LM_ALONE)
    steps = 30
    changes = {"refinement_starts": False, "refinement_rounds": 0, "refinement_iterations": steps}
    runs = [
        start(Job(*shape, lights, product.LM_ALONE, changes, (), 1, steps - 1))
        for _ in range(REPEATS)
    ]  # fmt: skip
    seconds = [statistics.median(values) for values in zip(*(run["work"] for run in runs), strict=True)]
    return {"seconds": seconds, "ftol": schedule.refinement.ftol, "texels": runs[0]["texels"], "lights": lights}


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines, with plots."""
    sizes, counts = data["sizes"], data["counts"]
    whole = [r for r in sizes if "tiles" not in r or r["resident"]]
    x, y = [r["all"] for r in sizes], [r["computed"] for r in sizes]
    slopes = {
        "time against texels, all sizes": report.slope(x, y),
        "time against texels, sizes that stay on the device": report.slope([r["all"] for r in whole],
                                                                           [r["computed"] for r in whole]),
        "memory against texels, sizes that stay on the device": report.slope([r["all"] for r in whole],
                                                                             [r["memory"] for r in whole]),
        "time against observations": report.slope([r["lights"] for r in counts], [r["computed"] for r in counts]),
        "memory against observations": report.slope([r["lights"] for r in counts], [r["memory"] for r in counts]),
    }  # fmt: skip
    _draw(sizes, counts, folder)
    lines = [
        "The paper's two-lobe roughness stage: preset `paper`, model `cook_torrance_two_lobe`, normal and base"
        f" colour known, r1, r2 and w searched by 16 particles, {data['lights']} lights, every texel covered. The"
        f" first size is run in full. The others are **extrapolated** to {ITERATIONS} iterations from a few timed"
        f" ones, after the swarms are placed. Sizes that do not fit {BUDGET >> 30} GiB of textures are solved in"
        " tiles that take turns on the device. Eq. 4 reads neighbours in every iteration, so every tile, with its"
        " images and swarms, is transferred in both directions each time. There, two tiles were timed, and the"
        " others are assumed equal.",
        "",
        SOFTWARE if data["software"] else "Seconds are wall time.",
        "",
        *report.image("fig7", "Seconds and memory against texels and observations, both axes logarithmic"),
        *report.table(
            ["texels", "tiles", "timed iterations", "s an iteration", "million texel·lights a second",
             f"s for {ITERATIONS} iterations", "wall s", "", "MB at the peak"],
            [[f"{r['height']} × {r['width']}", _tiles(r), r["timed"], short(r["computed"]),
              f"{r['all'] * data['lights'] / r['computed'] / 1e6:.1f}", f"{r['computed_all']:.0f}",
              f"{r['seconds']:.0f}", "measured" if r["full"] else "extrapolated",
              f"{r['memory']:.0f}" + (" (two tiles)" if r.get("resident") is False else "")] for r in sizes],
        ),
        *report.table(
            ["observations", "s an iteration", "million texel·lights a second", "MB at the peak"],
            [[r["lights"], short(r["computed"]), f"{r['texels'] * r['lights'] / r['computed'] / 1e6:.1f}",
              f"{r['memory']:.0f}"] for r in counts],
        ),
        "Log–log slopes (1 is proportional; goal: 1.0 ± 0.1):",
        "",
        *(f"- {name}: **{value:.3f}**" for name, value in slopes.items()),
        "",
        *_affine(counts),
        "Memory is the process's peak minus its memory before the domain was made; it includes a software"
        " renderer's textures. The images of this benchmark are one repeated row, so the sample stack takes no room"
        " on the host: the count covers the upload and the device.",
        "",
        "## Texel·lights a second",
        "",
        f"Medians over {REPEATS} interleaved runs of each, with minimum and maximum; one evaluation renders all"
        " observations of a texel. If all particles move, each observation is read once for several of them. The"
        " closed form needs two renders per evaluation of a particle, and far fewer particles.",
        "",
        *report.table(
            ["what", "evaluations a texel and iteration", "million texel·lights a second",
             "µs an evaluation of a texel", "over fragment"],
            [_rate_row(r, data["rates"]) for r in data["rates"]],
        ),
        "## Converged texels",
        "",
        *_refinement_lines(data["refinement"], folder),
    ]  # fmt: skip
    return lines


def _affine(counts: list[dict[str, Any]]) -> list[str]:
    """Return the lines on time and memory as affine functions of the number of observations."""
    lights = np.array([row["lights"] for row in counts], float)
    fits = []
    for key, unit, scale in (("computed", "ms", 1e3), ("memory", "MB", 1.0)):
        values = scale * np.array([row[key] for row in counts])
        each, fixed = np.polyfit(lights, values, 1)
        residual = np.abs(fixed + each * lights - values) / values
        fits.append(f"{short(fixed)} {unit} + {short(each)} {unit} an observation (within {residual.max():.0%})")
    return [
        "Time and memory grow linearly with observations, with an offset for the swarms themselves, which every"
        f" iteration reads and writes: {fits[0]}; {fits[1]}. So the slopes are below 1.",
        "",
    ]


def _tiles(row: dict[str, Any]) -> str:
    if "tiles" not in row:
        return "1"
    return f"{row['tiles']}, {'all on the device' if row['resident'] else str(row['on_device']) + ' at a time'}"


def _rate_row(row: dict[str, Any], rows: list[dict[str, Any]]) -> list[str]:
    name, _, entry = row["name"].rpartition(", ")
    other = next(r for r in rows if r["name"] == f"{name}, fragment")
    rate, low, high = (f"{row[key] / 1e6:.1f}" for key in ("rate", "low", "high"))
    gain = "" if entry == "fragment" else short(row["rate"] / other["rate"])
    cost = short(1e6 * row["evaluation"] / row["covered"])
    return [row["name"], short(row["evaluations"]), f"{rate} ({low}–{high})", cost, gain]


def _refinement_lines(refinement: dict[str, Any], folder: Path) -> list[str]:
    seconds = refinement["seconds"]
    with report.plot(folder, "fig7_refinement", "A refinement: what a step costs as texels are done") as axes:
        axis = axes[0][0]
        axis.plot(
            range(2, len(seconds) + 2), [1e3 * s for s in seconds], color=report.COLORS[0], marker="o", markersize=3
        )
        axis.set(xlabel="step", ylabel="ms", ylim=(0, None))
    last = statistics.median(seconds[-5:])
    return [
        f"{refinement['texels']} texels under {refinement['lights']} lights with noise, Levenberg–Marquardt from"
        f" the Lambertian seed. The first timed step takes {1000.0 * seconds[0]:.0f} ms, the last ones"
        f" {1000.0 * last:.0f} ms ({last / seconds[0]:.0%}): a texel has converged once two steps gain less than"
        f" {refinement['ftol']:g} of its fitness.",
        "",
        *report.image("fig7_refinement", "Milliseconds a step against the step's number"),
    ]


def _draw(sizes: list[dict], counts: list[dict], folder: Path) -> None:
    with report.plot(folder, "fig7", "Two-lobe roughness stage, preset paper", 3) as axes:
        time, lights, memory = axes[0]
        for full, mark, name in ((True, "o", "measured"), (False, "s", "extrapolated")):
            chosen = [r for r in sizes if r["full"] == full]
            if chosen:
                time.plot([r["all"] for r in chosen], [r["computed_all"] for r in chosen], mark, color=report.COLORS[1],
                          markerfacecolor=report.COLORS[1] if full else "white", label=name)  # fmt: skip
        first = sizes[0]
        ends = [first["all"], sizes[-1]["all"]]
        each = first["computed_all"] / first["all"]
        time.plot(ends, [each * n for n in ends], "--", color=report.COLORS[7], linewidth=1, label="proportional")
        time.set(xlabel="texels", ylabel=f"s for {ITERATIONS} iterations", title="time against texels")
        time.legend(fontsize=7)
        n = [r["lights"] for r in counts]
        lights.plot(n, [1e3 * r["computed"] for r in counts], "o-", color=report.COLORS[1], linewidth=1)
        lights.set(xlabel="observations", ylabel="ms an iteration", title="time against observations")
        lights.set_xticks(n, [str(v) for v in n])
        chosen = [r for r in sizes if "tiles" not in r or r["resident"]]
        memory.plot([r["all"] * LIGHTS for r in chosen], [r["memory"] for r in chosen], "o-", color=report.COLORS[1],
                    linewidth=1, label="sizes")  # fmt: skip
        memory.plot([r["texels"] * r["lights"] for r in counts], [r["memory"] for r in counts], "^-",
                    color=report.COLORS[2], linewidth=1, label="observations")  # fmt: skip
        memory.set(xlabel="texels × observations", ylabel="MB", title="memory")
        memory.legend(fontsize=7)
        for axis in axes[0]:
            axis.set(xscale="log", yscale="log")
        lights.set_xticks(n, [str(v) for v in n])


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    first, last = data["sizes"][0], data["sizes"][-1]
    return (
        f"{first['height']} × {first['width']} texels, {data['lights']} lights: {first['computed_all']:.0f} s of work;"
        f" {last['height']} × {last['width']}: {last['computed_all'] / 3600:.1f} h extrapolated"
    )


PROGRAM = report.Program(
    "fig7", "Time and memory against size: the paper's Fig. 7", __file__, measure, write, headline,
    ("benchmarks/timed.py",),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
