"""Operators that probe texels: a click on the subject, in the viewport or an Image editor, adds a texel to plot."""

import bpy
import numpy as np
from bpy.props import IntProperty

from ..common import failures
from ..common.polls import usable
from ..common.words import iface, n_, rpt
from ..session import session
from . import flat, handlers
from .picking import first_hit, nearest_texel, texel_at, view_ray
from .surface import bounding_corners, is_solved, placement, triangles_of

_REACH = 3  # most distance from the click to a solved texel, in texels
_HELP = n_("Click the subject to see the error of a texel. Esc or right-click ends")


class IRPSO_OT_probe(bpy.types.Operator):
    """Click texels of the subject, in the viewport or in the Image editor, to see their errors: four at most, a fifth
    replaces the oldest. Esc or right-click ends"""

    bl_idname = "irpso.probe"
    bl_label = "Probe Texels"
    bl_options = {"INTERNAL"}

    row: IntProperty(name="Row", description="Row of the texel, from 0 at the bottom", min=-1, default=-1)
    column: IntProperty(name="Column", description="Column of the texel, from 0 at the left", min=-1, default=-1)

    @classmethod
    def poll(cls, context):
        """Whether there are texels to probe."""
        running = session.current()
        there = running is not None and running.fitted is not None
        return usable(cls, there, "Nothing to probe: press Recover and wait until the images are read")

    def execute(self, context):
        """Probe the texel at ``row`` and ``column``."""
        running = session.current()
        height, width = running.domain.shape
        if not (0 <= self.row < height and 0 <= self.column < width):
            self.report({"ERROR"}, f"texel ({self.row}, {self.column}): there are {height} rows, {width} columns")
            return {"CANCELLED"}
        if not running.fitted.solvable[self.row, self.column]:
            self.report({"ERROR"}, f"no photograph shows texel ({self.row}, {self.column}); choose another")
            return {"CANCELLED"}
        self._add_probe(running, self.row, self.column)
        return {"FINISHED"}

    def invoke(self, context, event):
        """Wait for clicks."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        context.window.cursor_modal_set("CROSSHAIR")
        context.workspace.status_text_set(iface(_HELP))
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Probe the texel of each click on the subject. Blender handles all other events."""
        with failures.reported(n_("Probing")):
            return self._handle(context, event)
        return self._leave(context)

    def _handle(self, context, event):
        running = session.current()
        if running is None or running.fitted is None:
            return self._leave(context)
        if event.value == "PRESS" and event.type in {"ESC", "RIGHTMOUSE"}:
            return self._leave(context)
        if event.type != "LEFTMOUSE" or event.value != "PRESS" or event.alt or event.ctrl or event.shift:
            return {"PASS_THROUGH"}
        texel = _texel_under(context, running, event.mouse_x, event.mouse_y)
        if texel is None:  # buttons, gizmos, other editors
            return {"PASS_THROUGH"}
        nearest = nearest_texel(running.fitted.solvable, *texel, _REACH)
        if nearest is None:
            self.report({"INFO"}, rpt("No photograph shows this texel; click another"))
            return {"RUNNING_MODAL"}
        self._add_probe(running, *nearest)
        return {"RUNNING_MODAL"}

    def cancel(self, context):
        """Blender calls this when the window or the file is closed."""
        if context.window is not None:
            self._leave(context)

    def _add_probe(self, running, row: int, column: int) -> None:
        """Add a probe, and report the one that it replaces."""
        replaced = running.probes.add(row, column)
        if replaced is not None:
            where = f"{replaced.column}, {replaced.row}"
            self.report({"INFO"}, rpt(
                "Probe {number} has moved here from texel {where}: there are four at most", number=replaced.number,
                where=where,
            ))  # fmt: skip
        handlers.redraw()

    @staticmethod
    def _leave(context):
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)
        return {"FINISHED"}


class IRPSO_OT_probe_remove(bpy.types.Operator):
    """Remove this probe"""

    bl_idname = "irpso.probe_remove"
    bl_label = "Remove Probe"
    bl_options = {"INTERNAL"}

    index: IntProperty(name="Index", description="Index of the probe from 0, oldest first", min=0)

    @classmethod
    def poll(cls, context):
        """Whether a texel is probed."""
        return _has_probes(cls)

    def execute(self, context):
        """Remove the probe."""
        running = session.current()
        if self.index >= len(running.probes):
            self.report({"ERROR"}, f"there is no probe {self.index}: there are {len(running.probes)}, from 0")
            return {"CANCELLED"}
        running.probes.remove_at(self.index)
        handlers.redraw()
        return {"FINISHED"}


class IRPSO_OT_probe_clear(bpy.types.Operator):
    """Remove all probes"""

    bl_idname = "irpso.probe_clear"
    bl_label = "Clear Probes"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, context):
        """Whether a texel is probed."""
        return _has_probes(cls)

    def execute(self, context):
        """Remove all probes."""
        running = session.current()
        while running.probes:
            running.probes.remove_at(0)
        handlers.redraw()
        return {"FINISHED"}


def _has_probes(cls) -> bool:
    running = session.current()
    return usable(cls, running is not None and running.probes, "No texel is probed")


def _texel_under(context, running, x: int, y: int) -> tuple[int, int] | None:
    """Return (row, column) of the texel at a pixel of the window, None beside the subject."""
    area = next((a for a in context.screen.areas if _contains(a, x, y)), None)
    if area is None or area.type not in ("VIEW_3D", "IMAGE_EDITOR"):
        return None
    regions = [region for region in area.regions if _contains(region, x, y)]
    if not regions or any(region.type != "WINDOW" for region in regions):  # a sidebar may lie over the view
        return None
    region, space = regions[0], area.spaces.active
    place = (x - region.x + 0.5, y - region.y + 0.5)
    if area.type == "IMAGE_EDITOR":
        return _flat_texel(running, region, space, place)
    if not handlers.is_seen_in(context, space):
        return None
    # In a quad view each region has its own view.
    return _surface_texel(running, region.data, place, (region.width, region.height))


def _contains(item, x: int, y: int) -> bool:
    return item.width > 1 and item.height > 1 and 0 <= x - item.x < item.width and 0 <= y - item.y < item.height


def _flat_texel(running, region, space, place: tuple[float, float]) -> tuple[int, int] | None:
    if flat.why_covered(space):
        return None
    uv = flat.texture_place(flat.map_areas(region, space, running.domain.shape, running.tiles), *place)
    return None if uv is None else texel_at(uv, running.domain.shape)


def _surface_texel(running, view, place: tuple[float, float], size: tuple[float, float]) -> tuple[int, int] | None:
    corners = bounding_corners(running)
    inverse = np.linalg.inv(placement(running, running.subject(), corners).frame)
    origin, direction = view_ray(np.array(view.perspective_matrix), place, size)
    origin, direction = inverse[:3, :3] @ origin + inverse[:3, 3], inverse[:3, :3] @ direction
    positions, uvs = triangles_of(running)
    hit = first_hit(origin, direction, positions)
    if hit is None or not is_solved(running, hit[0]):
        return None
    return texel_at(hit[1] @ uvs[hit[0]], running.domain.shape)


CLASSES = (IRPSO_OT_probe, IRPSO_OT_probe_remove, IRPSO_OT_probe_clear)
