"""Oracle of the surface phase: slopes of the normals, their covariance, and the relaxed slopes, in float64."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from tests.oracles import confidence as confidence_oracle
from tests.oracles.swarm import frames

OUTLIER_Z = 2.5  # as in shaders/surface/relax.glsl
_STEP = 1e-6  # radians


def grid_of(domain):
    """Return (H, W, 2, 2) texel steps, [along x, along y][tangent, bitangent]; no seams, 0 without neighbours."""
    position, frame = domain.bake.position.astype(np.float64), frames(domain.bake)
    steps = np.zeros((*domain.shape, 2, 2))
    for row, column in np.argwhere(domain.solvable):
        for axis, (down, right) in enumerate(((0, 1), (1, 0))):
            ends = []
            for side in (-1, 1):
                place = row + side * down, column + side * right
                inside = 0 <= place[0] < domain.shape[0] and 0 <= place[1] < domain.shape[1]
                ends.append(place if inside and domain.solvable[place] else (row, column))
            count = sum(end != (row, column) for end in ends)
            way = (position[ends[1]] - position[ends[0]]) / max(count, 1)
            steps[row, column, axis] = frame[row, column, :2] @ way
    return steps


def slopes_of(normal, grid, lean):
    """Return (H, W, 2) rise along a step in x and in y. normal: (H, W, 3) in the texel's frame. lean: (H, W, 2)."""
    facing = normal[..., 2] + (normal[..., :2] * lean).sum(axis=-1)
    return np.einsum("hwai,hwi->hwa", grid, -normal[..., :2] / facing[..., None])


def covariance_of(domain, model, values, variance, grid, lean):
    """Return (H, W, 2, 2) covariance of the slopes for samples of this variance (H, W).

    Searched parameters are fixed. Each free one has a prior as wide as its range.
    """
    fixed = [p.name for p in model.parameters if p.kind == "search" and not p.is_normal]
    unknowns = confidence_oracle.unknowns(model, fixed)
    j = confidence_oracle.jacobian(domain, model, values, fixed)
    weight = domain.stack.values[..., 3].astype(np.float64)
    precision = np.einsum("khw,akhwc,bkhwc->hwab", weight, j, j) / variance[..., None, None] + np.eye(len(unknowns))
    normal = [i for i, (p, _, _) in enumerate(unknowns) if p.is_normal]
    angles = np.linalg.inv(precision)[..., normal, :][..., normal] * (np.pi / 2) ** 2
    (p,) = {p for p, _, _ in unknowns if p.is_normal}
    tilted = [
        slopes_of(confidence_oracle.moved(values, p, i, np.full(domain.shape, _STEP))[p.name], grid, lean)
        for i in (0, 1)
    ]
    change = (np.stack(tilted, axis=-1) - slopes_of(values[p.name].astype(np.float64), grid, lean)[..., None]) / _STEP
    return change @ angles @ np.swapaxes(change, -1, -2)


def circulation(begins):
    """Return (L, H, W, 2) coefficients of the slopes in the circulations. begins: (H, W) bool, loops' first texels."""
    loops = []
    for row, column in np.argwhere(begins):
        factors = np.zeros((*begins.shape, 2))
        round_trip = [(row, column), (row, column + 1), (row + 1, column + 1), (row + 1, column)]
        for (r0, c0), (r1, c1) in zip(round_trip, [*round_trip[1:], round_trip[0]], strict=True):
            for end in ((r0, c0), (r1, c1)):  # an edge has the mean slope of its ends
                factors[end] += np.array((c1 - c0, r1 - r0)) / 2
        loops.append(factors)
    return np.array(loops)


def relaxed(slopes, covariance, begins, weight):
    """Return (H, W, 2) slopes of least ½ Σ (s − s₀)ᵀ P⁻¹ (s − s₀) + Σ κ |circulation|, by the dual's least squares."""
    c = circulation(begins).reshape(int(begins.sum()), -1)
    root = np.linalg.cholesky(covariance)
    half = np.einsum("lhwi,hwij->lhwj", c.reshape(-1, *slopes.shape), root).reshape(len(c), -1)  # C √P
    loop_sums, sigma = c @ slopes.reshape(-1), np.sqrt((half**2).sum(axis=1))
    kappa = weight / (sigma * (1 + (loop_sums / (OUTLIER_Z * sigma)) ** 4))
    target = np.linalg.solve(root, slopes[..., None]).reshape(-1)  # √P⁻¹ s₀
    dual = lsq_linear(half.T, target, (-kappa, kappa), method="bvls", tol=1e-14, max_iter=10000)
    correction = np.einsum("hwij,hwj->hwi", covariance, (c.T @ dual.x).reshape(slopes.shape))
    return slopes - correction


def smoothed(slopes, covariance, grid, solvable, bandwidth=0.1):
    """Return (H, W, 2) posterior slopes under a plane through each texel's neighbours plus relief of a variance t².

    grid: (H, W, 2, 2) texel steps, as of ``grid_of``; their lengths convert slopes to those of the surface. A texel
    with fewer than three like neighbours keeps its slope. t² is DerSimonian and Laird's, from explicit hat matrices.
    """
    result, all_slopes, all_covariances = slopes.copy(), slopes, covariance
    takes_part = solvable & (np.trace(covariance, axis1=-2, axis2=-1) > 0)
    for row, column in np.argwhere(takes_part):
        lengths, around = np.linalg.norm(grid[row, column], axis=-1), []
        slopes, covariance = all_slopes / lengths, all_covariances / np.outer(lengths, lengths)
        own, variance = slopes[row, column], np.trace(covariance, axis1=-2, axis2=-1) / 2
        for r, c in np.argwhere(takes_part):
            if 0 < max(abs(r - row), abs(c - column)) <= 2:
                around.append((r, c))
        index = tuple(np.array(around, int).reshape(-1, 2).T)
        y, v = slopes[index] - own, np.maximum(variance[index], 1e-3 * variance[row, column])
        k = np.exp(-0.5 * (y**2).sum(axis=1) / (bandwidth**2 + v + variance[row, column]))
        if k.sum() < 3:
            continue
        x = np.column_stack([np.ones(len(around)), index[1] - column, index[0] - row])

        def fit(precision, x=x, y=y):
            normal = x.T @ (precision[:, None] * x)
            inverse = np.linalg.inv(normal + np.diag([0, 1, 1]) * 1e-4 * normal[0, 0])
            return inverse @ x.T @ (precision[:, None] * y), inverse, x @ inverse @ x.T

        w = k / v
        plane, _, hat = fit(w)
        # The sum of squares that the plane leaves, its expectation at t² = 0, and what a unit of t² adds to that.
        q = 0.5 * ((w[:, None] * y**2).sum() - ((x.T @ (w[:, None] * y)) * plane).sum())
        freedom = k.sum() - np.diag(hat) @ (k * w)
        remainder = w.sum() - np.diag(hat) @ w**2
        if remainder < 0.01 * w.sum():
            continue
        t2 = max((q - freedom) / remainder, 0)
        plane, inverse, _ = fit(k / (v + t2))
        unexplained = (t2 + inverse[0, 0]) * np.eye(2)
        p = covariance[row, column]
        result[row, column] = lengths * (own + p @ np.linalg.solve(p + unexplained, plane[0]))
    return result
