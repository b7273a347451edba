"""Detects lights that are listed in another order than the photographs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...core.files import natural
from .shading import bright_samples, shading_errors, with_factors

_MIN_PHOTOGRAPHS = 8  # photographs
_MOVES = (1, -1, 2, -2)  # places by which a list may be moved
_RANDOM = 5  # random orders that the lights are compared with
_RIGHT_ERROR = 0.02  # median error, as part of a pixel's bright sample: below, the order is right
_BETTER = 0.5  # of the given order's error: at most that of a reversed or moved list that is right
_MIN_ERROR = 0.07  # median error of a wrong order, as part of a pixel's bright sample: below, the order hardly matters
_METAL = 0.25  # median of the samples, likewise: below, most light is in highlights, which follow no matt shading
# In the right order the median error is at most 0.53 of that in random orders: on rendered spheres, cards, reliefs and
# hollows, with gloss, and with intensities unstated within a factor of 2. On a nearly flat icon it is 0.95, and 0.04.
_LIKE_RANDOM = 0.75  # of the error in random orders: an order that is no better
_RIGHT = 0.55  # of the error in random orders: at most that of the right order


def light_order_message(values: np.ndarray, usable: np.ndarray, lamps: np.ndarray, names: Sequence[str] = ()) -> str:
    """Return a warning of lights in another order than the photographs, "" for none.

    values, usable, lamps: as of ``shading.bright_samples``. names: of the photographs. A robust fit of matt shading,
    with a factor for each photograph, has larger errors with the lights in a wrong order. The lights are compared with
    the reversed list, with the list moved by one or two places, with the names' order by numbers or by letters (10.jpg
    before 2.jpg), and with random orders. Silent on lights turned or mirrored as a whole, so
    on a moved or reversed ring; on lists of which a small part is wrong; on metals.
    """
    samples = bright_samples(values, usable, lamps)
    if samples is None or len(values) < _MIN_PHOTOGRAPHS:
        return ""
    relative, used, lamps = samples
    if np.median(relative[used]) < _METAL:
        return ""
    places, generator = np.arange(len(values)), np.random.default_rng(0)
    given = _error(relative, used, lamps)
    if given < _RIGHT_ERROR:
        return ""
    random = float(np.median([_error(relative, used, lamps[generator.permutation(places)]) for _ in range(_RANDOM)]))
    others = {"the list reversed": _error(relative, used, lamps[::-1])}
    others |= {_moved(move): _error(relative, used, np.roll(lamps, -move, axis=0)) for move in _MOVES}
    others |= {text: _error(relative, used, lamps[ranks]) for text, ranks in _orders_of(names)}
    best = min(others, key=others.__getitem__)
    is_wrong = given >= max(_MIN_ERROR, _RIGHT * random) or others[best] < _BETTER * given
    if is_wrong and others[best] < _RIGHT * random:
        return (
            f"the photographs match the lights better with {best}: compare the order of the lights with the photographs"
        )
    if given >= _MIN_ERROR and given > _LIKE_RANDOM * random:
        return (
            "the photographs match the lights no better than lights in a random order: compare the list of lights with"
            " the photographs, or calibrate again"
        )
    return ""


def _error(values: np.ndarray, used: np.ndarray, lamps: np.ndarray) -> float:
    """Return the median error of shading with a factor for each photograph, of mean 1 in the logarithm."""
    return float(np.median(np.abs(shading_errors(with_factors(values, used, lamps), used, lamps)[0])[used]))


def _orders_of(names: Sequence[str]) -> list[tuple[str, np.ndarray]]:
    """Return the places of the photographs in orders of their names other than the given one, each with its text."""
    orders = []
    for text, key in (("by the numbers", natural), ("by the letters", str)):
        ranks = np.argsort(sorted(range(len(names)), key=lambda n: key(names[n])))
        if (np.diff(ranks) < 0).any():
            orders.append((f"the lights in the order of the photographs' names, sorted {text} in them", ranks))
    return orders


def _moved(move: int) -> str:
    """Return what moves light ``i + move`` to photograph i."""
    places = "one place" if abs(move) == 1 else f"{abs(move)} places"
    return f"every light {places} further {'up' if move > 0 else 'down'}"
