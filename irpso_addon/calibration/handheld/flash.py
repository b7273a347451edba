"""Position, beam and strengths of a flash, fitted to the radiance of a card.

Away from the mirror direction a card's radiance is about its albedo times the irradiance. Many photographs of the same
points separate albedo from flash.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_OFF_MIRROR = 18.0  # degrees between normal and half vector: above, gloss adds little
_ROUNDS = 8
_SCALE = 0.08  # of the logarithm of radiance: scale of the Cauchy loss
_GROUPS = 8  # of photographs, for the jackknife's standard error
_MIN_SAMPLES = 4  # per point
_MIN_MATTE = 0.1  # of the points: a photograph with fewer off the mirror direction uses all


@dataclass(frozen=True)
class Flash:
    """offset: (3,) from lens to flash, in the sensor's axes. error: (2,) its standard error, x and y.

    beam: light falls off as the cosine to the camera's axis to this power, which includes the lens's vignetting.
    gains: (K,) strength in each photograph, with mean logarithm 0. albedo: (P,) radiance of each point over the
    irradiance / π of a flash of intensity 1; NaN where too few photographs show it.
    """

    offset: np.ndarray
    error: np.ndarray
    beam: float
    gains: np.ndarray
    albedo: np.ndarray


@dataclass(frozen=True)
class Samples:
    """Radiance of points of the plane z = 0. places: (P, 2). cameras: (K, 4, 4) sensor to world, in Blender's axes.

    radiance: (K, P) grey, NaN where a point is outside the photograph, clipped or black.
    """

    places: np.ndarray
    cameras: np.ndarray
    radiance: np.ndarray


def flash_of(samples: Samples, offset: np.ndarray | None = None) -> Flash:
    """Return the flash that fits the samples. offset: (3,) from lens to flash, or None to fit it."""
    usable = usable_samples(samples)
    start = np.zeros(3) if offset is None else np.asarray(offset, float)
    estimate, beam, gains, albedo = _fit(samples, usable, start, offset is None)
    count = len(samples.cameras)
    estimates = []
    if offset is None:
        for group in range(min(_GROUPS, count // 3)):
            included = np.arange(count) % _GROUPS != group
            part = Samples(samples.places, samples.cameras[included], samples.radiance[included])
            estimates.append(_fit(part, usable[included], estimate, True)[0][:2])
    error = np.zeros(2) if not estimates else np.std(estimates, axis=0) * np.sqrt(len(estimates) - 1)
    return Flash(estimate, error, beam, gains, albedo)


def irradiance(places: np.ndarray, camera: np.ndarray, offset: np.ndarray, beam: float) -> np.ndarray:
    """Return irradiance / π (P,) at points (P, 2) of the plane z = 0 by a flash of intensity 1 at a camera (4, 4)."""
    lamp = camera[:3, :3] @ offset + camera[:3, 3]
    rays = np.insert(places, 2, 0.0, axis=1) - lamp
    distance = np.linalg.norm(rays, axis=1)
    along = np.clip(-(rays @ camera[:3, 2]) / distance, 1e-6, 1)
    return np.clip(-rays[:, 2] / distance, 1e-6, 1) / distance**2 * along**beam


def usable_samples(samples: Samples) -> np.ndarray:
    """Return bool (K, P): lit, away from the mirror direction, and at points with four or more such samples.

    The mirror direction is that of a flash at the lens.
    """
    eyes = samples.cameras[:, None, :3, 3] - np.insert(samples.places, 2, 0.0, axis=1)
    cosine = eyes[..., 2] / np.linalg.norm(eyes, axis=-1)
    positive = np.isfinite(samples.radiance) & (samples.radiance > 0)
    matte = positive & (cosine < np.cos(np.radians(_OFF_MIRROR)))
    # A photograph from straight above is all near the mirror direction; its strength must be fitted, too.
    usable = np.where(matte.sum(axis=1, keepdims=True) >= _MIN_MATTE * positive.shape[1], matte, positive)
    return usable & (usable.sum(axis=0) >= _MIN_SAMPLES)


def _fit(
    samples: Samples, usable: np.ndarray, offset: np.ndarray, free: bool
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Return offset, beam, gains (K,) and albedo (P,) by Gauss–Newton on logarithms, reweighted (Cauchy).

    The albedos are eliminated: each column is centred by its weighted mean at each point.
    """
    k, p = np.nonzero(usable & (usable.sum(axis=0) >= _MIN_SAMPLES))
    log = np.log(samples.radiance[k, p])
    count, distance = len(samples.cameras), float(np.median(np.linalg.norm(samples.cameras[:, :3, 3], axis=1)))
    beam, gains, weight = 0.0, np.zeros(count), np.ones(len(log))
    size = len(samples.places)

    def centred(columns: np.ndarray) -> np.ndarray:
        total = np.maximum(np.bincount(p, weight, size), 1e-12)
        means = np.stack([np.bincount(p, weight * column, size) for column in columns.T], axis=-1) / total[:, None]
        return columns - means[p]

    def lit(at: np.ndarray, power: float) -> np.ndarray:
        rows = np.stack([irradiance(samples.places, camera, at, power) for camera in samples.cameras])
        return np.log(rows[k, p])

    def solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
        weighted = matrix * weight[:, None]
        square = weighted.T @ matrix + 1e-9 * len(log) * np.eye(matrix.shape[1])
        return np.linalg.solve(square, weighted.T @ right)

    for _ in range(_ROUNDS):
        predicted = lit(offset, beam)
        columns = [lit(offset, beam + 1.0) - predicted]
        step = 1e-4 * distance
        if free:
            columns += [(lit(offset + step * axis, beam) - predicted) / step * distance for axis in np.eye(3)[:2]]
        ones = np.zeros((len(log), count))
        ones[np.arange(len(log)), k] = 1.0
        matrix = centred(np.concatenate([np.stack(columns, -1), ones], axis=1))
        residual = centred((log - predicted)[:, None])[:, 0]
        solution = solved(matrix, residual)
        if beam + solution[0] < 0:  # a lens's correction of vignetting may brighten the corners; a lamp does not
            solution = np.append(-beam, solved(matrix[:, 1:], residual + beam * matrix[:, 0]))
        beam += float(solution[0])
        if free:
            offset = offset + np.append(np.clip(solution[1:3], -0.2, 0.2) * distance, 0.0)
        gains = solution[len(columns) :] - solution[len(columns) :].mean()
        error = centred((log - lit(offset, beam) - gains[k])[:, None])[:, 0]
        weight = 1 / (1 + (error / _SCALE) ** 2)
    albedo_logs = log - lit(offset, beam) - gains[k]
    total = np.bincount(p, weight, size)
    albedo = np.where(total > 0, np.exp(np.bincount(p, weight * albedo_logs, size) / np.maximum(total, 1e-12)), np.nan)
    return offset, beam, np.exp(gains), albedo
