"""Captures of files and of the scene in the window's settings: import, check, what bars Recover."""

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

import irpso_addon
from irpso_addon.blender.images import decode
from irpso_addon.capture import write_exr
from irpso_addon.capture.inspect.report import inspect_steps
from irpso_addon.core.errors import InputError
from irpso_addon.core.paths import PRESETS
from irpso_addon.pipeline.result import capture_warnings
from irpso_addon.solver.settings.schedule import load_schedule
from irpso_addon.ui.operators import capture_import
from irpso_addon.ui.properties import findings
from irpso_addon.ui.properties.schedule_settings import schedule_of
from irpso_addon.ui.session import scene_capture
from tests.builders.captures import LIGHTS, chunk, shade, sphere, write_diligent, write_png
from tests.builders.exif import exif
from tests.builders.scene_captures import add_camera, add_light, created, image_of, write_views

pytestmark = [pytest.mark.bpy_only, pytest.mark.usefixtures("registered")]


@pytest.fixture(autouse=True)
def scene(registered):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


# ---- files


@pytest.mark.parametrize("chosen", ["", "filenames.txt", "002.exr", "camera.toml"])
def test_any_file_of_a_folder_imports_the_folder(scene, tmp_path, chosen):
    write_diligent(tmp_path / "bowl")
    (tmp_path / "bowl" / "camera.toml").write_text("fov_degrees = 30.0\n")
    assert bpy.ops.irpso.import_capture(filepath=str(tmp_path / "bowl" / chosen)) == {"FINISHED"}
    settings = scene.irpso
    assert (settings.source, settings.subject) == ("FILES", "CARD")
    assert settings.capture_path == str((tmp_path / "bowl").resolve()) == settings.checked_path
    assert "images: 5" in settings.summary and "24×24 perspective" in settings.summary
    capture = scene_capture.capture_of(scene)
    np.testing.assert_allclose([o.light.vector for o in capture.observations], LIGHTS, atol=1e-7)


def test_a_list_of_lights_is_a_card_and_cameras_around_something_are_a_mesh(scene, tmp_path):
    write_diligent(tmp_path / "a")
    rows = [f"{k:03d}.exr {x} {y} {z}" for k, (x, y, z) in enumerate(LIGHTS)]
    (tmp_path / "a" / "dome.lp").write_text("\n".join(["5", *rows]))
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "a" / "dome.lp"))
    assert scene.irpso.subject == "CARD" and scene.irpso.capture_path.endswith("dome.lp")
    write_views(tmp_path / "b")
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "b" / "capture.toml"))
    assert scene.irpso.subject == "MESH"


def test_a_path_beside_an_unsaved_file_is_a_finding(scene):
    settings = scene.irpso
    settings.capture_path = "//photographs"
    for check in (bpy.ops.irpso.check_capture, lambda: setattr(settings, "skip_damaged", True)):
        settings.findings.clear()
        check()
        (finding,) = findings.shown(settings)
        assert finding.severity == "error" and "Capture: //photographs lies beside the .blend file" in finding.message


@pytest.mark.parametrize("chosen", ["nothing", "gone/capture.toml", "odd.lp", ""])
def test_another_file_than_a_capture_is_reported_in_one_line_and_changes_nothing(scene, tmp_path, chosen):
    write_diligent(tmp_path / "good")
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "good"))
    (tmp_path / "nothing").mkdir()
    (tmp_path / "odd.lp").write_text("two\nimages")
    before = {name: getattr(scene.irpso, name) for name in ("source", "capture_path", "summary", "checked_path")}
    with pytest.raises(RuntimeError) as caught:
        bpy.ops.irpso.import_capture(filepath=str(tmp_path / chosen) if chosen else "")
    assert len(str(caught.value).strip().splitlines()) == 1
    assert {name: getattr(scene.irpso, name) for name in before} == before


def test_other_exposures_by_exif_are_findings_of_the_check_and_warnings_of_the_result(scene, tmp_path):
    write_diligent(tmp_path / "a")
    for k, seconds in enumerate((60, 60, 30, 60, 60)):
        codes = np.random.default_rng(k).integers(20, 200, (24, 24, 3))
        write_png(tmp_path / "a" / f"{k:03d}.png", codes, 8, chunk(b"eXIf", exif((1, seconds))))
    (tmp_path / "a" / "filenames.txt").write_text("".join(f"{k:03d}.png\n" for k in range(5)))
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "a"))
    (found,) = [item.message for item in scene.irpso.findings if item.code == "exposure"]
    assert found.startswith("002.png: its exposure by EXIF is 1.0 stops above")
    (warning,) = capture_warnings(scene_capture.capture_of(scene), reads=False)  # as the panel draws them
    assert warning.endswith(found)


def test_findings_of_the_check_are_kept_as_settings(scene, tmp_path):
    normals, mask = sphere(24)
    frames = shade(normals)
    frames[3] = 0
    write_diligent(tmp_path / "a", frames, mask=mask)
    (tmp_path / "a" / "001.exr").unlink()
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "a"))
    (missing,) = [item for item in scene.irpso.findings if item.severity == "error"]
    assert missing.message.startswith("001.exr: this image is not there;")  # without its folder: a panel is narrow
    write_exr(tmp_path / "a" / "001.exr", {"": dict.fromkeys("RGB", frames[1])})
    bpy.ops.irpso.check_capture()
    assert {item.severity for item in scene.irpso.findings} == {"warning"}
    assert any("003.exr: is all black" in item.message for item in scene.irpso.findings)


def test_light_sufficiency_follows_the_recovered_parameters(scene):
    settings = scene.irpso
    asked = {}
    for name in ("lambert", "principled", "cook_torrance_two_lobe"):
        settings.model = name
        asked[name] = capture_import.goals_of(settings)
    assert asked == {
        "lambert": ("normals",), "principled": ("normals", "roughness"),
        "cook_torrance_two_lobe": ("normals", "two lobes"),
    }  # fmt: skip
    settings.model = "principled"
    for item in settings.parameters:
        item.recover = item.name == "base_color"
    assert capture_import.goals_of(settings) == ()


def test_a_check_pauses_at_every_image(tmp_path):
    write_diligent(tmp_path / "a")
    lines = list(inspect_steps(tmp_path / "a", decode))
    for words in ("Looking at headers: {} of 5", "Checking images: {} of 5"):
        assert [words.format(k) for k in range(1, 6)] == [line for line in lines if line.startswith(words[:8])][:5]


def test_a_slice_of_a_check_is_short_and_another_capture_ends_it(scene, tmp_path):
    normals, mask = sphere(24)
    write_diligent(tmp_path / "a", shade(normals), mask=mask)
    bpy.ops.irpso.import_capture(filepath=str(tmp_path / "a"))
    scene.irpso.summary = ""
    steps = inspect_steps(tmp_path / "a", decode)
    check = capture_import._Check(scene.session_uid, scene.irpso.capture_path, steps)
    capture_import._running[:] = [check]
    assert capture_import._slice(check, 1e-5) and check.doing.startswith("Looking") and scene.irpso.summary == ""
    assert not capture_import._slice(check, 60.0) and "5 distant" in scene.irpso.summary
    assert capture_import._running == []
    capture_import._running[:] = [check]
    scene.irpso.capture_path = str(tmp_path)
    assert not capture_import._slice(check, 60.0) and capture_import._running == []


def test_files_can_be_dropped_where_maps_are_seen():
    handler = capture_import.CaptureFiles
    assert handler.bl_import_operator == "irpso.import_capture"
    assert handler.bl_file_extensions.split(";") == [".lp", ".toml", ".txt"]


# ---- what bars Recover


def recoverable(scene):
    """Return whether Recover can be pressed, and what the panel says where it cannot."""
    from irpso_addon.ui.properties import upkeep
    from irpso_addon.ui.session import scene_job

    upkeep.fill_lists()
    return bpy.ops.irpso.recover.poll(), scene_job.missing(bpy.context)


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_lights_bar_recover_with_the_reason_unless_normals_are_given(scene, tmp_path, count):
    normals, mask = sphere(24)
    write_diligent(tmp_path, shade(normals)[:count], LIGHTS[:count], mask)
    bpy.ops.irpso.import_capture(filepath=str(tmp_path))
    possible, why = recoverable(scene)
    assert not possible and f"has {count} light" in why and "a normal needs at least three" in why
    assert "enough for: not for normals (few)" in scene.irpso.summary
    for item in scene.irpso.parameters:
        item.recover = not item.is_normal
    assert recoverable(scene) == (True, "") and findings.shown(scene.irpso) == []


def test_lights_of_the_scene_that_are_too_few_bar_recover_with_the_reason(scene, tmp_path):
    image = image_of(tmp_path / "a.png", np.full((4, 4, 3), 99))
    add_camera(scene)
    scene.irpso.source = "SCENE"
    for count in range(3):
        possible, why = recoverable(scene)
        assert not possible and ("No light" if count == 0 else f"Only {count} light") in why
        add_light(scene, f"Key {count}", image)
    assert recoverable(scene)[0]
    bpy.ops.irpso.check_capture()  # all three shine from above
    assert [item.code for item in scene.irpso.findings] == ["lights_same"]


def test_a_damaged_image_bars_recover_until_it_is_left_out(scene, tmp_path):
    normals, mask = sphere(24)
    write_diligent(tmp_path, shade(normals), mask=mask)
    (tmp_path / "001.exr").write_bytes((tmp_path / "001.exr").read_bytes()[:-50])
    bpy.ops.irpso.import_capture(filepath=str(tmp_path))
    possible, why = recoverable(scene)
    assert not possible and "001.exr: is cut short" in why
    scene.irpso.skip_damaged = True  # which checks again
    assert recoverable(scene) == (True, "") and "images: 4, 1 more left out" in scene.irpso.summary
    assert any("left out: 001.exr: is cut short" in item.message for item in scene.irpso.findings)
    capture = scene_capture.capture_of(scene)
    assert [one.index for one in capture.left_out] == [1] and len(capture.observations) == 4
    assert bpy.ops.irpso.create_scene() == {"FINISHED"}
    assert sum(obj.type == "LIGHT" for obj in scene.objects) == 4


def test_a_color_space_is_checked_when_it_is_chosen(scene, tmp_path):
    write_diligent(tmp_path)
    names = [f"{k}.png" for k in range(5)]
    for name in names:
        write_png(tmp_path / name, np.full((24, 24, 3), 128), 8)
    (tmp_path / "filenames.txt").write_text("\n".join(names))
    bpy.ops.irpso.import_capture(filepath=str(tmp_path))
    assert "frame means 0.2159" in scene.irpso.summary  # sRGB
    scene.irpso.colour_space = "linear"
    assert "frame means 0.502" in scene.irpso.summary


def test_a_damaged_photograph_of_the_scene_is_left_out(scene, tmp_path):
    write_views(tmp_path / "views")
    created(scene, tmp_path / "views" / "capture.toml")
    scene.irpso.subject = "MESH"
    lights = sorted((obj for obj in scene.objects if obj.type == "LIGHT"), key=lambda obj: obj.name)
    path = scene_images_file(lights[2].irpso.image)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match=f"light '{lights[2].name}'.*cut short.*--skip-damaged"):
        scene_capture.capture_of(scene)
    bpy.ops.irpso.check_capture()
    (item,) = scene.irpso.findings
    assert item.code == "image_truncated" and "Leave Out Damaged Images" in item.message
    scene.irpso.skip_damaged = True
    capture = scene_capture.capture_of(scene)
    assert [one.image for one in capture.left_out] == [lights[2].name] and len(capture.observations) == 3
    assert any("left out" in item.message for item in scene.irpso.findings)


def scene_images_file(image):
    from irpso_addon.blender.scenes import scene_images

    return scene_images.file_of(image)


# ---- the open file in another folder


def write_grey(folder, code):
    """Write a capture of four grey photographs of one code, its chart and a model; return its list of lights."""
    for k in range(4):
        write_png(folder / f"p{k}.png", np.full((16, 16, 3), code))
    places = [(0.6, 0), (0, 0.6), (-0.6, 0), (0, -0.6)]
    (folder / "lights.lp").write_text("4\n" + "".join(f"p{k}.png {x} {y} 0.8\n" for k, (x, y) in enumerate(places)))
    return folder / "lights.lp"


@pytest.fixture
def two_jobs(scene, tmp_path):
    """Two folders with photographs of the same names; the first one's are the capture of the file saved in it."""
    jobs = [tmp_path / name for name in ("first", "second")]
    for job, code in zip(jobs, (50, 220), strict=True):
        (job / "photos").mkdir(parents=True)
        write_grey(job / "photos", code)
    bpy.ops.wm.save_as_mainfile(filepath=str(jobs[0] / "card.blend"))
    bpy.context.preferences.filepaths.use_relative_paths = True
    bpy.ops.irpso.import_capture(filepath=str(jobs[0] / "photos" / "lights.lp"))
    settings = bpy.context.scene.irpso
    settings.chart_photograph, settings.model_path = "//photos/p0.png", "//photos/own.toml"
    shutil.copy(PRESETS / "paper.toml", jobs[0] / "photos" / "search.toml")
    settings.schedule.preset, settings.schedule.inertia = "//photos/search.toml", 0.25
    settings.chart_corners[0] = 3.0
    assert settings.capture_path == "//photos/lights.lp" == settings.checked_path
    return jobs


def assert_first_job(folder):
    settings = bpy.context.scene.irpso
    photos = folder / "photos"
    assert scene_capture.capture_path(settings).resolve() == photos / "lights.lp"
    for name, path in (("chart_photograph", "p0.png"), ("model_path", "own.toml")):
        assert getattr(settings, name).startswith("//")
        assert Path(bpy.path.abspath(getattr(settings, name))).resolve() == photos / path
    assert settings.schedule.preset.startswith("//")
    assert schedule_of(settings.schedule) == load_schedule(str(photos / "search.toml")).replaced(inertia=0.25)
    assert findings.is_checked(settings) and settings.chart_corners[0] == 3.0  # unlike with another capture
    assert scene_capture.capture_of(bpy.context.scene).observations[0].read()[..., :3].max() < 0.1


def test_a_file_saved_in_another_folder_keeps_its_capture(two_jobs):
    first, second = two_jobs
    bpy.ops.wm.save_as_mainfile(filepath=str(second / "card.blend"))
    assert_first_job(first)
    bpy.ops.wm.open_mainfile(filepath=str(second / "card.blend"))
    assert_first_job(first)


def test_a_saved_copy_has_the_capture_and_the_open_file_keeps_its_paths(two_jobs):
    first, second = two_jobs
    bpy.ops.wm.save_as_mainfile(filepath=str(second / "copy.blend"), copy=True)
    assert bpy.context.scene.irpso.capture_path == "//photos/lights.lp"
    bpy.ops.wm.open_mainfile(filepath=str(second / "copy.blend"))
    assert_first_job(first)


def test_an_undo_past_saving_in_another_folder_keeps_the_capture(two_jobs):
    first, second = two_jobs
    bpy.ops.ed.undo_push(message="before")
    bpy.context.scene.irpso.seed = 5
    bpy.ops.ed.undo_push(message="seed")
    bpy.ops.wm.save_as_mainfile(filepath=str(second / "card.blend"))
    bpy.ops.ed.undo()
    assert bpy.context.scene.irpso.seed == 0
    assert_first_job(first)
    bpy.ops.ed.redo()
    assert bpy.context.scene.irpso.seed == 5
    assert_first_job(first)


def test_a_folder_moved_with_file_and_photographs_has_its_own(two_jobs, tmp_path):
    first, _ = two_jobs
    bpy.ops.wm.save_mainfile()
    first.rename(tmp_path / "moved")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "moved" / "card.blend"))
    assert_first_job(tmp_path / "moved")


def test_a_folder_moved_before_the_add_on_is_enabled_has_its_own(two_jobs, tmp_path):
    first, second = two_jobs
    bpy.ops.wm.save_mainfile()
    irpso_addon.unregister()
    first.rename(tmp_path / "moved")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "moved" / "card.blend"))
    irpso_addon.register()
    bpy.ops.wm.save_as_mainfile(filepath=str(second / "card.blend"))
    assert_first_job(tmp_path / "moved")
