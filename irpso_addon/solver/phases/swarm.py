"""What both kinds of swarms share: their bests, halos, state and constants."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.passes import Entry
from ...reflectance.model import ReflectanceModel
from ..kernels.encoding import build_encoding
from ..settings.resolve import ResolvedSwarm
from ..settings.schedule import Schedule
from ..state.reader import Reader
from ..state.textures import SOLVED, DomainTextures, Estimates, loss_constants, texel_states
from .phase import Phase

ALL_TOLD = 255  # a seed that knows of all eight dimensions


class SwarmPhase(Phase):
    """The swarms of a stage, a Phase. A kind of swarms brings ``textures``, ``passes`` and ``advance``."""

    def __init__(
        self,
        stage: ResolvedSwarm,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        domain: DomainTextures,
        estimates: Estimates,
        entry: Entry,
    ):
        self.stage, self.schedule, self.seed = stage, schedule, seed
        self.title, self.iterations = stage.title, stage.iterations
        self._domain, self._estimates = domain, estimates
        self.encoding = build_encoding(model, stage, schedule.swarm.normal)
        self.particles = particle_count(schedule, self.encoding.dimensions)
        self.width, self.height = domain.packing.width, domain.packing.height
        self.reader = Reader(entry)
        self._build(model, domain, entry)

    def _build(self, model: ReflectanceModel, domain: DomainTextures, entry: Entry) -> None:
        """Make ``textures`` and ``passes``, and set the ``iteration`` at which placing begins."""
        raise NotImplementedError

    @property
    def done(self) -> bool:
        """Whether all iterations have been made."""
        return self.iteration >= self.iterations

    @property
    def reach(self) -> int:
        """How many texels away the iteration that is next reads global bests."""
        return reach_at(self.schedule, self.iteration, self.iterations)

    def constants(self) -> dict[str, int | float]:
        """Return the push constants of the iteration that is next."""
        return swarm_constants(self.stage, self.schedule, self._domain, self.seed, self.iteration, self.particles)

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put the global bests into the resolved estimates, at once: it is cheap."""
        yield from self.textures.make()
        targets = self._estimates.resolved
        yield from bands.once(lambda: self.preview(targets), lambda: self.passes.resolve.fence(targets))

    def preview(self, targets: list[Any]) -> None:
        """Put the global bests into other textures."""
        self.passes.resolve.run(targets, self._inputs(), self.constants())

    def reached(self, threshold: float) -> bool:
        """Return whether every swarm of this tile has a fitness at or under the threshold h."""
        moved = texel_states(self._domain.domain) == SOLVED
        return bool((self.fitness()[moved] <= threshold).all())

    def fitness(self) -> np.ndarray:
        """Return (H, W) float32 over the domain: every swarm's best fitness; NaN where none is solved."""
        self.textures.ensure()
        return self._domain.packing.unpack(self.reader.read(self.textures.best_fitness)[..., 0], np.nan)

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: every swarm's best place, in [0, 1]; NaN where none is solved."""
        self.textures.ensure()
        packed = np.concatenate([self.reader.read(t) for t in self.textures.best_places], axis=-1)
        return self._domain.packing.unpack(packed[..., : self.encoding.dimensions], np.nan)

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n) places, and (M, n), as the bests of the texels that belong to other tiles."""
        self.textures.ensure()
        targets = self.textures.best_places
        packed = np.zeros((self.height, self.width, 4 * len(targets)), np.float32)
        packed[..., : self.encoding.dimensions] = self._domain.packing.pack(values, ghosts)
        given = {f"u_given_{b}": textures.upload(packed[..., 4 * b : 4 * b + 4]) for b in range(len(targets))}
        self.passes.take_halo.run(targets, {**given, **self._domain.textures}, self.constants())

    def state(self) -> dict[str, np.ndarray]:
        """Return all that the swarms remember."""
        self.textures.ensure()
        return {name: self.reader.read(texture) for name, texture in self.textures.remembered.items()}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Go on from what ``state`` returned at an iteration."""
        self.textures.restore(arrays)
        self.iteration = iteration

    def inherit(self, old: SwarmPhase) -> None:
        """Go on with the swarms of a stage that looks for the same, which is over then."""
        self.textures.stop()
        self.textures, old.textures, self.iteration = old.textures, None, old.iteration

    def close(self) -> None:
        """Free shaders and textures."""
        self.passes.close()
        self.reader.close()
        if self.textures is not None:
            self.textures.stop()
        self.textures = None

    def _inputs(self) -> dict[str, Any]:
        return {**self.textures.read_bindings(), **self._estimates.bindings(), **self._domain.textures}


def particle_count(schedule: Schedule, dimensions: int) -> int:
    """Return m, the particles of a swarm that searches so many dimensions."""
    swarm = schedule.swarm
    return max(swarm.particles, math.ceil(swarm.particles_per_dimension * dimensions))


def neighbour_constant(schedule: Schedule, iteration: int, iterations: int) -> float:
    """Return c3 of Eq. 2 at an iteration: falling to 0 at the fraction c3_until, or constant where that is 0."""
    swarm = schedule.swarm
    if swarm.c3_until == 0:
        return swarm.c3
    return swarm.c3 * max(0.0, 1 - max(iteration, 0) / (swarm.c3_until * iterations))


def reach_at(schedule: Schedule, iteration: int, iterations: int) -> int:
    """Return how many texels away an iteration reads global bests; placing reads none."""
    swarm = schedule.swarm
    if iteration < 0:
        return 0
    tries = swarm.neighbour_every > 0 and (iteration + 1) % swarm.neighbour_every == 0
    averages = neighbour_constant(schedule, iteration, iterations) != 0
    return max(swarm.neighbourhood // 2 if averages else 0, 1 if tries else 0)


def swarm_constants(
    stage: ResolvedSwarm,
    schedule: Schedule,
    domain: DomainTextures,
    seed: int,
    iteration: int,
    particles: int,
    told: int = ALL_TOLD,
) -> dict[str, int | float]:
    """Return the push constants of an iteration. told: a bit for each dimension that the seed knows something of."""
    swarm = schedule.swarm
    seeded = math.ceil(swarm.seeded * particles) if swarm.seed != "random" else 0
    if stage.cycle > 0 or swarm.seed == "given":
        seeded = max(1, seeded)  # a later cycle, or a finer level, must not lose what the one before has found
    return {
        "u_width": domain.packing.width,
        "u_height": domain.packing.height,
        "u_origin_x": domain.domain.origin[0],
        "u_origin_y": domain.domain.origin[1],
        "u_seed": seed,
        "u_iteration": iteration,
        "u_particle": iteration + particles,
        "u_seeded": seeded,
        "u_inertia": swarm.inertia,
        "u_constriction": swarm.constriction,
        "u_c1": swarm.c1,
        "u_c2": swarm.c2,
        "u_c3": neighbour_constant(schedule, iteration, stage.iterations),
        "u_v_max": swarm.v_max,
        "u_threshold": schedule.threshold,
        **loss_constants(domain, schedule.fitness.delta),
        "u_seeded_dimensions": told,
        "u_seed_spread": swarm.seed_spread,
        "u_start_speed": swarm.start_speed,
    }
