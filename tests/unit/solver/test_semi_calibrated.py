"""Intensities of lights from the images of a matte surface, and the texels that they are told by."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.geometry.domain import with_lights, with_samples
from irpso_addon.solver.lights.light_texels import draw_texels
from irpso_addon.solver.lights.semi_calibrated import normalised, relative_intensities
from irpso_addon.solver.state.prepare import light_vectors
from tests.builders.lights import apart, gains, off, photographed, subject


def factors_of(domain):
    texels = np.nonzero(domain.solvable)
    samples = domain.stack.values[:, texels[0], texels[1]].astype(np.float64)
    return relative_intensities(samples[..., :3], samples[..., 3], *light_vectors(domain, texels))


def test_without_noise_the_intensities_of_a_matte_card_are_exact():
    rng = np.random.default_rng(1)
    domain, truth = subject("lambert", 15)
    true = gains(15, rng)[:, :1] * (1, 0.8, 0.6)  # where tints differ, grey is no longer one factor a light
    found, normals = factors_of(photographed(domain, true, rng, shadow=0, noise=0))
    assert off(found, true).max() < 2e-4
    assert np.median(apart(normals, truth["normal"].reshape(-1, 3))) < 0.01
    np.testing.assert_allclose(np.log(found).mean(axis=0), 0, atol=1e-12)


@pytest.mark.parametrize(("card", "near"), [(True, False), (False, False), (False, True)])
def test_shadow_and_noise_leave_the_intensities_of_a_matte_surface_within_two_per_cent(card, near):
    rng = np.random.default_rng(2)
    domain, _ = subject("lambert", 30, card=card, near=near)
    true = gains(30, rng)
    found, _ = factors_of(photographed(domain, true, rng))
    assert off(found, true).max() < 0.02
    assert off(found, true).mean() < 0.006


def test_a_light_without_texels_keeps_its_intensity():
    rng = np.random.default_rng(3)
    domain, _ = subject("lambert", 12)
    domain = photographed(domain, true := gains(12, rng), rng, shadow=0)
    stack = domain.stack.values.copy()
    stack[4] = 0
    found, _ = factors_of(with_samples(domain, stack))
    others = np.arange(12) != 4
    assert off(found[others], true[others]).max() < 0.02
    assert np.isfinite(found).all()
    assert 0.2 < found[4].mean() < 5


def test_normalised_factors_have_the_mean_logarithm_zero_in_each_channel():
    factors = normalised(np.array([[1.0, 2.0, 3.0], [4.0, 8.0, 3.0]]))
    np.testing.assert_allclose(factors, [[0.5, 0.5, 1], [2, 2, 1]], rtol=1e-12)


def test_the_sample_holds_texels_that_are_lit_with_their_own_radiance_and_every_light_has_some():
    domain, _ = subject("lambert", 12, shape=(60, 70), card=False)
    stack = domain.stack.values.copy()
    stack[:, :, 35:] = 0  # nothing is seen there
    stack[7, :, :33] = 0  # and one light reaches a strip alone
    domain = with_samples(domain, stack)
    texels = draw_texels(domain, 1, np.arange(12), 300)
    count = len(texels.rows)
    assert count == 300
    assert (texels.columns < 35).all()
    part = texels.domain.stack.values.reshape(12, -1, 4)[:, :count]
    np.testing.assert_array_equal(part, domain.stack.values[:, texels.rows, texels.columns])
    np.testing.assert_array_equal(texels.domain.bake.coverage.ravel()[:count], True)
    assert (part[7, :, :3] > 0).any(axis=-1).sum() > 20
    np.testing.assert_array_equal(texels.part(domain.bake.normal).reshape(-1, 3)[:count],
                                  domain.bake.normal[texels.rows, texels.columns])  # fmt: skip


def test_a_domain_under_other_lights_keeps_its_stacks_properties():
    domain, _ = subject("lambert", 5, shape=(6, 6))
    solvable = domain.solvable
    other = with_lights(domain, domain.lights[::-1], domain.intensities * 2)
    assert other.solvable is solvable
    np.testing.assert_array_equal(other.lights, domain.lights[::-1])
    np.testing.assert_array_equal(other.intensities, 2)


def test_sampled_texels_for_lights_have_the_noise_of_the_whole():
    rng = np.random.default_rng(4)
    domain, _ = subject("lambert", 12)
    domain = replace(photographed(domain, gains(12, rng), rng), noise=0.01)
    assert draw_texels(domain, 0, np.arange(12)).domain.noise == 0.01
