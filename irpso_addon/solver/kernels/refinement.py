"""The kernels of the refinement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ...core.paths import SHADERS
from ...gpu.kernel import Defines, Entry, Kernel, Output, Samplers
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ..settings.groups import Fitness
from ..settings.refinement_groups import Refinement
from ..settings.resolve import ResolvedMaterials, ResolvedRefinement
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
from .free_parameters import FreeParameters, build_jacobian, build_starts

NO_PENALTY = SHADERS / "refine" / "no_penalty.glsl"
STEP = {**LOSS_CONSTANTS, "u_settles": "INT"}
DAMPINGS = 3  # tried in one step
# Largest distance, in texels, of proposals and support (shaders/refine/propagate.glsl, neighbour_support.glsl).
PROPAGATION_RADIUS = 2
_PROPOSALS = {True: 8, False: 4}  # neighbours' materials in a propagation: twice four where unknowns are searched


@dataclass(frozen=True)
class RefinementPasses:
    """The compiled passes of a refinement. evaluations: renders of all observations in a step.

    proposals: renders in a propagation. keep_probable: replaces ``keep`` after a propagation; None where neighbours'
    support does not count. ``keep`` is always a fragment pass, because its output may be read back.
    """

    begin: Pass
    step: Pass
    propagate: Pass
    keep: Pass
    keep_probable: Pass | None
    evaluations: int
    proposals: int

    def close(self) -> None:
        """Free the shaders."""
        for pass_ in (self.begin, self.step, self.propagate, self.keep, self.keep_probable):
            if pass_ is not None:
                pass_.close()


def renders(model: ReflectanceModel, resolved: ResolvedRefinement) -> tuple[int, int]:
    """Return the renders of all observations per texel in a step and in a propagation."""
    free, _ = resolved_jacobian(model, resolved)
    evaluations = jacobian_renders(free, resolved.refinement) + DAMPINGS
    if isinstance(resolved, ResolvedMaterials):
        return evaluations, resolved.materials.count
    return evaluations, _PROPOSALS[free.defines["SEARCHED"] > 0]


def jacobian_renders(free: FreeParameters, settings: Refinement) -> int:
    """Return the renders of all observations that the normal equations need."""
    stepped = free.defines["STEPPED"] * (2 if settings.central_differences else 1)
    # All bases of the linear parameters together cost one more render.
    return 1 + stepped + (1 if free.defines["STEPPED"] < free.count else 0)


def step_defines(settings: Refinement) -> Defines:
    """Return the constants of a step that are compiled in."""
    return {
        "DAMPINGS": DAMPINGS, "DAMPING": f"{settings.damping:.9f}", "FTOL": f"{settings.ftol:.9f}",
        "XTOL": f"{settings.xtol:.9f}", "CANDIDATE_RATIO": f"{settings.candidate_ratio:.9f}",
        "NEIGHBOUR_WEIGHT": f"{settings.neighbour_weight:.9f}",
    }  # fmt: skip


def build_refinement_passes(
    model: ReflectanceModel,
    resolved: ResolvedRefinement,
    fitness: Fitness,
    domain_defines: Defines,
    entry: Entry,
    penalty: Path = NO_PENALTY,
) -> RefinementPasses:
    """Compile the passes of a refinement. penalty: shader of the term added to the loss."""
    settings = resolved.refinement
    free, jacobian = resolved_jacobian(model, resolved)
    evaluations, proposals = renders(model, resolved)
    defines = {
        **domain_defines, **free.defines, **fitness_defines(fitness), **step_defines(settings),
        "EVALUATIONS": evaluations, "PROPOSALS": proposals,
    }  # fmt: skip
    propagate: str = "refine/propagate"
    materials: Samplers = {}
    if isinstance(resolved, ResolvedMaterials):
        propagate, materials = "materials/propose", {"u_materials": FLOAT_2D}
        defines["MATERIALS_WEIGHT"] = f"{resolved.materials.weight:.9f}"
    step, constants = OBSERVATIONS, STEP
    if resolved.starts and settings.race_iterations:
        defines["RACE_RATIO"] = f"{settings.race_ratio:.9f}"
        step, constants = {**OBSERVATIONS, "u_best_status": FLOAT_2D}, {**STEP, "u_races": "INT"}
    includes = {
        **model_includes(model), "free_parameters.glsl": free.source, "jacobian.glsl": jacobian,
        "starts.glsl": build_starts(model, resolved.starts),
        "penalty.glsl": penalty,
        "materials.glsl": SHADERS / "materials" / f"{'shared' if materials else 'none'}.glsl",
    }  # fmt: skip
    outputs = Output("o_estimate", packed(model)), Output("o_status")
    best: Samplers = {"u_estimate": packed(model), "u_status": FLOAT_2D}
    work: Samplers = {"u_work": packed(model), "u_work_status": FLOAT_2D}

    compared: Samplers = {**work, **materials, **OBSERVATIONS, **PACKING}
    has_support = settings.neighbour_weight > 0 and free.defines["SEARCHED"] > 0

    def make(name: str, samplers: Samplers, constants: Mapping[str, str], how: Entry = entry) -> Pass:
        return Pass(Kernel(f"{name}.glsl", outputs, {**best, **samplers}, constants, defines, includes), how)

    return RefinementPasses(
        begin=make("refine/begin", OBSERVATIONS, {"u_observations": "INT", "u_start": "INT"}),
        step=make("refine/step", step, constants),
        propagate=make(propagate, {**OBSERVATIONS, **PACKING, **materials}, {**LOSS_CONSTANTS, "u_mirror": "INT"}),
        keep=make("refine/keep", {**work, **GEOMETRY}, {}, "fragment"),
        keep_probable=make("refine/keep_probable", compared, LOSS_CONSTANTS) if has_support else None,
        evaluations=evaluations,
        proposals=proposals,
    )


def resolved_jacobian(model: ReflectanceModel, resolved: ResolvedRefinement) -> tuple[FreeParameters, str]:
    """Return the unknowns of a refinement, and its jacobian.glsl."""
    fixed = {p.name for p in model.parameters} - {p.name for p in resolved.parameters}
    return build_jacobian(model, fixed, resolved.refinement.central_differences)
