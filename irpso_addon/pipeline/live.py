"""``recover --live``: a picture of the maps so far."""

from __future__ import annotations

import sys
from pathlib import Path

from ..core.errors import InputError
from ..core.files import remove_partials
from ..core.png import encode_png, png_software
from ..results.maps import Maps
from ..solver.engine.engine import RecoveryEngine
from ..solver.views.pictures import maps_so_far

LIVE = "live.png"
_SOFTWARE = "irpso recover --live"  # stated in the picture: a killed run leaves it, the next may replace it


def is_live_picture(path: Path) -> bool:
    """Return whether a run with --live wrote this file. A program that edits the picture states its own name."""
    return png_software(path) == _SOFTWARE


class LivePicture:
    """Keeps a picture of a recovery's maps in a file; a failure does not stop the run and leaves a line in warnings."""

    def __init__(self, path: Path, recovery: RecoveryEngine):
        self._path, self._recovery = path, recovery
        self.warnings: list[str] = []
        remove_partials(path)

    def show(self, maps: Maps) -> None:
        """Replace the picture."""
        progress = self._recovery.progress
        stage = "" if progress.done else f"stage {progress.title}, "
        heading = f"{100 * progress.fraction:.0f} %, {stage}iteration {progress.iteration_in_all}"
        try:
            encode_png(self._path, maps_so_far(maps, heading), bits=8, software=_SOFTWARE)
        except InputError as error:
            if not self.warnings:
                self.warnings.append(f"no picture of the maps so far: {error}")
                sys.stderr.write(f"irpso: warning: {self.warnings[0]}\n")
