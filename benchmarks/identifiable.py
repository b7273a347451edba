"""Cramér–Rao bound of a texel's parameters, from ground truth, in float64."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.peers.models import geometry_of, radiance
from benchmarks.peers.problem import problem_of
from benchmarks.subjects import Card
from irpso_addon.reflectance.model import load_model

_STEP = 1e-5  # of a range: central differences in float64 are precise to 1e-9


def bounds(card: Card, noise: float) -> dict[str, np.ndarray]:
    """Return parameter → (T,), the least standard deviation of an unbiased estimate, over the parameter's range.

    All parameters are unknown; every sample has Gaussian noise of standard deviation ``noise`` and no shadow:
    σ² = noise² (JᵀJ)⁻¹ (Cramér 1946). A normal is two angles with a range of π/2; of several components the worst
    counts. Infinite where JᵀJ is singular.
    """
    columns = _jacobian(card)
    matrix = np.einsum("aktc,bktc->tab", columns, columns)
    regular = np.linalg.cond(matrix) < 1e14
    inverse = np.linalg.inv(np.where(regular[:, None, None], matrix, np.eye(matrix.shape[-1])))
    deviation = np.where(regular[:, None], noise * np.sqrt(np.einsum("taa->ta", inverse)), np.inf)
    deviations, at = {}, 0
    for p in load_model(card.model).parameters:
        size = 2 if p.is_normal else p.components
        deviations[p.name] = deviation[:, at : at + size].max(axis=1)
        at += size
    return deviations


def _jacobian(card: Card) -> np.ndarray:
    """Return (n, K, T, 3) derivatives of the radiance by every component, per range."""
    problem = problem_of(card.domain, card.model, card.truth)
    geometry = geometry_of(problem)

    def render(values: Mapping[str, np.ndarray]) -> np.ndarray:
        diffuse, specular = radiance(np, card.model, values, geometry)
        return diffuse[..., None] * values["base_color"] + specular[..., None]

    columns = []
    for p in load_model(card.model).parameters:
        truth = problem.truth[p.name]
        for i in range(2 if p.is_normal else p.components):
            ends = []
            for sign in (-1, 1):
                if p.is_normal:
                    angle = sign * _STEP * np.pi / 2
                    moved = np.cos(angle) * truth + np.sin(angle) * _tangents(truth)[i]
                else:
                    moved = truth.copy()
                    moved[:, i] += sign * _STEP * (p.range[1] - p.range[0])
                ends.append(render({**problem.truth, p.name: moved}))
            columns.append((ends[1] - ends[0]) / (2 * _STEP))
    return np.array(columns)


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors (T, 3) perpendicular to normals of the upper hemisphere and to each other."""
    first = np.stack([normal[:, 2], np.zeros(len(normal)), -normal[:, 0]], axis=-1)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return first, np.cross(normal, first)
