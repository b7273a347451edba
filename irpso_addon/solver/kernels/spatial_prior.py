"""The kernels of the spatial prior."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.paths import SHADERS
from ...gpu.kernel import Defines, Entry, Includes, Kernel, Output, Samplers
from ...gpu.passes import Pass
from ...reflectance.model import Parameter, ReflectanceModel
from ..settings.refinement_groups import Refinement, SpatialPrior
from ..settings.resolve import ResolvedSpatialPrior
from ..settings.schedule import Schedule
from .declarations import (
    FLOAT_2D,
    GEOMETRY,
    LOSS_CONSTANTS,
    OBSERVATIONS,
    PACKING,
    fitness_defines,
    model_includes,
    packed,
)
from .free_parameters import build_free_parameters, build_jacobian
from .refinement import STEP, renders, resolved_jacobian, step_defines
from .single_passes import copy_pass

NOISE, DEVIATION, FIRST_ROUND = 0, 1, 2  # iterations of a prior; its steps follow the rounds
_NOISE = {"u_noise": FLOAT_2D}
# Of shaders/spatial_prior/pool.glsl.
_KINDS = {"other": 0, "color": 1, "scalar": 2}


@dataclass(frozen=True)
class SpatialPriorPasses:
    """The compiled passes of a prior, in their order.

    ``keep`` is always a fragment pass, because its output may be read back.
    """

    noise: Pass
    variance: Pass
    deviation: Pass
    pool: Pass
    pool_last: Pass
    begin: Pass
    step: Pass
    keep: Pass
    copy: Pass

    def close(self) -> None:
        """Free the shaders."""
        for name in self.__dataclass_fields__:
            getattr(self, name).close()


def stencil_radius_of(prior: SpatialPrior) -> int:
    """Return the distance, in texels, at which a round of a prior reads neighbours."""
    return 2**prior.scales


def taps_of(prior: SpatialPrior) -> int:
    """Return the number of neighbours that a round of a prior reads: TAPS of shaders/common/taps.glsl."""
    return 24 + 16 * (prior.scales - 1)


def build_spatial_prior_passes(
    model: ReflectanceModel, resolved: ResolvedSpatialPrior, schedule: Schedule, domain_defines: Defines, entry: Entry
) -> SpatialPriorPasses:
    """Compile the passes of a prior."""
    prior, fixed = resolved.prior, _fixed_names(model, resolved.parameters)
    free = build_free_parameters(model, fixed)
    common = {
        **domain_defines, **free.defines, **_lobes(model, fixed),
        **_settings(prior, schedule.refinement), **fitness_defines(schedule.fitness), "COMPONENTS": model.components,
    }  # fmt: skip
    numbers = packed(model)
    estimates, own, work = ({f"u_{name}": numbers} for name in ("estimate", "own", "work"))
    pooled_inputs = {"u_mean": numbers, "u_deviation": numbers}
    mean, deviation, estimate = (Output(f"o_{name}", numbers) for name in ("mean", "deviation", "estimate"))
    includes = {
        **model_includes(model), "components.glsl": components_source(model, resolved),
        "free_parameters.glsl": free.source,
    }  # fmt: skip

    def make(source: str, outputs: tuple[Output, ...], samplers: Samplers, how: Entry = entry, **more: int) -> Pass:
        name = f"{source}.glsl"
        return Pass(Kernel(name, outputs, samplers, LOSS_CONSTANTS, {**common, **more}, includes), how)

    return SpatialPriorPasses(
        noise=make("spatial_prior/noise", (Output("o_noise"), mean), {**estimates, **OBSERVATIONS}),
        variance=make("spatial_prior/variance", (Output("o_noise"),), {**_NOISE, **PACKING}),
        deviation=make("diagnostics/confidence", (deviation,), {**estimates, **OBSERVATIONS, **_NOISE}, NOISE_GIVEN=1),
        pool=make("spatial_prior/pool", (mean, deviation), {**estimates, **pooled_inputs, **own, **PACKING}),
        pool_last=make(
            "spatial_prior/pool", (mean, deviation), {**estimates, **pooled_inputs, **own, **PACKING}, LAST=1
        ),
        begin=make(
            "spatial_prior/begin",
            (estimate, Output("o_status"), Output("o_penalty", "R32F")),
            {**estimates, **pooled_inputs, **own, **_NOISE, **GEOMETRY},
        ),
        step=_step_pass(model, resolved, common, {**estimates, **pooled_inputs, **_NOISE}, includes, entry),
        keep=make(
            "spatial_prior/keep",
            (estimate,),
            {**estimates, **work, "u_work_status": FLOAT_2D, **_NOISE, "u_penalty": FLOAT_2D, **OBSERVATIONS},
            "fragment",
        ),
        copy=copy_pass(),
    )


def evaluations_of(resolved: ResolvedSpatialPrior, model: ReflectanceModel, iteration: int) -> int:
    """Return the renders of all observations that an iteration makes at a texel that has not converged."""
    if iteration == NOISE:
        return 1
    if iteration == DEVIATION:  # one at the estimate, two for each derivative
        return 1 + 2 * build_free_parameters(model, _fixed_names(model, resolved.parameters)).count
    return 0 if iteration < FIRST_ROUND + resolved.prior.rounds else renders(model, resolved.step)[0]


def components_source(model: ReflectanceModel, resolved: ResolvedSpatialPrior) -> str:
    """Return the GLSL of ``component_at(i, width, kind)``: each component's range, and its kind for the pooling."""
    lines = []
    for p in model.parameters:
        kind = "other" if p.is_normal else "scalar" if p.components == 1 else "color"
        body = f"{{ width = {p.width!r}; kind = {_KINDS[kind]}; }}"
        lines += [f"    if (i == {model.offset(p.name) + i}) {body}" for i in range(p.components)]
    defines = [f"#define COMPONENT_{name.upper()} {value}" for name, value in _KINDS.items()]
    return "\n".join(
        [*defines, "void component_at(int i, out float width, out int kind)", "{",
         f"    width = 1.0; kind = {_KINDS['other']};", *lines, "}", ""]
    )  # fmt: skip


def _step_pass(
    model: ReflectanceModel,
    resolved: ResolvedSpatialPrior,
    common: Defines,
    samplers: Samplers,
    includes: Includes,
    entry: Entry,
) -> Pass:
    free, jacobian = resolved_jacobian(model, resolved.step)
    # Lobes are ordered only at the end: each lobe has its own prior.
    unknowns = {name: value for name, value in free.defines.items() if not name.startswith("LOBE_")}
    unordered = {name: value for name, value in common.items() if not name.startswith("LOBE_")}
    penalty = SHADERS / "spatial_prior" / "penalty.glsl"
    return Pass(
        Kernel(
            "refine/step.glsl", (Output("o_estimate", packed(model)), Output("o_status")),
            {**samplers, "u_status": FLOAT_2D, **OBSERVATIONS}, STEP,
            {**unordered, **unknowns, "EVALUATIONS": renders(model, resolved.step)[0]},
            {**includes, "free_parameters.glsl": free.source, "jacobian.glsl": jacobian, "penalty.glsl": penalty},
        ),
        entry,
    )  # fmt: skip


def _settings(prior: SpatialPrior, refinement: Refinement) -> Defines:
    numbers = {
        "NOISE_SAMPLES": prior.noise_samples, "BANDWIDTH": prior.bandwidth,
        "COLOR_BANDWIDTH": prior.color_bandwidth, "MIN_DEVIATION": prior.min_deviation,
        "MIN_INFLUENCE": prior.min_influence, "TOLERANCE": prior.tolerance,
    }  # fmt: skip
    return {
        **step_defines(refinement),
        "TAPS": taps_of(prior),
        **{name: f"{value:.9f}" for name, value in numbers.items()},
    }


def _lobes(model: ReflectanceModel, fixed: set[str]) -> dict[str, int]:
    defines = build_jacobian(model, fixed, central_differences=False)[0].defines
    return {name: value for name, value in defines.items() if name.startswith("LOBE_")}


def _fixed_names(model: ReflectanceModel, parameters: tuple[Parameter, ...]) -> set[str]:
    return {p.name for p in model.parameters} - {p.name for p in parameters}
