"""Recoveries: the same maps bit for bit however they are stepped, tiled or interrupted."""

import dataclasses
import os

import numpy as np
import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.geometry.domain import tile
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiles import TileRecovery
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.domains import SHORT, bits_of, recoveries, run_tiled, subject

LAMBERT = load_model("lambert")
TWO_LOBES = load_model("cook_torrance_two_lobe")
recover = pytest.fixture(recoveries)


# ---- lock step ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole():
    """(domain on a mesh, two-stage schedule, the maps of an uninterrupted recovery of it, its evaluations)."""
    domain, _ = subject(card=False)
    schedule = load_schedule("paper").replaced(iterations=12, cycles=1, neighbourhood=5, c3=0.3, particles=6)
    with Recovery(domain, LAMBERT, schedule, 1, entry="fragment") as recovery:
        progress = recovery.step()
        assert progress.done and progress.fraction == 1
        return domain, schedule, bits_of(recovery.maps()), progress.evaluations


def one_by_one(recovery):
    while not recovery.step(iterations=1).done:
        pass


def in_uneven_steps(recovery):
    for n in (0, 5, 0, 9, 1):
        recovery.step(iterations=n)
    recovery.step()


def in_tiny_slices(recovery):
    slices = 0
    while not recovery.step(time_budget_s=1e-6).done:
        slices += 1
    assert slices > 2 * (12 + 6)


def in_slices_with_looks_between(recovery):
    slices = 0
    while not recovery.step(time_budget_s=1e-6).done:
        slices += 1
        if slices % 7 == 0:
            recovery.maps()
        elif slices % 11 == 0:
            with recovery.view() as lent:
                assert "u_estimate_0" in lent


def in_slices_of_iterations(recovery):
    while not recovery.step(iterations=2, time_budget_s=0.01).done:
        pass


@pytest.mark.parametrize(
    "drive", [one_by_one, in_uneven_steps, in_tiny_slices, in_slices_with_looks_between, in_slices_of_iterations]
)
def test_stepping_does_not_change_the_maps(whole, recover, drive):
    domain, schedule, wanted, evaluations = whole
    recovery = recover(domain, schedule=schedule)
    drive(recovery)
    assert recovery.progress.done and recovery.progress.evaluations == evaluations
    assert bits_of(recovery.maps()) == wanted


def test_a_step_makes_the_requested_iterations(whole, recover):
    domain, schedule, _, evaluations = whole
    recovery = recover(domain, schedule=schedule)
    assert recovery.step(iterations=0).iteration == 0
    assert recovery.step(iterations=1).iteration == 1
    assert recovery.step(iterations=7).iteration == 8
    progress = recovery.step(iterations=6)
    assert (progress.stage, progress.iteration) == (1, 2)
    assert progress.fraction == pytest.approx((6 + 12 + 6 + 2) / (2 * (6 + 12)))  # six particles are placed first
    assert progress.stage_end == pytest.approx(1)
    assert recovery.step().evaluations == evaluations == 2 * (6 + 12) * domain.solvable.sum()
    assert recovery.step(iterations=5).done


def test_another_seed_gives_other_maps_and_the_same_gives_the_same(whole, recover):
    domain, schedule, wanted, _ = whole
    found = []
    for seed in (1, 2):
        recovery = recover(domain, schedule=schedule, seed=seed)
        recovery.step()
        found.append(bits_of(recovery.maps()))
    assert found[0] == wanted and found[1] != wanted


@pytest.mark.parametrize("seed", [2**31, -(2**31) - 1, 1.5, "a", None])
def test_a_seed_that_the_gpu_cannot_hold_is_refused(recover, seed):
    with pytest.raises(InputError, match="^seed: must be a whole number from -2147483648 to 2147483647, not"):
        recover(subject(5, 4)[0], seed=seed)


def test_the_outermost_seeds_are_taken(recover):
    for seed in (2**31 - 1, -(2**31)):
        assert recover(subject(5, 4)[0], seed=seed).step().done


@pytest.mark.parametrize(("window", "entry"), [(3, "fragment"), (5, "fragment"), (5, "compute")])
def test_tiles_that_exchange_their_bests_are_the_whole_bit_for_bit(recover, window, entry):
    domain, _ = subject(card=False)
    schedule = SHORT.replaced(neighbourhood=window, c3_fade=0.0)
    untiled = recover(domain, schedule=schedule, entry=entry)
    untiled.step()
    assert run_tiled(domain, LAMBERT, schedule, window // 2, entry) == bits_of(untiled.maps())


def test_tiles_of_several_stages_are_the_whole_bit_for_bit(whole, recover):
    domain, schedule, wanted, _ = whole
    assert run_tiled(domain, LAMBERT, schedule, 2) == wanted


def test_a_tile_reports_when_it_reads_neighbours():
    schedule = SHORT.replaced(neighbourhood=5, c3_fade=0.5, neighbour_interval=5)
    with TileRecovery(subject(5, 4)[0], LAMBERT, schedule, 1, entry="fragment") as recovery:
        found = [recovery.stencil_radius]
        for _ in range(12):
            recovery.step(iterations=1)
            found.append(recovery.stencil_radius)
    # Nothing while swarms are placed, the window's while Eq. 4 counts, one texel in every fifth iteration.
    assert found == [0] + [2] * 5 + [0, 0, 0, 1, 0, 0, 0]


def test_a_received_halo_moves_no_own_texel():
    domain, _ = subject()
    part = tile(domain, 3, 3, 6, 6, halo=2)
    with TileRecovery(part, LAMBERT, SHORT, 1, entry="fragment") as recovery:
        recovery.step(iterations=3)
        before = recovery.halo()
        recovery.set_halo(np.full_like(before, 0.25))
        after, evaluations = recovery.halo(), recovery.progress.evaluations
    own = np.zeros(part.shape, bool)
    own[2:-2, 2:-2] = True
    np.testing.assert_array_equal(after[own], before[own])
    assert (after[~own & part.solvable] == 0.25).all()
    assert evaluations == (6 + 3) * (own & part.solvable).sum()


# ---- checkpoints -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", ["fragment", "compute"])
@pytest.mark.parametrize("stop", [0, 1, 7, 11, 12, 13, 23])
def test_a_run_resumes_from_a_checkpoint_bit_for_bit(whole, recover, tmp_path, stop, entry):
    domain, schedule, wanted, evaluations = whole
    path = tmp_path / "run.irpso"
    first = recover(domain, schedule=schedule, entry=entry)
    first.step(iterations=stop)
    first.save(path)
    second = recover(domain, schedule=schedule, entry=entry)
    second.step(iterations=3)
    second.load(path)
    assert second.progress == first.progress
    second.step()
    first.step()
    assert bits_of(second.maps()) == bits_of(first.maps())
    assert second.progress.evaluations == evaluations
    if entry == "fragment":
        assert bits_of(second.maps()) == wanted
    assert os.listdir(tmp_path) == ["run.irpso"]


@pytest.mark.parametrize("slices", [1, 5, 40])
def test_a_checkpoint_within_an_iteration_resumes_bit_for_bit(whole, recover, tmp_path, slices):
    domain, schedule, wanted, _ = whole
    path = tmp_path / "run.irpso"
    first = recover(domain, schedule=schedule)
    for _ in range(slices):
        first.step(time_budget_s=1e-6)
    first.save(path)
    second = recover(domain, schedule=schedule)
    second.step(time_budget_s=1e-6)
    second.load(path)
    for recovery in (first, second):
        recovery.step()
        assert bits_of(recovery.maps()) == wanted


def test_a_finished_run_loads_as_finished(whole, recover, tmp_path):
    domain, schedule, wanted, _ = whole
    first = recover(domain, schedule=schedule)
    first.step()
    first.save(tmp_path / "run.irpso")
    second = recover(domain, schedule=schedule)
    second.load(tmp_path / "run.irpso")
    assert second.step().done and bits_of(second.maps()) == wanted


def test_a_refused_checkpoint_leaves_the_run_unchanged(whole, recover, tmp_path):
    domain, schedule, wanted, _ = whole
    path = tmp_path / "run.irpso"
    other = recover(domain, schedule=schedule, seed=2)
    other.step(iterations=4)
    other.save(path)
    data = path.read_bytes()
    recovery = recover(domain, schedule=schedule)
    recovery.step(iterations=5)
    for content, word in ((data, "seed"), (data[: len(data) // 2], "damaged"), (b"x", "damaged")):
        path.write_bytes(content)
        with pytest.raises(InputError, match=word):
            recovery.load(path)
    moved = dataclasses.replace(domain, bake=dataclasses.replace(domain.bake, position=domain.bake.position + 1))
    other = recover(moved, schedule=schedule)
    other.save(path)
    with pytest.raises(InputError, match="geometry differ"):
        recovery.load(path)
    other = recover(domain, schedule=schedule, fixed={"base_color": np.array([0.5, 0.5, 0.5])})
    other.save(path)
    with pytest.raises(InputError, match="fixed differ"):
        recovery.load(path)
    recovery.step()
    assert bits_of(recovery.maps()) == wanted
    assert os.listdir(tmp_path) == ["run.irpso"]
