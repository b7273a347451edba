"""The demo's ground truth: a skin of waves, as a function of position.

The material depends on the position in space, not on UV coordinates: seams do not show, and a camera's pixel has the
material of a texel at the same position exactly.
"""

from __future__ import annotations

import numpy as np

from ..core.waves import wave_field
from ..geometry.domain import GeometryBake

_BUMPS = ((0.9, 0.10), (0.34, 0.16), (0.19, 0.20))  # wavelength in world units, slope (root mean square)


def material_at(bake: GeometryBake) -> dict[str, np.ndarray]:
    """Return the two-lobe material of a bake: base_color, normal (tangent space), r1, r2, w; (H, W, components)."""
    p = bake.position.astype(np.float64)
    region = wave_field(p, 1.5, 1)[0]
    blotch = wave_field(p, 0.7, 2)[0]
    fine = wave_field(p, 0.2, 3)[0]
    freckles = _smooth_step(1.3, 1.9, wave_field(p, 0.2, 4)[0])
    pale, red, dark = np.array([0.72, 0.46, 0.35]), np.array([0.62, 0.24, 0.17]), np.array([0.20, 0.085, 0.05])
    color = pale + (red - pale) * _smooth_step(-0.4, 1.6, blotch)[..., None]
    color = color * (1 + 0.12 * fine[..., None])
    color = color + (dark - color) * 0.7 * freckles[..., None]
    # The lobes' widths vary by region, as on skin: oily forehead, dry cheeks.
    oily = _smooth_step(-1.2, 1.2, region + 0.25 * fine)
    values = {
        "base_color": np.clip(color, 0.02, 0.95),
        "normal": _bumpy_normal(bake, p),
        "r1": (0.26 - 0.10 * oily + 0.012 * fine)[..., None],
        "r2": (0.56 - 0.10 * oily + 0.020 * fine)[..., None],
        "w": (0.35 + 0.30 * oily)[..., None],
    }
    return {name: value.astype(np.float32) for name, value in values.items()}


def _bumpy_normal(bake: GeometryBake, p: np.ndarray) -> np.ndarray:
    normal = bake.normal.astype(np.float64)
    gradient = sum(slope * wave_field(p, length, 10 + i)[1] for i, (length, slope) in enumerate(_BUMPS))
    along = (gradient * normal).sum(axis=-1, keepdims=True)
    bumped = normal - (gradient - along * normal)
    bumped /= np.maximum(np.linalg.norm(bumped, axis=-1, keepdims=True), 1e-9)
    return np.einsum("hwij,hwj->hwi", bake.frames(), bumped)


def _smooth_step(low: float, high: float, value: np.ndarray) -> np.ndarray:
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
