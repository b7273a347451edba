"""What every pass binds, against what GPUs have: 16 textures to read, 8 images to write, 6 colour attachments."""

from functools import cache
from pathlib import Path

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.gpu import context
from irpso_addon.gpu.library import read_source
from irpso_addon.gpu.passes import Pass
from irpso_addon.reflectance.model import load_model, shipped_models
from irpso_addon.solver.engine.confidence import Confidence
from irpso_addon.solver.kernels import refinement as refinement_kernels
from irpso_addon.solver.kernels import sequential_swarm as sequential_kernels
from irpso_addon.solver.kernels import spatial_prior as prior_kernels
from irpso_addon.solver.kernels import surface as surface_kernels
from irpso_addon.solver.kernels import synchronous_swarm as synchronous_swarm_kernels
from irpso_addon.solver.kernels.encoding import build_encoding
from irpso_addon.solver.kernels.linear_weights import linear_weights
from irpso_addon.solver.kernels.single_passes import (
    light_transport_pass,
    render_pass,
    residual_pass,
    sampled_residual_pass,
)
from irpso_addon.solver.phases import acceptance, indirect, prefit, separation, sheen
from irpso_addon.solver.phases.neighbour_test import decision_pass
from irpso_addon.solver.settings.resolve import (
    ResolvedIndirect,
    ResolvedPrefit,
    ResolvedRefinement,
    ResolvedSeparation,
    ResolvedSheen,
    ResolvedSpatialPrior,
    ResolvedSurface,
    particle_count,
    resolve,
)
from irpso_addon.solver.settings.schedule import load_schedule, shipped_presets
from irpso_addon.solver.state.alternatives import Alternatives
from irpso_addon.solver.views import display

SAMPLERS, IMAGES = 16, 8
OWN = Path(__file__).resolve().parents[2] / "gpu" / "models"
MODELS = [*shipped_models(), *sorted(str(path) for path in OWN.glob("*.toml"))]
VARIANTS = {
    "as shipped": {},
    "all at once, searched": {"update": "all", "linear": "search", "particles": 16, "particles_per_dimension": 0.0},
    "all at once, solved": {"update": "all", "linear": "solve", "particles": 16, "particles_per_dimension": 0.0},
}
TOO_MANY_TO_SEARCH = ("anisotropic", "clear_coat")  # where base colour and normal are searched with all the rest
ONE_STAGE = ("constriction", "swarm")  # presets that do so: no prefit finds normals before
DOMAIN = {"SEAMS": 16}  # a mesh under near lights: nothing is left out


@pytest.fixture
def made(monkeypatch):
    """The kernels of all passes that are made meanwhile; nothing is compiled, so that no GPU is needed."""
    kernels_made = []

    def note(self, kernel, entry="fragment"):
        kernels_made.append(kernel)

    monkeypatch.setattr(Pass, "__init__", note)
    monkeypatch.setattr(context, "ensure", lambda: None)
    return kernels_made


def make_passes(resolved, model, schedule):
    """Make the passes of one phase."""
    if isinstance(resolved, ResolvedRefinement):
        refinement_kernels.build_refinement_passes(model, resolved, schedule.fitness, DOMAIN, "fragment")
    elif isinstance(resolved, ResolvedSpatialPrior):
        prior_kernels.build_spatial_prior_passes(model, resolved, schedule, DOMAIN, "fragment")
    elif isinstance(resolved, ResolvedSurface):
        surface_kernels.build_surface_passes(model, resolved, schedule, DOMAIN, "fragment")
    elif isinstance(resolved, ResolvedIndirect):
        decision_pass("prefit/indirect.glsl", "shadow", indirect.limits(schedule), DOMAIN)
    elif isinstance(resolved, ResolvedSheen):
        decision_pass("prefit/sheen.glsl", "chosen", sheen.limits(schedule), DOMAIN)
    elif isinstance(resolved, ResolvedSeparation):
        prefit.adopt_pass(model, DOMAIN)
        separation.shadow_light_pass(model, 0.05, separation.MIN_TURN, DOMAIN, "fragment")
    elif isinstance(resolved, ResolvedPrefit):
        for part in (resolved.stage, resolved.refinement):
            make_passes(part, resolved.model, schedule)
        prefit.adopt_pass(model, DOMAIN)
        prefit._measure_pass(resolved.model, schedule, DOMAIN)
        prefit._indirect_misfit_pass(resolved.model, schedule, DOMAIN)
        acceptance.acceptance_pass(model, schedule, DOMAIN)
    else:
        codec = build_encoding(model, resolved, schedule.swarm.normal)
        particles = particle_count(schedule, codec.dimensions)
        if schedule.swarm.update == "all":
            linear = linear_weights(model, resolved.solved)
            synchronous_swarm_kernels.build_synchronous_swarm_passes(
                model, codec, linear, schedule, particles, 4, DOMAIN, "fragment"
            )  # fmt: skip
        else:
            sequential_kernels.build_sequential_swarm_passes(model, codec, schedule, particles, 4, DOMAIN, "fragment")


@cache
def source_of(path, includes):
    return read_source(path, dict(includes))


def samplers_of(kernel):
    """Return the textures that a kernel declares: those of its table that its source reads."""
    return sorted(kernel.declared(source_of(kernel.source, frozenset(kernel.includes.items()))))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", MODELS, ids=lambda name: Path(name).stem)
def test_every_pass_of_every_model_and_preset_fits_the_common_limits(made, name, variant):
    model = load_model(name)
    for preset in shipped_presets():
        schedule = load_schedule(preset).replaced(surface_rounds=1, **VARIANTS[variant])
        if schedule.swarm.linear == "search" and preset in ONE_STAGE and model.name in TOO_MANY_TO_SEARCH:
            with pytest.raises(InputError, match='9 dimensions together.*linear = "solve"'):
                resolve(schedule, model, set(), observations=24)
            continue
        for resolved in resolve(schedule, model, set(), observations=24):
            make_passes(resolved, model, schedule)
        Confidence(model, (), schedule.fitness, DOMAIN)
        Alternatives(model, (), schedule.fitness, DOMAIN)
    for make in (residual_pass, sampled_residual_pass, render_pass, light_transport_pass):
        make(model, DOMAIN)
    for kind in ("parameter", "error", "render", "reference", "confidence"):
        display._picture_pass(model, kind, DOMAIN)
    assert len(made) > 30
    for kernel in made:
        assert len(samplers_of(kernel)) <= SAMPLERS, (kernel.source, samplers_of(kernel))
        assert len(kernel.targets) <= min(IMAGES, 6), kernel.source
