"""Start of an MPI job: chooses a device for each rank, and checks that all ranks have the same inputs."""

from __future__ import annotations

import hashlib
import os
import sys
import traceback
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..capture.types import Capture
from ..core.errors import InputError, IrpsoError
from ..core.interrupt import exit_code_of
from ..core.paths import ROOT
from ..core.steps import available_cores
from ..gpu.versions import versions
from .transport import CollectiveError, Ranks

_NODES = Path("/dev/dri/by-path")  # Linux's render devices, by their PCI addresses
_SOURCES = ("irpso_addon/**/*.py", "shaders/**/*.glsl", "shaders/**/*.toml", "presets/*.toml", "blender_manifest.toml")
_REMEDIES = {
    "program": "install the same version of the program on all machines",
    "Python packages": "install the same versions of Blender, numpy and Python on all machines",
    "options": "start all ranks with the same command",
    "capture": "let all machines read the same files",
}


def choose_device(ranks: Ranks) -> int:
    """Set the environment so that ranks on one machine take a GPU each, or share its cores where there is none.

    Return how many ranks seem to share this one's device; too many where a launcher shows each rank another one.

    Call this before a context is made. Variables that are set stay. Mesa's drivers take the device from DRI_PRIME
    (docs.mesa3d.org, envvars). NVIDIA's takes the first that the process sees: the launcher must show each rank its
    own. Without LP_NUM_THREADS llvmpipe starts as many threads in each rank as the machine has cores. A rank of one
    core has none beside its own: with one more, a refinement's tests take 60 in place of 49 s.
    """
    cores = available_cores()
    used_here = [used for host, used in ranks.allgather((ranks.host, sorted(cores))) if host == ranks.host]
    shared = sum(not cores.isdisjoint(used) for used in used_here)
    threads = len(cores) // shared
    os.environ.setdefault("LP_NUM_THREADS", str(threads if threads > 1 else 0))
    nodes = sorted(_NODES.glob("pci-*-render")) if _NODES.is_dir() else []
    if ranks.locals > 1 and len(nodes) > 1:
        name = nodes[ranks.local % len(nodes)].name.removesuffix("-render")
        os.environ.setdefault("DRI_PRIME", name.replace(":", "_").replace(".", "_"))
    here = ranks.host, os.environ.get("DRI_PRIME")
    return ranks.allgather(here).count(here)


def check_alike(ranks: Ranks, options: Namespace, capture: Capture) -> None:
    """Raise CollectiveError on all ranks, naming one that differs in program, packages, options or capture."""
    facts = ranks.allgather((ranks.name, _about(options, capture)))
    ranks.agreed(lambda: _compare(facts))


def _compare(facts: list[tuple[str, dict[str, tuple[str, str]]]]) -> None:
    name, first = facts[0]
    for other, theirs in facts[1:]:
        for what, (words, digest) in first.items():
            if theirs[what][1] != digest:
                raise InputError(
                    f"{what} of {other} ({theirs[what][0]}) and of {name} ({words}) are not the same; {_REMEDIES[what]}"
                )


@contextmanager
def abort_together(ranks: Ranks, busy: Callable[[], bool]) -> Iterator[None]:
    """If this rank fails while others wait for it, print one line that names it and abort the whole job.

    busy: returns whether others wait; if not, the error goes to the caller.
    """
    try:
        yield
    except BaseException as error:
        if isinstance(error, CollectiveError) or not busy():
            raise
        if isinstance(error, IrpsoError | KeyboardInterrupt | MemoryError):
            text = " ".join(str(error).splitlines()) or type(error).__name__
        else:
            traceback.print_exc()
            text = f"{type(error).__name__}: {error}"
        if ranks.leads or not isinstance(error, KeyboardInterrupt):  # an interrupt reaches all ranks
            sys.stderr.write(f"irpso: {ranks.name}: {text}\n")
            sys.stderr.flush()
        ranks.abort(exit_code_of(error))
        raise


def _about(options: Namespace, capture: Capture) -> dict[str, tuple[str, str]]:
    """Return what must be equal on all ranks: subject → (description, digest)."""
    own = versions()
    packages = f"Blender {own['blender']}, numpy {own['numpy']}, Python {own['python']}"
    values = {name: str(value) for name, value in sorted(vars(options).items())}
    return {
        "program": (f"version {own['irpso']}", _digest_of_files()),
        "Python packages": (packages, packages),
        "options": (f"{len(values)} of them", repr(values)),
        "capture": (f"'{capture.name}', {len(capture.observations)} observations", _digest_of_capture(capture)),
    }


def _digest_of_files() -> str:
    digest = hashlib.sha256()
    for pattern in _SOURCES:
        for path in sorted(ROOT.glob(pattern)):
            digest.update(path.relative_to(ROOT).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _digest_of_capture(capture: Capture) -> str:
    """Return a digest of a capture without its images."""
    digest = hashlib.sha256(repr(capture.card_distance).encode())
    for observation in capture.observations:
        digest.update(repr((observation.name, observation.light, observation.camera)).encode())
    for camera, mask in zip(capture.cameras, capture.masks, strict=True):
        digest.update(repr(camera.key).encode())
        digest.update(np.packbits(np.asarray(mask, bool)).tobytes())
    return digest.hexdigest()
