"""One setting of a schedule: its limits, and how it is shown. Declared once, beside its field (groups.py)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from typing import Any, Literal, get_origin, get_type_hints

from ...core.errors import InputError
from .renamed import current_value, hint

MAX_ITERATIONS, MAX_STEPS, MAX_ROUNDS = 1_000_000, 10_000, 100  # a plan lists the cost of every iteration
_LONG = 10**40
_SHADERS_MAXIMUM = {int: 2**31 - 1, float: 3.4e38}  # of 32 bits


@dataclass(frozen=True)
class Setting:
    """Limits, label and help of a setting.

    label, help: as shown in the window and in docs/presets.md. kind: int, float, bool, or str for one of ``choices``;
    read from the field's type. minimum: excluded where ``exclusive_minimum``. maximum: None for the largest number that
    shaders hold. odd: even numbers are refused. soft_max: upper end of the slider. subtype: Blender's name of the unit.
    precision: decimals. choices: value → (label, help). default: None where every preset sets the value.
    """

    label: str
    help: str
    kind: type = float
    minimum: int = 0
    exclusive_minimum: bool = False
    maximum: int | None = None
    odd: bool = False
    soft_max: float | None = None
    subtype: str = "NONE"
    precision: int = 3
    choices: Mapping[str, tuple[str, str]] = dataclasses.field(default_factory=dict)
    default: Any = None

    def check(self, name: str, value: Any, where: str) -> None:
        """Raise InputError where ``value`` is no valid value of setting ``name``. where: begin of the message."""
        if self.choices:
            if value not in tuple(self.choices):  # a tuple, so that unhashable values are refused, too
                now = hint(value, current_value(name, value))
                raise InputError(f"{where}: {name} must be one of {', '.join(self.choices)}, not {value!r}{now}")
            return
        if self.kind is bool:
            if not isinstance(value, bool):
                raise InputError(f"{where}: {name} must be true or false, not {value!r}")
            return
        long = isinstance(value, int) and abs(value) > _LONG  # Python writes none of more than 4300 digits
        shown = f"a number of more than {math.log10(_LONG):.0f} digits" if long else repr(value)
        kinds, words = (int, "a whole number") if self.kind is int else (int | float, "a number")
        number = isinstance(value, kinds) and not isinstance(value, bool)
        if not number or not self.minimum <= value < math.inf:
            raise InputError(f"{where}: {name} must be {words} from {self.minimum}, not {shown}")
        if self.exclusive_minimum and value == self.minimum:
            raise InputError(f"{where}: {name} must be above {self.minimum}, not {shown}")
        maximum = _SHADERS_MAXIMUM[self.kind] if self.maximum is None else self.maximum
        if value > maximum:
            raise InputError(f"{where}: {name} must be at most {maximum}, not {shown}")
        if self.odd and value % 2 == 0:
            raise InputError(f"{where}: {name} must be odd (1, 3, 5, …), not {shown}")


def setting(label: str, help: str, default: Any = MISSING, **more: Any) -> Any:
    """Return the field of a dataclass that is a setting; ``more`` are Setting's own fields."""
    shown = None if default is MISSING else default
    return dataclasses.field(default=default, metadata={Setting: Setting(label, help, default=shown, **more)})


def settings_of(kind: type, prefix: str = "") -> dict[str, Setting]:
    """Return name → Setting of a dataclass's fields that are settings; each name starts with ``prefix``."""
    hints = get_type_hints(kind)
    return {
        prefix + field.name: dataclasses.replace(
            field.metadata[Setting], kind=str if get_origin(hints[field.name]) is Literal else hints[field.name]
        )
        for field in dataclasses.fields(kind)
        if Setting in field.metadata
    }
