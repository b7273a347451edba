"""Runs a refinement alone on the GPU, and makes domains that show known materials."""

from dataclasses import replace

import numpy as np

from irpso_addon.capture.bounds import bounded
from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.phases.refinement import RefinementPhase
from irpso_addon.solver.settings.refinement_groups import Refinement
from irpso_addon.solver.settings.resolve import ResolvedRefinement
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import make_domain, makers, pack_layers, unit
from tests.oracles import confidence as confidence_oracle

SETTINGS = Refinement(iterations=1, starts=False, rounds=0, central_differences=True)
DELTA = 0.05


def schedule_of(loss="cauchy", **settings):
    """Return a schedule of a refinement alone."""
    refinement = replace(SETTINGS, **settings)
    return load_schedule("swarm").replaced(iterations=0, loss=loss, delta=DELTA, shadow=0.0, refinement=refinement)


class Bench:
    """A refinement of a domain on the GPU that starts from ``values``. scale: of every texel."""

    def __init__(self, model, domain, values, schedule, starts=(), entry="fragment", scale=1.0):
        context.ensure()
        self.model, self.domain = model, domain
        self.pack = pack = Packing(domain.solvable)
        scales = pack.pack(np.full(domain.shape, scale, np.float32))
        uploaded = DomainTextures(domain, pack, pack_layers(pack, domain.stack.values), scales)
        self.estimates = Estimates(model, {name: pack.pack(np.float32(v)) for name, v in values.items()})
        resolved = ResolvedRefinement(model.parameters, schedule.refinement, starts)
        self.refinement = RefinementPhase(resolved, PhaseContext(model, schedule, uploaded, self.estimates, entry))
        self.bands = Bands()

    def run(self, iterations=None):
        """Run to an iteration, or to the end; return name → (H, W, components) float64."""
        while not self.refinement.done and (iterations is None or self.refinement.iteration < iterations):
            for _ in self.refinement.advance(self.bands, 0.25):
                pass
        self.refinement.write_estimates_at_once()
        values = self.estimates.values()
        return {name: self.pack.unpack(v, np.nan).astype(np.float64) for name, v in values.items()}

    def close(self):
        self.refinement.close()


def refinements():
    """Yield a maker of ``Bench`` and close all at the end, for a fixture."""
    yield from makers(Bench)


def materials(model, shape, seed=0):
    """Return random materials well inside the ranges: normals within 30° of z, lobes ordered and distinct; float32."""
    rng, values = np.random.default_rng(seed), {}
    for p in model.parameters:
        low, width = p.range[0], p.range[1] - p.range[0]
        value = low + width * rng.uniform(0.25, 0.75, (*shape, p.components))
        values[p.name] = unit(rng.normal(size=(*shape, 3)) * 0.25 + (0, 0, 1)) if p.is_normal else value
    if model.ordered:
        first, second = model.ordered
        low, width = model.parameter(first).range[0], np.ptp(model.parameter(first).range)
        values[first] = low + width * rng.uniform(0.15, 0.35, (*shape, 1))
        values[second] = low + width * rng.uniform(0.45, 0.75, (*shape, 1))
    return {name: v.astype(np.float32).astype(np.float64) for name, v in values.items()}


def near(model, values, by, seed=5):
    """Return the values with random offsets of up to ``by`` of every range."""
    rng, off = np.random.default_rng(seed), {}
    for p in model.parameters:
        change = by * rng.uniform(-1, 1, values[p.name].shape)
        if p.is_normal:
            off[p.name] = unit(values[p.name] + change)
        else:
            off[p.name] = np.clip(values[p.name] + change * (p.range[1] - p.range[0]), *p.range)
    return {name: v.astype(np.float32).astype(np.float64) for name, v in off.items()}


def observed(model, values, shape, observations=40, noise=0.0, shadow=0.0, bounds=0.0, seed=2, **domain):
    """Return a domain that shows these materials, with noise and parts of its samples in shadow or lower bounds."""
    rng = np.random.default_rng(seed)
    made = make_domain(*shape, observations=observations, holes=False, **domain)
    stack = made.stack.values.copy()
    stack[..., :3] = confidence_oracle.radiance(made, model.name, values)
    stack[..., :3] += noise * rng.normal(size=stack[..., :3].shape)
    stack[..., :3] *= np.where(rng.random(stack.shape[:3]) < shadow, 0.1, 1.0)[..., None]
    stack[..., 3] = rng.random(stack.shape[:3]) < 0.9
    clipped = rng.random((*stack.shape[:3], 3)) < 0.05 * bounds
    stack[..., :3] *= np.where(clipped, rng.uniform(0.3, 1.2, clipped.shape), 1.0)
    stack[..., 3] = bounded(stack[..., 3], clipped)
    return with_samples(made, stack.astype(np.float32))
