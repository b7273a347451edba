"""Where the light is indirect: what the prefit measures, which texels it means, and what they gain."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.domain import with_samples
from irpso_addon.gpu import context
from irpso_addon.gpu.bands import Bands
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.phases.indirect import IndirectPhase
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.settings.resolve import ResolvedIndirect
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.prefit_measurements import PrefitMeasurements
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import (
    angles_of,
    around,
    bits_of,
    ended_prefit,
    make_domain,
    pack_layers,
    recoveries,
    resumed,
    sliced,
    unit,
)
from tests.oracles import confidence as confidence_oracle

LAMBERT = load_model("lambert")
RAISED = load_schedule("standard").replaced(prior_rounds=0, surface_rounds=0, materials_rounds=0, prefit_sheen_gain=0.0)
OFF = RAISED.replaced(prefit_indirect_shadow=0.0, prefit_sheen_gain=0.0)
OBSERVATIONS = 96
LIMITS = 0.2, 0.03  # of misfit and surplus
recover = pytest.fixture(recoveries)


@cache
def corner(shape=(20, 36), colour=None):
    """Return (domain, normals, (H, W) bool where): the left half of a matt card stands between two walls.

    One hides it from every second lamp, the other is of metal and throws light on it. The card has many colours, or one
    (3,), which its walls have, too; they throw three times the light.
    """
    rng = np.random.default_rng(3)
    lights = unit(rng.normal(size=(OBSERVATIONS, 3)) * (1, 1, 0.4) + (0, 0, 1.3))
    normal = unit(rng.normal(size=(*shape, 3)) * 0.3 + (0, 0, 1))
    between = np.broadcast_to(np.arange(shape[1]) < shape[1] // 2, shape)
    direct = np.maximum(np.einsum("ki,hwi->khw", lights, normal), 0)
    direct[np.ix_(lights @ (1, 0, 0.2) > 0, *map(range, shape))] *= ~between
    thrown = (0.5 if colour is None else 1.5) * np.maximum(lights @ (0, -0.8, 0.6), 0)[:, None, None] ** 4
    thrown = thrown * between * np.maximum(normal @ (0.9, 0, 0.44), 0)
    if colour is None:
        light = (direct + thrown)[..., None] * rng.uniform(0.3, 0.8, (*shape, 3))
    else:
        once = np.array(colour)
        light = direct[..., None] * once + thrown[..., None] * once**2 * once.sum() / (once**2).sum()
    return card_of(lights, light), normal, between


def card_of(lights, light):
    """Return the domain of a card that sends (K, H, W, 3) light under distant lights (K, 3) of intensity 1."""
    made = make_domain(*light.shape[1:3], observations=len(lights), holes=False)
    made = replace(
        made, lights=np.float32(np.pad(lights, ((0, 0), (0, 1)))), intensities=np.ones((len(lights), 3), np.float32)
    )
    return with_samples(made, np.pad(np.float32(light), [(0, 0)] * 3 + [(0, 1)], constant_values=1))


def raised(recovery):
    """Return (H, W) bool: the texels whose shadow has been raised."""
    return Packing(recovery.domain.solvable).unpack(recovery.snapshot().arrays["prefit_shadow"]) > 0


def test_darker_samples_count_as_shadow_where_the_light_is_indirect_and_nowhere_else(recover):
    domain, normal, between = corner()
    found, recovery = angles_of(recover, domain, LAMBERT, (OFF, RAISED), normal)
    chosen = raised(recovery)
    assert chosen[between].mean() > 0.5 and not chosen[:, domain.shape[1] // 2 + 8 :].any()
    before, after = (angles[chosen & between].mean() for angles in found)
    assert before > 10 and after < 0.7 * before
    assert all(angles[~between].mean() < 0.05 for angles in found)


def test_the_misfit_of_indirect_light_matches_float64(recover):
    domain, _, _ = corner((6, 10))
    recovery = recover(domain, LAMBERT, RAISED)
    phase, pack = ended_prefit(recovery), Packing(domain.solvable)
    measured = pack.unpack(run_steps(phase.measure_steps(Bands(), 1.0)).indirect_misfit)
    own = {name: np.float64(pack.unpack(value)) for name, value in phase.own.values().items()}
    shown = domain.stack.values[..., :3].astype(np.float64).mean(axis=-1)
    scale = np.percentile(shown, RAISED.fitness.scale_percentile, axis=0)
    counted = np.minimum(shown, scale)
    error = np.minimum(confidence_oracle.radiance(domain, "base_lobe", own).mean(axis=-1), scale) - counted
    light = counted.sum(axis=0)
    assert (shown < RAISED.fitness.shadow * scale).mean() > 0.1  # samples in shadow count
    np.testing.assert_allclose(measured[..., 0], np.minimum(np.abs(error).sum(axis=0) / light, 1), rtol=2e-3, atol=1e-5)
    np.testing.assert_allclose(measured[..., 1], np.maximum(-error, 0).sum(axis=0) / light, rtol=2e-3, atol=1e-5)
    enough = (shown >= 0.5 * scale).sum(axis=0) >= 18  # three for each of the prefit's six free numbers
    np.testing.assert_array_equal(measured[..., 2], enough)


@pytest.mark.parametrize("holes", [False, True])
def test_texels_are_chosen_by_the_means_over_their_neighbours(holes):
    context.ensure()
    domain = make_domain(19, 23, observations=4, holes=holes)
    rng = np.random.default_rng(5)
    measured = np.float32(rng.random((*domain.shape, 4)) * (0.5, 0.1, 1, 0) + (0, 0, 0, 1))
    measured[..., 2] = measured[..., 2] > 0.2
    measured *= domain.solvable[..., None]
    pack = Packing(domain.solvable)
    domain_textures = DomainTextures(
        domain, pack, pack_layers(pack, domain.stack.values), pack.pack(np.ones(domain.shape, np.float32))
    )
    values = {p.name: pack.pack(np.zeros((*domain.shape, p.components), np.float32)) for p in LAMBERT.parameters}
    shared = PhaseContext(LAMBERT, RAISED, domain_textures, Estimates(LAMBERT, values), "fragment")
    measurements = PrefitMeasurements(indirect_misfit=pack.pack(measured))
    phase = IndirectPhase(ResolvedIndirect(), shared, measurements)
    run_steps(phase.advance(Bands(), 1.0))
    found = pack.unpack(run_steps(phase.measure_steps(Bands(), 1.0)).shadow)
    phase.close()
    sums = around(measured)
    with np.errstate(all="ignore"):
        misfit, surplus = sums[..., 0] / sums[..., 3], sums[..., 1] / sums[..., 3]
    wanted = (measured[..., 2] > 0) & (misfit > LIMITS[0]) & (surplus > LIMITS[1])
    assert 0.1 < wanted[domain.solvable].mean() < 0.9
    np.testing.assert_array_equal(found, np.where(wanted, np.float32(0.5), 0))


SHORT = RAISED.replaced(iterations=2, prefit_iterations=4, prefit_refinement_iterations=3, refinement_iterations=2,
                        refinement_start_iterations=1)  # fmt: skip


@pytest.fixture(scope="module")
def whole():
    with Recovery(corner()[0], LAMBERT, SHORT, 1, entry="fragment") as recovery:
        recovery.step()
        assert raised(recovery).any()
        return bits_of(recovery.maps(confidence=False))


@pytest.mark.parametrize("resident", [True, False])
def test_tiles_find_the_same_maps(whole, resident):
    boxes = [(0, 0, 13, 20), (13, 0, 23, 9), (13, 9, 23, 11)]
    options = {"boxes": boxes, "halo": 8, "on_device": None if resident else 1}
    with TiledRecovery(corner()[0], LAMBERT, SHORT, 1, entry="fragment", **options) as recovery:
        recovery.step()
        assert bits_of(recovery.maps(confidence=False)) == whole


@pytest.mark.parametrize("iterations", [6, 7, 8, 10, 16])
def test_a_run_continues_from_a_checkpoint_with_the_same_maps(whole, recover, iterations):
    # After 7 its misfit is there, after 8 the shadow, then the second prefit and what follows it.
    assert resumed(recover, corner()[0], LAMBERT, SHORT, iterations) == [whole, whole]


def test_slices_of_time_change_nothing(whole, recover):
    assert sliced(recover(corner()[0], LAMBERT, SHORT)) == whole


def test_without_the_raised_shadow_a_run_that_goes_on_counts_all_samples_again(recover):
    domain = corner()[0]
    recovery = recover(domain, LAMBERT, SHORT)
    recovery.step(iterations=9)
    assert recovery._textures.shadow.any()
    again = recovery.reconfigure(SHORT.replaced(prefit_indirect_shadow=0.0, prefit_sheen_gain=0.0))
    assert not again._textures.shadow.any() and "prefit_shadow" not in again.snapshot().arrays
    again.step()
    again.close()


@pytest.mark.parametrize(("gain", "then"), [(0.0, 0.03), (0.03, 0.0)])
def test_indirect_light_is_sought_again_with_and_without_a_prefit_of_sheen(recover, gain, then):
    recovery = recover(corner()[0], LAMBERT, SHORT.replaced(prefit_sheen_gain=gain))
    recovery.step(iterations=9 if gain == 0 else 34)
    assert recovery._textures.shadow.any()
    again = recovery.reconfigure(SHORT.replaced(prefit_sheen_gain=then))
    again.step()
    assert raised(again).any()
    again.close()


def test_a_run_that_is_to_seek_indirect_light_prefits_again(recover):
    recovery = recover(corner()[0], LAMBERT, SHORT.replaced(prefit_indirect_shadow=0.0, prefit_sheen_gain=0.0))
    recovery.step(iterations=9)
    again = recovery.reconfigure(SHORT)
    again.step()
    assert raised(again).any()
    again.close()
