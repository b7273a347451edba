"""Videos among the photographs of ``calibrate``: their frames become photographs beside the output."""

from __future__ import annotations

import shutil
import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ...blender.frames import COUNT, frame_steps
from ...calibration.photographs import videos_of
from ...calibration.write import checked_output, frames_folder, table_path
from ...core.errors import InputError
from ...core.files import check_unused
from ...core.progress_bar import ProgressBar
from .values import silent, warn


@contextmanager
def frames_of_videos(options: Namespace) -> Iterator[tuple[Path, ...]]:
    """Yield the frames of the capture's videos, written to OUT_photographs; none where it has no video.

    They are removed if the caller raises before it has written a capture of them. Raises InputError where a video shows
    no lights, or its camera moves.
    """
    if not Path(options.capture).exists():
        raise InputError(f"{options.capture}: is not there; give a folder of photographs, a video, or a capture")
    videos = videos_of(Path(options.capture))
    if not videos:
        if options.count is not None:
            raise InputError(f"--count: applies to videos, and {options.capture} has none; leave it out")
        yield ()
        return
    out = checked_output(Path(options.output), options.replace)
    folder, table = frames_folder(out), table_path(out)
    check_unused(folder, "calibrate these frames in place of the video, or delete the folder first")
    bar, before = ProgressBar("frames", silent(options)), _written_at(table)
    frames = bar.run(frame_steps(videos, folder, COUNT if options.count is None else options.count), tuple)
    try:
        warn(frames.warnings)
        if not silent(options):
            shown = ", ".join(video.name for video in videos)
            sys.stdout.write(f"{len(frames.files)} of {frames.total} frames of {shown} written to {folder}\n")
        yield tuple(folder / name for name in frames.files)
    except BaseException:
        if _written_at(table) == before:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _written_at(path: Path) -> int | None:
    return path.stat().st_mtime_ns if path.exists() else None
