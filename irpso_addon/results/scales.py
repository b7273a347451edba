"""Axes of plots: round limits, ticks and their labels."""

from __future__ import annotations

import math

PERCENT = 100.0  # the panel, the legend and the plots show errors in % of white
_ROUND = (1.0, 2.0, 5.0, 10.0)
# The limit does not change while a new one over it lies between these: a legend that jumps is unreadable.
_HOLD_BELOW, _HOLD_ABOVE = 0.45, 1.8


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 5 · 10ⁿ that is not below a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in _ROUND if step * power >= value * (1 - 1e-9))


def round_down(value: float) -> float:
    """Return the largest of 1, 2, 5 · 10ⁿ that is not above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in reversed(_ROUND) if step * power <= value * (1 + 1e-9))


def steady_limit(exact: float, former: float) -> float:
    """Return a round limit near ``exact``, or the former limit (0 for none) while that is close enough."""
    if not (math.isfinite(exact) and exact > 0):
        return former or 1.0
    if former > 0 and _HOLD_BELOW * former <= exact <= _HOLD_ABOVE * former:
        return former
    below, above = round_down(exact), round_up(exact)
    return below if exact / below <= above / exact else above


def linear_ticks(low: float, high: float, most: int) -> list[float]:
    """Return at most ``most`` round values, evenly spaced, in low…high."""
    if not high > low or most < 1:
        return []
    step = round_up((high - low) / most)
    while math.floor(high / step + 1e-9) - math.ceil(low / step - 1e-9) + 1 > most:
        step = round_up(step * 1.5)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [index * step for index in range(first, last + 1)]


def ticks_to(top: float, most: int) -> list[float]:
    """Return at most ``most`` round values from 0, including ``top`` if it is round."""
    choices = [linear_ticks(0, top, count) for count in range(most, 1, -1)]
    return next((ticks for ticks in choices if math.isclose(ticks[-1], top)), choices[0])


def log_ticks(low: float, high: float, most: int = 6) -> tuple[list[float], list[float]]:
    """Return the labelled and the unlabelled ticks of a logarithmic axis low…high, both > 0.

    Powers of ten are labelled; if there are many, every second or third; if there are few, also 2 and 5.
    """
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    decades = range(math.floor(math.log10(low)), last + 1)
    within = [
        m * 10.0**d for d in decades for m in range(1, 10) if low * (1 - 1e-9) <= m * 10.0**d <= high * (1 + 1e-9)
    ]
    if last - first < 1:
        major = [value for value in within if f"{value:.0e}"[0] in "125"]
    else:
        every = max(1, math.ceil((last - first + 1) / most))
        major = [10.0**d for d in range(first, last + 1) if (d - last) % every == 0]
    return major, [value for value in within if value not in major]


def tick_text(value: float) -> str:
    """Return the short text of a number at a tick."""
    if value == 0:
        return "0"
    if 1e-4 <= abs(value) < 1e5:
        return f"{value:.6f}".rstrip("0").rstrip(".") if abs(value) < 1 else f"{value:.6g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return f"{float(mantissa):g}e{int(exponent)}"
