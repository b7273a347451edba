"""First estimate of relative light intensities from the images of a matte surface; light positions are given."""

from __future__ import annotations

import numpy as np

_ROUNDS = 30  # of reweighting; most subjects converge in ten
_SETTLED = 1e-4  # relative change of an intensity in the last round
_MIN_WIDTH = 0.02  # of the robust weight, as a fraction of a texel's albedo: the level of noise
_WIDTH = 2.0  # times the median of the residuals
_FACING = 0.1  # least cosine of a sample; below it most samples lie in shadow
_DARK = 0.1  # of the texel's and the image's usual radiance; below it lies shadow, in the first weights
_COLOUR_ROUNDS = 10
# On a nearly flat surface two trends of the intensities are undetermined: the second smallest eigenvalue is small (1
# for well determined intensities, 0.1 for a bunny), and a highlight would bias the result. On a relief of 6° under 20
# lights the error is up to a factor of 8 without this weight of the given intensities, and 1.4 with it.
_DETERMINED, _GIVEN_WEIGHT = 0.05, 0.02


def relative_intensities(
    radiance: np.ndarray, weight: np.ndarray, vectors: np.ndarray, irradiance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return (K, 3) factors on the given intensities, with mean logarithm 0 per channel, and (T, 3) normals.

    Semi-calibrated photometric stereo (Cho, Matsushita, Tai and Kweon 2016): m_ij = e_j b_i·l_j is linear in b_i and
    1/e_j, so the solution is the eigenvector of the smallest eigenvalue of one K×K matrix, with the b_i eliminated.
    Reweighting until convergence suppresses shadows and highlights. radiance: (K, T, 3). weight: (K, T), 0 where not
    visible. vectors, irradiance: from ``prepare.light_vectors``. An undetermined light keeps the factor 1.
    """
    if not radiance.shape[1]:
        return np.ones((len(radiance), 3)), np.zeros((0, 3))
    lights = irradiance > 0
    channels = np.maximum(lights.sum(axis=-1), 1)
    shade = np.where(lights & (weight[..., None] > 0), radiance, 0) / np.where(lights, irradiance, 1)
    grey = shade.sum(axis=-1) / channels
    factors, scaled, weights = _grey_factors(grey, (weight > 0) & (grey > 0), vectors)
    length = np.maximum(np.linalg.norm(scaled, axis=-1, keepdims=True), 1e-12)
    normals = scaled / length
    facing = np.maximum(np.einsum("ktc,tc->kt", np.broadcast_to(vectors, (*grey.shape, 3)), normals), 1e-6)
    colours = [_channel_factors(shade[..., c], facing, weights * lights[..., c], factors) for c in range(3)]
    return normalised(np.stack(colours, axis=-1)), normals


def normalised(factors: np.ndarray) -> np.ndarray:
    """Return (K, 3) factors with mean logarithm 0 in each channel: images do not determine this scale."""
    return factors / np.exp(np.log(factors).mean(axis=0))


def _grey_factors(grey: np.ndarray, usable: np.ndarray, vectors: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return factors (K,), scaled normals (T, 3) and the final weights (K, T)."""
    inverse = np.ones(len(grey))
    weights = usable * _first_weights(grey, usable)
    for _ in range(_ROUNDS):
        before = inverse
        inverse = _inverse_intensities(grey, weights, vectors, inverse)
        scaled = _scaled_normals(grey * inverse[:, None], weights, vectors)
        length = np.maximum(np.linalg.norm(scaled, axis=-1), 1e-12)
        shading = np.einsum("ktc,tc->kt", np.broadcast_to(vectors, (*grey.shape, 3)), scaled)
        residual = np.abs(shading - inverse[:, None] * grey) / length
        width = max(_MIN_WIDTH, _WIDTH * float(np.median(residual[weights > 0.1]))) if (weights > 0.1).any() else 1.0
        weights = usable * (shading > _FACING * length) / (1 + (residual / width) ** 2) ** 2
        if np.abs(inverse / before - 1).max() < _SETTLED:
            break
    return 1 / inverse, scaled, weights


def _first_weights(grey: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Return (K, T) weights: 0 for samples that are dark for their texel and their image, less for bright ones."""
    shade = np.where(usable, grey, np.nan)
    shade[~usable.any(axis=1)] = 1.0  # numpy warns of percentiles of empty rows
    image = np.nanpercentile(shade, 80, axis=1)
    shade = shade / image[:, None]
    shade[:, ~usable.any(axis=0)] = 1.0
    texel = np.nanpercentile(shade, 80, axis=0)
    level = grey / (image[:, None] * texel)
    # With unknown gains a highlight is bright only shade to its own image.
    return (level > _DARK) * np.minimum(1, 1 / np.maximum(level, 1e-6) ** 2)


def _inverse_intensities(grey: np.ndarray, weights: np.ndarray, toward: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Return (K,) 1/e that minimise b_i·l_ij − m_ij / e_j in least squares; b_i is eliminated, the mean logarithm 0."""
    samples = grey * inverse[:, None]  # of similar magnitude, because least squares fix the norm of 1/e
    samples = samples / np.maximum(np.sqrt((weights * samples**2).sum(axis=0)), 1e-30)  # all texels have equal weight
    gram = _gram(weights, toward)
    root = np.linalg.inv(np.linalg.cholesky(gram))
    cross = np.einsum("tab,ktb->tak", root, (weights * samples)[..., None] * toward, optimize=True)
    matrix = np.diag((weights * samples**2).sum(axis=1)) - np.tensordot(cross, cross, ((0, 1), (0, 1)))
    determined = np.diag(matrix) > 1e-9 * max(float(np.diag(matrix).max()), 1e-30)
    change = np.ones(len(grey))
    if determined.sum() > 1:
        part = matrix[np.ix_(determined, determined)]
        spread = np.sqrt(np.diag(part))
        scaled = part / np.outer(spread, spread)
        values, vectors = np.linalg.eigh(scaled)
        if values[1] < _DETERMINED:
            given = spread[:, None] / inverse[determined][:, None]
            given = given / np.linalg.norm(given)
            vectors = np.linalg.eigh(scaled + _GIVEN_WEIGHT * (np.eye(len(part)) - given * given.T))[1]
        vector = vectors[:, 0] / spread
        vector *= np.sign(vector.sum()) or 1.0
        middle = float(np.median(vector))
        if middle > 0:
            change[determined] = np.clip(vector / middle, 0.05, 20)
    new = change * inverse
    return new / np.exp(np.log(new).mean())


def _gram(weights: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return (T, 3, 3) Σ w l lᵀ, damped to be regular."""
    gram = np.einsum("ktc,ktd,kt->tcd", *(2 * (np.broadcast_to(vectors, (*weights.shape, 3)),)), weights, optimize=True)
    return gram + (1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-12) * np.eye(3)


def _scaled_normals(samples: np.ndarray, weights: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return (T, 3) scaled normals by weighted least squares (Woodham 1980)."""
    right = ((weights * samples)[..., None] * vectors).sum(axis=0)
    return np.linalg.solve(_gram(weights, vectors), right[..., None])[..., 0]


def _channel_factors(shade: np.ndarray, facing: np.ndarray, weights: np.ndarray, grey: np.ndarray) -> np.ndarray:
    """Return (K,) factors of one channel; its shading is known up to the texels' albedos."""
    factors = grey.copy()
    ratio = np.where(weights > 0, shade, 0) / facing
    for _ in range(_COLOUR_ROUNDS):
        # Alternating least squares: shading is fixed, so only the common scale is free.
        weight = weights * facing**2
        norm = np.maximum((weight * factors[:, None] ** 2).sum(0), 1e-30)
        albedo = (weight * ratio * factors[:, None]).sum(axis=0) / norm
        weight = weight * albedo**2
        total = weight.sum(axis=1)
        estimate = (weight * ratio / np.maximum(albedo, 1e-30)).sum(axis=1) / np.maximum(total, 1e-30)
        factors = np.where((total > 0) & (estimate > 0), estimate, grey)
    return factors
