"""Checks of the lights against the samples of a domain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...capture.bounds import without_bounds
from ...capture.inspect import shading
from ...capture.inspect.light_order import light_order_message
from ...capture.inspect.room_light import room_light, room_light_message
from ...geometry.domain import Domain
from ..state.prepare import light_vectors


def light_warnings(domain: Domain, seed: int = 0, names: Sequence[str] = ()) -> list[str]:
    """Return warnings of room light and of lights in another order than the photographs ``names``, at random texels."""
    places = np.flatnonzero(domain.solvable)
    count = min(shading.PIXELS, len(places))
    chosen = np.sort(np.random.default_rng(seed % 2**32).choice(places, count, replace=False, shuffle=False))
    texels = np.divmod(chosen, domain.shape[1])
    samples = without_bounds(domain.stack.texels(*texels))
    vectors, irradiance = light_vectors(domain, texels)
    light = irradiance.mean(axis=-1)
    usable = (samples[..., 3] > 0) & (light > 0)
    pixels = samples[..., :3].mean(axis=-1), usable, vectors * light[..., None]
    return [text for text in (room_light_message(room_light(*pixels)), light_order_message(*pixels, names)) if text]
