"""The panels of the 3D viewport's sidebar, in the order in which an artist works."""

from __future__ import annotations

import bpy

from ...capture.inspect.damage import DAMAGE
from ...solver.settings.schedule import GROUPS
from ..common import drawing, failures
from ..operators.capture_import import checking
from ..operators.presets import label_of
from ..operators.restore import draw_unkept
from ..operators.scene_setup import capture_lights
from ..properties import findings, upkeep
from ..properties.scene_settings import CUSTOM
from ..session import session
from ..session.job import missing, subject_object
from ..session.keep import is_standard_view
from ..session.scene_capture import wants_distance

_SEVERITIES = {"error": "CANCEL", "warning": "ERROR"}  # Blender's icon "ERROR" is the triangle of a warning
_MOST_FINDINGS = 8
_FIRST_FACTS = 3  # kind, images, and what they are enough for; the rest is in a panel of its own


class Sidebar:
    """The tab that the panels are in."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "IRPSO"


class Failures:
    """What has failed where no operator could report it, above all else."""

    bl_label = "Failed"
    bl_options = {"HIDE_HEADER"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is anything to tell."""
        return bool(failures.said())

    def draw(self, context) -> None:
        """Draw it, and the button that takes it away."""
        failures.draw(self.layout, context)


class IRPSO_PT_failures(Failures, Sidebar, bpy.types.Panel):
    """What has failed."""


class _BeforeRun(Sidebar):
    """A panel of settings that a recovery does not heed once it has begun: it makes room for what there is to see."""

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is no recovery."""
        return session.current() is None


class IRPSO_PT_capture(_BeforeRun, bpy.types.Panel):
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


class IRPSO_PT_capture_facts(_BeforeRun, bpy.types.Panel):
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


class IRPSO_PT_subject(_BeforeRun, bpy.types.Panel):
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


class IRPSO_PT_material(_BeforeRun, bpy.types.Panel):
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


class IRPSO_PT_recover(Sidebar, bpy.types.Panel):
    """The button, and how far it is."""

    bl_label = "Recover"

    def draw(self, context) -> None:
        """Draw what can be done now."""
        running = session.current()
        if running is None:
            draw_unkept(self.layout, context)
            _draw_start(self.layout, context, "Recover")
        elif running.state == "done":
            draw_result(self.layout, context, running)
            self.layout.separator()
            _draw_start(self.layout, context, "Recover Again")
        else:
            draw_progress(self.layout, context, running)


def draw_presets(layout, settings) -> None:
    """Draw the menu of presets with its + and −; shipped ones have no −."""
    row = layout.row(align=True)
    row.menu("IRPSO_MT_presets", text=label_of(settings.schedule), translate=False)
    row.operator("irpso.preset_add", text="", icon="ADD")
    if settings.schedule.own:
        row.operator("irpso.preset_add", text="", icon="REMOVE").remove_active = True


def _draw_start(layout, context, text: str) -> None:
    draw_presets(layout, context.scene.irpso)
    row = layout.row()
    row.scale_y = 2
    row.operator("irpso.recover", text=text, icon="PLAY")
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(context.scene.irpso, "hold_out")  # below the button, which a row above would push out of sight
    if wanting := missing(context):
        drawing.wrapped(layout, context, wanting, "INFO")


def draw_progress(layout, context, running: session.Session) -> None:
    """Draw what is done, how far it is, how well, how fast, how long still; and the buttons."""
    layout.label(text=running.job.name, icon="TEXTURE", translate=False)
    progress = running.progress
    title = running.title.replace("_", " ").replace(" + ", ", ")
    text = f"Paused at {running.fraction:.0%}" if running.state == "paused" else f"{running.fraction:.0%}"
    layout.progress(factor=running.fraction, type="BAR", text=text, translate=False)
    column = layout.column(align=True)
    column.scale_y = 0.9
    drawing.fact(column, context, "Now", title[:1].upper() + title[1:], lines=2)  # buttons must not jump
    if progress is not None:
        drawing.fact(column, context, "Iteration", f"{progress.iteration_in_all} / {progress.iterations_in_all}")
        drawing.fact(column, context, "Error", "–" if running.error is None else drawing.percent(running.error))
        drawing.fact(column, context, "Evaluations", drawing.rate(running.rate))
        left = running.seconds_left
        drawing.fact(column, context, "Time Left", "–" if left is None else drawing.clock(left))
    if running.state == "paused":
        draw_presets(layout, context.scene.irpso)
    row = layout.row()
    row.scale_y = 1.5
    if running.state == "paused":
        row.operator("irpso.resume", icon="PLAY")
    elif running.state == "running":
        row.operator("irpso.pause", icon="PAUSE")
    row = layout.row(align=True)
    if running.recovery is not None:
        row.operator("irpso.stop", text="Stop and Keep", icon="CHECKMARK")
    row.operator("irpso.cancel", text="Cancel", icon="X")
    if running.recovery is not None and running.state == "paused":
        _draw_displacement(layout, context)
        layout.operator("irpso.export", text="Export…", icon="EXPORT")


def draw_result(layout, context, running: session.Session) -> None:
    """Draw what has been found, and what can be done with it."""
    kept, stopped = running.kept, running.stopped
    column = layout.column(align=True)
    state = ["Stopped Early"] * stopped + ["Kept"] * kept or ["Done"]
    column.label(text=f"{running.job.name}: {', '.join(state)}", icon="PAUSE" if stopped else "CHECKMARK",
                 translate=False)  # fmt: skip
    if stopped:
        progress = running.progress
        drawing.fact(column, context, "Iteration", f"{progress.iteration_in_all} / {progress.iterations_in_all}")
    if running.error is not None:
        drawing.fact(column, context, "Error", drawing.percent(running.error))
    drawing.fact(column, context, "Search Time", drawing.clock(running.seconds))
    if running.unseen:
        drawing.wrapped(layout, context, running.unseen, "HIDE_ON")
    if running.lights is not None:
        drawing.fact(column, context, "Lights", running.lights.summary())
        for text in running.lights.warnings(running.job.lights.intensities != "auto"):
            drawing.wrapped(layout, context, text[:1].upper() + text[1:], "ERROR")
    for text in running.job.notes():
        drawing.wrapped(layout, context, text, "ERROR")
    if stopped:
        layout.operator("irpso.resume", icon="PLAY")
    row = layout.row()
    row.scale_y = 1.0 if kept else 2.0
    row.operator("irpso.keep", text="Keep Again" if kept else "Keep", icon="MATERIAL")
    _draw_displacement(layout, context)
    row = layout.row(align=True)
    row.operator("irpso.export", text="Export…", icon="EXPORT")
    row.operator("irpso.cancel", text="Close" if kept else "Discard", icon="X")
    if kept and not is_standard_view(context.scene):
        drawing.wrapped(
            layout, context, "The scene's view transform changes colors; to compare with photographs:", "INFO"
        )
        layout.operator("irpso.standard_view", icon="COLOR")


def _draw_displacement(layout, context) -> None:
    """Draw what Keep adds to the material."""
    column = layout.column(heading="Keep With")
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(context.scene.irpso, "displacement")


class IRPSO_PT_search(Sidebar, bpy.types.Panel):
    """All settings of the search."""

    bl_label = "Search Settings"
    bl_parent_id = "IRPSO_PT_recover"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether settings are heeded now: before and after a run, and while it is paused."""
        running = session.current()
        return running is None or running.state in ("paused", "done")

    def draw(self, context) -> None:
        """Draw the seed, which one that is paused keeps; the rest is in panels of its own."""
        running = session.current()
        if running is not None and running.state == "paused":
            return
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(context.scene.irpso, "seed")


def _shown(settings, name: str) -> bool:
    """Return whether a setting does anything with the others as they are."""
    schedule = settings.schedule
    switch = {"prefit": "prefit_iterations", "refinement": "refinement_iterations", "prior": "prior_rounds"}
    part = name.partition("_")[0]
    if part in switch and name != switch[part]:
        return getattr(schedule, switch[part]) > 0
    if name in ("delta", "shadow", "highlight_power"):
        return schedule.loss == "robust"
    if name in ("seeded", "seed_spread"):
        return schedule.seed != "random"
    if name == "level_iterations":
        return schedule.levels > 1
    return True


def _settings_panel(title: str, names: tuple[str, ...]) -> type[bpy.types.Panel]:
    """Return the closed panel of one group of settings."""

    def draw(self, context) -> None:
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        for name in names:
            if _shown(context.scene.irpso, name):
                column.prop(context.scene.irpso.schedule, name)

    idname = f"IRPSO_PT_{title.lower()}"
    return type(
        idname,
        (Sidebar, bpy.types.Panel),
        {
            "__doc__": f"Settings of the search: {title.lower()}.", "__module__": __name__, "bl_label": title,
            "bl_parent_id": "IRPSO_PT_search", "bl_options": {"DEFAULT_CLOSED"}, "draw": draw,
        },
    )  # fmt: skip


CLASSES = (
    IRPSO_PT_failures,
    IRPSO_PT_capture,
    IRPSO_PT_capture_facts,
    IRPSO_PT_subject,
    IRPSO_PT_material,
    IRPSO_PT_recover,
    IRPSO_PT_search,
    *(_settings_panel(title, names) for title, names in GROUPS.items()),
)
