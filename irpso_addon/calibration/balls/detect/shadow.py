"""Agreement of a ball's lights with the shadow that it throws: the test that no other thing passes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....core.filters import blurred
from ..ball import Ball, pixel_rays, tangents
from ..table import Table

_NEAREST, _FARTHEST = 1.08, 4.0  # of the ball's radius: where its shadow is looked for
_PIXELS, _MORE_PIXELS = 1500, 4000  # compared: among all tables, and near one
_TILTS = np.radians((0, 10, 20, 30, 40, 50, 60, 70))  # of the table's normal from the viewer
_HEIGHTS = (1.0, 1.6)  # of the ball's centre above the table, in radii: on it, or on a stand
_TILTED = np.radians(2.5)  # between neighbouring tables
_GRAZING = 0.02  # cosine between the table's normal and a light: the light is above the table
_FULL = 0.8  # quantile over photographs: a pixel in light
_LEAST_LIT, _FAINTEST = 0.01, 0.001  # of white: darker pixels, and means of pixels, show no shadow
_CLEAR = 5.0  # deviations of the noise: a shadow shows
_SHADED, _BRIGHTEST = 0.5, 1.3  # of a photograph's light: less is in shadow, more is of another thing
_PLANES, _FLAT = 3, 0.01  # fits of a photograph's light; weight of a slope of 0
_SOFT = 0.1  # of the radius: deviation of means on black cloth
_BRIGHT = 4.0  # of the cloth's value: brighter things count no more in means
_LIT_PART = 0.2  # of the pixels: so many show whether there is a shadow
_ELSEWHERE = 0.25  # weight where the ball throws no shadow: other things may
_SEEN = 0.05  # variation of darkness: below, nothing is in shadow


def agreement(
    stack: np.ndarray,
    ball: Ball,
    lights: np.ndarray,
    near: Table | None = None,
    around: Ball | None = None,
    inverse: float = 0.0,
    noise: float = 0.0,
) -> tuple[float, Table] | None:
    """Return the correlation, −1…1, between the darkness beside a ball and the shadow that it would throw on a table.

    stack: (K, H, W) grey values over white. lights: (K, 3) unit, from the ball, NaN where unknown. The table is the one
    that agrees best: of all, or of those ``near`` one. around: the ball beside which pixels are compared (default: the
    ball). inverse: the ball's radius over the lamps' distance. noise: deviation of the values. A correlation of 0:
    nothing becomes dark. None: there is no surface that the lamp lights.
    """
    known = np.isfinite(lights).all(axis=-1)
    around = around or ball
    pixels = _around(around, (stack.shape[1], stack.shape[2]), _PIXELS if near is None else _MORE_PIXELS)
    if known.sum() < 3 or len(pixels) < 30:
        return None
    seen = _lit(stack[known], pixels, noise, around)
    if seen is None:
        return None
    pixels, values, lit = seen
    darkness = _centred(np.clip(1.25 - 1.5 * _evened(values / lit, pixels), 0, 1))
    if darkness.std() < _SEEN:
        return 0.0, Table(np.array([0.0, 0.0, 1.0]), 1.0)
    middle = around.outline[:-1].mean(axis=0)
    # Farther away lie the shadows of other things.
    weight = around.radius_px**2 / ((pixels[:, ::-1] + 0.5 - middle) ** 2).sum(axis=-1)
    origin, ray = pixel_rays(ball.camera, pixels[:, ::-1] + 0.5)
    best = -1.0, Table(np.array([0.0, 0.0, 1.0]), 1.0)
    for table in _tables() if near is None else _near(near):
        if (lights[known] @ table.up).min() > _GRAZING:
            shadow = shadowed(_meeting(origin, ray, ball, table), lights[known], inverse)
            reached = np.where(shadow.any(axis=0), 1.0, _ELSEWHERE)
            correlation = _correlation(_centred(shadow), darkness, weight * reached)
            if correlation > best[0]:
                best = correlation, table
    return best


def _lit(
    stack: np.ndarray, pixels: np.ndarray, noise: float, ball: Ball
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the pixels (N, 2) that a lamp lights, their values (K, N) and the value in light (N,).

    None: there are too few. On black cloth single values are noise: means over a tenth of the ball's radius are not.
    """
    values, clear = stack[:, *pixels.T], max(_LEAST_LIT, _CLEAR * noise)
    lit = np.quantile(values, _FULL, axis=0)
    if (lit > clear).sum() < max(30, _LIT_PART * len(pixels)):
        sigma = _SOFT * ball.radius_px
        clear = max(_FAINTEST, _CLEAR * noise / max(2 * np.pi**0.5 * sigma, 1))
        middle = ball.outline[:-1].mean(axis=0)
        away = np.hypot(*(pixels[:, ::-1] + 0.5 - middle).T) / ball.radius_px
        pixels = pixels[away > _NEAREST + 2 * _SOFT]
        values = _means(stack, pixels, sigma, _BRIGHT * float(np.median(lit)))
        lit = np.quantile(values, _FULL, axis=0)
    enough = (lit > clear).sum() >= max(30, _LIT_PART * len(pixels))
    return (pixels[lit > clear], values[:, lit > clear], lit[lit > clear]) if enough else None


def _evened(ratio: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return values (K, N) over planes fitted to each photograph's lit ones: the light of a near lamp falls off."""
    place = (pixels - pixels.mean(axis=0)) / max(float(np.ptp(pixels)), 1.0)
    design = np.concatenate([np.ones((len(pixels), 1)), place], axis=1)
    products = (design[:, :, None] * design[:, None]).reshape(-1, 9)
    flat = _FLAT * len(pixels) * np.diag((0.0, 1.0, 1.0))
    full = np.maximum(np.quantile(ratio, _FULL, axis=1, keepdims=True), 1e-6)
    plane, most = np.broadcast_to(full, ratio.shape), np.minimum(ratio, _BRIGHTEST * full)
    for _ in range(_PLANES):
        lit = (ratio > _SHADED * plane).astype(np.float64)
        square = (lit @ products).reshape(-1, 3, 3) + flat
        slope = np.linalg.solve(square, ((lit * most) @ design)[..., None])[..., 0]
        plane = np.maximum(slope @ design.T, _SHADED * full)
    return ratio / plane


def _means(stack: np.ndarray, pixels: np.ndarray, sigma: float, most: float) -> np.ndarray:
    """Return weighted means (K, N) around pixels, of values up to ``most``: the ball's own light spreads no farther."""
    low, high = pixels.min(axis=0), pixels.max(axis=0) + 1
    part = np.minimum(stack[:, low[0] : high[0], low[1] : high[1]], most)
    rows, columns = (pixels - low).T
    return np.stack([blurred(image, sigma)[rows, columns] for image in part])


def table_light(stack: np.ndarray, ball: Ball) -> float:
    """Return the median value, over white, of what lies around a ball where a lamp lights it."""
    pixels = _around(ball, (stack.shape[1], stack.shape[2]), _PIXELS)
    return float(np.median(np.quantile(stack[:, *pixels.T], _FULL, axis=0))) if len(pixels) else 0.0


def _around(ball: Ball, shape: tuple[int, int], most: int) -> np.ndarray:
    """Return (N, 2) rows and columns around a ball's outline, N about ``most`` or less."""
    outline = ball.outline[:-1]
    middle = outline.mean(axis=0)
    low = np.maximum(middle - _FARTHEST * ball.radius_px, 0).astype(int)
    high = np.minimum(middle + _FARTHEST * ball.radius_px + 1, shape[::-1]).astype(int)
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    away = np.hypot(columns + 0.5 - middle[0], rows + 0.5 - middle[1]) / ball.radius_px
    places = np.stack([rows, columns], axis=-1)[(away > _NEAREST) & (away < _FARTHEST)]
    return places[:: max(1, len(places) // most)]


def _tables() -> list[Table]:
    """Return tables that a camera may see."""
    found = []
    for tilt in _TILTS:
        count = max(1, round(16 * np.sin(tilt)))
        for turn in 2 * np.pi * np.arange(count) / count + np.pi / 2:
            up = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
            found += [Table(up, height) for height in _HEIGHTS]
    return found


def _near(table: Table) -> Sequence[Table]:
    """Return a table and some that are tilted a little more."""
    across, upward = tangents(table.up)
    steps = [(x, y) for x in (-_TILTED, 0, _TILTED) for y in (-_TILTED, 0, _TILTED)]
    ups = [table.up + x * across + y * upward for x, y in steps]
    return [Table(up / np.linalg.norm(up), table.height) for up in ups]


def on_table(ball: Ball, table: Table, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the points (N, 3) of the table that pixels show, from the ball's centre, in radii; NaN where none."""
    origin, ray = pixel_rays(ball.camera, np.stack([columns, rows], axis=-1) + 0.5)
    return _meeting(origin, ray, ball, table)


def _meeting(origin: np.ndarray, ray: np.ndarray, ball: Ball, table: Table) -> np.ndarray:
    falling = ray @ table.up
    foot = ball.centre - table.height * ball.radius * table.up
    length = ((foot - origin) @ table.up) / np.where(falling < -1e-3, falling, np.nan)
    return (origin + length[:, None] * ray - ball.centre) / ball.radius


def shadowed(point: np.ndarray, lights: np.ndarray, inverse: float = 0.0) -> np.ndarray:
    """Return (K, N) 1 where points (N, 3), from the ball's centre in radii, lie in the shadow of a ball, else 0.

    lights: (K, 3) unit, from its centre. inverse: its radius over the lamps' distance.
    """
    along, square = point @ lights.T, (point**2).sum(axis=-1)[:, None]
    # From a point p the lamp lies along the light l less inverse p: a cone of shadow.
    toward = along - inverse * square
    with np.errstate(invalid="ignore"):
        off = square - toward**2 / (1 - 2 * inverse * along + inverse**2 * square)
        return ((off < 1) & (toward < 0)).T.astype(np.float64)


def _centred(values: np.ndarray) -> np.ndarray:
    """Return (K, N) values less their mean over the photographs: what never changes is no shadow."""
    return values - values.mean(axis=0)


def _correlation(one: np.ndarray, other: np.ndarray, weight: np.ndarray) -> float:
    """Return the correlation of centred values (K, N) with weights (N,)."""
    size = np.sqrt((one**2 @ weight).sum() * (other**2 @ weight).sum())
    return float(((one * other) @ weight).sum() / size) if size > 0 else 0.0
