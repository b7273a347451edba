"""Oracle of shaders/prefit/shadow_light.glsl: indirect light estimated from shadows, in numpy and float64."""

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
from irpso_addon.solver.state.separation_record import HARMONICS, SHADOW_LIGHT
from irpso_addon.solver.state.shadow_light import harmonics

_FACING = 0.2  # least cosine to the lamp of a lit sample and of a cast shadow
_DARK = 0.15  # most direct light in a cast shadow, over the unshadowed direct light
_ROUNDS = 3  # of normal, shadows and harmonics
_FITS, _SMALL = 4, 0.02  # reweighted least squares of a fit; scale of the errors, over the texel's bright light
_LIT, _BRIGHT = 80.0, 95.0  # percentiles of albedos and of light: most lamps may be occluded
_RIDGE = np.array([1e-3, *[0.1] * (HARMONICS - 1)])

# Acceptance tests. On convex subjects the dark samples show noise and sheen, which harmonics do not explain. The
# harmonics' errors turn a normal by about 1°: a turn of less than ``turn`` is not accepted.
_MIN_SHADOWED, _MIN_LIT = 10, 4  # samples in shadow, lit samples
_MAX_UNEXPLAINED = 0.3  # of the light in shadow
# Of the direct light, times the prefit's misfit, or without: its difference to a Lambertian texel's.
_MAX_GLOSS, _MATT = 0.25, 0.02


def shadow_light(domain: Domain, normal: np.ndarray, misfit: np.ndarray, least: float, turn: float) -> np.ndarray:
    """Return (H, W, 12), the shader's output: nine coefficients, red and green of the chroma, the indirect share.

    All 0 where the share is less than ``least`` or a test fails. normal: (H, W, 3) in the texels' frames. misfit:
    (H, W), the prefit's loss, 0 to skip a texel. turn: degrees.
    """
    result = np.zeros((*domain.shape, SHADOW_LIGHT))
    for _, (rows, columns) in chunks(domain):
        texels = rows[misfit[rows, columns] > 0], columns[misfit[rows, columns] > 0]
        own = normal[texels].astype(np.float64), misfit[texels]
        coefficients, chroma, share = _indirect_light(domain, texels, *own, turn)
        output = np.column_stack([coefficients, chroma[:, :2], share])
        result[texels] = np.where((share >= least)[:, None], output, 0)
    return result


def _indirect_light(
    domain: Domain, texels: Texels, normal: np.ndarray, misfit: np.ndarray, turn: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return coefficients (T, 9), chroma (T, 3), share (T,) of T texels; share 0 where a test fails."""
    vectors, irradiance = light_vectors(domain, texels)
    samples = domain.stack.texels(*texels)
    counted = samples[..., 3] > 0
    light = np.where(counted[..., None], np.maximum(samples[..., :3], 0) / irradiance, 0).astype(np.float64)
    grey, basis = grey_of(light), harmonics(vectors)
    bright = percentiles(np.where(counted, grey, np.nan), [_BRIGHT])[0]
    indirect, weight, lit = np.zeros_like(grey), np.zeros_like(grey), counted
    coefficients, active = np.zeros((grey.shape[1], HARMONICS)), np.ones(grey.shape[1], bool)
    for step in range(_ROUNDS):
        left = grey - indirect
        if step > 0:
            normal = _lambertian_normals(vectors, left, lit, bright, normal)
        cosine = dot(vectors, normal)
        facing = counted & (cosine > _FACING)
        (albedo,) = percentiles(np.where(facing, left / np.where(facing, cosine, 1), np.nan), [_LIT])
        cast = facing & (left < _DARK * np.nan_to_num(albedo) * cosine)
        shadow, lit = counted & ((cosine < 0) | cast), facing & ~cast
        active = active & (shadow.sum(axis=0) >= _MIN_SHADOWED)
        own = basis if basis.shape[1] == 1 else basis[:, active]
        coefficients[active], weight[:, active] = _fitted(own, shadow[:, active], grey[:, active], bright[active])
        indirect[:, active] = np.minimum(_light_of(own, coefficients[active]), grey[:, active])
    dark = over_lights(np.where(shadow, grey, 0))
    unexplained = over_lights(np.where(shadow, np.abs(grey - indirect), 0))
    colour = np.stack([over_lights(weight * light[..., channel]) for channel in range(3)], axis=-1)
    chroma = colour / np.maximum((colour[:, :1] + colour[:, 1:2]) + colour[:, 2:], 1e-30)
    share = over_lights(indirect) / np.maximum(over_lights(grey), 1e-30)
    (albedo,) = percentiles(np.where(lit, (grey - indirect) / np.where(lit, cosine, 1), np.nan), [50.0])
    gloss = over_lights(np.where(lit, np.abs(grey - indirect - np.nan_to_num(albedo) * cosine), 0))
    accepted = active & (unexplained < _MAX_UNEXPLAINED * dark)
    accepted &= gloss < np.maximum(_MAX_GLOSS * misfit, _MATT) * over_lights(np.where(lit, grey - indirect, 0))
    turned, unturned = (_lambertian_normals(vectors, part, lit, bright, normal) for part in (grey - indirect, grey))
    accepted &= np.linalg.norm(turned - unturned, axis=-1) >= 2 * np.sin(np.radians(turn) / 2)
    return coefficients, chroma, np.where(accepted, share, 0)


def _lambertian_normals(
    vectors: np.ndarray, light: np.ndarray, lit: np.ndarray, bright: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """Return (T, 3) normals of a Lambertian fit by least absolute errors; ``other`` where it fails or faces away."""
    every = np.broadcast_to(vectors, (*light.shape, 3))
    weight = lit.astype(np.float64)
    for _ in range(_FITS):
        gram = np.einsum("kt,kti,ktj->tij", weight, every, every)
        ridge = np.maximum(1e-4 * np.trace(gram, axis1=1, axis2=2), 1e-30)[:, None, None] * np.eye(3)
        scaled = np.linalg.solve(gram + ridge, np.einsum("kt,kt,kti->ti", weight, light, every)[..., None])[..., 0]
        error = np.abs(light - dot(every, scaled)) / np.maximum(bright, 1e-30)
        weight = lit * (_SMALL / (error + _SMALL))
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    valid = (scaled[:, 2:] > 0) & (lit.sum(axis=0) >= _MIN_LIT)[:, None]
    return np.where(valid, scaled / np.maximum(length, 1e-30), other)


def _fitted(
    basis: np.ndarray, shadow: np.ndarray, grey: np.ndarray, bright: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coefficients (T, 9) of the light in shadow by least absolute errors, and the weights (K, T) of the fit."""
    weight = shadow.astype(np.float64)
    for _ in range(_FITS):
        gram, right = normal_equations(basis, weight, grey)
        coefficients = np.linalg.solve(gram + np.diag(_RIDGE), right[..., None])[..., 0]
        error = np.abs(grey - _light_of(basis, coefficients)) / np.maximum(bright, 1e-30)
        weight = shadow * (_SMALL / (error + _SMALL))
    return coefficients, weight


def _light_of(basis: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return (K, T) light of coefficients (T, 9), at least 0."""
    total = basis[..., 0] * coefficients[:, 0]
    for order in range(1, HARMONICS):
        total = total + basis[..., order] * coefficients[:, order]
    return np.maximum(total, 0)
