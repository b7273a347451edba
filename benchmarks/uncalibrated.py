"""Lights from the subject's own shading, and normals under them, against those under the capture's lights.

Usage: python -m benchmarks.uncalibrated [--quick] [--again] [--output FOLDER]; an hour without a GPU.

``calibrate --ball none`` estimates the lights of captures without light files; ``recover`` runs with these and with the
given ones. Cycles renders subjects (benchmarks/scenes/catalogue.py) with four bounces under 96 lamps whose strengths
differ by 36 %; the bunnies and the head's scan are those of IRPSO_DATA, or of ../shared/data.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.peer_child import DATA, FIELD_OF_VIEW
from benchmarks.scenes import capture
from benchmarks.scenes.catalogue import catalogue, hollow_scenes, metal_scenes
from benchmarks.scenes.command import recover
from benchmarks.scenes.scores import angles
from irpso_addon.blender.images import decode
from irpso_addon.capture import read_capture
from irpso_addon.capture.images.exr import read_exr
from irpso_addon.core.paths import DEFAULT_MODEL
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.read import read_maps

_SIZE, _QUICK = (160, 134), (64, 54)
_CACHE = report.CACHE.parent / "uncalibrated"
_BUNNIES = "bunny_lambert_noshadow", "bunny_lambert", "bunny_specular"
_SCAN = "head_leeperrysmith/LeePerrySmith.obj"
_HOLLOWS = "goblet, rose, matt", "goblet, green enamel", "fruits, terracotta", "goblet, patina"
_LIGHT_FILES = "light_directions.txt", "light_intensities.txt"
# Not used in developing the method.
_UNSEEN = (
    "cat_clay", "skin_sss", "goblet, patina", "bunny_lambert_noshadow", "pot, bronze", "fruits, metal paint",
)  # fmt: skip


def measure(quick: bool) -> dict[str, Any]:
    """Photograph all subjects (the first if quick), estimate their lights, and recover them with both."""
    size = _QUICK if quick else _SIZE
    scenes = catalogue(_present(_SCAN)) | metal_scenes() | {name: hollow_scenes()[name] for name in _HOLLOWS}
    rows = []
    for name, scene in list(scenes.items())[: 1 if quick else None]:
        folder = _CACHE / f"{capture.folder_name(name)}-{size[0]}"
        capture.make(name, scene, size, _CACHE / "pictures", folder)
        rows.append(_row(name, folder))
    for name in () if quick else _BUNNIES:
        if (folder := _present(name)) is not None:
            rows.append(_row(name, folder, "--fov", FIELD_OF_VIEW))
    return {"rows": rows, "size": size}


def _present(name: str) -> Path | None:
    if (path := DATA / name).exists():
        return path
    report.say(f"uncalibrated: {path} is not there, left out; set IRPSO_DATA")
    return None


def _row(name: str, given: Path, *lens: object) -> dict[str, Any]:
    """Return the data of a capture. lens: options of the calibration for its camera."""
    bare, estimated = (_CACHE / f"{given.name}-{what}" for what in ("bare", "found"))
    shutil.rmtree(bare, ignore_errors=True)
    shutil.copytree(given, bare, ignore=shutil.ignore_patterns(*_LIGHT_FILES))
    row: dict[str, Any] = {"subject": name, **_calibrated(bare, estimated, *lens)}
    runs = {"given": given} if "refused" in row else {"given": given, "found": estimated}
    for run, folder in runs.items():
        out = _CACHE / f"{given.name}-recovered-{run}"
        row[f"{run}_seconds"] = recover(folder, out)
        row[run] = _normal_error(given, out)
    if "found" in runs:
        row |= light_errors(_lights(given), _lights(estimated))
    report.say(json.dumps(row))
    return row


def _calibrated(folder: Path, out: Path, *lens: object) -> dict[str, Any]:
    """Run ``calibrate --ball none``; return the agreement between parts of the subject, or why it refuses."""
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-m", "irpso_addon", "calibrate", folder, "--ball", "none", *lens, "-o", out]
    started = time.perf_counter()
    ended = subprocess.run(
        [*map(str, command), "--json", "--quiet"], cwd=report.ROOT, stdout=subprocess.PIPE, text=True
    )
    seconds = time.perf_counter() - started
    if ended.returncode and not ended.stdout:
        raise RuntimeError(f"{folder}: calibrate ended with {ended.returncode}, without an answer")
    if ended.returncode:
        return {"refused": json.loads(ended.stdout)["error"].rpartition(": ")[2], "seconds": seconds}
    summary = json.loads((out / "report.json").read_text(encoding="utf-8"))
    errors = [light["error_degrees"] for light in summary["lights"]]
    return {"agree": float(np.mean(errors)), "warnings": len(summary["warnings"]), "seconds": seconds}


def _lights(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return (K, 3) directions and (K,) strengths of a capture's lights."""
    shots = read_capture(folder, decode).observations
    lights = [shot.light for shot in sorted(shots, key=lambda shot: shot.name)]
    directions = np.array([light.vector for light in lights], np.float64)
    return directions, np.mean([light.intensity for light in lights], axis=-1)


def light_errors(
    reference: tuple[np.ndarray, np.ndarray], estimated: tuple[np.ndarray, np.ndarray]
) -> dict[str, float]:
    """Return mean errors of directions, degrees, without and with a common rotation, and of strengths, relative.

    reference, estimated: (K, 3) unit vectors and (K,) strengths, up to a common factor. The rotation is that of least
    squares (Kabsch 1976).
    """
    (true, strong), (other, strong_other) = reference, estimated
    u, _, vt = np.linalg.svd(other.T @ true)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    ratio = strong_other / strong
    return {
        "lights": float(angles(other, true).mean()), "turned": float(angles(other @ turn, true).mean()),
        "strengths": float(np.abs(ratio / np.median(ratio) - 1).mean()),
    }  # fmt: skip


def _normal_error(given: Path, out: Path) -> float:
    truth = capture.read_truth(given, "normal").astype(np.float64)
    length = np.linalg.norm(truth, axis=-1)
    normal = read_maps(out, load_model(DEFAULT_MODEL))["normal"]
    (coverage,) = read_exr(out / "maps.exr")["coverage"].values()
    seen = (coverage > 0) & (length > 0.5)
    return float(angles(normal[seen], truth[seen] / length[seen][:, None]).mean())


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    width, height = data["size"]
    lines = []
    for row in data["rows"]:
        if "refused" in row:
            cells = [f"refused: {row['refused']}", "", "", "", f"–, {row['given']:.1f}°"]
        else:
            cells = [
                f"{row['agree']:.1f}°", f"{row['lights']:.1f}°", f"{row['turned']:.1f}°", f"{row['strengths']:.1%}",
                f"{row['found']:.1f}°, {row['given']:.1f}°",
            ]  # fmt: skip
        name = row["subject"] + (" †" if row["subject"] in _UNSEEN else "")
        lines.append([name, *cells, f"{row['seconds']:.0f}"])
    return [
        f"Captures whose light files were taken away: subjects photographed by Cycles ({width} × {height} pixels, four"
        " bounces) under 96 lamps whose strengths differ by 36 %, and the three bunnies of the shared data under 50"
        " equal ones. Lights by `calibrate --ball none`, normals by `recover`, *Standard*. † the method was made"
        " without them.",
        "",
        *report.table(
            ["subject", "parts agree to", "lights off by", "their common rotation taken off", "strengths",
             "normals: lights found, given", "s of calibrate"],
            lines,
        ),
    ]  # fmt: skip


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    both = [row for row in data["rows"] if "found" in row]
    found, given = (np.mean([row[run] for row in both]) for run in ("found", "given"))
    return (
        f"{len(both)} of {len(data['rows'])} subjects not refused: normals off by {found:.1f}° under found lights,"
        f" {given:.1f}° under the given ones"
    )


PROGRAM = report.Program(
    "uncalibrated", "Lights from the subject's own shading", __file__, measure, write, headline,
    (*report.RECOVER, "irpso_addon/calibration", "irpso_addon/sample", "benchmarks/scenes", "benchmarks/peer_child.py"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
