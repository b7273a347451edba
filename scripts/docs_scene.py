"""Functions inside Blender for the guide's pictures: view of the sample's card, lights, preferences."""

import importlib

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Euler, Vector

PROGRAM = "bl_ext.user_default.irpso.irpso_addon"
# Probed texels (row, column) as fractions of the card, from its lower left corner: petal, gold, glaze, leaf.
PROBED = ((0.66, 0.5), (0.5, 0.575), (0.3, 0.3), (0.71, 0.36))


def part(name):
    """Return a module of the program."""
    return importlib.import_module(f"{PROGRAM}.{name}")


def empty():
    """Remove all objects, and the viewport's overlays."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    space = largest("VIEW_3D").spaces.active  # noqa: F821  of inside.py
    overlay = space.overlay
    overlay.show_floor = overlay.show_axis_x = overlay.show_axis_y = overlay.show_cursor = overlay.show_text = False
    overlay.show_outline_selected = overlay.show_extras = space.show_gizmo = False


def bare():
    """Hide the viewport's bars, so that the card is in its middle."""
    space = largest("VIEW_3D").spaces.active  # noqa: F821
    space.show_region_ui = space.show_region_toolbar = False


def closer():
    """Zoom in to the card, which Recover has framed, with room for curves at the left."""
    view = largest("VIEW_3D").spaces.active.region_3d  # noqa: F821
    view.view_location, view.view_distance = (-0.3, 0, 0), 1.45


def card_box():
    """Return x, y from the top, width and height on the screen of the card, 1 wide around the origin."""
    area = largest("VIEW_3D")  # noqa: F821
    region, view = region_of(area, "WINDOW"), area.spaces.active.region_3d  # noqa: F821
    low, high = (location_3d_to_region_2d(region, view, Vector((end, end, 0))) for end in (-0.5, 0.5))
    top = main_window().height - region.y - round(high.y)  # noqa: F821
    return region.x + round(low.x), top, round(high.x - low.x), round(high.y - low.y)


def texel(place):
    """Return row and column of a texel at fractions of the card's height and width."""
    rows, columns = part("ui.session.session").current().domain.solvable.shape
    return [int(place[0] * rows), int(place[1] * columns)]


def aslant(card):
    """View the card from the front left, to show its gloss."""
    space = largest("VIEW_3D").spaces.active  # noqa: F821
    view = space.region_3d
    view.view_perspective = "PERSP"
    view.view_rotation = Euler((0.62, 0, -0.35)).to_quaternion()
    view.view_location = card.matrix_world.translation
    view.view_distance = 1.6 * max(card.dimensions)
    space.clip_end = 100 * view.view_distance


def lit_by(observation):
    """Light the scene by one light of the capture and a faint ambient light."""
    bpy.context.scene.irpso.view.observation = observation
    bpy.context.scene.world.color = (0.03, 0.03, 0.03)
    bpy.context.scene.world.use_nodes = False


def rendered_view():
    """Render the viewport by Cycles, without overlays."""
    scene, space = bpy.context.scene, largest("VIEW_3D").spaces.active  # noqa: F821
    scene.render.engine = "CYCLES"
    scene.cycles.preview_samples = 64
    scene.cycles.use_preview_denoising = False
    space.overlay.show_overlays = False
    space.shading.type = "RENDERED"


def solid_view():
    """Restore the viewport's overlays and solid shading."""
    space = largest("VIEW_3D").spaces.active  # noqa: F821
    space.overlay.show_overlays = True
    space.shading.type = "SOLID"


def show_preferences():
    """Show the add-on's preferences, expanded."""
    bpy.context.preferences.active_section = "ADDONS"
    bpy.context.window_manager.addon_search = "IRPSO"
    bpy.context.window_manager.addon_filter = "All"
    bpy.ops.preferences.addon_expand(module=PROGRAM.rpartition(".")[0])


def waiting(seconds):
    """Let Blender work for some seconds."""
    import time

    end = time.monotonic() + seconds
    while time.monotonic() < end:
        yield
