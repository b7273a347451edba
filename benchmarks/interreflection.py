"""Hollow bodies recovered with and without the light that they throw on themselves, and from pictures without it.

Usage: python -m benchmarks.interreflection [--quick] [--again] [--output FOLDER]

Cycles renders each body (benchmarks/scenes/hollows.py) with 8 bounces, which ``irpso recover`` gets, and with none,
from which the oracle is recovered. The mesh is known, so its own normals are the truth. *Inside* is what owes more than
5 % of its light to the rest of the body.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from benchmarks import report
from benchmarks.scenes import hollows
from benchmarks.scenes.command import recover
from benchmarks.scenes.scores import Errors, angles
from benchmarks.scenes.textured import BLEND, CAPTURE, NAME
from irpso_addon.blender.images import decode
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.capture.images.exr import read_exr
from irpso_addon.capture.read import read_capture
from irpso_addon.geometry.build import domain_from_mesh
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps

_INSIDE = 0.05
_WIDEST = 0.999 * np.pi / 2  # deviations of normals that no photograph tells
_CACHE = report.CACHE.parent / "hollows"
_RUNS = {"standard": "standard", "thorough": "thorough", "oracle": "standard"}  # name → preset


def measure(quick: bool) -> dict[str, Any]:
    """Photograph and recover all bodies, one of them where it is quick."""
    side, texels, samples = (40, 24, 2) if quick else (128, 80, 64)
    rows = []
    for name in list(hollows.HOLLOWS)[: 1 if quick else None]:
        with_all, with_none = hollows.photograph(name, side, samples, _CACHE)
        share = indirect_share(with_all, with_none, texels)
        for run, preset in _RUNS.items():
            folder, out = with_none if run == "oracle" else with_all, _CACHE / "recovered" / f"{name}-{run}"
            seconds = recover(folder / CAPTURE, out, *hollows.arguments(folder, texels), "--preset", preset)
            report.say(f"{name}, {run}: {seconds:.0f} s")
            for where, texel in (("inside", share > _INSIDE), ("outside", (share >= 0) & (share <= _INSIDE))):
                rows.append({"body": name, "run": run, "where": where, "seconds": seconds, **errors(name, out, texel)})
    return {"rows": rows}


def indirect_share(with_all: Path, with_none: Path, texels: int) -> np.ndarray:
    """Return (H, W): the part of all its light that a texel owes to the rest of the body, −1 where none is seen."""
    bpy.ops.wm.open_mainfile(filepath=str(with_all / BLEND))
    mesh = extract_mesh(bpy.data.objects[NAME])
    domains = [
        domain_from_mesh(read_capture(folder / CAPTURE, decoder=decode), mesh, texels, texels)
        for folder in (with_all, with_none)
    ]
    light, direct = (domain.stack.values[..., :3].mean(axis=(0, -1)) for domain in domains)
    return np.where(domains[0].solvable, 1 - direct / np.maximum(light, 1e-9), -1.0)


def errors(name: str, out: Path, chosen: np.ndarray) -> dict[str, Any]:
    """Return the errors of a recovery at some texels, (H, W) bool."""
    body, found = hollows.HOLLOWS[name], read_maps(out, load_model("metallic_roughness"))
    parts = read_exr(out / "maps.exr")
    (coverage,), (deviation,) = (parts[name].values() for name in ("coverage", "confidence_normal"))
    chosen = chosen & (coverage > 0)
    unknown = deviation > _WIDEST
    if not (chosen & ~unknown).any():
        return {"texels": 0}
    return {
        "texels": int(chosen.sum()),
        "unknown": float(unknown[chosen].mean()),
        "normal": asdict(Errors.of(angles(found["normal"], np.array((0.0, 0.0, 1.0)))[chosen & ~unknown])),
        "color": float((found["base_color"][chosen].mean(axis=0) / body.color).mean() - 1),
        "roughness": float(np.abs(found["roughness"][chosen] - body.roughness).mean()),
        "metallic": float(np.abs(found["metallic"][chosen] - body.metallic).mean()),
    }


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    heads = ["body", "where", "maps", "texels", "unknown", "normal ° mean", "median", "95 %", "base colour",
             "roughness", "metallic", "s"]  # fmt: skip
    rows = [
        [
            r["body"], r["where"], r["run"], f"{r['texels']}",
            f"{100 * r['unknown']:.0f} %", *(f"{r['normal'][key]:.2f}" for key in ("mean", "median", "p95")),
            f"{100 * r['color']:+.1f} %", f"{r['roughness']:.3f}", f"{r['metallic']:.3f}", f"{r['seconds']:.0f}",
        ]
        for r in sorted(data["rows"], key=lambda r: (r["body"], r["where"])) if r["texels"]
    ]  # fmt: skip
    return [
        "Bodies of one material, their meshes known, rendered by Cycles with 8 bounces under 40 lights, one camera."
        " *Standard* and *thorough* are recovered from these pictures by these presets, without and with rounds of"
        " interreflection; *oracle* from pictures without bounces. *Inside* owes more than 5 % of its light to the rest"
        " of the body; base colour is the mean against the true one. *Unknown*: texels whose normal the maps"
        " call unknown, for want of direct light; the errors of normals are those of the others.",
        "",
        *report.table(heads, rows),
    ]


def headline(data: dict[str, Any]) -> str:
    """Return what the index says."""
    found = {r["run"]: r for r in data["rows"] if r["where"] == "inside" and r["body"] == data["rows"][0]["body"]}
    tilts = [f"{found[run]['normal']['mean']:.1f}°" for run in _RUNS if run in found]
    return f"{data['rows'][0]['body']}, inside: {', '.join(tilts)} ({', '.join(_RUNS)})"


PROGRAM = report.Program(
    "interreflection", "Light that the subject throws on itself", __file__, measure, write, headline
)

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
