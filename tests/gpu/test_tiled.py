"""Recoveries tile by tile: the maps of the whole domain, bit for bit, whatever the tiles and wherever they wait."""

import numpy as np
import pytest

from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.recovery import Recovery
from irpso_addon.solver.schedule import load_schedule
from irpso_addon.solver.tiled import TiledRecovery
from tests.swarm_subjects import SHORT, subject

TWO_LOBES = load_model("cook_torrance_two_lobe")
# Ragged, with one of a single texel and one (at the lower left) in which nothing is covered.
BOXES = [(0, 0, 2, 3), (2, 0, 5, 3), (0, 3, 7, 2), (7, 0, 10, 5), (0, 5, 5, 8), (5, 5, 11, 3), (16, 5, 1, 1),
         (16, 6, 1, 2), (5, 8, 11, 5), (16, 8, 1, 5)]  # fmt: skip
FEW = [(0, 0, 2, 3), (2, 0, 15, 3), (0, 3, 17, 10)]
SCHEDULES = {
    "one particle at a time": SHORT.replaced(neighbour_every=3),
    "wide window": SHORT.replaced(neighbourhood=5, c3_until=0.0, seed="lambert"),
    "several stages": load_schedule("paper").replaced(iterations=6, cycles=2, particles=4, c3=0.3, search=["normal"]),
    "standard": load_schedule("standard").replaced(iterations=8),
}


def everything(maps):
    """Return all arrays of maps as bytes."""
    arrays = {**maps.values, "covered": maps.covered, "residual": maps.residual}
    arrays |= {f"{name} σ": a for name, a in (maps.confidence or {}).items()}
    return {name: np.ascontiguousarray(array).tobytes() for name, array in arrays.items()}


def with_hole(**options):
    domain, _ = subject(**options)
    domain.bake.coverage[:3, :2] = False
    return domain


def whole_of(domain, schedule, entry="fragment", model=TWO_LOBES, **options):
    """Return (all arrays of the maps, progress) of a recovery of the whole domain at once."""
    with Recovery(domain, model, schedule, 1, entry=entry, **options) as whole:
        progress = whole.step()
        return everything(whole.maps()), progress


def tiled(domain, schedule, boxes=BOXES, entry="fragment", halo=2, model=TWO_LOBES, **options):
    return TiledRecovery(domain, model, schedule, 1, entry=entry, boxes=boxes, halo=halo, **options)


@pytest.mark.parametrize("card", [True, False], ids=["card", "mesh"])
@pytest.mark.parametrize("name", SCHEDULES)
def test_tiles_give_the_maps_of_the_whole_bit_for_bit(name, card):
    domain = with_hole(model="cook_torrance_two_lobe", card=card, observations=12)
    wanted, progress = whole_of(domain, SCHEDULES[name])
    with tiled(domain, SCHEDULES[name]) as recovery:
        assert recovery.step() == progress
        assert everything(recovery.maps()) == wanted


@pytest.mark.parametrize("on_scratch", [False, True])
@pytest.mark.parametrize("name", SCHEDULES)
def test_tiles_that_take_turns_on_the_device_do_so_too(name, on_scratch, tmp_path):
    domain = with_hole(model="cook_torrance_two_lobe", card=False, observations=12)
    wanted, progress = whole_of(domain, SCHEDULES[name])
    with tiled(domain, SCHEDULES[name], FEW, resident=False, scratch=tmp_path if on_scratch else None) as recovery:
        assert recovery.step() == progress
        assert everything(recovery.maps()) == wanted
        assert sum(part.recovery is not None for part in recovery._tiles) == 1
    assert not list(tmp_path.iterdir())
