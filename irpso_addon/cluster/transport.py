"""The processes of an MPI job and the messages between them. The only module that imports mpi4py."""

from __future__ import annotations

import itertools
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np

from ..core.errors import GpuUnavailableError, InputError, IrpsoError

# Number of processes that a launcher has started: Open MPI's mpirun, MPICH's and Intel's, and Slurm's srun.
_SIZE_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS", "SLURM_STEP_NUM_TASKS")
_REMEDY = 'install it with pip ("mpi4py", beside an MPI library), or start one process'
_COMMAND, _VALUES, _STRIP = 1, 2, 3  # tags of messages
_MAX_BYTES = 1 << 30  # bytes of one message: MPI counts them in 32 bits
_POLL_SECONDS = 5e-4  # between polls for an order: a waiting rank leaves its core to working ones

Result = TypeVar("Result")


class CollectiveError(Exception):
    """An error that all ranks raise together. ``error``: for rank 0 to report."""

    def __init__(self, error: IrpsoError):
        super().__init__(str(error))
        self.error = error


class Ranks:
    """The processes of one job: this is number ``rank`` of ``size``. Without MPI there is only this one.

    host: this machine's name. local, locals: this rank's number among those on its machine, and their count. sent:
    messages and bytes that ``exchanged`` has sent so far.
    """

    def __init__(self, mpi: Any = None, world: Any = None):
        self._mpi = mpi
        self._world = mpi.COMM_WORLD if mpi and world is None else world
        self.host = platform.node()
        self.rank, self.size, self.local, self.locals = 0, 1, 0, 1
        if mpi:
            here = self._world.Split_type(mpi.COMM_TYPE_SHARED)
            self.rank, self.size = self._world.Get_rank(), self._world.Get_size()
            self.local, self.locals = here.Get_rank(), here.Get_size()
        self.sent = (0, 0)

    @property
    def leads(self) -> bool:
        """Whether this is rank 0, the only one that prints and writes."""
        return self.rank == 0

    @property
    def name(self) -> str:
        """This rank, for people."""
        return f"rank {self.rank} on {self.host}"

    def among(self, included: bool) -> Ranks | None:
        """Return the included ranks; None on the others. All ranks call it."""
        if self._world is None:
            return self
        some = self._world.Split(0 if included else self._mpi.UNDEFINED, self.rank)
        return Ranks(self._mpi, some) if included else None

    def allgather(self, value: Result) -> list[Result]:
        """Return, on every rank, the values of all ranks in their order (MPI allgather)."""
        return self._world.allgather(value) if self._world else [value]

    def broadcast(self, value: Any = None, root: int = 0) -> Any:
        """Return, on every rank, the value of rank ``root`` (MPI broadcast)."""
        return self._world.bcast(value, root=root) if self._world else value

    def agreed(self, work: Callable[[], Result]) -> Result:
        """Return the result of ``work``; if a rank raises IrpsoError, raise CollectiveError, naming it, on all."""
        error: IrpsoError | None = None
        try:
            result = work()
        except IrpsoError as raised:
            error = raised
        errors = self.allgather(None if error is None else (type(error), str(error), self.name))
        failed = [each for each in errors if each is not None]
        if not failed:
            return result
        if error is None or len(failed) < self.size or len({text for _, text, _ in failed}) > 1:
            kind, text, name = failed[0]
            more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
            error = (GpuUnavailableError if kind is GpuUnavailableError else InputError)(f"{name}{more}: {text}")
        raise CollectiveError(error)

    def order(self, order: Any) -> None:
        """Send every other rank an order."""
        for rank in range(1, self.size):
            self._world.send(order, dest=rank, tag=_COMMAND)

    def next_order(self) -> Any:
        """Wait for rank 0's next order and return it."""
        while not self._world.iprobe(source=0, tag=_COMMAND):
            time.sleep(_POLL_SECONDS)
        return self._world.recv(source=0, tag=_COMMAND)

    def gathered(self, arrays: Mapping[str, np.ndarray] | None) -> Iterator[dict[str, np.ndarray] | None]:
        """Yield on rank 0 the arrays of each rank in their order, or None; on the others send ``arrays``.

        Rank 0 must take all of them.
        """
        if not self.leads:
            self._send_arrays(arrays, 0)
            return iter(())
        own = None if arrays is None else dict(arrays)
        return itertools.chain([own], (self._receive_arrays(rank) for rank in range(1, self.size)))

    def scattered(self, arrays: list[Mapping[str, np.ndarray] | None]) -> dict[str, np.ndarray] | None:
        """Return, on each rank, its own of rank 0's arrays (MPI scatter); the other ranks' argument is ignored."""
        if not self.leads:
            return self._receive_arrays(0)
        for rank in range(1, self.size):
            self._send_arrays(arrays[rank], rank)
        return None if arrays[0] is None else dict(arrays[0])

    def exchanged(
        self, outgoing: Mapping[int, np.ndarray], incoming: Mapping[int, tuple[int, ...]]
    ) -> dict[int, np.ndarray]:
        """Send other ranks ``outgoing``; return rank → float32 array received, of the shape in ``incoming``."""
        received = {rank: np.empty(shape, np.float32) for rank, shape in incoming.items()}
        requests = [
            self._world.Irecv(part, source=rank, tag=_STRIP)
            for rank, array in received.items()
            for part in _parts(array)
        ]
        parts = [(rank, part) for rank, array in outgoing.items() for part in _parts(array)]
        requests += [self._world.Isend(part, dest=rank, tag=_STRIP) for rank, part in parts]
        self.sent = self.sent[0] + len(parts), self.sent[1] + sum(part.nbytes for _, part in parts)
        if requests:
            self._mpi.Request.Waitall(requests)
        return received

    def abort(self, code: int) -> None:
        """End all ranks at once."""
        if self._world:
            self._world.Abort(code)

    def close(self) -> None:
        """Leave the job at its end; a launcher counts a process that ends without this as failed."""
        if self._mpi and not self._mpi.Is_finalized():
            self._mpi.Finalize()

    def _send_arrays(self, arrays: Mapping[str, np.ndarray] | None, rank: int) -> None:
        arrays = None if arrays is None else {name: np.ascontiguousarray(a) for name, a in arrays.items()}
        shapes = None if arrays is None else {name: (a.shape, a.dtype.str) for name, a in arrays.items()}
        self._world.send(shapes, dest=rank, tag=_VALUES)
        for array in (arrays or {}).values():
            for part in _parts(array):
                self._world.Send(part, dest=rank, tag=_VALUES)

    def _receive_arrays(self, rank: int) -> dict[str, np.ndarray] | None:
        shapes = self._world.recv(source=rank, tag=_VALUES)
        if shapes is None:
            return None
        arrays = {name: np.empty(shape, dtype) for name, (shape, dtype) in shapes.items()}
        for array in arrays.values():
            for part in _parts(array):
                self._world.Recv(part, source=rank, tag=_VALUES)
        return arrays


def joined() -> Ranks | None:
    """Return the ranks of this process's MPI job, None where it was started alone.

    Raises InputError where a launcher has started several processes that cannot connect: each would do the whole work,
    and the last one's result would replace the others'.
    """
    started = max(int(text) for name in _SIZE_VARIABLES if (text := os.environ.get(name, "1")).isdigit())
    if started == 1:
        return None
    try:
        # Blender has other threads, but only one calls MPI.
        import mpi4py

        mpi4py.rc.thread_level = "funneled"
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        raise InputError(
            f"{started} processes were started together, but Python's mpi4py does not load ({error}); {_REMEDY}"
        ) from error
    ranks = Ranks(MPI)
    if ranks.size == 1:
        raise InputError(
            f"{started} processes were started together, but MPI reports only one: the launcher belongs to another MPI"
            " than mpi4py; start them with the mpirun of mpi4py's MPI, or with srun --mpi=pmix"
        )
    return ranks


def _parts(array: np.ndarray) -> list[np.ndarray]:
    """Return a contiguous array's bytes in pieces of at most one message."""
    flat = array.reshape(-1).view(np.uint8)
    return [flat[start : start + _MAX_BYTES] for start in range(0, len(flat), _MAX_BYTES)]
