"""Divides a domain into a box per rank, and checks that each fits its device."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..geometry.domain import Domain
from ..solver.engine.halo import Box
from ..solver.planning.cost import Cost
from ..solver.planning.memory import Memory, amount
from ..solver.planning.plan import (
    BAKE,
    PREPARED,
    Borders,
    Limits,
    Tile,
    divided,
    fits_textures,
    light_transport_bytes,
    stack_bytes,
    tile_of,
)
from .transport import Ranks


@dataclass(frozen=True)
class Split:
    """A domain divided over ranks. shape: (H, W). tiles: of the first ranks, which have texels."""

    shape: tuple[int, int]
    tiles: tuple[Tile, ...]
    ranks: int
    cost: Cost

    @property
    def halo(self) -> int:
        """Texels around each box."""
        return self.cost.stencil_radius

    @property
    def state(self) -> int:
        """Bytes that rank 0 gathers for a checkpoint."""
        return self.cost.kept * sum(tile.texels for tile in self.tiles)

    @property
    def boxes(self) -> tuple[Box | None, ...]:
        """The box of every rank, None for those without texels."""
        boxes = [(tile.x0, tile.y0, tile.width, tile.height) for tile in self.tiles]
        return (*boxes, *[None] * (self.ranks - len(boxes)))

    @property
    def geometry(self) -> int:
        """Bytes of the geometry of the whole domain, which every rank holds."""
        return BAKE * self.shape[0] * self.shape[1]

    def host(self, tile: Tile) -> int:
        """Return the host bytes of a tile's rank: its samples and solved state, and the geometry of the whole."""
        _, _, width, height = around(self.shape, (tile.x0, tile.y0, tile.width, tile.height), self.halo)
        samples = self.cost.stacks * stack_bytes(self.cost, width * height)
        of_rank_0 = light_transport_bytes(self.cost, self.shape[0] * self.shape[1]) if tile is self.tiles[0] else 0
        return self.geometry + PREPARED * width * height + samples + max(tile.host, of_rank_0)

    def as_dict(self) -> dict[str, Any]:
        """Return the split as plain data."""
        return {
            "shape": list(self.shape), "ranks": self.ranks, "halo": self.halo,
            "observations": self.cost.observations,
            "tiles": [vars(tile) | {"host": self.host(tile)} for tile in self.tiles],
            "texels": sum(tile.texels for tile in self.tiles),
            "checkpoint": self.state,
        }  # fmt: skip

    def lines(self) -> list[str]:
        """Return the split as lines of text."""
        texels = [tile.texels for tile in self.tiles]
        idle = self.ranks - len(self.tiles)
        return [
            f"domain        {self.shape[1]} × {self.shape[0]}, {sum(texels)} texels covered,"
            f" {self.cost.observations} observations",
            f"ranks         {self.ranks}" + (f", {idle} of them without texels" if idle else ""),
            f"texels        {min(texels)} to {max(texels)} to a rank, and a halo of {self.halo} around them",
            f"device        {amount(max(tile.device for tile in self.tiles))} at most",
            f"host          {amount(max(map(self.host, self.tiles)))} at most, {amount(self.geometry)} of it geometry",
            f"checkpoint    {amount(self.state)}, gathered on rank 0",
        ]


@dataclass(frozen=True)
class Partition:
    """A rank's part of a domain.

    whole: the domain, without its samples. boxes: of every rank, None for one without texels. halo: texels around them.
    window: the domain of this rank's box and its halo, None where it has none.
    """

    whole: Domain
    boxes: tuple[Box | None, ...]
    halo: int
    window: Domain | None


def around(shape: tuple[int, int], box: Box, halo: int) -> Box:
    """Return a box with its halo, cut at the border of a domain of (H, W)."""
    (height, width), (x0, y0, wide, high) = shape, box
    left, bottom = max(0, x0 - halo), max(0, y0 - halo)
    return left, bottom, min(width, x0 + wide + halo) - left, min(height, y0 + high + halo) - bottom


def split(coverage: np.ndarray, cost: Cost, ranks: int, borders: Borders | None = None) -> Split:
    """Return boxes for ``ranks`` ranks, with about equally many covered texels. coverage: (H, W) bool."""
    if not coverage.any():
        raise InputError("no texel is covered; raise the resolution or check the mask")
    height, width = coverage.shape
    boxes = divided(coverage, (0, 0, width, height), ranks)
    costs = (cost if rank == 0 else replace(cost, rays=0) for rank in range(ranks))  # rank 0 alone holds rays
    tiles = tuple(tile_of(coverage, box, each, borders) for box, each in zip(boxes, costs, strict=False))
    return Split((height, width), tiles, ranks, cost)


def check_gathered(division: Split, memory: Memory) -> None:
    """Raise InputError where a checkpoint of all ranks does not fit the memory of rank 0's machine."""
    if division.state > memory.host:
        raise InputError(
            f"--checkpoint-every: a checkpoint takes {amount(division.state)} on rank 0, where there are"
            f" {amount(memory.host)} ({memory.host_from}); leave it out, or state the memory with --memory host=…"
        )


def check_fits(division: Split, ranks: Ranks, memory: Memory, limits: Limits, sharing: int) -> None:
    """Raise InputError where this rank's texels do not fit its device or its part of the main memory.

    memory: of each of this machine's devices, and the main memory of all its ranks. limits: of this rank's textures.
    sharing: how many ranks have this one's device.
    """
    if ranks.rank >= len(division.tiles):
        return
    tile = division.tiles[ranks.rank]
    allowed = memory.device // sharing
    if tile.device > allowed:
        raise InputError(
            f"{tile.texels} texels with a halo of {division.halo} take {amount(tile.device)} on the device, where there"
            f" are {amount(allowed)} for each of {sharing} ranks ({memory.device_from}); start more ranks on more"
            " machines, or state the memory with --memory device=…"
        )
    if not fits_textures(tile, division.cost, limits):
        raise InputError(
            f"{tile.texels} texels with a halo of {division.halo} need a texture that exceeds this GPU's limits"
            f" ({limits.side} texels a side, {amount(limits.texture)}); start more ranks, or lower the number of"
            " observations or the number of particles"
        )
    busy = min(ranks.locals, len(division.tiles))
    if division.host(tile) > memory.host // busy:
        raise InputError(
            f"{tile.texels} texels with a halo of {division.halo} take {amount(division.host(tile))} of main memory,"
            f" where there are {amount(memory.host // busy)} for each of {busy} ranks on this machine"
            f" ({memory.host_from}); start fewer ranks on each machine and more machines, or state the memory with"
            " --memory host=…"
        )
