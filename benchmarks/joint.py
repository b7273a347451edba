"""Joint recovery of all maps, two lobes, 100 lights: the share of right texels, and errors under disturbances.

Usage: python -m benchmarks.joint [--quick] [--again] [--output FOLDER]
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import product, report, subjects
from benchmarks.identifiable import bounds
from benchmarks.report import short
from irpso_addon.gpu import context

NOISE, MAX_BOUND = 0.003, 0.02  # σ of the bound, and the bound, over the range, below which a parameter is identifiable
DEGREES, PERCENT = 1.0, 1.0  # largest errors of a right texel
METHODS = ("standard", product.LM_ALONE)
DEGRADATIONS = ("clean", "noisy", "shadowed", "dirty", "patched")


def measure(quick: bool) -> dict[str, Any]:
    """Recover cards of several seeds with every method, clean and dirty."""
    size, lights, seeds = (8, 30, 1) if quick else (48, 100, 4)
    rows = []
    for degradation in DEGRADATIONS:
        for method in METHODS:
            schedule = product.schedule_of(method)
            pooled: dict[str, list[np.ndarray]] = {}
            identifiable, seconds, evaluations = [], 0.0, 0.0
            for seed in range(seeds):
                card = subjects.make_card(size, lights, subjects.DEGRADATIONS[degradation], seed)
                run = product.recover(card.domain, card.model, schedule, seed)
                for name, error in subjects.errors_of(card.model, run.values, card.truth).items():
                    pooled.setdefault(name, []).append(error)
                identifiable.append(np.max(list(bounds(card, NOISE).values()), axis=0) < MAX_BOUND)
                seconds, evaluations = seconds + run.seconds, evaluations + run.evaluations / seeds
            errors = {name: np.concatenate(parts) for name, parts in pooled.items()}
            rows.append({"degradation": degradation, "method": method, "seconds": seconds, "evaluations": evaluations,
                         **_summary(errors, np.concatenate(identifiable))})  # fmt: skip
            right, degrees = rows[-1]["right"], rows[-1]["errors"]["normal"][0]
            report.say(f"joint: {degradation}, {method}: {right:.4f} right, {degrees:.3f}°")
    return {"size": size, "lights": lights, "seeds": seeds, "rows": rows, "floor": _floors(size, lights, quick)}


def _summary(errors: dict[str, np.ndarray], identifiable: np.ndarray) -> dict[str, Any]:
    limits = {name: DEGREES if name == "normal" else PERCENT for name in errors}
    within = {name: error < limits[name] for name, error in errors.items()}
    everything = np.all(list(within.values()), axis=0)
    return {
        "excluded": 1 - identifiable.mean(),
        "right": float(everything[identifiable].mean()),
        "within": {name: float(ok[identifiable].mean()) for name, ok in within.items()},
        "errors": {
            name: [float(x) for x in (e.mean(), np.median(e), np.quantile(e, 0.99), e[identifiable].mean())]
            for name, e in errors.items()
        },
    }


def _floors(size: int, lights: int, quick: bool) -> dict[str, list[float]]:
    """Return degradation → mean normal error, with its interval, that interreflection alone leaves.

    scipy's least squares from the truth, without the samples in shadow, on some texels of the first card: the model's
    local minimum next to the truth.
    """
    from benchmarks.peers.least_squares import scipy_least_squares
    from benchmarks.peers.objective import Loss
    from benchmarks.peers.problem import problem_of

    floors = {}
    for degradation in ("shadowed", "dirty"):
        card = subjects.make_card(size, lights, subjects.DEGRADATIONS[degradation], 0)
        whole = problem_of(card.domain, card.model, card.truth)
        chosen = subjects.sample(whole.count, 4 if quick else 150)
        lit = ~card.shadowed.reshape(lights, -1)
        fixed = replace(whole, weights=whole.weights * lit).subset(chosen)
        fit = scipy_least_squares(fixed, Loss(kind="linear", shadow=0.0), restarts=False, max_nfev=60)
        error = subjects.errors_of(card.model, fit.values, fixed.truth)["normal"]
        floors[degradation] = list(report.mean_interval(error))
    return floors


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    rows = data["rows"]
    names = list(rows[0]["errors"])
    titles = {name: degradation.title for name, degradation in subjects.DEGRADATIONS.items()}
    clean, dirty, patched = (
        next(r for r in rows if r["degradation"] == d and r["method"] == "standard")
        for d in ("clean", "dirty", "patched")
    )
    lines = [
        f"Cards of {data['size']}² texels under {data['lights']} lights, {data['seeds']} seeds pooled, model"
        " `cook_torrance_two_lobe`; base colour, normal, r1, r2 and w all unknown (8 numbers a texel)."
        " [subjects.py](../../benchmarks/subjects.py) has the formulas of the cards and their disturbances.",
        "",
        f"A texel is identifiable if its Cramér–Rao bound at noise {NOISE}, from the ground truth, is under"
        f" {MAX_BOUND:.0%} of the range in every parameter (a normal's range is 90°); **{clean['excluded']:.1%}** of"
        f" all texels are not. A texel is right if every parameter is within {DEGREES:g}° or {PERCENT:g} % of its"
        " range.",
        "",
        f"- Clean: **{clean['right']:.2%}** of the identifiable texels are right with `standard` (goal: 99 %, with"
        " at most 15 % excluded).",
        f"- {titles['dirty']}: mean normal error **{short(dirty['errors']['normal'][0])}°** over all texels with"
        f" `standard` (goal: 0.15°); {titles['patched']}: **{short(patched['errors']['normal'][0])}°**.",
        "",
        "## Right among the identifiable",
        "",
        *report.table(
            ["capture", "method", "all", *names, "evaluations a texel", "s"],
            [[titles[r["degradation"]], r["method"], f"{r['right']:.2%}", *(f"{r['within'][n]:.2%}" for n in names),
              short(r["evaluations"]), short(r["seconds"])] for r in rows],
        ),
        "## Errors over all texels: mean (median; 99th percentile)",
        "",
        "Normals in degrees, others in % of the parameter's range; for base colour the worst channel.",
        "",
        *report.table(
            ["capture", "method", *names],
            [[titles[r["degradation"]], r["method"],
              *(f"{short(a)} ({short(b)}; {short(c)})" for a, b, c, _ in r["errors"].values())] for r in rows],
        ),
    ]  # fmt: skip
    if data["floor"]:
        floors = [
            f"{titles[d]}: {short(m)}° ({short(a)} to {short(b)})"
            for d, (m, a, b) in data["floor"].items()
            if subjects.DEGRADATIONS[d].reach == 1
        ]
        lines += [
            "Error that the disturbance itself leaves: the mean normal error, with its 95 % interval, of scipy's"
            " least squares, started from the truth and without the shadowed samples, on a sample of texels:"
            f" {'; '.join(floors)}. Interreflection adds light that no local model has. With any search it bends"
            " normals toward the surrounding surface's and brightens base colours by about its own fraction.",
            "",
        ]
    return lines


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    clean, dirty = (next(r for r in data["rows"] if r["degradation"] == d) for d in ("clean", "dirty"))
    return (
        f"{clean['right']:.2%} of identifiable texels right ({clean['excluded']:.1%} excluded); normals under dirt off"
        f" by {short(dirty['errors']['normal'][0])}°"
    )


PROGRAM = report.Program(
    "joint", "Everything unknown at once", __file__, measure, write, headline,
    ("benchmarks/identifiable.py",),
)  # fmt: skip

if __name__ == "__main__":
    report.run(PROGRAM)
    context.exit_process(0)
