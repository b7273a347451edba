"""Encoding of maps in image files: sRGB transfer, normals in 0…1, margins past UV islands."""

from __future__ import annotations

import numpy as np

MARGIN_TEXELS = 8  # mip levels and bilinear filtering reach this far past an island before it shows
FLAT_NORMAL = (0.0, 0.0, 1.0)


def srgb_from_linear(values: np.ndarray) -> np.ndarray:
    """Return sRGB-encoded values of linear ones (IEC 61966-2-1), same shape; negative input is treated as 0.

    Values above 1 continue along the curve; the file format clips them.
    """
    values = np.maximum(np.asarray(values, np.float64), 0.0)
    curve = 1.055 * np.power(np.maximum(values, 0.0031308), 1 / 2.4) - 0.055
    return np.where(values <= 0.0031308, 12.92 * values, curve).astype(np.float32)


def linear_from_srgb(values: np.ndarray) -> np.ndarray:
    """Return linear values of sRGB-encoded ones (IEC 61966-2-1), same shape and type; computed in that type."""
    values = np.asarray(values)
    curve = np.power((np.maximum(values, 0.04045) + 0.055) / 1.055, 2.4)
    return np.where(values <= 0.04045, values / 12.92, curve).astype(values.dtype, copy=False)


def encode_normal(normals: np.ndarray) -> np.ndarray:
    """Return (…, 3) values in 0…1 of vectors in −1…1, normalised first: the OpenGL (Y+) normal map."""
    normals = np.asarray(normals, np.float32)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    unit = np.where(length > 0, normals / np.where(length > 0, length, 1), np.asarray(FLAT_NORMAL, np.float32))
    return unit * np.float32(0.5) + np.float32(0.5)


def fill_margin(
    values: np.ndarray,
    covered: np.ndarray,
    texels: int = MARGIN_TEXELS,
    far: tuple[float, ...] | None = None,
    keep: np.ndarray | None = None,
) -> np.ndarray:
    """Return ``values`` (H, W, C) float32 with every uncovered texel filled.

    Texels within ``texels`` (Euclidean) of a covered one take the value of the nearest; the others take ``far`` (C
    numbers), by default the mean of the covered ones, so that the smallest mip levels stay near the map's own colour.
    texels: 0 and more; with 0 all uncovered texels take ``far``.
    covered: (H, W) bool. The former values of uncovered texels, NaN included, are ignored, except where ``keep``,
    (H, W) bool, is True: these texels keep theirs.
    """
    values = np.asarray(values, np.float32)
    if covered.all():
        return values.copy()
    mean = values[covered].mean(axis=0, dtype=np.float64) if covered.any() else np.zeros(values.shape[-1])
    result = np.where(covered[..., None], values, np.asarray(mean if far is None else far, np.float32))
    row, column, source_row, source_column = nearest_covered(covered, texels)
    result[row, column] = values[source_row, source_column]
    return result if keep is None else np.where(keep[..., None], values, result)


def nearest_covered(
    covered: np.ndarray, reach: int = MARGIN_TEXELS
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return rows and columns of uncovered texels within ``reach``, and of the nearest covered texel of each."""
    height, width = covered.shape
    row, column = np.nonzero(_box_dilated(covered, reach) & ~covered)
    pairs = [(row[:0], column[:0], row[:0], column[:0])]  # with a reach of 0 there are no others
    side = range(-reach, reach + 1)
    disc = [(dy, dx) for dy in side for dx in side if 0 < dy * dy + dx * dx <= reach * reach]
    for dy, dx in sorted(disc, key=lambda offset: offset[0] ** 2 + offset[1] ** 2):
        y, x = row + dy, column + dx
        inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
        hit = inside.copy()
        hit[inside] = covered[y[inside], x[inside]]
        pairs.append((row[hit], column[hit], y[hit], x[hit]))
        row, column = row[~hit], column[~hit]
        if not row.size:
            break
    rows, columns, source_rows, source_columns = map(np.concatenate, zip(*pairs, strict=True))
    return rows, columns, source_rows, source_columns


def _box_dilated(mask: np.ndarray, reach: int) -> np.ndarray:
    """Return the mask grown by ``reach`` texels along both axes (a square window)."""
    for axis in (0, 1):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (reach + 1, reach)
        total = np.cumsum(np.pad(mask, padding), axis=axis, dtype=np.int32)
        length = mask.shape[axis]
        window = 2 * reach + 1
        high = np.take(total, np.arange(window, window + length), axis=axis)
        mask = high > np.take(total, np.arange(length), axis=axis)
    return mask
