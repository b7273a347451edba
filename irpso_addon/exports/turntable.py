"""Turntable: renders of a result's subject with its material, through one full turn, in two rows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..blender.materials.pictures import turntable
from ..core.canvas import BACKGROUND
from ..core.png import encode_png
from .place import file_place, file_stem
from .result import Result

_PICTURES, _ROWS, _SIDE, _RIM = 8, 2, 320, 8  # pictures and their rows; pixels of a side, and of the rim around


def write_turntable(
    result: Result, out: str | Path, subject: Callable[[], Any], replace: bool = True
) -> dict[str, Any]:
    """Write a PNG of Cycles renders in rows; return the entries of the report.

    out: the file, or a folder for NAME_turntable.png. subject: returns the object of the result's open file. replace:
    an existing file. Raises InputError where nothing can be written there, or the result has no material.
    """
    path = file_place(out, f"{file_stem(result.name)}_turntable", [".png"], replace)
    pictures = np.stack(turntable(subject(), _SIDE, _PICTURES))
    rows = np.flatnonzero(pictures[..., 3].any(axis=(0, 2)))
    pictures = pictures[:, max(rows[0] - _RIM, 0) : rows[-1] + 1 + _RIM]
    across = [np.concatenate(part, axis=1) for part in np.split(pictures, _ROWS)]
    sheet = np.concatenate(across[::-1])  # row 0 is at the bottom
    alpha = sheet[..., 3:]
    path.parent.mkdir(parents=True, exist_ok=True)
    encode_png(path, sheet[..., :3] * alpha + np.array(BACKGROUND) * (1 - alpha), bits=8)
    return {"output": str(path), "pictures": _PICTURES}
