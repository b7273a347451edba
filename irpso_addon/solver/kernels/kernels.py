"""The kernels of a stage: shader files with the declarations and constants that one model and stage give them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ...gpu.library import defined
from ...gpu.passes import Defines, Entry, Includes, Kernel, Output, Packed, Pass, Samplers
from ...reflectance.glsl import material_declaration, prior_declaration
from ...reflectance.model import ReflectanceModel
from ..settings.groups import Fitness
from ..settings.schedule import Schedule
from .encoding import Encoding
from .free_parameters import FreeParameters
from .linear_weights import LinearWeights

FLOAT_2D = "FLOAT_2D"
LAYERS = "FLOAT_2D_ARRAY"
GEOMETRY: Samplers = {"u_geometry": LAYERS}
PACKING: Samplers = {**GEOMETRY, "u_packed": FLOAT_2D}
OBSERVATIONS: Samplers = {**GEOMETRY, "u_observation_table": FLOAT_2D, "u_stack": LAYERS}
_SIZE = {"u_width": "INT", "u_height": "INT"}
FITNESS = {"u_observations": "INT", "u_delta": "FLOAT", "u_brightness": "FLOAT"}
MOVE = {
    **_SIZE, **FITNESS, "u_origin_x": "INT", "u_origin_y": "INT", "u_seed": "INT", "u_iteration": "INT",
    "u_particle": "INT", "u_seeded": "INT", "u_inertia": "FLOAT", "u_constriction": "FLOAT", "u_c1": "FLOAT",
    "u_c2": "FLOAT", "u_c3": "FLOAT", "u_v_max": "FLOAT", "u_threshold": "FLOAT",
    "u_seeded_dimensions": "INT", "u_seed_spread": "FLOAT", "u_start_speed": "FLOAT",
}  # fmt: skip
LOSSES, _WALLS = defined("fitness/loss.glsl", "FITNESS_"), defined("swarm/update.glsl", "WALLS_")


@dataclass(frozen=True)
class SequentialSwarmPasses:
    """The compiled passes of a stage. ``resolve`` is always a fragment pass: what it wrote may be read back."""

    start: Pass
    move: Pass
    commit_state: Pass
    commit_personal: Pass
    commit_global: Pass
    resolve: Pass
    take_halo: Pass

    def close(self) -> None:
        """Free the shaders."""
        for name in self.__dataclass_fields__:
            getattr(self, name).close()


def build_sequential_swarm_passes(
    model: ReflectanceModel,
    encoding: Encoding,
    schedule: Schedule,
    particles: int,
    across: int,
    domain_defines: Defines,
    entry: Entry,
) -> SequentialSwarmPasses:
    """Compile the passes of a stage for ``particles`` in an atlas ``across`` tiles wide."""
    estimates = packed(model)
    given = {**model_includes(model), "particle_encoding.glsl": encoding.source}
    defines = {
        **domain_defines, **encoding.defines, **schedule_defines(schedule), "PARTICLES": particles, "TILES_X": across
    }  # fmt: skip
    fixed = {"u_best": encoding.packed, "u_estimate": estimates, **PACKING}
    particle = {f"u_particle_{name}": FLOAT_2D for name in ("position", "velocity", "best", "fitness")}
    candidate = {f"u_candidate_{name}": encoding.packed for name in ("position", "velocity")} | {"u_verdict": FLOAT_2D}
    moved = (*(Output(f"o_{name}", encoding.packed) for name in ("position", "velocity")), Output("o_verdict"))
    fitness = Output("o_fitness", "R32F")

    def make(
        source: str, outputs: tuple[Output, ...], samplers: Samplers, constants: Mapping[str, str],
        how: Entry = entry, **more: int,
    ) -> Pass:  # fmt: skip
        kernel = Kernel(f"swarm/sequential/{source}.glsl", outputs, samplers, constants, {**defines, **more}, given)
        return Pass(kernel, how)

    read = {**particle, "u_best_fitness": FLOAT_2D, **fixed, **OBSERVATIONS}
    return SequentialSwarmPasses(
        start=make("move", moved, read, MOVE, START=1),
        move=make("move", moved, read, MOVE),
        commit_state=make("commit_state", (Output("o_position"), Output("o_velocity")), candidate, _SIZE),
        commit_personal=make("commit_personal", (Output("o_best"), fitness), candidate, _SIZE),
        commit_global=make("commit_global", (Output("o_best", encoding.packed), fitness), candidate, _SIZE),
        resolve=make("resolve", (Output("o_estimate", estimates),), fixed, _SIZE, how="fragment"),
        take_halo=take_halo_pass(encoding, defines),
    )


def take_halo_pass(encoding: Encoding, defines: Defines) -> Pass:
    """Compile the pass that takes given bests at the texels of neighbouring tiles."""
    outputs, samplers = (Output("o_best", encoding.packed),), {"u_given": encoding.packed, **GEOMETRY}
    return Pass(Kernel("swarm/take_halo.glsl", outputs, samplers, _SIZE, defines, {}))


def schedule_defines(schedule: Schedule) -> Defines:
    """Return the constants of a schedule that are compiled in."""
    swarm = schedule.swarm
    return {
        "REACH": swarm.neighbourhood // 2,
        **fitness_defines(schedule.fitness),
        "WALLS": _WALLS[swarm.walls.upper()],
        "NEIGHBOUR_EVERY": swarm.neighbour_every,
        "LINEAR_REACH": f"{swarm.linear_reach:.9f}",
    }


def fitness_defines(fitness: Fitness, loss: str = "") -> Defines:
    """Return the constants of a fitness that are compiled in, or of another loss in its place."""
    return {"FITNESS": LOSSES[(loss or fitness.loss).upper()], "HIGHLIGHT_POWER": f"{fitness.highlight_power:.9f}"}


def residual_pass(model: ReflectanceModel, domain_defines: Defines) -> Pass:
    """Compile the pass that compares the render of the estimates with the references."""
    return _model_pass(model, "diagnostics/residual.glsl", "o_residual", {"u_observations": "INT"}, domain_defines)


def sampled_residual_pass(model: ReflectanceModel, domain_defines: Defines) -> Pass:
    """Return the same pass over the texels that u_sampled names, in places of its own."""
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


def confidence_pass(model: ReflectanceModel, free: str, fitness: Fitness, defines: Defines) -> Pass:
    """Compile the pass of standard deviations; ``free``: the source of free_parameters.glsl."""
    outputs, samplers = (Output("o_deviation", packed(model)),), {"u_estimate": packed(model), **OBSERVATIONS}
    given = {**model_includes(model), "free_parameters.glsl": free}
    defines = {**defines, **fitness_defines(fitness)}
    return Pass(Kernel("diagnostics/confidence.glsl", outputs, samplers, FITNESS, defines, given))


def alternatives_pass(
    model: ReflectanceModel, free: FreeParameters, linear: LinearWeights, fitness: Fitness, defines: Defines
) -> Pass:
    """Compile the pass that measures the fit of materials far from the estimates; ``linear`` is solved for each."""
    outputs = (Output("o_alternative", Packed(-(-int(defines["ALTERNATIVES"]) // 4))),)
    samplers = {"u_estimate": packed(model), **OBSERVATIONS}
    given = {**model_includes(model), "free_parameters.glsl": free.source, "basis.glsl": linear.source}
    defines = {**defines, **free.defines, **linear.defines, **fitness_defines(fitness)}
    return Pass(Kernel("diagnostics/alternatives.glsl", outputs, samplers, FITNESS, defines, given))


def copy_pass() -> Pass:
    """Compile the pass that copies a texture, so that what a compute dispatch wrote can be read back."""
    return Pass(Kernel("common/copy.glsl", (Output("o_copy"),), {"u_source": FLOAT_2D}, {}, {}))


def _model_pass(
    model: ReflectanceModel, source: str, output: str, constants: Mapping[str, str], defines: Defines
) -> Pass:
    samplers = {"u_estimate": packed(model), **OBSERVATIONS}
    return Pass(Kernel(source, (Output(output),), samplers, constants, defines, model_includes(model)))


def model_includes(model: ReflectanceModel) -> Includes:
    """Return what a kernel's includes of material.glsl, model.glsl and priors.glsl bring."""
    return {
        "material.glsl": material_declaration(model),
        "model.glsl": model.shader,
        "priors.glsl": prior_declaration(model),
    }


def packed(model: ReflectanceModel) -> Packed:
    """Return how a model's components lie in textures."""
    return Packed(-(-model.components // 4))
