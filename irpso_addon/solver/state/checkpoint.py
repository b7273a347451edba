"""Checkpoints: the state of a recovery in one file, written atomically."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ...core.errors import CheckpointError
from ...core.files import replacing_file
from ...geometry.domain import Domain
from ...gpu.library import read_source
from ...reflectance.model import ReflectanceModel
from ..kernels.declarations import model_includes
from ..settings.schedule import Schedule
from .layout import digest_of_texels

_VERSION = 8  # raised where the file, or a recovery that resumes from it, would be another
_EXTRA, _FORMER_EXTRA = "extra_", "note_"  # prefixes of the caller's own arrays in the file; until version 7
NEVER = -1  # value of ``begun`` where the stage cannot restart from its begin
PHASE = "phase_"  # prefix of the arrays of the running phase


@dataclass(frozen=True)
class Checkpoint:
    """The state of a recovery, and arrays of its caller.

    stage: index of the running stage. iteration: of its phase. arrays: by name, rows of all solvable texels
    (layout.py), or textures within one process; without the phase's arrays the stage restarts. extra_arrays: the
    caller's, by name. begun: the evaluations at the begin of the stage, or NEVER.
    """

    stage: int
    iteration: int
    evaluations: int
    arrays: dict[str, np.ndarray]
    extra_arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    begun: int = 0

    @property
    def of_stage(self) -> Checkpoint:
        """The state at the begin of the running stage."""
        arrays = {name: array for name, array in self.arrays.items() if not name.startswith(PHASE)}
        return dataclasses.replace(self, iteration=0, evaluations=self.begun, arrays=arrays)


def identity(
    domain: Domain,
    model: ReflectanceModel,
    schedule: Schedule,
    seed: int,
    entry: str,
    fixed: Mapping[str, np.ndarray] = MappingProxyType({}),
    samples: int | None = None,
) -> dict[str, Any]:
    """Return, as plain data, the properties that must match to resume a checkpoint.

    samples: from ``digest_of_texels``, where the domain's own stack does not hold the samples.
    """
    bake = domain.bake
    samples = digest_of_texels(domain) if samples is None else samples
    shape = [bake.position, bake.normal, bake.tangent, bake.coverage]
    if domain.seams is not None:
        shape += [domain.seams.place, domain.seams.of, domain.seams.target]
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
        "fixed": {name: _digest([fixed[name]]) for name in sorted(fixed)},
    }


def _digest(arrays: Iterable[np.ndarray]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def named(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    """Return the arrays whose names begin with a prefix, named without it."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def write(path: Path, who: dict[str, Any], state: Checkpoint) -> None:
    """Write a checkpoint to ``path`` through a temporary name beside it."""
    arrays = state.arrays | {_EXTRA + name: array for name, array in state.extra_arrays.items()}
    about = {
        "version": _VERSION,
        "identity": who,
        "stage": state.stage,
        "iteration": state.iteration,
        "evaluations": state.evaluations,
        "begun": state.begun,
        "arrays": {name: [list(array.shape), _digest([array])] for name, array in arrays.items()},
    }
    with replacing_file(path, durable=True) as part, part.open("wb") as file:
        np.savez(file, about=np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays)


def read(path: Path, who: dict[str, Any]) -> Checkpoint:
    """Read a checkpoint. Raises CheckpointError if it is missing, damaged or of another recovery."""
    with _reading(path):
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(bytes(arrays.pop("about")))
        _check(path, about, who)
        if {name: [list(array.shape), _digest([array])] for name, array in arrays.items()} != about["arrays"]:
            raise ValueError("the arrays are not those that were written")
        extra_arrays = named(arrays, _EXTRA)
        arrays = {name: array for name, array in arrays.items() if not name.startswith(_EXTRA)}
        counts = about["stage"], about["iteration"], about["evaluations"]
        return Checkpoint(*counts, arrays, extra_arrays, about["begun"])


def glance(path: Path, who: Mapping[str, Any]) -> dict[str, Any]:
    """Return a checkpoint's identity without reading its arrays.

    who: the known part of the recovery's ``identity``. Raises CheckpointError as ``read`` does.
    """
    with _reading(path):
        with np.load(path) as file:
            about = json.loads(bytes(file["about"]))
        _check(path, about, who)
        return dict(about["identity"])


def check_replaceable(path: Path) -> None:
    """Raise CheckpointError if there is a file at ``path`` that does not begin as a checkpoint, of any version."""
    if not path.exists():
        return
    with _reading(path, "move or delete it, or choose another folder"), np.load(path) as file:
        about = json.loads(bytes(file["about"]))
        if not {"version", "identity"} <= set(about):
            raise ValueError("another program wrote it")


def read_extra_array(path: Path, name: str) -> np.ndarray:
    """Return one of a checkpoint's extra arrays, of any version. Raises CheckpointError if it is missing."""
    with _reading(path), np.load(path) as file:
        return file[_EXTRA + name if _EXTRA + name in file else _FORMER_EXTRA + name]


# Raised by numpy, zipfile and json when single bytes of a checkpoint were changed.
_DAMAGED = (zipfile.BadZipFile, ValueError, KeyError, EOFError, TypeError, AttributeError, RuntimeError)


@contextmanager
def _reading(path: Path, remedy: str = "start without --resume, and move or delete it first") -> Iterator[None]:
    """Convert the errors of reading a file to CheckpointError. remedy: for a file that is no whole checkpoint."""
    try:
        yield
    except OSError as error:
        raise CheckpointError(
            f"{path}: the checkpoint cannot be read ({error.strerror or error}); check its path and permissions"
        ) from error
    except _DAMAGED as error:
        raise CheckpointError(f"{path}: is no checkpoint, or a damaged one; {remedy}") from error


def _check(path: Path, about: dict[str, Any], who: Mapping[str, Any]) -> None:
    if about["version"] != _VERSION:
        raise CheckpointError(f"{path}: is of another version of the program; finish it there, or leave out --resume")
    theirs, ours = dict(about["identity"]), json.loads(json.dumps(who))
    differing = [name for name in ours if theirs.get(name) != ours[name]]
    if differing:
        details = [text for name in differing if (text := _difference(name, theirs.get(name), ours[name]))]
        verb = "differs" if len(differing) == 1 else "differ"
        raise CheckpointError(
            f"{path}: is of another recovery: {', '.join(differing)} {verb}"
            f"{' (' + '; '.join(details) + ')' if details else ''}; start without --resume"
        )


def _difference(name: str, there: Any, here: Any) -> str:
    """Return in words how a user's setting differs; "" if it is no setting."""
    if name in ("model", "seed", "entry"):
        return f"{name} {there} there, {here} here"
    if name == "geometry":
        return "another mesh, camera, mask or distance of the card"
    if name == "preset" and isinstance(there, dict):
        return f"in the preset {', '.join(dict.fromkeys(_leaves(there, here)))}"
    return ""


def _leaves(there: Any, here: Any, name: str = "") -> Iterator[str]:
    """Yield the names of the settings that differ, at any depth."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in {**there, **here}:
            yield from _leaves(there.get(key), here.get(key), key)
    elif isinstance(there, list) and isinstance(here, list) and len(there) == len(here):
        for one, other in zip(there, here, strict=True):
            yield from _leaves(one, other, name)
    elif there != here:
        yield name
