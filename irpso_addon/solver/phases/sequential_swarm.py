"""Sequential swarms, the paper's: an iteration moves one random particle of every swarm."""

from __future__ import annotations

from collections.abc import Iterator

from ...gpu.bands import Bands
from ...gpu.kernel import Entry
from ..kernels.sequential_swarm import SequentialSwarmPasses, build_sequential_swarm_passes
from ..state.phase_textures import PhaseTextures, sequential_swarm_table
from .swarm import SwarmPhase


class SequentialSwarmPhase(SwarmPhase):
    """A Phase. ``iteration`` counts from −particles: each of these iterations places one particle of every swarm."""

    evaluations = 1
    passes: SequentialSwarmPasses

    def _build(self, entry: Entry) -> None:
        table = sequential_swarm_table(self.particles, self.encoding.blocks)
        self.textures = PhaseTextures(table, self.width, self.height)
        self.passes = build_sequential_swarm_passes(
            self.model, self.encoding, self.schedule, self.particles, self.textures.atlas.across, self.domain.defines,
            entry,
        )  # fmt: skip
        self.iteration = -self.particles

    @property
    def has_result(self) -> bool:
        """Whether the first particle of every swarm is initialised."""
        return self.iteration > -self.particles

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each band."""
        yield from self.textures.make()
        passes, constants, inputs = self.passes, self.constants(), self._inputs()
        name, move = ("place", passes.start) if self.iteration < 0 else ("move", passes.move)
        candidates = self.textures.of("candidates", "verdict")
        yield from move.in_bands(name, bands, seconds, candidates, inputs, constants, counted=True)
        for name, commit, groups in (
            ("state", passes.commit_state, ("position", "velocity")),
            ("personal", passes.commit_personal, ("best", "fitness")),
            ("global", passes.commit_global, ("global_best", "global_fitness")),
        ):
            yield from commit.in_bands(name, bands, seconds, self.textures.of(*groups), inputs, constants)
        self.iteration += 1
