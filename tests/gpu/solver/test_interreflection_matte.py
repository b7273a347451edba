"""Matte rounds: the light that a mesh throws on itself, from its base colours alone."""

import numpy as np
import pytest

from irpso_addon.blender.ray_caster import ray_caster
from irpso_addon.geometry.light.surroundings import CardSurroundings
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.engine.recovery import Recovery
from tests.builders.cavity import cap_card
from tests.builders.command_line import dome_lights
from tests.builders.domains import bits_of
from tests.builders.rounds import ALBEDO, LAMBERT, SINGLE, errors, matt_bowl, rounds_of


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


def test_matte_rounds_alone_say_that_they_do_not_know_metal(bowl):
    model, schedule = load_model("metallic_roughness"), SINGLE.replaced(interreflection_matte_rounds=1)
    for metallic, warned in ((1.0, True), (0.0, False)):
        fixed = {"metallic": np.float32([metallic])}
        with rounds_of(bowl, schedule, fixed, model) as recovery:
            recovery.step()
            assert any("is metal" in line for line in recovery.warnings) == warned
    with rounds_of(bowl, schedule.replaced(interreflection_rounds=1), fixed, model) as recovery:
        recovery.step()
        assert not any("is metal" in line for line in recovery.warnings)


def test_fixed_colours_and_cards_have_no_matte_rounds(bowl):
    schedule = SINGLE.replaced(interreflection_matte_rounds=2)
    domain, camera, _ = cap_card(ALBEDO, dome_lights(24, 50.0))
    card = domain, CardSurroundings(camera, "normal", ray_caster, 40, 64)
    for subject, fixed in ((bowl, {"base_color": np.float32(ALBEDO)}), (card, {})):
        with rounds_of(subject, schedule, fixed) as recovery:
            stages = recovery.progress.stages
        with Recovery(subject[0], LAMBERT, SINGLE, 1, fixed, entry="fragment") as alone:
            assert stages == alone.progress.stages
