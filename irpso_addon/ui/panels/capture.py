"""Sidebar panels before a recovery: capture, subject, maps."""

from __future__ import annotations

import bpy

from ...capture.inspect.damage import DAMAGE
from ...core.errors import InputError
from ..common import drawing, failures
from ..common.words import iface, n_
from ..operators.capture_import import checking
from ..operators.scene_setup import numbered_lights, of_number
from ..properties import findings, upkeep
from ..properties.model_items import CUSTOM
from ..session.scene_capture import has_capture, wants_distance
from .mesh import draw_mesh
from .sidebar import BeforeRun

_CORNERS = (n_("Upper Left"), n_("Upper Right"), n_("Lower Right"), n_("Lower Left"))
_FACTS = {  # name of a fact of the check → label in the panel
    "kind": n_("Kind"), "images": n_("Images"), "cameras": n_("Cameras"), "enough for": n_("Enough For"),
    "formats": n_("Formats"), "lights": n_("Lights"), "encoding": n_("Encoding"), "noise": n_("Noise"),
    "brightness": n_("Brightness"), "colours": n_("Colors"), "used": n_("Used"), "card": n_("Card"),
}  # fmt: skip
_SEVERITIES = {"error": "CANCEL", "warning": "ERROR"}  # Blender's icon "ERROR" is the triangle of a warning
_MAX_ERRORS, _MAX_FINDINGS = 8, 1  # in the panel Capture; more warnings would push Recover out of view
_FIRST_STEP = n_(
    "Photographs with a ball in them: Find Lights. With a list of their lights: Import Capture. Without any: Open"
    " Sample"
)
_FIRST_FACTS = ("images", "cameras", "enough for")  # the panel Details has the rest


class IRPSO_PT_capture(BeforeRun, bpy.types.Panel):
    """The capture and its faults."""

    bl_label = "Capture"

    def draw(self, context) -> None:
        """Draw the source, the facts and the findings."""
        layout, settings = self.layout, context.scene.irpso
        layout.row().prop(settings, "source", expand=True)
        if settings.source == "FILES":
            row = layout.row()
            row.scale_y = 1.0 if settings.capture_path else 1.5
            row.operator("irpso.import_capture", text="Import Capture…", icon="IMPORT")
            row = layout.row(align=True)
            finds = "irpso.find_lights" if settings.capture_path else "irpso.choose_photographs"
            row.operator(finds, text="Find Lights…", icon="LIGHT_SUN")
            row.operator("irpso.mark_balls", text="", icon="MESH_CIRCLE")
            row.menu("IRPSO_MT_photographs", text="", icon="DOWNARROW_HLT")
            if not settings.capture_path:
                layout.operator("irpso.open_sample", text="Open Sample…", icon="OUTLINER_OB_IMAGE")
                drawing.wrapped(layout, context, iface(_FIRST_STEP), "INFO")
                return
            row = layout.row(align=True)
            row.prop(settings, "capture_path", text="")
            _draw_check_again(row, context)
        else:
            layout.operator("irpso.import_cameras", text="Import Cameras…", icon="OUTLINER_OB_CAMERA")
            layout.operator("irpso.assign_images", text="Assign Images to Lights…", icon="FILE_IMAGE")
            _draw_light(layout, context)
        _draw_check(layout, context, settings)
        if settings.source == "SCENE":
            _draw_check_again(layout, context)
        else:
            layout.operator("irpso.create_scene", icon="OUTLINER_OB_LIGHT")
        draw_observation(layout, context)


def draw_observation(layout, context) -> None:
    """Draw the choice of the observation, if the capture has lights in the scene."""
    lights, view = numbered_lights(context.scene), context.scene.irpso.view
    if not lights:
        return
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(view, "observation")
    shown = of_number(lights, view.observation)
    drawing.fact(column, context, iface("of {count}", count=max(lights) + 1), shown.name)


def _draw_light(layout, context) -> None:
    """Draw the active light's photograph and camera, or a hint to select a light."""
    obj = context.object
    if obj is None or obj.type != "LIGHT":
        drawing.wrapped(layout, context, iface("Select a light to choose its photograph"), "INFO")
        return
    box = layout.box()
    box.label(text=obj.name, icon="LIGHT", translate=False)
    box.template_ID(obj.irpso, "image", open="image.open")
    column = box.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(obj.irpso, "camera")


def _draw_fact(layout, context, line: str) -> None:
    name, _, value = line.partition(": ")
    drawing.fact(layout, context, _FACTS.get(name, name[:1].upper() + name[1:]), value)


def _is_first(line: str) -> bool:
    return line.partition(": ")[0] in _FIRST_FACTS


def _summary(context) -> list[str]:
    """Return the facts about the capture, one per line; [] if they belong to another capture."""
    settings = context.scene.irpso
    return settings.summary.splitlines() if findings.is_checked(settings) or checking(context.scene) else []


def _draw_check(layout, context, settings) -> None:
    """Draw the capture's first facts, its findings and the button of the check."""
    doing, lines = checking(context.scene), _summary(context)
    if lines:
        column = layout.column(align=True)
        column.scale_y = 0.8
        for line in filter(_is_first, lines):
            _draw_fact(column, context, line)
    if doing:
        layout.label(text=iface(doing), icon="SORTTIME", translate=False)
        return
    first, others = _first_findings(settings)
    _draw_findings(layout, context, first)
    if others:
        layout.label(text=iface("and {count} more, in Details", count=len(others)), icon="BLANK1")
    if lines and not first:
        layout.label(text="No Problems Found", icon="CHECKMARK")
    # The check of a scene reads headers only, so it does not see damaged pixels.
    damaged = any(item.code in DAMAGE for item in first + others)
    if settings.skip_damaged or settings.source == "SCENE" or damaged:
        layout.prop(settings, "skip_damaged")


def _first_findings(settings) -> tuple[list, list]:
    """Return the findings for the panel Capture (errors, else the first warning) and those for Details."""
    faults = findings.shown(settings)
    errors = sum(item.severity == "error" for item in faults)
    count = min(errors, _MAX_ERRORS) or _MAX_FINDINGS
    return faults[:count], faults[count:]


def _draw_findings(layout, context, faults: list) -> None:
    for item in faults:
        row = layout.row()
        row.alert = item.severity == "error"
        drawing.wrapped(
            row, context, failures.message_of(InputError(item.message)), _SEVERITIES.get(item.severity, "INFO")
        )


def _draw_check_again(layout, context) -> None:
    """Draw the button of the check: an icon beside the files, with words below a scene's capture."""
    if context.scene.irpso.source == "FILES":
        layout.operator("irpso.check_capture", text="", icon="FILE_REFRESH")
    elif not checking(context.scene):
        layout.operator("irpso.check_capture", text="Check Again" if _summary(context) else "Check", icon="VIEWZOOM")


class IRPSO_PT_capture_facts(BeforeRun, bpy.types.Panel):
    """The other findings and facts about the capture."""

    bl_label = "Details"
    bl_parent_id = "IRPSO_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is more than the panel Capture shows."""
        more = not all(map(_is_first, _summary(context))) or _first_findings(context.scene.irpso)[1]
        return super().poll(context) and bool(more)

    def draw(self, context) -> None:
        """Draw the findings and facts."""
        _draw_findings(self.layout, context, _first_findings(context.scene.irpso)[1])
        column = self.layout.column(align=True)
        column.scale_y = 0.8
        for line in _summary(context):
            if not _is_first(line):
                _draw_fact(column, context, line)


class _OfCapture(BeforeRun):
    """Base of panels with settings of a capture, hidden before the first one is chosen."""

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is a capture, and no recovery."""
        return super().poll(context) and has_capture(context.scene.irpso)


class IRPSO_PT_capture_reading(_OfCapture, bpy.types.Panel):
    """The photographs' color space, and what is estimated of their lights."""

    bl_label = "Colors and Lights"
    bl_parent_id = "IRPSO_PT_capture"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context) -> None:
        """Draw the settings, which seldom need a change."""
        settings, column = context.scene.irpso, self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        if settings.source == "FILES":
            column.prop(settings, "colour_space")
        column.prop(settings, "light_strengths")
        column.prop(settings, "refine_directions")


class IRPSO_PT_subject(_OfCapture, bpy.types.Panel):
    """The subject: a mesh or a flat card."""

    bl_label = "Subject"

    def draw(self, context) -> None:
        """Draw the settings of the mesh or the card."""
        layout, settings = self.layout, context.scene.irpso
        row = layout.row(align=True)
        row.prop(settings, "subject", expand=True)
        if settings.subject != "MESH" and settings.source == "FILES":
            whole = settings.framing == "FILE" and settings.picture_scale == 1
            row.popover(IRPSO_PT_frame.__name__, text="", icon="FULLSCREEN_ENTER" if whole else "FULLSCREEN_EXIT")
        if settings.subject != "MESH":
            _draw_distance(layout, context.scene)
            return
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        draw_mesh(column, context)
        column.prop(settings, "resolution")
        column.prop(settings, "shadows")


class IRPSO_PT_frame(bpy.types.Panel):
    """The part of the photographs that is recovered, and its size."""

    bl_label = "Frame"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"INSTANCED"}

    def draw(self, context) -> None:
        """Draw the settings. The subject's panel opens this panel as a popover."""
        settings = context.scene.irpso
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(settings, "framing")
        column.operator("irpso.find_corners", icon="VIEWZOOM")
        column.operator("irpso.mark_card", icon="EYEDROPPER")
        if settings.framing == "CROP":
            column.prop(settings, "crop")
        elif settings.framing == "CORNERS":
            _draw_corners(column, settings)
        column.prop(settings, "picture_scale")


def _draw_distance(layout, scene) -> None:
    """Draw the distance from camera to card, if the result depends on it."""
    settings = scene.irpso
    if not wants_distance(scene):
        return
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    files = settings.source == "FILES"  # files have a unit of their own; a scene's distance uses the scene's unit
    if files and not settings.card_distance:
        column.prop(settings, "card_width")
    if not settings.card_width:
        column.prop(settings, "card_distance" if files else "card_length")
    if files and settings.stated_distance and not settings.card_distance:
        column.label(
            text=iface("The capture says {distance:g}", distance=settings.stated_distance), icon="INFO", translate=False
        )


def _draw_corners(layout, settings) -> None:
    """Draw X and Y of each corner in a row."""
    for number, name in enumerate(_CORNERS):
        split = layout.split(factor=0.4)
        side = split.row()
        side.alignment = "RIGHT"
        side.label(text=name)
        row = split.row(align=True)
        row.use_property_split = False
        for index in (2 * number, 2 * number + 1):
            row.prop(settings, "corners", index=index, text="")


class IRPSO_PT_material(_OfCapture, bpy.types.Panel):
    """The model and its maps."""

    bl_label = "Maps"

    def draw(self, context) -> None:
        """Draw the model and its parameters, those not recovered with their fixed value or image."""
        layout, settings = self.layout, context.scene.irpso
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(settings, "model")
        if settings.model == CUSTOM:
            column.prop(settings, "model_path", text="File")
        if upkeep.lacks_parameters(settings):
            upkeep.ask()
        column = layout.column(heading="Recover")
        column.use_property_split, column.use_property_decorate = True, False
        for item in settings.parameters:
            column.prop(item, "recover", text=bpy.path.display_name(item.name))
            if not item.recover:
                _draw_fixed(column, item)


def _draw_fixed(layout, item) -> None:
    """Draw a fixed parameter's image, and its value if it has no image."""
    box = layout.box().column(align=True)
    box.use_property_split = False
    if item.image is None and item.is_normal:
        box.label(text="Flat, or from an image:")
    elif item.image is None:
        box.prop(item, "color" if item.components == 3 else "value", text="")
    box.template_ID(item, "image", open="image.open")


CLASSES = (
    IRPSO_PT_frame, IRPSO_PT_capture, IRPSO_PT_capture_facts, IRPSO_PT_capture_reading, IRPSO_PT_subject,
    IRPSO_PT_material,
)  # fmt: skip
