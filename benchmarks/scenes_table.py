"""The page of Cycles scenes (benchmarks/cycles_scenes.py) for ``make bench``.

Usage: python -m benchmarks.scenes_table [--quick] [--again] [--output FOLDER]; the scan and the materials are looked
for in the folder IRPSO_DATA, or in ../shared/data.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks import report
from benchmarks.peer_child import DATA

SCENES = report.CACHE.parent / "scenes"  # where cycles_scenes keeps its pictures
QUICK = ("--size", "48", "--resolution", "32", "--detail", "16", "--samples", "2")


def measure(quick: bool) -> dict[str, Any]:
    """Run cycles_scenes in a process of its own, on one scene if quick."""
    if not (DATA / "materials").is_dir():
        raise SystemExit(f"{DATA} has no materials; set IRPSO_DATA to the folder that has")
    out = SCENES / ("recovered-quick" if quick else "recovered")
    out.mkdir(parents=True, exist_ok=True)
    names = _names()[:1] if quick else []
    command = [sys.executable, "-m", "benchmarks.cycles_scenes", "--data", str(DATA), "-o", str(out), *names]
    subprocess.run([*command, *(QUICK if quick else ())], cwd=report.ROOT, check=True, stdout=subprocess.DEVNULL)
    return {
        "table": (out / "cycles_scenes.md").read_text(encoding="utf-8").splitlines(),
        "results": json.loads((out / "cycles_scenes.json").read_text(encoding="utf-8")),
    }


def _names() -> list[str]:
    from benchmarks.scenes import textured

    return list(textured.scene_table(DATA))


def write(data: dict[str, Any], folder: Path) -> list[str]:
    """Return the page's lines."""
    return [
        "Meshes with UVs and true maps, rendered by Cycles (an independent renderer; cast shadows, four bounces)"
        " under 40 lights and recovered by `python -m irpso_addon recover`. Cycles then renders the written"
        " material under 10 lights that were not in the capture. PSNR and SSIM compare these renders, over the"
        " subject, in sRGB. Source: [cycles_scenes.py](../../benchmarks/cycles_scenes.py).",
        "",
        *data["table"],
    ]


def headline(data: dict[str, Any]) -> str:
    """Return the text of the index."""
    return "; ".join(f"{r['scene']} {r['normal']['median']:.1f}°, {min(r['psnr']):.0f} dB" for r in data["results"])


PROGRAM = report.Program(
    "cycles_scenes", "Materials recovered from what Cycles rendered", __file__, measure, write, headline,
    (*report.RECOVER, "benchmarks/scenes", "benchmarks/peer_child.py", "benchmarks/cycles_scenes.py"),
)  # fmt: skip

if __name__ == "__main__":
    from irpso_addon.gpu import context

    report.run(PROGRAM)
    context.exit_process(0)
