"""Dense packing: the texels that are solved, side by side, so that empty ones cost neither memory nor time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..gpu import textures


class Packing:
    """Which place of a packed grid holds which texel of a domain, row by row.

    solved: (H, W) bool. width, height: of the packed grid; its last places may be empty. A domain that is solved
    everywhere is its own packing.
    """

    def __init__(self, solved: np.ndarray):
        self.shape = solved.shape
        self._rows, self._columns = np.nonzero(solved)
        count = len(self._rows)
        self.width = solved.shape[1] if solved.all() else max(1, math.isqrt(max(count - 1, 0)) + 1)
        self.height = max(1, -(-count // self.width))
        self._padding = self.width * self.height - count
        self._whole = bool(solved.all())

    def pack(self, array: np.ndarray) -> np.ndarray:
        """Return (h, w, …) of (H, W, …); places without a texel are 0. Where all are solved, the array itself."""
        return array if self._whole else self._grid(array[self._rows, self._columns])

    def pack_layers(self, array: np.ndarray) -> np.ndarray:
        """Return (K, h, w, C) of (K, H, W, C), a copy."""
        packed = np.zeros((len(array), self.height * self.width, array.shape[-1]), np.float32)
        for layer, out in zip(array, packed, strict=True):
            out[: len(self._rows)] = layer[self._rows, self._columns]
        return packed.reshape(len(array), self.height, self.width, -1)

    def unpack(self, array: np.ndarray, fill: Any = 0.0) -> np.ndarray:
        """Return (H, W, …) of (h, w, …), with ``fill`` where no texel is solved."""
        if self._whole:
            return array.copy()
        result = np.empty((*self.shape, *array.shape[2:]), array.dtype)
        result[:] = fill
        flat = array.reshape(array.shape[0] * array.shape[1], *array.shape[2:])  # −1 fails for 0 channels
        result[self._rows, self._columns] = flat[: len(self._rows)]
        return result

    def upload(self) -> dict[str, Any]:
        """Return the textures of shaders/common/packing.glsl by sampler name."""
        return {name: textures.upload(array) for name, array in self.arrays().items()}

    def arrays(self) -> dict[str, np.ndarray]:
        """Return u_place (x, y of a packed texel) and u_packed (its inverse), (…, 2) float32."""
        places = self._grid(np.stack([self._columns, self._rows], axis=-1).astype(np.float32))
        index = np.arange(len(self._rows))
        inverse = np.full((*self.shape, 2), -1, np.float32)
        inverse[self._rows, self._columns] = np.stack([index % self.width, index // self.width], axis=-1)
        return {"u_place": places, "u_packed": inverse}

    def _grid(self, values: np.ndarray) -> np.ndarray:
        padded = np.concatenate([values, np.zeros((self._padding, *values.shape[1:]), values.dtype)])
        return padded.reshape(self.height, self.width, *values.shape[1:])
