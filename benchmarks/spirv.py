"""Counts a kernel's arithmetic operations and fetches per texel in its optimised SPIR-V.

Needs glslangValidator and spirv-opt (Debian: glslang-tools, spirv-tools). All branches count, as in a divergent group
of threads; a loop counts as often as its bounds say, one whose bound is another's counter half as often as that.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from irpso_addon.gpu.kernel import Kernel
from irpso_addon.gpu.library import read_source
from irpso_addon.gpu.program import source_of

_SAMPLERS = {"FLOAT_2D": "sampler2D", "FLOAT_2D_ARRAY": "sampler2DArray"}
_CONSTANTS = {"INT": "int", "FLOAT": "float"}
_MARK = re.compile(r"^#line .*$", re.M)
_LINE = re.compile(r"(?:(%\S+) = )?(Op\w+)(.*)")
_PLAIN = re.compile(
    r"Op([FSIU](Add|Sub|Mul|Negate|Mod|Rem|LessThan|GreaterThan|LessThanEqual|GreaterThanEqual|Equal|NotEqual)"
    r"|FOrd\w+|FUnord\w+|Select|VectorTimesScalar|Convert\w+|Not|IsNan|IsInf|(Bitwise|Logical|Shift)\w+)"
)
_SPECIAL = 4  # operations of a root or an exponential: GPUs have a quarter as many units for them
_DIVISION = _SPECIAL + 1  # a reciprocal and a product
# Operations a component of a function; one (min, max, abs, floor, …) if it is not listed.
_FUNCTIONS = {
    "Sqrt": _SPECIAL, "InverseSqrt": _SPECIAL, "Exp2": _SPECIAL, "Log2": _SPECIAL, "Sin": _SPECIAL, "Cos": _SPECIAL,
    "Exp": _SPECIAL + 1, "Log": _SPECIAL + 1, "Pow": 2 * _SPECIAL + 1, "Tan": 2 * _SPECIAL + _DIVISION, "Atan": 12,
    "Atan2": 12 + _DIVISION, "Acos": 12, "Asin": 12, "FMix": 3, "Fma": 2, "FClamp": 2, "SClamp": 2, "SmoothStep": 9,
}  # fmt: skip


@dataclass(frozen=True)
class Counts:
    """Work at one texel. operations: of scalars. fetches: sampler → texels read from it."""

    operations: float = 0.0
    fetches: Mapping[str, float] = field(default_factory=dict)


def counts(kernel: Kernel, *known: Mapping[str, int | float]) -> list[Counts]:
    """Return a kernel's work at one texel of its targets, for each set of values that bound its loops.

    known: constants by name, and the widths of textures by the names of their samplers. Raises CalledProcessError,
    FileNotFoundError without the tools, ValueError for loops with other bounds.
    """
    text = _disassembled(_fragment(kernel))
    return [_Module(text, each).counts() for each in known]


def _fragment(kernel: Kernel) -> str:
    """Return a kernel as plain GLSL, with the declarations that Blender adds."""
    source = source_of(kernel)
    samplers, constants = kernel.declared(source), kernel.needed(source)
    lines = ["#version 450", *(f"#define {name} {value}" for name, value in kernel.defines.items())]
    lines += [
        f"layout(binding = {slot}) uniform {_SAMPLERS[kind]} {name};"
        for slot, (name, kind) in enumerate(samplers.items())
    ]
    if constants:
        members = "".join(f"{_CONSTANTS[kind]} {name}; " for name, kind in constants.items())
        lines.append(f"layout(push_constant) uniform Constants {{ {members}}};")
    for slot, (name, texture_format) in enumerate(kernel.targets):
        lines.append(f"layout(location = {slot}) out {'float' if texture_format == 'R32F' else 'vec4'} {name};")
    return _MARK.sub("", "\n".join([*lines, source, read_source("common/entry_fragment.glsl")]))


def _disassembled(fragment: str) -> str:
    """Compile, inline and optimise GLSL; return the SPIR-V as text. Raises CalledProcessError."""
    with tempfile.TemporaryDirectory() as folder:
        text, compiled, optimised = (Path(folder) / name for name in ("kernel.frag", "compiled.spv", "optimised.spv"))
        text.write_text(fragment, encoding="utf-8")
        for command in (
            ["glslangValidator", "-V", "-o", compiled, text],
            ["spirv-opt", "-O", compiled, "-o", optimised],
        ):
            subprocess.run(command, check=True, stdout=subprocess.PIPE)
        shown = ["spirv-dis", "--no-indent", "--raw-id", optimised]
        return subprocess.run(shown, check=True, stdout=subprocess.PIPE, text=True).stdout


@dataclass(frozen=True)
class _Instruction:
    result: str
    name: str
    operands: tuple[str, ...]


class _Module:
    """A SPIR-V module of one function. known: values of push constants, and widths of textures."""

    def __init__(self, text: str, known: Mapping[str, int | float]):
        self.known = known
        self.blocks: dict[str, list[_Instruction]] = {}
        self.defined: dict[str, _Instruction] = {}
        self.names: dict[tuple[str, ...], str] = {}
        block: list[_Instruction] | None = None
        for line in text.splitlines():
            if not (match := _LINE.match(line)):
                continue
            instruction = _Instruction(match[1] or "", match[2], tuple(match[3].split()))
            self.defined[instruction.result] = instruction
            if instruction.name in ("OpName", "OpMemberName"):
                self.names[instruction.operands[:-1]] = instruction.operands[-1].strip('"')
            elif instruction.name == "OpLabel":
                block = self.blocks[instruction.result] = []
            elif block is not None:
                block.append(instruction)

    def counts(self) -> Counts:
        """Return the sums over all blocks, each times the trips of the loops around it."""
        operations, fetches = 0.0, Counter[str]()
        for label, block in self.blocks.items():
            times = 1.0
            for header, body in self.loops.items():
                times *= self.trips(header) if label in body else 1.0
            for each in block:
                if each.name == "OpImageFetch":
                    fetches[self._sampler(each.operands[1])] += times
                else:
                    operations += times * self._operations(each)
        return Counts(operations, dict(fetches))

    @cached_property
    def loops(self) -> dict[str, set[str]]:
        """Header → the blocks that lead back to it, itself included."""
        before: dict[str, set[str]] = {label: set() for label in self.blocks}
        for label, block in self.blocks.items():
            for target in block[-1].operands:
                if target in before:
                    before[target].add(label)
        bodies = {}
        for header, block in self.blocks.items():
            if merge := next((each for each in block if each.name == "OpLoopMerge"), None):
                body, ahead = {header}, [merge.operands[1]]
                while ahead:
                    if (label := ahead.pop()) not in body:
                        body.add(label)
                        ahead += before[label]
                bodies[header] = body
        return bodies

    def trips(self, header: str) -> float:
        """Return how often the body of a loop runs. Raises ValueError if its bounds are not known."""
        block = self.blocks[header]
        if block[-1].name == "OpBranch":
            block = self.blocks[block[-1].operands[0]]
        test = self.defined[block[-1].operands[0]]
        counter = self.defined.get(test.operands[1]) if len(test.operands) > 2 else None
        if counter is None or counter.name != "OpPhi":
            raise ValueError(f"a loop that ends by {test.name} is not counted")
        into = dict(zip(counter.operands[2::2], counter.operands[1::2], strict=True))
        start = next(self._value(value) for label, value in into.items() if label not in self.loops[header])
        step = next(self.defined[value] for label, value in into.items() if label in self.loops[header])
        closed = test.name.endswith("Equal")
        return (abs(self._value(test.operands[2]) - start) + closed) / abs(self._value(step.operands[2]))

    def _value(self, name: str) -> float:
        """Return a constant's value; the mean of another loop's counter; of other phis the largest input."""
        instruction = self.defined[name]
        if instruction.name == "OpConstant":
            return float(instruction.operands[1])
        if instruction.name == "OpLoad" and (name := self._push_constant(self.defined[instruction.operands[1]])):
            return float(self.known[name])
        if (
            instruction.name == "OpCompositeExtract"
            and self.defined[instruction.operands[1]].name == "OpImageQuerySizeLod"
        ):
            return float(self.known[self._sampler(self.defined[instruction.operands[1]].operands[1])])
        if instruction.name in ("OpIAdd", "OpISub"):
            left, right = (self._value(operand) for operand in instruction.operands[1:])
            return left + right if instruction.name == "OpIAdd" else left - right
        if instruction.name == "OpPhi":
            header = next((h for h, block in self.blocks.items() if instruction in block and h in self.loops), None)
            if header is not None:
                return (self.trips(header) - 1) / 2
            return max(self._value(value) for value in instruction.operands[1::2])
        raise ValueError(f"a loop's bound by {instruction.name} is not known")

    def _push_constant(self, pointer: _Instruction) -> str | None:
        """Return the name of a pointer's push constant, or None."""
        block = self.defined[self.defined[pointer.operands[1]].operands[0]]
        if pointer.name != "OpAccessChain" or block.operands[0] != "PushConstant":
            return None
        return self.names[block.operands[1], str(int(self._value(pointer.operands[2])))]

    def _sampler(self, name: str) -> str:
        """Return the name of the sampler of a fetched image."""
        while (instruction := self.defined[name]).name != "OpVariable":
            name = instruction.operands[1]
        return self.names[(name,)]

    def _components(self, name: str) -> int:
        instruction = self.defined[name]
        return int(instruction.operands[1]) if instruction.name == "OpTypeVector" else 1

    def _operations(self, each: _Instruction) -> float:
        if not each.operands:
            return 0
        kind = each.operands[0]
        if each.name == "OpDot":
            return 2 * self._components(self.defined[each.operands[1]].operands[0]) - 1
        if each.name in ("OpFDiv", "OpSDiv", "OpUDiv"):
            return _DIVISION * self._components(kind)
        if each.name == "OpExtInst":
            return self._function(each.operands[2], kind, each.operands[3])
        return self._components(kind) if _PLAIN.fullmatch(each.name) else 0

    def _function(self, name: str, kind: str, argument: str) -> float:
        size = self._components(self.defined[argument].operands[0])
        if name == "Cross":
            return 9
        if name in ("Length", "Normalize"):
            return 2 * size - 1 + _SPECIAL + (size if name == "Normalize" else 0)
        return _FUNCTIONS.get(name, 1) * self._components(kind)
