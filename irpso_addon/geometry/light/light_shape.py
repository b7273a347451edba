"""Lights whose light differs with direction: what reaches each texel, folded into its samples.

The table of observations knows a light's place and intensity; cone and cosine, which differ from texel to texel, are
taken out of the radiances before.
"""

from __future__ import annotations

import numpy as np

from ...capture.types import Light

# Below this part of the intensity along the axis (3° from edge-on to a flat emitter) a sample tells nothing: where the
# axis is known to a degree, its radiance would be off by a third.
LEAST_SHARE = 0.05


def unshaped(light: Light, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) factors of radiance and (N,) of weight, float32, that turn samples into those of an even light.

    points: (N, 3) world. Radiance is divided by the share of the intensity that reaches the texel; that multiplies its
    noise too, so the weight is multiplied by the share squared. Both are 0 where the share is under LEAST_SHARE.
    """
    share = light.share(points)
    enough = share >= LEAST_SHARE
    gain = np.where(enough, 1 / np.where(enough, share, 1), 0)
    return gain.astype(np.float32), np.where(enough, share**2, 0).astype(np.float32)
