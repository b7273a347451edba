"""The rounds that take the light off that a subject throws on itself, where that light is known."""

from contextlib import closing
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from irpso_addon.blender.ray_caster import ray_caster_steps
from irpso_addon.core.errors import CheckpointError, InputError
from irpso_addon.core.steps import run_steps
from irpso_addon.geometry.domain import domain_of
from irpso_addon.geometry.light.interreflection_geometry import CardInterreflection, MeshInterreflection
from irpso_addon.geometry.surface.bake import bake_uv
from irpso_addon.gpu import textures
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.false_color import COLORS, false_color
from irpso_addon.results.maps import UNKNOWN, Cause
from irpso_addon.solver.engine.recovery import Recovery
from irpso_addon.solver.interreflection import rounds
from irpso_addon.solver.interreflection.indirect_light import IndirectLight
from irpso_addon.solver.interreflection.rounds import InterreflectionRounds
from irpso_addon.solver.views.display import Display, Shown
from tests.builders.cavity import cap_card, cavity_mesh, half_cavity
from tests.builders.command_line import dome_lights
from tests.builders.domains import bits_of
from tests.builders.rounds import ALBEDO, LAMBERT, ROUNDS, SINGLE, errors, matt_bowl, rounds_of, without_indirect


@pytest.fixture(scope="module")
def bowl():
    return matt_bowl()


@pytest.fixture(scope="module")
def whole(bowl):
    """(maps, progress) of all rounds in one step."""

    @cache
    def run():
        with rounds_of(bowl) as recovery:
            recovery.step()
            return recovery.maps(), recovery.progress

    return run()


def test_rounds_find_the_normals_and_the_colour_of_a_bowl(bowl, whole):
    with Recovery(bowl[0], LAMBERT, SINGLE, 1, entry="fragment") as recovery:
        recovery.step()
        tilt, colour = errors(recovery.maps())
    assert tilt > 3 and colour[0] > 1.15  # what it is about
    tilt, colour = errors(whole[0])
    assert tilt < 1 and abs(colour - 1).max() < 0.03


def test_the_maps_tell_the_light_of_photographs_that_they_were_not_found_from(bowl):
    """Half a sphere keeps half of what a place sends; its opening lets in π cos θ, of which a place receives half."""
    lights = np.array([[0.3, 0.2, -0.9], [-0.6, 0.1, -0.5]])
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    unseen = half_cavity(bowl[1].mesh, ALBEDO, lights)
    with rounds_of(bowl) as recovery:
        assert run_steps(recovery.indirect_in(unseen))(0) == 0  # nothing has been found yet
        recovery.step()
        light = run_steps(recovery.indirect_in(unseen))
        again = run_steps(recovery.indirect_in(bowl[0]))(3)
        lit = bowl[0].stack.layer(3)[..., 3] > 0  # where no lamp reaches, all that shows is taken off
        np.testing.assert_allclose(again[lit], recovery.indirect(3)[lit], atol=1e-5)
    rho = np.array(ALBEDO)
    for number, direction in enumerate(lights):
        wanted = rho * 0.5 * rho * (-direction[2] / 2) / (1 - 0.5 * rho)
        np.testing.assert_allclose(light(number)[unseen.solvable].mean(axis=0), wanted, rtol=0.12)


def test_each_round_makes_all_iterations(bowl, whole):
    progress = whole[1]
    assert progress.done and progress.fraction == 1 and progress.stage == progress.stages - 1
    assert progress.iteration_in_all == progress.iterations_in_all
    up = np.broadcast_to(np.float32([0, 0, 1]), (*bowl[0].shape, 3))
    lengths = []
    for fixed in ({"normal": up}, {}):
        with Recovery(bowl[0], LAMBERT, SINGLE, 1, fixed, "fragment") as recovery:
            lengths.append(recovery.progress.iterations_in_all)
    assert progress.iterations_in_all == 2 * lengths[0] + lengths[1]


def test_the_normals_of_a_mesh_are_held_until_the_light_is_found(bowl):
    with rounds_of(bowl) as recovery:
        tilts = {}
        while not (progress := recovery.step(3)).done:
            tilts.setdefault(progress.title.rpartition(", ")[2], []).append(errors(recovery.maps(confidence=False))[0])
    free = tilts.pop("round 2 of interreflection")
    assert max(max(found) for found in tilts.values()) == 0 < max(free)


def test_light_is_found_from_the_gloss_of_texels_that_show_it(bowl):
    model = load_model("metallic_roughness")
    with rounds_of(bowl, model=model) as run:
        solved = np.argwhere(bowl[0].solvable)
        unsure, others = tuple(solved[10]), tuple(solved[len(solved) // 2 :].T)
        maps = run.maps()
        shape = bowl[0].shape
        values = {p.name: np.full((*shape, p.components), 0.5, np.float32) for p in model.parameters}
        deviations = {p.name: np.full((*shape, 1 if p.is_normal else p.components), 0.02) for p in model.parameters}
        values["roughness"][unsure], deviations["roughness"][unsure] = 1.0, 1.0
        values["roughness"][others], values["base_color"][others] = 0.7, 0.1
        found = replace(maps, values=values, confidence=deviations, residual=np.zeros(shape))
        source_maps = run_steps(run._source_maps_of(found))
        assert abs(source_maps["roughness"][unsure] - 0.5) < 0.01
        np.testing.assert_allclose(source_maps["roughness"][others], 0.7, atol=0.01)
        assert values["roughness"][unsure] == 1, "the maps themselves keep what was found"
        for name in ("normal", "base_color"):
            np.testing.assert_array_equal(source_maps[name], values[name])


def test_texels_that_owe_most_of_their_light_to_others_say_so(bowl, monkeypatch):
    monkeypatch.setattr(rounds, "MAX_INDIRECT", 0.2)  # of albedos of up to 0.8 a third of the light is
    with rounds_of(bowl) as recovery:
        recovery.step()
        maps, count = recovery.maps(), recovery.findings["interreflection"]["unknown_texels"]
    there = maps.confidence["normal"][..., 0] == np.float32(np.pi / 2)
    assert 0 < count == np.count_nonzero(there) <= np.count_nonzero(maps.solved)
    np.testing.assert_allclose(maps.values["normal"][there], np.tile(np.float32([0, 0, 1]), (count, 1)), atol=1e-6)
    assert (maps.confidence["base_color"][there] == 1).all()


def test_the_window_marks_the_texels_that_the_maps_call_unknown(bowl, monkeypatch):
    monkeypatch.setattr(rounds, "MAX_INDIRECT", 0.2)
    shown = Shown("parameter", "normal", unknown=UNKNOWN * np.pi / 2)
    with rounds_of(bowl) as recovery, closing(Display(recovery)) as display:
        for cause in (Cause.LATER_ROUND, Cause.MOSTLY_INDIRECT):
            maps = recovery.maps()
            mask = maps.unknown_by_cause()["normal"][cause]
            assert mask.any()
            alpha = textures.download(display.picture(shown))[..., 3]
            for texel in np.argwhere(maps.solved)[::37]:
                causes = [why for why, there in maps.unknown_by_cause()["normal"].items() if there[*texel]]
                assert list(display.unknown_at(*texel).values()) == causes, texel
            np.testing.assert_array_equal((alpha > 0) & (alpha < 1), maps.unknown()["normal"])
            deviations = textures.download(display.picture(Shown("confidence", "normal", limit=1.0)))
            np.testing.assert_allclose(deviations[mask, :3], np.tile(COLORS[-1], (mask.sum(), 1)), atol=1e-3)
            recovery.step()


def test_a_wrong_material_does_not_hide_that_a_texel_owes_most_of_its_light_to_others(bowl, monkeypatch):
    monkeypatch.setattr(rounds, "MAX_INDIRECT", 0.27)
    schedule = ROUNDS.replaced(interreflection_rounds=3)  # the first finds the direct light too bright
    with rounds_of(bowl, schedule) as recovery:
        recovery.step()
        share = recovery.indirect_share
        assert 0.2 < recovery._mostly_indirect[bowl[0].solvable].mean() < 0.8
    darkest = share > np.percentile(share[bowl[0].solvable], 80)
    found, spoiled = InterreflectionRounds._source_maps_of, darkest & (np.indices(share.shape).sum(axis=0) % 5 == 0)

    def spoiling(self, maps):
        source_maps = dict((yield from found(self, maps)))
        source_maps["base_color"] = np.where(spoiled[..., None], np.float32(0), source_maps["base_color"])
        return source_maps

    monkeypatch.setattr(InterreflectionRounds, "_source_maps_of", spoiling)
    with rounds_of(bowl, schedule) as recovery:
        recovery.step()
        assert recovery._mostly_indirect[spoiled].mean() > 0.8
        np.testing.assert_allclose(recovery.indirect_share[spoiled], share[spoiled], rtol=0.15)


def test_neither_noise_nor_lamps_that_reach_dark_places_change_the_strength(bowl):
    domain, geometry = bowl
    with rounds_of(bowl) as recovery:
        recovery.step()
        light = run_steps(recovery._estimator(domain, recovery._source_maps[-1]))
    with closing(light):
        radiance, _ = run_steps(light.of_elements())
        wanted, rng = light.strength(radiance), np.random.default_rng(1)
        noise = np.exp(rng.normal(-0.5 * 0.5**2, 0.5, radiance.shape[:2]))[..., None]  # with a mean of 1
        assert light.strength(radiance * noise) == pytest.approx(wanted, rel=0.05)
        light.shown = np.where(rng.random(light.shown.shape) < 0.1, 20 * light.shown, light.shown)
        assert light.strength(radiance) == pytest.approx(wanted, rel=0.02)
        light.shown = np.where(light.shown < np.median(light.shown), -1e-4, light.shown)  # too bright a dark frame
        assert light.strength(radiance) == 0


def test_the_share_of_indirect_light_is_that_of_the_half_sphere(bowl):
    domain = bowl[0]
    with rounds_of(bowl) as recovery:
        assert recovery.indirect_share is None
        recovery.step()
        share, mean = recovery.indirect_share, recovery.findings["interreflection"]["share"]
    light = domain.stack.values[..., :3].astype(np.float64).mean(axis=-1) * (domain.stack.values[..., 3] > 0)
    # As half_cavity has it: what a place receives from others is the same everywhere.
    rho, slant = np.array(ALBEDO), -domain.lights[:, 2].astype(np.float64)
    sent = (rho * 0.5 * rho / (1 - 0.5 * rho)).mean() * slant / 2
    indirect = (sent[:, None, None] * (domain.stack.values[..., 3] > 0)).sum(axis=0)
    wanted = indirect / light.sum(axis=0)
    np.testing.assert_allclose(share, wanted, rtol=0.1)
    np.testing.assert_allclose(mean, wanted.mean(), rtol=0.02)


def test_the_share_is_shown_in_false_colours_once_it_is_known(bowl):
    shown = Shown("indirect", limit=0.5)
    with rounds_of(bowl) as recovery, closing(Display(recovery)) as display:
        recovery.step(1)
        assert textures.download(display.picture(shown)).max() == 0
        while recovery.indirect_share is None or recovery.progress.iteration < 0:
            recovery.step(time_budget_s=0.05)
        assert display.pending(shown)
        picture = textures.download(display.picture(shown))
        assert not display.pending(shown)
        np.testing.assert_allclose(picture[..., :3], false_color(recovery.indirect_share, 0.5), atol=1e-3)
        recovery.step()
        np.testing.assert_allclose(
            textures.download(display.picture(shown))[..., :3], false_color(recovery.indirect_share, 0.5), atol=1e-3
        )


def test_time_slices_and_reads_change_nothing(bowl, whole):
    fractions = []
    with rounds_of(bowl) as recovery:
        while not recovery.step(time_budget_s=0.02).done:
            fractions.append(recovery.progress.fraction)
            if len(fractions) % 7 == 0:
                recovery.maps(confidence=False)
        assert bits_of(recovery.maps()) == bits_of(whole[0])
    assert fractions == sorted(fractions)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_run_resumes_in_every_round(bowl, whole, share, tmp_path):
    with rounds_of(bowl) as recovery:
        while recovery.progress.fraction < share:
            recovery.step(5)
        recovery.save(tmp_path / "checkpoint.npz")
        shown = recovery.indirect_share
    with rounds_of(bowl) as recovery:
        recovery.load(tmp_path / "checkpoint.npz")
        np.testing.assert_array_equal(recovery.indirect_share, shown)  # None, too
        recovery.step()
        assert bits_of(recovery.maps()) == bits_of(whole[0])


def test_photographs_without_shadows_and_bounces_lose_no_light():
    # As `render` makes them. Where the mesh casts its shadows, such a photograph is bright by its lamp.
    mesh = cavity_mesh(opening=-0.8)
    texels = bake_uv(mesh, 48, 16, allow_overlap=True)
    lights = np.pad(dome_lights(16, 50.0) * (1, 1, -1), ((0, 0), (0, 1))).astype(np.float32)
    cosine = np.einsum("hwi,ki->khw", texels.normal.astype(np.float64), lights[:, :3])
    values = np.ones((*cosine.shape, 4), np.float32)
    values[..., :3] = np.array(ALBEDO) * np.maximum(cosine, 0)[..., None]
    views = np.tile(np.float32([0, 0, 0, 1]), (16, 1))
    domain = domain_of(texels, values, lights, np.ones((16, 3), np.float32), views, card=False)
    with rounds_of((domain, MeshInterreflection(mesh, ray_caster_steps, 48, 64, shadowed=False))) as recovery:
        recovery.step()
        maps, found = recovery.maps(), recovery.findings["interreflection"]
    assert max(found["strength"]) < 0.01
    lit = (cosine > 0.1).sum(axis=0) >= 6
    np.testing.assert_allclose(maps.values["base_color"][lit], np.broadcast_to(ALBEDO, (lit.sum(), 3)), rtol=0.02)


def test_a_run_among_other_occluders_is_another(bowl, tmp_path):
    domain, geometry = bowl
    with rounds_of(bowl) as recovery:
        recovery.step(1)
        recovery.save(tmp_path / "checkpoint.npz")
    table = replace(geometry.mesh, occluders=geometry.mesh.positions[:2] + np.float32(3))
    with (
        rounds_of((domain, MeshInterreflection(table, ray_caster_steps, 48, 64))) as recovery,
        pytest.raises(CheckpointError, match="is of another recovery: occluders differs"),
    ):
        recovery.load(tmp_path / "checkpoint.npz")


def test_a_run_that_is_done_takes_up_an_earlier_state(bowl, monkeypatch, tmp_path):
    monkeypatch.setattr(rounds, "MAX_INDIRECT", 0.2)
    with rounds_of(bowl) as recovery:
        recovery.step(1)
        recovery.save(tmp_path / "first.npz")
        while recovery.progress.fraction < 0.5:
            recovery.step(5)
        recovery.save(tmp_path / "checkpoint.npz")
        recovery.step()
        wanted = bits_of(recovery.maps())
        recovery.load(tmp_path / "checkpoint.npz")
        recovery.step()
        assert bits_of(recovery.maps()) == wanted
        recovery.load(tmp_path / "first.npz")
        assert recovery.indirect_share is None and recovery.findings["interreflection"]["share"] == 0


def test_a_run_continues_wherever_it_takes_settings_again(bowl, whole):
    recovery, slices = rounds_of(bowl), 0
    while not recovery.step(time_budget_s=0.02).done:
        slices += 1
        if slices % 5 == 0:
            before, recovery = recovery, recovery.reconfigure(ROUNDS)
            before.close()
    with recovery:
        assert bits_of(recovery.maps()) == bits_of(whole[0])
    assert slices > 10


def test_every_round_is_prepared_before_it_begins(bowl, whole):
    """What a Recovery prepares by itself, it prepares in one piece: a window would stand still."""
    given = []

    def solve(*arguments, **more):
        given.append(more.get("prepared"))
        return Recovery(*arguments, **more)

    with rounds_of(bowl, solve=solve) as recovery:
        recovery.step()
        assert bits_of(recovery.maps()) == bits_of(whole[0])
    assert len(given) == 3 and all(prepared is not None and prepared.stack is not None for prepared in given[1:])


def test_other_settings_of_interreflection_are_refused_in_mid_run(bowl):
    with rounds_of(bowl) as recovery, pytest.raises(InputError, match="keeps its settings"):
        recovery.reconfigure(ROUNDS.replaced(interreflection_rounds=1))


def test_a_fixed_base_colour_leaves_the_normals_to_every_round(bowl, monkeypatch):
    monkeypatch.setattr(rounds, "MAX_INDIRECT", 0.2)
    painted = np.broadcast_to(np.float32(ALBEDO), (*bowl[0].shape, 3))
    with rounds_of(bowl, fixed={"base_color": painted}) as recovery:
        recovery.step()
        maps = recovery.maps()
    assert errors(maps)[0] < 1.5
    np.testing.assert_array_equal(maps.values["base_color"][maps.solved], painted[maps.solved])


def test_fixed_parameters_stay_where_others_give_most_of_the_light(bowl, monkeypatch):
    monkeypatch.setattr(rounds, "MAX_INDIRECT", 0.2)
    rough = np.linspace(0.5, 0.9, bowl[0].shape[1], dtype=np.float32)[None, :, None] * np.ones((*bowl[0].shape, 1))
    fixed = {"roughness": rough.astype(np.float32)}
    with rounds_of(bowl, fixed=fixed, model=load_model("metallic_roughness")) as recovery:
        recovery.step()
        maps = recovery.maps()
    assert recovery.findings["interreflection"]["unknown_texels"] > 0
    np.testing.assert_array_equal(maps.values["roughness"][maps.solved], fixed["roughness"][maps.solved])


@pytest.fixture(scope="module")
def direct(bowl):
    return without_indirect(bowl)


def test_photographs_without_such_light_end_with_the_first_maps(direct):
    with Recovery(direct[0], LAMBERT, SINGLE, 1, entry="fragment") as recovery:
        recovery.step()
        wanted = recovery.maps()
    with rounds_of(direct) as recovery:
        assert recovery.step().done and recovery.progress.fraction == 1
        assert bits_of(recovery.maps()) == bits_of(wanted)
        assert recovery.findings["interreflection"]["strength"] == [0.0]
        assert recovery.findings["interreflection"]["share"] == recovery.indirect_share.max() == 0


def test_a_run_without_such_light_continues_under_settings_again(direct):
    schedule = ROUNDS.replaced(interreflection_rounds=1)
    with rounds_of(direct, schedule) as recovery:
        recovery.step()
        wanted = bits_of(recovery.maps())
    recovery = rounds_of(direct, schedule)
    while not recovery.step(3).done:
        before, recovery = recovery, recovery.reconfigure(schedule)
        before.close()
    with recovery:
        assert bits_of(recovery.maps()) == wanted


def test_a_recovery_that_it_does_not_help_says_so(direct, monkeypatch):
    monkeypatch.setattr(IndirectLight, "strength", lambda self, radiance: 1.0)
    with rounds_of(direct) as recovery:
        recovery.step()
        assert any("interreflection_rounds=0" in line for line in recovery.warnings)


def test_a_recovery_that_it_helps_says_nothing(bowl):
    with rounds_of(bowl) as recovery:
        recovery.step()
        assert recovery.warnings == ()


def test_a_single_recovery_refuses_rounds(bowl):
    with pytest.raises(InputError, match="interreflection_rounds = 2: .* use InterreflectionRounds"):
        Recovery(bowl[0], LAMBERT, ROUNDS, 1, entry="fragment")


def test_several_levels_are_refused():
    with pytest.raises(InputError, match="set levels = 1"):
        ROUNDS.replaced(levels=2)


def test_rounds_find_the_relief_of_a_hollow_card():
    albedo = (0.8, 0.6, 0.4)
    domain, camera, normals = cap_card(albedo, dome_lights(24, 50.0))
    geometry = CardInterreflection(camera, "normal", ray_caster_steps, 40, 64)

    around = [np.roll(domain.solvable, step, axis) for step in (-1, 1) for axis in (0, 1)]
    rim = domain.solvable & ~np.all(around, axis=0)

    def tilt(maps, there=domain.solvable):
        chord = np.linalg.norm(maps.values["normal"] - normals, axis=-1)[there]
        return np.degrees(2 * np.arcsin(chord / 2)).mean()

    with Recovery(domain, LAMBERT, SINGLE, 1, entry="fragment") as recovery:
        recovery.step()
        before = tilt(recovery.maps())
    with rounds_of((domain, geometry)) as recovery:
        recovery.step()
        maps, strength = recovery.maps(), recovery.findings["interreflection"]["strength"][-1]
    print(f"{before:.2f}° → {tilt(maps):.2f}°, strength {strength:.2f}")
    assert before > 2 and tilt(maps) < before / 4 and tilt(maps, rim) < before / 4
    assert abs(maps.values["base_color"][maps.solved].mean(axis=0) / albedo - 1).max() < 0.03
