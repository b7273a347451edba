"""What a recovery asks of each of its phases, whatever searches in it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from ...gpu.bands import Bands

BAND_SECONDS = 0.02  # of one draw while a window waits
BACKGROUND_BAND_SECONDS = 0.25  # well under the two seconds at which drivers kill a draw
_BANDS = 8  # that a long time budget is cut into
_SHARE = 0.5  # of a time budget that one band takes: the last one begins before the budget is spent


def band_seconds(time_budget_s: float | None) -> float:
    """Return how long a band of a step takes, by the time budget of the step, None for none."""
    if time_budget_s is None:
        return BACKGROUND_BAND_SECONDS
    return min(max(BAND_SECONDS, time_budget_s / _BANDS), _SHARE * time_budget_s)


class Phase(Protocol):
    """One phase under way: it reads the current estimates and puts what it finds into the resolved ones.

    title: what is searched, for people. iteration: how many were made, negative while swarms are being placed.
    iterations: how many there will be. done: whether all were made. evaluations: renders of all observations that the
    iteration that is next makes at each texel. reach: how many texels away it reads what others have found (0: none),
    which is the halo that tiles must have exchanged before it. placed: whether it has found anything to look at; until
    then the current estimates are what there is.

    Its textures and shaders are made where they are first needed, in the slices of ``advance``.
    """

    title: str
    iteration: int
    iterations: int

    @property
    def done(self) -> bool: ...  # noqa: D102

    @property
    def evaluations(self) -> int: ...  # noqa: D102

    @property
    def reach(self) -> int: ...  # noqa: D102

    @property
    def placed(self) -> bool: ...  # noqa: D102

    def advance(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Make one iteration in bands of rows of about ``seconds``; yield after each. Counts up when it is whole."""

    def conclude(self, bands: Bands, seconds: float) -> Iterator[None]:
        """Put what has been found so far into the resolved estimates, in bands; yield after each. Changes no search."""

    def preview(self, targets: list[Any]) -> None:
        """Put what has been found so far, if something is placed, into other textures: cheap, without the last word."""

    def resolve(self) -> None:
        """Put what has been found so far into the resolved estimates, at once."""
        for _ in self.conclude(Bands(), BACKGROUND_BAND_SECONDS):
            pass

    def reached(self, threshold: float) -> bool:
        """Return whether the fitness of every texel that is solved here is at or under ``threshold``."""

    def halo(self) -> np.ndarray:
        """Return (H, W, n) float32 over the domain: what neighbours read of each texel; NaN where none is solved."""

    def take_halo(self, values: np.ndarray, ghosts: np.ndarray | float = 0.0) -> None:
        """Take (H, W, n), and (M, n) of the ghosts, at texels of other tiles; the tile's own stay."""

    def sample(self) -> np.ndarray | None:
        """Return this tile's part of the sample of the whole domain (mixture.py) that the next iteration needs.

        None where it needs none. An iteration that needs one has a ``reach`` too.
        """
        return None

    def take_sample(self, sample: np.ndarray) -> None:
        """Take the sample of the whole domain."""

    def state(self) -> dict[str, np.ndarray]:
        """Return all that outlives an iteration, by name."""

    def restore(self, arrays: dict[str, np.ndarray], iteration: int) -> None:
        """Go on from what ``state`` returned at an iteration."""

    def close(self) -> None:
        """Free shaders and textures."""
