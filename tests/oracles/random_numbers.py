"""Oracle of the solver's random numbers and of its particle atlases, in numpy."""

from __future__ import annotations

import numpy as np


def pcg4d(key: np.ndarray) -> np.ndarray:
    """Hash (…, 4) uint32 (Jarzynski & Olano 2020)."""
    x, y, z, w = np.moveaxis(key.astype(np.uint32) * np.uint32(1664525) + np.uint32(1013904223), -1, 0)
    for last in (False, True):
        if last:
            x, y, z, w = (c ^ (c >> np.uint32(16)) for c in (x, y, z, w))
        x = x + y * w
        y = y + z * x
        z = z + x * y
        w = w + y * z
    return np.stack([x, y, z, w], axis=-1)


def random_bits(seed: int, iteration: int, x: np.ndarray, y: np.ndarray, particle, purpose: int) -> np.ndarray:
    """Return (…, 4) uint32 for global texels (x, y)."""
    place = np.asarray(x, np.uint32) | (np.asarray(y, np.uint32) << np.uint32(16))
    stream = np.asarray(particle, np.int64) * 16 + purpose
    parts = [place, np.int64(iteration), stream, np.int64(seed)]
    key = np.stack(np.broadcast_arrays(*(np.asarray(p, np.int64) & 0xFFFFFFFF for p in parts)), axis=-1)
    return pcg4d(pcg4d(key.astype(np.uint32)))


def random_uniform(seed: int, iteration: int, x: np.ndarray, y: np.ndarray, particle, purpose: int) -> np.ndarray:
    """Return (…, 4) float64 in [0, 1)."""
    return (random_bits(seed, iteration, x, y, particle, purpose) >> np.uint32(8)) / 2.0**24


def to_atlas(particles: np.ndarray, across: int, down: int) -> np.ndarray:
    """Return (down·H, across·W, 4): tiles left to right, bottom to top; dimensions 0–3 of all particles, then 4–7."""
    m, height, width, columns = particles.shape
    atlas = np.zeros((down * height, across * width, min(4, columns)), np.float32)
    for tile in range(m * max(1, columns // 4)):
        block, k = divmod(tile, m)
        y, x = divmod(tile, across)
        part = particles[k, ..., 4 * block : 4 * block + 4]
        atlas[y * height : (y + 1) * height, x * width : (x + 1) * width] = part
    return atlas


def from_atlas(atlas: np.ndarray, m: int, height: int, width: int, columns: int) -> np.ndarray:
    """Return (m, H, W, columns) float64 of an atlas."""
    across = atlas.shape[1] // width
    result = np.zeros((m, height, width, columns))
    for tile in range(m * max(1, columns // 4)):
        block, k = divmod(tile, m)
        y, x = divmod(tile, across)
        part = atlas[y * height : (y + 1) * height, x * width : (x + 1) * width]
        result[k, ..., 4 * block : 4 * block + 4] = part[..., :columns]
    return result
