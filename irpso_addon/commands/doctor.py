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
    """Probe the GPU in a child process and print the facts, and what a benchmark says. Raises GpuUnavailableError."""
    found = probe.probe()
    _tell(options, fact_lines(machine_facts(found)))
    result = {**found, "entry": probe.chosen_entry(found), "versions": versions()}
    if options.benchmark:
        speed = measure_speed()
        _tell(options, ["", *speed.lines()])
        result["benchmark"] = speed.as_dict()
    return result


def _tell(options: Namespace, lines: Iterable[str]) -> None:
    if not options.json:
        sys.stdout.write("".join(f"{line}\n" for line in lines))
        sys.stdout.flush()
