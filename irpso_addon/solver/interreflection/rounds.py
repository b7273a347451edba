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
from ...geometry.light.interreflection_geometry import InterreflectionGeometry
from ...geometry.samples import SampleStack
from ...gpu.kernel import EntryChoice
from ...reflectance.model import ReflectanceModel
from ...results.maps import Cause, Maps
from ..engine.engine import RecoveryEngine
from ..engine.recovery import Recovery
from ..engine.successive import Successive
from ..phases.phase import BAND_SECONDS
from ..planning.cost import works_of_rounds
from ..settings.resolve import unsearched_names
from ..settings.round_schedules import RoundSchedules, round_schedules
from ..settings.schedule import Schedule
from ..state.checkpoint import Checkpoint
from ..state.prepare import Prepared
from .corrected_stack import CorrectedStack
from .indirect_light import IndirectLight
from .shrinkage import shrunk_to_similar_colours

_RULES = 3  # raised where a run that resumes would decide otherwise about its rounds than it did
_AT = "interreflection"  # checkpoint array: the round, and the evaluations of the rounds before it
_ERRORS = "interreflection_errors"
_WELL_FITTED = "explained"  # among source maps: (H, W, 1), 1 where they fit the photographs; its name in checkpoints
_SOURCE_MAPS = "interreflection_of_{}_"  # prefix of the maps from which a round's light was estimated
# Relaxation factor of the subtracted light. Too bright an albedo gives too much of it, and then the next albedo is too
# dark: with 1 the rounds oscillate about the solution, with 0.75 two rounds reach it. With fixed normals the first
# estimate is closer, and the factor is 1.
_RELAXATION = 0.75
# Least residual of several matte rounds, over the mean light of the photographs: above it a full round follows. It is
# at most 0.034 in bodies of roughness 0.5 to 0.8, 0.07 to 0.13 in glazed and satin ones. In a glazed bowl that round
# takes the normals from 3.2 to 1.7°.
_MAX_MATTE_MISFIT = 0.05
# Part of the texels that the first matte round does not fit well: above it a full round follows. It is at most 0.015 in
# those bodies and 0.9 in metal paint, where that round takes the normals of a bowl from 7.2 to 0.9°.
_MAX_ILL_FITTED = 0.02
_ROUNDING = 1e-3  # of mean errors that are the same
# There, the last matte round may fit worse than the first by a factor: such fits say little. It is 1.03 and 1.05 in a
# coin and a bowl of metal paint, and their light helps the full round.
_WORSE = 1.25
_MAX_FOREIGN = 0.02  # part of the texels without an element; more are worth a warning
_MIN_SHARE = 0.003  # of the light of the photographs; with less there is no further round
_MAX_RESIDUAL = 0.5  # of a texel's light: above it the maps do not fit the photographs
# Indirect part of a texel's light. Above it, the direct rest is mostly the error of the indirect light: in a bowl of
# metal paint the normal error is 1.6° where the part is 0.5 to 0.7, and 20° where it is more than 0.9.
MAX_INDIRECT = 2 / 3


class InterreflectionRounds(Successive):
    """A ``RecoveryEngine`` that recovers a domain, then ``interreflection.rounds`` times without indirect light.

    After each recovery the indirect light that its maps predict (indirect_light.py) is subtracted from the photographs,
    and the domain is recovered again (Nayar, Ikeuchi & Kanade 1991). Where the shape is known, all recoveries but the
    last fix its normals: in a hollow of metal, indirect light biases estimated normals. The last one starts from the
    materials of the others. The first ``interreflection.matte_rounds`` recoveries find base colours alone, with all
    else at the model's defaults; where these do not fit the photographs, a full round follows in any case. If the last
    of them fits worse than the first, their light is not subtracted. Without notable indirect light the maps are those
    of a Recovery. Texels whose part of the surface has no element keep all light.

    geometry: builds the surface that sends the light. prepared: from ``prepare``, of the original photographs. solve:
    creates one recovery from the arguments of ``Recovery``: domain, model, schedule, seed, fixed, entry, prepared and
    guess. The others are as for Recovery.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        fixed: Mapping[str, np.ndarray] | None,
        entry: EntryChoice,
        geometry: InterreflectionGeometry,
        prepared: Prepared | None = None,
        solve: Callable[..., RecoveryEngine] = Recovery,
    ):
        self._rounds = round_schedules(schedule, model, fixed or {}, geometry.known_shape)
        super().__init__(domain, model, schedule, seed, fixed, entry, self._rounds.schedules(schedule))
        self._geometry, self._solve = geometry, solve
        self._everywhere = np.ones(domain.shape, bool)
        self._mostly_indirect = np.zeros(domain.shape, bool)  # texels whose light is mostly indirect
        self._substitutes: dict[str, np.ndarray] = {}  # maps for these texels
        self._samples: SampleStack | None = None  # without indirect light
        self._share: np.ndarray | None = None  # (H, W), indirect part of the photographed light, from the last round
        self._mean_share = 0.0  # over the texels
        self._foreign = 0.0  # part of the texels without an element
        self._brightness = 0.0  # mean light of the photographs
        self._errors: list[float] = []  # mean residuals at the ends of the rounds
        self._strengths: list[float] = []  # factors on each round's light
        self._source_maps: list[dict[str, np.ndarray]] = []  # from which each round's light was estimated
        self._count()
        self._live = self._begin(domain, prepared)

    def maps(self, confidence: bool = True) -> Maps:
        """Return the maps of the current recovery, as RecoveryEngine.maps.

        What a round holds fixed has the largest deviation. Where most light is indirect, the maps of the last recovery
        have the mesh's normals, the material of the nearest texels with direct light, and the largest deviations.
        """
        maps = self._live.maps(confidence)
        values, deviations = dict(maps.values), maps.confidence and dict(maps.confidence)
        unknown = {p.name: self.unknown_texels(p.name) for p in self.model.parameters}
        for p in self.model.parameters:
            for cause, mask in unknown[p.name].items():
                if deviations:
                    deviations[p.name] = np.where(mask[..., None], np.float32(p.width), deviations[p.name])
                if cause is Cause.MOSTLY_INDIRECT:
                    values[p.name] = np.where(mask[..., None], self._substitutes[p.name], values[p.name])
        return replace(maps, values=values, confidence=deviations, unknown_texels=unknown)

    @property
    def warnings(self) -> tuple[str, ...]:
        if self._rounds.normals_fixed_in(self._at):
            return (
                f"stopped in round {self._at + 1} of {len(self._schedules)} of interreflection: normals are recovered"
                " in the last, until then they are the mesh's own; resume to find them",
            )
        lines = []
        if self._foreign > _MAX_FOREIGN:
            lines.append(
                f"interreflection: {self._foreign:.0%} of the texels lie on islands of the UV map for which there are"
                " too few elements, and keep the light of the rest of the subject; raise interreflection_resolution,"
                " or unwrap the mesh into larger islands"
            )
        full = self._errors[self._rounds.matte :]
        if full and self.progress.done:
            last = self._mean_residual(self._live.maps(confidence=False))
            if self._samples is not None and last > (1 + _ROUNDING) * full[0]:
                setting = "rounds" if self.schedule.interreflection.rounds else "matte_rounds"
                lines.append(
                    "after subtracting the light that the subject throws on itself, the maps fit the photographs worse"
                    f" than before (mean error {last:.2g}, {full[0]:.2g}); set interreflection_{setting}=0"
                )
        return tuple(lines)

    def unknown_texels(self, name: str) -> dict[Cause, np.ndarray]:
        if name in self.fixed:
            return {}
        if name in self._rounds.fixed_in(self._at, self.model):
            return {Cause.LATER_ROUND: self._everywhere}
        last = not self._rounds.normals_fixed_in(self._at)
        return {Cause.MOSTLY_INDIRECT: self._mostly_indirect} if last and self._mostly_indirect.any() else {}

    @property
    def has_rounds(self) -> bool:
        return self._rounds.count > 1

    @property
    def findings(self) -> dict[str, Any]:
        rounds = {"rounds": len(self._strengths), "strength": self._strengths, "share": self._mean_share}
        unknown = {"unknown_texels": int(np.count_nonzero(self._mostly_indirect))}
        return {**self._live.findings, "interreflection": rounds | unknown}

    @property
    def identity(self) -> dict[str, Any]:
        return super().identity | self._geometry.identity | {"rules of interreflection": _RULES}

    def indirect(self, observation: int) -> np.ndarray | float:
        own = self._live.indirect(observation)
        if self._at == 0 or self._samples is None:
            return own
        return own + self.domain.stack.layer(observation)[..., :3] - self._samples.layer(observation)[..., :3]

    def indirect_in(self, domain: Domain) -> Generator[None, None, Callable[[int], np.ndarray | float]]:
        if self._at == 0 or self._samples is None:
            return lambda observation: 0.0
        number = self._at - 1  # the round whose light was subtracted before the current recovery
        light = yield from self._estimator(replace(domain, solvable=self.domain.solvable), self._source_maps[number])
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
        sources = {
            _SOURCE_MAPS.format(number) + name: value[solved]
            for number, maps in enumerate(self._source_maps)
            for name, value in maps.items()
        }
        own = {_AT: np.array([self._at, self._earlier_evaluations]), _ERRORS: np.array(self._errors)}
        return replace(state, arrays=state.arrays | own | sources)

    def restore(self, saved: Checkpoint) -> None:
        self.close()
        self._mostly_indirect, self._substitutes = np.zeros(self.domain.shape, bool), {}
        self._rounds = round_schedules(self.schedule, self.model, self.fixed, self._geometry.known_shape)
        self._schedules = self._rounds.schedules(self.schedule)
        self._at, self._earlier_evaluations = (int(number) for number in saved.arrays[_AT])
        self._errors = saved.arrays[_ERRORS].tolist()[: self._at]  # without that of a round whose light is not known
        self._share, self._mean_share = None, 0.0
        self._source_maps, self._strengths, domain = [], [], self.domain
        for number in range(self._at):
            sizes = {p.name: p.components for p in self.model.parameters} | {_WELL_FITTED: 1}
            self._source_maps.append({name: np.zeros((*domain.shape, n), np.float32) for name, n in sizes.items()})
            for name, value in self._source_maps[-1].items():
                value[domain.solvable] = saved.arrays[_SOURCE_MAPS.format(number) + name]
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
        return self._reconfigured(schedule, self._rounds.schedules(schedule), seed)

    def _texels(self, number: int) -> int:
        return int(np.count_nonzero(self.domain.solvable))

    @property
    def _cost_of_all(self) -> float:
        """With the full round that may follow, until that is decided: the fraction never steps back."""
        return self._longest_cost if self._at < self._rounds.matte else super()._cost_of_all

    def _count(self) -> None:
        super()._count()
        rounds = self._rounds.longest, self.schedule, self.model, set(self.fixed), self.domain.observations
        self._longest_cost = sum(work * self._texels(0) for work in works_of_rounds(*rounds))

    def _title_suffix(self, number: int) -> str:
        return f", round {number} of interreflection" if number else ""

    def _fixed_in(self, number: int) -> Mapping[str, np.ndarray]:
        return self._rounds.fixed_in(number, self.model) | dict(self.fixed)

    def _begin(self, domain: Domain, prepared: Prepared | None = None) -> RecoveryEngine:
        schedule = self._schedules[self._at]
        begin: dict[str, Any] = {"prepared": prepared} if prepared else {}
        if schedule.swarm.start == "given" and self._source_maps:
            begin["guess"] = {p.name: self._source_maps[-1][p.name] for p in self.model.parameters}
        fixed = self._fixed_in(self._at)
        return self._solve(domain, self.model, schedule, self.seed, fixed, self.entry, **begin)

    def _next(self) -> Iterator[None]:
        while self._rounds.fixes_normals and not self._live.refresh_confidence(BAND_SECONDS):
            yield
        maps = self._live.maps(confidence=self._rounds.fixes_normals)
        self._source_maps.append((yield from self._source_maps_of(maps)))
        self._errors.append(self._mean_residual(maps))
        domain = yield from self._subtract_indirect()
        if domain is None and not self._rounds.normals_fixed_in(self._at):
            self._set_rounds(replace(self._rounds, end=self._at))
            return
        domain = self._after_round(self._at, domain)
        prepared = yield from self._live.preparation(domain, self._schedules[self._at + 1])
        self._earlier_evaluations += self._live.progress.evaluations
        self._live.close()
        self._at += 1
        self._live = self._begin(domain, prepared)

    def _after_round(self, number: int, domain: Domain | None) -> Domain:
        """Return the domain of the recovery after ``number``. domain: without indirect light, None if it has none.

        Where the surfaces are not matte, a full round follows the last matte one, even if there are to be none. If the
        last matte round fits worse than the first, which had all light, the next recovery has all light again.
        """
        if domain is None:
            self._set_rounds(replace(self._rounds, end=number + 1))
            return self._all_light()
        if number == self._rounds.matte - 1:
            well_fitted = self._source_maps[0][_WELL_FITTED][self.domain.solvable]
            ill_fitted = 1 - well_fitted.mean(dtype=np.float64) > _MAX_ILL_FITTED
            first, last = self._errors[0], self._errors[number]
            glossy = number > 0 and min(first, last) > _MAX_MATTE_MISFIT * self._brightness
            if self._rounds.full == 0 and (ill_fitted or glossy):
                self._set_rounds(replace(self._rounds, full=1))
            if last > (_WORSE if ill_fitted else 1.0) * first:
                return self._all_light()
        return domain

    def _set_rounds(self, rounds: RoundSchedules) -> None:
        """Change the rounds that are still to come."""
        self._rounds = rounds
        self._schedules = self._rounds.schedules(self.schedule)
        self._count()

    def _mean_residual(self, maps: Maps) -> float:
        return float(present(maps.residual)[self.domain.solvable].mean(dtype=np.float64))

    def _source_maps_of(self, maps: Maps) -> Generator[None, None, dict[str, np.ndarray]]:
        """Yield often; return the live maps by name, and a mask of the texels at which they fit the photographs."""
        light, count = np.zeros(self.domain.shape), np.zeros(self.domain.shape)
        for layer in self._live.domain.stack.layers():
            counted = layer[..., 3] > 0
            light += counted * layer[..., :3].mean(axis=-1)
            count += counted
            yield
        well_fitted = present(maps.residual) * np.maximum(count, 1) <= _MAX_RESIDUAL * light
        full = self._rounds.fixes_normals and not self._rounds.is_matte(self._at)
        values = self._shrunk(maps, well_fitted) if full else maps.values
        return {**values, _WELL_FITTED: (well_fitted & ~self._mostly_indirect)[..., None].astype(np.float32)}

    def _shrunk(self, maps: Maps, well_fitted: np.ndarray) -> dict[str, np.ndarray]:
        """Return the live maps; a weakly determined gloss is drawn to that of texels of similar colour.

        Subtracting light that was estimated from a wrong gloss would make the next round estimate more of that gloss.
        """
        values, solved = dict(maps.values), self.domain.solvable
        colour = next((values[p.name][solved] for p in self.model.parameters if p.is_albedo), None)
        if colour is None:
            return values
        unsearched = unsearched_names(self.schedule, self.model, self.fixed)
        for p in self.model.parameters:
            deviation = (maps.confidence or {}).get(p.name)
            if not (p.is_normal or p.is_albedo or p.name in unsearched or deviation is None):
                values[p.name] = values[p.name].copy()
                own = values[p.name][solved], deviation[solved]
                values[p.name][solved] = shrunk_to_similar_colours(*own, colour, well_fitted[solved])
        return values

    def _all_light(self) -> Domain:
        """Forget what was subtracted; return the domain with all light."""
        self._samples, self._substitutes, self._foreign = None, {}, 0.0
        self._mostly_indirect = np.zeros(self.domain.shape, bool)
        self._set_share(np.zeros(self.domain.shape))
        return self.domain

    def _subtract_indirect(self) -> Generator[None, None, Domain | None]:
        """Yield often; return the domain minus the indirect light that its last maps predict.

        None if that light is negligible.
        """
        domain = self.domain
        first, relaxation = len(self._source_maps) == 1, 1.0 if self._rounds.fixes_normals else _RELAXATION
        with closing((yield from self._estimator(domain, self._source_maps[-1]))) as light:
            transport, covered = light.transport, light.covered
            self._foreign = float((transport.share.sum(axis=-1) == 0)[domain.solvable[covered]].mean(dtype=np.float64))
            radiance, direct = yield from light.of_elements()
            strength = light.strength(radiance)
            self._strengths.append(strength)
            if strength * radiance.mean() < _MIN_SHARE * light.shown.mean():
                if first:
                    self._set_share(np.zeros(domain.shape))
                return None
            indirect = light.samples(strength * radiance)
            before = None if self._rounds.fixes_normals else self._samples
            samples = self._samples = domain.stack.kept(CorrectedStack(domain.stack, indirect, before, relaxation))
            subtracted, shown, lit = np.zeros((3, int(covered.sum())))
            for observation, layer in enumerate(domain.stack.layers()):
                light_of_texels = indirect.at(observation, *np.nonzero(covered))
                seen = layer[covered, 3] > 0
                subtracted += seen * light_of_texels.mean(axis=-1)
                shown += seen * layer[covered, :3].mean(axis=-1)
                lit += seen
                yield
            self._brightness = float(shown.sum() / max(lit.sum(), 1))
            share = np.zeros(domain.shape)
            share[covered] = np.divide(subtracted, shown, out=np.zeros_like(subtracted), where=shown > 0)
            self._set_share(share)
            if self._rounds.fixes_normals:
                self._find_mostly_indirect(light, strength, radiance, direct)
        return replace(domain, stack=samples)

    def _find_mostly_indirect(
        self, light: IndirectLight, strength: float, radiance: np.ndarray, direct: np.ndarray
    ) -> None:
        """Store which texels have mostly indirect light, and their substitutes.

        strength: the factor on radiance. radiance, direct: (K, E, 3) and (K, E), from ``IndirectLight.of_elements``.
        """
        covered, transport = light.covered, light.transport
        counted = light.seen | ~light.seen.any(axis=0)  # all, for an element that no photograph shows
        own = (counted * direct).sum(axis=0, dtype=np.float64)
        others = strength * (counted * radiance.mean(axis=-1)).sum(axis=0, dtype=np.float64)
        part = others / np.maximum(others + own, 1e-12)
        found = np.zeros(self.domain.shape, bool)
        found[covered] = transport.at_texels(part[:, None])[:, 0] > MAX_INDIRECT
        self._mostly_indirect = found & self.domain.solvable
        for name, value in light.materials.items():
            self._substitutes[name] = np.zeros((*self.domain.shape, value.shape[-1]), np.float32)
            self._substitutes[name][covered] = transport.at_texels(value)

    def _estimator(self, domain: Domain, source_maps: Mapping[str, np.ndarray]) -> Generator[None, None, IndirectLight]:
        """Yield often; return the estimator of the indirect light of maps in the observations of a domain."""
        bounces, steps = self.schedule.interreflection.bounces, self._geometry.steps(domain, source_maps)
        surface = yield from map_steps(steps, lambda part: None)
        known = domain.solvable & (surface.values[_WELL_FITTED][..., 0] > 0)
        shape = surface.domain, surface.transport, self.model
        return IndirectLight(*shape, surface.values, known, bounces, surface.shadowed)

    def _set_share(self, share: np.ndarray) -> None:
        """Store the indirect part (H, W) of the light of the photographs."""
        self._share = np.where(self.domain.solvable, np.minimum(share, 1), 0).astype(np.float32)
        self._mean_share = float(self._share[self.domain.solvable].mean())
