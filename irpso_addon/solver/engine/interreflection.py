"""Rounds of interreflection: indirect light, estimated from the maps, is subtracted from the photographs."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...core.optional import present
from ...core.steps import map_steps, run_steps
from ...geometry.domain import Domain
from ...geometry.light.alike import shrunk_to_similar_colours
from ...geometry.light.surroundings import Surroundings
from ...geometry.samples import SampleStack
from ...gpu.kernel import EntryChoice
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..phases.phase import BAND_SECONDS
from ..settings.levels import warm_started
from ..settings.resolve import held_names
from ..settings.schedule import Schedule
from ..state.checkpoint import Checkpoint
from ..state.prepare import Prepared
from ..views.direct import DirectStack
from ..views.indirect import IndirectLight
from .engine import RecoveryEngine
from .recovery import Recovery
from .successive import Successive

_AT = "interreflection"  # checkpoint array: the round, and the evaluations of the rounds before it
_ERRORS = "interreflection_errors"
_EXPLAINED = "explained"  # with the maps of a basis: (H, W, 1), 1 where they explain the photographs
_BASIS = "interreflection_of_{}_"  # prefix of the maps from which a round's light was estimated
# Relaxation factor of the subtracted light. Too bright an albedo gives too much of it, and then the next albedo is too
# dark: with 1 the rounds oscillate about the solution, with 0.75 two rounds reach it. With fixed normals the first
# estimate is closer, and the factor is 1.
_RELAXATION = 0.75
_MATTE_STEPS = 6  # of Levenberg–Marquardt in a matte round
# Part of the texels that the first matte round does not explain; with more, a full round follows. In a bowl of metal
# paint it is 0.9, and normals are off by 7.2° without that round, by 0.9° with it. In glazed and satin bodies it is at
# most 0.015.
_MOST_UNEXPLAINED = 0.02
# Where surfaces are not matte, a last matte round may fit worse than the first by this factor: such fits say little. In
# a coin and a bowl of metal paint it is 1.03 and 1.05, and their light helps the full round.
_WORSE = 1.25
_MOST_FOREIGN = 0.02  # part of the texels without an element; more are worth a warning
_LEAST_SHARE = 0.003  # of the light of the photographs; with less there is no further round
_MOST_RESIDUAL = 0.5  # of a texel's light: above it the maps do not explain the photographs
# Indirect part of a texel's light. Above it, the direct rest is mostly the error of the indirect light: in a bowl of
# metal paint the normal error is 1.6° where the part is 0.5 to 0.7, and 20° where it is more than 0.9.
MOST_INDIRECT = 2 / 3


class InterreflectionRounds(Successive):
    """A ``RecoveryEngine`` that recovers a domain, then ``interreflection.rounds`` times without indirect light.

    After each recovery the indirect light that its maps predict (views/indirect.py) is subtracted from the photographs,
    and the domain is recovered again. Where the surroundings know the shape, all recoveries but the last fix its
    normals: in a hollow of metal, indirect light biases estimated normals. The last one starts from the materials of
    the others. The first ``interreflection.matte_rounds`` recoveries find base colours alone, with all else at the
    model's defaults; where these do not explain the photographs, a full round follows in any case. If the last of them
    fits worse than the first, their light is not subtracted. Without notable indirect light the maps are those of a
    Recovery. Texels whose part of the surface has no element keep all light.

    surroundings: surfaces that send the light. prepared: from ``prepare``, of the original photographs. solve: creates
    one recovery from the arguments of ``Recovery``: domain, model, schedule, seed, fixed, entry, and one of prepared
    and guess. The others are as for Recovery.
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
        solve: Callable[..., RecoveryEngine] = Recovery,
    ):
        free = any(not p.is_normal and p.name not in (fixed or {}) for p in model.parameters)
        self._known_shape = surroundings.shape_known and free  # in all recoveries but the last
        coloured = any(p.is_albedo and p.name not in (fixed or {}) for p in model.parameters)
        self._matte = schedule.interreflection.matte_rounds if self._known_shape and coloured else 0
        self._full = schedule.interreflection.rounds
        self._warm = self._known_shape  # whether the last recovery starts from earlier estimates
        self._restarted: int | None = None  # the recovery that is the last because there is no light to subtract
        super().__init__(domain, model, schedule, seed, fixed, entry, self._schedules_of(schedule))
        self._surroundings, self._solve = surroundings, solve
        self._dominated = np.zeros(domain.shape, bool)  # texels whose light is mostly indirect
        self._substitutes: dict[str, np.ndarray] = {}  # maps for these texels
        self._samples: SampleStack | None = None  # without indirect light
        self._share: np.ndarray | None = None  # (H, W), indirect part of the photographed light, from the last round
        self._mean_share = 0.0  # over the texels
        self._foreign = 0.0  # part of the texels without an element
        self._errors: list[float] = []  # mean residuals at the ends of the rounds
        self._strengths: list[float] = []  # factors on each round's light
        self._bases: list[dict[str, np.ndarray]] = []  # the maps from which each round's light was estimated
        self._count()
        self._live = self._begin(domain, prepared)

    def maps(self, confidence: bool = True) -> Maps:
        """Return the maps of the current recovery, as RecoveryEngine.maps.

        What a round holds fixed has the largest deviation. Where most light is indirect, the maps of the last recovery
        have the mesh's normals, the material of the nearest texels with direct light, and the largest deviations.
        """
        maps = self._live.maps(confidence)
        values, deviations = dict(maps.values), maps.confidence and dict(maps.confidence)
        if self._normals_fixed(self._at):
            held = self._fixed_in(self._at).keys() - self.fixed.keys()
            for p in self.model.parameters:
                if deviations and p.name in held:
                    deviations[p.name] = np.full_like(deviations[p.name], p.width)
            return replace(maps, confidence=deviations)
        for p in self.model.parameters if self._substitutes else ():
            if p.name not in self.fixed:
                values[p.name] = np.where(self._dominated[..., None], self._substitutes[p.name], values[p.name])
                if deviations:
                    widest = np.float32(p.width)
                    deviations[p.name] = np.where(self._dominated[..., None], widest, deviations[p.name])
        return replace(maps, values=values, confidence=deviations)

    @property
    def warnings(self) -> tuple[str, ...]:
        if self._normals_fixed(self._at):
            return (
                f"stopped in round {self._at + 1} of {len(self._schedules)} of interreflection: normals are recovered"
                " in the last, until then they are the mesh's own; resume to find them",
            )
        lines = []
        if self._foreign > _MOST_FOREIGN:
            lines.append(
                f"interreflection: {self._foreign:.0%} of the texels lie on islands of the UV map for which there are"
                " too few elements, and keep the light of the rest of the subject; raise interreflection_resolution,"
                " or unwrap the mesh into larger islands"
            )
        full = self._errors[self._matte :]
        if full and self.progress.done:
            last = self._mean_residual(self._live.maps(confidence=False))
            if last > full[0]:
                setting = "rounds" if self.schedule.interreflection.rounds else "matte_rounds"
                lines.append(
                    "after subtracting the light that the subject throws on itself, the maps fit the photographs worse"
                    f" than before (mean error {last:.2g}, {full[0]:.2g}); set interreflection_{setting}=0"
                )
        return tuple(lines)

    @property
    def findings(self) -> dict[str, Any]:
        rounds = {"rounds": len(self._strengths), "strength": self._strengths, "share": self._mean_share}
        unknown = {"unknown_texels": int(np.count_nonzero(self._dominated))}
        return {**self._live.findings, "interreflection": rounds | unknown}

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
        number = self._at - 1  # the round whose light was subtracted before the current recovery
        light = yield from self._lighting(replace(domain, solvable=self.domain.solvable), self._bases[number])
        with closing(light):
            radiance, _ = yield from light.of_elements()
            samples = light.samples(self._strengths[number] * radiance)

        def indirect(observation: int) -> np.ndarray:
            result = np.zeros((*domain.shape, 3), np.float32)
            result[light.covered] = samples.at(observation, *np.nonzero(light.covered))
            return result

        return indirect

    @property
    def indirect_share(self) -> np.ndarray | None:
        return self._live.indirect_share if self._share is None else self._share

    def state(self, running: bool = True) -> Checkpoint:
        """Return the state of the current round, its number, and the maps that gave the light of all rounds."""
        state, solved = self._live.state(running), self.domain.solvable
        bases = {
            _BASIS.format(number) + name: value[solved]
            for number, basis in enumerate(self._bases)
            for name, value in basis.items()
        }
        own = {_AT: np.array([self._at, self._earlier_evaluations]), _ERRORS: np.array(self._errors)}
        return replace(state, arrays=state.arrays | own | bases)

    def restore(self, saved: Checkpoint) -> None:
        self.close()
        self._warm, self._dominated, self._substitutes = self._known_shape, np.zeros(self.domain.shape, bool), {}
        self._full, self._restarted = self.schedule.interreflection.rounds, None
        self._schedules = self._schedules_of(self.schedule)
        self._at, self._earlier_evaluations = (int(number) for number in saved.arrays[_AT])
        self._errors = saved.arrays[_ERRORS].tolist()[: self._at]  # without that of a round whose light is not known
        self._share, self._mean_share = None, 0.0
        self._bases, self._strengths, domain = [], [], self.domain
        for number in range(self._at):
            sizes = {p.name: p.components for p in self.model.parameters} | {_EXPLAINED: 1}
            self._bases.append({name: np.zeros((*domain.shape, n), np.float32) for name, n in sizes.items()})
            for name, value in self._bases[-1].items():
                value[domain.solvable] = saved.arrays[_BASIS.format(number) + name]
            domain = self._after_round(number, run_steps(self._subtract_indirect()))
        self._count()
        self._live = self._begin(domain)
        own = {name: array for name, array in saved.arrays.items() if not name.startswith(_AT)}
        self._live.restore(replace(saved, arrays=own))

    def reconfigure(self, schedule: Schedule, seed: int | None = None) -> InterreflectionRounds:
        """Return a run that continues from here, as Recovery.reconfigure; settings of interreflection must stay."""
        if schedule.interreflection != self.schedule.interreflection:
            raise InputError("Interreflection: a running recovery keeps its settings; set them back, or begin another")
        self._end_transition()
        return self._reconfigured(schedule, self._schedules_of(schedule), seed)

    def _texels(self, number: int) -> int:
        return int(np.count_nonzero(self.domain.solvable))

    def _title_suffix(self, number: int) -> str:
        return f", round {number} of interreflection" if number else ""

    def _normals_fixed(self, number: int) -> bool:
        """Return whether a recovery fixes the normals of the known shape."""
        return self._known_shape and number < len(self._schedules) - 1

    def _of_matte(self, number: int) -> bool:
        """Return whether a recovery finds base colours alone."""
        return number < self._matte and self._normals_fixed(number)

    def _fixed_in(self, number: int) -> Mapping[str, np.ndarray]:
        held: dict[str, np.ndarray] = {}
        for p in self.model.parameters:
            if p.is_normal and self._normals_fixed(number):
                held[p.name] = np.array((0, 0, 1), np.float32)
            elif not (p.is_normal or p.is_albedo) and self._of_matte(number):
                held[p.name] = np.atleast_1d(np.asarray(p.default, np.float32))
        return held | dict(self.fixed)

    def _begin(self, domain: Domain, prepared: Prepared | None = None) -> RecoveryEngine:
        schedule = self._schedules[self._at]
        begin: dict[str, Any] = {"prepared": prepared} if prepared else {}
        if schedule.swarm.seed == "given" and self._bases:
            begin = {"guess": {p.name: self._bases[-1][p.name] for p in self.model.parameters}}
        fixed = self._fixed_in(self._at)
        return self._solve(domain, self.model, schedule, self.seed, fixed, self.entry, **begin)

    def _next(self) -> Iterator[None]:
        while self._known_shape and not self._live.refresh_confidence(BAND_SECONDS):
            yield
        maps = self._live.maps(confidence=self._known_shape)
        self._bases.append((yield from self._basis(maps)))
        self._errors.append(self._mean_residual(maps))
        domain = yield from self._subtract_indirect()
        if domain is None and not self._normals_fixed(self._at):
            self._schedules = self._schedules[: self._at + 1]
            self._count()
            return
        domain = self._after_round(self._at, domain)
        self._earlier_evaluations += self._live.progress.evaluations
        self._live.close()
        self._at += 1
        self._live = self._begin(domain)

    def _after_round(self, number: int, domain: Domain | None) -> Domain:
        """Return the domain of the recovery after ``number``. domain: without indirect light, None if it has none.

        If the last matte round fits worse than the first, which had all light, the next recovery has all light again:
        notably worse, where the surfaces are not matte. There a full round follows, even if there are to be none.
        """
        if domain is None:
            return self._restart_with_all_light(number + 1)
        if number == self._matte - 1:
            explained = self._bases[0][_EXPLAINED][self.domain.solvable]
            matte = 1 - explained.mean(dtype=np.float64) <= _MOST_UNEXPLAINED
            if self._full == 0 and not matte:
                self._full = 1
                self._schedules = self._schedules_of(self.schedule)
                self._count()
            if self._errors[number] > (1.0 if matte else _WORSE) * self._errors[0]:
                return self._all_light()
        return domain

    def _schedules_of(self, schedule: Schedule) -> tuple[Schedule, ...]:
        """Return the schedule of each recovery."""
        single = schedule.without_rounds()
        last = warm_started(single) if self._warm and self._full else single
        all_of_them = (*(_of_colours(single),) * self._matte, *(single,) * self._full, last)
        return all_of_them if self._restarted is None else (*all_of_them[: self._restarted], single)

    def _mean_residual(self, maps: Maps) -> float:
        return float(present(maps.residual)[self.domain.solvable].mean(dtype=np.float64))

    def _basis(self, maps: Maps) -> Generator[None, None, dict[str, np.ndarray]]:
        """Yield often; return the live maps by name, and a mask of the texels at which they explain the photographs."""
        light, count = np.zeros(self.domain.shape), np.zeros(self.domain.shape)
        for layer in self._live.domain.stack.layers():
            counted = layer[..., 3] > 0
            light += counted * layer[..., :3].mean(axis=-1)
            count += counted
            yield
        explained = present(maps.residual) * np.maximum(count, 1) <= _MOST_RESIDUAL * light
        full = self._known_shape and not self._of_matte(self._at)
        values = self._stabilised(maps, explained) if full else maps.values
        return {**values, _EXPLAINED: (explained & ~self._dominated)[..., None].astype(np.float32)}

    def _stabilised(self, maps: Maps, explained: np.ndarray) -> dict[str, np.ndarray]:
        """Return the live maps; a weakly determined gloss is drawn to that of texels of similar colour.

        Subtracting light that was estimated from a wrong gloss would make the next round estimate more of that gloss.
        """
        values, solved = dict(maps.values), self.domain.solvable
        colour = next((values[p.name][solved] for p in self.model.parameters if p.is_albedo), None)
        if colour is None:
            return values
        held = held_names(self.schedule, self.model, self.fixed)
        for p in self.model.parameters:
            deviation = (maps.confidence or {}).get(p.name)
            if not (p.is_normal or p.is_albedo or p.name in held or deviation is None):
                values[p.name] = values[p.name].copy()
                own = values[p.name][solved], deviation[solved]
                values[p.name][solved] = shrunk_to_similar_colours(*own, colour, explained[solved])
        return values

    def _restart_with_all_light(self, last: int) -> Domain:
        """Make recovery ``last`` the final one, independent of all earlier ones; return its domain."""
        self._warm, self._restarted = False, last
        self._schedules = self._schedules_of(self.schedule)
        self._count()
        return self._all_light()

    def _all_light(self) -> Domain:
        """Forget what was subtracted; return the domain with all light."""
        self._samples, self._substitutes, self._foreign = None, {}, 0.0
        self._dominated = np.zeros(self.domain.shape, bool)
        self._set_share(np.zeros(self.domain.shape))
        return self.domain

    def _subtract_indirect(self) -> Generator[None, None, Domain | None]:
        """Yield often; return the domain minus the indirect light that its last maps predict.

        None if that light is negligible.
        """
        domain = self.domain
        first, relaxation = len(self._bases) == 1, 1.0 if self._known_shape else _RELAXATION
        with closing((yield from self._lighting(domain, self._bases[-1]))) as light:
            exchange, covered = light.exchange, light.covered
            self._foreign = float((exchange.share.sum(axis=-1) == 0)[domain.solvable[covered]].mean(dtype=np.float64))
            radiance, direct = yield from light.of_elements()
            strength = light.strength(radiance)
            self._strengths.append(strength)
            if strength * radiance.mean() < _LEAST_SHARE * light.shown.mean():
                if first:
                    self._set_share(np.zeros(domain.shape))
                return None
            indirect = light.samples(strength * radiance)
            before = None if self._known_shape else self._samples
            samples = self._samples = domain.stack.kept(DirectStack(domain.stack, indirect, before, relaxation))
            subtracted, shown = np.zeros((2, int(covered.sum())))
            for observation, layer in enumerate(domain.stack.layers()):
                light_of_texels = indirect.at(observation, *np.nonzero(covered))
                seen = layer[covered, 3] > 0
                subtracted += seen * light_of_texels.mean(axis=-1)
                shown += seen * layer[covered, :3].mean(axis=-1)
                yield
            share = np.zeros(domain.shape)
            share[covered] = np.divide(subtracted, shown, out=np.zeros_like(subtracted), where=shown > 0)
            self._set_share(share)
            if self._known_shape:
                counted = light.seen | ~light.seen.any(axis=0)  # all, for an element that no photograph shows
                own = (counted * direct).sum(axis=0, dtype=np.float64)
                others = strength * (counted * radiance.mean(axis=-1)).sum(axis=0, dtype=np.float64)
                part = others / np.maximum(others + own, 1e-12)
                self._dominated[covered] = exchange.at_texels(part[:, None])[:, 0] > MOST_INDIRECT
                self._dominated &= domain.solvable
                for name, value in light.materials.items():
                    self._substitutes[name] = np.zeros((*domain.shape, value.shape[-1]), np.float32)
                    self._substitutes[name][covered] = exchange.at_texels(value)
        return replace(domain, stack=samples)

    def _lighting(self, domain: Domain, basis: Mapping[str, np.ndarray]) -> Generator[None, None, IndirectLight]:
        """Yield often; return the estimator of the indirect light of a basis in the observations of a domain."""
        bounces, steps = self.schedule.interreflection.bounces, self._surroundings.steps(domain, basis)
        surface, exchange, values = yield from map_steps(steps, lambda part: None)
        known = domain.solvable & (values[_EXPLAINED][..., 0] > 0)
        return IndirectLight(surface, exchange, self.model, values, known, bounces)

    def _set_share(self, share: np.ndarray) -> None:
        """Store the indirect part (H, W) of the light of the photographs."""
        self._share = np.where(self.domain.solvable, np.minimum(share, 1), 0).astype(np.float32)
        self._mean_share = float(self._share[self.domain.solvable].mean())


def _of_colours(schedule: Schedule) -> Schedule:
    """Return the schedule of a matte round: robust least squares, as base colours are linear weights."""
    settings = {
        "prefit_iterations": 0, "refinement_iterations": _MATTE_STEPS, "refinement_starts": False,
        "refinement_rounds": 0, "materials_rounds": 0, "prior_rounds": 0, "surface_rounds": 0,
    }  # fmt: skip
    stages = tuple(replace(stage, iterations=0) for stage in schedule.stages)
    return replace(schedule.replaced(**settings), stages=stages)
