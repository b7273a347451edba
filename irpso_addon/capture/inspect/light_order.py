"""Detects lights that are listed in another order than the photographs."""

from __future__ import annotations

import numpy as np

from .shading import bright_samples, shading_errors

_FEWEST = 8  # photographs
_MOVES = (1, -1, 2, -2)  # places by which a list may be moved
_RANDOM = 3  # random orders that the lights are compared with
# In the right order the median error is at most 0.66 of that in random orders, and at most 0.98 of that in the reversed
# or a moved list (three bunnies, the icon, 14 rendered captures: gloss, brass, gold, hollows; all lights and 8 to 16).
_RIGHT, _NO_BETTER, _BETTER = 0.7, 0.8, 0.85
_LEAST = 0.05  # median error in the wrong order, of a pixel's bright sample: below, the order hardly matters


def light_order_message(values: np.ndarray, usable: np.ndarray, lamps: np.ndarray) -> str:
    """Return a warning of lights in another order than the photographs, "" for none.

    values, usable, lamps: as of ``shading.bright_samples``. A robust fit of matt shading has larger errors with the
    lights in a wrong order. The lights are compared with the reversed list, with the list moved by one or two places,
    and with random orders. A list of which a small part is wrong goes unnoticed; so does a turned dome.
    """
    samples = bright_samples(values, usable, lamps)
    if samples is None or len(values) < _FEWEST:
        return ""
    relative, used, lamps = samples
    places = np.arange(len(values))

    def error(order: np.ndarray) -> float:
        return float(np.median(np.abs(shading_errors(relative, used, lamps[order]))[used]))

    given = error(places)
    if given < _LEAST:
        return ""
    others = {"the list reversed": error(places[::-1])}
    others |= {_moved(move): error(np.roll(places, -move)) for move in _MOVES}
    best = min(others, key=others.__getitem__)
    generator = np.random.default_rng(0)
    random = float(np.median([error(generator.permutation(places)) for _ in range(_RANDOM)]))
    if others[best] < min(_BETTER * given, _RIGHT * random):
        return (
            f"the photographs match the lights better with {best}: compare the order of the lights with the photographs"
        )
    if given > _NO_BETTER * random:
        return (
            "the photographs match the lights no better than lights in a random order: compare the list of lights with"
            " the photographs, or calibrate again"
        )
    return ""


def _moved(move: int) -> str:
    """Return what moves light ``i + move`` to photograph i."""
    places = "one place" if abs(move) == 1 else f"{abs(move)} places"
    return f"every light {places} further {'up' if move > 0 else 'down'}"
