"""GLSL declarations generated from a model's table of parameters: packing of components, and priors."""

from __future__ import annotations

from .model import MAX_COMPONENTS, MIN_PRIOR_WIDTH, ReflectanceModel

_ROOM = f"[{MAX_COMPONENTS}]"
_TYPES = {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}


def material_declaration(model: ReflectanceModel) -> str:
    """Return the GLSL of ``struct Material``, one field per parameter, and of its packing and unpacking.

    ``Material material_from(inout float c[12])`` and ``void material_to(Material s, out float c[12])`` keep the order;
    arrays are passed by reference: Metal has none by value.
    """
    fields = [f"    {_TYPES[p.components]} {p.name};" for p in model.parameters]
    unpack, pack = [], [f"    for (int i = 0; i < {MAX_COMPONENTS}; i++) {{ c[i] = 0.0; }}"]
    for p in model.parameters:
        at = model.offset(p.name)
        arguments = ", ".join(f"c[{at + i}]" for i in range(p.components))
        unpack.append(f"    s.{p.name} = {_TYPES[p.components]}({arguments});")
        pack += [f"    c[{at + i}] = s.{p.name}{f'[{i}]' if p.components > 1 else ''};" for i in range(p.components)]
    lines = ["struct Material {", *fields, "};"]
    lines += [f"Material material_from(inout float c{_ROOM}) {{", "    Material s;", *unpack, "    return s;", "}"]
    lines += [f"void material_to(Material s, out float c{_ROOM}) {{", *pack, "}", ""]
    return "\n".join(lines)


def prior_declaration(model: ReflectanceModel) -> str:
    """Return the GLSL of PRIORS, the number of components with a prior, and of functions of the priors.

    ``float prior_deviance(inout float c[12])`` is −2 log of their densities, up to a constant. ``void prior_derivatives
    (inout float c[12], out float gradient[12], out float curvature[12])`` gives half its first and half its second
    derivatives. ``float prior_precision(inout float c[12], int component)`` is 1 over its variance; 0 for a concave
    one, which selects among values that the samples do not determine, but makes none of them certain.
    """
    deviances, derivatives, precisions = [], [], []
    for p in model.parameters:
        if p.prior is None:
            continue
        value, width, extent = p.prior.value, p.prior.width, p.width
        along = model.parameter(p.prior.vanishes_with) if p.prior.vanishes_with else None
        for i in range(model.offset(p.name), model.offset(p.name) + p.components):
            lines = [f"float d = c[{i}] - {value!r};", f"float w = {width!r};"]
            if along is not None:
                at, (low, high) = model.offset(along.name), along.range
                lines.append(f"float x = (c[{at}] - {low!r}) * {1 / (high - low)!r};")
                lines.append(f"w *= max(1.0 - x * x, {MIN_PRIOR_WIDTH!r});")
            if p.prior.kind == "normal":
                deviance, gradient, curvature = "d * d / (w * w)", "d / (w * w)", "1.0 / (w * w)"
                precisions.append([*lines, f"if (component == {i}) {{ return {curvature}; }}"])
            else:
                side = 1.0 if value == p.range[0] else -1.0
                left = f"(1.0 - abs(d) * {1 / extent!r})"
                deviance = f"2.0 * (abs(d) - d * d * {0.5 / extent!r}) / w"
                gradient, curvature = f"{side!r} * {left} / w", "0.0"
            deviances.append([*lines, f"sum += {deviance};"])
            differentiated = [*lines, f"gradient[{i}] += {gradient};", f"curvature[{i}] += {curvature};"]
            if along is not None:  # d(1 / wᵏ) = k / wᵏ · 2 x / (1 − x²) dx
                power = 2.0 if p.prior.kind == "normal" else 1.0
                differentiated.append(
                    f"gradient[{at}] += {power / (high - low)!r} * ({deviance}) * x"
                    f" / max(1.0 - x * x, {MIN_PRIOR_WIDTH!r});"
                )
            derivatives.append(differentiated)

    def blocks(parts: list[list[str]]) -> list[str]:
        return [line for part in parts for line in ("    {", *(f"        {x}" for x in part), "    }")]

    lines = [
        f"#define PRIORS {len(deviances)}",
        f"float prior_deviance(inout float c{_ROOM})", "{", "    float sum = 0.0;", *blocks(deviances),
        "    return sum;", "}",
        f"void prior_derivatives(inout float c{_ROOM}, out float gradient{_ROOM}, out float curvature{_ROOM})", "{",
        f"    for (int i = 0; i < {MAX_COMPONENTS}; i++) {{ gradient[i] = 0.0; curvature[i] = 0.0; }}",
        *blocks(derivatives), "}",
        f"float prior_precision(inout float c{_ROOM}, int component)", "{", *blocks(precisions),
        "    return 0.0;", "}", "",
    ]  # fmt: skip
    return "\n".join(lines)
