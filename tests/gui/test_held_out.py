"""Photographs held out in a real window: the setting, relighting in slices, and the line in the panel."""

import pytest

from tests.builders import command_line as cli_maker

UI = "bl_ext.user_default.irpso.irpso_addon.ui"
STALL = 1.0  # seconds that the window may stand still while photographs are relit; 0.3 were measured on llvmpipe

SETUP = f"""
import importlib, time
session = importlib.import_module("{UI}.session.session")
settings = bpy.context.scene.irpso
slices = []
def noted(tick):
    def measured(self, budget):
        relighting, begun = self.relighting, time.perf_counter()
        tick(self, budget)
        if relighting:
            slices.append(time.perf_counter() - begun)
    return measured
session.Session.tick = noted(session.Session.tick)
"""


@pytest.fixture(scope="module")
def ready(window, tmp_path_factory):
    """The window with its tab open and a card of 100 000 texels imported."""
    values = cli_maker.smooth_maps((280, 360), {"roughness": (0.25, 0.6), "specular": (0.3, 0.7)})
    lights = cli_maker.dome_lights(16)
    folder = tmp_path_factory.mktemp("capture") / "leaf"
    cli_maker.write_card(folder, cli_maker.render_oracle("principled", values, lights), lights)
    window.run(SETUP)
    window.open_sidebar("IRPSO")
    window.run(f"bpy.ops.irpso.import_capture(filepath={str(folder)!r})")
    window.wait("bool(settings.checked_path)", timeout=120)
    window.run("settings.hold_out = 'AUTO'; settings.schedule.preset = 'swarm'; settings.schedule.iterations = 20")
    window.settle()
    window.screenshot("hold out set", window.region(region="UI"))
    return window


def test_stop_and_keep_relights_the_unseen_photographs_while_the_window_lives(ready):
    ready.run("bpy.ops.irpso.recover('INVOKE_DEFAULT')")
    ready.wait(
        "session.current().progress is not None and session.current().progress.iteration_in_all > 3", timeout=120
    )
    ready.run("session.current().pause()")
    ready.wait("not main_window().modal_operators")
    ready.run("bpy.ops.irpso.stop()")
    ready.wait("session.current().state == 'done'", timeout=60)
    ready.settle()
    ready.screenshot("stopped and relit", ready.region(region="UI"))
    assert ready.run("session.current().stopped and session.current().held_out_line").startswith("Unseen photographs: ")
    slices = ready.run("slices")
    print(f"relighting: {len(slices)} slices, the longest {max(slices):.3f} s, {sum(slices):.2f} s in all")
    assert max(slices) < STALL


def test_a_run_to_its_end_shows_the_line_and_the_view_says_what_is_held_out(ready):
    ready.run("slices.clear(); bpy.ops.irpso.resume()")
    ready.wait("session.current().progress.done and session.current().state == 'done'", timeout=300)
    ready.run("settings.view.shown = 'SPLIT'; settings.view.observation = 5")
    ready.settle()
    ready.screenshot("done and relit")
    ready.screenshot("done and relit, the panel", ready.region(region="UI"))
    assert ready.run("session.current().held_out_line").startswith("Unseen photographs: ")
    assert ready.run("len(slices)") > 0 and ready.run("session.current().failure") == ""
