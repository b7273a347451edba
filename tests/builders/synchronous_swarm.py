"""A phase of synchronous swarms on the GPU, with the problem of its float64 oracle."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.phases.synchronous_swarm import SynchronousSwarmPhase
from irpso_addon.solver.settings.resolve import particle_count, resolve
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import make_domain, makers, pack_layers, unit
from tests.oracles import random_numbers as numbers
from tests.oracles import swarm
from tests.oracles import synchronous_swarm as oracle


@dataclass(frozen=True)
class Case:
    """A phase to compare: model, parameters, domain, settings, fixed parameters."""

    name: str
    search: tuple[str, ...] = ("all",)
    shape: tuple[int, int] = (7, 9)
    model: str = "lambert"
    domain: dict = field(default_factory=dict)
    settings: dict = field(default_factory=dict)
    fixed: frozenset = frozenset()
    iterations: int = 3

    def __str__(self) -> str:
        return self.name


class Bench:
    """A phase on the GPU and its oracle, from random estimates or ``estimates``. domain: in place of the case's own."""

    def __init__(self, case: Case, entry: str = "fragment", seed: int = 7, domain=None, estimates=None):
        context.ensure()
        self.model = load_model(case.model)
        settings = {"prefit_iterations": 0, "refinement_iterations": 0, "prior_rounds": 0, **case.settings}
        self.schedule = load_schedule("standard").replaced(search=case.search, iterations=40, **settings)
        self.domain = domain or make_domain(*case.shape, **case.domain)
        self.rng = rng = np.random.default_rng(seed)
        scale = rng.uniform(0.5, 2, size=self.domain.shape).astype(np.float32)
        made = random_material(self.model, self.domain.shape, rng)
        self.values = {**made, **(estimates or {})}
        stage = resolve(self.schedule, self.model, set(case.fixed))[0]
        self.packing = pack = Packing(self.domain.solvable)
        self.textures = DomainTextures(self.domain, pack, pack_layers(pack, self.domain.stack.values), pack.pack(scale))
        self.estimates = Estimates(self.model, {name: pack.pack(value) for name, value in self.values.items()})
        shared = PhaseContext(self.model, self.schedule, self.textures, self.estimates, entry)
        self.stage = SynchronousSwarmPhase(stage, shared, seed)
        count = particle_count(self.schedule, stage.dimensions(self.schedule.swarm.normal))
        self.problem = oracle.SynchronousSwarm(
            self.domain, self.model, stage, self.schedule, self.values, scale.astype(np.float64), count, seed
        )
        self.bands = Bands()

    def randomise(self) -> None:
        """Set a random position, velocity and best of every particle; about half of the bests will improve."""
        problem, rng = self.problem, self.rng
        shape = (problem.particles, *problem.domain.shape)
        # Most stay off the walls, where a normal is at the horizon.
        x, p = (rng.uniform(0.15, 0.85, size=(*shape, problem.columns)) for _ in range(2))
        v = rng.uniform(-0.25, 0.25, size=x.shape)
        x, v = swarm.ordered_lobes(problem, x, v)
        g = rng.uniform(0.15, 0.85, size=x.shape[1:])
        w = np.zeros((*shape[1:], len(problem.weights)))
        for i, (_, _, low, high) in enumerate(problem.weights):
            w[..., i] = low + (high - low) * rng.uniform(0.1, 0.9, shape[1:])
        typical = oracle.fitness(problem, problem.material(g, w))
        typical = np.where(typical < 1e29, typical, 1.0)
        fits = typical * rng.uniform(0.5, 1.5, shape)
        self.give(oracle.State(x, v, p, fits, g, typical * rng.uniform(0.2, 1, shape[1:]), w))

    def give(self, state: oracle.State) -> None:
        """Write ``state`` to the GPU."""
        atlas, blocks = self.stage.textures.atlas, self.stage.encoding.blocks
        arrays = particle_arrays(state, self.packing, atlas, blocks)
        g, w = self.packing.pack(state.g), self.packing.pack(state.w)
        w = np.pad(w, ((0, 0), (0, 0), (0, -w.shape[-1] % 4)))
        best = [g[..., 4 * b : 4 * b + 4] for b in range(blocks)]
        best += [w[..., 4 * b : 4 * b + 4] for b in range(w.shape[-1] // 4)]
        best.append(self.packing.pack(state.g_fitness)[..., None])
        self.stage.restore({**arrays, **{f"global_best_{i}": a for i, a in enumerate(best)}}, self.stage.iteration)

    def read(self) -> oracle.State:
        """Return the state on the GPU; 0, with a fitness of UNFIT, where no texel is solved."""
        stage, pack, problem = self.stage, self.packing, self.problem
        arrays = {name: array.astype(np.float64) for name, array in stage.state().items()}
        sizes = (problem.particles, pack.height, pack.width)
        x, v, p = (
            np.stack([pack.unpack(one) for one in numbers.from_atlas(arrays[name], *sizes, problem.columns)])
            for name in ("position", "velocity", "best")
        )
        fitness = numbers.from_atlas(arrays["fitness"], *sizes, 1)[..., 0]
        fitness = np.stack([pack.unpack(one, swarm.UNFIT) for one in fitness])
        blocks, linear = stage.encoding.blocks, stage.linear.blocks
        g, w = (
            pack.unpack(np.concatenate([arrays[f"global_best_{b}"] for b in some] or [np.zeros((*sizes[1:], 0))], -1))
            for some in (range(blocks), range(blocks, blocks + linear))
        )
        g_fitness = pack.unpack(arrays[f"global_best_{blocks + linear}"][..., 0], swarm.UNFIT)
        return oracle.State(x, v, p, fitness, g, g_fitness, w[..., : len(problem.weights)])

    def found_fitness(self) -> np.ndarray:
        """Return (m, H, W): the fitness of every particle after the last iteration."""
        fitness = self.stage.read("found_fitness").astype(np.float64)
        fits = np.moveaxis(fitness, -1, 0)[: self.stage.particles]
        return np.stack([self.packing.unpack(one, swarm.UNFIT) for one in fits])

    def found_weights(self) -> np.ndarray:
        """Return (H, W, L): the linear weights of the best particle of the last iteration."""
        weights = self.stage.read("found_linear").astype(np.float64)
        return self.packing.unpack(weights)[..., : len(self.problem.weights)]

    def advance(self) -> None:
        """Run one iteration."""
        for _ in self.stage.advance(self.bands, 1.0):
            pass

    def close(self) -> None:
        """Free the GPU resources."""
        self.stage.close()


def particle_arrays(state, packing, atlas, blocks) -> dict[str, np.ndarray]:
    """Return name → atlas of the particles of a swarm's state."""
    fits = np.concatenate([state.p_fitness] * blocks)[..., None]
    particles = {"position": state.x, "velocity": state.v, "best": state.p, "fitness": fits}
    packed = {name: np.stack([packing.pack(one) for one in array]) for name, array in particles.items()}
    return {name: numbers.to_atlas(array, atlas.across, atlas.down) for name, array in packed.items()}


def random_material(model, shape, rng) -> dict[str, np.ndarray]:
    """Return float32 values of every parameter, inside the ranges."""
    values = {}
    for p in model.parameters:
        value = p.range[0] + (p.range[1] - p.range[0]) * rng.uniform(0.05, 0.95, size=(*shape, p.components))
        value = unit(value * (1, 1, 0) + (0, 0, 1)) if p.is_normal else value
        values[p.name] = value.astype(np.float32)
    return values


def benches():
    """Yield a maker of ``Bench`` and close all at the end, for a fixture."""
    yield from makers(Bench)
