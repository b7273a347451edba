"""Maps as planes of bytes, which shaders/web/planes.glsl reads.

Plane 0 holds the normal, octahedral, twelve bits each: eight of u, eight of v, four and four; 0 where nothing is
covered. The others hold the model's remaining components, three per plane, as the square root of their position in
their range: an even error on screens, and a hundred times finer where a lobe is narrow.
"""

from __future__ import annotations

import numpy as np

from ...reflectance.glsl import material_declaration
from ...reflectance.model import MAX_COMPONENTS, Parameter, ReflectanceModel
from ...results.map_tables import ALPHA

CODES = 4095  # of a normal's u and v
_HIGHEST = 255


def material_planes(model: ReflectanceModel, values: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Return (P, H, W, 3) uint8 of the components (H, W, C) of a model; covered: (H, W) bool."""
    at = model.offset(model.normal)
    low, span = _ranges(model)
    place = np.clip((values - low) / span, 0, 1)
    roots = np.rint(_HIGHEST * np.sqrt(np.delete(place, slice(at, at + 3), axis=-1)))
    planes = [octahedral(values[..., at : at + 3]), *_in_threes(roots)]
    return np.stack([np.where(covered[..., None], plane, 0) for plane in planes]).astype(np.uint8)


def share_planes(shares: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Return (P, H, W, 3) uint8 of fractions (H, W, C), 0…1, coded as 1…255; 0 where nothing is covered."""
    codes = np.where(covered[..., None], 1 + np.rint((_HIGHEST - 1) * np.clip(np.nan_to_num(shares, nan=1), 0, 1)), 0)
    return np.stack(_in_threes(codes)).astype(np.uint8)


def octahedral(normals: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) bytes of unit vectors. Cigolle et al. 2014, A Survey of Efficient Representations for
    Independent Unit Vectors.

    The direction (0, 0, −1) at the corner of the square, whose bytes are 0, moves to the next corner.
    """
    n = normals / np.maximum(np.abs(normals).sum(axis=-1, keepdims=True), 1e-9)
    folded = (1 - np.abs(n[..., 1::-1])) * np.where(n[..., :2] >= 0, 1, -1)
    uv = np.rint((np.where(n[..., 2:] < 0, folded, n[..., :2]) * 0.5 + 0.5) * CODES).astype(np.int64)
    uv[(uv == 0).all(axis=-1)] = CODES
    low = (uv[..., 0] & 15) << 4 | (uv[..., 1] & 15)
    return np.stack([uv[..., 0] >> 4, uv[..., 1] >> 4, low], axis=-1)


def layout(model: ReflectanceModel, colours: int) -> str:
    """Return the text of "web/layout.glsl" for a model. colours: number of colours of the ramp."""
    count, at = model.components, model.offset(model.normal)
    low, span = (np.resize(np.append(values, np.zeros(MAX_COMPONENTS)), MAX_COMPONENTS) for values in _ranges(model))
    lines = [f"#define {name} {value}" for name, value in (
        ("PLANES", 1 + -(-(count - 3) // 3)), ("COMPONENTS", count), ("NORMAL", at), ("RAMP", colours),
    )]  # fmt: skip
    for name, numbers in (("LOW", low), ("SPAN", span)):
        lines.append(
            f"const float {name}[MAX_COMPONENTS] = float[MAX_COMPONENTS]({', '.join(repr(float(x)) for x in numbers)});"
        )
    srgb = [
        p.color_space == "sRGB" and _first_channel(model, p) + i < ALPHA
        for p in model.parameters
        for i in range(p.components)
    ]
    encoded = [str(is_srgb).lower() for is_srgb in srgb]
    padded = ", ".join([*encoded, *["false"] * (MAX_COMPONENTS - count)])
    lines.append(f"const bool SRGB[MAX_COMPONENTS] = bool[MAX_COMPONENTS]({padded});")
    return "\n".join([*lines, material_declaration(model)])


def _first_channel(model: ReflectanceModel, parameter: Parameter) -> int:
    """Return the index of a parameter's first channel in the map that it shares with those before it."""
    before = model.parameters[: model.parameters.index(parameter)]
    return sum(p.components for p in before if parameter.map and p.map == parameter.map)


def components_of(model: ReflectanceModel, values: dict[str, np.ndarray], shape: tuple[int, int]) -> np.ndarray:
    """Return (H, W, C) float32 the components of all parameters in the model's order, defaults without a map."""
    maps = []
    for p in model.parameters:
        value = np.asarray(values.get(p.name, p.default), np.float32)
        whole = value.size == shape[0] * shape[1] * p.components
        maps.append(value.reshape(*shape, -1) if whole else np.broadcast_to(value.reshape(-1), (*shape, p.components)))
    return np.concatenate(maps, axis=-1)


def _ranges(model: ReflectanceModel) -> tuple[np.ndarray, np.ndarray]:
    """Return (C,) lower ends and (C,) lengths of the components' ranges."""
    low = [p.range[0] for p in model.parameters for _ in range(p.components)]
    high = [p.range[1] for p in model.parameters for _ in range(p.components)]
    return np.array(low), np.array(high) - low


def _in_threes(codes: np.ndarray) -> list[np.ndarray]:
    """Return (H, W, C) as images of three channels, the last one filled up with 0."""
    spare = -codes.shape[-1] % 3
    padded = np.pad(codes, [(0, 0), (0, 0), (0, spare)])
    return [padded[..., i : i + 3] for i in range(0, padded.shape[-1], 3)]
