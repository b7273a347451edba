"""Values of a few texels during a recovery, recorded after the iterations that are due, without stopping there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...core.optional import present
from ...results.maps import Maps
from .progress import Progress


@dataclass(frozen=True)
class Note:
    """The values of ``maps`` at n texels after an iteration, which is counted over all stages.

    values: parameter name → (n, components). residual: (n,).
    """

    iteration: int
    values: Mapping[str, np.ndarray]
    residual: np.ndarray


def note_of(maps: Maps, iteration: int, rows: np.ndarray, columns: np.ndarray) -> Note:
    """Return the note of (n,) texels of maps that have a residual."""
    values = {name: value[rows, columns] for name, value in maps.values.items()}
    return Note(iteration, values, present(maps.residual)[rows, columns])


@dataclass
class Watch:
    """Records notes of n texels of a recovery, (n,) rows and columns, after the iterations that are ``due``."""

    rows: np.ndarray
    columns: np.ndarray
    due: Callable[[Progress], bool]
    notes: list[Note] = field(default_factory=list)
    last: int = 0  # iteration of the last note: the initialisation of a stage's swarms is no new one

    def record_due(self, progress: Progress, note: Callable[[np.ndarray, np.ndarray], Note]) -> None:
        """Record a note if one is due. progress, note: of the texels' recovery."""
        if progress.iteration_in_all != self.last and self.due(progress):
            self.last = progress.iteration_in_all
            self.notes.append(note(self.rows, self.columns))

    def discard(self, iteration: int) -> None:
        """Remove the note of an iteration that was the last of its stage."""
        self.notes = [note for note in self.notes if note.iteration != iteration]


def noted_by_all(watches: Sequence[tuple[Watch, np.ndarray]]) -> list[Note]:
    """Remove from watches the notes that all of them have, and return these merged.

    watches: each with the indices of its texels among all watched texels.
    """
    merged = []
    texels = sum(len(numbers) for _, numbers in watches)
    for notes in zip(*(watch.notes for watch, _ in watches), strict=False):
        whole = {name: np.empty((texels, value.shape[1]), np.float32) for name, value in notes[0].values.items()}
        residual = np.empty(texels, np.float32)
        for note, (_, numbers) in zip(notes, watches, strict=True):
            residual[numbers] = note.residual
            for name, value in note.values.items():
                whole[name][numbers] = value
        merged.append(Note(notes[0].iteration, whole, residual))
    for watch, _ in watches:
        del watch.notes[: len(merged)]
    return merged
