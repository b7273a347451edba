"""Detection of materials for which a number has two distant optima."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce

import numpy as np

from ...results.maps import Maps
from ..phases.mixture import features_of, memberships, mixture
from ..settings.refinement_groups import Materials
from ..state.texel_subset import chosen_texels, merged_subset

_TEXELS = 40  # whose evidence is pooled: as many as the spatial prior reads (kernels/spatial_prior.taps_of)
_CONTRADICTED = 9.0  # −2 log of the likelihoods' ratio: three standard deviations
_AT_ONCE = 1 << 16  # texels


def with_modes(maps: Maps) -> Maps:
    """Return the maps of a whole domain with ``two_modes`` set; the same maps where there are no alternatives.

    The evidence of all texels of a material is pooled. One texel does not suffice: a mirror whose highlight falls
    between the lamps nearly always fits matt paint, too. Materials are a mixture (phases/mixture.py) over some of the
    texels. A number has two modes in a material where the mean of its texels' ``alternatives``, times _TEXELS (or the
    number of texels, if smaller), is under _CONTRADICTED.
    """
    if not maps.alternatives or not maps.solved.any():
        return maps
    parameters, names = maps.model.parameters, list(maps.alternatives)
    subset = reduce(lambda a, b: merged_subset([a, b]), (chosen_texels(*texels) for texels in _texels(maps)))
    features = features_of(maps.model, parameters, subset.values)
    finite = np.isfinite(features).all(axis=1)
    if not finite.any():
        return maps
    materials = mixture(features[finite], np.ones(np.count_nonzero(finite)), Materials().count)
    count = len(materials[0])
    weights, deviance_sums = np.zeros(count), np.zeros((count, len(names)))
    material = np.zeros(maps.solved.shape, np.uint8)
    for rows, columns, values in _texels(maps):
        weight = memberships(features_of(maps.model, parameters, values), *materials)
        material[rows, columns] = weight.argmax(axis=1)
        deviances = np.column_stack([maps.alternatives[name][rows, columns].min(axis=-1) for name in names])
        weights += weight.sum(axis=0)
        deviance_sums += weight.T @ deviances.astype(np.float64)
    mean = deviance_sums / np.maximum(weights, 1e-9)[:, None]
    bimodal = mean * np.minimum(weights, _TEXELS)[:, None] < _CONTRADICTED
    return replace(maps, two_modes={name: bimodal[material, i] & maps.solved for i, name in enumerate(names)})


def _texels(maps: Maps) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (n,) rows, (n,) columns and (n, C) float64 components of the solved texels, some rows at a time."""
    height, width = maps.solved.shape
    step = max(1, _AT_ONCE // width)
    for first in range(0, height, step):
        rows, columns = np.nonzero(maps.solved[first : first + step])
        values = [maps.values[p.name][first : first + step][rows, columns] for p in maps.model.parameters]
        yield rows + first, columns, np.concatenate(values, axis=-1).astype(np.float64)
