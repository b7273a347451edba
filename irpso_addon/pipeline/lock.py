"""A lock on the output folder of a running recovery."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..core.errors import InputError

LOCK = ".irpso-lock"
_TRIES = 10


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of an output folder, which is made if it is missing, and removed at the end if it is empty.

    The system's lock on a file in the folder ends with the process, also where that is killed. Folders that are
    read-only, or on a network without locks, are not locked. Raises InputError if another process has the lock.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    handle = _taken(folder)
    try:
        yield
    finally:
        if handle is not None:
            _release(folder / LOCK, handle)
        with suppress(OSError):  # not empty
            for path in made:
                path.rmdir()


def _taken(folder: Path) -> int | None:
    """Return the handle of the locked file, None where the folder cannot have one. Raises InputError."""
    for _ in range(_TRIES):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError:
            return None
        try:
            _lock(handle)
            if sys.platform == "win32" or os.path.samestat(os.fstat(handle), os.stat(folder / LOCK)):
                return handle
        except FileNotFoundError:
            pass
        except (BlockingIOError, PermissionError) as error:
            os.close(handle)
            raise InputError(
                f"{folder}: another process writes its result there now; wait for its end, or choose another -o"
            ) from error
        except OSError:  # a network folder
            _release(folder / LOCK, handle)
            return None
        os.close(handle)  # its owner removed the file between the two calls
    return None  # a network folder that numbers its files anew


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
