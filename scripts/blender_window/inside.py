"""Functions for code inside Blender: contexts, regions of the screen, and their buttons."""

from contextlib import suppress

import bpy

STEP = 18  # pixels between probes for a button: less than its height; each probe redraws the region


def main_window():
    """Return Blender's first window."""
    return bpy.context.window_manager.windows[0]


def largest(area_type):
    """Return the largest area of a type in the first window. Raises LookupError where there is none."""
    areas = [area for area in main_window().screen.areas if area.type == area_type]
    if not areas:
        raise LookupError(f"the window shows no area of type {area_type}")
    return max(areas, key=lambda area: area.width * area.height)


def region_of(area, region_type):
    """Return an area's region of a type."""
    return next(region for region in area.regions if region.type == region_type)


def override(area_type, region_type="WINDOW"):
    """Return the context of an operator with the mouse over the largest area of a type."""
    area = largest(area_type)
    return bpy.context.temp_override(window=main_window(), area=area, region=region_of(area, region_type))


def region_box(area_type, region_type="WINDOW"):
    """Return x, y, width and height of a region on the screen, from its upper left corner."""
    region = region_of(largest(area_type), region_type)
    return region.x, main_window().height - region.y - region.height, region.width, region.height


def redrawn(ticks=3):
    """Redraw everything and wait a few ticks."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            area.tag_redraw()
    for _ in range(ticks):
        yield


def settled(ticks=3):
    """Wait a few ticks, so that Blender handles events."""
    for _ in range(ticks):
        yield


def open_sidebar(tab, area_type):
    """Show a tab of the sidebar. Raises LookupError where the sidebar has no such tab."""
    area = largest(area_type)
    area.spaces.active.show_region_ui = True
    region = region_of(area, "UI")
    for _ in range(100):  # a tab can be chosen once the sidebar has been drawn
        area.tag_redraw()
        yield
        if region.width > 1:
            with suppress(TypeError, AttributeError):
                region.active_panel_category = tab
            if region.active_panel_category == tab:
                yield from redrawn()
                return
    raise LookupError(f"the sidebar of {area_type} has no tab {tab!r}; it shows {region.active_panel_category!r}")


def reports():
    """Return what operators have reported to the user, of any kind, oldest first.

    The log lacks reports of cancelled operators; only an Info editor can copy them, so the smallest area becomes one
    for a moment. The editor's lines of Python calls are omitted.
    """
    window = main_window()
    area = min((a for a in window.screen.areas if a.type != "VIEW_3D"), key=lambda area: area.width * area.height)
    before, area.ui_type = area.ui_type, "INFO"
    window_manager = bpy.context.window_manager
    window_manager.clipboard = ""
    with bpy.context.temp_override(window=window, area=area, region=region_of(area, "WINDOW")):
        bpy.ops.info.select_all(action="SELECT")
        bpy.ops.info.report_copy()
    area.ui_type = before
    return [line for line in window_manager.clipboard.splitlines() if not line.startswith("bpy.")]


def button_under_mouse(area_type, region_type):
    """Return the operator call in Python, or the property's data path, of the button under the mouse, or ""."""
    wm, ui = bpy.context.window_manager, bpy.ops.ui
    wm.clipboard = ""
    with override(area_type, region_type), suppress(RuntimeError):
        if ui.copy_python_command_button.poll():
            ui.copy_python_command_button()
        elif ui.copy_data_path_button.poll():
            ui.copy_data_path_button(full_path=True)
    return wm.clipboard


def find_button(call, area_type, region_type="UI"):
    """Move the mouse down a region, in columns, to a button; return its x and y on the screen.

    call: a part of the operator's call in Python, or of the property's data path. Raises LookupError, with the
    buttons in the region.
    """
    left, top, width, height = region_box(area_type, region_type)
    window, seen = main_window(), {}
    for across in (0.4, 0.8, 0.15):
        for y in range(top + STEP, top + height, STEP):
            x = left + round(across * width)
            window.cursor_warp(x, window.height - 1 - y)
            yield
            yield
            does = button_under_mouse(area_type, region_type)
            if call in does:
                return x, y
            seen[does] = None
            yield
    raise LookupError(f"no button of {call!r} in {region_type} of {area_type}; there are: {', '.join(seen)}")
