"""Maps, error and deviations of an unfinished recovery, measured in slices; the search does not change."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..kernels.single_passes import residual_pass, sampled_residual_pass
from ..phases.phase import Phase
from ..settings.groups import Fitness
from ..state.alternatives import Alternatives
from ..state.textures import SOLVED, DomainTextures, Estimates, texel_states
from .confidence import Confidence

_SAMPLED = 4096  # texels of a mean: a sixty-fourth of 512², with a standard error of about 1 %
_SAMPLED_WIDTH = 64


class Diagnostics:
    """The next estimates, their residual, deviations and alternatives: for ``maps``, by ``measure_steps``.

    Raises ShaderError where the model does not compile.
    """

    def __init__(
        self,
        model: ReflectanceModel,
        fitness: Fitness,
        domain: DomainTextures,
        estimates: Estimates,
        fixed: Collection[str],
    ):
        self._fitness = fitness
        self._model, self._domain, self._estimates, self._fixed = model, domain, estimates, frozenset(fixed)
        self._residual = residual_pass(model, domain.defines)
        self._residual.compile()
        self._error = textures.empty(*estimates.size)
        self._measures: tuple[Confidence, Alternatives] | None = None  # made at first use: two more shaders
        self._bands = Bands()
        self._of_next = False  # whether ``maps`` returns the next estimates
        self._sample: tuple[Texture, Texture] | None = None  # places of texels, and their residuals
        self._sampled = sampled_residual_pass(model, domain.defines)

    def measure_steps(self, phase: Phase | None, confidence: bool, seconds: float, paced: bool) -> Iterator[None]:
        """Write a phase's estimates and measure them, in bands of about ``seconds``; yields after each.

        phase: None after the last one. confidence: measure deviations and alternatives too. paced: as in Bands.
        """
        self._bands.paced = paced
        self._of_next = False
        if phase is not None and phase.has_result:
            self._of_next = True
            yield from phase.write_estimates(self._bands, seconds)
        targets, inputs = [self._error], {**self._domain.textures, **self._estimates.bindings(self._of_next)}
        constants = {"u_observations": self._domain.domain.observations}
        yield from self._bands.run(
            "residual", self._error.height, seconds,
            lambda rows: self._residual.run(targets, inputs, constants, rows), lambda: self._residual.fence(targets),
        )  # fmt: skip
        if confidence:
            if self._measures is None:
                settings = self._model, self._fixed, self._fitness, self._domain.defines
                self._measures = Confidence(*settings), Alternatives(*settings)
            materials = self._estimates.bindings(self._of_next)
            for measure in self._measures:
                yield from measure.measure_steps(self._domain, materials, self._bands, seconds)

    def maps(self, confidence: bool) -> Maps:
        """Return the last measure of ``measure_steps``."""
        packing, solvable = self._domain.packing, self._domain.domain.solvable
        values = {
            name: packing.unpack(value, self._model.parameter(name).default)
            for name, value in self._estimates.values(self._of_next).items()
        }
        error = packing.unpack(textures.download(self._error)[..., 0])
        deviations = alternatives = None
        if confidence and self._measures is not None:
            deviations, alternatives = (
                {name: packing.unpack(value) for name, value in measure.read().items()} for measure in self._measures
            )
        return Maps(self._model, values, solvable, error, deviations, alternatives=alternatives)

    def at(self, rows: np.ndarray, columns: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the values of ``maps`` at n texels: parameter name → (n, components), and (n,) residuals."""
        places = self._domain.packing.places(rows, columns)
        return self._estimates.at(places, self._of_next), textures.texels(self._error, places)[:, 0]

    def mean_error(self, shown: Mapping[str, Texture]) -> float:
        """Return the mean residual of at most 4096 texels, NaN where none is solved. shown: estimates by sampler name.

        The texels are drawn once, at random and without replacement.
        """
        if self._sample is None:
            self._sample = self._draw_sample()
        places, target = self._sample
        inputs = {**self._domain.textures, **shown, "u_sampled": places}
        self._sampled.run([target], inputs, {"u_observations": self._domain.domain.observations})
        residuals = textures.download(target)
        counted = residuals[..., 1] > 0
        return float(residuals[counted, 0].mean(dtype=np.float64)) if counted.any() else float("nan")

    def close(self) -> None:
        """Free shaders and textures."""
        self._residual.close()
        self._sampled.close()
        for measure in self._measures or ():
            measure.close()
        self._measures = self._sample = None
        del self._error

    def _draw_sample(self) -> tuple[Texture, Texture]:
        """Return the positions of the sampled packed texels, −1 at unused ones, and the texture of their residuals."""
        packing = self._domain.packing
        own = np.flatnonzero(packing.pack(texel_states(self._domain.domain)) == SOLVED)
        chosen = np.sort(np.random.default_rng(0).permutation(own)[:_SAMPLED])
        places = np.full((-(-max(len(chosen), 1) // _SAMPLED_WIDTH), _SAMPLED_WIDTH, 2), -1, np.float32)
        places.reshape(-1, 2)[: len(chosen)] = np.stack([chosen % packing.width, chosen // packing.width], axis=-1)
        return textures.upload(places), textures.empty(_SAMPLED_WIDTH, len(places))
