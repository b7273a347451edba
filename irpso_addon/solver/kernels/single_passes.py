"""The passes of single steps: halos, renders, residuals, confidence, alternatives, copies."""

from __future__ import annotations

from collections.abc import Mapping

from ...gpu.kernel import Defines, Kernel, Output, Packed
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ..settings.groups import Fitness
from .declarations import (
    FLOAT_2D,
    GEOMETRY,
    LAYERS,
    LOSS_CONSTANTS,
    OBSERVATIONS,
    SIZE,
    fitness_defines,
    model_includes,
    packed,
)
from .encoding import Encoding
from .free_parameters import FreeParameters
from .linear_weights import LinearWeights

TRANSPORT_LIGHTS = 4  # observations of one pass of light transport: channels of u_lit


def take_halo_pass(encoding: Encoding, defines: Defines) -> Pass:
    """Compile the pass that copies received bests to the texels of neighbouring tiles."""
    outputs, samplers = (Output("o_best", encoding.packed),), {"u_given": encoding.packed, **GEOMETRY}
    return Pass(Kernel("swarm/take_halo.glsl", outputs, samplers, SIZE, defines, {}))


def residual_pass(model: ReflectanceModel, domain_defines: Defines) -> Pass:
    """Compile the pass that compares the render of the estimates with the references."""
    return _model_pass(model, "diagnostics/residual.glsl", "o_residual", {"u_observations": "INT"}, domain_defines)


def sampled_residual_pass(model: ReflectanceModel, domain_defines: Defines) -> Pass:
    """Compile the residual pass for the texels listed in u_sampled; its output is as large as that list."""
    samplers = {"u_estimate": packed(model), **OBSERVATIONS, "u_sampled": FLOAT_2D}
    outputs = (Output("o_residual"),)
    includes = model_includes(model)
    return Pass(
        Kernel(
            "diagnostics/residual_sampled.glsl", outputs, samplers, {"u_observations": "INT"}, domain_defines, includes
        )
    )


def render_pass(model: ReflectanceModel, domain_defines: Defines) -> Pass:
    """Compile the pass that renders the estimates under one observation's light."""
    return _model_pass(model, "view/render.glsl", "o_radiance", {"u_observation": "INT"}, domain_defines)


def light_transport_pass(model: ReflectanceModel, domain_defines: Defines) -> Pass:
    """Compile the pass that gathers the light that elements of a surface send to each other and to a camera."""
    each = Packed(TRANSPORT_LIGHTS, 4 * TRANSPORT_LIGHTS)
    samplers = {
        "u_estimate": packed(model), **OBSERVATIONS, "u_rays": LAYERS, "u_lit": FLOAT_2D, "u_received": each
    }  # fmt: skip
    constants = dict.fromkeys(("u_observation", "u_ray_count", "u_columns", "u_to_camera", "u_branches"), "INT")
    defines = {**domain_defines, "LIGHTS": TRANSPORT_LIGHTS}
    outputs = (Output("o_radiance", each),)
    return Pass(Kernel("view/light_transport.glsl", outputs, samplers, constants, defines, model_includes(model)))


def confidence_pass(model: ReflectanceModel, free: str, fitness: Fitness, defines: Defines) -> Pass:
    """Compile the pass of standard deviations; ``free``: the source of free_parameters.glsl."""
    outputs, samplers = (Output("o_deviation", packed(model)),), {"u_estimate": packed(model), **OBSERVATIONS}
    includes = {**model_includes(model), "free_parameters.glsl": free}
    defines = {**defines, **fitness_defines(fitness)}
    return Pass(Kernel("diagnostics/confidence.glsl", outputs, samplers, LOSS_CONSTANTS, defines, includes))


def alternatives_pass(
    model: ReflectanceModel, free: FreeParameters, linear: LinearWeights, fitness: Fitness, defines: Defines
) -> Pass:
    """Compile the pass that measures the fit of materials far from the estimates; it solves ``linear`` for each."""
    outputs = (Output("o_alternative", Packed(-(-int(defines["ALTERNATIVES"]) // 4))),)
    samplers = {"u_estimate": packed(model), **OBSERVATIONS}
    includes = {**model_includes(model), "free_parameters.glsl": free.source, "basis.glsl": linear.source}
    defines = {**defines, **free.defines, **linear.defines, **fitness_defines(fitness)}
    return Pass(Kernel("diagnostics/alternatives.glsl", outputs, samplers, LOSS_CONSTANTS, defines, includes))


def copy_pass() -> Pass:
    """Compile the pass that copies a texture, so that the output of a compute dispatch can be read back."""
    return Pass(Kernel("common/copy.glsl", (Output("o_copy"),), {"u_source": FLOAT_2D}, {}, {}))


def _model_pass(
    model: ReflectanceModel, source: str, output: str, constants: Mapping[str, str], defines: Defines
) -> Pass:
    samplers = {"u_estimate": packed(model), **OBSERVATIONS}
    return Pass(Kernel(source, (Output(output),), samplers, constants, defines, model_includes(model)))
