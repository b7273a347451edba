"""Files and folders: shipped tables by name, constants of shaders, and atomic writes through a temporary name."""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .errors import InputError
from .paths import SHADERS

INCLUDE = re.compile(r'^[ \t]*#include[ \t]+"([^"\n]+)"[ \t]*$', re.M)  # of a GLSL file: the name of another
JSON_ERRORS = "backslashreplace"  # for names that are no UTF-8: their escapes are JSON's own, and read back exactly
_NAME_BYTES = 150
_unfinished: set[Path] = set()  # folders that are being filled


@contextmanager
def replacing_file(path: Path, durable: bool = False, new: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, moved onto it at the end, or deleted after an exception.

    durable: flush it to the disk. new: raise FileExistsError, at the end, if ``path`` exists by then; of processes that
    write it at once, on whatever machines, one succeeds. Raises InputError if the folder cannot be written.
    """
    partial = path.with_name(f"{_partial_prefix(path)}{os.getpid()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        if durable:
            synced(partial)
        if new:  # an empty file holds the name: not every file system has hard links
            os.close(os.open(path, os.O_CREAT | os.O_EXCL))
        try:
            os.replace(partial, path)
        except BaseException:
            if new and partial.exists():  # else an interrupt came when it was moved
                path.unlink(missing_ok=True)
            raise
        if durable:
            synced(path.parent)
    except OSError as error:
        if new and isinstance(error, FileExistsError):
            raise
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        if partial.exists():
            partial.unlink()


def shortened(name: str) -> str:
    """Return the beginning of a name, in at most 150 bytes of UTF-8: file systems allow 255, with prefix and suffix."""
    return name.encode(errors="replace")[:_NAME_BYTES].decode(errors="ignore")


def remove_partials(path: Path) -> None:
    """Remove partial versions of a file that killed processes left."""
    for left in path.parent.glob(f"{_partial_prefix(path)}*{path.suffix}"):
        left.unlink(missing_ok=True)


def visible(folder: Path) -> list[Path]:
    """Return what is in a folder, by name, but for names that begin with a dot: macOS writes ._NAME beside a file."""
    return sorted(path for path in folder.iterdir() if not path.name.startswith("."))


def check_unused(path: Path, remedy: str = "choose a new folder or delete it first") -> None:
    """Raise InputError unless a folder can be made at ``path``: nothing is there, or an empty folder."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path}: is there already and not empty; {remedy}")
    check_writable(path.absolute().parent if path.exists() else path)  # an empty folder is replaced, not filled


def check_writable(path: Path, remedy: str = "choose another folder") -> None:
    """Raise InputError where nothing can be written at ``path``. The trial file has no name or is removed at once."""
    place = path
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise InputError(f"{place}: is a file, so nothing can be written to {path}; {remedy}")
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); {remedy}") from error


def synced(path: Path) -> None:
    """Flush a file, or a folder's list of files, to the disk."""
    if os.name == "nt" and path.is_dir():  # Windows cannot open folders, and need not flush them
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_json(path: Path, table: dict[str, Any]) -> None:
    """Write plain data as JSON, atomically. Raises InputError if it cannot be written."""
    with replacing_file(path, durable=True) as partial:
        text = json.dumps(table, indent=2, ensure_ascii=False) + "\n"
        partial.write_text(text, encoding="utf-8", errors=JSON_ERRORS)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder beside ``path``, renamed to it at the end, or deleted after an exception.

    The current folder is filled instead: a shell would stay in the deleted one. Raises InputError if ``path`` exists
    and is not an empty folder, or cannot be made.
    """
    check_unused(path)
    whole = path.absolute()  # "." has no name
    partial = whole.with_name(f".{whole.name}.partial-{os.getpid()}")
    _unfinished.add(partial)
    try:
        partial.mkdir(parents=True)
        yield partial
        if path.exists() and path.samefile(os.curdir):
            for made in list(partial.iterdir()):
                os.replace(made, path / made.name)
        else:
            if path.exists():
                path.rmdir()  # Windows does not rename onto a folder, even an empty one
            os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        _unfinished.discard(partial)


def remove_unfinished() -> None:
    """Remove every incomplete ``new_folder``, before the process ends."""
    for partial in _unfinished:
        shutil.rmtree(partial, ignore_errors=True)


def natural(name: str | Path) -> list[int | str]:
    """Return a key for the natural order of names and paths: "light 2" before "light 10"."""
    return [int(word) if word.isdecimal() else word.lower() for word in re.split(r"(\d+)", str(name))]


def shipped_names(folder: Path) -> list[str]:
    """Return the sorted names, without suffix, of a folder's .toml files."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def defined(path: str, prefix: str = "") -> dict[str, int | float]:
    """Return the numbers that a file of shaders/ names by ``#define PREFIX_NAME number``, by NAME."""
    found = re.findall(rf"^#define {prefix}(\w+) ([-+.\w]+)", read_glsl(SHADERS / path), re.M)
    return {name: float(value) if re.search("[.e]", value) else int(value) for name, value in found}


def read_glsl(path: Path) -> str:
    """Return the text of a GLSL file, without a byte order mark. Raises InputError if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); save it as UTF-8") from error


def load_shipped_table(what: str, name_or_path: str | Path, folder: Path) -> tuple[dict[str, Any], Path]:
    """Return the table of ``folder``/NAME.toml, or of a user's own .toml by path, and its path.

    what: "model" or "preset", for the message of the InputError that a missing or damaged file raises.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = folder / f"{name_or_path}.toml"
        if not path.exists():
            names = ", ".join(shipped_names(folder))
            raise InputError(f"{what} '{name_or_path}' is not shipped; choose one of {names}, or give a .toml by path")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig")), path
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); give the path of a {what}'s .toml file"
        ) from error
    except ValueError as error:  # also of UTF-8, and of a number with thousands of digits
        raise InputError(f"{path}: is not valid TOML: {error}") from error


def _partial_prefix(path: Path) -> str:
    return f".{path.stem}.partial-"
