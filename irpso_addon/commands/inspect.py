"""``inspect CAPTURE``: lists the contents of a capture and its faults."""

from __future__ import annotations

import sys
from argparse import Namespace

from ..blender.images import decode
from ..capture.inspect.damage import DAMAGE
from ..capture.inspect.report import inspect_capture
from ..core.errors import InputError
from .options.values import positive

_GOALS = ("normals", "roughness")  # of recover's default model; a fact says whether the lights suffice for two lobes


def run(options: Namespace) -> dict:
    """Print facts and findings; the exit code is 2 if a finding is an error."""
    distance = positive("--distance", options.distance)
    width = positive("--card-width", options.card_width)
    if distance and width:
        raise InputError("--distance and --card-width: give one of them")
    report = inspect_capture(
        options.capture, decode, options.colour_space, _GOALS, distance, options.skip_damaged, width
    )  # fmt: skip
    if not report.facts:  # the capture could not be opened
        raise InputError("; ".join(finding.message for finding in report.findings))
    if not options.json:
        column = max(len(name) for name, _ in report.facts)
        lines = [f"{name:{column}}  {value}" for name, value in report.facts]
        lines += [f"{finding.severity}: {finding.message}" for finding in report.findings] or ["nothing suspicious"]
        if report.codes & DAMAGE:
            lines.append("hint: --skip-damaged, here and of recover, leaves damaged images out")
        sys.stdout.write("\n".join(lines) + "\n")
    findings = [{"severity": f.severity, "code": f.code, "message": f.message} for f in report.findings]
    return {"facts": dict(report.facts), "findings": findings, "exit_code": 0 if report.usable else 2}
