"""The demo's ground truth: a skin made of waves.

It is a function of the position in space, not of the texture square: no seam shows, and a camera's pixel has exactly
the material of a texel at its place.
"""

from __future__ import annotations

import numpy as np

from ..geometry.domain import GeometryBake

_WAVES = 28  # per field: enough to hide every direction
_BUMPS = ((0.9, 0.10), (0.34, 0.16), (0.19, 0.20))  # wavelength in world units, slope (root mean square)


def material_at(bake: GeometryBake) -> dict[str, np.ndarray]:
    """Return the two-lobe material of a bake: base_color, normal (tangent space), r1, r2, w; (H, W, components)."""
    p = bake.position.astype(np.float64)
    region = _field(p, 1.5, 1)[0]
    blotch = _field(p, 0.7, 2)[0]
    fine = _field(p, 0.2, 3)[0]
    freckles = _smooth_step(1.3, 1.9, _field(p, 0.2, 4)[0])
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
    gradient = sum(slope * _field(p, length, 10 + i)[1] for i, (length, slope) in enumerate(_BUMPS))
    along = (gradient * normal).sum(axis=-1, keepdims=True)
    bumped = normal - (gradient - along * normal)
    bumped /= np.maximum(np.linalg.norm(bumped, axis=-1, keepdims=True), 1e-9)
    return np.einsum("hwij,hwj->hwi", bake.frames(), bumped)


def _field(p: np.ndarray, wavelength: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a smooth random field of about unit variance at positions (…, 3), and its gradient of about unit slope."""
    random = np.random.default_rng(seed)
    axes = random.normal(size=(_WAVES, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    numbers = 2 * np.pi / (wavelength * random.uniform(0.8, 1.25, _WAVES))
    phases = random.uniform(0, 2 * np.pi, _WAVES)
    value = np.zeros(p.shape[:-1])
    gradient = np.zeros(p.shape)
    for axis, number, phase in zip(axes, numbers, phases, strict=True):
        angle = number * (p @ axis) + phase
        value += np.sin(angle)
        gradient += np.cos(angle)[..., None] * axis
    # Each wave has variance 1/2. Two of the gradient's three directions lie in the surface.
    return value * np.sqrt(2 / _WAVES), gradient * np.sqrt(3 / _WAVES)


def _smooth_step(low: float, high: float, value: np.ndarray) -> np.ndarray:
    t = np.clip((value - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)
