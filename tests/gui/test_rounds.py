"""Interreflection in a real window: its switch, its rounds, the light that it finds, and its figures."""

import time

import numpy as np
import pytest

from irpso_addon.results.false_color import false_color
from irpso_addon.solver.interreflection.rounds import MAX_INDIRECT
from tests.builders import command_line as cli_maker
from tests.builders.cavity import cap_card

SESSION = "bl_ext.user_default.irpso.irpso_addon.ui.session.session"
SIDE = 32
NEAR = 10  # code values
TEXELS = [(SIDE // 2, SIDE // 2), (SIDE // 2, SIDE // 4), (SIDE // 4, SIDE // 2)]
SETUP = f"""
session = __import__('importlib').import_module('{SESSION}')
settings = bpy.context.scene.irpso
bpy.ops.object.select_all(action='SELECT')
bpy.ops.object.delete()
settings.model = 'lambert'
settings.view.show_lights = settings.view.show_cameras = settings.view.show_curves = False
"""


@pytest.fixture(scope="module")
def ready(window, tmp_path_factory):
    """A window with its tab open and a hollow card imported, seen from above."""
    lights = cli_maker.dome_lights(16, 50.0)
    domain, _, _ = cap_card((0.8, 0.6, 0.4), lights, SIDE)
    folder = tmp_path_factory.mktemp("interreflection") / "hollow"
    cli_maker.write_card(folder, domain.stack.values[..., :3], lights, domain.solvable)
    window.run(SETUP)
    window.open_sidebar("IRPSO")
    window.run(f"bpy.ops.irpso.import_capture(filepath={str(folder)!r})")
    window.wait("bool(settings.checked_path)", timeout=120)
    window.run("bpy.ops.view3d.view_axis(type='TOP')\nbpy.context.space_data.region_3d.view_distance = 2.5")
    for guide in ("cursor", "ortho_grid", "axis_x", "axis_y"):
        window.run(f"bpy.context.space_data.overlay.show_{guide} = False")
    return window


def shown_at(window, texels):
    """Return (N, 3) what the screen shows at texels of the card, which is 1 wide around the origin, 0…255."""
    picture, box, seen = window.pixels().astype(int), window.region(), []
    for row, column in texels:
        x, y = (column + 0.5) / SIDE - 0.5, (row + 0.5) / SIDE - 0.5
        px, py = window.run(
            "from bpy_extras.view3d_utils import location_3d_to_region_2d\n"
            f"tuple(location_3d_to_region_2d(bpy.context.region, bpy.context.space_data.region_3d, ({x}, {y}, 0)))"
        )
        seen.append(picture[round(box.y + box.height - 1 - py), round(box.x + px)])
    return np.array(seen)


def test_the_switch_is_in_the_recover_panel_and_sets_the_rounds(ready):
    assert ready.run("settings.schedule.interreflection_rounds") == 0
    place = ready.find_button("schedule.interreflection")
    ready.move(place[0] + 3, place[1])
    time.sleep(1.5)  # until Blender shows the tooltip
    ready.screenshot("interreflection: tooltip")
    ready.click(*place)
    ready.wait("settings.schedule.interreflection_rounds == 3")
    ready.screenshot("interreflection: on", ready.region(region="UI"))


def test_the_light_is_shown_from_the_first_round_on(ready):
    ready.run("settings.view.shown = 'INDIRECT'\nbpy.ops.irpso.recover('INVOKE_DEFAULT')")
    ready.wait("session.current().state == 'running' and session.current().progress.iteration >= 0", timeout=120)
    ready.screenshot("interreflection: before the first round")
    ready.wait("'round 1 of interreflection' in session.current().title", timeout=240)
    ready.run("bpy.ops.irpso.pause()")
    ready.settle()
    ready.screenshot("interreflection: round 1")
    share = np.array(ready.run("session.current().recovery.indirect_share.tolist()"))
    wanted = 255 * np.array([false_color(share, MAX_INDIRECT)[texel] for texel in TEXELS])
    assert np.abs(shown_at(ready, TEXELS) - wanted).max() <= NEAR
    ready.run("bpy.ops.irpso.resume()")


def test_the_result_says_what_it_changed(ready):
    ready.wait("session.current().state == 'done'", timeout=400)
    ready.screenshot("interreflection: result")
    found = ready.run("session.current().recovery.findings['interreflection']")
    assert found["rounds"] == 3 and 0.05 < found["share"] < 0.3
    ready.run("settings.view.shown = 'PARAMETER'\nsettings.view.parameter = 'normal'")
    ready.screenshot("interreflection: normals")
    ready.run("session.current().probes.add(16, 16)")
    ready.wait("session.current().probes[0].judged == session.current().progress")
    found = ready.run("[str(c) for c in session.current().probes[0].unknown.values()]")
    masks = "session.current().maps().unknown_by_cause()['normal'].items()"
    assert found == ready.run(f"[str(cause) for cause, mask in {masks} if mask[16, 16]]")


def test_occluders_are_a_collection_in_the_subject_panel(ready):
    ready.run(
        "bpy.ops.irpso.cancel()\nbpy.ops.mesh.primitive_plane_add()\n"
        "around = bpy.data.collections.new('Around')\nbpy.context.scene.collection.children.link(around)\n"
        "settings.subject = 'MESH'"
    )
    ready.click(*ready.find_button("irpso.occluders"))
    ready.settle()
    ready.screenshot("interreflection: choosing occluders")
    ready.type("Aro")
    ready.key("Return")
    ready.wait("settings.occluders == around")
    ready.screenshot("interreflection: occluders", ready.region(region="UI"))
