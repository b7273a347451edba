"""Recovery of hollow subjects with and without separation of indirect light, by colour or by shadows.

Usage: python -m benchmarks.separation [--quick] [--again] [--output FOLDER]

Cycles renders each subject (benchmarks/scenes/catalogue.py) under 96 lights with four bounces, and with none for the
oracle. The mesh is not given. The limits of the separation were tuned on all subjects but the four that are marked; its
chromas on the goblet of brass.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.scenes import capture
from benchmarks.scenes.catalogue import Scene, hollow_scenes
from benchmarks.scenes.command import recover
from benchmarks.scenes.scores import Errors, angles
from irpso_addon.capture.images.exr import read_exr
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps

_SIZE, _QUICK = (160, 134), (40, 34)
_BOUNCES = 4
_CACHE = report.CACHE.parent / "separation"
_UNSEEN = "goblet, rose, matt", "goblet, two glazes", "fruits, bronze", "fruits, marble"
_ORACLE = "oracle"
_RUNS = {"off": ("--set", "prefit_indirect_share=0"), "standard": (), _ORACLE: ()}  # name → arguments
_WIDEST = 0.999 * np.pi / 2  # radians: a larger deviation marks an undetermined normal


def measure(quick: bool) -> dict[str, Any]:
    """Photograph and recover all subjects, or one if quick."""
    size, scenes = (_QUICK if quick else _SIZE), list(hollow_scenes().items())
    return {"rows": [_row(name, scene, size) for name, scene in scenes[: 1 if quick else None]], "size": size}


def _row(name: str, scene: Scene, size: tuple[int, int]) -> dict[str, Any]:
    row: dict[str, Any] = {"subject": name, "runs": {}}
    for run, arguments in _RUNS.items():
        bounces = 0 if run == _ORACLE else _BOUNCES
        folder = _CACHE / f"{capture.folder_name(name)}-{size[0]}-{bounces}"
        row["texels"] = capture.make(name, scene, size, _CACHE / "pictures", folder, bounces)
        out = folder / f"recovered-{run}"
        seconds = recover(folder, out, *arguments)
        row["runs"][run] = {"seconds": seconds, **_errors(folder, out)}
        report.say(f"{name}, {run}: {row['runs'][run]['normal']['mean']:.2f}°, {seconds:.0f} s")
    return row


def _errors(folder: Path, out: Path) -> dict[str, Any]:
    maps = read_maps(out, load_model("metallic_roughness"))
    (coverage,) = read_exr(out / "maps.exr")["coverage"].values()
    (deviation,) = read_exr(out / "maps.exr")["confidence_normal"].values()
    seen, unknown = coverage > 0, deviation > _WIDEST
    error = angles(maps["normal"], capture.read_truth(folder, "normal"))
    colour = np.abs(_chroma(maps["base_color"]) - _chroma(capture.read_truth(folder, "base_color"))).sum(axis=-1)
    return {
        "normal": asdict(Errors.of(error[seen])),
        "known": float(error[seen & ~unknown].mean()),
        "unknown": float(unknown[seen].mean()),
        "chroma": float(colour[seen].mean()),
        "separated": json.loads((out / "report.json").read_text()).get("separation", {"texels": 0})["texels"],
    }


def _chroma(colour: np.ndarray) -> np.ndarray:
    return colour / np.maximum(colour.sum(axis=-1, keepdims=True), 1e-6)


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    width, height = data["size"]
    heads = ["subject", "texels", "separated", "normal °, mean", "median", "95 %", "off by, where known", "unknown",
             "chroma of the base colour, off by", "s"]  # fmt: skip
    lines = []
    for row in data["rows"]:
        runs = [row["runs"][run] for run in _RUNS]
        lines.append([
            row["subject"] + (" †" if row["subject"] in _UNSEEN else ""), row["texels"],
            f"{100 * runs[1]['separated'] / row['texels']:.0f} %",
            *(_cell([run["normal"][key] for run in runs], digits) for key, digits in
              (("mean", 2), ("median", 2), ("p95", 1))),
            _cell([run["known"] for run in runs], 2), _cell([100 * run["unknown"] for run in runs], 0, " %"),
            _cell([run["chroma"] for run in runs], 3), _cell([run["seconds"] for run in runs], 0),
        ])  # fmt: skip
    return [
        f"Subjects rendered by Cycles ({width} × {height} pixels) under 96 lights with four bounces; their shape is not"
        " known. Cells: *standard* with `prefit_indirect_share=0` → *standard* (oracle: *standard*, from pictures"
        " without bounces). *Separated*: texels whose indirect light was separated. *Unknown*: texels"
        " whose normal the maps call unknown. Chroma: the sum of the differences of red, green and blue over their sum."
        " † looked at only here; with the others in view the limits were set. Where a subject shows its one colour"
        " twice, colour separates; elsewhere a texel's own shadows tell its indirect light.",
        "",
        *report.table(heads, lines),
    ]


def _cell(values: list[float], digits: int, unit: str = "") -> str:
    before, after, oracle = (f"{value:.{digits}f}{unit}" for value in values)
    return f"{before} → {after} ({oracle})"


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    first = data["rows"][0]
    tilts = [f"{first['runs'][run]['normal']['mean']:.1f}°" for run in _RUNS]
    return f"{first['subject']}: {', '.join(tilts)} (without, with, oracle)"


PROGRAM = report.Program(
    "separation", "Indirect light by colour and by shadows", __file__, measure, write, headline,
    (*report.RECOVER, "irpso_addon/sample", "benchmarks/scenes"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
