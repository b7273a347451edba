"""The plan of a recovery: the tiles of a domain that fit the texture limits and the memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ...core.errors import InputError
from ...geometry.seams.seams import MAX_SEARCHED_HALO, SEAM_RADIUS
from ..state.phase_textures import plan_atlas
from .cost import FLOAT, FLOAT2, FLOAT4, Cost
from .memory import Memory, amount

BAKE = 65  # host bytes per texel: position 12, normal 12, tangent 16, coverage 1, uv 8, face normal 12, triangle 4
_TRANSPORT = 160  # host bytes per texel while a round estimates indirect light (measured): elements, weights
_INDIRECT = 48  # host bytes per texel of a round's light: number 4, elements 16, weights 16, albedo 12
_RAY = 104  # host bytes per ray while light transport is computed (measured)
_TREE = 480  # host bytes per triangle of the tree at which rays are cast (measured)
PREPARED = 28  # host bytes per texel: scale 4, the first guess's normal 12 and albedo 12
_PREPARING = 512 << 20  # host bytes for every domain: chunks of the preparation, Blender itself
_TEXTURE, _SHARE = 1 << 30, 8  # bytes of one texture that software GL allows; divisor of a large device memory
_MAX_TEXTURE = (1 << 33) - (1 << 20)  # Blender indexes a Buffer with 31 bits
_MIN_SIDE = 8  # texels along the longer side: a tile this small is not cut

Box = tuple[int, int, int, int]  # x0, y0, width, height


@dataclass(frozen=True)
class Borders:
    """Border edges of a UV map's islands. middle: (E, 2), length: (E,), in texels."""

    middle: np.ndarray
    length: np.ndarray

    def length_in(self, box: Box, halo: int) -> float:
        """Return their total length in a box and up to ``halo`` texels around it."""
        x0, y0, width, height = box
        low, high = (x0 - halo, y0 - halo), (x0 + width + halo, y0 + height + halo)
        return float(self.length[((self.middle >= low) & (self.middle <= high)).all(axis=1)].sum())


@dataclass(frozen=True)
class Limits:
    """Device limits: side and layers of a texture, and the bytes of a single one."""

    side: int = 16384
    layers: int = 2048
    texture: int = _TEXTURE


def max_texture_bytes(free: int | None) -> int:
    """Return the most bytes of one texture. free: bytes that the driver reports, or None. On an H100, 8 GiB work."""
    return min(max(_TEXTURE, (free or 0) // _SHARE), _MAX_TEXTURE)


@dataclass(frozen=True)
class Tile:
    """Texels [x0, x0 + width) × [y0, y0 + height) of the domain, with their number and bytes.

    texels: its own covered ones. solved: these, its halo's, and ghosts. window: (H, W) of its rectangle with halo and
    border of seams. device, host: bytes while it is solved. restored: bytes of its state; two copies of it are on
    the device when its turn starts.
    """

    x0: int
    y0: int
    width: int
    height: int
    texels: int
    solved: int
    window: tuple[int, int]
    device: int
    host: int
    restored: int

    @property
    def device_in_turns(self) -> int:
        """Bytes on the device while its state is restored."""
        return self.device + self.restored


@dataclass(frozen=True)
class Plan:
    """A recovery within a memory budget.

    shape: (H, W) of the domain. texels: covered. tiles: rectangles that contain these texels, with ``halo`` texels
    around each. on_device: tiles on the device at once; where not all fit, tiles take turns. stack_on, state_on: place
    of the sample stack, and of the state of waiting tiles: "memory" or "scratch" (a file). passes: turns of each tile,
    1 + exchanges. device, host, scratch: peak bytes. work, most_work: as in Cost, of all texels.
    """

    shape: tuple[int, int]
    texels: int
    observations: int
    tiles: tuple[Tile, ...]
    halo: int
    on_device: int
    stack_on: str
    state_on: str
    passes: int
    device: int
    host: int
    scratch: int
    evaluations: int
    work: float
    most_work: float
    memory: Memory

    @property
    def resident(self) -> bool:
        """Whether all tiles stay on the device."""
        return self.on_device == len(self.tiles)

    @property
    def boxes(self) -> list[Box]:
        """The tiles as (x0, y0, width, height)."""
        return [(t.x0, t.y0, t.width, t.height) for t in self.tiles]

    def as_dict(self) -> dict:
        """Return the plan as plain data."""
        return asdict(self) | {"resident": self.resident}

    def lines(self) -> list[str]:
        """Return the plan as lines for display."""
        height, width = self.shape
        count = len(self.tiles)
        share = [t.texels for t in self.tiles]
        how = f"{'all' if self.resident else self.on_device} on the device at once"
        lines = [
            f"domain        {width} × {height}, {self.texels} texels covered, {self.observations} observations",
            f"tiles         {count}" + (f" of {min(share)} to {max(share)} texels, {how}" if count > 1 else ""),
            f"device        {amount(self.device)} of {amount(self.memory.device)} ({self.memory.device_from})",
            f"host          {amount(self.host)} of {amount(self.memory.host)} ({self.memory.host_from})",
            f"scratch file  {amount(self.scratch) if self.scratch else 'none'}",
            f"evaluations   {self.evaluations / 1e6:.3g} million of {self.observations} observations each",
        ]
        if count > 1:
            largest = max(self.tiles, key=lambda t: t.device)
            turns = f", {self.passes} turns of each tile" if not self.resident else ""
            lines.insert(2, f"halo          {self.halo} texels around each tile{turns}")
            lines.insert(3, f"largest tile  {largest.width} × {largest.height} at ({largest.x0}, {largest.y0}), "
                            f"{amount(largest.device)} on the device, {amount(largest.host)} on the host")  # fmt: skip
        return lines


def plan_recovery(
    coverage: np.ndarray,
    cost: Cost,
    memory: Memory,
    limits: Limits = Limits(),
    stack_on: str | None = None,
    borders: Borders | None = None,
) -> Plan:
    """Return the plan of a recovery of the covered texels, (H, W) bool, with the fewest tiles that fit.

    The domain is halved across its longer side by the number of covered texels, recursively, until each tile fits the
    device. Where host memory does not suffice, the sample stack moves to a scratch file, then the state of waiting
    tiles. stack_on: place of a stack that has been read, or None. borders: of a mesh, whose seams need memory too.
    Raises InputError, with the setting's name, where even small tiles do not fit or no texel is covered.
    """
    cost = within_limits(cost, coverage, limits)
    whole = (0, 0, coverage.shape[1], coverage.shape[0])
    fits = _fits(coverage, whole, cost, memory, limits, borders)
    boxes = [whole] if fits else _cut(coverage, cost, memory, limits, borders)
    tiles = tuple(tile_of(coverage, box, cost, borders) for box in boxes)
    largest = max(tile.device for tile in tiles)
    restored = max(tile.restored for tile in tiles)
    resident = sum(tile.device for tile in tiles) <= memory.device
    on_device = len(tiles) if resident else max(1, (memory.device - restored) // largest)
    host, scratch, stack_on, state_on = _storage(coverage.size, tiles, cost, memory, resident, stack_on)
    device = sum(sorted(tile.device for tile in tiles)[-on_device:]) + (0 if resident else restored)
    passes = 1 if resident else (1 + cost.exchanges) * cost.recoveries
    texels = _texels(coverage)
    return Plan(
        (coverage.shape[0], coverage.shape[1]), texels, cost.observations, tiles,
        0 if boxes == [whole] else cost.stencil_radius, on_device, stack_on, state_on, passes,
        device, host, scratch, texels * cost.evaluations, texels * cost.work, texels * cost.most_work, memory,
    )  # fmt: skip


def within_limits(cost: Cost, coverage: np.ndarray, limits: Limits) -> Cost:
    """Return the cost with no more elements than covered texels, (H, W) bool. Raises InputError.

    Errors: more observations or rays than a texture takes, no covered texel.
    """
    if cost.observations > limits.layers:
        raise InputError(
            f"{cost.observations} observations exceed this GPU's textures of {limits.layers} layers; hold some out"
        )
    if not coverage.any():
        raise InputError("no texel is covered; raise the resolution or check the mask")
    cost = replace(cost, elements=min(cost.elements, _texels(coverage)))
    if _ray_bytes(cost) > limits.texture:
        raise InputError(
            f"interreflection: {cost.elements} elements of {cost.rays} rays exceed this GPU's textures of"
            f" {amount(limits.texture)}; lower interreflection_resolution or interreflection_rays"
        )
    return cost


def device_bytes(texels: int, rectangle: int, cost: Cost) -> int:
    """Return the bytes of all textures of a recovery of ``texels`` packed texels in a rectangle of ``rectangle``.

    This includes the rays between rounds of interreflection.
    """
    table = 3 * FLOAT4 * cost.observations
    return _grid_places(texels) * cost.device + FLOAT2 * rectangle + table + _ray_bytes(cost)


def _ray_bytes(cost: Cost) -> int:
    """Return the bytes of the rays on the device: a layer for each, and one with the number of those that hit."""
    return FLOAT4 * cost.elements * (cost.rays + (cost.rays > 0))


def host_bytes(texels: int, rectangle: int, cost: Cost) -> int:
    """Return the host bytes while a tile moves to or from the device: its stack, geometry and state."""
    geometry = 4 * FLOAT4
    return _grid_places(texels) * (FLOAT4 * cost.observations + geometry + cost.kept) + FLOAT2 * rectangle


def restored_bytes(texels: int, cost: Cost) -> int:
    """Return the bytes that move with a tile back to the device."""
    return _grid_places(texels) * cost.kept


def _grid_places(texels: int) -> int:
    """Return the number of places in the packed grid of ``texels`` texels, as square as Packing makes it."""
    side = int(np.ceil(np.sqrt(max(texels, 1))))
    return side * -(-max(texels, 1) // side)


def _texels(coverage: np.ndarray) -> int:
    return int(np.count_nonzero(coverage))


def _window(box: Box, halo: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    x0, y0, width, height = box
    rows = slice(max(0, y0 - halo), min(shape[0], y0 + height + halo))
    return rows, slice(max(0, x0 - halo), min(shape[1], x0 + width + halo))


def tile_of(coverage: np.ndarray, box: Box, cost: Cost, borders: Borders | None) -> Tile:
    """Return a box of the covered texels, (H, W) bool, as a tile."""
    own = coverage[_window(box, 0, coverage.shape)]
    part = coverage[_window(box, cost.stencil_radius, coverage.shape)]
    texels, seams = _texels(part), 0
    border = 0 if borders is None else 2 * SEAM_RADIUS
    window = (part.shape[0] + border, part.shape[1] + border)
    if borders is not None:
        border_length = borders.length_in(box, cost.stencil_radius)
        ghosts = int(border_length * (cost.stencil_radius if cost.stencil_radius <= MAX_SEARCHED_HALO else SEAM_RADIUS))
        texels += min(ghosts, _texels(coverage) - texels)
        # Places past borders have four channels; ghosts fill complete layers of the geometry.
        places = _grid_places(texels)
        layers = -(-int(border_length * SEAM_RADIUS) // places)
        seams = FLOAT4 * (window[0] * window[1] + layers * places) - FLOAT2 * part.size
    device, host = (count(texels, part.size, cost) + seams for count in (device_bytes, host_bytes))
    return Tile(*box, _texels(own), texels, window, device, host, restored_bytes(texels, cost))


def _cut(coverage: np.ndarray, cost: Cost, memory: Memory, limits: Limits, borders: Borders | None = None) -> list[Box]:
    """Return the fewest boxes that all fit, each the bounds of its covered texels; about equal in number of texels."""
    count = 1
    while True:
        boxes = list(divided(coverage, (0, 0, coverage.shape[1], coverage.shape[0]), count))
        unfit = [box for box in boxes if not _fits(coverage, box, cost, memory, limits, borders, in_turns=True)]
        if not unfit:
            return boxes
        if small := [box for box in unfit if max(box[2:]) <= _MIN_SIDE]:
            needs = {box: tile_of(coverage, box, cost, borders).device_in_turns for box in small}
            box = max(small, key=needs.__getitem__)
            rays = ", or interreflection_rays" if cost.rays else ""
            raise InputError(
                f"--memory device={amount(memory.device)} ({memory.device_from}): a tile of {box[2]} × {box[3]} texels"
                f" with a halo of {cost.stencil_radius} needs at least {amount(needs[box])} at its turn; allow more, or"
                f" lower the number of observations or the number of particles{rays}"
            )
        count = max(count + 1, int(1.1 * count))


def divided(coverage: np.ndarray, box: Box, count: int) -> Iterator[Box]:
    """Yield ``count`` boxes: a box is halved recursively across its longer side, by the number of covered texels.

    Yields fewer where a box would be too small.
    """
    x0, y0, _, _ = box
    part = coverage[_window(box, 0, coverage.shape)]
    rows, columns = np.flatnonzero(part.any(axis=1)), np.flatnonzero(part.any(axis=0))
    if not len(rows):
        return
    x0, y0 = x0 + int(columns[0]), y0 + int(rows[0])
    width, height = int(columns[-1] - columns[0]) + 1, int(rows[-1] - rows[0]) + 1
    if count == 1 or max(width, height) <= _MIN_SIDE:
        yield x0, y0, width, height
        return
    part = part[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    sums = np.cumsum(np.count_nonzero(part, axis=0 if width >= height else 1))
    at = int(np.clip(np.searchsorted(sums, sums[-1] * (count // 2) / count) + 1, 1, len(sums) - 1))
    if width >= height:
        halves = [(x0, y0, at, height), (x0 + at, y0, width - at, height)]
    else:
        halves = [(x0, y0, width, at), (x0, y0 + at, width, height - at)]
    for half, share in zip(halves, (count // 2, count - count // 2), strict=True):
        yield from divided(coverage, half, share)


def _fits(
    coverage: np.ndarray,
    box: Box,
    cost: Cost,
    memory: Memory,
    limits: Limits,
    borders: Borders | None,
    in_turns: bool = False,
) -> bool:
    tile = tile_of(coverage, box, cost, borders)
    device = tile.device_in_turns if in_turns else tile.device
    return device <= memory.device and fits_textures(tile, cost, limits)


def fits_textures(tile: Tile, cost: Cost, limits: Limits) -> bool:
    """Return whether every texture of a tile is within the device's limits."""
    places = _grid_places(tile.solved)
    side = int(np.ceil(np.sqrt(places)))
    full = tile.solved == tile.window[0] * tile.window[1]  # Packing leaves a full window as it is
    height, width = tile.window if full else (side, side)
    tiles = max(phase.atlas for phase in cost.phases)
    if max(*tile.window, side) > limits.side or places * FLOAT4 * cost.observations > limits.texture:
        return False
    try:
        atlas = plan_atlas(width, height, tiles, limits.side)
    except InputError:
        return False
    return places * FLOAT4 * atlas.across * atlas.down <= limits.texture


def _storage(
    texels: int, tiles: Sequence[Tile], cost: Cost, memory: Memory, resident: bool, stack_on: str | None
) -> tuple[int, int, str, str]:
    """Return (host bytes, scratch bytes, stack_on, state_on). The sample stack is the first to move to a file.

    texels: number of texels of the domain, covered or not.
    """
    coarse = sum(-(-texels // 4**halvings) for halvings in range(1, cost.levels))
    stack = stack_bytes(cost, texels) + FLOAT4 * cost.observations * coarse
    state = 0 if resident else cost.kept * sum(_grid_places(tile.texels) for tile in tiles)
    maps = FLOAT * (2 * cost.components + 1) * texels
    transient = max(tile.host for tile in tiles)  # while a tile is prepared, or indirect light is estimated
    needed = _PREPARING + (BAKE + PREPARED) * texels + maps
    if cost.rounds:
        transient = max(transient, light_transport_bytes(cost, texels) - _INDIRECT * texels)
        lights = max(cost.recoveries - 1, 1)  # that are kept: on a card a round's depends on those before
        needed += (_INDIRECT * lights + FLOAT * (cost.components + 1) * cost.rounds) * texels
        needed += 3 * FLOAT * cost.observations * cost.rounds * cost.elements
    needed += transient
    choices = [(first, second) for second in ("memory", "scratch") for first in ("memory", "scratch")]
    for places in [w for w in choices if w[0] == (stack_on or w[0]) and w != ("memory", "scratch")]:
        scratch = stack * (places[0] == "scratch") + state * (places[1] == "scratch")
        host = needed + stack + state - scratch
        if host <= memory.host:
            return host, scratch, *places
    how = " even with the images in a scratch file" if scratch else ""
    remedy = "choose a smaller --resolution"
    if cost.rounds and host - light_transport_bytes(cost, texels) <= memory.host:
        remedy = "recover without interreflection (interreflection_rounds=0, interreflection_matte_rounds=0)"
    raise InputError(
        f"--memory host={amount(memory.host)} ({memory.host_from}): the recovery needs {amount(host)}{how}; allow more,"
        f" or {remedy}"
    )


def light_transport_bytes(cost: Cost, texels: int) -> int:
    """Return the host bytes of the light transport over a domain's texels; 0 without rounds of interreflection."""
    if not cost.rounds:
        return 0
    return _TRANSPORT * texels + _RAY * cost.rays * cost.elements + _TREE * cost.triangles


def stack_bytes(cost: Cost, texels: int) -> int:
    """Return the bytes of the samples of a domain's texels."""
    return FLOAT4 * cost.observed * texels
