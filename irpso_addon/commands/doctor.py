"""``doctor``: reports the GPU, its limits, and the chosen kind of pass."""

from __future__ import annotations

import sys
from argparse import Namespace

from ..gpu import probe
from ..gpu.versions import versions
from ..solver.planning.machine import fact_lines, machine_facts


def run(options: Namespace) -> dict:
    """Probe the GPU in a child process and print the facts. Raises GpuUnavailableError."""
    found = probe.probe()
    if not options.json:
        sys.stdout.write("".join(f"{line}\n" for line in fact_lines(machine_facts(found))))
    return {**found, "entry": probe.chosen_entry(found), "versions": versions()}
