"""Response curves on disk: a small TOML table, or lines of numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...capture.errors import CaptureError
from ...capture.formats.lists import read_numbers
from ...capture.formats.toml_file import known_keys, load_toml
from ...core.errors import InputError
from ...core.files import replacing_file
from .response import Response

_FORMAT = 1
_LAST_CODE = 0.99  # at least; 255 of 256 counts as 1
_CHANNELS = ("red", "green", "blue")
_KEYS = {"format", "residual", "codes", *_CHANNELS, *(f"{name}_used" for name in _CHANNELS)}
_REMEDY = "write one line for each code: code red green blue, or code linear, all 0 to 1 and rising"


def write_response(path: Path | str, response: Response) -> None:
    """Write a curve as TOML, atomically. Raises InputError if writing fails."""
    lines = [
        "# Linear light of code values, both 0 to 1: the response curve of a camera, channel by channel.",
        f"format = {_FORMAT}",
        f"residual = {response.residual:.6g}",
        f"codes = {_list(response.codes)}",
    ]
    for c, name in enumerate(_CHANNELS):
        lines += [f"{name}_used = {_list(response.used[c])}", f"{name} = {_list(response.linear[:, c])}"]
    with replacing_file(Path(path)) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_response(path: Path | str) -> Response:
    """Read a curve: a .toml from ``write_response``, or lines "code red green blue" or "code linear".

    Raises InputError if the file is missing or damaged, or the curve does not rise from 0 to 1.
    """
    path = Path(path)
    if path.suffix.lower() == ".toml":
        table = load_toml(path)
        known_keys(table, _KEYS, str(path))
        if table.get("format") != _FORMAT:
            raise InputError(f"{path}: is not a response curve; make one with irpso response")
        codes, used = _array(table, "codes", path), []
        channels = [_array(table, name, path) for name in _CHANNELS]
        for name in _CHANNELS:
            ends = _array(table, f"{name}_used", path) if f"{name}_used" in table else np.array([0.0, 1.0])
            used.append(ends)
        if any(c.shape != codes.shape for c in channels) or any(e.shape != (2,) for e in used):
            raise InputError(f"{path}: red, green and blue must have as many numbers as codes; make the file again")
        residual = table.get("residual", float("nan"))
        residual = float(residual) if isinstance(residual, int | float) else float("nan")
        return _checked(path, codes, np.stack(channels, axis=-1), np.stack(used), residual)
    rows = read_numbers(path, _REMEDY)
    widths = {len(row) for _, row in rows}
    if widths not in ({2}, {4}):
        raise CaptureError(f"{path}: is not a response curve; {_REMEDY}", "value")
    values = np.array([row for _, row in rows], np.float64)
    linear = np.repeat(values[:, 1:], 3, axis=1) if widths == {2} else values[:, 1:]
    return _checked(path, values[:, 0], linear, np.tile(values[[0, -1], 0], (3, 1)), float("nan"))


def _checked(path: Path, codes: np.ndarray, linear: np.ndarray, used: np.ndarray, residual: float) -> Response:
    finite = np.isfinite(codes).all() and np.isfinite(linear).all()
    if not finite or len(codes) < 2 or (np.diff(codes) <= 0).any() or codes[0] < 0 or not 0 < codes[-1] <= 1:
        raise InputError(f"{path}: codes must rise from 0 to 1 (code value / largest code); correct them")
    if (np.diff(linear, axis=0) < 0).any() or linear.min() < 0 or (linear[-1] <= linear[0]).any():
        raise InputError(f"{path}: linear values must rise with the codes, from 0; correct them")
    if codes[0] > 0 and (linear[0] > 0).any():
        raise InputError(
            f"{path}: its first code is {codes[0]:g}; add the line of code 0, else dark pixels are unknown"
        )
    if codes[-1] < _LAST_CODE:
        raise InputError(
            f"{path}: its last code is {codes[-1]:g}; add the line of code 1, else bright pixels are unknown"
        )
    return Response(codes, linear / linear[-1], used, residual)


def _array(table: dict, key: str, path: Path) -> np.ndarray:
    try:
        value = np.asarray(table[key], np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: has no list of numbers '{key}'; make the file again with irpso response") from error
    if value.ndim != 1:
        raise InputError(f"{path}: '{key}' must be a list of numbers; make the file again with irpso response")
    return value


def _list(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{value:.7g}" for value in values) + "]"
