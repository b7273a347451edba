"""Lights from a mirror ball: the lamp's highlight in each photograph and the direction reflected there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .ball import Ball
from .crops import BallView

MAX_RADIUS = 256.0  # pixels; larger balls are averaged down to it
AMBIENT_PERCENTILE = 25.0  # of a pixel's values over all photographs: ambient light
_MIN_FOR_AMBIENT = 4
_RIM = 0.985  # of the ball's radius: beyond, the error of the outline dominates
_MIN_ELEVATION = -0.2  # least cosine to the table's normal; below the horizon, as the normal is uncertain
_MIN_SIGNAL = 8.0  # deviations of the noise
_TINY = float(np.finfo(np.float32).tiny)
_SKIRT = 0.2  # of the peak: border of a highlight's region
_HALF = 0.5  # of the highest peak: least peak of another candidate
_CANDIDATES = 4
_USUAL_AREA, _LARGE_AREA, _HUGE_AREA = 0.02, 0.12, 0.35  # of the ball's disc
_HALO, _HALO_PIXELS = 1.2, 1.0  # of the clipped core's radius, and pixels more: the border of its halo
_ROUND = 0.95  # least compactness of a lamp's clipped core; two discs that touch have 0.9
_FILLED = 0.2  # least clipped part of a clipped lamp's region
_FACING = 3.0  # power of n·v in a spot's score
_COMPACT = 0.5
_RIVAL = 0.5  # of the best candidate's score
_SECOND = 0.1  # of the best score: a clipped spot may be the lamp, and the larger spot an overexposed object
_DIMMER = 0.5  # of the highest peak: an object is far darker than the lamp that lights it
_WHITE = 0.9  # of the brightest clipped value: less is clipped in one channel only, like a red object in full light
_HOT = 0.2  # of a clipped value: least mean around it; around a hot pixel the mean is a ninth
_SAME_LAMP = np.radians(5.0)  # between highlights: one lamp in two parts
_CONTRAST = 3.0  # least ratio of the highlight to the rest of the ball
_FAINT = "the highlight is hardly brighter than other reflections in the ball"
# Of the median highlight. A darker one is not the lamp's: if it is faint or most others are clipped; in any case.
_DARK, _DARKEST = 0.4, 0.1
_GRAZING = 0.26  # n·v: lights from more than 150° off the viewer
_SHAPE_ERROR, _MIN_ERROR = 0.03, 0.05  # least error of a blob's centre: of its radius, and in pixels
_ONE_PIXEL = 12**-0.5  # deviation of a uniform distribution over one pixel
_SPREAD = 0.15  # square pixels: from this variance on, a spot's centroid is not limited by sampling


@dataclass(frozen=True)
class Sight:
    """One light as one ball shows it, in camera axes.

    pixel: (2,) the highlight, or NaN for a matte ball. point: (3,) on the ball. direction: (3,) unit, from the point to
    the light. error: its standard error, radians (RMS angle). warnings: about the outline and the highlight.
    """

    pixel: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    error: float
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Blob:
    """A bright spot; unit: values. centre: (2,) column and row, 0 at the first value. saturated: clipped fraction."""

    centre: np.ndarray
    error: float
    area: float
    score: float
    peak: float
    saturated: float
    region: np.ndarray


def find_highlights(view: BallView, up: np.ndarray | None = None, sure: bool = True) -> list[Sight | str]:
    """Return the light that the ball shows in each photograph, or in words why there is none.

    up: (3,) normal of the table in camera axes, if known: lamps are above the table, the highlight of a glossy table is
    below. sure: reject a photograph with two spots of similar score; else use the better one.
    """
    grey = view.values.mean(axis=-1)
    _, direction, facing = reflected(view.ball, view.pixels)
    inside = view.inside
    searched = inside & (facing > np.sqrt(1 - _RIM**2))
    if up is not None:
        searched &= direction @ up > _MIN_ELEVATION
    ambient = np.zeros_like(grey[0])
    if len(grey) >= _MIN_FOR_AMBIENT:
        rank = int(AMBIENT_PERCENTILE / 100 * (len(grey) - 1))
        ambient = np.partition(grey, rank, axis=0)[rank]
    results, spots = [], []
    signals = np.where(searched, grey - ambient, 0)
    for number, (image, usable) in enumerate(zip(grey, view.usable, strict=True)):
        clipped = ~usable & (image > 0) & inside
        sight, spot = _sight(view, signals, number, _saturated(image, signals[number], clipped), searched, sure)
        results.append(sight)
        spots.append(spot)
    return _without_hidden(results, spots, view.ball.name)


def _without_hidden(results: list[Sight | str], spots: list[_Blob | None], name: str) -> list[Sight | str]:
    """Replace sights of lamps hidden from the ball, where the brightest spot is another object, by a reason in words.

    spots: those of the sights. A lamp is far brighter than what it lights, so weak and strong lamps clip alike.
    """
    present = [spot for spot in spots if spot is not None]
    if len(present) < _MIN_FOR_AMBIENT:
        return results
    typical = float(np.median([spot.peak for spot in present]))
    mostly_clipped = np.mean([spot.saturated > 0 for spot in present]) > 0.5
    for number, (sight, spot) in enumerate(zip(results, spots, strict=True)):
        if isinstance(sight, Sight) and spot is not None:
            doubtful = mostly_clipped or f"{name}: {_FAINT}" in sight.warnings
            if spot.peak < typical * (_DARK if doubtful else _DARKEST) and not spot.saturated > 0:
                results[number] = (
                    f"{name}: no highlight: the brightest reflection is far darker than in other photographs; the lamp"
                    " is hidden"
                )
    return results


def _saturated(image: np.ndarray, signal: np.ndarray, clipped: np.ndarray) -> np.ndarray:
    """Return bool (H, W): values that the lamp clips in all channels; hot pixels are excluded."""
    lit = clipped & (signal > _SKIRT * signal.max())
    return lit & (image >= _WHITE * np.max(image, where=lit, initial=0)) & (_box_mean(signal) > _HOT * signal)


def reflected(ball: Ball, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (…, 3), unit directions (…, 3) reflected at pixels (…, 2) of a mirror ball, and n·v (…).

    r = 2 (n·v) n − v, with v toward the viewer: the normal is the half vector of light and viewer.
    """
    point, normal, view, _ = ball.surface(pixels)
    facing = (normal * view).sum(axis=-1)
    return point, 2 * facing[..., None] * normal - view, facing


def _sight(
    view: BallView, signals: np.ndarray, number: int, clipped: np.ndarray, inside: np.ndarray, sure: bool
) -> tuple[Sight | str, _Blob | None]:
    """Return a photograph's sight, or in words why there is none, and its spot."""
    ball, name, signal = view.ball, view.ball.name, signals[number]
    blobs = _blobs(signal, clipped, inside)
    if not blobs:
        return f"{name}: no highlight", None
    disc = inside.sum()
    lamps = [_rescored(view, signals, number, blob) for blob in _lamps(blobs)]
    blob = max(lamps, key=lambda b: b.score)
    if blob.area > _HUGE_AREA * disc:
        return f"{name}: no highlight: the bright spot covers {blob.area / disc:.0%} of the ball; expose less", None
    pixel = view.pixels[0, 0] + blob.centre * view.block
    point, direction, facing = reflected(ball, pixel)
    warnings = []
    if facing < _GRAZING or _touches_rim(blob.region, inside):
        warnings.append(f"{name}: the highlight is at the ball's edge, where its direction is uncertain")
    if blob.area > _LARGE_AREA * disc:
        advice = ", most of it clipped: expose less" if blob.saturated > 0.5 else ""
        warnings.append(f"{name}: the highlight covers {blob.area / disc:.0%} of the ball{advice}")
    ambiguity = 0.0
    for rival in [b for b in lamps if b is not blob and b.score > _SECOND * blob.score]:
        rival_direction = reflected(ball, view.pixels[0, 0] + rival.centre * view.block)[1]
        angle = float(np.arccos(np.clip(direction @ rival_direction, -1, 1)))
        if rival.score > _RIVAL * blob.score:
            ambiguity = max(ambiguity, angle)
        elif rival.saturated > 0 and angle > _SAME_LAMP:
            warnings.append(
                f"{name}: a smaller highlight is clipped, too; expose less if the cross in the picture of the balls is"
                " not on the lamp"
            )
    if ambiguity > _SAME_LAMP and sure:
        return (
            f"{name}: the highlight of the lamp is ambiguous: two highlights, {np.degrees(ambiguity):.0f}° apart, are"
            " about as bright; cover other lamps and bright objects beside the ball, or expose less"
        ), None
    rest = signal[inside & ~blob.region]
    if rest.size and np.percentile(rest, 99) * _CONTRAST > blob.peak:
        warnings.append(f"{name}: {_FAINT}")
    error = float(np.hypot(_direction_error(ball, pixel, blob.error * view.block), ambiguity if sure else 0.0))
    return Sight(pixel, point, direction, error, tuple(warnings)), blob


def _lamps(blobs: list[_Blob]) -> list[_Blob]:
    """Return the spots that may be the lamp: the saturated ones; without any, those with a high peak.

    The radiance of a clipped spot is unknown, so a larger unclipped spot does not outweigh it: in 8 bits a matte ball
    beside a mirror ball sends up to 1.5 times the light of 4 clipped pixels with their halo.
    """
    saturated = [blob for blob in blobs if blob.saturated > 0]
    highest = max(blob.peak for blob in blobs)
    return saturated or [blob for blob in blobs if blob.peak > _DIMMER * highest]


def _rescored(view: BallView, signals: np.ndarray, number: int, blob: _Blob) -> _Blob:
    """Return a spot with a score that is lower for reflections of lit objects.

    Objects on the table are reflected at the same place in most photographs; the lamp's place is new in each. A glossy
    table's highlight also moves, but lies closer to the rim than the lamp, which is above the table.
    """
    repeated = 0.0
    if len(signals) >= _MIN_FOR_AMBIENT:
        values = np.maximum(signals[:, blob.region], 0)
        overlap = np.minimum(values, values[number]).sum(axis=1) / max(float(values[number].sum()), _TINY)
        repeated = max(float((overlap.sum() - 1) / (len(overlap) - 1)), 0.0)
    facing = float(reflected(view.ball, view.pixels[0, 0] + blob.centre * view.block)[2])
    filled = min(blob.saturated / _FILLED, 1.0) if blob.saturated > 0 else 1.0
    return replace(blob, score=blob.score * filled * (1 - repeated) ** 2 * facing**_FACING)


def _direction_error(ball: Ball, pixel: np.ndarray, blob_error: float) -> float:
    """Return the standard error, radians, of the direction reflected at a pixel, by errors of highlight and outline."""
    step = 0.01 * ball.radius_px
    direction = reflected(ball, pixel)[1]
    shifted = reflected(ball, pixel + step * np.eye(2))[1]
    jacobian = (shifted - direction) / step
    centre = ball.outline[:-1].mean(axis=0)
    radial = (pixel - centre) / ball.radius_px
    covariance = (blob_error**2 + ball.error_px[0] ** 2) * np.eye(2) + ball.error_px[1] ** 2 * np.outer(radial, radial)
    return float(np.sqrt(np.trace(jacobian.T @ covariance @ jacobian)))


def _blobs(signal: np.ndarray, clipped: np.ndarray, inside: np.ndarray) -> list[_Blob]:
    """Return the brightest spots, at most four, of radiance above ambient (H, W); none if all is noise."""
    values = signal[inside]
    noise = 1.4826 * np.median(np.abs(values - np.median(values)))
    # The 3×3 mean dims a lamp of a few clipped pixels, which must rank before unclipped spots.
    smooth = np.where(clipped, np.maximum(_box_mean(signal), signal), _box_mean(signal))
    remaining, blobs = inside.copy(), []
    highest = float(np.max(smooth, where=remaining, initial=0))
    for _ in range(_CANDIDATES):
        peak = float(np.max(smooth, where=remaining, initial=0))
        # A box of nine values has a third of the noise.
        if peak <= _MIN_SIGNAL * noise / 3 or peak < _HALF * highest or peak <= 0:
            break
        row, column = np.unravel_index(np.argmax(np.where(remaining, smooth, -np.inf)), smooth.shape)
        threshold = max(_SKIRT * peak, 2 * noise)
        region = grown = _grown(remaining & (smooth > threshold), (int(row), int(column)))
        if clipped[row, column] and _compactness(np.argwhere(grown)) < _ROUND:
            region = grown & _near_core(_grown(grown & clipped, (int(row), int(column))))
        remaining &= ~grown | clipped & ~region  # another clipped core may touch this one
        blobs.append(_measured(signal, clipped, region, inside, noise))
    return blobs


def _near_core(core: np.ndarray) -> np.ndarray:
    """Return bool (H, W): a clipped core with its halo.

    A lamp's image is round, or an ellipse at the rim. Of any other shape only the largest disc is used, as the
    highlight of a glossy table may touch the lamp.
    """
    places = np.argwhere(core)
    if _compactness(places) < _ROUND:
        low = places.min(axis=0)
        eroded = np.pad(core[tuple(np.s_[a:b] for a, b in zip(low, places.max(axis=0) + 1, strict=True))], 1)
        radius = 0
        while eroded.any():
            last, radius = eroded, radius + 1
            eroded = ~_widened(~eroded, 1)
        deepest = np.argwhere(last) + low - 1
        centre = deepest[np.linalg.norm(deepest - deepest.mean(axis=0), axis=1).argmin()]
        places = places[np.linalg.norm(places - centre, axis=1) <= radius]
    squares, axes = np.linalg.eigh(_covariance(places))
    offsets = (np.moveaxis(np.indices(core.shape), 0, -1) - places.mean(axis=0)) @ axes
    return ((offsets / (2 * _HALO * np.sqrt(squares) + _HALO_PIXELS)) ** 2).sum(axis=-1) <= 1


def _covariance(places: np.ndarray) -> np.ndarray:
    """Return the covariance (2, 2) of a region of pixels (N, 2), including the variance 1/12 within a pixel."""
    offsets = places - places.mean(axis=0)
    return offsets.T @ offsets / len(places) + np.eye(2) / 12


def _compactness(places: np.ndarray) -> float:
    """Return 1 for pixels (N, 2) of an ellipse, less for other shapes."""
    return min(len(places) / (4 * np.pi * float(np.sqrt(np.linalg.det(_covariance(places))))), 1.0)


def _measured(signal: np.ndarray, clipped: np.ndarray, region: np.ndarray, inside: np.ndarray, noise: float) -> _Blob:
    """Return a spot: centroid weighted by the radiance above its surroundings, error and score."""
    # One pixel wider: a lamp smaller than a pixel puts a tenth of its light on the next pixel.
    widened = _widened(region, 1) & inside
    surroundings = signal[_widened(widened, 2) & ~widened & inside]
    rows, columns = np.nonzero(widened)
    value = signal[widened]
    weight = np.maximum(value - (np.median(surroundings) if surroundings.size else 0), 0)
    if not weight.sum() > 0:
        weight = np.ones_like(value)
    places = np.stack([columns, rows], axis=-1).astype(np.float64)
    total = weight.sum()
    centre = weight @ places / total
    offsets = places - centre
    covariance = (weight[:, None] * offsets).T @ offsets / total
    area = float(region.sum())
    compact = _compactness(np.argwhere(region))
    noise_error = noise * np.sqrt((offsets**2).sum() / 2) / total
    sampling_error = _ONE_PIXEL * max(0.0, 1 - np.linalg.eigvalsh(covariance)[0] / _SPREAD)
    shape_error = _SHAPE_ERROR * np.sqrt(np.trace(covariance))
    error = float(np.sqrt(noise_error**2 + shape_error**2 + sampling_error**2 + _MIN_ERROR**2))
    # Total radiance ranks the lamp before its image in another ball; a window is too large.
    score = signal[region].sum() * max(compact - _COMPACT, 0.05) / (1 + area / (_USUAL_AREA * inside.sum())) ** 2
    return _Blob(centre, error, area, float(score), float(value.max()), float(clipped[region].mean()), region)


def _box_mean(values: np.ndarray) -> np.ndarray:
    """Return means of 3×3 values (H, W), which suppress hot pixels."""
    padded = np.pad(values, 1)
    height, width = values.shape
    total = np.zeros_like(values)
    for y, x in np.ndindex(3, 3):
        total = total + padded[y : y + height, x : x + width]
    return total / 9


def _grown(mask: np.ndarray, seed: tuple[int, int]) -> np.ndarray:
    """Return the 8-connected part of a mask (H, W) that contains ``seed``."""
    region = np.zeros(np.add(mask.shape, 2), bool)
    free = np.pad(mask, 1)
    y0, x0 = seed[0] + 1, seed[1] + 1
    region[y0, x0] = True
    y1, x1 = y0 + 1, x0 + 1
    while True:
        y0, x0, y1, x1 = max(y0 - 1, 1), max(x0 - 1, 1), min(y1 + 1, free.shape[0] - 1), min(x1 + 1, free.shape[1] - 1)
        window = region[y0 - 1 : y1 + 1, x0 - 1 : x1 + 1]
        rows = window[:-2] | window[1:-1] | window[2:]
        wider = (rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]) & free[y0:y1, x0:x1]
        if (wider == region[y0:y1, x0:x1]).all():
            return region[1:-1, 1:-1]
        region[y0:y1, x0:x1] = wider


def _widened(region: np.ndarray, by: int) -> np.ndarray:
    """Return a region (H, W) dilated by ``by`` pixels."""
    height, width = region.shape
    padded = np.pad(region, by)
    steps = range(2 * by + 1)
    return np.any([padded[y : y + height, x : x + width] for y in steps for x in steps], axis=0)


def _touches_rim(region: np.ndarray, inside: np.ndarray) -> bool:
    padded = np.pad(inside, 1)
    interior = padded[1:-1, :-2] & padded[1:-1, 2:] & padded[:-2, 1:-1] & padded[2:, 1:-1]
    return bool((region & ~interior).any())
