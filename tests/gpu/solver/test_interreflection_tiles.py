"""Rounds of interreflection in tiles: the maps of the whole, bit for bit."""

from contextlib import closing
from functools import partial

import numpy as np
import pytest

from irpso_addon.blender.ray_caster import ray_caster_steps
from irpso_addon.geometry.light.interreflection_geometry import CardInterreflection
from irpso_addon.gpu import textures
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.engine.tiled import TiledRecovery
from irpso_addon.solver.interreflection.indirect_light import IndirectLight
from irpso_addon.solver.planning.cost import recovery_cost
from irpso_addon.solver.views.display import Shown
from irpso_addon.solver.views.tiled_view import display_of
from tests.builders.cavity import cap_card
from tests.builders.command_line import dome_lights
from tests.builders.rounds import LAMBERT, ROUNDS, SINGLE, matt_bowl, rounds_of, without_indirect

BOXES = [(0, 0, 23, 16), (23, 0, 41, 7), (23, 7, 41, 9)]


@pytest.fixture(scope="module")
def bowl():
    return matt_bowl()


@pytest.fixture(scope="module")
def whole(bowl):
    """(maps, progress, findings) of all rounds as a whole."""
    with rounds_of(bowl) as recovery:
        recovery.step()
        return recovery.maps(), recovery.progress, recovery.findings


def in_tiles(bowl, scratch=None, **options):
    """Return the rounds in tiles; with a folder for files they take turns."""
    reach = recovery_cost(LAMBERT, SINGLE, (), bowl[0].observations).stencil_radius
    tiles = {"boxes": BOXES, "halo": reach, "on_device": scratch and 1, "scratch": scratch}
    return rounds_of(bowl, solve=partial(TiledRecovery, **tiles), **options)


def all_bits_of(maps):
    """Return values, deviations, alternatives and residual of maps as bytes."""
    parts = {"values": maps.values, "deviations": maps.confidence, "alternatives": maps.alternatives}
    found = {(part, name): array.tobytes() for part, arrays in parts.items() for name, array in arrays.items()}
    return found | {"residual": maps.residual.tobytes()}


@pytest.mark.parametrize("turns", [False, True])
def test_rounds_in_tiles_find_the_maps_of_the_whole(bowl, whole, turns, tmp_path):
    with in_tiles(bowl, tmp_path if turns else None) as recovery:
        assert recovery.capabilities.turns == turns and recovery.tiles()
        assert recovery.step() == whole[1]
        assert all_bits_of(recovery.maps()) == all_bits_of(whole[0])
        assert recovery.findings == whole[2]


def test_matte_rounds_in_tiles_find_the_maps_of_the_whole(bowl):
    schedule = SINGLE.replaced(interreflection_matte_rounds=1)
    with rounds_of(bowl, schedule) as recovery, in_tiles(bowl, schedule=schedule) as tiled:
        assert tiled.step() == recovery.step()
        assert all_bits_of(tiled.maps()) == all_bits_of(recovery.maps())


def test_tiles_begin_with_the_materials_of_the_round_before(bowl):
    # Its roughness is searched: where the swarms begin shows in the maps. Lambert is solved in closed form.
    schedule = ROUNDS.replaced(iterations=2, prefit_iterations=2, materials_rounds=0, prior_rounds=0, surface_rounds=0,
                               refinement_iterations=2, refinement_rounds=0)  # fmt: skip
    found = []
    for make in (rounds_of, in_tiles):
        with make(bowl, schedule=schedule, model=load_model("metallic_roughness")) as recovery:
            recovery.step()
            found.append(all_bits_of(recovery.maps()))
    assert found[0] == found[1]


def test_slices_of_tiles_that_take_turns_change_nothing(bowl, whole, tmp_path):
    fractions = []
    with in_tiles(bowl, tmp_path) as recovery:
        while not recovery.step(7, 0.1).done:
            fractions.append(recovery.progress.fraction)
        assert all_bits_of(recovery.maps()) == all_bits_of(whole[0])
    assert fractions == sorted(fractions)
    assert not list(tmp_path.iterdir())


def test_tiles_that_take_turns_make_many_iterations_at_a_turn(bowl, monkeypatch, tmp_path):
    asked, step = [], TiledRecovery.step
    monkeypatch.setattr(TiledRecovery, "step", lambda self, n, budget: asked.append(n) or step(self, n, budget))
    with in_tiles(bowl, tmp_path) as recovery:
        assert recovery.step(7).iteration_in_all == 7
    assert asked == [7]


def test_a_window_shows_tiles_through_all_rounds(bowl):
    pictures, color, light = [], Shown("parameter", "base_color"), Shown("indirect", limit=1.0)
    for recovery in (rounds_of(bowl), in_tiles(bowl)):
        with recovery, closing(display_of(recovery)) as display:
            while not recovery.step(9).done:
                assert textures.download(display.picture(color))[..., :3].any()
            pictures.append([textures.download(display.picture(shown)).copy() for shown in (color, light)])
    np.testing.assert_array_equal(*pictures)
    assert np.ptp(pictures[0][1][..., 0]) > 0.1


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_run_in_tiles_resumes_as_a_whole_and_back(bowl, whole, share, tmp_path):
    makers = [lambda: in_tiles(bowl), lambda: rounds_of(bowl)]
    for begun, ended in (makers, makers[::-1]):
        with begun() as recovery:
            while recovery.progress.fraction < share:
                recovery.step(5)
            recovery.save(tmp_path / "checkpoint.npz")
        with ended() as recovery:
            recovery.load(tmp_path / "checkpoint.npz")
            recovery.step()
            assert all_bits_of(recovery.maps()) == all_bits_of(whole[0])


def test_a_card_in_tiles_has_the_relief_of_the_whole():
    domain, camera, _ = cap_card((0.8, 0.6, 0.4), dome_lights(24, 50.0), side=24)
    schedule, found = ROUNDS.replaced(interreflection_rounds=1), []
    boxes = [(0, 0, 24, 11), (0, 11, 13, 13), (13, 11, 11, 13)]
    for solve in (Recovery, partial(TiledRecovery, boxes=boxes, halo=16)):
        geometry = CardInterreflection(camera, "normal", ray_caster_steps, 24, 32)
        with rounds_of((domain, geometry), schedule, solve=solve) as recovery:
            recovery.step()
            found.append(all_bits_of(recovery.maps()))
    assert found[0] == found[1]


def test_the_warning_of_a_run_in_tiles_is_that_of_the_whole(bowl, monkeypatch, tmp_path):
    monkeypatch.setattr(IndirectLight, "strength", lambda self, radiance: 1.0)
    found, direct = [], without_indirect(bowl)
    for recovery in (rounds_of(direct), in_tiles(direct, tmp_path)):
        with recovery:
            recovery.step()
            found.append(recovery.warnings)
    assert found[0] == found[1] and found[0]
