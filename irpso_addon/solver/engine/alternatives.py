"""How well the photographs are met by materials far from the estimates: what a linearised render does not see."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from ...gpu import textures
from ...gpu.bands import Bands
from ...reflectance.model import Parameter, ReflectanceModel
from ..kernels.free_parameters import build_free_parameters, has_basis
from ..kernels.kernels import alternatives_pass
from ..kernels.linear_weights import MAX_WEIGHTS, linear_weights
from ..settings.groups import Fitness
from ..state.textures import DomainTextures, Estimates, loss_constants


class Alternatives:
    """The pass that tells, at every texel, how much worse the best material far from the estimate fits.

    Far in one number: by 0.3 of its range or more. The other searched numbers and the normal are held, the linear
    weights found anew. The measure is n log((F + ε) / (F₀ + ε)), F the fitness of the alternative, F₀ of the estimate,
    ε the NOISE_FLOOR of fitness/with_priors.glsl, n the samples that are independent: profile likelihood (Venzon
    and Moolgavkar 1988, A Method for Computing Profile-Likelihood-Based Confidence Intervals) at a few values, between
    −9 and 9. Only searched numbers without a normal prior, which would choose between optima by itself, are looked at,
    and only with a robust loss: ε is in its units. Of one texel it tells little: a highlight that falls between the
    lamps makes a mirror of matt paint (modes.py). What is held is not found anew, so that an alternative may
    look worse than its best.
    """

    def __init__(
        self, model: ReflectanceModel, fixed: Collection[str], fitness: Fitness, domain_defines: dict[str, int]
    ):
        self._fitness = fitness
        self._asked = asked(model, fixed, fitness)
        self._pass = None
        if self._asked:
            solved = linear_weights(model, _solved(model, fixed))
            defines = {**domain_defines, "ALTERNATIVES": sum(p.components for p in self._asked)}
            self._pass = alternatives_pass(model, build_free_parameters(model, fixed), solved, fitness, defines)
        self._targets: list[Any] = []

    def measuring(
        self, domain: DomainTextures, estimates: Estimates, resolved: bool, bands: Bands, seconds: float
    ) -> Iterator[None]:
        """Find what ``read`` returns, in bands of rows of about ``seconds``; yields after each."""
        if self._pass is None:
            return
        if not self._targets:
            self._targets = [textures.empty(*estimates.size) for _ in self._pass.kernel.targets]
        inputs = {**domain.textures, **estimates.bindings(resolved)}
        constants = loss_constants(domain, self._fitness.delta)
        yield from self._pass.in_bands("alternatives", bands, seconds, self._targets, inputs, constants)

    def read(self) -> dict[str, np.ndarray]:
        """Return what was measured last: name → (h, w, components) float32, packed; 0 where none is solved."""
        if self._pass is None:
            return {}
        packed = np.concatenate([textures.download(t) for t in self._targets], axis=-1)
        ends = np.cumsum([p.components for p in self._asked])
        return {p.name: packed[..., end - p.components : end] for p, end in zip(self._asked, ends, strict=True)}

    def close(self) -> None:
        """Free the shader and its targets."""
        if self._pass is not None:
            self._pass.close()
        self._targets = []


def asked(model: ReflectanceModel, fixed: Collection[str], fitness: Fitness) -> tuple[Parameter, ...]:
    """Return the parameters of which alternatives are tried."""
    return tuple(
        p for p in model.parameters
        if fitness.loss == "robust" and p.name not in fixed and not p.is_normal and not has_basis(p, model)
        and (p.prior is None or p.prior.kind != "normal")
    )  # fmt: skip


def _solved(model: ReflectanceModel, fixed: Collection[str]) -> list[Parameter]:
    """Return the linear weights to find anew: the first MAX_WEIGHTS, as many as the closed form takes."""
    solved: list[Parameter] = []
    for p in model.parameters:
        room = MAX_WEIGHTS - sum(q.components for q in solved)
        if p.name not in fixed and has_basis(p, model) and p.components <= room:
            solved.append(p)
    return solved
