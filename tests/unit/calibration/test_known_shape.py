"""Lamps over a known surface, against shading that is computed in float64."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.calibration.shading.flat import even_steps, falloff_steps
from irpso_addon.calibration.shading.known import GROUPS, Samples, cells, fit_steps, free_normals, linear_lamps, nearer
from irpso_addon.calibration.shading.lamps import Lamps
from irpso_addon.core.steps import run_steps
from tests.builders.command_line import angle
from tests.builders.relief import lamps, unit

COUNT, TEXELS = 8, 700
CENTRE = np.zeros(3)


def _ellipsoid():
    rng = np.random.default_rng(1)
    axes = np.array([1.0, 0.8, 0.6])
    points = unit(rng.standard_normal((TEXELS, 3))) * axes
    points[:, 2] = np.abs(points[:, 2])
    return points, unit(points / axes**2)


def _card():
    points = np.random.default_rng(1).uniform(-0.7, 0.7, (TEXELS, 3)) * (1, 1, 0)
    return points, np.broadcast_to((0.0, 0.0, 1.0), points.shape)


def _photographed(points, normals, far, gloss=0.0, noise=0.002):
    """Return samples under COUNT lamps at ``far`` (K,), infinite for distant ones; their directions, strengths."""
    directions, strengths = lamps(COUNT, uneven=0.3)
    rng = np.random.default_rng(2)
    albedo = rng.uniform(0.1, 0.8, len(points))
    values = []
    for direction, distance, strength in zip(directions, far, strengths, strict=True):
        distant = not np.isfinite(distance)
        toward = np.broadcast_to(direction, points.shape) if distant else direction * distance - points
        length = 1.0 if distant else np.linalg.norm(toward, axis=-1) / distance
        cosine = np.maximum((unit(toward) * normals).sum(axis=-1), 0)
        half = unit(unit(toward) + (0, 0, 1))
        shine = gloss * np.maximum((half * normals).sum(axis=-1), 0) ** 400 * (cosine > 0)
        values.append(strength / length**2 * (albedo * cosine + shine))
    values = np.maximum(np.array(values) + noise * rng.standard_normal((COUNT, len(points))), 0)
    samples = Samples(values, np.ones_like(values), points, normals, cells(points, 0))
    return samples, directions, strengths


def _off(found, directions, strengths):
    """Return the largest angle, and the deviation of the logarithm of the strengths."""
    return angle(found.directions, directions).max(), np.std(np.log(found.strengths / strengths))


def test_shading_is_irradiance_by_the_inverse_square():
    points, normals = _ellipsoid()
    lamp = Lamps(CENTRE, 1.0, np.array([[0.0, 0.6, 0.8]]), np.array([0.4]), np.array([2.0]))
    (light,) = lamp.lights(near=True)
    toward = np.array(light.vector) - points
    expected = light.intensity[0] * (toward * normals).sum(axis=-1) / np.linalg.norm(toward, axis=-1) ** 3
    np.testing.assert_allclose(lamp.shading(points, normals)[0][0], expected, rtol=1e-12)


@pytest.mark.parametrize("inverse", [0.0, 0.3])
def test_derivatives_are_those_of_the_shading(inverse):
    points, normals = _ellipsoid()
    directions, strengths = lamps(COUNT)
    base = Lamps(CENTRE, 1.0, directions, np.full(COUNT, inverse), strengths)
    slopes = base.derivatives(points, normals)
    for number in range(4):
        steps = np.zeros((COUNT, 4))
        steps[0, number] = 1e-5
        up, down = (base.moved(s).shading(points, normals)[0] for s in (steps, -steps))
        change = (up - down)[0] / 2e-5
        if number == 3:  # the common scale stays
            change = change * COUNT / (COUNT - 1)
        np.testing.assert_allclose(slopes[0, :, number], change, atol=1e-6)


@pytest.mark.parametrize("gloss", [0.0, 0.5])
def test_distant_lamps_over_a_known_surface_are_found(gloss):
    samples, directions, strengths = _photographed(*_ellipsoid(), np.full(COUNT, np.inf), gloss)
    start, determined = linear_lamps(samples, CENTRE, 1.0)
    far, near = (run_steps(fit_steps(samples, start, near)) for near in (False, True))
    off, uneven = _off(far.lamps, directions, strengths)
    assert off < 1.0
    assert uneven < 0.02
    assert determined > 0.8
    assert not nearer(near, far)
    assert np.nanmedian(free_normals(samples, far)) < 3


def test_near_lamps_over_a_known_surface_are_found():
    away = np.linspace(2.5, 5.0, COUNT)
    samples, directions, strengths = _photographed(*_ellipsoid(), away, 0.3)
    start, _ = linear_lamps(samples, CENTRE, 1.0)
    far, near = (run_steps(fit_steps(samples, start, kind)) for kind in (False, True))
    assert nearer(near, far)
    off, uneven = _off(near.lamps, directions, strengths)
    assert off < 1.0
    assert uneven < 0.02
    np.testing.assert_allclose(1 / near.lamps.inverses, away, rtol=0.03)


@pytest.mark.parametrize("shape", ["plane", "cylinder", "three faces"])
def test_surfaces_that_do_not_determine_distant_lamps_are_told(shape):
    points, normals = _card()
    if shape == "cylinder":
        normals = unit(points * (1, 0, 0) + (0, 0, 0.6))
    if shape == "three faces":
        faces = unit(np.array([(0.5, 0.2, 1.0), (-0.5, 0.2, 1.0), (0.0, -0.5, 1.0)]))
        normals = faces[np.arange(TEXELS) % 3]
    samples, *_ = _photographed(points, normals, np.full(COUNT, np.inf))
    assert linear_lamps(samples, CENTRE, 1.0)[1] < 0.2


def test_normals_of_another_surface_contradict_the_photographs():
    points, normals = _ellipsoid()
    samples, *_ = _photographed(points, normals, np.full(COUNT, np.inf))
    mixed = replace(samples, normals=normals[np.random.default_rng(3).permutation(TEXELS)])
    found = run_steps(fit_steps(mixed, linear_lamps(mixed, CENTRE, 1.0)[0], False))
    assert np.nanmedian(free_normals(mixed, found)) > 18


def test_near_lamps_are_found_by_their_fall_off_over_a_card():
    away = np.linspace(1.5, 3.0, COUNT)
    points, normals = _card()
    samples, directions, strengths = _photographed(points, normals, away, 0.3)
    found = run_steps(falloff_steps(samples, normals, CENTRE, 1.0))
    off, uneven = _off(found.lamps, directions, strengths)
    assert off < 1.5
    assert uneven < 0.05
    np.testing.assert_allclose(1 / found.lamps.inverses, away, rtol=0.1)
    assert nearer(found, run_steps(even_steps(samples, found.lamps)))


def test_a_card_does_not_show_distant_lamps():
    points, normals = _card()
    samples, *_ = _photographed(points, normals, np.full(COUNT, np.inf), 0.3)
    found = run_steps(falloff_steps(samples, normals, CENTRE, 1.0))
    assert not nearer(found, run_steps(even_steps(samples, found.lamps)))


def test_groups_are_parts_of_space():
    points, _ = _ellipsoid()
    groups = cells(points, 0)
    assert (groups.min(), groups.max()) == (0, GROUPS - 1)
    assert (cells(points + 3, 0) == groups).all()
