"""Swarms that move as a whole: every iteration evaluates all particles, with linear weights in closed form."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...gpu import context, textures
from ...gpu.bands import Bands
from ...gpu.passes import Entry
from ...reflectance.model import ReflectanceModel
from ..kernels.linear_weights import LinearWeights, linear_weights
from ..kernels.synchronous_swarm import MAX_PARTICLES, build_synchronous_swarm_passes
from ..state.textures import UNFIT, DomainTextures, IncrementalAllocation, plan_atlas
from .swarm import ALL_TOLD, SwarmPhase, swarm_constants


class SynchronousSwarmPhase(SwarmPhase):
    """The swarms of a stage that move as a whole, a Phase. Iteration −1 places all particles.

    State is kept twice: an iteration reads the old one and writes the new one, then they change places.
    """

    def _build(self, model: ReflectanceModel, domain: DomainTextures, entry: Entry) -> None:
        self.linear = linear_weights(model, self.stage.solved)
        _check(self.particles)
        self.textures = SynchronousSwarmTextures(
            self.width, self.height, self.particles, self.encoding.blocks, self.linear
        )
        across = self.textures.atlas.across
        self.passes = build_synchronous_swarm_passes(
            model, self.encoding, self.linear, self.schedule, self.particles, across, domain.defines, entry
        )
        self.iteration = -1

    @property
    def evaluations(self) -> int:
        """Renders of all observations that an iteration makes at each texel: two a particle where weights are solved.

        Rendering the best once for every few particles, to weigh the samples, comes on top.
        """
        return self.particles * (2 if self.linear.blocks else 1)

    @property
    def placed(self) -> bool:
        """Whether the particles have been placed."""
        return self.iteration >= 0

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each. Counts up when it is whole."""
        yield from self.textures.make()
        held, passes, constants = self.textures, self.passes, self.constants()
        inputs = self._inputs()
        found = {**inputs, **held.found_bindings()}
        if self.iteration < 0:
            steps = ("place", passes.place), ("place commit", passes.place_commit), ("place best", passes.place_best)
        else:
            steps = ("synchronous", passes.move), ("commit", passes.commit), ("best", passes.best)
            if constants["u_c3"] != 0:
                yield from passes.mean.in_bands("mean", bands, seconds, held.mean, inputs, constants)
        (name, find), *commits = steps
        yield from find.in_bands(name, bands, seconds, held.found, inputs, constants, counted=True)
        for (name, work), targets in zip(commits, (held.spare_state, held.spare_bests), strict=True):
            yield from work.in_bands(name, bands, seconds, targets, found, constants)
        held.swap()
        self.iteration += 1

    def constants(self) -> dict[str, int | float]:
        """Return the push constants of the iteration that is next."""
        told = ALL_TOLD if self.schedule.swarm.seed == "given" else self.encoding.lambert_tells
        return swarm_constants(
            self.stage, self.schedule, self._domain, self.seed, self.iteration, self.particles, told
        )  # fmt: skip


class SynchronousSwarmTextures(IncrementalAllocation):
    """All that the swarms of one stage remember, twice, and what a generation finds.

    state: position, velocity, best, fitness in atlases. bests: global best places, their linear weights, fitness.
    found: fitness of every particle, four a texture, and the linear weights of the best of them.
    """

    def __init__(self, width: int, height: int, particles: int, blocks: int, linear: LinearWeights):
        super().__init__()
        self.atlas = plan_atlas(width, height, particles * blocks, context.max_texture_size())
        self._blocks, self._linear, self._fours = blocks, linear.blocks, -(-particles // 4)
        self._small = width, height

    def _make(self) -> Iterator[None]:
        small, blocks, linears = self._small, self._blocks, self._linear
        large = small[0] * self.atlas.across, small[1] * self.atlas.down
        self.state, self.spare_state, self.bests, self.spare_bests = [], [], [], []
        for kind in ("RGBA32F", "RGBA32F", "RGBA32F", "R32F"):
            self.state.append(textures.empty(*large, kind, value=0.0))
            yield
            self.spare_state.append(textures.empty(*large, kind))
            yield
        for kind in ["RGBA32F"] * (blocks + linears) + ["R32F"]:
            for held in (self.bests, self.spare_bests):
                held.append(textures.empty(*small, kind, value=UNFIT if kind == "R32F" else 0.5))
            yield
        self.found = [textures.empty(*small) for _ in range(self._fours + linears)]
        yield
        self.mean = [textures.empty(*small, value=0.0) for _ in range(blocks)]
        yield

    def swap(self) -> None:
        """Make the generation that was written the current one."""
        self.state, self.spare_state = self.spare_state, self.state
        self.bests, self.spare_bests = self.spare_bests, self.bests

    @property
    def best_places(self) -> list[Any]:
        """The textures of the global bests' places."""
        return self.bests[: self._blocks]

    @property
    def best_fitness(self) -> Any:
        """The texture of the global bests' fitness."""
        return self.bests[-1]

    @property
    def remembered(self) -> dict[str, Any]:
        """The textures that outlive an iteration, by name: what a checkpoint holds."""
        names = ("position", "velocity", "best", "fitness")
        return {
            **dict(zip(names, self.state, strict=True)),
            **{f"global_best_{i}": texture for i, texture in enumerate(self.bests)},
        }

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Take the contents that ``remembered`` had, from arrays of the same names."""
        self.ensure()
        self.state = [textures.upload(arrays[name]) for name in ("position", "velocity", "best", "fitness")]
        self.bests = [textures.upload(arrays[f"global_best_{i}"]) for i in range(len(self.bests))]

    def read_bindings(self) -> dict[str, Any]:
        """Return by sampler name what is remembered."""
        weights = self.bests[self._blocks : -1]
        return {
            **{f"u_particle_{name}": texture for name, texture in list(self.remembered.items())[:4]},
            **{f"u_best_{i}": texture for i, texture in enumerate(self.best_places)},
            **{f"u_best_linear_{i}": texture for i, texture in enumerate(weights)},
            **{f"u_mean_{i}": texture for i, texture in enumerate(self.mean)},
            "u_best_fitness": self.best_fitness,
        }

    def found_bindings(self) -> dict[str, Any]:
        """Return by sampler name what a generation has found."""
        return {
            **{f"u_fitness_{i}": texture for i, texture in enumerate(self.found[: self._fours])},
            **{f"u_linear_{i}": texture for i, texture in enumerate(self.found[self._fours :])},
        }


def _check(particles: int) -> None:
    if particles > MAX_PARTICLES:
        raise InputError(
            f'particles: update = "all" moves at most {MAX_PARTICLES} together, not {particles}; lower particles or'
            " particles_per_dimension"
        )
