"""The interface of a phase, and the base class of phases with their own textures."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...gpu.bands import Bands
from ...gpu.kernel import Entry
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ..settings.resolve import Resolved
from ..settings.schedule import Schedule
from ..state.phase_textures import PhaseTextures
from ..state.prefit_measurements import PrefitMeasurements
from ..state.reader import Reader
from ..state.texel_subset import TexelSubset
from ..state.textures import HALO, SOLVED, DomainTextures, Estimates, packed_states, texel_states

BAND_SECONDS = 0.02  # of one draw while a window waits
BACKGROUND_BAND_SECONDS = 0.25  # drivers kill a draw after two seconds
_BANDS = 8  # in a long time budget
_SHARE = 0.5  # of a time budget, for one band: the last one begins before the budget is spent


def band_seconds(time_budget_s: float | None) -> float:
    """Return the seconds of a band in a step with a time budget; None: without."""
    if time_budget_s is None:
        return BACKGROUND_BAND_SECONDS
    return min(max(BAND_SECONDS, time_budget_s / _BANDS), _SHARE * time_budget_s)


@dataclass(frozen=True)
class PhaseContext:
    """What a phase shares with its recovery: model and settings, samples, estimates, and the entry of its shaders.

    estimates: a phase reads the current ones and writes the next ones.
    """

    model: ReflectanceModel
    schedule: Schedule
    domain: DomainTextures
    estimates: Estimates
    entry: Entry


class Phase(Protocol):
    """A sequence of iterations. It reads the current estimates and writes the next ones.

    title: searched parameters, for display. iterations: their number. Textures and shaders are made at first use, in
    slices of ``advance``.
    """

    title: str
    iterations: int

    @property
    def iteration(self) -> int:
        """Number of finished iterations; negative while swarms are initialised."""

    @property
    def done(self) -> bool:
        """Whether all iterations are finished."""
        return self.iteration >= self.iterations

    @property
    def evaluations(self) -> int:
        """Renders of all observations in the next iteration, at a texel that has not converged."""

    @property
    def stencil_radius(self) -> int:
        """Distance, in texels, at which the next iteration reads neighbours; 0 if it reads none."""

    @property
    def needs_texel_subset(self) -> bool:
        """Whether the next iteration needs the subset of all texels of the whole domain (state/texel_subset.py)."""
        return False

    @property
    def has_result(self) -> bool:
        """Whether there is a result to show; until then the current estimates are shown."""

    @property
    def keeps_estimates(self) -> bool:
        """Whether the recovery's estimates stay as they are at the end; then ``has_result`` is False."""
        return False

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yields after each band."""

    def write_estimates(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Write the result so far into the next estimates, in bands. The search itself does not change."""

    def preview(self, targets: Sequence[Texture]) -> None:
        """Write the result so far into other textures, before any acceptance test."""
        return None

    def write_estimates_at_once(self) -> None:
        """Do what ``write_estimates`` does, in one go."""
        for _ in self.write_estimates(Bands(), BACKGROUND_BAND_SECONDS):
            pass

    def reached(self, threshold: float) -> bool:
        """Return whether the fitness of each of the tile's own texels is at most ``threshold``."""
        return False

    def measure_steps(self, bands: Bands, seconds: float) -> Generator[None, None, PrefitMeasurements | None]:
        """Yields often; returns, after the last iteration, all measurements for later phases, None if it makes none."""
        yield from ()
        return None

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: the data that neighbours read; NaN where no texel is solved."""

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Set (H, W, n), and (M, n) of the ghosts, at texels of other tiles. The tile's own texels do not change."""

    def texel_subset(self) -> TexelSubset:
        """Return this tile's part of the subset of the whole domain, where ``needs_texel_subset``."""
        return TexelSubset.none()

    def take_texel_subset(self, subset: TexelSubset) -> None:
        """Set the subset of the whole domain."""
        return None

    def state(self) -> dict[str, np.ndarray]:
        """Return name → array of all that persists between iterations."""

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Continue from the ``state`` of an iteration."""

    def close(self) -> None:
        """Free shaders and textures."""


class Acceptance(Protocol):
    """A test that decides which next estimates are accepted."""

    def decide_steps(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Replace the next estimates by the accepted ones, in bands; takes effect after the last one."""

    def close(self) -> None:
        """Free shaders and textures."""


class Passes(Protocol):
    """The compiled passes of a phase."""

    def close(self) -> None:
        """Free the shaders."""


class TexturePhase(Phase):
    """A phase whose textures a table declares. A subclass sets ``textures`` and ``passes``.

    acceptance: test of the next estimates, or None. shared: groups of RGBA textures that neighbours read.
    """

    iteration = 0
    shared: tuple[str, ...] = ()
    textures: PhaseTextures
    passes: Passes

    def __init__(self, resolved: Resolved, context: PhaseContext, acceptance: Acceptance | None = None):
        self.title, self.iterations = resolved.title, resolved.iterations
        self.model, self.schedule = context.model, context.schedule
        self.domain, self.estimates = context.domain, context.estimates
        self.acceptance = acceptance
        self.reader = Reader(context.entry)

    def _inputs(self) -> dict[str, Texture]:
        """Return the textures that the passes read, by sampler name: estimates, the phase's own, the domain's."""
        return {**self.estimates.bindings(), **self.textures.bindings(), **self.domain.textures}

    def read(self, *names: str) -> np.ndarray:
        """Return (h, w, channels) of the current textures of some groups, channels side by side."""
        self.textures.ensure()
        return np.concatenate([self.reader.read(texture) for texture in self.textures.of(*names)], axis=-1)

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: the shared groups; NaN where no texel is solved."""
        return self.domain.packing.unpack(self.read(*self.shared), np.nan)

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Set (H, W, n), and (M, n) of the ghosts, at texels of other tiles. The tile's own texels do not change."""
        packing = self.domain.packing
        of_other_tiles = packed_states(self.domain.domain, packing)[..., None] == HALO
        merged = np.where(of_other_tiles, packing.pack(values, ghosts), self.read(*self.shared))
        parts = iter(np.split(merged, merged.shape[-1] // 4, axis=-1))
        for name in self.shared:
            self.textures.upload(name, [next(parts) for _ in self.textures.of(name)])

    def fitness(self) -> np.ndarray | None:
        """Return (H, W) float32 over the domain: every texel's best fitness; NaN where none is solved.

        None: the phase does not search for a lower fitness.
        """
        return None

    def reached(self, threshold: float) -> bool:
        """Return whether the fitness of each of the tile's own texels is at most ``threshold``."""
        if (fitness := self.fitness()) is None:
            return False
        return bool((fitness[texel_states(self.domain.domain) == SOLVED] <= threshold).all())

    def state(self) -> dict[str, np.ndarray]:
        """Return name → array of all that persists between iterations."""
        self.textures.ensure()
        return {name: self.reader.read(texture) for name, texture in self.textures.persistent.items()}

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Continue from the ``state`` of an iteration."""
        self.textures.restore(arrays)
        self.iteration = iteration

    def close(self) -> None:
        """Free shaders and textures."""
        if self.acceptance is not None:
            self.acceptance.close()
        self.passes.close()
        self.reader.close()
        self.textures.close()
