"""Sidebar panels of the recovery: start, progress, result, search settings."""

from __future__ import annotations

import re
from typing import Any

import bpy

from ...core.errors import InputError
from ...pipeline.result import capture_warnings
from ...solver.lights.refine import Lights
from ...solver.settings.schedule import GROUPS
from ..common import drawing, failures
from ..common.words import iface, n_
from ..operators.presets import label_of
from ..operators.restore import draw_stored
from ..session import session
from ..session.forecast import search_time
from ..session.keep import is_standard_view
from ..session.scene_capture import has_capture
from ..session.scene_job import missing
from .sidebar import Sidebar

_ROUND, _LEVEL = re.compile(r", round (\d+) of interreflection$"), re.compile(r" at 1/(\d+)$")  # ends of titles
_OF_STRENGTHS = "--intensities"  # in warnings whose remedy is Light Strengths


class IRPSO_PT_recover(Sidebar, bpy.types.Panel):
    """The button Recover, the progress, the result."""

    bl_label = "Recover"

    def draw(self, context) -> None:
        """Draw the start, the progress or the result."""
        running = session.current()
        if running is None:
            draw_stored(self.layout, context)
            _draw_start(self.layout, context, n_("Recover"))
        elif running.state == "done":
            warnings = draw_result(self.layout, context, running)
            self.layout.separator()
            _draw_start(self.layout, context, n_("Recover Again"))
            if any(_OF_STRENGTHS in text for text in warnings):  # the panel that has them is hidden now
                column = self.layout.column()
                column.use_property_split, column.use_property_decorate = True, False
                column.prop(context.scene.irpso, "light_strengths")
        else:
            draw_progress(self.layout, context, running)


def draw_presets(layout, settings) -> None:
    """Draw the menu of presets with its buttons + and −. A shipped preset has no −."""
    row = layout.row(align=True)
    row.menu("IRPSO_MT_presets", text=label_of(settings.schedule), translate=False)
    row.operator("irpso.preset_add", text="", icon="ADD")
    if settings.schedule.own:
        row.operator("irpso.preset_add", text="", icon="REMOVE").remove_active = True


def _draw_start(layout, context, text: str) -> None:
    chosen = has_capture(context.scene.irpso)  # if not, the panel Capture says how to begin
    if chosen:
        draw_presets(layout, context.scene.irpso)
    row = layout.row()
    row.scale_y = 2
    row.operator("irpso.recover", text=text, icon="PLAY")
    if not chosen:
        return
    if wanting := missing(context):
        drawing.wrapped(layout, context, wanting, "INFO")
    elif time := search_time(context):
        drawing.fact(layout, context, "Search Time", time)
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(context.scene.irpso, "hold_out")  # below the button: a row above could push it out of view
    column.prop(context.scene.irpso.schedule, "interreflection")


def draw_progress(layout, context, running: session.Session) -> None:
    """Draw stage, progress, error, speed and remaining time; and the buttons."""
    layout.label(text=running.job.name, icon="TEXTURE", translate=False)
    progress = running.progress
    text = (
        iface("Paused at {part:.0%}", part=running.fraction) if running.state == "paused" else f"{running.fraction:.0%}"
    )
    layout.progress(factor=running.fraction, type="BAR", text=text, translate=False)
    column = layout.column(align=True)
    column.scale_y = 0.9
    lines = 3 if running.job.schedule.interreflection.estimates else 2  # a fixed number, so that buttons do not move
    drawing.fact(column, context, "Now", stage_text(running.title), lines)
    if progress is not None:
        drawing.fact(column, context, "Iteration", f"{progress.iteration_in_all} / {progress.iterations_in_all}")
        drawing.fact(column, context, "Error", "–" if running.error is None else drawing.percent(running.error))
        drawing.fact(column, context, "Evaluations", drawing.rate(running.rate))
        left = running.seconds_left
        drawing.fact(column, context, "Time Left", "–" if left is None else drawing.clock(left))
    if running.state == "paused" and running.home_scene() == context.scene:  # whose settings Resume takes
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
        _draw_displacement(layout, running.home_scene() or context.scene)
        layout.operator("irpso.export", text="Export…", icon="EXPORT")


def stage_text(title: str) -> str:
    """Return the title of a step or stage in the user's language, the parameters of a search one by one."""
    if round_found := _ROUND.search(title):
        stage = stage_text(title[: round_found.start()])
        return iface("{stage}, round {number} of interreflection", stage=stage, number=round_found[1])
    if level := _LEVEL.search(title):
        return iface("{stage} at 1/{part} of the size", stage=stage_text(title[: level.start()]), part=level[1])
    parts = title.split(" + ")
    names = [part[:1].upper() + part[1:] if " " in part else bpy.path.display_name(part) for part in parts]
    return ", ".join(map(iface, names))


def lights_text(lights: Lights) -> str:
    """Return how refined lights differ from the given ones, in the user's language, as ``Lights.summary``."""
    parts = []
    if lights.scaled:
        factors = lights.factors.mean(axis=-1)
        parts.append(iface("{low:.2g} to {high:.2g} × as given", low=factors.min(), high=factors.max()))
    if lights.turned.any():
        parts.append(iface("turned by {degrees:.1f}°", degrees=lights.turned.mean()))
    return ", ".join(parts) or iface("as given")


def draw_result(layout, context, running: session.Session) -> list[str]:
    """Draw the result's figures and warnings, and the buttons; return the warnings."""
    kept, stopped = running.kept, running.stopped
    column = layout.column(align=True)
    state = [iface("Stopped Early")] * stopped + [iface("Kept")] * kept or [iface("Done")]
    column.label(text=f"{running.job.name}: {', '.join(state)}", icon="PAUSE" if stopped else "CHECKMARK",
                 translate=False)  # fmt: skip
    if stopped:
        progress = running.progress
        drawing.fact(column, context, "Iteration", f"{progress.iteration_in_all} / {progress.iterations_in_all}")
    if running.error is not None:
        drawing.fact(column, context, "Error", drawing.percent(running.error))
    drawing.fact(column, context, "Search Time", drawing.clock(running.seconds))
    if running.held_out_line:
        drawing.wrapped(layout, context, running.held_out_line, "HIDE_ON")
    if running.lights is not None:
        drawing.fact(column, context, "Lights", lights_text(running.lights))
    if (found := running.recovery.findings.get("interreflection")) is not None:
        _draw_interreflection(column, context, found)
    of_capture = capture_warnings(running.job.capture, reads=False, exposures=not running.job_run.scaled)
    warnings = [*running.warnings, *of_capture]
    for text in warnings:
        _draw_warning(layout, context, text)
    if stopped:
        layout.operator("irpso.resume", icon="PLAY")
    row = layout.row()
    row.scale_y = 1.0 if kept else 2.0
    row.operator("irpso.keep", text="Keep Again" if kept else "Keep", icon="MATERIAL")
    _draw_displacement(layout, running.home_scene() or context.scene)
    row = layout.row(align=True)
    row.operator("irpso.export", text="Export…", icon="EXPORT")
    row.operator("irpso.cancel", text="Close" if kept else "Discard", icon="X")
    if kept:
        layout.operator("irpso.save_asset", text="Save to Asset Library…", icon="ASSET_MANAGER")
        layout.operator("irpso.mix_captures", text="Mix Captures…", icon="NODE_MATERIAL")
    if kept and not is_standard_view(context.scene):
        text = iface("The scene's Color Management changes colors. To compare with the photographs:")
        drawing.wrapped(layout, context, text, "INFO")
        layout.operator("irpso.standard_view", icon="COLOR")
    return warnings


def _draw_warning(layout, context, text: str) -> None:
    text = failures.message_of(InputError(text))
    drawing.wrapped(layout, context, text[:1].upper() + text[1:], "ERROR")


def _draw_interreflection(layout, context, found: dict[str, Any]) -> None:
    """Draw the measurements of the interreflection rounds."""
    if not found["rounds"]:
        return
    drawing.fact(layout, context, "Indirect Light", iface("{share} of all", share=drawing.percent(found["share"])))
    drawing.fact(layout, context, "Rounds", str(found["rounds"]))
    drawing.fact(layout, context, "Strength", f"{found['strength'][-1]:.2f}")
    if count := found["unknown_texels"]:
        drawing.fact(
            layout, context, "Left Unknown", iface("1 texel") if count == 1 else iface("{count} texels", count=count)
        )


def _draw_displacement(layout, scene: bpy.types.Scene) -> None:
    """Draw the options of Keep, which are those of the recovery's scene."""
    column = layout.column(heading="Keep With")
    column.use_property_split, column.use_property_decorate = True, False
    column.prop(scene.irpso, "displacement")


class IRPSO_PT_search(Sidebar, bpy.types.Panel):
    """All settings of the search."""

    bl_label = "Search Settings"
    bl_parent_id = "IRPSO_PT_recover"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        """Whether changes have an effect now: neither before there is a capture nor while a recovery runs.

        Resume takes the settings of the scene in which the recovery was started.
        """
        running = session.current()
        if running is None:
            return has_capture(context.scene.irpso)
        return running.state == "done" or running.state == "paused" and running.home_scene() == context.scene

    def draw(self, context) -> None:
        """Draw the seed, except during a pause, when it cannot change. Panels below have the other settings."""
        running = session.current()
        if running is not None and running.state == "paused":
            return
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(context.scene.irpso, "seed")


def _has_effect(settings, name: str) -> bool:
    """Return whether a setting has an effect with the present values of the others."""
    schedule = settings.schedule
    switch = {"prefit": "prefit_iterations", "refinement": "refinement_iterations", "prior": "prior_rounds"}
    group = name.partition("_")[0]
    if group in switch and name != switch[group]:
        return getattr(schedule, switch[group]) > 0
    if name in ("delta", "shadow", "highlight_power"):
        return schedule.loss == "cauchy"
    if name in ("start_fraction", "start_spread"):
        return schedule.start != "random"
    if name == "level_iterations":
        return schedule.levels > 1
    return True


def _settings_panel(title: str, names: tuple[str, ...]) -> type[bpy.types.Panel]:
    """Return the closed panel of one group of settings."""

    def draw(self, context) -> None:
        column = self.layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        for name in names:
            if _has_effect(context.scene.irpso, name):
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


CLASSES = (IRPSO_PT_recover, IRPSO_PT_search, *(_settings_panel(title, names) for title, names in GROUPS.items()))
