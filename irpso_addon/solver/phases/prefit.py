"""Prefit: estimates normals with a model of few assumptions, before the recovery's own model."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from ...capture.light_geometry import NARROW, flatness
from ...core.optional import present
from ...core.paths import SHADERS
from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.kernel import Defines, Kernel, Output, Samplers
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ..kernels import declarations
from ..kernels.free_parameters import build_free_parameters
from ..kernels.refinement import NO_PENALTY
from ..settings.resolve import ResolvedPrefit
from ..settings.schedule import Schedule
from ..state.prefit_measurements import PrefitMeasurements
from ..state.textures import DomainTextures, Estimates, loss_constants
from .phase import Phase, PhaseContext
from .refinement import RefinementPhase
from .synchronous_swarm import SynchronousSwarmPhase

# With fewer samples per unknown a prefit is no reference for other fits: under 16 near lamps noise would turn the
# normals of metals (metallic of a gilding 0.056, not 0.042). With this limit the mean error in hollows of
# bunny_specular, which few of its 50 lights reach, falls from 0.82 to 0.69°.
_SAMPLES_PER_UNKNOWN = 3
# Least fitness of the first prefit for a second one with sheen: SheenPhase adopts none whose neighbourhood fits better
# than 0.37. On captures like DiLiGenT's the limit reduces the time to 0.35 to 0.47 on clay and glaze, not on velvet and
# metal paint; the normals' mean error changes by less than 0.03°.
_MIN_FITNESS = 0.3
_PENALTY = SHADERS / "prefit" / "exponent_penalty.glsl"
# Of the prior on the cosine's exponent (mean 1) under narrow lights. On balls under 12 lights within 22° it lowers the
# mean error from 0.66 to 0.36° (Lambert) and from 3.95 to 2.95° (Oren–Nayar, σ = 0.2). Wide lights determine the
# exponent: with the prior the error on bunny_lambert would rise by 0.08°.
_EXPONENT_DEVIATION = 0.15


class PrefitPhase(Phase):
    """A Phase: swarms, then a refinement, on grey samples with the prefit's own model.

    Its result is the estimates of the recovery's model with the prefit's normals. inner: the swarms, later the
    refinement. own: the estimates of the prefit's model. measurements: of the phases before. A prefit of indirect light
    changes only texels with a raised shadow threshold or separated light, without neighbours. A prefit with sheen
    changes no estimates: it solves the texels that the first one fits badly; SheenPhase adopts its normals.

    Start: state/prepare.py fits Lambertian normals (Prepared.guess) for the recovery's Estimates, unless a guess is
    given. ``_first_estimates`` keeps these normals; the base is the texel's scale, the rest defaults. The swarms have
    the settings of the recovery's own (group Swarm): SwarmPhase.constants counts the particles that start near the
    estimate, kernels/encoding.py encodes it, initialise_particle (shaders/swarm/update.glsl) places them.
    """

    def __init__(self, resolved: ResolvedPrefit, context: PhaseContext, seed: int, measurements: PrefitMeasurements):
        schedule, domain = context.schedule, context.domain
        self._chosen: np.ndarray | None = None
        if resolved.indirect:
            self._chosen = (domain.shadow > 0) | domain.separation.separated
        elif resolved.sheen:
            self._chosen = present(measurements.fitness) >= _MIN_FITNESS
        if self._chosen is not None:
            schedule, domain = schedule.replaced(c3=0.0, neighbour_interval=0), domain.where(self._chosen)
        self._resolved, self._schedule, self._entry = resolved, schedule, context.entry
        self._domain, self._estimates, self._measurements = grey(domain, schedule), context.estimates, measurements
        self._model, self.title = resolved.model, resolved.title
        self._domain.defines |= {
            "EXPONENT_COMPONENT": self._model.offset("cosine_exponent"),
            "EXPONENT_DEVIATION": f"{_EXPONENT_DEVIATION:.9f}",
        }  # fmt: skip
        self.own = _first_estimates(self._model, context.model, context.estimates, domain)
        self._adopt = adopt_pass(context.model, domain.defines)
        self._measure = _measure_pass(self._model, schedule, self._domain.defines)
        self._indirect_misfit = (
            _indirect_misfit_pass(self._model, schedule, self._domain.defines) if resolved.seeks else None
        )
        self._refining = False
        if schedule.swarm.start == "given":  # a given guess has a normal, but no parameters of the prefit's model
            schedule = schedule.replaced(start="lambert")
        self.inner: SynchronousSwarmPhase | RefinementPhase = SynchronousSwarmPhase(
            resolved.stage, self._inner_context(schedule), seed
        )
        self.iterations = resolved.iterations

    @property
    def iteration(self) -> int:
        """Number of finished iterations, of swarms and refinement; negative while swarms are initialised."""
        return self.inner.iteration + (self._resolved.stage.iterations if self._refining else 0)

    @property
    def evaluations(self) -> int:
        """Renders of all observations in the next iteration, at a texel that has not converged."""
        return self.inner.evaluations

    @property
    def stencil_radius(self) -> int:
        """Distance, in texels, at which the next iteration reads neighbours."""
        return self.inner.stencil_radius

    @property
    def has_result(self) -> bool:
        """Whether there are normals to show."""
        return not self.keeps_estimates and (self._refining or self.inner.has_result)

    @property
    def keeps_estimates(self) -> bool:
        """Whether the current estimates stay: the selection between two prefits adopts the normals with sheen."""
        return self._resolved.sheen

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each band."""
        yield from self.inner.advance(bands, seconds)
        bands.part = 0.0  # the inner phase has counted this iteration
        if self.inner.done and not self._refining:
            yield from self.inner.write_estimates(bands, seconds)
            self.own.swap()
            self._begin_refinement()

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the normals so far into the next estimates."""
        yield from self.inner.write_estimates(bands, seconds)
        if not self.keeps_estimates:
            yield from self._adopt.in_one_draw(bands, self._estimates.next, self._inputs(self.own.next))

    def preview(self, targets: Sequence[Texture]) -> None:
        """Write the normals so far into other textures."""
        own = self.own.shown if self.inner.has_result else self.own.current
        if self.inner.has_result:
            self.inner.preview(own)
        self._adopt.run(targets, self._inputs(own))

    def _inputs(self, own: list[Texture]) -> dict[str, Texture]:
        prefit = {f"u_prefit_{i}": texture for i, texture in enumerate(own)}
        return {**self._estimates.bindings(), **self._domain.textures, **prefit}

    def measure_steps(self, bands: Bands, seconds: float) -> Generator[None, None, PrefitMeasurements]:
        """Yields often; returns the measurements, with the fitness of the next estimates of the prefit's model.

        Where the stage ``seeks`` indirect light, its misfit too; of a prefit with sheen, its normals and fitness.
        """
        targets = [textures.empty(*self.own.size, "R32F")]
        inputs = {**self.own.bindings(of_next=True), **self._domain.textures}
        constants = acceptance_constants(self._domain, self._schedule)
        yield from self._measure.in_bands("measure", bands, seconds, targets, inputs, constants)
        fitness = textures.download(targets[0])[..., 0]
        if self._chosen is not None:
            fitness = np.where(self._chosen, fitness, present(self._measurements.fitness))
        if self._resolved.sheen:
            normals = normals_of(self.own, self._model, of_next=True)
            return replace(self._measurements, sheen=np.concatenate([normals, fitness[..., None]], axis=-1))
        if self._indirect_misfit is None:
            return replace(self._measurements, fitness=fitness)
        targets = [textures.empty(*self.own.size)]
        constants = {"u_observations": constants["u_observations"]}
        yield from self._indirect_misfit.in_bands("indirect misfit", bands, seconds, targets, inputs, constants)
        return PrefitMeasurements(fitness, indirect_misfit=textures.download(targets[0]))

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: the data that neighbours read; NaN where no texel is solved."""
        return self.inner.halo()

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Set (H, W, n), and (M, n) of the ghosts, at texels of other tiles. The tile's own texels do not change."""
        self.inner.take_halo(values, ghosts)

    def state(self) -> dict[str, np.ndarray]:
        """Return name → array of all that persists between iterations."""
        own = {f"own_{i}": textures.download(texture) for i, texture in enumerate(self.own.current)}
        return {**self.inner.state(), **own}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Continue from the ``state`` of an iteration."""
        self.own.current = [textures.upload(arrays[f"own_{i}"]) for i in range(self.own.count)]
        swarm = self._resolved.stage.iterations
        if iteration >= swarm and not self._refining:
            self._begin_refinement()
        self.inner.restore(arrays, iteration - (swarm if self._refining else 0))

    def close(self) -> None:
        """Free shaders and textures."""
        self.inner.close()
        self._adopt.close()
        self._measure.close()
        if self._indirect_misfit is not None:
            self._indirect_misfit.close()
        self.own.close()

    def _inner_context(self, schedule: Schedule) -> PhaseContext:
        return PhaseContext(self._model, schedule, self._domain, self.own, self._entry)

    def _begin_refinement(self) -> None:
        self.inner.close()
        lights = self._domain.domain.lights  # the same for all parts of a domain
        narrow = not lights[:, 3].any() and flatness(lights[:, :3].astype(np.float64)) < NARROW
        self.inner = RefinementPhase(
            self._resolved.refinement, self._inner_context(self._schedule), penalty=_PENALTY if narrow else NO_PENALTY
        )
        self._refining = True


def grey(domain: DomainTextures, schedule: Schedule) -> DomainTextures:
    """Return the same textures, for kernels that read grey samples under lights of intensity 1."""
    result = copy(domain)
    result.defines = {**domain.defines, "GREY": 1, "GREY_SHADOW": f"{schedule.prefit.shadow:.9f}"}
    result.mean_irradiance = 1.0
    return result


def _first_estimates(
    own: ReflectanceModel, model: ReflectanceModel, estimates: Estimates, domain: DomainTextures
) -> Estimates:
    """Return the prefit's first estimates: the recovery's normals, and a matt surface of each texel's own scale."""
    normals = normals_of(estimates, model)
    values = {
        p.name: np.broadcast_to(np.asarray(p.default, np.float32), (*normals.shape[:2], p.components))
        for p in own.parameters
    }
    return Estimates(own, values | {"normal": normals, "base": domain.scale[..., None]})


def normals_of(estimates: Estimates, model: ReflectanceModel, of_next: bool = False) -> np.ndarray:
    """Return the normals (h, w, 3) of the current estimates, or of the next ones, packed."""
    name = model.normal
    return estimates.values(of_next)[name]


def adopt_pass(model: ReflectanceModel, defines: Defines) -> Pass:
    """Compile the pass that gives the estimates the normals of u_prefit_0."""
    normal = model.normal
    packed = declarations.packed(model)
    samplers: Samplers = {"u_estimate": packed, **declarations.GEOMETRY, "u_prefit_0": declarations.FLOAT_2D}
    defines = {**defines, "NORMAL_COMPONENT": model.offset(normal)}
    outputs, includes = (Output("o_estimate", packed),), declarations.model_includes(model)
    return Pass(Kernel("prefit/adopt.glsl", outputs, samplers, {}, defines, includes))


def adopt_where(
    adopt: Pass, bands: Bands, context: PhaseContext, chosen: np.ndarray, normals: np.ndarray
) -> Iterator[None]:
    """Write normals (h, w, 3) into the next estimates where chosen, (h, w) bool; elsewhere the current ones stay.

    adopt: from ``adopt_pass``.
    """
    estimates = context.estimates
    normals = np.where(chosen[..., None], normals, normals_of(estimates, context.model))
    uploaded = textures.upload(np.pad(normals, ((0, 0), (0, 0), (0, 1))).astype(np.float32))
    inputs = {**estimates.bindings(), **context.domain.textures, "u_prefit_0": uploaded}
    yield from adopt.in_one_draw(bands, estimates.next, inputs)


def _measure_pass(model: ReflectanceModel, schedule: Schedule, defines: Defines) -> Pass:
    samplers: Samplers = {"u_estimate": declarations.packed(model), **declarations.OBSERVATIONS}
    defines = {
        **defines, **declarations.fitness_defines(schedule.fitness, "geman_mcclure"),
        "MIN_SAMPLES": _min_samples(model, schedule),
    }  # fmt: skip
    outputs, includes = (Output("o_fitness", "R32F"),), declarations.model_includes(model)
    return Pass(Kernel("prefit/measure.glsl", outputs, samplers, declarations.LOSS_CONSTANTS, defines, includes))


def _indirect_misfit_pass(model: ReflectanceModel, schedule: Schedule, defines: Defines) -> Pass:
    samplers: Samplers = {"u_estimate": declarations.packed(model), **declarations.OBSERVATIONS}
    defines = {
        **defines, "GREY_SHADOW": "0.0", "WITH_SHADOW": 1, "MIN_SAMPLES": _min_samples(model, schedule),
        "RAISED_SHADOW": f"{schedule.prefit.indirect_shadow:.9f}",
    }  # fmt: skip
    outputs, includes = (Output("o_indirect_misfit"),), declarations.model_includes(model)
    return Pass(Kernel("prefit/indirect_misfit.glsl", outputs, samplers, {"u_observations": "INT"}, defines, includes))


def _min_samples(model: ReflectanceModel, schedule: Schedule) -> int:
    """Return the number of samples from which on a fit is a reference for others."""
    return max(schedule.prefit.min_observations, _SAMPLES_PER_UNKNOWN * build_free_parameters(model, ()).count)


def acceptance_constants(domain: DomainTextures, schedule: Schedule) -> dict[str, int | float]:
    """Return the constants of the losses that the acceptance test compares."""
    return loss_constants(domain, schedule.prefit.acceptance_delta)
