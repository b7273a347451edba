"""Schedules: which parameters are searched together, in which order, and with what constants. Read from presets/."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ...core.errors import InputError
from ...core.files import defined, load_shipped_table, shipped_names
from ...core.paths import PRESETS
from .groups import Fitness, Prefit, Stage, Swarm
from .refinement_groups import Interreflection, Materials, Refinement, SpatialPrior, Surface
from .renamed import FORMAT, current_key, current_name, current_tables, hint
from .setting import Setting, setting, settings_of

_LIMITS = defined("common/limits.glsl", "MAX_")
MAX_DIMENSIONS, MAX_PARTICLES = int(_LIMITS["DIMENSIONS"]), int(_LIMITS["PARTICLES"])  # of a swarm that moves together
ALL = "all"
REST = "rest"  # all parameters that no stage of the schedule names
_TEXTS = ("name", "title")  # that only a preset's file sets
_TOP_KEYS = (*_TEXTS, "cycles", "threshold", "levels", "level_iterations")
_ITERATIONS = "iterations"  # of every stage
_GROUPS = ("swarm", "fitness")  # their settings have no prefix; those of other groups have the group's name as prefix


@dataclass(frozen=True)
class Schedule:
    """A preset: the stages in order, repeated ``cycles`` times, and the constants they share.

    Order: prefit, whose normals stay fixed in the stages; stages; refinement; shared materials; spatial prior; surface.
    Each round of interreflection repeats all of them.
    """

    name: str
    title: str
    swarm: Swarm
    fitness: Fitness
    stages: tuple[Stage, ...]
    cycles: int = setting(
        "Cycles",
        "How many times the search runs through all stages. Each further time starts"
        " from the maps so far and takes as long again",
        1,
        minimum=1,
        maximum=100,
        soft_max=10,
    )
    threshold: float = setting(
        "Stop at Error", "Fitness below which a texel's swarm stops. More is faster and less exact; 0 never stops"
        " early", 0.0, soft_max=0.1,
        precision=5,
    )  # fmt: skip
    levels: int = setting(
        "Levels", "Number of map sizes that are solved, from small to full. Each is half the next one and gives"
        " its first guess; 1 solves the full size alone", 1, minimum=1, maximum=5,
    )  # fmt: skip
    level_iterations: float = setting(
        "Finer Levels", "Iterations at all levels but the smallest, as a part of those at the smallest. Less is"
        " faster and less exact", 0.4, exclusive_minimum=True, maximum=1,
        subtype="FACTOR",
    )  # fmt: skip
    prefit: Prefit = Prefit()
    refinement: Refinement = Refinement()
    materials: Materials = Materials()
    prior: SpatialPrior = SpatialPrior()
    surface: Surface = Surface()
    interreflection: Interreflection = Interreflection()

    def settings(self) -> dict[str, Any]:
        """Return name → value of every setting that ``replaced`` accepts, except ``search``; see SETTINGS.

        iterations: the maximum over the stages.
        """
        parts = {part: getattr(self, part) for part in (*_GROUPS, *_OPTIONAL)}
        named = {_prefix(part) + f.name: getattr(group, f.name) for part, group in parts.items()
                 for f in dataclasses.fields(group)}  # fmt: skip
        own = {name: getattr(self, name) for name in SETTINGS if name in _TOP_KEYS}
        return {**named, **own, _ITERATIONS: max((stage.iterations for stage in self.stages), default=0)}

    def without_rounds(self) -> Schedule:
        """Return a copy without rounds of interreflection."""
        return self.replaced(interreflection_rounds=0).without_matte_rounds()

    def without_matte_rounds(self) -> Schedule:
        """Return a copy without matte rounds, for a subject whose shape is not known."""
        return self.replaced(interreflection_matte_rounds=0)

    def replaced(self, **changes: Any) -> Schedule:
        """Return a checked copy with other settings: names of Swarm, Fitness or Schedule fields. Raises InputError.

        ``iterations`` sets that of every stage; ``search`` replaces all stages by one with these names. Other groups
        are replaced whole (``refinement=``), or by setting, with the group's name as prefix (``refinement_rounds=``).
        """
        result = self
        if (search := changes.pop("search", None)) is not None:
            most = max(stage.iterations for stage in self.stages)
            names = tuple(search) if isinstance(search, Iterable) and not isinstance(search, str) else search
            result = dataclasses.replace(result, stages=(Stage(names, most),))
        if (iterations := changes.pop("iterations", None)) is not None:
            stages = tuple(dataclasses.replace(stage, iterations=iterations) for stage in result.stages)
            result = dataclasses.replace(result, stages=stages)
        for part in _GROUPS:
            group = getattr(result, part)
            names = {f.name for f in dataclasses.fields(group)} & set(changes)
            values = {name: changes.pop(name) for name in names}
            result = dataclasses.replace(result, **{part: dataclasses.replace(group, **values)})
        for part in _OPTIONAL:
            group = getattr(result, part)
            names = {_prefix(part) + f.name: f.name for f in dataclasses.fields(group)}
            values = {names[name]: changes.pop(name) for name in names.keys() & set(changes)}
            result = dataclasses.replace(result, **{part: dataclasses.replace(group, **values)})
        for part, kind in _OPTIONAL.items():
            if part in changes and not isinstance(changes[part], kind):
                first = dataclasses.fields(kind)[0].name
                raise InputError(f"preset {self.name}: {part} has settings of its own, as in {part}_{first}=0")
        if unknown := set(changes) - {*_TOP_KEYS, *_OPTIONAL} | set(changes) & {*_TEXTS}:
            name = sorted(unknown)[0]
            raise InputError(f"preset {self.name}: there is no setting '{name}'{hint(name, current_name(name))}")
        result = dataclasses.replace(result, **changes)
        _check(result)
        return result


def refuse_interreflection(schedule: Schedule, why: str, remedy: str) -> None:
    """Raise InputError where a schedule has rounds of interreflection that cannot be made."""
    if count := schedule.interreflection.rounds:
        raise InputError(f"interreflection_rounds = {count}: {why}; {remedy}, or set it to 0")


# Groups with defaults. A preset sets only what differs; without a group's table its phase does not run.
_OPTIONAL = {
    "prefit": Prefit, "refinement": Refinement, "materials": Materials, "prior": SpatialPrior,
    "surface": Surface, "interreflection": Interreflection,
}  # fmt: skip


def _prefix(part: str) -> str:
    return "" if part in _GROUPS else f"{part}_"


SETTINGS: Mapping[str, Setting] = MappingProxyType({
    **settings_of(Stage), **settings_of(Schedule), **settings_of(Swarm), **settings_of(Fitness),
    **{name: one for part, kind in _OPTIONAL.items() for name, one in settings_of(kind, _prefix(part)).items()},
})  # fmt: skip
GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType({  # title → names of the settings, in order
    "Stages": (_ITERATIONS, *settings_of(Schedule)),
    "Swarm": tuple(settings_of(Swarm)),
    "Fitness": tuple(settings_of(Fitness)),
    **{part.capitalize(): tuple(settings_of(kind, _prefix(part))) for part, kind in _OPTIONAL.items()},
})  # fmt: skip


def shipped_presets() -> list[str]:
    """Return the names of the presets that come with the program."""
    return shipped_names(PRESETS)


def load_schedule(name_or_path: str | Path) -> Schedule:
    """Read a shipped preset by name, or a user's .toml file of any format by path.

    The classes of groups.py define meaning and limits of each constant; SETTINGS collects them. The files in presets/
    cite the sources of the shipped values. Raises InputError naming the file, the setting and its limits.
    """
    table, path = _preset_table(name_or_path)
    _refuse_unknown(table, [*_TOP_KEYS, *_GROUPS, "stage", *_OPTIONAL], str(path))
    rows = table.get("stage", [])
    if not isinstance(rows, list):
        raise InputError(f"{path}: stages are written [[stage]], with two brackets")
    schedule = Schedule(
        **{"name": path.stem, "title": path.stem, **{key: table[key] for key in _TOP_KEYS if key in table}},
        swarm=_build(Swarm, table.get("swarm"), path, "swarm"),
        fitness=_build(Fitness, table.get("fitness"), path, "fitness"),
        stages=tuple(_build(Stage, row, path, "[stage]") for row in rows),
        **{part: _build(kind, table[part], path, part) for part, kind in _OPTIONAL.items() if part in table},
    )
    _check(schedule, str(path))
    return schedule


def _preset_table(name_or_path: str | Path) -> tuple[dict[str, Any], Path]:
    """Return a preset's table, merged over that of the preset that it extends, and the preset's path."""
    table, path = load_shipped_table("preset", name_or_path, PRESETS)
    if (version := table.pop("format", 1)) not in range(1, FORMAT + 1):
        raise InputError(f"{path}: is of format {version!r}; this version reads 1 to {FORMAT}: install a later one")
    if version != FORMAT:
        table = current_tables(table)
    base = table.pop("extends", None)
    if base is None:
        return table, path
    if base not in shipped_presets() or (PRESETS / f"{base}.toml").resolve() == path.resolve():
        raise InputError(f"{path}: extends {base!r}; name another preset: {', '.join(shipped_presets())}")
    below, _ = _preset_table(base)
    groups = {
        name: {**below[name], **value}
        for name, value in table.items()
        if isinstance(value, dict) and isinstance(below.get(name), dict)
    }
    return {**below, **table, **groups}, path


def _build(kind: type, table: Any, path: Path, part: str) -> Any:
    where = f"{path}: [{part}]"
    if not isinstance(table, dict):
        raise InputError(f"{where} is not there, or no table; copy it from a shipped preset")
    fields = {f.name: f for f in dataclasses.fields(kind)}
    _refuse_unknown(table, fields, where, part)
    if missing := [name for name, field in fields.items() if field.default is MISSING and name not in table]:
        raise InputError(f"{where}: '{missing[0]}' is not set; copy it from a shipped preset")
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in table.items()})


def _refuse_unknown(table: dict[str, Any], allowed: Iterable[str], where: str, part: str = "") -> None:
    """Raise InputError for a key that is not allowed. part: name of the table, "" for the whole preset."""
    if unknown := sorted(set(table) - set(allowed)):
        key = unknown[0]
        now = hint(key, current_key(part, key))
        raise InputError(f"{where}: unknown key '{key}'{now}; known are {', '.join(allowed)}")


def _check(schedule: Schedule, where: str = "") -> None:
    where = where or f"preset {schedule.name}"
    for key in _TEXTS:
        if not isinstance(value := getattr(schedule, key), str):
            raise InputError(f"{where}: {key} must be a text, not {value!r}")
    if not schedule.stages:
        raise InputError(f"{where}: it has no [[stage]]; add one with search and iterations")
    for stage in schedule.stages:
        SETTINGS[_ITERATIONS].check(_ITERATIONS, stage.iterations, where)
        names = stage.search
        if not isinstance(names, tuple) or not names or not all(isinstance(name, str) for name in names):
            raise InputError(f'{where}: search must be a list of names, as in search = ["normal"], not {names!r}')
    for name, value in schedule.settings().items():
        SETTINGS[name].check(name, value, where)
    if (schedule.swarm.update, schedule.swarm.linear) == ("one", "solve"):
        raise InputError(f'{where}: linear = "solve" needs update = "all"')
    if schedule.levels > 1:
        refuse_interreflection(schedule, f"{where} solves coarse to fine", "set levels = 1")
    if schedule.refinement.iterations == 0 and not any(stage.iterations for stage in schedule.stages):
        raise InputError(
            f"{where}: no stage has iterations, and there is no [refinement] either; give one of them some"
        )
