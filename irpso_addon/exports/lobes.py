"""Approximates one or two GGX or Beckmann lobes by the single Ward or GGX lobe of a format.

The fit minimizes the squared difference of radiance over all lights, weighted by solid angle (Ngan, Durand & Matusik
2005, Experimental Analysis of BRDF Models). Tables hold the inner products of all lobes with all candidates, so each
texel is fitted independently.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .surface import F0_HALF, Lobe, Surface

_VIEWS = (0.0, 30.0, 60.0)  # view angles for unknown views, degrees from the normal
_VIEW_STEP = 2.0  # degrees between the tables for known views
_SLOPES, _TURNS = 48, 8  # half vectors: logarithmic steps of their angle's tangent, and azimuths over half a turn
_WIDTHS = 64  # of the tables
_BLOCK = 1 << 14  # texels per block


@dataclass(frozen=True)
class Fit:
    """The fitted lobe. alpha: (H, W) its width. strength: (H, W) or (H, W, 3) the factor of the lobe.

    error: (H, W) root of the squared difference of radiance over root of the original's squared radiance.
    """

    alpha: np.ndarray
    strength: np.ndarray
    error: np.ndarray


def fit_ward(surface: Surface, lowest: float, highest: float) -> Fit:
    """Return the Ward lobes nearest to a surface's, with widths lowest…highest; their strength is their albedo.

    The view is straight from above: the texel's normal gives the view angle at which the lobe is fitted. The fitted
    albedo, one for each colour, includes the terms that a Ward lobe lacks: Fresnel, and the cosines of a microfacet
    lobe. Width and error are of the mean of the colours.
    """
    if not surface.lobes:
        return _none(surface.base_color.shape)
    f0, f90 = surface.specular_color, surface.f90 * (1 - surface.metallic) + surface.metallic
    widths = np.geomspace(lowest, highest, _WIDTHS)
    angle = np.degrees(np.arccos(np.clip(surface.normal[..., 2], 0, 1)))
    step = np.minimum(np.rint(angle / _VIEW_STEP), 80 / _VIEW_STEP)
    alpha, error, *shares = fitted = np.zeros((4, *surface.f0.shape))
    for number in np.unique(step):
        mask = step == number
        fresnel = f0[mask].mean(axis=-1), f90[mask]
        fitted[:, mask] = _fit(_texels(surface, mask), fresnel, _ward, widths, (number * _VIEW_STEP,))
    return Fit(alpha, shares[0][..., None] * f0 + (shares[1] * f90)[..., None], error)


def fit_ggx(surface: Surface) -> Fit:
    """Return the single GGX lobes nearest to a surface's; their strength scales the surface's Fresnel curve."""
    if not surface.lobes:
        return _none(surface.f0.shape)
    if len(surface.lobes) == 1 and surface.lobes[0].distribution == "GGX":
        alpha = surface.lobes[0].alpha
        return Fit(alpha, np.ones_like(alpha), np.zeros_like(alpha))
    everywhere = np.ones(surface.f0.shape, bool)
    fresnel = np.full((2, everywhere.size), [[F0_HALF], [1.0]])
    widths = np.geomspace(1e-3, 1.0, 2 * _WIDTHS)
    fitted = _fit(_texels(surface, everywhere), fresnel, _ggx, widths, _VIEWS)
    alpha, error, *shares = fitted.reshape(4, *surface.f0.shape)
    return Fit(alpha, F0_HALF * shares[0] + shares[1], error)


def _none(shape: tuple[int, ...]) -> Fit:
    """Return the fit of a surface without lobes: width 1, strength 0."""
    return Fit(np.ones(shape[:2]), np.zeros(shape), np.zeros(shape[:2]))


def _texels(surface: Surface, mask: np.ndarray) -> list[Lobe]:
    """Return the lobes of the texels in ``mask`` as flat arrays."""
    return [Lobe(lobe.weight[mask], lobe.alpha[mask], lobe.distribution) for lobe in surface.lobes]


@dataclass(frozen=True)
class _Configurations:
    """K pairs of light and view: n·l, n·v, n·h, v·h and the weight of the light's solid angle, each (K,)."""

    light: np.ndarray
    view: np.ndarray
    half: np.ndarray
    between: np.ndarray
    weight: np.ndarray


def _configurations(views: tuple[float, ...]) -> _Configurations:
    tangents = np.geomspace(1e-3, 10.0, _SLOPES)
    around = (np.arange(_TURNS) + 0.5) * np.pi / _TURNS
    view_angle, tangent, phi = np.meshgrid(np.radians(views), tangents, around, indexing="ij")
    theta = np.arctan(tangent)
    between = np.sin(view_angle) * np.sin(theta) * np.cos(phi) + np.cos(view_angle) * np.cos(theta)
    light = 2 * between * np.cos(theta) - np.cos(view_angle)
    # dω of the light is 4 v·h times dω of the half vector. Equal steps of log tan θ give dθ ∝ sin θ cos θ.
    weight = 4 * between * np.sin(theta) ** 2 * np.cos(theta)
    valid = (light > 1e-3) & (between > 1e-3)
    return _Configurations(light[valid], np.cos(view_angle)[valid], np.cos(theta)[valid], between[valid], weight[valid])


def _microfacet(k: _Configurations, alpha: np.ndarray, distribution: str = "GGX") -> np.ndarray:
    """Return (…, K) radiance of lobes of widths (…) without Fresnel: Cook & Torrance 1982 with Smith's masking."""
    alpha = np.asarray(alpha, np.float64)[..., None]
    slope = (1 - k.half**2) / k.half**2 / alpha**2
    if distribution == "GGX":
        density = 1 / (np.pi * alpha**2 * k.half**4 * (1 + slope) ** 2)
    else:
        density = np.exp(-slope) / (np.pi * alpha**2 * k.half**4)
    masked = 1 / (1 + _smith(k.light, alpha, distribution) + _smith(k.view, alpha, distribution))
    return density * masked / (4 * k.view)


def _schlick(k: _Configurations) -> np.ndarray:
    """Return (2, K) shares of F0 and F90 in Fresnel's reflectance (Schlick 1994, Eq. 15)."""
    rise = (1 - k.between) ** 5
    return np.stack([1 - rise, rise])


def _ggx(k: _Configurations, alpha: np.ndarray) -> np.ndarray:
    """Return (…, K) radiance of GGX lobes of widths (…) and the reflectance of common dielectrics."""
    return _microfacet(k, alpha) * ([F0_HALF, 1.0] @ _schlick(k))


def _smith(cosine: np.ndarray, alpha: np.ndarray, distribution: str) -> np.ndarray:
    """Return Λ of Walter et al. 2007: exact for GGX, their rational approximation (Eq. 15) for Beckmann."""
    slope = np.sqrt(1 - cosine**2) / cosine * alpha
    if distribution == "GGX":
        return (np.sqrt(1 + slope**2) - 1) / 2
    a = 1 / np.maximum(slope, 1e-9)
    return np.where(a < 1.6, (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2), 0.0)


def _ward(k: _Configurations, alpha: np.ndarray) -> np.ndarray:
    """Return (…, K) radiance of isotropic Ward lobes of albedo 1 and widths (…) (Ward 1992, Eq. 5a)."""
    alpha = np.asarray(alpha, np.float64)[..., None]
    slope = (1 - k.half**2) / k.half**2 / alpha**2
    return np.exp(-slope) * np.sqrt(k.light / k.view) / (4 * np.pi * alpha**2)


def _fit(
    lobes: list[Lobe],
    fresnel: Sequence[np.ndarray] | np.ndarray,
    candidate: Callable[[_Configurations, np.ndarray], np.ndarray],
    widths: np.ndarray,
    views: tuple[float, ...],
) -> np.ndarray:
    """Return (4, N) width, error, and strengths due to F0 and F90, of the candidates nearest to N texels' lobes.

    fresnel: F0 and F90 (N,) by which the lobes are multiplied; the strengths are those of one unit. views: angles in
    degrees.
    """
    k = _configurations(views)
    rows = np.sqrt(k.weight)
    grid = np.geomspace(1e-3, 1.0, 2 * _WIDTHS)
    candidates = candidate(k, widths) * rows
    own = np.einsum("jk,jk->j", candidates, candidates)
    # Each lobe counts twice: times Schlick's share of F0, and of F90.
    tables = [_microfacet(k, grid, lobe.distribution) * share * rows for share in _schlick(k) for lobe in lobes]
    crosses = [table @ candidates.T / own for table in tables]
    places = 2 * [_cells(lobe.alpha, grid) for lobe in lobes]
    weights = [lobe.weight * reflectance for reflectance in fresnel for lobe in lobes]
    fitted = np.zeros((4, len(weights[0])))
    for start in range(0, len(weights[0]), _BLOCK):
        block = slice(start, start + _BLOCK)
        parts = [_row_at(cross, place, block) for cross, place in zip(crosses, places, strict=True)]
        parts = [lobe.weight[block, None] * part for lobe, part in zip(2 * lobes, parts, strict=True)]
        shares = np.stack([sum(parts[: len(lobes)]), sum(parts[len(lobes) :])])
        strength = sum(f[block, None] * share for f, share in zip(fresnel, shares, strict=True))
        at, error = _best(strength**2 * own, _energy(tables, weights, places, block))
        fitted[:, block] = np.exp(np.interp(at, np.arange(len(widths)), np.log(widths))), error, *_between(shares, at)
    return fitted


def _cells(alpha: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each width's cell in the grid, and its fraction along the cell."""
    at = np.interp(np.log(np.maximum(alpha, grid[0])), np.log(grid), np.arange(len(grid)))
    low = np.minimum(at.astype(int), len(grid) - 2)
    return low, at - low


def _row_at(table: np.ndarray, place: tuple[np.ndarray, np.ndarray], block: slice) -> np.ndarray:
    low, part = place[0][block], place[1][block, None]
    return table[low] * (1 - part) + table[low + 1] * part


def _energy(lobes: list, weights: list, places: list, block: slice) -> np.ndarray:
    """Return the squared norm of each texel's mixture of lobes."""
    total = 0.0
    for i, first in enumerate(lobes):
        for j, second in enumerate(lobes):
            table = first @ second.T
            (a, s), (b, t) = places[i], places[j]
            a, s, b, t = a[block], s[block], b[block], t[block]
            mixed = (table[a, b] * (1 - s) + table[a + 1, b] * s) * (1 - t)
            mixed += (table[a, b + 1] * (1 - s) + table[a + 1, b + 1] * s) * t
            total = total + weights[i][block] * weights[j][block] * mixed
    return total


def _best(score: np.ndarray, energy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places (N,) of the best candidates, by a parabola over log width, and their relative errors (N,).

    score: (N, candidates) squared norms of the lobes' projections. energy: (N,) squared norms of the lobes.
    """
    best = np.clip(score.argmax(axis=1), 1, score.shape[1] - 2)
    row = np.arange(len(best))
    left, middle, right = (score[row, best + d] for d in (-1, 0, 1))
    curvature = left - 2 * middle + right
    shift = np.where(curvature < 0, 0.5 * (left - right) / np.where(curvature < 0, curvature, 1), np.sign(right - left))
    at = best + np.clip(shift, -1, 1)
    peak = np.maximum(_between(score, at), middle)
    return at, np.sqrt(np.maximum(1 - peak / np.maximum(energy, 1e-30), 0))


def _between(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return (…, N) values (…, N, candidates) at places (N,) between the candidates."""
    low = np.minimum(at.astype(int), values.shape[-1] - 2)
    row, part = np.arange(len(at)), at - low
    return values[..., row, low] * (1 - part) + values[..., row, low + 1] * part
