"""``frames VIDEO…``: photographs from videos, or folders of them, of a lamp that is carried around a subject."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path

from ..blender.frames import COUNT, frame_steps
from ..calibration.photographs import videos_of
from ..core.files import check_unused
from ..core.progress_bar import ProgressBar
from .options.values import shell_quoted, silent, warn


def run(options: Namespace) -> dict:
    """Write the chosen frames into a new folder. Raises InputError and then writes nothing."""
    out = Path(options.output)
    check_unused(out)
    count = COUNT if options.count is None else options.count
    bar = ProgressBar("frames", silent(options))
    videos = [video for path in map(Path, options.videos) for video in videos_of(path) or [path]]
    frames = bar.run(frame_steps(videos, out, count), tuple)
    warn(frames.warnings)
    if not silent(options):
        next_command = f"irpso calibrate {shell_quoted(out)}"
        sys.stdout.write(f"{len(frames.files)} of {frames.total} frames written to {out}; next: {next_command}\n")
    return {"output": str(out), "frames": list(frames.numbers), "warnings": list(frames.warnings)}
