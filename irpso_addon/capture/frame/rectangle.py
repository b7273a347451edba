"""Searches the outline of a flat subject: the dominant quadrilateral of a picture, its sides fitted to the edges.

Pixels count from the UPPER left corner of the picture, to the right and down; corners clockwise from the upper left
one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...core.filters import sampled
from ...core.opencv import opencv

_WORKING = 800  # pixels of the longer side for the search of quadrilaterals
_MIN_AREA = 0.04  # of the picture
_BORDER = 0.006  # of the diagonal: a corner nearer to the border lies outside, or is the picture's own
_SAME = 0.02  # of the diagonal: outlines with nearer corners are the same
_RIVAL = 0.35  # of the largest's area: a larger second rectangle makes the choice ambiguous
_SAMPLES = 80  # along a side
_REACH = 0.012  # of the diagonal: search distance of an edge from the first outline
_ENDS = 0.06  # of a side, ignored at each end: corners may be round
_SUPPORT = 0.6  # least share of a side's samples with an edge on its line
_ON_LINE = 1.5  # pixels: largest distance of an edge from its line
_MIN_STEP = 0.03  # least contrast of an edge, of the range of display values


def quadrilaterals(codes: np.ndarray) -> list[np.ndarray]:
    """Return the outlines (4, 2) in a picture, with edges along all sides, to subpixel precision, the largest first.

    codes: (H, W) uint8 display values, row 0 at the TOP. Outlines within another are excluded.
    """
    cv2 = opencv("finding a card's corners")
    height, width = codes.shape
    factor = min(1.0, _WORKING / max(height, width))
    small = cv2.resize(codes, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1 else codes
    grey = _grey(codes)
    outlines: list[np.ndarray] = []
    for rough in sorted(_candidates(cv2, small), key=_area, reverse=True):
        outline = rough / factor
        if any(_same(outline, other, (width, height)) for other in outlines):
            continue
        fine = _fitted(grey, outline)
        if fine is None or any(_same(fine, other, (width, height)) or _within(fine, other) for other in outlines):
            continue
        outlines.append(fine)
    return sorted(outlines, key=_area, reverse=True)


def dominant(outlines: list[np.ndarray]) -> tuple[np.ndarray | None, bool]:
    """Return the largest outline, and whether another of over 0.35 of its area makes the choice ambiguous."""
    if not outlines:
        return None, False
    first, *others = outlines
    return first, any(_area(other) > _RIVAL * _area(first) for other in others)


def fitted(codes: np.ndarray, outline: np.ndarray) -> np.ndarray | None:
    """Return an outline (4, 2) with its sides fitted to the edges near them; None if a side has no edge.

    A side's line is the least squares fit to the positions of steepest gradient across it, without outliers.
    """
    return _fitted(_grey(codes), outline)


def _grey(codes: np.ndarray) -> np.ndarray:
    return codes.astype(np.float32) / 255


def _fitted(grey: np.ndarray, outline: np.ndarray) -> np.ndarray | None:
    reach = max(_REACH * math.hypot(*grey.shape), 3.0)
    for span in (reach, max(reach / 3, 2.5)):
        sides = [_side(grey, outline[k], outline[(k + 1) % 4], span) for k in range(4)]
        lines = [line for line in sides if line is not None]
        if len(lines) < 4:
            return None
        corners = [np.cross(lines[k - 1], lines[k]) for k in range(4)]
        if any(abs(corner[2]) < 1e-9 for corner in corners):
            return None
        outline = np.array([corner[:2] / corner[2] for corner in corners])
    inside = _BORDER * math.hypot(*grey.shape)
    size = np.array(grey.shape[::-1])
    return outline if ((outline > inside) & (outline < size - inside)).all() else None


def _candidates(cv2: Any, small: np.ndarray) -> list[np.ndarray]:
    """Return convex quadrilaterals (4, 2), clockwise, of the contours at several thresholds and of Canny edges."""
    smooth = cv2.GaussianBlur(small, (5, 5), 0)
    level, _ = cv2.threshold(smooth, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    masks = [(smooth > value).astype(np.uint8) for value in (level, 0.6 * level, 0.35 * level, (level + 255) / 2)]
    masks += [1 - mask for mask in masks]
    for low in (20, 50):
        edges = cv2.Canny(smooth, low, 3 * low)
        masks.append(cv2.morphologyEx(edges, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)))
    candidates = []
    for mask in masks:
        contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
        for contour in contours:
            hull = cv2.convexHull(contour)
            if cv2.contourArea(hull) < _MIN_AREA * small.size:
                continue
            shape = cv2.approxPolyDP(hull, 0.03 * cv2.arcLength(hull, True), True)[:, 0]
            if len(shape) == 4 and cv2.contourArea(shape) > 0.85 * cv2.contourArea(hull):
                candidates.append(_from_upper_left(shape.astype(float) + 0.5))
    return candidates


def _from_upper_left(corners: np.ndarray) -> np.ndarray:
    """Return corners (4, 2) clockwise, y down, from the one nearest to the upper left."""
    away = corners - corners.mean(axis=0)
    ordered = corners[np.argsort(np.arctan2(away[:, 1], away[:, 0]))]
    return np.roll(ordered, -int(ordered.sum(axis=1).argmin()), axis=0)


def _side(grey: np.ndarray, a: np.ndarray, b: np.ndarray, reach: float) -> np.ndarray | None:
    """Return the line (3,) of steepest gradients across the side from a to b; None if too few lie on one line."""
    along = b - a
    length = float(np.linalg.norm(along))
    if length < 8:
        return None
    normal = np.array([-along[1], along[0]]) / length
    places = a + np.linspace(_ENDS, 1 - _ENDS, _SAMPLES)[:, None] * along
    offsets = np.arange(-reach, reach + 0.25, 0.5)
    gradient = np.gradient(_smooth(sampled(grey, places[:, None] + offsets[:, None] * normal)), 0.5, axis=1)
    sign = np.sign(np.median(gradient[np.arange(len(gradient)), np.abs(gradient).argmax(axis=1)])) or 1.0
    strength = np.clip(gradient * sign, 0, None)[:, 1:-1]
    best = strength.argmax(axis=1)
    peak = strength[np.arange(len(best)), best]
    clear = (peak > _MIN_STEP) & (best > 0) & (best < strength.shape[1] - 1)
    if clear.mean() < _SUPPORT:
        return None
    rows, at = np.flatnonzero(clear), best[clear]
    left, middle, right = (strength[rows, at + k] for k in (-1, 0, 1))
    shift = 0.5 * (left - right) / np.minimum(left - 2 * middle + right, -1e-9)
    edge = places[rows] + (offsets[1:-1][at] + 0.5 * np.clip(shift, -1, 1))[:, None] * normal
    return _line(edge, normal, len(places))


def _line(points: np.ndarray, normal: np.ndarray, samples: int) -> np.ndarray | None:
    """Fit a line (3,) about perpendicular to ``normal`` to points (N, 2); None if too few of ``samples`` lie on it."""
    along = np.array([normal[1], -normal[0]])
    middle = points.mean(axis=0)
    t, s = (points - middle) @ along, (points - middle) @ normal
    # Start: the median of slopes between samples half a side apart (Theil–Sen), which many outliers do not move.
    half = len(t) // 2
    slope = float(np.median((s[half : 2 * half] - s[:half]) / np.maximum(t[half : 2 * half] - t[:half], 1e-9)))
    offset = float(np.median(s - slope * t))
    for _ in range(3):
        near = np.abs(s - slope * t - offset) < _ON_LINE
        if near.sum() < _SUPPORT * samples:
            return None
        slope, offset = np.polyfit(t[near], s[near], 1)
    direction = along + slope * normal
    point = middle + offset * normal
    return np.cross(np.append(point, 1.0), np.append(point + direction, 1.0))


def _smooth(values: np.ndarray) -> np.ndarray:
    padded = np.pad(values, [(0, 0), (2, 2)], mode="edge")
    return (padded[:, :-4] + 2 * padded[:, 1:-3] + 3 * padded[:, 2:-2] + 2 * padded[:, 3:-1] + padded[:, 4:]) / 9


def _area(outline: np.ndarray) -> float:
    x, y = outline.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def _same(a: np.ndarray, b: np.ndarray, size: tuple[int, int]) -> bool:
    return float(np.linalg.norm(a - b, axis=1).max()) < _SAME * math.hypot(*size)


def _within(inner: np.ndarray, outer: np.ndarray) -> bool:
    """Return whether the mean of an outline's corners lies within another outline (clockwise, y down)."""
    middle = inner.mean(axis=0)
    sides = np.roll(outer, -1, axis=0) - outer
    away = middle - outer
    return bool((sides[:, 0] * away[:, 1] - sides[:, 1] * away[:, 0] > 0).all())
