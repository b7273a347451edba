"""Lens distortion by the Brown–Conrady model with OpenCV's formulas and order of coefficients.

Brown, Decentering distortion of lenses, 1966; OpenCV's calib3d documentation: with x, y on the plane at distance 1,
y down, r² = x² + y² and g = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶),
x″ = x g + 2 p1 x y + p2 (r² + 2 x²), y″ = y g + p1 (r² + 2 y²) + 2 p2 x y.
Planes here are the cameras' own, with y up. OpenCV 5.0's projectPoints agrees within 3e-13 pixels.
"""

from __future__ import annotations

import math

import numpy as np

NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
MAX_COEFFICIENT = 1e12  # in size: far beyond any lens's, and its products are finite
_REAL = 1e-9  # a root with a smaller imaginary part, relative to its size, counts as real
_TABLE = 4096  # radii in the table that gives Newton's method its start
_STEPS = 30  # most of Newton's method; from the table it takes three or four
_LAST_STEP = 1e-9  # on the plane at distance 1: convergence is quadratic, so the remaining error is below rounding
_ROUNDING = 1e-12
_BLOCK = 1 << 16  # points per block: measured, faster than all at once, and little memory
_FAR = 64.0  # largest radius in the table: the tangent of 89°


def reach(coefficients: tuple[float, ...]) -> float:
    """Return the radius on the plane at distance 1 up to which the distorted radius rises; infinity if always.

    Beyond it the polynomial folds the image back onto itself, which no lens does.
    """
    numerator, denominator = _radial(coefficients)
    # d/dr (r g) has, in s = r², the sign of N D + 2 s (N′ D − N D′).
    slope = numerator * denominator + np.polynomial.Polynomial([0, 2]) * (
        numerator.deriv() * denominator - numerator * denominator.deriv()
    )
    roots = np.concatenate([polynomial.trim().roots() for polynomial in (slope, denominator)])
    real = roots[np.abs(roots.imag) <= _REAL * np.abs(roots)].real
    return math.sqrt(min((root for root in real if root > 0), default=math.inf))


def distorted(plane: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """Return the distorted positions of points (…, 2) on the plane at distance 1; NaN beyond the lens's field."""
    points, (xx, xy, yy) = _distorted(plane, coefficients)
    visible = (np.linalg.norm(plane, axis=-1) < reach(coefficients)) & (xx * yy > xy * xy)
    return np.where(visible[..., None], points, np.nan)


def undistorted(plane: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """Return the points (…, 2) whose distorted positions are ``plane``, as of ``distorted``; NaN where there is none.

    Newton's method in both coordinates, started from a table of the radial part.
    """
    target = np.asarray(plane, np.float64).reshape(-1, 2)
    points, start = np.empty_like(target), _first_guess(coefficients)
    for first in range(0, len(target), _BLOCK):
        block = slice(first, first + _BLOCK)
        points[block] = _newton(target[block], start, coefficients)
    return points.reshape(plane.shape)


def _newton(target: np.ndarray, start: tuple[np.ndarray, np.ndarray], coefficients: tuple[float, ...]) -> np.ndarray:
    """Return the points (N, 2) whose distorted positions are ``target``. start: as of ``_first_guess``."""
    radius = np.linalg.norm(target, axis=-1)
    points = target * (np.interp(radius, *start) / np.where(radius > 0, radius, 1))[:, None]
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for _ in range(_STEPS):
            value, (xx, xy, yy) = _distorted(points, coefficients)
            x, y = (value - target).T
            step = np.stack([yy * x - xy * y, xx * y - xy * x], axis=-1) / (xx * yy - xy * xy)[:, None]
            points = points - step
            if not (np.abs(step) > _LAST_STEP).any():
                break
        distorted_points = distorted(points, coefficients)
        # Where the iteration does not converge, no point has this distorted position.
        exact = np.abs(distorted_points - target).max(axis=-1) <= _ROUNDING * (1 + np.abs(target).max(axis=-1))
    return np.where(exact[:, None], points, np.nan)


def _radial(coefficients: tuple[float, ...]) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial]:
    """Return numerator and denominator of g as polynomials in r²."""
    k1, k2, _, _, k3, k4, k5, k6 = _padded(coefficients)
    return np.polynomial.Polynomial([1, k1, k2, k3]), np.polynomial.Polynomial([1, k4, k5, k6])


def _padded(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    return (*coefficients, *(0.0,) * (len(NAMES) - len(coefficients)))


def _distorted(
    plane: np.ndarray, coefficients: tuple[float, ...]
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return distorted points (…, 2), also beyond ``reach``, and derivatives ∂x″/∂x, ∂x″/∂y = ∂y″/∂x, ∂y″/∂y."""
    _, _, p1, p2, *_ = _padded(coefficients)
    numerator, denominator = _radial(coefficients)
    x, y = plane[..., 0], -plane[..., 1]  # OpenCV's y is down
    r2 = x * x + y * y
    top, bottom = numerator(r2), denominator(r2)
    gain = top / bottom
    slope = 2 * (numerator.deriv()(r2) - gain * denominator.deriv()(r2)) / bottom  # dg/dx is slope · x
    points = np.stack(
        [x * gain + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), -(y * gain + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)],
        axis=-1,
    )
    across = -(slope * x * y + 2 * p1 * x + 2 * p2 * y)
    along_x = gain + slope * x * x + 2 * p1 * y + 6 * p2 * x
    along_y = gain + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return points, (along_x, across, along_y)


def _first_guess(coefficients: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return a table of the radial part: distorted radii, ascending, and the radii before distortion."""
    limit = min(reach(coefficients), _FAR)
    numerator, denominator = _radial(coefficients)
    # Evenly spaced angles: dense near the centre, and up to any field of view.
    table = np.tan(np.linspace(0, math.atan(limit), _TABLE)[:-1])
    return table * numerator(table**2) / denominator(table**2), table
