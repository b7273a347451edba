"""Maps as pixels in the encodings common to the formats, with filled margins."""

from __future__ import annotations

import numpy as np

from ..core.encode import FLAT_NORMAL, encode_normal, fill_margin, srgb_from_linear
from ..results.maps import Maps


def filled(values: np.ndarray, maps: Maps) -> np.ndarray:
    """Return values (H, W) or (H, W, C) as (H, W, C), with filled margins outside the solved texels."""
    values = values[..., None] if values.ndim == 2 else values
    return fill_margin(values, maps.solved, keep=maps.margin)


def colour(values: np.ndarray, maps: Maps) -> np.ndarray:
    """Return (H, W, 3) sRGB-encoded pixels in 0…1 of linear colours."""
    return np.clip(srgb_from_linear(filled(values, maps)), 0, 1)


def normal(values: np.ndarray, maps: Maps, directx: bool = False) -> np.ndarray:
    """Return (H, W, 3) pixels in 0…1 of a tangent-space normal map, OpenGL, or DirectX with inverted green."""
    vectors = fill_margin(values, maps.solved, far=FLAT_NORMAL, keep=maps.margin)
    return encode_normal(vectors * np.float32([1, -1, 1]) if directx else vectors)


def packed(maps: Maps, *channels: np.ndarray | float) -> np.ndarray:
    """Return (H, W, C) pixels in 0…1 of several maps (H, W) or constants."""
    shape = maps.solved.shape
    stack = [np.broadcast_to(np.asarray(channel, np.float32), shape) for channel in channels]
    return np.clip(filled(np.stack(stack, axis=-1), maps), 0, 1)
