"""Pictures of a result: preview.png, convergence.png, live.png and the strip of a converging map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.canvas import BACKGROUND, FAINT, GRID, PANEL, TEXT, Canvas
from ..core.encode import encode_normal, srgb_from_linear
from ..reflectance.model import Parameter
from .false_color import UNCOVERED, false_color
from .scales import linear_ticks, round_up, tick_text

MARK_COLORS = ((0.96, 0.36, 0.33), (0.42, 0.80, 0.38), (0.38, 0.66, 1.00), (0.98, 0.80, 0.30))
_SHOWN = 360  # pixels of height: integer factors enlarge small maps, or reduce large ones, to about this
_MARGIN, _GAP = 28, 14
_HEADING, _LABEL, _SMALL = 13.0, 11.0, 9.0
_BAR = 14


@dataclass(frozen=True)
class PreviewRow:
    """One row of a preview: reference, recovered, and error.

    label: at the left. reference, recovered: (H, W, 3) display values (see ``display_image``). error: (H, W) in
    ``unit``. covered: (H, W) bool, visible texels. counted: (H, W) bool, texels of the error statistics, by default the
    covered ones. maximum: error shown as red, by default the 99th percentile, rounded up.
    """

    label: str
    reference: np.ndarray
    recovered: np.ndarray
    error: np.ndarray
    unit: str = "%"
    covered: np.ndarray | None = None
    counted: np.ndarray | None = None
    maximum: float | None = None

    @property
    def compared(self) -> np.ndarray | None:
        """(H, W) bool: texels of the error statistics, None for all."""
        return self.covered if self.counted is None else self.counted


@dataclass(frozen=True)
class Curves:
    """Errors of marked texels against iteration. iterations: (N,). errors: (N, M) in ``unit``, M ≤ 4."""

    title: str
    iterations: np.ndarray
    errors: np.ndarray
    unit: str = "%"
    log: bool = False


def display_image(parameters: Sequence[Parameter], values: Sequence[np.ndarray]) -> np.ndarray:
    """Return (H, W, 3) display values of one map: its parameters' channels in order, padded with black.

    Normals and sRGB maps are encoded as such, others as a fraction of their range.
    """
    channels = []
    for parameter, value in zip(parameters, values, strict=True):
        low, high = parameter.range
        if parameter.is_normal:
            channels.append(encode_normal(value))
        elif parameter.color_space == "sRGB":
            channels.append(srgb_from_linear(value))
        else:
            channels.append((np.asarray(value, np.float32) - low) / (high - low))
    image = np.concatenate(channels, axis=-1)[..., :3]
    if image.shape[-1] == 1:
        image = np.repeat(image, 3, axis=-1)
    elif image.shape[-1] == 2:
        image = np.concatenate([image, np.zeros_like(image[..., :1])], axis=-1)
    return np.clip(np.nan_to_num(image), 0, 1).astype(np.float32)


def on_one_scale(rows: Sequence[PreviewRow]) -> list[PreviewRow]:
    """Return rows of one unit with the same error shown as red: the largest 99th percentile of a row, rounded up."""
    maximum = max((default_maximum([row.error], row.compared) for row in rows), default=None)
    return [replace(row, maximum=maximum) for row in rows]


def preview(rows: Sequence[PreviewRow], columns: Sequence[str] = ("Ground truth", "Recovered", "Error")) -> np.ndarray:
    """Return (H, W, 3) display values: reference | recovered | error of each row (Nagano et al. Fig. 6)."""
    cells = [_fit(row.recovered.shape[:2]) for row in rows]
    width = max(_size(row.recovered.shape[:2], fit)[1] for row, fit in zip(rows, cells, strict=True))
    heights = [_size(row.recovered.shape[:2], fit)[0] for row, fit in zip(rows, cells, strict=True)]
    left, top, caption = _MARGIN + 22, _MARGIN + 26, 30
    legend = 96
    canvas = Canvas(left + 3 * width + 2 * _GAP + legend, top + sum(heights) + caption * len(rows) + _MARGIN - 16)
    for column, title in enumerate(columns):
        canvas.text(left + column * (width + _GAP) + width / 2, top - 14, title, _HEADING, TEXT, 0.5)
    y = top
    for row, fit, height in zip(rows, cells, heights, strict=True):
        canvas.text_upward(_MARGIN + 6, y + height / 2, row.label, _HEADING)
        maximum = row.maximum if row.maximum is not None else default_maximum([row.error], row.compared)
        error = false_color(row.error, maximum, row.compared)
        images = (_masked(row.reference, row.covered), _masked(row.recovered, row.covered), error)
        for column, image in enumerate(images):
            scaled = _scaled(image, fit)
            canvas.image(left + column * (width + _GAP) + (width - scaled.shape[1]) // 2, y, scaled)
        x = left + 3 * width + 2 * _GAP
        _legend(canvas, x + 10, y, height, maximum, row.unit)
        canvas.text(x, y + height + 16, _caption(row), _SMALL, FAINT, 1.0)
        y += height + caption
    return canvas.result()


def convergence(image: np.ndarray, marks: Sequence[tuple[int, int]], panels: Sequence[Curves]) -> np.ndarray:
    """Return (H, W, 3) display values: an image with marked texels, then their errors (Nagano et al. Fig. 4).

    image: (H, W, 3) display values. marks: (x, y) texels from the lower left, in the order of the curves.
    """
    fit = _fit(image.shape[:2])
    height, width = _size(image.shape[:2], fit)
    panel, axis = max(300, round(height * 0.95)), 66
    top, bottom = _MARGIN + 26, 52
    canvas = Canvas(_MARGIN * 2 + width + len(panels) * (panel + axis) + 8, top + height + bottom)
    canvas.image(_MARGIN, top, _scaled(image, fit))
    canvas.text(_MARGIN + width / 2, top - 14, "Recovered", _HEADING, TEXT, 0.5)
    for color, (x, y) in zip(MARK_COLORS, marks, strict=False):
        px = _MARGIN + (x + 0.5) * width / image.shape[1]
        py = top + height - (y + 0.5) * height / image.shape[0]
        canvas.ring(px, py, 8.5, 6.5, BACKGROUND)
        canvas.ring(px, py, 10.5, 1.2, TEXT)
        canvas.ring(px, py, 8, 3.0, color)
    for number, curves in enumerate(panels):
        left = _MARGIN + width + number * (panel + axis) + axis
        _plot(canvas, curves, left, top, panel, height)
    return canvas.result()


def spread_marks(places: np.ndarray, count: int = 4) -> list[int]:
    """Return the indices of at most ``count`` points (N, 2) far from each other, for marks, the most central first.

    Excludes the outer fifth, where the mark would hide its texel.
    """
    places = np.asarray(places, np.float64)
    distance = np.linalg.norm(places - np.median(places, axis=0), axis=1)
    inner = distance <= 0.8 * distance.max()
    chosen = [int(np.argmin(distance))]
    while len(chosen) < min(count, len(places)):
        nearest = np.min([np.linalg.norm(places - places[i], axis=1) for i in chosen], axis=0)
        chosen.append(int(np.argmax(np.where(inner, nearest, -1))))
    return chosen


def gallery(
    heading: str, images: Sequence[np.ndarray], labels: Sequence[str], covered: np.ndarray | None = None
) -> np.ndarray:
    """Return (H, W, 3) display values: maps side by side under a heading.

    images: (H, W, 3) display values each. labels: one above each. covered: (H, W) bool.
    """
    fit = _fit(images[0].shape[:2])
    height, width = _size(images[0].shape[:2], fit)
    top = _MARGIN + 52
    canvas = Canvas(2 * _MARGIN + len(images) * (width + _GAP) - _GAP, top + height + _MARGIN)
    canvas.text(_MARGIN, _MARGIN + 10, heading, _HEADING)
    for number, (image, label) in enumerate(zip(images, labels, strict=True)):
        x = _MARGIN + number * (width + _GAP)
        canvas.text(x + width / 2, top - 12, label, _LABEL, FAINT, 0.5)
        canvas.image(x, top, _scaled(_masked(image, covered), fit))
    return canvas.result()


def strip(
    images: Sequence[np.ndarray],
    errors: Sequence[np.ndarray],
    labels: Sequence[str],
    unit: str = "°",
    covered: np.ndarray | None = None,
    maximum: float | None = None,
) -> np.ndarray:
    """Return (H, W, 3) display values: a map as it converges, above, and its error, below (Nagano et al. Fig. 1).

    images: (H, W, 3) display values each. errors: (H, W) each, in ``unit``. labels: one per column. maximum: the error
    shown as red, by default the 99th percentile over all columns except the first, which is a random guess.
    """
    fit = _fit(images[0].shape[:2])
    height, width = _size(images[0].shape[:2], fit)
    maximum = maximum if maximum is not None else default_maximum(list(errors[1:] or errors), covered)
    top = _MARGIN + 26
    canvas = Canvas(_MARGIN + len(images) * (width + _GAP) + 86, top + 2 * height + _GAP + 40)
    for number, (image, error, label) in enumerate(zip(images, errors, labels, strict=True)):
        x = _MARGIN + number * (width + _GAP)
        canvas.text(x + width / 2, top - 14, label, _HEADING, TEXT, 0.5)
        canvas.image(x, top, _scaled(_masked(image, covered), fit))
        canvas.image(x, top + height + _GAP, _scaled(false_color(error, maximum, covered), fit))
        mean = float(np.nanmean(error if covered is None else error[covered]))
        canvas.text(
            x + width / 2, top + 2 * height + _GAP + 20, f"mean {_number(mean)}{_unit(unit)}", _SMALL, FAINT, 0.5
        )
    _legend(canvas, _MARGIN + len(images) * (width + _GAP), top + height + _GAP, height, maximum, unit)
    return canvas.result()


def _plot(canvas: Canvas, curves: Curves, left: int, top: int, width: int, height: int) -> None:
    """Draw one panel: axes, ticks, one line per marked texel."""
    canvas.rectangle(left, top, width, height, PANEL)
    errors = np.asarray(curves.errors, np.float64)
    ticks, low, high = _error_axis(errors, curves.log)
    last = float(curves.iterations[-1]) or 1.0
    for tick in linear_ticks(0, last, 4):
        x = left + tick / last * width
        canvas.lines([[(x, top), (x, top + height)]], 1.0, GRID)
        canvas.text(x, top + height + 18, tick_text(tick), _SMALL, FAINT, 0.5)
    level = np.log10 if curves.log else np.asarray
    bottom_level, span = level(low), level(high) - level(low)
    for tick in ticks:
        y = top + height - (level(tick) - bottom_level) / span * height
        canvas.lines([[(left, y), (left + width, y)]], 1.0, GRID)
        canvas.text(left - 8, y + _SMALL / 2, tick_text(tick), _SMALL, FAINT, 1.0)
    for color, series in reversed(list(zip(MARK_COLORS, errors.T, strict=False))):
        known = np.isfinite(series)
        series = series[known]
        x = left + np.asarray(curves.iterations)[known] / last * width
        y = top + height - (level(np.clip(series, low, high)) - bottom_level) / span * height
        canvas.lines([np.stack([x, y], axis=-1)], 1.8, color)
    canvas.frame(left, top, width, height)
    canvas.text(left + width / 2, top - 14, curves.title, _HEADING, TEXT, 0.5)
    canvas.text(left + width / 2, top + height + 40, "iteration", _LABEL, FAINT, 0.5)
    canvas.text_upward(left - 50, top + height / 2, f"error ({curves.unit})", _LABEL, FAINT)


def _error_axis(errors: np.ndarray, log: bool) -> tuple[list[float], float, float]:
    """Return ticks, lowest and highest value of an axis for all the errors."""
    highest = float(np.nanmax(errors)) if np.isfinite(errors).any() and np.nanmax(errors) > 0 else 1.0
    if not log:
        ticks = linear_ticks(0, highest * 1.05, 5)
        return ticks, 0.0, max(highest * 1.05, ticks[-1])
    positive = errors[np.isfinite(errors) & (errors > 0)]
    lowest = max(float(positive.min()) if positive.size else highest / 10, highest * 1e-6)
    first, last = math.floor(math.log10(lowest)), math.ceil(math.log10(highest))
    last = max(last, first + 1)
    return [10.0**e for e in range(first, last + 1)], 10.0**first, 10.0**last


def _legend(canvas: Canvas, x: int, y: int, height: int, maximum: float, unit: str) -> None:
    """Draw the colour bar with its numbers, highest on top."""
    ramp = np.linspace(0, maximum, height)[:, None] * np.ones((1, _BAR))
    canvas.image(x, y, false_color(ramp, maximum))
    for part in (0.0, 0.25, 0.5, 0.75, 1.0):
        baseline = y + height - part * (height - _SMALL)
        canvas.text(x + _BAR + 8, baseline, f"{_number(part * maximum)}{_unit(unit)}", _SMALL, FAINT)


def _caption(row: PreviewRow) -> str:
    error = row.error[np.isfinite(row.error) if row.compared is None else row.compared & np.isfinite(row.error)]
    if not error.size:
        return "nothing covered"
    numbers = (np.mean(error), np.percentile(error, 99), np.max(error))
    return "   ".join(
        f"{word} {_number(float(n))}{_unit(row.unit)}" for word, n in zip(("mean", "99th", "max"), numbers, strict=True)
    )


def _unit(unit: str) -> str:
    return unit if unit in ("°", "") else f" {unit}"


def _number(value: float) -> str:
    """Return three significant digits, without exponents or trailing zeros."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    text = f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def default_maximum(errors: Sequence[np.ndarray], covered: np.ndarray | None) -> float:
    """Return the 99th percentile of the errors, rounded up to a round number."""
    values = np.concatenate([np.ravel(e if covered is None else e[covered]) for e in errors])
    values = values[np.isfinite(values)]
    percentile = float(np.percentile(values, 99)) if values.size else 1.0
    return round_up(percentile) if percentile > 0 else 1.0


def _fit(shape: tuple[int, ...]) -> float:
    """Return the scale of an image: an integer, or 1 / an integer."""
    longest = max(shape[0], shape[1])
    return max(1, round(_SHOWN / longest)) if longest <= 1.5 * _SHOWN else 1 / math.ceil(longest / (1.5 * _SHOWN))


def _size(shape: tuple[int, ...], fit: float) -> tuple[int, int]:
    height, width = shape
    if fit >= 1:
        return int(height * fit), int(width * fit)
    return -(-height // round(1 / fit)), -(-width // round(1 / fit))


def _scaled(image: np.ndarray, fit: float) -> np.ndarray:
    """Return the image enlarged texel by texel, or reduced by averaging blocks."""
    if fit >= 1:
        return np.repeat(np.repeat(image, int(fit), axis=0), int(fit), axis=1)
    block = round(1 / fit)
    height, width = image.shape[:2]
    rows, columns = -(-height // block), -(-width // block)
    padded = np.pad(image, ((0, rows * block - height), (0, columns * block - width), (0, 0)), mode="edge")
    return padded.reshape(rows, block, columns, block, 3).mean(axis=(1, 3))


def _masked(image: np.ndarray, covered: np.ndarray | None) -> np.ndarray:
    return image if covered is None else np.where(covered[..., None], image, np.asarray(UNCOVERED, np.float32))
