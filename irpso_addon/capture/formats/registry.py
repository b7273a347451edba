"""``FORMATS``: all formats of captures, in the order in which a folder is searched for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...core.files import visible
from ..spec import CaptureKind, CaptureSpec
from . import diligent, rti, table


@dataclass(frozen=True)
class CaptureFormat:
    """A format of captures. All that depends on the format of a path asks here.

    kind: of its specs. folder_holds: what its folder holds, for messages. captures_in: folder → files, each of which
    stands for a capture of this format; several if the user has to choose one. read: (file, colour space) → spec.
    suffixes, names: of these files in any folder. has_lights: file → whether the capture states its lights.
    """

    kind: CaptureKind
    folder_holds: str
    captures_in: Callable[[Path], list[Path]]
    read: Callable[[Path, str], CaptureSpec]
    suffixes: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    has_lights: Callable[[Path], bool] = lambda path: True


FORMATS = (
    CaptureFormat(
        CaptureKind.TABLE, table.TABLE,
        lambda folder: [path for path in (folder / table.TABLE,) if path.exists()],
        table.spec_of_table, suffixes=(".toml",),
    ),
    CaptureFormat(
        CaptureKind.DILIGENT, f"{diligent.FILENAMES} and {diligent.DIRECTIONS}",
        lambda folder: [folder / diligent.DIRECTIONS] if diligent.is_diligent(folder) else [],
        lambda path, colour_space: diligent.spec_of_folder(path.parent, colour_space),
        names=(diligent.FILENAMES, diligent.DIRECTIONS),
        has_lights=lambda path: path.with_name(diligent.DIRECTIONS).exists(),
    ),
    CaptureFormat(
        CaptureKind.RTI, "one .lp file",
        lambda folder: [path for path in visible(folder) if path.suffix.lower() == ".lp" and path.is_file()],
        rti.spec_of_lp, suffixes=(".lp",),
    ),
)  # fmt: skip
SUFFIXES = tuple(sorted(suffix for known in FORMATS for suffix in known.suffixes))  # of files that are a capture
EXTENSIONS = tuple(sorted({*SUFFIXES, *(Path(name).suffix for known in FORMATS for name in known.names)}))


def format_of(path: Path) -> CaptureFormat | None:
    """Return the format of a file by its name; None if it is no capture."""
    for known in FORMATS:
        if path.suffix.lower() in known.suffixes or path.name in known.names:
            return known
    return None


def captures_in(folder: Path) -> tuple[CaptureFormat, list[Path]] | None:
    """Return the first format of which a folder holds captures, and their files; None without a capture."""
    for known in FORMATS:
        if captures := known.captures_in(folder):
            return known, captures
    return None


def captures_with_lights(folder: Path) -> list[Path]:
    """Return the files of the captures in a folder that state their lights; several if one is to be chosen."""
    known, captures = captures_in(folder) or (FORMATS[0], [])
    return [path for path in captures if known.has_lights(path)]
