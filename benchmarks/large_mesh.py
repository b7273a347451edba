"""Large maps on a mesh within a memory budget: 1024² in full, and at 4096² the plan and two of its tiles.

Usage: python -m benchmarks.large_mesh [--quick] [--again] [--output FOLDER]

Subject and pictures are those of benchmarks.multiview, whose captures must exist. For 40 lights a camera its 24
pictures are repeated: memory and time are measured here, not errors.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks import report
from benchmarks.multiview import PICTURES, run_measured

_FULL, _FEW = 1024, 4  # texels along a side, and lights a camera
_HUGE, _MANY = 4096, 40
_BUDGETS = {"full": "device=2G,host=4G", "huge": "device=512M,host=6G"}
_FOLDER = PICTURES / "head_own-around-256"
_CAPTURE = _FOLDER / "capture-8"


def measure(quick: bool) -> dict[str, Any]:
    """Run the command at 1024², and two tiles of the plan at 4096²."""
    from benchmarks.scenes import textured

    if not _CAPTURE.is_dir():
        raise SystemExit(f"{_CAPTURE} is not there; run python -m benchmarks.multiview first")
    scale = 16 if quick else 1
    command = [sys.executable, "-m", "irpso_addon", "recover"]
    mesh = ["--blend", str(_FOLDER / textured.BLEND), "--object", textured.NAME]
    few, many = (_with_lights(count) for count in (_FEW, _MANY))
    out = _FOLDER / "recovered"
    seconds, peak = run_measured([
        *command, str(few), *mesh, "--resolution", str(_FULL // scale), "--memory", _BUDGETS["full"],
        "-o", str(out / "full"), "--json", "--quiet",
    ])  # fmt: skip
    done = json.loads((out / "full" / "report.json").read_text(encoding="utf-8"))
    result = out / "tiles.json"
    tiles = [sys.executable, "-m", "benchmarks.large_mesh", "tiles", str(many), str(_HUGE // scale), str(result)]
    tiles_seconds, tiles_peak = run_measured(tiles)
    return {
        "full": {"seconds": seconds, "peak": peak, "texels": done["texels"], "tiles": done["settings"]["tiles"]},
        "huge": {"seconds": tiles_seconds, "peak": tiles_peak, **json.loads(result.read_text(encoding="utf-8"))},
        "budgets": _BUDGETS, "scale": scale,
    }  # fmt: skip


def _with_lights(count: int) -> Path:
    """Write a capture of ``count`` observations for each camera, with repeated pictures; return its path."""
    head, *observations = (_CAPTURE / "capture.toml").read_text(encoding="utf-8").split("[[observation]]")
    cameras: dict[str, list[str]] = {}
    for text in observations:
        cameras.setdefault(text[text.index("camera =") :].strip(), []).append(text.strip())
    folder = _FOLDER / f"capture-8-of-{count}"
    folder.mkdir(exist_ok=True)
    chosen = [
        f"[[observation]]\n{texts[n % len(texts)]}".replace('image = "', f'image = "../{_CAPTURE.name}/')
        for texts in cameras.values()
        for n in range(count)
    ]
    head = head.replace('mask = "', f'mask = "../{_CAPTURE.name}/')
    (folder / "capture.toml").write_text("\n\n".join([head.strip(), *chosen]) + "\n", encoding="utf-8")
    return folder


def run_tiles(capture_path: Path, resolution: int, result: Path) -> None:
    """Solve the fullest tile of the plan at ``resolution`` and the next one; write times and sizes as JSON."""
    import numpy as np

    from benchmarks.product import now
    from benchmarks.scenes import textured
    from irpso_addon.blender.images import decode
    from irpso_addon.blender.mesh import extract_mesh
    from irpso_addon.blender.scenes.scene import mesh_object, open_blend
    from irpso_addon.capture.read import read_capture
    from irpso_addon.geometry.build import domain_from_mesh
    from irpso_addon.reflectance.model import load_model
    from irpso_addon.solver.engine.tiled import TiledRecovery
    from irpso_addon.solver.planning.make_plan import covered_texels, make_plan
    from irpso_addon.solver.settings.schedule import load_schedule

    open_blend(_FOLDER / textured.BLEND)
    mesh = extract_mesh(mesh_object(textured.NAME))
    capture, model, schedule = read_capture(capture_path, decode), load_model("principled"), load_schedule("standard")
    coverage = covered_texels(capture, mesh, (resolution, resolution))
    count = len(capture.observations)
    plan = make_plan(coverage, model, schedule, (), count, memory=_BUDGETS["huge"])
    at = int(np.argmax([tile.texels for tile in plan.tiles[:-1]]))
    boxes = plan.boxes[at : at + 2]
    x0, y0 = (min(box[i] for box in boxes) for i in (0, 1))
    x1, y1 = (max(box[i] + box[i + 2] for box in boxes) for i in (0, 1))
    started = now()
    domain = domain_from_mesh(capture, mesh, resolution, resolution, window=(x0, y0, x1 - x0, y1 - y0))
    read = now()
    moved = [(x - x0, y - y0, width, height) for x, y, width, height in boxes]
    inside = np.zeros(domain.shape, bool)
    for x, y, width, height in moved:
        inside[y : y + height, x : x + width] = True
    bake = replace(domain.bake, coverage=domain.bake.coverage & inside)
    domain = replace(domain, bake=bake, solvable=domain.solvable & inside)
    with TiledRecovery(domain, model, schedule, boxes=moved, halo=plan.halo, on_device=2) as recovery:
        recovery.step()
        solved = recovery.maps().solved
    done = now()
    texels = int(sum(solved[y : y + h, x : x + w].sum() for x, y, w, h in moved))
    facts = {
        "plan": plan.lines(), "solved": texels, "observations": count, "read": (read - started).tolist(),
        "solve": (done - read).tolist(), "texels": plan.texels, "tiles": len(plan.tiles),
    }  # fmt: skip
    result.write_text(json.dumps(facts), encoding="utf-8")


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    full, huge = data["full"], data["huge"]
    work = huge["solve"][1] * huge["texels"] / max(huge["solved"], 1)
    return [
        "The head of [One view against several](multiview.md), 8 cameras. Peak: the resident memory of the whole"
        " process, including a software renderer's textures. Source:"
        " [large_mesh.py](../../benchmarks/large_mesh.py).",
        "",
        f"**{_FULL}², {_FEW} lights a camera, in full**, `--memory {data['budgets']['full']}`: {full['texels']} texels"
        f" in {'one tile' if full['tiles'] == 1 else str(full['tiles']) + ' tiles'},"
        f" {full['seconds']:.0f} s, peak {full['peak']:.2f} GiB.",
        "",
        f"**{_HUGE}², {_MANY} lights a camera**, `--memory {data['budgets']['huge']} --dry-run`:",
        "",
        "```",
        *huge["plan"],
        "```",
        "",
        f"Two of its {huge['tiles']} tiles, {huge['solved']} texels of {huge['observations']} observations: images read"
        f" and projected in {huge['read'][0]:.0f} s (processor time {huge['read'][1]:.0f} s), solved in"
        f" {huge['solve'][0]:.0f} s ({huge['solve'][1]:.0f} s), peak {huge['peak']:.2f} GiB."
        f" All tiles would take about {work / 3600:.1f} hours of processor time on this machine.",
    ]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    return f"{_FULL}² in {data['full']['peak']:.1f} GiB; two tiles of {_HUGE}² in {data['huge']['peak']:.1f} GiB"


PROGRAM = report.Program(
    "large_mesh", "Large maps on a mesh", __file__, measure, write, headline,
    (*report.RECOVER, "benchmarks/scenes", "benchmarks/peer_child.py", "benchmarks/cycles_scenes.py",
     "benchmarks/multiview.py"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    if sys.argv[1:2] == ["tiles"]:
        run_tiles(Path(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
    else:
        report.run(PROGRAM)
    context.exit_process(0)
