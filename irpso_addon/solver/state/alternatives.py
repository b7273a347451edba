"""Fit of materials far from the estimates: other optima, which a linearised render does not show."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...gpu.textures import Texture
from ...reflectance.model import Parameter, ReflectanceModel
from ..kernels.free_parameters import build_free_parameters, has_basis
from ..kernels.linear_weights import MAX_WEIGHTS, linear_weights
from ..kernels.single_passes import alternatives_pass
from ..settings.groups import Fitness
from .textures import DomainTextures, loss_constants


class Alternatives:
    """The pass that measures, at every texel, how much worse the best material far from the estimate fits.

    Far: one number differs by 0.3 of its range or more. The other searched numbers and the normal stay fixed, so an
    alternative may fit worse than its optimum; the linear weights are solved again. The measure is n log((F + ε) /
    (F₀ + ε)), from −9 to 9: F is the fitness of the alternative, F₀ of the estimate, ε the NOISE_FLOOR of
    fitness/with_priors.glsl, n the number of independent samples. It is profile likelihood (Venzon and Moolgavkar
    1988, A Method for Computing Profile-Likelihood-Based Confidence Intervals) at a few values. It excludes numbers
    with a normal prior, which alone selects between optima, and needs a robust loss: ε is in its units. A single texel
    is weak evidence: a mirror whose highlight falls between the lamps fits matt paint, too (modes.py).
    """

    def __init__(
        self, model: ReflectanceModel, fixed: Collection[str], fitness: Fitness, domain_defines: Mapping[str, str | int]
    ):
        self._fitness = fitness
        self._varied = varied(model, fixed, fitness)
        self._pass = None
        if self._varied:
            solved = linear_weights(model, _solved(model, fixed))
            defines = {**domain_defines, "ALTERNATIVES": sum(p.components for p in self._varied)}
            self._pass = alternatives_pass(model, build_free_parameters(model, fixed), solved, fitness, defines)
        self._targets: list[Texture] = []

    @property
    def measured(self) -> bool:
        """Whether any number has alternatives."""
        return self._pass is not None

    def measure_steps(
        self, domain: DomainTextures, materials: Mapping[str, Texture], bands: Bands, seconds: float
    ) -> Iterator[None]:
        """Make the measurement for ``read``, in bands of rows of about ``seconds``; yields after each.

        materials: textures by sampler name, as of ``Estimates.bindings``.
        """
        if self._pass is None:
            return
        if not self._targets:
            size = next((texture.width, texture.height) for texture in materials.values())
            self._targets = [textures.empty(*size) for _ in self._pass.kernel.targets]
        inputs = {**domain.textures, **materials}
        constants = loss_constants(domain, self._fitness.delta)
        yield from self._pass.in_bands("alternatives", bands, seconds, self._targets, inputs, constants)

    def read(self) -> dict[str, np.ndarray]:
        """Return the last measurement: name → (h, w, components) float32, packed; 0 where none is solved."""
        if self._pass is None:
            return {}
        packed = np.concatenate([textures.download(t) for t in self._targets], axis=-1)
        ends = np.cumsum([p.components for p in self._varied])
        return {p.name: packed[..., end - p.components : end] for p, end in zip(self._varied, ends, strict=True)}

    def close(self) -> None:
        """Free the shader and its targets."""
        if self._pass is not None:
            self._pass.close()
        self._targets = []


def varied(model: ReflectanceModel, fixed: Collection[str], fitness: Fitness) -> tuple[Parameter, ...]:
    """Return the parameters that have alternatives."""
    return tuple(
        p for p in model.parameters
        if fitness.loss == "cauchy" and p.name not in fixed and not p.is_normal and not has_basis(p, model)
        and (p.prior is None or p.prior.kind != "normal")
    )  # fmt: skip


def _solved(model: ReflectanceModel, fixed: Collection[str]) -> list[Parameter]:
    """Return the linear weights to solve again: the first MAX_WEIGHTS, the limit of the closed form."""
    solved: list[Parameter] = []
    for p in model.parameters:
        left = MAX_WEIGHTS - sum(q.components for q in solved)
        if p.name not in fixed and has_basis(p, model) and p.components <= left:
            solved.append(p)
    return solved
