"""Photographs minus indirect light, computed where they are read."""

import numpy as np
import pytest

from irpso_addon.geometry.light.light_transport import LightTransport
from irpso_addon.solver.interreflection.corrected_stack import CorrectedStack, IndirectSamples
from tests.builders.domains import make_domain

COUNT = 4  # elements


@pytest.fixture
def lit():
    """A domain with holes, its indirect light, and that light at each texel: (K, H, W, 3)."""
    domain, rng = make_domain(6, 5, observations=3, holes=True), np.random.default_rng(1)
    covered = domain.bake.coverage
    texels = int(covered.sum())
    assert 0 < texels < covered.size
    near, share = rng.integers(0, COUNT, (texels, 4)), rng.dirichlet(np.ones(4), texels)
    radiance, detail = rng.random((3, COUNT, 3), np.float32), rng.random((texels, 3), np.float32)
    none = np.zeros((0, COUNT))
    transport = LightTransport(np.arange(COUNT), none, none, none, none, near, share.astype(np.float32))
    light = np.zeros((3, *covered.shape, 3))
    light[:, covered] = np.einsum("ti,ktic->ktc", share, radiance[:, near]) * detail
    return domain, IndirectSamples(covered, transport, radiance, detail), light


def test_the_light_is_subtracted_down_to_zero(lit):
    domain, indirect, light = lit
    values = domain.stack.values
    direct = CorrectedStack(domain.stack, indirect)
    assert direct.shape == domain.stack.shape
    found = np.stack([*direct.layers()])
    wanted = np.where(domain.bake.coverage[..., None], np.maximum(values[..., :3] - light, 0), values[..., :3])
    np.testing.assert_allclose(found[..., :3], wanted, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(found[..., 3], values[..., 3])


def test_a_relaxed_step_goes_part_of_the_way(lit):
    domain, indirect, light = lit
    covered, values = domain.bake.coverage, domain.stack.values[..., :3]
    once = CorrectedStack(domain.stack, indirect, None, 0.75)
    twice = CorrectedStack(domain.stack, indirect, once, 0.75)
    left = np.maximum(values - light, 0)
    for stack, part in ((once, 0.25), (twice, 0.25**2)):
        found = np.stack([*stack.layers()])[..., :3]
        np.testing.assert_allclose(found[:, covered], (left + part * (values - left))[:, covered], rtol=1e-4, atol=1e-6)


def test_all_ways_to_read_agree_bit_for_bit(lit):
    domain, indirect, _ = lit
    stack = CorrectedStack(domain.stack, indirect, CorrectedStack(domain.stack, indirect), 0.75)
    whole = np.stack([*stack.layers()])
    rows, columns = np.indices(domain.shape).reshape(2, -1)
    np.testing.assert_array_equal(stack.texels(rows, columns), whole.reshape(3, -1, 4))
    chosen, part = np.array([2, 0]), (slice(1, 5), slice(2, 5))
    for derived in (stack.subset(chosen).window(*part), stack.window(*part).subset(chosen)):
        wanted = whole[chosen][:, *part]
        np.testing.assert_array_equal(np.stack([*derived.layers()]), wanted)
        some = np.array([0, 3]), np.array([2, 1])
        np.testing.assert_array_equal(derived.texels(*some), wanted[:, *some])
    np.testing.assert_array_equal(stack.lit(domain.bake.coverage), domain.stack.lit(domain.bake.coverage))
