"""Before the search: each texel's scale, the weights of its samples, and a Lambertian first guess.

A texel's numbers depend on its own samples alone, to the last bit, however a domain is cut: so sums are added up light
by light, never by a library that groups them by the size of an array.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from ...core.steps import at_once, available_cores, run_steps
from ...geometry.domain import Domain
from ...reflectance.model import ReflectanceModel
from ..settings.groups import Fitness
from ..settings.schedule import Schedule
from .packing import Packing
from .textures import domain_arrays

_LIT_PERCENTILES = (20.0, 75.0)  # of the lit samples: below lies shadow's edge, above lies the highlight
_CHUNK = 1 << 16  # samples at a time: what is made of them, about 80 bytes a sample, stays in a cache
_EXPONENTS, _LEAST_EXPONENT = 280, -149  # of float32 numbers, with room
_MOST_THREADS = 8  # numpy lets go of the interpreter meanwhile; more would wait for memory

Texels = tuple[np.ndarray, np.ndarray]  # rows, columns
Report = Callable[[float], object]  # receives the fraction that is done, 0 to 1


@dataclass(frozen=True)
class Prepared:
    """What is found before the search. scale: (H, W) of each texel. guess: parameter name → (H, W, components).

    brightness: mean irradiance/π of the lights at the texels. A scale is radiance over irradiance, errors are
    radiances: the unit and the distance of the lights must not matter. packing, stack, arrays: what goes to the GPU as
    it goes there, (K, h, w, 4) samples without shadow and what state.domain_arrays gives; None where a recovery is to
    find it itself.
    """

    scale: np.ndarray
    guess: dict[str, np.ndarray]
    brightness: float
    packing: Packing | None = None
    stack: np.ndarray | None = None
    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    def part(self, rows: slice, columns: slice) -> Prepared:
        """Return it for a part of the domain: the very numbers of the whole, which a fit of the part may round off."""
        return Prepared(
            self.scale[rows, columns],
            {name: value[rows, columns] for name, value in self.guess.items()},
            self.brightness,
        )

    def packed(self, domain: Domain, schedule: Schedule, report: Report = lambda part: None) -> Prepared:
        """Return it with what goes to the GPU. report: as for ``prepare``."""
        return run_steps(self.packing_steps(domain, schedule), report)

    def packing_steps(self, domain: Domain, schedule: Schedule) -> Generator[float, None, Prepared]:
        """Return what ``packed`` does; yield the part that is done."""
        if self.stack is not None:
            return self
        packing = Packing(domain.solvable, domain.seams)
        stack = np.zeros((domain.observations, packing.height * packing.width, 4), np.float32)

        def work(start: int, texels: Texels) -> None:
            part = stack[:, start : start + len(texels[0])]
            part[:] = domain.stack.texels(*texels)
            if not schedule.fitness.bounds:
                part[..., 3] = np.maximum(part[..., 3], 0)
            weight = part[..., 3].copy()
            _drop_shadow(part, domain, texels, self.scale[texels], schedule.fitness)
            # As shaders/common/observation.glsl marks them.
            part[..., 3] -= np.where(part[..., 3] == 0, np.clip(weight, 0, 1) / 2, 0)

        yield from chunk_steps(domain, work)
        stack = stack.reshape(-1, packing.height, packing.width, 4)
        arrays = domain_arrays(domain, packing, packing.pack(self.scale))
        return Prepared(self.scale, self.guess, self.brightness, packing, stack, arrays)


def prepare(
    domain: Domain, model: ReflectanceModel, schedule: Schedule, pack: bool = True, report: Report = lambda part: None
) -> Prepared:
    """Return each texel's scale, its first guess (defaults, or a Lambertian fit where seeds ask for it), and the stack.

    Nothing but numpy: it may run in a thread beside a window. pack: whether to find what goes to the GPU, too. report:
    is called now and then with how much of it is done, 0 to 1.
    """
    seeded = schedule.swarm.seed == "lambert"
    count = 1 + seeded + pack
    sweeps = (lambda part, k=k: report((k + part) / count) for k in range(count))
    guess = {
        p.name: np.broadcast_to(np.asarray(p.default, np.float32), (*domain.shape, p.components))
        for p in model.parameters
    }
    if seeded:
        normal, albedo = run_steps(lambert_steps(domain), next(sweeps))
        for p in model.parameters:
            if p.is_normal:
                guess[p.name] = normal
            elif p.is_albedo:
                guess[p.name] = np.clip(albedo, *p.range)
    scale = run_steps(scale_steps(domain, schedule.fitness.percentile), next(sweeps))
    prepared = Prepared(scale, guess, brightness(domain))
    return prepared.packed(domain, schedule, next(sweeps)) if pack else prepared


def brightness(domain: Domain) -> float:
    """Return the mean irradiance/π of the lights at the texels, over lights, texels and channels."""
    return brightness_of(domain, *brightness_sums(domain, domain.solvable))


def brightness_sums(domain: Domain, counted: np.ndarray) -> tuple[np.ndarray, int]:
    """Return what ``brightness_of`` needs of some solvable texels, (H, W) bool, and how many they are.

    The first is (280,) int64: the texels' irradiances in float32, taken apart into whole numbers by their exponents.
    Such sums are exact, so that those of parts add up to that of the whole, in any order.
    """
    sums, count = np.zeros(_EXPONENTS, np.int64), 0
    if not domain.lights[:, 3].any():
        return sums, int(np.count_nonzero(counted))
    for _, texels in chunks(domain):
        mean = _irradiance(domain, texels).mean(axis=-1)
        values = (over_lights(mean) / len(mean)).astype(np.float32)[counted[texels]]
        mantissa, exponent = np.frexp(values)
        np.add.at(sums, exponent - _LEAST_EXPONENT, (mantissa * 2.0**24).astype(np.int64))
        count += len(values)
    return sums, count


def brightness_of(domain: Domain, sums: np.ndarray, count: int) -> float:
    """Return the brightness that goes with the sums of all of a domain's texels."""
    if not domain.lights[:, 3].any():
        return float(domain.intensities.mean())
    total = sum(int(part) << place for place, part in enumerate(sums.tolist()))
    return float(Fraction(total, max(1, count)) * Fraction(2) ** (_LEAST_EXPONENT - 24))


def scale_steps(domain: Domain, percentile: float) -> Generator[float, None, np.ndarray]:
    """Return (H, W) float32: the percentile of each texel's samples over their irradiance/π; 1 if there are none.

    Yields the part that is done.
    """
    scale = np.ones(domain.shape, np.float32)

    def work(start: int, texels: Texels) -> None:
        samples = domain.stack.texels(*texels)
        grey = grey_of(samples) / _irradiance(domain, texels).mean(axis=-1)
        with np.errstate(all="ignore"):
            (found,) = percentiles(np.where(samples[..., 3] > 0, grey, np.nan), [percentile])
            scale[texels] = np.where(found > 0, found, 1.0)

    yield from chunk_steps(domain, work)
    return scale


texel_scale = at_once("texel_scale", scale_steps)


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
    brightness = grey_of(stack)
    for layer in np.flatnonzero(lights[:, 3] > 0):
        brightness[layer] *= ((lights[layer, :3] - position) ** 2).sum(axis=-1)
    brightness /= intensities.mean(axis=-1)[:, None, None]
    stack[..., 3] *= brightness >= fitness.shadow * scale


def lambert_steps(domain: Domain) -> Generator[float, None, tuple[np.ndarray, np.ndarray]]:
    """Return normals (H, W, 3), in the frames that are searched, and albedos (H, W, 3) of a trimmed Lambertian fit.

    Photometric stereo (Woodham 1980) by least squares over those of a texel's lit samples that lie between the 20th
    and the 75th percentile. Texels that leave fewer than three samples get the frame's own normal.

    Yields the part that is done.
    """
    normal = np.zeros((*domain.shape, 3), np.float32)
    normal[..., 2] = 1
    albedo = np.zeros((*domain.shape, 3), np.float32)

    def work(start: int, texels: Texels) -> None:
        normal[texels], albedo[texels] = _lambert_fit(domain, texels, start)

    yield from chunk_steps(domain, work)
    return normal, albedo


lambert_seed = at_once("lambert_seed", lambert_steps)


def light_vectors(domain: Domain, texels: Texels) -> tuple[np.ndarray, np.ndarray]:
    """Return, for T texels, (K, T, 3) unit vectors to the light in each texel's own frame, and its irradiance/π.

    Where they are the same at every texel, on a card under distant lights, T is 1.
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
    seen = samples[..., 3] > 0
    shades = [_shade(samples, seen, channel, irradiance[..., channel]) for channel in range(3)]
    sums, channels = (shades[0] + shades[1]) + shades[2], lights.sum(axis=-1).astype(np.float64)
    grey = sums.astype(np.float64)
    with np.errstate(all="ignore"):
        grey /= channels
        lit = grey > 0
        # Single precision sorts faster, and in the same order where all lights have as many channels.
        single = (channels == channels.flat[0]).all()
        values = np.where(lit, sums if single else grey, np.nan)
        low, high = percentiles(values, _LIT_PERCENTILES, channels.flat[0] if single else 1)
        kept = (grey >= low) & (grey <= high) & lit
    count = kept.sum(axis=0)
    if (count < 3).any():
        kept = np.where(count >= 3, kept, lit)
        count = kept.sum(axis=0)
    kept = kept.astype(np.float64)
    gram, right = normal_equations(vectors, kept, grey)
    # 1e-9 of the trace: an answer for lights in a plane too, where it is the shortest of many.
    gram += 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-30 * np.eye(3)
    scaled = np.linalg.solve(gram, right[..., None])[..., 0]
    scaled[:, 2] = np.maximum(scaled[:, 2], 0)
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    usable = (count >= 3)[:, None] & (length > 1e-8)
    normal = np.where(usable, scaled / np.maximum(length, 1e-8), (0.0, 0.0, 1.0))
    cosine = np.maximum(dot(vectors, normal), 0)
    cosine *= kept
    albedo, squares = np.empty(normal.shape, np.float32), None
    for channel, shade in enumerate(shades):
        every = lights[..., channel].all()
        shading = cosine if every else cosine * lights[..., channel]
        if squares is None or not every:
            squares = over_lights(shading**2)
        albedo[:, channel] = over_lights(shading * shade) / np.maximum(squares, 1e-8)
        squares = squares if every else None
    return normal.astype(np.float32), albedo


def _shade(samples: np.ndarray, seen: np.ndarray, channel: int, irradiance: np.ndarray) -> np.ndarray:
    """(K, T) one channel over the irradiance/π, 0 where a sample is not seen or its light lacks the channel."""
    # What weighs nothing may be anything, and 0 · NaN is NaN.
    radiance = samples[..., channel] if seen.all() else np.where(seen, samples[..., channel], 0)
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
    """Percentiles over axis 0 of what is not NaN, of the values over a divisor; NaN for empty columns."""
    ordered = np.array(values.T, order="C")  # a copy, even of what lies so: numbers side by side sort faster
    ordered.sort(axis=1)  # NaN last
    last = np.maximum(values.shape[0] - np.isnan(values).sum(axis=0) - 1, 0)
    rows, found = np.arange(values.shape[1]), []
    for percentile in percentiles:
        rank = last * percentile / 100
        low = np.floor(rank).astype(int)
        a, b = ordered[rows, low], ordered[rows, np.minimum(low + 1, last)]
        if divisor != 1:
            a, b = a.astype(np.float64) / divisor, b.astype(np.float64) / divisor
        found.append(a + (b - a) * (rank - low))
    return found


def chunk_steps(domain: Domain, work: Callable[[int, Texels], None]) -> Generator[float, None, None]:
    """Do work(start, texels) for all chunks, some at a time beside the caller; yield the part that is done."""
    with ThreadPoolExecutor(min(_MOST_THREADS, len(available_cores()))) as pool:
        waiting = [pool.submit(work, *chunk) for chunk in chunks(domain)]
        for number, done in enumerate(waiting, 1):
            done.result()
            yield number / len(waiting)


def chunks(domain: Domain) -> Iterator[tuple[int, Texels]]:
    """Yield rows and columns of the solvable texels, row by row, as many at a time as hold _CHUNK samples.

    Before them the number of the first one among the solvable.
    """
    texels = np.flatnonzero(domain.solvable)
    size = max(1, _CHUNK // max(domain.observations, 1))
    for start in range(0, len(texels), size):
        yield start, np.divmod(texels[start : start + size], domain.shape[1])
