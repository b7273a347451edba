"""docs/first_recovery.md from beginning to end, by mouse and keys alone, in a Blender as it starts."""

import numpy as np
import pytest

from irpso_addon.capture.images.exr import read_exr
from tests.builders import command_line as cli_maker

UI = "bl_ext.user_default.irpso.irpso_addon.ui"
SHAPE = (36, 48)  # texels
CARD = "IRPSO leaf"

SETUP = f"""
import importlib
session = importlib.import_module("{UI}.session.session")

def state():
    running = session.current()
    return running.state if running is not None else "none"

def settings():
    return bpy.context.scene.irpso
"""


@pytest.fixture(scope="module")
def truth():
    """The maps of a leaf."""
    return cli_maker.smooth_maps(SHAPE, {"roughness": (0.25, 0.6), "specular": (0.3, 0.7)})


@pytest.fixture(scope="module")
def capture(truth, tmp_path_factory):
    """The folder of its photographs."""
    lights = cli_maker.dome_lights(24)
    folder = tmp_path_factory.mktemp("journey") / "leaf"
    return cli_maker.write_card(folder, cli_maker.render_oracle("principled", truth, lights), lights)


@pytest.fixture(scope="module")
def artist(window):
    """A window in which nothing was done, but for a file browser that opens in the same window."""
    window.run(SETUP + "bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'")
    return window


def test_a_new_file_gets_the_tab_by_n(artist):
    artist.move(*artist.region().centre)
    artist.key("n")
    artist.open_sidebar("IRPSO")
    artist.screenshot("journey 1: a fresh file")


def test_the_capture_is_imported_and_checked(artist, capture):
    artist.click(*artist.find_button("irpso.import_capture"))
    artist.choose_in_browser(capture)
    artist.wait("settings().checked_path != ''", timeout=120)
    artist.screenshot("journey 2: imported")
    assert artist.run("[settings().subject, [item.severity for item in settings().findings]]") == ["CARD", []]


def test_recover_shows_a_picture_pauses_on_escape_and_resumes(artist):
    artist.click(*artist.find_button("irpso.recover"))
    artist.wait("state() == 'running'", 180)
    artist.screenshot("journey 3: the first picture")
    artist.move(*artist.region().centre)
    artist.key("Escape")
    artist.wait("state() == 'paused'")
    artist.screenshot("journey 4: paused")
    artist.click(*artist.find_button("irpso.resume"))
    artist.wait("state() == 'done'", 400)
    artist.screenshot("journey 5: done")
    assert artist.run("session.current().error") < 0.005


def test_the_view_goes_through_all_that_can_be_shown(artist):
    x, y = artist.find_button("irpso.view.shown")
    seen = []
    for _ in range(7):
        artist.click(x, y, button=5, held="ctrl")  # the next entry of the menu under the mouse
        seen.append(artist.run("settings().view.shown"))
        artist.screenshot(f"journey 6: {seen[-1].lower()}")
    assert seen == ["ERROR", "CONFIDENCE", "INDIRECT", "RENDER", "REFERENCE", "SPLIT", "BLINK"]
    artist.click(x, y, button=4, held="ctrl")  # the one before: Blink has all drawn again twice a second


def test_keep_makes_the_material_that_the_rendered_view_shows(artist):
    artist.click(*artist.find_button("irpso.keep"))
    artist.wait(f"{CARD!r} in bpy.data.materials")
    artist.click(*artist.find_button("irpso.standard_view"))
    assert artist.run("bpy.context.scene.view_settings.view_transform") == "Standard"
    artist.run("bpy.context.scene.render.engine = 'CYCLES'")
    artist.move(*artist.region().at(0.3, 0.3))
    artist.key("z", "8")  # the pie menu of shading: Rendered lies upward
    artist.wait("bpy.context.space_data.shading.type == 'RENDERED'")
    artist.run("redrawn(4)", area="", timeout=180)
    artist.screenshot("journey 7: kept, rendered by Cycles")
    artist.run("bpy.context.space_data.shading.type = 'SOLID'")


def test_the_exported_maps_are_those_of_the_leaf(artist, truth, tmp_path):
    artist.click(*artist.find_button("irpso.export"))
    artist.choose_in_browser(tmp_path)
    artist.wait("any('files written' in line for line in reports())", 120, area="")
    (written,) = tmp_path.glob("**/maps.exr")
    found = read_exr(written)["normal"]
    normal = np.stack([found[channel] for channel in "RGB"], axis=-1)
    cosine = np.clip((normal * truth["normal"]).sum(axis=-1), -1, 1)
    assert np.degrees(np.arccos(cosine)).mean() < 0.5


def test_the_kept_material_goes_into_an_asset_library(artist, tmp_path):
    artist.run("while bpy.context.preferences.filepaths.asset_libraries:\n"
               "    bpy.ops.preferences.asset_library_remove(index=0)\n"
               f"bpy.ops.preferences.asset_library_add(directory={str(tmp_path)!r})")  # fmt: skip
    artist.click(*artist.find_button("irpso.save_asset"))
    artist.settle()
    artist.screenshot("journey 8: into an asset library")
    artist.key("Return")
    artist.wait("any('is in the library' in line for line in reports())", 120, area="")
    assert [path.suffix for path in tmp_path.iterdir()] == [".blend"]


def test_close_restores_the_settings_and_recover_restarts(artist):
    artist.click(*artist.find_button("irpso.cancel"))
    artist.wait("state() == 'none'")
    assert artist.run(f"[{CARD!r} in bpy.data.materials, settings().capture_path != '']") == [True, True]
    artist.click(*artist.find_button("irpso.create_scene"))
    artist.wait("len([obj for obj in bpy.data.objects if obj.type == 'LIGHT']) >= 24")
    artist.screenshot("journey 9: the capture's cameras and lights")
    seen, stands = artist.run(
        f"[list(bpy.context.space_data.region_3d.view_location), list(bpy.data.objects[{CARD!r}].location)]"
    )
    np.testing.assert_allclose(seen, stands, atol=1e-5)
