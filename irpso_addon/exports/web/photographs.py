"""Photographs of a card for its web page, with their lights and camera."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.domain import Domain, GeometryBake
from ...solver.views.pictures import display_white

PHOTOGRAPHS = 8  # in a page, by default
_MAX_BEND = 0.02  # largest deviation from a plane (lens distortion) without a warning, of the card's width


@dataclass(frozen=True)
class Photographs:
    """K photographs of a capture, in the card's frame: x right, y up, z toward the viewer.

    names: (K). unseen: (K,) bool, those held out of the fit. lights: (K, 4), intensities: (K, 3) and view:
    (4,) as in a Domain. place: (3, 3) rows: position of the upper left corner, the step of one texel to the right,
    and down. pictures: (K, H, W, 3) linear radiance, row 0 at the bottom. whites: (K), the radiance that the page shows
    as white in a photograph and in its render. warnings: approximations of the page.
    """

    names: tuple[str, ...]
    unseen: np.ndarray
    lights: np.ndarray
    intensities: np.ndarray
    view: np.ndarray
    place: np.ndarray
    pictures: Sequence[np.ndarray]
    whites: Sequence[float]
    warnings: tuple[str, ...] = ()


def photographs_of(domain: Domain, names: Sequence[str], unseen: Collection[int]) -> Photographs:
    """Return the observations of a card's domain. names: of all; unseen: the indices of those held out of the fit."""
    place, bend = _plane(domain.bake.position, domain.bake.coverage)
    warnings = (f"the lens bends the card by {bend:.1%} of its width; the page ignores this bend",)
    layers = [domain.stack.layer(k) for k in range(domain.observations)]
    return Photographs(
        tuple(names), np.isin(np.arange(len(names)), list(unseen)), domain.lights, domain.intensities,
        domain.views[0], place, [layer[..., :3] for layer in layers], [display_white(layer) for layer in layers],
        warnings if bend > _MAX_BEND else (),
    )  # fmt: skip


def spread(lights: np.ndarray, bake: GeometryBake, first: Sequence[int], count: int) -> list[int]:
    """Return the indices of ``count`` lights, in order: those of ``first``, then one by one the light whose direction
    is farthest from the nearest chosen one (Gonzalez 1985, Clustering to Minimize the Maximum Intercluster Distance).

    lights: (K, 4) as in a card's Domain, seen from the middle of its bake. Without ``first`` the most central begins.
    """
    toward = lights[:, :3] - lights[:, 3:] * bake.position[bake.coverage].mean(axis=0)
    toward = toward / np.linalg.norm(toward, axis=-1, keepdims=True)
    chosen = list(first)[:count]
    nearest = (toward @ toward[chosen].T).max(axis=-1) if chosen else toward @ -toward.mean(axis=0)
    while len(chosen) < min(count, len(toward)):
        nearest[chosen] = np.inf
        chosen.append(int(np.argmin(nearest)))
        own = toward @ toward[chosen[-1]]
        nearest = own if len(chosen) == 1 else np.maximum(nearest, own)
    return sorted(chosen)


def _plane(position: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit a plane to positions (H, W, 3); return ``Photographs.place`` and the largest distance over the width."""
    height, width = covered.shape
    rows, columns = np.nonzero(covered)
    terms = np.stack([np.ones(len(rows)), columns + 0.5, height - rows - 0.5], axis=-1)
    positions = position[rows, columns].astype(np.float64)
    place = np.linalg.lstsq(terms, positions, rcond=None)[0]
    largest = np.linalg.norm(terms @ place - positions, axis=-1).max()
    return place, float(largest / max(width * np.linalg.norm(place[1]), 1e-12))
