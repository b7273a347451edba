"""What every iterative peer minimises, and where it begins: the program's own robust fitness and seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import lambertian
from .models import Box, Geometry, geometry_of, radiance
from .problem import Problem, Values

# Roughnesses to begin from, besides the model's defaults: those of the program's multi-start refinement.
STARTS: dict[str, tuple[dict[str, float], ...]] = {
    "lambert": (),
    "principled": ({"roughness": 0.2}, {"roughness": 0.35}, {"roughness": 0.75}),
    "cook_torrance_two_lobe": (
        {"r1": 0.15, "r2": 0.35}, {"r1": 0.2, "r2": 0.5}, {"r1": 0.3, "r2": 0.6}, {"r1": 0.08, "r2": 0.2},
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Loss:
    """kind: "cauchy" for Σ log(1 + (e/δ)²), "linear" for Σ e². e is over the texel's brightness.

    delta: δ. shadow: samples below it, over the texel's brightness, are left out; 0 keeps all.
    """

    kind: str = "cauchy"
    delta: float = 0.05
    shadow: float = 0.08


class Objective:
    """The images of a problem over each texel's brightness, with the weights that a loss gives them; float64 numpy.

    target: (K, T, 3). weights: (K, T). gains: (K, T, 3) what a radiance is multiplied by to be compared.
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
        """(S, K, 3) weighted residuals of S tries x (S, size) at texel t; no rows for samples without weight."""
        used, g = self.weights[:, t] > 0, self.geometry
        part = Geometry(g.lights[used], g.views[:, t : t + 1], g.half[:, used, t : t + 1], g.between[used, t : t + 1])
        values = self.box.values(np, x)
        diffuse, specular = radiance(np, self.problem.model, values, part)
        shown = diffuse[..., None] * values["base_color"] + specular[..., None]
        return np.moveaxis(shown * self.gains[used, t, None] - self.target[used, t, None], 1, 0)

    def cost(self, x: np.ndarray, t: int) -> np.ndarray:
        """(S,) the loss of S tries at texel t."""
        squared = self.residuals(x, t) ** 2
        if self.loss.kind == "cauchy":
            squared = np.log1p(squared / self.loss.delta**2)
        return squared.sum(axis=(1, 2))

    def starts(self, restarts: bool) -> list[np.ndarray]:
        """Return (T, size) places to begin: the trimmed Lambertian fit with default roughness, and with each start."""
        seed = lambertian.trimmed(self.problem).values
        rows = ({}, *(STARTS[self.problem.model] if restarts else ()))
        return [self.box.numbers(self._start(seed, row)) for row in rows]

    def _start(self, seed: Values, row: dict[str, float]) -> Values:
        values = {}
        for p in self.box.model.parameters:
            default = np.broadcast_to(np.asarray(p.default), (self.problem.count, p.components))
            value = seed.get(p.name, default) if p.name not in row else np.full_like(default, row[p.name])
            values[p.name] = value if p.is_normal else np.clip(value, *p.range)
        return values
