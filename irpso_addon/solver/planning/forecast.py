"""The search time of a recovery, estimated before it begins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ...gpu.probe import chosen_entry, rounds_per_second

# Rounds of the probe's kernel that take as long as one render of a sample, and the factor by which this may be wrong:
# the work at a texel depends on its convergence. Measured on llvmpipe with 16 to 96 observations.
_ROUNDS_PER_RENDER, _SPREAD = 4.2, 1.8
# Host seconds per render: two thirds of the 4.4 s that an H100 takes for a megapixel from 24 photographs.
_HOST_PER_RENDER = 2e-11
_MINUTE, _HOUR = 60, 3600


def forecast(work: float, probed: Mapping[str, Any], most_work: float | None = None) -> tuple[float, float]:
    """Return the lower and the upper end of the likely duration of a search, in seconds.

    work, most_work: from a ``Plan``, None for the same. probed: from ``gpu.probe``.
    """
    render = _ROUNDS_PER_RENDER / rounds_per_second(probed[f"{chosen_entry(probed)}_seconds"])
    each = render + _HOST_PER_RENDER
    return work * each / _SPREAD, (most_work or work) * each * _SPREAD


def in_units(seconds: tuple[float, float]) -> tuple[int, int, str]:
    """Return a range of seconds as whole numbers of "minutes" or "hours"; 0 to 1 minutes is less than a minute."""
    low, high = seconds
    if high < _MINUTE:
        return 0, 1, "minutes"
    unit, name = (_MINUTE, "minutes") if high < 2 * _HOUR else (_HOUR, "hours")
    return max(1, round(low / unit)), max(2, round(high / unit)), name


def forecast_text(seconds: tuple[float, float]) -> str:
    """Return a range of seconds in words: "less than a minute", "2 to 6 minutes", "1 to 4 hours"."""
    least, most, name = in_units(seconds)
    return f"{least} to {most} {name}" if least else "less than a minute"
