"""Exposure brackets: photographs grouped by light, with exposures from EXIF or file names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...capture.images.exif import SAME_STOPS, Exposure, exposure_of
from ...capture.images.headers import read_bytes
from ...core.errors import InputError
from ...core.files import natural

_NUMBER = r"\d+(?:\.\d+)?"
# The end of a name, after a blank, _ or -: seconds as in 1-60s, 0.5s or 16ms, or stops as in ev-2, ev_1.3 or +2EV.
_FRACTION = re.compile(rf"^(?:(?P<stem>.*)[ _-])?1-(?P<below>{_NUMBER})s$", re.I)
_SECONDS = re.compile(rf"^(?:(?P<stem>.*)[ _-])?(?P<value>{_NUMBER})(?P<unit>m?s)$", re.I)
_EV_FIRST = re.compile(rf"^(?:(?P<stem>.*?)[ _-])?ev[ _]?(?P<stops>[+-]?{_NUMBER})$", re.I)
_EV_LAST = re.compile(rf"^(?P<stem>.*?)[ _-]?(?P<stops>[+-]{_NUMBER}|(?<=[ _]){_NUMBER})[ _]?ev$", re.I)
_INDEX = re.compile(r"^(?P<stem>.*?)[ _-]+e?(?P<index>\d+)$", re.I)
_NAMES = "write exposures into the names (name_1-60s.jpg, name_ev-2.jpg) and choose names"


@dataclass(frozen=True)
class Bracket:
    """The photographs of one light. name: common part of their names. paths: F files, shortest exposure first.

    amounts: (F,) exposures, above 0.
    """

    name: str
    paths: tuple[Path, ...]
    amounts: tuple[float, ...]


def exif_amount(path: Path) -> float:
    """Return a photograph's exposure, seconds · ISO / 100 / N². Raises InputError if its EXIF has no exposure time."""
    return _exposure(path).amount


def _exposure(path: Path) -> Exposure:
    exposure = exposure_of(read_bytes(path))
    if exposure is None:
        raise InputError(f"{path}: has no exposure time in its EXIF; {_NAMES}")
    return exposure


def _exif_amounts(paths: Sequence[Path]) -> list[float]:
    """Return exposures. Raises InputError if one is unknown, or some files of a folder lack f-number or ISO."""
    exposures = [_exposure(path) for path in paths]
    for what, key in (("f-number", "f_number"), ("ISO", "iso")):
        having = {p.parent: p for p, e in zip(paths, exposures, strict=True) if getattr(e, key) is not None}
        for path, exposure in zip(paths, exposures, strict=True):
            if getattr(exposure, key) is None and path.parent in having:
                raise InputError(f"{path}: has no {what} in its EXIF, and {having[path.parent].name} has one; {_NAMES}")
    return [exposure.amount for exposure in exposures]


def name_amount(stem: str, exposures: Sequence[float] = ()) -> tuple[str, float, str] | None:
    """Parse a file name without suffix; return (rest of the name, exposure, kind), or None if it has no exposure.

    kind: "seconds", "stops" (the exposure is 2 to this power), or "index" into ``exposures``, from 0 or from 1.
    """
    if exposures:
        match = _INDEX.match(stem)
        return (match["stem"], float(match["index"]), "index") if match else None
    if match := _EV_FIRST.match(stem) or _EV_LAST.match(stem):
        return match["stem"] or "", 2.0 ** float(match["stops"]), "stops"
    if (match := _FRACTION.match(stem)) and float(match["below"]):
        return match["stem"] or "", 1 / float(match["below"]), "seconds"
    if (match := _SECONDS.match(stem)) and float(match["value"]):
        scale = 1e-3 if match["unit"].lower() == "ms" else 1.0
        return match["stem"] or "", float(match["value"]) * scale, "seconds"
    return None


def amounts_of(paths: Sequence[Path], by: str, exposures: Sequence[float] = ()) -> list[tuple[str, float]]:
    """Return (name without exposure, exposure) of each file. by: "exif" or "names".

    Raises InputError if a file has no exposure, or names mix seconds and stops.
    """
    if by == "exif":
        return [(path.stem, amount) for path, amount in zip(paths, _exif_amounts(paths), strict=True)]
    parsed = []
    for path in paths:
        if (parts := name_amount(path.stem, exposures)) is None:
            kind = "_0, _1, … for --exposures" if exposures else "as in name_1-60s.jpg, name_16ms.jpg or name_ev-2.jpg"
            raise InputError(f"{path}: its name has no exposure; end it {kind}")
        parsed.append(parts)
    kinds = {kind for _, _, kind in parsed}
    if len(kinds) > 1:
        raise InputError(f"{paths[0].parent}: some names have seconds and some EV; use one for all")
    if kinds == {"index"}:
        return _indexed(paths, [(stem, int(index)) for stem, index, _ in parsed], exposures)
    return [(stem, amount) for stem, amount, _ in parsed]


def _indexed(
    paths: Sequence[Path], indices: list[tuple[str, int]], exposures: Sequence[float]
) -> list[tuple[str, float]]:
    first = _first([index for _, index in indices])
    for path, (_, index) in zip(paths, indices, strict=True):
        if index - first >= len(exposures):
            raise InputError(f"{path}: is exposure {index} from {first}, and --exposures has only {len(exposures)}")
    return [(stem, float(exposures[index - first])) for stem, index in indices]


def _first(indices: Sequence[int]) -> int:
    """Return the number of the first exposure, 0 or 1."""
    return 0 if 0 in indices else 1


def index_amount(path: Path, paths: Sequence[Path], exposures: Sequence[float]) -> float | None:
    """Return the exposure of a file by the number at the end of its name, counted as in the names of ``paths``.

    None if the name has no number, or that of no exposure.
    """
    own = name_amount(path.stem, exposures)
    if own is None:
        return None
    place = int(own[1]) - _first([int(parts[1]) for one in paths if (parts := name_amount(one.stem, exposures))])
    return float(exposures[place]) if 0 <= place < len(exposures) else None


def brackets_of(paths: Sequence[Path], by: str, exposures: Sequence[float] = ()) -> tuple[list[Bracket], list[str]]:
    """Sort photographs by name and group them; return the brackets, and warnings.

    by "names": names in a bracket differ only in the exposure; their common part is its name. by "exif": a bracket ends
    before an exposure repeats. Raises InputError if an exposure is unknown or no bracket has two photographs.
    """
    paths = sorted(paths, key=natural)
    if by == "exif":
        groups = [(run[0][0].stem, run) for run in _runs(list(zip(paths, _exif_amounts(paths), strict=True)))]
    else:
        named: dict[tuple[Path, str], list[tuple[Path, float]]] = {}
        for path, (stem, value) in zip(paths, amounts_of(paths, by, exposures), strict=True):
            named.setdefault((path.parent, stem), []).append((path, value))
        groups = [(stem, group) for (_, stem), group in named.items()]
    brackets = [_bracket(name, group) for name, group in groups]
    if max((len(bracket.paths) for bracket in brackets), default=0) < 2:
        where = f"{paths[0].parent}: " if paths else ""
        raise InputError(
            f"{where}no two photographs make a bracket; omit --brackets, or use --exposure where frames have different"
            " exposures"
        )
    sets = [tuple(round(np.log2(a / b.amounts[0]) / SAME_STOPS) for a in b.amounts) for b in brackets]
    usual = max(set(sets), key=sets.count)
    warnings = [
        f"{b.paths[0]}: its bracket has {len(b.paths)} exposures that differ from the usual {len(usual)}; check that"
        " no photograph is missing"
        for b, stops in zip(brackets, sets, strict=True)
        if stops != usual
    ]
    return brackets, warnings


def _runs(exposures: list[tuple[Path, float]]) -> list[list[tuple[Path, float]]]:
    groups: list[list[tuple[Path, float]]] = []
    for path, amount in exposures:
        repeated = not groups or any(abs(np.log2(amount / other)) < SAME_STOPS for _, other in groups[-1])
        if repeated or groups[-1][0][0].parent != path.parent:
            groups.append([])
        groups[-1].append((path, amount))
    return groups


def _bracket(name: str, group: list[tuple[Path, float]]) -> Bracket:
    group = sorted(group, key=lambda exposure: exposure[1])
    for (a, shorter), (b, longer) in zip(group, group[1:], strict=False):
        if abs(np.log2(longer / shorter)) < 1e-3:
            raise InputError(f"{b}: has the exposure of {a} in the same bracket; remove one of them")
    paths = tuple(path for path, _ in group)
    return Bracket(name or paths[0].stem, paths, tuple(amount for _, amount in group))
