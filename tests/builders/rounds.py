"""A bowl of known interreflection, and rounds of interreflection over it."""

from __future__ import annotations

import numpy as np

from irpso_addon.blender.ray_caster import ray_caster_steps
from irpso_addon.geometry.domain import with_samples
from irpso_addon.geometry.light.interreflection_geometry import MeshInterreflection
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.interreflection.rounds import InterreflectionRounds
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.cavity import cavity_mesh, half_cavity
from tests.builders.command_line import dome_lights

LAMBERT = load_model("lambert")
ALBEDO = (0.8, 0.5, 0.3)
SINGLE = load_schedule("standard").without_rounds().replaced(interreflection_bounces=6)
ROUNDS = SINGLE.replaced(interreflection_rounds=2)


def matt_bowl():
    """Return (domain, geometry) of a matt half sphere, lit through its opening."""
    mesh = cavity_mesh(opening=0.0)
    lights = dome_lights(24, 50.0) * (1, 1, -1)
    return half_cavity(mesh, ALBEDO, lights), MeshInterreflection(mesh, ray_caster_steps, 48, 64)


def without_indirect(bowl):
    """Return (domain, geometry) of the bowl without indirect light in its photographs."""
    domain, geometry = bowl
    values = domain.stack.values.copy()
    darkest = values[..., :3].min(axis=(1, 2), keepdims=True)  # samples in shadow show indirect light alone
    values[..., :3] = np.where(values[..., 3:] > 0, values[..., :3] - darkest, 0)
    return with_samples(domain, values), geometry


def rounds_of(bowl, schedule=ROUNDS, fixed=None, model=LAMBERT, **options):
    """Return the rounds of interreflection over a bowl (domain, geometry)."""
    return InterreflectionRounds(bowl[0], model, schedule, 1, fixed, "fragment", bowl[1], **options)


def errors(maps):
    """Return the mean error of the normals in degrees, and the base colour's mean over the true one."""
    tilt = np.degrees(np.arccos(np.clip(maps.values["normal"][maps.solved][:, 2], -1, 1)))
    return tilt.mean(), maps.values["base_color"][maps.solved].mean(axis=0) / ALBEDO
