"""Output places of exports: files are written to a temporary folder, then moved together."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ..core.errors import InputError
from ..core.files import shortened
from ..results.write import check_output_folder

_MESHES = (".glb", ".gltf", ".fbx", ".obj", ".stl", ".ply", ".3mf", ".dae", ".usd", ".usda", ".usdc", ".usdz", ".blend")
_IMAGES = (".ptm", ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".tga", ".webp", ".bmp", ".hdr", ".exr")
_FILES = {*_MESHES, *_IMAGES, ".html", ".htm", ".pdf", ".zip"}


@contextmanager
def filled_folder(folder: str | Path, replace: bool = True) -> Iterator[Path]:
    """Yield a temporary folder; at the end move its files, and its folders' files, into ``folder``.

    replace: overwrite files of the same name; otherwise they are an InputError. An exception moves nothing. Raises
    InputError if the folder cannot be written.
    """
    _refuse_file(Path(folder), "name a folder")
    folder = check_output_folder(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".irpso-", dir=folder) as temporary:
            yield Path(temporary)
            files = sorted(path for path in Path(temporary).rglob("*") if path.is_file())
            places = [folder / file.relative_to(temporary) for file in files]
            check_replaced(places, replace)
            for file, place in zip(files, places, strict=True):
                place.parent.mkdir(exist_ok=True)
                os.replace(file, place)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error}); choose another folder") from error


def file_place(out: str | Path, stem: str, suffixes: Sequence[str], replace: bool = True) -> Path:
    """Return ``out`` if it has one of the suffixes, else the file of this stem and first suffix in folder ``out``.

    Raises InputError where it cannot be written, has the suffix of another format, or exists without ``replace``.
    """
    path = Path(out)
    if path.suffix.lower() in suffixes:
        path = path.with_suffix(path.suffix.lower())  # which exporters write
        check_output_folder(path.parent)
    else:
        _refuse_file(path, f"name a {' or '.join(suffixes)} file, or a folder")
        path = check_output_folder(path) / f"{stem}{suffixes[0]}"
    check_replaced([path], replace)
    return path


def check_replaced(files: Iterable[Path], replace: bool) -> None:
    """Raise InputError where one of these files exists, unless ``replace``."""
    if not replace and (existing := next((file for file in files if file.exists()), None)):
        raise InputError(f"{existing}: is there already; choose another -o, or replace it with --replace")


def _refuse_file(path: Path, remedy: str) -> None:
    """Raise InputError where a new folder's name has the suffix of a file format: the user meant a file."""
    if path.suffix.lower() in _FILES and not path.is_dir():
        raise InputError(f"{path}: this format writes no {path.suffix} file; {remedy}")


def file_stem(name: str) -> str:
    """Return a name for files: letters, digits, _ and - stay, other characters become _; a long one ends early."""
    return shortened("".join(c if c.isalnum() or c in "_-" else "_" for c in name)) or "material"
