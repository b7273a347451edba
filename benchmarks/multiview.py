"""One view against several, with and without predicted shadows, near lights: a head rendered by Cycles from all sides.

Usage: python -m benchmarks.multiview [--quick] [--again] [--output FOLDER]; the scan is looked for in the folder
IRPSO_DATA, or in ../shared/data.

The head has its own colours and normals, and a roughness authored from its specular map; cast shadows, four bounces.
Each camera has 24 lights of its own, up to 60° off its axis. ``python -m irpso_addon recover`` solves the captures; its
maps are compared texel by texel, and the material that it writes is rendered by Cycles from two views and under ten
lights that were in no capture. All errors but the last two columns are over the texels that the front camera, which is
in all captures, sees.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.peer_child import DATA

PICTURES = report.CACHE.parent / "scenes"
LIGHTS = 24
_ANGLES = np.arange(0, 90, 10)  # degrees between surface and front view: lower ends of bins
_SEAM = 4  # texels


@dataclass(frozen=True)
class Size:
    """Sizes. picture: pixels, maps: texels along a side. detail: texels of the true maps' detail. samples: Cycles'."""

    picture: int = 256
    maps: int = 256
    detail: int = 128
    samples: int = 16
    lights: int = LIGHTS


QUICK = Size(48, 32, 16, 2, 6)


@dataclass(frozen=True)
class Case:
    """A recovery. cameras: number of around.shots. near: point lights. shadows: whether cast shadows are predicted."""

    cameras: int
    near: bool = False
    shadows: bool = True

    @property
    def title(self) -> str:
        """The row's title."""
        views = f"{self.cameras} view{'s' if self.cameras > 1 else ''}"
        return f"{views}{', near lights' if self.near else ''}{'' if self.shadows else ', shadows not predicted'}"


CASES = tuple(Case(n, near, shadows) for n, near in ((1, False), (3, False), (8, False), (3, True))
              for shadows in (True, False))  # fmt: skip


@dataclass(frozen=True)
class _Subject:
    """The truth. front: (H, W) bool, texels that the front camera sees. angle: degrees between it and the normal.

    border: texels to the nearest one without surface. relit: for each view, true pictures under the unseen lights, the
    subject's mask, and the mask of what the front camera sees.
    """

    truth: Any
    front: np.ndarray
    angle: np.ndarray
    border: np.ndarray
    relit: list[tuple[np.ndarray, np.ndarray, np.ndarray]]


def measure(quick: bool) -> dict[str, Any]:
    """Photograph the head, recover it in every case, and compare."""
    from benchmarks.scenes import around, render, textured

    if not (DATA / "head_leeperrysmith").is_dir():
        raise SystemExit(f"{DATA} has no head_leeperrysmith; set IRPSO_DATA to the folder that has")
    size = QUICK if quick else Size()
    scene = textured.scene_table(DATA)["head_own"]
    view = render.View(size.picture, size.picture, samples=size.samples)
    folder = PICTURES / f"head_own-around-{size.picture}{'-quick' if quick else ''}"
    subject = _photograph(scene, size, view, folder)
    results = []
    for case in CASES[:2] if quick else CASES:
        out = folder / "recovered" / case.title.replace(", ", "-").replace(" ", "_")
        seconds, peak = recover(folder, out, size.maps, case)
        results.append(_compare(case, out, subject, view, around.unseen_shots()) | {"seconds": seconds, "peak": peak})
        report.say(" | ".join(_row(results[-1])))
    return {"results": results, "note": scene.note, "size": vars(size)}


def _photograph(scene, size: Size, view, folder: Path) -> _Subject:
    """Render what the folder lacks, write the captures, and return the truth."""
    import bpy
    from scipy.ndimage import distance_transform_edt

    from benchmarks.scenes import around, render, textured
    from irpso_addon.blender.mesh import extract_mesh
    from irpso_addon.blender.scenes.scene import camera_from_object
    from irpso_addon.blender.scenes.true_surface import true_material
    from irpso_addon.geometry.project import Projector
    from irpso_addon.geometry.surface.bake import bake_camera, bake_uv
    from irpso_addon.gpu import context

    context.ensure()
    textured.prepare(scene, view, folder)
    truth = scene.maps(size.maps, size.detail)
    bpy.data.objects[textured.NAME].data.materials.append(true_material(truth))
    for cameras, near in sorted({(case.cameras, case.near) for case in CASES}):
        around.write(folder, _capture(cameras, near), around.shots(cameras, size.lights, near), 1, view)
    mesh = extract_mesh(bpy.data.objects[textured.NAME])
    bake = bake_uv(mesh, size.maps, size.maps)

    def camera_at(shot):
        around.set_camera(shot)
        return camera_from_object(bpy.context.scene.camera, view.width, view.height)

    first = camera_at(around.shots(1, 1)[0])
    front = Projector(bake, bake_camera(mesh, first), first).visible
    toward = first.position - bake.position
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip(np.einsum("hwi,hwi->hw", toward, bake.normal), -1, 1)))
    relit = []
    for shot in around.unseen_shots():
        pictures = np.stack(list(around.pictures(folder, shot)))
        mask = render.truth(folder / shot.name)["coverage"] > 0.999
        uv = bake_camera(mesh, camera_at(shot)).uv
        column, row = np.clip((uv * size.maps).astype(int), 0, size.maps - 1).transpose(2, 0, 1)
        relit.append((pictures, mask, mask & front[row, column]))
    border = distance_transform_edt(np.pad(bake.coverage, 1))[1:-1, 1:-1]
    return _Subject(truth, front, angle, border, relit)


def _capture(cameras: int, near: bool) -> str:
    return f"capture-{cameras}{'-near' if near else ''}"


def recover(folder: Path, out: Path, resolution: int, case: Case, extra: Sequence[str] = ()) -> tuple[float, float]:
    """Run the public command into a new folder; return its seconds and its peak memory in GiB."""
    from benchmarks.scenes import textured

    shutil.rmtree(out, ignore_errors=True)
    command = [
        sys.executable, "-m", "irpso_addon", "recover", folder / _capture(case.cameras, case.near),
        "--blend", folder / textured.BLEND, "--object", textured.NAME, "--resolution", resolution, "-o", out,
        "--json", "--quiet", *([] if case.shadows else ["--no-shadows"]), *extra,
    ]  # fmt: skip
    return run_measured([str(part) for part in command])


def run_measured(command: list[str]) -> tuple[float, float]:
    """Run a command in the project's root; return its seconds and its peak memory in GiB."""
    from benchmarks.product import now

    started = now()[0]
    process = subprocess.Popen(command, cwd=report.ROOT, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return float(now()[0] - started), usage.ru_maxrss / 2**20


def _compare(case: Case, out: Path, subject: _Subject, view, unseen) -> dict[str, Any]:
    from benchmarks.cycles_scenes import side_by_side
    from benchmarks.scenes.scores import angles, psnr, ssim
    from irpso_addon.capture.images.exr import read_exr
    from irpso_addon.core.encode import srgb_from_linear
    from irpso_addon.core.png import encode_png
    from irpso_addon.reflectance.model import load_model
    from irpso_addon.results.read import read_maps

    maps, truth = read_maps(out, load_model("principled")), subject.truth
    (coverage,) = read_exr(out / "maps.exr")["coverage"].values()
    solved = coverage > 0
    normal = angles(maps["normal"], truth.normal)
    colour = np.abs(maps["base_color"] - truth.base_color).mean(axis=-1)
    rough = np.abs(maps["roughness"][..., 0] - truth.roughness)
    seen = subject.front & solved
    values, shown = {}, []
    for number, (true, mask, inside) in enumerate(subject.relit):
        pictures = _relight(out, unseen[number], view)
        a, b = (srgb_from_linear(np.clip(p, 0, 1)) for p in (pictures, true))
        shown.append(side_by_side(a, b))
        for name, where in (("front", inside), ("all", mask)):
            values.setdefault(f"psnr_{name}", []).extend(psnr(x, y, where) for x, y in zip(a, b, strict=True))
            values.setdefault(f"ssim_{name}", []).extend(ssim(x, y, where) for x, y in zip(a, b, strict=True))
    encode_png(out / "relit.png", np.concatenate(shown), bits=8)
    bins = [(subject.angle >= low) & (subject.angle < low + 10) & seen for low in _ANGLES]
    near = solved & (subject.border <= _SEAM)
    return {
        "title": case.title, "case": vars(case), "texels": int(solved.sum()),
        "normal": _mean_median(normal[seen]), "base_color": _mean_median(colour[seen]),
        "roughness": _mean_median(rough[seen]),
        "by_angle": [float(normal[b].mean()) if b.sum() > 20 else None for b in bins],
        "seam": [float(normal[near].mean()), float(normal[solved & ~near].mean())],
        "seam_median": [float(np.median(normal[near])), float(np.median(normal[solved & ~near]))],
    } | {name: float(np.mean(v)) for name, v in values.items()}  # fmt: skip


def _relight(out: Path, shot, view) -> np.ndarray:
    """Return (K, H, W, 3), Cycles' renders of the material that a recovery wrote."""
    import bpy

    from benchmarks.scenes import around, render

    bpy.ops.wm.open_mainfile(filepath=str(out / "material.blend"))
    render.set_up(bpy.context.scene, view)
    return np.stack(list(around.pictures(out / "relit", shot)))


def _mean_median(values: np.ndarray) -> list[float]:
    return [float(values.mean()), float(np.median(values))]


_COLUMNS = ("capture", "texels", "normal ° mean", "median", "base colour mean", "roughness mean", "median",
            "relit, seen: PSNR dB", "SSIM", "all: PSNR dB", "SSIM", "seam", "median", "s", "GiB")  # fmt: skip


def _row(r: dict[str, Any]) -> list[str]:
    seams = [r[name][0] / r[name][1] for name in ("seam", "seam_median")]
    return [
        r["title"], str(r["texels"]), *(f"{v:.2f}" for v in r["normal"]), f"{r['base_color'][0]:.4f}",
        *(f"{v:.3f}" for v in r["roughness"]), f"{r['psnr_front']:.1f}", f"{r['ssim_front']:.4f}",
        f"{r['psnr_all']:.1f}", f"{r['ssim_all']:.4f}", *(f"{v:.2f}" for v in seams),
        f"{r['seconds']:.0f}", f"{r['peak']:.2f}",
    ]  # fmt: skip


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Draw the errors against the angle and return the page's lines."""
    size = data["size"]
    with report.plot(folder, PROGRAM.name, "Error of the normal against the angle of the front view") as axes:
        chosen = [r for r in data["results"] if r["case"]["shadows"] and not r["case"]["near"]]
        for r, colour in zip(chosen, report.COLORS, strict=False):
            values = [np.nan if v is None else v for v in r["by_angle"]]
            axes[0, 0].plot(_ANGLES + 5, values, "o-", color=colour, markersize=3, label=r["title"])
        axes[0, 0].set(xlabel="angle between surface and front view, °", ylabel="mean error, °", ylim=(0, None))
        axes[0, 0].legend()
    return [
        f"The head scan with its own colours and normals ({data['note']}), rendered by Cycles (an independent"
        f" renderer; cast shadows, four bounces) at {size['picture']}² pixels from 1, 3 and 8 cameras under"
        f" {size['lights']} lights each, and recovered by `python -m irpso_addon recover` at {size['maps']}²"
        " texels. Cycles then renders the written material from two other views under ten other lights. Errors"
        " cover the texels that the front camera sees. Relit pictures cover what it sees, and the whole subject,"
        " half of which one view does not see. Seam: the mean error (and the median) within 4 texels of the border"
        " of a UV island, divided by that of all other texels. Source:"
        " [multiview.py](../../benchmarks/multiview.py).",
        "",
        *report.table(_COLUMNS, map(_row, data["results"])),
        *report.image(PROGRAM.name, "error of the normal against the angle of the front view"),
    ]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    return "; ".join(f"{r['title']} {r['normal'][0]:.1f}°, {r['psnr_front']:.0f} dB" for r in data["results"])


PROGRAM = report.Program(
    "multiview", "One view against several", __file__, measure, write, headline,
    (*report.RECOVER, "benchmarks/scenes", "benchmarks/peer_child.py", "benchmarks/cycles_scenes.py"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
