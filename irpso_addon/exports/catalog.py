"""The catalogs of a Blender asset library: ``blender_assets.cats.txt`` (Blender manual, Asset Catalogs)."""

from __future__ import annotations

import os
import platform
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..core.errors import InputError
from ..core.files import replacing_file

CATALOGS = "blender_assets.cats.txt"
_WAIT = 10.0  # seconds; the file is changed in milliseconds, so that whoever holds it longer was killed
_HEAD = """\
# This is an Asset Catalog Definition file for Blender.
#
# Empty lines and lines starting with `#` will be ignored.
# The first non-ignored line should be the version indicator.
# Other lines are of the format "UUID:catalog/path/for/assets:simple catalog name"

VERSION 1
"""


def catalog_path(name: str) -> str:
    """Return the path of a catalog as the file has it: ``Stone / Marble`` → ``Stone/Marble``. Raises InputError."""
    parts = [part.strip() for part in name.split("/")]
    if not all(parts) or any(sign in name for sign in ":\\\n\r"):
        raise InputError(f"catalog '{name}': give names separated by single slashes, without colons, as Stone/Marble")
    return "/".join(parts)


def catalog_id(library: Path, name: str) -> str:
    """Return the UUID of a library's catalog; add the catalog where the library has none of this path.

    Other lines of the file stay unchanged. Raises InputError where it cannot be read or written.
    """
    path, catalog = library / CATALOGS, catalog_path(name)
    with _held(path):
        return _found_or_added(path, catalog)


def catalogs_text(library: Path) -> str:
    """Return the text of a library's catalog file, with its own line ends, or a new one's. Raises InputError."""
    path = library / CATALOGS
    try:
        return path.read_bytes().decode() if path.is_file() else _HEAD
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); repair it, or leave out the catalog") from error


def _found_or_added(path: Path, catalog: str) -> str:
    text = catalogs_text(path.parent)
    for line in text.splitlines():
        number, _, rest = line.partition(":")
        if not line.startswith("#") and rest.partition(":")[0].strip() == catalog:
            return number.strip()
    added = str(uuid.uuid4())
    end = "\r\n" if "\r\n" in text else "\n"
    line = f"{added}:{catalog}:{catalog.replace('/', '-')}{end}"
    with replacing_file(path, durable=True) as partial:
        partial.write_bytes((text + ("" if text.endswith("\n") else end) + line).encode())
    return added


@contextmanager
def _held(path: Path) -> Iterator[None]:
    """Keep other processes, of any machine, from changing a file; wait while one of them changes it.

    A lock file beside ``path`` says so, with host, process and a number of its own. Where it stays the same for 10 s
    its process was killed, and it is removed. Raises InputError if the folder cannot be written, or that file not
    removed.
    """
    lock, token = path.with_name(f".{path.name}.lock"), f"{platform.node()} {os.getpid()} {uuid.uuid4()}".encode()
    _take(lock, token, path)
    try:
        yield
    finally:
        with suppress(OSError):
            if lock.read_bytes() == token:  # else another process took this one for killed
                lock.unlink()


def _take(lock: Path, token: bytes, path: Path) -> None:
    """Make a lock file with this text, as soon as there is none. Raises InputError, as ``_held``."""
    seen, since = None, time.monotonic()
    while True:
        try:
            handle = os.open(lock, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
            break
        except OSError as error:  # on Windows a file that is being removed is a PermissionError
            with suppress(OSError):
                found = _identity(lock)
                seen, since = (seen, since) if found == seen else (found, time.monotonic())
            waited = time.monotonic() - since
            if waited > _WAIT and seen is None:
                raise InputError(f"{path}: cannot be written ({error.strerror}); choose another library") from error
            if waited > _WAIT:
                _remove_stale(lock, seen, last_try=waited > 2 * _WAIT)
        time.sleep(0.01)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(token)
    except OSError as error:  # a full disk
        lock.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another library") from error


def _remove_stale(lock: Path, seen: tuple[int, int], last_try: bool) -> None:
    """Remove the lock file of a killed process. last_try: whether to raise InputError where that fails.

    A second file lets one process at a time do so: else one could remove the lock that another has made meanwhile.
    """
    claim = lock.with_name(f"{lock.name}.stale")
    try:
        os.close(os.open(claim, os.O_CREAT | os.O_EXCL))
        try:
            if _identity(lock) == seen:
                lock.unlink()
        finally:
            claim.unlink()
    except FileNotFoundError:
        return
    except OSError as error:
        if last_try:
            raise InputError(
                f"{error.filename or lock}: cannot be replaced ({error.strerror}), and the process that made it has"
                " ended; delete this file"
            ) from error


def _identity(lock: Path) -> tuple[int, int]:
    """Return what differs between two lock files. On Windows reading one would keep its process from removing it."""
    found = lock.stat()
    return found.st_ino, found.st_mtime_ns
