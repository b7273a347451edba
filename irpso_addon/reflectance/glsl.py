"""The table of parameters, written as GLSL declarations for the kernels that use it: components and priors."""

from __future__ import annotations

from .model import ReflectanceModel

_TYPES = {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}


def material_declaration(model: ReflectanceModel) -> str:
    """Return ``struct Material``, one field a parameter, and the functions that pack and unpack components.

    ``Material material_from(inout float c[12])`` and ``void material_to(Material s, out float c[12])`` keep the order;
    arrays go by reference, since Metal has none by value.
    """
    fields = [f"    {_TYPES[p.components]} {p.name};" for p in model.parameters]
    unpack, pack = [], ["    for (int i = 0; i < 12; i++) { c[i] = 0.0; }"]
    for p in model.parameters:
        at = model.offset(p.name)
        arguments = ", ".join(f"c[{at + i}]" for i in range(p.components))
        unpack.append(f"    s.{p.name} = {_TYPES[p.components]}({arguments});")
        pack += [f"    c[{at + i}] = s.{p.name}{f'[{i}]' if p.components > 1 else ''};" for i in range(p.components)]
    lines = ["struct Material {", *fields, "};"]
    lines += ["Material material_from(inout float c[12]) {", "    Material s;", *unpack, "    return s;", "}"]
    lines += ["void material_to(Material s, out float c[12]) {", *pack, "}", ""]
    return "\n".join(lines)


def prior_declaration(model: ReflectanceModel) -> str:
    """Return PRIORS, how many components have a prior, and what the priors say.

    ``float prior_deviance(Material s)`` is −2 log of their densities, up to a constant. ``void prior_slope(int
    component, float x, out float slope, out float curvature)`` gives half its first and half its second derivative,
    ``float prior_precision(int component)`` 1 over its variance.
    """
    terms, slopes, precisions = ["0.0"], [], []
    for p in model.parameters:
        if p.prior is None:
            continue
        value, width = p.prior.value, p.prior.width
        for i in range(p.components):
            away = f"(s.{p.name}{f'[{i}]' if p.components > 1 else ''} - {value!r})"
            if p.prior.kind == "normal":
                terms.append(f"{away} * {away} * {1 / width**2!r}")
                slope, curvature = f"(x - {value!r}) * {1 / width**2!r}", 1 / width**2
            else:
                side = 1.0 if value == p.range[0] else -1.0
                terms.append(f"{away} * {2 * side / width!r}")
                slope, curvature = repr(side / width), 0.0
            here = f"    if (component == {model.offset(p.name) + i})"
            slopes.append(f"{here} {{ slope = {slope}; curvature = {curvature!r}; }}")
            precisions.append(f"{here} {{ return {1 / width**2!r}; }}")
    lines = [
        f"#define PRIORS {len(slopes)}", "float prior_deviance(Material s)", "{", f"    return {' + '.join(terms)};", "}",
        "void prior_slope(int component, float x, out float slope, out float curvature)", "{",
        "    slope = 0.0; curvature = 0.0;", *slopes, "}",
        "float prior_precision(int component)", "{", *precisions, "    return 0.0;", "}", "",
    ]  # fmt: skip
    return "\n".join(lines)
