"""The schedule as scene settings: the preset's name, and every setting with its effective value.

The properties come from the schedule's table of settings, which gives their limits. FIRST gives the defaults.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ...blender.scenes.scene_capture import system_properties
from ...core.errors import InputError
from ...solver.settings.renamed import current_name
from ...solver.settings.schedule import SETTINGS, Schedule, load_schedule, shipped_presets
from ...solver.settings.setting import Setting
from ..common.file_paths import absolute
from ..common.numbers import typed

FIRST = "standard"  # the preset of a new scene
_ROUNDS_PRESETS = {True: "standard", False: "thorough"}  # of the switch Interreflection; whether there are matte rounds
_OPEN_OFFSET = 1e-6  # added to an open lower limit, because Blender's limits are closed
_DIGITS = 6  # largest number of decimals that Blender shows


def _on_preset(self: ScheduleSettings, context: Any) -> None:
    try:
        fill(self, base_schedule(self))
    except InputError:
        return  # the values stay; schedule_of raises the error when it is called


def _make_odd(self: ScheduleSettings, context: Any) -> None:
    if self.neighbourhood % 2 == 0:
        self.neighbourhood += 1


def _has_rounds(self: ScheduleSettings) -> bool:
    return self.interreflection_rounds > 0 or (_has_matte_rounds(self) and self.interreflection_matte_rounds > 0)


def _has_matte_rounds(self: ScheduleSettings) -> bool:
    settings = self.id_data.irpso
    return settings.subject == "MESH" and settings.shadows and self.levels == 1


def _switch_rounds(self: ScheduleSettings, on: bool) -> None:
    matte = _has_matte_rounds(self)
    try:
        light = base_schedule(self).interreflection
    except InputError:  # a file that is gone
        light = _shipped(FIRST).interreflection
    if not (light.estimates if matte else light.rounds):
        light = _shipped(_ROUNDS_PRESETS[matte]).interreflection
    self.interreflection_rounds = light.rounds * on
    if matte:
        self.interreflection_matte_rounds = light.matte_rounds * on


class ScheduleSettings(bpy.types.PropertyGroup):
    """A preset's name, and the settings. Choosing a preset sets them."""


@cache
def _shipped(name: str) -> Schedule:
    return load_schedule(name)


def base_schedule(settings: ScheduleSettings) -> Schedule:
    """Return the preset's schedule as in its file. Raises InputError.

    Shipped files are read once, because panels call this at every redraw. The user's own .toml is read every time.
    """
    name = settings.preset
    return _shipped(name) if name in _names() else load_schedule(absolute(name, "Preset"))


@cache
def _names() -> frozenset[str]:
    return frozenset(shipped_presets())


def is_shipped(settings: ScheduleSettings) -> bool:
    """Return whether the preset is a shipped schedule."""
    return settings.preset in _names()


def fill(settings: ScheduleSettings, schedule: Schedule) -> None:
    """Set all settings to those of a schedule."""
    for name, value in schedule.settings().items():
        setattr(settings, name, value)


def rename_stored(settings: ScheduleSettings) -> None:
    """Move values that an earlier version stored under other names to the present settings."""
    stored = system_properties(settings)
    for old in {*stored.keys()} - SETTINGS.keys():
        if (name := current_name(old)) in SETTINGS:
            choices = tuple(SETTINGS[name].choices)  # of which the number is stored
            setattr(settings, name, choices[stored[old]] if choices else stored[old])
            del stored[old]


def differences(settings: ScheduleSettings) -> dict[str, Any]:
    """Return setting → value of those that differ from the preset, for ``Schedule.replaced``. Raises InputError.

    Blender stores numbers in 32 bits: 0.03 becomes 0.02999999933. So numbers are compared in 32 bits, and a changed one
    is returned as the shortest decimal that rounds to it: the number that the user typed.
    """
    base = base_schedule(settings).settings()
    changed = {}
    for name, value in base.items():
        stored = getattr(settings, name)
        if SETTINGS[name].kind is float:
            if np.float32(stored) != np.float32(value):
                changed[name] = typed(stored)
        elif stored != value:
            changed[name] = stored
    return changed


def schedule_of(settings: ScheduleSettings) -> Schedule:
    """Return the schedule of the settings: the preset's own if none differs. Raises InputError."""
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
    bounds = {"min": setting.minimum, "soft_min": setting.minimum}
    if setting.maximum is not None:
        bounds |= {"max": setting.maximum, "soft_max": setting.maximum}
    if setting.soft_max is not None:
        bounds["soft_max"] = setting.soft_max
    if setting.kind is int:
        if setting.odd:
            bounds["update"] = _make_odd
        return IntProperty(default=default, subtype=setting.subtype, **bounds, **texts)
    if setting.exclusive_minimum:
        bounds |= {"min": setting.minimum + _OPEN_OFFSET, "soft_min": setting.minimum + _OPEN_OFFSET}
    return FloatProperty(
        default=default, subtype=setting.subtype, precision=min(setting.precision, _DIGITS), step=1, **bounds, **texts
    )


def _declare() -> None:
    defaults = {name: _shipped(name) for name in _names()}[FIRST].settings()  # loads all now: panels open no file
    declared = {name: _property(setting, defaults[name]) for name, setting in SETTINGS.items()}
    ScheduleSettings.__annotations__ = {
        "preset": StringProperty(
            name="Preset", description="The schedule of the search, or your own .toml file", default=FIRST,
            update=_on_preset,
        ),
        "own": StringProperty(description="The last preset of the user's own that was chosen"),
        "own_text": StringProperty(description="The text of its file"),
        "interreflection": BoolProperty(
            name="Interreflection", get=_has_rounds, set=_switch_rounds,
            description="Find the light that the subject throws on itself, as in a bowl or a fold, and subtract it"
            " from the photographs. A mesh takes up to twice as long, a card up to four times. Not possible with Levels"
            " above 1",
        ),
        **declared,
    }  # fmt: skip


_declare()
CLASSES = (ScheduleSettings,)
