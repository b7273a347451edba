"""A rig is saved and applied in a real window, by the mouse: menu, file browser, dialog, refusals."""

import shutil

import numpy as np
import pytest
from blender_window import Box

from irpso_addon.capture.read import read_capture
from tests.builders import command_line as cli_maker
from tests.gui.test_import import SETUP

SHAPE = (36, 48)
TABS = 18, 190  # width and height of the sidebar's tabs, in pixels
LIGHTS = cli_maker.dome_lights(8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A calibrated capture, ``first``; ``later``, photographs of another subject under the same lamps; ``few``: two."""
    folder = tmp_path_factory.mktemp("rigs")
    for seed, name in enumerate(("first", "later")):
        maps = cli_maker.smooth_maps(SHAPE, {"roughness": (0.3, 0.6), "specular": (0.4, 0.6)}, seed)
        cli_maker.write_card(folder / name, cli_maker.render_oracle("principled", maps, LIGHTS), LIGHTS)
    (folder / "few").mkdir()
    for path in (folder / "later").iterdir():
        if not path.stem.isdecimal():
            path.unlink()  # the list of lights, and the mask
        elif int(path.stem) < 2:
            shutil.copy(path, folder / "few")
    return folder


@pytest.fixture(scope="module")
def artist(window):
    """A window whose file browser opens in the same window, in which Apply Rig's dialog must survive it."""
    window.run(SETUP + "bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'")
    window.open_sidebar("IRPSO")
    return window


def choose(artist, entry, number):
    """Click an entry of the menu beside Find Lights."""
    button = "irpso.find_lights" if artist.run("settings().capture_path") else "irpso.choose_photographs"
    _, y = artist.find_button(button)
    x = artist.region(region="UI").at(0.825, 0)[0]
    artist.click(x, y)
    artist.settle()
    artist.screenshot(f"rigs: menu before {entry}")
    artist.click(x + 60, y + 24 + round(21 * number))


def test_without_a_rig_the_browser_asks_for_one_and_refuses_another_folder(artist, folder):
    artist.expect("is no rig")
    artist.run("bpy.ops.irpso.apply_rig('INVOKE_DEFAULT')")
    artist.settle()
    artist.screenshot("rigs: choosing a rig")
    artist.choose_in_browser(folder / "few")
    artist.settle()
    artist.screenshot("rigs: no rig")
    (line,) = [line for line in artist.reports() if "is no rig" in line]
    assert line.endswith("choose the folder that Save Rig made")


def test_a_rig_is_saved_beside_the_capture(artist, folder):
    artist.run(f"bpy.ops.irpso.import_capture(filepath={str(folder / 'first')!r})")
    artist.wait("not checking()", timeout=120)
    choose(artist, "save", 3.7)
    artist.wait("any(area.type == 'FILE_BROWSER' for area in main_window().screen.areas)", area="")
    artist.settle()
    artist.screenshot("rigs: saving")
    artist.move(*artist.region("FILE_BROWSER").centre)
    artist.key("Return")
    artist.wait("all(area.type != 'FILE_BROWSER' for area in main_window().screen.areas)", area="")
    artist.screenshot("rigs: saved")
    assert artist.reports()[-1] == "first_rig: 8 lamps, without corrections"
    assert (folder / "first_rig" / "rig.toml").is_file()


def apply(artist, photographs, name):
    """Choose Apply Rig in the menu, photographs in the browser, and OK in the dialog."""
    choose(artist, name, 4.6)
    artist.choose_in_browser(photographs)
    artist.settle()
    artist.screenshot(f"rigs: dialog of {name}")
    artist.key("Return")


def test_the_rig_lights_other_photographs_in_four_clicks(artist, folder):
    apply(artist, folder / "later", "apply")
    table = folder / "later_capture" / "capture.toml"
    artist.wait(f"settings().capture_path == {str(table.parent)!r}", timeout=60)
    artist.wait("not checking()", timeout=120)
    artist.screenshot("rigs: applied")
    found = read_capture(table)
    np.testing.assert_allclose([one.light.vector for one in found.observations], LIGHTS, atol=1e-6)
    assert "8 lamps written to later_capture" in artist.reports()


def test_a_photograph_accepted_in_the_browser_stands_for_its_folder(artist, folder):
    photographs = sorted((folder / "later").glob("0*.*"))
    apply(artist, photographs[0], "photograph")
    artist.wait(f"settings().capture_path == {str(folder / 'later_capture_1')!r}", timeout=60)
    artist.wait("not checking()", timeout=120)


def test_another_number_of_photographs_is_refused_in_one_line_and_changes_nothing(artist, folder):
    artist.expect("has 2 photographs")
    before, sidebar = artist.run("settings().capture_path"), artist.region(region="UI")
    tabs = Box(sidebar.x + sidebar.width - TABS[0], sidebar.y, *TABS)
    names = artist.pixels(tabs)
    apply(artist, folder / "few", "few")
    failures = "importlib.import_module(capture_import.__name__.replace('operators.capture_import', 'common.failures'))"
    (message,) = artist.wait(f"{failures}.messages()", timeout=60)
    artist.screenshot("rigs: too few photographs")
    assert message.endswith("choose Match: Names or Numbers") and "8 lamps" in message
    assert artist.run("settings().capture_path") == before and not (folder / "few_capture").exists()
    np.testing.assert_allclose(artist.pixels(tabs), names.astype(int), atol=30)  # the message moves no tab
    artist.run("bpy.ops.irpso.dismiss_failures()")
