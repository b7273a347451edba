"""Objective and starts of every iterative peer: the program's robust fitness and first guess."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import lambertian
from .models import Box, Geometry, geometry_of, radiance
from .problem import Problem, Values

# Roughnesses of the starts, besides the model's defaults: those of the program's multi-start refinement.
STARTS: dict[str, tuple[dict[str, float], ...]] = {
    "lambert": (),
    "principled": ({"roughness": 0.2}, {"roughness": 0.35}, {"roughness": 0.75}),
    "cook_torrance_two_lobe": (
        {"r1": 0.15, "r2": 0.35}, {"r1": 0.2, "r2": 0.5}, {"r1": 0.3, "r2": 0.6}, {"r1": 0.08, "r2": 0.2},
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Loss:
    """The loss. kind: "cauchy" for Σ log(1 + (e/δ)²), "linear" for Σ e². e: error over the texel's brightness.

    delta: δ. shadow: samples below it, over the texel's brightness, are omitted; 0 keeps all.
    """

    kind: str = "cauchy"
    delta: float = 0.05
    shadow: float = 0.08


class Objective:
    """The samples of a problem over each texel's brightness, with a loss's weights; float64 numpy.

    target: (K, T, 3). weights: (K, T). gains: (K, T, 3), factors from a radiance to the target's unit.
    """

    def __init__(self, problem: Problem, loss: Loss):
        self.problem, self.loss, self.box = problem, loss, Box(problem.model)
        scale = problem.scale()
        dark = (problem.grey < loss.shadow * scale) & (loss.shadow > 0)
        self.weights = problem.weights * ~dark
        self.target = problem.radiance / scale[:, None]
        self.gains = problem.intensities[:, None, :] / scale[:, None]
        self.geometry = geometry_of(problem)

    def residuals(self, x: np.ndarray, t: int) -> np.ndarray:
        """Return (S, K, 3) residuals of S candidates x (S, size) at texel t, without samples of weight 0."""
        used, g = self.weights[:, t] > 0, self.geometry
        part = Geometry(g.lights[used], g.views[:, t : t + 1], g.half[:, used, t : t + 1], g.between[used, t : t + 1])
        values = self.box.values(np, x)
        diffuse, specular = radiance(np, self.problem.model, values, part)
        shown = diffuse[..., None] * values["base_color"] + specular[..., None]
        return np.moveaxis(shown * self.gains[used, t, None] - self.target[used, t, None], 1, 0)

    def cost(self, x: np.ndarray, t: int) -> np.ndarray:
        """Return (S,), the losses of S candidates at texel t."""
        squared = self.residuals(x, t) ** 2
        if self.loss.kind == "cauchy":
            squared = np.log1p(squared / self.loss.delta**2)
        return squared.sum(axis=(1, 2))

    def starts(self, restarts: bool) -> list[np.ndarray]:
        """Return starts, (T, size) each: the trimmed Lambertian fit with default roughness, and with each of STARTS."""
        guess = lambertian.trimmed(self.problem).values
        rows = ({}, *(STARTS[self.problem.model] if restarts else ()))
        return [self.box.numbers(self._start(guess, row)) for row in rows]

    def _start(self, guess: Values, row: dict[str, float]) -> Values:
        values = {}
        for p in self.box.model.parameters:
            default = np.broadcast_to(np.asarray(p.default), (self.problem.count, p.components))
            value = guess.get(p.name, default) if p.name not in row else np.full_like(default, row[p.name])
            values[p.name] = value if p.is_normal else np.clip(value, *p.range)
        return values
