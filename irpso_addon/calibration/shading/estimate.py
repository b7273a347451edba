"""Uncalibrated photometric stereo: directions and intensities of distant lights from the shading of one subject."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from ...core.errors import InputError
from ...core.steps import map_steps
from .ambiguity import even_relief, integrable, outward_cosine
from .factors import factored, scaled_normals, usable_samples

MIN_PHOTOGRAPHS = 10  # photographs
_GOOD = 0.5  # fraction of the pixels, those of least misfit, that determine the surface
_LIT = 0.3  # least fraction of a pixel's samples that are neither in shadow nor in a highlight
PARTS = 4  # of the subject, for the jackknife
_BLOCKS = 8  # along the subject's larger side; each block of pixels is in one part
_MIN_PIXELS, _MIN_LIT = 500, 50  # lit pixels; lit pixels in each photograph
_ROUNDS = 40  # yields of one fit, for the progress
_OUTLINE = 0.2  # least |outward_cosine| that distinguishes relief from its inverse


@dataclass(frozen=True)
class ShadingLights:
    """Lights from shading, in the camera's axes (x right, y up, z toward the viewer).

    directions: (K, 3) unit, toward the light. intensities: (K,) relative, with mean logarithm 0. errors: (K,) standard
    error, degrees, by parts of the subject (delete-a-group jackknife; Efron 1982), without errors common to all parts.
    solid: whether an outline distinguishes the relief from its inverse, whose lights are rotated by 180° about the view
    axis.
    """

    directions: np.ndarray
    intensities: np.ndarray
    errors: np.ndarray
    solid: bool


def shading_steps(
    values: np.ndarray, weight: np.ndarray, mask: np.ndarray, seed: int = 0, names: Sequence[str] = ()
) -> Generator[float, None, ShadingLights]:
    """Yield the fraction done; return the lights of K photographs, in three steps.

    The radiance of matt texels factors into lights and scaled normals, up to a 3×3 matrix (``factors``); integrability
    reduces this to a bas-relief transformation, and about equal strengths of the lamps determine that (``ambiguity``).
    values, weight: (K, P) radiance and weight of the P pixels of a mask (H, W), orthographic. names: of the
    photographs, for errors. Raises InputError for too few photographs or pixels, or too little relief.
    """
    if len(values) < MIN_PHOTOGRAPHS:
        raise InputError(
            f"{len(values)} photographs are too few to find lights by shading; take {MIN_PHOTOGRAPHS}, or put a"
            " ball into them"
        )
    scaled, usable = usable_samples(values, weight)
    lit = np.flatnonzero(usable.mean(axis=0) > _LIT)
    if len(lit) < _MIN_PIXELS:
        raise InputError(
            f"only {len(lit)} pixels are lit well enough to find lights by shading, {_MIN_PIXELS} are needed; put a"
            " ball into the photographs"
        )
    lit_by = usable[:, lit].sum(axis=1)
    if lit_by.min() < _MIN_LIT:
        worst = int(lit_by.argmin())
        which = f"'{names[worst]}'" if names else f"photograph {worst + 1} of {len(values)}"
        raise InputError(
            f"{which} lights only {int(lit_by.min())} pixels of the subject without a highlight, {_MIN_LIT} are needed"
            " to find its light; leave it out"
        )
    part_of = parts_of(mask, seed)
    fits = []
    for part in range(PARTS + 1):  # the last uses all pixels
        pixels = lit[part_of[lit] != part]
        steps = _lights(scaled, usable, pixels, mask, np.random.default_rng(seed))
        fits.append((yield from _counted(steps, part)))
    full, outward = fits[-1]
    strength = np.linalg.norm(full, axis=-1)
    directions = full / strength[:, None]
    solid = abs(outward) >= _OUTLINE
    replicates = np.stack([_unit(lights) for lights, _ in fits[:-1]])
    if not solid:  # a part may have found the inverse
        same = (replicates[..., :2] * directions[:, :2]).sum(axis=(1, 2)) > 0
        replicates[~same] *= (-1, -1, 1)
    intensities = strength / np.exp(np.log(strength).mean())
    return ShadingLights(directions, intensities, errors_of(replicates, directions), solid)


def errors_of(others: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return standard errors (K,), degrees, of directions (K, 3). others: (PARTS, K, 3), each without one part."""
    cosine = np.clip((others * directions).sum(axis=-1), -1, 1)
    errors: np.ndarray = np.degrees(np.sqrt((PARTS - 1) / PARTS * (np.arccos(cosine) ** 2).sum(axis=0)))
    return errors


def _counted(
    steps: Generator[None, None, tuple[np.ndarray, float]], part: int
) -> Generator[float, None, tuple[np.ndarray, float]]:
    """Yield the fraction done of all parts."""
    rounds = count(1)
    return (yield from map_steps(steps, lambda _: (part + min(next(rounds) / _ROUNDS, 1.0)) / (PARTS + 1)))


def parts_of(mask: np.ndarray, seed: int) -> np.ndarray:
    """Return the part (P,), 0 to 3, of each pixel of a mask. Blocks are assigned to parts at random."""
    rows, columns = np.nonzero(mask)
    side = max(np.ptp(rows), np.ptp(columns)) / _BLOCKS + 1
    block = (rows - rows.min()) // side * _BLOCKS + (columns - columns.min()) // side
    part_of: np.ndarray = np.random.default_rng(seed).integers(PARTS, size=_BLOCKS**2 + _BLOCKS)
    return part_of[block.astype(int)]


def _lights(
    scaled: np.ndarray, usable: np.ndarray, chosen: np.ndarray, mask: np.ndarray, rng: np.random.Generator
) -> Generator[None, None, tuple[np.ndarray, float]]:
    """Return lights (K, 3) times their intensities, from chosen pixels, and ``outward_cosine`` of the normals."""
    lights = yield from factored(scaled, usable, chosen, rng)
    normals, misfit = scaled_normals(scaled[:, chosen], usable[:, chosen], lights)
    yield
    good = np.zeros(scaled.shape[1], bool)
    good[chosen[misfit <= np.quantile(misfit, _GOOD)]] = True
    all_normals = np.zeros((scaled.shape[1], 3))
    all_normals[chosen] = normals
    matrix, determined = integrable(all_normals, good, mask)
    if not determined > 0:
        raise InputError("the subject has too little relief to find lights by its shading; put a ball beside it")
    all_normals, lights = all_normals @ matrix, lights @ np.linalg.inv(matrix).T
    side = 1.0 if np.median(all_normals[good, 2]) > 0 else -1.0
    depth = np.median(np.abs(all_normals[good, 2])) / max(
        np.median(np.linalg.norm(all_normals[good, :2], axis=-1)), 1e-12
    )
    scale = side * np.array([1.0, 1.0, 1 / depth])
    all_normals, lights = all_normals * scale, lights / scale
    yield
    relief = even_relief(lights)
    all_normals, lights = all_normals @ relief, lights @ np.linalg.inv(relief).T
    outward = outward_cosine(_unit(all_normals), mask)
    if outward < 0:
        lights = lights * (-1, -1, 1)
    return lights, outward


def shading_normals(values: np.ndarray, weight: np.ndarray, lights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (P, 3) by matt shading under lights (K, 3), of any length, and bool (P,): where they fit best.

    values, weight: as for ``shading_steps``.
    """
    scaled, usable = usable_samples(values, weight)
    normals, misfit = scaled_normals(scaled, usable, lights)
    lit = usable.mean(axis=0) > _LIT
    return normals, lit & (misfit <= np.quantile(misfit[lit], _GOOD)) if lit.any() else lit


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
