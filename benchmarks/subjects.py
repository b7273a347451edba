"""Synthetic captures with known materials, their disturbances as formulas, and the errors of a recovery.

A card of W×H texels before an orthographic camera under K distant lights. All maps are smooth: sums of a few waves with
directions and phases by the seed. The sample of texel x under light k is

    I_k(x) = max(0, V_k(x) R_k(x) + a U_k(x) B[V_k R_k](x) + N(0, σ²))

with R the reflectance model in float64 (benchmarks/peers/models.py) under a light of intensity 1. V is the cast shadow:
at each texel V = 0 for the fraction ``shadow`` of the lights nearest to a random direction of that texel, a connected
patch of lights. B is a Gaussian blur over the card, BLUR of its side wide: the interreflection of a texel's
surroundings, which adds the fraction a of their radiance, smooth over texels. U is 1 under all lights, or under a
connected patch of them, drawn for each texel like its shadow.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.peers.models import geometry_of, radiance
from benchmarks.peers.problem import Problem, angles, problem_of
from irpso_addon.geometry.domain import Domain, domain_of, flat_bake, with_samples
from irpso_addon.reflectance.model import load_model

TWO_LOBES = "cook_torrance_two_lobe"
BLUR = 0.06  # standard deviation of the blur, over the card's side
_LOWEST = 0.3  # z of the lowest light: 73° from the axis
_WAVES = 6  # to a map
_LENGTHS = (0.45, 1.1)  # of the waves, over the card's side
_SLOPE = 0.3  # root mean square of each component of the surface's slope
# Ranges of the maps: lobes of skin (see the model's table), so different that 100 lights separate them in 90 % of the
# texels (see joint.md).
_RANGES = {"r1": (0.09, 0.16), "r2": (0.28, 0.4), "w": (0.3, 0.5), "roughness": (0.2, 0.6), "specular": (0.3, 0.7)}


@dataclass(frozen=True)
class Degradation:
    """noise: σ. shadow: share of a texel's lights. interreflection: a. reach: share of the lights with U = 1."""

    title: str
    noise: float = 0.0
    shadow: float = 0.0
    interreflection: float = 0.0
    reach: float = 1.0


CLEAN = Degradation("clean")
NOISY = Degradation("noise 0.003", noise=0.003)
DIRTY = Degradation("15 % cast shadow, 10 % interreflection, noise 0.003", 0.003, 0.15, 0.1)
SHADOWED = Degradation("15 % cast shadow, noise 0.003", 0.003, 0.15)
PATCHED = Degradation(
    "15 % cast shadow, 30 % interreflection in 10 % of the samples, noise 0.003", 0.003, 0.15, 0.3, 0.1
)
DEGRADATIONS = {"clean": CLEAN, "noisy": NOISY, "dirty": DIRTY, "shadowed": SHADOWED, "patched": PATCHED}


@dataclass(frozen=True)
class Card:
    """A synthetic capture. truth: parameter → (H, W, components) float64. shadowed: (K, H, W) bool, V = 0."""

    domain: Domain
    model: str
    truth: Mapping[str, np.ndarray]
    shadowed: np.ndarray
    degradation: Degradation

    def problem(self, count: int | None = None, seed: int = 0) -> Problem:
        """Return all texels, or a random ``count``, as the peers' problem; a smaller sample is part of a larger one."""
        whole = problem_of(self.domain, self.model, self.truth)
        return whole if count is None or count >= whole.count else whole.subset(sample(whole.count, count, seed))


def sample(count: int, size: int, seed: int = 0) -> np.ndarray:
    """Return ``size`` random indices below ``count``; a smaller sample is the start of a larger one."""
    return np.random.default_rng(seed).permutation(count)[:size]


def spiral_lights(count: int, lowest: float = _LOWEST) -> np.ndarray:
    """Return (K, 3) unit directions on a Fibonacci spiral, even over the sphere above z = ``lowest``."""
    z = 1 - (1 - lowest) * (np.arange(count) + 0.5) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)


def make_card(
    size: int | tuple[int, int],
    lights: int | np.ndarray = 100,
    degradation: Degradation = CLEAN,
    seed: int = 0,
    model: str = TWO_LOBES,
) -> Card:
    """Return a card of ``size``² or (H, W) texels under a number of spiral lights, or under directions (K, 3)."""
    shape = (size, size) if isinstance(size, int) else size
    directions = spiral_lights(lights) if isinstance(lights, int) else lights
    rng = np.random.default_rng(seed)
    truth = _truth(shape, model, rng)
    domain = _domain(shape, directions)
    clean = _render(domain, model, truth)
    shadowed = _patch(shape, directions, degradation.shadow, rng)
    direct = seen = np.where(shadowed[..., None], 0, clean)
    if degradation.interreflection:
        reached = _patch(shape, directions, degradation.reach, rng) if degradation.reach < 1 else np.ones_like(shadowed)
        seen = direct + degradation.interreflection * reached[..., None] * _blur(direct, BLUR * max(shape))
    seen = np.maximum(seen + degradation.noise * rng.normal(size=seen.shape), 0)
    stack = np.concatenate([seen, np.ones((*seen.shape[:3], 1))], axis=-1).astype(np.float32)
    return Card(with_samples(domain, stack), model, truth, shadowed, degradation)


def errors_of(model: str, values: Mapping[str, np.ndarray], truth: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return parameter → (T,) errors of values (…, components): the normal's in degrees, others in % of the range.

    Of several components the worst counts. Parameters: those in values and truth.
    """
    errors = {}
    for p in load_model(model).parameters:
        if p.name not in values or p.name not in truth:
            continue
        a, b = (np.asarray(v[p.name], np.float64).reshape(-1, p.components) for v in (values, truth))
        width = p.range[1] - p.range[0] if not p.is_normal else 1.0
        errors[p.name] = angles(a, b) if p.is_normal else 100 * np.abs(a - b).max(axis=-1) / width
    return errors


def unit_of(parameter: str) -> str:
    """Return the unit of ``errors_of``."""
    return "°" if parameter == "normal" else "%"


def _domain(shape: tuple[int, int], directions: np.ndarray) -> Domain:
    """Return a flat card without images."""
    rows, columns = shape
    count = len(directions)
    y, x = np.mgrid[:rows, :columns].astype(np.float32) / max(shape)
    position = np.stack([x, y, np.zeros_like(x)], axis=-1)
    bake = flat_bake(position, np.ones(shape, bool), position[..., :2])
    lights = np.concatenate([directions, np.zeros((count, 1))], axis=1).astype(np.float32)
    views = np.broadcast_to(np.float32([0, 0, 1, 0]), (count, 4))
    empty = np.broadcast_to(np.float32(1), (count, *shape, 4))
    return domain_of(bake, empty, lights, np.ones((count, 3), np.float32), views)


def _render(domain: Domain, model: str, truth: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return (K, H, W, 3) float64 radiance under lights of intensity 1, with the domain's float32 directions."""
    problem = problem_of(domain, model)
    flat = {name: value.reshape(-1, value.shape[-1]) for name, value in truth.items()}
    diffuse, specular = radiance(np, model, flat, geometry_of(problem))
    return (diffuse[..., None] * flat["base_color"] + specular[..., None]).reshape(-1, *domain.shape, 3)


def _truth(shape: tuple[int, int], model: str, rng: np.random.Generator) -> dict[str, np.ndarray]:
    values = {}
    for p in load_model(model).parameters:
        if p.is_normal:
            slopes = [_SLOPE * _waves(shape, rng) for _ in range(2)]
            normal = np.stack([*slopes, np.ones(shape)], axis=-1)
            values[p.name] = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        else:
            low, high = _RANGES.get(p.name, (0.15, 0.85))
            shades = [_waves(shape, rng) for _ in range(p.components)]
            values[p.name] = low + (high - low) * (0.5 + 0.5 * np.tanh(np.stack(shades, axis=-1)))
    return values


def _waves(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Return (H, W), a sum of waves of about unit variance."""
    y, x = np.mgrid[: shape[0], : shape[1]] / max(shape)
    total = np.zeros(shape)
    for _ in range(_WAVES):
        turn, phase = rng.uniform(0, 2 * np.pi, 2)
        number = 2 * np.pi / rng.uniform(*_LENGTHS)
        total += np.cos(number * (x * np.cos(turn) + y * np.sin(turn)) + phase)
    return total * np.sqrt(2 / _WAVES)


def _patch(shape: tuple[int, int], directions: np.ndarray, part: float, rng: np.random.Generator) -> np.ndarray:
    """Return (K, H, W) bool: at each texel the fraction ``part`` of the lights nearest to a random one of them."""
    count = round(part * len(directions))
    if not count:
        return np.zeros((len(directions), *shape), bool)
    toward = directions[rng.integers(len(directions), size=shape)]
    near = np.einsum("kc,hwc->khw", directions, toward)
    order = np.argsort(-near, axis=0, kind="stable")
    patch = np.zeros(near.shape, bool)
    np.put_along_axis(patch, order[:count], True, axis=0)
    return patch


def _blur(images: np.ndarray, deviation: float) -> np.ndarray:
    """Return images (K, H, W, 3) blurred by a Gaussian over H and W, mirrored at the borders."""
    from scipy.ndimage import gaussian_filter1d

    across = gaussian_filter1d(images, deviation, axis=1, mode="reflect")
    return gaussian_filter1d(across, deviation, axis=2, mode="reflect")
