"""Plots of errors over iterations: curves and ticks in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...results.scales import linear_ticks, log_ticks, round_down, round_up, tick_text
from .layout import Rectangle

_MIN_ITERATIONS = 10  # least length of the iterations' axis
_MIN_SPAN = 10.0  # least ratio of the error axis's ends, so that a constant curve looks constant
_MIN_RATIO = 1e-8  # least error drawn over the axis's upper end: smaller ones are rounding


@dataclass(frozen=True)
class Plot:
    """A plot in pixels. x_ticks, y_ticks: (pixel, text). minor: pixels of y ticks without text.

    curves: one (N, 2) array per curve, empty if it has no points.
    """

    area: Rectangle
    x_ticks: tuple[tuple[float, str], ...]
    y_ticks: tuple[tuple[float, str], ...]
    minor: tuple[float, ...]
    curves: tuple[np.ndarray, ...]


def curve_plot(area: Rectangle, curves: Sequence[Sequence[tuple[float, float]]]) -> Plot:
    """Return the plot of curves of (iteration, error): iterations linear from 0, errors logarithmic.

    Errors that are not finite are left out. Errors of 0 lie on the axis.
    """
    points = [_finite_points(curve) for curve in curves]
    all_points = np.concatenate([np.empty((0, 2)), *points])
    last = max(_MIN_ITERATIONS, all_points[:, 0].max(initial=0))
    low, high = _error_range(all_points[:, 1])
    major, minor = log_ticks(low, high)

    def x_of(iteration):
        return area.x + area.width * np.asarray(iteration) / last

    def y_of(error):
        fraction = np.log(np.clip(error, low, high) / low) / np.log(high / low)
        return area.y + area.height * fraction

    most_ticks = max(2, int(area.width / (9 * max(len(tick_text(round(last))), 2))))
    return Plot(
        area,
        tuple((float(x_of(t)), tick_text(t)) for t in linear_ticks(0, last, min(6, most_ticks)) if t == int(t)),
        tuple((float(y_of(tick)), tick_text(tick)) for tick in major),
        tuple(float(y_of(tick)) for tick in minor),
        tuple(_thinned(np.stack([x_of(p[:, 0]), y_of(p[:, 1])], axis=-1), int(area.width)) for p in points),
    )


def _finite_points(curve: Sequence[tuple[float, float]]) -> np.ndarray:
    points = np.asarray(curve, np.float64).reshape(-1, 2)
    return points[np.isfinite(points).all(axis=1) & (points[:, 0] >= 0)]


def _error_range(errors: np.ndarray) -> tuple[float, float]:
    positive = errors[errors > 0]
    if not len(positive):
        return 0.01, 1.0
    high = round_up(positive.max())
    low = round_down(max(positive.min(), _MIN_RATIO * high))
    return min(low, high / _MIN_SPAN), high


def _thinned(points: np.ndarray, most: int) -> np.ndarray:
    """Return at most ``most`` points of a curve, including the last."""
    if len(points) <= most or most < 2:
        return points
    return points[np.unique(np.linspace(0, len(points) - 1, most).round().astype(int))]
