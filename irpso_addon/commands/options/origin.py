"""Origin of a job of ``batch``: its capture's name, its place, and a digest of its files."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...calibration.radiometry.source import images_in
from ...capture.formats.registry import format_of
from ...capture.formats.table import TABLE
from ...capture.read import read_spec
from ...core.errors import InputError

_SCENE = ".blend"  # suffix of a capture that is a Blender file
_PIECE = 1 << 14  # bytes read at the beginning, middle and end of a file: photographs differ everywhere, by their noise


def name_of(capture: Path) -> str:
    """Return the name of a capture by its path: of its folder, or of a file that may have others beside it."""
    whole, known = Path(os.path.abspath(capture)), format_of(capture)
    if known is not None and whole.name in (TABLE, *known.names):
        return whole.parent.name
    is_file = (known is not None or whole.suffix.lower() == _SCENE) and not whole.is_dir()
    return whole.stem if is_file else whole.name


def origin_of(capture: Path, rig: Path | None, output: Path) -> dict[str, Any]:
    """Return a job's origin as plain data.

    capture: a capture, or with a rig a folder of photographs. output: the batch's folder. paths: absolute, of capture
    and rig. from_output: the same, relative to ``output``; None on another drive. sha256: of names and parts of the
    files; None where the capture is not readable.
    """
    return places_of(capture, rig, output) | {"sha256": _digest(capture, rig)}


def places_of(capture: Path, rig: Path | None, output: Path) -> dict[str, Any]:
    """Return the paths of an origin, without its digest."""
    paths = [str(path.resolve()) for path in (capture, rig) if path is not None]
    try:
        relative = [os.path.relpath(path, output.resolve()) for path in paths]
    except ValueError:  # Windows: on different drives
        relative = None
    return {"paths": paths, "from_output": relative}


def is_same_origin(former: Any, capture: Path, rig: Path | None, output: Path) -> bool:
    """Return whether ``former``, from ``origin_of``, is of this capture: at its place, or with the same files.

    The place is also the same where it was moved together with ``output``. True where former is None: earlier versions
    stored no origin.
    """
    if not isinstance(former, dict):
        return True
    places = places_of(capture, rig, output)
    if any(places[key] is not None and places[key] == former.get(key) for key in places):
        return True
    digest = _digest(capture, rig)
    return digest is not None and digest == former.get("sha256")


def _digest(capture: Path, rig: Path | None) -> str | None:
    digest = hashlib.sha256()
    try:
        for path in _files(capture, rig):
            digest.update(f"{path.name}\n{path.stat().st_size}\n".encode(errors="surrogatepass"))
            for piece in _pieces(path):
                digest.update(piece)
    except (InputError, OSError):
        return None
    return digest.hexdigest()


def _files(capture: Path, rig: Path | None) -> list[Path]:
    """Return the files that determine a capture."""
    if rig is not None:
        return [*images_in(capture), *(path for path in sorted(rig.rglob("*")) if path.is_file())]
    if capture.suffix.lower() == _SCENE:
        return [capture]
    spec = read_spec(capture)
    tables = [path for path in (spec.source, *spec.source.glob("*.txt")) if path.is_file()]  # a DiLiGenT folder's lists
    return [*sorted(tables), *dict.fromkeys(observation.image.path for observation in spec.observations)]


def _pieces(path: Path) -> Iterator[bytes]:
    size = path.stat().st_size
    with path.open("rb") as file:
        for start in sorted({0, max(0, (size - _PIECE) // 2), max(0, size - _PIECE)}):
            file.seek(start)
            yield file.read(_PIECE)
