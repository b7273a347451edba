"""Indirect light by its shading: what a texel shows where no lamp reaches it, as a smooth function of the lamp's place.

Matt surfaces around a texel send it light that changes slowly with the direction of the lamp (Basri and Jacobs 2003,
Lambertian reflectance and linear subspaces). Photographs in which the texel lies in shadow, attached or cast, show that
light alone; spherical harmonics to order 2 that are fitted to these tell it in the others, too. Lights are in the
texel's own frame.
"""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from ...core.steps import at_once
from ...geometry.domain import Domain
from .prepare import Texels, chunk_steps, dot, grey_of, light_vectors, normal_equations, over_lights, percentiles
from .textures import HARMONICS

_FACING = 0.2  # cosine to a light from which on its light is sought, or missed where a cast shadow lies
_DARK = 0.15  # of the light that a texel would send without a cast shadow
_ROUNDS = 3  # shadows by the light that is left, then the light by them
_FITS, _SMALL = 4, 0.02  # each weighted by the errors of the last; an error, of a texel's bright light
_LIT, _BRIGHT = 80.0, 95.0  # percentiles: most lamps may be hidden
_RIDGE = np.array([1e-3, *[0.1] * (HARMONICS - 1)])

# What a texel must show: on convex subjects what is dark is noise and sheen, which no harmonics explain.
_FEWEST = 10  # shadows
_MOST_UNEXPLAINED = 0.3  # of the light in them
_MOST_GLOSS = 0.25  # of the light beside them, unlike a matt surface's: metal is dark beside its highlight, too


def harmonics(vectors: np.ndarray) -> np.ndarray:
    """Return (…, 9) the real spherical harmonics to order 2, up to constants, of unit vectors (…, 3)."""
    x, y, z = (vectors[..., axis] for axis in range(3))
    return np.stack([np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x - y * y, 3 * z * z - 1], axis=-1)


def shadow_light_steps(
    domain: Domain, normal: np.ndarray, sought: np.ndarray, least: float
) -> Generator[float, None, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return what the shadows of texels tell: (H, W, 9) coefficients of ``harmonics``, of the mean of the channels of
    radiance over irradiance/π; (H, W, 3) the light's chroma; (H, W) the part of the texel's light that it is.

    All are 0 where it is less than ``least``, or where too few shadows tell it. normal: (H, W, 3) in texels' frames.
    sought: (H, W) bool. Yields the part that is done.
    """
    coefficients = np.zeros((*domain.shape, HARMONICS), np.float32)
    chroma, share = np.zeros((*domain.shape, 3), np.float32), np.zeros(domain.shape, np.float32)

    def work(start: int, texels: Texels) -> None:
        rows, columns = texels
        texels = rows[sought[texels]], columns[sought[texels]]
        if len(texels[0]) and (domain.intensities > 0).all():
            found = _found(domain, texels, normal[texels].astype(np.float64))
            told = found[2] >= least
            for whole, part in zip((coefficients, chroma, share), found, strict=True):
                whole[texels] = np.where(told if part.ndim == 1 else told[:, None], part, 0)

    yield from chunk_steps(domain, work)
    return coefficients, chroma, share


shadow_light = at_once("shadow_light", shadow_light_steps)


def light_of(vectors: np.ndarray, coefficients: np.ndarray, chroma: np.ndarray) -> np.ndarray:
    """Return (K, T, 3) radiance over irradiance/π that T texels are sent under lights at vectors (K, T or 1, 3).

    coefficients: (T, 9). chroma: (T, 3).
    """
    return _mean_of(harmonics(vectors), coefficients)[..., None] * (3 * chroma)


def _found(domain: Domain, texels: Texels, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return coefficients (T, 9), chroma (T, 3), share (T,) of T texels; shares 0 where shadows do not tell it."""
    vectors, irradiance = light_vectors(domain, texels)
    samples = domain.stack.texels(*texels)
    counted = samples[..., 3] > 0
    light = np.where(counted[..., None], np.maximum(samples[..., :3], 0) / irradiance, 0).astype(np.float64)
    grey, basis, cosine = grey_of(light), harmonics(vectors), dot(vectors, normal)
    facing, bright = counted & (cosine > _FACING), percentiles(np.where(counted, grey, np.nan), [_BRIGHT])[0]
    sent, weight = np.zeros_like(grey), np.zeros_like(grey)
    coefficients = np.zeros((grey.shape[1], HARMONICS))
    for _ in range(_ROUNDS):
        left = grey - sent
        (albedo,) = percentiles(np.where(facing, left / np.where(facing, cosine, 1), np.nan), [_LIT])
        cast = facing & (left < _DARK * np.nan_to_num(albedo) * cosine)
        shadow = counted & ((cosine < 0) | cast)
        asked = shadow.sum(axis=0) >= _FEWEST
        own = basis if basis.shape[1] == 1 else basis[:, asked]
        coefficients[asked], weight[:, asked] = _fitted(own, shadow[:, asked], grey[:, asked], bright[asked])
        sent[:, asked] = np.minimum(_mean_of(own, coefficients[asked]), grey[:, asked])
    dark = over_lights(np.where(shadow, grey, 0))
    unexplained = over_lights(np.where(shadow, np.abs(grey - sent), 0))
    colour = np.stack([over_lights(weight * light[..., channel]) for channel in range(3)], axis=-1)
    chroma = colour / np.maximum((colour[:, :1] + colour[:, 1:2]) + colour[:, 2:], 1e-30)
    share = over_lights(sent) / np.maximum(over_lights(grey), 1e-30)
    lit = facing & ~cast
    (albedo,) = percentiles(np.where(lit, (grey - sent) / np.where(lit, cosine, 1), np.nan), [50.0])
    gloss = over_lights(np.where(lit, np.abs(grey - sent - np.nan_to_num(albedo) * cosine), 0))
    told = asked & (unexplained < _MOST_UNEXPLAINED * dark)
    told &= gloss < _MOST_GLOSS * over_lights(np.where(lit, grey - sent, 0))
    return coefficients, chroma, np.where(told, share, 0)


def _fitted(
    basis: np.ndarray, shadow: np.ndarray, grey: np.ndarray, bright: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients (T, 9) of the light in shadows by least absolute errors, and weights (K, T) by these."""
    weight = shadow.astype(np.float64)
    for _ in range(_FITS):
        gram, right = normal_equations(basis, weight, grey)
        coefficients = np.linalg.solve(gram + np.diag(_RIDGE), right[..., None])[..., 0]
        error = np.abs(grey - _mean_of(basis, coefficients)) / np.maximum(bright, 1e-30)
        weight = shadow * (_SMALL / (error + _SMALL))
    return coefficients, weight


def _mean_of(basis: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """(K, T) the light of coefficients (T, 9), at least 0."""
    total = basis[..., 0] * coefficients[:, 0]
    for order in range(1, HARMONICS):
        total = total + basis[..., order] * coefficients[:, order]
    return np.maximum(total, 0)
