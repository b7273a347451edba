"""The panels in a real window: one button recovers, one keeps, one undo takes it back; presets by their buttons."""

import pytest

from tests.builders import command_line as cli_maker

UI = "bl_ext.user_default.irpso.irpso_addon.ui"
DRAWING = 0.02  # seconds that all panels of the tab may take together, on a machine that others use as well

SETUP = f"""
import importlib, time
session = importlib.import_module("{UI}.session.session")

def state():
    running = session.current()
    return running.state if running is not None else "none"

def there():
    return sorted(m.name for m in bpy.data.materials if m.name.startswith("IRPSO")), \\
           sorted(o.name for o in bpy.data.objects if o.name.startswith("IRPSO"))

def drawing_times():
    \"\"\"Return the seconds that each panel of the tab takes to be drawn, the longest of some redraws.\"\"\"
    took, real = {{}}, {{}}
    names = ("sidebar", "capture", "recovery", "view")
    classes = [c for n in names for c in importlib.import_module("{UI}.panels." + n).CLASSES]
    def timed(cls, draw):
        def measured(self, context):
            begun = time.perf_counter()
            draw(self, context)
            took.setdefault(cls.__name__, []).append(time.perf_counter() - begun)
        return measured
    for cls in classes:
        real[cls] = cls.draw
        cls.draw = timed(cls, cls.draw)
    for _ in range(5):
        yield from redrawn()
    for cls, draw in real.items():
        cls.draw = draw
    return {{name: min(times) for name, times in took.items()}}
"""


@pytest.fixture(scope="module")
def ready(window, tmp_path_factory):
    """The window with its tab open and a small capture of a card imported."""
    values = cli_maker.smooth_maps((40, 48), {"roughness": (0.25, 0.6), "specular": (0.3, 0.7)})
    lights = cli_maker.dome_lights(16)
    folder = tmp_path_factory.mktemp("capture") / "leaf"
    cli_maker.write_card(folder, cli_maker.render_oracle("principled", values, lights), lights)
    window.run(SETUP)
    window.open_sidebar("IRPSO")
    window.screenshot("panel of a fresh file", window.region(region="UI"))
    window.run(f"bpy.ops.irpso.import_capture(filepath={str(folder)!r})")
    window.wait("bool(bpy.context.scene.irpso.checked_path)", timeout=120)
    return window


def test_a_fresh_file_has_the_list_of_its_parameters(ready):
    names = ready.run("[item.name for item in bpy.context.scene.irpso.parameters]")
    assert names == ["base_color", "normal", "roughness", "metallic", "specular"]


def test_all_panels_together_are_drawn_in_a_blink(ready):
    took = ready.run("drawing_times()", area="")
    assert {"IRPSO_PT_capture", "IRPSO_PT_recover"} <= set(took)
    print(f"all panels: {1e3 * sum(took.values()):.2f} ms, the longest {max(took, key=took.get)}")
    assert sum(took.values()) < DRAWING


def test_an_own_preset_is_saved_under_a_name_and_removed(ready):
    ready.run("bpy.context.scene.irpso.schedule.delta = 0.07")
    ready.click(*ready.find_button("irpso.preset_add"))
    ready.settle()
    ready.type("skin")
    ready.screenshot("adding a preset")
    ready.key("Return", "Return")
    ready.wait("bpy.context.scene.irpso.schedule.own == 'skin'")
    assert ready.run("bpy.utils.preset_find('skin', 'irpso') is not None")
    ready.run("bpy.ops.irpso.preset_add(remove_active=True)")
    ready.wait("bpy.context.scene.irpso.schedule.own == ''")
    assert ready.run("bpy.utils.preset_find('skin', 'irpso') is None")
    ready.run("bpy.ops.irpso.preset_choose(name='standard')")
    assert ready.run("round(bpy.context.scene.irpso.schedule.delta, 6)") == 0.03


def test_recover_by_the_button_pause_and_resume(ready):
    ready.click(*ready.find_button("irpso.recover"))
    ready.wait("state() == 'running'", timeout=120)
    ready.screenshot("panel of a running recovery", ready.region(region="UI"))
    ready.run("bpy.ops.irpso.pause()")
    ready.screenshot("panel of a paused recovery", ready.region(region="UI"))
    assert ready.run("state()") == "paused"
    ready.run("bpy.ops.irpso.resume()")
    ready.wait("state() == 'done'", timeout=240)
    ready.screenshot("panel of a result", ready.region(region="UI"))


def test_keep_by_the_button_is_one_step_to_undo(ready):
    ready.click(*ready.find_button("irpso.keep"))
    ready.wait("session.current().kept")
    assert ready.run("there()") == [["IRPSO leaf"], ["IRPSO leaf"]]
    assert any("Material 'IRPSO leaf'" in line for line in ready.reports())
    ready.screenshot("kept")
    ready.move(*ready.region().at(0.3, 0.3))
    ready.key("ctrl+z")
    ready.wait("there() == ([], [])")
    assert not ready.run("session.current().kept")
    ready.screenshot("panel after undoing Keep", ready.region(region="UI"))
    ready.key("ctrl+shift+z")
    ready.wait("there() == (['IRPSO leaf'], ['IRPSO leaf'])")
    assert ready.run("all(i.packed_file for i in bpy.data.images if i.name.startswith('IRPSO'))")


def test_stop_and_keep_is_one_step_to_undo_too(ready):
    ready.run("bpy.ops.irpso.cancel()")
    ready.run("bpy.context.scene.irpso.schedule.iterations = 5000")
    ready.run("bpy.ops.irpso.recover('INVOKE_DEFAULT')")
    ready.wait("state() == 'running' and session.current().progress.iteration >= 0", timeout=120)
    ready.run("bpy.data.objects.remove(bpy.data.objects['IRPSO leaf'])\nbpy.ops.ed.undo_push(message='removed')")
    ready.click(*ready.find_button("irpso.stop"))
    ready.wait("session.current().kept")
    assert ready.run("there()") == [["IRPSO leaf"], ["IRPSO leaf"]]
    ready.screenshot("panel of a run that was stopped", ready.region(region="UI"))
    ready.click(*ready.find_button("irpso.resume"))
    ready.wait("state() == 'running'")
    ready.run("bpy.ops.irpso.pause()")
    ready.move(*ready.region().at(0.3, 0.3))
    ready.key("ctrl+z")
    ready.wait("there()[1] == []")
    ready.run("bpy.ops.irpso.cancel()")
    assert ready.run("state()") == "none"
