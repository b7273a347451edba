"""Before the search: each texel's scale, the weights of its samples, and a Lambertian first guess."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..geometry.domain import Domain
from ..reflectance.model import ReflectanceModel
from .schedule import Fitness, Schedule

_LIT_PERCENTILES = (20.0, 75.0)  # of the lit samples: below lies shadow's edge, above lies the highlight
_CHUNK = 1 << 20  # samples at a time: bounds the memory of the normal equations, about 200 bytes a sample


@dataclass(frozen=True)
class Prepared:
    """What is found before the search. scale: (H, W) of each texel. guess: parameter name → (H, W, components).

    brightness: mean irradiance/π of the lights at the texels. A scale is radiance over irradiance, errors are
    radiances: the unit and the distance of the lights must not matter.
    """

    scale: np.ndarray
    guess: dict[str, np.ndarray]
    brightness: float

    def part(self, rows: slice, columns: slice) -> Prepared:
        """Return it for a part of the domain: the very numbers of the whole, which a fit of the part may round off."""
        return Prepared(
            self.scale[rows, columns],
            {name: value[rows, columns] for name, value in self.guess.items()},
            self.brightness,
        )


def prepare(domain: Domain, model: ReflectanceModel, schedule: Schedule) -> Prepared:
    """Return each texel's scale and its first guess: defaults, or a Lambertian fit where seeds ask for it."""
    guess = {
        p.name: np.broadcast_to(np.asarray(p.default, np.float32), (*domain.shape, p.components))
        for p in model.parameters
    }
    if schedule.swarm.seed == "lambert":
        normal, albedo = lambert_seed(domain)
        for p in model.parameters:
            if p.is_normal:
                guess[p.name] = normal
            elif p.is_albedo:
                guess[p.name] = np.clip(albedo, *p.range)
    return Prepared(texel_scale(domain, schedule.fitness.percentile), guess, brightness(domain))


def brightness(domain: Domain) -> float:
    """Return (H, W) float32: the percentile of each texel's samples over their irradiance/π; 1 if it has none."""
    if not domain.lights[:, 3].any():
        return float(domain.intensities.mean())
    sums = [(_irradiance(domain, texels).mean(axis=(0, 2)).sum(), len(texels[0])) for texels in _chunks(domain)]
    return float(sum(part for part, _ in sums) / max(1, sum(count for _, count in sums)))


def texel_scale(domain: Domain, percentile: float) -> np.ndarray:
    """Return (H, W) float32: the percentile of each texel's samples over their irradiance/π; 1 if there are none."""
    scale = np.ones(domain.shape, np.float32)
    for texels in _chunks(domain):
        values = _grey(domain, texels)
        with np.errstate(all="ignore"):
            found = _nan_percentile(values, percentile)
        scale[texels] = np.where(found > 0, found, 1.0)
    return scale


def drop_shadow(
    stack: np.ndarray,
    lights: np.ndarray,
    intensities: np.ndarray,
    position: np.ndarray,
    scale: np.ndarray,
    fitness: Fitness,
) -> None:
    """Give weight 0, in place, to samples (K, h, w, 4) under the shadow threshold of their texel's scale (h, w).

    lights: (K, 4) and intensities: (K, 3) as in Domain; position: (h, w, 3) of the texels.
    """
    if fitness.loss != "robust" or fitness.shadow == 0:
        return
    for layer, light, intensity in zip(stack, lights, intensities, strict=True):
        squared = ((light[:3] - position) ** 2).sum(axis=-1) if light[3] > 0 else 1.0
        brightness = layer[..., :3].mean(axis=-1) * squared / intensity.mean()
        layer[..., 3] *= brightness >= fitness.shadow * scale


def lambert_seed(domain: Domain) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (H, W, 3), in the frames that are searched, and albedos (H, W, 3) of a trimmed Lambertian fit.

    Photometric stereo (Woodham 1980) by least squares over those of a texel's lit samples that lie between the 20th
    and the 75th percentile. Texels that leave fewer than three samples get the frame's own normal.
    """
    normal = np.zeros((*domain.shape, 3), np.float32)
    normal[..., 2] = 1
    albedo = np.zeros((*domain.shape, 3), np.float32)
    for texels in _chunks(domain):
        normal[texels], albedo[texels] = _lambert_fit(domain, texels)
    return normal, albedo


def light_vectors(domain: Domain, texels: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return, for T texels, (K, T, 3) unit vectors to the light in each texel's own frame, and its irradiance/π.

    Where they are the same at every texel, on a card under distant lights, T is 1.
    """
    if domain.card and not domain.lights[:, 3].any():
        vectors = domain.lights[:, None, :3].astype(np.float64)
        return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), domain.intensities[:, None]
    bake = domain.bake
    position, normal, tangent = bake.position[texels], bake.normal[texels], bake.tangent[texels]
    frame = np.stack(
        [tangent[..., :3], tangent[..., 3:] * np.cross(normal, tangent[..., :3]), normal], axis=-1
    )  # fmt: skip
    near = domain.lights[:, 3] > 0
    toward = np.repeat(domain.lights[:, None, :3], len(position), axis=1)
    toward[near] -= position
    squared = np.where(near[:, None], (toward**2).sum(axis=-1), 1.0)
    toward = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
    return np.einsum("ktc,tcd->ktd", toward, frame), domain.intensities[:, None, :] / squared[..., None]


def _lambert_fit(domain: Domain, texels: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    vectors, irradiance = light_vectors(domain, texels)
    samples = domain.stack[:, texels[0], texels[1]]
    # What weighs nothing may be anything, and 0 · NaN is NaN.
    radiance = np.where(samples[..., 3:] > 0, samples[..., :3], 0)
    lights = irradiance > 0  # a coloured light may have none of a channel
    shades = np.divide(radiance, irradiance, out=np.zeros_like(radiance), where=lights)
    grey = shades.sum(axis=-1) / lights.sum(axis=-1)
    lit = grey > 0
    values = np.where(lit, grey, np.nan)
    with np.errstate(all="ignore"):
        low, high = (_nan_percentile(values, q) for q in _LIT_PERCENTILES)
        kept = lit & (grey >= low) & (grey <= high)
    kept = np.where(kept.sum(axis=0) >= 3, kept, lit).astype(np.float64)
    gram, right = _normal_equations(vectors, kept, grey)
    # 1e-9 of the trace: an answer for lights in a plane too, where it is the shortest of many.
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-30 * np.eye(3)
    scaled = np.linalg.solve(gram, right[..., None])[..., 0]
    scaled[:, 2] = np.maximum(scaled[:, 2], 0)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    usable = (kept.sum(axis=0) >= 3)[:, None] & (length > 1e-8)
    normal = np.where(usable, scaled / np.maximum(length, 1e-8), (0.0, 0.0, 1.0))
    facing = vectors[:, 0] @ normal.T if vectors.shape[1] == 1 else np.einsum("kti,ti->kt", vectors, normal)
    cosine = (np.maximum(facing, 0) * kept)[..., None] * lights
    albedo = (cosine * shades).sum(axis=0) / np.maximum((cosine**2).sum(axis=0), 1e-8)
    return normal.astype(np.float32), albedo.astype(np.float32)


def _normal_equations(vectors: np.ndarray, weight: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 3) Σ w l lᵀ and (T, 3) Σ w l v over K lights: products of matrices where texels share the lights."""
    if vectors.shape[1] == 1:
        outer = vectors[:, 0, :, None] * vectors[:, 0, None, :]
        gram = (weight.T @ outer.reshape(-1, 9)).reshape(-1, 3, 3)
        return gram, (weight * values).T @ vectors[:, 0]
    gram = np.einsum("kti,ktj->tij", weight[..., None] * vectors, vectors, optimize=True)
    return gram, np.einsum("kt,kti->ti", weight * values, vectors)


def _irradiance(domain: Domain, texels: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(K, T, 3) irradiance/π of every light at T texels facing it; T is 1 where all lights are distant."""
    near = domain.lights[:, 3] > 0
    if not near.any():
        return domain.intensities[:, None]
    position = domain.bake.position[texels]
    squared = ((domain.lights[:, None, :3] - position) ** 2).sum(axis=-1)
    return domain.intensities[:, None] / np.where(near[:, None], squared, 1.0)[..., None]


def _grey(domain: Domain, texels: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(K, T) mean of RGB over the light's own, NaN where a sample weighs nothing."""
    samples = domain.stack[:, texels[0], texels[1]]
    grey = samples[..., :3].mean(axis=-1) / _irradiance(domain, texels).mean(axis=-1)
    return np.where(samples[..., 3] > 0, grey, np.nan)


def _nan_percentile(values: np.ndarray, percentile: float) -> np.ndarray:
    """Percentile over axis 0 of what is not NaN, linear between ranks; NaN for empty columns (np's own loops)."""
    ordered = np.sort(values, axis=0)  # NaN last
    count = (~np.isnan(values)).sum(axis=0)
    rank = np.maximum(count - 1, 0) * percentile / 100
    low = np.floor(rank).astype(int)
    high = np.minimum(low + 1, np.maximum(count - 1, 0))
    columns = np.arange(values.shape[1])
    a, b = ordered[low, columns], ordered[high, columns]
    return a + (b - a) * (rank - low)


def _chunks(domain: Domain) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield rows and columns of the solvable texels, row by row, as many at a time as hold _CHUNK samples."""
    texels = np.flatnonzero(domain.solvable)
    size = max(1, _CHUNK // max(domain.observations, 1))
    for start in range(0, len(texels), size):
        yield np.divmod(texels[start : start + size], domain.shape[1])
