"""A lock on the output folder of a running recovery."""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..core.errors import InputError

_TRIES = 10


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of an output folder, which need not exist, among the processes of this machine.

    The system's lock on a temporary file ends with the process, also where that is killed. Without such locks nothing
    is locked. Raises InputError if another process has the lock.
    """
    path = lock_file(folder)
    handle = _taken(path, folder)
    try:
        yield
    finally:
        if handle is not None:
            _release(path, handle)


def lock_file(folder: Path) -> Path:
    """Return the file that is locked for an output folder."""
    place = os.path.normcase(os.path.realpath(folder))
    digest = hashlib.sha256(place.encode(errors="surrogatepass")).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"irpso-{digest}.lock"


def _taken(path: Path, folder: Path) -> int | None:
    """Return the handle of the locked file, None where there are no locks. Raises InputError."""
    for _ in range(_TRIES):
        try:
            handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except OSError:  # of another user
            return None
        try:
            _lock(handle)
            if sys.platform == "win32" or os.path.samestat(os.fstat(handle), os.stat(path)):
                return handle
        except FileNotFoundError:
            pass
        except (BlockingIOError, PermissionError) as error:
            os.close(handle)
            raise InputError(
                f"{folder}: another process writes its result there now; wait for its end, or choose another -o"
            ) from error
        except OSError:
            _release(path, handle)
            return None
        os.close(handle)  # its owner removed the file between the two calls
    return None


def _lock(handle: int) -> None:
    """Lock an open file. Raises BlockingIOError, on Windows PermissionError, if another process has locked it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _release(path: Path, handle: int) -> None:
    """Remove the locked file and end its lock. Windows removes no open files."""
    if sys.platform == "win32":
        os.close(handle)
    with suppress(OSError):
        path.unlink()
    if sys.platform != "win32":
        os.close(handle)
