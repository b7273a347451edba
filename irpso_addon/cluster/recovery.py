"""A recovery over the ranks of an MPI job, driven on rank 0."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from operator import methodcaller
from typing import Concatenate, TypeVar

import numpy as np

from ..geometry.domain import Domain, with_lights
from ..gpu.kernel import EntryChoice
from ..reflectance.model import ReflectanceModel
from ..results.maps import Maps
from ..solver.engine.engine import Capabilities, RecoveryEngine
from ..solver.engine.progress import Progress
from ..solver.settings.schedule import Schedule
from ..solver.state.checkpoint import Checkpoint
from ..solver.state.separation_record import Separation
from .samples import RankedStack
from .worker import P, Worker

T = TypeVar("T")
Result = TypeVar("Result")


class Leader:
    """Rank 0's access to all ranks, which carry out its orders. busy: while they do."""

    def __init__(self, worker: Worker):
        self.worker, self.ranks = worker, worker.ranks
        self.busy = False
        whole = worker.partition.whole
        window = slice(0, whole.shape[0]), slice(0, whole.shape[1])
        self.domain = replace(whole, stack=RankedStack(self, range(whole.observations), window))

    def ask(
        self, order: Callable[Concatenate[Worker, P], Result | None], *arguments: P.args, **named: P.kwargs
    ) -> Result:
        """As ``Orders.ask``."""
        call = methodcaller(order.__name__, *arguments, **named)
        return self._dispatch(call, call)

    def send(self, order: Callable[Concatenate[Worker, P], None], *arguments: P.args, **named: P.kwargs) -> None:
        """As ``ask``, for a method that returns nothing."""
        call = methodcaller(order.__name__, *arguments, **named)
        self._dispatch(call, call)

    def scatter(self, order: Callable[[Worker, T | None], Result], value: T) -> Result:
        """As ``Orders.scatter``."""
        return self._dispatch(methodcaller(order.__name__, value), methodcaller(order.__name__, None))

    def take_lights(self, lights: np.ndarray, intensities: np.ndarray) -> None:
        """Have all ranks replace the capture's lights."""
        self.send(Worker.take_lights, lights, intensities)
        self.domain = with_lights(self.domain, lights, intensities)

    def end(self, code: int = 0) -> None:
        """End ``serve`` on the other ranks, with an exit code."""
        self.ranks.order(code)

    def _dispatch(self, own: Callable[[Worker], Result], others: Callable[[Worker], Result]) -> Result:
        self.busy = True
        self.ranks.order(others)
        result = own(self.worker)
        self.busy = False
        return result


def serve(worker: Worker) -> int:
    """Carry out rank 0's orders until ``Leader.end``; return the exit code."""
    while not isinstance(order := worker.ranks.next_order(), int):
        order(worker)
    return order


class RankedRecovery(RecoveryEngine):
    """A ``RecoveryEngine`` over all ranks: the maps are those of one process, bit for bit.

    Created on rank 0 while the others ``serve``. domain: the leader's, or of some of its observations. fixed: the
    job's, which the ranks have, and perhaps more. Other arguments as for Recovery.
    """

    def __init__(
        self,
        leader: Leader,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        fixed: Mapping[str, np.ndarray],
        entry: EntryChoice = "auto",
        guess: Mapping[str, np.ndarray] | None = None,
    ):
        self._leader, stack = leader, domain.stack
        super().__init__(domain, model, schedule, seed, fixed, entry)
        if not isinstance(stack, RankedStack):
            raise TypeError("RankedRecovery: the domain's samples must lie on the ranks")
        if guess is not None:
            leader.scatter(Worker.take_guess, guess)
        extra_fixed = {name: value for name, value in fixed.items() if name not in leader.worker.fixed}
        samples = stack.observations.tolist(), stack.second
        self._separation: tuple[int, Separation | None] | None = None  # stage, its separation
        self._progress = leader.ask(Worker.begin, *samples, model, schedule, seed, extra_fixed, self.entry)

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities("none", reconfigure=False)

    @property
    def progress(self) -> Progress:
        return self._progress

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance on all ranks, as RecoveryEngine.step."""
        if time_budget_s is None:
            self._progress = self._leader.ask(Worker.advance, iterations)
            return self._progress
        deadline, left = time.perf_counter() + time_budget_s, iterations
        while not self._progress.done and (left is None or left > 0) and time.perf_counter() < deadline:
            self._progress = self._leader.ask(Worker.advance, 1)
            left = None if left is None else left - 1
        return self._progress

    def maps(self, confidence: bool = True) -> Maps:
        return self._leader.ask(Worker.maps, confidence)

    @property
    def separation(self) -> Separation | None:
        if self._separation is None or self._separation[0] != self._progress.stage:
            self._separation = self._progress.stage, self._leader.ask(Worker.separation)
        return self._separation[1]

    def mean_error(self) -> float:
        """Return the mean error over some texels of each rank, as RecoveryEngine.mean_error."""
        return self._leader.ask(Worker.mean_error)

    def state(self, running: bool = True) -> Checkpoint:
        """Return the state of all ranks' texels, gathered here."""
        return self._leader.ask(Worker.state)

    def restore(self, saved: Checkpoint) -> None:
        self._progress = self._leader.scatter(Worker.restore, saved)

    def close(self) -> None:
        if not self._leader.busy:  # else a rank has failed and the others wait for it
            self._leader.send(Worker.close)

    @cached_property
    def digest(self) -> int:
        """The 64-bit digest of all ranks' samples."""
        return self._leader.ask(Worker.digest)
