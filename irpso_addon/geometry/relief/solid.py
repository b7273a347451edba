"""A card's relief as a closed solid, for 3D printing."""

from __future__ import annotations

import numpy as np

from ...core.errors import InputError
from .height import Height

_GAP = 0.1  # texels by which each of two touching parts draws back: printing programs join equal vertices


def relief_solid(height: Height, width: float, base: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (V, 3) and the quads (Q, 4), counter-clockwise from outside, of a card's relief on a base.

    The relief goes through the middles of the covered texels; walls drop from its outline and from its holes to a flat
    underside, ``base`` below its lowest place. Two parts that touch at one texel are a fifth of a texel apart there, so
    that every edge belongs to two quads. width: of the card, in the vertices' unit; x to the right, y up, z toward the
    viewer, the card's middle at x = y = 0 and the underside at z = 0. Raises InputError where no four neighbouring
    texels are covered.
    """
    covered = height.covered
    rows, columns = covered.shape
    whole = covered[:-1, :-1] & covered[:-1, 1:] & covered[1:, 1:] & covered[1:, :-1]
    if not whole.any():
        raise InputError("the card has no four covered texels side by side, and so no relief")
    first = np.flatnonzero(np.pad(whole, ((0, 1), (0, 1))))
    grid = np.stack([first, first + 1, first + columns + 1, first + columns], axis=-1)
    touches = _touches(whole).ravel()
    # Where two quads touch, the lower one has the odd number.
    used, top = np.unique(2 * grid + (touches[grid] != 0) * [0, 0, 1, 1], return_inverse=True)
    top = top.reshape(-1, 4)
    used, lower = np.divmod(used, 2)
    up = _GAP * np.abs(touches[used]) * (1 - 2 * lower)
    row, column = np.divmod(used, columns)
    texel = width / columns
    z = texel * height.values.ravel()[used].astype(np.float64)
    upper = np.stack(
        [
            (column + up * touches[used] + 0.5 - columns / 2) * texel,
            (row + up + 0.5 - rows / 2) * texel,
            z - z.min() + base,
        ],
        axis=-1,
    )
    count = len(used)
    edges = np.concatenate([top[:, [k, (k + 1) % 4]] for k in range(4)])
    inner = np.isin(edges @ (1, count), edges @ (count, 1))  # the reversed edge belongs to another quad
    a, b = edges[~inner].T
    walls = np.stack([b, a, a + count, b + count], axis=-1)
    under = top[:, ::-1] + count
    return np.concatenate([upper, upper * (1, 1, 0)]), np.concatenate([top, walls, under])


def _touches(whole: np.ndarray) -> np.ndarray:
    """Return (H, W): 1 or −1 where two diagonal quads of (H − 1, W − 1) alone meet, the lower left or right; else 0."""
    around = np.pad(whole, 1)
    below, above = around[:-1], around[1:]
    both = below[:, :-1] & above[:, 1:] & ~below[:, 1:] & ~above[:, :-1]
    other = below[:, 1:] & above[:, :-1] & ~below[:, :-1] & ~above[:, 1:]
    return both.astype(int) - other
