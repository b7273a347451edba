"""Given intensities against the photographs: whether these contradict them, and whether they determine others."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import replace

import numpy as np

from ...capture.light_geometry import NARROW, flatness
from ...core.errors import InputError
from ...core.steps import run_steps
from ...geometry.domain import Domain, subset
from ...gpu.kernel import EntryChoice
from ...reflectance.model import ReflectanceModel
from ..engine.recovery import Recovery
from ..settings.schedule import load_schedule
from ..state.prepare import texel_scale
from .fit import LightStep, light_step
from .light_texels import LightTexels, draw_texels, fixed_at, texel_schedule

_SMALL = 256  # texels of the check
_SLICE_SECONDS = 0.02
_DELTA = 0.1  # of the fitness
_CONTRADICTED = 0.1  # least RMS error of the intensities that is reported
# Least fraction of the error that other intensities explain: 0.66 to 0.81 where they vary by 10 to 50 %, 0.48 for a
# matte model on a glossy surface, 0.01 for correct intensities.
_EXPLAINED = 0.6
_MIN_LIGHTS = 8  # least number for an estimate of intensities


def can_tell(domain: Domain, fitted: np.ndarray | None = None) -> bool:
    """Return whether images determine the intensities, all given as 1: there are many, widely spread lights.

    Under lights that lie close together a model error looks like other intensities, which turn normals: with twelve
    photographs of a ball under lights within 22°, errors rise from 6.2 to 7.2°. fitted: the observations in the fit.
    """
    lights = domain.lights if fitted is None else domain.lights[fitted]
    if not (domain.intensities == 1).all() or len(lights) < _MIN_LIGHTS:
        return False
    middle = domain.bake.position[domain.bake.coverage].mean(axis=0, dtype=np.float64)
    toward = lights[:, :3] - np.where(lights[:, 3:] > 0, middle, 0.0)
    return flatness(toward / np.linalg.norm(toward, axis=-1, keepdims=True)) >= NARROW


def contradicted(
    domain: Domain,
    model: ReflectanceModel,
    seed: int,
    fixed: Mapping[str, np.ndarray],
    fitted: np.ndarray,
    entry: EntryChoice,
    texels: LightTexels,
) -> Generator[float, None, bool]:
    """Yield while some texels are recovered under the given lights; return whether the images contradict the lights.

    No recovery runs where the first estimate, for matt texels, is near the given intensities.
    """
    if not len(texels.rows) or rms(np.log(texels.factors)) < _CONTRADICTED:
        return False
    few = draw_texels(domain, seed, fitted, _SMALL)
    part, fixed_values = subset(few.domain, fitted), fixed_at(fixed, few)
    with Recovery(part, model, texel_schedule(), seed, fixed_values, entry) as recovery:
        while not recovery.step(time_budget_s=_SLICE_SECONDS).done:
            yield 0.0
        values = recovery.maps(confidence=False).values
    return _disagreement(part, model, values, frozenset(fixed)) is not None


def contradiction(
    domain: Domain, model: ReflectanceModel, values: Mapping[str, np.ndarray], fixed: frozenset[str], seed: int = 0
) -> str:
    """Return a warning if recovered maps contradict the given intensities, else "".

    values: parameter name → (H, W, components) of the whole domain.
    """
    texels = draw_texels(domain, seed, np.arange(domain.observations), _SMALL)
    if not len(texels.rows):
        return ""
    there = {name: texels.part(value) for name, value in values.items()}
    try:
        step = _disagreement(texels.domain, model, there, fixed)
    except InputError as error:  # a model of the user's that is not finite: the maps are made all the same
        return str(error)
    if step is None:
        return ""
    remedy = (
        "estimate them with --intensities estimate"
        if can_tell(domain)
        else "they are too few or too close together to be found from the images"
    )
    return (
        "the images contradict the lights' intensities, all given as 1: they differ by about"
        f" {rms(step.gains):.0%} from light to light; give them, or {remedy}"
    )


def _disagreement(
    domain: Domain, model: ReflectanceModel, values: Mapping[str, np.ndarray], fixed: frozenset[str]
) -> LightStep | None:
    """Return the step to better intensities; None if the recovered texels do not support one."""
    fitness = load_schedule("standard").fitness
    scale = texel_scale(domain, fitness.scale_percentile)
    fitness = replace(fitness, delta=_DELTA)
    step = run_steps(light_step(domain, model, values, fixed, scale, fitness, True, None))
    return step if rms(step.gains) >= _CONTRADICTED and step.explained >= _EXPLAINED else None


def rms(changes: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt((changes**2).mean()))
