"""A stage whose swarms move as a whole: every iteration evaluates all particles, with linear weights in closed form."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...core.errors import InputError
from ...gpu import context, textures
from ...gpu.bands import Bands
from ...gpu.passes import Entry
from ...reflectance.model import ReflectanceModel
from ..kernels.encoding import build_encoding
from ..kernels.linear_weights import LinearWeights, linear_weights
from ..kernels.synchronous_swarm import MAX_PARTICLES, build_synchronous_swarm_passes
from ..settings.resolve import ResolvedSwarm
from ..settings.schedule import Schedule
from ..state.reader import Reader
from ..state.textures import SOLVED, UNFIT, DomainTextures, Estimates, IncrementalAllocation, plan_atlas, texel_states
from .phase import Phase
from .sequential_swarm import ALL_TOLD, particle_count, reach_at, swarm_constants


class SynchronousSwarmPhase(Phase):
    """The swarms of a stage that move as a whole, a Phase. Iteration −1 places all particles.

    State is kept twice: a generation is judged from the old one and written into the new one, then they change places.
    """

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
        self.linear = linear_weights(model, stage.solved)
        self.particles = _checked(particle_count(schedule, self.encoding.dimensions))
        self.width, self.height = domain.packing.width, domain.packing.height
        self.textures = SynchronousSwarmTextures(
            self.width, self.height, self.particles, self.encoding.blocks, self.linear
        )
        self.passes = build_synchronous_swarm_passes(
            model,
            self.encoding,
            self.linear,
            schedule,
            self.particles,
            self.textures.atlas.across,
            domain.defines,
            entry,
        )
        self.reader = Reader(entry)
        self.iteration = -1

    @property
    def done(self) -> bool:
        """Whether all iterations have been made."""
        return self.iteration >= self.iterations

    @property
    def evaluations(self) -> int:
        """Renders of all observations that an iteration makes at each texel: two a particle where weights are solved.

        Rendering the best once for every few particles, to weigh the samples, comes on top.
        """
        return self.particles * (2 if self.linear.blocks else 1)

    @property
    def reach(self) -> int:
        """How many texels away the iteration that is next reads global bests."""
        return reach_at(self.schedule, self.iteration, self.iterations)

    @property
    def placed(self) -> bool:
        """Whether the particles have been placed."""
        return self.iteration >= 0

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each. Counts up when it is whole."""
        yield from self.textures.make()
        old, passes, constants = self.textures, self.passes, self.constants()
        placing = self.iteration < 0
        inputs = {**old.read_bindings(), **self._estimates.bindings(), **self._domain.textures}
        judged = {**inputs, **old.found_bindings()}
        find, commit, best = (
            (passes.place, passes.place_commit, passes.place_best)
            if placing
            else (passes.move, passes.commit, passes.best)
        )
        steps = [
            ("place" if placing else "synchronous", find, old.found, inputs),
            ("place commit" if placing else "commit", commit, old.spare_state, judged),
            ("place best" if placing else "best", best, old.spare_bests, judged),
        ]
        if constants["u_c3"] != 0 and not placing:
            steps.insert(0, ("mean", passes.mean, old.mean, inputs))
        for name, work, targets, given in steps:
            yield from bands.run(
                name,
                targets[0].height,
                seconds,
                lambda rows, work=work, targets=targets, given=given: work.run(targets, given, constants, rows),
                lambda work=work, targets=targets: work.fence(targets),
                counted=work is find,
            )
        old.swap()
        self.iteration += 1

    def constants(self) -> dict[str, int | float]:
        """Return the push constants of the iteration that is next."""
        told = ALL_TOLD if self.schedule.swarm.seed == "given" else self.encoding.lambert_tells
        return swarm_constants(
            self.stage, self.schedule, self._domain, self.seed, self.iteration, self.particles, told
        )  # fmt: skip

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put the global bests and their linear weights into the resolved estimates, at once: it is cheap."""
        yield from self.textures.make()
        targets = self._estimates.resolved
        yield from bands.once(lambda: self.preview(targets), lambda: self.passes.resolve.fence(targets))

    def preview(self, targets: list[Any]) -> None:
        """Put the global bests and their linear weights into other textures."""
        inputs = {**self.textures.read_bindings(), **self._estimates.bindings(), **self._domain.textures}
        self.passes.resolve.run(targets, inputs, self.constants())

    def reached(self, threshold: float) -> bool:
        """Return whether every swarm of this tile has a fitness at or under the threshold h."""
        moved = texel_states(self._domain.domain) == SOLVED
        return bool((self._domain.packing.unpack(self.fitness())[moved] <= threshold).all())

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: every swarm's best place, in [0, 1]; NaN where none is solved."""
        self.textures.ensure()
        packed = np.concatenate([self.reader.read(t) for t in self.textures.bests[: self.encoding.blocks]], axis=-1)
        return self._domain.packing.unpack(packed[..., : self.encoding.dimensions], np.nan)

    def fitness(self) -> np.ndarray:
        """Return (h, w) float32, packed as the domain's textures: every swarm's best fitness."""
        self.textures.ensure()
        return self.reader.read(self.textures.bests[-1])[..., 0]

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n) places, and (M, n), as the bests of the texels that belong to other tiles."""
        self.textures.ensure()
        packed = np.zeros((self.height, self.width, 4 * self.encoding.blocks), np.float32)
        packed[..., : self.encoding.dimensions] = self._domain.packing.pack(values, ghosts)
        given = {f"u_given_{b}": textures.upload(packed[..., 4 * b : 4 * b + 4]) for b in range(self.encoding.blocks)}
        targets = self.textures.bests[: self.encoding.blocks]
        self.passes.take_halo.run(targets, {**given, **self._domain.textures}, self.constants())

    def state(self) -> dict[str, np.ndarray]:
        """Return all that the swarms remember."""
        self.textures.ensure()
        return {name: self.reader.read(texture) for name, texture in self.textures.remembered.items()}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Go on from what ``state`` returned at an iteration."""
        self.textures.restore(arrays)
        self.iteration = iteration

    def inherit(self, old: SynchronousSwarmPhase) -> None:
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
        places, weights = self.bests[: self._blocks], self.bests[self._blocks : -1]
        return {
            **{f"u_particle_{name}": texture for name, texture in list(self.remembered.items())[:4]},
            **{f"u_best_{i}": texture for i, texture in enumerate(places)},
            **{f"u_best_linear_{i}": texture for i, texture in enumerate(weights)},
            **{f"u_mean_{i}": texture for i, texture in enumerate(self.mean)},
            "u_best_fitness": self.bests[-1],
        }

    def found_bindings(self) -> dict[str, Any]:
        """Return by sampler name what a generation has found."""
        return {
            **{f"u_fitness_{i}": texture for i, texture in enumerate(self.found[: self._fours])},
            **{f"u_linear_{i}": texture for i, texture in enumerate(self.found[self._fours :])},
        }


def _checked(particles: int) -> int:
    if particles > MAX_PARTICLES:
        raise InputError(
            f'particles: update = "all" moves at most {MAX_PARTICLES} together, not {particles}; lower particles or'
            " particles_per_dimension"
        )
    return particles
