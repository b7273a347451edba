"""Encoding of particles: positions in [0, 1]ⁿ to the parameters of a stage and back, as GLSL."""

from __future__ import annotations

from dataclasses import dataclass

from ...gpu.kernel import Packed
from ...reflectance.model import ReflectanceModel
from ..settings.groups import NormalSearch
from ..settings.resolve import ResolvedSwarm
from ..settings.schedule import MAX_DIMENSIONS

_LEAST = 1e-6  # part of an albedo's range that is searched, however dark the texel


@dataclass(frozen=True)
class Encoding:
    """dimensions: n, 0 to 8. source: GLSL ``decode(x, albedo_limit, s)`` and ``encode(s, albedo_limit, x)``.

    defines: kernels'. lambert_dimensions: bit mask of the dimensions that a Lambertian fit sets: those of
    normal and albedo.
    """

    dimensions: int
    source: str
    defines: dict[str, int]
    lambert_dimensions: int

    @property
    def blocks(self) -> int:
        """Number of RGBA texels that hold a particle."""
        return blocks_of(self.dimensions)

    @property
    def packed(self) -> Packed:
        """Layout of a particle in textures."""
        return Packed(self.blocks, MAX_DIMENSIONS)


def blocks_of(dimensions: int) -> int:
    """Return the number of RGBA texels that hold a particle."""
    return 1 if dimensions <= 4 else 2


def build_encoding(model: ReflectanceModel, stage: ResolvedSwarm, normal: NormalSearch) -> Encoding:
    """Return the encoding of a stage: its parameters one after the other, each component scaled to its range."""
    decode, encode, offsets = [], [], {}
    defines = {"NORMAL_SIZE": 0, "NORMAL_AT": 0}
    at = mask = 0
    for p in stage.parameters:
        offsets[p.name] = at
        if p.is_normal or p.is_albedo:
            mask |= (1 << stage.size(p, normal)) - 1 << at
        if p.is_normal:
            size = 2 if normal == "hemisphere" else 3
            arguments = ", ".join(f"x[{at + i}]" for i in range(size))
            decode.append(f"s.{p.name} = normal_from_{normal}(vec{size}({arguments}));")
            encode.append(f"vec{size} place = {normal}_from_normal(s.{p.name});")
            encode += [f"x[{at + i}] = place[{i}];" for i in range(size)]
            defines |= {"NORMAL_SIZE": size, "NORMAL_AT": at}
            at += size
            continue
        low, width = p.range[0], p.width
        span = f"clamp(albedo_limit - {low!r}, {_LEAST * width!r}, {width!r})" if p.is_albedo else repr(width)
        for i in range(p.components):
            field = f"s.{p.name}{f'[{i}]' if p.components > 1 else ''}"
            decode.append(f"{field} = {low!r} + {span} * x[{at}];")
            encode.append(f"x[{at}] = clamp(({field} - {low!r}) / ({span}), 0.0, 1.0);")
            at += 1
    free = {*offsets, *(p.name for p in stage.solved)}  # solved parameters follow the order of the searched ones
    if model.ordered and set(model.ordered) <= set(offsets) and set(model.complement) <= free:
        defines |= {"LOBE_FIRST": offsets[model.ordered[0]], "LOBE_SECOND": offsets[model.ordered[1]]}
        if model.complement and model.complement[0] in offsets:
            defines["LOBE_WEIGHT"] = offsets[model.complement[0]]
    clear = "for (int i = 0; i < MAX_DIMENSIONS; i++) { x[i] = 0.0; }"
    source = "\n".join(
        ['#include "material.glsl"', '#include "swarm/encoding.glsl"',
         "void decode(inout float x[MAX_DIMENSIONS], float albedo_limit, inout Material s) {", *decode, "}",
         "void encode(Material s, float albedo_limit, out float x[MAX_DIMENSIONS]) {", clear, *encode, "}", ""]
    )  # fmt: skip
    return Encoding(at, source, defines | {"DIMENSIONS": at, "BLOCKS": blocks_of(at)}, mask)
