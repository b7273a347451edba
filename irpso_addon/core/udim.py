"""UDIM sets: several squares of texture coordinates, side by side in one domain, each with its own file.

Numbers are Blender's and Mari's: 1001 is the unit square, one more for each square to the right, ten for each row up.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from .errors import InputError

FIRST = 1001
COLUMNS = 10
ROWS = 100  # Blender's last number is 2000
ONE_SQUARE = (FIRST,)
PATTERN = "<UDIM>"
Number = TypeVar("Number", int, np.ndarray)
_NUMBER = re.compile(r"(1\d\d\d|2000)")


def tile_number(column: Number, row: Number) -> Number:
    """Return the number of the square whose lower left corner has these texture coordinates, or of several (N,)."""
    return FIRST + column + COLUMNS * row


def tile_place(number: int) -> tuple[int, int]:
    """Return (column, row): the texture coordinates of a square's lower left corner."""
    row, column = divmod(number - FIRST, COLUMNS)
    return column, row


def tile_stem(stem: str, number: int, tiles: Sequence[int]) -> str:
    """Return the stem of a tile's file: "base_color.1002", and "base_color" for the unit square alone."""
    return stem if tuple(tiles) == ONE_SQUARE else f"{stem}.{number}"


def tile_part(array: np.ndarray, index: int, count: int) -> np.ndarray:
    """Return the view (H, W / count, …) of the tile with this index in a domain (H, W, …)."""
    width = array.shape[1] // count
    return array[:, index * width : (index + 1) * width]


def tile_files(path: Path, tiles: Sequence[int]) -> list[Path]:
    """Return the file of each tile. path: its name holds <UDIM> or a number, unless there is only one square.

    Raises InputError for one name for several tiles, or a missing file.
    """
    if PATTERN not in path.name:
        if tuple(tiles) == ONE_SQUARE:
            return [path]
        stem, dot, number = path.stem.rpartition(".")  # normal.1002.exr stands for normal.<UDIM>.exr
        if not dot or not _NUMBER.fullmatch(number):
            names = ", ".join(map(str, tiles))
            raise InputError(
                f"{path}: is one picture, the UV map has the UDIM tiles {names}; name a file of each, as in"
                f" {path.stem}.{PATTERN}{path.suffix}"
            )
        path = path.with_name(f"{stem}.{PATTERN}{path.suffix}")
    files = [path.with_name(path.name.replace(PATTERN, str(number))) for number in tiles]
    if missing := [number for number, file in zip(tiles, files, strict=True) if not file.is_file()]:
        raise InputError(
            f"{path}: has no file for UDIM tile {missing[0]} ({len(missing)} of {len(files)} are missing); add it"
        )
    return files
