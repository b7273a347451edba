"""Convergence of a recovery: errors of four texels, measured at intervals while it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...reflectance.model import Parameter
from ...results.maps import Maps
from ...results.preview import Curves, convergence, display_image, spread_marks
from ...results.report import error_unit, parameter_error
from ..engine.engine import RecoveryEngine
from ..engine.progress import Progress
from ..engine.watch import TexelRecord

_ITERATIONS = "iterations"
_MEASUREMENTS = 40  # per run: each costs a render and a read-back, as much as one or two iterations


class History:
    """Measures the errors of four texels about 40 times per recovery.

    truth: parameter name → (H, W, components), or None; then the error is the residual, in % of white. show: called
    with the maps at each measurement.
    """

    def __init__(
        self,
        recovery: RecoveryEngine,
        truth: Mapping[str, np.ndarray] | None,
        show: Callable[[Maps], None] | None = None,
    ):
        self._recovery, self._truth, self._show = recovery, truth, show
        rows, columns = np.nonzero(recovery.domain.solvable)
        chosen = spread_marks(np.stack([columns, rows], axis=-1))
        self._rows, self._columns = rows[chosen], columns[chosen]
        self._watches = recovery.capabilities.watches and show is None
        if self._watches:
            recovery.watch(self._rows, self._columns, _due)
        self._iterations: list[int] = []
        self._last = 0  # iteration of the last measurement, which may be of the first tile only
        self._errors: dict[str, list[np.ndarray]] = {}

    def until_next(self, most: int | None) -> int | None:
        """Return how many iterations may run before the next ``record_due``, at most ``most``; None for any number.

        Their end does not depend on the slicing of the run.
        """
        if self._watches:
            return most
        progress = self._recovery.progress
        left = _interval(progress) - progress.iteration_in_all % _interval(progress)
        return left if most is None else min(most, left)

    def record_due(self) -> None:
        """Record the errors if a measurement is due, or the errors of the records that the recovery has taken."""
        if self._watches:
            for record in self._recovery.records():
                self._record(record)
            return
        progress = self._recovery.progress
        if progress.iteration_in_all == self._last or not _due(progress):
            return
        self._record(self._recovery.record(self._rows, self._columns))
        if self._show is not None:
            self._show(self._recovery.maps(confidence=False))

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Return the record, for a checkpoint."""
        return {_ITERATIONS: np.array(self._iterations), **{n: np.stack(e) for n, e in self._errors.items()}}

    def take(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the record from a checkpoint, up to the recovery's iteration: a stage may be repeated.

        Errors of a truth that only one of the two runs has are dropped, or NaN until this iteration.
        """
        self._last = self._recovery.progress.iteration_in_all
        self._iterations = [int(n) for n in arrays.get(_ITERATIONS, ()) if n <= self._last]
        count = len(self._iterations)
        unknown = np.full((count, len(self._rows)), np.nan)
        names = ["residual", *(p.name for p in self._judged())]
        self._errors = {name: list(arrays.get(name, unknown)[:count]) for name in names} if count else {}
        if self._watches:
            self._recovery.watch(self._rows, self._columns, _due)

    def picture(self, maps: Maps) -> np.ndarray:
        """Return (H, W, 3) display values: the marked texels on the normal map, and their errors (Fig. 4)."""
        normal = maps.model.parameter(maps.model.normal)
        image = display_image([normal], [maps.values[normal.name]]) * maps.solved[..., None]
        panels = [
            Curves(name, np.array(self._iterations), np.stack(errors), unit, log=True)
            for name, errors in self._errors.items()
            for unit in ("%" if name == "residual" else error_unit(maps.model.parameter(name)),)
        ]
        marks = [(int(x), int(y)) for x, y in zip(self._columns, self._rows, strict=True)]
        return convergence(image, marks, panels)

    def _record(self, record: TexelRecord) -> None:
        self._last = record.iteration
        self._iterations.append(record.iteration)
        self._errors.setdefault("residual", []).append(100 * record.residual)
        if self._truth is not None:
            for p in self._judged():
                error = parameter_error(p, record.values[p.name], self._truth[p.name][self._rows, self._columns])
                self._errors.setdefault(p.name, []).append(error)

    def _judged(self) -> list[Parameter]:
        """Return the parameters that the truth has."""
        return [p for p in self._recovery.model.parameters if p.name in (self._truth or ())]


def _interval(progress: Progress) -> int:
    """Return the iterations between measurements."""
    return max(1, progress.iterations_in_all // _MEASUREMENTS)


def _due(progress: Progress) -> bool:
    return progress.done or progress.iteration_in_all % _interval(progress) == 0
