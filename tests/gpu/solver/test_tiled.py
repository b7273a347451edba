"""Recoveries tile by tile: the maps of the whole domain, bit for bit, whatever the tiles and wherever they wait."""

import functools
import sys
from itertools import permutations

import numpy as np
import pytest

from irpso_addon.gpu import textures
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine import engine, tiles
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.engine.tiles import TileRecovery
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.planning.memory import Memory
from irpso_addon.solver.planning.plan import Limits, device_bytes, plan_recovery
from irpso_addon.solver.settings.refinement_groups import Refinement
from irpso_addon.solver.settings.schedule import load_schedule
from tests.builders.domains import SHORT, masked, subject

TWO_LOBES = load_model("cook_torrance_two_lobe")
LAMBERT = load_model("lambert")
# Ragged, with one of a single texel and one (at the lower left) in which nothing is covered.
BOXES = [(0, 0, 2, 3), (2, 0, 5, 3), (0, 3, 7, 2), (7, 0, 10, 5), (0, 5, 5, 8), (5, 5, 11, 3), (16, 5, 1, 1),
         (16, 6, 1, 2), (5, 8, 11, 5), (16, 8, 1, 5)]  # fmt: skip
FEW = [(0, 0, 2, 3), (2, 0, 15, 3), (0, 3, 17, 10)]
# These read texels 8 away: tests/gpu/solver/test_indirect_shadow.py, test_surface.py.
NARROW = load_schedule("standard").replaced(prefit_indirect_shadow=0.0, prefit_sheen_gain=0.0, surface_rounds=0)
SCHEDULES = {
    "one particle at a time": SHORT.replaced(neighbour_interval=3),
    "wide window": SHORT.replaced(neighbourhood=5, c3_fade=0.0, start="lambert"),
    "several stages": load_schedule("paper").replaced(iterations=6, cycles=2, particles=4, c3=0.3, search=["normal"]),
    "standard": NARROW.replaced(iterations=8, materials_rounds=0, prior_rounds=0),
    "materials": load_schedule("standard").replaced(
        iterations=2,
        prefit_iterations=0,
        prior_rounds=0,
        surface_rounds=0,
        refinement_iterations=2,
        refinement_rounds=0,
        materials_iterations=3,
    ),
    "refinement": NARROW.replaced(
        iterations=6, materials_rounds=0, prior_rounds=0, refinement=Refinement(iterations=3, rounds=2)
    ),
}


def everything(maps):
    """Return all arrays of maps as bytes."""
    arrays = {**maps.values, "covered": maps.solved, "residual": maps.residual}
    arrays |= {f"{name} σ": a for name, a in (maps.confidence or {}).items()}
    arrays |= {f"{name} elsewhere": a for name, a in (maps.alternatives or {}).items()}
    return {name: np.ascontiguousarray(array).tobytes() for name, array in arrays.items()}


def with_hole(**options):
    domain, _ = subject(**options)
    rows, columns = np.indices(domain.shape)
    return masked(domain, (rows >= 3) | (columns >= 2))


def whole_of(domain, schedule, entry="fragment", model=TWO_LOBES, **options):
    """Return (all arrays of the maps, progress) of a recovery of the whole domain at once."""
    with Recovery(domain, model, schedule, 1, entry=entry, **options) as whole:
        progress = whole.step()
        return everything(whole.maps()), progress


def tiled(domain, schedule, boxes=BOXES, entry="fragment", halo=2, model=TWO_LOBES, resident=True, **options):
    options = {"on_device": None if resident else 1, **options}
    return TiledRecovery(domain, model, schedule, 1, entry=entry, boxes=boxes, halo=halo, **options)


@functools.cache
def known(name, card=False):
    """Return (domain, all arrays of its maps, progress) of a recovery at once, made once: (13, 17) texels."""
    domain = with_hole(model="cook_torrance_two_lobe", card=card, observations=12)
    return domain, *whole_of(domain, SCHEDULES[name])


# A card has one frame for all of its texels, so less that is cut than a mesh.
@pytest.mark.parametrize(("name", "card"), [*((name, False) for name in SCHEDULES), ("standard", True)])
def test_tiles_give_the_maps_of_the_whole_bit_for_bit(name, card):
    domain, wanted, progress = known(name, card)
    with tiled(domain, SCHEDULES[name]) as recovery:
        assert recovery.step() == progress
        assert everything(recovery.maps()) == wanted


@pytest.mark.parametrize(("name", "on_scratch"), [*((name, True) for name in SCHEDULES), ("standard", False)])
def test_swapped_tiles_give_the_maps_of_the_whole_bit_for_bit(name, on_scratch, tmp_path):
    domain, wanted, progress = known(name)
    with tiled(domain, SCHEDULES[name], FEW, resident=False, scratch=tmp_path if on_scratch else None) as recovery:
        assert recovery.step() == progress
        assert everything(recovery.maps()) == wanted
        assert sum(part.recovery is not None for part in recovery._pool.tiles) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("card", "resident"), [(True, True), (False, False)])
def test_a_prior_with_a_reach_beyond_its_tile_equals_the_whole(card, resident):
    domain = with_hole(model="cook_torrance_two_lobe", card=card, observations=12)
    schedule = NARROW.replaced(iterations=2, prior_rounds=2, prior_scales=2)
    cost = recovery_cost(TWO_LOBES, schedule, (), 12)
    assert cost.stencil_radius == 4
    wanted, progress = whole_of(domain, schedule)
    boxes = FEW if resident else [(0, 0, 9, 13), (9, 0, 8, 13)]
    with tiled(domain, schedule, boxes, halo=cost.stencil_radius, resident=resident) as recovery:
        assert recovery.step() == progress
        assert everything(recovery.maps()) == wanted


@pytest.mark.parametrize("on_device", [2, 4])
def test_the_allowed_number_of_tiles_stays_on_the_device(on_device):
    domain = with_hole(card=False)
    wanted, progress = whole_of(domain, SCHEDULES["wide window"], model=LAMBERT)
    boxes = [(0, 0, 9, 6), (9, 0, 8, 6), (0, 6, 4, 7), (4, 6, 5, 7), (9, 6, 8, 7)]
    with tiled(domain, SCHEDULES["wide window"], boxes, model=LAMBERT, on_device=on_device) as recovery:
        while not recovery.step(iterations=1).done:
            assert sum(part.recovery is not None for part in recovery._pool.tiles) == on_device
        assert recovery.progress == progress and recovery.capabilities.turns
        assert everything(recovery.maps()) == wanted


def test_compute_dispatches_over_tiles_give_the_maps_of_the_whole(tmp_path):
    domain = with_hole(model="cook_torrance_two_lobe", observations=12)
    wanted, _ = whole_of(domain, SCHEDULES["standard"], "compute")
    with tiled(domain, SCHEDULES["standard"], FEW, "compute", resident=False) as recovery:
        recovery.step()
        assert everything(recovery.maps()) == wanted


@pytest.mark.parametrize(
    ("resident", "name"), [(True, "wide window"), (False, "wide window"), (True, "several stages"), (False, "standard")]
)
def test_time_slices_and_reads_change_nothing(resident, name, monkeypatch):
    monkeypatch.setattr("irpso_addon.solver.engine.lockstep.BAND_SECONDS", 1e-9)  # the smallest bands on any machine
    domain = with_hole(card=False)
    wanted, progress = whole_of(domain, SCHEDULES[name], model=LAMBERT)
    with tiled(domain, SCHEDULES[name], FEW, resident=resident, model=LAMBERT) as recovery:
        fractions, slices, placing = [0.0], 0, []
        while not (now := recovery.step(time_budget_s=1e-6)).done:
            slices += 1
            fractions.append(now.fraction)
            placing += [now.fraction] * (now.iteration < 0)
            if now.iteration >= 0 and slices % 10 == 0:  # maps() ends what is under way
                recovery.maps(confidence=False)
        assert slices > 12 and np.diff(fractions).min() > -1e-12
        assert len(set(placing)) > len(FEW)  # it rises before the first iteration, and inside a tile
        assert recovery.progress == progress
        assert everything(recovery.maps()) == wanted


def test_tiles_that_take_turns_show_where_they_are_without_another_turn(monkeypatch):
    domain, schedule = with_hole(model="cook_torrance_two_lobe", observations=12), SCHEDULES["refinement"]
    turns, free = [], 0
    with (
        Recovery(domain, TWO_LOBES, schedule, 1, entry="fragment") as whole,
        tiled(domain, schedule, FEW, resident=False) as recovery,
    ):
        monkeypatch.setattr(tiles, "TileRecovery", lambda *given: turns.append(None) or TileRecovery(*given))
        done = False
        while not done:
            done = whole.step(2).done
            assert recovery.step(2).done == done
            before = len(turns)
            shown, wanted = recovery.maps(confidence=False), whole.maps(confidence=False)
            free += len(turns) == before
            for name, value in wanted.values.items():
                np.testing.assert_array_equal(shown.values[name], value)
            np.testing.assert_array_equal(shown.residual, wanted.residual)
        assert everything(recovery.maps()) == everything(whole.maps())
    assert free > 3


def test_a_tiled_step_makes_the_requested_iterations():
    with tiled(
        with_hole(), SHORT.replaced(c3=0.0, neighbour_interval=0), FEW, resident=False, model=LAMBERT
    ) as recovery:
        assert (recovery.step(iterations=0).iteration, recovery.progress.evaluations > 0) == (0, True)
        assert recovery.step(iterations=1).iteration == 1
        assert recovery.step(iterations=7).iteration == 8
        assert recovery.step(iterations=9).done


# stop None: before the first step
@pytest.mark.parametrize(
    ("how", "stop"), [*(("turns", stop) for stop in (None, 0, 3, 6, 7)), ("resident", 6), ("scratch", 7)]
)
def test_tiles_resume_from_a_checkpoint_bit_for_bit(how, stop, tmp_path):
    domain = with_hole(card=False)
    schedule = SCHEDULES["several stages"].replaced(neighbour_interval=2)
    wanted, progress = whole_of(domain, schedule, model=LAMBERT)
    options = {"resident": how == "resident", "scratch": tmp_path if how == "scratch" else None, "model": LAMBERT}
    with tiled(domain, schedule, FEW, **options) as first:
        if stop is not None:
            first.step(iterations=stop)
        first.save(tmp_path / "run.npz", {"mark": np.arange(3)})
        before = first.progress
    with tiled(domain, schedule, FEW, **options) as second:
        second.step(iterations=2)
        np.testing.assert_array_equal(second.load(tmp_path / "run.npz")["mark"], np.arange(3))
        assert second.progress == before
        assert second.step() == progress
        assert everything(second.maps()) == wanted
        second.save(tmp_path / "run.npz")
    with tiled(domain, schedule, FEW, **options) as third:
        third.load(tmp_path / "run.npz")
        assert third.progress.done and everything(third.maps()) == wanted


@pytest.mark.parametrize("most", [0, engine._MAX_RUNNING], ids=["begin of the stage", "all"])
@pytest.mark.parametrize("name", ["several stages", "materials", "refinement"])
def test_a_checkpoint_does_not_depend_on_the_tiles(name, most, tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "_MAX_RUNNING", most)
    (domain, wanted, progress), schedule = known(name), SCHEDULES[name]
    makes = {
        "whole": lambda: Recovery(domain, TWO_LOBES, schedule, 1, entry="fragment"),
        "tiles": lambda: tiled(domain, schedule, FEW),
        "turns": lambda: tiled(domain, schedule, BOXES, resident=False, scratch=tmp_path),
    }
    for stop, (first, second) in enumerate(permutations(makes, 2), 3):
        with makes[first]() as recovery:
            recovery.step(iterations=stop)
            assert recovery.save(tmp_path / "run.npz") == (most > 0)  # whether one that comes later holds more
        with np.load(tmp_path / "run.npz") as file:
            assert any(array.startswith("phase_") for array in file.files) == (most > 0)
        with makes[second]() as recovery:
            recovery.load(tmp_path / "run.npz")
            assert recovery.step() == progress and everything(recovery.maps()) == wanted, (first, second, stop)


@pytest.mark.parametrize("how", ["tiles", "turns"])
def test_tiles_resume_within_the_shared_materials(how, tmp_path):
    (domain, wanted, progress), schedule = known("materials"), SCHEDULES["materials"]

    def make():
        return tiled(domain, schedule, FEW, resident=how == "tiles")

    with make() as recovery:
        while recovery.progress.title != "shared materials" or recovery.progress.iteration < 2:
            recovery.step(iterations=1)
        recovery.save(tmp_path / "run.npz")
    with make() as recovery:
        recovery.load(tmp_path / "run.npz")
        assert recovery.step() == progress and everything(recovery.maps()) == wanted


@pytest.mark.parametrize(("resident", "threshold"), [(True, 0.06), (False, 0.2)])
def test_tiles_stop_at_the_threshold_when_the_whole_does(resident, threshold):
    domain, _ = subject(9, 8, holes=False)
    schedule = SHORT.replaced(iterations=400, cycles=2, loss="l1", threshold=threshold, c3=0.0, neighbour_interval=30)
    wanted, progress = whole_of(domain, schedule, model=LAMBERT)
    texels = 72
    assert progress.evaluations < 2 * (400 + 6) * texels
    boxes = [(0, 0, 8, 4), (0, 4, 3, 5), (3, 4, 5, 5)]
    with tiled(domain, schedule, boxes, resident=resident, model=LAMBERT) as recovery:
        assert recovery.step() == progress
        assert everything(recovery.maps()) == wanted


def test_known_maps_are_cut_with_their_tiles():
    domain, truth = subject(card=False)
    fixed = {"normal": truth["normal"]}
    wanted, _ = whole_of(domain, SHORT, model=LAMBERT, fixed=fixed)
    with tiled(domain, SHORT, model=LAMBERT, fixed=fixed) as recovery:
        recovery.step()
        assert everything(recovery.maps()) == wanted


def test_a_halo_narrower_than_the_reach_and_tiles_with_gaps_are_refused():
    domain = with_hole()
    with (
        tiled(domain, SCHEDULES["wide window"], halo=1, model=LAMBERT) as recovery,
        pytest.raises(ValueError, match="2"),
    ):
        recovery.step()
    for boxes in (FEW[:-1], [*FEW, (3, 3, 2, 2)]):
        with pytest.raises(ValueError, match="one of them"):
            tiled(domain, SHORT, boxes, model=LAMBERT)


@pytest.fixture
def device(monkeypatch):
    """Return how many bytes of textures there have been at once since the last time of asking."""
    made, peak, original = [], [0], textures._texture

    def counted(width, height, layers=0, **properties):
        texture = original(width, height, layers, **properties)
        made.append((texture, width * height * max(1, layers) * 4 * textures.CHANNELS[properties["format"]]))
        # Two references: this list's and the argument's. What has no other is gone but for the counting.
        made[:] = [item for item in made if item[0] is texture or sys.getrefcount(item[0]) > 2]
        peak[0] = max(peak[0], sum(size for _, size in made))
        return texture

    def take_peak():
        made.clear()
        found, peak[0] = peak[0], 0
        return found

    monkeypatch.setattr(textures, "_texture", counted)
    return take_peak


# Each is shaders of its own, of seconds to compile: models of the fewest and the most numbers, and one between.
PLANNED = [(preset, model, "fragment") for preset in ("swarm", "standard", "paper")
           for model in ("lambert", "cook_torrance_two_lobe")]  # fmt: skip
PLANNED += [("standard", "principled", "fragment"), ("swarm", "lambert", "compute")]
PLANNED += [("standard", "cook_torrance_two_lobe", "compute")]


# With a single particle the refinement and the test of its results need most, not the swarms.
SINGLE_PARTICLE = {"particles": 1, "particles_per_dimension": 0.0}
PLANNED = [(*planned, {}) for planned in PLANNED]
PLANNED += [("standard", "cook_torrance_two_lobe", "fragment", SINGLE_PARTICLE)]


@pytest.mark.parametrize(("preset", "model", "entry", "changes"), PLANNED)
def test_the_plan_expects_the_bytes_that_textures_take(preset, model, entry, changes, device):
    model, schedule = load_model(model), load_schedule(preset).without_rounds().replaced(iterations=2, cycles=1)
    schedule = schedule.replaced(**changes)
    domain, _ = subject(20, 20, holes=False, observations=12)
    domain = masked(domain, np.indices(domain.shape)[0] < 15)
    with Recovery(domain, model, schedule, 1, entry=entry) as recovery:
        while not recovery.progress.done:
            recovery.step(iterations=1)
            recovery.maps()
    cost = recovery_cost(model, schedule, (), 12, compute=entry == "compute")
    # Compute dispatches are read back through copies, which were not asked for here.
    copies = 306 * 16 * (1 + max(phase.atlas for phase in cost.phases)) if cost.compute else 0
    taken = device()
    assert taken <= device_bytes(300, 400, cost) <= 1.05 * taken + copies


@pytest.mark.parametrize("preset, budget", [("swarm", 3 << 20), ("standard", 7 << 19)])
def test_swapped_tiles_take_at_most_the_planned_bytes(preset, budget, device):
    domain, _ = subject(40, 40, holes=False, observations=12)
    schedule = load_schedule(preset).without_rounds().replaced(iterations=6)
    cost = recovery_cost(LAMBERT, schedule, (), 12)
    plan = plan_recovery(domain.solvable, cost, Memory(budget, 4 << 30), Limits(texture=150_000))
    assert len(plan.tiles) > plan.on_device > 1
    with tiled(domain, schedule, plan.boxes, halo=plan.halo, model=LAMBERT, on_device=plan.on_device) as recovery:
        recovery.step()
        recovery.maps()
    assert 0.5 * plan.device < device() <= plan.device <= budget


@pytest.mark.parametrize("tiles", [False, True], ids=["whole", "tiles"])
def test_a_stage_whose_settings_changed_is_stored_whole(tiles, tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "_MAX_RUNNING", 0)
    (domain, _, _), schedule, path = known("several stages"), SCHEDULES["several stages"], tmp_path / "run.npz"
    changed = schedule.replaced(c1=1.1)
    with Recovery(domain, TWO_LOBES, schedule, 1, entry="fragment") as recovery:
        recovery.step(iterations=2)
        other = recovery.reconfigure(changed)
    other.step(iterations=1)
    assert other.save(path)  # one that comes later holds more
    other.step()
    wanted = everything(other.maps())
    other.close()
    make = (
        (lambda: tiled(domain, changed, FEW))
        if tiles
        else (lambda: Recovery(domain, TWO_LOBES, changed, 1, entry="fragment"))
    )
    with make() as recovery:
        recovery.load(path)
        recovery.save(path)  # and again from there
    with make() as recovery:
        recovery.load(path)
        recovery.step()
        assert everything(recovery.maps()) == wanted


@pytest.mark.parametrize("tiles", [False, True], ids=["whole", "tiles"])
def test_a_stage_that_other_settings_restart_is_stored_before_its_swarms_are_placed(tiles, tmp_path):
    """Its swarms begin closer around the estimates than the settings say."""
    (domain, _, _), schedule, path = known("several stages"), SCHEDULES["several stages"], tmp_path / "run.npz"
    changed = schedule.replaced(particles=5)
    with Recovery(domain, TWO_LOBES, schedule, 1, entry="fragment") as recovery:
        recovery.step(iterations=2)
        other = recovery.reconfigure(changed)
    assert other.save(path)
    other.step()
    wanted = everything(other.maps())
    other.close()
    with tiled(domain, changed, FEW) if tiles else Recovery(domain, TWO_LOBES, changed, 1, entry="fragment") as again:
        again.load(path)
        again.step()
        assert everything(again.maps()) == wanted


def test_another_seed_holds_from_the_current_stage_on(tmp_path):
    (domain, _, _), schedule, path = known("several stages"), SCHEDULES["several stages"], tmp_path / "run.npz"
    with Recovery(domain, TWO_LOBES, schedule, 1, entry="fragment") as recovery:
        recovery.step(iterations=2)
        other = recovery.reconfigure(schedule, seed=2)
    other.step(iterations=1)
    assert other.save(path, running=True)
    other.step()
    wanted = everything(other.maps())
    other.close()
    with Recovery(domain, TWO_LOBES, schedule, 2, entry="fragment") as recovery:
        recovery.load(path)
        recovery.step()
        assert everything(recovery.maps()) == wanted


def test_a_recovery_that_is_done_goes_on_with_a_further_stage():
    domain, schedule = known("several stages")[0], SCHEDULES["several stages"]
    with Recovery(domain, TWO_LOBES, schedule, 1, entry="fragment") as recovery:
        assert recovery.step().done
        before, error = recovery.maps().values["normal"], recovery.mean_error()
        other = recovery.reconfigure(schedule.replaced(refinement=Refinement(iterations=3)))
    assert not other.progress.done and other.progress.title != ""
    assert other.step().done and other.mean_error() < error
    assert (other.maps().values["normal"] != before).any()
    other.close()
