"""The unknowns of a model, of all free parameters jointly, as GLSL."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from ...reflectance.model import Parameter, ReflectanceModel, Start


@dataclass(frozen=True)
class FreeParameters:
    """The unknowns of a model. count: a normal counts as two.

    source: GLSL of their table, and of the predicate for searched unknowns.
    """

    count: int
    source: str
    defines: dict[str, int]


def build_free_parameters(model: ReflectanceModel, fixed: Collection[str]) -> FreeParameters:
    """Return the free parameters of a model: all but those named ``fixed``.

    ``FreeParameter free_at(int u)`` gives component, low end and width of its range. The normal is two numbers, from
    NORMAL_FREE on (−1 if it is fixed), of the component NORMAL_COMPONENT. ``bool searched(int u)``: u is neither of
    the normal (``is_normal``) nor linear; SEARCHED is their count.
    """
    rows: list[tuple[int, float, float]] = []
    searched: list[int] = []
    normal: list[int] = []
    defines = {"NORMAL_FREE": -1}
    for p in _free(model, fixed):
        at = model.offset(p.name)
        if p.is_normal:
            defines = {"NORMAL_FREE": len(rows), "NORMAL_COMPONENT": at}
            normal = [len(rows), len(rows) + 1]
            rows += [(at, 0.0, p.width)] * 2
        else:
            searched += [] if has_basis(p, model) else range(len(rows), len(rows) + p.components)
            rows += [(at + i, p.range[0], p.width) for i in range(p.components)]
    cases = [
        f"    if (u == {u}) {{ free.at = {at}; free.low = {low}; free.width = {width}; }}"
        for u, (at, low, width) in enumerate(rows)
    ]
    source = "\n".join(
        ["struct FreeParameter {", "    int at;", "    float low;", "    float width;", "};",
         "FreeParameter free_at(int u)", "{",
         "    FreeParameter free;", "    free.at = 0;", "    free.low = 0.0;", "    free.width = 1.0;",
         *cases, "    return free;", "}",
         *_predicate("is_normal", normal), *_predicate("searched", searched), ""]
    )  # fmt: skip
    return FreeParameters(len(rows), source, defines | {"FREE_COUNT": len(rows), "SEARCHED": len(searched)})


def build_jacobian(
    model: ReflectanceModel, fixed: Collection[str], central_differences: bool
) -> tuple[FreeParameters, str]:
    """Return the unknowns, and jacobian.glsl: sums of the normal equations.

    STEPPED counts unknowns that are differentiated numerically: normals and searched ones. The derivative of the others
    is their basis. central_differences: else forward ones. LOBE_…: the components of interchangeable lobes.

    jacobian.glsl has no loops: a compiler that does not unroll a loop over arrays copies whole arrays at every
    observation, which took half of a step's time.
    """
    free = build_free_parameters(model, fixed)
    stepped: list[int] = []
    channels: list[str] = []
    lines = ["vec3 basis = vec3(0.0);"]
    for p in _free(model, fixed):
        u, count = len(channels), 2 if p.is_normal else p.components
        if has_basis(p, model):
            lines.append(f"basis = {p.width!r} * basis_{p.name}(s, l, v);")
            lines += [f"vec3 j_{u + i} = basis;" for i in range(p.components)]
            # The derivative by a component of a colour is 0 in the other channels.
            channels += [""] if p.components == 1 else list("rgb")
        else:
            for i in range(u, u + count):
                other = f"reflectance(p.behind_{i}, l, v)" if central_differences else "render"
                lines.append(f"vec3 j_{i} = (reflectance(p.ahead_{i}, l, v) - {other}) / p.by_{i};")
            stepped += range(u, u + count)
            channels += [""] * count
    defines = free.defines | {"STEPPED": len(stepped)}
    names = (*model.ordered, *model.complement)
    if model.ordered and not set(names) & set(fixed):
        first, second = (model.offset(name) for name in model.ordered)
        defines |= {"LOBE_FIRST": first, "LOBE_SECOND": second}
        if model.complement:
            defines["LOBE_WEIGHT"] = model.offset(model.complement[0])
    return FreeParameters(free.count, free.source, defines), _jacobian(stepped, central_differences, lines, channels)


def _jacobian(
    stepped: Sequence[int], central_differences: bool, columns: Sequence[str], channels: Sequence[str]
) -> str:
    n = len(channels)
    pairs = [(row, column) for row in range(n) for column in range(row, n)]
    sides = ("ahead", "behind") if central_differences else ("ahead",)
    steps = [f"float by_{u};" for u in stepped] + [f"Material {side}_{u};" for u in stepped for side in sides]
    sums = [f"float gradient_{i};" for i in range(n)] + [f"float a_{row}_{column};" for row, column in pairs]
    steps_taken = [f"p.by_{u} = stride_of(c, {u});" for u in stepped]
    steps_taken += [f"p.ahead_{u} = moved(c, {u}, p.by_{u});" for u in stepped]
    if central_differences:
        steps_taken += [f"p.behind_{u} = moved(c, {u}, -p.by_{u}); p.by_{u} *= 2.0;" for u in stepped]
    clears = [f"n.gradient_{i} = 0.0;" for i in range(n)] + [f"n.a_{row}_{column} = 0.0;" for row, column in pairs]
    copies = [f"gradient[{i}] = n.gradient_{i};" for i in range(n)]
    copies += [f"a[{row * n + column}] = n.a_{row}_{column};" for row, column in pairs]
    parts = [
        ("struct Steps", ["float none;", *steps]),
        ("struct NormalSums", sums),
        ("void take_steps(inout float c[MAX_COMPONENTS], inout Steps p)", steps_taken),
        ("void clear_sums(out NormalSums n)", clears),
        (
            "void sums_to(NormalSums n, inout float a[FREE_COUNT * FREE_COUNT], inout float gradient[FREE_COUNT])",
            copies,
        ),
        (
            "void add_jacobian(Material s, Steps p, vec3 render, vec3 l, vec3 v, vec3 once, vec3 twice,"
            " inout NormalSums n)",
            [*columns, "vec3 weighted = vec3(0.0);", *_products(channels)],
        ),
    ]
    lines = ['#include "fitness/differences.glsl"', '#include "model.glsl"']
    for head, body in parts:
        lines += [head, "{", *(f"    {line}" for line in body), "};" if head.startswith("struct") else "}"]
    return "\n".join([*lines, ""])


def _products(channels: Sequence[str]) -> list[str]:
    """Return lines that add products of J's columns. Columns of two channels have none; "" stands for all channels."""
    lines = []
    for row, channel in enumerate(channels):
        part = f".{channel}" if channel else ""
        lines.append(f"n.gradient_{row} += {_product('once', f'j_{row}', channel)};")
        lines.append(f"weighted{part} = twice{part} * j_{row}{part};")
        for column in range(row, len(channels)):
            if not (channel and channels[column]) or channel == channels[column]:
                product = _product("weighted", f"j_{column}", channel or channels[column])
                lines.append(f"n.a_{row}_{column} += {product};")
    return lines


def _product(a: str, b: str, channel: str) -> str:
    return f"{a}.{channel} * {b}.{channel}" if channel else f"dot({a}, {b})"


def build_starts(model: ReflectanceModel, starts: Sequence[Start]) -> str:
    """Return the GLSL of ``take_start(start, c)``, which sets the values of a start; −1 sets none.

    ``bool mirrors(int start)``: whether the start turns the normal to the brightest sample's mirror direction.
    """
    lines = [
        f"    if (start == {k}) {{ {' '.join(sets)} }}"
        for k, start in enumerate(starts)
        if (sets := [f"c[{model.offset(name) + i}] = {v!r};" for name, row in start if row for i, v in enumerate(row)])
    ]
    turned = [k for k, start in enumerate(starts) if not all(row for _, row in start)]
    mirroring = " || ".join(f"start == {k}" for k in turned) or "false"
    return "\n".join(
        ["void take_start(int start, inout float c[MAX_COMPONENTS])", "{", *lines, "}",
         "bool mirrors(int start)", "{", f"    return {mirroring};", "}", ""]
    )  # fmt: skip


def _predicate(name: str, numbers: Sequence[int]) -> list[str]:
    """Return the lines of ``bool name(int u)``: whether u is one of the numbers."""
    return [f"bool {name}(int u)", "{", f"    return {' || '.join(f'u == {u}' for u in numbers) or 'false'};", "}"]


def has_basis(p: Parameter, model: ReflectanceModel) -> bool:
    """Return whether a parameter's derivative is a basis function, and linear least squares give its optimum."""
    return p.kind == "linear" and p.name in model.bases and p.components in (1, 3)


def _free(model: ReflectanceModel, fixed: Collection[str]) -> list[Parameter]:
    return [p for p in model.parameters if p.name not in fixed]
