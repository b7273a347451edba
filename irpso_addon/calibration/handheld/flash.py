"""The flash, by the brightness of a card: its place beside the lens, its beam, and its strength in each photograph.

Away from the mirror direction a card's radiance is about its albedo times the irradiance. Over many photographs each
place of the card is its own reference, so that albedo and flash separate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_OFF_MIRROR = 18.0  # degrees between normal and half-vector above which a sample is hardly a highlight
_ROUNDS = 8
_SCALE = 0.08  # of the logarithm of radiance, of the Cauchy loss
_GROUPS = 8  # of photographs, one of which is left out at a time: the jackknife's standard error
_LEAST_SAMPLES = 4  # of a place
_LEAST_MATTE = 0.1  # of the places that a photograph must show off the mirror direction, else all of it count


@dataclass(frozen=True)
class Flash:
    """offset: (3,) of the flash from the lens, in the camera's axes. error: (2,) its standard error, x and y.

    beam: power of the cosine to the camera's axis with which its light falls, the lens's vignetting included.
    gains: (K,) its strength in each photograph, of mean logarithm 0. albedo: (P,) radiance of each place over the
    irradiance of a flash of intensity 1; NaN where too few photographs show it.
    """

    offset: np.ndarray
    error: np.ndarray
    beam: float
    gains: np.ndarray
    albedo: np.ndarray


@dataclass(frozen=True)
class Samples:
    """What photographs show of places of the plane z = 0. places: (P, 2). cameras: (K, 4, 4) to world, Blender's axes.

    radiance: (K, P) grey, NaN where a place does not show, is clipped or too dark.
    """

    places: np.ndarray
    cameras: np.ndarray
    radiance: np.ndarray


def flash_of(samples: Samples, offset: np.ndarray | None = None) -> Flash:
    """Return the flash that explains the samples best. offset: (3,) where it is known."""
    usable = usable_samples(samples)
    start = np.zeros(3) if offset is None else np.asarray(offset, float)
    found, beam, gains, albedo = _fit(samples, usable, start, offset is None)
    count = len(samples.cameras)
    parts = []
    if offset is None:
        for group in range(min(_GROUPS, count // 3)):
            kept = np.arange(count) % _GROUPS != group
            part = Samples(samples.places, samples.cameras[kept], samples.radiance[kept])
            parts.append(_fit(part, usable[kept], found, True)[0][:2])
    error = np.zeros(2) if not parts else np.std(parts, axis=0) * np.sqrt(len(parts) - 1)
    return Flash(found, error, beam, gains, albedo)


def irradiance(places: np.ndarray, camera: np.ndarray, offset: np.ndarray, beam: float) -> np.ndarray:
    """Return (P,) over π, at places (P, 2) of the plane z = 0, of a flash of intensity 1 beside a camera (4, 4)."""
    lamp = camera[:3, :3] @ offset + camera[:3, 3]
    away = np.insert(places, 2, 0.0, axis=1) - lamp
    distance = np.linalg.norm(away, axis=1)
    along = np.clip(-(away @ camera[:3, 2]) / distance, 1e-6, 1)
    return np.clip(-away[:, 2] / distance, 1e-6, 1) / distance**2 * along**beam


def usable_samples(samples: Samples) -> np.ndarray:
    """Return (K, P) bool: lit, of places that enough photographs show, and away from the mirror direction.

    That is taken as if the flash were the lens.
    """
    eyes = samples.cameras[:, None, :3, 3] - np.insert(samples.places, 2, 0.0, axis=1)
    cosine = eyes[..., 2] / np.linalg.norm(eyes, axis=-1)
    good = np.isfinite(samples.radiance) & (samples.radiance > 0)
    matte = good & (cosine < np.cos(np.radians(_OFF_MIRROR)))
    # A photograph from straight above shows the card near the mirror direction alone, and has a strength, too.
    usable = np.where(matte.sum(axis=1, keepdims=True) >= _LEAST_MATTE * good.shape[1], matte, good)
    return usable & (usable.sum(axis=0) >= _LEAST_SAMPLES)


def _fit(
    samples: Samples, usable: np.ndarray, offset: np.ndarray, free: bool
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Return offset, beam, gains (K,) and albedo (P,) by Gauss–Newton on logarithms, reweighted (Cauchy).

    The places' albedos are eliminated: for each place, all columns count from their weighted mean.
    """
    k, p = np.nonzero(usable & (usable.sum(axis=0) >= _LEAST_SAMPLES))
    log = np.log(samples.radiance[k, p])
    count, reach = len(samples.cameras), float(np.median(np.linalg.norm(samples.cameras[:, :3, 3], axis=1)))
    beam, gains, weight = 0.0, np.zeros(count), np.ones(len(log))
    size = len(samples.places)

    def centred(columns: np.ndarray) -> np.ndarray:
        total = np.maximum(np.bincount(p, weight, size), 1e-12)
        means = np.stack([np.bincount(p, weight * column, size) for column in columns.T], axis=-1) / total[:, None]
        return columns - means[p]

    def lit(at: np.ndarray, power: float) -> np.ndarray:
        rows = np.stack([irradiance(samples.places, camera, at, power) for camera in samples.cameras])
        return np.log(rows[k, p])

    for _ in range(_ROUNDS):
        now = lit(offset, beam)
        columns = [lit(offset, beam + 1.0) - now]
        step = 1e-4 * reach
        if free:
            columns += [(lit(offset + step * axis, beam) - now) / step * reach for axis in np.eye(3)[:2]]
        ones = np.zeros((len(log), count))
        ones[np.arange(len(log)), k] = 1.0
        matrix = centred(np.concatenate([np.stack(columns, -1), ones], axis=1))
        left_over = centred((log - now)[:, None])[:, 0]
        weighted = matrix * weight[:, None]
        square = weighted.T @ matrix + 1e-9 * len(log) * np.eye(matrix.shape[1])
        answer = np.linalg.solve(square, weighted.T @ left_over)
        beam += float(answer[0])
        if free:
            offset = offset + np.append(np.clip(answer[1:3], -0.2, 0.2) * reach, 0.0)
        gains = answer[len(columns) :] - answer[len(columns) :].mean()
        error = centred((log - lit(offset, beam) - gains[k])[:, None])[:, 0]
        weight = 1 / (1 + (error / _SCALE) ** 2)
    rest = log - lit(offset, beam) - gains[k]
    total = np.bincount(p, weight, size)
    albedo = np.where(total > 0, np.exp(np.bincount(p, weight * rest, size) / np.maximum(total, 1e-12)), np.nan)
    return offset, beam, np.exp(gains), albedo
