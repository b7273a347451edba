"""The standard deviation of each recovered number, from the observations alone."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ..kernels.free_parameters import build_free_parameters
from ..kernels.single_passes import confidence_pass
from ..settings.groups import Fitness
from ..state.textures import DomainTextures, loss_constants


def deviation_pass(
    model: ReflectanceModel, fixed: Collection[str], fitness: Fitness, domain_defines: Mapping[str, str | int]
) -> Pass:
    """Return the pass of Confidence."""
    free = build_free_parameters(model, fixed)
    return confidence_pass(model, free.source, fitness, {**domain_defines, **free.defines})


class Confidence:
    """The pass that measures the standard deviation of every parameter at every texel.

    The render is linearised at the estimates; the residuals there give the noise: σ² = variance · (JᵀJ)⁻¹, jointly over
    all n numbers that are not ``fixed``. The variance is a Σ w e² / (3 Σ w − n (1 + a) / 2), over weighted
    samples and three channels. a = Σ w (e_r + e_g + e_b)² / Σ w e², 1 to 3, shows how the channels' errors correlate:
    shifts, shading and JPEG's luminance are one error, not three. With a robust loss the deviation of a sample is at
    least 0.3 % of the texel's scale. Model errors are not detected; alternatives.py and modes.py detect other optima.
    σ of an undetermined number is its range: its column of J is lost in rounding or depends linearly on others, or its
    joint deviation exceeds its range. Numbers that can compensate for it get their share, up to their own range: two
    lobes of one width leave r1, r2 and w undetermined (r1 by (1 − w) / w of r2's range), w = 1 leaves r2. With fewer
    samples than numbers, σ of all is their range.
    """

    def __init__(
        self, model: ReflectanceModel, fixed: Collection[str], fitness: Fitness, domain_defines: Mapping[str, str | int]
    ):
        self.model, self._fixed, self._fitness = model, frozenset(fixed), fitness
        self._pass = deviation_pass(model, self._fixed, fitness, domain_defines)
        self._targets: list[Texture] = []  # reused: the pass keeps the frame buffer of every target

    def measure_steps(
        self, domain: DomainTextures, materials: Mapping[str, Texture], bands: Bands, seconds: float
    ) -> Iterator[None]:
        """Make the measurement for ``read``, in bands of rows of about ``seconds``; yields after each.

        materials: textures by sampler name, as of ``Estimates.bindings``.
        """
        if not self._targets:
            self._targets = [textures.empty(texture.width, texture.height) for texture in materials.values()]
        inputs = {**domain.textures, **materials}
        constants = loss_constants(domain, self._fitness.delta)
        yield from self._pass.in_bands("confidence", bands, seconds, self._targets, inputs, constants)

    def read(self) -> dict[str, np.ndarray]:
        """Return the last measurement: name → (h, w, components) float32, packed, in its units; 0 where fixed.

        A normal has one component: the root of the sum of its two tangent variances, in radians, at most π/2.
        """
        packed = np.concatenate([textures.download(t) for t in self._targets], axis=-1)
        deviations = {}
        for p in self.model.parameters:
            at, size = self.model.offset(p.name), 1 if p.is_normal else p.components
            deviations[p.name] = packed[..., at : at + size]
        return deviations

    def close(self) -> None:
        """Free the shader and its targets."""
        self._pass.close()
        self._targets = []
