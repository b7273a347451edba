"""The schedule as settings of a scene, and presets: shipped ones as they are shipped, the user's own in files."""

import dataclasses
import struct
import tomllib

import bpy
import pytest

import irpso_addon
from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import PRESETS

pytestmark = pytest.mark.bpy_only

SHIPPED = sorted(path.stem for path in PRESETS.glob("*.toml"))


@pytest.fixture(autouse=True)
def user_folder(tmp_path, monkeypatch):
    """Register in an empty file, with a folder of presets of the test's own; return that folder."""
    found = bpy.utils.user_resource
    folder = tmp_path / "scripts" / "presets" / "irpso"

    def user_resource(kind, path="", create=False):
        if kind != "SCRIPTS":
            return found(kind, path=path, create=create)
        place = tmp_path / "scripts" / path
        if create:
            place.mkdir(parents=True, exist_ok=True)
        return str(place)

    monkeypatch.setattr(bpy.utils, "user_resource", user_resource)
    monkeypatch.setattr(bpy.utils, "preset_paths", lambda name: [str(folder)] if folder.is_dir() else [])
    bpy.ops.wm.read_homefile(use_empty=True)
    irpso_addon.register()
    yield folder
    irpso_addon.unregister()


def settings():
    return bpy.context.scene.irpso.schedule


def schedule():
    from irpso_addon.ui.properties.schedule_settings import schedule_of

    return schedule_of(settings())


def refusal(call, *arguments, **values):
    """Return the one line that an operator refuses with."""
    with pytest.raises(RuntimeError) as caught:
        call(*arguments, **values)
    lines = str(caught.value).strip().splitlines()
    assert len(lines) == 1 and "Traceback" not in lines[0]
    return lines[0]


def bits(value):
    """Return numbers as the bits of their float64, so that equal means equal in every bit."""
    if isinstance(value, dict):
        return {key: bits(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [bits(item) for item in value]
    return struct.pack("<d", value) if isinstance(value, float) else value


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_preset_left_alone_is_the_schedule_of_its_file_in_every_bit(name):
    table = tomllib.loads((PRESETS / f"{name}.toml").read_text(encoding="utf-8"))
    if base := table.get("extends"):
        table = tomllib.loads((PRESETS / f"{base}.toml").read_text(encoding="utf-8")) | table
    settings().preset = "swarm" if name != "swarm" else "paper"
    settings().preset = name
    found = dataclasses.asdict(schedule())
    for part in ("swarm", "fitness", "prefit", "refinement", "materials", "prior", "interreflection"):
        for key, value in table.get(part, {}).items():
            assert bits(found[part][key]) == bits(value)
    assert bits(list(found["stages"])) == bits(table["stage"])
    for key in {"cycles", "threshold"} & table.keys():
        assert bits(found[key]) == bits(table[key])


def test_a_fresh_scene_has_the_standard_schedule():
    assert settings().preset == "standard"
    assert schedule() == irpso_addon.load_schedule("standard")


def test_every_setting_of_a_schedule_is_a_property_that_shows_the_value_in_effect():
    with open(PRESETS / "paper.toml", "rb") as file:
        table = tomllib.load(file)
    settings().preset = "paper"
    for name, value in {**table["swarm"], **table["fitness"], "cycles": table["cycles"]}.items():
        expected = pytest.approx(value, rel=1e-7) if isinstance(value, float) else value  # 32 bits
        assert getattr(settings(), name) == expected, name
    assert settings().iterations == 1000


@pytest.mark.parametrize("name", ["inertia", "delta", "refinement_ftol", "prior_bandwidth", "c3"])
def test_a_typed_number_reaches_the_schedule_exactly(name):
    for typed in (0.07, 0.1, 0.3, 0.025, 1e-05, 0.123456):
        setattr(settings(), name, typed)
        part, _, field = name.rpartition("_") if name.startswith(("refinement", "prior")) else ("", "", name)
        groups = [getattr(schedule(), part)] if part else [schedule().swarm, schedule().fitness]
        assert [getattr(group, field) for group in groups if hasattr(group, field)] == [typed]


def test_a_reset_setting_no_longer_differs():
    from irpso_addon.ui.properties.schedule_settings import differences

    settings().delta, settings().particles, settings().loss = 0.5, 99, "l1"
    assert differences(settings()) == {"delta": 0.5, "particles": 99, "loss": "l1"}
    settings().delta, settings().particles, settings().loss = 0.03, 8, "cauchy"
    assert differences(settings()) == {}


def test_property_limits_equal_schedule_limits():
    settings().start_fraction = 7
    settings().particles = -3
    settings().scale_percentile = 0
    settings().levels = 40
    settings().neighbourhood = 6
    found = schedule()
    assert (found.swarm.start_fraction, found.swarm.particles, found.levels, found.swarm.neighbourhood) == (1, 1, 5, 7)
    assert 0 < found.fitness.scale_percentile < 1e-5


def test_settings_that_contradict_each_other_are_refused_with_what_to_do():
    settings().update = "one"
    with pytest.raises(InputError, match='linear = "solve" needs update = "all"'):
        schedule()


def test_on_a_card_the_switch_of_interreflection_sets_the_rounds_of_the_thorough_preset():
    rounds = irpso_addon.load_schedule("thorough").interreflection.rounds
    assert rounds > 0 and not settings().interreflection
    settings().interreflection = True
    assert schedule().interreflection.rounds == rounds
    settings().interreflection = False
    assert schedule() == irpso_addon.load_schedule("standard")
    settings().preset = "thorough"
    assert settings().interreflection


def test_matte_rounds_count_on_meshes_alone_and_go_off_with_the_switch():
    assert settings().interreflection_matte_rounds > 0
    bpy.context.scene.irpso.subject = "CARD"
    assert not settings().interreflection
    bpy.context.scene.irpso.subject = "MESH"
    assert settings().interreflection
    bpy.context.scene.irpso.shadows = False
    assert not settings().interreflection
    settings().interreflection = True
    assert settings().interreflection
    settings().interreflection = False
    bpy.context.scene.irpso.shadows, settings().levels = True, 2
    assert not settings().interreflection
    settings().levels = 1
    settings().interreflection = False
    assert settings().interreflection_matte_rounds == settings().interreflection_rounds == 0
    settings().interreflection = True
    assert schedule() == irpso_addon.load_schedule("standard")


@pytest.mark.parametrize("subject", ["MESH", "CARD"])
def test_the_switch_off_and_on_keeps_the_rounds_of_the_preset(subject):
    bpy.context.scene.irpso.subject = subject
    settings().preset = "thorough"
    settings().interreflection = False
    settings().interreflection = True
    found, wanted = schedule().interreflection, irpso_addon.load_schedule("thorough").interreflection
    assert found.rounds == wanted.rounds
    assert subject == "CARD" or found == wanted


def test_an_own_preset_holds_its_schedules_name_and_what_differs_and_comes_back(user_folder):
    settings().preset = "swarm"
    settings().delta, settings().particles = 0.07, 24
    before = schedule()
    bpy.ops.irpso.preset_add(name="My Skin")
    (path,) = user_folder.iterdir()
    lines = path.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if line.startswith("schedule.")] == [
        "schedule.preset = 'swarm'", "schedule.delta = 0.07", "schedule.particles = 24",
    ]  # fmt: skip
    bpy.ops.irpso.preset_choose(name="paper")
    assert schedule() == irpso_addon.load_schedule("paper")
    bpy.ops.irpso.preset_load(filepath=str(path))
    assert schedule() == before == irpso_addon.load_schedule("swarm").replaced(delta=0.07, particles=24)


def test_an_own_preset_can_be_run_by_blender_like_its_own(user_folder):
    settings().delta = 0.07
    bpy.ops.irpso.preset_add(name="mine")
    settings().preset = "paper"
    bpy.utils.execfile(str(user_folder / "mine.py"))
    assert schedule() == irpso_addon.load_schedule("standard").replaced(delta=0.07)


def test_the_menu_says_which_preset_is_set_and_whether_settings_differ_from_it(user_folder):
    from irpso_addon.ui.operators.presets import label_of

    assert label_of(settings()) == "Standard"
    settings().delta = 0.07
    assert label_of(settings()) == "Standard *"
    bpy.ops.irpso.preset_add(name="skin")
    assert label_of(settings()) == "skin"
    settings().delta = 0.08
    assert label_of(settings()) == "skin *"
    bpy.ops.irpso.preset_choose(name="paper")
    assert label_of(settings()) == "Paper"


def test_an_own_preset_can_be_removed_and_a_shipped_one_neither_removed_nor_replaced(user_folder):
    settings().delta = 0.07
    bpy.ops.irpso.preset_add(name="skin")
    bpy.ops.irpso.preset_add(remove_active=True)
    assert list(user_folder.iterdir()) == [] and settings().own == ""
    assert settings().delta == pytest.approx(0.07)
    for values in ({"remove_active": True}, {"name": "standard", "remove_name": True}):
        assert "Shipped presets cannot be removed" in refusal(bpy.ops.irpso.preset_add, **values)
    for name in ("Standard", "paper"):
        assert "Shipped presets cannot be replaced" in refusal(bpy.ops.irpso.preset_add, name=name)
    assert list(user_folder.iterdir()) == []
    assert sorted(path.stem for path in PRESETS.glob("*.toml")) == SHIPPED


HEAD = "import bpy\nschedule = bpy.context.scene.irpso.schedule\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + "schedule.preset = 'nonsense'\n", "preset 'nonsense' is not shipped; choose one of"),
        (HEAD + "schedule.preset = 'paper'\nschedule.particels = 3\n", "there is no setting 'particels'"),
        (HEAD + "schedule.preset = 'paper'\nschedule.search = ['normal']\n", "there is no setting 'search'"),
        (HEAD + "schedule.preset = 'paper'\nschedule.particles = -3\n", "particles must be a whole number from 1"),
        (HEAD + "schedule.preset = 'paper'\nschedule.start_fraction = 2.0\n", "start_fraction must be at most 1"),
        (HEAD + "schedule.particles = 3\n", "names no schedule"),
        (HEAD + "schedule.preset = 'paper'\nschedule.particles = open('x')\n", "line 4 sets no setting"),
        (HEAD + "schedule.preset = 'paper'\nbpy.ops.wm.quit_blender()\n", "line 4 sets no setting"),
        ("schedule.preset = (\n", "line 1 sets no setting"),
        ("\0", "line 1 sets no setting"),
    ],
)
def test_a_preset_file_with_a_mistake_is_refused_in_one_line_and_changes_nothing(tmp_path, text, message):
    path = tmp_path / "bad.py"
    path.write_text(text, encoding="utf-8")
    settings().delta = 0.07
    before = schedule()
    assert message in refusal(bpy.ops.irpso.preset_load, filepath=str(path))
    assert str(path) in refusal(bpy.ops.irpso.preset_load, filepath=str(path))
    assert schedule() == before and settings().preset == "standard"


def test_an_own_preset_of_an_earlier_version_keeps_its_settings(tmp_path):
    path = tmp_path / "old.py"
    path.write_text(HEAD + "schedule.preset = 'standard'\nschedule.polish_gain = 0.25\nschedule.survey_trust = 2.0\n")
    bpy.ops.irpso.preset_load(filepath=str(path))
    assert (schedule().refinement.ftol, schedule().prefit.acceptance_ratio) == (0.25, 2.0)


def test_an_own_preset_of_format_2_keeps_its_settings_and_is_unchanged(tmp_path):
    from irpso_addon.ui.operators.presets import label_of

    text = (
        "schedule.preset = 'paper'\nschedule.loss = 'robust'\nschedule.prior_turn = False\nschedule.seed = 'lambert'\n"
    )
    (tmp_path / "old.py").write_text(HEAD + text)
    bpy.ops.irpso.preset_load(filepath=str(tmp_path / "old.py"))
    changes = {"loss": "cauchy", "prior_normals": False, "start": "lambert"}
    assert schedule() == irpso_addon.load_schedule("paper").replaced(**changes)
    settings().own_text = HEAD + text  # as a scene of that version has it
    assert label_of(settings()) == "old"
    settings().prior_normals = True
    assert label_of(settings()) == "old *"


def test_an_own_preset_with_a_former_and_the_present_name_is_refused(tmp_path):
    (tmp_path / "old.py").write_text(
        HEAD + "schedule.preset = 'paper'\nschedule.seed = 'lambert'\nschedule.start = 'random'\n"
    )
    assert "there is no setting 'seed'" in refusal(bpy.ops.irpso.preset_load, filepath=str(tmp_path / "old.py"))


def test_a_missing_own_preset_is_refused_in_one_line(tmp_path):
    assert "No such file" in refusal(bpy.ops.irpso.preset_load, filepath=str(tmp_path / "gone.py"))


def test_a_schedule_of_the_users_own_is_a_preset_by_its_path(tmp_path):
    text = (PRESETS / "swarm.toml").read_text(encoding="utf-8").replace("inertia = 0.6", "inertia = 0.55")
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    settings().preset = str(tmp_path / "own.toml")
    assert schedule().swarm.inertia == 0.55
    settings().preset = str(tmp_path / "gone.toml")
    with pytest.raises(InputError, match="cannot be read"):
        schedule()


def test_an_own_preset_of_a_schedule_beside_the_blend_file_serves_other_files(user_folder, tmp_path):
    (tmp_path / "own.toml").write_text((PRESETS / "swarm.toml").read_text(encoding="utf-8"), encoding="utf-8")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    settings().preset, settings().delta = "//own.toml", 0.07
    wanted = schedule()
    bpy.ops.irpso.preset_add(name="beside")
    (tmp_path / "b").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "b" / "b.blend"))
    settings().preset = "standard"
    bpy.ops.irpso.preset_load(filepath=str(user_folder / "beside.py"))
    assert schedule() == wanted


def test_a_scenes_schedule_survives_saving(tmp_path):
    settings().preset = "paper"
    settings().delta = 0.07
    before = schedule()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    assert schedule() == irpso_addon.load_schedule("standard")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert schedule() == before


def test_a_scene_of_an_earlier_version_keeps_its_settings(tmp_path):
    from irpso_addon.blender.scenes.scene_capture import system_properties

    stored = system_properties(settings())
    stored["polish_rounds"], stored["survey_judge_delta"], stored["polish_starts"] = 7, 0.125, False
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "old.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "old.blend"))
    assert (schedule().refinement.rounds, schedule().refinement.starts) == (7, False)
    assert schedule().prefit.acceptance_delta == 0.125 and "polish_rounds" not in system_properties(settings())


def test_a_scene_of_format_2_keeps_its_settings(tmp_path):
    from irpso_addon.blender.scenes.scene_capture import system_properties

    settings().preset = "paper"
    stored = system_properties(settings())
    stored["seed"], stored["loss"] = 1, 2  # Blender stores the numbers of choices: lambert, robust
    stored["c3_until"], stored["neighbour_every"], stored["bounds"] = 0.25, 9, True
    stored["refinement_votes"], stored["prior_turn"], stored["prior_share"] = 2.5, False, 0.125
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "old.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "old.blend"))
    wanted = irpso_addon.load_schedule("paper").replaced(
        start="lambert", loss="cauchy", c3_fade=0.25, neighbour_interval=9, clipped_samples=True,
        refinement_neighbour_weight=2.5, prior_normals=False, prior_min_influence=0.125,
    )  # fmt: skip
    assert schedule() == wanted and "seed" not in system_properties(settings())
