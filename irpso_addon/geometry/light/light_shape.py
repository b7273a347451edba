"""Lights with a beam shape: cone and cosine falloff, divided out of the samples.

The observation table has a light's position and intensity only. Cone and cosine differ from texel to texel, so the
samples are corrected before the search.
"""

from __future__ import annotations

import numpy as np

from ...capture.types import Light, beam_share
from ..domain import Domain

# Samples below this fraction of the intensity along the axis (3° from edge-on to a flat emitter) are unusable: with an
# axis known to 1°, their radiance would be off by a third.
MIN_SHARE = 0.05


def beam_correction(light: Light, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return float32 factors of radiance (N,) and weight (N,) that turn samples into those of an isotropic light.

    points: (N, 3) world. Radiance is divided by the share of the intensity that reaches the texel; this scales its
    noise too, so the weight is multiplied by the share squared. Both are 0 where the share is under MIN_SHARE.
    """
    share = light.relative_intensity(points)
    usable = share >= MIN_SHARE
    gain = np.where(usable, 1 / np.where(usable, share, 1), 0)
    return gain.astype(np.float32), np.where(usable, share**2, 0).astype(np.float32)


def beam_shares(domain: Domain, observation: int, texels: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Return, for T texels (rows, columns), (T,) the fraction of the light's axial intensity, and the samples' divisor.

    The divisor is 1 where ``beam_correction`` left the radiance as photographed. (1,) of 1 where lights are isotropic.
    """
    if domain.beams is None:
        return np.ones(1, np.float32), np.ones(1, np.float32)
    place, beam = np.split(domain.beams[observation], [3])
    share = beam_share(domain.bake.position[texels] - place, beam)
    return share, np.where(share >= MIN_SHARE, share, np.float32(1))
