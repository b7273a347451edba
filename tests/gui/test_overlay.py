"""What is drawn over a viewport and an Image editor while a recovery goes on, and which texels clicks find."""

import numpy as np
import pytest

from tests.builders import command_line as cli_maker

SHAPE = (12, 18)  # texels
OVERLAY = "bl_ext.user_default.irpso.irpso_addon.ui.overlay"
# The false colours' ends, as the figures of Nagano et al. have them: low is blue, high is red.
NEAR = 8  # code values; software GL shows dark ones up to 7 brighter, Blender's own background by 2
BLUE, RED = (33, 37, 107), (184, 18, 31)


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    """The folder of a small Lambertian card, and its maps."""
    values = cli_maker.smooth_maps(SHAPE, {}, tilt=12)
    lights = cli_maker.dome_lights(16)
    images = cli_maker.render_oracle("lambert", values, lights)
    return cli_maker.write_card(tmp_path_factory.mktemp("overlay") / "card", images, lights), values


@pytest.fixture(scope="module")
def paused(window, card):
    """A window in whose viewport, seen from above, a recovery of the card rests after all its iterations."""
    window.run("bpy.ops.object.select_all(action='SELECT')\nbpy.ops.object.delete()")
    window.run(
        f"from importlib import import_module\nhandlers = import_module('{OVERLAY}.handlers')\n"
        f"session = import_module('{OVERLAY.rpartition('.')[0]}.session.session')\n"
        "settings = bpy.context.scene.irpso\nview = settings.view\n"
        "settings.subject, settings.model = 'CARD', 'lambert'"
    )
    assert window.run("len(handlers.installed)") == 0
    window.run(f"bpy.ops.irpso.import_capture(directory={str(card[0]) + '/'!r})")
    window.wait("settings.summary != '' or settings.capture_path != ''")
    window.run(
        "bpy.ops.view3d.view_axis(type='TOP')\nbpy.context.space_data.region_3d.view_distance = 2.5\n"
        "view.show_lights = view.show_cameras = False\nbpy.ops.irpso.recover('INVOKE_DEFAULT')"
    )
    window.wait("session.current().state == 'done'", 180)
    for guide in ("cursor", "ortho_grid", "axis_x", "axis_y"):
        window.run(f"bpy.context.space_data.overlay.show_{guide} = False")
    return window


def texel_on_screen(window, row, column):
    """Return the pixel of a texel's middle, the card being 1 wide around the origin, by Blender's own projection."""
    x, y = (column + 0.5) / SHAPE[1] - 0.5, ((row + 0.5) - SHAPE[0] / 2) / SHAPE[1]
    px, py = window.run(
        "from bpy_extras.view3d_utils import location_3d_to_region_2d\n"
        f"tuple(location_3d_to_region_2d(bpy.context.region, bpy.context.space_data.region_3d, ({x}, {y}, 0)))"
    )
    box = window.region()
    return round(box.x + px), round(box.y + box.height - 1 - py)


def shown_at(window, places):
    """Return (N, 3) what the screen shows at pixels, 0…255."""
    picture = window.pixels().astype(int)
    return np.array([picture[y, x] for x, y in places])


def encoded(linear):
    """Return the sRGB code values of linear ones (IEC 61966-2-1)."""
    linear = np.asarray(linear, float)
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


TEXELS = [(1, 2), (1, 15), (10, 2), (10, 15), (5, 9)]


def test_draw_handlers_are_there_while_a_session_is(paused):
    assert paused.run("len(handlers.installed)") == 3


def test_the_base_colour_on_the_card_matches_the_photographs(paused, card):
    paused.run("view.parameter = 'base_color'\nview.shown = 'PARAMETER'")
    paused.wait("not session.current().display.pending(next(iter(session.current().display._pictures)))")
    paused.screenshot("overlay: base colour")
    seen = shown_at(paused, [texel_on_screen(paused, *texel) for texel in TEXELS])
    true = np.array([encoded(card[1]["base_color"][texel]) for texel in TEXELS])
    assert np.abs(seen - true).max() <= NEAR


def test_the_normal_map_is_seen_in_the_colours_of_a_normal_map(paused, card):
    paused.run("view.parameter = 'normal'")
    paused.screenshot("overlay: normal")
    seen = shown_at(paused, [texel_on_screen(paused, *texel) for texel in TEXELS])
    true = np.array([255 * (0.5 + 0.5 * card[1]["normal"][texel]) for texel in TEXELS])
    assert np.abs(seen - true).max() <= NEAR


def test_errors_run_from_blue_to_red(paused):
    paused.run("view.shown, view.red_error = 'ERROR', 1000.0")
    places = [texel_on_screen(paused, *texel) for texel in TEXELS]
    paused.screenshot("overlay: small errors")
    assert np.abs(shown_at(paused, places) - BLUE).max() <= NEAR
    paused.run("view.red_error = 1e-7")
    paused.screenshot("overlay: large errors")
    assert np.abs(shown_at(paused, places) - RED).max() <= NEAR
    paused.run("view.red_error = 0")
    paused.screenshot("overlay: error")


def test_left_of_the_split_is_the_render_and_right_of_it_the_photograph(paused, card):
    paused.run("view.shown, view.observation, view.split = 'SPLIT', 4, 0.5")
    paused.screenshot("overlay: split")
    places = [texel_on_screen(paused, *texel) for texel in TEXELS[:4]]
    seen = shown_at(paused, places)
    image = cli_maker.render_oracle("lambert", card[1], cli_maker.dome_lights(16)[3:4])[0]
    # The card is recovered so well that render and photograph agree.
    assert np.abs(seen - np.array([encoded(image[texel]) for texel in TEXELS[:4]])).max() <= NEAR


def test_a_click_probes_a_texel_and_a_fifth_replaces_the_oldest(paused):
    paused.run("view.shown = 'PARAMETER'\nbpy.ops.irpso.probe('INVOKE_DEFAULT')")
    for texel in TEXELS:
        paused.click(*texel_on_screen(paused, *texel))
    paused.key("Escape")
    found = paused.run("[(probe.row, probe.column, probe.slot) for probe in session.current().probes]")
    assert [tuple(probe[:2]) for probe in found] == TEXELS[1:]
    assert [probe[2] for probe in found] == [1, 2, 3, 0]
    paused.wait("all(probe.curve for probe in session.current().probes)")
    paused.screenshot("overlay: probes")


def test_one_or_all_probes_can_be_removed(paused):
    paused.run("bpy.ops.irpso.probe_remove(index=1)")
    assert paused.run("[probe.slot for probe in session.current().probes]") == [1, 3, 0]
    paused.run("bpy.ops.irpso.probe(row=4, column=5)")
    assert paused.run("(session.current().probes[-1].row, session.current().probes[-1].slot)") == [4, 2]
    paused.run("bpy.ops.irpso.probe_clear()")
    assert paused.run("(len(session.current().probes), bpy.ops.irpso.probe_clear.poll())") == [0, False]


def test_a_viewport_without_overlays_says_why_it_shows_nothing(paused):
    assert paused.run("handlers.why_hidden(bpy.context)") == ""
    paused.run("bpy.context.space_data.overlay.show_overlays = False")
    assert "overlays are off" in paused.run("handlers.why_hidden(bpy.context)")
    paused.run("bpy.context.space_data.overlay.show_overlays = True")


def test_a_number_above_the_last_observation_becomes_the_last(paused):
    paused.run("view.observation = 99")
    assert paused.run("view.observation") == 16


def test_another_scene_shows_nothing_of_it(paused):
    place = [texel_on_screen(paused, 5, 9)]
    before = shown_at(paused, place)
    paused.run("first = bpy.context.window.scene\nbpy.context.window.scene = bpy.data.scenes.new('Other')")
    assert np.abs(shown_at(paused, place) - before).max() > 20
    paused.run("bpy.context.window.scene = first")
    assert np.abs(shown_at(paused, place) - before).max() <= 2


def test_the_image_editor_shows_the_map_flat_and_takes_clicks(paused, card):
    paused.run("view.parameter = 'base_color'\nbpy.context.area.ui_type = 'IMAGE_EDITOR'")
    corners = paused.run(
        "[bpy.context.region.view2d.view_to_region(*corner, clip=False) for corner in ((0, 0), (1, 1))]",
        area="IMAGE_EDITOR",
    )
    (x0, y0), (x1, _) = corners
    box, side = paused.region("IMAGE_EDITOR"), (x1 - x0) / SHAPE[1]
    places = [
        (round(box.x + x0 + side * (column + 0.5)), round(box.y + box.height - 1 - y0 - side * (row + 0.5)))
        for row, column in TEXELS
    ]
    paused.screenshot("overlay: flat")
    true = np.array([encoded(card[1]["base_color"][texel]) for texel in TEXELS])
    assert np.abs(shown_at(paused, places) - true).max() <= NEAR
    paused.run("bpy.ops.irpso.probe('INVOKE_DEFAULT')", area="IMAGE_EDITOR")
    paused.click(*places[1])
    paused.key("Escape")
    found = paused.run("[(p.row, p.column) for p in session.current().probes]", area="IMAGE_EDITOR")
    assert [tuple(texel) for texel in found] == [TEXELS[1]]
    paused.run("bpy.ops.irpso.probe_clear()\nbpy.context.area.ui_type = 'VIEW_3D'", area="IMAGE_EDITOR")


def test_a_failed_drawing_ends_the_overlay_and_is_reported_once(paused):
    paused.expect("Traceback|The overlay has ended|broken on purpose")
    paused.run(
        "module = import_module(handlers.__name__.replace('handlers', 'session_overlay'))\n"
        "overlay = module.SessionOverlay\nright = overlay.draw_pixels\n"
        "def broken(self, context):\n    raise ValueError('broken on purpose')\n"
        "overlay.draw_pixels = broken"
    )
    paused.run("redrawn()", area="")
    paused.wait("len(handlers.installed) == 0")
    paused.run("redrawn()", area="")
    paused.run("redrawn()", area="")
    said = paused.run("import_module(handlers.__name__.replace('overlay.handlers', 'common.failures')).messages()")
    assert said == ["The overlay has ended: broken on purpose"]
    paused.screenshot("overlay: failed")
    assert paused.log().count("ValueError: broken on purpose") == 1
    paused.run("overlay.draw_pixels = right")


def test_draw_handlers_follow_the_session(paused):
    paused.run("bpy.ops.irpso.cancel()")
    assert paused.run("(session.current() is None, len(handlers.installed))") == [True, 0]
    paused.run("bpy.ops.irpso.recover('INVOKE_DEFAULT')")
    assert paused.run("len(handlers.installed)") == 3
    paused.wait("session.current().state in ('running', 'done')", 60)
    paused.run("bpy.ops.irpso.cancel()")
    assert paused.run("len(handlers.installed)") == 0
