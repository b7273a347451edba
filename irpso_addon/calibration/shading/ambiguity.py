"""Resolution of the ambiguity of uncalibrated photometric stereo: the 3×3 matrix between lights and normals."""

from __future__ import annotations

import numpy as np

from ...core.filters import blurred

_SMOOTH = 1.0  # pixels of the blur before normals are differentiated
_INSIDE = 0.7  # least part of the blur's weight on good pixels
_STEEP = 90.0  # percentile of the normals' change from pixel to pixel: above, a jump
_ROUNDS = 40  # of reweighting
_WIDTH = 1.5  # medians of the residuals at which a row's weight is a half
_UNEVEN = 0.15  # of the lights' log intensities: scale of the Cauchy loss
_STARTS = tuple(
    (across, up, depth)
    for depth in (-1.2, -0.6, 0.0, 0.6, 1.2)
    for across, up in ((0, 0), (0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5))
)
_STEPS, _STEP = 60, 1e-5  # of Gauss–Newton's method
_FLATTEST = 2.5  # most of |depth|, a logarithm
_MAX_TURN = np.radians(5.0)  # prior standard deviation of a rotation
_CORRELATED = 20.0  # rows with a common error: neighbours are correlated
_RIM = 4  # pixels: width of the outline's band in which normals should point outward


def integrable(normals: np.ndarray, good: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the matrix (3, 3) that makes scaled normals (P, 3) integrable, up to a bas-relief, and its certainty, 0…1.

    With columns m of the matrix, ∂y(b·m₁ / b·m₃) = ∂x(b·m₂ / b·m₃) is linear in m₃ × m₁ and m₃ × m₂ (Yuille & Snow
    1997): (m₃ × m₁)·(b × ∂y b) = (m₃ × m₂)·(b × ∂x b). Albedo cancels. Their null vector is found by reweighting, which
    suppresses edges of the surface. mask: (H, W) bool of the P pixels. good: (P,) bool, pixels with a small residual.
    The certainty is 1 − the ratio of the two smallest singular values.
    """
    rows = _rows(normals, good, mask)[:, :6]
    if len(rows) < 100:
        return np.eye(3), 0.0
    weight = np.ones(len(rows))
    for _ in range(_ROUNDS):
        # The eigenvector of the smallest eigenvalue.
        values, vectors = np.linalg.eigh((rows * weight[:, None]).T @ (rows * weight[:, None]))
        solution = vectors[:, 0]
        residual = np.abs(rows @ solution)
        weight = 1 / np.sqrt(1 + (residual / max(_WIDTH * float(np.median(residual)), 1e-12)) ** 2)
    first, second = solution[:3], solution[3:]
    third = np.cross(first, second)
    third /= np.linalg.norm(third)
    matrix = np.stack([np.cross(first, third), np.cross(second, third), third], axis=-1)
    return matrix, float(1 - np.sqrt(max(values[0], 0) / max(values[1], 1e-300)))


def rotation(
    normals: np.ndarray,
    good: np.ndarray,
    mask: np.ndarray,
    plane: np.ndarray | None = None,
    covariance: np.ndarray | None = None,
) -> np.ndarray:
    """Return the small rotation R (3, 3) that makes normals (P, 3) integrable: normals @ R.

    The constraint is that of ``integrable``, with orthonormal columns. plane: (P, 2) x and y of the pixels' rays at
    distance 1, for a perspective camera: the slopes of log depth are n₁ and n₂ over n₃ − x n₁ − y n₂ (Quéau, Durou &
    Aujol 2018), which adds (m₁ × m₂)·(y b × ∂y b + x b × ∂x b). covariance: (3, 3), radians², of the rotation by other
    evidence, whose mean is the identity; by default a prior that keeps undetermined rotations near it.
    """
    rows = _rows(normals, good, mask, plane)
    vector, known = np.zeros(3), np.linalg.inv(np.eye(3) * _MAX_TURN**2 if covariance is None else covariance)
    if len(rows) < 100:
        return np.eye(3)
    for _ in range(_ROUNDS):
        residual = rows @ _constrained(_rodrigues(vector))
        shifted = [rows @ _constrained(_rodrigues(vector + _STEP * axis)) for axis in np.eye(3)]
        jacobian = (np.stack(shifted, axis=-1) - residual[:, None]) / _STEP
        width = max(float(np.median(np.abs(residual))), 1e-12)
        weight = 1 / (1 + (residual / (_WIDTH * width)) ** 2)
        certainty = 1 / (_CORRELATED * (1.4826 * width) ** 2)  # inverse variance of a row
        square = certainty * (jacobian * weight[:, None]).T @ jacobian + known
        slope = certainty * jacobian.T @ (weight * residual) + known @ vector
        step = np.linalg.solve(square, slope)
        vector = vector - step
        if np.abs(step).max() < 1e-7:
            break
    return _rodrigues(vector)


def _constrained(matrix: np.ndarray) -> np.ndarray:
    """Return m₃ × m₁, m₃ × m₂ and m₁ × m₂ of a rotation's columns, (9,)."""
    return np.concatenate([matrix[:, 1], -matrix[:, 0], matrix[:, 2]])


def _rodrigues(vector: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) by a vector (3,), axis times angle in radians (Rodrigues 1840)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _rows(normals: np.ndarray, good: np.ndarray, mask: np.ndarray, plane: np.ndarray | None = None) -> np.ndarray:
    """Return b × ∂y b, −b × ∂x b, y b × ∂y b + x b × ∂x b (N, 9) of smoothed unit normals away from jumps."""
    unit = normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    image, known = np.zeros((*mask.shape, 3)), np.zeros(mask.shape)
    known[mask] = good
    image[mask] = unit * good[:, None]
    coverage = blurred(known, _SMOOTH)
    smooth = np.stack([blurred(image[..., i], _SMOOTH) for i in range(3)], axis=-1)
    smooth /= np.maximum(coverage, 1e-3)[..., None]
    up, across = np.gradient(smooth, axis=(0, 1))
    inside = mask & (coverage > _INSIDE)
    change = np.sqrt((up**2 + across**2).sum(axis=-1))
    if inside.any():
        inside &= change < np.percentile(change[inside], _STEEP)
    vertical, horizontal = np.cross(smooth[inside], up[inside]), np.cross(smooth[inside], across[inside])
    ray = np.zeros((len(vertical), 2)) if plane is None else plane[inside[mask]]
    return np.concatenate([vertical, -horizontal, ray[:, 1:] * vertical + ray[:, :1] * horizontal], axis=-1)


def even_relief(lights: np.ndarray) -> np.ndarray:
    """Return the bas-relief transformation (3, 3) of normals under which lights (K, 3) have the most equal strengths.

    Integrability leaves n → (n₁ + a n₃, n₂ + b n₃, c n₃) free (Belhumeur, Kriegman & Yuille 1999). The strength of
    lamps does not depend on their direction: a robust fit (Cauchy's loss), from many starts, makes most
    intensities equal.
    """
    best, least = np.zeros(3), np.inf
    for start in _STARTS:
        parameters, cost = _minimised(np.array(start), lights)
        if cost < least:
            best, least = parameters, cost
    return bas_relief(best)


def bas_relief(parameters: np.ndarray) -> np.ndarray:
    """Return H (3, 3) of (a, b, log c): normals become normals @ H, lights become lights @ inv(H)ᵀ."""
    a, b, depth = parameters
    return np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [a, b, np.exp(depth)]])


def _minimised(parameters: np.ndarray, lights: np.ndarray) -> tuple[np.ndarray, float]:
    """Return parameters and cost after a damped Gauss–Newton search."""
    damping, residual = 1e-2, _unevenness(parameters, lights)
    cost = _cost(residual)
    for _ in range(_STEPS):
        weight = 1 / (1 + residual**2)
        moved = [_unevenness(parameters + _STEP * axis, lights) for axis in np.eye(3)]
        jacobian = (np.stack(moved, axis=-1) - residual[:, None]) / _STEP
        square = (jacobian * weight[:, None]).T @ jacobian
        step = np.linalg.solve(square + damping * np.diag(np.diag(square) + 1e-9), jacobian.T @ (weight * residual))
        trial = parameters - step
        trial[2] = np.clip(trial[2], -_FLATTEST, _FLATTEST)
        trial_residual = _unevenness(trial, lights)
        if _cost(trial_residual) < cost:
            parameters, residual, damping = trial, trial_residual, damping / 3
            improvement, cost = cost - _cost(trial_residual), _cost(trial_residual)
            if improvement < 1e-7:
                break
        else:
            damping *= 4
            if damping > 1e6:
                break
    return parameters, cost


def _unevenness(parameters: np.ndarray, lights: np.ndarray) -> np.ndarray:
    moved = lights @ np.linalg.inv(bas_relief(parameters)).T
    strength = np.log(np.maximum(np.linalg.norm(moved, axis=-1), 1e-12))
    return (strength - np.median(strength)) / _UNEVEN


def _cost(residual: np.ndarray) -> float:
    return float(np.log1p(residual**2).mean())


def outward_cosine(normals: np.ndarray, mask: np.ndarray) -> float:
    """Return the mean cosine of tilt and the direction from the mask's centroid at its outline; 0 without an outline.

    normals: (P, 3), unit, of the pixels of the mask (H, W). The mean is weighted by tilt. Normals of a solid point
    outward; without an outline, relief and its inverse fit photographs equally well.
    """
    rows, columns = np.nonzero(mask)
    inner = mask.copy()
    for _ in range(_RIM):
        padded = np.pad(inner, 1)
        inner = inner & padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
    rim = (mask & ~inner)[mask]
    # The edge of the image is not an outline.
    height, width = mask.shape
    rim &= (rows >= _RIM) & (rows < height - _RIM) & (columns >= _RIM) & (columns < width - _RIM)
    if rim.sum() < 20:
        return 0.0
    outward = np.stack([columns - columns.mean(), rows - rows.mean()], axis=-1)[rim]
    outward /= np.maximum(np.linalg.norm(outward, axis=-1, keepdims=True), 1e-9)
    tilt = normals[rim, :2]
    return float((tilt * outward).sum() / max(np.linalg.norm(tilt, axis=-1).sum(), 1e-9))
