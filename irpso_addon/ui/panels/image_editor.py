"""Panels of the Image editor's sidebar: the displayed map, progress or result, probes."""

from __future__ import annotations

import bpy

from ..session import session
from .recovery import draw_progress, draw_result
from .sidebar import Failures
from .view import draw_probes, draw_shown


class _ImageSidebar:
    bl_space_type = "IMAGE_EDITOR"
    bl_region_type = "UI"
    bl_category = "IRPSO"

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there are maps to show."""
        running = session.current()
        return running is not None and running.display is not None


class IRPSO_PT_image_failures(Failures, _ImageSidebar, bpy.types.Panel):
    """Messages of failures."""


class IRPSO_PT_image_maps(_ImageSidebar, bpy.types.Panel):
    """The converging maps, flat."""

    bl_label = "View"

    def draw_header(self, context) -> None:
        """Draw the switch of the overlay."""
        self.layout.prop(context.scene.irpso.view, "show", text="")

    def draw(self, context) -> None:
        """Draw the choice of the picture."""
        if context.scene.irpso.view.show:
            draw_shown(self.layout, context, session.current())


class IRPSO_PT_image_recover(_ImageSidebar, bpy.types.Panel):
    """Progress or result of the recovery, with its buttons."""

    bl_label = "Recover"

    def draw(self, context) -> None:
        """Draw progress, or the result."""
        running = session.current()
        (draw_result if running.state == "done" else draw_progress)(self.layout, context, running)


class IRPSO_PT_image_probes(_ImageSidebar, bpy.types.Panel):
    """The probed texels."""

    bl_label = "Probes"

    def draw(self, context) -> None:
        """Draw the list."""
        draw_probes(self.layout, context)


CLASSES = (IRPSO_PT_image_failures, IRPSO_PT_image_maps, IRPSO_PT_image_recover, IRPSO_PT_image_probes)
