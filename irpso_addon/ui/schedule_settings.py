"""The schedule as settings of the scene: the name of a preset, and what differs from it."""

import bpy
from bpy.props import StringProperty

from ..solver.schedule import Schedule, load_schedule


class ScheduleSettings(bpy.types.PropertyGroup):
    """A preset's name and what differs from it."""

    preset: StringProperty(name="Preset", description="The schedule of the search", default="standard")


CLASSES = (ScheduleSettings,)


def schedule_of(settings: ScheduleSettings) -> Schedule:
    """Return the schedule that the settings describe. Raises InputError."""
    return load_schedule(settings.preset)
