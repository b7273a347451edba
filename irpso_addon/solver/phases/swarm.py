"""Common parts of both kinds of swarms: results, halos, push constants."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.kernel import Entry
from ...gpu.textures import Texture
from ..kernels.encoding import build_encoding
from ..kernels.sequential_swarm import SequentialSwarmPasses
from ..kernels.synchronous_swarm import SynchronousSwarmPasses
from ..settings.resolve import ResolvedSwarm, particle_count
from ..settings.schedule import Schedule
from ..state.textures import loss_constants
from .phase import PhaseContext, TexturePhase


class SwarmPhase(TexturePhase):
    """The swarms of a stage. A subclass implements ``_build`` and ``advance``.

    start_dimensions: bit mask of the dimensions that start near the estimate; all eight unless a subclass sets another.
    """

    passes: SequentialSwarmPasses | SynchronousSwarmPasses
    start_dimensions = 0xFF

    def __init__(self, stage: ResolvedSwarm, context: PhaseContext, seed: int):
        super().__init__(stage, context)
        self.stage, self.seed = stage, seed
        self.encoding = build_encoding(self.model, stage, self.schedule.swarm.normal)
        self.particles = particle_count(self.schedule, self.encoding.dimensions)
        self.width, self.height = self.domain.packing.width, self.domain.packing.height
        self._build(context.entry)

    def _build(self, entry: Entry) -> None:
        """Make ``textures`` and ``passes``; set the first ``iteration``."""
        raise NotImplementedError

    @property
    def stencil_radius(self) -> int:
        """Distance, in texels, at which the next iteration reads global bests."""
        return stencil_radius_at(self.schedule, self.iteration, self.iterations)

    def constants(self) -> dict[str, int | float]:
        """Return the push constants of the next iteration."""
        swarm, domain = self.schedule.swarm, self.domain
        starting = math.ceil(swarm.start_fraction * self.particles) if swarm.start != "random" else 0
        if self.stage.cycle > 0 or swarm.start == "given":
            starting = max(1, starting)  # a later cycle or a finer level must keep the previous result
        return {
            "u_width": self.width,
            "u_height": self.height,
            "u_origin_x": domain.domain.origin[0],
            "u_origin_y": domain.domain.origin[1],
            "u_seed": self.seed,
            "u_iteration": self.iteration,
            "u_particle": self.iteration + self.particles,
            "u_start_count": starting,
            "u_inertia": swarm.inertia,
            "u_constriction": swarm.constriction,
            "u_c1": swarm.c1,
            "u_c2": swarm.c2,
            "u_c3": neighbour_constant(self.schedule, self.iteration, self.iterations),
            "u_v_max": swarm.v_max,
            "u_threshold": self.schedule.threshold,
            **loss_constants(domain, self.schedule.fitness.delta),
            "u_start_dimensions": self.start_dimensions,
            "u_start_spread": swarm.start_spread,
            "u_start_speed": swarm.start_speed,
        }

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the global bests into the next estimates, in one band: it is a short pass."""
        yield from self.textures.make()
        targets = self.estimates.next
        yield from self.passes.decode_best.in_one_draw(bands, targets, self._inputs(), self.constants())

    def preview(self, targets: Sequence[Texture]) -> None:
        """Write the global bests into other textures."""
        self.passes.decode_best.run(targets, self._inputs(), self.constants())

    def fitness(self) -> np.ndarray:
        """Return (H, W) float32 over the domain: every swarm's best fitness; NaN where no texel is solved."""
        return self.domain.packing.unpack(self.read("global_fitness")[..., 0], np.nan)

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: every swarm's best position in [0, 1]; NaN where none is solved."""
        return self.domain.packing.unpack(self.read("global_best")[..., : self.encoding.dimensions], np.nan)

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Set (H, W, n) positions, and (M, n) of the ghosts, as the bests of texels of other tiles."""
        self.textures.ensure()
        targets = self.textures.of("global_best")
        packed = np.zeros((self.height, self.width, 4 * len(targets)), np.float32)
        packed[..., : self.encoding.dimensions] = self.domain.packing.pack(values, ghosts)
        received = {f"u_given_{b}": textures.upload(packed[..., 4 * b : 4 * b + 4]) for b in range(len(targets))}
        self.passes.take_halo.run(targets, {**received, **self.domain.textures}, self.constants())

    def inherit(self, old: SwarmPhase) -> None:
        """Continue with the swarms of a phase that searches the same parameters; the old phase then loses them."""
        self.textures, old.textures, self.iteration = old.textures, self.textures, old.iteration


def neighbour_constant(schedule: Schedule, iteration: int, iterations: int) -> float:
    """Return c3 of Eq. 2 at an iteration: falling to 0 at the fraction c3_fade, or constant where that is 0."""
    swarm = schedule.swarm
    if swarm.c3_fade == 0:
        return swarm.c3
    return swarm.c3 * max(0.0, 1 - max(iteration, 0) / (swarm.c3_fade * iterations))


def stencil_radius_at(schedule: Schedule, iteration: int, iterations: int) -> int:
    """Return the distance, in texels, at which an iteration reads global bests; 0 while particles are initialised."""
    swarm = schedule.swarm
    if iteration < 0:
        return 0
    tries = swarm.neighbour_interval > 0 and (iteration + 1) % swarm.neighbour_interval == 0
    averages = neighbour_constant(schedule, iteration, iterations) != 0
    return max(swarm.neighbourhood // 2 if averages else 0, 1 if tries else 0)
