"""Parameters that are solved in closed form, and the GLSL of their bases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...core.errors import InputError
from ...core.files import defined
from ...gpu.kernel import Packed
from ...reflectance.model import Parameter, ReflectanceModel

MAX_WEIGHTS = int(defined("common/limits.glsl", "MAX_")["WEIGHTS"])


@dataclass(frozen=True)
class LinearWeights:
    """The parameters solved in closed form, and the GLSL that shaders/fitness/linear.glsl includes for them.

    colors: of three components, each of which multiplies its own channel. numbers: of one. source: basis.glsl.
    """

    colors: tuple[Parameter, ...]
    numbers: tuple[Parameter, ...]
    source: str

    @property
    def components(self) -> int:
        """Their number of components."""
        return 3 * len(self.colors) + len(self.numbers)

    @property
    def blocks(self) -> int:
        """Number of RGBA texels that hold them."""
        return -(-self.components // 4)

    @property
    def packed(self) -> Packed:
        """Their layout in textures."""
        return Packed(self.blocks, MAX_WEIGHTS)

    @property
    def defines(self) -> dict[str, int]:
        """The constants of the kernels; GLSL arrays have at least one element."""
        colors, numbers = len(self.colors), len(self.numbers)
        return {
            "COLORS": colors,
            "NUMBERS": numbers,
            "COLOR_ROOM": max(1, colors),
            "NUMBER_ROOM": max(1, numbers),
            "LINEAR_BLOCKS": self.blocks,
        }


def linear_weights(model: ReflectanceModel, solved: Sequence[Parameter]) -> LinearWeights:
    """Return the closed form of the parameters ``solved``; the model's other linear parameters stay fixed.

    Raises InputError where they are too many, or have neither one component nor three.
    """
    colors = tuple(p for p in solved if p.components == 3)
    numbers = tuple(p for p in solved if p.components == 1)
    if unsupported := [p.name for p in solved if p.components not in (1, 3)]:
        raise InputError(f"model {model.name}: linear parameter '{unsupported[0]}' must have one component or three")
    weights = LinearWeights(colors, numbers, _source(model, colors, numbers))
    if weights.components > MAX_WEIGHTS:
        raise InputError(
            f"model {model.name}: {weights.components} linear components, at most {MAX_WEIGHTS} are solved in closed"
            " form; fix some (--fixed), or search them with linear = \"search\""
        )  # fmt: skip
    return weights


def _source(model: ReflectanceModel, colors: Sequence[Parameter], numbers: Sequence[Parameter]) -> str:
    solved = {p.name for p in (*colors, *numbers)}
    fixed = [p for p in model.parameters if p.name in model.bases and p.name not in solved]
    rest = ["basis_fixed(s, l, v)"] if "fixed" in model.bases else []
    rest += [f"s.{p.name} * basis_{p.name}(s, l, v)" for p in fixed]
    bases, ranges, assign, clear, pack, unpack = [], [], [], [], [], []
    for kind, chosen in (("color", colors), ("number", numbers)):
        zero = "vec3(0.0)" if kind == "color" else "0.0"
        if not chosen:
            bases.append(f"    {kind}s[0] = vec3(0.0);")
            ranges.append(f"    {kind}_range[0] = vec2(0.0);")
            clear.append(f"    w.{kind}s[0] = {zero};")
        for i, p in enumerate(chosen):
            bases.append(f"    {kind}s[{i}] = basis_{p.name}(s, l, v);")
            ranges.append(f"    {kind}_range[{i}] = vec2({p.range[0]!r}, {p.range[1]!r});")
            clear.append(f"    w.{kind}s[{i}] = {zero};")
            assign.append(f"    s.{p.name} = w.{kind}s[{i}];")
            at = 3 * i if kind == "color" else 3 * len(colors) + i
            for c in range(p.components):
                part = f"[{c}]" if p.components > 1 else ""
                pack.append(f"    x[{at + c}] = w.{kind}s[{i}]{part};")
                unpack.append(f"    s.{p.name}{part} = x[{at + c}];")
    lines = [
        '#include "material.glsl"', '#include "model.glsl"', '#include "fitness/linear_types.glsl"',
        "void basis_at(Material s, vec3 l, vec3 v, out vec3 colors[COLOR_ROOM], out vec3 numbers[NUMBER_ROOM],",
        "              out vec3 rest) {", *bases, f"    rest = {' + '.join(rest) or 'vec3(0.0)'};", "}",
        "void linear_range(out vec2 color_range[COLOR_ROOM], out vec2 number_range[NUMBER_ROOM]) {", *ranges, "}",
        "void linear_to(Linear w, inout Material s) {", *assign, "}",
        "void clear_linear(out Linear w) {", *clear, "}",
        "void numbers_of(Linear w, out float x[MAX_WEIGHTS]) {",
        "    for (int i = 0; i < MAX_WEIGHTS; i++) { x[i] = 0.0; }", *pack, "}",
        "void linear_from(inout float x[MAX_WEIGHTS], inout Material s) {", *unpack, "}", "",
    ]  # fmt: skip
    return "\n".join(lines)
