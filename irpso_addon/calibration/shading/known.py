"""Lights from the shading of a surface of known shape and unknown albedo.

The radiance of a matt texel is its albedo times its shading, so ratios of its samples depend on lights and normal
only. The albedos are eliminated (variable projection, Golub & Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from .lamps import FREE, Lamps

WHITE = 0.8  # albedo of the brightest texels, which sets the scale of the intensities
GROUPS = 8  # of texels, for the jackknife
_FACING = 0.1  # least cosine to the light of a sample with weight
_DARK = 0.1  # of a texel's and photograph's typical radiance: shadow, before the lights are known
_GLARE = 1.5  # of the same: highlight
_NARROW = 0.03  # mean square of a component of the normals, about 10°: below, lights are poorly determined
_LINEAR_ROUNDS, _ROUNDS, _INNER = 12, 60, 3
_WIDTH = 2.0  # deviations at which a sample's weight is a half (Cauchy)
_MIN_WIDTH = 2e-3
_SETTLED = 1e-5  # largest step of a lamp, in radians or in a logarithm
_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-9, 1e6
_NEAREST = 0.95  # largest size / distance: no lamp is inside the subject
_TRUST = 10.0  # prior deviation of size / distance and of each step, for what photographs do not determine
_STRENGTH_TRUST = 1e-3  # prior deviation of the sum of the strengths' logarithms: fixes the free scale
SIGNIFICANT = 3.0  # standard errors: least 1 / distance of near lights, as for balls
_BRIGHT = 95.0  # percentile of the albedos
_BETTER = 0.9  # of the misfit of distant lamps: largest misfit of near ones


@dataclass(frozen=True)
class Samples:
    """Samples of T texels in K photographs. values, weight: (K, T) radiance, and weight, 0 where hidden or in shadow.

    points, normals: (T, 3). groups: (T,) 0…GROUPS − 1, the groups of the jackknife.
    """

    values: np.ndarray
    weight: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    groups: np.ndarray

    def scaled(self) -> Samples:
        """Return the samples with each texel divided by its RMS radiance, so that texels weigh equally."""
        valid = self.weight > 0
        total = np.maximum(valid.sum(axis=0), 1)
        rms = np.sqrt(np.where(valid, self.values**2, 0).sum(axis=0) / total)
        return replace(self, values=np.where(valid, self.values, 0) / np.maximum(rms, 1e-12))


@dataclass(frozen=True)
class LampFit:
    """Fitted lamps. errors: (K, FREE) standard errors of their parameters (delete-a-group jackknife, Efron 1982).

    misfit: robust deviation of the samples over a texel's RMS radiance. weight: (K, T) final weights of the samples.
    explained: (K,) fraction of each photograph's squared radiance, by these weights.
    """

    lamps: Lamps
    errors: np.ndarray
    misfit: float
    weight: np.ndarray
    explained: np.ndarray

    @property
    def degrees(self) -> np.ndarray:
        """(K,) standard error of each direction, in degrees."""
        return np.degrees(np.linalg.norm(self.errors[:, :2], axis=-1))

    @property
    def distance_errors(self) -> np.ndarray:
        """(K,) relative standard error of each near lamp's distance."""
        return np.minimum(self.errors[:, 2] / np.maximum(self.lamps.inverses, 1e-12), 1.0)


def nearer(near: LampFit, distant: LampFit) -> bool:
    """Return whether the lamps are significantly near.

    The median of 1 / distance must exceed three standard errors, and the misfit must fall by a tenth. Gloss resembles
    finite distances, too, but does not lower the misfit: a glazed pot under suns has 4.6 standard errors and a misfit
    that rises by 8 %, a rough monkey 4.7 and one that falls by 4 %.
    """
    significance = np.median(near.lamps.inverses / np.maximum(near.errors[:, 2], 1e-12))
    return bool(significance > SIGNIFICANT and near.misfit < _BETTER * distant.misfit)


def linear_lamps(samples: Samples, centre: np.ndarray, size: float) -> tuple[Lamps, float]:
    """Return distant lamps, and how well the texels determine them: 0 (not at all) to 1.

    With the inverse albedo β of a texel, β I = n·L is linear in β and in all L: the lights are an eigenvector of one
    3K × 3K matrix, which needs no start and is robustly reweighted. It is ambiguous for a few facets; normals in one
    plane do not determine the component across it.
    """
    values, normals = samples.scaled().values, samples.normals
    initial = samples.weight * _plausible(values, samples.weight > 0)
    weight = initial
    count = len(values)
    products = np.einsum("ti,tj->tij", normals, normals).reshape(-1, 9)
    for number in range(_LINEAR_ROUNDS):
        blocks = (weight @ products).reshape(count, 3, 3) + 1e-9 * np.eye(3)
        root = np.linalg.inv(np.linalg.cholesky(blocks))
        norm = np.sqrt(np.maximum((weight * values**2).sum(axis=0), 1e-12))
        cross = np.einsum("kij,kt,tj->kit", root, weight * values / norm, normals, optimize=True).reshape(3 * count, -1)
        eigenvalues, vectors = np.linalg.eigh(cross @ cross.T)
        if number == 0:  # later rounds down-weight what contradicts their solution
            determined = float(1 - (1 - eigenvalues[-1]) / max(1 - eigenvalues[-2], 1e-12))
        lights = np.einsum("kji,kj->ki", root, vectors[:, -1].reshape(count, 3))
        shading = lights @ normals.T
        if (weight * values * shading).sum() < 0:
            lights, shading = -lights, -shading
        inverse = (weight * values * shading).sum(axis=0) / norm**2
        albedo = 1 / np.maximum(np.abs(inverse), 1e-9 * np.abs(inverse).max()) * np.sign(inverse)
        residual = values - albedo * shading
        facing = shading > _FACING * np.linalg.norm(lights, axis=-1, keepdims=True)
        weight = initial * facing / (1 + (residual / _width(residual, initial * facing)) ** 2)
    strength = np.maximum(np.linalg.norm(lights, axis=-1), 1e-12)
    determined *= min(1.0, _narrowness(normals) / _NARROW)
    lamps = Lamps(centre, size, lights / strength[:, None], np.zeros(count), strength / np.exp(np.log(strength).mean()))
    return lamps, determined


def _narrowness(normals: np.ndarray) -> float:
    """Return the least mean square of a component of the normals, over directions: 0 for normals in one plane."""
    return float(np.linalg.eigvalsh(normals.T @ normals / len(normals))[0])


def fit_steps(samples: Samples, lamps: Lamps, near: bool, nearest: float = _NEAREST) -> Generator[None, None, LampFit]:
    """Yield after each round; return the lamps fitted from a start: Levenberg–Marquardt, albedos eliminated.

    near: whether distances are free; nearest: largest size / distance. Samples have weight where the lamp is above the
    surface; Cauchy's weights suppress highlights, shadows that are missing in ``samples.weight``, and other outliers.
    """
    samples = samples.scaled()
    equations = _Equations(samples, near)
    damping = _DAMPING
    weight, width = equations.weighted(lamps, None)
    for _ in range(_ROUNDS):
        matrix, right = equations.reduced(lamps, weight)
        whole = matrix.sum(axis=0)
        diagonal = np.diag(np.maximum(np.diag(whole), 1e-9))
        system, gradient = whole + equations.prior(width), right.sum(axis=0) - equations.pull(lamps, width)
        before = equations.cost(lamps, weight, width)
        while damping < _MAX_DAMPING:
            steps = equations.spread(np.linalg.solve(system + damping * diagonal, gradient))
            other = lamps.moved(steps)
            other = replace(other, inverses=np.clip(other.inverses, -nearest, nearest))
            if equations.cost(other, weight, width) <= before:
                break
            damping *= 10
        else:
            break
        damping = max(damping / 10, _MIN_DAMPING)
        lamps = other
        weight, width = equations.weighted(lamps, weight)
        yield
        if np.abs(steps).max() < _SETTLED:
            break
    bright = samples.weight * samples.values**2
    explained = (weight * samples.values**2).sum(axis=1) / np.maximum(bright.sum(axis=1), 1e-12)
    return LampFit(lamps, equations.errors(lamps, weight, width), width / _WIDTH, weight, explained)


def free_normals(samples: Samples, fit: LampFit) -> np.ndarray:
    """Return the angles (T,), degrees, between the known normals and normals fitted to the samples under the lamps.

    NaN where fewer than four samples have weight.
    """
    samples = samples.scaled()
    vectors = fit.lamps.vectors(samples.points)
    initial = (fit.weight > 0.01).astype(np.float64)
    weight = initial
    for _ in range(8):
        gram = np.einsum("kt,kti,ktj->tij", weight, vectors, vectors, optimize=True)
        gram += (1e-4 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(3)
        right = np.einsum("kt,kti->ti", weight * samples.values, vectors)
        scaled = np.linalg.solve(gram, right[..., None])[..., 0]
        residual = samples.values - np.einsum("kti,ti->kt", vectors, scaled)
        weight = initial / (1 + (residual / _width(residual, initial)) ** 2)
    unit = scaled / np.maximum(np.linalg.norm(scaled, axis=-1, keepdims=True), 1e-12)
    angle = np.degrees(np.arccos(np.clip((unit * samples.normals).sum(axis=-1), -1, 1)))
    return np.where((initial > 0).sum(axis=0) >= 4, angle, np.nan)


def free_scale(samples: Samples, fit: LampFit) -> float:
    """Return the factor of the lamps' strengths for which the brightest texels have the albedo WHITE."""
    shading, _ = fit.lamps.shading(samples.points, samples.normals)
    top, bottom = ((fit.weight * shading * other).sum(axis=0) for other in (samples.values, shading))
    known = bottom > 0
    return (float(np.percentile(top[known] / bottom[known], _BRIGHT)) if known.any() else 1.0) / WHITE


def cells(points: np.ndarray, seed: int) -> np.ndarray:
    """Return the group (T,), 0…GROUPS − 1, of each point. Cubes of space are assigned to groups at random."""
    low, high = points.min(axis=0), points.max(axis=0)
    cube = ((points - low) / max(float((high - low).max()), 1e-12) * 5.999).astype(int) @ (1, 6, 36)
    group_of: np.ndarray = np.random.default_rng(seed).integers(GROUPS, size=216)
    return group_of[cube]


def _plausible(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return bool (K, T): neither shadow nor highlight, relative to texel and photograph, before lights are known."""
    lit = np.where(valid, values, np.nan)
    lit[~valid.any(axis=1)] = 1.0  # numpy warns of a percentile of nothing
    level = lit / np.nanpercentile(lit, 75, axis=1, keepdims=True)
    level[:, ~valid.any(axis=0)] = 1.0
    level = level / np.nanpercentile(level, 75, axis=0)
    return valid & (level > _DARK) & (level < _GLARE)


def _width(residual: np.ndarray, weight: np.ndarray) -> float:
    """Return the width of Cauchy's weights: two robust deviations of the residuals with weight."""
    magnitudes = np.abs(residual[weight > 0.1])
    return max(_WIDTH * 1.4826 * float(np.median(magnitudes)) if len(magnitudes) else 0.0, _MIN_WIDTH)


class _Equations:
    """Normal equations of the lamps, with the texels' albedos eliminated."""

    def __init__(self, samples: Samples, near: bool):
        self._samples = samples
        self._free = [0, 1, 2, 3] if near else [0, 1, 3]
        self._count = len(samples.values)
        self._shaded: tuple[Lamps, tuple[np.ndarray, np.ndarray]] | None = None  # of the last lamps

    def _shading(self, lamps: Lamps) -> tuple[np.ndarray, np.ndarray]:
        if self._shaded is None or self._shaded[0] is not lamps:
            self._shaded = lamps, lamps.shading(self._samples.points, self._samples.normals)
        return self._shaded[1]

    def weighted(self, lamps: Lamps, weight: np.ndarray | None) -> tuple[np.ndarray, float]:
        """Return robust weights (K, T) under lamps, from the previous ones, and their width."""
        s = self._samples
        shading, cosine = self._shading(lamps)
        first = s.weight * (cosine > _FACING)
        weight = first if weight is None else np.where(first > 0, np.maximum(weight, 0.01 * first), 0)
        for _ in range(_INNER):
            residual = s.values - self._albedo(shading, weight) * shading
            width = _width(residual, first)
            weight = first / (1 + (residual / width) ** 2)
        return weight, width

    def _albedo(self, shading: np.ndarray, weight: np.ndarray) -> np.ndarray:
        top, bottom = ((weight * shading * other).sum(axis=0) for other in (self._samples.values, shading))
        return np.maximum(top, 0) / np.maximum(bottom, 1e-12)

    def cost(self, lamps: Lamps, weight: np.ndarray, width: float) -> float:
        """Return the weighted sum of squared residuals plus the prior."""
        s = self._samples
        shading, _ = self._shading(lamps)
        residual = s.values - self._albedo(shading, weight) * shading
        prior = (width / _WIDTH / _TRUST) ** 2 * (lamps.inverses**2).sum() if 2 in self._free else 0.0
        return float((weight * residual**2).sum() + prior)

    def reduced(self, lamps: Lamps, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the reduced equations (G, n, n) and (G, n) of each group of texels, in all n free parameters."""
        s = self._samples
        shading, _ = self._shading(lamps)
        albedo = self._albedo(shading, weight)
        residual = s.values - albedo * shading
        slopes = albedo[:, None] * lamps.derivatives(s.points, s.normals)[..., self._free]
        norm = np.sqrt(np.maximum((weight * shading**2).sum(axis=0), 1e-12))
        cross = ((weight * shading / norm)[..., None] * slopes).transpose(0, 2, 1).reshape(-1, len(albedo))
        size, per_lamp = len(cross), len(self._free)
        matrices, rights = np.zeros((GROUPS, size, size)), np.zeros((GROUPS, size))
        diagonal = np.arange(self._count)
        for group in range(GROUPS):
            members = s.groups == group
            blocks = matrices[group].reshape(self._count, per_lamp, self._count, per_lamp)
            scaled = slopes[:, members] * np.sqrt(weight[:, members, None])
            blocks[diagonal, :, diagonal] = scaled.transpose(0, 2, 1) @ scaled
            matrices[group] -= cross[:, members] @ cross[:, members].T
            rights[group] = np.einsum("ktp,kt->kp", slopes[:, members], (weight * residual)[:, members]).ravel()
        return matrices, rights

    def prior(self, width: float) -> np.ndarray:
        """Return the prior's matrix (n, n): fixes the scale of the strengths, and damps undetermined parameters."""
        per_lamp, size = len(self._free), len(self._free) * self._count
        noise = (width / _WIDTH) ** 2
        matrix = noise / _TRUST**2 * np.eye(size)
        strengths = np.arange(self._count) * per_lamp + per_lamp - 1
        matrix[np.ix_(strengths, strengths)] += max(noise, 1e-9) / _STRENGTH_TRUST**2
        return matrix

    def pull(self, lamps: Lamps, width: float) -> np.ndarray:
        """Return the gradient (n,) of the prior."""
        steps = np.zeros((self._count, FREE))
        steps[:, 2] = (width / _WIDTH / _TRUST) ** 2 * lamps.inverses
        return steps[:, self._free].ravel()

    def spread(self, steps: np.ndarray) -> np.ndarray:
        """Return a step in the free parameters as (K, FREE), clipped to ±0.5."""
        result = np.zeros((self._count, FREE))
        result[:, self._free] = steps.reshape(self._count, -1)
        return np.clip(result, -0.5, 0.5)

    def errors(self, lamps: Lamps, weight: np.ndarray, width: float) -> np.ndarray:
        """Return standard errors (K, FREE): one step without each group of texels (jackknife)."""
        matrices, rights = self.reduced(lamps, weight)
        prior = self.prior(width)
        whole, right = matrices.sum(axis=0) + prior, rights.sum(axis=0) - self.pull(lamps, width)
        solutions = []
        for group in range(GROUPS):
            solutions.append(np.linalg.solve(whole - matrices[group], right - rights[group]))
        replicates = np.stack(solutions)
        deviation = np.sqrt((GROUPS - 1) / GROUPS * ((replicates - replicates.mean(axis=0)) ** 2).sum(axis=0))
        result = np.zeros((self._count, FREE))
        result[:, self._free] = deviation.reshape(self._count, -1)
        return result
