"""A corner of brass, recovered without the light that it throws on itself: normals, tiles, checkpoints, settings."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from tests.builders.domains import angles_of, bits_of, recoveries, resumed, sliced
from tests.gpu.solver.test_indirect_shadow import RAISED
from tests.gpu.solver.test_indirect_shadow import SHORT as RAISED_SHORT
from tests.gpu.solver.test_indirect_shadow import corner as corner_of

LAMBERT = load_model("lambert")
BRASS = 0.9, 0.6, 0.3
SHORT, SEPARATED = (schedule.replaced(prefit_indirect_share=0.05) for schedule in (RAISED_SHORT, RAISED))
OFF = RAISED.replaced(prefit_indirect_share=0.0)
recover = pytest.fixture(recoveries)


def corner():
    return corner_of(colour=BRASS)


def test_the_normals_of_a_hollow_are_those_of_its_direct_light(recover):
    domain, normal, between = corner()
    found, recovery = angles_of(recover, domain, LAMBERT, (OFF, SEPARATED), normal)
    before, after = (angles[between].mean() for angles in found)
    assert before > 10 and after < 1
    assert all(angles[:, 22:].mean() < 0.05 for angles in found)
    colour = recovery.maps(confidence=False).values["base_color"][between]
    aside = np.abs(colour / colour.sum(axis=-1, keepdims=True) - np.divide(BRASS, sum(BRASS))).max(axis=-1)
    assert np.quantile(aside, 0.99) < 0.01


def test_the_light_that_was_taken_off_is_told(recover):
    domain, _, between = corner()
    recovery = recover(domain, LAMBERT, SHORT)
    assert recovery.separation is None and recovery.indirect_share is None and recovery.findings == {}
    assert isinstance(recovery.indirect(3), float)
    recovery.step()
    recovery.close()
    share = recovery.indirect_share
    taken = sum(recovery.indirect(k)[between].sum() for k in range(domain.observations))
    shown = domain.stack.values[:, between, :3].sum()
    assert 0.1 < share[between].mean() < 0.9 and not share[:, 22:].any()
    assert taken / shown == pytest.approx(share[between].mean(), abs=0.1)
    assert recovery.indirect_share is share
    assert recovery.findings["separation"]["texels"] == np.count_nonzero(share) > 0


@pytest.fixture(scope="module")
def whole():
    with Recovery(corner()[0], LAMBERT, SHORT, 1, entry="fragment") as recovery:
        recovery.step()
        return bits_of(recovery.maps(confidence=False)), recovery.separation


@pytest.mark.parametrize("resident", [True, False])
def test_tiles_find_the_same_maps(whole, resident):
    boxes = [(0, 0, 13, 20), (13, 0, 23, 9), (13, 9, 23, 11)]
    options = {"boxes": boxes, "halo": 8, "on_device": None if resident else 1}
    with TiledRecovery(corner()[0], LAMBERT, SHORT, 1, entry="fragment", **options) as recovery:
        assert recovery.separation is None
        recovery.step()
        np.testing.assert_array_equal(recovery.separation.values, whole[1].values)
        assert bits_of(recovery.maps(confidence=False)) == whole[0]


@pytest.mark.parametrize("iterations", [8, 9, 10, 12, 17])
def test_a_run_continues_from_a_checkpoint_with_the_same_maps(whole, recover, iterations):
    # After 8 the shadow is there, after 9 the two chromas, then the second prefit and what follows it.
    assert resumed(recover, corner()[0], LAMBERT, SHORT, iterations) == [whole[0], whole[0]]


def test_slices_of_time_change_nothing(whole, recover):
    assert sliced(recover(corner()[0], LAMBERT, SHORT)) == whole[0]


def test_a_run_that_goes_on_without_it_has_all_its_light_again(recover):
    recovery = recover(corner()[0], LAMBERT, SHORT)
    recovery.step(iterations=9)
    assert recovery.separation is not None
    again = recovery.reconfigure(SHORT.replaced(prefit_indirect_share=0.0))
    assert again.separation is None and again._textures.shadow.any()
    again.step()
    again.close()


def test_lights_that_lack_a_channel_tell_no_colours(recover):
    domain = corner()[0]
    intensities = domain.intensities.copy()
    intensities[5, 1] = 0
    recovery = recover(replace(domain, intensities=intensities), LAMBERT, SHORT)
    recovery.step()
    assert recovery.separation is None
