"""Shared materials: every texel tries the means of a mixture over all texels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.textures import Texture
from ..kernels.refinement import PROPAGATION_RADIUS
from ..settings.resolve import BEST, PROPAGATE, ResolvedMaterials, Track
from ..state.alternatives import Alternatives
from ..state.texel_subset import TexelSubset, chosen_texels
from ..state.textures import SOLVED, texel_states
from .mixture import features_of, material_table
from .refinement import RefinementPhase

_TABLE = "materials"  # name in a state
_AT_ONCE = 0.1  # seconds of a band of the alternatives
_MIN_WEIGHT = 0.02  # of a texel in the mixture


class SharedMaterialsPhase(RefinementPhase):
    """A Phase: a refinement whose rounds begin with the materials of a subset of all texels (mixture.py).

    Each round estimates the mixture again. A tile or a rank takes the whole domain's subset before an iteration whose
    ``needs_texel_subset`` is true; without it, its own part replaces the whole. A texel's weight in the mixture is 1
    minus the likelihood ratio of its best distant alternative (state/alternatives.py), mean of the searched numbers:
    texels without a highlight, which fit matt paint as well as a polished surface, leave the decision to the others.
    """

    resolved: ResolvedMaterials
    _table: Texture | None = None
    _alternatives: Alternatives | None = None

    @property
    def stencil_radius(self) -> int:
        """PROPAGATION_RADIUS if the next iteration reads the halo, else 0."""
        return PROPAGATION_RADIUS if self.needs_texel_subset else 0

    @property
    def needs_texel_subset(self) -> bool:
        """Whether the next iteration begins a round, and its materials are missing."""
        return self._in_round and self._table is None and not self.done

    def texel_subset(self) -> TexelSubset:
        """Return this tile's part of the subset; values: the model's components, and a weight."""
        self._ensure_ready()
        packed = np.concatenate([self.reader.read(texture) for texture in self.best[:-1]], axis=-1)
        values = self.domain.packing.unpack(packed[..., : self.model.components])
        domain = self.domain.domain
        rows, columns = np.nonzero(texel_states(domain) == SOLVED)
        subset = chosen_texels(rows + domain.origin[1], columns + domain.origin[0], values[rows, columns])
        weights = self._weights(subset.rows - domain.origin[1], subset.columns - domain.origin[0])
        return replace(subset, values=np.column_stack([subset.values, weights]))

    def take_texel_subset(self, subset: TexelSubset) -> None:
        """Estimate the materials of this round. subset: of the whole domain."""
        features = features_of(self.model, self.resolved.parameters, subset.values)
        self._table = textures.upload(material_table(features, subset.values[:, -1], self.resolved.materials.count))

    def _weights(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (n,) weights of texels: 1 minus the likelihood ratio of the best alternative, mean of the numbers."""
        if self._alternatives is None:
            fixed = {p.name for p in self.model.parameters} - {p.name for p in self.resolved.parameters}
            self._alternatives = Alternatives(self.model, fixed, self.schedule.fitness, self.domain.defines)
        if not self._alternatives.measured:
            return np.ones(len(rows))
        packing = self.domain.packing
        chosen = np.zeros(self.domain.domain.shape, bool)
        chosen[rows, columns] = True
        part = self.domain.where(packing.pack(chosen).astype(bool))
        best = {f"u_estimate_{i}": texture for i, texture in enumerate(self.best[:-1])}
        for _ in self._alternatives.measure_steps(part, best, Bands(), _AT_ONCE):
            pass
        deviances = [packing.unpack(value)[rows, columns] for value in self._alternatives.read().values()]
        ratios = np.exp(-0.5 * np.maximum(np.nan_to_num(np.concatenate(deviances, axis=-1, dtype=np.float64)), 0.0))
        return _MIN_WEIGHT + (1 - _MIN_WEIGHT) * (1 - ratios.mean(axis=-1))

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration, as RefinementPhase does."""
        yield from self._ready(bands)
        if self._in_round and self._table is None:
            self.take_texel_subset(self.texel_subset())
            yield
        yield from super().advance(bands, seconds)
        if self.track[1] == 0:
            self._table = None

    def state(self) -> dict[str, np.ndarray]:
        """Return name → array of all that persists between iterations; in a round also its materials."""
        table = {} if self._table is None else {_TABLE: self.reader.read(self._table)}
        return super().state() | table

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Continue from the ``state`` of an iteration; without the materials the round estimates them again."""
        super().restore(arrays, iteration)
        self._table = textures.upload(arrays[_TABLE]) if _TABLE in arrays else None

    def close(self) -> None:
        """Free shaders and textures."""
        super().close()
        self._table = None
        if self._alternatives is not None:
            self._alternatives.close()
            self._alternatives = None

    @property
    def _in_round(self) -> bool:
        return self.track[0].start == PROPAGATE

    def _delta_factor(self, track: Track, made: int) -> float:
        last = track.iterations - 1
        return 1.0 if track.start == BEST or last == 0 else self.refinement.delta_factor ** (1 - made / last)

    def _material(self, material: list[Texture]) -> dict[str, Texture]:
        table = {} if self._table is None else {"u_materials": self._table}
        return {**super()._material(material), **table}

    def _constants(self, start: int = BEST, delta_factor: float = 1.0) -> dict[str, int | float]:
        first = self.iteration < 1 + self.refinement.round_iterations
        return {**super()._constants(start, delta_factor), "u_mirror": int(not first)}
