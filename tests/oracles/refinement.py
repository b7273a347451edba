"""Oracle of the refinement: one Levenberg–Marquardt step in float64, for cards under distant lights."""

from __future__ import annotations

import numpy as np

from tests.oracles import reflectance as oracles
from tests.oracles.loss import loss, loss_weight

_STEP = 1e-6  # of a range
_FARTHEST = 0.2  # as in shaders/refine/step.glsl
_FLOOR = 0.01  # as in shaders/fitness/with_priors.glsl


class Texel:
    """One texel's samples and loss. model: a ReflectanceModel, with its priors.

    scale, delta: of the robust loss. power: Fitness.highlight_power.
    """

    def __init__(self, model, domain, row, column, loss, delta, scale, power=1.0):
        assert domain.card and not domain.lights[:, 3].any() and not domain.views[:, 3].any()
        self.model, self.loss = model, loss
        samples = domain.stack.values[:, row, column].astype(np.float64)
        below = np.maximum(-samples[:, 3:], 0)
        self.bound = (below.astype(int) & (1, 2, 4)) > 0
        self.weight = np.where(below > 0, 2 * (below % 1), samples[:, 3:])
        self.radiance = np.where(self.weight > 0, samples[:, :3], 0)
        self.lights, self.views = (a[:, :3].astype(np.float64) for a in (domain.lights, domain.views))
        self.intensities = domain.intensities.astype(np.float64)
        self.white = self.intensities.mean()
        level = self.white * scale
        self.unit = 1 / (delta * level) if loss == "cauchy" else 1.0
        brightest = np.maximum(self.radiance.max(axis=-1, keepdims=True), level)
        self.error_scale = (level / brightest) ** power if loss == "cauchy" else np.ones_like(self.weight)
        self.unknowns = [(p, i) for p in model.parameters for i in range(2 if p.is_normal else p.components)]

    def error(self, values):
        """Return (K, 3): render of ``values``, name → (components,), minus the samples."""
        flat = {name: v[0] if len(v) == 1 else v for name, v in values.items()}
        render = oracles.MODELS[self.model.name](flat, self.lights, self.views) * self.intensities
        off = render - self.radiance
        return np.where((self.weight > 0) & ~(self.bound & (off > 0)), off, 0)

    def residuals(self, values):
        """Return (K, 3) errors in units of δ."""
        return self.unit * self.error_scale * self.error(values)

    def mean_loss(self, values):
        """Return the mean loss over weighted samples and channels."""
        e = self.residuals(values)
        return (self.weight * loss(self.loss, e)).sum() / (3 * self.weight.sum())

    def prior_cost(self, values):
        """Return −2 log of the model's priors, up to a constant."""
        total = 0.0
        for p in self.model.parameters:
            if p.prior is not None:
                away, width = np.abs(np.asarray(values[p.name]) - p.prior.value), p.prior.width
                if p.prior.vanishes_with:
                    low, high = self.model.parameter(p.prior.vanishes_with).range
                    width *= max(1 - ((values[p.prior.vanishes_with][0] - low) / (high - low)) ** 2, 0.02)
                concave = 2 * (away - away**2 / (2 * (p.range[1] - p.range[0]))) / width
                total += float((concave if p.prior.kind == "concave" else (away / width) ** 2).sum())
        return total

    def cost(self, values):
        """Return the objective: −2 log of the posterior with noise of unknown variance, up to a monotone map."""
        excess = np.expm1(self.prior_cost(values) / (3 * self.weight.sum()))
        return self.mean_loss(values) * (1 + excess) + _FLOOR * excess

    def moved(self, values, by):
        """Return the values after a step (n,) in fractions of the ranges (π/2 for a normal), clipped to the ranges."""
        after, at = {}, 0
        for p in self.model.parameters:
            value = np.array(values[p.name], np.float64)
            if p.is_normal:
                first, second = tangents(value)
                value = value + np.pi / 2 * (by[at] * first + by[at + 1] * second)
                value[2] = max(value[2], 0)
                after[p.name], at = value / np.linalg.norm(value), at + 2
            else:
                width = p.range[1] - p.range[0]
                after[p.name] = np.clip(value + width * by[at : at + p.components], *p.range)
                at += p.components
        return after

    def equations(self, values):
        """Return JᵀWJ (n, n) and JᵀWe (n,), with the weights of iteratively reweighted least squares."""
        e = self.error(values)
        scaled = self.unit * self.error_scale * e
        weight = self.weight * self.error_scale**2 * loss_weight(self.loss, scaled, self.white)
        weight = (weight * ~(self.bound & (e == 0))).ravel()
        j = []
        for u in range(len(self.unknowns)):
            ends = [self.error(self.moved(values, sign * _STEP * np.eye(len(self.unknowns))[u])) for sign in (-1, 1)]
            j.append(((ends[1] - ends[0]) / (2 * _STEP)).ravel())
        j = np.array(j)
        a, gradient = (weight * j) @ j.T, (weight * j) @ e.ravel()
        part = (self.mean_loss(values) + _FLOOR) / self.unit**2 * (2 if self.loss == "l1" else 1)
        for u, (p, _) in enumerate(self.unknowns):
            ends = [self.prior_cost(self.moved(values, sign * _STEP * np.eye(len(gradient))[u])) for sign in (-1, 1)]
            gradient[u] += part * (ends[1] - ends[0]) / (4 * _STEP)
            if p.prior is not None and p.prior.kind == "normal":
                a[u, u] += part * ((p.range[1] - p.range[0]) / p.prior.width) ** 2
        return a, gradient

    def step(self, values, damping):
        """Return (n,), the solution of (JᵀWJ + λ diag) step = −JᵀWe, not clipped."""
        a, gradient = self.equations(values)
        return np.linalg.solve(a + damping * np.diag(np.diag(a)), -gradient)

    def between(self, values, others):
        """Return (n,), the step from one material to a nearby one."""
        by = []
        for p in self.model.parameters:
            change = np.asarray(others[p.name]) - values[p.name]
            if p.is_normal:
                by += [axis @ change / (np.pi / 2) for axis in tangents(np.asarray(values[p.name]))]
            else:
                by += list(change / (p.range[1] - p.range[0]))
        return np.array(by)

    def inside(self, values, by):
        """Return whether a step stays in all ranges and below the refinement's largest step of a searched parameter."""
        for (p, i), one in zip(self.unknowns, by, strict=True):
            x = 0.5 if p.is_normal else (values[p.name][i] - p.range[0]) / (p.range[1] - p.range[0])
            bounded = not p.is_normal and p.kind == "search"
            if not 0 < x + one < 1 or (bounded and abs(one) >= _FARTHEST):
                return False
        return True


def tangents(normal):
    """Return the axes of a normal's two angles: with Marquardt's scaling a step depends on them."""
    first = np.cross(normal, (0.0, 0, 1) if abs(normal[2]) < 0.9 else (1.0, 0, 0))
    first /= np.linalg.norm(first)
    return first, np.cross(normal, first)
