"""Checkpoints: the state of a recovery in one file, written whole or not at all."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..errors import CheckpointError
from ..files import replacing_file, synced
from ..geometry.domain import Domain
from ..gpu.library import read_source
from ..reflectance.model import ReflectanceModel
from .kernels import model_includes
from .portable import digest_of_texels
from .schedule import Schedule

_VERSION = 3
_NOTE = "note_"  # before the names of arrays in the file that are the caller's


@dataclass(frozen=True)
class Checkpoint:
    """The state of a recovery, and what its caller wants to find again.

    stage: index of the running stage. iteration: as the phase counts. arrays: texture contents by name. notes: arrays
    of the caller's own by name.
    """

    stage: int
    iteration: int
    evaluations: int
    arrays: dict[str, np.ndarray]
    notes: Mapping[str, np.ndarray] = field(default_factory=dict)


def identity(
    domain: Domain,
    model: ReflectanceModel,
    schedule: Schedule,
    seed: int,
    entry: str,
    known: Mapping[str, np.ndarray] = MappingProxyType({}),
    samples: int | None = None,
) -> dict[str, Any]:
    """Return what must be equal for a checkpoint to be gone on from, as plain data.

    samples: of ``digest_of_texels``, where the domain's own stack does not hold them.
    """
    bake = domain.bake
    samples = digest_of_texels(domain) if samples is None else samples
    shape = (bake.position, bake.normal, bake.tangent, bake.coverage)
    if domain.seams is not None:
        shape += (domain.seams.place, domain.seams.of, domain.seams.target)
    return {
        "model": model.name,
        "preset": dataclasses.asdict(schedule),
        "seed": seed,
        "entry": entry,
        "parameters": [*(dataclasses.asdict(p) for p in model.parameters), model.starts],
        "shader": hashlib.sha256(read_source(model.shader, model_includes(model)).encode()).hexdigest(),
        "domain": [*domain.shape, *domain.origin, *domain.halo],
        "observations": [_digest((domain.lights, domain.intensities, domain.views)), f"{samples:016x}"],
        "geometry": _digest(shape),
        "known": {name: _digest([known[name]]) for name in sorted(known)},
        "tiles": None,
    }


def _digest(arrays: Iterable[np.ndarray]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array))
    return digest.hexdigest()


def named(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays whose names begin with a prefix, named without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def write(path: Path, who: dict[str, Any], state: Checkpoint) -> None:
    """Write a checkpoint to ``path`` through a temporary name beside it."""
    arrays = state.arrays | {_NOTE + name: array for name, array in state.notes.items()}
    about = {
        "version": _VERSION,
        "identity": who,
        "stage": state.stage,
        "iteration": state.iteration,
        "evaluations": state.evaluations,
        "arrays": {name: [list(array.shape), _digest([array])] for name, array in arrays.items()},
    }
    with replacing_file(path) as part:
        with part.open("wb") as file:
            np.savez(file, about=np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays)
        synced(part)
    synced(path.parent)


def read(path: Path, who: dict[str, Any]) -> Checkpoint:
    """Read a checkpoint. Raises CheckpointError where it is missing, damaged, or another's, naming what differs."""
    try:
        saved = _unpacked(path)
    except OSError as error:
        raise CheckpointError(f"{path}: the checkpoint cannot be read ({error.strerror or error})") from error
    except _DAMAGED as error:
        raise CheckpointError(f"{path}: is no checkpoint, or a damaged one; start without --resume") from error
    if saved is None:
        raise CheckpointError(f"{path}: is a checkpoint of another version; start without --resume")
    found, checkpoint = saved
    ours = json.loads(json.dumps(who))
    if differing := [name for name in ours if found.get(name) != ours[name]]:
        raise CheckpointError(f"{path}: is of another recovery: {', '.join(differing)} differ; start without --resume")
    return checkpoint


# What numpy, zipfile and json were seen to raise when single bytes of a checkpoint were changed.
_DAMAGED = (zipfile.BadZipFile, ValueError, KeyError, EOFError, TypeError, AttributeError, RuntimeError)


def tiles_of(path: Path) -> tuple[list[tuple[int, int, int, int]], int]:
    """Return the boxes and the halo of the tiles that a checkpoint's recovery had; no boxes where it was of the whole.

    What is damaged has no boxes either: ``read`` will say so.
    """
    try:
        tiles = _identity_in(path).get("tiles") or []
        return [tuple(int(n) for n in tile[:4]) for tile in tiles], max((int(tile[4]) for tile in tiles), default=0)
    except (OSError, *_DAMAGED):
        return [], 0


def entry_of(path: Path) -> str | None:
    """Return by which kind of pass a checkpoint's recovery was solved; None where it is damaged, as ``read`` will say.

    The two kinds differ in the last bits, and a machine under load may find the other one faster than it did before.
    """
    try:
        return str(_identity_in(path)["entry"])
    except (OSError, *_DAMAGED):
        return None


def _identity_in(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return json.loads(bytes(file["about"]))["identity"]


def _unpacked(path: Path) -> tuple[dict[str, Any], Checkpoint] | None:
    """Return whose checkpoint it is, and what it holds; None where it is of another version."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    about = json.loads(bytes(arrays.pop("about")))
    if about["version"] != _VERSION:
        return None
    if {name: [list(array.shape), _digest([array])] for name, array in arrays.items()} != about["arrays"]:
        raise ValueError("the arrays are not those that were written")
    notes = named(arrays, _NOTE)
    arrays = {name: array for name, array in arrays.items() if not name.startswith(_NOTE)}
    return about["identity"], Checkpoint(about["stage"], about["iteration"], about["evaluations"], arrays, notes)
