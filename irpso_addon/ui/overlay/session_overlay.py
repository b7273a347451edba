"""The overlay of one session: ``update`` prepares it in a window's GPU context, draw callbacks show it."""

from __future__ import annotations

import logging
import time
from dataclasses import replace

import bpy
import numpy as np

from ...capture.camera import Camera
from ...core.errors import InputError
from ...gpu import context_guard
from ...gpu.viewport import Drawing, Surface
from ...solver.engine.progress import Progress
from ...solver.views.display import Shown
from ...solver.views.texel_probe import TexelProbe
from ...solver.views.tiled_view import TiledTexelProbe, texel_probe_of
from ..common.words import iface
from ..properties import preferences
from ..session.probes import Probe
from ..session.recovery import Session
from ..session.scene_job import image_map
from . import curves, dome, flat, legend, surface, swarm
from .layout import Rectangle, beside, free_rectangle, stacked_around
from .paint import SMALL, Painter
from .place import Placement, to_pixels, transformed

_log = logging.getLogger(__name__)

_MARGIN, _GAP = 14.0, 10.0  # pixels at scale 1
_MIN_FREE = (300.0, 230.0)  # least free width and height of a region with panels, in pixels at scale 1
_PICTURE_SECONDS = 0.012  # time per redraw for the measurement of errors
_STRIPE_SPACING = 9.0  # distance between stripes, in pixels at scale 1
_SPLIT_LINE = (1.0, 1.0, 1.0, 0.85)


class SessionOverlay:
    """The pictures, curves and trails of a session; ``close`` frees their GPU memory.

    Frame buffers belong to the context in which they were made, and draw callbacks run in another context than
    operators. So ``update``, called outside of them, renders pictures and reads probes; callbacks only draw.
    """

    def __init__(self, running: Session, home_scene: int):
        self.running, self.home_scene = running, home_scene
        self.drawing = Drawing()
        self._recovery: object = None  # that of surface, pictures and reader
        self._surface: Surface | None = None
        self._corners: np.ndarray | None = None
        self._reader: TexelProbe | TiledTexelProbe | None = None
        self._pictures: dict[int, tuple[tuple[Shown, ...], list]] = {}  # by the scene's session_uid
        self._limits: dict[int, float] = {}  # last error drawn red, by the scene's session_uid
        self._trails: dict[int, swarm.Trail] = {}  # by the probe's slot
        self._truths: dict[tuple[int, str], np.ndarray | None] = {}  # by image and parameter
        self._updated = 0.0
        self._probes_read_at: Progress | None = None

    def is_due(self) -> bool:
        """Return whether new pictures are due, by the preferences' display rate."""
        if context_guard.active() is None:
            return False
        waits = time.perf_counter() - self._updated < preferences.picture_seconds(bpy.context)
        return not waits or self._recovery is not self.running.recovery

    def update(self) -> bool:
        """Update pictures, curves and trails; return whether anything has changed."""
        self._updated = time.perf_counter()
        running = self.running
        if running.recovery is None or running.display is None:
            return False
        if self._recovery is not running.recovery:
            self._begin()
        changed = self._read_probes() | any([self._draw_pictures(scene) for scene in self._scenes()])
        return self._judge_probes() or changed

    def wants_redraw(self) -> bool:
        """Return whether the overlay is animated, as in Blink."""
        return any(scene.irpso.view.show and scene.irpso.view.shown == "BLINK" for scene in self._scenes())

    def draw_view(self, context) -> None:
        """Draw in a viewport's 3D space: the map on the subject, lights, cameras, rings around probes."""
        running, subject = self.running, self.running.subject()
        if not self._draws_in(context):
            return
        view, region = context.scene.irpso.view, context.region
        placement, perspective = self._placement(subject), np.array(context.region_data.perspective_matrix)
        size, scale = (region.width, region.height), context.preferences.system.ui_scale
        if view.show:
            self._draw_surface(context, view, placement, perspective)
            curves.draw_rings(self.drawing, running, placement, perspective, size, scale)
        if view.show_lights:
            lights = self._dome(view, placement)
            over = dome.over_subject(lights.places, transformed(placement.frame, self._corners), perspective, size)
            dome.draw_lights(self.drawing, lights, self._observation(view), over, perspective, scale)
        if view.show_cameras:
            current = running.job.capture.observations[self._observation(view)].camera
            dome.draw_cameras(self.drawing, self._cameras(), current, placement, perspective, scale)

    def draw_pixels(self, context) -> None:
        """Draw over a viewport: legend, curves, swarm, names."""
        subject = self.running.subject()
        if not self._draws_in(context):
            return
        view, region = context.scene.irpso.view, context.region
        painter = Painter(self.drawing, context.preferences.system.ui_scale)
        size, perspective = (region.width, region.height), np.array(context.region_data.perspective_matrix)
        if view.show:
            curves.name_rings(painter, self.running, self._placement(subject), perspective, size)
            self._draw_split_line(painter, context, Rectangle(0, 0, *size))
        free = _free_area(context.area, region).inset(*(_MARGIN * painter.scale,) * 4)
        occupied: list[Rectangle] = []
        # In a quad view only the user's own view has panels.
        if context.region_data == context.space_data.region_3d and _has_room(free, painter.scale):
            corner = self._draw_legend(painter, context.scene, free) if view.show else None
            occupied = [*self._draw_panels(painter, view, free, corner), *([corner] if corner else [])]
        if view.show_lights:
            self._name_light(painter, view, subject, perspective, size, free, occupied)
        painter.flush()

    def draw_image(self, context) -> None:
        """Draw over an Image editor: the map flat, rings, legend."""
        running, space, region = self.running, context.space_data, context.region
        view = context.scene.irpso.view
        visible = running.domain is not None and view.show and not flat.why_covered(space)
        if not visible or not surface.is_in_scene(context.scene, running, running.subject(), self.home_scene):
            return
        shown, pictures = self._pictures_of(context.scene)
        if not pictures:
            return
        painter = Painter(self.drawing, context.preferences.system.ui_scale)
        areas = flat.map_areas(region, space, running.domain.shape, running.tiles)
        first, second = _pair(view, pictures)
        stripes = _stripes(view, painter.scale)
        for index, area in enumerate(areas):
            part = index / len(areas), (index + 1) / len(areas)
            size = area.width, area.height
            self.drawing.draw_flat(first, (area.x, area.y), size, second, view.split, view.opacity, part, stripes)
        curves.draw_flat_rings(painter, areas, running)
        self._draw_split_line(painter, context, flat.bounds(areas))
        free = _free_area(context.area, region).inset(*(_MARGIN * painter.scale,) * 4)
        if _has_room(free, painter.scale):
            corner = self._draw_legend(painter, context.scene, free)
            if all(other.type != "VIEW_3D" for other in context.screen.areas):  # else a viewport has the panels
                self._draw_panels(painter, view, free, corner)
        painter.flush()

    def close(self) -> None:
        """Free the GPU memory."""
        self._release()
        self.drawing.close()

    def why_hidden(self, context) -> str:
        """Return a sentence on why the context's editor has no overlay, "" if it has one."""
        if context.space_data.type == "IMAGE_EDITOR":
            return flat.why_covered(context.space_data)
        reason = surface.why_unseen(context, self.running, self.running.subject(), self.home_scene)
        if not reason and surface.shows_itself(context, self.running):  # the overlay would cover it
            reason = iface("This viewport renders the material that was kept: choose Solid shading to see this map")
        return reason

    def _draws_in(self, context) -> bool:
        return self.running.domain is not None and not self.why_hidden(context)

    def _begin(self) -> None:
        self._release()
        self._recovery = self.running.recovery
        self._surface = surface.make_surface(self.running)
        self._reader = texel_probe_of(self.running.recovery)

    def _release(self) -> None:
        for resource in (self._surface, self._reader):
            if resource is not None:
                resource.close()
        self._surface = self._reader = None
        self._pictures.clear()
        self._trails.clear()

    def _scenes(self) -> list[bpy.types.Scene]:
        """Return the scenes with the subject that are open in a window."""
        subject = self.running.subject()
        shown = {window.scene.session_uid: window.scene for window in bpy.context.window_manager.windows}
        return [s for s in shown.values() if surface.is_in_scene(s, self.running, subject, self.home_scene)]

    def _draw_pictures(self, scene: bpy.types.Scene) -> bool:
        view, uid, running = scene.irpso.view, scene.session_uid, self.running
        if not view.show:
            return False
        shown = surface.wanted(view, running, self._limits.get(uid, 0.0))
        if shown[0].kind == "error":
            self._limits[uid] = shown[0].limit
        former = self._pictures.get(uid, ((), []))[0]
        if shown == former and not any(running.display.pending(item) for item in shown):
            return False
        self._pictures[uid] = shown, [running.display.picture(item, _PICTURE_SECONDS) for item in shown]
        return True

    def _read_probes(self) -> bool:
        """Read the probed texels, at most once for each iteration."""
        running, progress = self.running, self.running.progress
        if not running.probes:
            return False
        watched = [
            running.probes.numbered(scene.irpso.view.probe) for scene in self._scenes() if scene.irpso.view.show_swarm
        ]
        unread = any(not probe.curve for probe in running.probes) or any(p.slot not in self._trails for p in watched)
        if progress == self._probes_read_at and not unread:
            return False
        self._probes_read_at = progress
        for probe in running.probes:
            state = self._reader.read(probe.row, probe.column)
            if state is None:
                continue
            iteration = progress.iteration_in_all
            if np.isfinite(state.error) and (not probe.curve or probe.curve[-1][0] < iteration):
                probe.curve.append((iteration, state.error))
            if probe in watched:
                self._trails.setdefault(probe.slot, swarm.Trail()).update(state.particles, (probe.row, probe.column))
        return True

    def _judge_probes(self) -> bool:
        """Read why the probed texels of a paused recovery are unknown, once its deviations are measured."""
        running, changed = self.running, False
        for probe in [] if running.active else running.probes:
            if probe.judged != running.progress:
                found = running.display.unknown_at(probe.row, probe.column)
                probe.unknown, probe.judged = found or {}, None if found is None else running.progress
                changed |= found is not None
        return changed

    def _placement(self, subject) -> Placement:
        if self._corners is None:
            self._corners = surface.bounding_corners(self.running)
        return surface.placement(self.running, subject, self._corners)

    def _dome(self, view, placement: Placement) -> dome.Dome:
        domain = self.running.domain
        return dome.dome_of(domain.lights, domain.intensities, placement, view.dome_radius)

    def _observation(self, view) -> int:
        return self.running.observation(view)

    def _cameras(self) -> list[Camera]:
        """Return the cameras in the domain's frame. A card's frame is that of its only camera."""
        cameras = self.running.job.capture.cameras
        if self.running.mesh is not None:
            return list(cameras)
        return [replace(camera, matrix=np.eye(4)) for camera in cameras]

    def _pictures_of(self, scene: bpy.types.Scene) -> tuple[tuple[Shown, ...], list]:
        return self._pictures.get(scene.session_uid, ((), []))

    def _draw_surface(self, context, view, placement: Placement, perspective: np.ndarray) -> None:
        _, pictures = self._pictures_of(context.scene)
        if not pictures or self._surface is None:
            return
        first, second = _pair(view, pictures)
        size = (context.region.width, context.region.height)
        stripes = _stripes(view, context.preferences.system.ui_scale)
        self._surface.draw(first, perspective, placement.frame, second, view.split, size, view.opacity, stripes=stripes)

    def _draw_split_line(self, painter: Painter, context, area: Rectangle) -> None:
        view = context.scene.irpso.view
        if view.shown != "SPLIT" or len(self._pictures_of(context.scene)[1]) != 2:
            return
        x = round(view.split * context.region.width) + 0.5
        if not area.x <= x <= area.right:
            return
        painter.line((x, area.y), (x, area.top), _SPLIT_LINE, 1.2)
        gap, y = 8 * painter.scale, max(area.y, 0) + 24 * painter.scale
        painter.chip(iface("Render"), x - gap, y, "right")
        painter.chip(iface("Photograph"), x + gap, y)

    def _draw_legend(self, painter: Painter, scene: bpy.types.Scene, free: Rectangle) -> Rectangle | None:
        """Draw the legend or caption in the lower right corner; return its rectangle."""
        shown, _ = self._pictures_of(scene)
        if not shown:
            return None
        job = self.running.job
        item = shown[surface.blink_index() if scene.irpso.view.shown == "BLINK" else 0]
        color_scale = legend.scale_of(item, job.model)
        if color_scale is not None:
            widest = max(painter.width(color_scale.title), painter.width(color_scale.unit, SMALL))
            area = free.corner(*legend.legend_size(painter.scale, free, widest))
            legend.draw_legend(painter, area, color_scale)
            return area
        if len(shown) == 2 and scene.irpso.view.shown != "BLINK":  # the split line has its own labels
            return None
        names = [one.name for one in job.capture.observations]
        text = legend.caption(item, names, job.listed_numbers)
        area = free.corner(*painter.chip_size(text))
        painter.chip(text, area.x, area.y)
        return area

    def _draw_panels(self, painter: Painter, view, free: Rectangle, corner: Rectangle | None) -> list[Rectangle]:
        """Draw curves and swarm beside the box in the lower right corner; return their rectangles."""
        running = self.running
        with_curves = view.show_curves and bool(running.history or running.probes)
        with_swarm = view.show_swarm and bool(running.probes)
        chosen = running.probes.numbered(view.probe) if with_swarm else None
        trail = self._trails.get(chosen.slot if chosen else -1, swarm.Trail())
        sizes = [curves.curves_size(painter.scale, free)] if with_curves else []
        sizes += [swarm.swarm_size(painter.scale, trail)] if chosen else []
        places = stacked_around(corner, free, sizes, _GAP * painter.scale)
        if with_curves and places[0] is not None:
            curves.draw_curves(painter, places[0], running)
        if chosen is not None and places[-1] is not None:
            axes = self._axes(view, trail)
            goal = self._goal(view, axes, chosen)
            at = {"number": chosen.number, "column": chosen.column, "row": chosen.row}
            title = iface("Swarm of probe {number}: {column}, {row}", **at)
            color = curves.color_of(chosen)
            swarm.draw_swarm(painter, places[-1], title, color, trail, axes, running.seconds, goal)
        return [place for place in places if place is not None]

    def _axes(self, view, trail: swarm.Trail) -> list[swarm.Axis]:
        names = trail.particles.names if trail.particles is not None else ()
        return swarm.choose_axes(names, (view.swarm_x, view.swarm_y, view.swarm_z), self.running.job.model)

    def _goal(self, view, axes: list[swarm.Axis], probe: Probe) -> np.ndarray | None:
        """Return the place in the swarm's box of the probed texel's true value, None without an image of the truth."""
        parameters = {parameter.name: parameter for parameter in self.running.job.model.parameters}
        parameter = parameters.get(axes[0].name.partition(".")[0]) if axes else None
        if view.goal is None or parameter is None:
            return None
        key = view.goal.session_uid, parameter.name
        if key not in self._truths:
            try:
                shape, model = self.running.domain.shape, self.running.job.model
                self._truths[key] = image_map(view.goal, model, parameter.name, shape, self.running.tiles)
            except InputError as error:
                _log.warning("no goal is drawn: %s", error)
                self._truths[key] = None
        truth = self._truths[key]
        return None if truth is None else swarm.goal_place(axes, parameter, truth[probe.row, probe.column])

    def _name_light(
        self, painter: Painter, view, subject, perspective: np.ndarray, size: tuple[float, float], free: Rectangle,
        occupied: list[Rectangle],
    ) -> None:  # fmt: skip
        """Write the current observation's number and name beside its light, if there is space."""
        index = self._observation(view)
        place = self._dome(view, self._placement(subject)).places[index][None]
        (pixel,), (in_front,) = to_pixels(perspective, place, size)
        job = self.running.job
        text = f"{job.listed_numbers[index] + 1}  {job.capture.observations[index].name}"
        area = beside(pixel, painter.chip_size(text), 12 * painter.scale, free, occupied)
        if in_front and area is not None:
            painter.chip(text, area.x, area.y)


def _pair(view, pictures: list) -> tuple:
    """Return the picture to draw now and None, or the two pictures of a split."""
    if view.shown == "BLINK" and len(pictures) == 2:
        return pictures[surface.blink_index()], None
    return pictures[0], pictures[1] if len(pictures) == 2 else None


def _stripes(view, scale: float) -> float:
    """Return the distance in pixels between stripes over unknown values or samples without weight, 0 for none."""
    return _STRIPE_SPACING * scale if view.mark_unused or view.shown == "PARAMETER" else 0.0


def _has_room(free: Rectangle, scale: float) -> bool:
    return free.width >= _MIN_FREE[0] * scale and free.height >= _MIN_FREE[1] * scale


def _free_area(area, region) -> Rectangle:
    """Return the part of a region that the area's other regions do not cover, in the region's pixels."""
    window = Rectangle(region.x, region.y, region.width, region.height)
    others = [r for r in area.regions if r.type != "WINDOW" and r.width > 1 and r.height > 1]
    sides = [(r.alignment, Rectangle(r.x, r.y, r.width, r.height)) for r in others if r.type != "HUD"]
    # The last operator's panel (HUD) floats over the lower left corner.
    sides += [("BOTTOM", Rectangle(r.x, r.y, r.width, r.height)) for r in others if r.type == "HUD"]
    return free_rectangle(window, sides)
