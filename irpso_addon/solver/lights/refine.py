"""Estimation of uncertain lights: intensities up to one scale, and small errors of direction or position."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from ...core.errors import InputError
from ...core.steps import blocking, map_steps
from ...geometry.domain import Domain, subset, with_lights, with_samples
from ...gpu.kernel import EntryChoice
from ...gpu.program import ProgramCache
from ...reflectance.model import ReflectanceModel
from ..engine.recovery import Recovery
from ..settings.schedule import Schedule
from ..state.prepare import lambert_fit, texel_scale
from .contradiction import can_tell, contradicted, rms
from .fit import GAINS, MOVES, LightStep, Moving, axes_of, brightened, light_step
from .light_texels import LightTexels, draw_texels, fixed_at, texel_schedule
from .semi_calibrated import normalised

MAX_DEGREES = 20.0  # of a refinement: larger errors need a calibration
_ROUNDS = 12
_SETTLED = 1e-3  # RMS change (relative intensities, radians of directions) of the last round
# δ of the fitness in the first rounds: with a narrow δ a wrong light is an outlier and stays wrong. On a relief of 3°
# under 20 lights with 44 % initial error, eight rounds end at 0.2 % with these widths, and at 8.8 % without.
_WIDTHS = (0.2, 0.1, 0.05)
_SLICE_SECONDS = 0.02
_BRIGHT = 95.0  # percentile of the albedos; a common factor lowers it to _WHITE where it exceeds 1
_WHITE = 0.9
_DETERMINED = 0.01  # least LightStep.determined; below it a linear trend of the intensities is undetermined
_MIN_FREE_LIGHTS = 4  # a Lambertian texel has three unknowns, which fit any three photographs

Intensities = Literal["auto", "given", "estimate"]


@dataclass(frozen=True)
class Lights:
    """Estimated lights. lights: (K, 4) and intensities: (K, 3), for a Domain.

    factors: (K, 3) on the given intensities. deviations: (K, 3) relative standard deviations of the intensities from
    the scatter between texels, without model error. turned: (K,) degrees between the given and the estimated light, as
    seen from the centre of the texels. determined: see LightStep. rounds: recoveries of the texels. change: RMS change
    in the last round. rotation: as in LightStep.
    """

    lights: np.ndarray
    intensities: np.ndarray
    factors: np.ndarray
    deviations: np.ndarray
    turned: np.ndarray
    determined: float
    rounds: int
    change: float
    rotation: np.ndarray

    @property
    def scaled(self) -> bool:
        """Whether any intensity differs from the given one."""
        return bool((self.factors != 1).any())

    def applied(self, domain: Domain) -> Domain:
        """Return the domain with these lights."""
        return with_lights(domain, self.lights, self.intensities)

    def summary(self) -> str:
        """Return one line about the difference from the given lights."""
        parts = []
        if self.scaled:
            low, high = self.factors.mean(axis=-1).min(), self.factors.mean(axis=-1).max()
            parts.append(f"{low:.2g} to {high:.2g} × as given")
        if self.turned.any():
            parts.append(f"turned by {self.turned.mean():.1f}°")
        return ", ".join(parts) or "as given"

    def report(self, numbers: Sequence[int] | None = None) -> dict[str, Any]:
        """Return a table for the report, as plain data. numbers: of the lights, in the order of the report."""
        order = np.argsort(numbers) if numbers is not None else slice(None)
        return {
            "intensities": np.round(self.intensities, 6)[order].tolist(),
            "relative_deviation": np.round(self.deviations, 6)[order].tolist(),
            "lights": np.round(self.lights, 6)[order].tolist(),
            "turned_degrees": np.round(self.turned, 4)[order].tolist(),
            "rounds": self.rounds,
            "last_change": round(self.change, 6),
        }

    def warnings(self, requested: bool = True) -> list[str]:
        """Return one line per warning. requested: whether the user requested intensities."""
        lines = []
        if not requested and self.scaled:
            lines.append(
                "the images contradict the lights' intensities, all given as 1, so they were estimated:"
                f" {self.summary()}; --intensities given (Light Strengths) keeps them"
            )
        if self.scaled and self.determined < _DETERMINED:
            lines.append(
                "the surface is nearly flat: the lights' intensities may have a linear trend from side to side;"
                " photograph a grey card or a matte ball beside it"
            )
        if self.change > 10 * _SETTLED:
            lines.append(
                f"the lights did not converge in {self.rounds} rounds: the last changed them by {self.change:.1%}"
            )
        return lines


def light_steps(
    domain: Domain,
    model: ReflectanceModel,
    schedule: Schedule | None = None,
    seed: int = 0,
    fixed: Mapping[str, np.ndarray] = MappingProxyType({}),
    *,
    intensities: bool = True,
    refine_degrees: float = 0.0,
    fitted: Sequence[int] | None = None,
    entry: EntryChoice = "auto",
    texels: LightTexels | None = None,
) -> Generator[float, None, Lights]:
    """Return the lights that best explain about a thousand texels of a domain.

    The start is semi-calibrated photometric stereo (Cho et al. 2016). Then recoveries of the texels and Gauss–Newton
    steps of the lights alternate until both converge. Images determine intensities up to one scale per channel: the
    mean logarithm stays as given, except for a common factor where the surface would be brighter than white.
    schedule: of the texels' recovery, ``standard`` by default, without spatial phases. fixed: as for a Recovery.
    intensities: estimate them, each channel by itself. refine_degrees: standard deviation of the error of the given
    directions (for near lights as seen from the texels), 0…20; 0 keeps them. fitted: the observations in the fit, all
    by default; the others get the intensity that matches their own image. texels: from ``draw_texels`` with the same
    seed and observations, drawn here by default. Yields the fraction done, 0…1. Raises InputError; otherwise like a
    Recovery.
    """
    check(intensities, refine_degrees)
    chosen = _indices(domain, fitted)
    texels = texels or draw_texels(domain, seed, chosen)
    if not len(texels.rows):
        raise InputError(
            "no texel is lit by three observations, so the lights are not determined; give the intensities"
        )
    if not any(p.is_normal and p.name in fixed for p in model.parameters):
        _check_count(domain.lights[chosen])
    search = _Search(
        texels, model, texel_schedule(schedule), seed, fixed_at(fixed, texels), chosen, intensities,
        np.radians(refine_degrees), entry,
    )  # fmt: skip
    step = yield from search.rounds()
    return search.result(domain, step)


def _check_count(lights: np.ndarray) -> None:
    """Raise InputError for fewer different lights (K, 4) than free normals and albedos leave anything to find in."""
    count = len(np.unique(np.round(lights, 4), axis=0))
    if count < _MIN_FREE_LIGHTS:
        raise InputError(
            f"{count} different lights do not determine their intensities or directions, as every texel fits any; keep"
            f" the given ones, take {_MIN_FREE_LIGHTS} photographs or more, or fix the normals"
        )


estimate_lights = blocking("estimate_lights", light_steps)


def chosen_steps(
    domain: Domain,
    model: ReflectanceModel,
    seed: int = 0,
    fixed: Mapping[str, np.ndarray] = MappingProxyType({}),
    *,
    intensities: Intensities = "auto",
    refine_degrees: float = 0.0,
    fitted: Sequence[int] | None = None,
    entry: EntryChoice = "auto",
    texels: LightTexels | None = None,
) -> Generator[float, None, Lights | None]:
    """Yield the fraction done, 0…1; return the estimated lights, or None if the given ones stay.

    intensities: "given", "estimate", or "auto": estimated if all are given as 1, the images contradict that, and the
    lights determine them. The others: as for ``light_steps``.
    """
    chosen = _indices(domain, fitted)

    def search(wanted: bool) -> Generator[float, None, Lights]:
        return light_steps(
            domain, model, None, seed, fixed, intensities=wanted, refine_degrees=refine_degrees, fitted=fitted,
            entry=entry, texels=texels,
        )  # fmt: skip

    if intensities == "auto" and can_tell(domain, chosen):
        texels = texels or draw_texels(domain, seed, chosen)
        if (yield from contradicted(domain, model, seed, fixed, chosen, entry, texels)):
            lights = yield from search(True)
            if lights.determined >= _DETERMINED:
                return lights
    if intensities != "estimate" and refine_degrees == 0:
        return None
    return (yield from search(intensities == "estimate"))


def check(intensities: bool, refine_degrees: float) -> None:
    """Raise InputError where nothing is to be estimated, or the angle is out of range."""
    if not 0 <= refine_degrees <= MAX_DEGREES:
        raise InputError(
            f"--refine-directions {refine_degrees:g}: give the directions' typical error in degrees, 0 to"
            f" {MAX_DEGREES:g}"
        )
    if not intensities and refine_degrees == 0:
        raise InputError("lights: choose what to estimate, intensities or directions; neither is chosen")


class _Search:
    """Alternation of texel recoveries and light steps. factors: on the intensities of the fitted observations."""

    def __init__(
        self,
        texels: LightTexels,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        fixed: Mapping[str, np.ndarray],
        fitted: np.ndarray,
        intensities: bool,
        sigma: float,
        entry: EntryChoice,
    ):
        self._texels, self._model, self._schedule, self._seed, self._fixed = texels, model, schedule, seed, fixed
        self._fitted, self._intensities, self._entry = fitted, intensities, entry
        self._base = subset(texels.domain, fitted)
        self._moving = None
        if sigma > 0:
            self._moving = Moving(self._base.lights, axes_of(self._base), np.zeros((len(fitted), MOVES)), sigma)
        self._factors = texels.factors if intensities else np.ones((len(fitted), GAINS))
        if intensities:
            self._factors = self._factors * _white_factor(_with_divided_images(self._base, self._factors))
        self._change, self._round = np.inf, 0
        self._values: dict[str, np.ndarray] = {}
        self._programs = ProgramCache()  # for all rounds

    def rounds(self) -> Generator[float, None, LightStep]:
        """Run all rounds; yield the fraction done, and return the last step."""
        while True:
            width = _WIDTHS[self._round] if self._round < len(_WIDTHS) else 0.0
            schedule = self._schedule.replaced(delta=max(self._schedule.fitness.delta, width))
            self._round += 1
            # Divide images instead of multiplying lights: dim images then have the weight of bright ones.
            domain = _with_divided_images(self._base, self._factors)
            if self._moving is not None:
                domain = with_lights(domain, self._moving.lights(), domain.intensities)
            self._values = yield from self._solved(domain, schedule)
            scale = texel_scale(domain, schedule.fitness.scale_percentile)
            stepping = light_step(
                domain, self._model, self._values, frozenset(self._fixed), scale, schedule.fitness, self._intensities,
                self._moving,
            )  # fmt: skip
            step = yield from map_steps(stepping, lambda _: self._fraction(0.9))
            common = float(np.exp(np.log(self._factors).mean()))
            if self._intensities:
                self._factors = normalised(self._factors * np.exp(step.gains)) * common
            if self._moving is not None:
                self._moving = replace(self._moving, moves=self._moving.moves + step.moves)
            self._change = max(rms(step.gains), rms(step.moves))
            if self._round == _ROUNDS or (self._round >= len(_WIDTHS) and self._change <= _SETTLED):
                return step

    def result(self, domain: Domain, step: LightStep) -> Lights:
        """Return the lights of a domain after the last step, including those outside the fit."""
        count = domain.observations
        lights, factors = domain.lights.copy(), np.ones((count, GAINS))
        deviations, turned = np.zeros((count, GAINS)), np.zeros(count)
        if self._moving is not None:
            lights[self._fitted] = self._moving.lights()
            turned[self._fitted] = np.degrees(np.linalg.norm(self._moving.moves[:, :2], axis=-1))
        factors[self._fitted], deviations[self._fitted] = self._factors, step.deviations
        if self._intensities and len(self._fitted) < count:
            others = np.setdiff1d(np.arange(count), self._fitted)
            factors[others] = brightened(subset(self._texels.domain, others), self._model, self._values)
        return Lights(
            lights, (domain.intensities * factors).astype(np.float32), factors, deviations, turned, step.determined,
            self._round, self._change, step.rotation,
        )  # fmt: skip

    def _solved(self, domain: Domain, schedule: Schedule) -> Generator[float, None, dict[str, np.ndarray]]:
        with Recovery(domain, self._model, schedule, self._seed, self._fixed, self._entry) as recovery:
            while not (progress := recovery.step(time_budget_s=_SLICE_SECONDS)).done:
                yield self._fraction(0.7 * progress.fraction)
            return recovery.maps(confidence=False).values

    def _fraction(self, part: float) -> float:
        """Return the fraction done: after three rounds each usually takes half of the rest."""
        rounds = self._round - 1 + part
        return rounds / 6 if rounds < 3 else 1 - 0.5 ** (rounds - 2)


def _indices(domain: Domain, fitted: Sequence[int] | None) -> np.ndarray:
    return np.arange(domain.observations) if fitted is None else np.asarray(fitted, np.intp)


def _with_divided_images(domain: Domain, factors: np.ndarray) -> Domain:
    """Return the domain with its images divided by (K, 3) factors."""
    divisors = np.concatenate([factors, np.ones((len(factors), 1))], axis=1)[:, None, None]
    return with_samples(domain, (np.stack([*domain.stack.layers()]) / divisors).astype(np.float32))


def _white_factor(domain: Domain) -> float:
    """Return a common factor on the intensities with which nearly all of the surface is darker than white."""
    albedo = lambert_fit(domain)[1][domain.solvable]
    bright = float(np.percentile(albedo.max(axis=-1), _BRIGHT)) if len(albedo) else 0.0
    return bright / _WHITE if bright > 1 else 1.0
