"""A recovery in a living window, and all that can befall it while it runs: nothing crashes, nothing stays behind."""

from pathlib import Path

import numpy as np
import pytest

from irpso_addon.capture.images.exr import read_exr
from tests.builders import command_line as cli_maker
from tests.gui.traces import MODULE, SNAPSHOT, switch

SIZE, LIGHTS = 64, 24
CARD = "IRPSO card"
IN_NEW_WINDOW = """
new = bpy.context.window_manager.windows[-1]
with bpy.context.temp_override(window=new, area=new.screen.areas[0]):
    {}
"""
MODULES = f"""
import gpu
import importlib
session = importlib.import_module("{MODULE}.irpso_addon.ui.session.session")
handlers = importlib.import_module("{MODULE}.irpso_addon.ui.overlay.handlers")
"""
SOFTWARE_VULKAN = "[gpu.platform.backend_type_get(), 'llvmpipe' in gpu.platform.renderer_get()] == ['VULKAN', True]"
FRESH = """
bpy.ops.irpso.cancel() if session.current() is not None else None
bpy.ops.wm.read_homefile()
"""
PLANE = """
bpy.ops.mesh.primitive_plane_add(size=2, location=(0, 0, -1))
bpy.context.object.name = "Plane"
"""
RUNNING = "session.current().state == 'running' and session.current().progress.iteration_in_all > 0"


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    """A card under 24 lights."""
    lights = cli_maker.dome_lights(LIGHTS)
    values = cli_maker.smooth_maps((SIZE, SIZE), {"roughness": (0.25, 0.6), "specular": (0.2, 0.8)})
    images = cli_maker.render_oracle("principled", values, lights)
    return cli_maker.write_card(tmp_path_factory.mktemp("captures") / "card", images, lights)


@pytest.fixture
def ready(window, capture):
    """The window with a fresh file, the sidebar open and the capture imported."""
    window.run(MODULES + FRESH, area="")
    window.open_sidebar("IRPSO")
    window.run(f"bpy.ops.irpso.import_capture(filepath={str(capture)!r})")
    window.run("bpy.context.scene.irpso.subject = 'CARD'\nbpy.context.scene.irpso.seed = 7")
    yield window
    window.run("bpy.ops.irpso.cancel() if session.current() is not None else None", area="")


def begin(window, subject="CARD"):
    """Begin a recovery of the card, or of a plane that stands where the card is, and wait until it iterates."""
    if subject == "MESH":
        window.run(PLANE + f"bpy.context.scene.irpso.subject = 'MESH'\nbpy.context.scene.irpso.resolution = {SIZE}")
    window.run("bpy.ops.irpso.recover('INVOKE_DEFAULT')", timeout=120)
    window.wait(RUNNING, 180)


def finish(window):
    window.wait("session.current().state == 'done'", 400)


def test_the_button_recovers_and_keep_makes_the_material_in_one_undo_step(ready):
    ready.click(*ready.find_button("irpso.recover"))
    ready.wait(RUNNING, 180)
    assert any("Software Vulkan" in line for line in ready.reports()) == ready.run(SOFTWARE_VULKAN)
    finish(ready)
    assert ready.run("session.current().failure") == ""
    ready.screenshot("run-done")
    ready.click(*ready.find_button("irpso.keep"))
    ready.wait(f"{CARD!r} in bpy.data.materials")
    images = "any('IRPSO' in image.name for image in bpy.data.images)"
    kept = f"[{CARD!r} in bpy.data.materials, {CARD!r} in bpy.data.objects, {images}]"
    assert ready.run(kept) == [True, True, True]
    ready.move(*ready.region().centre)
    ready.key("ctrl+z")
    ready.wait(f"{CARD!r} not in bpy.data.objects")
    ready.key("ctrl+shift+z")
    ready.wait(f"{CARD!r} in bpy.data.objects")
    assert ready.run(kept) == [True, True, True]
    assert ready.run(f"bpy.data.objects[{CARD!r}].active_material.name") == CARD


def test_undoing_a_second_keep_shows_the_pictures_of_the_first(ready, tmp_path):
    preferences = f"bpy.context.preferences.addons[{MODULE!r}].preferences"
    ready.run(f"{preferences}.output_folder = {str(tmp_path)!r}")
    maps = "[image for image in bpy.data.images if 'irpso_map' in image]"
    shown = f"sorted(image.filepath for image in {maps})[0]"
    try:
        ready.click(*ready.find_button("irpso.recover"))
        ready.wait(RUNNING, 180)
        finish(ready)
        ready.click(*ready.find_button("irpso.keep"))
        ready.wait(f"{CARD!r} in bpy.data.materials")
        first = ready.run(shown)
        ready.click(*ready.find_button("irpso.keep"))
        ready.wait(f"{shown} != {first!r}")
        ready.move(*ready.region().centre)
        ready.key("ctrl+z")
        ready.wait(f"{shown} == {first!r}")
        count = ready.run(f"len({maps})")
        assert len(list(tmp_path.iterdir())) == 2 * count
        ready.run(FRESH, area="")
        assert len(list(tmp_path.iterdir())) == count and Path(first).exists()
    finally:
        ready.run(f"{preferences}.output_folder = ''", area="")


def test_escape_pauses_and_resume_goes_on_with_what_was_changed(ready):
    begin(ready)
    ready.move(*ready.region().centre)
    ready.key("Escape")
    ready.wait("session.current().state == 'paused'")
    before = ready.run("session.current().progress.evaluations")
    ready.run("redrawn(10)", area="")
    assert ready.run("session.current().progress.evaluations") == before
    ready.run("bpy.context.scene.irpso.schedule.prior_rounds = 0")
    ready.run("bpy.ops.irpso.resume()")
    assert ready.run("session.current().job.schedule.prior.rounds") == 0
    finish(ready)
    assert ready.run("session.current().history[-1][1]") < 0.02


def test_cancel_leaves_the_scene_as_it_was(ready):
    names = "sorted(n for k in ('objects', 'materials', 'images', 'meshes') for n in getattr(bpy.data, k).keys())"
    before = ready.run(names)
    begin(ready)
    ready.run("bpy.ops.irpso.cancel()")
    assert ready.run("session.current() is None")
    ready.run("redrawn()", area="")
    assert ready.run("len(handlers.installed)") == 0
    assert ready.run(names) == before


def test_another_file_loaded_in_mid_run_ends_it(ready, tmp_path):
    begin(ready)
    ready.run("bpy.ops.wm.read_homefile()", area="")
    ready.run("redrawn(10)", area="")
    assert ready.run("session.current() is None")
    assert ready.run("len(handlers.installed)") == 0


def test_undo_in_mid_run_does_not_disturb_it(ready):
    ready.run("bpy.ops.ed.undo_push(message='before')")
    ready.run("bpy.ops.mesh.primitive_cube_add(location=(5, 5, 0))\nbpy.ops.ed.undo_push(message='cube')")
    begin(ready)
    ready.move(*ready.region().centre)
    ready.key("ctrl+z")
    ready.wait("len(bpy.context.scene.objects) == 3")
    ready.key("ctrl+shift+z")
    ready.wait("len(bpy.context.scene.objects) == 4")
    finish(ready)
    assert ready.run("session.current().failure") == ""


def test_a_subject_deleted_in_mid_run_is_reported_at_keep(ready):
    begin(ready, "MESH")
    ready.run("bpy.data.objects.remove(bpy.data.objects['Plane'])")
    ready.run("redrawn()", area="")
    assert ready.run("session.current().state") == "running"
    finish(ready)
    ready.expect("deleted")
    with pytest.raises(Exception, match="deleted"):
        ready.run("bpy.ops.irpso.keep()")
    assert ready.run("[m.name for m in bpy.data.materials if 'IRPSO' in m.name]") == []


def test_modes_areas_and_windows_may_change_in_mid_run(ready):
    begin(ready, "MESH")
    ready.run("bpy.context.view_layer.objects.active = bpy.data.objects['Plane']\nbpy.ops.object.mode_set(mode='EDIT')")
    ready.run("redrawn()", area="")
    ready.run("bpy.ops.object.mode_set(mode='TEXTURE_PAINT')\nbpy.ops.object.mode_set(mode='OBJECT')")
    ready.run("area = largest('VIEW_3D')\narea.type = 'IMAGE_EDITOR'", area="")
    ready.run("redrawn()", area="")
    ready.run("area.type = 'VIEW_3D'\narea.spaces.active.shading.type = 'MATERIAL'", area="")
    ready.run("redrawn()", area="", timeout=300)  # the first time Blender compiles its own shaders
    ready.run("area.spaces.active.shading.type = 'SOLID'\nbpy.ops.wm.window_new()")
    ready.run("redrawn()", area="")
    ready.run(IN_NEW_WINDOW.format("bpy.ops.wm.window_close()"), area="")
    ready.run("redrawn()", area="")
    finish(ready)
    assert ready.run("session.current().failure") == ""


def test_the_extension_switched_off_in_mid_run_leaves_nothing_behind(ready):
    ready.run(SNAPSHOT)
    clean = switch(ready, "disable")
    switch(ready, "enable")
    ready.run(MODULES, area="")
    begin(ready)
    after = switch(ready, "disable")
    assert {**after, "data": None} == {**clean, "data": None}
    switch(ready, "enable")
    ready.run(MODULES, area="")


def test_the_picture_follows_a_recovery_that_another_window_resumes(ready):
    begin(ready)
    ready.run("bpy.ops.irpso.pause()\nbpy.ops.wm.window_new()")
    ready.run("redrawn()", area="")
    ready.run("import time\nresumed = time.perf_counter()", area="")
    ready.run(IN_NEW_WINDOW.format("bpy.ops.irpso.resume()"), area="")
    drawn = "handlers._overlay._updated > resumed"
    ready.wait(f"{drawn} or session.current().state == 'done'", 400)
    assert ready.run(f"[session.current().state, {drawn}]") == ["running", True]
    ready.run("bpy.ops.irpso.cancel()", area="")
    ready.run(IN_NEW_WINDOW.format("bpy.ops.wm.window_close()"), area="")


def test_two_windows_the_background_and_the_command_line_find_the_same_maps(
    ready, blender, backend, settings, capture, tmp_path
):
    begin(ready)
    ready.run("bpy.ops.irpso.pause()\nbpy.ops.wm.window_new()")
    ready.run("redrawn()", area="")
    ready.run(
        "new = bpy.context.window_manager.windows[-1]\n"
        "with bpy.context.temp_override(window=new, area=new.screen.areas[0]):\n    bpy.ops.irpso.resume()",
        area="",
    )
    finish(ready)
    ready.run(f"bpy.ops.irpso.export(filepath={str(tmp_path / 'window')!r})")
    script = tmp_path / "operator.py"
    script.write_text(
        "import bpy\n"
        f"bpy.ops.irpso.import_capture(filepath={str(capture)!r})\n"
        "bpy.context.scene.irpso.subject, bpy.context.scene.irpso.seed = 'CARD', 7\n"
        "bpy.ops.irpso.recover()\n"
        f"bpy.ops.irpso.export(filepath={str(tmp_path / 'background')!r})\n"
    )
    variables = {"BLENDER_USER_RESOURCES": str(settings), "TMPDIR": str(tmp_path)}
    program = (blender.executable, "--gpu-backend", backend)
    blender.run(*program, "--background", "--python-exit-code", "3", "--python", str(script), variables=variables)
    command = ["--command", "irpso", "recover", str(capture), "-o", str(tmp_path / "command"), "--seed", "7", "--quiet"]
    blender.run(*program, *command, variables=variables)
    found = [read_exr(tmp_path / door / "maps.exr") for door in ("window", "background", "command")]
    for other in found[1:]:
        assert other.keys() == found[0].keys()
        for part, channels in found[0].items():
            for channel, values in channels.items():
                np.testing.assert_array_equal(values, other[part][channel], err_msg=f"{part}.{channel}")
