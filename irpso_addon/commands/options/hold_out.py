"""``--hold-out``: names or numbers of photographs → indices in the list of the capture's files."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from ...core.errors import InputError
from ...solver.views.held_out import spared

_SHOWN = 3  # most names in a message


def held_out_list(text: str | None, names: Sequence[str], cameras: Sequence[int] = ()) -> list[int]:
    """Return the indices of --hold-out among the photographs' names. cameras: of each photograph; () for one camera.

    Each entry is a full name, else a name without its suffix, else a number from 0. Raises InputError if one is
    unknown, ambiguous or given twice.
    """
    if not text:
        return []
    if text == "auto":
        return _spared(cameras or [0] * len(names))
    chosen = [_index(entry, text, names) for entry in _entries(text, names)]
    if twice := [k for n, k in enumerate(chosen) if k in chosen[:n]]:
        raise InputError(f"--hold-out {text}: gives {names[twice[0]]} twice; give different photographs")
    return chosen


def _entries(text: str, names: Sequence[str]) -> list[str]:
    """Split ``text`` at commas, except inside the names of photographs."""
    known = {*names, *(Path(name).stem for name in names)}
    parts, entries = text.split(","), []
    while parts:
        ends = range(len(parts), 0, -1)
        end = next((end for end in ends if ",".join(parts[:end]).strip() in known), 1)
        entries.append(",".join(parts[:end]).strip())
        parts = parts[end:]
    return entries


def _spared(cameras: Sequence[int]) -> list[int]:
    chosen = spared(cameras)
    if not chosen:
        raise InputError(
            f"--hold-out auto: of {len(cameras)} observations none can be held out; omit the option, or name one"
        )
    return chosen


def _index(entry: str, text: str, names: Sequence[str]) -> int:
    """Return the index of one entry of ``text``. Raises InputError."""
    named = [k for k, name in enumerate(names) if name == entry]
    named = named or [k for k, name in enumerate(names) if Path(name).stem == entry]
    if len(named) > 1:
        shown = ", ".join(f"{names[k]} (number {k})" for k in named)
        raise InputError(f"--hold-out {text}: '{entry}' may be {shown}; give the full name, or the number")
    if named:
        return named[0]
    if entry.isdecimal() and int(entry) < len(names):
        return int(entry)
    whole = {form: name for name in names for form in (Path(name).stem, name)}
    near = dict.fromkeys(whole[form] for form in get_close_matches(entry, whole, _SHOWN))
    kind, shown = ("nearest", ", ".join(near)) if near else ("first", ", ".join(names[:_SHOWN]))
    raise InputError(
        f"--hold-out {text}: '{entry}' is no photograph; the {kind} names are {shown}; numbers are from 0 to"
        f" {len(names) - 1}"
    )
