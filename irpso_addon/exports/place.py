"""Output folder of an export: files are written to a temporary folder, then moved together."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..core.errors import InputError
from ..results.write import check_output_folder


@contextmanager
def filled_folder(folder: str | Path) -> Iterator[Path]:
    """Yield a temporary folder; at the end move its files, and its folders' files, into ``folder``, replacing those of
    the same name.

    An exception moves nothing. Raises InputError if the folder cannot be written.
    """
    folder = check_output_folder(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".irpso-", dir=folder) as temporary:
            yield Path(temporary)
            for file in sorted(path for path in Path(temporary).rglob("*") if path.is_file()):
                place = folder / file.relative_to(temporary)
                place.parent.mkdir(exist_ok=True)
                os.replace(file, place)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error}); choose another folder") from error


def file_stem(name: str) -> str:
    """Return a name for files: letters, digits, _ and - stay, other characters become _."""
    return "".join(c if c.isalnum() or c in "_-" else "_" for c in name) or "material"
