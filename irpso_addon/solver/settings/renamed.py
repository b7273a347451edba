"""Former names of settings, and their names now: the only table of both. docs/presets.md shows it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

FORMAT = 3  # of preset files
FORMER: Mapping[str, Mapping[str, str]] = MappingProxyType({  # table → setting in format 1 or 2 → now
    "": {"survey": "prefit", "polish": "refinement"},  # the tables themselves
    "swarm": {
        "seed": "start", "seeded": "start_fraction", "seed_spread": "start_spread", "linear_reach": "linear_limit",
        "c3_until": "c3_fade", "neighbour_every": "neighbour_interval",
    },
    "fitness": {"percentile": "scale_percentile", "bounds": "clipped_samples"},
    "prefit": {
        "polish_iterations": "refinement_iterations", "judge_delta": "acceptance_delta", "trust": "acceptance_ratio",
        "observations": "min_observations",
    },
    "refinement": {
        "daring": "candidate_ratio", "gain": "ftol", "smallest_step": "xtol", "votes": "neighbour_weight",
        "central": "central_differences", "widening": "delta_factor", "race_observations": "race_max_observations",
    },
    "prior": {
        "likeness": "bandwidth", "likeness_color": "color_bandwidth", "spread": "min_deviation",
        "noise_freedom": "noise_samples", "share": "min_influence", "turn": "normals",
    },
})  # fmt: skip
FORMER_VALUES = {("loss", "robust"): "cauchy"}  # setting, value in format 1 or 2 → now
_WITHOUT_PREFIX = {**FORMER["swarm"], **FORMER["fitness"]}


def current_name(name: str) -> str:
    """Return the present name of a setting, given as in ``--set``."""
    table, _, key = name.partition("_")
    if (now := current_key("", table)) in FORMER and key:
        return f"{now}_{current_key(now, key)}"
    return _WITHOUT_PREFIX.get(name, name)


def current_key(table: str, key: str) -> str:
    """Return the present name of a key in a table of a preset."""
    return FORMER.get(table, {}).get(key, key)


def current_value(name: str, value: Any) -> Any:
    """Return the present word for a value of a setting."""
    return FORMER_VALUES.get((name, value), value) if isinstance(value, str) else value


def current_settings(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return name → value of settings, named as in ``--set``, under the present names."""
    return _renamed(values, current_name)


def current_tables(preset: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a preset of any format under the present names."""
    tables = _renamed(preset, partial(current_key, ""))
    return {
        table: _renamed(rows, partial(current_key, table)) if isinstance(rows, dict) else rows
        for table, rows in tables.items()
    }


def _renamed(values: Mapping[str, Any], current: Callable[[str], str]) -> dict[str, Any]:
    """Return values under the present names. A former name stays beside the present one, so that it is refused."""
    return {
        name if (now := current(name)) in values else now: current_value(name, value) for name, value in values.items()
    }


def hint(old: Any, now: Any) -> str:
    """Return the end of an error that refuses a former name or value; "" where it is none."""
    return "" if now == old else f"; it is '{now}' now"
