"""An operator that marks a card in its photographs: a click on each corner, in an Image editor."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np
from bpy.props import FloatVectorProperty

from ...blender.images import decode
from ...capture.bounds import without_bounds
from ...capture.frame.find import find_corners
from ...capture.spec import build_capture
from ...core.encode import srgb_from_linear
from ...core.errors import InputError
from ...gpu.viewport import Drawing
from ..common import failures
from ..common.polls import usable
from ..session.scene_capture import knows_distance, spec_of
from . import handlers
from .paint import HALO, Painter

_PICTURE = "IRPSO Photograph"
_MOST_PIXELS = 1600  # of the shown picture's longer side
_PICTURES = 3  # photographs whose brightest values are shown
_BRIGHT = 99.0  # percentile that is shown white
_REACH = 20.0  # pixels at scale 1 within which a click takes hold of a corner
_COLOUR = (1.0, 0.75, 0.2, 1.0)
_HELP = "Click the card's four corners; drag one to move it. Backspace removes the last. Enter ends, Esc cancels"


class IRPSO_OT_mark_card(bpy.types.Operator):
    """Click the four corners of the card in a photograph, in an Image editor. Backspace removes the last one, a corner
    can be dragged, Enter ends, Esc cancels"""

    bl_idname = "irpso.mark_card"
    bl_label = "Mark in Photograph"
    bl_options = {"INTERNAL", "UNDO"}

    corners: FloatVectorProperty(
        name="Corners", description="X and Y of four corners, in pixels from the upper left corner of the photographs",
        size=8, min=0,
    )  # fmt: skip

    @classmethod
    def poll(cls, context):
        """Whether there are photographs in files."""
        return _has_photographs(cls, context)

    def execute(self, context):
        """Take ``corners``, in any order, for those of the card."""
        take_corners(context.scene.irpso, np.reshape(self.corners, (4, 2)))
        return {"FINISHED"}

    def invoke(self, context, event):
        """Show a photograph and wait for clicks."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            picture, self._size = _photograph(context.scene.irpso)
        except InputError as error:
            return failures.refused(self, error)
        self._area = _shown_in_editor(context, picture)
        if self._area is None:
            self.report({"ERROR"}, "There is no room for an Image editor in this window; make an area larger")
            return {"CANCELLED"}
        self._points: list[np.ndarray] = []  # in parts of the picture, from its lower left corner
        self._held: int | None = None
        self._drawing = Drawing()
        self._handle: Any = bpy.types.SpaceImageEditor.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")
        context.window.cursor_modal_set("CROSSHAIR")
        context.workspace.status_text_set(_HELP)
        context.window_manager.modal_handler_add(self)
        handlers.redraw()
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Place, move and remove corners. Blender handles all other events."""
        with failures.reported("Marking"):
            return self._handled(context, event)
        return self._leave(context, {"CANCELLED"})

    def cancel(self, context):
        """End when the window or the file is closed."""
        self._leave(context, {"CANCELLED"})

    def _handled(self, context, event):
        if self._area not in list(context.screen.areas):
            return self._leave(context, {"CANCELLED"})
        if event.value == "PRESS" and event.type in {"ESC", "RIGHTMOUSE"}:
            return self._leave(context, {"CANCELLED"})
        if event.value == "PRESS" and event.type in {"RET", "NUMPAD_ENTER"}:
            if len(self._points) < 4:
                self.report({"INFO"}, f"{len(self._points)} of 4 corners are marked; click the others")
                return {"RUNNING_MODAL"}
            height = self._size[1]
            corners = np.array(self._points) * self._size
            take_corners(context.scene.irpso, np.stack([corners[:, 0], height - corners[:, 1]], axis=-1))
            return self._leave(context, {"FINISHED"})
        if event.value == "PRESS" and event.type == "BACK_SPACE":
            self._points = self._points[:-1]
            return self._again()
        if event.type == "MOUSEMOVE" and self._held is not None:
            self._points[self._held] = np.clip(self._place(event), 0, 1)
            return self._again()
        if event.type == "LEFTMOUSE" and event.value == "RELEASE" and self._held is not None:
            self._held = None
            return self._again()
        if event.type == "LEFTMOUSE" and event.value in {"PRESS", "DOUBLE_CLICK"} and self._is_over_picture(event):
            return self._pressed(context, event)
        return {"PASS_THROUGH"}

    def _pressed(self, context, event):
        place = np.clip(self._place(event), 0, 1)
        reach = _REACH * context.preferences.system.ui_scale
        clicked = np.array([event.mouse_x - self._region.x, event.mouse_y - self._region.y], float)
        near = [float(np.linalg.norm(self._pixel(point) - clicked)) for point in self._points]
        if near and min(near) <= reach:
            self._held = near.index(min(near))
        elif len(self._points) < 4:
            self._points.append(place)
            self._held = len(self._points) - 1
        return self._again()

    def _again(self):
        self._area.tag_redraw()
        return {"RUNNING_MODAL"}

    @property
    def _region(self):
        return next(region for region in self._area.regions if region.type == "WINDOW")

    def _is_over_picture(self, event) -> bool:
        inside = [
            region.type
            for region in self._area.regions
            if 0 <= event.mouse_x - region.x < region.width and 0 <= event.mouse_y - region.y < region.height
        ]
        return inside == ["WINDOW"]  # a sidebar may lie over the picture

    def _place(self, event) -> np.ndarray:
        region = self._region
        return np.array(region.view2d.region_to_view(event.mouse_x - region.x + 0.5, event.mouse_y - region.y + 0.5))

    def _pixel(self, place: np.ndarray) -> np.ndarray:
        return np.array(self._region.view2d.view_to_region(*place, clip=False), float)

    def _draw(self) -> None:
        """Draw the corners and the outline over the picture."""
        with failures.reported("Marking"):
            if bpy.context.area != self._area or not self._points:
                return
            painter = Painter(self._drawing, bpy.context.preferences.system.ui_scale)
            points = np.array([self._pixel(point) for point in self._points])
            outline = around(points) if len(points) == 4 else points
            closed = np.concatenate([outline, outline[:1]]) if len(points) > 2 else outline
            if len(closed) > 1:
                painter.curve(closed, HALO, 4.0)
                painter.curve(closed, _COLOUR, 1.5)
            painter.rings(points, HALO, 7.0, 4.0)
            painter.rings(points, _COLOUR, 7.0, 1.5)
            painter.flush()

    def _leave(self, context, result):
        if self._handle is not None:
            bpy.types.SpaceImageEditor.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None
            self._drawing.close()
            handlers.redraw()
        if context.window is not None:
            context.window.cursor_modal_restore()
            context.workspace.status_text_set(None)
        return result


def _has_photographs(operator, context) -> bool:
    settings = context.scene.irpso
    there = settings.source == "FILES" and settings.capture_path
    return usable(operator, there, "No capture: import a folder of photographs, an .lp list or a capture.toml")


class IRPSO_OT_find_corners(bpy.types.Operator):
    """Find the card in its photographs: by printed markers around it, or as the one rectangle that shows"""

    bl_idname = "irpso.find_corners"
    bl_label = "Find Corners"
    bl_options = {"INTERNAL", "UNDO"}

    @classmethod
    def poll(cls, context):
        """Whether there are photographs in files."""
        return _has_photographs(cls, context)

    def execute(self, context):
        """Read some photographs and store the corners."""
        settings = context.scene.irpso
        try:
            found = find_corners(build_capture(spec_of(settings), decode))
        except InputError as error:
            return failures.refused(self, error)
        take_corners(settings, np.array(found.corners))
        settings.framing, settings.corners = (
            "CORNERS",
            np.ravel(found.corners).tolist(),
        )  # a sheet has its own upper left
        if found.width and settings.near_lights and not knows_distance(settings):
            settings.card_width = found.width
        self.report({"INFO"}, f"Corners: {found}")
        return {"FINISHED"}


def take_corners(settings, corners: np.ndarray) -> None:
    """Store the corners (4, 2) of a card, in any order, in pixels from the upper left: as crop or as corners."""
    ordered = around(corners * (1, -1)) * (1, -1)
    settings.corners = ordered.ravel().tolist()
    low, high = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0))
    settings.crop = [int(value) for value in (*low, *(high - low))]
    if settings.framing == "FILE":
        settings.framing = "CORNERS"


def around(points: np.ndarray) -> np.ndarray:
    """Return points (4, 2), y up, clockwise around their middle, the upper left one first."""
    away = points - points.mean(axis=0)
    ordered = points[np.argsort(-np.arctan2(away[:, 1], away[:, 0]))]
    return np.roll(ordered, -int((ordered[:, 1] - ordered[:, 0]).argmax()), axis=0)


def _photograph(settings) -> tuple[Any, np.ndarray]:
    """Return an image of the brightest values of some photographs, and their size in pixels (2,). Raises InputError."""
    capture = build_capture(spec_of(settings), decode)
    count = len(capture.observations)
    shown: np.ndarray = np.zeros(())
    size = np.zeros(2)
    for index in sorted({round(k * (count - 1) / max(_PICTURES - 1, 1)) for k in range(_PICTURES)}):
        radiance = without_bounds(capture.observations[index].read())[..., :3]
        size = np.array(radiance.shape[1::-1], float)
        step = math.ceil(max(radiance.shape) / _MOST_PIXELS)
        shown = np.maximum(shown, np.nan_to_num(radiance[::step, ::step]))
    shown = srgb_from_linear(np.clip(shown / max(float(np.percentile(shown, _BRIGHT)), 1e-6), 0, 1))
    height, width = shown.shape[:2]
    if (former := bpy.data.images.get(_PICTURE)) is not None:
        bpy.data.images.remove(former)
    image = bpy.data.images.new(_PICTURE, width, height)
    image.pixels.foreach_set(np.concatenate([shown, np.ones((height, width, 1))], axis=-1).astype(np.float32).ravel())
    image.update()
    return image, size


def _shown_in_editor(context, picture):
    """Return an Image editor that shows the picture, made by a split where there is none; None where that fails."""
    areas = list(context.screen.areas)
    area = next((area for area in areas if area.type == "IMAGE_EDITOR"), None)
    if area is None:
        largest = max(areas, key=lambda area: area.width * area.height)
        with context.temp_override(area=largest):
            bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
        area = next((area for area in context.screen.areas if area not in areas), None)
        if area is None:
            return None
        area.type = "IMAGE_EDITOR"
    space = area.spaces.active
    space.mode, space.image = "VIEW", picture
    region = next(region for region in area.regions if region.type == "WINDOW")
    with context.temp_override(area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)
    return area


CLASSES = (IRPSO_OT_mark_card, IRPSO_OT_find_corners)
