"""Base of operators that mark a photograph: an Image editor shows it, and the mouse drags handles on it."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import bpy
import numpy as np

from ...blender.images import decode
from ...capture.bounds import without_bounds
from ...capture.errors import CaptureError
from ...capture.frame.find import evenly_spaced
from ...capture.images.image import ImageStore
from ...capture.inspect.damage import without_damaged
from ...capture.spec import build_capture
from ...core.encode import srgb_from_linear
from ...core.errors import InputError
from ...gpu.viewport import Drawing
from ..common import failures
from ..common.words import iface, n_
from ..overlay import handlers
from ..overlay.paint import Painter
from ..session.scene_capture import spec_of

T = TypeVar("T")
_PICTURE = "IRPSO Photograph"
_MAX_PIXELS = 1600  # most pixels of the shown picture's longer side
_PICTURES = 3  # photographs whose brightest values are shown
_BRIGHT = 99.0  # percentile that is shown white
_GRAB_RADIUS = 20.0  # pixels at scale 1 within which a click grabs a handle


class Marking:
    """Mixin of a modal operator that places marks on a photograph. Enter ends, Esc cancels.

    A place is (x, y) from the lower left corner, as fractions (0…1) of the picture's width and height.
    """

    help_text = ""
    _size: np.ndarray  # (2,) of the photographs, in pixels

    def confirmed(self, context) -> bool:
        """Use the marks, on Enter; return whether the operator ends."""
        raise NotImplementedError

    def handles(self) -> dict[Hashable, np.ndarray]:
        """Return handle → place (2,) of the points that a click can grab."""
        raise NotImplementedError

    def clicked(self, handle: Hashable | None, place: np.ndarray) -> Hashable | None:
        """Handle a click on a handle, None beside all; return the handle to drag with the mouse, None for none."""
        raise NotImplementedError

    def moved(self, handle: Hashable, place: np.ndarray) -> None:
        """Move a handle to a place."""
        raise NotImplementedError

    def removed(self) -> None:
        """Remove the last mark, if that is possible."""

    def drawn(self, painter: Painter) -> None:
        """Draw the marks."""
        raise NotImplementedError

    def radiances(self, settings, most: int) -> Iterator[np.ndarray]:
        """Yield the linear photographs (H, W, 3) whose brightest values are shown: of one camera, at most ``most``.

        Others are not read, unless these are damaged and the settings leave such out.
        """
        spec = spec_of(settings)
        camera = spec.observations[0].camera
        observations = tuple(
            replace(observation, camera=0) for observation in spec.observations if observation.camera == camera
        )
        whole = replace(spec, observations=observations, views=(spec.views[camera],))
        shown = replace(whole, observations=_spread(observations, most))
        if settings.skip_damaged:
            store = ImageStore(decode)
            try:
                shown = without_damaged(shown, store)
            except CaptureError:
                shown = without_damaged(whole, store)
        for observation in _spread(build_capture(shown, decode).observations, most):
            yield without_bounds(observation.read())[..., :3]

    def begin(self, context, readers: int = _PICTURES) -> set[str]:
        """Show the brightest values of some photographs and wait for the mouse."""
        failures.clear()  # those of the search that the marks replace
        try:
            picture, self._size = _make_picture(self.radiances(context.scene.irpso, readers))
        except InputError as error:
            return failures.report_and_cancel(self, error)
        before = list(context.screen.areas)
        self._area, self._former = _show_in_editor(context, picture)
        self._own_area = self._area not in before
        if self._area is None:
            _remove_picture()
            self.report({"ERROR"}, "There is no room for an Image editor in this window; make an area larger")
            return {"CANCELLED"}
        self._grabbed: Hashable | None = None
        self._drawing = Drawing()
        self._draw_handler: Any = bpy.types.SpaceImageEditor.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")
        context.window.cursor_modal_set("CROSSHAIR")
        context.workspace.status_text_set(iface(self.help_text))
        context.window_manager.modal_handler_add(self)
        handlers.redraw()
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Place, move and remove marks. Blender handles all other events."""
        with failures.reported(n_("Marking")):
            return self._on_event(context, event)
        return self._leave(context, {"CANCELLED"})

    def cancel(self, context):
        """Blender calls this when the window or the file is closed."""
        self._leave(context, {"CANCELLED"})

    def _on_event(self, context, event):
        if self._area not in list(context.screen.areas):
            return self._leave(context, {"CANCELLED"})
        if event.value == "PRESS" and event.type in {"ESC", "RIGHTMOUSE"}:
            return self._leave(context, {"CANCELLED"})
        if event.value == "PRESS" and event.type in {"RET", "NUMPAD_ENTER"}:
            return self._leave(context, {"FINISHED"}) if self.confirmed(context) else {"RUNNING_MODAL"}
        if event.value == "PRESS" and event.type == "BACK_SPACE":
            self.removed()
            return self._redraw()
        if event.type == "MOUSEMOVE" and self._grabbed is not None:
            self.moved(self._grabbed, np.clip(self._place(event), 0, 1))
            return self._redraw()
        if event.type == "LEFTMOUSE" and event.value == "RELEASE" and self._grabbed is not None:
            self._grabbed = None
            return self._redraw()
        if event.type == "LEFTMOUSE" and event.value in {"PRESS", "DOUBLE_CLICK"} and self._is_over_picture(event):
            return self._on_press(context, event)
        return {"PASS_THROUGH"}

    def _on_press(self, context, event):
        pointer = np.array([event.mouse_x - self._region.x, event.mouse_y - self._region.y], float)
        distances = {key: float(np.linalg.norm(self.pixel(place) - pointer)) for key, place in self.handles().items()}
        closest = min(distances, key=lambda key: distances[key], default=None)
        reached = closest is not None and distances[closest] <= _GRAB_RADIUS * context.preferences.system.ui_scale
        self._grabbed = self.clicked(closest if reached else None, np.clip(self._place(event), 0, 1))
        return self._redraw()

    def _redraw(self):
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

    def pixel(self, place: np.ndarray) -> np.ndarray:
        """Return the pixel (2,) of the region at a place."""
        return np.array(self._region.view2d.view_to_region(*place, clip=False), float)

    def _draw(self) -> None:
        with failures.reported(n_("Marking")):
            if bpy.context.area != self._area:
                return
            painter = Painter(self._drawing, bpy.context.preferences.system.ui_scale)
            self.drawn(painter)
            painter.flush()

    def _leave(self, context, result):
        if self._draw_handler is not None:
            bpy.types.SpaceImageEditor.draw_handler_remove(self._draw_handler, "WINDOW")
            self._draw_handler = None
            self._drawing.close()
            self._show_former(context)
            handlers.redraw()
        if context.window is not None:
            context.window.cursor_modal_restore()
            context.workspace.status_text_set(None)
            if self._own_area:  # a timer, because Blender uses the area after the operator returns
                bpy.app.timers.register(partial(_close_area, context.window, self._area))
        return result

    def _show_former(self, context) -> None:
        """Show the editor's former image again, and remove the picture: Blender would ask to save it at the end."""
        screen = context.screen
        if screen is not None and self._area in list(screen.areas) and self._area.type == "IMAGE_EDITOR":
            space = self._area.spaces.active
            if space.image is not None and space.image.name == _PICTURE:
                space.image = bpy.data.images.get(self._former)
        _remove_picture()


def _remove_picture() -> None:
    if (picture := bpy.data.images.get(_PICTURE)) is not None:
        bpy.data.images.remove(picture)


def _spread(items: tuple[T, ...], most: int) -> tuple[T, ...]:
    """Return at most so many items, evenly spaced from the first to the last."""
    return tuple(items[k] for k in evenly_spaced(len(items), most))


def _make_picture(radiances: Iterable[np.ndarray]) -> tuple[Any, np.ndarray]:
    """Make an image of the photographs' brightest values; return it and their (width, height). Raises InputError."""
    peak: np.ndarray = np.zeros(())
    size = np.zeros(2)
    for radiance in radiances:
        size = np.array(radiance.shape[1::-1], float)
        step = math.ceil(max(radiance.shape) / _MAX_PIXELS)
        peak = np.maximum(peak, np.nan_to_num(radiance[::step, ::step]))
    peak = srgb_from_linear(np.clip(peak / max(float(np.percentile(peak, _BRIGHT)), 1e-6), 0, 1))
    height, width = peak.shape[:2]
    _remove_picture()
    image = bpy.data.images.new(_PICTURE, width, height)
    image.pixels.foreach_set(np.concatenate([peak, np.ones((height, width, 1))], axis=-1).astype(np.float32).ravel())
    image.update()
    return image, size


def _close_area(window, area) -> None:
    """Close an area that was split for the picture, unless the user has closed it or shows something else in it."""
    with suppress(ReferenceError):
        shown = area in list(window.screen.areas) and area.type == "IMAGE_EDITOR"
        if shown and area.spaces.active.image is None:
            with bpy.context.temp_override(window=window, screen=window.screen, area=area):
                bpy.ops.screen.area_close()


def _show_in_editor(context, picture) -> tuple[Any, str]:
    """Show the picture in an Image editor; return it and the name of its former image, "" for none.

    Without an Image editor the largest area is split; the editor is None if that fails.
    """
    areas = list(context.screen.areas)
    area = next((area for area in areas if area.type == "IMAGE_EDITOR"), None)
    if area is None:
        largest = max(areas, key=lambda area: area.width * area.height)
        with context.temp_override(area=largest):
            bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
        area = next((area for area in context.screen.areas if area not in areas), None)
        if area is None:
            return None, ""
        area.type = "IMAGE_EDITOR"
    space = area.spaces.active
    former = "" if space.image is None else space.image.name
    space.mode, space.image = "VIEW", picture
    region = next(region for region in area.regions if region.type == "WINDOW")
    with context.temp_override(area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)
    return area, former
