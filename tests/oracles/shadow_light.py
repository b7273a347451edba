"""The light that shadows tell (shaders/prefit/shadow_light.glsl) once more, in numpy and float64."""

from __future__ import annotations

import numpy as np

from irpso_addon.geometry.domain import Domain
from irpso_addon.solver.state.prepare import (
    Texels,
    chunks,
    dot,
    grey_of,
    light_vectors,
    normal_equations,
    over_lights,
    percentiles,
)
from irpso_addon.solver.state.shadow_light import harmonics
from irpso_addon.solver.state.textures import HARMONICS

_FACING = 0.2  # cosine to a light from which on its light is sought, or missed where a cast shadow lies
_DARK = 0.15  # of the light that a texel would send without a cast shadow
_ROUNDS = 3  # shadows by the normal and the light that is left, then both by them
_FITS, _SMALL = 4, 0.02  # each weighted by the errors of the last; an error, of a texel's bright light
_LIT, _BRIGHT = 80.0, 95.0  # percentiles: most lamps may be hidden
_RIDGE = np.array([1e-3, *[0.1] * (HARMONICS - 1)])

# What a texel must show: on convex subjects what is dark is noise and sheen, which no harmonics explain. The errors of
# the harmonics turn a normal by a degree: light that turns it by less than ``turn`` stays.
_FEWEST, _FEWEST_LIT = 10, 4  # shadows, lit samples
_MOST_UNEXPLAINED = 0.3  # of the light in them
_MOST_GLOSS = 0.25  # of the light beside them, unlike a matt surface's: metal is dark beside its highlight, too


def shadow_light(domain: Domain, normal: np.ndarray, sought: np.ndarray, least: float, turn: float) -> np.ndarray:
    """Return (H, W, 12) what the shader writes: coefficients, red and green of the chroma, the share.

    All are 0 where it is less than ``least``, or where too few shadows tell it. normal: (H, W, 3) in texels' frames.
    sought: (H, W) bool. turn: in degrees.
    """
    result = np.zeros((*domain.shape, HARMONICS + 3))
    for _, (rows, columns) in chunks(domain):
        texels = rows[sought[rows, columns]], columns[sought[rows, columns]]
        coefficients, chroma, share = _found(domain, texels, normal[texels].astype(np.float64), turn)
        found = np.column_stack([coefficients, chroma[:, :2], share])
        result[texels] = np.where((share >= least)[:, None], found, 0)
    return result


def _found(
    domain: Domain, texels: Texels, normal: np.ndarray, turn: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return coefficients (T, 9), chroma (T, 3), share (T,) of T texels; shares 0 where shadows do not tell it."""
    vectors, irradiance = light_vectors(domain, texels)
    samples = domain.stack.texels(*texels)
    counted = samples[..., 3] > 0
    light = np.where(counted[..., None], np.maximum(samples[..., :3], 0) / irradiance, 0).astype(np.float64)
    grey, basis = grey_of(light), harmonics(vectors)
    bright = percentiles(np.where(counted, grey, np.nan), [_BRIGHT])[0]
    sent, weight, lit = np.zeros_like(grey), np.zeros_like(grey), counted
    coefficients, asked = np.zeros((grey.shape[1], HARMONICS)), np.ones(grey.shape[1], bool)
    for step in range(_ROUNDS):
        left = grey - sent
        if step > 0:
            normal = _lambertian(vectors, left, lit, bright, normal)
        cosine = dot(vectors, normal)
        facing = counted & (cosine > _FACING)
        (albedo,) = percentiles(np.where(facing, left / np.where(facing, cosine, 1), np.nan), [_LIT])
        cast = facing & (left < _DARK * np.nan_to_num(albedo) * cosine)
        shadow, lit = counted & ((cosine < 0) | cast), facing & ~cast
        asked = asked & (shadow.sum(axis=0) >= _FEWEST)
        own = basis if basis.shape[1] == 1 else basis[:, asked]
        coefficients[asked], weight[:, asked] = _fitted(own, shadow[:, asked], grey[:, asked], bright[asked])
        sent[:, asked] = np.minimum(_mean_of(own, coefficients[asked]), grey[:, asked])
    dark = over_lights(np.where(shadow, grey, 0))
    unexplained = over_lights(np.where(shadow, np.abs(grey - sent), 0))
    colour = np.stack([over_lights(weight * light[..., channel]) for channel in range(3)], axis=-1)
    chroma = colour / np.maximum((colour[:, :1] + colour[:, 1:2]) + colour[:, 2:], 1e-30)
    share = over_lights(sent) / np.maximum(over_lights(grey), 1e-30)
    (albedo,) = percentiles(np.where(lit, (grey - sent) / np.where(lit, cosine, 1), np.nan), [50.0])
    gloss = over_lights(np.where(lit, np.abs(grey - sent - np.nan_to_num(albedo) * cosine), 0))
    told = asked & (unexplained < _MOST_UNEXPLAINED * dark)
    told &= gloss < _MOST_GLOSS * over_lights(np.where(lit, grey - sent, 0))
    turned, unturned = (_lambertian(vectors, part, lit, bright, normal) for part in (grey - sent, grey))
    told &= np.linalg.norm(turned - unturned, axis=-1) >= 2 * np.sin(np.radians(turn) / 2)
    return coefficients, chroma, np.where(told, share, 0)


def _lambertian(
    vectors: np.ndarray, light: np.ndarray, lit: np.ndarray, bright: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """Return (T, 3) normals of Lambertian texels by least absolute errors; another where lights are few, or behind."""
    every = np.broadcast_to(vectors, (*light.shape, 3))
    weight = lit.astype(np.float64)
    for _ in range(_FITS):
        gram = np.einsum("kt,kti,ktj->tij", weight, every, every)
        ridge = np.maximum(1e-4 * np.trace(gram, axis1=1, axis2=2), 1e-30)[:, None, None] * np.eye(3)
        own = np.linalg.solve(gram + ridge, np.einsum("kt,kt,kti->ti", weight, light, every)[..., None])[..., 0]
        error = np.abs(light - dot(every, own)) / np.maximum(bright, 1e-30)
        weight = lit * (_SMALL / (error + _SMALL))
    length = np.linalg.norm(own, axis=-1, keepdims=True)
    told = (own[:, 2:] > 0) & (lit.sum(axis=0) >= _FEWEST_LIT)[:, None]
    return np.where(told, own / np.maximum(length, 1e-30), other)


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
