"""A recovery over the ranks of an MPI job, with the face of Recovery on rank 0."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Concatenate, TypeVar

import numpy as np

from ..core.errors import InputError
from ..geometry.domain import Domain, with_lights
from ..gpu import probe
from ..results.maps import Maps
from ..solver.engine.progress import Progress
from ..solver.settings.schedule import Schedule
from ..solver.state import checkpoint
from .samples import RankedStack
from .worker import P, Worker

T, Result = TypeVar("T"), TypeVar("Result")


class Leader:
    """All ranks as rank 0 sees them: what it asks for, every one does. ``busy`` while they do."""

    def __init__(self, worker: Worker):
        self.worker, self.ranks = worker, worker.ranks
        self.busy = False
        whole = worker.partition.whole
        window = slice(0, whole.shape[0]), slice(0, whole.shape[1])
        self.domain = replace(whole, stack=RankedStack(self.ask, range(whole.observations), window))

    def ask(self, order: Callable[Concatenate[Worker, P], Result], *arguments: P.args, **named: P.kwargs) -> Result:
        """Have all ranks call a method of their Worker; return what rank 0 is given."""
        return self._do(order, arguments, arguments)

    def deal(self, order: Callable[[Worker, T | None], Result], value: T) -> Result:
        """As ``ask``, with what is large and stays here: the other ranks call the method with None."""
        return self._do(order, (value,), (None,))

    def take_lights(self, lights: np.ndarray, intensities: np.ndarray) -> None:
        """Have all ranks take other lights than the capture's."""
        self.ask(Worker.take_lights, lights, intensities)
        self.domain = with_lights(self.domain, lights, intensities)

    def end(self, code: int = 0) -> None:
        """Let the other ranks go, with an exit code."""
        self.ranks.order((None, (code,)))

    def _do(self, order: Callable[..., Result], own: tuple, others: tuple) -> Result:
        self.busy = True
        self.ranks.order((order, others))
        result = order(self.worker, *own)
        self.busy = False
        return result


def serve(worker: Worker) -> int:
    """Do what rank 0 asks for until it lets this rank go; return the exit code."""
    while True:
        order, arguments = worker.ranks.next_order()
        if order is None:
            return arguments[0]
        order(worker, *arguments)


class RankedRecovery:
    """One run over all ranks, with the face of Recovery: the maps are those of one process, bit for bit.

    To be made on rank 0 while the others ``serve``. fitted: the observations, by number, that are fitted. entry: as for
    a Recovery. There is no view(): no textures hold the whole. A checkpoint does not know how many ranks there were.
    """

    def __init__(self, leader: Leader, fitted: Sequence[int], entry: str = "auto"):
        self._leader, worker = leader, leader.worker
        self.model, self.schedule, self.seed = worker.model, worker.schedule, worker.seed
        self.entry = probe.faster_entry() if entry == "auto" else entry
        self._progress: Progress = leader.ask(Worker.begin, list(fitted), self.entry)
        self.domain: Domain = replace(worker.domain, stack=leader.domain.stack.subset(np.asarray(fitted, np.intp)))

    @property
    def progress(self) -> Progress:
        """How far the recovery is."""
        return self._progress

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance by whole iterations, or for about so long, or to the end; return the progress, as Recovery.step."""
        if time_budget_s is None:
            self._progress = self._leader.ask(Worker.advance, iterations)
            return self._progress
        deadline, left = time.perf_counter() + time_budget_s, iterations
        while not self._progress.done and (left is None or left > 0) and time.perf_counter() < deadline:
            self._progress = self._leader.ask(Worker.advance, 1)
            left = None if left is None else left - 1
        return self._progress

    def maps(self, confidence: bool = True) -> Maps:
        """Return what has been found so far, as Recovery.maps."""
        return self._leader.ask(Worker.maps, confidence)

    def mean_error(self) -> float:
        """Return the mean error over a few thousand texels of each rank, as Recovery.mean_error."""
        return self._leader.ask(Worker.mean_error)

    def save(self, path: str | Path, notes: Mapping[str, np.ndarray] = MappingProxyType({})) -> None:
        """Write a checkpoint, as Recovery.save, from which any number of ranks goes on to the same maps bit for bit."""
        state = self._leader.ask(Worker.state)
        checkpoint.write(Path(path), self._identity, replace(state, notes=notes))

    def load(self, path: str | Path) -> dict[str, np.ndarray]:
        """Go on from a checkpoint of the same domain and settings, and return its notes, as Recovery.load."""
        saved = checkpoint.read(Path(path), self._identity)
        self._progress = self._leader.deal(Worker.restore, saved)
        return dict(saved.notes)

    def changed(self, schedule: Schedule, seed: int | None = None) -> RankedRecovery:
        """Raise InputError: a recovery over ranks does not change its settings midway."""
        raise InputError("a recovery over ranks takes no other settings in mid-run: stop, and recover again with them")

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        """Return True: ranks find theirs in maps()."""
        return True

    def close(self) -> None:
        """Free all that lies on the GPUs."""
        self._leader.ask(Worker.close)

    def __enter__(self) -> RankedRecovery:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if not self._leader.busy:  # else some ranks wait for one that has failed
            self.close()

    @cached_property
    def _identity(self) -> dict[str, Any]:
        """Who this is to a checkpoint; found once: it reads all samples."""
        worker = self._leader.worker
        settings = (self.model, self.schedule, self.seed, self.entry, worker.fixed)
        return checkpoint.identity(worker.domain, *settings, samples=self._leader.ask(Worker.digest))
