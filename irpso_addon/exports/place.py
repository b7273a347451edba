"""Where an export is written: all its files at once, under temporary names first."""

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
    """Yield a temporary folder whose files are moved into ``folder`` at the end, replacing those of the same names.

    Where an exception is raised, nothing is moved. Raises InputError where the folder cannot be written.
    """
    folder = check_output_folder(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".irpso-", dir=folder) as temporary:
            yield Path(temporary)
            for made in sorted(Path(temporary).iterdir()):
                os.replace(made, folder / made.name)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error}); choose another folder") from error


def file_stem(name: str) -> str:
    """Return a name as it may stand in a file's: letters, digits, _ and -, others as _."""
    return "".join(c if c.isalnum() or c in "_-" else "_" for c in name) or "material"
