"""Refinement: Levenberg–Marquardt at every texel, from several starts and from the neighbours' estimates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ..kernels.refinement import NO_PENALTY, PROPAGATION_RADIUS, RefinementPasses, build_refinement_passes
from ..settings.resolve import BEST, PROPAGATE, ResolvedRefinement, Track
from ..state.phase_textures import PhaseTextures, refinement_table
from ..state.textures import HALO, loss_constants, packed_states
from .phase import Acceptance, PhaseContext, TexturePhase


class RefinementPhase(TexturePhase):
    """A Phase. Every texel has a best material and one in work, both with a status (shaders/refine/status.glsl)."""

    resolved: ResolvedRefinement
    passes: RefinementPasses

    def __init__(
        self,
        resolved: ResolvedRefinement,
        context: PhaseContext,
        acceptance: Acceptance | None = None,
        penalty: Path = NO_PENALTY,
    ):
        super().__init__(resolved, context, acceptance)
        self.resolved, self.refinement = resolved, resolved.refinement
        self.tracks = resolved.tracks
        fitness, defines = self.schedule.fitness, self.domain.defines
        self.passes = build_refinement_passes(self.model, resolved, fitness, defines, context.entry, penalty)
        self.textures = PhaseTextures(refinement_table(self.estimates.count), *self.estimates.size)
        self.best: list[Texture] = []
        self.work: list[Texture] = []

    @property
    def evaluations(self) -> int:
        """Renders of all observations in the next iteration, at a texel that has not converged."""
        track, made = self.track
        return self.passes.evaluations + (self.passes.proposals if track.start == PROPAGATE and made == 0 else 0)

    @property
    def stencil_radius(self) -> int:
        """PROPAGATION_RADIUS if the next iteration reads the neighbours' best materials, else 0."""
        track, made = self.track
        return PROPAGATION_RADIUS if track.start == PROPAGATE and made == 0 and not self.done else 0

    @property
    def has_result(self) -> bool:
        """Whether a step has been made."""
        return self.iteration > 0

    @property
    def track(self) -> tuple[Track, int]:
        """The track of the next iteration, and the number of its iterations that are finished."""
        made = self.iteration
        for track in self.tracks:
            if made < track.iterations:
                return track, made
            made -= track.iterations
        return self.tracks[-1], made

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each band."""
        yield from self._ready(bands)
        track, made = self.track
        if made == 0:
            yield from self._begin(track, bands, seconds)
        target, delta_factor = self._spare(), self._delta_factor(track, made)
        inputs = {**self._material(self.work), "u_best_status": self.best[-1]}
        yield from self._in_bands("refinement", self.passes.step, target, inputs, bands, seconds, delta_factor)
        self.work = target
        if made == track.iterations - 1:
            target, keep_probable = self._spare(), self.passes.keep_probable
            if track.start == PROPAGATE and keep_probable is not None:
                yield from self._in_bands("keep probable", keep_probable, target, self._best_and_work(), bands, seconds)
            else:
                yield from self._run(bands, self.passes.keep, target, self._best_and_work())
            self.best = self.work = target
        self.iteration += 1

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the best material so far into the next estimates; then run the acceptance test."""
        yield from self._ready(bands)
        targets = [*self.estimates.next, *self.textures.of("result")]
        yield from self._run(bands, self.passes.keep, targets, self._comparable())
        if self.acceptance is not None:
            yield from self.acceptance.decide_steps(bands, seconds)

    def preview(self, targets: Sequence[Texture]) -> None:
        """Write the best material so far into other textures, before the acceptance test."""
        inputs = {**self._comparable(), **self.domain.textures}
        self.passes.keep.run([*targets, *self.textures.of("result")], inputs, self._constants())

    def fitness(self) -> np.ndarray:
        """Return (H, W) float32 over the domain: fitness of the best material so far; NaN where no texel is solved."""
        self._write_result()
        return self.domain.packing.unpack(self.read("result")[..., 0], np.nan)

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: every texel's best material; NaN where no texel is solved.

        Within a round that is the best one at its begin, as the neighbours of the whole domain read it.
        """
        self._ensure_ready()
        packed = np.concatenate([self.reader.read(texture) for texture in self.best[:-1]], axis=-1)
        return self.domain.packing.unpack(packed[..., : self.model.components], np.nan)

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Set (H, W, n) materials, and (M, n) of the ghosts, as the best ones of texels of other tiles."""
        self._ensure_ready()
        packing = self.domain.packing
        of_other_tiles = packed_states(self.domain.domain, packing) == HALO
        packed = packing.pack(values, ghosts)
        packed = np.pad(packed, ((0, 0), (0, 0), (0, 4 * self.estimates.count - packed.shape[-1])))
        for i in range(self.estimates.count):
            part = np.where(of_other_tiles[..., None], packed[..., 4 * i : 4 * i + 4], self.reader.read(self.best[i]))
            self.best[i] = textures.upload(part.astype(np.float32))

    def state(self) -> dict[str, np.ndarray]:
        """Return name → array of all that persists between iterations."""
        self._ensure_ready()
        sets = {"best": self.best, "work": self.work}
        return {f"{name}_{i}": self.reader.read(t) for name, group in sets.items() for i, t in enumerate(group)}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Continue from the ``state`` of an iteration."""
        super().restore(arrays, iteration)
        self.best, self.work = self.textures.current["best"], self.textures.current["work"]

    def close(self) -> None:
        """Free shaders and textures."""
        super().close()
        self.best = self.work = []

    def _ready(self, bands: Bands) -> Iterator[None]:
        """Allocate the textures, and start from the current estimates unless a state was restored."""
        yield from self.textures.make()
        if not self.best:
            target, (status,) = self.textures.current["best"], self.textures.of("result")
            yield from self._run(bands, self.passes.begin, target, {**self.estimates.bindings(), "u_status": status})
            self.best = self.work = target

    def _ensure_ready(self) -> None:
        for _ in self._ready(Bands()):
            pass

    def _write_result(self) -> None:
        self._ensure_ready()
        self.preview(self.estimates.next)

    def _delta_factor(self, track: Track, made: int) -> float:
        """Return the factor on δ in an iteration: from a start it falls to 1 before the race; else 1."""
        last = self.refinement.start_iterations - 1
        return 1.0 if track.start < 0 or made >= last else self.refinement.delta_factor ** (1 - made / last)

    def _begin(self, track: Track, bands: Bands, seconds: float) -> Iterator[None]:
        if track.start == BEST:
            self.work = self.best
            return
        target = self._spare()
        if track.start == PROPAGATE:
            yield from self._in_bands(
                "propagate", self.passes.propagate, target, self._material(self.best), bands, seconds
            )
        else:
            yield from self._run(bands, self.passes.begin, target, self._material(self.best), track.start)
        self.work = target

    def _spare(self) -> list[Texture]:
        """Return the set of textures that holds neither the best material nor the one in work."""
        current, spare = self.textures.current, self.textures.spare
        sets = current["best"], current["work"], spare["work"]
        return next(chosen for chosen in sets if chosen is not self.best and chosen is not self.work)

    def _material(self, material: list[Texture]) -> dict[str, Texture]:
        return self.textures.bound("best", material)

    def _best_and_work(self) -> dict[str, Texture]:
        return {**self._material(self.best), **self.textures.bound("work", self.work)}

    def _comparable(self) -> dict[str, Texture]:
        """Return the best material and the one in work, to keep the better; while δ is wider the best one twice.

        With a robust loss, a wider δ makes every loss smaller: the material in work would always be the better one.
        """
        track, made = self.track
        comparable = made == 0 or self._delta_factor(track, made - 1) == 1
        return {**self._material(self.best), **self.textures.bound("work", self.work if comparable else self.best)}

    def _constants(self, start: int = BEST, delta_factor: float = 1.0) -> dict[str, int | float]:
        constants = loss_constants(self.domain, delta_factor * self.schedule.fitness.delta)
        track, made = self.track
        races = track.start >= 0 and made >= self.refinement.start_iterations
        return {**constants, "u_start": start, "u_settles": int(delta_factor == 1), "u_races": int(races)}

    def _run(
        self, bands: Bands, pass_: Pass, targets: list[Texture], inputs: dict[str, Texture], start: int = BEST
    ) -> Iterator[None]:
        return pass_.in_one_draw(bands, targets, {**inputs, **self.domain.textures}, self._constants(start))

    def _in_bands(
        self,
        name: str,
        pass_: Pass,
        targets: list[Texture],
        inputs: dict[str, Texture],
        bands: Bands,
        seconds: float,
        delta_factor: float = 1.0,
    ) -> Iterator[None]:
        inputs, constants = {**inputs, **self.domain.textures}, self._constants(delta_factor=delta_factor)
        return pass_.in_bands(name, bands, seconds, targets, inputs, constants, counted=pass_ is self.passes.step)
