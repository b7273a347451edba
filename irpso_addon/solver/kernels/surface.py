"""The kernels of the surface phase, which makes normals integrable and smooth."""

from __future__ import annotations

from dataclasses import dataclass

from ...gpu.kernel import Defines, Entry, Kernel, Output, Samplers
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ..settings.resolve import ResolvedSurface
from ..settings.schedule import Schedule
from .declarations import FLOAT_2D, LOSS_CONSTANTS, OBSERVATIONS, PACKING, fitness_defines, model_includes, packed
from .free_parameters import FreeParameters, build_jacobian, has_basis
from .refinement import jacobian_renders

NOISE, INFORMATION, FIRST_ROUND = 0, 1, 2  # iterations
SWEEPS = 7  # in a round: each reads adjacent texels; then settle.glsl one texel further, and smooth.glsl a window
_TAPS, _WINDOW = 24, 2  # neighbours, and the largest distance of them: shaders/common/taps.glsl
NOISE_STENCIL_RADIUS, STENCIL_RADIUS = _WINDOW, SWEEPS + 1 + _WINDOW


@dataclass(frozen=True)
class SurfacePasses:
    """The compiled passes, in their order. ``bend`` is always a fragment pass: its output may be read back."""

    noise: Pass
    variance: Pass
    information: Pass
    relax: Pass
    settle: Pass
    smooth: Pass
    bend: Pass

    def close(self) -> None:
        """Free the shaders."""
        for name in self.__dataclass_fields__:
            getattr(self, name).close()


def build_surface_passes(
    model: ReflectanceModel, resolved: ResolvedSurface, schedule: Schedule, domain_defines: Defines, entry: Entry
) -> SurfacePasses:
    """Compile the passes of the surface phase."""
    free, jacobian = _jacobian(model, resolved, schedule)
    defines = {
        **domain_defines, **free.defines, **fitness_defines(schedule.fitness), "TAPS": _TAPS,
        "NOISE_SAMPLES": f"{schedule.prior.noise_samples:.9f}", "WEIGHT": f"{resolved.surface.weight:.9f}",
        "TOLERANCE": f"{resolved.surface.tolerance:.9f}", "SMOOTHNESS": f"{resolved.surface.smoothness:.9f}",
    }  # fmt: skip
    numbers = packed(model)
    samplers: Samplers = {
        "u_estimate": numbers, "u_noise": FLOAT_2D, "u_field": FLOAT_2D, "u_covariance": FLOAT_2D, **PACKING,
        **OBSERVATIONS,
    }  # fmt: skip
    includes = {**model_includes(model), "free_parameters.glsl": free.source, "jacobian.glsl": jacobian}

    def make(source: str, *outputs: Output, how: Entry = entry) -> Pass:
        constants = {**LOSS_CONSTANTS, "u_momentum": "FLOAT"}
        return Pass(Kernel(f"{source}.glsl", outputs, samplers, constants, defines, includes), how)

    return SurfacePasses(
        noise=make("spatial_prior/noise", Output("o_noise"), Output("o_mean", numbers)),
        variance=make("spatial_prior/variance", Output("o_noise")),
        information=make("surface/information", Output("o_field"), Output("o_covariance")),
        relax=make("surface/relax", Output("o_field")),
        settle=make("surface/settle", Output("o_field")),
        smooth=make("surface/smooth", Output("o_field")),
        bend=make("surface/bend", Output("o_estimate", numbers), how="fragment"),
    )


def evaluations_of(resolved: ResolvedSurface, model: ReflectanceModel, schedule: Schedule, iteration: int) -> int:
    """Return the renders of all observations that an iteration makes at a texel."""
    if iteration == INFORMATION:
        return jacobian_renders(_jacobian(model, resolved, schedule)[0], schedule.refinement)
    return 1 if iteration == NOISE else 0


def _jacobian(model: ReflectanceModel, resolved: ResolvedSurface, schedule: Schedule) -> tuple[FreeParameters, str]:
    """Return the unknowns, normal and linear parameters, and their jacobian.glsl.

    Searched parameters are fixed. A texel's few samples hardly separate them from the normal, but earlier phases have
    estimated them from other texels. With free ones, bending doubled the error of texels that three lights see.
    """
    fixed = {p.name for p in model.parameters} - {
        p.name for p in resolved.parameters if p.is_normal or has_basis(p, model)
    }
    return build_jacobian(model, fixed, schedule.refinement.central_differences)
