"""Seams of a tile, with ghosts: the texels outside that it sees across them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .seams import MAX_SEARCHED_HALO, SeamMap


def tile_seams(
    seams: SeamMap,
    solvable: np.ndarray,
    normal: np.ndarray,
    tangent: np.ndarray,
    origin: tuple[int, int],
    box: tuple[int, int, int, int],
    halo: int,
) -> SeamMap:
    """Return the seams of a tile of a domain, with the ghosts that its own texels see outside it.

    solvable (H, W), normal (H, W, 3), tangent (H, W, 4), origin: of the domain. box: x0, y0, width, height of the
    tile's own texels. halo: texels around them, clipped at the domain's border.
    """
    height, width = seams.shape
    x0, y0, wide, high = box
    left, bottom = max(0, x0 - halo), max(0, y0 - halo)
    right, top = min(width, x0 + wide + halo), min(height, y0 + high + halo)
    own = solvable[y0 : y0 + high, x0 : x0 + wide]
    charts = seams.chart[y0 : y0 + high, x0 : x0 + wide]
    near = (seams.place >= (x0 - halo, y0 - halo)) & (seams.place < (x0 + wide + halo, y0 + high + halo))
    chosen = np.flatnonzero(near.all(axis=1) & np.isin(seams.of, np.unique(charts[own])))
    if halo <= MAX_SEARCHED_HALO:
        chosen = chosen[_sees(np.where(own, charts, -1), seams.place[chosen] - (x0, y0), seams.of[chosen], halo)]
    target = seams.target[chosen]
    is_ghost = target >= height * width
    y, x = np.divmod(np.where(is_ghost, 0, target), width)
    chosen, target, is_ghost, x, y = (a[is_ghost | solvable[y, x]] for a in (chosen, target, is_ghost, x, y))
    inside = ~is_ghost & (y >= bottom) & (y < top) & (x >= left) & (x < right)
    outside, number = np.unique(target[~inside], return_inverse=True)
    new = (y - bottom) * (right - left) + x - left
    new[~inside] = (top - bottom) * (right - left) + number
    ay, ax = np.divmod(outside[outside < height * width], width)
    old = outside[outside >= height * width] - height * width
    places = np.stack([ax + origin[0], ay + origin[1]], axis=-1)
    return replace(
        seams, island=seams.island[bottom:top, left:right], chart=seams.chart[bottom:top, left:right],
        of=seams.of[chosen], target=new, at=seams.at[chosen],
        place=seams.place[chosen] - np.array([left, bottom], np.int32),
        ghosts=np.concatenate([places, seams.ghosts[old]]).astype(np.int32),
        ghost_normal=np.concatenate([normal[ay, ax], seams.ghost_normal[old]]),
        ghost_tangent=np.concatenate([tangent[ay, ax], seams.ghost_tangent[old]]),
    )  # fmt: skip


def _sees(chart: np.ndarray, place: np.ndarray, of: np.ndarray, halo: int) -> np.ndarray:
    """Return (N,) bool: whether a texel of the chart ``of`` lies within ``halo`` of a place (N, 2)."""
    padded = np.pad(chart, 2 * halo, constant_values=-1)
    seen = np.zeros(len(place), bool)
    for y in range(-halo, halo + 1):
        for x in range(-halo, halo + 1):
            seen |= padded[place[:, 1] + y + 2 * halo, place[:, 0] + x + 2 * halo] == of
    return seen
