"""Photographs corrected for the indirect light of a subject: a sample stack that is computed where it is read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...geometry.domain import Domain
from ...geometry.light.light_shape import beam_shares
from ...geometry.light.light_transport import LightTransport
from ...geometry.samples import SampleStack


@dataclass(frozen=True, eq=False)
class IndirectSamples:
    """Indirect light of the covered texels of a domain, as their samples have it.

    radiance: (K, E, 3) of the elements of ``transport``, interpolated to the texels; divided by the albedo of the
    elements if there is detail: (T, 3), the albedo of the T covered texels, row by row. beamed: the domain if its
    lights have beams, by which samples are divided.
    """

    covered: np.ndarray
    transport: LightTransport
    radiance: np.ndarray
    detail: np.ndarray | None
    beamed: Domain | None = None

    def at(self, observation: int, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (N, 3) float32: the light at N covered texels in one observation."""
        number = self._number[rows, columns]
        near, share = self.transport.near[number], self.transport.share[number]
        of_elements = self.radiance[observation]
        light = sum(share[:, i, None] * of_elements[near[:, i]] for i in range(near.shape[1]))
        if self.detail is not None:
            light = light * self.detail[number]
        if self.beamed is None:
            return light
        return light / beam_shares(self.beamed, observation, (rows, columns))[1][:, None]

    @cached_property
    def _number(self) -> np.ndarray:
        """(H, W) int32: the number of each covered texel."""
        return (np.cumsum(self.covered, dtype=np.int32) - 1).reshape(self.covered.shape)


@dataclass(frozen=True, eq=False)
class CorrectedStack:
    """A read-only ``SampleStack``: photographs minus the light of ``indirect``, at covered texels.

    Computed at each read, it takes no memory beside the photographs. before: the stack of the round before, None for
    the photographs. relaxation: the factor on the step from it. first: row and column of the texel (0, 0) among
    those of ``indirect``. observations: their numbers there, None for all.
    """

    photographs: SampleStack
    indirect: IndirectSamples
    before: SampleStack | None = None
    relaxation: float = 1.0
    first: tuple[int, int] = (0, 0)
    observations: np.ndarray | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """(K, H, W)."""
        return self.photographs.shape

    def layer(self, observation: int) -> np.ndarray:
        """Return (H, W, 4): the samples of one observation."""
        layer, covered = self.photographs.layer(observation).copy(), self._covered
        before = layer if self.before is None else self.before.layer(observation)
        layer[covered] = self._corrected(observation, layer[covered], before[covered], *covered)
        return layer

    def layers(self) -> Iterator[np.ndarray]:
        """Yield the samples of every observation."""
        return (self.layer(observation) for observation in range(self.shape[0]))

    def kept(self, derived: SampleStack) -> SampleStack:
        """As SampleStack."""
        return self.photographs.kept(derived)

    def texels(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (K, N, 4): the samples at N texels."""
        samples, covered = self.photographs.texels(rows, columns).copy(), self._coverage[rows, columns]
        before = samples if self.before is None else self.before.texels(rows, columns)
        for observation, own in enumerate(samples):
            others = before[observation, covered], rows[covered], columns[covered]
            own[covered] = self._corrected(observation, own[covered], *others)
        return samples

    def subset(self, observations: np.ndarray) -> CorrectedStack:
        """Return the stack of some observations."""
        numbers = np.arange(self.shape[0]) if self.observations is None else self.observations
        before = self.before and self.before.subset(observations)
        photographs = self.photographs.subset(observations)
        return replace(self, photographs=photographs, before=before, observations=numbers[observations])

    def window(self, rows: slice, columns: slice) -> CorrectedStack:
        """Return the texels of a window."""
        photographs, before = self.photographs.window(rows, columns), self.before and self.before.window(rows, columns)
        first = self.first[0] + rows.start, self.first[1] + columns.start
        return replace(self, photographs=photographs, before=before, first=first)

    def lit(self, coverage: np.ndarray) -> np.ndarray:
        """Return (H, W) bool: covered texels that at least one observation sees lit, directly or not."""
        return self.photographs.lit(coverage)

    @property
    def _coverage(self) -> np.ndarray:
        """(H, W) bool."""
        (_, height, width), (down, across) = self.shape, self.first
        return self.indirect.covered[down : down + height, across : across + width]

    @cached_property
    def _covered(self) -> tuple[np.ndarray, ...]:
        """Rows and columns of the covered texels."""
        return np.nonzero(self._coverage)

    def _corrected(
        self, observation: int, samples: np.ndarray, before: np.ndarray, rows: np.ndarray, columns: np.ndarray
    ) -> np.ndarray:
        """Return (N, 4): samples of the photographs in one observation, without the indirect light."""
        number = observation if self.observations is None else int(self.observations[observation])
        light = self.indirect.at(number, rows + self.first[0], columns + self.first[1])
        direct = np.maximum(samples[:, :3] - light, 0)
        if self.relaxation != 1:
            direct = before[:, :3] + self.relaxation * (direct - before[:, :3])
        return np.concatenate([direct, samples[:, 3:]], axis=-1, dtype=np.float32)
