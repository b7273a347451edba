"""Declarations that passes share: samplers, constants, defines, includes, the layout of a material."""

from __future__ import annotations

from ...core.files import defined
from ...gpu.kernel import Defines, Includes, Packed, Samplers
from ...reflectance.glsl import material_declaration, prior_declaration
from ...reflectance.model import ReflectanceModel
from ..settings.groups import Fitness
from ..settings.schedule import Schedule

FLOAT_2D = "FLOAT_2D"
LAYERS = "FLOAT_2D_ARRAY"
GEOMETRY: Samplers = {"u_geometry": LAYERS}
PACKING: Samplers = {**GEOMETRY, "u_packed": FLOAT_2D}
OBSERVATIONS: Samplers = {**GEOMETRY, "u_observation_table": FLOAT_2D, "u_stack": LAYERS}
SIZE = {"u_width": "INT", "u_height": "INT"}
LOSS_CONSTANTS = {"u_observations": "INT", "u_delta": "FLOAT", "u_mean_irradiance": "FLOAT"}
MOVE = {
    **SIZE, **LOSS_CONSTANTS, "u_origin_x": "INT", "u_origin_y": "INT", "u_seed": "INT", "u_iteration": "INT",
    "u_particle": "INT", "u_start_count": "INT", "u_inertia": "FLOAT", "u_constriction": "FLOAT", "u_c1": "FLOAT",
    "u_c2": "FLOAT", "u_c3": "FLOAT", "u_v_max": "FLOAT", "u_threshold": "FLOAT",
    "u_start_dimensions": "INT", "u_start_spread": "FLOAT", "u_start_speed": "FLOAT",
}  # fmt: skip
_LOSSES, _WALLS = defined("fitness/loss.glsl", "LOSS_"), defined("swarm/update.glsl", "WALLS_")


def schedule_defines(schedule: Schedule) -> Defines:
    """Return the constants of a schedule that are compiled in."""
    swarm = schedule.swarm
    return {
        "WINDOW_RADIUS": swarm.neighbourhood // 2,
        **fitness_defines(schedule.fitness),
        "WALLS": _WALLS[swarm.walls.upper()],
        "NEIGHBOUR_INTERVAL": swarm.neighbour_interval,
        "ALBEDO_LIMIT": f"{swarm.linear_limit:.9f}",
    }


def fitness_defines(fitness: Fitness, loss: str = "") -> Defines:
    """Return the constants of a fitness that are compiled in. loss: replaces the fitness's own, "" for none."""
    return {"LOSS": _LOSSES[(loss or fitness.loss).upper()], "HIGHLIGHT_POWER": f"{fitness.highlight_power:.9f}"}


def model_includes(model: ReflectanceModel) -> Includes:
    """Return the sources of a kernel's includes: material.glsl, model.glsl and priors.glsl."""
    return {
        "material.glsl": material_declaration(model),
        "model.glsl": model.shader,
        "priors.glsl": prior_declaration(model),
    }


def packed(model: ReflectanceModel) -> Packed:
    """Return the texture layout of a model's components."""
    return Packed(-(-model.components // 4))
