"""The prefit: normals found with a model of few assumptions, before the surface's own model is asked."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from copy import copy
from typing import Any

import numpy as np

from ...capture.inspect.checks import NARROW, flatness
from ...core.paths import SHADERS
from ...core.steps import run_steps
from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.passes import Entry, Kernel, Output, Pass
from ...reflectance.model import ReflectanceModel
from ..kernels import kernels
from ..kernels.free_parameters import build_free_parameters
from ..kernels.refinement import NO_PENALTY
from ..settings.resolve import ResolvedPrefit, prefit_model
from ..settings.schedule import Schedule
from ..state.textures import DomainTextures, Estimates, loss_constants
from .phase import BACKGROUND_BAND_SECONDS, Phase
from .refinement import RefinementPhase
from .synchronous_swarm import SynchronousSwarmPhase

# With fewer samples for each of its unknowns the prefit is no acceptance test. Under 16 near lamps it would turn the
# normals of metals by noise alone (metallic of a gilding 0.056 for 0.042); hollows of bunny_specular that few of its 50
# lights reach go from 0.82 to 0.69° of mean error.
_SAMPLES_PER_UNKNOWN = 3
_ACCEPTANCE_FLOOR = 0.005  # under such a mean of bounded losses a fit is as good as the pictures
_PENALTY = SHADERS / "prefit" / "falloff_penalty.glsl"
# Of the prior on the exponent, whose mean is 1, under narrow lights. On balls under 12 lights within 22° it takes the
# mean error from 0.66 to 0.36° (Lambert) and from 3.95 to 2.95° (Oren–Nayar, σ = 0.2); wide lights tell the exponent,
# and the prior would cost 0.08° on bunny_lambert.
_FALLOFF_DEVIATION = 0.15


class PrefitPhase(Phase):
    """The prefit under way, a Phase: swarms, then Levenberg–Marquardt, on grey samples with the prefit's own model.

    What it resolves are the estimates of the recovery's model, with the prefit's normals put in.
    """

    title = ResolvedPrefit.title

    def __init__(
        self,
        resolved: ResolvedPrefit,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        domain: DomainTextures,
        estimates: Estimates,
        entry: Entry,
    ):
        self._resolved, self._schedule, self._seed, self._entry = resolved, schedule, seed, entry
        self._domain, self._estimates = grey(domain, schedule), estimates
        self._model = prefit_model()
        self._domain.defines |= {
            "FALLOFF_COMPONENT": self._model.offset("falloff"), "FALLOFF_DEVIATION": f"{_FALLOFF_DEVIATION:.9f}",
        }  # fmt: skip
        self._own = _begun(self._model, model, estimates, domain)
        self._adopt = _adopt_pass(model, domain.defines)
        self._measure = _measure_pass(self._model, schedule, self._domain.defines)
        self._refining = False
        if schedule.swarm.seed == "given":  # a first guess tells the normal, but nothing of the prefit's own model
            schedule = schedule.replaced(seed="lambert")
        self._inner: Phase = SynchronousSwarmPhase(
            resolved.stage, self._model, schedule, seed, self._domain, self._own, entry
        )
        self.iterations = resolved.iterations

    @property
    def iteration(self) -> int:
        """How many iterations were made, those of the refinement on top of the swarms'."""
        return self._inner.iteration + (self._resolved.stage.iterations if self._refining else 0)

    @property
    def done(self) -> bool:
        """Whether all iterations have been made."""
        return self.iteration >= self.iterations

    @property
    def evaluations(self) -> int:
        """Renders of all observations that the next iteration makes at a texel."""
        return self._inner.evaluations

    @property
    def reach(self) -> int:
        """How many texels away the next iteration reads what others have found."""
        return self._inner.reach

    @property
    def placed(self) -> bool:
        """Whether the particles have been placed."""
        return self._refining or self._inner.placed

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each. Counts up when it is whole."""
        yield from self._inner.advance(bands, seconds)
        if self._inner.done and not self._refining:
            yield from self._inner.conclude(bands, seconds)
            self._own.accept()
            self._begin_refinement()

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put the normals that have been found so far into the resolved estimates."""
        yield from self._inner.conclude(bands, seconds)
        own, targets = self._own.resolved, self._estimates.resolved
        yield from bands.once(lambda: self._take_over(own, targets), lambda: self._adopt.fence(targets))

    def preview(self, targets: list[Any]) -> None:
        """Put the normals that have been found so far into other textures."""
        own = self._own.shown if self._inner.placed else self._own.current
        if self._inner.placed:
            self._inner.preview(own)
        self._take_over(own, targets)

    def _take_over(self, own: list[Any], targets: list[Any]) -> None:
        prefit = {f"u_prefit_{i}": texture for i, texture in enumerate(own)}
        self._adopt.run(targets, {**self._estimates.bindings(), **self._domain.textures, **prefit})

    def reached(self, threshold: float) -> bool:
        """Return False: a prefit's fitness says nothing of the recovery's threshold."""
        return False

    def measuring(self, bands: Bands, seconds: float) -> Generator[None, None, np.ndarray]:
        """Return (h, w) float32, packed as the domain's textures: how well the prefit's model fits what is resolved.

        In bands; yields after each.
        """
        targets = [textures.empty(*self._own.size, "R32F")]
        inputs = {**self._own.bindings(resolved=True), **self._domain.textures}
        constants = _acceptance_constants(self._domain, self._schedule)
        yield from self._measure.in_bands("measure", bands, seconds, targets, inputs, constants)
        return textures.download(targets[0])[..., 0]

    def fitness(self) -> np.ndarray:
        """Return what ``measuring`` does, of what has been found so far, at once."""
        self._inner.resolve()
        return run_steps(self.measuring(Bands(), BACKGROUND_BAND_SECONDS))

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: what neighbours read of each texel; NaN where none is solved."""
        return self._inner.halo()

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n), and (M, n), for the texels that belong to other tiles; others are left alone."""
        self._inner.take_halo(values, ghosts)

    def state(self) -> dict[str, np.ndarray]:
        """Return all that outlives an iteration."""
        own = {f"own_{i}": textures.download(texture) for i, texture in enumerate(self._own.current)}
        return {**self._inner.state(), **own}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Go on from what ``state`` returned at an iteration."""
        self._own.current = [textures.upload(arrays[f"own_{i}"]) for i in range(self._own.count)]
        swarm = self._resolved.stage.iterations
        if iteration >= swarm and not self._refining:
            self._begin_refinement()
        self._inner.restore(arrays, iteration - (swarm if self._refining else 0))

    def close(self) -> None:
        """Free shaders and textures."""
        self._inner.close()
        self._adopt.close()
        self._measure.close()
        self._own = None

    def _begin_refinement(self) -> None:
        self._inner.close()
        self._inner = RefinementPhase(
            self._resolved.refinement, self._model, self._schedule, self._domain, self._own, self._entry,
            penalty=_PENALTY if _narrow(self._domain.domain.lights) else NO_PENALTY,
        )  # fmt: skip
        self._refining = True


class AcceptanceTest:
    """Decides at every texel whether the refinement of the recovery's model may turn the prefit's normal.

    fitness: (h, w) the prefit's own, packed. It swaps what it decides into the resolved estimates.
    """

    def __init__(
        self,
        model: ReflectanceModel,
        schedule: Schedule,
        domain: DomainTextures,
        estimates: Estimates,
        fitness: np.ndarray,
    ):
        self._domain, self._estimates = grey(domain, schedule), estimates
        self._fitness = textures.upload(fitness)
        self._schedule = schedule
        self._decided = [textures.empty(*estimates.size) for _ in range(estimates.count)]
        self._pass = _acceptance_pass(model, schedule, self._domain.defines)

    def deciding(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put into the resolved estimates what is to be believed of them, in bands; the last one makes it so."""
        work = {f"u_work_{i}": texture for i, texture in enumerate(self._estimates.resolved)}
        inputs = {**self._estimates.bindings(), **work, **self._domain.textures, "u_prefit_fitness": self._fitness}
        constants = _acceptance_constants(self._domain, self._schedule)
        yield from self._pass.in_bands("acceptance", bands, seconds, self._decided, inputs, constants)
        self._estimates.resolved, self._decided = self._decided, self._estimates.resolved

    def close(self) -> None:
        """Free shader and textures."""
        self._pass.close()
        self._fitness = self._decided = None


def grey(domain: DomainTextures, schedule: Schedule) -> DomainTextures:
    """Return a domain's textures, shared, for kernels that see grey samples under lights of intensity 1."""
    result = copy(domain)
    result.defines = {**domain.defines, "GREY": 1, "GREY_SHADOW": f"{schedule.prefit.shadow:.9f}"}
    result.brightness = 1.0
    return result


def _begun(own: ReflectanceModel, model: ReflectanceModel, estimates: Estimates, domain: DomainTextures) -> Estimates:
    """The prefit's first estimates: the normals that the recovery begins with, matt and as bright as the texel is."""
    normal = next(p.name for p in model.parameters if p.is_normal)
    packed = np.concatenate([textures.download(t) for t in estimates.current], axis=-1)
    at = model.offset(normal)
    fixed = {
        "normal": packed[..., at : at + 3],
        "base": domain.scale[..., None],
    }
    default = {
        p.name: np.broadcast_to(np.float32(p.default), (*packed.shape[:2], p.components)) for p in own.parameters
    }
    return Estimates(own, default | fixed)


def _narrow(lights: np.ndarray) -> bool:
    """Return whether lights (K, 4) are distant and close together: the same for all parts of a domain."""
    return not lights[:, 3].any() and flatness(lights[:, :3].astype(np.float64)) < NARROW


def _adopt_pass(model: ReflectanceModel, defines: dict[str, Any]) -> Pass:
    normal = next(p.name for p in model.parameters if p.is_normal)
    packed = kernels.packed(model)
    samplers = {"u_estimate": packed, **kernels.GEOMETRY, "u_prefit_0": kernels.FLOAT_2D}
    defines = {**defines, "NORMAL_COMPONENT": model.offset(normal)}
    outputs, given = (Output("o_estimate", packed),), kernels.model_includes(model)
    return Pass(Kernel("prefit/adopt.glsl", outputs, samplers, {}, defines, given))


def _acceptance_pass(model: ReflectanceModel, schedule: Schedule, defines: dict[str, Any]) -> Pass:
    packed = kernels.packed(model)
    samplers = {
        "u_estimate": packed, "u_work": packed, "u_prefit_fitness": kernels.FLOAT_2D, **kernels.OBSERVATIONS
    }  # fmt: skip
    defines = {
        **defines, **kernels.fitness_defines(schedule.fitness, "geman_mcclure"),
        "ACCEPTANCE_RATIO": f"{schedule.prefit.acceptance_ratio:.9f}", "ACCEPTANCE_FLOOR": f"{_ACCEPTANCE_FLOOR:.9f}",
    }  # fmt: skip
    outputs, given = (Output("o_estimate", packed),), kernels.model_includes(model)
    return Pass(Kernel("prefit/acceptance.glsl", outputs, samplers, kernels.FITNESS, defines, given))


def _measure_pass(model: ReflectanceModel, schedule: Schedule, defines: dict[str, Any]) -> Pass:
    samplers = {"u_estimate": kernels.packed(model), **kernels.OBSERVATIONS}
    free = build_free_parameters(model, ()).count
    defines = {
        **defines, **kernels.fitness_defines(schedule.fitness, "geman_mcclure"),
        "LEAST_SAMPLES": max(schedule.prefit.observations, _SAMPLES_PER_UNKNOWN * free),
    }  # fmt: skip
    outputs, given = (Output("o_fitness", "R32F"),), kernels.model_includes(model)
    return Pass(Kernel("prefit/measure.glsl", outputs, samplers, kernels.FITNESS, defines, given))


def _acceptance_constants(domain: DomainTextures, schedule: Schedule) -> dict[str, int | float]:
    return loss_constants(domain, schedule.prefit.acceptance_delta)
