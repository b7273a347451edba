"""Tiles of a domain: a rectangle of its texels, with a halo, as a domain of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .domain import Domain
from .seams.seams import LOOKED_FOR, SeamMap


def tile(domain: Domain, x0: int, y0: int, width: int, height: int, halo: int = 0) -> Domain:
    """Return texels [x0, x0 + width) × [y0, y0 + height) of a domain as one of its own, with a halo around them.

    The halo is ``halo`` texels wide, less where the domain ends; the tile's arrays include it, and its origin is that
    of the halo's corner. The arrays are views, not copies; the texels that it sees across UV seams are the ghosts of
    its seams. Raises ValueError where the tile leaves the domain.
    """
    rows, columns = domain.shape
    if not (width > 0 and height > 0 and halo >= 0 and 0 <= x0 <= columns - width and 0 <= y0 <= rows - height):
        raise ValueError(f"tile {width}×{height} at ({x0}, {y0}), halo {halo}, leaves the domain of {columns}×{rows}")
    left, right = min(halo, x0), min(halo, columns - x0 - width)
    bottom, top = min(halo, y0), min(halo, rows - y0 - height)
    part = (slice(y0 - bottom, y0 + height + top), slice(x0 - left, x0 + width + right))
    bake = domain.bake.each(lambda values: values[part])
    result = replace(
        domain,
        bake=bake,
        stack=domain.stack[:, *part],
        origin=(domain.origin[0] + x0 - left, domain.origin[1] + y0 - bottom),
        halo=(left, right, bottom, top),
        seams=None if domain.seams is None else tile_seams(domain.seams, domain, (x0, y0, width, height), halo),
    )
    if "solvable" in vars(domain):  # found already
        vars(result)["solvable"] = domain.solvable[part]
    return result


def tile_seams(seams: SeamMap, domain: Domain, box: tuple[int, int, int, int], halo: int) -> SeamMap:
    """Return the seams of a tile of a domain, with an ghosts of what its own texels see beyond it.

    box: x0, y0, width, height of its own texels. halo: texels around them, less where the domain ends.
    """
    height, width = seams.shape
    x0, y0, wide, high = box
    left, bottom = max(0, x0 - halo), max(0, y0 - halo)
    right, top = min(width, x0 + wide + halo), min(height, y0 + high + halo)
    solvable = domain.solvable
    own = solvable[y0 : y0 + high, x0 : x0 + wide]
    charts = seams.chart[y0 : y0 + high, x0 : x0 + wide]
    near = (seams.place >= (x0 - halo, y0 - halo)) & (seams.place < (x0 + wide + halo, y0 + high + halo))
    kept = np.flatnonzero(near.all(axis=1) & np.isin(seams.of, np.unique(charts[own])))
    if halo <= LOOKED_FOR:
        kept = kept[_sees(np.where(own, charts, -1), seams.place[kept] - (x0, y0), seams.of[kept], halo)]
    target = seams.target[kept]
    passed = target >= height * width
    y, x = np.divmod(np.where(passed, 0, target), width)
    kept, target, passed, x, y = (a[passed | solvable[y, x]] for a in (kept, target, passed, x, y))
    inside = ~passed & (y >= bottom) & (y < top) & (x >= left) & (x < right)
    outside, number = np.unique(target[~inside], return_inverse=True)
    new = (y - bottom) * (right - left) + x - left
    new[~inside] = (top - bottom) * (right - left) + number
    ay, ax = np.divmod(outside[outside < height * width], width)
    old = outside[outside >= height * width] - height * width
    there = np.stack([ax + domain.origin[0], ay + domain.origin[1]], axis=-1)
    return replace(
        seams, island=seams.island[bottom:top, left:right], chart=seams.chart[bottom:top, left:right],
        of=seams.of[kept], target=new, at=seams.at[kept],
        place=seams.place[kept] - np.array([left, bottom], np.int32),
        ghosts=np.concatenate([there, seams.ghosts[old]]).astype(np.int32),
        ghost_normal=np.concatenate([domain.bake.normal[ay, ax], seams.ghost_normal[old]]),
        ghost_tangent=np.concatenate([domain.bake.tangent[ay, ax], seams.ghost_tangent[old]]),
    )  # fmt: skip


def _sees(chart: np.ndarray, place: np.ndarray, of: np.ndarray, halo: int) -> np.ndarray:
    """Return (N,) bool: whether a texel of the chart ``of`` lies within ``halo`` of a place (N, 2)."""
    padded = np.pad(chart, 2 * halo, constant_values=-1)
    found = np.zeros(len(place), bool)
    for y in range(-halo, halo + 1):
        for x in range(-halo, halo + 1):
            found |= padded[place[:, 1] + y + 2 * halo, place[:, 0] + x + 2 * halo] == of
    return found
