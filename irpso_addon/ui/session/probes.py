"""Probes: texels whose error the user watches during a recovery."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ...results.maps import Cause
from ...solver.engine.progress import Progress

MAX_PROBES = 4


@dataclass
class Probe:
    """A watched texel. curve: (iteration, error) pairs. slot: index of its colour, 0…3.

    unknown: parameter → why it is unknown, when the recovery was last paused; judged: the progress then.
    """

    row: int
    column: int
    curve: list[tuple[int, float]] = field(default_factory=list)
    slot: int = 0
    unknown: dict[str, Cause] = field(default_factory=dict)
    judged: Progress | None = None

    @property
    def number(self) -> int:
        """Its number for the user, 1…4, which does not change."""
        return self.slot + 1


class Probes(list[Probe]):
    """Watched texels, the oldest first, at most four. changed: called after ``add`` and ``remove_at``."""

    def __init__(self, changed: Callable[[], None]):
        super().__init__()
        self._changed = changed

    def add(self, row: int, column: int) -> Probe | None:
        """Watch a texel. A fifth probe replaces the oldest, which is returned; else return None."""
        dropped = self.pop(0) if len(self) == MAX_PROBES else None
        free_slots = set(range(MAX_PROBES)) - {probe.slot for probe in self}
        self.append(Probe(row, column, slot=min(free_slots)))
        self._changed()
        return dropped

    def remove_at(self, index: int) -> None:
        """Stop watching a texel."""
        del self[index]
        self._changed()

    def numbered(self, number: int) -> Probe | None:
        """Return the probe with this number; if there is none, the oldest; None without probes."""
        return next((probe for probe in self if probe.number == number), next(iter(self), None))
