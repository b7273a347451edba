"""A recovery that nobody has kept, and New, Open and Quit: Blender asks, and the next file offers to go on from it."""

import numpy as np
import pytest
from blender_window import open_window

from tests.builders import command_line as cli_maker

UI = "bl_ext.user_default.irpso.irpso_addon.ui"
SETUP = f"""
import importlib
import numpy as np
from pathlib import Path
session = importlib.import_module("{UI}.session.session")
recoveries = importlib.import_module("{UI}.session.stored_recoveries")

def state():
    running = session.current()
    return running.state if running is not None else "none"

def found():
    return {{name: values.tolist() for name, values in session.current().maps(False).values.items()}}
"""


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    values = cli_maker.smooth_maps((24, 32), {"roughness": (0.25, 0.6), "specular": (0.3, 0.7)})
    lights = cli_maker.dome_lights(12)
    folder = tmp_path_factory.mktemp("capture") / "leaf"
    return cli_maker.write_card(folder, cli_maker.render_oracle("principled", values, lights), lights)


def begin(window, capture, blend):
    """Begin a recovery in a file that was saved after it was set up, and pause it in mid-search."""
    window.run(SETUP)
    window.open_sidebar("IRPSO")
    window.run(f"bpy.ops.irpso.import_capture(filepath={str(capture)!r})")
    window.wait("bool(bpy.context.scene.irpso.checked_path)", timeout=120)
    window.run("bpy.context.scene.irpso.seed = 5\nbpy.context.scene.irpso.schedule.delta = 0.04")
    window.run(f"bpy.ops.wm.save_as_mainfile(filepath={str(blend)!r})", area="")
    window.wait("not bpy.data.is_dirty")
    window.run("bpy.ops.irpso.recover('INVOKE_DEFAULT')")
    window.wait("state() == 'running' and session.current().progress.iteration_in_all > 0", timeout=180)
    window.run("bpy.ops.irpso.pause()")


def test_the_file_counts_as_changed_while_a_recovery_is_not_kept_and_new_asks(window, capture, tmp_path):
    begin(window, capture, tmp_path / "mine.blend")
    assert window.run("bpy.data.is_dirty")
    window.run("bpy.ops.wm.save_mainfile()", area="")
    window.wait("bpy.data.is_dirty")  # a saved file does not hold the recovery either
    window.run("bpy.ops.wm.read_homefile('INVOKE_DEFAULT')")
    window.settle()
    window.screenshot("New asks")
    assert window.run("state()") == "paused" and window.run("bpy.data.filepath").endswith("mine.blend")
    window.key("Escape")


def test_a_new_file_offers_the_recovery_which_goes_on_where_it_was(window):
    before = window.run("found()"), window.run("session.current().progress.iteration_in_all")
    window.run("bpy.ops.wm.read_homefile()", area="")
    window.run("redrawn(5)", area="")
    window.open_sidebar("IRPSO")
    assert window.run("state()") == "none"
    assert [one[0] for one in window.run("[(one.name, one.fraction) for one in recoveries.listed()]")] == ["leaf"]
    window.screenshot("a recovery that was not kept is offered")
    window.click(*window.find_button("irpso.restore"))
    window.wait("state() == 'paused' and session.current().recovery is not None", timeout=180)
    window.screenshot("restored", window.region(region="UI"))
    assert window.run("session.current().progress.iteration_in_all") == before[1]
    for name, values in window.run("found()").items():
        np.testing.assert_array_equal(values, before[0][name])
    asked = "[bpy.context.scene.irpso.seed, round(bpy.context.scene.irpso.schedule.delta, 6)]"
    assert window.run(asked) == [5, 0.04]
    window.run("bpy.ops.irpso.resume()")
    window.wait("state() == 'done'", timeout=300)
    assert window.run("session.current().failure") == "" and window.run("len(recoveries.listed())") == 1


def test_saving_the_kept_material_removes_what_was_stored(window, tmp_path):
    window.run("bpy.ops.irpso.keep()")
    assert window.run("len(recoveries.listed())") == 1
    window.run(f"bpy.ops.wm.save_as_mainfile(filepath={str(tmp_path / 'kept.blend')!r})", area="")
    assert window.run("recoveries.listed()") == [] and window.run("list(recoveries.folder().iterdir())") == []
    window.run("bpy.ops.wm.read_homefile()", area="")
    assert window.run("state(), recoveries.listed()") == ["none", []]


def test_another_recovery_stores_the_former_which_stays_when_it_is_further_done(window, capture, tmp_path):
    begin(window, capture, tmp_path / "mine.blend")
    window.run("bpy.ops.irpso.resume()")
    window.wait("state() == 'done'", timeout=300)
    window.run("bpy.ops.irpso.recover('INVOKE_DEFAULT')")
    assert window.run("[one.fraction for one in recoveries.listed()]") == [1.0]
    window.wait("state() == 'running' and session.current().recovery is not None", timeout=180)
    window.run("bpy.ops.irpso.pause()")
    fraction = window.run("session.current().fraction")
    window.run("bpy.ops.wm.read_homefile()", area="")
    assert fraction < 1 and window.run("[one.fraction for one in recoveries.listed()]") == [fraction, 1.0]
    window.run("[recoveries.delete(one.path) for one in recoveries.listed()]")


LEAVE_IN_ANOTHER_WINDOW = """
def leave():
    new = bpy.context.window_manager.windows[-1]
    for _ in range(5):  # the window drawn last has the current graphics context
        for area in new.screen.areas:
            area.tag_redraw()
        yield
    with bpy.context.temp_override(window=new):
        bpy.ops.wm.read_homefile()
leave()
"""


def test_a_file_closed_in_another_window_stores_the_recovery(window, capture, tmp_path):
    begin(window, capture, tmp_path / "mine.blend")
    window.run("bpy.ops.wm.window_new()")
    window.run(LEAVE_IN_ANOTHER_WINDOW, area="")
    assert window.run("state(), [one.name for one in recoveries.listed()]") == ["none", ["leaf"]]
    window.run("[recoveries.delete(one.path) for one in recoveries.listed()]")


def test_quitting_stores_the_recovery(blender, installed, pictures, backend, capture, tmp_path):
    stored = tmp_path / "stored"
    with open_window(blender, installed, pictures, backend, log_name="stored recoveries, quitting") as window:
        begin(window, capture, tmp_path / "mine.blend")
        window.run(f"recoveries.folder = lambda: Path({str(stored)!r})")
    assert [path.suffix for path in stored.iterdir()] == [".npz"]
