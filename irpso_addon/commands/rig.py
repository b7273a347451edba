"""``rig save CAPTURE`` and ``rig apply RIG PHOTOGRAPHS``: lamps and cameras that are calibrated once."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from ..blender.images import decode
from ..calibration.rigs.apply import apply_steps
from ..calibration.rigs.rig import read_rig, save_rig
from ..capture.read import read_spec
from ..core.errors import InputError
from ..core.progress_bar import ProgressBar
from .options.values import shell_quoted, silent, warn

_USE = {"save": (1, "irpso rig save CAPTURE -o RIG"), "apply": (2, "irpso rig apply RIG PHOTOGRAPHS -o CAPTURE")}


def run(options: Namespace) -> dict:
    """Save or apply a rig. Raises InputError and then writes nothing."""
    count, use = _USE[options.action]
    if len(options.inputs) != count:
        raise InputError(f"rig {options.action}: write {use}")
    return _save(options) if options.action == "save" else _apply(options)


def _save(options: Namespace) -> dict:
    for option, value in (("--match", options.match != "auto"), ("--exposure", options.exposure),
                          ("--half", options.half)):  # fmt: skip
        if value:
            raise InputError(f"{option}: applies to rig apply; leave it out")
    rig = save_rig(read_spec(options.inputs[0]), Path(options.output), decode)
    corrected = rig.measured is not None
    if not silent(options):
        kind = "with the corrections of develop" if corrected else "without corrections"
        lamps, cameras = len(rig.photographs), len(rig.spec.views)
        counts = f"{lamps} lamp{'s' * (lamps != 1)}, {cameras} camera{'s' * (cameras != 1)}"
        sys.stdout.write(f"{counts}, {kind}: {options.output}\n")
    return {"output": options.output, "lamps": len(rig.photographs), "cameras": len(rig.spec.views),
            "corrections": corrected}  # fmt: skip


def _apply(options: Namespace) -> dict:
    rig = read_rig(Path(options.inputs[0]))
    bar = ProgressBar("rig", silent(options))
    steps = apply_steps(
        rig, Path(options.inputs[1]), Path(options.output), options.match, options.exposure, options.half, decode
    )
    applied = bar.run(steps, tuple)
    warn([*applied.left_out, *applied.warnings])
    if not silent(options):
        out = shell_quoted(options.output)
        sys.stdout.write(
            f"{len(applied.lamps)} photographs under their lamps, written to {out}; next: irpso inspect {out}\n"
        )
    return {"output": options.output, "lamps": applied.lamps, "developed": applied.developed,
            "left_out": list(applied.left_out), "warnings": list(applied.warnings)}  # fmt: skip
