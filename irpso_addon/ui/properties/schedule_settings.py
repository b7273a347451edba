"""The schedule as settings of the scene: a preset's name, and every setting at the value that is in effect.

The properties are made of the schedule's own table of settings: defaults are those of the preset a new scene has,
limits are those that schedules are checked by.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ...core.errors import InputError
from ...solver.settings.schedule import SETTINGS, Schedule, load_schedule, shipped_presets
from ...solver.settings.setting import Setting
from ..common.file_paths import absolute

FIRST = "standard"  # the preset of a new scene
_ABOVE = 1e-6  # Blender's limits may themselves be set; this stands for "above zero"
_DIGITS = 6  # the most that Blender shows behind the point


def _fill(self: ScheduleSettings, context: Any) -> None:
    try:
        fill(self, base_schedule(self))
    except InputError:
        return  # said by schedule_of when it is needed; the values stay as they are


def _make_odd(self: ScheduleSettings, context: Any) -> None:
    if self.neighbourhood % 2 == 0:
        self.neighbourhood += 1


class ScheduleSettings(bpy.types.PropertyGroup):
    """A preset's name, and the settings; choosing a preset fills them."""


@cache
def _shipped(name: str) -> Schedule:
    return load_schedule(name)


def base_schedule(settings: ScheduleSettings) -> Schedule:
    """Return the schedule that the settings begin from, as it stands in its file. Raises InputError.

    Shipped ones are read once, so that panels may ask at every redraw; a .toml of the user's own is read every time.
    """
    name = settings.preset
    return _shipped(name) if name in _names() else load_schedule(absolute(name, "Preset"))


@cache
def _names() -> frozenset[str]:
    return frozenset(shipped_presets())


def is_shipped(settings: ScheduleSettings) -> bool:
    """Return whether the settings begin from a schedule that comes with the program."""
    return settings.preset in _names()


def fill(settings: ScheduleSettings, schedule: Schedule) -> None:
    """Set all settings to what the schedule has."""
    for name, value in schedule.settings().items():
        setattr(settings, name, value)


def differences(settings: ScheduleSettings) -> dict[str, Any]:
    """Return setting → value for those that differ from the preset, as ``Schedule.replaced`` takes them.

    Blender keeps numbers in 32 bits, in which 0.03 is 0.02999999933: numbers are compared in 32 bits, and one that the
    user has set is taken for the shortest decimal that rounds to it, which is what was typed. Raises InputError.
    """
    base = base_schedule(settings).settings()
    found = {}
    for name, value in base.items():
        shown = getattr(settings, name)
        if SETTINGS[name].kind is float:
            if np.float32(shown) != np.float32(value):
                found[name] = float(str(np.float32(shown)))
        elif shown != value:
            found[name] = shown
    return found


def schedule_of(settings: ScheduleSettings) -> Schedule:
    """Return the schedule that the settings describe: the preset's own where nothing differs. Raises InputError."""
    changes = differences(settings)
    base = base_schedule(settings)
    return base.replaced(**changes) if changes else base


def _property(setting: Setting, default: Any) -> Any:
    texts = {"name": setting.label, "description": setting.help}
    if setting.choices:
        items = [(choice, *words) for choice, words in setting.choices.items()]
        return EnumProperty(items=items, default=default, **texts)
    if setting.kind is bool:
        return BoolProperty(default=default, **texts)
    bounds = {"min": setting.least, "soft_min": setting.least}
    if setting.most is not None:
        bounds |= {"max": setting.most, "soft_max": setting.most}
    if setting.soft_max is not None:
        bounds["soft_max"] = setting.soft_max
    if setting.kind is int:
        if setting.odd:
            bounds["update"] = _make_odd
        return IntProperty(default=default, subtype=setting.subtype, **bounds, **texts)
    if setting.above:
        bounds |= {"min": setting.least + _ABOVE, "soft_min": setting.least + _ABOVE}
    return FloatProperty(
        default=default, subtype=setting.subtype, precision=min(setting.precision, _DIGITS), step=1, **bounds, **texts
    )


def _declare() -> None:
    defaults = {name: _shipped(name) for name in _names()}[FIRST].settings()  # all are read now: panels open no file
    declared = {name: _property(setting, defaults[name]) for name, setting in SETTINGS.items()}
    ScheduleSettings.__annotations__ = {
        "preset": StringProperty(
            name="Preset", description="The schedule of the search, or a .toml file of your own", default=FIRST,
            update=_fill,
        ),
        "own": StringProperty(description="The preset of the user's own that was chosen last"),
        "own_text": StringProperty(description="What its file holds"),
        **declared,
    }  # fmt: skip


_declare()
CLASSES = (ScheduleSettings,)
