"""The prefit with sheen: which texels take it, and what a card gains whose one half is velvet."""

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
from irpso_addon.solver.phases.phase import PhaseContext
from irpso_addon.solver.phases.sheen import SheenPhase
from irpso_addon.solver.settings.resolve import ResolvedSheen
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state.packing import Packing
from irpso_addon.solver.state.prefit_measurements import PrefitMeasurements
from irpso_addon.solver.state.textures import DomainTextures, Estimates
from tests.builders.domains import (
    angles_of,
    around,
    bits_of,
    make_domain,
    pack_layers,
    recoveries,
    resumed,
    sliced,
    unit,
)

LAMBERT = load_model("lambert")
SHEEN = load_schedule("standard").replaced(prior_rounds=0, materials_rounds=0, surface_rounds=0,
                                           prefit_indirect_shadow=0.0, refinement_iterations=0)  # fmt: skip
OFF = SHEEN.replaced(prefit_sheen_gain=0.0)
MIN_FITNESS, GAIN, UNFIT = 0.37, 0.03, 1e30
recover = pytest.fixture(recoveries)


@cache
def velvet(shape=(18, 40), observations=60):
    """Return (domain, normals, (H, W) bool where): the left half of a matt card has a rim that shines.

    The rim is that of Zeltner's fibres in shape only: bright where light and view are both far from the normal.
    """
    rng = np.random.default_rng(3)
    lights = unit(rng.normal(size=(observations, 3)) * (1, 1, 0.4) + (0, 0, 1.3))
    y, x = np.mgrid[: shape[0], : shape[1]]
    normal = unit(np.stack([0.9 * np.sin(x / 3.0), 0.9 * np.cos(y / 3.0), np.ones(shape)], axis=-1))
    diffuse = np.maximum(np.einsum("ki,hwi->khw", lights, normal), 0)
    half = unit(lights + (0, 0, 1))
    along = np.einsum("ki,hwi->khw", half, normal)
    rim = (1 - along**2) ** 1.1 * diffuse / (diffuse + normal[..., 2] + 1e-3)
    left = np.broadcast_to(np.arange(shape[1]) < shape[1] // 2, shape)
    stack = np.ones((observations, *shape, 4), np.float32)
    stack[..., :3] = (0.3 * diffuse + 1.5 * rim * left)[..., None]
    made = make_domain(*shape, observations=observations, holes=False)
    made = replace(
        made, lights=np.float32(np.pad(lights, ((0, 0), (0, 1)))), intensities=np.ones((observations, 3), np.float32)
    )
    return with_samples(made, stack), normal, left


def test_velvet_takes_the_normals_with_sheen_and_matt_does_not(recover):
    domain, normal, left = velvet()
    found, _ = angles_of(recover, domain, LAMBERT, (OFF, SHEEN), normal)
    before, after = (angles[left].mean() for angles in found)
    assert before > 10 and after < 0.5 * before
    far = np.broadcast_to(np.arange(domain.shape[1]) >= domain.shape[1] // 2 + 8, domain.shape)
    np.testing.assert_array_equal(found[0][far], found[1][far])


@pytest.mark.parametrize("holes", [False, True])
def test_texels_are_chosen_by_the_fits_of_their_neighbours(holes):
    context.ensure()
    domain = make_domain(19, 23, observations=4, holes=holes)
    rng = np.random.default_rng(5)
    first = np.float32(rng.uniform(0.2, 0.55, domain.shape))
    second = np.float32(first * rng.uniform(0.8, 1.14, domain.shape))
    first[rng.random(domain.shape) < 0.1] = UNFIT
    normals = np.float32(unit(rng.normal(size=(*domain.shape, 3)) + (0, 0, 3)))
    pack = Packing(domain.solvable)
    domain_textures = DomainTextures(
        domain, pack, pack_layers(pack, domain.stack.values), pack.pack(np.ones(domain.shape, np.float32))
    )
    up = np.float32([0, 0, 1])
    values = {"normal": pack.pack(np.broadcast_to(up, (*domain.shape, 3)).copy()),
              "base_color": pack.pack(np.full((*domain.shape, 3), 0.5, np.float32))}  # fmt: skip
    sheen = pack.pack(np.concatenate([normals, second[..., None]], axis=-1))
    measurements = PrefitMeasurements(pack.pack(first), sheen=sheen)
    estimates = Estimates(LAMBERT, values)
    phase = SheenPhase(
        ResolvedSheen(), PhaseContext(LAMBERT, SHEEN, domain_textures, estimates, "fragment"), measurements
    )
    run_steps(phase.advance(Bands(), 1.0))
    run_steps(phase.write_estimates(Bands(), 1.0))
    known = {name: pack.unpack(array) for name, array in run_steps(phase.measure_steps(Bands(), 1.0)).arrays.items()}
    found = pack.unpack(estimates.values()["normal"])
    phase.close()
    counted = domain.solvable & (first < UNFIT)
    sums = around(np.stack([first, second, counted], axis=-1) * counted[..., None])
    chosen = counted & (sums[..., 0] > MIN_FITNESS * sums[..., 2]) & (sums[..., 1] < (1 - GAIN) * sums[..., 0])
    assert 0.1 < chosen[domain.solvable].mean() < 0.9
    inside = domain.solvable
    np.testing.assert_allclose(found[inside], np.where(chosen[..., None], normals, up)[inside], atol=1e-6)
    ratio = np.where(second < 0.9 * first, np.float32(SHEEN.prefit.acceptance_ratio), 1)
    wanted = np.where(chosen, second / ratio, first)
    np.testing.assert_allclose(known["prefit_fitness"][inside], wanted[inside], rtol=1e-6)
    np.testing.assert_array_equal(known["prefit_sheen_chosen"][inside], chosen[inside])
    assert set(known) == {"prefit_fitness", "prefit_sheen_chosen"}


SHORT = SHEEN.replaced(iterations=2, prefit_iterations=4, prefit_refinement_iterations=3, prefit_indirect_shadow=0.5)


@pytest.fixture(scope="module")
def whole():
    with Recovery(velvet()[0], LAMBERT, SHORT, 1, entry="fragment") as recovery:
        recovery.step()
        return bits_of(recovery.maps(confidence=False))


def test_sheen_is_tried_where_the_first_prefit_fits_badly_and_nowhere_else(recover):
    recovery = recover(velvet()[0], LAMBERT, SHORT)
    recovery.step(iterations=sum(stage.iterations for stage in recovery._stages[:2]))
    measured = recovery.state().arrays
    first, second = measured["prefit_fitness"].ravel(), measured["prefit_sheen"].reshape(-1, 4)[:, 3]
    badly = first >= 0.3
    assert 0.2 < badly.mean() < 0.8
    np.testing.assert_array_equal(second[~badly], first[~badly])
    assert (second[badly] < first[badly]).mean() > 0.5


@pytest.mark.parametrize("resident", [True, False])
def test_tiles_find_the_same_maps(whole, resident):
    boxes = [(0, 0, 15, 18), (15, 0, 25, 9), (15, 9, 25, 9)]
    options = {"boxes": boxes, "halo": 8, "on_device": None if resident else 1}
    with TiledRecovery(velvet()[0], LAMBERT, SHORT, 1, entry="fragment", **options) as recovery:
        recovery.step()
        assert bits_of(recovery.maps(confidence=False)) == whole


@pytest.mark.parametrize("iterations", [7, 10, 18, 30, 31, 32])
def test_a_run_continues_from_a_checkpoint_with_the_same_maps(whole, recover, iterations):
    # After 7 the first prefit has ended, after 18 the one with sheen makes a round of proposals, after 30 it has ended,
    # after 31 the choice, after 32 the search.
    assert resumed(recover, velvet()[0], LAMBERT, SHORT, iterations) == [whole, whole]


def test_slices_of_time_change_nothing(whole, recover):
    assert sliced(recover(velvet()[0], LAMBERT, SHORT)) == whole
