"""Rounds of interreflection: the light that the subject throws on itself is taken off the photographs."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...core.optional import present
from ...core.steps import map_steps, run_steps
from ...geometry.domain import Domain
from ...geometry.light.alike import drawn_to_alike
from ...geometry.light.surroundings import Surroundings
from ...geometry.samples import SampleStack
from ...gpu.kernel import EntryChoice
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..settings.schedule import Schedule
from ..state.checkpoint import Checkpoint
from ..state.prepare import Prepared
from ..views.indirect import IndirectLight
from .engine import RecoveryEngine
from .reconfigure import given
from .recovery import Recovery
from .successive import Successive

_AT = "interreflection"  # in a checkpoint: the round, and the evaluations of those before it
_ERRORS = "interreflection_errors"
_EXPLAINED = "explained"  # beside the maps of a basis: (H, W, 1), 1 where they can be trusted
_BASIS = "interreflection_of_{}_"  # before the maps that a round's light was found from
# By how much the light that is taken off moves toward the new one. Too bright an albedo makes it too bright, and the
# next albedo too dark: with 1 the rounds swing about the answer, with 0.75 two reach it. With held normals the first
# answer is nearer: there it moves all the way.
_RELAXATION = 0.75
_LEAST_SHARE = 0.003  # of the light of the photographs: less is not worth a round
_MOST_RESIDUAL = 0.5  # of a texel's light: where more is left, what was found is not the material
# Of the light that a texel's material sends: what is left above this tells of the errors of the rest. Normals in a bowl
# of metal paint are off by 1.6° where it is 0.5 to 0.7, and by 20° where it is more than 0.9.
_MOST_INDIRECT = 2 / 3


class InterreflectionRounds(Successive):
    """A ``RecoveryEngine`` that recovers a domain, then ``interreflection.rounds`` times without indirect light.

    After each recovery the light that its maps make the subject throw on itself (views/indirect.py) is subtracted from
    the photographs, and the domain is recovered again from them. Where the surroundings know the shape, all recoveries
    but the last hold its normals: those that photographs with indirect light show in a hollow of metal lead astray. The
    last one begins with their materials. Where there is next to none of that light, the maps are those of a Recovery.

    surroundings: what the light comes from. prepared: from ``prepare``, of the photographs as they are. scratch: a
    folder for the second sample stack, None for memory. solve: begins one recovery, by the arguments of ``Recovery``:
    domain, model, schedule, seed, fixed, entry, and one of prepared and guess. The others are as for Recovery.
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
        solve: Callable[..., RecoveryEngine] = Recovery,
    ):
        free = any(not p.is_normal and p.name not in (fixed or {}) for p in model.parameters)
        self._holds = surroundings.shape_known and free  # whether normals are held
        self._warm = self._holds  # whether the last recovery begins with what those before have found
        super().__init__(domain, model, schedule, seed, fixed, entry, _schedules(schedule, self._warm))
        self._surroundings, self._scratch, self._solve = surroundings, scratch, solve
        self._dominated = np.zeros(domain.shape, bool)  # texels that owe most of their light to others
        self._stand_in: dict[str, np.ndarray] = {}  # maps in place of theirs
        self._samples: SampleStack | None = None  # without indirect light
        self._share: np.ndarray | None = None  # (H, W) of the light of the photographs, as the last round found it
        self._mean_share = 0.0  # over the texels
        self._errors: list[float] = []  # mean residuals at the ends of the rounds
        self._strengths: list[float] = []  # by which each round's light was multiplied
        self._bases: list[dict[str, np.ndarray]] = []  # the maps that each round's light was found from
        self._count()
        self._live = self._begin(domain, prepared)

    def maps(self, confidence: bool = True) -> Maps:
        """Return the maps of the current recovery, as RecoveryEngine.maps.

        Where most light is indirect, those of the last have the mesh's normals, the material of the nearest texels
        whose light is direct, and deviations as wide as can be.
        """
        maps = self._live.maps(confidence)
        if self._held(self._at) or not self._stand_in:
            return maps
        values, deviations = dict(maps.values), maps.confidence and dict(maps.confidence)
        for p in self.model.parameters:
            if p.name not in self.fixed:
                values[p.name] = np.where(self._dominated[..., None], self._stand_in[p.name], values[p.name])
                if deviations:
                    widest = np.float32(p.width)
                    deviations[p.name] = np.where(self._dominated[..., None], widest, deviations[p.name])
        return replace(maps, values=values, confidence=deviations)

    @property
    def warnings(self) -> tuple[str, ...]:
        if not self._errors or not self.progress.done:
            return ()
        last = self._mean_residual(self._live.maps(confidence=False))
        if last <= self._errors[0]:
            return ()
        return (
            "without the light that the subject throws on itself the photographs are explained worse than before (mean"
            f" error {last:.2g}, {self._errors[0]:.2g}); set interreflection_rounds=0",
        )

    @property
    def findings(self) -> dict[str, Any]:
        found = {"rounds": len(self._strengths), "strength": self._strengths, "share": self._mean_share}
        unknown = {"unknown_texels": int(np.count_nonzero(self._dominated))}
        return {**self._live.findings, "interreflection": found | unknown}

    @property
    def identity(self) -> dict[str, Any]:
        return super().identity | self._surroundings.identity

    def indirect(self, observation: int) -> np.ndarray | float:
        own = self._live.indirect(observation)
        if self._at == 0 or self._samples is None:
            return own
        return own + self.domain.stack.layer(observation)[..., :3] - self._samples.layer(observation)[..., :3]

    def indirect_in(self, domain: Domain) -> Generator[None, None, Callable[[int], np.ndarray | float]]:
        if self._at == 0 or self._samples is None:
            return lambda observation: 0.0
        number, radiance = self._at - 1, []  # of the light that the current maps were found without
        light = yield from self._lighting(replace(domain, solvable=self.domain.solvable), self._bases[number])
        with closing(light):
            for observation in range(domain.observations):
                radiance.append(self._strengths[number] * light.of_elements(observation)[0])
                yield

        def thrown(observation: int) -> np.ndarray:
            found = np.zeros((*domain.shape, 3), np.float32)
            found[light.covered] = light.at_texels(radiance[observation])
            return found

        return thrown

    @property
    def indirect_share(self) -> np.ndarray | None:
        return self._live.indirect_share if self._share is None else self._share

    def state(self, running: bool = True) -> Checkpoint:
        """Return the state of the current round, its number, and the maps that the rounds' light was found from."""
        state, solved = self._live.state(running), self.domain.solvable
        bases = {
            _BASIS.format(number) + name: value[solved]
            for number, basis in enumerate(self._bases)
            for name, value in basis.items()
        }
        own = {_AT: np.array([self._at, self._before]), _ERRORS: np.array(self._errors)}
        return replace(state, arrays=state.arrays | own | bases)

    def restore(self, saved: Checkpoint) -> None:
        self.close()
        self._warm, self._dominated, self._stand_in = self._holds, np.zeros(self.domain.shape, bool), {}
        self._schedules = _schedules(self.schedule, self._warm)
        self._at, self._before = (int(number) for number in saved.arrays[_AT])
        self._errors = saved.arrays[_ERRORS].tolist()
        self._share, self._mean_share = None, 0.0
        self._bases, self._strengths, domain = [], [], self.domain
        for number in range(self._at):
            sizes = {p.name: p.components for p in self.model.parameters} | {_EXPLAINED: 1}
            self._bases.append({name: np.zeros((*domain.shape, n), np.float32) for name, n in sizes.items()})
            for name, value in self._bases[-1].items():
                value[domain.solvable] = saved.arrays[_BASIS.format(number) + name]
            domain = run_steps(self._without_indirect()) or self._without_rounds(number + 1)
        self._count()
        self._live = self._begin(domain)
        own = {name: array for name, array in saved.arrays.items() if not name.startswith(_AT)}
        self._live.restore(replace(saved, arrays=own))

    def reconfigure(self, schedule: Schedule, seed: int | None = None) -> InterreflectionRounds:
        """Return a run that continues from here, as Recovery.reconfigure; settings of interreflection must stay."""
        if schedule.interreflection != self.schedule.interreflection:
            raise InputError("Interreflection: a running recovery keeps its settings; set them back, or begin another")
        return self._reconfigured(schedule, _schedules(schedule, self._warm), seed)

    def _texels(self, number: int) -> int:
        return int(np.count_nonzero(self.domain.solvable))

    def _ending(self, number: int) -> str:
        return f", round {number} of interreflection" if number else ""

    def _held(self, number: int) -> bool:
        """Return whether a recovery holds the normals of the known shape."""
        return self._holds and number < len(self._schedules) - 1

    def _fixed_in(self, number: int) -> Mapping[str, np.ndarray]:
        held = {
            p.name: np.array((0, 0, 1), np.float32) for p in self.model.parameters if p.is_normal and self._held(number)
        }
        return held | dict(self.fixed)

    def _begin(self, domain: Domain, prepared: Prepared | None = None) -> RecoveryEngine:
        schedule = self._schedules[self._at]
        begin: dict[str, Any] = {"prepared": prepared} if prepared else {}
        if schedule.swarm.seed == "given" and self._bases:
            begin = {"guess": {p.name: self._bases[-1][p.name] for p in self.model.parameters}}
        fixed = self._fixed_in(self._at)
        return self._solve(domain, self.model, schedule, self.seed, fixed, self.entry, **begin)

    def _next(self) -> Iterator[None]:
        maps = self._live.maps(confidence=self._holds)
        self._bases.append(self._basis(maps))
        self._errors.append(self._mean_residual(maps))
        domain = yield from self._without_indirect()
        if domain is None and not self._held(self._at):
            self._schedules = self._schedules[: self._at + 1]
            self._count()
            return
        domain = domain or self._without_rounds(self._at + 1)
        self._before += self._live.progress.evaluations
        self._live.close()
        self._at += 1
        self._live = self._begin(domain)

    def _mean_residual(self, maps: Maps) -> float:
        return float(present(maps.residual)[self.domain.solvable].mean(dtype=np.float64))

    def _basis(self, maps: Maps) -> dict[str, np.ndarray]:
        """Return the live maps by name, and where they explain the photographs."""
        light, count = np.zeros(self.domain.shape), np.zeros(self.domain.shape)
        for layer in self._live.domain.stack.layers():
            counted = layer[..., 3] > 0
            light += counted * layer[..., :3].mean(axis=-1)
            count += counted
        explained = present(maps.residual) * np.maximum(count, 1) <= _MOST_RESIDUAL * light
        values = self._steadied(maps, explained) if self._holds else maps.values
        return {**values, _EXPLAINED: (explained & ~self._dominated)[..., None].astype(np.float32)}

    def _steadied(self, maps: Maps, explained: np.ndarray) -> dict[str, np.ndarray]:
        """Return the live maps with the gloss of texels that hardly show it drawn to that of texels of like colour.

        Light that is found from a gloss that is not there, and taken off, makes the next round find more of it.
        """
        values, solved = dict(maps.values), self.domain.solvable
        colour = next((values[p.name][solved] for p in self.model.parameters if p.is_albedo), None)
        if colour is None:
            return values
        for p in self.model.parameters:
            deviation = (maps.confidence or {}).get(p.name)
            if not (p.is_normal or p.is_albedo or p.name in self.fixed or deviation is None):
                values[p.name] = values[p.name].copy()
                own = values[p.name][solved], deviation[solved]
                values[p.name][solved] = drawn_to_alike(*own, colour, explained[solved])
        return values

    def _without_rounds(self, last: int) -> Domain:
        """Make a recovery the last one, without anything of those before it; return its domain."""
        self._warm, self._samples, self._stand_in = False, None, {}
        self._dominated = np.zeros(self.domain.shape, bool)
        self._take_share(np.zeros(self.domain.shape))
        self._schedules = _schedules(self.schedule, self._warm)[: last + 1]
        self._count()
        return self.domain

    def _without_indirect(self) -> Generator[None, None, Domain | None]:
        """Return, yielding often, the domain with less of the light that its last maps make it throw on itself.

        None where there is next to none.
        """
        domain = self.domain
        first, relaxation = len(self._bases) == 1, 1.0 if self._holds else _RELAXATION
        with closing((yield from self._lighting(domain, self._bases[-1]))) as light:
            exchange, covered = light.exchange, light.covered
            radiance = np.empty((domain.observations, len(exchange.texels), 3), np.float32)
            direct, indirect = np.zeros((2, len(exchange.texels)))
            counted = light.seen | ~light.seen.any(axis=0)  # of an element that no photograph shows, all
            for observation in range(domain.observations):
                radiance[observation], own = light.of_elements(observation)
                direct += counted[observation] * own
                indirect += counted[observation] * radiance[observation].mean(axis=-1)
                yield
            strength = light.strength(radiance)
            self._strengths.append(strength)
            if strength * radiance.mean() < _LEAST_SHARE * light.shown.mean():
                if first:
                    self._take_share(np.zeros(domain.shape))
                return None
            samples = self._samples = self._samples or domain.stack.another(self._scratch)
            taken, shown = np.zeros((2, int(covered.sum())))
            for observation, (layer, of_elements) in enumerate(zip(domain.stack.layers(), radiance, strict=True)):
                sample = (layer if first else samples.layer(observation)).copy()
                light_of_texels = strength * light.at_texels(of_elements)
                off = np.maximum(layer[covered, :3] - light_of_texels, 0)
                sample[covered, :3] += relaxation * (off - sample[covered, :3])
                samples.put(observation, sample)
                seen = layer[covered, 3] > 0
                taken += seen * light_of_texels.mean(axis=-1)
                shown += seen * layer[covered, :3].mean(axis=-1)
                yield
            share = np.zeros(domain.shape)
            share[covered] = np.divide(taken, shown, out=np.zeros_like(taken), where=shown > 0)
            self._take_share(share)
            if self._holds:
                part = strength * indirect / np.maximum(strength * indirect + direct, 1e-12)
                self._dominated[covered] = exchange.at_texels(part[:, None])[:, 0] > _MOST_INDIRECT
                self._dominated &= domain.solvable
                for name, value in light.materials.items():
                    self._stand_in[name] = np.zeros((*domain.shape, value.shape[-1]), np.float32)
                    self._stand_in[name][covered] = exchange.at_texels(value)
        return replace(domain, stack=samples)

    def _lighting(self, domain: Domain, basis: Mapping[str, np.ndarray]) -> Generator[None, None, IndirectLight]:
        """Return, yielding often, what finds the light of a basis in the observations of a domain."""
        bounces, steps = self.schedule.interreflection.bounces, self._surroundings.steps(domain, basis)
        surface, exchange, values = yield from map_steps(steps, lambda part: None)
        known = domain.solvable & (values[_EXPLAINED][..., 0] > 0)
        return IndirectLight(surface, exchange, self.model, values, known if known.any() else domain.solvable, bounces)

    def _take_share(self, share: np.ndarray) -> None:
        """Take the share (H, W) of the light of the photographs that is indirect."""
        self._share = np.where(self.domain.solvable, np.minimum(share, 1), 0).astype(np.float32)
        self._mean_share = float(self._share[self.domain.solvable].mean())


def _schedules(schedule: Schedule, warm: bool) -> tuple[Schedule, ...]:
    """Return the schedule of each recovery. warm: whether the last begins with what those before have found."""
    single = schedule.replaced(interreflection_rounds=0)
    return (*(single,) * schedule.interreflection.rounds, given(single) if warm else single)
