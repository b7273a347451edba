"""A recovery over the ranks of an MPI job, with the face of Recovery on rank 0."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..geometry.domain import Domain, subset
from ..gpu import probe
from ..results.maps import Maps
from ..solver.engine.progress import Progress
from ..solver.settings.schedule import Schedule
from ..solver.state import checkpoint
from .samples import SharedStack
from .worker import Member

_END = "end"


class Crew:
    """All ranks as rank 0 sees them: what it orders, every one does. ``busy`` while they do."""

    def __init__(self, member: Member):
        self.member, self.ranks = member, member.ranks
        self.busy = False
        whole = member.share.whole
        self.domain = replace(whole, stack=SharedStack(self.ask, range(whole.observations), whole.shape))

    def ask(self, name: str, *arguments: Any) -> Any:
        """Have all ranks do one of Member's methods; return what rank 0 is given."""
        return self._do(name, arguments, arguments)

    def ask_of_own(self, name: str, *arguments: Any, others: Sequence[Any]) -> Any:
        """As ``ask``, with other arguments for the other ranks: what is large may stay here."""
        return self._do(name, arguments, others)

    def take_lights(self, lights: np.ndarray, intensities: np.ndarray) -> None:
        """Have all ranks take other lights than the capture's."""
        self.ask("take_lights", lights, intensities)
        whole = self.member.share.whole
        self.domain = replace(self.domain, lights=whole.lights, intensities=whole.intensities)

    def end(self, code: int = 0) -> None:
        """Let the other ranks go, with an exit code."""
        self.ranks.order((_END, (code,)))

    def _do(self, name: str, own: Sequence[Any], others: Sequence[Any]) -> Any:
        self.busy = True
        self.ranks.order((name, others))
        result = getattr(self.member, name)(*own)
        self.busy = False
        return result


def serve(member: Member) -> int:
    """Do what rank 0 orders until it lets this rank go; return the exit code."""
    while True:
        name, arguments = member.ranks.next_order()
        if name == _END:
            return arguments[0]
        getattr(member, name)(*arguments)


class RankedRecovery:
    """One run over all ranks, with the face of Recovery: the maps are those of one process, bit for bit.

    To be made on rank 0 while the others ``serve``. fitted: the observations, by number, that are fitted. entry: as for
    a Recovery. There is no view(): no textures hold the whole. A checkpoint does not know how many ranks there were.
    """

    def __init__(self, crew: Crew, fitted: Sequence[int], entry: str = "auto"):
        self._crew, member = crew, crew.member
        self.model, self.schedule, self.seed = member.model, member.schedule, member.seed
        self.entry = probe.faster_entry() if entry == "auto" else entry
        self._progress: Progress = crew.ask("begin", list(fitted), self.entry)
        self.domain: Domain = subset(crew.domain, fitted)
        vars(self.domain)["solvable"] = member.domain.solvable

    @property
    def progress(self) -> Progress:
        """How far the recovery is."""
        return self._progress

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance by whole iterations, or for about so long, or to the end; return the progress, as Recovery.step."""
        if time_budget_s is None:
            self._progress = self._crew.ask("advance", iterations)
            return self._progress
        deadline, left = time.perf_counter() + time_budget_s, iterations
        while not self._progress.done and (left is None or left > 0) and time.perf_counter() < deadline:
            self._progress = self._crew.ask("advance", 1)
            left = None if left is None else left - 1
        return self._progress

    def maps(self, confidence: bool = True) -> Maps:
        """Return what has been found so far, as Recovery.maps."""
        return self._crew.ask("maps", confidence)

    def mean_error(self) -> float:
        """Return the mean error over a few thousand texels of each rank, as Recovery.mean_error."""
        return self._crew.ask("mean_error")

    def save(self, path: str | Path, notes: Mapping[str, np.ndarray] = MappingProxyType({})) -> None:
        """Write a checkpoint, as Recovery.save, from which any number of ranks goes on to the same maps bit for bit."""
        state = self._crew.ask("state")
        checkpoint.write(Path(path), self._identity, replace(state, notes=notes))

    def load(self, path: str | Path) -> dict[str, np.ndarray]:
        """Go on from a checkpoint of the same domain and settings, and return its notes, as Recovery.load."""
        saved = checkpoint.read(Path(path), self._identity)
        at = saved.stage, saved.iteration, saved.evaluations
        self._progress = self._crew.ask_of_own("restore", *at, saved.arrays, others=(*at, None))
        return dict(saved.notes)

    def changed(self, schedule: Schedule, seed: int | None = None) -> RankedRecovery:
        """Raise InputError: a recovery over ranks does not change its settings midway."""
        raise InputError("a recovery over ranks takes no other settings in mid-run: stop, and recover again with them")

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        """Return True: ranks find theirs in maps()."""
        return True

    def close(self) -> None:
        """Free all that lies on the GPUs."""
        self._crew.ask("close")

    def __enter__(self) -> RankedRecovery:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if not self._crew.busy:  # else some ranks wait for one that has failed
            self.close()

    @cached_property
    def _identity(self) -> dict[str, Any]:
        """Who this is to a checkpoint; found once: it reads all samples."""
        member = self._crew.member
        settings = (self.model, self.schedule, self.seed, self.entry, member.fixed)
        return checkpoint.identity(member.domain, *settings, samples=self._crew.ask("digest"))
