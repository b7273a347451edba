"""Swarms of which one random particle moves an iteration, in lock step: the paper's."""

from __future__ import annotations

from collections.abc import Iterator

from ...gpu.bands import Bands
from ...gpu.passes import Entry
from ...reflectance.model import ReflectanceModel
from ..kernels.kernels import build_sequential_swarm_passes
from ..state.textures import DomainTextures, SwarmTextures
from .swarm import SwarmPhase


class SequentialSwarmPhase(SwarmPhase):
    """The swarms of a stage, a Phase. ``iteration`` counts from −particles, while it places one particle of each."""

    evaluations = 1  # one particle of each swarm moves

    def _build(self, model: ReflectanceModel, domain: DomainTextures, entry: Entry) -> None:
        self.textures = SwarmTextures(self.width, self.height, self.particles, self.encoding)
        self.passes = build_sequential_swarm_passes(
            model, self.encoding, self.schedule, self.particles, self.textures.atlas.across, domain.defines, entry
        )
        self.iteration = -self.particles

    @property
    def placed(self) -> bool:
        """Whether the first particle of every swarm has been placed."""
        return self.iteration > -self.particles

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each. Counts up when it is whole."""
        yield from self.textures.make()
        held, passes, constants = self.textures, self.passes, self.constants()
        name, move = ("place", passes.start) if self.iteration < 0 else ("move", passes.move)
        candidates = [*held.candidates, held.verdict]
        yield from move.in_bands(name, bands, seconds, candidates, self._inputs(), constants, counted=True)
        for name, work, targets in (
            ("state", passes.commit_state, [held.position, held.velocity]),
            ("personal", passes.commit_personal, [held.best, held.fitness]),
            ("global", passes.commit_global, [*held.best_places, held.best_fitness]),
        ):
            yield from work.in_bands(name, bands, seconds, targets, held.candidate_bindings(), constants)
        self.iteration += 1
