"""Sample stacks: radiance and weight of every observation at every texel; in memory, in a file or over ranks."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from ..core.errors import InputError


class SampleStack(Protocol):
    """Samples of K observations at H×W texels, in memory, in a mapped file, or distributed over ranks.

    A sample is (4,) float32: linear RGB radiance and a weight, 0…1, below 0 where it is a lower bound
    (capture/bounds.py). ``ArrayStack`` is the store in memory and in a file, ``cluster.samples.RankedStack`` the
    distributed one.
    """

    @property
    def shape(self) -> tuple[int, int, int]:
        """(K, H, W)."""

    def layer(self, observation: int) -> np.ndarray:
        """Return (H, W, 4) the samples of one observation; not to be written to."""

    def layers(self) -> Iterator[np.ndarray]:
        """Yield the samples of every observation, as ``layer`` returns them."""

    def kept(self, derived: SampleStack) -> SampleStack:
        """Return a stack that is computed from this one as it is to be read: itself, or a copy on all ranks."""

    def texels(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (K, N, 4) the samples at N texels; not to be written to."""

    def subset(self, observations: np.ndarray) -> SampleStack:
        """Return the stack of some observations, by (n,) index."""

    def window(self, rows: slice, columns: slice) -> SampleStack:
        """Return the stack of a window's texels; both slices have a start and a stop."""

    def lit(self, coverage: np.ndarray) -> np.ndarray:
        """Return (H, W) bool: covered texels that at least one observation sees lit."""


def place_of(stack: SampleStack) -> str:
    """Return where a stack is: "scratch" for one in a mapped file, else "memory"."""
    return "scratch" if isinstance(stack, ArrayStack) and isinstance(stack.values.base, np.memmap) else "memory"


@dataclass(frozen=True, eq=False)
class ArrayStack:
    """A ``SampleStack`` over one array, in memory or mapped from a file. values: (K, H, W, 4) float32."""

    values: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        """(K, H, W)."""
        count, height, width = self.values.shape[:3]
        return count, height, width

    def layer(self, observation: int) -> np.ndarray:
        """Return (H, W, 4) the samples of one observation."""
        return self.values[observation]

    def layers(self) -> Iterator[np.ndarray]:
        """Yield the samples of every observation."""
        return iter(self.values)

    def kept(self, derived: SampleStack) -> SampleStack:
        """Return a stack that is computed from this one."""
        return derived

    def put(self, observation: int, layer: np.ndarray) -> None:
        """Replace the samples of one observation by (H, W, 4)."""
        self.values[observation] = layer

    def texels(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Return (K, N, 4) the samples at N texels: a view where they lie side by side, else a copy."""
        if self.values.flags.c_contiguous and len(rows):
            places = rows * self.shape[2] + columns
            if (np.diff(places) == 1).all():
                return self.values.reshape(len(self.values), -1, 4)[:, places[0] : places[-1] + 1]
        return self.values[:, rows, columns]

    def subset(self, observations: np.ndarray) -> ArrayStack:
        """Return the stack of some observations: of the first ones a view, since it may be larger than the memory."""
        first = np.array_equal(observations, np.arange(len(observations)))
        return ArrayStack(self.values[: len(observations)] if first else self.values[observations])

    def window(self, rows: slice, columns: slice) -> ArrayStack:
        """Return a view of the texels of a window."""
        return ArrayStack(self.values[:, rows, columns])

    def lit(self, coverage: np.ndarray) -> np.ndarray:
        """Return (H, W) bool: covered texels that at least one observation sees lit. Reads until all are."""
        lit = np.zeros(coverage.shape, bool)
        for layer in self.values:
            # Channel by channel: any() over an axis of three is ten times slower.
            lit |= (layer[..., 3] > 0) & ((layer[..., 0] > 0) | (layer[..., 1] > 0) | (layer[..., 2] > 0))
            if lit[coverage].all():
                break
        return coverage & lit


def new_stack(observations: int, height: int, width: int, scratch: Path | None = None) -> ArrayStack:
    """Return a stack of zeros, to be filled: in memory, or mapped from a file in the folder ``scratch``."""
    shape = (observations, height, width, 4)
    return ArrayStack(np.zeros(shape, np.float32) if scratch is None else mapped_array(scratch, shape))


def mapped_array(folder: Path, shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
    """Return zeros mapped from a temporary file in a folder; the file disappears with the array or the process.

    Raises InputError where the disk has no room: on a full disk a later write would kill the process.
    """
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    try:
        with tempfile.TemporaryFile(prefix=".irpso-", dir=folder) as file:
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            elif shutil.disk_usage(folder).free < size:
                raise OSError(28, "no space left on device")
            return np.memmap(file, dtype, "w+", shape=shape).view(np.ndarray)
    except OSError as error:
        raise InputError(
            f"{folder}: holds no scratch file of {size / 2**30:.3g} GiB ({error.strerror or error}); set TMPDIR to a"
            " folder with room, or allow more with --memory host=…"
        ) from error
