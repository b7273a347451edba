"""``sample -o DIR``: renders a capture to practise on, with its truth."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from ..core.progress_bar import ProgressBar
from ..sample.render_sample import PHOTOGRAPHS, SIZE, Request, sample_steps
from ..sample.truth import PAGE
from .options.values import silent, size_option


def run(options: Namespace) -> dict:
    """Render the photographs and write them with their truth. Raises InputError and then writes nothing."""
    size = SIZE if options.size is None else size_option("--size", options.size)
    photographs = PHOTOGRAPHS if options.photographs is None else options.photographs
    folder = Path(options.output)
    bar = ProgressBar("sample", silent(options))
    steps = sample_steps(Request(photographs, size, options.seed), folder)
    bar.run(steps, lambda step: (step.done, step.what))
    if not silent(options):
        sys.stdout.write(f"{photographs} photographs written to {folder}; {folder / PAGE} says what to try next\n")
    return {"output": str(folder), "photographs": photographs, "seconds": round(bar.seconds, 1)}
