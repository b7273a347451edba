"""One stage under way: its swarms, placed and then moved iteration by iteration in lock step."""

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
from ..kernels.kernels import build_sequential_swarm_passes
from ..settings.resolve import ResolvedSwarm
from ..settings.schedule import Schedule
from ..state.reader import Reader
from ..state.textures import SOLVED, DomainTextures, Estimates, SwarmTextures, loss_constants, texel_states
from .phase import Phase

ALL_TOLD = 255  # a seed that knows of all eight dimensions


class SequentialSwarmPhase(Phase):
    """The swarms of a stage, a Phase. ``iteration`` counts from −particles, while it places one particle of each."""

    evaluations = 1  # one particle of each swarm moves

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
        width, height = domain.packing.width, domain.packing.height
        self.width, self.height = width, height
        self.swarm = SwarmTextures(width, height, self.particles, self.encoding)
        self.passes = build_sequential_swarm_passes(
            model, self.encoding, schedule, self.particles, self.swarm.atlas.across, domain.defines, entry
        )
        self.reader = Reader(entry)
        self.iteration = -self.particles

    @property
    def done(self) -> bool:
        """Whether all iterations have been made."""
        return self.iteration >= self.iterations

    @property
    def reach(self) -> int:
        """How many texels away the iteration that is next reads global bests."""
        return reach_at(self.schedule, self.iteration, self.iterations)

    @property
    def placed(self) -> bool:
        """Whether the first particle of every swarm has been placed."""
        return self.iteration > -self.particles

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each. Counts up when it is whole."""
        yield from self.swarm.make()
        swarm = self.swarm
        constants = self.constants()
        placing = self.iteration < 0
        candidate = {**swarm.read_bindings(), **self._estimates.bindings(), **self._domain.textures}
        steps = (
            ("place" if placing else "move", self.passes.start if placing else self.passes.move,
             [*swarm.candidates, swarm.verdict], candidate),
            ("state", self.passes.commit_state, [swarm.position, swarm.velocity], swarm.candidate_bindings()),
            ("personal", self.passes.commit_personal, [swarm.best, swarm.fitness], swarm.candidate_bindings()),
            ("global", self.passes.commit_global, [*swarm.global_best, swarm.global_fitness],
             swarm.candidate_bindings()),
        )  # fmt: skip
        for name, work, targets, inputs in steps:
            yield from bands.run(
                name,
                targets[0].height,
                seconds,
                lambda rows, work=work, targets=targets, inputs=inputs: work.run(targets, inputs, constants, rows),
                lambda work=work, targets=targets: work.fence(targets),
                counted=name in ("place", "move"),
            )
        self.iteration += 1

    def constants(self) -> dict[str, int | float]:
        """Return the push constants of the iteration that is next."""
        return swarm_constants(self.stage, self.schedule, self._domain, self.seed, self.iteration, self.particles)

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put the global bests into the resolved estimates, at once: it is cheap."""
        yield from self.swarm.make()
        targets = self._estimates.resolved
        yield from bands.once(lambda: self.preview(targets), lambda: self.passes.resolve.fence(targets))

    def preview(self, targets: list[Any]) -> None:
        """Put the global bests into other textures."""
        inputs = {**self.swarm.best_bindings(), **self._estimates.bindings(), **self._domain.textures}
        self.passes.resolve.run(targets, inputs, self.constants())

    def reached(self, threshold: float) -> bool:
        """Return whether every swarm of this tile has a fitness at or under the threshold h."""
        moved = texel_states(self._domain.domain) == SOLVED
        return bool((self.global_fitness()[moved] <= threshold).all())

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: every swarm's best place, in [0, 1]; NaN where none is solved."""
        self.swarm.ensure()
        packed = np.concatenate([self.reader.read(t) for t in self.swarm.global_best], axis=-1)
        return self._domain.packing.unpack(packed[..., : self.encoding.dimensions], np.nan)

    def global_fitness(self) -> np.ndarray:
        """Return (H, W) float32 over the domain: every swarm's best fitness; NaN where none is solved."""
        self.swarm.ensure()
        return self._domain.packing.unpack(self.reader.read(self.swarm.global_fitness)[..., 0], np.nan)

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n) places, and (M, n), as the bests of the texels that belong to other tiles."""
        self.swarm.ensure()
        packed = np.zeros((self.height, self.width, 4 * self.encoding.blocks), np.float32)
        packed[..., : self.encoding.dimensions] = self._domain.packing.pack(values, ghosts)
        given = {f"u_given_{b}": textures.upload(packed[..., 4 * b : 4 * b + 4]) for b in range(self.encoding.blocks)}
        self.passes.take_halo.run(self.swarm.global_best, {**given, **self._domain.textures}, self.constants())

    def state(self) -> dict[str, np.ndarray]:
        """Return all that the swarms remember."""
        self.swarm.ensure()
        return {name: self.reader.read(texture) for name, texture in self.swarm.remembered.items()}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Go on from what ``state`` returned at an iteration."""
        self.swarm.restore(arrays)
        self.iteration = iteration

    def inherit(self, old: SequentialSwarmPhase) -> None:
        """Go on with the swarms of a stage that looks for the same, which is over then."""
        self.swarm.stop()
        self.swarm, old.swarm, self.iteration = old.swarm, None, old.iteration

    def close(self) -> None:
        """Free shaders and textures."""
        self.passes.close()
        self.reader.close()
        if self.swarm is not None:
            self.swarm.stop()
        self.swarm = None


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
        "u_seed_tells": told,
        "u_seed_spread": swarm.seed_spread,
        "u_start_speed": swarm.start_speed,
    }
