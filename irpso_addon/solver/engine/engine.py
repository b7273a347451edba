"""Base class of recoveries: the interface that the window, the command line, MPI and Python drive."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Self, get_args

import numpy as np

from ...core.errors import InputError
from ...geometry.domain import Domain
from ...gpu import probe
from ...gpu.kernel import Entry, EntryChoice
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ...reflectance.model import ReflectanceModel
from ...results.maps import Cause, Maps
from ..phases.phase import Phase
from ..settings.fixed import full_map
from ..settings.resolve import unsearched_names
from ..settings.schedule import Schedule
from ..state import checkpoint
from ..state.checkpoint import Checkpoint
from ..state.layout import digest_of_texels
from ..state.prepare import Prepared
from ..state.separation import SeparatedStack
from ..state.separation_record import Separation
from .halo import Box
from .progress import Progress
from .watch import TexelRecord, record_of

_MAX_RUNNING = 1 << 21  # solvable texels: above it, checkpoints omit the running stage (about a gigabyte)
_DIVIDED = "the recovery runs in tiles or over ranks: no texture holds all of it; lower the resolution to view it"


@dataclass(frozen=True)
class Capabilities:
    """Optional features of a recovery.

    view: which live textures it lends: of the whole domain, of the tiles on the device, or none. reconfigure: whether
    it accepts other settings during the run. turns: whether tiles take turns on the device, which makes short steps
    slow. watches: whether it has ``watch``.
    """

    view: Literal["whole", "tiles", "none"]
    reconfigure: bool
    turns: bool = False
    watches: bool = False


class RecoveryEngine(ABC):
    """One run from domain, model and schedule to maps. A context manager that closes it.

    The same seed, settings and device give the same maps bit for bit, however the steps were sliced, the domain was
    divided or the run was interrupted.
    """

    def __init__(
        self,
        domain: Domain,
        model: ReflectanceModel,
        schedule: Schedule,
        seed: int,
        fixed: Mapping[str, np.ndarray] | None,
        entry: EntryChoice,
    ):
        """Store the arguments; nothing runs yet.

        fixed: parameter name → (H, W, components) or (components,) in the parameter's own units; these parameters are
        not searched. entry: of the shaders; "auto" is the one that the probe finds faster.
        """
        if entry not in ("auto", *get_args(Entry)):
            raise InputError(f"entry is '{entry}'; choose fragment, compute or auto")
        self.domain, self.model, self.schedule, self.seed = domain, model, schedule, seed
        self.entry = probe.faster_entry() if entry == "auto" else entry
        self.fixed = {name: full_map(model, name, value, domain.solvable) for name, value in (fixed or {}).items()}

    @property
    @abstractmethod
    def capabilities(self) -> Capabilities:
        """The optional features of this recovery."""

    @property
    @abstractmethod
    def progress(self) -> Progress:
        """The progress, including the finished bands of the current iteration."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the recovery itself, for the report."""
        return ()

    @property
    def findings(self) -> dict[str, Any]:
        """Results besides the maps, for the report."""
        if (separation := self.separation) is None:
            return {}
        share = separation.indirect_share[self.domain.solvable]
        return {"separation": {"texels": int(np.count_nonzero(separation.separated)), "share": float(share.mean())}}

    @abstractmethod
    def step(self, iterations: int | None = None, time_budget_s: float | None = None) -> Progress:
        """Advance by whole iterations, for about a time, or to the end; return the progress.

        The step that begins a stage also places its swarms, which is no iteration; step(0) does only that. With a time
        budget a step may stop inside an iteration; the next one continues there.
        """

    @abstractmethod
    def maps(self, confidence: bool = True) -> Maps:
        """Return the maps so far, with the mean absolute error of their render.

        confidence: find standard deviations and alternatives too, which takes as long as ten to fifteen iterations.
        """

    def record(self, rows: np.ndarray, columns: np.ndarray) -> TexelRecord:
        """Return the values of maps() at n texels; fast if one recovery holds the whole domain."""
        return record_of(self.maps(confidence=False), self.progress.iteration_in_all, rows, columns)

    @abstractmethod
    def mean_error(self) -> float:
        """Return the mean absolute error of the render so far, over a few thousand texels; NaN where none is solved.

        The texels are drawn at random, once. It takes milliseconds, where maps() may take a second.
        """

    def watch(self, rows: np.ndarray, columns: np.ndarray, due: Callable[[Progress], bool]) -> None:
        """Record from now on the values of maps() at n texels after ``due`` iterations; ``records`` returns them.

        For tiles that take turns: a call of maps() after an iteration would end their turns.
        """
        raise NotImplementedError

    def records(self) -> list[TexelRecord]:
        """Return the records of watched texels since the last call, in the order of iterations."""
        raise NotImplementedError

    @property
    def separation(self) -> Separation | None:
        """The separation (H, W) of indirect light; None: nowhere.

        The object changes only when its values change.
        """
        return None

    def indirect(self, observation: int) -> np.ndarray | float:
        """Return the indirect light that was subtracted from a photograph before the fit, (H, W, 3) or 0."""
        if (separation := self.separation) is None:
            return 0.0
        direct = SeparatedStack(self.domain, separation)
        return self.domain.stack.layer(observation)[..., :3] - direct.layer(observation)[..., :3]

    def indirect_in(self, domain: Domain) -> Generator[None, None, Callable[[int], np.ndarray | float]]:
        """Yield often; return a function that gives the indirect light of an observation, as the maps predict it.

        domain: the same texels; its observations may be others than the fitted ones. The light is (H, W, 3), or 0 where
        the recovery does not model it.
        """
        yield from ()
        return lambda observation: 0.0

    @property
    def indirect_share(self) -> np.ndarray | None:
        """(H, W) float32: the indirect part, 0…1, of a texel's light, over all photographs that show the texel.

        The last estimate; None before the first, and where none is made or no indirect light was detected. A new
        estimate is a new array.
        """
        return None if (separation := self.separation) is None else separation.indirect_share

    def refresh_confidence(self, time_budget_s: float | None = None) -> bool:
        """Compute the result of ``maps`` for about ``time_budget_s``; return whether it is ready: then maps() is fast.

        A tiled recovery computes it in maps().
        """
        return True

    def view(self) -> AbstractContextManager[dict[str, Texture]]:
        """Lend the live textures, by sampler name, to a draw callback for the length of one draw.

        u_estimate_0 … hold the parameters' components in the model's order, densely packed: u_packed has the place of
        each texel of the domain. Nothing is read back. Raises InputError where no textures hold the whole.
        """
        raise InputError(_DIVIDED)

    def deviation_pass(self) -> tuple[Pass, dict[str, int | float]]:
        """Return the pass for the deviations of the estimates of ``view``, and its constants. Raises as ``view``."""
        raise InputError(_DIVIDED)

    @property
    def has_rounds(self) -> bool:
        """Whether rounds of interreflection find ``indirect_share``."""
        return False

    @property
    def unsearched(self) -> frozenset[str]:
        """The parameters that are not searched now."""
        return unsearched_names(self.schedule, self.model, self.fixed)

    def unknown_texels(self, name: str) -> dict[Cause, np.ndarray]:
        """Return cause → (H, W) bool: texels of which a parameter is unknown, whatever its estimate in ``view``.

        ``maps`` has them too, with the widest deviations. Another mask is another array.
        """
        return {}

    @property
    def phase(self) -> Phase | None:
        """The current phase, whose textures ``view`` reads, or None."""
        return None

    def tiles(self) -> list[tuple[Box, RecoveryEngine]]:
        """Return (box of own texels, recovery) for each tile on the device. The caller must not step them."""
        return []

    def reconfigure(self, schedule: Schedule, seed: int | None = None) -> Self:
        """Return a recovery that continues from here under another schedule; this one can then only be closed.

        Raises InputError where the settings do not fit, or ``capabilities`` excludes it.
        """
        raise InputError("a run in tiles or over ranks cannot change its settings: stop it, and recover again")

    @property
    def settled(self) -> bool:
        """Whether all tiles are at one iteration. If not, ``state`` finishes the round, perhaps a turn of each."""
        return True

    @abstractmethod
    def state(self, running: bool = True) -> Checkpoint:
        """Return all that a recovery of the same domain and settings needs to reach the same maps bit for bit.

        Its arrays are of the solvable texels of the whole domain, row by row (state/layout.py), however it is divided.
        running: include the state of the running stage. Without it a resumed run repeats the stage, and the state has
        a twelfth to a half of the bytes. Ranks always include it, and so does a stage whose settings have changed since
        its begin.
        """

    @abstractmethod
    def restore(self, saved: Checkpoint) -> None:
        """Continue from a result of ``state``."""

    @property
    def identity(self) -> dict[str, Any]:
        """The properties that must match to resume a checkpoint, as plain data."""
        settings = self.model, self.schedule, self.seed, self.entry, self.fixed
        return checkpoint.identity(self.domain, *settings, self.digest)

    @cached_property
    def digest(self) -> int:
        """The digest of all samples; computed once, because it reads all of them."""
        return digest_of_texels(self.domain)

    def save(
        self,
        path: str | Path,
        extra_arrays: Mapping[str, np.ndarray] = MappingProxyType({}),
        running: bool | None = None,
    ) -> bool:
        """Write a checkpoint atomically. ``load`` continues from it to the same maps bit for bit.

        extra_arrays: of the caller, which ``load`` returns. running: as for ``state``; None: True unless the domain is
        large. Returns whether a later checkpoint in the same stage would hold more.
        """
        if running is None:
            running = bool(np.count_nonzero(self.domain.solvable) <= _MAX_RUNNING)
        state = self.state(running)
        checkpoint.write(Path(path), self.identity, replace(state, extra_arrays=extra_arrays))
        return running or any(name.startswith(checkpoint.PHASE) for name in state.arrays)

    def load(self, path: str | Path) -> dict[str, np.ndarray]:
        """Continue from a checkpoint of the same domain, model, schedule and seed, and return its extra arrays.

        Raises InputError for a checkpoint of another recovery.
        """
        saved = checkpoint.read(Path(path), self.identity)
        self.restore(saved)
        return dict(saved.extra_arrays)

    def preparation(self, domain: Domain, schedule: Schedule) -> Generator[None, None, Prepared | None]:
        """Yield often; return the preparation of a recovery of this kind, or None if it prepares itself."""
        yield from ()
        return None

    @abstractmethod
    def close(self) -> None:
        """Free all textures and shaders on the GPU."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
