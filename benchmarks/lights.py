"""Number and spread of the lights of a capture: errors, texels that fail, and the warnings of ``inspect``.

Usage: python -m benchmarks.lights [--quick] [--again] [--output FOLDER]
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import product, report, subjects
from benchmarks.report import short
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.inspect import sufficiency
from irpso_addon.capture.inspect.report import inspect_capture
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from irpso_addon.gpu import context

COUNTS = (200, 100, 50, 20, 10, 5, 3)
SPREAD_OVER = 50  # lights, where their spread is measured
CONES = (73, 60, 45, 30, 20, 10)  # degrees between the axis and the outermost light
FANS = (0.5, 0.2, 0.1, 0.05, 0.02)  # width across the fan's plane over that along it
DEGREES, PERCENT = 5.0, 10.0  # larger errors are failures
FEW = 0.05  # share of texels that may fail
OUTDATED = 0.03  # largest difference between a figure in inspect and the measured one
MODELS = {"principled": "one lobe", "cook_torrance_two_lobe": "two lobes"}
# Goal of a capture → the parameters that must not fail.
GOALS = {"normal": ("normal",), "roughness": ("roughness",), "two lobes": ("r1", "r2", "w")}


def cone(count: int, degrees: float) -> np.ndarray:
    """Return (K, 3) lights on a spiral up to ``degrees`` off the axis."""
    return subjects.spiral_lights(count, float(np.cos(np.radians(degrees))))


def fan(count: int, width: float) -> np.ndarray:
    """Return (K, 3) lights of the spiral with y scaled by ``width`` and z recomputed."""
    lights = subjects.spiral_lights(count) * (1, width, 1)
    lights[:, 2] = np.sqrt(1 - (lights[:, :2] ** 2).sum(axis=1))
    return lights


def lights_of(kind: str, value: float) -> np.ndarray:
    """Return unit directions (K, 3) of a set of lights. value: their number, the cone's degrees or the fan's width."""
    if kind == "number":
        return subjects.spiral_lights(int(value))
    return cone(SPREAD_OVER, value) if kind == "cone" else fan(SPREAD_OVER, value)


def measure(quick: bool) -> dict[str, Any]:
    """Recover cards under every set of lights with ``standard``."""
    size, seeds = (6, 1) if quick else (32, 2)
    sets = [("number", n, ("noisy", "dirty")) for n in COUNTS]
    sets += [(kind, v, ("noisy",)) for kind, values in (("cone", CONES), ("fan", FANS)) for v in values]
    rows = []
    for kind, value, degradations in sets[:: 6 if quick else 1]:
        lights = lights_of(kind, value)
        for model in MODELS:
            for degradation in degradations:
                rows.append({"kind": kind, "value": value, **_row(model, lights, degradation, size, seeds)})
            report.say(f"lights: {kind} {value}, {model}: {rows[-1]['failed']}")
    return {"size": size, "seeds": seeds, "rows": rows}


def _row(model: str, lights: np.ndarray, degradation: str, size: int, seeds: int) -> dict[str, Any]:
    pooled: dict[str, list[np.ndarray]] = {}
    for seed in range(seeds):
        card = subjects.make_card(size, lights, subjects.DEGRADATIONS[degradation], seed, model)
        run = product.recover(card.domain, model, product.schedule_of("standard"), seed)
        for name, error in subjects.errors_of(model, run.values, card.truth).items():
            pooled.setdefault(name, []).append(error)
    errors = {name: np.concatenate(parts) for name, parts in pooled.items()}
    bad = {name: error > (DEGREES if name == "normal" else PERCENT) for name, error in errors.items()}
    failed = {"any": float(np.any(list(bad.values()), axis=0).mean())}
    for goal, names in GOALS.items():
        if all(name in bad for name in names):
            failed[goal] = float(np.any([bad[name] for name in names], axis=0).mean())
    return {
        "model": model, "degradation": degradation, "failed": failed,
        "errors": {name: [float(e.mean()), float(np.median(e))] for name, e in errors.items()},
    }  # fmt: skip


def inspect_lights(lights: np.ndarray) -> tuple[str, list[str]]:
    """Return the goals for which ``inspect`` calls these lights enough, and its findings on them."""
    shades = np.random.default_rng(0).random((len(lights), 1)) + 1
    picture = np.ones((4, 4, 4), np.float32)
    observations = tuple(
        Observation(f"{k}", lambda shade=shade: picture * np.float32((*shade, *shade, *shade, 1)), Light(tuple(light)))
        for k, (shade, light) in enumerate(zip(shades, lights.tolist(), strict=True))
    )
    camera = Camera(4, 4, (4.0, 4.0), (2.0, 2.0), np.eye(4), False)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "capture"
        write_capture(Capture("lights", observations, (camera,), (np.ones((4, 4), bool),)), target, single_file=True)
        inspection = inspect_capture(target, goals=sufficiency.GOALS)
    (enough_for,) = [value for name, value in inspection.facts if name == "enough for"]
    return enough_for, [f.message.split(": ", 1)[1] for f in inspection.findings if f.code.startswith("lights")]


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines, with its plots."""
    rows = data["rows"]
    lines = [
        f"Cards of {data['size']}² texels, {data['seeds']} seeds pooled, preset `standard`, everything unknown. A"
        f" texel fails if its normal is off by more than {DEGREES:g}°, or another parameter by more than"
        f" {PERCENT:g} % of its range. Unless stated otherwise, lights are distributed evenly over the sphere down"
        " to 73° from the axis. `inspect` uses these figures. Interreflection brightens base colours by about its"
        " own fraction; no fit can distinguish the two.",
        "",
    ]
    with report.plot(folder, "lights", "Texels that fail, preset standard", 3) as axes:
        for axis, (kind, label) in zip(axes[0], _KINDS.items(), strict=True):
            _draw(axis, [r for r in rows if r["kind"] == kind], label, kind)
        axes[0][0].legend(fontsize=7)
    lines += report.image("lights", "Fraction of texels that fail against number and spread of lights")
    for kind, label in _KINDS.items():
        for model, title in MODELS.items():
            chosen = [r for r in rows if r["kind"] == kind and r["model"] == model]
            if chosen:
                lines += [f"## {label[0].upper()}{label[1:]}, {title} (`{model}`)", "", *_table(chosen, label)]
    lines += ["## What `inspect` says beforehand", "", *_outdated(rows)]
    # Inspected now: the stored measurement may be older than inspect's texts.
    cells = []
    for kind, value in dict.fromkeys((r["kind"], r["value"]) for r in rows):
        enough_for, findings = inspect_lights(lights_of(kind, value))
        cells.append([f"{_KINDS[kind]} {value:g}", enough_for, "<br>".join(findings)])
    return [*lines, *report.table(["lights", "enough for", "why not for the others"], cells)]


def _outdated(rows: list[dict]) -> list[str]:
    """Return a warning line if the figures in inspect differ from the measured ones."""
    off = []
    for kind, degradation, figures in (("number", "dirty", sufficiency.NUMBER), ("cone", "noisy", sufficiency.CONE),
                                ("fan", "noisy", sufficiency.ACROSS)):  # fmt: skip
        for figure in figures:
            same = [r for r in rows if (r["kind"], r["degradation"], r["value"]) == (kind, degradation, figure.value)]
            for model, ask, at in (("principled", "normal", 0), ("principled", "roughness", 1),
                                   ("cook_torrance_two_lobe", "two lobes", 2)):  # fmt: skip
                now = [r["failed"][ask] for r in same if r["model"] == model]
                if now and abs(now[0] - figure.failed[at]) > OUTDATED:
                    off.append(f"{kind} {figure.value:g}, {ask}: {figure.failed[at]:.1%} there, {now[0]:.1%} here")
    return (
        [f"The figures in `irpso_addon/capture/inspect/sufficiency.py` are outdated: {'; '.join(off)}.", ""]
        if off
        else []
    )


_KINDS = {"number": "number of lights", "cone": "half-angle of the cone, degrees", "fan": "width across a fan"}


def _draw(axis: Any, rows: list[dict], label: str, kind: str) -> None:
    styles = {"normal": 0, "roughness": 1, "two lobes": 2}
    for model in MODELS:
        for degradation, dash in (("noisy", "-"), ("dirty", "--")):
            chosen = [r for r in rows if r["model"] == model and r["degradation"] == degradation]
            for goal, color in styles.items():
                if not chosen or goal not in chosen[0]["failed"]:
                    continue
                if goal == "normal" and model != "principled":
                    continue
                x, y = [r["value"] for r in chosen], [100 * r["failed"][goal] for r in chosen]
                name = f"{goal}, {degradation}" if kind == "number" else goal
                axis.plot(x, y, dash, marker="o", markersize=3, color=report.COLORS[color], label=name, linewidth=1.3)
    axis.set(xscale="log", xlabel=label, ylabel="texels that fail, %", ylim=(-3, 103))
    values = sorted({r["value"] for r in rows})
    axis.set_xticks(values, [f"{v:g}" for v in values])


def _table(rows: list[dict], label: str) -> list[str]:
    names = list(rows[0]["errors"])
    header = [label, "capture", *(f"{n} {subjects.unit_of(n)}" for n in names), "fails: normal", "lobes", "any"]
    cells = []
    for r in rows:
        lobes = r["failed"].get("roughness", r["failed"].get("two lobes"))
        failed = [f"{100 * x:.1f} %" for x in (r["failed"]["normal"], lobes, r["failed"]["any"])]
        errors = [f"{short(mean)} ({short(median)})" for mean, median in r["errors"].values()]
        cells.append([f"{r['value']:g}", subjects.DEGRADATIONS[r["degradation"]].title, *errors, *failed])
    return ["Errors: mean (median).", "", *report.table(header, cells)]


def headline(data: dict[str, Any]) -> str:
    """Return the index entry: the fewest lights with which few texels fail."""
    parts = []
    for goal in GOALS:
        rows = [
            r for r in data["rows"] if r["kind"] == "number" and r["degradation"] == "noisy" and goal in r["failed"]
        ]
        good = [r["value"] for r in rows if r["failed"][goal] <= FEW]
        parts.append(f"{goal} from {min(good)} lights" if good else f"{goal} with none of these numbers")
    return f"under {FEW:.0%} of texels fail: {', '.join(parts)}"


PROGRAM = report.Program(
    "lights", "How many lights a capture needs", __file__, measure, write, headline,
    report.CAPTURE,
)  # fmt: skip

if __name__ == "__main__":
    report.run(PROGRAM)
    context.exit_process(0)
