"""Bundle adjustment: poses, lens and points of least reprojection error (Triggs et al. 2000).

Levenberg–Marquardt with a robust (Cauchy) loss; points are eliminated by the Schur complement. Axes and poses are those
of ``poses``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

_SCALE = 1.0  # pixels: scale of the Cauchy loss
_ITERATIONS = 60
_LIKELY_RADIAL = 0.1  # standard deviation of k1: cameras correct most of the distortion
_CONVERGED = 1e-7  # relative decrease of the loss that ends the iteration


@dataclass(frozen=True)
class Bundle:
    """rotations: (K, 3, 3) and shifts: (K, 3), the poses. points: (P, 3). focal: pixels. radial: k1 of the lens.

    centres: (K, 2) principal points, pixels from the upper left corner.
    """

    rotations: np.ndarray
    shifts: np.ndarray
    points: np.ndarray
    focal: float
    radial: float
    centres: np.ndarray


@dataclass(frozen=True)
class Views:
    """Observations of points: (M,) photograph, (M,) point, (M, 2) pixels from the upper left corner."""

    photograph: np.ndarray
    point: np.ndarray
    pixels: np.ndarray


def seen(bundle: Bundle, views: Views) -> np.ndarray:
    """Return the pixels (M, 2) at which a bundle predicts the views."""
    return _projected(bundle, views)[0]


def rotation_errors(bundle: Bundle, views: Views) -> np.ndarray:
    """Return the standard errors (K,), in degrees, of the photographs' rotations about their least certain axes.

    They follow from each pose's normal equations, with lens and points fixed, and the weighted mean of squared errors.
    """
    left, _, _ = _normal_equations(bundle, views, 0.0, None, bundle)
    square = ((seen(bundle, views) - views.pixels) ** 2).sum(axis=1)
    weight = 1 / (1 + square / _SCALE**2)
    variance = (weight * square).sum() / max(2 * weight.sum() - len(left), 1.0)
    blocks = np.stack([left[k : k + 6, k : k + 6] for k in range(0, len(left), 6)])
    covariance = variance * np.linalg.pinv(blocks, hermitian=True)[:, :3, :3]
    return np.degrees(np.sqrt(np.linalg.eigvalsh(covariance)[:, -1]))


def adjusted(bundle: Bundle, views: Views, lens: float, relief: float | None) -> Bundle:
    """Return the bundle of least robust reprojection error.

    lens: relative standard deviation of the focal length about that of ``bundle``; k1 is then free, too; 0 fixes both.
    relief: standard deviation of the points' heights about z = 0; their positions are then free; None fixes all points.
    """
    first = bundle
    loss, damping = _loss(bundle, views, lens, relief, first), 1e-4
    for _ in range(_ITERATIONS):
        left, right, eliminated = _normal_equations(bundle, views, lens, relief, first)
        for _ in range(8):
            new = _stepped(bundle, left, right, eliminated, damping, lens)
            new = new if relief is None else _rescaled(new, first)
            new_loss = _loss(new, views, lens, relief, first)
            if new_loss < loss:
                break
            damping *= 6
        else:
            return bundle
        gain, bundle, loss, damping = (loss - new_loss) / loss, new, new_loss, max(damping / 6, 1e-9)
        if gain < _CONVERGED:
            break
    return bundle


def _rescaled(bundle: Bundle, first: Bundle) -> Bundle:
    """Scale a bundle to the size of the first one's points, which photographs do not determine.

    Without this the prior on the relief would shrink the scene.
    """
    target, size = (np.linalg.norm(one.points[:, :2] - one.points[:, :2].mean(axis=0)) for one in (first, bundle))
    scale = float(target / size)
    return replace(bundle, points=scale * bundle.points, shifts=scale * bundle.shifts)


def _projected(bundle: Bundle, views: Views) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return pixels (M, 2), points in camera axes (M, 3), on the plane at depth 1 (M, 2), and rotated only (M, 3)."""
    k = views.photograph
    turned = np.einsum("mij,mj->mi", bundle.rotations[k], bundle.points[views.point])
    local = turned + bundle.shifts[k]
    plane = local[:, :2] / np.maximum(local[:, 2:], 1e-9)
    gain = 1 + bundle.radial * (plane**2).sum(axis=1, keepdims=True)
    return bundle.focal * gain * plane + bundle.centres[k], local, plane, turned


def _loss(bundle: Bundle, views: Views, lens: float, relief: float | None, first: Bundle) -> float:
    square = ((seen(bundle, views) - views.pixels) ** 2).sum(axis=1) / _SCALE**2
    total = float(np.log1p(square).sum())
    if lens:
        total += ((bundle.focal / first.focal - 1) / lens) ** 2
        total += ((bundle.radial - first.radial) / _LIKELY_RADIAL) ** 2
    return total if relief is None else total + float(((bundle.points[:, 2] / relief) ** 2).sum())


def _normal_equations(
    bundle: Bundle, views: Views, lens: float, relief: float | None, first: Bundle
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray] | None]:
    """Return left and right side for poses (6 each) and lens, and the blocks of the points, or None if fixed."""
    pixels, local, plane, turned = _projected(bundle, views)
    error = pixels - views.pixels
    weight = 1 / (1 + (error**2).sum(axis=1) / _SCALE**2)
    k, count, free = views.photograph, len(bundle.shifts), 2 if lens else 0
    radius = (plane**2).sum(axis=1)
    by_plane = bundle.focal * (
        (1 + bundle.radial * radius)[:, None, None] * np.eye(2) + 2 * bundle.radial * plane[:, :, None] * plane[:, None]
    )
    by_local = np.zeros((len(k), 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = 1 / local[:, 2]
    by_local[:, :, 2] = -plane / local[:, 2:]
    by_local = by_plane @ by_local
    by_pose = np.concatenate([by_local @ -_cross(turned), by_local], axis=2)
    by_lens = np.stack([(1 + bundle.radial * radius)[:, None] * plane, bundle.focal * radius[:, None] * plane], axis=-1)
    by_lens = by_lens[..., :free]
    size = 6 * count + free
    left, right = np.zeros((size, size)), np.zeros(size)
    blocks = np.zeros((count, 6, 6))
    np.add.at(blocks, k, np.einsum("mai,m,maj->mij", by_pose, weight, by_pose))
    sides = np.zeros((count, 6))
    np.add.at(sides, k, np.einsum("mai,m,ma->mi", by_pose, weight, error))
    mixed = np.zeros((count, 6, free))
    np.add.at(mixed, k, np.einsum("mai,m,maj->mij", by_pose, weight, by_lens))
    for n in range(count):
        at = slice(6 * n, 6 * n + 6)
        left[at, at], left[at, 6 * count :], left[6 * count :, at] = blocks[n], mixed[n], mixed[n].T
    left[6 * count :, 6 * count :] = np.einsum("mai,m,maj->ij", by_lens, weight, by_lens)
    right[: 6 * count], right[6 * count :] = sides.ravel(), np.einsum("mai,m,ma->i", by_lens, weight, error)
    if lens:
        for index, sigma, deviation in (
            (-2, lens * first.focal, bundle.focal - first.focal),
            (-1, _LIKELY_RADIAL, bundle.radial - first.radial),
        ):
            left[index, index] += 1 / sigma**2
            right[index] += deviation / sigma**2
    if relief is None:
        return left, right, None
    by_point = by_local @ bundle.rotations[k]
    total = len(bundle.points)
    point_blocks, point_sides = np.zeros((total, 3, 3)), np.zeros((total, 3))
    np.add.at(point_blocks, views.point, np.einsum("mai,m,maj->mij", by_point, weight, by_point))
    np.add.at(point_sides, views.point, np.einsum("mai,m,ma->mi", by_point, weight, error))
    point_blocks[:, 2, 2] += 1 / relief**2
    point_sides[:, 2] += bundle.points[:, 2] / relief**2
    pose_point = np.zeros((size, total, 3))
    rows = 6 * k[:, None] + np.arange(6)
    np.add.at(pose_point, (rows, views.point[:, None]), np.einsum("mai,m,maj->mij", by_pose, weight, by_point))
    for part in range(free):
        by_part = np.einsum("ma,m,maj->mj", by_lens[..., part], weight, by_point)
        np.add.at(pose_point[6 * count + part], views.point, by_part)
    return left, right, (point_blocks, point_sides, pose_point)


def _stepped(
    bundle: Bundle,
    left: np.ndarray,
    right: np.ndarray,
    eliminated: tuple[np.ndarray, np.ndarray, np.ndarray] | None,
    damping: float,
    lens: float,
) -> Bundle:
    """Return the bundle after one damped step; the Schur complement eliminates free points."""
    damped = left + damping * np.diag(np.diag(left) + 1e-9)
    points = bundle.points
    if eliminated is None:
        step = -np.linalg.solve(damped, right)
    else:
        point_blocks, point_sides, pose_point = eliminated
        point_blocks = point_blocks + damping * point_blocks * np.eye(3) + 1e-12 * np.eye(3)
        inverse = _inverses(point_blocks)
        reduced = np.einsum("cpi,pij->cpj", pose_point, inverse)
        flat, reduced_flat = pose_point.reshape(len(left), -1), reduced.reshape(len(left), -1)
        step = -np.linalg.solve(damped - reduced_flat @ flat.T, right - reduced_flat @ point_sides.ravel())
        point_steps = -np.einsum("pij,pj->pi", inverse, point_sides + np.einsum("c,cpi->pi", step, pose_point))
        points = bundle.points + point_steps
    count = len(bundle.shifts)
    poses = step[: 6 * count].reshape(count, 6)
    rotations = _turns(poses[:, :3]) @ bundle.rotations
    new = replace(bundle, rotations=rotations, shifts=bundle.shifts + poses[:, 3:], points=points)
    if not lens:
        return new
    return replace(new, focal=bundle.focal + float(step[-2]), radial=bundle.radial + float(step[-1]))


def _inverses(matrices: np.ndarray) -> np.ndarray:
    """Return the inverses of symmetric matrices (N, 3, 3): the cross products of their rows over the determinant.

    ``numpy.linalg.inv`` of 500 of them takes up to a second where OpenBLAS's threads wait for one another.
    """
    a, b, c = np.moveaxis(matrices, 1, 0)
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    return adjugate / (a * adjugate[:, 0]).sum(axis=-1)[:, None, None]


def _cross(vectors: np.ndarray) -> np.ndarray:
    """Return the matrices (N, 3, 3) of cross products with vectors (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1)


def _turns(vectors: np.ndarray) -> np.ndarray:
    """Return the rotations (N, 3, 3) by vectors (N, 3) (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    cross = _cross(vectors)
    safe = np.maximum(angle, 1e-12)
    return np.eye(3) + np.sin(angle) / safe * cross + (1 - np.cos(angle)) / safe**2 * (cross @ cross)
