"""Origin of a job of ``batch``: its capture's name, its place, and a digest of its files."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
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


def origin_of(capture: Path, rig: Path | None, others: Sequence[Path], output: Path) -> dict[str, Any]:
    """Return a job's origin as plain data.

    capture: a capture, or with a rig a folder of photographs. others: the job's other files, as its mesh. output: the
    batch's folder. paths: absolute, of capture and rig. from_output: the same, relative to ``output``; None on another
    drive. sha256: of names and parts of the files; None where the capture is not readable. others: the same three.
    """
    own = _places_of(_photographs(capture, rig), output) | {"sha256": _digest(lambda: _files(capture, rig))}
    return own | {"others": _places_of(others, output) | {"sha256": _digest(lambda: _with_beside(others))}}


def is_same_origin(former: Any, capture: Path, rig: Path | None, output: Path) -> bool:
    """Return whether ``former``, from ``origin_of``, is of this capture: at its place, or with the same files.

    The place is also the same where it was moved together with ``output``. True where former is None: earlier versions
    stored no origin.
    """
    return _is_same(former, _photographs(capture, rig), lambda: _files(capture, rig), output)


def has_same_others(former: Any, others: Sequence[Path], output: Path) -> bool:
    """Return as ``is_same_origin`` whether ``former`` is of these other files."""
    stored = former.get("others") if isinstance(former, dict) else None
    return _is_same(stored, others, lambda: _with_beside(others), output)


def foreign_path(former: dict[str, Any], capture: Path, rig: Path | None, others: Sequence[Path]) -> str:
    """Return the first path of ``former``, from ``origin_of``, that is none of this job's."""
    own = [str(path.resolve()) for path in (*_photographs(capture, rig), *others)]
    stored = [*former["paths"], *former.get("others", {}).get("paths", ())]
    return next((path for path in stored if path not in own), stored[0])


def _photographs(capture: Path, rig: Path | None) -> list[Path]:
    return [path for path in (capture, rig) if path is not None]


def _places_of(paths: Sequence[Path], output: Path) -> dict[str, Any]:
    whole = [str(path.resolve()) for path in paths]
    try:
        relative = [os.path.relpath(path, output.resolve()) for path in whole]
    except ValueError:  # Windows: on different drives
        relative = None
    return {"paths": whole, "from_output": relative}


def _is_same(former: Any, paths: Sequence[Path], files: Callable[[], list[Path]], output: Path) -> bool:
    if not isinstance(former, dict):
        return True
    places = _places_of(paths, output)
    if any(places[key] is not None and places[key] == former.get(key) for key in places):
        return True
    digest = _digest(files)
    return digest is not None and digest == former.get("sha256")


def _digest(files: Callable[[], list[Path]]) -> str | None:
    digest = hashlib.sha256()
    try:
        for path in files():
            digest.update(f"{path.name}\n{path.stat().st_size}\n".encode(errors="surrogatepass"))
            for piece in _pieces(path):
                digest.update(piece)
    except (InputError, OSError):
        return None
    return digest.hexdigest()


def _with_beside(paths: Sequence[Path]) -> list[Path]:
    """Return the files of paths: of a folder all, of a model's .toml the .glsl beside it, too."""
    files: list[Path] = []
    for path in paths:
        inside = sorted(one for one in path.rglob("*") if one.is_file()) if path.is_dir() else [path]
        shader = path.with_suffix(".glsl")
        files += [*inside, *[shader] * (path.suffix == ".toml" and shader.is_file())]
    return files


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
