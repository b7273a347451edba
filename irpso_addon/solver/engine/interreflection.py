"""Rounds of interreflection: the light that the subject throws on itself is taken off the photographs."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...core.optional import present
from ...core.steps import map_steps, run_steps
from ...geometry.domain import Domain
from ...geometry.light.surroundings import Surroundings
from ...geometry.samples import ArrayStack, new_stack
from ...gpu.passes import EntryChoice
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..settings.schedule import Schedule
from ..state import prepare
from ..state.checkpoint import Checkpoint
from ..state.prepare import Prepared
from ..views.indirect import IndirectLight
from .recovery import Recovery
from .successive import Successive

_AT = "interreflection"  # in a checkpoint: the round, and the evaluations of those before it
_ERRORS = "interreflection_errors"
_BASIS = "interreflection_of_{}_"  # before the maps that a round's light was found from
# By how much the light that is taken off moves toward the new one. Too bright an albedo makes it too bright, and the
# next albedo too dark: with 1 the rounds swing about the answer, with 0.75 two reach it.
_RELAXATION = 0.75
_LEAST_SHARE = 0.003  # of the light of the photographs: less is not worth a round


class InterreflectionRounds(Successive):
    """A ``RecoveryEngine`` that recovers a domain, then ``interreflection.rounds`` times without indirect light.

    After each recovery the light that its maps make the subject throw on itself (views/indirect.py) is subtracted from
    the photographs, and the domain is recovered again from them; it ends earlier where there is next to none of that
    light. surroundings: what the light comes from. prepared: from ``prepare``, of the photographs as they are. scratch:
    a folder for the second sample stack, None for memory. The others are as for Recovery.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        fixed: Mapping[str, np.ndarray] | None,
        entry: EntryChoice,
        surroundings: Surroundings,
        prepared: Prepared | None = None,
        scratch: Path | None = None,
    ):
        super().__init__(domain, model, schedule, seed, fixed, entry, _schedules(schedule))
        self._surroundings, self._scratch = surroundings, scratch
        self._samples: ArrayStack | None = None  # without indirect light
        self._errors: list[float] = []  # mean errors of the renders at the ends of the rounds
        self._strengths: list[float] = []  # by which each round's light was multiplied
        self._bases: list[dict[str, np.ndarray]] = []  # the maps that each round's light was found from
        self._count()
        self._live = self._begin(domain, prepared)

    def maps(self, confidence: bool = True) -> Maps:
        return self._live.maps(confidence)

    @property
    def warnings(self) -> tuple[str, ...]:
        if not self._errors or not self.progress.done or (last := self.mean_error()) <= self._errors[0]:
            return ()
        return (
            "without the light that the subject throws on itself the photographs are explained worse than before (mean"
            f" error {last:.2g}, {self._errors[0]:.2g}); set interreflection_rounds=0",
        )

    @property
    def findings(self) -> dict[str, Any]:
        return {"interreflection": {"rounds": len(self._strengths), "strength": self._strengths}}

    def indirect(self, observation: int) -> np.ndarray | float:
        if self._at == 0 or self._samples is None:
            return 0.0
        return self.domain.stack.layer(observation)[..., :3] - self._samples.layer(observation)[..., :3]

    def state(self) -> Checkpoint:
        """Return the state of the current round, its number, and the maps that the rounds' light was found from."""
        state, solved = self._live.state(), self.domain.solvable
        bases = {
            _BASIS.format(number) + name: value[solved]
            for number, basis in enumerate(self._bases)
            for name, value in basis.items()
        }
        own = {_AT: np.array([self._at, self._before]), _ERRORS: np.array(self._errors)}
        return replace(state, arrays=state.arrays | own | bases)

    def restore(self, saved: Checkpoint) -> None:
        self.close()
        self._at, self._before = (int(number) for number in saved.arrays[_AT])
        self._errors = saved.arrays[_ERRORS].tolist()
        self._bases, self._strengths, domain = [], [], self.domain
        for number in range(self._at):
            self._bases.append(
                {p.name: np.zeros((*domain.shape, p.components), np.float32) for p in self.model.parameters}
            )
            for name, value in self._bases[-1].items():
                value[domain.solvable] = saved.arrays[_BASIS.format(number) + name]
            domain = present(run_steps(self._without_indirect()))
        self._live = self._begin(domain)
        own = {name: array for name, array in saved.arrays.items() if not name.startswith(_AT)}
        self._live.restore(replace(saved, arrays=own))

    def reconfigure(self, schedule: Schedule, seed: int | None = None) -> InterreflectionRounds:
        """Return a run that continues from here, as Recovery.reconfigure; settings of interreflection must stay."""
        if schedule.interreflection != self.schedule.interreflection:
            raise InputError("Interreflection: a running recovery keeps its settings; set them back, or begin another")
        return self._reconfigured(schedule, _schedules(schedule), seed)

    def _texels(self, number: int) -> int:
        return int(np.count_nonzero(self.domain.solvable))

    def _ending(self, number: int) -> str:
        return f", round {number} of interreflection" if number else ""

    def _begin(self, domain: Domain, prepared: Prepared | None = None) -> Recovery:
        schedule = self._schedules[self._at]
        prepared = prepared or prepare.prepare(domain, self.model, schedule)
        return Recovery(domain, self.model, schedule, self.seed, self.fixed, self.entry, prepared)

    def _next(self) -> Iterator[None]:
        self._bases.append(dict(self._live.maps(confidence=False).values))
        self._errors.append(self.mean_error())
        domain = yield from self._without_indirect()
        if domain is None:
            self._schedules = self._schedules[: self._at + 1]
            self._count()
            return
        self._before += self._live.progress.evaluations
        self._live.close()
        self._at += 1
        self._live = self._begin(domain)

    def _without_indirect(self) -> Generator[None, None, Domain | None]:
        """Return, yielding often, the domain with less of the light that its last maps make it throw on itself.

        None where there is next to none.
        """
        settings, domain = self.schedule.interreflection, self.domain
        first = len(self._bases) == 1
        samples = self._samples = self._samples or new_stack(*domain.stack.shape, self._scratch)
        surface, exchange, values = yield from map_steps(
            self._surroundings.steps(domain, self._bases[-1]), lambda part: None
        )
        covered = surface.bake.coverage
        with closing(IndirectLight(surface, exchange, self.model, values, settings.bounces)) as light:
            radiance = np.empty((domain.observations, len(exchange.texels), 3), np.float32)
            for observation in range(domain.observations):
                radiance[observation] = light.of_elements(observation)
                yield
            strength = light.strength(radiance)
            self._strengths.append(strength)
            if strength * radiance.mean() < _LEAST_SHARE * light.shown.mean():
                return None
            for sample, layer, indirect in zip(samples.layers(), domain.stack.layers(), radiance, strict=True):
                if first:
                    sample[:] = layer
                off = layer[covered, :3] - strength * light.at_texels(indirect)
                sample[covered, :3] += _RELAXATION * (np.maximum(off, 0) - sample[covered, :3])
                yield
        return replace(domain, stack=samples)


def _schedules(schedule: Schedule) -> tuple[Schedule, ...]:
    """Return the schedule of each recovery."""
    return (schedule,) * (1 + schedule.interreflection.rounds)
