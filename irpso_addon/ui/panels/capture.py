"""Panels of the sidebar before a recovery: capture, subject, material."""

from __future__ import annotations

import bpy

from ...capture.inspect.damage import DAMAGE
from ..common import drawing
from ..operators.capture_import import checking
from ..operators.scene_setup import capture_lights
from ..properties import findings, upkeep
from ..properties.scene_settings import CUSTOM
from ..session.job import subject_object
from ..session.scene_capture import wants_distance
from .sidebar import BeforeRun

_SEVERITIES = {"error": "CANCEL", "warning": "ERROR"}  # Blender's icon "ERROR" is the triangle of a warning
_MOST_FINDINGS = 8
_FIRST_FACTS = 3  # kind, images, and what they are enough for; the rest is in a panel of its own


class IRPSO_PT_capture(BeforeRun, bpy.types.Panel):
    """What was photographed, and what is wrong with it."""

    bl_label = "Capture"

    def draw(self, context) -> None:
        """Draw the source, what is in it, and findings."""
        layout, settings = self.layout, context.scene.irpso
        layout.row().prop(settings, "source", expand=True)
        if settings.source == "FILES":
            row = layout.row()
            row.scale_y = 1.0 if settings.capture_path else 1.5
            row.operator("irpso.import_capture", text="Import Capture…", icon="IMPORT")
            layout.operator("irpso.lights_from_ball", text="Lights from a Ball…", icon="LIGHT_SUN")
            if not settings.capture_path:
                return
            layout.prop(settings, "capture_path", text="")
            column = layout.column()
            column.use_property_split, column.use_property_decorate = True, False
            column.prop(settings, "colour_space")
        else:
            layout.operator("irpso.import_cameras", text="Import Cameras…", icon="OUTLINER_OB_CAMERA")
            layout.operator("irpso.assign_images", icon="FILE_IMAGE")
            _draw_light(layout, context)
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(settings, "light_strengths")
        column.prop(settings, "refine_directions")
        _draw_check(layout, context, settings)
        if settings.source == "FILES":
            layout.operator("irpso.create_scene", icon="OUTLINER_OB_LIGHT")
        draw_observation(layout, context)


def draw_observation(layout, context) -> None:
    """Draw the switch between the capture's lights in the scene, where there are any."""
    lights, view = capture_lights(context.scene), context.scene.irpso.view
    if not lights:
        return
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(view, "observation")
    drawing.fact(column, context, f"of {len(lights)}", lights[view.index(len(lights))].name)


def _draw_light(layout, context) -> None:
    """Draw what the active light was photographed under it with, or say where to set that."""
    obj = context.object
    if obj is None or obj.type != "LIGHT":
        drawing.wrapped(layout, context, "Select a light to give it its photograph", "INFO")
        return
    box = layout.box()
    box.label(text=obj.name, icon="LIGHT", translate=False)
    box.template_ID(obj.irpso, "image", open="image.open")
    column = box.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(obj.irpso, "camera")


def _draw_fact(layout, context, line: str) -> None:
    name, _, value = line.partition(": ")
    drawing.fact(layout, context, name[:1].upper() + name[1:], value)


def _summary(context) -> list[str]:
    """Return what is known of the capture, a fact a line; nothing where it is another one by now."""
    settings = context.scene.irpso
    return settings.summary.splitlines() if findings.is_checked(settings) or checking(context.scene) else []


def _draw_check(layout, context, settings) -> None:
    """Draw what the capture holds, what is wrong with it, and the button that looks it over."""
    doing, lines = checking(context.scene), _summary(context)
    if lines:
        column = layout.column(align=True)
        column.scale_y = 0.8
        for line in lines[:_FIRST_FACTS]:
            _draw_fact(column, context, line)
    if doing:
        layout.label(text=doing, icon="SORTTIME", translate=False)
        return
    found = findings.shown(settings)
    for item in found[:_MOST_FINDINGS]:
        row = layout.row()
        row.alert = item.severity == "error"
        drawing.wrapped(row, context, item.message, _SEVERITIES.get(item.severity, "INFO"))
    if len(found) > _MOST_FINDINGS:
        layout.label(text=f"and {len(found) - _MOST_FINDINGS} more like these", icon="BLANK1")
    if lines and not found:
        layout.label(text="Nothing Suspicious", icon="CHECKMARK")
    # The check of a scene looks at headers alone: that pixels are cut short shows when they are read.
    if settings.skip_damaged or settings.source == "SCENE" or any(item.code in DAMAGE for item in found):
        layout.prop(settings, "skip_damaged")
    layout.operator("irpso.check_capture", text="Check Again" if lines else "Check", icon="VIEWZOOM")


class IRPSO_PT_capture_facts(BeforeRun, bpy.types.Panel):
    """All that the check has found out about the capture."""

    bl_label = "Details"
    bl_parent_id = "IRPSO_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is more to say than the panel above says."""
        return super().poll(context) and len(_summary(context)) > _FIRST_FACTS

    def draw(self, context) -> None:
        """Draw the other facts."""
        column = self.layout.column(align=True)
        column.scale_y = 0.8
        for line in _summary(context)[_FIRST_FACTS:]:
            _draw_fact(column, context, line)


class IRPSO_PT_subject(BeforeRun, bpy.types.Panel):
    """What the maps are recovered of."""

    bl_label = "Subject"

    def draw(self, context) -> None:
        """Draw mesh or card."""
        layout, settings = self.layout, context.scene.irpso
        layout.row().prop(settings, "subject", expand=True)
        if settings.subject != "MESH":
            _draw_distance(layout, context.scene)
            return
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(settings, "object")
        if settings.object is None and (active := subject_object(context)) is not None:
            column.label(text=f"Active: {active.name}", icon="OBJECT_DATA", translate=False)
        chosen = subject_object(context)
        if chosen is not None and len(chosen.material_slots) > 1:
            column.prop(settings, "slots")
            if settings.slots == "ACTIVE" and (made := chosen.active_material) is not None:
                column.label(text=f"Active: {made.name}", icon="MATERIAL", translate=False)
            if settings.slots == "NAMED":
                column.prop(settings, "slot_list", text="Names")
        column.prop(settings, "resolution")
        column.prop(settings, "shadows")


def _draw_distance(layout, scene) -> None:
    """Draw how far the card lies from its camera, where anything depends on it."""
    settings = scene.irpso
    if not wants_distance(scene):
        return
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    files = settings.source == "FILES"  # whose unit is their own; what is of the scene is shown in the scene's unit
    column.prop(settings, "card_distance" if files else "card_length")
    if files and settings.stated_distance and not settings.card_distance:
        column.label(text=f"The capture says {settings.stated_distance:g}", icon="INFO", translate=False)


class IRPSO_PT_material(BeforeRun, bpy.types.Panel):
    """What is recovered."""

    bl_label = "Maps"

    def draw(self, context) -> None:
        """Draw the model, and each of its parameters with what is given where it is not recovered."""
        layout, settings = self.layout, context.scene.irpso
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(settings, "model")
        if settings.model == CUSTOM:
            column.prop(settings, "model_path", text="File")
        if upkeep.is_wanting(settings):
            upkeep.ask()
        column = layout.column(heading="Recover", align=True)
        for item in settings.parameters:
            column.prop(item, "recover", text=bpy.path.display_name(item.name), translate=False)
            if not item.recover:
                _draw_given(column, item)


def _draw_given(layout, item) -> None:
    """Draw the image that is taken for a parameter, or the value where there is none."""
    box = layout.box().column(align=True)
    if item.image is None and item.is_normal:
        box.label(text="Taken as flat, or from an image:")
    elif item.image is None:
        box.prop(item, "color" if item.components == 3 else "value", text="")
    box.template_ID(item, "image", open="image.open")


CLASSES = (IRPSO_PT_capture, IRPSO_PT_capture_facts, IRPSO_PT_subject, IRPSO_PT_material)
