"""The covariance of the lights' common rotation, against a Monte Carlo experiment in float64."""

from types import SimpleNamespace

import numpy as np
import pytest

from irpso_addon.solver.lights.fit import _MODEL_ERROR, Moving, _Equations

LIGHTS, CHANNELS, SIGMA, NOISE, SPREADS = 5, 3, 0.05, 0.02, (1.0, 0.3)
DRAWS = 40_000  # a variance is then known to 0.7 %


def lights_of(rng):
    """Return (K, 3) unit directions, their axes (K, 2, 3) across, and (2K, 3) moves along these by rotation angles."""
    directions = rng.normal(size=(LIGHTS, 3)) + (0, 0, 2)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    first = np.cross(directions, (0.3, 0.5, -0.2))
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(directions, first)], axis=1)
    turned = np.cross(np.eye(3)[:, None], directions)  # φ × d for the unit rotations about x, y and z
    return directions, axes, np.einsum("kac,jkc->kaj", axes, turned).reshape(-1, 3)


@pytest.mark.parametrize("texels", [30, 150])
def test_the_covariance_of_a_rotation_is_that_of_a_monte_carlo_experiment(texels):
    rng = np.random.default_rng(8)
    directions, axes, by_angle = lights_of(rng)
    free = len(SPREADS)
    by_move = rng.normal(size=(LIGHTS, texels, CHANNELS, 2)) * 0.02
    by_texel = rng.normal(size=(LIGHTS, texels, CHANNELS, free))
    error = rng.normal(size=(LIGHTS, texels, CHANNELS))
    error *= NOISE / np.sqrt((error**2).mean())  # the noise is estimated from these

    lights, zeros = np.pad(directions, ((0, 0), (0, 1))), np.zeros((LIGHTS, 3))
    moving = Moving(lights, np.pad(axes, ((0, 0), (0, 1), (0, 0))), zeros, SIGMA)
    equations = _Equations(LIGHTS, texels, free, False, moving)
    for k in range(LIGHTS):
        moves = np.pad(by_move[k], ((0, 0), (0, 0), (0, 1)))  # a distant light has no third move
        equations.add(error[k], np.ones_like(error[k]), np.ones_like(error[k]), by_texel[k], moves)
    found = equations.solved([SimpleNamespace(spread=spread) for spread in SPREADS]).rotation

    # The experiment. More than 100 texels add no information: the variance of their noise is larger by as much.
    sd = NOISE * np.sqrt(max(1.0, texels / 100))
    spreads = np.array(SPREADS) * sd / NOISE  # relative to the noise, as before
    design = np.zeros((LIGHTS, texels, CHANNELS, 2 * LIGHTS + texels * free))
    for k in range(LIGHTS):
        design[k, ..., 2 * k : 2 * k + 2] = by_move[k]
        for t in range(texels):
            design[k, t, :, 2 * LIGHTS + t * free :][:, :free] = by_texel[k, t]
    design = design.reshape(-1, design.shape[-1])
    # The prior: σ for moves that differ between lights, √K σ for those of a common rotation.
    common, angles = by_angle @ np.linalg.pinv(by_angle), np.linalg.pinv(by_angle)
    scale = np.sqrt(LIGHTS) * SIGMA * common + SIGMA * (np.eye(2 * LIGHTS) - common)
    prior = np.zeros((design.shape[1],) * 2)
    prior[: 2 * LIGHTS, : 2 * LIGHTS] = np.linalg.inv(scale)
    prior[2 * LIGHTS :, 2 * LIGHTS :] = np.diag(np.tile(1 / spreads, texels))
    estimate = np.linalg.pinv(np.concatenate([design / sd, prior]))[: 2 * LIGHTS, : len(design)] / sd
    total = np.zeros((3, 3))
    for _ in range(40):
        moves = rng.normal(size=(DRAWS // 40, 2 * LIGHTS)) @ scale
        textures = rng.normal(size=(len(moves), texels * free)) * np.tile(spreads, texels)
        seen = np.concatenate([moves, textures], axis=1) @ design.T
        seen += sd * rng.normal(size=seen.shape)
        off = (seen @ estimate.T - moves) @ angles.T
        total += off.T @ off
    expected = _MODEL_ERROR**2 * total / DRAWS
    unit = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(unit, unit), expected / np.outer(unit, unit), atol=0.03)
    assert not np.allclose(
        expected, _MODEL_ERROR**2 * LIGHTS * SIGMA**2 * np.linalg.inv(by_angle.T @ by_angle), rtol=0.3
    )
