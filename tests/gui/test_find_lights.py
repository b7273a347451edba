"""The lights of photographs are found in a real window: from relief, a video, a flat card and a mesh."""

from dataclasses import replace

import numpy as np
import pytest

from irpso_addon.capture.camera import Camera
from irpso_addon.capture.images.exr import write_exr
from irpso_addon.capture.read import read_capture
from irpso_addon.capture.types import Capture, Light, Observation
from irpso_addon.capture.write import write_capture
from tests.builders import command_line as cli_maker
from tests.builders import video
from tests.builders.near_card import DISTANCE, write_unlit_card
from tests.builders.relief import write_ball
from tests.builders.sphere import LAMPS, SIDE, sphere_photographs
from tests.gui.test_import import SETUP


@pytest.fixture(scope="module")
def ready(window):
    window.run(SETUP)
    window.open_sidebar("IRPSO")
    return window


def test_lights_are_found_without_a_ball_while_the_window_goes_on(ready, tmp_path):
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.open_sidebar("IRPSO")
    directions = write_ball(tmp_path)
    given = f"photographs={str(tmp_path)!r}, found_by='NONE'"
    ready.run(f"bpy.ops.irpso.find_lights('INVOKE_DEFAULT', {given})")
    ready.settle()
    ready.screenshot("finding lights: dialog")
    ready.key("Return")
    ready.settle()
    ready.screenshot("finding lights")
    assert ready.run("settings().capture_path") == ""  # it goes on, and the window answers
    ready.wait(f"settings().capture_path == {str(tmp_path / 'capture.toml')!r}", timeout=300)
    ready.screenshot("lights are found")
    found = np.array([one.light.vector for one in read_capture(tmp_path / "capture.toml").observations])
    assert np.degrees(np.arccos(np.clip((found * directions).sum(axis=-1), -1, 1))).mean() < 4
    ready.move(*ready.region().centre)
    ready.key("ctrl+z")
    ready.wait("settings().capture_path == ''")
    ready.key("ctrl+shift+z")
    ready.wait(f"settings().capture_path == {str(tmp_path / 'capture.toml')!r}")
    ready.run("bpy.context.scene.irpso.capture_path = ''")
    ready.run(f"bpy.ops.irpso.find_lights('INVOKE_DEFAULT', {given})")
    ready.settle()
    ready.key("Return")
    ready.settle()
    ready.move(*ready.region().centre)
    ready.key("ctrl+z")  # in the middle of the work
    ready.settle()
    assert ready.run("[one.bl_idname for one in main_window().modal_operators]") == ["IRPSO_OT_find_lights"]
    ready.key("Escape")
    ready.wait("not main_window().modal_operators")
    assert not (tmp_path / "capture_1.toml").exists()


def test_photographs_are_chosen_in_the_browser_and_a_refusal_stays_in_the_panel(ready, tmp_path):
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.open_sidebar("IRPSO")
    for number in range(3):
        grey = np.full((60, 80), 0.2 + 0.1 * number, np.float32)
        write_exr(tmp_path / f"{number}.exr", {"": dict.fromkeys("RGB", grey)})
    ready.run("bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'")
    ready.expect("no ball was found")
    ready.click(*ready.find_button("irpso.choose_photographs"))
    ready.choose_in_browser(tmp_path)
    ready.run("redrawn()", area="")
    ready.screenshot("finding lights: photographs are chosen")
    ready.key("Return")
    failures = "importlib.import_module(capture_import.__name__.replace('operators.capture_import', 'common.failures'))"
    (message,) = ready.wait(f"{failures}.messages()", timeout=180)
    ready.screenshot("finding lights: refused")
    assert "no ball was found" in message and "Lights From: Relief" in message and "--" not in message
    ready.run("bpy.ops.irpso.dismiss_failures()")


def test_a_folder_with_a_video_gives_photographs_and_the_dialog_of_their_lights(ready, tmp_path):
    pytest.importorskip("cv2", reason="OpenCV, which writes the video, is not installed")
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.open_sidebar("IRPSO")
    normals, albedo = video.scene(64, 96)
    lights = [video.direction(np.pi * k / 6, 0.5 + 0.04 * k) for k in range(12)]
    video.write_video(
        tmp_path / "lamp.mkv", [video.rec709(video.lit(normals, albedo, light)) for light in lights], "FFV1"
    )
    ready.run("bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'")
    ready.click(*ready.find_button("irpso.choose_photographs"))
    ready.choose_in_browser(tmp_path)
    photographs = str(tmp_path / "lamp_photographs")
    ready.wait(f"__import__('os').path.isdir({photographs!r})", timeout=120)
    ready.settle()
    ready.screenshot("finding lights: photographs of a video")
    assert len(list((tmp_path / "lamp_photographs").glob("*.png"))) == 12
    ready.key("Escape")


def test_the_dialog_finds_near_lamps_over_a_flat_card(ready, tmp_path):
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.open_sidebar("IRPSO")
    capture = write_unlit_card(tmp_path)
    width = 2 * DISTANCE * np.tan(np.radians(15))
    given = f"photographs={str(tmp_path)!r}, found_by='FLAT', card_width={width}"
    found = lights_by_dialog(ready, given, tmp_path / "capture_1.toml", "a flat card")
    places = np.array([one.light.vector for one in capture.observations])
    assert np.linalg.norm(found - places, axis=-1).max() < 0.02 * 260
    assert ready.run("settings().subject, settings().near_lights") == ["CARD", True]


def test_the_dialog_finds_lights_over_the_active_mesh(ready, tmp_path):
    matrix = np.eye(4)
    matrix[2, 3] = 5
    camera = replace(Camera.from_fov(SIDE, SIDE, 30.0), matrix=matrix)
    places = 3.2 * cli_maker.dome_lights(LAMPS, widest=55.0)
    pictures, mask = sphere_photographs(camera, places, near=False)
    shots = tuple(
        Observation(f"{k}", lambda rgb=rgb: np.dstack([rgb, np.ones((SIDE, SIDE), np.float32)]), Light((0.0, 0.0, 1.0)))
        for k, rgb in enumerate(pictures)
    )
    write_capture(Capture("sphere", shots, (camera,), (mask,)), tmp_path / "sphere")
    ready.run("bpy.ops.wm.read_homefile(use_empty=True)", area="")
    ready.open_sidebar("IRPSO")
    ready.run("bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)\nbpy.ops.object.shade_smooth()")
    given = f"photographs={str(tmp_path / 'sphere')!r}, found_by='MESH'"
    found = lights_by_dialog(ready, given, tmp_path / "sphere" / "capture_1.toml", "a mesh")
    cosines = (found * places).sum(axis=-1) / np.linalg.norm(places, axis=-1)
    assert np.degrees(np.arccos(np.clip(cosines, -1, 1))).max() < 1.5
    assert ready.run("settings().subject") == "MESH"


def lights_by_dialog(ready, given, table, name):
    """Press OK in the dialog Find Lights with some entries; return the vectors (K, 3) of the table that it writes."""
    ready.run(f"bpy.ops.irpso.find_lights('INVOKE_DEFAULT', {given})")
    ready.settle()
    ready.screenshot(f"finding lights: over {name}")
    ready.key("Return")
    ready.wait(f"settings().capture_path == {str(table)!r}", timeout=120)
    ready.screenshot(f"lights are found over {name}")
    return np.array([one.light.vector for one in read_capture(table).observations])
