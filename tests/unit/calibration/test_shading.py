"""Lights by shading, against reliefs whose photographs are computed in float64."""

import warnings

import numpy as np
import pytest

from irpso_addon.calibration.shading.ambiguity import bas_relief, even_relief, integrable, outward_cosine, rotation
from irpso_addon.calibration.shading.estimate import shading_normals, shading_steps
from irpso_addon.calibration.shading.factors import factored, scaled_normals, usable_samples
from irpso_addon.core.errors import InputError
from irpso_addon.core.steps import run_steps
from tests.builders.relief import SIDE, ball, lamps, relief, unit

RNG = np.random.default_rng(4)


def angles(a, b):
    return np.degrees(np.arccos(np.clip((unit(a) * unit(b)).sum(axis=-1), -1, 1)))


def photographs(normals, directions, strengths, mask, gloss=0.0):
    """Return radiance (K, P), with attached shadow, texture, noise and highlights of Blinn and Phong."""
    n = normals[mask]
    albedo = 0.3 + 0.5 * np.random.default_rng(1).random((SIDE, SIDE))[mask]
    cosine = np.maximum(directions @ n.T, 0)
    shine = np.maximum(unit(directions + (0, 0, 1)) @ n.T, 0) ** 60
    values = strengths[:, None] * (albedo * cosine + gloss * shine * (cosine > 0))
    return np.maximum(values + 0.002 * np.random.default_rng(2).standard_normal(values.shape), 0)


def every(values):
    return np.ones_like(values)


@pytest.mark.parametrize("gloss", [0.0, 0.5])
def test_lights_are_found_up_to_a_matrix(gloss):
    (directions, strengths), mask = lamps(30), np.ones((SIDE, SIDE), bool)
    values = photographs(relief(), directions, strengths, mask, gloss)
    scaled, usable = usable_samples(values, every(values))
    lights = run_steps(factored(scaled, usable, np.arange(values.shape[1]), np.random.default_rng(0)))
    true = directions * strengths[:, None]
    matrix = np.linalg.lstsq(lights, true, rcond=None)[0]
    assert angles(lights @ matrix, true).mean() < 0.5
    normals, _ = scaled_normals(scaled, usable, lights)
    assert np.median(angles(normals @ np.linalg.inv(matrix).T, relief()[mask])) < 0.5


def test_pixels_without_a_sample_are_unusable_without_a_warning_of_numpy():
    values, weight = np.full((4, 2), 0.5), np.array([[1, 0]] * 4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scaled, usable = usable_samples(values, weight)
        _, nothing = usable_samples(values, 0 * weight)
    assert usable[:, 0].all() and not usable[:, 1].any() and np.isfinite(scaled).all() and not nothing.any()


def test_what_is_integrable_is_a_surface_up_to_a_bas_relief():
    normals, mask = relief(), np.ones((SIDE, SIDE), bool)
    mixed = normals[mask] * (0.3 + RNG.random((mask.sum(), 1))) @ RNG.standard_normal((3, 3))
    matrix, clear = integrable(mixed, np.ones(len(mixed), bool), mask)
    found = unit(mixed @ matrix)
    # n = f @ H: of H only the diagonal and its last row may differ from 0, and the first two entries are equal.
    h = np.linalg.svd(_equations(found, normals[mask]), full_matrices=False)[2][-1].reshape(3, 3)
    h = h / h[0, 0]
    assert abs(h[1, 1] - 1) < 0.03
    assert np.abs([h[0, 1], h[1, 0], h[0, 2], h[1, 2]]).max() < 0.03
    assert clear > 0.8


def _equations(found, true):
    """Return rows of cross(true, found @ H) = 0 in the nine entries of H."""
    skew = np.zeros((len(true), 3, 3))
    for i, j, k, sign in ((0, 1, 2, -1), (0, 2, 1, 1), (1, 0, 2, 1), (1, 2, 0, -1), (2, 0, 1, -1), (2, 1, 0, 1)):
        skew[:, i, j] = sign * true[:, k]
    return np.einsum("pik,pj->pijk", skew, found).reshape(-1, 9)


@pytest.mark.parametrize("parameters", [(0.3, -0.2, 0.4), (-0.5, 0.1, -0.8)])
def test_even_lamps_tell_the_bas_relief(parameters):
    directions, strengths = lamps(60, uneven=0.05)
    h = bas_relief(np.array(parameters))
    found = even_relief(directions * strengths[:, None] @ h.T)
    assert np.abs(found @ np.linalg.inv(h) / (found @ np.linalg.inv(h))[0, 0] - np.eye(3)).max() < 0.1


@pytest.mark.parametrize("perspective", [None, 90.0])
def test_a_turned_surface_is_turned_back(perspective):
    normals, mask = relief(perspective=perspective), np.ones((SIDE, SIDE), bool)
    turn = np.radians((3.0, -2.0, 5.0))
    matrix = _rotation(turn)
    plane = None
    if perspective:
        plane = np.stack(np.meshgrid(*[(np.arange(SIDE) + 0.5 - SIDE / 2) / perspective] * 2), axis=-1)[mask]
    found = rotation(normals[mask] @ matrix, np.ones(mask.sum(), bool), mask, plane)
    off = angles(np.eye(3) @ matrix @ found, np.eye(3))
    assert off.max() < 0.5
    if perspective:
        assert angles(np.eye(3) @ matrix @ rotation(normals[mask] @ matrix, mask[mask], mask), np.eye(3)).max() > 1


@pytest.mark.parametrize("free", [(0,), (2,), (0, 1), (0, 1, 2)])
def test_a_surface_is_turned_back_only_about_axes_that_other_evidence_leaves_open(free):
    normals, mask, opened = relief(), np.ones((SIDE, SIDE), bool), np.isin(range(3), free)
    deviations = np.where(opened, np.radians(20), np.radians(1e-4))
    whole = np.radians((3.0, -2.0, 5.0))
    for turn in (whole * opened, whole):
        found = rotation(normals[mask] @ _rotation(turn), mask[mask], mask, None, np.diag(deviations**2))
        vector = np.array([found[2, 1] - found[1, 2], found[0, 2] - found[2, 0], found[1, 0] - found[0, 1]]) / 2
        assert np.degrees(np.abs(vector[~opened])).max(initial=0) < 1e-3
        if turn is not whole or opened.all():
            assert angles(_rotation(turn) @ found, np.eye(3)).max() < 0.6


def _rotation(turn):
    result = np.eye(3)
    for axis, angle in enumerate(turn):
        i, j = [k for k in range(3) if k != axis]
        part = np.eye(3)
        part[i, i] = part[j, j] = np.cos(angle)
        part[i, j], part[j, i] = np.sin(angle), -np.sin(angle)
        result = result @ part
    return result


def test_an_outline_tells_a_solid_from_a_hollow():
    normals, mask = ball()
    assert outward_cosine(normals[mask], mask) > 0.9
    assert outward_cosine(normals[mask] * (-1, -1, 1), mask) < -0.9
    everything = np.ones((SIDE, SIDE), bool)
    assert outward_cosine(relief()[everything], everything) == 0


@pytest.mark.parametrize(("shape", "gloss"), [("ball", 0.4), ("relief", 0.0)])
def test_the_lights_of_a_subject_are_found_from_it_alone(shape, gloss):
    normals, mask = ball() if shape == "ball" else (relief(), np.ones((SIDE, SIDE), bool))
    directions, strengths = lamps(40)
    values = photographs(normals, directions, strengths, mask, gloss)
    fractions = []
    steps = shading_steps(values, every(values), mask)
    found = run_steps(steps, fractions.append)
    assert fractions == sorted(fractions)
    assert fractions[0] > 0
    assert fractions[-1] <= 1
    assert found.solid == (shape == "ball")
    turned = found.directions * (
        (1, 1, 1) if found.solid or found.directions[:, 0] @ directions[:, 0] > 0 else (-1, -1, 1)
    )
    # The strengths differ by 15 %, which the bas-relief takes up in part.
    assert angles(turned, directions).mean() < 8
    assert np.std(np.log(found.intensities / strengths)) < 0.09
    assert found.errors.mean() < 10


def test_a_rotation_of_lights_is_told_by_the_surface():
    normals, mask = ball()
    directions, strengths = lamps(40)
    values = photographs(normals, directions, strengths, mask)
    matrix = _rotation(np.radians((2.0, 3.0, -2.0)))
    normals, good = shading_normals(values, every(values), directions * strengths[:, None] @ matrix)
    found = rotation(normals, good, mask)
    assert angles(directions @ matrix @ found, directions).mean() < 0.5


def test_too_few_photographs_and_pixels_are_refused():
    (directions, strengths), mask = lamps(9), np.ones((SIDE, SIDE), bool)
    values = photographs(relief(), directions, strengths, mask)
    with pytest.raises(InputError, match="9 photographs are too few"):
        run_steps(shading_steps(values, every(values), mask))
    (directions, strengths), few = lamps(20), np.zeros((SIDE, SIDE), bool)
    few[:20, :20] = True
    values = photographs(relief(), directions, strengths, few)
    with pytest.raises(InputError, match="only 4.. pixels are lit"):
        run_steps(shading_steps(values, every(values), few))


def test_a_photograph_without_light_is_named():
    (directions, strengths), mask = lamps(20), np.ones((SIDE, SIDE), bool)
    values = photographs(relief(), directions, strengths, mask)
    values[6] = 0
    with pytest.raises(InputError, match="photograph 7 of 20 lights only 0 pixels"):
        run_steps(shading_steps(values, every(values), mask))
    with pytest.raises(InputError, match="'6.jpg' lights only 0 pixels"):
        run_steps(shading_steps(values, every(values), mask, names=[f"{n}.jpg" for n in range(20)]))


def test_a_flat_subject_tells_nothing():
    (directions, strengths), mask = lamps(20), np.ones((SIDE, SIDE), bool)
    values = photographs(np.broadcast_to((0.0, 0.0, 1.0), (SIDE, SIDE, 3)), directions, strengths, mask)
    assert run_steps(shading_steps(values, every(values), mask)).errors.mean() > 40
