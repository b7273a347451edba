"""Outline of a ball near a circle: the place of its edge in each direction, and how much of it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .edges import Edges

_ANGLES = 72
_CLEAR = 2.5  # of the median contrast across the profile: an edge shows
_SHOWN = 0.5  # clarity of an edge that is seen
_SHIFT = 0.12  # of the radius: how far the centre and the radius may move
_STEPS = 4  # each way
_BAND, _LEAST_BAND = 0.35, 8.0  # half the profile, of the radius and in pixels
_RIDGE = 2.0  # pixels: of neighbouring places with an edge only the clearest counts
_FLOOR = 0.3  # quantile of the contrast across the profile that texture and noise have


@dataclass(frozen=True)
class Outline:
    """A circle on the edges. support: fraction of its directions, 0…1, where an edge shows. points: (N, 2) there."""

    x: float
    y: float
    radius: float
    support: float
    points: np.ndarray


def fitted(edges: Edges, x: float, y: float, radius: float, rounds: int = 3, least_shift: float = 0.0) -> Outline:
    """Return the circle near a circle (pixel coordinates) that most directions agree upon, to a part of a pixel.

    It is at most 12 % of the radius away in each of x, y and radius, or ``least_shift`` pixels.
    """
    shift = max(_SHIFT * radius, least_shift)
    for _ in range(rounds):
        x, y, radius = _agreed(edges, x, y, radius, shift)
        shift /= 3
    return measured(edges, x, y, radius)


def _profiles(
    edges: Edges, x: float, y: float, radius: float, half: float, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit directions (A, 2), distances (R,) and how clearly each place shows an edge, (A, R), 0…1."""
    angle = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    away = np.arange(-half, half + step / 2, step)
    places = np.array([x, y]) + (radius + away)[:, None] * direction[:, None]
    contrast = edges.across(places, np.broadcast_to(direction[:, None], places.shape))
    height, width = edges.size
    seen = (places >= 0).all(axis=-1) & (places[..., 0] <= width) & (places[..., 1] <= height)
    floor = _CLEAR * np.quantile(contrast, _FLOOR, axis=1, keepdims=True) + 1e-4
    ridge = contrast / np.maximum(_highest(contrast, max(1, round(_RIDGE / step))), 1e-9)
    return direction, away, np.where(seen, contrast**2 / (contrast**2 + floor**2) * ridge**2, 0)


def _highest(values: np.ndarray, reach: int) -> np.ndarray:
    """Return the maximum of values (A, R) along rows within ``reach`` values."""
    padded = np.pad(values, ((0, 0), (reach, reach)), mode="edge")
    return np.max([padded[:, i : i + values.shape[1]] for i in range(2 * reach + 1)], axis=0)


def _half(radius: float) -> float:
    return min(max(_BAND * radius, _LEAST_BAND), 0.9 * radius)


def _agreed(edges: Edges, x: float, y: float, radius: float, shift: float) -> tuple[float, float, float]:
    step = max(shift / _STEPS, 0.1)
    half = 1.8 * shift + _half(radius)
    direction, away, clear = _profiles(edges, x, y, radius, half, step)
    # A box of three samples: neighbours on an oblong outline agree, too.
    padded = np.pad(clear, ((0, 0), (1, 1)), mode="edge")
    clear = (padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]) / 3
    moves = np.arange(-_STEPS, _STEPS + 1) * step
    dx, dy, dr = np.meshgrid(moves, moves, moves, indexing="ij")
    distance = dr[..., None] + dx[..., None] * direction[:, 0] + dy[..., None] * direction[:, 1]
    at = np.clip(np.rint((distance - away[0]) / step).astype(int), 0, len(away) - 1)
    score = clear[np.arange(_ANGLES), at].sum(axis=-1)
    best = np.unravel_index(int(np.argmax(score)), score.shape)
    return x + float(dx[best]), y + float(dy[best]), radius + float(dr[best])


def measured(edges: Edges, x: float, y: float, radius: float) -> Outline:
    """Return the outline with the highest contrast of each direction close to a circle."""
    reach, step = max(0.04 * radius, 1.5), 0.2
    direction, away, clear = _profiles(edges, x, y, radius, _half(radius), step)
    near = np.flatnonzero(np.abs(away) <= reach)
    at = near[0] + clear[:, near].argmax(axis=1)
    angles = np.arange(_ANGLES)
    peak = clear[angles, at]
    shown = (peak > _SHOWN) & (at > near[0]) & (at < near[-1])
    low, high = clear[angles, at - 1], clear[angles, np.minimum(at + 1, len(away) - 1)]
    bend = np.maximum(2 * peak - low - high, 1e-9)
    place = radius + away[at] + step * np.clip(0.5 * (high - low) / bend, -1, 1)
    points = np.array([x, y]) + place[:, None] * direction
    return Outline(x, y, radius, float(shown.mean()), points[shown])
