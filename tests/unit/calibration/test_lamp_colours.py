"""Colours of lamps over matt surfaces of unknown colour, against radiances that are computed in float64."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.calibration.shading.lamp_colours import lamp_colours, whitened
from irpso_addon.capture.camera import Camera
from irpso_addon.capture.types import Light
from irpso_addon.core.steps import run_steps
from irpso_addon.pipeline.flat_card import flat_card_steps
from tests.builders.command_line import smooth_maps
from tests.builders.near_card import DISTANCE, LAMPS, near_card
from tests.oracles import reflectance as oracles

COUNT, TEXELS = 9, 600
UNLIT = Light((0.0, 0.0, 1.0))


def colours_of_lamps(spread, count=COUNT):
    """Return (count, 3) colours of geometric mean 1, over channels and over lamps."""
    logarithms = spread * np.random.default_rng(5).standard_normal((count, 3))
    logarithms -= logarithms.mean(axis=1, keepdims=True)
    return np.exp(logarithms - logarithms.mean(axis=0))


def scene(colours, noise=0.003, base=1.0):
    """Return radiances (K, T, 3) of texels of many colours, a tenth of them in highlights and another in shadow."""
    rng = np.random.default_rng(6)
    base, shading = base * rng.uniform(0.05, 0.9, (TEXELS, 3)), rng.uniform(0.2, 1, (COUNT, TEXELS, 1))
    fate = rng.uniform(size=(COUNT, TEXELS, 1))
    shading, shine = np.where(fate < 0.1, 0, shading), np.where(fate > 0.9, rng.exponential(1, fate.shape), 0)
    radiance = colours[:, None] * (base * shading + shine) + 0.01 * base
    return radiance + noise * rng.standard_normal(radiance.shape)


@pytest.mark.parametrize(("spread", "noise", "tolerance"), [(0.2, 0.003, 0.02), (0.6, 0.003, 0.02), (0.2, 0.02, 0.05)])
def test_colours_are_found_whatever_texels_and_shading(spread, noise, tolerance):
    truth = colours_of_lamps(spread)
    radiance = scene(truth, noise)
    np.testing.assert_allclose(lamp_colours(radiance, np.ones((COUNT, TEXELS))), truth, rtol=tolerance)


def test_samples_without_weight_do_not_count():
    truth = colours_of_lamps(0.4)
    radiance, weight = scene(truth), np.ones((COUNT, TEXELS))
    radiance[:, ::3], weight[:, ::3] = 0, 0
    values, colours = whitened(radiance, weight)
    np.testing.assert_allclose(colours, truth, rtol=0.02)
    np.testing.assert_allclose(values, (radiance / colours[:, None]).mean(axis=-1))
    assert (values[:, ::3] == 0).all()


def test_lamps_of_one_colour_are_white_and_so_is_a_dark_photograph():
    tint = np.array([1.3, 1.0, 0.7])  # of all lamps: not distinct from the texels' colour
    np.testing.assert_array_equal(lamp_colours(scene(np.tile(tint, (COUNT, 1))), np.ones((COUNT, TEXELS))), 1)
    dark = scene(colours_of_lamps(0.4))
    dark[3] = 0
    found = lamp_colours(dark, np.ones((COUNT, TEXELS)))
    assert np.isfinite(found).all() and np.ptp(np.log(np.delete(found, 3, axis=0))) > 0.5


@pytest.mark.parametrize("blue", [0.0, 0.002])
def test_a_channel_that_the_texels_hardly_reflect_shows_no_colour(blue):
    truth, white = colours_of_lamps(0.4), np.ones((COUNT, 3))
    weight, base = np.ones((COUNT, TEXELS)), np.array([1.0, 1.0, blue])
    np.testing.assert_array_equal(lamp_colours(scene(white, base=base), weight), 1)
    found = lamp_colours(scene(truth, base=base), weight)
    np.testing.assert_allclose(found[:, 0] / found[:, 1], truth[:, 0] / truth[:, 1], rtol=0.02)
    np.testing.assert_allclose(found[:, 2], np.sqrt(found[:, 0] * found[:, 1]))


@pytest.mark.parametrize(("tint", "found"), [(0.0, False), (0.4, True)])
def test_semi_gloss_of_a_saturated_card_is_no_colour_of_its_lamps(tint, found):
    """Highlights add white to a red card, more under some lamps: that scatters over the texels, colours do not."""
    rng, shape = np.random.default_rng(8), (20, 30)
    base = np.clip(rng.uniform(0.3, 1, (*shape, 1)) * (0.6, 0.05, 0.04), 0, 1)
    values = {"normal": np.broadcast_to((0.0, 0.0, 1.0), (*shape, 3)), "base_color": base,
              "roughness": np.full(shape, 0.6), "specular": np.full(shape, 0.5)}  # fmt: skip
    points = replace(Camera.from_fov(*shape[::-1], 30.0), matrix=np.eye(4)).points(DISTANCE)
    radiance = []
    for colour, lamp in zip(colours_of_lamps(tint, len(LAMPS)), LAMPS, strict=True):
        toward = lamp - points
        render = oracles.principled(values, oracles.unit(toward), oracles.unit(-points))
        radiance.append((render * colour / (toward**2).sum(axis=-1, keepdims=True)).reshape(-1, 3))
    colours = lamp_colours(np.array(radiance), np.ones((len(LAMPS), shape[0] * shape[1])))
    assert (colours != 1).any() == found


def test_near_lamps_of_several_colours_are_found_over_a_coloured_card():
    values = smooth_maps((40, 60), {}, seed=3) | {"normal": np.broadcast_to((0.0, 0.0, 1.0), (40, 60, 3))}
    capture, _ = near_card(values=values)
    colours = colours_of_lamps(0.4, len(capture.observations))

    def coloured(observation, colour):
        image = observation.read() * np.append(colour, 1).astype(np.float32)
        return replace(observation, read=lambda: image, light=UNLIT)

    seen = tuple(coloured(*pair) for pair in zip(capture.observations, colours, strict=True))
    found = run_steps(flat_card_steps(replace(capture, observations=seen))).capture
    for light, shot, colour in zip(found.lights, capture.observations, colours, strict=True):
        np.testing.assert_allclose(light.vector, shot.light.vector, rtol=0.01, atol=2.0)
        np.testing.assert_allclose(
            np.array(light.intensity) / np.mean(light.intensity), colour / colour.mean(), rtol=0.02
        )
    strengths = np.array([light.intensity for light in found.lights]) / colours
    assert strengths.std() / strengths.mean() < 0.03  # all lamps are equally strong
