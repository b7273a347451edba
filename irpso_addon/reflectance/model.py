"""Reflectance models: table of parameters (TOML), checked when read, and the shader beside it (GLSL)."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.files import defined, load_shipped_table, read_glsl, shipped_names
from ..core.paths import MODELS, SHADERS
from .shader_files import check_names, files_of, is_word

MAX_COMPONENTS = int(defined("common/limits.glsl", "MAX_")["COMPONENTS"])
_IDENTIFIER = re.compile(r"[a-z][a-z0-9_]*$")
_BASIS = re.compile(r"\bvec3\s+basis_(\w+)\s*\(")
_MOST = 1e9  # end of a range: the shaders' float32 holds its fourth power
MIN_PRIOR_WIDTH = 0.02  # least fraction of a prior's width where it vanishes
_KINDS = ("search", "linear")
_PRIORS = ("normal", "concave")
_COLOR_SPACES = ("Non-Color", "sRGB")
# Types of TOML keys; others are texts.
_KIND_OF = {"ordered": list, "complement": list, "material": dict}
_WORDS: dict[type, str] = {str: "a text", list: "a list of names", dict: "a table"}


Start = tuple[tuple[str, tuple[float, ...]], ...]  # (name, components), …; none for a mirror normal
_MIRROR = "mirror"  # the only start value of a normal


@dataclass(frozen=True)
class ParameterPrior:
    """Prior density of a parameter, the same for each of its components.

    kind: "normal" around ``value`` with the standard deviation ``width``; "concave", where ``value`` is an end of the
    range of length R: −2 log p = 2 (d − d² / 2R) / width at the distance d from it, which attracts near the value and
    not at all at the other end (the minimax concave penalty; Zhang 2010, Nearly Unbiased Variable Selection).
    vanishes_with: a scalar parameter; at its position x in its range, 0…1, the width is (1 − x²) times ``width``.
    """

    kind: str
    value: float
    width: float
    vanishes_with: str = ""

    def variance(self, values: np.ndarray, extent: float, place: np.ndarray | None = None) -> np.ndarray:
        """Return (…) the prior's variance around values (…), ∞ where its derivative is 0. extent: length of the range.

        place: (…) position of the scalar ``vanishes_with`` in that scalar's range, 0…1.
        """
        width = self.width if place is None else self.width * np.maximum(1 - place**2, MIN_PRIOR_WIDTH)
        left = 1.0 if self.kind == "normal" else 1 - np.abs(values - self.value) / extent
        with np.errstate(divide="ignore"):
            return np.square(width / left)


@dataclass(frozen=True)
class Parameter:
    """One row of a model's table.

    name: also the field of ``Material`` in GLSL. components: 1 to 4 (a normal has 3). range: (low, high), the same for
    all components. default: its value where it is neither known nor searched. kind: "search" if swarms must search it,
    "linear" if the radiance is linear in it. map: stem of its file; parameters that name the same map become its
    channels in order. color_space: "sRGB" or "Non-Color", of the 8/16-bit picture.
    socket: the shader socket it drives, "" for none. stage: the stage of a staged schedule that searches it.
    is_normal: a unit vector rather than independent numbers. prior: of a searched parameter, None for a uniform one.
    """

    name: str
    components: int = 1
    range: tuple[float, float] = (0.0, 1.0)
    default: tuple[float, ...] = (0.5,)
    kind: str = "search"
    map: str = ""
    color_space: str = "Non-Color"
    socket: str = ""
    stage: str = ""
    is_normal: bool = False
    prior: ParameterPrior | None = None

    @property
    def width(self) -> float:
        """The width of its range, the deviation of an unknown value; of a normal π / 2 radians."""
        return math.pi / 2 if self.is_normal else self.range[1] - self.range[0]

    @property
    def has_unknown(self) -> bool:
        """Whether a single deviation tells where it is unknown: for a normal or a searched scalar."""
        return self.is_normal or (self.kind == "search" and self.components == 1)

    @property
    def is_albedo(self) -> bool:
        """Whether it is a colour to which radiance is proportional: brightness limits it, a Lambert fit begins it."""
        return self.kind == "linear" and self.components == 3


@dataclass(frozen=True)
class ReflectanceModel:
    """A reflectance model: its parameters, and the shader of its BRDF.

    bases: names of the linear parameters whose basis the shader defines, and "fixed" if it defines the radiance
    without them (shaders/README.md). ordered: names of scalar parameters kept in rising order while searching
    (interchangeable lobes). complement: names of scalars that become 1 − value when the lobes are exchanged. material:
    the table [material] of the TOML, read by blender/materials/material.py: ``shader`` names a builder there. starts:
    starting points of a refinement besides the estimate.
    """

    name: str
    title: str
    shader: Path
    parameters: tuple[Parameter, ...]
    bases: frozenset[str] = frozenset()
    ordered: tuple[str, ...] = ()
    complement: tuple[str, ...] = ()
    material: dict[str, Any] = field(default_factory=dict)
    starts: tuple[Start, ...] = ()

    def parameter(self, name: str) -> Parameter:
        """Return the parameter of this name. Raises InputError that lists the names."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        names = ", ".join(p.name for p in self.parameters)
        raise InputError(f"model {self.name} has no parameter '{name}'; it has: {names}")

    @property
    def normal(self) -> str:
        """The name of the normal."""
        return next(p.name for p in self.parameters if p.is_normal)

    def without_priors(self, names: Collection[str]) -> ReflectanceModel:
        """Return the model without the priors of the named parameters."""
        parameters = tuple(replace(p, prior=None) if p.name in names else p for p in self.parameters)
        return replace(self, parameters=parameters)

    def with_ordered_lobes(self, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return maps of the same radiance, with interchangeable lobes in rising order if they have all of them."""
        result = dict(values)
        if not self.ordered or not {*self.ordered, *self.complement} <= set(values):
            return result
        first, second = (np.asarray(values[name]) for name in self.ordered)
        result |= dict(zip(self.ordered, (np.minimum(first, second), np.maximum(first, second)), strict=True))
        for name in self.complement:
            result[name] = np.where(first > second, 1 - np.asarray(values[name]), values[name])
        return result

    @property
    def components(self) -> int:
        """The number of components of all parameters together."""
        return sum(p.components for p in self.parameters)

    def offset(self, name: str) -> int:
        """Return the index of a parameter's first component among all, in the table's order. Raises KeyError."""
        position = 0
        for parameter in self.parameters:
            if parameter.name == name:
                return position
            position += parameter.components
        raise KeyError(name)


def shipped_models() -> list[str]:
    """Return the names of the models that come with the program."""
    return shipped_names(MODELS)


def load_model(name_or_path: str | Path) -> ReflectanceModel:
    """Read a shipped model by name, or a user's own by the path of its .toml file (the .glsl lies beside it).

    Their format: shaders/README.md. The shader is compiled by the recovery that uses it. Raises InputError
    naming the file, the key and the remedy.
    """
    table, path = load_shipped_table("model", name_or_path, MODELS)
    model = _model_from_table(table, path)
    if not model.shader.resolve().is_relative_to(SHADERS):
        check_names(model.shader)
    return model


def digest_of_own_model(name_or_path: str | Path) -> str | None:
    """Return the SHA-256 of a user's model, in hexadecimal digits; None for a shipped model, or without a file.

    It is that of the .toml file, the shader, and the files beside them that this includes. Raises InputError where they
    are no model.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml" or not path.is_file():
        return None
    digest = hashlib.sha256(path.read_bytes())
    for file in files_of(load_model(path).shader):
        if not file.is_relative_to(SHADERS):
            digest.update(read_glsl(file).encode())
    return digest.hexdigest()


def _model_from_table(table: dict[str, Any], path: Path) -> ReflectanceModel:
    known = {"name", "title", "source", "shader", "ordered", "complement", "parameter", "material", "start"}
    _refuse_unknown_keys(table, known, path, "the table")
    rows = table.get("parameter")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{path}: declares no [[parameter]]; add one table for each unknown of the model")
    for key in known - {"parameter", "start"}:
        _check_kind(table, key, _KIND_OF.get(key, str), str(path))
    parameters = tuple(_parameter_from_table(row, path) for row in rows)
    names = [p.name for p in parameters]
    if len(set(names)) != len(names):
        raise InputError(f"{path}: two parameters have the same name; names must differ")
    if sum(p.is_normal for p in parameters) != 1:
        raise InputError(f"{path}: exactly one parameter must have is_normal = true")
    scalars = {p.name for p in parameters if p.components == 1}
    for p in parameters:
        if p.prior is not None and p.prior.vanishes_with not in {"", *scalars} - {p.name}:
            others = ", ".join(sorted(scalars - {p.name})) or "none"
            raise InputError(f"{path}: parameter '{p.name}': prior: vanishes_with must name another scalar: {others}")
    components = sum(p.components for p in parameters)
    if components > MAX_COMPONENTS:
        raise InputError(f"{path}: {components} components in all; at most {MAX_COMPONENTS} fit")
    file = table.get("shader", path.stem + ".glsl")
    shader = path.parent / file
    if shader.parent != path.parent or not shader.is_file():
        raise InputError(f'{path}: its shader {file} is not beside it; write it there or set shader = "…"')
    ordered, complement = tuple(table.get("ordered", ())), tuple(table.get("complement", ()))
    for name in (*ordered, *complement):
        if name not in names or parameters[names.index(name)].components != 1:
            raise InputError(f"{path}: ordered and complement must name scalar parameters; '{name}' is none")
    if len(ordered) not in (0, 2) or len({parameters[names.index(n)].range for n in ordered}) > 1:
        raise InputError(f"{path}: ordered must name two parameters with the same range")
    if any(parameters[names.index(n)].range != (0.0, 1.0) for n in complement):
        raise InputError(f"{path}: a complement must have the range [0, 1]")
    name = table.get("name", path.stem)
    bases = frozenset(_BASIS.findall(read_glsl(shader)))
    return ReflectanceModel(
        name, table.get("title", name), shader, parameters, bases, ordered, complement, dict(table.get("material", {})),
        _starts_from_table(table.get("start", []), parameters, path),
    )  # fmt: skip


def _starts_from_table(rows: Any, parameters: tuple[Parameter, ...], path: Path) -> tuple[Start, ...]:
    if not isinstance(rows, list) or not all(isinstance(row, dict) and row for row in rows):
        raise InputError(f"{path}: starts are written [[start]], with two brackets, and set at least one parameter")
    names = {p.name: p for p in parameters}
    starts = []
    for row in rows:
        where = f"{path}: [[start]]"
        if unknown := sorted(set(row) - set(names)):
            raise InputError(f"{where}: '{unknown[0]}' is no parameter; set {', '.join(names)}")
        starts.append(tuple(_start_value(names[name], value, f"{where}: {name}") for name, value in row.items()))
    return tuple(starts)


def _start_value(parameter: Parameter, value: Any, where: str) -> tuple[str, tuple[float, ...]]:
    if not parameter.is_normal:
        return parameter.name, _components(value, parameter.components, parameter.range, where)
    if value != _MIRROR:
        raise InputError(f'{where}: a normal begins at "{_MIRROR}", that of the brightest light; or leave it out')
    return parameter.name, ()


def _parameter_from_table(row: dict[str, Any], path: Path) -> Parameter:
    name = row.get("name", "")
    where = f"parameter '{name}'"
    _refuse_unknown_keys(row, set(Parameter.__dataclass_fields__), path, where)
    if not isinstance(name, str) or not _IDENTIFIER.match(name):
        raise InputError(f"{path}: {where}: a name is lower-case letters, digits and _")
    if is_word(name):
        raise InputError(f"{path}: {where}: that is a word of GLSL; choose another name")
    is_normal = bool(row.get("is_normal", False))
    for key in ("kind", "map", "color_space", "socket", "stage"):
        _check_kind(row, key, str, f"{path}: {where}")
    components = row.get("components", 3 if is_normal else 1)
    if not isinstance(components, int) or not 1 <= components <= 4 or (is_normal and components != 3):
        raise InputError(f"{path}: {where}: components must be 1 to 4, and 3 for a normal")
    low, high = _two_numbers(row.get("range", (-1.0, 1.0) if is_normal else (0.0, 1.0)), path, where)
    if not low < high:
        raise InputError(f"{path}: {where}: range must rise, as in range = [0.0, 1.0]")
    if row.get("kind", "search") not in _KINDS:
        raise InputError(f"{path}: {where}: kind must be one of {', '.join(_KINDS)}")
    if row.get("color_space", "Non-Color") not in _COLOR_SPACES:
        raise InputError(f"{path}: {where}: color_space must be one of {', '.join(_COLOR_SPACES)}")
    default = row.get("default", (0.0, 0.0, 1.0) if is_normal else (low + high) / 2)
    default = _components(default, components, (low, high), f"{path}: {where}: default")
    return Parameter(
        name, components, (low, high), default, row.get("kind", "search"),
        row.get("map", name), row.get("color_space", "Non-Color"), row.get("socket", ""), row.get("stage", name),
        is_normal, _prior_from_table(row, is_normal, (low, high), f"{path}: {where}: prior"),
    )  # fmt: skip


def _prior_from_table(
    row: dict[str, Any], is_normal: bool, within: tuple[float, float], where: str
) -> ParameterPrior | None:
    table = row.get("prior")
    if table is None:
        return None
    keys = set(ParameterPrior.__dataclass_fields__)
    if not isinstance(table, dict) or not keys - {"vanishes_with"} <= set(table) <= keys:
        raise InputError(f'{where}: write prior = {{ kind = "normal", value = 0.5, width = 0.1 }}')
    if is_normal or row.get("kind", "search") != "search":
        raise InputError(f"{where}: only a searched parameter that is no normal may have one; remove it")
    kind, value, width = table["kind"], table["value"], table["width"]
    if kind not in _PRIORS:
        raise InputError(f"{where}: kind must be one of {', '.join(_PRIORS)}, not {kind!r}")
    if not _is_number(value) or not within[0] <= value <= within[1]:
        raise InputError(f"{where}: value must be a number inside the range {list(within)}, not {value!r}")
    if not _is_number(width) or width <= 0:
        raise InputError(f"{where}: width must be a number above 0, not {width!r}")
    if kind == "concave" and value not in within:
        raise InputError(f"{where}: the value of a concave prior is an end of the range {list(within)}")
    return ParameterPrior(kind, float(value), float(width), str(table.get("vanishes_with", "")))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _components(value: Any, count: int, within: tuple[float, float], where: str) -> tuple[float, ...]:
    values = tuple(value) if isinstance(value, list | tuple) else (value,) * count
    if len(values) != count or not all(isinstance(v, int | float) and within[0] <= v <= within[1] for v in values):
        raise InputError(f"{where} must be one number, or one a component, inside the range")
    return tuple(float(v) for v in values)


def _check_kind(table: dict[str, Any], key: str, kind: type, where: str) -> None:
    value = table.get(key, kind())
    if not isinstance(value, kind) or (isinstance(value, list) and not all(isinstance(item, str) for item in value)):
        raise InputError(f"{where}: {key} must be {_WORDS[kind]}, not {value!r}")


def _two_numbers(value: Any, path: Path, where: str) -> tuple[float, float]:
    numbers = value if isinstance(value, list | tuple) else ()
    if len(numbers) != 2 or not all(_is_number(v) and abs(v) <= _MOST for v in numbers):
        raise InputError(f"{path}: {where}: range must be two numbers up to {_MOST:g}, as in range = [0.0, 1.0]")
    return float(value[0]), float(value[1])


def _refuse_unknown_keys(table: dict[str, Any], known: set[str], path: Path, where: str) -> None:
    unknown = sorted(set(table) - known)
    if unknown:
        raise InputError(f"{path}: {where}: unknown key '{unknown[0]}'; known are {', '.join(sorted(known))}")
