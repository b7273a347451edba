"""Schedules: presets read and checked, settings replaced, and stages resolved for a model."""

import re

import pytest

from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import PRESETS
from irpso_addon.reflectance.model import Parameter, ReflectanceModel, load_model
from irpso_addon.solver.phases.swarm import neighbour_constant
from irpso_addon.solver.settings.groups import Stage
from irpso_addon.solver.settings.refinement_groups import Refinement
from irpso_addon.solver.settings.resolve import ResolvedRefinement, particle_count, resolve, unsearched_names
from irpso_addon.solver.settings.schedule import SETTINGS, load_schedule, shipped_presets

SWARM = (PRESETS / "swarm.toml").read_text(encoding="utf-8")


def titles(schedule, model="cook_torrance_two_lobe", fixed=()):
    """Return what every stage of the first cycle searches."""
    return [stage.title for stage in resolve(schedule, load_model(model), set(fixed)) if stage.cycle == 0]


@pytest.mark.parametrize("name", ["paper", "swarm", "constriction", "standard"])
def test_a_shipped_preset_loads_under_its_own_name(name):
    assert name in shipped_presets()
    schedule = load_schedule(name)
    assert schedule.name == name and schedule.stages and schedule.title


@pytest.mark.parametrize("name", shipped_presets())
def test_the_sliders_reach_the_values_of_a_shipped_preset(name):
    values = load_schedule(name).settings()
    numbers = {key: one for key, one in SETTINGS.items() if isinstance(values.get(key), int | float) and one.soft_max}
    assert len(numbers) > 30
    assert [key for key, one in numbers.items() if values[key] > one.soft_max] == []


def test_the_constants_of_the_paper_are_what_the_paper_prints():
    paper = load_schedule("paper")
    swarm = paper.swarm
    assert (swarm.inertia, swarm.constriction, swarm.start, swarm.normal) == (1.0, 1.0, "random", "cartesian")
    assert paper.fitness.loss == "l1" and swarm.c3_fade == 0
    assert titles(paper) == ["base_color", "normal", "r1 + r2 + w"]


def test_constriction_multiplies_to_1496():
    swarm = load_schedule("constriction").swarm
    assert swarm.constriction * swarm.c1 == pytest.approx(1.496, abs=1e-3)
    phi = swarm.c1 + swarm.c2  # Clerc & Kennedy 2002, Eq. 4.15 with κ = 1
    assert swarm.constriction == pytest.approx(2 / abs(2 - phi - (phi**2 - 4 * phi) ** 0.5), abs=1e-4)


BAD_SETTINGS = {
    "particles": [0, -3, 2.5, "16", True, None, 2**31, 10**400],
    "neighbourhood": [0, 2, -1, 3.0, "3", 2**31 - 1],
    "iterations": [0, -1, 10.5, "100", 5 * 10**9],
    "cycles": [0, 1.5, "2", 10**6],
    "inertia": [-0.1, float("nan"), float("inf"), "fast", None, [0.6]],
    "c1": ["1.2", -1],
    "c3": [-0.05, "a"],
    "c3_fade": [1.5, -0.1, "x"],
    "v_max": [0, -1, "x", float("nan")],
    "particles_per_dimension": [-1, "3"],
    "start_speed": [-0.1, "x"],
    "start_fraction": [1.1, -0.1, "half"],
    "start_spread": [-0.1, "x"],
    "walls": ["bounce", 3, None, ["clamp"]],
    "start": ["", 1],
    "normal": ["spherical", 2],
    "loss": ["l3", 1],
    "delta": [0, -1, "x", float("nan"), 1e300, 10**400],
    "scale_percentile": [0, 101, "x"],
    "shadow": [-0.1, "x"],
    "threshold": [-1, float("nan"), "x"],
    "search": [[], "normal", [3], [["normal"]], 5],
    "particels": [16],
    "name": ["x", 5],
    "title": ["x", [1]],
}


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, values in BAD_SETTINGS.items() for v in values])
def test_a_bad_setting_is_refused_in_one_line_that_names_it(name, value):
    with pytest.raises(InputError) as caught:
        load_schedule("swarm").replaced(**{name: value})
    assert name in str(caught.value) and "\n" not in str(caught.value)
    assert len(str(caught.value)) > len(name) + 15


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("inertia = 0.6", 'inertia = "fast"', "inertia"),
        ("inertia = 0.6", "inertia = true", "inertia"),
        ("inertia = 0.6", "inertia = nan", "inertia"),
        ("inertia = 0.6", "", "inertia"),
        ("inertia = 0.6", "inertia = 0.6\nmass = 2", "mass"),
        ("particles = 16\n", "particles = 16.0\n", "particles"),
        ("neighbourhood = 3", "neighbourhood = 4", "neighbourhood"),
        ('walls = "stop"', 'walls = "bounce"', "walls"),
        ('walls = "stop"', "walls = 1", "walls"),
        ('loss = "cauchy"', 'loss = "huber"', "loss"),
        ("iterations = 1500", 'iterations = "many"', "iterations"),
        ("iterations = 1500", "", "iterations"),
        ('search = ["all"]', 'search = "all"', "search"),
        ('search = ["all"]', "search = []", "search"),
        ('search = ["all"]', "search = [1]", "search"),
        ('[[stage]]\nsearch = ["all"]\niterations = 1500', "", "stage"),
        ("[[stage]]", "[stage]", "stage"),
        ("[swarm]", "[swarms]", "swarms"),
        ("[fitness]", "[[fitness]]", "fitness"),
        ("cycles = 1", "cycles = 1\nfitness.loss = 3", "TOML"),
        ("cycles = 1", "cycles = 0", "cycles"),
        ("cycles = 1", 'cycles = 1\ntitle2 = "x"', "title2"),
        ("cycles = 1", "cycles = ", "TOML"),
        ("cycles = 1", f"cycles = {'9' * 400}", "cycles"),
        ("cycles = 1", f"cycles = 0x{'F' * 5000}", "cycles must be at most 100, not a number of more than 40 digits"),
        ("cycles = 1", "cycles = 1\nname = 7", "name must be a text"),
        ('title = "', 'title = [1] # "', "title must be a text"),
        ("cycles = 1", f"cycles = {'9' * 5000}", "TOML"),
    ],
)
def test_a_bad_preset_file_is_refused_in_one_line_with_its_path(tmp_path, old, new, word):
    path = tmp_path / "mine.toml"
    assert old in SWARM
    path.write_text(SWARM.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_schedule(path)
    assert str(caught.value).startswith(str(path)) and word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_preset_with_a_byte_order_mark_is_read(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(SWARM, encoding="utf-8-sig")
    assert load_schedule(path).swarm == load_schedule("swarm").swarm


def test_tables_in_place_of_values_are_refused(tmp_path):
    path = tmp_path / "mine.toml"
    for text in ("stage = 3", "stage = [3]", "swarm = 3", "swarm = []", "fitness = 'l1'", SWARM + "[swarm.more]"):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=r"mine\.toml"):
            load_schedule(path)


def test_a_missing_or_binary_preset_is_refused(tmp_path):
    with pytest.raises(InputError, match="choose one of constriction, paper, "):
        load_schedule("fastest")
    with pytest.raises(InputError, match="cannot be read"):
        load_schedule(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not valid TOML"):
        load_schedule(tmp_path / "binary.toml")


def test_replacing_changes_a_copy_and_only_what_is_named():
    before = load_schedule("paper")
    after = before.replaced(particles=24, loss="l2", threshold=0.5, iterations=7)
    assert (after.swarm.particles, after.fitness.loss, after.threshold) == (24, "l2", 0.5)
    assert [s.iterations for s in after.stages] == [7, 7, 7]
    assert before == load_schedule("paper")
    assert after.replaced(particles=16, loss="l1", threshold=0.0, iterations=1000) == before


def test_a_free_search_is_one_stage_as_long_as_the_longest():
    schedule = load_schedule("paper").replaced(search=["normal", "r1"])
    assert schedule.stages == (Stage(("normal", "r1"), 1000),)
    assert titles(schedule) == ["normal + r1"]
    assert titles(load_schedule("paper").replaced(search=["specular", "diffuse"])) == ["base_color + r1 + r2 + w"]


def test_fixed_parameters_are_not_searched_and_empty_stages_are_dropped():
    paper = load_schedule("paper")
    assert titles(paper, fixed=["normal", "base_color"]) == ["r1 + r2 + w"]
    assert titles(paper, fixed=["r1"]) == ["base_color", "normal", "r2 + w"]
    assert titles(paper, model="lambert") == ["base_color", "normal"]


def test_unsearched_are_the_fixed_parameters_and_those_of_no_stage():
    model, schedule = load_model("principled"), load_schedule("standard")
    assert unsearched_names(schedule, model, {"specular"}) == {"specular"}
    assert unsearched_names(schedule.replaced(search=("normal",)), model, ()) == {"base_color", "roughness", "specular"}
    assert unsearched_names(load_schedule("paper"), model, ()) == set()


def test_rest_means_all_parameters_that_no_stage_names():
    parameters = (Parameter("normal", 3, is_normal=True, stage="normal"), Parameter("sheen", stage="cloth"))
    model = ReflectanceModel("mine", "mine", PRESETS / "none.glsl", parameters)
    once = load_schedule("paper").replaced(cycles=1)
    assert [s.title for s in resolve(once, model, set())] == ["normal", "sheen"]


def test_cycles_repeat_the_stages_in_order():
    schedule = load_schedule("paper").replaced(cycles=2, iterations=5)
    stages = resolve(schedule, load_model("lambert"), set())
    assert [(s.title, s.cycle) for s in stages] == [("base_color", 0), ("normal", 0), ("base_color", 1), ("normal", 1)]


def test_more_than_eight_dimensions_are_refused_and_eight_are_not():
    swarm = load_schedule("swarm")
    model = load_model("cook_torrance_two_lobe")
    assert resolve(swarm, model, set())[0].dimensions("hemisphere") == 8
    with pytest.raises(InputError, match="9 dimensions together, at most 8"):
        resolve(swarm.replaced(normal="cartesian"), model, set())


def test_an_unknown_name_is_refused_with_the_names_there_are():
    with pytest.raises(InputError, match=re.escape("'metallic'; it has: base_color, normal")):
        resolve(load_schedule("swarm").replaced(search=["metallic"]), load_model("lambert"), set())


def test_nothing_left_to_search_is_refused():
    with pytest.raises(InputError, match="every searched parameter is fixed"):
        resolve(load_schedule("swarm"), load_model("lambert"), {"base_color", "normal"})
    with pytest.raises(InputError, match="every searched parameter is fixed"):
        resolve(load_schedule("swarm").replaced(search=["specular"]), load_model("lambert"), set())


def test_swarms_grow_with_the_dimensions():
    schedule = load_schedule("swarm")
    assert [particle_count(schedule, n) for n in (2, 5, 6, 8)] == [16, 16, 18, 24]
    assert particle_count(schedule.replaced(particles=5, particles_per_dimension=0.0), 8) == 5


def test_more_particles_than_move_together_are_refused_before_anything_is_read():
    standard, model = load_schedule("standard"), load_model("lambert")
    with pytest.raises(InputError, match="at most 16 together, not 17; .* for the prefit set prefit_iterations = 0"):
        resolve(standard.replaced(particles=17), model, set(), observations=50)


def test_the_neighbour_term_fades_to_nothing_or_stays():
    fading = load_schedule("swarm").replaced(c3=0.1, c3_fade=0.5)
    assert [neighbour_constant(fading, t, 100) for t in (-3, 0, 25, 50, 99)] == pytest.approx([0.1, 0.1, 0.05, 0, 0])
    constant = fading.replaced(c3_fade=0.0)
    assert [neighbour_constant(constant, t, 100) for t in (0, 99)] == [0.1, 0.1]


# ---- the refinement --------------------------------------------------------------------------------------------------


def with_refinement(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(SWARM + "\n" + text)
    return path


REFINEMENT = "[refinement]\niterations = 20\nrounds = 2\nround_iterations = 4\n"


def test_a_preset_without_a_refinement_has_none():
    assert load_schedule("paper").refinement.iterations == 0
    stages = resolve(load_schedule("swarm"), load_model("principled"), set())
    assert [stage.title for stage in stages if isinstance(stage, ResolvedRefinement)] == []


def test_a_refinement_comes_last_and_counts_all_its_steps(tmp_path):
    stages = resolve(load_schedule(with_refinement(tmp_path, REFINEMENT)), load_model("principled"), {"base_color"})
    refinement = stages[-1]
    assert isinstance(refinement, ResolvedRefinement) and refinement.title == "refinement"
    assert [p.name for p in refinement.parameters] == ["normal", "roughness", "specular"]
    # Five steps from the estimate and from each of three starts, twenty from the best, four after each of two rounds.
    assert refinement.iterations == 5 * 4 + 20 + 2 * 4
    assert sum(track.iterations for track in refinement.tracks) == refinement.iterations


def test_starts_race_with_few_photographs_alone():
    schedule, model = load_schedule("standard"), load_model("metallic_roughness")
    few, many = (
        next(stage for stage in resolve(schedule, model, set(), count) if type(stage) is ResolvedRefinement)
        for count in (schedule.refinement.race_max_observations, schedule.refinement.race_max_observations + 1)
    )
    assert few.iterations - many.iterations == schedule.refinement.race_iterations * len(model.starts) > 0
    for refinement in (few, many):
        assert sum(track.iterations for track in refinement.tracks) == refinement.iterations


def test_starts_set_only_searched_parameters(tmp_path):
    schedule = load_schedule(with_refinement(tmp_path, REFINEMENT))
    only = resolve(schedule.replaced(search=["normal", "roughness"]), load_model("principled"), set())[-1]
    assert [dict(start) for start in only.starts] == [{"roughness": (r,)} for r in (0.15, 0.4, 0.8)]
    assert resolve(schedule.replaced(search=["normal"]), load_model("principled"), set())[-1].starts == ()
    assert resolve(schedule, load_model("lambert"), set())[-1].iterations == 20 + 2 * 4
    assert (
        resolve(schedule.replaced(refinement_starts=False), load_model("principled"), set())[-1].iterations
        == 20 + 2 * 4
    )


def test_a_schedule_may_be_a_refinement_and_nothing_else():
    alone = load_schedule("swarm").replaced(
        iterations=0, refinement_iterations=7, refinement_rounds=0, refinement_starts=False
    )
    stages = resolve(alone, load_model("lambert"), set())
    assert [(stage.title, stage.iterations) for stage in stages] == [("refinement", 7)]
    with pytest.raises(InputError, match="no stage has iterations"):
        load_schedule("swarm").replaced(iterations=0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"refinement_iterations": -1}, "refinement_iterations must be a whole number from 0, not -1"),
        ({"refinement_rounds": 1.5}, "refinement_rounds must be a whole number from 0"),
        ({"refinement_start_iterations": 0}, "refinement_start_iterations must be a whole number from 1"),
        ({"refinement_starts": 1}, "refinement_starts must be true or false, not 1"),
        ({"refinement_damping": 0.0}, "refinement_damping must be above 0"),
        ({"refinement_ftol": "much"}, "refinement_ftol must be a number from 0"),
        ({"refinement_steps": 3}, "there is no setting 'refinement_steps'"),
    ],
)
def test_an_invalid_refinement_is_refused(settings, message):
    with pytest.raises(InputError, match=message):
        load_schedule("swarm").replaced(**settings)


def test_a_preset_may_leave_out_what_has_a_default(tmp_path):
    loaded = load_schedule(with_refinement(tmp_path, REFINEMENT)).refinement
    assert loaded == Refinement(20, rounds=2, round_iterations=4)
    with pytest.raises(InputError, match=r"\[refinement\]: unknown key 'steps'"):
        load_schedule(with_refinement(tmp_path, REFINEMENT + "steps = 3\n"))
