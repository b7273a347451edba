"""A small subset of a domain's texels, as a domain, for the estimation of lights; and the schedule for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...capture.bounds import without_bounds
from ...geometry.domain import Domain, with_texels
from ..settings.schedule import Schedule, load_schedule
from ..state.prepare import light_vectors
from .semi_calibrated import relative_intensities

_TEXELS = 1024  # at most; 5 % noise per sample then gives 0.2 % error per light
_SAMPLES = 1 << 16  # at most, over all observations, but at least _MIN_TEXELS texels
_MIN_TEXELS = 384
_WIDTH = 64  # of the subset's grid, in texels
_CANDIDATES = 3  # candidates per texel; each is read from all layers of a stack, which may be on disk
_EVERY_LIGHT = 128  # texels per light, if so many are lit by it
_CELLS = 5  # cells along each axis of the histogram of normals


@dataclass(frozen=True)
class LightTexels:
    """Some texels of a domain, and the first estimate of its lights.

    domain: h×w independent texels; neighbours in it are not neighbours in the source. factors: (n, 3) on the given
    intensities of the fitted observations. rows, columns: positions of its texels in the source, row by row; the rest
    of the grid is not covered.
    """

    domain: Domain
    factors: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    def part(self, value: np.ndarray) -> np.ndarray:
        """Return (h, w, …): a map (H, W, …) of the source at these texels."""
        return _grid(value[self.rows, self.columns], self.domain.shape)


def draw_texels(domain: Domain, seed: int, fitted: np.ndarray, most: int = _TEXELS) -> LightTexels:
    """Return texels under many lights, with normals as widely spread as the subject's, and a first estimate.

    Uses numpy only, so it may run in a thread. fitted: indices of the observations in the fit. most: number of texels.
    """
    places = np.flatnonzero(domain.solvable)
    count = min(most, max(_MIN_TEXELS, _SAMPLES // domain.observations))
    rng = np.random.default_rng(seed % 2**32)
    chosen = np.sort(rng.permutation(places)[: _CANDIDATES * count])
    rows, columns = np.divmod(chosen, domain.shape[1])
    stack = without_bounds(domain.stack.texels(rows, columns))  # bounds do not determine lights
    vectors, irradiance = (a[fitted] for a in light_vectors(domain, (rows, columns)))
    lit = _well_lit(stack[fitted], 2 * count)
    vectors, irradiance = (a if a.shape[1] == 1 else a[:, lit] for a in (vectors, irradiance))
    rows, columns, stack = rows[lit], columns[lit], stack[:, lit]
    samples = stack[fitted]
    radiance = np.where(samples[..., 3:] > 0, samples[..., :3], 0).astype(np.float64)
    factors, normals = relative_intensities(radiance, samples[..., 3].astype(np.float64), vectors, irradiance)
    world = np.einsum("tc,tcd->td", normals, domain.bake.frames((rows, columns)))
    order = np.sort(evenly_facing(world, rng)[:count])
    part = _gathered(domain, stack[:, order], rows[order], columns[order])
    return LightTexels(part, factors, rows[order], columns[order])


def fixed_at(fixed: Mapping[str, np.ndarray], texels: LightTexels) -> dict[str, np.ndarray]:
    """Return fixed maps, (H, W, components) or (components,), at these texels."""
    return {name: value if np.ndim(value) == 1 else texels.part(np.asarray(value)) for name, value in fixed.items()}


def _well_lit(stack: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of the ``count`` texels with the most observations, and of some texels per observation."""
    lit = (stack[..., 3] > 0) & (stack[..., :3] > 0).any(axis=-1)
    order = np.argsort(-lit.sum(axis=0), kind="stable")
    chosen = np.zeros(len(order), bool)
    chosen[order[:count]] = True
    for layer in lit:
        short = _EVERY_LIGHT - int((layer & chosen).sum())
        if short > 0:
            chosen[order[layer[order] & ~chosen[order]][:short]] = True
    return np.flatnonzero(chosen & (lit.sum(axis=0) >= 3))


def evenly_facing(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return indices in an order in which every prefix has about equally many texels of each normal."""
    cells = np.floor((normals + 1) * (_CELLS / 2)).clip(0, _CELLS - 1).astype(int) @ (1, _CELLS, _CELLS**2)
    shuffled = rng.permutation(len(cells))
    by_cell = shuffled[np.argsort(cells[shuffled], kind="stable")]
    ordered = cells[by_cell]
    first = np.r_[True, ordered[1:] != ordered[:-1]]
    rank = np.arange(len(ordered)) - np.maximum.accumulate(np.where(first, np.arange(len(ordered)), 0))
    return by_cell[np.argsort(rank, kind="stable")]


def _gathered(domain: Domain, stack: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> Domain:
    width = min(_WIDTH, max(len(rows), 1))
    shape = -(-max(len(rows), 1) // width), width
    bake = domain.bake.map_arrays(lambda values: _grid(values[rows, columns], shape))
    layers = np.stack([_grid(layer, shape) for layer in stack])
    return with_texels(domain, bake, layers)


def _grid(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    filled = np.zeros((shape[0] * shape[1], *values.shape[1:]), values.dtype)
    filled[: len(values)] = values
    return filled.reshape(*shape, *values.shape[1:])


def texel_schedule(schedule: Schedule | None = None) -> Schedule:
    """Return a schedule, by default ``standard``, for texels drawn at random and lights that may be wrong.

    These have no neighbours: nothing makes their normals one surface. Shared materials stay.
    """
    return (schedule or load_schedule("standard")).without_rounds().replaced(
        c3=0.0, neighbour_interval=0, refinement_rounds=0, refinement_race_iterations=0, prior_rounds=0,
        surface_rounds=0, levels=1, prefit_indirect_share=0.0,
    )  # fmt: skip
