"""Geometry of a capture's lights: how far their directions spread."""

from __future__ import annotations

import numpy as np

NARROW = 0.3  # flatness of directions within about 33° of their mean; 0.19 of those within 22°, 0.4 within 45°


def flatness(directions: np.ndarray) -> float:
    """Return the smallest over the largest singular value of unit directions (K, 3): 0 if all lie in one plane.

    The plane contains the origin: the images do not determine a normal's component perpendicular to it.
    """
    values = np.linalg.svd(directions, compute_uv=False)
    return float(values[-1] / values[0]) if len(values) == 3 else 0.0
