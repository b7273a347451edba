"""A capture comes into a real window: by the button's file browser, dropped, checked without a pause, as a scene."""

import numpy as np
import pytest

from tests.builders import command_line as cli_maker
from tests.builders.near_card import DISTANCE, write_near_card

UI = "bl_ext.user_default.irpso.irpso_addon.ui"

SETUP = f"""
import importlib, time
capture_import = importlib.import_module("{UI}.operators.capture_import")
scene_capture = importlib.import_module("{UI}.session.scene_capture")

def settings():
    return bpy.context.scene.irpso

def checking():
    return capture_import.checking(bpy.context.scene)

slices, said, real_slice = [], [], capture_import._slice

def watch_checks():
    # Notes the duration of each slice of a check, and what it says. Slices are short, however fast the machine.
    def timed(check, seconds):
        begun = time.perf_counter()
        more = real_slice(check, min(seconds, 0.02))
        slices.append(time.perf_counter() - begun)
        said.append(check.doing)
        return more
    capture_import._slice = timed

def until_checked():
    # The longest slice that the watched check took, and what it said on the way.
    while checking():
        yield
    capture_import._slice = real_slice
    return max(slices, default=0.0), said

def steps_of_find_corners():
    # The slices of a search that has no time for two steps in one.
    sliced = importlib.import_module("{UI}.common.sliced")
    count, usual, real = [0], sliced._SLICE_SECONDS, sliced.SlicedOperator._slice
    def counted(self, context, seconds):
        count[0] += 1
        return real(self, context, seconds)
    sliced.SlicedOperator._slice, sliced._SLICE_SECONDS = counted, 1e-9
    bpy.ops.irpso.find_corners("INVOKE_DEFAULT")
    while any(o.bl_idname == "IRPSO_OT_find_corners" for o in main_window().modal_operators):
        yield
    sliced.SlicedOperator._slice, sliced._SLICE_SECONDS = real, usual
    return count[0]

def forget():
    settings().capture_path = settings().checked_path = settings().summary = ""
    settings().findings.clear()
"""


@pytest.fixture(scope="module")
def ready(window):
    window.run(SETUP)
    window.open_sidebar("IRPSO")
    return window


@pytest.fixture
def icon(shared_data, ready):
    ready.run("forget()")
    return (shared_data / "rti_icon").resolve()


def test_a_capture_is_chosen_in_the_file_browser(ready, icon):
    ready.run("bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'")
    ready.click(*ready.find_button("irpso.import_capture"))
    ready.wait("any(area.type == 'FILE_BROWSER' for area in main_window().screen.areas)", area="")
    ready.run(f"largest('FILE_BROWSER').spaces.active.params.directory = {str(icon).encode()!r}", area="")
    ready.settle()
    ready.screenshot("file browser")
    ready.move(*ready.region("FILE_BROWSER").centre)
    ready.key("Return")
    ready.wait(f"settings().capture_path == {str(icon)!r}", area="")
    ready.wait("not checking()", timeout=180)
    ready.screenshot("capture imported")
    assert ready.run("settings().source, settings().subject") == ["FILES", "CARD"]
    assert ready.run("'images: 72' in settings().summary")
    assert ready.run("[item.message.split(': ')[1][:5] for item in settings().findings]") == ["39.4%"]


def test_a_dropped_list_of_lights_is_imported_and_checked_while_the_window_goes_on(ready, icon):
    # What Blender itself does once files have been dropped on an area.
    ready.run("watch_checks()")
    ready.run(f"bpy.ops.wm.drop_import_file(directory={str(icon)!r}, files=[{{'name': 'dirs.lp'}}])")
    stall, said = ready.run("until_checked()", timeout=180)
    print(f"72 images were checked in {len(said)} slices, of {stall:.3f} s at most")
    assert ready.run("settings().capture_path").endswith("dirs.lp")
    assert len({line for line in said if line.startswith("Checking images")}) > 1
    assert ready.run("settings().checked_path == settings().capture_path")


def test_another_file_than_a_capture_is_reported_and_changes_nothing(ready, icon, tmp_path):
    (tmp_path / "notes.txt").write_text("no capture")
    ready.run(f"bpy.ops.irpso.import_capture('INVOKE_DEFAULT', filepath={str(icon / 'dirs.lp')!r})")
    ready.wait("not checking()", timeout=180)
    before = ready.run("settings().capture_path")
    ready.run(
        "try:\n"
        f"    bpy.ops.wm.drop_import_file(directory={str(tmp_path)!r}, files=[{{'name': 'notes.txt'}}])\n"
        "except RuntimeError:\n"
        "    pass"
    )
    ready.settle()
    assert ready.run("settings().capture_path") == before
    assert any("holds no capture" in line for line in ready.reports())


def test_loading_another_file_ends_a_check(ready, icon):
    ready.run(f"bpy.ops.irpso.import_capture(filepath={str(icon)!r})")
    ready.wait("checking().startswith('Checking')")
    ready.run("bpy.ops.wm.read_homefile(app_template='')", area="")
    ready.run("redrawn()", area="")
    assert ready.run("checking(), settings().summary, len(capture_import._running)")[:2] == ["", ""]
    assert not ready.run("bpy.app.timers.is_registered(capture_import._tick)")
    ready.open_sidebar("IRPSO")


def test_cameras_and_lights_stand_in_the_scene_and_one_light_shines(ready, icon):
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.run(f"bpy.ops.irpso.import_capture(filepath={str(icon)!r})")
    ready.wait("not checking()", timeout=180)
    ready.run("bpy.ops.ed.undo_push(message='before')")
    ready.run("bpy.ops.irpso.create_scene('EXEC_DEFAULT', True)")
    shining = ready.run("[obj.name[:9] for obj in bpy.data.objects if obj.type == 'LIGHT' and not obj.hide_viewport]")
    assert (shining, ready.run("len(bpy.data.lights)")) == (["Light 000"], 72)
    ready.run("bpy.ops.view3d.view_all()")
    ready.run("redrawn()", area="")
    ready.screenshot("scene of the capture")
    ready.run("bpy.ops.view3d.view_camera()")
    # EEVEE takes minutes to begin on a software renderer.
    ready.run("bpy.context.scene.render.engine = 'CYCLES'\nbpy.context.scene.cycles.preview_samples = 4")
    ready.run("largest('VIEW_3D').spaces.active.shading.type = 'RENDERED'")
    for number in (1, 41):
        ready.run(f"settings().view.observation = {number}")
        ready.run("redrawn(30)", area="", timeout=180)
        ready.screenshot(f"observation {number} through its camera")
    ready.run("largest('VIEW_3D').spaces.active.shading.type = 'SOLID'")


def test_undo_takes_the_cameras_and_lights_away_and_redo_brings_them_back(ready, icon):
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.run(f"settings().capture_path = {str(icon)!r}")
    ready.run("bpy.ops.ed.undo_push(message='before')")
    ready.run("bpy.ops.irpso.create_scene('EXEC_DEFAULT', True)")
    ready.move(*ready.region().centre)
    ready.key("ctrl+z")
    ready.wait("not bpy.context.scene.objects")
    ready.key("ctrl+shift+z")
    ready.wait("len(bpy.context.scene.objects) == 74")
    assert ready.run("len(scene_capture.capture_from_scene(bpy.context.scene).observations)") == 72


def test_a_near_lit_card_asks_for_its_distance_and_uses_it(ready, tmp_path):
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.open_sidebar("IRPSO")
    folder = write_near_card(tmp_path / "near", card_distance=None)
    ready.run(f"bpy.ops.irpso.import_capture(filepath={str(folder)!r})")
    ready.wait("not checking()", timeout=180)
    ready.run("redrawn()", area="")
    ready.screenshot("distance asked for", ready.region(region="UI"))
    ready.run(f"settings().card_distance = {DISTANCE}")
    ready.run("bpy.ops.irpso.check_capture()")
    ready.wait("not checking()", timeout=180)
    ready.run("redrawn()", area="")
    ready.screenshot("distance given", ready.region(region="UI"))
    assert ready.run("[item.message for item in settings().findings if 'distance' in item.message]") == []


def test_a_card_is_marked_by_clicks_on_its_corners(ready, tmp_path):
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.open_sidebar("IRPSO")
    ready.run(f"bpy.ops.irpso.import_capture(filepath={str(write_near_card(tmp_path / 'near'))!r})")
    ready.wait("not checking()", timeout=180)
    ready.run("settings().framing = 'CORNERS'")
    ready.run("redrawn()", area="")
    ready.run("bpy.ops.wm.call_panel(name='IRPSO_PT_frame')")
    ready.settle()
    ready.screenshot("frame of a card")
    ready.key("Escape")
    ready.run("bpy.ops.irpso.mark_card('INVOKE_DEFAULT')")
    ready.wait("any(area.type == 'IMAGE_EDITOR' for area in main_window().screen.areas)", area="")
    ready.run("redrawn()", area="")
    to_region = "[bpy.context.region.view2d.view_to_region(*corner, clip=False) for corner in ((0, 0), (1, 1))]"
    (x0, y0), (x1, y1) = ready.run(to_region, area="IMAGE_EDITOR")
    box, marks = ready.region("IMAGE_EDITOR"), ((20, 4), (5, 3), (19, 13), (4, 12))  # of 24 × 16 pixels, y down

    def on_screen(x, y):
        up = y0 + (y1 - y0) * (16 - y) / 16
        return round(box.x + x0 + (x1 - x0) * x / 24), round(box.y + box.height - 1 - up)

    for mark in marks[:3]:
        ready.click(*on_screen(*mark))
    ready.key("Return")  # too early: one corner is missing
    assert ready.run("list(settings().corners)", area="IMAGE_EDITOR") == [0] * 8
    ready.click(*on_screen(8, 8))
    ready.screenshot("three corners of a card, and a wrong one")
    ready.drag(on_screen(8, 8), on_screen(*marks[3]))
    ready.screenshot("a card is marked")
    ready.key("Return")
    ready.run("redrawn()", area="")
    found = ready.run("list(settings().corners)")
    expected = [value for mark in ((5, 3), (20, 4), (19, 13), (4, 12)) for value in mark]
    assert max(abs(a - b) for a, b in zip(found, expected, strict=True)) < 0.2
    assert ready.reports()[-1].startswith("Corners: ")
    ready.wait("all(area.type != 'IMAGE_EDITOR' for area in main_window().screen.areas)", area="")
    ready.screenshot("the marked card's photograph is closed")
    assert ready.run("[image.name for image in bpy.data.images if image.is_dirty]") == []  # Blender asks to save such
    timeline = "next(area for area in main_window().screen.areas if area.type == 'DOPESHEET_EDITOR')"
    ready.run(f"{timeline}.type = 'IMAGE_EDITOR'", area="")
    shown = "[area.spaces.active.image.name for area in main_window().screen.areas if area.type == 'IMAGE_EDITOR']"
    ready.run("mine = bpy.data.images.new('mine', 4, 4)\nbpy.context.space_data.image = mine", area="IMAGE_EDITOR")
    ready.run("bpy.ops.irpso.mark_card('INVOKE_DEFAULT')")
    ready.wait(f"{shown} == ['IRPSO Photograph']", area="")
    ready.key("Escape")
    ready.wait(f"{shown} == ['mine']", area="")


def test_return_in_the_browser_of_assign_images_gives_no_light_the_open_file(ready, tmp_path):
    ready.run("bpy.ops.wm.read_homefile()", area="")
    ready.run(f"bpy.ops.wm.save_as_mainfile(filepath={str(tmp_path / 'scene.blend')!r})", area="")
    ready.run("bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'")
    ready.run("bpy.ops.irpso.assign_images('INVOKE_DEFAULT')")
    ready.wait("any(area.type == 'FILE_BROWSER' for area in main_window().screen.areas)", area="")
    ready.settle()
    ready.move(*ready.region("FILE_BROWSER").centre)
    ready.key("Return")
    ready.wait("all(area.type != 'FILE_BROWSER' for area in main_window().screen.areas)", area="")
    assert any("No image was chosen" in line for line in ready.reports())
    assert ready.run("[image.name for image in bpy.data.images if image.source == 'FILE']") == []


def test_the_preferences_show_a_report_on_the_gpu_and_copy_it(ready):
    ready.run("bpy.ops.irpso.doctor()", timeout=120)
    ready.run("bpy.ops.irpso.copy_report()")
    report = ready.run("bpy.context.window_manager.clipboard")
    assert ready.run("__import__('gpu').platform.renderer_get()") in report and "passes used" in report
    ready.run(
        "area = largest('VIEW_3D')\n"
        "area.type = 'PREFERENCES'\n"
        "bpy.context.preferences.active_section = 'ADDONS'\n"
        "bpy.context.window_manager.addon_search = 'irpso'\n"
        "bpy.ops.preferences.addon_expand(module='bl_ext.user_default.irpso')",
        area="",
    )
    ready.run("redrawn(10)", area="")
    ready.screenshot("preferences")
    ready.run("largest('PREFERENCES').type = 'VIEW_3D'", area="")


def test_a_damaged_image_bars_recover_until_it_is_left_out_by_the_box_beside_it(ready, tmp_path):
    folder = small_card(tmp_path / "damaged", 6)
    path = folder / "003.exr"
    path.write_bytes(path.read_bytes()[:-40])
    ready.run("bpy.ops.wm.read_homefile(app_template='')", area="")
    ready.open_sidebar("IRPSO")
    ready.run(f"bpy.ops.irpso.import_capture(filepath={str(folder)!r})")
    ready.wait("not checking()", timeout=60)
    ready.screenshot("a damaged image", ready.region(region="UI"))
    assert ready.run("bpy.ops.irpso.recover.poll()") is False
    ready.run("settings().skip_damaged = True")
    ready.wait("not checking() and bpy.ops.irpso.recover.poll()", timeout=60)
    ready.screenshot("a damaged image left out", ready.region(region="UI"))
    assert ready.run("'images: 5, 1 more left out' in settings().summary")


def test_too_few_lights_and_a_failed_check_are_reported_in_the_panel(ready, tmp_path):
    ready.run("bpy.ops.wm.read_homefile(app_template='')", area="")
    ready.open_sidebar("IRPSO")
    ready.run(f"bpy.ops.irpso.import_capture(filepath={str(small_card(tmp_path / 'one', 1))!r})")
    ready.wait("not checking()", timeout=60)
    ready.screenshot("one light", ready.region(region="UI"))
    assert ready.run("bpy.ops.irpso.recover.poll()") is False
    ready.expect("Traceback|The check has ended|broken on purpose")
    ready.run("right = capture_import._slice\ndef broken(*_):\n    raise IndexError('broken on purpose')\n"
              "capture_import._slice = broken\nbpy.ops.irpso.check_capture()")  # fmt: skip
    ready.wait("not checking()", timeout=60)
    ready.screenshot("a check that failed", ready.region(region="UI"))
    failures = "capture_import.__name__.replace('operators.capture_import', 'common.failures')"
    assert ready.run(f"importlib.import_module({failures}).messages()") == ["The check has ended: broken on purpose"]
    ready.run("capture_import._slice = right\nbpy.ops.irpso.dismiss_failures()")


def small_card(folder, count):
    """Write a capture of a card under so many lights; return its folder."""
    lights = cli_maker.dome_lights(count)
    return cli_maker.write_card(
        folder, cli_maker.render_oracle("lambert", cli_maker.smooth_maps((20, 24), {}), lights), lights
    )


def test_the_sample_opens_by_its_button_with_nothing_typed(ready, tmp_path):
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.open_sidebar("IRPSO")
    ready.run(
        "from functools import partial\n"
        f"sample = importlib.import_module('{UI}.operators.sample')\n"
        "sample._rendering = partial(sample._rendering, options=['--size', '300x225', '--photographs', '6'])\n"
        f"sample.Path.home = lambda: sample.Path({str(tmp_path)!r})"
    )
    ready.click(*ready.find_button("irpso.open_sample"))
    ready.settle()
    ready.screenshot("the sample's dialog")
    ready.key("Return")
    ready.wait("settings().crop[2] > 0", timeout=400)
    ready.wait("not checking()", timeout=180)
    ready.run("redrawn()", area="")
    ready.screenshot("the sample is open")
    assert ready.run("settings().framing, settings().checked_images") == ["CROP", 6]
    assert (tmp_path / "irpso-sample" / "photographs" / "capture.toml").is_file()
    x, y, width, height = ready.run("list(settings().crop)")
    assert ready.run("steps_of_find_corners()", timeout=120) > 2 * 6  # it looks at six photographs, twice
    ready.screenshot("the sample's corners are found")
    corners = np.reshape(ready.run("list(settings().corners)"), (4, 2))
    assert np.abs(corners - [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]).max() < 2
