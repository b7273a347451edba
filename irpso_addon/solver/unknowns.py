"""The numbers that a model leaves to be found, of all its parameters at once, as GLSL."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from ..reflectance.model import Parameter, ReflectanceModel, Start

NORMAL_RANGE = math.pi / 2  # radians: what is said of a normal about which the observations say nothing


@dataclass(frozen=True)
class Unknowns:
    """The numbers that a model leaves to be found. count: a normal is two. source: their table, as GLSL."""

    count: int
    source: str
    defines: dict[str, int]


def build_unknowns(model: ReflectanceModel, known: Collection[str]) -> Unknowns:
    """Return the unknowns of a model of which the parameters named ``known`` are given."""
    rows: list[tuple[int, float, float]] = []
    defines = {"NORMAL_UNKNOWN": -1}
    for p in _unknown(model, known):
        at = model.offset(p.name)
        if p.is_normal:
            defines = {"NORMAL_UNKNOWN": len(rows), "NORMAL_COMPONENT": at}
            rows += [(at, 0.0, NORMAL_RANGE)] * 2
        else:
            rows += [(at + i, p.range[0], p.range[1] - p.range[0]) for i in range(p.components)]
    cases = [f"    if (u == {u}) {{ component = {at}; low = {low!r}; width = {width!r}; }}"
             for u, (at, low, width) in enumerate(rows)]  # fmt: skip
    source = "\n".join(
        ["void unknown_at(int u, out int component, out float low, out float width)", "{",
         "    component = 0; low = 0.0; width = 1.0;", *cases, "}", ""]
    )  # fmt: skip
    return Unknowns(len(rows), source, defines | {"UNKNOWNS": len(rows)})


def build_slopes(model: ReflectanceModel, known: Collection[str]) -> Unknowns:
    """Return the unknowns with ``stepped_at(i)``, ``searched(u)`` and ``linear_slopes(s, l, v, slopes)`` beside them.

    STEPPED unknowns, those of stepped_at, have no derivative but by differences; SEARCHED are those that are no normal.
    linear_slopes tells the derivative of the others, which is their basis, times the width of their range. LOBE_… name
    the components of interchangeable lobes.
    """
    unknowns = build_unknowns(model, known)
    stepped, searched, slopes, u = [], [], [], 0
    for p in _unknown(model, known):
        count = 2 if p.is_normal else p.components
        if p.kind == "linear" and p.name in model.bases and p.components in (1, 3):
            slopes.append(f"    basis = {p.range[1] - p.range[0]!r} * basis_{p.name}(s, l, v);")
            slopes += [f"    slopes[{u + i}] = {_channel(i, p.components)};" for i in range(p.components)]
        else:
            stepped += range(u, u + count)
            searched += [] if p.is_normal else range(u, u + count)
        u += count
    cases = [f"    unknown = i == {i} ? {u} : unknown;" for i, u in enumerate(stepped)]
    source = "\n".join(
        [unknowns.source, "int stepped_at(int i)", "{", "    int unknown = 0;", *cases, "    return unknown;", "}",
         "bool searched(int u)", "{", f"    return {' || '.join(f'u == {u}' for u in searched) or 'false'};", "}",
         "void linear_slopes(Material s, vec3 l, vec3 v, inout vec3 slopes[UNKNOWNS])", "{",
         "    vec3 basis = vec3(0.0);", *slopes, "}", ""]
    )  # fmt: skip
    defines = unknowns.defines | {"STEPPED": len(stepped), "STEPPED_ROOM": max(1, len(stepped))}
    defines["SEARCHED"] = len(searched)
    names = (*model.ordered, *model.complement)
    if model.ordered and not set(names) & set(known):
        first, second = (model.offset(name) for name in model.ordered)
        defines |= {"LOBE_FIRST": first, "LOBE_SECOND": second}
        if model.complement:
            defines["LOBE_WEIGHT"] = model.offset(model.complement[0])
    return Unknowns(unknowns.count, source, defines)


def build_starts(model: ReflectanceModel, starts: Sequence[Start]) -> str:
    """Return ``void take_start(int start, inout float c[12])``, which puts a start's values in; −1 leaves all."""
    lines = [
        f"    if (start == {k}) {{ {' '.join(sets)} }}"
        for k, start in enumerate(starts)
        if (sets := [f"c[{model.offset(name) + i}] = {v!r};" for name, row in start for i, v in enumerate(row)])
    ]
    return "\n".join(["void take_start(int start, inout float c[12])", "{", *lines, "}", ""])


def _unknown(model: ReflectanceModel, known: Collection[str]) -> list[Parameter]:
    return [p for p in model.parameters if p.name not in known]


def _channel(i: int, components: int) -> str:
    """A colour's weight multiplies its own channel of the basis, a number all of them."""
    if components == 1:
        return "basis"
    return f"vec3({', '.join(f'basis.{channel}' if k == i else '0.0' for k, channel in enumerate('rgb'))})"
