"""A camera's response curve: from code values to linear light.

The method is Debevec and Malik's (1997): free values at many codes with a penalty on roughness. It fits any curve and
is linear, so it has one solution. The polynomial of Mitsunaga and Nayar (1999) also refines exposures, which EXIF
makes unnecessary, and a low order cannot follow the toe and shoulder of a picture profile. Two changes: roughness is
that of log light over log code, where a gamma curve is straight and has no penalty; residuals are reweighted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError

TABLE = 256  # rows of a curve
_KNOTS, _FIRST = 64, 0.015  # free values of a curve, at even steps of the logarithm of the code, from this code to 1
_ENDS = 10  # knots whose slope extrapolates the curve below the first
_SMOOTH = 0.1  # weight of roughness at a knot over the data's mean weight, times the cube of the step in stops
_ROUNDS, _OUTLIER = 8, 0.05  # reweightings; logarithm of light: the Cauchy scale, about 5 %
_LOW, _HIGH = 0.03, 0.98  # codes outside are excluded: clipped black and white
_MIN_FRAMES, _MIN_SAMPLES = 2, 64
_MIN_RATIO = 1.5  # longest over shortest exposure
_CURVE_PATCHES = 6  # with fewer patches the curve is a gamma


@dataclass(frozen=True)
class Response:
    """A response curve. codes: (N,) rising from 0 to 1, code value / largest code. linear: (N, 3) rising from 0 to 1.

    used: (3, 2) lowest and highest measured code of each channel; beyond, the curve is extrapolated.
    residual: RMS relative error of the data, or NaN if unknown.
    """

    codes: np.ndarray
    linear: np.ndarray
    used: np.ndarray
    residual: float = float("nan")

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return linear light (…, 3) float32 of code values (…, 3) in 0…1."""
        channels = [np.interp(values[..., c], self.codes, self.linear[:, c]) for c in range(3)]
        return np.stack(channels, axis=-1).astype(np.float32)


def response_from_brackets(samples: Sequence[np.ndarray], exposures: Sequence[np.ndarray]) -> Response:
    """Return the curve of code values of the same pixels under several exposures (Debevec and Malik 1997).

    samples: (N, F, 3) per bracket, codes / largest code, 0…1: N pixels in its F frames. exposures: (F,) per bracket,
    above 0, in any unit. Each channel's curve is 1 at the largest code; white balance is not determined. Raises
    InputError if a bracket's longest exposure is less than 1.5 times its shortest or too few pixels are usable in two
    frames.
    """
    for times in exposures:
        if len(times) < _MIN_FRAMES or max(times) < _MIN_RATIO * min(times):
            raise InputError(
                "a response curve needs brackets: at least two frames of one light, whose longest exposure is at least"
                f" {_MIN_RATIO:g} times the shortest ({math.log2(_MIN_RATIO):.1f} stop); give their folder, with"
                " EXIF or exposures in the names"
            )
    codes = np.linspace(0, 1, TABLE)
    smooth = _SMOOTH * bracket_step(exposures) ** 3
    curves, used, squares = [], [], []
    for channel, name in enumerate(("red", "green", "blue")):
        rows = [_rows(s[..., channel].astype(np.float64), np.log(t)) for s, t in zip(samples, exposures, strict=True)]
        curve, ends, residual = _solved(rows, codes, smooth, name)
        curves.append(curve)
        used.append(ends)
        squares.append(residual**2)
    return Response(codes, np.stack(curves, axis=-1), np.array(used), float(np.sqrt(np.mean(squares))))


def bracket_step(exposures: Sequence[np.ndarray]) -> float:
    """Return the median step between neighbouring exposures of brackets, in stops."""
    return float(np.median(np.concatenate([np.diff(np.sort(np.log2(times))) for times in exposures])))


def _rows(values: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return codes, log exposures and weights, each (N, F), of pixels that are usable in at least two frames."""
    usable = (values > _LOW) & (values < _HIGH)
    enough = usable.sum(axis=1) >= _MIN_FRAMES
    values, usable = values[enough], usable[enough]
    # As Debevec and Malik's hat function: low weight at both ends.
    weights = np.where(usable, values**2 * np.minimum((_HIGH - values) / 0.2 + 0.05, 1), 0.0)
    return values, np.broadcast_to(times, values.shape), weights


def _solved(rows: list, codes: np.ndarray, smooth: float, name: str) -> tuple[np.ndarray, tuple[float, float], float]:
    """Return one channel's curve (N,) at ``codes``, the lowest and highest measured code, and the residual."""
    count = sum(len(values) for values, _, _ in rows)
    if count < _MIN_SAMPLES:
        raise InputError(
            f"only {count} pixels are neither black nor clipped in two frames of the {name} channel; a response curve"
            f" needs {_MIN_SAMPLES}: bracket a subject with many tones in smaller steps"
        )
    measured = np.concatenate([values[weights > 0] for values, _, weights in rows])
    low, high = np.quantile(measured, (0.01, 0.99))
    knots = np.linspace(np.log(_FIRST), 0, _KNOTS)
    curvature = np.diff(np.eye(_KNOTS), 2, axis=0)
    robust = [np.ones(values.shape) for values, _, _ in rows]
    for _ in range(_ROUNDS):
        matrix, right, total = np.zeros((_KNOTS, _KNOTS)), np.zeros(_KNOTS), 0.0
        for (values, times, weights), factor in zip(rows, robust, strict=True):
            w = weights * factor
            design, target = _centred(_knot_weights(values, knots), w), _centred(times[..., None], w)[..., 0]
            flat = design.reshape(-1, _KNOTS)
            matrix += flat.T @ (flat * w.reshape(-1, 1))
            right += flat.T @ (w * target).ravel()
            total += w.sum()
        matrix += smooth * total / _KNOTS * curvature.T @ curvature
        matrix += 1e-6 * total  # fixes the mean of the curve, which the data do not determine
        curve = np.linalg.solve(matrix, right)
        errors = [_centred((_knot_weights(v, knots) @ curve - t)[..., None], w * r)[..., 0]
                  for (v, t, w), r in zip(rows, robust, strict=True)]  # fmt: skip
        robust = [1 / (1 + (error / _OUTLIER) ** 2) for error in errors]
    square = sum((w * r * e**2).sum() for (_, _, w), r, e in zip(rows, robust, errors, strict=True))
    light = np.exp(np.interp(np.log(np.maximum(codes, _FIRST)), knots, curve))
    slope = (curve[_ENDS] - curve[0]) / (knots[_ENDS] - knots[0])
    light = np.where(codes < _FIRST, light * (np.maximum(codes, 1e-9) / _FIRST) ** max(slope, 0.5), light)
    light = monotone(np.where(codes > 0, light, 0))
    return light / light[-1], (float(low), float(high)), float(np.sqrt(square / total))


def _knot_weights(values: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the linear interpolation factors (N, F, knots) of each code between its two knots."""
    place = np.clip((np.log(np.maximum(values, _FIRST)) - knots[0]) / (knots[1] - knots[0]), 0, len(knots) - 1 - 1e-9)
    left = place.astype(int)
    result = np.zeros((*values.shape, len(knots)))
    np.put_along_axis(result, left[..., None], (1 - place + left)[..., None], axis=-1)
    np.put_along_axis(result, left[..., None] + 1, (place - left)[..., None], axis=-1)
    return result


def _centred(array: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Subtract from (N, F, C) its weighted mean over a pixel's frames, which eliminates the pixel's radiance."""
    total = np.maximum(weights.sum(axis=1), 1e-12)[:, None, None]
    return array - (array * weights[..., None]).sum(axis=1, keepdims=True) / total


def monotone(values: np.ndarray) -> np.ndarray:
    """Return the nearest non-decreasing values in least squares (pool adjacent violators, Ayer et al. 1955)."""
    blocks: list[list[float]] = []
    for value in values:
        blocks.append([float(value), 1.0])
        while len(blocks) > 1 and blocks[-2][0] >= blocks[-1][0]:
            last, size = blocks.pop()
            mean, count = blocks[-1]
            blocks[-1] = [(mean * count + last * size) / (count + size), count + size]
    return np.concatenate([np.full(int(size), mean) for mean, size in blocks])


def measurable(values: np.ndarray) -> np.ndarray:
    """Return bool (P,): patches (P, 3), codes / largest code, that are neither black nor clipped."""
    return ((values > _LOW / 2) & (values < _HIGH + 0.01)).all(axis=-1)


def response_from_patches(values: np.ndarray, reflectances: Sequence[float]) -> Response:
    """Return the curve from grey patches in the same light: values (P, 3), codes / largest code; reflectances (P,).

    Two to five patches give a least-squares gamma, more a monotone curve, piecewise linear in logarithms. Raises
    InputError if there are fewer than two patches, or they are black, clipped, equal or not rising.
    """
    values, reflectance = np.asarray(values, np.float64), np.asarray(reflectances, np.float64)
    if len(values) < 2:
        raise InputError(
            "one grey patch gives a scale, not a curve: add patches of other reflectance, or, where the files are"
            " linear or sRGB, use --white X,Y,W,H=REFLECTANCE"
        )
    if not (np.isfinite(reflectance).all() and (reflectance > 0).all()):
        raise InputError("a patch's reflectance must be above 0, as in X,Y,W,H=0.18")
    order = np.argsort(reflectance, kind="stable")
    values, reflectance = values[order], reflectance[order]
    if not measurable(values).all():
        raise InputError("a grey patch is black or clipped; choose an exposure in which none is")
    if (np.diff(values, axis=0) <= 0).any() or (np.diff(reflectance) <= 0).any():
        raise InputError("grey patches of higher reflectance must have higher code values; check their positions")
    codes = np.linspace(0, 1, TABLE)
    curves, errors = [], []
    for channel in values.T:
        x, y = np.log(channel), np.log(reflectance)
        slope, offset = np.polyfit(x, y, 1)
        errors.append(y - slope * x - offset)
        if len(x) < _CURVE_PATCHES:
            curves.append(codes**slope)
            continue
        ends = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
        logs = np.log(np.maximum(codes, 1e-9))
        inner = np.interp(logs, x, y)
        inner = np.where(logs < x[0], y[0] + ends[0] * (logs - x[0]), inner)
        inner = np.where(logs > x[-1], y[-1] + ends[1] * (logs - x[-1]), inner)
        curve = np.where(codes > 0, np.exp(inner), 0)
        curves.append(curve / curve[-1])
    used = np.stack([values.min(axis=0), values.max(axis=0)], axis=-1)
    residual = float(np.sqrt(np.mean(np.square(errors)))) if len(values) < _CURVE_PATCHES else 0.0
    return Response(codes, np.stack(curves, axis=-1), used, residual)
