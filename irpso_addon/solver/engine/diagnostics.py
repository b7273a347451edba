"""What is told of a recovery as it is: maps, error, deviations. Found in slices, and without disturbing the search."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..kernels.kernels import residual_pass, sampled_residual_pass
from ..phases.phase import Phase
from ..settings.groups import Fitness
from ..state.textures import SOLVED, DomainTextures, Estimates, texel_states
from .alternatives import Alternatives
from .confidence import Confidence

_SAMPLED = 4096  # texels of which a mean is told: a sixty-fourth of 512², and its standard error is 1 % or so
_SAMPLED_WIDTH = 64


class Diagnostics:
    """The resolved estimates, how well they fit, and how far they are to be trusted.

    ``finding`` finds all that ``maps`` tells. Raises ShaderError where the model does not compile.
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
        self._residual = residual_pass(model, domain.defines).compile()
        self._error: Any = textures.empty(*estimates.size)
        self._confidence: Confidence | None = None
        self._alternatives: Alternatives | None = None
        self._bands = Bands()
        self._resolved = False  # whether the estimates to look at are the resolved ones
        self._sample: tuple[Any, Any] | None = None  # which texels, and their residuals
        self._sampled = sampled_residual_pass(model, domain.defines)

    def finding(self, phase: Phase | None, confidence: bool, seconds: float, paced: bool) -> Iterator[None]:
        """Resolve what a phase has found so far and measure it, in bands of about ``seconds``; yields after each.

        phase: None where all are done. confidence: whether to find deviations and alternatives too. paced: as in Bands.
        """
        self._bands.paced = paced
        self._resolved = phase is not None and phase.placed
        if self._resolved:
            yield from phase.conclude(self._bands, seconds)
        targets, inputs = [self._error], {**self._domain.textures, **self._estimates.bindings(self._resolved)}
        constants = {"u_observations": self._domain.domain.observations}
        yield from self._bands.run(
            "residual", self._error.height, seconds,
            lambda rows: self._residual.run(targets, inputs, constants, rows), lambda: self._residual.fence(targets),
        )  # fmt: skip
        if confidence:
            if self._confidence is None:
                told = self._model, self._fixed, self._fitness, self._domain.defines
                self._confidence, self._alternatives = Confidence(*told), Alternatives(*told)
            for measured in (self._confidence, self._alternatives):
                yield from measured.measuring(self._domain, self._estimates, self._resolved, self._bands, seconds)

    def maps(self, confidence: bool) -> Maps:
        """Return what ``finding`` has found last."""
        packing, solvable = self._domain.packing, self._domain.domain.solvable
        values = {
            name: packing.unpack(value, self._model.parameter(name).default)
            for name, value in self._estimates.values(self._resolved).items()
        }
        error = packing.unpack(textures.download(self._error)[..., 0])
        deviations = alternatives = None
        if confidence:
            deviations = {name: packing.unpack(value) for name, value in self._confidence.read().items()}
            alternatives = {name: packing.unpack(value) for name, value in self._alternatives.read().items()}
        return Maps(self._model, values, solvable, error, deviations, alternatives=alternatives)

    def mean_error(self, shown: Mapping[str, Any]) -> float:
        """Return the mean residual of some thousand texels, NaN where none is solved. shown: estimates by sampler name.

        The texels are drawn once, at random and without replacement; in a smaller domain they are all there are.
        """
        if self._sample is None:
            self._sample = self._drawn()
        places, target = self._sample
        inputs = {**self._domain.textures, **shown, "u_sampled": places}
        self._sampled.run([target], inputs, {"u_observations": self._domain.domain.observations})
        found = textures.download(target)
        counted = found[..., 1] > 0
        return float(found[counted, 0].mean(dtype=np.float64)) if counted.any() else float("nan")

    def close(self) -> None:
        """Free shaders and textures."""
        self._residual.close()
        self._sampled.close()
        if self._confidence is not None:
            self._confidence.close()
            self._alternatives.close()
        self._error = self._confidence = self._alternatives = self._sample = None

    def _drawn(self) -> tuple[Any, Any]:
        """Which packed texels are looked at, −1 in places left over, and where their residuals go."""
        packing = self._domain.packing
        own = np.flatnonzero(packing.pack(texel_states(self._domain.domain)) == SOLVED)
        chosen = np.sort(np.random.default_rng(0).permutation(own)[:_SAMPLED])
        places = np.full((-(-max(len(chosen), 1) // _SAMPLED_WIDTH), _SAMPLED_WIDTH, 2), -1, np.float32)
        places.reshape(-1, 2)[: len(chosen)] = np.stack([chosen % packing.width, chosen // packing.width], axis=-1)
        return textures.upload(places), textures.empty(_SAMPLED_WIDTH, len(places))
