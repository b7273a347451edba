"""The window's session and the job it is given: what is read anew, what is given, and how a run ends."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from irpso_addon.blender.materials.material import build_material
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.core.errors import InputError
from irpso_addon.reflectance.model import load_model
from irpso_addon.results.maps import Maps
from irpso_addon.results.read import read_parameter
from irpso_addon.results.write import write_maps
from tests.builders import command_line as cli_maker
from tests.gpu.blender.test_material import random_maps

SHAPE = (10, 12)
LIGHTS = cli_maker.dome_lights(12, widest=70)


pytestmark = pytest.mark.usefixtures("registered")


@pytest.fixture
def scene():
    bpy.ops.wm.read_homefile(use_empty=True)
    return bpy.context.scene


@pytest.fixture
def folder(tmp_path):
    """A capture in the layout whose lights stand in a list of their own."""
    values = cli_maker.smooth_maps(SHAPE, {"roughness": (0.25, 0.6), "specular": (0.3, 0.8)}, seed=3)
    images = cli_maker.render_oracle("principled", values, LIGHTS)
    names = [f"{number:03d}.exr" for number in range(len(images))]
    for name, image in zip(names, images, strict=True):
        write_exr(tmp_path / name, {"image": dict(zip("RGB", np.moveaxis(np.float32(image), -1, 0), strict=True))})
    (tmp_path / "filenames.txt").write_text("\n".join(names))
    (tmp_path / "light_directions.txt").write_text("\n".join(" ".join(map(str, light[:3])) for light in LIGHTS))
    return tmp_path


@pytest.fixture
def job(scene, folder):
    from irpso_addon.ui.session.scene_job import make_job

    scene.irpso.capture_path, scene.irpso.subject = str(folder), "CARD"
    return lambda: make_job(bpy.context)


@pytest.fixture
def running(job):
    """A session under way."""
    from irpso_addon.ui.session import session

    bpy.context.scene.irpso.schedule.iterations = 4000
    running = session.begin(job())
    while running.recovery is None:
        running.tick(0.05)
    running.tick(0.05)
    assert running.state == "running"
    yield running
    session.end()


def swap_first_lines(path):
    first, second, *others = path.read_text().splitlines()
    path.write_text("\n".join([second, first, *others]))


@pytest.mark.parametrize("name", ["light_directions.txt", "filenames.txt"])
def test_a_list_that_was_edited_in_place_makes_another_domain(job, folder, name):
    before = job().source
    assert job().source == before
    swap_first_lines(folder / name)
    assert job().source != before


def test_a_camera_that_was_edited_in_place_makes_another_domain(job, folder):
    (folder / "camera.toml").write_text("fov_degrees = 30\n")
    before = job().source
    (folder / "camera.toml").write_text("fov_degrees = 31\n")
    assert job().source != before


def test_shadows_are_predicted_unless_switched_off_and_that_makes_another_domain(job, monkeypatch):
    from irpso_addon.pipeline import run as module

    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=6)
    settings = bpy.context.scene.irpso
    settings.subject, settings.resolution = "MESH", 8
    asked, sources = [], []

    def steps(*_, shadows, **__):
        asked.append(shadows)
        raise InputError("far enough")

    monkeypatch.setattr(module, "mesh_steps", steps)
    for wanted in (None, False, True):
        if wanted is not None:
            settings.shadows = wanted
        made = job()
        with pytest.raises(InputError, match="far enough"):
            list(module.Run(made).open())
        sources.append(made.source)
    assert asked == [True, False, True]
    assert sources[0] == sources[2] != sources[1]


def test_reading_a_mesh_ends_with_its_images_and_camera(job):
    from irpso_addon.ui.session import session

    bpy.ops.mesh.primitive_plane_add(size=2)
    settings = bpy.context.scene.irpso
    settings.subject, settings.resolution = "MESH", 8
    running = session.begin(job())
    fractions = []
    while running.recovery is None:
        running.tick(1e-6)
        if running.state == "loading":
            fractions.append(running.fraction)
    session.end()
    assert fractions == sorted(fractions) and fractions[0] < 0.1 and fractions[-1] == 1.0
    assert fractions.count(1.0) == 1 and len(set(fractions)) > len(LIGHTS)


def test_a_mesh_that_is_shaded_smooth_makes_another_domain(job):
    bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=6)
    obj = bpy.context.object
    bpy.context.scene.irpso.subject = "MESH"
    obj.data.shade_flat()
    flat = job().source
    assert job().source == flat
    obj.data.shade_smooth()
    assert job().source != flat


def given(name, path, space, model="principled"):
    from irpso_addon.ui.session.scene_job import image_map

    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = space
    return image_map(image, load_model(model), name, SHAPE)


@pytest.fixture
def maps(scene, tmp_path, request):
    model, random = load_model(getattr(request, "param", "principled")), np.random.default_rng(5)
    values = {p.name: np.float32(random.uniform(0.1, 0.9, (*SHAPE, p.components))) for p in model.parameters}
    normals = random.normal(size=(*SHAPE, 3)) * 0.5 + (0, 0, 1.5)
    values["normal"] = np.float32(normals / np.linalg.norm(normals, axis=-1, keepdims=True))
    write_maps(Maps(model, values, np.ones(SHAPE, bool)), tmp_path / "maps", {}, {})
    return tmp_path / "maps", values


@pytest.mark.parametrize(
    ("file", "space"),
    [
        ("normal.exr", "Non-Color"), ("roughness.exr", "Linear Rec.709"), ("base_color.exr", "Linear Rec.709"),
        ("normal.png", "Non-Color"), ("roughness.png", "Non-Color"), ("base_color.png", "sRGB"),
        ("normal.png", "sRGB"), ("roughness.png", "sRGB"),  # what Blender takes every PNG for
    ],
)  # fmt: skip
def test_maps_that_were_written_can_be_given_again(maps, file, space):
    folder, values = maps
    name, _, ending = file.partition(".")
    found = given(name, folder / file, space)
    assert np.abs(found - values[name]).max() <= (0 if ending == "exr" else 1e-4)


@pytest.mark.parametrize(
    ("maps", "file", "names"),
    [
        ("cook_torrance_two_lobe", "roughness_lobes", ("r1", "r2", "w")),
        ("anisotropic", "anisotropy", ("stretch", "slant")),  # a PNG of −1…1 holds a fraction of it
    ],
    indirect=["maps"],
)
@pytest.mark.parametrize(("ending", "tolerance"), [("exr", 0), ("png", 1e-4)])
def test_numbers_that_share_a_map_are_read_from_their_own_channels(maps, file, names, ending, tolerance):
    folder, values = maps
    model = "anisotropic" if "slant" in names else "cook_torrance_two_lobe"
    for name in names:
        path = folder / f"{file}.{ending}"
        assert np.abs(given(name, path, "Non-Color", model) - values[name]).max() <= tolerance
        if ending == "exr":
            np.testing.assert_array_equal(read_parameter(path, load_model(model), name), values[name])


def test_one_number_of_a_coloured_picture_is_refused(maps):
    folder, _ = maps
    with pytest.raises(InputError, match=r"base_color.exr.*its channels differ, and roughness is one number"):
        given("roughness", folder / "base_color.exr", "Non-Color")
    with pytest.raises(InputError, match=r"base_color.exr: its channels differ, and roughness is one number"):
        read_parameter(folder / "base_color.exr", load_model("principled"), "roughness")


def test_a_flat_normal_map_is_flat_in_either_way_of_writing(scene, tmp_path):
    for number, flat in enumerate([(0, 0, 1), (0.5, 0.5, 1)]):
        image = np.broadcast_to(np.float32(flat), (*SHAPE, 3))
        path = tmp_path / f"{number}.exr"
        write_exr(path, {"image": dict(zip("RGB", np.moveaxis(image, -1, 0), strict=True))})
        np.testing.assert_allclose(given("normal", path, "Non-Color"), np.broadcast_to((0, 0, 1), (*SHAPE, 3)))


def test_both_ends_of_a_range_can_be_given(job):
    item = bpy.context.scene.irpso.parameters["roughness"]
    item.recover = False
    for value in load_model("principled").parameter("roughness").range:
        item.value = value
        assert job().fixed["roughness"] == np.float32(value)
    item.value = 0.019
    with pytest.raises(InputError, match="between 0.02 and 1"):
        job()


def test_a_refused_schedule_does_not_replace_the_running_one(running):
    running.pause()
    before = running.job.schedule
    for _ in range(2):
        with pytest.raises(InputError, match="Levels"):
            running.resume(before.replaced(levels=2))
        assert running.state == "paused" and running.job.schedule == before


def test_any_error_in_a_tick_ends_the_session_and_is_reported(running, monkeypatch):
    def fail(**_):
        raise RuntimeError("the device is gone")

    monkeypatch.setattr(running.recovery, "step", fail)
    running.tick(0.01)
    assert running.closed and running.failure == "The recovery has ended: the device is gone"


def test_resume_takes_the_settings_of_the_scene_in_which_it_began_and_only_there_they_are_shown(running):
    from tests.builders.drawn_panels import labels

    home, other = bpy.context.scene, bpy.data.scenes.new("Other")
    running.pause()
    other.irpso.capture_path, other.irpso.schedule.iterations = home.irpso.capture_path, 7
    home.irpso.schedule.delta = 0.0625
    assert "Search Settings" in labels()
    bpy.context.window.scene = other
    assert "Search Settings" not in labels()
    assert bpy.ops.irpso.resume() == {"FINISHED"}
    schedule = running.job.schedule
    assert schedule.fitness.delta == 0.0625
    running.pause()
    bpy.data.scenes.remove(home)
    assert bpy.ops.irpso.resume() == {"FINISHED"} and running.job.schedule == schedule


def test_closing_the_file_pauses_and_ends_the_timer(running):
    from irpso_addon.ui.operators.recover import IRPSO_OT_run

    ended = []
    context = SimpleNamespace(window_manager=SimpleNamespace(event_timer_remove=ended.append))
    run = SimpleNamespace(_session=running, _number=running.runs, _timer="timer", _is_current=lambda: True)
    IRPSO_OT_run.cancel(run, context)
    assert ended == ["timer"] and running.state == "paused"


def test_stopping_keeps_and_ends_the_run(running):
    assert bpy.ops.irpso.stop() == {"FINISHED"}
    assert running.state == "done" and running.kept
    assert bpy.ops.irpso.recover.poll()


def test_a_stopped_run_resumes_to_the_maps_of_an_unstopped_one(job):
    from irpso_addon.ui.session import session

    bpy.context.scene.irpso.schedule.preset = "swarm"
    bpy.context.scene.irpso.schedule.iterations = 6
    running = session.begin(job())
    running.run()
    whole, total = running.maps().values, running.progress.iterations_in_all
    running = session.begin(job())
    while running.recovery is None:
        running.tick(0.05)
    running.recovery.step(2)
    assert not running.stopped and bpy.ops.irpso.stop() == {"FINISHED"}
    assert running.stopped and running.kept and (running.state, running.title) == ("done", "Stopped")
    assert (running.progress.iteration_in_all, total) == (2, 6)
    assert bpy.ops.irpso.resume() == {"FINISHED"} and running.state == "running"
    running.run()
    assert not running.stopped and running.title == "Done"
    assert not running.kept  # the material holds what was found after 2 iterations
    for name, values in running.maps().values.items():
        np.testing.assert_array_equal(values, whole[name])
    session.end()


def test_kept_maps_stay_kept_until_undo(running):
    from irpso_addon.ui.operators import recover
    from irpso_addon.ui.overlay import surface

    def seen():
        rendered = SimpleNamespace(space_data=SimpleNamespace(shading=SimpleNamespace(type="MATERIAL")))
        return surface.shows_itself(rendered, running), recover.IRPSO_OT_cancel.description(bpy.context, None)[:4]

    running.pause()
    assert seen() == (False, "Disc")
    bpy.ops.irpso.keep()
    assert seen() == (True, "Clos")
    (made,) = bpy.data.materials
    made["irpso_kept"] = "another run"  # what an undo brings back where an earlier run's maps were kept before
    assert seen() == (False, "Disc")
    bpy.data.materials.remove(made)
    assert seen() == (False, "Disc")


def test_stopping_reports_in_one_line_why_it_cannot_keep(running, monkeypatch):
    from irpso_addon.ui.session import keep

    def refuse(*_):
        raise InputError("'leaf' has been deleted: undo that")

    monkeypatch.setattr(keep, "_keep", refuse)
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.stop()
    assert str(caught.value).strip() == "Error: 'leaf' has been deleted: undo that"
    assert running.state == "paused" and not running.kept


def test_a_mesh_is_shown_with_the_uv_map_of_its_maps(job):
    from irpso_addon.ui.session import session

    settings = bpy.context.scene.irpso
    bpy.ops.mesh.primitive_plane_add(location=(0, 0, -1))
    obj, settings.subject, settings.resolution = bpy.context.object, "MESH", 8
    settings.schedule.preset, settings.schedule.iterations = "swarm", 2
    layers = obj.data.uv_layers
    layers.active = layers.new(name="Turned")
    coordinates = np.empty(8, np.float32)
    layers["Turned"].uv.foreach_get("vector", coordinates)
    layers["Turned"].uv.foreach_set("vector", 1 - coordinates)
    assert layers["UVMap"].active_render
    for marked, nodes in (("UVMap", ["Turned"]), ("Turned", [])):
        layers[marked].active_render = True
        session.begin(job()).run()
        bpy.ops.irpso.keep()
        tree = obj.active_material.node_tree
        assert [node.uv_map for node in tree.nodes if node.bl_idname == "ShaderNodeUVMap"] == nodes
        textures = [node for node in tree.nodes if node.bl_idname == "ShaderNodeTexImage"]
        assert all(node.inputs["Vector"].is_linked == bool(nodes) for node in textures) and textures
        (normal,) = [node for node in tree.nodes if node.bl_idname == "ShaderNodeNormalMap"]
        assert normal.uv_map == ("Turned" if nodes else "")
    session.end()


def test_errors_use_blenders_setting_names(job, monkeypatch):
    from irpso_addon.ui.properties import preferences
    from irpso_addon.ui.session import session

    monkeypatch.setattr(preferences, "current", lambda context: preferences.PreferenceValues(memory="device=1K"))
    running = session.begin(job())
    while running.active:
        running.tick(0.05)
    assert running.failure.startswith("Memory Budget device=1.0 KiB") and "--" not in running.failure


def test_a_finished_recovery_has_the_warnings_of_the_report_and_the_panel_shows_them(scene, folder, job):
    from irpso_addon.ui.session import keep, session
    from tests.builders.drawn_panels import drawn

    # Lights a fifth as strong: the photographs are brighter than a white surface.
    (folder / "light_intensities.txt").write_text("\n".join(["0.2 0.2 0.2"] * len(LIGHTS)))
    scene.irpso.schedule.iterations = 10
    running = session.begin(job())
    running.run()
    report = keep.report_of(running, keep.current_maps(running, confidence=False))
    session_warnings = list(running.warnings)
    assert any("base_color is at its limit" in text for text in session_warnings)
    assert [text for text in report["warnings"] if text in session_warnings] == session_warnings
    assert "Base_color is at its limit" in " ".join(drawn().texts)  # wrapped
    session.end()


def test_a_check_that_fails_loses_no_maps(scene, job, monkeypatch):
    from irpso_addon.ui.common import failures
    from irpso_addon.ui.session import recovery, session

    def fail(*arguments):
        raise RuntimeError("no check today")

    monkeypatch.setattr(recovery, "maps_warnings", fail)
    scene.irpso.schedule.iterations = 5
    running = session.begin(job())
    running.run()
    assert running.state == "done" and not running.warnings and running.maps().solved.any()
    assert any("no check today" in text for text in failures.messages())
    failures.clear()
    session.end()


def test_a_file_that_cannot_be_opened_removes_no_picture_that_undo_shows(registered, tmp_path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    for seed in (0, 1):
        build_material(random_maps(load_model("lambert"), seed), "icon", tmp_path)
    assert len(list(tmp_path.glob("*.png"))) == 4
    (tmp_path / "damaged.blend").write_bytes(b"BLENDER-v500damaged")
    with pytest.raises(RuntimeError):
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "damaged.blend"))
    assert len(list(tmp_path.glob("*.png"))) == 4
    bpy.ops.wm.read_homefile(use_empty=True)
    assert len(list(tmp_path.glob("*.png"))) == 2
