"""Reads plain text lists of captures: lines of numbers and lines of names."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import CaptureError


def read_text(path: Path, remedy: str) -> str:
    """Return a file's text. Raises CaptureError with ``remedy`` if it is missing, unreadable or no text."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise CaptureError(f"{path}: is not there; {remedy}", "missing") from error
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read ({error.strerror}); check its permissions", "missing") from error
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: is no text file; {remedy}", "not_text") from error


def read_lines(path: Path, remedy: str) -> list[tuple[int, str]]:
    """Return (line number, text) of all lines except empty ones and # comments. Raises CaptureError with ``remedy``."""
    lines = [(n, line.strip()) for n, line in enumerate(read_text(path, remedy).splitlines(), 1)]
    lines = [(n, line) for n, line in lines if line and not line.startswith("#")]
    if any("\0" in line for _, line in lines):
        raise CaptureError(f"{path}: is no text file; {remedy}", "not_text")
    if not lines:
        raise CaptureError(f"{path}: is empty; {remedy}", "list_empty")
    return lines


def read_numbers(path: Path, remedy: str) -> list[tuple[int, list[float]]]:
    """Return (line number, numbers) of each line. Raises CaptureError naming the first line with other text."""
    return [(n, numbers(line.replace(",", " ").split(), f"{path}: line {n}")) for n, line in read_lines(path, remedy)]


def numbers(words: list[str], where: str) -> list[float]:
    """Return words as floats. Raises CaptureError naming the first that is no number."""
    values = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError as error:
            raise CaptureError(f"{where}: '{word[:40]}' is not a number; write numbers only", "not_number") from error
    return values


def read_directions(path: Path) -> list[tuple[int, tuple[float, ...]]]:
    """Return (line number, (x, y, z)) of a light_directions.txt. Raises CaptureError for a transposed (3×K) table."""
    rows = read_numbers(path, "write one light a line: x y z toward the light")
    widths = {len(row) for _, row in rows}
    if len(rows) == 3 and len(widths) == 1 and min(widths) > 3:
        count = min(widths)
        raise CaptureError(
            f"{path}: is a 3×{count} table, one light a column; transpose it to one light a line"
            f" ({count} lines of x y z)",
            "lights_transposed",
        )
    for n, row in rows:
        if len(row) != 3:
            raise CaptureError(f"{path}: line {n}: has {len(row)} numbers; write three: x y z", "light_columns")
    return [(n, tuple(row)) for n, row in rows]


def read_intensities(path: Path) -> list[tuple[int, tuple[float, ...]]]:
    """Return (line number, (r, g, b)) of a light_intensities.txt with one or three numbers per line."""
    rows = read_numbers(path, "write one light a line: r g b, or one number")
    for n, row in rows:
        if len(row) not in (1, 3):
            raise CaptureError(f"{path}: line {n}: has {len(row)} numbers; write r g b, or one number", "intensity")
    return [(n, tuple(np.broadcast_to(row, 3).tolist())) for n, row in rows]
