"""Room light in the samples of a domain."""

from __future__ import annotations

import numpy as np

from ...capture.bounds import without_bounds
from ...capture.inspect import room_light as pixels
from ...geometry.domain import Domain
from ..state.prepare import light_vectors


def room_light(domain: Domain, seed: int = 0) -> float:
    """Return ``capture.inspect.room_light`` for a random sample of texels."""
    places = np.flatnonzero(domain.solvable)
    chosen = np.sort(np.random.default_rng(seed % 2**32).permutation(places)[: pixels.PIXELS])
    texels = np.divmod(chosen, domain.shape[1])
    samples = without_bounds(domain.stack.texels(*texels))
    vectors, irradiance = light_vectors(domain, texels)
    light = irradiance.mean(axis=-1)
    usable = (samples[..., 3] > 0) & (light > 0)
    return pixels.room_light(samples[..., :3].mean(axis=-1), usable, vectors * light[..., None])
