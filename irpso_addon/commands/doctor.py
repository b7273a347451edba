"""``doctor``: reports the GPU, its limits, the chosen kind of pass and, on request, how fast it recovers."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Iterable

from ..gpu import probe
from ..gpu.versions import versions
from ..pipeline.speed import measure_speed
from ..solver.planning.machine import fact_lines, machine_facts


def run(options: Namespace) -> dict:
    """Probe the GPU in a child process; print facts and, by --benchmark, speeds. Raises GpuUnavailableError."""
    facts = probe.probe()
    _print_lines(options, fact_lines(machine_facts(facts)))
    result = {**facts, "entry": probe.chosen_entry(facts), "versions": versions()}
    if options.benchmark:
        speed = measure_speed()
        _print_lines(options, ["", *speed.lines()])
        result["benchmark"] = speed.as_dict()
    return result


def _print_lines(options: Namespace, lines: Iterable[str]) -> None:
    if not options.json:
        sys.stdout.write("".join(f"{line}\n" for line in lines))
        sys.stdout.flush()
