"""The table of parameters, written as GLSL declarations for the kernels that use it."""

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
