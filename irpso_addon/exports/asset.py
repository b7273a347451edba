"""A result as an asset of a Blender asset library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..blender.materials.asset import About, recovered_slot, write_asset
from ..core.errors import InputError
from ..results.write import check_output_folder
from .catalog import catalog_id, catalog_path, catalogs_text
from .place import file_stem

_DESCRIPTION, _TAG = "Recovered from photographs by IRPSO", "photographed"


@dataclass(frozen=True)
class Shelf:
    """Library, catalog and metadata of an asset. catalog: as Stone/Marble, "" for none. Raises InputError."""

    library: Path
    catalog: str = ""
    author: str = ""
    license: str = ""
    tags: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        words = ("catalog", self.catalog), ("author", self.author), ("license", self.license)
        for option, word in (*words, *(("tag", tag) for tag in self.tags)):
            _check_utf8(option, word)
        if self.catalog:
            catalog_path(self.catalog)

    def path(self, name: str) -> Path:
        """Return the .blend of an asset. Raises InputError where it exists, or it or its catalog cannot be written."""
        _check_utf8("asset-name", name)
        path = check_output_folder(self.library) / f"{file_stem(name)}.blend"
        if path.exists():
            raise _taken(path)
        if self.catalog:
            catalogs_text(path.parent)
        return path


def write_to_shelf(shelf: Shelf, obj: Any, name: str, slots: Sequence[int] = ()) -> Path:
    """Write the recovered material of an object of the open file as an asset; return its .blend.

    slots: those whose material it is; else it is that of the active slot, or the first.
    Raises InputError where the library has it already, or cannot be written.
    """
    path = shelf.path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    catalog = catalog_id(path.parent, shelf.catalog) if shelf.catalog else ""
    tags = (word for tag in (*shelf.tags, _TAG) if (word := tag.strip()))  # an empty tag ends Blender 5.0 at once
    about = About(shelf.author, shelf.license, _DESCRIPTION, tuple(tags))
    try:
        write_asset(path, obj, recovered_slot(obj, slots), name, about, catalog)
    except FileExistsError as error:  # another process has written it meanwhile
        raise _taken(path) from error
    return path


def _check_utf8(option: str, word: str) -> None:
    """Raise InputError for bytes that are not UTF-8, which Python has as surrogates and Blender refuses."""
    try:
        word.encode()
    except UnicodeEncodeError as error:
        raise InputError(f"--{option}: {ascii(word)} is not UTF-8; give another one") from error


def _taken(path: Path) -> InputError:
    return InputError(f"{path}: the library has this file already; give another --asset-name, or remove it")
