"""Connected components of graphs."""

from __future__ import annotations

import numpy as np


def connected(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (count,) int: nodes with the same number hang together by the edges ``first``, ``second`` of indices."""
    root = np.arange(count)
    # The larger root hangs itself under the smaller one, then every path is cut short to its end.
    while (apart := root[first] != root[second]).any():
        first, second = first[apart], second[apart]
        a, b = root[first], root[second]
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while (root[root] != root).any():
            root = root[root]
    return np.unique(root, return_inverse=True)[1].reshape(-1)
