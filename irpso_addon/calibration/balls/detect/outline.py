"""Outline of a ball near a circle: edge position in each of 72 directions, and the visible fraction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .edges import Edges

_ANGLES = 72
_CLEAR = 2.5  # of a low quantile of the profile's contrast: the contrast at which clarity is 0.5
_MIN_CLARITY = 0.5  # of a visible edge
_MAX_SHIFT = 0.12  # of the radius: of centre and radius
_STEPS = 4  # in each direction
_BAND, _MIN_BAND = 0.35, 8.0  # half the profile, of the radius and in pixels
_RIDGE = 2.0  # pixels: non-maximum suppression along the profile
_FLOOR = 0.3  # quantile of the profile's contrast: that of texture and noise


@dataclass(frozen=True)
class Outline:
    """A circle fitted to edges. support: fraction of its directions, 0…1, with a visible edge. points: (N, 2) on it."""

    x: float
    y: float
    radius: float
    support: float
    points: np.ndarray


def fitted(edges: Edges, x: float, y: float, radius: float, rounds: int = 3, min_shift: float = 0.0) -> Outline:
    """Return the circle near a circle, in pixel coordinates, with the clearest edges, by grids of decreasing step.

    In the first round x, y and radius each move by at most 12 % of the radius, or ``min_shift`` pixels if larger.
    """
    shift = max(_MAX_SHIFT * radius, min_shift)
    for _ in range(rounds):
        x, y, radius = _most_support(edges, x, y, radius, shift)
        shift /= 3
    return measured(edges, x, y, radius)


def _profiles(
    edges: Edges, x: float, y: float, radius: float, half: float, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit directions (A, 2), offsets from the circle (R,) and the clarity of the edge at each (A, R), 0…1."""
    angle = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    offsets = np.arange(-half, half + step / 2, step)
    places = np.array([x, y]) + (radius + offsets)[:, None] * direction[:, None]
    contrast = edges.across(places, np.broadcast_to(direction[:, None], places.shape))
    height, width = edges.size
    seen = (places >= 0).all(axis=-1) & (places[..., 0] <= width) & (places[..., 1] <= height)
    floor = _CLEAR * np.quantile(contrast, _FLOOR, axis=1, keepdims=True) + 1e-4
    ridge = contrast / np.maximum(_running_maximum(contrast, max(1, round(_RIDGE / step))), 1e-9)
    return direction, offsets, np.where(seen, contrast**2 / (contrast**2 + floor**2) * ridge**2, 0)


def _running_maximum(values: np.ndarray, reach: int) -> np.ndarray:
    """Return the running maximum of values (A, R) along rows, ``reach`` values to each side."""
    padded = np.pad(values, ((0, 0), (reach, reach)), mode="edge")
    return np.max([padded[:, i : i + values.shape[1]] for i in range(2 * reach + 1)], axis=0)


def _half_profile(radius: float) -> float:
    return min(max(_BAND * radius, _MIN_BAND), 0.9 * radius)


def _most_support(edges: Edges, x: float, y: float, radius: float, shift: float) -> tuple[float, float, float]:
    step = max(shift / _STEPS, 0.1)
    half = 1.8 * shift + _half_profile(radius)
    direction, offsets, clear = _profiles(edges, x, y, radius, half, step)
    # A box of three samples tolerates an elliptic outline.
    padded = np.pad(clear, ((0, 0), (1, 1)), mode="edge")
    clear = (padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]) / 3
    moves = np.arange(-_STEPS, _STEPS + 1) * step
    dx, dy, dr = np.meshgrid(moves, moves, moves, indexing="ij")
    distance = dr[..., None] + dx[..., None] * direction[:, 0] + dy[..., None] * direction[:, 1]
    index = np.clip(np.rint((distance - offsets[0]) / step).astype(int), 0, len(offsets) - 1)
    score = clear[np.arange(_ANGLES), index].sum(axis=-1)
    best = np.unravel_index(int(np.argmax(score)), score.shape)
    return x + float(dx[best]), y + float(dy[best]), radius + float(dr[best])


def measured(edges: Edges, x: float, y: float, radius: float) -> Outline:
    """Return the outline through the clearest edge of each direction, within 4 % of the radius or 1.5 pixels."""
    reach, step = max(0.04 * radius, 1.5), 0.2
    direction, offsets, clear = _profiles(edges, x, y, radius, _half_profile(radius), step)
    near = np.flatnonzero(np.abs(offsets) <= reach)
    index = near[0] + clear[:, near].argmax(axis=1)
    angles = np.arange(_ANGLES)
    peak = clear[angles, index]
    visible = (peak > _MIN_CLARITY) & (index > near[0]) & (index < near[-1])
    low, high = clear[angles, index - 1], clear[angles, np.minimum(index + 1, len(offsets) - 1)]
    curvature = np.maximum(2 * peak - low - high, 1e-9)
    place = radius + offsets[index] + step * np.clip(0.5 * (high - low) / curvature, -1, 1)
    points = np.array([x, y]) + place[:, None] * direction
    return Outline(x, y, radius, float(visible.mean()), points[visible])
