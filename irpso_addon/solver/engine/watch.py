"""Values of a few texels during a recovery, recorded after the iterations that are due, without stopping there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...core.optional import present
from ...results.maps import Maps
from .progress import Progress


@dataclass(frozen=True)
class TexelRecord:
    """The values of ``maps`` at n texels after an iteration, which is counted over all stages.

    values: parameter name → (n, components). residual: (n,).
    """

    iteration: int
    values: Mapping[str, np.ndarray]
    residual: np.ndarray


def record_of(maps: Maps, iteration: int, rows: np.ndarray, columns: np.ndarray) -> TexelRecord:
    """Return the record of (n,) texels of maps that have a residual."""
    values = {name: value[rows, columns] for name, value in maps.values.items()}
    return TexelRecord(iteration, values, present(maps.residual)[rows, columns])


@dataclass
class Watch:
    """Records the values of n texels of a recovery, (n,) rows and columns, after the iterations that are ``due``."""

    rows: np.ndarray
    columns: np.ndarray
    due: Callable[[Progress], bool]
    records: list[TexelRecord] = field(default_factory=list)
    last: int = 0  # iteration of the last record: the initialisation of a stage's swarms is no new one

    def record_due(self, progress: Progress, record: Callable[[np.ndarray, np.ndarray], TexelRecord]) -> None:
        """Record the values if they are due. progress, record: of the texels' recovery."""
        if progress.iteration_in_all != self.last and self.due(progress):
            self.last = progress.iteration_in_all
            self.records.append(record(self.rows, self.columns))

    def discard(self, iteration: int) -> None:
        """Remove the record of an iteration that was the last of its stage."""
        self.records = [record for record in self.records if record.iteration != iteration]


def recorded_by_all(watches: Sequence[tuple[Watch, np.ndarray]]) -> list[TexelRecord]:
    """Remove from watches the records that all of them have, and return these merged.

    watches: each with the indices of its texels among all watched texels.
    """
    merged = []
    texels = sum(len(numbers) for _, numbers in watches)
    for records in zip(*(watch.records for watch, _ in watches), strict=False):
        whole = {name: np.empty((texels, value.shape[1]), np.float32) for name, value in records[0].values.items()}
        residual = np.empty(texels, np.float32)
        for record, (_, numbers) in zip(records, watches, strict=True):
            residual[numbers] = record.residual
            for name, value in record.values.items():
                whole[name][numbers] = value
        merged.append(TexelRecord(records[0].iteration, whole, residual))
    for watch, _ in watches:
        del watch.records[: len(merged)]
    return merged
