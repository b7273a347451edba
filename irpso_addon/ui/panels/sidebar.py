"""Base classes of the sidebar's panels, and the panel of failures."""

from __future__ import annotations

import bpy

from ..common import failures
from ..session import session


class Sidebar:
    """Base of the panels in the 3D viewport's sidebar."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "IRPSO"


class Failures:
    """Base of the first panel: messages of failures that no operator could report.

    It has a header: Blender would sort a panel without one, and its tab, before all others.
    """

    bl_label = "Failed"

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there are messages."""
        return bool(failures.messages())

    def draw(self, context) -> None:
        """Draw the messages and the button that dismisses them."""
        failures.draw(self.layout, context)


class IRPSO_PT_failures(Failures, Sidebar, bpy.types.Panel):
    """Messages of failures."""


class BeforeRun(Sidebar):
    """Base of panels with settings for the start of a recovery, hidden while there is a recovery."""

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is no recovery."""
        return session.current() is None


CLASSES = (IRPSO_PT_failures,)
