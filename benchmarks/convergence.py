"""Error against evaluations: the presets, Levenberg–Marquardt alone and differential evolution, staged and joint.

Usage: python -m benchmarks.convergence [--quick] [--again] [--output FOLDER]
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import product, report, subjects
from benchmarks.peers.problem import Sample
from benchmarks.report import short
from irpso_addon.gpu import context

DEGRADATIONS = ("clean", "noisy", "dirty")
JOINT = ("paper", "constriction", "swarm", "standard", product.LM_ALONE, "DE")
STAGED = ("paper", "constriction", "swarm")
POINTS = 11  # samples of a recovery's trace
NAMES = ("normal", "base_color", "r1", "r2", "w")
ErrorCurve = list[tuple[float, dict[str, float]]]  # evaluations a texel, mean errors
Traced = tuple[ErrorCurve, float]  # and the evaluations that a texel made


def measure(quick: bool) -> dict[str, Any]:
    """Run all methods for every seed and degradation; seeds outermost: other load affects all methods equally."""
    size, lights, seeds, evolved = (6, 20, 1, 1) if quick else (16, 100, 3, 6)
    runs: dict[str, dict[str, list[Traced]]] = {}
    for seed in range(seeds):
        for degradation in DEGRADATIONS:
            card = subjects.make_card(size, lights, subjects.DEGRADATIONS[degradation], seed)
            for kind, names in (("joint", JOINT), ("staged", STAGED)):
                for name in names:
                    trace = _de(card, evolved, seed, quick) if name == "DE" else _ours(card, kind, name, seed, quick)
                    runs.setdefault(f"{degradation}/{kind}", {}).setdefault(name, []).append(trace)
            report.say(f"convergence: seed {seed}, {degradation} done")
    curves = {key: {name: _quartiles(traces) for name, traces in group.items()} for key, group in runs.items()}
    return {"size": size, "lights": lights, "seeds": seeds, "evolved": evolved, "curves": curves}


def _ours(card: subjects.Card, kind: str, name: str, seed: int, quick: bool) -> Traced:
    schedule = product.schedule_of(name)
    if name in product.ONE_PARTICLE:
        # A swarm searches at most eight dimensions: in a joint search the normal takes two of them, not three.
        made = schedule.replaced(normal="hemisphere") if kind == "joint" else schedule
        once = sum(stage.iterations for stage in schedule.stages)
        most = 60 if quick else None
        schedule = product.jointly(made, most or once) if kind == "joint" else product.in_stages(made, most)
    total = product.iterations_of(card.domain, card.model, schedule)
    points = product.spaced(total, 4 if quick else POINTS)
    run = product.recover(card.domain, card.model, schedule, seed, points=points, entry="fragment")
    return [_point(card, sample) for sample in run.trace], run.made


def _point(card: subjects.Card, sample: Sample) -> tuple[float, dict[str, float]]:
    errors = subjects.errors_of(card.model, sample.values, card.truth)
    return float(sample.evaluations), {name: float(errors[name].mean()) for name in NAMES}


def _de(card: subjects.Card, count: int, seed: int, quick: bool) -> Traced:
    from benchmarks.peers.swarms import differential_evolution

    problem = card.problem(count, seed)
    settings = {"population": 2, "generations": 3, "workers": 1} if quick else {"workers": 2}
    result = differential_evolution(problem, seed=seed, **settings)
    trace = []
    for sample in [*result.trace[:-1:2], result.trace[-1]]:
        errors = subjects.errors_of(card.model, sample.values, problem.truth)
        trace.append((float(sample.evaluations), {name: float(errors[name].mean()) for name in NAMES}))
    return trace, trace[-1][0]


def _quartiles(runs: list[Traced]) -> dict[str, Any]:
    """Return evaluations, every parameter's median and quartiles over seeds at these, and the median of those made."""
    traces = [trace for trace, _ in runs]
    grid = np.array([at for at, _ in traces[0]])
    rows = {name: [] for name in NAMES}
    for trace in traces:
        at = np.array([a for a, _ in trace])
        index = np.clip(np.searchsorted(at, grid * (1 + 1e-9), side="right") - 1, 0, len(at) - 1)
        for name in NAMES:
            rows[name].append([trace[i][1][name] for i in index])
    made = float(np.median([made for _, made in runs]))
    return {"evaluations": grid.tolist(), "made": made, **{name: report.fold(rows[name]) for name in NAMES}}


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines, with two plots for each kind of degradation."""
    lines = [
        f"Cards of {data['size']}² texels under {data['lights']} lights, model `cook_torrance_two_lobe`, nothing"
        f" known. Errors are means over texels; lines are medians over {data['seeds']} seeds (of card, noise and"
        " search), bands their quartiles. One evaluation renders all observations of a texel once. Plots count those"
        " of texels that have already converged; *made* does not: such texels make none. DE is scipy's differential"
        f" evolution with polish, on {data['evolved']} texels of each card.",
        "",
        "Joint: all eight numbers are searched together (the paper's constants, with two numbers for the normal"
        " instead of three, which would make nine). Staged: diffuse, normal and lobes in turn, three rounds on the"
        " current estimates; `paper` staged is the unchanged preset. [subjects.py](../../benchmarks/subjects.py)"
        " defines the disturbances of the cards.",
        "",
    ]
    for degradation in DEGRADATIONS:
        title = subjects.DEGRADATIONS[degradation].title
        lines += [f"## {title[0].upper()}{title[1:]}", ""]
        for kind, names in (("joint", JOINT), ("staged", STAGED)):
            name = _draw(data["curves"], degradation, kind, names, title, folder)
            lines += report.image(name, f"Error against evaluations, {kind}, {title}")
        lines += report.table(
            ["", "method", "evaluations a texel", "made", *(f"{name} {subjects.unit_of(name)}" for name in NAMES)],
            [_row(kind, name, data["curves"][f"{degradation}/{kind}"][name])
             for kind, names in (("joint", JOINT), ("staged", STAGED)) for name in names],
        )  # fmt: skip
    return lines


def _row(kind: str, name: str, curve: dict[str, Any]) -> list[str]:
    ends = [[short(curve[n][q][-1]) for q in ("median", "low", "high")] for n in NAMES]
    last = [f"{middle} ({low} to {high})" for middle, low, high in ends]
    return [kind, name, short(curve["evaluations"][-1]), short(curve["made"]), *last]


def _draw(curves: dict, degradation: str, kind: str, names: tuple[str, ...], title: str, folder: Path) -> str:
    """Draw one row of plots, a parameter each; return its name."""
    name = f"convergence_{degradation}_{kind}"
    with report.plot(
        folder, name, f"{kind}, {title}: error against evaluations a texel", len(NAMES), figsize=(14, 3.1), sharex=True
    ) as axes:
        for axis, parameter in zip(axes[0], NAMES, strict=True):
            for method in names:
                curve = curves[f"{degradation}/{kind}"][method]
                x, c = curve["evaluations"], curve[parameter]
                low, middle, high = (np.maximum(c[q], 1e-5) for q in ("low", "median", "high"))
                axis.plot(x, middle, color=_COLORS[method], linewidth=1.4, label=method)
                axis.fill_between(x, low, high, color=_COLORS[method], alpha=0.15, linewidth=0)
            axis.set(xscale="log", yscale="log", xlabel="evaluations a texel")
            axis.set_title(f"{parameter}, {subjects.unit_of(parameter)}")
        axes[0][-1].legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return name


_COLORS = dict(zip(("standard", "LM alone", "swarm", "constriction", "paper", "DE"), report.COLORS, strict=False))


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    parts = []
    for name in ("paper", "standard", product.LM_ALONE):
        curve = data["curves"]["noisy/joint"][name]
        parts.append(f"{name} {short(curve['normal']['median'][-1])}° after {short(curve['made'])}")
    return f"normals with noise, joint: {', '.join(parts)} evaluations made"


PROGRAM = report.Program("convergence", "Error against evaluations", __file__, measure, write, headline)

if __name__ == "__main__":
    report.run(PROGRAM)
    context.exit_process(0)
