"""Gaps inside an island: texels on both sides of a gap are near each other in the UV map, not on the surface.

Where the island around a block of texels falls into several pieces, each piece inside the block is a chart of its own;
all other texels of an island are one chart. Texels of one piece see each other; past its border a piece sees the
surface past its own edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.graph import connected
from .edges import SeamEdges
from .places import places_beyond, texel_at

FIRST_CHART = -2  # charts of pieces count down from here; −1 is no texel
_WINDOWS = 512  # processed at a time
# Blocks of a window on each side of its block: a texel sees at most one block past its border, and a nearer side of a
# gap lies at most one further block away.
_BLOCKS = 2
_SIDE = 2 * _BLOCKS + 1


@dataclass(frozen=True)
class Pieces:
    """Blocks of B × B texels around which an island falls into pieces, and the resulting Q charts.

    corner: (A, 2) x, y of a block's first texel. island: (A,). label: (A, 5B, 5B) int16 the piece of each texel in the
    window of two blocks around a block, −1 outside the island. block, piece: (Q,) of each chart.
    """

    corner: np.ndarray
    island: np.ndarray
    label: np.ndarray
    block: np.ndarray
    piece: np.ndarray

    def number(self) -> np.ndarray:
        """Return (A, most pieces) the chart of a piece, −1 where it is outside the block."""
        result = np.full((len(self.corner), max(int(self.label.max(initial=0)), 0) + 1), -1)
        result[self.block, self.piece] = np.arange(len(self.block))
        return result


def pieces_of(island: np.ndarray, radius: int) -> Pieces:
    """Return the pieces of islands (H, W) around blocks of ``radius`` texels."""
    height, width = island.shape
    rows, columns = -(-height // radius), -(-width // radius)
    before = _BLOCKS * radius
    after = (rows * radius - height + before, columns * radius - width + before)
    padded = np.pad(island, ((before, after[0]), (before, after[1])), constant_values=-1)
    low, high = (_around_blocks(padded, radius, f) for f in (np.minimum, np.maximum))
    mixed = low != high  # a window of one island only is one piece
    y, x = np.nonzero((island >= 0) & np.kron(mixed, np.ones((radius, radius), bool))[:height, :width])
    pairs = np.unique(np.stack([y // radius * columns + x // radius, island[y, x]], axis=-1), axis=0)
    corner = np.stack([pairs[:, 0] % columns, pairs[:, 0] // columns], axis=-1) * radius
    split, labels = [np.zeros(0, np.int64)], [np.zeros((0, _SIDE * radius, _SIDE * radius), np.int16)]
    steps = np.arange(_SIDE * radius)
    for start in range(0, len(pairs), _WINDOWS):
        part = slice(start, start + _WINDOWS)
        window = padded[corner[part, 1, None, None] + steps[:, None], corner[part, 0, None, None] + steps]
        label, count = _labelled(window == pairs[part, 1, None, None])
        split.append(start + np.flatnonzero(count > 1))
        labels.append(label[count > 1].astype(np.int16))
    chosen, label = np.concatenate(split), np.concatenate(labels)
    core = label[:, before : before + radius, before : before + radius]
    block, piece = np.unique(np.stack([np.nonzero(core >= 0)[0], core[core >= 0]], axis=-1), axis=0).T.astype(np.int64)
    return Pieces(corner[chosen], pairs[chosen, 1], label, block, piece)


def charts_of(island: np.ndarray, pieces: Pieces) -> np.ndarray:
    """Return (H, W) int32 the chart of each texel: its island, or a piece's chart, from −2 downward."""
    chart = island.copy()
    if len(pieces.block):
        a, x, y, label = _texels(pieces, 0)
        chart[y, x] = FIRST_CHART - pieces.number()[a, label]
    return chart


def visible_across_gaps(chart: np.ndarray, island: np.ndarray, pieces: Pieces) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, 2) places and (N,) charts that see the texel there although its chart is another.

    The rest of its island and the other charts of its piece see a texel of a piece.
    """
    if not len(pieces.block):
        return np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
    y, x = np.nonzero(chart <= FIRST_CHART)
    of_rest = np.stack([x, y], axis=-1), island[y, x].astype(np.int64)
    a, x, y, label = _texels(pieces, 1)
    number = pieces.number()[a, label]
    seen = (number >= 0) & (chart[y, x] <= FIRST_CHART) & (chart[y, x] != FIRST_CHART - number)
    of_pieces = np.stack([x, y], axis=-1)[seen], FIRST_CHART - number[seen]
    places, charts = map(np.concatenate, zip(of_rest, of_pieces, strict=True))
    return places, charts


def places_beyond_pieces(
    edges: SeamEdges, island: np.ndarray, pieces: Pieces, radius: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (N, 2) places past the borders of pieces, (N,) the nearest edge of each, and (N,) their charts."""
    if not len(pieces.block):
        return np.zeros((0, 2), np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64)
    edge, view = _edges_of(edges, island, pieces, radius)

    def covered(charts: np.ndarray, place: np.ndarray) -> np.ndarray:
        block = pieces.block[charts]
        x, y = (place - pieces.corner[block] + _BLOCKS * radius).T
        # A chart sees at most one block far.
        outside = np.minimum(x, y) < (_BLOCKS - 1) * radius
        outside |= np.maximum(x, y) >= (_BLOCKS + 2) * radius
        x, y = np.where(outside, 0, x), np.where(outside, 0, y)
        return outside | (pieces.label[block, y, x] == pieces.piece[charts])

    mine = edges.some(edge)
    place, nearest = places_beyond(mine, view, covered, island.shape, radius)
    return place, edge[nearest], FIRST_CHART - view[nearest]


def _around_blocks(padded: np.ndarray, radius: int, extreme: np.ufunc) -> np.ndarray:
    """Return the smallest, or largest, number in the window of every block."""
    rows, columns = padded.shape[0] // radius, padded.shape[1] // radius
    each = extreme.reduce(extreme.reduce(padded.reshape(rows, radius, columns, radius), axis=3), axis=1)
    rows, columns = rows - _SIDE + 1, columns - _SIDE + 1
    down = extreme.reduce([each[step : step + rows] for step in range(_SIDE)])
    return extreme.reduce([down[:, step : step + columns] for step in range(_SIDE)])


def _labelled(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (M, S, S) piece numbers from 0 of masks (M, S, S), 8-connected, and (M,) their counts."""
    begins = mask.copy()
    begins[..., 1:] &= ~mask[..., :-1]
    runs = np.where(mask, np.cumsum(begins).reshape(mask.shape) - 1, -1)
    size, links = mask.shape[-1], [np.zeros((0, 2), np.int64)]
    for step in (-1, 0, 1):
        above = runs[:, :-1, max(0, step) : size + min(0, step)]
        below = runs[:, 1:, max(0, -step) : size + min(0, -step)]
        touch = (above >= 0) & (below >= 0)
        known = touch[..., :-1] & (above[..., 1:] == above[..., :-1]) & (below[..., 1:] == below[..., :-1])
        touch[..., 1:] &= ~known
        links.append(np.stack([above[touch], below[touch]], axis=-1))
    piece = connected(int(begins.sum()), *np.concatenate(links).T).astype(np.int32)
    window = np.nonzero(begins)[0]
    first = np.full(len(mask), np.iinfo(np.int64).max)
    np.minimum.at(first, window, piece)
    count = np.bincount(window[np.unique(piece, return_index=True)[1]], minlength=len(mask))
    label = np.where(mask, piece[np.maximum(runs, 0)] - first[:, None, None], -1) if len(piece) else runs
    return label, count


def _texels(pieces: Pieces, around: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return block, x, y and label of the pieces' texels up to ``around`` blocks from their block."""
    radius = pieces.label.shape[1] // _SIDE
    low = (_BLOCKS - around) * radius
    part = slice(low, low + (2 * around + 1) * radius)
    a, y, x = np.nonzero(pieces.label[:, part, part] >= 0)
    label = pieces.label[:, part, part][a, y, x].astype(np.int64)
    x, y = (step + pieces.corner[a, axis] - around * radius for axis, step in enumerate((x, y)))
    return a, x, y, label


def _edges_of(edges: SeamEdges, island: np.ndarray, pieces: Pieces, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (edge, chart) pairs where the edge lies at the chart's piece inside its window."""
    width = island.shape[1]
    length = np.linalg.norm(edges.end - edges.start, axis=-1)
    count = np.ceil(length).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(count)), count)
    t = ((np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)) / np.maximum(count[edge] - 1, 1))[:, None]
    at = edges.start[edge] * (1 - t) + edges.end[edge] * t - 0.5 * edges.outward[edge]
    texel = texel_at(at, edges.island[edge], island)
    edge, texel = edge[texel >= 0], texel[texel >= 0]
    y, x = np.divmod(texel, width)
    columns = -(-width // radius) + 2 * _BLOCKS
    islands = int(island.max()) + 1
    blocks = pieces.corner // radius + _BLOCKS
    keys = (blocks[:, 1] * columns + blocks[:, 0]) * islands + pieces.island
    order = np.argsort(keys)
    number, pairs = pieces.number(), []
    for dy in range(_SIDE):
        for dx in range(_SIDE):
            key = ((y // radius + dy) * columns + x // radius + dx) * islands + edges.island[edge]
            index = np.minimum(np.searchsorted(keys, key, sorter=order), len(keys) - 1)
            a = order[index]
            matches = np.flatnonzero(keys[a] == key)
            a = a[matches]
            wx, wy = (at[matches] - pieces.corner[a, axis] + _BLOCKS * radius for axis, at in enumerate((x, y)))
            label = pieces.label[a, wy, wx]
            chart = np.where(label >= 0, number[a, np.maximum(label, 0)], -1)
            pairs.append(np.stack([edge[matches], chart], axis=-1)[chart >= 0])
    return tuple(np.unique(np.concatenate(pairs), axis=0).T)
