"""The convergence of a recovery in tiles that take turns: that of the whole, without another turn."""

import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine import tiles
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.engine.tiles import TileRecovery
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.solver.views.history import History
from tests.builders.domains import SHORT, subject

LAMBERT = load_model("lambert")
BOXES = [(0, 0, 8, 4), (0, 4, 3, 5), (3, 4, 5, 5)]
STAGES = load_schedule("paper").replaced(iterations=30, cycles=2, particles=4, c3=0.3, neighbour_interval=7)
THRESHOLD = SHORT.replaced(iterations=200, cycles=2, loss="l1", threshold=0.2, c3=0.0, neighbour_interval=30)


def turns_of(domain, schedule):
    return TiledRecovery(domain, LAMBERT, schedule, 1, entry="fragment", boxes=BOXES, halo=2, on_device=1)


def driven(recovery, history, budget=None):
    while not recovery.step(history.until_next(None), budget).done:
        history.record_due()
    history.record_due()
    return history.arrays


@pytest.mark.parametrize("schedule", [STAGES, THRESHOLD], ids=["stages", "threshold"])
def test_tiles_that_take_turns_note_the_errors_of_the_whole(schedule, monkeypatch):
    domain, truth = subject(9, 8, holes=False)
    with Recovery(domain, LAMBERT, schedule, 1, entry="fragment") as whole:
        wanted = driven(whole, History(whole, truth))
    assert set(wanted) == {"iterations", "residual", "normal", "base_color"} and len(wanted["iterations"]) > 4
    turns = []
    monkeypatch.setattr(tiles, "TileRecovery", lambda *given: turns.append(None) or TileRecovery(*given))
    counts = []
    for watched in (False, True):
        turns.clear()
        with turns_of(domain, schedule) as recovery:
            if watched:
                found = driven(recovery, History(recovery, truth), 1e-3)
            else:
                recovery.step()
        counts.append(len(turns))
    assert counts[0] == counts[1], "to look takes no turn"
    assert set(found) == set(wanted)
    for name, values in wanted.items():
        np.testing.assert_array_equal(found[name], values, name)


@pytest.mark.parametrize("stop", [1, 10, 31])
def test_records_continue_from_a_checkpoint(stop, tmp_path):
    domain, truth = subject(9, 8, holes=False)
    with turns_of(domain, STAGES) as recovery:
        wanted = driven(recovery, History(recovery, truth))
    with turns_of(domain, STAGES) as recovery:
        history = History(recovery, truth)
        recovery.step(stop)
        history.record_due()
        recovery.save(tmp_path / "run.npz", history.arrays)
    with turns_of(domain, STAGES) as recovery:
        history = History(recovery, truth)
        history.take(recovery.load(tmp_path / "run.npz"))
        found = driven(recovery, history)
    assert found.keys() == wanted.keys()
    for name, values in wanted.items():
        np.testing.assert_array_equal(found[name], values, name)


@pytest.mark.parametrize("before", [False, True])
def test_a_truth_may_be_added_or_dropped_when_a_run_continues(before, tmp_path):
    domain, truth = subject(9, 8, holes=False)
    with Recovery(domain, LAMBERT, STAGES, 1, entry="fragment") as recovery:
        history = History(recovery, truth if before else None)
        for _ in range(3):
            recovery.step(history.until_next(None))
            history.record_due()
        recovery.save(tmp_path / "run.npz", history.arrays)
    with Recovery(domain, LAMBERT, STAGES, 1, entry="fragment") as recovery:
        history = History(recovery, None if before else truth)
        history.take(recovery.load(tmp_path / "run.npz"))
        found = driven(recovery, history)
        assert np.isfinite(history.picture(recovery.maps())).all()
    assert set(found) == {"iterations", "residual"} | (set() if before else {"normal", "base_color"})
    assert {len(errors) for errors in found.values()} == {len(found["iterations"])}
    assert np.isfinite(found["residual"]).all()
    if not before:
        assert np.isnan(found["normal"]).all(axis=1).tolist() == [True] * 3 + [False] * (len(found["normal"]) - 3)


def test_steps_end_with_a_round_so_that_checkpoints_take_no_turn():
    domain, _ = subject(9, 8, holes=False)
    with turns_of(domain, STAGES) as recovery:
        settled = 0
        while not recovery.step(None, 1e-3).done:
            settled += recovery.settled
    assert settled > 6


@pytest.mark.parametrize("entry", ["fragment", "compute"])
def test_a_record_is_what_the_maps_have(entry):
    domain, _ = subject(9, 8, holes=True)
    rows, columns = (found[::7] for found in np.nonzero(domain.solvable))
    with Recovery(domain, LAMBERT, STAGES, 1, entry=entry) as recovery:
        for iterations in (1, 20, 31):
            recovery.step(iterations)
            record = recovery.record(rows, columns)
            maps = recovery.maps(confidence=False)
            np.testing.assert_array_equal(record.residual, maps.residual[rows, columns])
            for name, values in record.values.items():
                np.testing.assert_array_equal(values, maps.values[name][rows, columns])
