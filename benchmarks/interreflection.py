"""Recovery of hollow bodies with and without rounds of interreflection, and from pictures without indirect light.

Usage: python -m benchmarks.interreflection [--quick] [--again] [--output FOLDER]; the head's scan is looked for in the
folder IRPSO_DATA, or in ../shared/data, and left out where it is not there.

Cycles renders each body (benchmarks/scenes/hollows.py) with 8 bounces, for ``irpso recover``, and with none, for the
oracle. The mesh is known, so its own normals are the truth. *Inside* are texels with more than 5 % indirect light. One
body is rendered with 1 and 2 bounces, too. Three are recovered with parts of the presets' settings.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from benchmarks import report
from benchmarks.peer_child import DATA
from benchmarks.scenes import hollows
from benchmarks.scenes.command import recover
from benchmarks.scenes.head import SCAN
from benchmarks.scenes.scores import Errors, angles
from benchmarks.scenes.textured import BLEND, CAPTURE, NAME
from irpso_addon.blender.images import decode
from irpso_addon.blender.mesh import extract_mesh
from irpso_addon.capture.images.exr import read_exr
from irpso_addon.capture.read import read_capture
from irpso_addon.geometry.build import domain_from_mesh
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps

_INSIDE = 0.05  # least indirect share
_WIDEST = 0.999 * np.pi / 2  # radians: a larger deviation marks an undetermined normal
_CACHE = report.CACHE.parent / "hollows"
_ORACLE = "oracle"
_STANDARD, _THOROUGH = (("--preset", preset) for preset in ("standard", "thorough"))
_NO_MATTE, _NO_SHADOW = (
    ("--set", setting) for setting in ("interreflection_matte_rounds=0", "prefit_indirect_shadow=0")
)
_WITHOUT = (*_STANDARD, *_NO_MATTE)
_RUNS = {"without": _WITHOUT, "standard": _STANDARD, "thorough": _THOROUGH, _ORACLE: _WITHOUT}  # name → arguments
_PARTS = {
    "without, `prefit_indirect_shadow=0`": (*_WITHOUT, *_NO_SHADOW),
    "without": _WITHOUT,
    "standard": _STANDARD,
    "standard, 1 matte round": (*_STANDARD, "--set", "interreflection_matte_rounds=1"),
    "thorough, 1 round": (*_THOROUGH, "--set", "interreflection_rounds=1"),
    "thorough": _THOROUGH,
    "thorough, no matte rounds": (*_THOROUGH, *_NO_MATTE),
    "thorough, 1 bounce": (*_THOROUGH, "--set", "interreflection_bounces=1"),
    "thorough, `prefit_indirect_shadow=0`": (*_THOROUGH, *_NO_SHADOW),
    _ORACLE: _WITHOUT,
}
_IN_PARTS = ("bowl, 0.6", "bowl, metal paint", "cloth")
_FEW_BOUNCES = (1, 2)
_SIZE, _QUICK = (128, 80, 32), (40, 24, 2)  # pixels, texels, samples


def measure(quick: bool) -> dict[str, Any]:
    """Photograph and recover all bodies, or one if quick."""
    size, (first, *others) = _QUICK if quick else _SIZE, _bodies().items()
    bodies = dict([first] if quick else [first, *others])
    rows = [row for name, body in bodies.items() for row in _compared(name, body, hollows.BOUNCES, _RUNS, size)]
    few = [
        {**row, "bounces": bounces}
        for bounces in _FEW_BOUNCES[: 1 if quick else None]
        for row in _compared(*first, bounces, _RUNS, size)
    ]
    parts = [
        row
        for name in _IN_PARTS[: 1 if quick else None]
        for row in _compared(name, bodies[name], hollows.BOUNCES, _RUNS if quick else _PARTS, size)
    ]
    return {"rows": rows, "few": few, "parts": parts, "size": size}


def _bodies() -> dict[str, hollows.Hollow]:
    scan = DATA / SCAN / "LeePerrySmith.obj"
    if scan.is_file():
        return hollows.HOLLOWS | hollows.head_parts(scan)
    report.say(f"interreflection: {scan} is not there, the head is left out; set IRPSO_DATA")
    return hollows.HOLLOWS


def _compared(
    name: str, body: hollows.Hollow, bounces: int, runs: Mapping[str, tuple[str, ...]], size: tuple[int, int, int]
) -> list[dict[str, Any]]:
    """Return the rows of a body: the errors of each run, inside and outside. Normals: where all runs determine them."""
    side, texels, samples = size
    with_light, with_none = (hollows.photograph(name, body, n, side, samples, _CACHE) for n in (bounces, 0))
    share = indirect_share(with_light, with_none, texels)
    results = {
        run: _recovered(with_none if run == _ORACLE else with_light, arguments, texels)
        for run, arguments in runs.items()
    }
    unknown = {run: _channel(out, "confidence_normal") > _WIDEST for run, (out, _) in results.items()}
    known = ~np.logical_or.reduce(list(unknown.values()))
    rows = []
    for where, texel in (("inside", share > _INSIDE), ("outside", (share >= 0) & (share <= _INSIDE))):
        for run, (out, seconds) in results.items():
            chosen = texel & (_channel(out, "coverage") > 0)
            if (chosen & known).any():
                row = {"body": name, "run": run, "where": where, "seconds": seconds, "texels": int(chosen.sum())}
                row["unknown"] = float(unknown[run][chosen].mean())
                rows.append(row | errors(body, out, chosen, known))
    return rows


@cache
def _recovered(folder: Path, arguments: tuple[str, ...], texels: int) -> tuple[Path, float]:
    """Recover a capture; return the folder of the maps, and the seconds."""
    words = "-".join(argument for argument in arguments if not argument.startswith("--"))
    out = _CACHE / "recovered" / f"{folder.name}-{words}"
    seconds = recover(folder / CAPTURE, out, *hollows.arguments(folder, texels), *arguments)
    report.say(f"{out.name}: {seconds:.0f} s")
    return out, seconds


def indirect_share(with_light: Path, with_none: Path, texels: int) -> np.ndarray:
    """Return (H, W): the indirect share of each texel's light, −1 outside the solvable texels."""
    bpy.ops.wm.open_mainfile(filepath=str(with_light / BLEND))
    mesh = extract_mesh(bpy.data.objects[NAME])
    domains = [
        domain_from_mesh(read_capture(folder / CAPTURE, decoder=decode), mesh, texels, texels)
        for folder in (with_light, with_none)
    ]
    light, direct = (np.mean([layer[..., :3] for layer in d.stack.layers()], axis=(0, -1)) for d in domains)
    return np.where(domains[0].solvable, 1 - direct / np.maximum(light, 1e-9), -1.0)


def errors(body: hollows.Hollow, out: Path, chosen: np.ndarray, known: np.ndarray) -> dict[str, Any]:
    """Return the errors of a recovery at some texels, (H, W) bool; of the normals where they are known."""
    maps = {name: value[chosen] for name, value in read_maps(out, load_model("metallic_roughness")).items()}
    return {
        "normal": asdict(Errors.of(angles(maps["normal"], np.array((0.0, 0.0, 1.0)))[known[chosen]])),
        "bias": float((maps["base_color"] / body.color).mean() - 1),
        "color": float(np.abs(maps["base_color"] / body.color - 1).mean()),
        "roughness": float(np.abs(maps["roughness"] - body.roughness).mean()),
        "metallic": float(np.abs(maps["metallic"] - body.metallic).mean()),
    }


def _channel(out: Path, name: str) -> np.ndarray:
    (values,) = read_exr(out / "maps.exr")[name].values()
    return values


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    side, texels, samples = data["size"]
    return [
        f"Bodies of one material, their meshes known, rendered by Cycles ({side} pixels, {samples} samples) with 8"
        f" bounces under 40 lights, one camera; maps of {texels} × {texels} texels. *Standard* and *thorough* are"
        " recovered from these pictures by these presets, with matte rounds and with full rounds of interreflection,"
        " *without* by *standard* without rounds; *oracle* as *without*, from pictures without bounces. Cells: without"
        " → standard → thorough (oracle). *Removed*: the shares of the error above the oracle's that *standard* and"
        " *thorough* remove; – where *without* is as good as the oracle. *Inside* owes more than 5 % of its light to"
        " the rest of the body. *Unknown*: texels whose normal the maps call unknown; the errors of normals are means"
        " over those that all four know. Base colour: mean absolute error, relative.",
        "",
        *_table("body", ((row["body"], row) for row in data["rows"])),
        "## Fewer bounces",
        "",
        "The first body, rendered with fewer bounces. The transport of the presets has 3 all the same.",
        "",
        *_table("bounces", ((row["bounces"], row) for row in data["few"])),
        "## The parts of the presets",
        "",
        "Standard has 2 matte rounds, and a full one where the surface is not matte; thorough has 2 matte and 3 full"
        " ones, with 3 bounces of transport. Normals: over texels that all runs know. Base colour: mean signed error.",
        "",
        *_parts(data["parts"]),
    ]


def _table(head: str, rows: Iterable[tuple[Any, dict[str, Any]]]) -> list[str]:
    heads = [head, "where", "texels", "unknown", "normal °", "removed", "95 % °", "base colour %", "removed",
             "roughness", "metallic", "s"]  # fmt: skip
    groups: dict[tuple[Any, str], dict[str, dict[str, Any]]] = {}
    for title, row in rows:
        groups.setdefault((title, row["where"]), {})[row["run"]] = row
    lines = []
    for (title, where), runs in groups.items():
        four = [runs[run] for run in _RUNS]
        mean, p95 = ([row["normal"][key] for row in four] for key in ("mean", "p95"))
        percent, unknown, seconds = (
            [scale * row[key] for row in four] for key, scale in (("color", 100), ("unknown", 100), ("seconds", 1))
        )
        lines.append([
            title, where, four[0]["texels"], _cell(unknown, 0), _cell(mean, 2), _removed(mean, 0.1), _cell(p95, 1),
            _cell(percent, 1), _removed(percent, 1.0),
            *(_cell([row[key] for row in four], 3) for key in ("roughness", "metallic")), _cell(seconds, 0),
        ])  # fmt: skip
    return report.table(heads, lines)


def _cell(values: list[float], digits: int) -> str:
    *runs, oracle = (f"{value:.{digits}f}" for value in values)
    return f"{' → '.join(runs)} ({oracle})"


def _removed(values: list[float], least: float) -> str:
    """Return (first − one) / (first − last) of the errors between, in %, if first − last is at least ``least``."""
    before, *after, oracle = values
    if before - oracle < least:
        return "–"
    return ", ".join(f"{100 * (before - one) / (before - oracle):.0f} %" for one in after)


def _parts(rows: list[dict[str, Any]]) -> list[str]:
    heads = ["body", "maps", "unknown", "normal ° inside", "outside", "base colour inside", "outside",
             "roughness inside", "metallic inside", "s"]  # fmt: skip
    outside = {(row["body"], row["run"]): row for row in rows if row["where"] == "outside"}
    lines = []
    for row in rows:
        if row["where"] == "inside":
            both = row, outside[row["body"], row["run"]]
            lines.append([
                row["body"], row["run"], f"{100 * row['unknown']:.0f} %", *(f"{r['normal']['mean']:.2f}" for r in both),
                *(f"{100 * r['bias']:+.1f} %" for r in both), f"{row['roughness']:.3f}", f"{row['metallic']:.3f}",
                f"{row['seconds']:.0f}",
            ])  # fmt: skip
    return report.table(heads, lines)


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    inside = {r["run"]: r for r in data["rows"] if r["where"] == "inside" and r["body"] == data["rows"][0]["body"]}
    tilts = [f"{inside[run]['normal']['mean']:.1f}°" for run in _RUNS if run in inside]
    return f"{data['rows'][0]['body']}, inside: {', '.join(tilts)} ({', '.join(_RUNS)})"


PROGRAM = report.Program(
    "interreflection", "Light that the subject throws on itself", __file__, measure, write, headline,
    (*report.RECOVER, "benchmarks/scenes", "benchmarks/peer_child.py"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
