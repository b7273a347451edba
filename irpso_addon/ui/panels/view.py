"""Sidebar panels of the overlay: displayed map, lights and cameras, probes."""

from __future__ import annotations

import bpy

from ...results.maps import Cause
from ..common import drawing
from ..common.words import iface, n_
from ..overlay.handlers import why_hidden
from ..session import session
from .capture import draw_observation
from .sidebar import Sidebar

# Why the shown parameter of a probed texel is unknown.
_CAUSES = {
    Cause.LATER_ROUND: n_("Unknown: a later round finds it"),
    Cause.MOSTLY_INDIRECT: n_("Unknown: light is mostly indirect"),
    Cause.NOTHING_DETERMINED: n_("Unknown: too little or unexplained light"),
    Cause.WIDE_DEVIATION: n_("Unknown: deviation is wide"),
}
# Blender's icons in the colours of the probes' marks and curves, in the order of results.preview.MARK_COLORS.
_PROBE_ICONS = ("COLLECTION_COLOR_01", "COLLECTION_COLOR_04", "COLLECTION_COLOR_05", "COLLECTION_COLOR_03")
_OF_A_MAP = ("PARAMETER", "CONFIDENCE")
_OF_A_LIGHT = ("RENDER", "REFERENCE", "SPLIT", "BLINK")
_OF_A_PHOTOGRAPH = ("REFERENCE", "SPLIT", "BLINK")
_IN_FALSE_COLORS = ("ERROR", "CONFIDENCE")


def draw_shown(layout, context, running: session.Session) -> None:
    """Draw the choice of the picture and its settings."""
    view, column = context.scene.irpso.view, layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(view, "shown")
    if view.shown in _OF_A_MAP:
        column.prop(view, "parameter")
    if view.shown == "PARAMETER":
        column.prop(view, "mark_unknown")
    if view.shown in _IN_FALSE_COLORS:
        column.prop(view, _red_of(view, running))
    if view.shown in _OF_A_LIGHT:
        capture = running.job.capture
        column.prop(view, "observation")
        index = running.observation(view)
        drawing.fact(column, context, iface("of {count}", count=capture.listed), capture.observations[index].name)
        chosen, number = view.index(capture.listed), running.job.listed_numbers[index]
        if chosen != number:
            text = iface("Photograph {chosen} is held out: {shown} is shown", chosen=chosen + 1, shown=number + 1)
            if chosen not in capture.listed_numbers:
                text = iface("Photograph {chosen} is left out: {shown} is shown", chosen=chosen + 1, shown=number + 1)
            drawing.wrapped(column, context, text, "INFO")
        column.prop(view, "exposure")
    if view.shown in _OF_A_PHOTOGRAPH:
        column.prop(view, "mark_unused")
    if view.shown == "SPLIT":
        column.prop(view, "split", slider=True)
    if view.shown == "INDIRECT" and running.recovery.indirect_share is None:
        on = running.recovery.has_rounds
        pending = iface("Known when the first round begins")
        text = pending if on else iface("Indirect light was not computed: recover with Interreflection on")
        drawing.wrapped(column, context, text, "INFO")
    if reason := why_hidden(context):
        drawing.wrapped(layout, context, reason, "HIDE_ON")


def _red_of(view, running: session.Session) -> str:
    """Return the name of the property for the value drawn red, in the legend's unit."""
    if view.shown == "ERROR":
        return "red_error"
    normal = any(p.is_normal and p.name == view.parameter for p in running.job.model.parameters)
    return "red_angle" if normal else "red_deviation"


class IRPSO_PT_view(Sidebar, bpy.types.Panel):
    """The converging maps on the subject."""

    bl_label = "View"

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there are maps to show."""
        running = session.current()
        return running is not None and running.recovery is not None

    def draw_header(self, context) -> None:
        """Draw the switch of the overlay."""
        self.layout.prop(context.scene.irpso.view, "show", text="")

    def draw(self, context) -> None:
        """Draw the choice of the picture and its opacity."""
        view = context.scene.irpso.view
        if not view.show:
            self.layout.label(text="Off: switch on in this panel's header", icon="HIDE_ON")
            return
        draw_shown(self.layout, context, session.current())
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(view, "opacity", slider=True)


class IRPSO_PT_dome(Sidebar, bpy.types.Panel):
    """The lights and cameras of the capture, around the subject."""

    bl_label = "Lights and Cameras"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is a recovery, and so a capture to draw."""
        return session.current() is not None

    def draw(self, context) -> None:
        """Draw the switches."""
        view = context.scene.irpso.view
        column = self.layout.column(heading="Show")
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(view, "show_lights")
        column.prop(view, "show_cameras")
        if view.show_lights:
            column.prop(view, "dome_radius")
        draw_observation(self.layout, context)


def draw_probes(layout, context) -> None:
    """Draw the list of probed texels with their errors, and the settings of curves and swarm."""
    view, running = context.scene.irpso.view, session.current()
    layout.operator("irpso.probe", icon="EYEDROPPER")
    column = layout.column(align=True)
    for index, probe in sorted(enumerate(running.probes), key=lambda item: item[1].number):
        row = column.row(align=True)
        error = f"   {drawing.percent(probe.curve[-1][1])}" if probe.curve else ""
        text = f"{probe.number}:  {probe.column}, {probe.row}{error}"
        row.label(text=text, icon=_PROBE_ICONS[probe.slot], translate=False)
        row.operator("irpso.probe_remove", text="", icon="X", emboss=False).index = index
        if not running.active and (cause := probe.unknown.get(view.parameter)):
            column.label(text=_CAUSES[cause], icon="BLANK1")
    if not running.probes:
        return
    column = layout.column(heading="Show")
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(view, "show_curves")
    column.prop(view, "show_swarm")
    if view.show_swarm and len(running.probes) > 1:
        column.prop(view, "probe", text="Swarm of Probe")
    if view.show_swarm:
        axes = column.column(align=True)
        for axis in ("swarm_x", "swarm_y", "swarm_z"):
            axes.prop(view, axis)
        column.prop(view, "goal")


class IRPSO_PT_probes(Sidebar, bpy.types.Panel):
    """The probed texels."""

    bl_label = "Probes"

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there are texels to probe."""
        running = session.current()
        return running is not None and running.display is not None

    def draw(self, context) -> None:
        """Draw the list."""
        draw_probes(self.layout, context)


CLASSES = (IRPSO_PT_view, IRPSO_PT_dome, IRPSO_PT_probes)
