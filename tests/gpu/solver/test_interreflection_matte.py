"""Matte rounds: the light that a mesh throws on itself, from its base colours alone."""

import numpy as np
import pytest

from irpso_addon.blender.ray_caster import ray_caster_steps
from irpso_addon.geometry.light.interreflection_geometry import CardInterreflection
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.interreflection.indirect_light import IndirectLight
from tests.builders.cavity import cap_card
from tests.builders.command_line import dome_lights
from tests.builders.domains import bits_of
from tests.builders.rounds import ALBEDO, LAMBERT, SINGLE, errors, matt_bowl, rounds_of, without_indirect


@pytest.fixture(scope="module")
def bowl():
    return matt_bowl()


def test_matte_rounds_find_them_with_one_recovery(bowl):
    schedule = SINGLE.replaced(interreflection_matte_rounds=2, interreflection_bounces=6)
    recovered = []

    def solve(*arguments, **more):
        recovered.append(arguments[2:5:2])
        return Recovery(*arguments, **more)

    with rounds_of(bowl, schedule, solve=solve) as recovery:
        recovery.step()
        maps, progress = recovery.maps(), recovery.progress
    assert [bool(schedule.prefit.iterations) for schedule, _ in recovered] == [False, False, True]
    tilt, colour = errors(maps)
    assert tilt < 1 and abs(colour - 1).max() < 0.03
    with Recovery(bowl[0], LAMBERT, SINGLE, 1, entry="fragment") as alone:
        alone.step()
        assert progress.evaluations < 1.2 * alone.progress.evaluations
    recovered.clear()
    with rounds_of(bowl, schedule, model=load_model("metallic_roughness"), solve=solve):
        assert sorted(recovered[0][1]) == ["metallic", "normal", "roughness", "specular"]


def test_a_run_resumes_in_and_after_matte_rounds(bowl, tmp_path):
    schedule = SINGLE.replaced(interreflection_matte_rounds=2, interreflection_rounds=1)
    with rounds_of(bowl, schedule) as recovery:
        for number in range(4):
            while recovery._at < number:
                recovery.step(2)
            recovery.save(tmp_path / f"{number}.npz")
        recovery.step()
        whole = bits_of(recovery.maps())
    for number in range(4):
        with rounds_of(bowl, schedule) as recovery:
            recovery.load(tmp_path / f"{number}.npz")
            recovery.step()
            assert bits_of(recovery.maps()) == whole


def make_shiny(bowl):
    """Make a quarter of a bowl send the light of half of the lamps alone, as lobes do; return it."""
    domain = bowl[0]
    quarter = domain.solvable & (np.arange(domain.shape[1]) < domain.shape[1] // 4)
    domain.stack.values[:, quarter, :3] *= np.resize([3, 0], len(domain.stack.values))[:, None, None]
    return bowl


def test_a_full_round_follows_where_surfaces_are_not_matte(tmp_path):
    matte, shiny = matt_bowl(), make_shiny(matt_bowl())
    schedule = SINGLE.replaced(interreflection_matte_rounds=1)
    found = []
    for bowl, rounds in ((matte, 0), (shiny, 0), (shiny, 1)):
        with rounds_of(bowl, schedule.replaced(interreflection_rounds=rounds)) as recovery:
            recovery.step()
            found.append((recovery._at, recovery.progress.stages, bits_of(recovery.maps())))
    assert [at for at, *_ in found] == [1, 2, 2]
    assert found[1] == found[2]
    with rounds_of(shiny, schedule) as recovery:
        for number in range(3):
            while recovery._at < number:
                recovery.step(2)
            recovery.save(tmp_path / f"{number}.npz")
    for number in range(3):
        with rounds_of(shiny, schedule) as recovery:
            recovery.load(tmp_path / f"{number}.npz")
            recovery.step()
            assert bits_of(recovery.maps()) == found[1][-1]


@pytest.mark.parametrize("subject", ["matte", "shiny", "dark"])
def test_the_fraction_does_not_step_back_between_rounds_whether_a_full_one_follows_or_not(subject):
    bowl = {"matte": matt_bowl, "shiny": lambda: make_shiny(matt_bowl()), "dark": lambda: without_indirect(matt_bowl())}
    fractions = {}
    with rounds_of(bowl[subject](), SINGLE.replaced(interreflection_matte_rounds=2)) as recovery:
        done = False
        while not done:
            progress = recovery.step(time_budget_s=0)
            done = progress.done
            fractions.setdefault(recovery._at, []).append(progress.fraction)
    for number in range(len(fractions) - 1):
        assert max(fractions[number]) <= min(fractions[number + 1])
    assert progress.fraction == 1 and max(fractions) == {"matte": 2, "shiny": 3, "dark": 1}[subject]


@pytest.mark.parametrize(("gloss", "recoveries"), [(0.02, 3), (0.15, 4)])
def test_a_full_round_follows_where_matte_surfaces_fit_badly(gloss, recoveries):
    bowl = matt_bowl()
    count = len(bowl[0].stack.values)
    bowl[0].stack.values[..., :3] *= np.resize([1 + gloss, 1 - gloss], count)[:, None, None, None]
    with rounds_of(bowl, SINGLE.replaced(interreflection_matte_rounds=2)) as recovery:
        recovery.step()
        assert recovery._at + 1 == recoveries


def between_rounds(recovery, number):
    """Step until the light of recovery ``number`` is being computed."""
    while recovery._at < number or recovery._transition is None:
        assert not recovery.step(time_budget_s=0).done


@pytest.mark.parametrize("subject", ["matte", "shiny", "not helped"])
def test_a_run_saved_or_changed_between_rounds_goes_on_as_if_it_were_not(subject, tmp_path, monkeypatch):
    bowl, schedule = matt_bowl(), SINGLE.replaced(interreflection_matte_rounds=2)
    if subject == "shiny":
        make_shiny(bowl)
    elif subject == "not helped":
        bowl = without_indirect(bowl)
        monkeypatch.setattr(IndirectLight, "strength", lambda self, radiance: 1.0)
    with rounds_of(bowl, schedule) as recovery:
        recovery.step()
        whole = bits_of(recovery.maps())
    for number in range(2):
        with rounds_of(bowl, schedule) as recovery:
            between_rounds(recovery, number)
            recovery.save(tmp_path / f"{number}.npz")
            changed = recovery.reconfigure(schedule)
            changed.step()
            assert bits_of(changed.maps()) == whole
        with rounds_of(bowl, schedule) as recovery:
            recovery.load(tmp_path / f"{number}.npz")
            recovery.step()
            assert bits_of(recovery.maps()) == whole


def test_a_changed_run_without_such_light_stays_a_whole_recovery():
    direct, schedule = without_indirect(matt_bowl()), SINGLE.replaced(interreflection_matte_rounds=2)
    found = []
    for change in (False, True):
        with rounds_of(direct, schedule) as recovery:
            while recovery._at == 0:
                recovery.step(1)
            live = recovery.reconfigure(schedule) if change else recovery
            live.step()
            found.append(bits_of(live.maps()))
    assert found[0] == found[1]


@pytest.mark.parametrize("rounds", [0, 1])
def test_matte_rounds_that_do_not_help_leave_the_photographs_as_they_are(rounds, monkeypatch):
    monkeypatch.setattr(IndirectLight, "strength", lambda self, radiance: 1.0)
    direct, plain = without_indirect(matt_bowl()), SINGLE.replaced(interreflection_rounds=rounds)
    found = []
    for schedule in (plain, plain.replaced(interreflection_matte_rounds=2)):
        with rounds_of(direct, schedule) as recovery:
            recovery.step()
            found.append(bits_of(recovery.maps()))
    assert found[0] == found[1]


def test_fixed_colours_and_cards_have_no_matte_rounds(bowl):
    schedule = SINGLE.replaced(interreflection_matte_rounds=2)
    domain, camera, _ = cap_card(ALBEDO, dome_lights(24, 50.0))
    card = domain, CardInterreflection(camera, "normal", ray_caster_steps, 40, 64)
    for subject, fixed in ((bowl, {"base_color": np.float32(ALBEDO)}), (card, {})):
        with rounds_of(subject, schedule, fixed) as recovery:
            stages = recovery.progress.stages
            assert not recovery.has_rounds
        with Recovery(subject[0], LAMBERT, SINGLE, 1, fixed, entry="fragment") as alone:
            assert stages == alone.progress.stages


def test_a_run_that_stops_in_a_round_says_that_its_normals_are_the_meshs(bowl):
    with rounds_of(bowl, SINGLE.replaced(interreflection_matte_rounds=1, interreflection_rounds=1)) as recovery:
        texts = []
        while not recovery.step(1).done:
            maps, texts = recovery.maps(), [*texts, *recovery.warnings[:1]]
            fixed = bool(recovery.warnings)
            unknown = maps.unknown()["normal"][maps.solved].mean()
            assert (unknown == 1) == fixed
            assert (maps.values["normal"] == (0, 0, 1)).all() == fixed
        assert {text[:25] for text in texts} == {f"stopped in round {number} of 3 o" for number in (1, 2)}
        assert recovery.warnings == ()
        assert not maps.unknown()["normal"].all()
