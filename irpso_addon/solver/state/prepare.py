"""Preparation of a search: each texel's scale, the weights of its samples, and a Lambertian first guess.

The numbers of a texel depend bit for bit on its own samples alone, not on how the domain is tiled. So all sums run
light by light: library sums group their terms by the size of an array.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from ...core.steps import available_cores, blocking, map_steps, run_steps
from ...geometry.domain import Domain
from ...reflectance.model import ReflectanceModel
from ..settings.groups import Fitness
from ..settings.schedule import Schedule
from .packing import Packing
from .textures import domain_arrays

_LIT_PERCENTILES = (20.0, 75.0)  # of the lit samples: shadow edges lie below, highlights above
_CHUNK = 1 << 16  # samples at a time: their temporaries, about 80 bytes a sample, stay in a cache
_EXPONENTS, _MIN_EXPONENT = 280, -149  # of float32 numbers, with a margin
_MAX_THREADS = 8  # numpy releases the GIL; more threads would wait for memory

Texels = tuple[np.ndarray, np.ndarray]  # rows, columns
Report = Callable[[float], object]  # receives the fraction done, 0 to 1


@dataclass(frozen=True)
class Prepared:
    """Result of the preparation. scale: (H, W) of each texel. guess: parameter name → (H, W, components).

    mean_irradiance: of the lights at the texels, over π. It converts scales (radiance over irradiance) to radiances
    and cancels the unit and the distance of the lights. packing, stack, arrays: for the upload to the GPU,
    (K, h, w, 4) samples without shadow and the result of ``domain_arrays``; None where the recovery computes them.
    """

    scale: np.ndarray
    guess: dict[str, np.ndarray]
    mean_irradiance: float
    packing: Packing | None = None
    stack: np.ndarray | None = None
    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    def part(self, rows: slice, columns: slice) -> Prepared:
        """Return the same numbers for a part of the domain; a new fit of the part might round differently."""
        return Prepared(
            self.scale[rows, columns],
            {name: value[rows, columns] for name, value in self.guess.items()},
            self.mean_irradiance,
        )

    def packed(self, domain: Domain, schedule: Schedule, report: Report = lambda part: None) -> Prepared:
        """Return a copy with the arrays for the GPU. report: as for ``prepare``."""
        return run_steps(self.packing_steps(domain, schedule), report)

    def packing_steps(self, domain: Domain, schedule: Schedule) -> Generator[float, None, Prepared]:
        """Yield the fraction done; return the result of ``packed``."""
        if self.stack is not None:
            return self
        packing = Packing(domain.solvable, domain.seams)
        stack = np.zeros((domain.observations, packing.height * packing.width, 4), np.float32)

        def work(start: int, texels: Texels) -> None:
            part = stack[:, start : start + len(texels[0])]
            part[:] = domain.stack.texels(*texels)
            if not schedule.fitness.clipped_samples:
                part[..., 3] = np.maximum(part[..., 3], 0)
            weight = part[..., 3].copy()
            _drop_shadow(part, domain, texels, self.scale[texels], schedule.fitness)
            # Marks dropped samples as shaders/common/observation.glsl does.
            part[..., 3] -= np.where(part[..., 3] == 0, np.clip(weight, 0, 1) / 2, 0)

        yield from chunk_steps(domain, work)
        stack = stack.reshape(-1, packing.height, packing.width, 4)
        arrays = domain_arrays(domain, packing, packing.pack(self.scale))
        return Prepared(self.scale, self.guess, self.mean_irradiance, packing, stack, arrays)


def prepare(
    domain: Domain, model: ReflectanceModel, schedule: Schedule, pack: bool = True, report: Report = lambda part: None
) -> Prepared:
    """Return the result of ``prepare_steps``. report: called now and then with the fraction done, 0 to 1."""
    return run_steps(prepare_steps(domain, model, schedule, pack), report)


def prepare_steps(
    domain: Domain, model: ReflectanceModel, schedule: Schedule, pack: bool = True
) -> Generator[float, None, Prepared]:
    """Yield the fraction done; return each texel's scale, first guess, and the stack.

    The guess is the defaults, or a Lambertian fit where swarms start near one. Uses numpy only, so it may run in a
    thread beside a window. pack: also make the arrays for the GPU.
    """
    fitted = schedule.swarm.start == "lambert"
    count = 1 + fitted + pack
    sweeps = (lambda part, k=k: (k + part) / count for k in range(count))
    guess = {
        p.name: np.broadcast_to(np.asarray(p.default, np.float32), (*domain.shape, p.components))
        for p in model.parameters
    }
    if fitted:
        normal, albedo = yield from map_steps(lambert_steps(domain), next(sweeps))
        for p in model.parameters:
            if p.is_normal:
                guess[p.name] = normal
            elif p.is_albedo:
                guess[p.name] = np.clip(albedo, *p.range)
    scale = yield from map_steps(scale_steps(domain, schedule.fitness.scale_percentile), next(sweeps))
    prepared = Prepared(scale, guess, mean_irradiance(domain))
    if not pack:
        return prepared
    return (yield from map_steps(prepared.packing_steps(domain, schedule), next(sweeps)))


def mean_irradiance(domain: Domain) -> float:
    """Return the mean irradiance/π of the lights at the texels, over lights, texels and channels."""
    return mean_irradiance_of(domain, *irradiance_sums(domain, domain.solvable))


def irradiance_sums(domain: Domain, counted: np.ndarray) -> tuple[np.ndarray, int]:
    """Return exact sums of the irradiances at some solvable texels, (H, W) bool, and the number of these texels.

    The sums are (280,) int64: for each exponent of a float32, the sum of the mantissas as whole numbers. They are
    exact, so the sums of parts add up to the sums of the whole domain, in any order.
    """
    sums, count = np.zeros(_EXPONENTS, np.int64), 0
    if not domain.lights[:, 3].any():
        return sums, int(np.count_nonzero(counted))
    for _, texels in chunks(domain):
        mean = _irradiance(domain, texels).mean(axis=-1)
        values = (over_lights(mean) / len(mean)).astype(np.float32)[counted[texels]]
        mantissa, exponent = np.frexp(values)
        np.add.at(sums, exponent - _MIN_EXPONENT, (mantissa * 2.0**24).astype(np.int64))
        count += len(values)
    return sums, count


def mean_irradiance_of(domain: Domain, sums: np.ndarray, count: int) -> float:
    """Return ``mean_irradiance`` from the ``irradiance_sums`` of all texels of a domain."""
    if not domain.lights[:, 3].any():
        return float(domain.intensities.mean())
    total = sum(int(part) << place for place, part in enumerate(sums.tolist()))
    return float(Fraction(total, max(1, count)) * Fraction(2) ** (_MIN_EXPONENT - 24))


def scale_steps(domain: Domain, percentile: float) -> Generator[float, None, np.ndarray]:
    """Return (H, W) float32: the percentile of each texel's samples over their irradiance/π; 1 if there are none.

    Where it is 0, as in a texel that few lights reach: that of the samples above 0.

    Yields the fraction done.
    """
    scale = np.ones(domain.shape, np.float32)

    def work(start: int, texels: Texels) -> None:
        samples = domain.stack.texels(*texels)
        grey = grey_of(samples) / _irradiance(domain, texels).mean(axis=-1)
        with np.errstate(all="ignore"):
            (value,) = percentiles(np.where(samples[..., 3] > 0, grey, np.nan), [percentile])
            if (dark := value <= 0).any():
                lit = (samples[..., 3] > 0) & (grey > 0)
                (value[dark],) = percentiles(np.where(lit, grey, np.nan)[:, dark], [percentile])
            scale[texels] = np.where(value > 0, value, 1.0)

    yield from chunk_steps(domain, work)
    return scale


texel_scale = blocking("texel_scale", scale_steps)


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
    if fitness.loss != "cauchy" or fitness.shadow == 0:
        return
    grey = grey_of(stack)
    for layer in np.flatnonzero(lights[:, 3] > 0):
        grey[layer] *= ((lights[layer, :3] - position) ** 2).sum(axis=-1)
    grey /= intensities.mean(axis=-1)[:, None, None]
    stack[..., 3] *= grey >= fitness.shadow * scale


def lambert_steps(domain: Domain) -> Generator[float, None, tuple[np.ndarray, np.ndarray]]:
    """Return normals (H, W, 3), in the texels' frames, and albedos (H, W, 3) of a trimmed Lambertian fit.

    Photometric stereo (Woodham 1980) by least squares over a texel's lit samples between the 20th and the 75th
    percentile; over all lit ones where these are fewer than three. Texels with fewer than three lit samples get the
    frame's own normal. Yields the fraction done.
    """
    normal = np.zeros((*domain.shape, 3), np.float32)
    normal[..., 2] = 1
    albedo = np.zeros((*domain.shape, 3), np.float32)

    def work(start: int, texels: Texels) -> None:
        normal[texels], albedo[texels] = _lambert_fit(domain, texels, start)

    yield from chunk_steps(domain, work)
    return normal, albedo


lambert_fit = blocking("lambert_fit", lambert_steps)


def light_vectors(domain: Domain, texels: Texels) -> tuple[np.ndarray, np.ndarray]:
    """Return, for T texels, (K, T, 3) unit vectors to the light in each texel's own frame, and its irradiance/π.

    T is 1 where both are the same at all texels: on a card under distant lights.
    """
    if domain.card and not domain.lights[:, 3].any():
        vectors = domain.lights[:, None, :3].astype(np.float64)
        return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), domain.intensities[:, None]
    position, frame = domain.bake.position[texels], domain.bake.frames(texels).swapaxes(-1, -2)
    near = domain.lights[:, 3] > 0
    toward = np.repeat(domain.lights[:, None, :3], len(position), axis=1)
    toward[near] -= position
    squared = np.where(near[:, None], (toward**2).sum(axis=-1), 1.0)
    toward = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
    local = [dot(toward, frame[..., axis]) for axis in range(3)]
    return np.stack(local, axis=-1), domain.intensities[:, None, :] / squared[..., None]


def _drop_shadow(stack: np.ndarray, domain: Domain, texels: Texels, scale: np.ndarray, fitness: Fitness) -> None:
    """``drop_shadow`` of (K, T, 4) samples of T texels."""
    position = domain.bake.position[texels]
    drop_shadow(stack[:, None], domain.lights, domain.intensities, position[None], scale[None], fitness)


def _lambert_fit(domain: Domain, texels: Texels, start: int) -> tuple[np.ndarray, np.ndarray]:
    vectors, irradiance = light_vectors(domain, texels)
    samples = domain.stack.texels(*texels)
    lights = irradiance > 0  # a coloured light may have none of a channel
    weighted = samples[..., 3] > 0
    shades = [_shade(samples, weighted, channel, irradiance[..., channel]) for channel in range(3)]
    sums, channels = (shades[0] + shades[1]) + shades[2], lights.sum(axis=-1).astype(np.float64)
    grey = sums.astype(np.float64)
    with np.errstate(all="ignore"):
        grey /= channels
        lit = grey > 0
        # Single precision sorts faster, and in the same order where all lights have the same number of channels.
        single = (channels == channels.flat[0]).all()
        values = np.where(lit, sums if single else grey, np.nan)
        low, high = percentiles(values, _LIT_PERCENTILES, channels.flat[0] if single else 1)
        fitted = (grey >= low) & (grey <= high) & lit
    count = fitted.sum(axis=0)
    if (count < 3).any():
        fitted = np.where(count >= 3, fitted, lit)
        count = fitted.sum(axis=0)
    weight = fitted.astype(np.float64)
    gram, right = normal_equations(vectors, weight, grey)
    # Damping by 1e-9 of the trace: for coplanar lights the solution is then the shortest of many.
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-30 * np.eye(3)
    scaled = np.linalg.solve(gram, right[..., None])[..., 0]
    scaled[:, 2] = np.maximum(scaled[:, 2], 0)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    usable = (count >= 3)[:, None] & (length > 1e-8)
    normal = np.where(usable, scaled / np.maximum(length, 1e-8), (0.0, 0.0, 1.0))
    cosine = np.maximum(dot(vectors, normal), 0)
    cosine *= weight
    albedo, squares = np.empty(normal.shape, np.float32), None
    for channel, shade in enumerate(shades):
        all_lights = lights[..., channel].all()
        shading = cosine if all_lights else cosine * lights[..., channel]
        if squares is None or not all_lights:
            squares = over_lights(shading**2)
        albedo[:, channel] = over_lights(shading * shade) / np.maximum(squares, 1e-8)
        squares = squares if all_lights else None
    return normal.astype(np.float32), albedo


def _shade(samples: np.ndarray, weighted: np.ndarray, channel: int, irradiance: np.ndarray) -> np.ndarray:
    """Return (K, T): one channel over irradiance/π; 0 where a sample has no weight or its light lacks the channel."""
    # A sample of weight 0 may be NaN, and 0 · NaN is NaN.
    radiance = samples[..., channel] if weighted.all() else np.where(weighted, samples[..., channel], 0)
    lights = np.broadcast_to(irradiance > 0, radiance.shape)
    if lights.all():
        return radiance / irradiance
    return np.divide(radiance, irradiance, out=np.zeros_like(radiance), where=lights)


def normal_equations(vectors: np.ndarray, weight: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (T, n, n) Σ w l lᵀ and (T, n) Σ w l v over K lights.

    vectors: (K, T or 1, n). weight, values: (K, T).
    """
    columns, size = vectors.transpose(0, 2, 1), vectors.shape[-1]
    first, second = np.triu_indices(size)
    sums, right = np.zeros((len(first), weight.shape[1])), np.zeros((size, weight.shape[1]))
    for vector, w, v in zip(columns, weight, weight * values, strict=True):
        sums += vector[first] * vector[second] * w
        right += vector * v
    gram = np.empty((weight.shape[1], size, size))
    gram[:, first, second] = gram[:, second, first] = sums.T
    return gram, right.T


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (…) products of vectors (…, 3)."""
    return (a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]) + a[..., 2] * b[..., 2]


def over_lights(values: np.ndarray) -> np.ndarray:
    """Return (T,) sums of (K, T) over the lights, one after another."""
    total = np.zeros(values.shape[1], np.float64)
    for value in values:
        total += value
    return total


def _irradiance(domain: Domain, texels: Texels) -> np.ndarray:
    """(K, T, 3) irradiance/π of every light at T texels facing it; T is 1 where all lights are distant."""
    near = domain.lights[:, 3] > 0
    if not near.any():
        return domain.intensities[:, None]
    position = domain.bake.position[texels]
    squared = ((domain.lights[:, None, :3] - position) ** 2).sum(axis=-1)
    return domain.intensities[:, None] / np.where(near[:, None], squared, 1.0)[..., None]


def grey_of(samples: np.ndarray) -> np.ndarray:
    """Return the mean of RGB, as numpy's over an axis of three, which is ten times slower."""
    return ((samples[..., 0] + samples[..., 1]) + samples[..., 2]) / samples.dtype.type(3)


def percentiles(values: np.ndarray, percentiles: Sequence[float], divisor: float = 1) -> list[np.ndarray]:
    """Return percentiles over axis 0 of values / divisor, without NaN; NaN for columns without numbers."""
    ordered = np.array(values.T, order="C")  # always a copy; contiguous numbers sort faster
    ordered.sort(axis=1)  # NaN last
    last = np.maximum(values.shape[0] - np.isnan(values).sum(axis=0) - 1, 0)
    rows, results = np.arange(values.shape[1]), []
    for percentile in percentiles:
        rank = last * percentile / 100
        low = np.floor(rank).astype(int)
        a, b = ordered[rows, low], ordered[rows, np.minimum(low + 1, last)]
        if divisor != 1:
            a, b = a.astype(np.float64) / divisor, b.astype(np.float64) / divisor
        results.append(a + (b - a) * (rank - low))
    return results


def chunk_steps(domain: Domain, work: Callable[[int, Texels], None]) -> Generator[float, None, None]:
    """Run work(start, texels) for all chunks in a pool of threads; yield the fraction done."""
    with ThreadPoolExecutor(min(_MAX_THREADS, len(available_cores()))) as pool:
        waiting = [pool.submit(work, *chunk) for chunk in chunks(domain)]
        try:
            for number, future in enumerate(waiting, 1):
                future.result()
                yield number / len(waiting)
        finally:  # where it is closed before the end
            pool.shutdown(cancel_futures=True)


def chunks(domain: Domain) -> Iterator[tuple[int, Texels]]:
    """Yield (start, (rows, columns)) of the solvable texels, row by row; each chunk holds about _CHUNK samples.

    start: number of the chunk's first texel among the solvable ones.
    """
    texels = np.flatnonzero(domain.solvable)
    size = max(1, _CHUNK // max(domain.observations, 1))
    for start in range(0, len(texels), size):
        yield start, np.divmod(texels[start : start + size], domain.shape[1])
