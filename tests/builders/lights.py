"""Reliefs in float64 numpy under uneven lights, with shadow and noise, for the tests of lights."""

from __future__ import annotations

import numpy as np

from irpso_addon.geometry.domain import Domain, with_samples
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.domains import make_domain, unit
from tests.oracles import confidence as confidence_oracle


def relief(height: int, width: int, rng: np.random.Generator, slope: float = 0.5) -> np.ndarray:
    """Return (H, W, 3) normals of a sum of waves."""
    y, x = np.mgrid[:height, :width] / max(height, width)
    tilt = np.zeros((height, width, 2))
    for _ in range(4):
        along = unit(rng.normal(size=2)) * rng.uniform(0.7, 2)
        tilt += along * np.cos(2 * np.pi * (x * along[0] + y * along[1]) + rng.uniform(0, 6))[..., None]
    return unit(np.concatenate([slope * tilt / 2, np.ones((height, width, 1))], axis=-1))


def subject(
    model: str, observations: int, shape=(24, 24), rng_seed=5, slope=0.5, **options
) -> tuple[Domain, dict[str, np.ndarray]]:
    """Return (domain, truth) of a relief with patches of colour, rendered by the oracle's model.

    options: of make_domain.
    """
    rng = np.random.default_rng(rng_seed)
    patches = tuple(np.mgrid[: shape[0], : shape[1]] // 6 % 9)
    truth = {
        "normal": relief(*shape, rng, slope),
        "base_color": rng.uniform(0.15, 0.85, (9, 9, 3))[patches],
        "roughness": rng.uniform(0.25, 0.7, (9, 9, 1))[patches],
        "specular": np.full((*shape, 1), 0.5),
    }
    made = make_domain(*shape, observations=observations, holes=False, rng_seed=rng_seed, **options)
    stack = np.ones((observations, *shape, 4))
    stack[..., :3] = confidence_oracle.radiance(made, model, truth)
    return with_samples(made, stack.astype(np.float32)), truth


def gains(observations: int, rng: np.random.Generator) -> np.ndarray:
    """Return (K, 3) factors from 0.3 to 3, with a tint per light."""
    strength = np.exp(rng.uniform(np.log(0.3), np.log(3), (observations, 1)))
    return strength * rng.uniform(0.9, 1.1, (observations, 3))


def photographed(domain: Domain, factors: np.ndarray, rng: np.random.Generator, shadow=0.15, noise=0.02) -> Domain:
    """Return the domain with its images times ``factors`` (K, 3), a share of the samples in shadow, and noise."""
    stack = domain.stack.values.astype(np.float64)
    radiance = stack[..., :3] * factors[:, None, None]
    dark = rng.random(stack.shape[:3]) < shadow
    radiance[dark] *= rng.uniform(0, 0.2, (dark.sum(), 1))
    radiance *= 1 + noise * rng.normal(size=radiance.shape)
    stack[..., :3] = np.maximum(radiance, 0)
    return with_samples(domain, stack.astype(np.float32))


def off(estimated: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return (K, 3) relative errors of factors, up to a common factor of each channel."""
    logs = np.log(estimated) - np.log(true)
    return np.abs(np.expm1(logs - logs.mean(axis=0)))


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the angles (…), in degrees, between unit vectors (…, 3)."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def photographed_card(name, truth, rng, lights=40):
    """Return the domain of a card of material ``truth``, rendered by an oracle's model, with shadow and noise."""
    shape = truth["normal"].shape[:2]
    made = make_domain(*shape, observations=lights, holes=False, rng_seed=5)
    stack = np.ones((lights, *shape, 4))
    stack[..., :3] = confidence_oracle.radiance(made, name, truth)
    return photographed(with_samples(made, stack.astype(np.float32)), np.ones((lights, 3)), rng, shadow=0.05)


def recovered(domain, model):
    """Return the values of a recovery by the preset standard without a spatial prior."""
    with Recovery(domain, model, load_schedule("standard").replaced(prior_rounds=0, surface_rounds=0), 1) as recovery:
        recovery.step()
        return recovery.maps(confidence=False).values
