"""Kernels: GLSL for one texel, with declarations of its inputs, outputs, constants and includes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from ..core.files import defined

Entry = Literal["fragment", "compute"]
EntryChoice = Entry | Literal["auto"]  # auto: whichever the probe finds faster
MAX_COMPONENTS = int(defined("common/limits.glsl", "MAX_")["COMPONENTS"])
MAX_OUTPUTS = 6  # colour attachments that every supported device and version has


@dataclass(frozen=True)
class Packed:
    """Numbers of a texel, four to an RGBA32F texture: NAME_0, NAME_1, … of ``textures``. room: of their array in GLSL.

    A kernel that samples u_NAME has ``void read_NAME(ivec2 texel, out float c[room])``, 0 beyond the last texture; one
    that puts out o_NAME has ``void write_NAME(inout float c[room])``.
    """

    textures: int
    room: int = MAX_COMPONENTS


@dataclass(frozen=True)
class Output:
    """An output of a kernel: the GLSL variable's name and the texture's format (R32F, RGBA32F, RGBA16F, or Packed)."""

    name: str
    format: str | Packed = "RGBA32F"


Samplers = Mapping[str, str | Packed]
Defines = Mapping[str, str | int | float]
Includes = Mapping[str, str | Path]


@dataclass(frozen=True)
class Kernel:
    """A kernel: the file with ``bool texel_kernel(ivec2 texel)``, which returns false to leave a texel as it was.

    The function is not called kernel because that is a keyword of Metal, into which Blender translates it on macOS.
    source: path under shaders/ or of the user's own. outputs: at most 6 textures, all of one size. samplers: name →
    FLOAT_2D, FLOAT_2D_ARRAY or Packed. constants: name → INT or FLOAT (128 bytes in all). defines: name → value.
    includes: name of an #include → its text (generated declarations) or the path of its file (a model).
    """

    source: str | Path
    outputs: tuple[Output, ...]
    samplers: Samplers
    constants: Mapping[str, str]
    defines: Defines
    includes: Includes = field(default_factory=dict)

    @property
    def targets(self) -> list[tuple[str, str]]:
        """Name and format of each texture that is written."""
        return [pair for output in self.outputs for pair in _textures(output.name, output.format, "RGBA32F")]

    def declared(self, source: str) -> dict[str, str]:
        """Return the textures that this kernel's source reads, with kinds; its table of samplers may have more."""
        named = set(re.findall(r"\b(?:u|read)_\w+", source))
        return {
            each: kind_of_each
            for name, kind in self.samplers.items()
            for each, kind_of_each in _textures(name, kind, "FLOAT_2D")
            if each in named or (isinstance(kind, Packed) and f"read_{name.removeprefix('u_')}" in named)
        }

    def needed(self, source: str) -> dict[str, str]:
        """Return the constants that this kernel's source names, with kinds; its table of constants may have more."""
        named = set(re.findall(r"\bu_\w+", source))
        return {name: kind for name, kind in self.constants.items() if name in named}


def _textures(name: str, kind: str | Packed, each: str) -> list[tuple[str, str]]:
    """Return name and kind of every texture that a name stands for; packed ones are of the kind ``each``."""
    return [(f"{name}_{i}", each) for i in range(kind.textures)] if isinstance(kind, Packed) else [(name, kind)]
