"""Dense packing: solved texels side by side, so that empty ones cost neither memory nor time."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ...core.errors import InputError
from ...geometry.seams.seams import SeamMap
from ...gpu.textures import Texture

_EXACT = 1 << 24  # float32 holds all whole numbers up to here


def level_size(lent: Mapping[str, Texture], defines: Mapping[str, str | int]) -> tuple[int, int]:
    """Return (W, H) of a domain from its textures and the defines of its kernels."""
    border = 2 * int(defines.get("SEAMS", 0))
    return lent["u_packed"].width - border, lent["u_packed"].height - border


class Packing:
    """The places of a domain's solved texels in a packed grid, row by row; ghosts of its seams come last.

    solved: (H, W) bool. width, height: of the packed grid. count: its occupied places; the last ones may be empty. A
    domain without ghosts in which every texel is solved is not rearranged.
    """

    def __init__(self, solved: np.ndarray, seams: SeamMap | None = None):
        self.shape, self.seams = solved.shape, seams
        self._rows, self._columns = np.nonzero(solved)
        self.ghosts = 0 if seams is None else len(seams.ghosts)
        self.count = count = len(self._rows) + self.ghosts
        self._unchanged = bool(solved.all()) and not self.ghosts
        self.width = solved.shape[1] if self._unchanged else max(1, math.isqrt(max(count - 1, 0)) + 1)
        self.height = max(1, -(-count // self.width))

    def pack(self, array: np.ndarray, ghosts: np.ndarray | float = 0.0) -> np.ndarray:
        """Return (h, w, …) of (H, W, …), 0 at empty places; the array itself if nothing is rearranged.

        ghosts: (M, …) of the ghost texels, or a value that broadcasts to that shape.
        """
        return array if self._unchanged else self._grid(array[self._rows, self._columns], ghosts)

    def unpack(self, array: np.ndarray, fill: object = 0.0) -> np.ndarray:
        """Return (H, W, …) of (h, w, …), ``fill`` where no texel is solved."""
        if self._unchanged:
            return array.copy()
        result = np.empty((*self.shape, *array.shape[2:]), array.dtype)
        result[:] = fill
        flat = array.reshape(array.shape[0] * array.shape[1], *array.shape[2:])  # −1 fails for 0 channels
        result[self._rows, self._columns] = flat[: len(self._rows)]
        return result

    def places(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (n, 2) x and y in the packed grid of n solved texels. Raises ValueError where one is not solved."""
        index = np.empty(len(rows), int)
        for number, (row, column) in enumerate(zip(rows, columns, strict=True)):
            first, end = np.searchsorted(self._rows, (row, row + 1))  # texels are sorted by row
            index[number] = at = first + np.searchsorted(self._columns[first:end], column)
            if at == end or self._columns[at] != column:
                raise ValueError(f"texel ({column}, {row}) is not solved")
        return np.stack([index % self.width, index // self.width], axis=-1)

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the float32 arrays of shaders/common/packing.glsl: layers of places (1 or more, h, w, 4) and u_packed.

        u_packed, the inverse of the places, has two channels; with seams four, and a border around the domain.
        """
        places = np.zeros((len(self._rows), 4), np.float32)
        places[:, 0], places[:, 1] = self._columns, self._rows
        index = np.arange(len(self._rows))
        inverse = np.full((*self.shape, 2), -1, np.float32)
        inverse[self._rows, self._columns] = np.stack([index % self.width, index // self.width], axis=-1)
        if self.seams is not None:
            return self._with_seams(self.seams, places, inverse)
        return self._grid(places)[None], inverse

    def _with_seams(self, seams: SeamMap, places: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        for channel, of in ((2, seams.chart), (3, seams.island)):
            places[:, channel] = of[self._rows, self._columns]
        height, width = self.shape
        numbers = np.full(height * width + self.ghosts, -1)
        numbers[self._rows * width + self._columns] = np.arange(len(self._rows))
        numbers[height * width :] = len(self._rows) + np.arange(self.ghosts)
        target = numbers[seams.target]
        valid = np.flatnonzero(target >= 0)
        place, target = seams.place[valid] + seams.radius, target[valid]
        if len(place) >= _EXACT:
            raise InputError("this domain has more texels beside seams than a texture can number; solve it in tiles")
        flat = place[:, 1].astype(np.int64) * (width + 2 * seams.radius) + place[:, 0]
        begins = np.diff(flat, prepend=-1) != 0
        next_link = np.where(np.append(begins[1:], True), -1, np.arange(len(flat)) + 1)
        chain = np.stack([target % self.width, target // self.width, seams.of[valid], next_link], axis=-1)
        layers = -(-len(chain) // (self.width * self.height))
        chains = np.full((layers, self.height, self.width, 4), -1, np.float32)
        chains.reshape(-1, 4)[: len(chain)] = chain
        border = ((seams.radius, seams.radius), (seams.radius, seams.radius), (0, 0))
        packed = np.concatenate([inverse, seams.chart[..., None], np.full((height, width, 1), -1)], axis=-1)
        packed = np.pad(packed.astype(np.float32), border, constant_values=-1)
        packed.reshape(-1, 4)[flat[begins], 3] = np.flatnonzero(begins)
        return np.concatenate([self._grid(places, -1)[None], chains]), packed

    def _grid(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> np.ndarray:
        rest = np.zeros((self.width * self.height - len(self._rows), *values.shape[1:]), values.dtype)
        rest[: self.ghosts] = ghosts
        return np.concatenate([values, rest]).reshape(self.height, self.width, *values.shape[1:])
