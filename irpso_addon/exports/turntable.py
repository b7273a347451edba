"""Turntable: a strip of renders of a result's subject with its material, through one full turn."""

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

_PICTURES, _SIDE, _RIM = 8, 224, 8  # pictures; pixels of a side of each, and of the rim above and below


def write_turntable(
    result: Result, out: str | Path, subject: Callable[[], Any], replace: bool = True
) -> dict[str, Any]:
    """Write a PNG of Cycles renders side by side; return the entries of the report.

    out: the file, or a folder for NAME_turntable.png. subject: returns the object of the result's open file. replace:
    an existing file. Raises InputError where nothing can be written there, or the result has no material.
    """
    path = file_place(out, f"{file_stem(result.name)}_turntable", [".png"], replace)
    strip = np.concatenate(turntable(subject(), _SIDE, _PICTURES), axis=1)
    rows = np.flatnonzero(strip[..., 3].any(axis=1))
    strip = strip[max(rows[0] - _RIM, 0) : rows[-1] + 1 + _RIM]
    alpha = strip[..., 3:]
    path.parent.mkdir(parents=True, exist_ok=True)
    encode_png(path, strip[..., :3] * alpha + np.array(BACKGROUND) * (1 - alpha), bits=8)
    return {"output": str(path), "pictures": _PICTURES}
