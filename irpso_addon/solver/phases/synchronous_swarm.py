"""Synchronous swarms: an iteration moves and evaluates all particles, with linear weights in closed form."""

from __future__ import annotations

from collections.abc import Iterator

from ...gpu.bands import Bands
from ...gpu.kernel import Entry
from ..kernels.linear_weights import linear_weights
from ..kernels.synchronous_swarm import SynchronousSwarmPasses, build_synchronous_swarm_passes
from ..state.phase_textures import GLOBAL_BESTS, PARTICLES, PhaseTextures, synchronous_swarm_table
from .swarm import SwarmPhase


class SynchronousSwarmPhase(SwarmPhase):
    """A Phase. Iteration −1 places all particles."""

    passes: SynchronousSwarmPasses

    def _build(self, entry: Entry) -> None:
        self.linear = linear_weights(self.model, self.stage.solved)
        table = synchronous_swarm_table(self.particles, self.encoding.blocks, self.linear.blocks)
        self.textures = PhaseTextures(table, self.width, self.height)
        self.passes = build_synchronous_swarm_passes(
            self.model, self.encoding, self.linear, self.schedule, self.particles, self.textures.atlas.across,
            self.domain.defines, entry,
        )  # fmt: skip
        self.iteration = -1
        if self.schedule.swarm.start != "given":
            self.start_dimensions = self.encoding.lambert_dimensions

    @property
    def evaluations(self) -> int:
        """Renders of all observations per texel and iteration: two per particle where linear weights are solved.

        Not counted: renders of the best, one per few particles, that give the samples' robust weights.
        """
        return self.particles * (2 if self.linear.blocks else 1)

    @property
    def has_result(self) -> bool:
        """Whether the particles are initialised."""
        return self.iteration >= 0

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each band."""
        yield from self.textures.make()
        textures, passes, constants, inputs = self.textures, self.passes, self.constants(), self._inputs()
        if self.iteration < 0:
            steps = ("place", passes.place), ("place commit", passes.place_commit), ("place best", passes.place_best)
        else:
            steps = ("synchronous", passes.move), ("commit", passes.commit), ("best", passes.best)
            if constants["u_c3"] != 0:
                yield from passes.mean.in_bands("mean", bands, seconds, textures.of("mean"), inputs, constants)
        (name, evaluate), *commits = steps
        targets = textures.of("found_fitness", "found_linear")
        yield from evaluate.in_bands(name, bands, seconds, targets, inputs, constants, counted=True)
        for (name, commit), groups in zip(commits, (PARTICLES, GLOBAL_BESTS), strict=True):
            yield from commit.in_bands(name, bands, seconds, textures.spares(*groups), inputs, constants)
        textures.swap(*PARTICLES, *GLOBAL_BESTS)
        self.iteration += 1
