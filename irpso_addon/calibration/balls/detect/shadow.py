"""Agreement of a ball's lights with its cast shadow, which tells balls from other objects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....core.filters import blurred
from ..ball import Ball, pixel_rays, tangents
from ..table import Table

_NEAREST, _FARTHEST = 1.08, 4.0  # radii from the outline's centre: where shadows are compared
_PIXELS, _MORE_PIXELS = 1500, 4000  # compared: for all tables, and for those near one
_TILTS = np.radians((0, 10, 20, 30, 40, 50, 60, 70))  # angles between the table's normal and the viewer
_HEIGHTS = (1.0, 1.6)  # of the ball's centre above the table, in radii: on it, or on a stand
_TILT_STEP = np.radians(2.5)  # angle between neighbouring tables
_GRAZING = 0.02  # least cosine between the table's normal and a light
_FULL = 0.8  # quantile over photographs: the lit value of a pixel
_MIN_LIT, _FAINTEST = 0.01, 0.001  # of white: darker pixels, and darker local means, show no shadow
_CLEAR = 5.0  # deviations of the noise: least lit value
_SHADED, _BRIGHTEST = 0.5, 1.3  # of a photograph's lit plane: darker is in shadow, brighter is clamped
_PLANES, _FLAT = 3, 0.01  # fits of a plane to a photograph's lit values; weight of the prior slope 0
_SOFT = 0.1  # of the radius: sigma of local means on black cloth
_BRIGHT = 4.0  # of the cloth's value: brighter values are clamped in local means
_LIT_PART = 0.2  # of the pixels: least lit part
_ELSEWHERE = 0.25  # weight of pixels outside the ball's shadows, where other objects may cast theirs
_SEEN = 0.05  # standard deviation of darkness; below, nothing is in shadow


def agreement(
    stack: np.ndarray,
    ball: Ball,
    lights: np.ndarray,
    near: Table | None = None,
    around: Ball | None = None,
    inverse: float = 0.0,
    noise: float = 0.0,
) -> tuple[float, Table] | None:
    """Return the correlation, −1…1, of the darkness around a ball with its predicted shadow, and the best table.

    stack: (K, H, W) grey values over white. lights: (K, 3) unit, from the ball, NaN where unknown. near: compare only
    tables near this one. around: the ball around which pixels are compared (default: ``ball``). inverse: the ball's
    radius over the lamps' distance. noise: standard deviation of the values. A correlation of 0: nothing darkens. None:
    no surface is lit, or fewer than three lights are known.
    """
    known = np.isfinite(lights).all(axis=-1)
    around = around or ball
    pixels = _around(around, (stack.shape[1], stack.shape[2]), _PIXELS if near is None else _MORE_PIXELS)
    if known.sum() < 3 or len(pixels) < 30:
        return None
    visible = _lit(stack[known], pixels, noise, around)
    if visible is None:
        return None
    pixels, values, lit = visible
    darkness = _centred(np.clip(1.25 - 1.5 * _flattened(values / lit, pixels), 0, 1))
    if darkness.std() < _SEEN:
        return 0.0, Table(np.array([0.0, 0.0, 1.0]), 1.0)
    centre = around.outline[:-1].mean(axis=0)
    # Shadows of other objects lie farther away.
    weight = around.radius_px**2 / ((pixels[:, ::-1] + 0.5 - centre) ** 2).sum(axis=-1)
    origin, ray = pixel_rays(ball.camera, pixels[:, ::-1] + 0.5)
    best = -1.0, Table(np.array([0.0, 0.0, 1.0]), 1.0)
    for table in _tables() if near is None else _neighbours(near):
        if (lights[known] @ table.up).min() > _GRAZING:
            shadow = shadowed(_meeting(origin, ray, ball, table), lights[known], inverse)
            cast = np.where(shadow.any(axis=0), 1.0, _ELSEWHERE)
            correlation = _correlation(_centred(shadow), darkness, weight * cast)
            if correlation > best[0]:
                best = correlation, table
    return best


def _lit(
    stack: np.ndarray, pixels: np.ndarray, noise: float, ball: Ball
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return lit pixels (N, 2), their values (K, N) and their lit values (N,); None if there are too few.

    On black cloth single values are noise, so local means over a tenth of the ball's radius replace them.
    """
    values, threshold = stack[:, *pixels.T], max(_MIN_LIT, _CLEAR * noise)
    lit = np.quantile(values, _FULL, axis=0)
    if (lit > threshold).sum() < max(30, _LIT_PART * len(pixels)):
        sigma = _SOFT * ball.radius_px
        threshold = max(_FAINTEST, _CLEAR * noise / max(2 * np.pi**0.5 * sigma, 1))
        centre = ball.outline[:-1].mean(axis=0)
        distance = np.hypot(*(pixels[:, ::-1] + 0.5 - centre).T) / ball.radius_px
        pixels = pixels[distance > _NEAREST + 2 * _SOFT]
        values = _local_means(stack, pixels, sigma, _BRIGHT * float(np.median(lit)))
        lit = np.quantile(values, _FULL, axis=0)
    enough = (lit > threshold).sum() >= max(30, _LIT_PART * len(pixels))
    return (pixels[lit > threshold], values[:, lit > threshold], lit[lit > threshold]) if enough else None


def _flattened(ratio: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Divide (K, N) by a plane fitted to each photograph's lit values, to remove the fall-off of near lamps."""
    position = (pixels - pixels.mean(axis=0)) / max(float(np.ptp(pixels)), 1.0)
    design = np.concatenate([np.ones((len(pixels), 1)), position], axis=1)
    products = (design[:, :, None] * design[:, None]).reshape(-1, 9)
    flat = _FLAT * len(pixels) * np.diag((0.0, 1.0, 1.0))
    level = np.maximum(np.quantile(ratio, _FULL, axis=1, keepdims=True), 1e-6)
    plane, limited = np.broadcast_to(level, ratio.shape), np.minimum(ratio, _BRIGHTEST * level)
    for _ in range(_PLANES):
        lit = (ratio > _SHADED * plane).astype(np.float64)
        square = (lit @ products).reshape(-1, 3, 3) + flat
        slope = np.linalg.solve(square, ((lit * limited) @ design)[..., None])[..., 0]
        plane = np.maximum(slope @ design.T, _SHADED * level)
    return ratio / plane


def _local_means(stack: np.ndarray, pixels: np.ndarray, sigma: float, most: float) -> np.ndarray:
    """Return Gaussian means (K, N) at pixels, of values clamped to ``most`` to limit spill from the ball."""
    low, high = pixels.min(axis=0), pixels.max(axis=0) + 1
    part = np.minimum(stack[:, low[0] : high[0], low[1] : high[1]], most)
    rows, columns = (pixels - low).T
    return np.stack([blurred(image, sigma)[rows, columns] for image in part])


def table_light(stack: np.ndarray, ball: Ball) -> float:
    """Return the median lit value, over white, around a ball."""
    pixels = _around(ball, (stack.shape[1], stack.shape[2]), _PIXELS)
    return float(np.median(np.quantile(stack[:, *pixels.T], _FULL, axis=0))) if len(pixels) else 0.0


def _around(ball: Ball, shape: tuple[int, int], most: int) -> np.ndarray:
    """Return rows and columns (N, 2) around a ball's outline, N about ``most`` or less."""
    outline = ball.outline[:-1]
    centre = outline.mean(axis=0)
    low = np.maximum(centre - _FARTHEST * ball.radius_px, 0).astype(int)
    high = np.minimum(centre + _FARTHEST * ball.radius_px + 1, shape[::-1]).astype(int)
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    distance = np.hypot(columns + 0.5 - centre[0], rows + 0.5 - centre[1]) / ball.radius_px
    pixels = np.stack([rows, columns], axis=-1)[(distance > _NEAREST) & (distance < _FARTHEST)]
    return pixels[:: max(1, len(pixels) // most)]


def _tables() -> list[Table]:
    """Return candidate tables over all tilts of up to 70° and two heights."""
    tables = []
    for tilt in _TILTS:
        count = max(1, round(16 * np.sin(tilt)))
        for azimuth in 2 * np.pi * np.arange(count) / count + np.pi / 2:
            up = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)])
            tables += [Table(up, height) for height in _HEIGHTS]
    return tables


def _neighbours(table: Table) -> Sequence[Table]:
    """Return a table and its eight neighbours in tilt."""
    across, upward = tangents(table.up)
    steps = [(x, y) for x in (-_TILT_STEP, 0, _TILT_STEP) for y in (-_TILT_STEP, 0, _TILT_STEP)]
    ups = [table.up + x * across + y * upward for x, y in steps]
    return [Table(up / np.linalg.norm(up), table.height) for up in ups]


def on_table(ball: Ball, table: Table, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the points of the table (N, 3) at pixels, relative to the ball's centre, in radii; NaN if none."""
    origin, ray = pixel_rays(ball.camera, np.stack([columns, rows], axis=-1) + 0.5)
    return _meeting(origin, ray, ball, table)


def _meeting(origin: np.ndarray, ray: np.ndarray, ball: Ball, table: Table) -> np.ndarray:
    falling = ray @ table.up
    foot = ball.centre - table.height * ball.radius * table.up
    length = ((foot - origin) @ table.up) / np.where(falling < -1e-3, falling, np.nan)
    return (origin + length[:, None] * ray - ball.centre) / ball.radius


def shadowed(point: np.ndarray, lights: np.ndarray, inverse: float = 0.0) -> np.ndarray:
    """Return 1 where points (N, 3), relative to the ball's centre in radii, lie in its shadow, else 0; (K, N).

    lights: (K, 3) unit, from its centre. inverse: its radius over the lamps' distance.
    """
    along, square = point @ lights.T, (point**2).sum(axis=-1)[:, None]
    # From a point p the lamp lies along l − inverse p, so the shadow is a cone.
    toward = along - inverse * square
    with np.errstate(invalid="ignore"):
        off = square - toward**2 / (1 - 2 * inverse * along + inverse**2 * square)
        return ((off < 1) & (toward < 0)).T.astype(np.float64)


def _centred(values: np.ndarray) -> np.ndarray:
    """Subtract the mean over the photographs from values (K, N)."""
    return values - values.mean(axis=0)


def _correlation(one: np.ndarray, other: np.ndarray, weight: np.ndarray) -> float:
    """Return the correlation of centred values (K, N) with weights (N,)."""
    size = np.sqrt((one**2 @ weight).sum() * (other**2 @ weight).sum())
    return float(((one * other) @ weight).sum() / size) if size > 0 else 0.0
