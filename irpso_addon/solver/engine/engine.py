"""The contract of a recovery: what the window, the command line, MPI and Python drive, however a domain is solved."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Protocol, Self

import numpy as np

from ...core.errors import InputError
from ...geometry.domain import Domain
from ...gpu.passes import Pass
from ...reflectance.model import ReflectanceModel
from ...results.maps import Maps
from ..phases.phase import Phase
from ..settings.schedule import Schedule
from ..state import checkpoint
from ..state.checkpoint import Checkpoint
from .halo import Box
from .progress import Progress


@dataclass(frozen=True)
class Capabilities:
    """What a recovery can do beside stepping to its maps.

    view: which live textures it lends: those of the whole domain, of the tiles on the device, or none. reconfigure:
    whether it takes other settings in mid-run. turns: whether tiles take turns on the device, so that short steps cost.
    """

    view: Literal["whole", "tiles", "none"]
    reconfigure: bool
    turns: bool = False


class RecoveryEngine(Protocol):
    """One run: domain, model and schedule to maps.

    The same seed, settings and device give the same maps bit for bit, however the steps were
    sliced, the domain divided or the run interrupted. It is a context manager, which closes it.
    """

    domain: Domain
    model: ReflectanceModel
    schedule: Schedule
    seed: int
    entry: str

    @property
    def capabilities(self) -> Capabilities:
        """What it can do."""

    @property
    def progress(self) -> Progress:
        """How far it is."""

    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance by whole iterations, or for about so long, or to the end; return the progress.

        Placing a stage's swarms is no iteration: it comes with the step that begins the stage, and step(0) does no
        more. With a time budget it may stop inside an iteration, and goes on there next time.
        """

    def maps(self, confidence: bool = True) -> Maps:
        """Return what has been found so far, with the mean absolute error of its render.

        confidence: whether to find standard deviations and alternatives too, which takes as long as ten to fifteen
        iterations.
        """

    def mean_error(self) -> float:
        """Return the mean absolute error of the render of what has been found so far, over a few thousand texels.

        They are drawn at random, once; NaN where none is solved. It takes milliseconds, where maps() may take a second.
        """

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        """Find what ``maps`` returns, for about so long; return whether it is found: then maps() itself is quick.

        Of a divided recovery maps() finds it.
        """
        return True

    def view(self) -> AbstractContextManager[dict[str, Any]]:
        """Lend the live textures, by sampler name, to a draw callback for the length of one draw.

        u_estimate_0 … hold the parameters' components in the model's order, densely packed: u_packed tells where a
        texel of the domain lies in them. No copy is read back. Raises InputError where no textures hold the whole.
        """
        raise InputError(_UNSEEN)

    def deviation_pass(self) -> tuple[Pass, dict[str, int | float]]:
        """Return the pass that finds the deviations of what ``view`` lends, and its constants. Raises as ``view``."""
        raise InputError(_UNSEEN)

    @property
    def phase(self) -> Phase | None:
        """The phase under way, whose textures ``view`` reads; None where there is none."""
        return None

    def tiles(self) -> list[tuple[Box, RecoveryEngine]]:
        """Return the tiles on the device, to look at and not to step: boxes of their own texels, and recoveries."""
        return []

    def reconfigure(self, schedule: Schedule, seed: int | None = None) -> Self:
        """Return a recovery that goes on from here under another schedule; this one can only be closed then.

        Raises InputError where the settings do not fit, or ``capabilities`` excludes it.
        """
        raise InputError("a divided recovery takes no other settings in mid-run: stop, and recover again with them")

    def state(self) -> Checkpoint:
        """Return what a recovery of the same domain and settings needs to go on to the same maps bit for bit.

        Its arrays are of the solvable texels of the whole domain, row by row (state/layout.py): whole, in tiles and
        over ranks they are the same.
        """

    def restore(self, saved: Checkpoint) -> None:
        """Go on from what ``state`` returned."""

    @property
    def identity(self) -> dict[str, Any]:
        """What must be equal for a checkpoint to be resumed, as plain data."""

    def save(self, path: str | Path, notes: Mapping[str, np.ndarray] = MappingProxyType({})) -> None:
        """Write a checkpoint, from which ``load`` goes on to the same maps bit for bit. Written whole or not at all.

        notes: arrays of the caller's own, which ``load`` gives back.
        """
        checkpoint.write(Path(path), self.identity, replace(self.state(), notes=notes))

    def load(self, path: str | Path) -> dict[str, np.ndarray]:
        """Go on from a checkpoint of the same domain, model, schedule and seed, and return its notes.

        Raises InputError for another's.
        """
        saved = checkpoint.read(Path(path), self.identity)
        self.restore(saved)
        return dict(saved.notes)

    def close(self) -> None:
        """Free all that lies on the GPU."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


_UNSEEN = "the recovery is divided: no textures hold the whole; lower the resolution to look at it as a whole"
