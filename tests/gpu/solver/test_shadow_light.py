"""A matt corner of many colours, recovered without the light that it sends itself, as its shadows tell it."""

from functools import cache

import numpy as np
import pytest

from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from tests.builders.domains import angles_of, bits_of, recoveries, resumed, unit
from tests.gpu.solver.test_indirect_colour import LAMBERT, OFF, SEPARATED, SHORT
from tests.gpu.solver.test_indirect_shadow import OBSERVATIONS, card_of

recover = pytest.fixture(recoveries)


@cache
def corner(shape=(20, 36)):
    """Return (domain, normals, sent light (K, H, W, 3), (H, W) bool where): the left half stands beside a matt wall.

    The wall hides it from lamps of one side, and sends it most light from lamps of the other.
    """
    rng = np.random.default_rng(8)
    lights = unit(rng.normal(size=(OBSERVATIONS, 3)) * (1, 1, 0.4) + (0, 0, 1.0))
    normal = unit(rng.normal(size=(*shape, 3)) * 0.3 + (0, 0, 1))
    beside = np.broadcast_to(np.arange(shape[1]) < shape[1] // 2, shape)
    direct = np.maximum(np.einsum("ki,hwi->khw", lights, normal), 0)
    direct[np.ix_(lights @ (1, 0, 0) > 0.3, *map(range, shape))] *= ~beside
    albedo = rng.uniform(0.3, 0.8, (*shape, 3))
    sent = 0.25 * np.maximum(lights @ unit(np.array([-1.0, 0, 0.6])), 0)[:, None, None] + 0.05
    sent = (sent * beside * np.maximum(normal @ (0.8, 0, 0.6), 0))[..., None] * albedo * (0.9, 0.6, 0.4)
    return card_of(lights, direct[..., None] * albedo + sent), normal, sent, beside


def test_the_normals_beside_a_wall_are_nearer_to_those_of_direct_light(recover):
    domain, normal, sent, beside = corner()
    found, recovery = angles_of(recover, domain, LAMBERT, (OFF, SEPARATED), normal)
    before, after = (angles[beside].mean() for angles in found)
    assert before > 4 and after < 0.7 * before
    np.testing.assert_array_equal(*(angles[:, 20:] for angles in found))
    share = recovery.indirect_share
    told = share > 0  # not where this light hardly turns a normal
    assert not told[~beside].any() and told[beside].mean() > 0.25
    true = sent.sum(axis=(0, -1)) / domain.stack.values[..., :3].sum(axis=(0, -1))
    assert np.abs(share - true)[told].mean() < 0.5 * true[told].mean()


@pytest.fixture(scope="module")
def whole():
    with Recovery(corner()[0], LAMBERT, SHORT, 1, entry="fragment") as recovery:
        recovery.step()
        assert not recovery.separation.bounced_chroma.any() and recovery.separation.harmonics.any()
        return bits_of(recovery.maps(confidence=False)), recovery.separation


def test_tiles_find_the_same_maps(whole):
    boxes = [(0, 0, 13, 20), (13, 0, 23, 9), (13, 9, 23, 11)]
    with TiledRecovery(corner()[0], LAMBERT, SHORT, 1, entry="fragment", boxes=boxes, halo=8) as recovery:
        recovery.step()
        np.testing.assert_array_equal(recovery.separation.values, whole[1].values)
        assert bits_of(recovery.maps(confidence=False)) == whole[0]


@pytest.mark.parametrize("iterations", [9, 12])
def test_a_run_continues_from_a_checkpoint_with_the_same_maps(whole, recover, iterations):
    assert resumed(recover, corner()[0], LAMBERT, SHORT, iterations) == [whole[0], whole[0]]
