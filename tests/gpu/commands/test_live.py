"""A recovery that a window drives: looking at it disturbs nothing, and its settings may change in mid-run."""

import dataclasses

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.gpu import textures
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.coarse_to_fine import Pyramid
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.state import prepare
from tests.builders.domains import SHORT, bits_of, recoveries, subject, with_radiance

LAMBERT = load_model("lambert")
TWO_LOBES = load_model("cook_torrance_two_lobe")
recover = pytest.fixture(recoveries)
STANDARD = load_schedule("standard").replaced(
    prefit_iterations=3, prefit_refinement_iterations=2, iterations=3, refinement_iterations=3,
    refinement_start_iterations=1, refinement_round_iterations=2, prior_iterations=2, prior_scales=2,
)  # fmt: skip
# Every kind of phase: sequential swarms in two stages; prefit, synchronous swarms, refinement, prior.
RUNS = {
    "one": (TWO_LOBES, SHORT.replaced(iterations=8, particles=5, start="lambert", start_fraction=0.5)),
    "standard": (TWO_LOBES, STANDARD),
}


def observed(model):
    return subject(model=model.name, observations=12)[0]


@pytest.fixture(scope="module", params=RUNS)
def whole(request):
    """(domain, model, schedule, the bits of the maps of an uninterrupted recovery)."""
    model, schedule = RUNS[request.param]
    domain = observed(model)
    with Recovery(domain, model, schedule, 1, entry="fragment") as recovery:
        recovery.step()
        return domain, model, schedule, bits_of(recovery.maps())


def lent_values(recovery):
    """Return parameter name → (H, W, components) of the estimates that view() lends."""
    with recovery.view() as lent:
        packed = np.concatenate(
            [textures.download(lent[f"u_estimate_{i}"]) for i in range(recovery._estimates.count)], -1
        )
    model = recovery.model
    return {
        p.name: recovery._packing.unpack(packed[..., model.offset(p.name) : model.offset(p.name) + p.components], 0.0)
        for p in model.parameters
    }


def float64_error(domain, model, values):
    """Return (H, W) float64: the mean over weighted samples and channels of |render − reference|."""
    values = {name: value.astype(np.float64) for name, value in values.items()}
    weight = domain.stack.values[..., 3].astype(np.float64)
    rendered = with_radiance(domain, model.name, values).stack.values[..., :3].astype(np.float64)
    difference = np.where(weight[..., None] > 0, np.abs(rendered - domain.stack.values[..., :3]), 0.0).sum(axis=-1)
    return (weight * difference).sum(axis=0) / (3 * weight.sum(axis=0).clip(1e-9))


# ---- looking -----------------------------------------------------------------------------------------------------


def test_reading_maps_between_slices_changes_no_bit(whole, recover):
    domain, model, schedule, wanted = whole
    recovery = recover(domain, model, schedule)
    slices = looks = 0
    while not recovery.step(time_budget_s=1e-6).done:
        slices += 1
        with recovery.view() as lent:
            assert {"u_estimate_0", "u_stack", "u_geometry", "u_packed"} <= set(lent)
        if slices % 5 == 0:
            assert recovery.mean_error() >= 0
        if slices % 23 == 0:  # begun, and left behind by the next step
            looks += recovery.refresh_confidence(time_budget_s=1e-6)
    assert slices > 60 and bits_of(recovery.maps()) == wanted


def test_the_first_picture_is_the_seed(recover):
    domain = observed(TWO_LOBES)
    seed = prepare.prepare(domain, TWO_LOBES, STANDARD).guess
    recovery = recover(domain, TWO_LOBES, STANDARD)
    for name, value in lent_values(recovery).items():
        np.testing.assert_array_equal(value[domain.solvable], seed[name][domain.solvable])
    normal, _ = prepare.lambert_fit(domain)
    np.testing.assert_array_equal(lent_values(recovery)["normal"][domain.solvable], normal[domain.solvable])


def test_the_picture_shows_the_last_iteration(recover):
    model, schedule = RUNS["one"]
    recovery = recover(observed(model), model, schedule)
    recovery.step(iterations=0)
    before = lent_values(recovery)
    recovery.step(iterations=5)
    after = lent_values(recovery)
    for name, value in recovery.maps().values.items():
        covered = recovery.domain.solvable
        np.testing.assert_array_equal(after[name][covered], value[covered])
        assert (after[name] != before[name]).any()


def test_the_mean_error_is_that_of_float64(recover):
    domain = observed(TWO_LOBES)
    recovery = recover(domain, TWO_LOBES, STANDARD.replaced(shadow=0.0))  # or dark samples would not count
    for iterations in (0, 2, 6):
        recovery.step(iterations=iterations)
        values = lent_values(recovery)
        wanted = float64_error(domain, TWO_LOBES, values)[domain.solvable].mean()
        assert recovery.mean_error() == pytest.approx(wanted, rel=1e-4)
    assert wanted > 1e-4


def test_the_sampled_mean_error_is_near_the_full_one(recover, monkeypatch):
    from irpso_addon.solver.engine import diagnostics as findings

    monkeypatch.setattr(findings, "_SAMPLED", 100)
    domain, _ = subject(40, 30, observations=5)
    recovery = recover(domain)
    recovery.step(iterations=3)
    residual = recovery.maps(confidence=False).residual[domain.solvable]
    error = residual.std() / np.sqrt(100)
    found = recovery.mean_error()
    assert abs(found - residual.mean()) < 4 * error and found != pytest.approx(residual.mean(), rel=1e-6)


def test_confidence_in_slices_equals_confidence_at_once(whole, recover):
    domain, model, schedule, _ = whole
    found = []
    for sliced in (False, True):
        recovery = recover(domain, model, schedule)
        recovery.step(iterations=4)
        slices = 0
        while sliced and not recovery.refresh_confidence(time_budget_s=1e-6):
            slices += 1
        assert slices > 3 or not sliced
        maps = recovery.maps()
        found.append({name: value.tobytes() for name, value in maps.confidence.items()} | bits_of(maps))
        assert recovery.refresh_confidence(time_budget_s=0.0)
    assert found[0] == found[1]


def test_confidence_follows_a_further_step(whole, recover):
    domain, model, schedule, _ = whole
    first, second = recover(domain, model, schedule), recover(domain, model, schedule)
    first.step(iterations=2)
    assert first.refresh_confidence()
    first.step(iterations=2)
    assert not first.refresh_confidence(time_budget_s=0.0)
    second.step(iterations=4)
    for name, value in second.maps().confidence.items():
        np.testing.assert_array_equal(first.maps().confidence[name], value)


# ---- other settings in mid-run -----------------------------------------------------------------------------------


@pytest.mark.parametrize("stop", [0, 2, 5, 8, 12, 17])
def test_reconfiguring_to_the_same_settings_changes_no_bit(whole, recover, stop):
    domain, model, schedule, wanted = whole
    first = recover(domain, model, schedule)
    first.step(iterations=stop)
    evaluations = first.progress.evaluations
    second = first.reconfigure(schedule)
    first.close()
    assert second.progress.evaluations == evaluations
    second.step()
    assert bits_of(second.maps()) == wanted
    second.close()


def test_changed_constants_apply_from_the_next_iteration(recover):
    model, schedule = RUNS["one"]
    still = schedule.replaced(
        c1=0.0, c2=0.0, c3=0.0, inertia=0.0, neighbour_interval=0
    )  # Eq. 2 with nothing left in it
    first = recover(observed(model), model, schedule)
    first.step(iterations=3)
    place, best = (first._phase.state()[name] for name in ("position", "best"))
    second = first.reconfigure(still)
    assert second.progress.iteration == 3
    second.step(iterations=1)
    after = second._phase.state()
    np.testing.assert_array_equal(after["position"], place)
    np.testing.assert_array_equal(after["best"], best)
    second.close()


def test_a_changed_error_to_stop_at_is_that_of_the_running_swarms(recover):
    model, schedule = RUNS["one"]
    first = recover(observed(model), model, schedule)
    first.step(iterations=3)
    place = first._phase.state()["position"]
    second = first.reconfigure(schedule.replaced(threshold=1e9))  # which every texel has reached
    second.step(iterations=1)
    assert second.progress.iteration == 4
    np.testing.assert_array_equal(second._phase.state()["position"], place)
    second.close()


def test_a_changed_error_to_stop_at_restarts_no_other_phase(recover):
    first = recover(observed(TWO_LOBES), TWO_LOBES, STANDARD)
    first.step(iterations=3)
    second = first.reconfigure(STANDARD.replaced(threshold=1e-3))
    assert second.progress.iteration == 3
    second.close()


def test_finished_stages_do_not_run_again(recover):
    first = recover(observed(TWO_LOBES), TWO_LOBES, STANDARD)
    before = 6  # the prefit, with sheen, two tests, the separation of indirect light, the prefit in it
    first.step(iterations=sum(stage.iterations for stage in first._stages[:before]) + 2)
    assert first.progress.stage == before
    second = first.reconfigure(STANDARD.replaced(prefit_iterations=50, iterations=20))
    assert (second.progress.stage, second.progress.iteration) == (before, 2)
    assert second.step(iterations=18).stage == before + 1
    second.close()


@pytest.mark.parametrize(
    "change",
    [
        {"particles": 7},
        {"normal": "cartesian"},
        {"update": "all", "particles": 6},
        {"start": "random"},
        {"particles": 7, "start": "random", "start_fraction": 0.0},
    ],
    ids=str,
)
def test_restarted_swarms_begin_at_the_current_best(recover, change):
    domain, truth = subject(model=TWO_LOBES.name, observations=12)
    schedule = SHORT.replaced(iterations=40, start="lambert", start_fraction=0.5, particles=6)
    first = recover(domain, TWO_LOBES, schedule, fixed={"base_color": truth["base_color"]})
    first.step(iterations=30)
    before = float64_error(domain, TWO_LOBES, first.maps().values)[domain.solvable]
    second = first.reconfigure(schedule.replaced(**change))
    assert (second.progress.iteration >= 0) == (change == {"start": "random"})
    second.step(iterations=0)
    found = second.maps()
    after = float64_error(domain, TWO_LOBES, found.values)[domain.solvable]
    # Swarms go by the robust fitness, so that single texels may get a little worse in the mean error.
    assert after.mean() <= before.mean() * 1.01 and (after <= before * 1.5).mean() > 0.98
    np.testing.assert_array_equal(found.values["base_color"][domain.solvable], truth["base_color"][domain.solvable])
    second.step()
    assert float64_error(domain, TWO_LOBES, second.maps().values)[domain.solvable].mean() < before.mean()
    second.close()


def test_another_fitness_reweights_the_samples(recover):
    domain = observed(LAMBERT)
    schedule = SHORT.replaced(start="lambert", shadow=0.0)
    first = recover(domain, LAMBERT, schedule)
    first.step(iterations=4)
    other = schedule.replaced(shadow=0.4, scale_percentile=50.0)
    second, wanted = first.reconfigure(other), recover(domain, LAMBERT, other)
    for recovery in (second, wanted):
        recovery.step(iterations=0)
    scales = [r._textures.scale for r in (first, second, wanted)]
    np.testing.assert_array_equal(scales[1], scales[2])
    assert (scales[0] != scales[1]).any()
    with second.view() as lent:
        assert lent["u_stack"] is not first._textures.textures["u_stack"]
    assert second.mean_error() != pytest.approx(first.mean_error(), rel=1e-3)  # other samples count
    second.close()


@pytest.mark.parametrize(
    ("change", "word"), [({"search": ["glitter"]}, "glitter"), ({"update": "all", "particles": 99}, "particles")]
)
def test_unsuitable_settings_leave_the_run_unchanged(whole, recover, change, word):
    domain, model, schedule, wanted = whole
    recovery = recover(domain, model, schedule)
    recovery.step(iterations=2)
    with pytest.raises(InputError, match=word):
        recovery.reconfigure(schedule.replaced(**change))
    with pytest.raises(InputError, match="levels"):
        recovery.reconfigure(dataclasses.replace(schedule, levels=2))
    recovery.step()
    assert bits_of(recovery.maps()) == wanted


def test_a_finished_run_stays_finished_without_new_work(whole, recover):
    domain, model, schedule, wanted = whole
    first = recover(domain, model, schedule)
    first.step()
    second = first.reconfigure(schedule.replaced(c1=0.7))
    assert second.progress.done and bits_of(second.maps()) == wanted
    second.close()


def test_a_pyramid_is_reconfigured_at_its_current_level(recover):
    domain, _ = subject(24, 20, observations=8)
    schedule = SHORT.replaced(iterations=6, levels=2, level_iterations=0.5)
    with Pyramid(domain, LAMBERT, schedule, 1, entry="fragment") as whole:
        whole.step()
        wanted = bits_of(whole.maps())
    first = Pyramid(domain, LAMBERT, schedule, 1, entry="fragment")
    first.step(iterations=2)
    second = first.reconfigure(schedule)
    first.close()
    assert second.mean_error() >= 0 and second.refresh_confidence()
    second.step()
    assert bits_of(second.maps()) == wanted
    with pytest.raises(InputError, match="levels = 1"):
        second.reconfigure(schedule.replaced(levels=1))
    second.close()


def test_a_tiled_run_measures_its_error_in_slices_and_refuses_reconfiguration(monkeypatch):
    monkeypatch.setattr("irpso_addon.solver.engine.lockstep.BAND_SECONDS", 1e-6)  # these tiles are small
    domain, _ = subject(16, 16, holes=False, observations=6)
    boxes = [(0, 0, 16, 8), (0, 8, 16, 8)]
    with Recovery(domain, LAMBERT, SHORT, 1, entry="fragment") as whole:
        whole.step()
        wanted, error = bits_of(whole.maps()), whole.mean_error()
    with TiledRecovery(domain, LAMBERT, SHORT, 1, entry="fragment", boxes=boxes, halo=2) as tiled:
        tiled.step(iterations=0)
        calls = 0
        while not tiled.step(time_budget_s=1e-6).done:
            calls += 1
        assert calls > 3 * 2 * 12  # it stops between bands, not only between iterations
        assert bits_of(tiled.maps()) == wanted
        assert tiled.mean_error() == pytest.approx(error, rel=1e-5)
        with pytest.raises(InputError, match="in tiles"):
            tiled.reconfigure(SHORT)
