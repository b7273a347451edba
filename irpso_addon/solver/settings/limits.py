"""What each setting of a schedule may be: the one table that checks, command line and user interface go by."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin, get_type_hints

from ...core.errors import InputError

_FROM_ZERO = {"iterations", "neighbour_every", "prefit_iterations", "prefit_refinement_iterations", "prefit_observations",
              "refinement_iterations", "refinement_rounds", "prior_rounds", "materials_rounds"}  # fmt: skip
_ABOVE_ZERO = {"v_max", "delta", "percentile", "level_iterations", "prefit_acceptance_delta", "refinement_damping",
               "prior_likeness", "prior_likeness_color", "prior_spread", "prior_noise_freedom", "prior_share",
               "prior_tolerance"}  # fmt: skip
# At five levels a coarse texel is 16 × 16; at six scales a round of the prior reaches 64 texels.
_MOST = {
    "seeded": 1,
    "c3_until": 1,
    "percentile": 100,
    "levels": 5,
    "level_iterations": 1,
    "prior_scales": 6,
    "highlight_power": 1,
}
_FROM_ONE = {"refinement_widening"}
_ODD = {"neighbourhood"}


@dataclass(frozen=True)
class Limits:
    """The values that a setting may have.

    kind: int, float, bool, or str for one of ``choices``. least: the smallest number, itself not allowed where
    ``above``. most: the largest, or None. odd: whether an even number is refused.
    """

    kind: type
    least: int = 0
    above: bool = False
    most: int | None = None
    odd: bool = False
    choices: tuple[str, ...] = ()

    def check(self, name: str, value: Any, where: str) -> None:
        """Raise InputError where the setting called ``name`` cannot have this value; ``where`` begins the message."""
        if self.choices:
            if value not in self.choices:
                raise InputError(f"{where}: {name} must be one of {', '.join(self.choices)}, not {value!r}")
            return
        if self.kind is bool:
            if not isinstance(value, bool):
                raise InputError(f"{where}: {name} must be true or false, not {value!r}")
            return
        kinds, words = (int, "a whole number") if self.kind is int else (int | float, "a number")
        number = isinstance(value, kinds) and not isinstance(value, bool) and math.isfinite(value)
        if not number or value < self.least:
            raise InputError(f"{where}: {name} must be {words} from {self.least}, not {value!r}")
        if self.above and value == self.least:
            raise InputError(f"{where}: {name} must be above {self.least}, not {value!r}")
        if self.most is not None and value > self.most:
            raise InputError(f"{where}: {name} must be at most {self.most}, not {value!r}")
        if self.odd and value % 2 == 0:
            raise InputError(f"{where}: {name} must be odd (1, 3, 5, …), not {value!r}")


def field_limits(kind: type, prefix: str = "", without: tuple[str, ...] = ()) -> dict[str, Limits]:
    """Return setting name → limits for the fields of a dataclass, ``prefix`` before each name."""
    hints = get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind) if field.name not in without]
    return {prefix + name: _limits(prefix + name, hints[name]) for name in names}


def check_values(limits: Mapping[str, Limits], values: Mapping[str, Any], where: str) -> None:
    """Raise InputError for the first value that is outside its limits."""
    for name, limit in limits.items():
        limit.check(name, values[name], where)


def _limits(name: str, hint: Any) -> Limits:
    if get_origin(hint) is Literal:
        return Limits(str, choices=get_args(hint))
    least = 1 if name in _FROM_ONE or (hint is int and name not in _FROM_ZERO) else 0
    return Limits(hint, least, name in _ABOVE_ZERO, _MOST.get(name), name in _ODD)
