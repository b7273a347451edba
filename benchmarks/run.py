"""Runs all benchmarks one after the other and writes the index of their pages: what ``make bench`` does.

Usage: python -m benchmarks.run [--quick] [--again] [--index] [--output FOLDER] [NAME …]

Every program keeps its result in .cache/bench; one that is fresh (same sources and presets) is not measured again.
A run that was stopped goes on with the program at which it was.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from benchmarks import (
    balls,
    coarse_to_fine,
    convergence,
    fig7,
    full_size,
    gpu,
    interreflection,
    joint,
    killed,
    large_mesh,
    lights,
    multiview,
    peers_table,
    recovery_scaling,
    report,
    road,
    roofline,
    scenes_table,
    seams,
    separation,
    swarm_quality,
    swarm_scaling,
    uncalibrated,
    window,
)

_MODULES = (
    joint, lights, convergence, coarse_to_fine, peers_table, fig7, scenes_table, multiview, large_mesh, swarm_quality,
    swarm_scaling, recovery_scaling, killed, window, road, interreflection, separation, balls,
    seams, full_size, roofline, uncalibrated, gpu,
)  # fmt: skip
PROGRAMS = {module.PROGRAM.name: module for module in _MODULES}
OTHERS = {
    "neighbour_term": "What the neighbour term does: the window H and the constant c3 of Eq. 4",
    "surface": "What the phase Surface does to normals",
}
_NICE = 10  # other work on the machine goes first


def index(output: Path, quick: bool) -> list[str]:
    """Return the lines of the index of the existing pages."""
    rows, machines = [], set()
    for name, module in PROGRAMS.items():
        path = report.result_path(module.PROGRAM, quick)
        if not path.is_file() or not (output / f"{name}.md").is_file():
            continue
        result = json.loads(path.read_text(encoding="utf-8"))
        machines.add("; ".join(result["machine"].values()))
        headline = module.PROGRAM.headline(result["data"])
        rows.append(
            [f"[{result['title']}]({name}.md)", headline, result["date"], result["commit"], f"{result['seconds']:.0f}"]
        )
    rows += [[f"[{title}]({name}.md)", "", "", "", ""] for name, title in OTHERS.items()
             if (output / f"{name}.md").is_file()]  # fmt: skip
    return [
        "# Benchmarks",
        "",
        "`make bench` runs all benchmarks whose sources or presets have changed, and writes pages and plots. `make"
        " bench QUICK=1` only tests in a few minutes that all of them run. One program alone: `python -m"
        " benchmarks.joint --again`; with `--draw` it rewrites its page from the result in `.cache/bench`. The"
        " peers' PyTorch is pip's default build; pip's own settings (`PIP_EXTRA_INDEX_URL`) choose the much smaller"
        " one for processors alone. A + after a commit marks uncommitted changes.",
        "",
        *(f"Machine: {words}." for words in sorted(machines)),
        "",
        *report.table(["page", "in short", "date", "commit", "s"], rows),
    ]


def main() -> int:
    """Run the programs; return how many failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(PROGRAMS)}; all without")
    parser.add_argument("--quick", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--again", action="store_true", help="measure even where there is a fresh result")
    parser.add_argument("--index", action="store_true", help="only write the index of the pages there are")
    parser.add_argument("--output", type=Path, help="folder of pages and plots (default: docs/benchmarks)")
    options = parser.parse_args()
    if unknown := set(options.names) - set(PROGRAMS):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; choose from {', '.join(PROGRAMS)}")
    output = options.output or (report.QUICK_PAGES if options.quick else report.PAGES)
    flags = [flag for flag, on in (("--quick", options.quick), ("--again", options.again)) if on]
    failed = 0
    for name in () if options.index else options.names or PROGRAMS:
        began = time.perf_counter()
        module = f"benchmarks.{Path(PROGRAMS[name].PROGRAM.source).stem}"
        # A process each: no state in memory or in the driver carries over.
        code = subprocess.run(
            [sys.executable, "-m", module, *flags, "--output", str(output)], cwd=report.ROOT,
            preexec_fn=(lambda: os.nice(_NICE)) if hasattr(os, "nice") else None,
        ).returncode  # fmt: skip
        report.say(
            f"{name}: {'done' if code == 0 else f'failed with exit code {code}'}, {time.perf_counter() - began:.0f} s"
        )
        failed += code != 0
    output.mkdir(parents=True, exist_ok=True)
    (output / "README.md").write_text("\n".join(index(output, options.quick)).rstrip() + "\n", encoding="utf-8")
    return failed


if __name__ == "__main__":
    sys.exit(1 if main() else 0)
