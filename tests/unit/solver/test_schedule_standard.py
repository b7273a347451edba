"""The standard schedule: swarms that move as a whole, weights in closed form, and the prefit before them."""

import dataclasses
import json
import tomllib

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import PRESETS
from irpso_addon.pipeline.job import possible_schedule
from irpso_addon.reflectance.model import load_model
from irpso_addon.solver.settings.resolve import (
    ResolvedIndirect,
    ResolvedMaterials,
    ResolvedPrefit,
    ResolvedRefinement,
    ResolvedSeparation,
    ResolvedSheen,
    ResolvedSurface,
    ResolvedSwarm,
    particle_count,
    resolve,
)
from irpso_addon.solver.settings.schedule import MAX_PARTICLES, load_schedule, shipped_presets

OTHERS = {"solve": "search", "cauchy": "l2", "stop": "clamp", "lambert": "random", "hemisphere": "cartesian"}


def unlike(value):
    """Return another value of a setting."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return OTHERS[value]
    return value + 2 if isinstance(value, int) else value / 2


def test_the_standard_preset_moves_whole_swarms_solves_prefits_and_refines():
    standard = load_schedule("standard")
    assert "standard" in shipped_presets() and standard.name == "standard"
    assert (standard.swarm.update, standard.swarm.linear, standard.swarm.start) == ("all", "solve", "lambert")
    stages = resolve(standard.replaced(prior_rounds=0), load_model("principled"), set(), observations=50)
    assert [type(stage) for stage in stages] == [
        ResolvedPrefit, ResolvedPrefit, ResolvedSheen, ResolvedIndirect, ResolvedSeparation, ResolvedPrefit,
        ResolvedSwarm, ResolvedRefinement, ResolvedRefinement, ResolvedMaterials, ResolvedSurface,
    ]  # fmt: skip
    assert [stage.indirect for stage in stages if isinstance(stage, ResolvedPrefit)] == [False, False, True]
    assert [stage.sheen for stage in stages if isinstance(stage, ResolvedPrefit)] == [False, True, False]
    swarm = stages[6]
    assert [p.name for p in swarm.parameters] == ["roughness", "specular"]
    assert [p.name for p in swarm.solved] == ["base_color"]
    assert particle_count(standard, swarm.dimensions("hemisphere")) <= MAX_PARTICLES


def test_every_constant_of_the_standard_preset_is_read_from_its_file(tmp_path):
    text = (PRESETS / "standard.toml").read_text(encoding="utf-8")
    standard = load_schedule("standard")
    parts = {name: table for name, table in tomllib.loads(text).items() if isinstance(table, dict)}
    assert {"swarm", "fitness", "prefit"} <= set(parts)
    for part, table in parts.items():
        values = dataclasses.asdict(getattr(standard, part))
        assert table.items() <= values.items(), part
        for name, value in values.items():
            if (part, name) == ("swarm", "update"):
                continue  # "one" cannot solve
            changed = {**values, name: unlike(value)}
            path = tmp_path / "mine.toml"
            start = text.index(f"[{part}]")
            end = text.find("\n[", start)
            path.write_text(text[:start] + toml_of(part, changed) + text[end:], encoding="utf-8")
            found = getattr(load_schedule(path), part)
            assert getattr(found, name) == changed[name] != value, name
            others = dataclasses.asdict(found)
            assert {k: v for k, v in others.items() if k != name} == {k: v for k, v in values.items() if k != name}


def test_thorough_is_standard_without_interreflection():
    thorough, standard = load_schedule("thorough"), load_schedule("standard")
    assert thorough.interreflection.rounds > 0
    wanted = standard.replaced(interreflection_rounds=thorough.interreflection.rounds)
    assert dataclasses.replace(thorough, name=wanted.name, title=wanted.title) == wanted


def test_a_preset_that_extends_another_sets_what_differs(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('format = 3\nextends = "thorough"\n[fitness]\ndelta = 0.5\n[interreflection]\nrays = 32\n')
    mine = load_schedule(path)
    wanted = load_schedule("thorough").replaced(delta=0.5, interreflection_rays=32)
    assert dataclasses.replace(mine, title=wanted.title, name=wanted.name) == wanted


def test_a_users_preset_may_have_the_name_of_the_shipped_one_that_it_extends(tmp_path):
    path = tmp_path / "standard.toml"
    path.write_text('format = 3\nextends = "standard"\ncycles = 2\n')
    standard = load_schedule("standard")
    assert load_schedule(path) == dataclasses.replace(standard, cycles=2)


@pytest.mark.parametrize("base", ['"nothing"', "3", '"mine.toml"', '["standard"]'])
def test_a_preset_that_extends_no_preset_is_refused(tmp_path, base):
    path = tmp_path / "mine.toml"
    path.write_text(f"format = 3\nextends = {base}\n")
    with pytest.raises(InputError, match="mine.toml: extends .* name another preset: .*standard"):
        load_schedule(path)


def toml_of(part, values):
    """Return a table as TOML."""
    rows = (f"{name} = {str(v).lower() if isinstance(v, bool) else json.dumps(v)}" for name, v in values.items())
    return "\n".join([f"[{part}]", *rows]) + "\n"


def test_a_particle_at_a_time_cannot_solve_weights():
    with pytest.raises(InputError, match='linear = "solve" needs update = "all"'):
        load_schedule("swarm").replaced(linear="solve")
    with pytest.raises(InputError, match='linear = "solve" needs update = "all"'):
        load_schedule("standard").replaced(update="one")
    searched = load_schedule("standard").replaced(update="one", linear="search")
    assert [p.name for p in resolve(searched, load_model("lambert"), set())[0].parameters] == ["base_color", "normal"]


def test_linear_parameters_leave_the_search_where_they_are_solved():
    solved = load_schedule("standard").replaced(prefit_iterations=0)
    for model, searched, closed in (
        ("lambert", ["normal"], ["base_color"]),
        ("cook_torrance_two_lobe", ["normal", "r1", "r2"], ["base_color", "w"]),
    ):
        stage = resolve(solved, load_model(model), set())[0]
        assert [p.name for p in stage.parameters] == searched and [p.name for p in stage.solved] == closed
        assert stage.title == " + ".join(searched + closed)
    fixed = resolve(solved, load_model("cook_torrance_two_lobe"), {"w", "normal"})[0]
    assert [p.name for p in fixed.parameters] == ["r1", "r2"] and [p.name for p in fixed.solved] == ["base_color"]
    nothing = resolve(solved, load_model("lambert"), {"normal"})[0]
    assert nothing.parameters == () and nothing.dimensions("hemisphere") == 0


def test_a_preset_without_a_prefit_has_none():
    assert load_schedule("swarm").prefit.iterations == 0
    for observations in (0, 100):
        stages = resolve(load_schedule("swarm"), load_model("principled"), set(), observations)
        assert not any(isinstance(stage, ResolvedPrefit) for stage in stages)


def test_a_prefit_comes_first_and_takes_the_normal_from_the_stages_but_not_from_the_refinement():
    standard = load_schedule("standard").replaced(
        prefit_iterations=7, prefit_refinement_iterations=4, prefit_indirect_shadow=0.0, prefit_sheen_gain=0.0,
        cycles=2, prior_rounds=0, surface_rounds=0,
    )  # fmt: skip
    stages = resolve(standard, load_model("principled"), set(), observations=standard.prefit.min_observations)
    assert [stage.title for stage in stages] == [
        "prefit of the normals", "roughness + specular + base_color", "roughness + specular + base_color", "refinement",
        "refinement, normals fixed", "shared materials",
    ]  # fmt: skip
    assert stages[0].iterations == 11
    assert [p.name for p in stages[-3].parameters] == ["base_color", "normal", "roughness", "specular"]
    assert [p.name for p in stages[-2].parameters] == ["base_color", "roughness", "specular"]
    assert stages[-2].iterations == 3 + 2 * 4 and stages[-2].starts == ()
    assert [p.name for p in stages[-1].parameters] == ["base_color", "normal", "roughness", "specular"]
    matt = resolve(standard, load_model("lambert"), set(), observations=50)
    assert [stage.title for stage in matt][-2:] == ["base_color", "refinement"]
    alone = resolve(standard.replaced(search=["normal"]), load_model("lambert"), set(), observations=50)
    assert [stage.title for stage in alone] == ["prefit of the normals", "refinement"]


@pytest.mark.parametrize(
    ("settings", "fixed", "observations"),
    [({}, set(), 9), ({}, {"normal"}, 50), ({"search": ["base_color"]}, set(), 50),
     ({"prefit_iterations": 0}, set(), 50), ({"prefit_min_observations": 51}, set(), 50)],
)  # fmt: skip
def test_a_prefit_needs_observations_and_a_normal_to_find(settings, fixed, observations):
    schedule = load_schedule("standard").replaced(**settings)
    stages = resolve(schedule, load_model("principled"), fixed, observations)
    assert not any(isinstance(stage, ResolvedPrefit) for stage in stages)


BAD_PREFITS = {
    "prefit_iterations": [-1, 1.5, "10", True],
    "prefit_refinement_iterations": [-1, 2.5, None],
    "prefit_min_observations": [-1, 9.5, "many"],
    "prefit_shadow": [-0.1, 1.5, "dark", float("nan"), True],
    "prefit_indirect_shadow": [1.5],
    "shadow": [1.5],
    "delta": [0.0, 1e-25],
    "prefit_acceptance_delta": [-1, "x", float("inf")],
    "prefit_acceptance_ratio": [-1, "x", None],
    "update": ["two", 1],
    "linear": ["closed", True],
    "linear_limit": [-1, "far"],
    "neighbour_interval": [-1, "often"],
    "prefit_lobes": [2],
}


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, values in BAD_PREFITS.items() for v in values])
def test_an_invalid_prefit_is_refused_in_one_line(name, value):
    with pytest.raises(InputError) as caught:
        load_schedule("standard").replaced(**{name: value})
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_settings_of_the_prefit_are_replaced_by_name_and_whole():
    before = load_schedule("standard")
    after = before.replaced(prefit_iterations=3, prefit_shadow=0.5, shadow=0.1, refinement_iterations=2)
    assert (after.prefit.iterations, after.prefit.shadow, after.prefit.acceptance_ratio) == (
        3,
        0.5,
        before.prefit.acceptance_ratio,
    )
    assert (after.fitness.shadow, after.refinement.iterations) == (0.1, 2)
    assert before.replaced(prefit=after.prefit) == before.replaced(prefit_iterations=3, prefit_shadow=0.5)


@pytest.mark.parametrize("part", ["prefit", "refinement", "prior"])
@pytest.mark.parametrize("value", [0, False])
def test_a_disabled_part_is_refused_with_the_setting_to_use(part, value):
    with pytest.raises(InputError, match=rf"{part} has settings of its own, as in {part}_\w+=0"):
        load_schedule("standard").replaced(**{part: value})


def test_an_acceptance_delta_of_0_is_refused():
    with pytest.raises(InputError, match="prefit_acceptance_delta must be above 0"):
        load_schedule("standard").replaced(prefit_acceptance_delta=0)


def test_matte_rounds_are_of_meshes_with_shadows_at_one_size():
    standard = load_schedule("standard")
    assert standard.interreflection.matte_rounds > 0
    assert possible_schedule(standard, shadowed_mesh=True) == standard
    for schedule, mesh in ((standard, False), (standard.replaced(levels=2), True)):
        wanted = schedule.replaced(interreflection_matte_rounds=0)
        assert possible_schedule(schedule, shadowed_mesh=mesh) == wanted
