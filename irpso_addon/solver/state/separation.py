"""Direct and indirect light, separated by colour, or by shadows (shadow_light.py).

Light between two surfaces of one colour is coloured twice. If the direct light of brass has the chroma u, the light
after one more bounce has about u², after two u³, and so on. So a sample in a hollow is a mixture of u, u² and u⁴ (Funt
and Drew 1993, Color space analysis of mutual illumination; Liao et al. 2011, Interreflection removal for photometric
stereo by using spectrum-dependent albedo). A chroma is radiance over irradiance, normalised to a sum of 1. Here a
chroma is a power of the direct one; the exponent is called its saturation.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...core.optional import present
from ...core.steps import blocking
from ...geometry.domain import Domain, subset, with_lights
from ...geometry.samples import SampleStack
from ..settings.schedule import Schedule
from .prepare import Prepared, Texels, chunk_steps, dot, light_vectors, over_lights, percentiles, scale_steps
from .separation_record import Separation
from .shadow_light import light_of
from .textures import DomainTextures

_MIN_LIGHT, _BRIGHT = 0.02, 90.0  # a sample has a chroma above this part of this percentile of the texel's light
_DIRECT = 10.0  # percentile of the saturations of a texel's samples: the least indirect ones

# Conditions on a subject. The median distance of its chromas from their middle is 0.04 to 0.06 for brass, gold, copper
# and terracotta, 0.17 for enamel with its highlights, 0.27 for patina, 0.48 for a concave mix. Of the texels whose
# shading shows indirect light, 74 to 97 % are doubly coloured on the first four, at most 42 % on others.
_MIN_CHROMA = 0.3
_MAX_SPREAD = 0.15
_MIN_FOUND = 0.02  # of the texels
_MIN_SATURATION, _MAX_SATURATION, _MAX_DISTANCE = 1.2, 4.0, 0.15

# Least weight of a sample after its light is separated by colour; with 0.05 or 0.2, copper, brass and gold differ by at
# most 0.5°. Mean normal errors (subjects of benchmarks/separation.py, standard) with all weights 1 and with these:
# copper 15.7 and 14.0°, brass 4.3 and 3.8°, bronze 12.0 and 11.9°, terracotta 4.7 and 4.5°, gold 18.8 and 18.9° (median
# 5.5 and 4.7°). More texels are called known, 44 in place of 39 % of copper; those of gold are off by 2.8, not 2.5°.
_MIN_WEIGHT = 0.1


def median_chromas(domain: Domain, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return (T, 3): the chromas of T texels, each channel the median over its lit samples; NaN without any.

    All are NaN if a light lacks a channel.
    """
    if not (domain.intensities > 0).all():
        return np.full((len(rows), 3), np.nan)
    return _median(_chromas(domain.stack.texels(rows, columns), domain.intensities))


def direct_chroma(chroma: np.ndarray, indirect: np.ndarray) -> np.ndarray | None:
    """Return (3,): the chroma of the direct light of a subject of one colour; None for other subjects.

    chroma: (T, 3) from ``median_chromas``, of a sample of the subject's texels. indirect: (T,) bool, those whose
    shading shows indirect light.
    """
    known = np.isfinite(chroma).all(axis=-1)
    direct, hollow = chroma[known & ~indirect], chroma[known & indirect]
    if len(direct) == 0 or len(hollow) < _MIN_FOUND * len(chroma):
        return None
    middle = _chroma(np.median(direct, axis=0))
    if np.linalg.norm(_logarithm(middle)) < _MIN_CHROMA:
        return None
    distance = np.linalg.norm(_logarithm(direct) - _logarithm(middle), axis=-1)
    if np.median(distance) > _MAX_SPREAD:
        return None
    saturation, _ = _saturation_of(direct, middle)
    unmixed = _chroma(np.median(direct[saturation <= np.median(saturation)], axis=0))
    if np.mean(_doubly_coloured(hollow, unmixed)) < 0.5:
        return None
    return unmixed


def separation_steps(
    domain: Domain, indirect: np.ndarray, direct: np.ndarray, least: float
) -> Generator[float, None, Separation]:
    """Return the separation (H, W) by colour.

    None where the shading shows no indirect light and its part by colour is below ``least``. indirect: (H, W) bool,
    from the shading. direct: (3,) from ``direct_chroma``. Yields the fraction done.
    """
    result = Separation.none(domain.shape)

    def work(start: int, texels: Texels) -> None:
        samples = domain.stack.texels(*texels)
        chroma = _chromas(samples, domain.intensities)
        hollow = indirect[texels] & _doubly_coloured(_median(chroma), direct)
        (own,) = percentiles(_saturation_of(chroma, direct)[0], [_DIRECT])
        known = np.isfinite(own)
        own = np.where(hollow | ~known, 1.0, np.maximum(own, 1.0))[:, None]
        once, twice = (_chroma(direct**power)[:, :2].astype(np.float32) for power in (own, own + 1))
        light = _radiance(samples, domain.intensities) * (samples[..., 3:] > 0)
        direct_part = _all_light(_without(light, once, twice)) / np.maximum(_all_light(light), 1e-30)
        chosen = known & (hollow | (1 - direct_part >= least))
        found = Separation.of_colours(once, twice, 1 - direct_part)
        result[texels] = found.where(chosen, Separation.none(chosen.shape))

    yield from chunk_steps(domain, work)
    return result


separation_of = blocking("separation_of", separation_steps)


@dataclass(frozen=True, eq=False)
class SeparatedStack:
    """A read-only ``SampleStack``: a domain's samples without indirect light. Bounds and samples of weight 0 stay.

    Metal seen at a grazing angle reflects nearly white light, which the chromas do not explain. So the more light is
    removed by colour, the less a sample weighs: with the direct part d and the removed part r of its light, its weight
    becomes d² / (d² + r²), at least _MIN_WEIGHT. Samples separated by shadows keep their weights: with the same
    formula, a concave mix is off by 8.82 in place of 8.80°, a goblet of enamel by 3.51 in place of 3.52°.

    separation: (H, W).
    """

    domain: Domain
    separation: Separation

    @property
    def shape(self) -> tuple[int, int, int]:
        """(K, H, W)."""
        return self.domain.stack.shape

    def layer(self, observation: int) -> np.ndarray:
        """Return (H, W, 4): the samples of one observation."""
        rows, columns = np.nonzero(self.separation.separated)
        layer = self.domain.stack.layer(observation).copy()
        one = slice(observation, observation + 1)
        domain = with_lights(self.domain, self.domain.lights[one], self.domain.intensities[one])
        samples, separation = layer[rows, columns][None], self.separation[rows, columns]
        layer[rows, columns] = _direct(domain, (rows, columns), samples, separation)[0]
        return layer

    def layers(self) -> Iterator[np.ndarray]:
        """Yield the samples of every observation."""
        return (self.layer(observation) for observation in range(self.shape[0]))

    def kept(self, derived: SampleStack) -> SampleStack:
        """As SampleStack."""
        return self.domain.stack.kept(derived)

    def texels(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (K, N, 4): the samples at N texels."""
        samples = self.domain.stack.texels(rows, columns)
        return _direct(self.domain, (rows, columns), samples, self.separation[rows, columns])

    def subset(self, observations: np.ndarray) -> SeparatedStack:
        """Return the stack of some observations."""
        return SeparatedStack(subset(self.domain, observations, self.domain.solvable), self.separation)

    def window(self, rows: slice, columns: slice) -> SeparatedStack:
        """Return the texels of a window."""
        part = rows, columns
        domain = replace(
            self.domain,
            bake=self.domain.bake.map_arrays(lambda values: values[part]),
            stack=self.domain.stack.window(*part),
        )
        return SeparatedStack(domain, self.separation[part])

    def lit(self, coverage: np.ndarray) -> np.ndarray:
        """Return (H, W) bool: covered texels that at least one observation sees lit, directly or not."""
        return self.domain.stack.lit(coverage)


def separated_steps(
    domain: Domain, domain_textures: DomainTextures, separation: Separation, schedule: Schedule
) -> Generator[float, None, tuple[DomainTextures, np.ndarray]]:
    """Return textures of a domain without its indirect light, and the stack to upload to them.

    separation: (h, w), packed. domain_textures: the current ones. Yields the fraction done of each sweep in turn.
    """
    if separation.any():
        domain = replace(domain, stack=SeparatedStack(domain, separation.unpacked(domain_textures.packing)))
    scale = yield from scale_steps(domain, schedule.fitness.scale_percentile)
    irradiance, packing = domain_textures.mean_irradiance, domain_textures.packing
    prepared = yield from Prepared(scale, {}, irradiance).packing_steps(domain, schedule)
    numbers = packing.pack(scale), irradiance, prepared.arrays
    return DomainTextures(domain, packing, None, *numbers, separation=separation), present(prepared.stack)


def _direct(domain: Domain, texels: Texels, samples: np.ndarray, separation: Separation) -> np.ndarray:
    """Return samples (K, T, 4) of a domain's T texels minus their indirect light. separation: (T,)."""
    result, by_colour = samples.copy(), separation.by_colour
    by_shadows = separation.separated & ~by_colour
    for chosen, subtract in ((by_colour, _without_bounces), (by_shadows, _without_shadow_light)):
        if chosen.any():
            rows, columns = texels
            part = samples[:, chosen]
            direct = subtract(domain, (rows[chosen], columns[chosen]), part, separation[chosen])
            result[:, chosen] = np.where(part[..., 3:] > 0, direct, part)
    return result


def _without_bounces(domain: Domain, texels: Texels, samples: np.ndarray, separation: Separation) -> np.ndarray:
    """Return (K, T, 4): samples minus their components of the indirect chromas, with the weights of SeparatedStack."""
    light = _radiance(samples, domain.intensities)
    direct = _without(light, separation.direct_chroma, separation.bounced_chroma)
    kept, removed = (dot(part, part) for part in (direct, light - direct))
    weight = np.maximum(1 - removed / np.maximum(kept + removed, 1e-30), _MIN_WEIGHT) * samples[..., 3]
    return np.concatenate([direct * domain.intensities[:, None], weight[..., None]], axis=-1)


def _without_shadow_light(domain: Domain, texels: Texels, samples: np.ndarray, separation: Separation) -> np.ndarray:
    """Return (K, T, 4): samples minus the indirect light that was estimated from shadows."""
    vectors, irradiance = light_vectors(domain, texels)
    chroma = _completed(separation.shadow_chroma.astype(np.float64))
    indirect = light_of(vectors, separation.harmonics.astype(np.float64), chroma) * irradiance
    direct = np.maximum(np.nan_to_num(samples[..., :3]) - indirect, 0)
    return np.concatenate([direct, samples[..., 3:]], axis=-1)


def _without(light: np.ndarray, direct: np.ndarray, bounced: np.ndarray) -> np.ndarray:
    """Return light (K, T, 3) minus its components of the indirect chromas, by non-negative least squares in float64.

    direct, bounced: chromas (T, 2), as in Separation. Inside the cone of the three chromas a sample has three
    components; outside, it is projected to the nearest side of the cone, which has two chromas.
    """
    u, v = (_completed(chroma.astype(np.float64)) for chroma in (direct, bounced))
    w = _chroma(v**3 / np.maximum(u, 1e-9) ** 2)  # v has one bounce more than u, w has three more
    volume = dot(u, np.cross(v, w))
    volume = np.where(np.abs(volume) > 1e-15, volume, 1e-15)[:, None]
    parts = [dot(light, np.cross(*others) / volume) for others in ((v, w), (w, u), (u, v))]
    inside = (parts[0] >= 0) & (parts[1] >= 0) & (parts[2] >= 0)
    least = np.where(inside, 0.0, np.inf)
    once, often = (np.where(inside, part, 0.0) for part in parts[1:])
    for first, second, is_once, is_often in ((u, v, (0, 1), (0, 0)), (u, w, (0, 0), (0, 1)), (v, w, (1, 0), (0, 1))):
        two = _two_components(light, first, second)
        left = light - two[0][..., None] * first - two[1][..., None] * second
        error = dot(left, left)
        nearer = error < least
        least = np.where(nearer, error, least)
        once, often = (
            np.where(nearer, two[0] * one + two[1] * other, part)
            for part, (one, other) in ((once, is_once), (often, is_often))
        )
    return np.maximum(light - once[..., None] * v - often[..., None] * w, 0)


def _two_components(light: np.ndarray, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two (K, T): the components of two chromas (T, 3) in light, by non-negative least squares."""
    ff, ss, fs = dot(first, first), dot(second, second), dot(first, second)
    determinant = ff * ss - fs * fs
    determinant = np.where(determinant > 0, determinant, 1.0)
    along_f, along_s = dot(light, first), dot(light, second)
    a, b = (along_f * ss - along_s * fs) / determinant, (along_s * ff - along_f * fs) / determinant
    return (
        np.where(b < 0, np.maximum(along_f / ff, 0), np.maximum(a, 0)),
        np.where(a < 0, np.maximum(along_s / ss, 0), np.maximum(b, 0)),
    )


def _completed(chroma: np.ndarray) -> np.ndarray:
    """Return (T, 3) chromas from their red and green; thirds where both are 0, which separates nothing."""
    whole = np.concatenate([chroma, (1 - chroma[:, :1]) - chroma[:, 1:]], axis=-1)
    return np.where(chroma[:, :1] > 0, whole, 1 / 3)


def _median(chroma: np.ndarray) -> np.ndarray:
    """Return (T, 3) of chromas (K, T, 3): the median of each channel over the samples that are not NaN."""
    return _chroma(np.stack([percentiles(chroma[..., c], [50.0])[0] for c in range(3)], axis=-1))


def _radiance(samples: np.ndarray, intensities: np.ndarray) -> np.ndarray:
    """Return (K, T, 3) samples (K, T, 4) under lights of intensity 1, at least 0."""
    return np.maximum(np.nan_to_num(samples[..., :3]) / intensities[:, None], 0).astype(np.float64)


def _chromas(samples: np.ndarray, intensities: np.ndarray) -> np.ndarray:
    """Return (K, T, 3) chromas of samples (K, T, 4); NaN of dark samples, bounds, and those of no weight."""
    light = _radiance(samples, intensities)
    total = (light[..., 0] + light[..., 1]) + light[..., 2]
    counted = np.where(samples[..., 3] > 0, total, np.nan)
    with np.errstate(invalid="ignore"):
        (bright,) = percentiles(counted, [_BRIGHT])
        counted = counted > np.maximum(_MIN_LIGHT * bright, 1e-30)
    return np.where(counted[..., None], _chroma(light), np.nan)


def _chroma(light: np.ndarray) -> np.ndarray:
    total = (light[..., 0] + light[..., 1]) + light[..., 2]
    return light / np.where(total > 0, total, 1)[..., None]


def _logarithm(chroma: np.ndarray) -> np.ndarray:
    """Return logarithms of chromas, with a sum of 0."""
    logarithm = np.log(np.maximum(chroma, 1e-4))
    return logarithm - (((logarithm[..., 0] + logarithm[..., 1]) + logarithm[..., 2]) / 3)[..., None]


def _saturation_of(chroma: np.ndarray, direct: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the saturations of chromas (…, 3), exponents of the direct one, and their distances from its powers."""
    axis, logarithm = _logarithm(direct), _logarithm(chroma)
    saturation = dot(logarithm, axis) / dot(axis, axis)
    across = logarithm - saturation[..., None] * axis
    return saturation, np.sqrt(dot(across, across))


def _doubly_coloured(chroma: np.ndarray, direct: np.ndarray) -> np.ndarray:
    """Return bool: whether chromas (…, 3) are powers of the direct one with one or more further bounces."""
    saturation, distance = _saturation_of(chroma, direct)
    return (saturation >= _MIN_SATURATION) & (saturation <= _MAX_SATURATION) & (distance <= _MAX_DISTANCE)


def _all_light(light: np.ndarray) -> np.ndarray:
    """Return (T,) sums of (K, T, 3) over lights and channels, one light after another."""
    return over_lights((light[..., 0] + light[..., 1]) + light[..., 2])
