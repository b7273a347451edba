"""Connected components of graphs."""

from __future__ import annotations

import numpy as np


def connected(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (count,) int: the component of each node under the edges ``first``, ``second`` of indices."""
    root = np.arange(count)
    # The larger root joins the smaller one, then all paths are compressed.
    while (apart := root[first] != root[second]).any():
        first, second = first[apart], second[apart]
        a, b = root[first], root[second]
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while (root[root] != root).any():
            root = root[root]
    return np.unique(root, return_inverse=True)[1].reshape(-1)
