"""Material slots of an object: selection by name or index, and slots that share texture coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...core.errors import InputError

OPTION = "--slots"


def slot_names(obj: Any) -> tuple[str, ...]:
    """Return the names of an object's material slots; "slot N" for one without a material."""
    return tuple(
        slot.material.name if slot.material is not None else f"slot {index}"
        for index, slot in enumerate(obj.material_slots)
    )


def slots_of_text(text: str, names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the ascending indices of slots given as "name or index,…". Raises InputError that lists the slots.

    names: of all slots. A single name may contain commas.
    """
    parts = [text.strip()] if text.strip() in names else [part.strip() for part in text.split(",")]
    chosen = set()
    for part in parts:
        if part in names:
            chosen |= {index for index, name in enumerate(names) if name == part}
        elif part.isdecimal() and int(part) < len(names):
            chosen.add(int(part))
        else:
            raise InputError(
                f"{OPTION} {text}: there is no slot '{part}'; "
                + (
                    f"the slots are {listed(names)}"
                    if names
                    else f"the object has no material slots: leave {OPTION} out"
                )
            )
    return tuple(sorted(chosen))


def listed(names: tuple[str, ...]) -> str:
    """Return slots with their numbers, for display."""
    return ", ".join(f"{index} '{name}'" for index, name in enumerate(names))


def overlapping_slots(materials: np.ndarray, first: np.ndarray, last: np.ndarray) -> tuple[int, ...]:
    """Return the slots that overlap each other, or none where most overlaps lie within a slot.

    materials: (T,) slot of each triangle. first, last: (H, W) triangles over each texel from 1, 0 for none.
    """
    shared = (first != last) & (first > 0) & (last > 0)
    a, b = materials[first[shared] - 1], materials[last[shared] - 1]
    between = a != b
    if between.sum() <= 0.5 * max(len(between), 1):
        return ()
    return tuple(int(slot) for slot in np.union1d(a[between], b[between]))
