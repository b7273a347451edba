"""The sidebar of the 3D viewport: what its panels have in common, and the panel of failures."""

from __future__ import annotations

import bpy

from ..common import failures
from ..session import session


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


class BeforeRun(Sidebar):
    """A panel of settings that count before a recovery only; it leaves while one is there."""

    @classmethod
    def poll(cls, context) -> bool:
        """Whether there is no recovery."""
        return session.current() is None


CLASSES = (IRPSO_PT_failures,)
