"""Pictures and single texels of a running recovery, tiled or not, for a window."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import TypeVar

from ...geometry.domain import Domain
from ...gpu import textures
from ...gpu.kernel import Kernel, Output
from ...gpu.passes import Pass
from ...gpu.textures import Texture
from ...results.maps import Cause
from ..engine.engine import RecoveryEngine
from ..engine.halo import Box
from ..kernels.declarations import FLOAT_2D
from .display import KEPT, Display, Shown
from .texel_probe import TexelProbe, TexelState

View = TypeVar("View", Display, TexelProbe)
_SIDE = 2048  # largest side of a picture of tiles: more than a window shows, and little memory
_PLACE = {
    **{f"u_{name}": "INT" for name in ("x", "y", "left", "bottom", "right", "top")},
    **{f"u_{name}": "FLOAT" for name in ("across", "up")},
}


def display_of(recovery: RecoveryEngine) -> Display | TiledDisplay:
    """Return the Display of a recovery."""
    return TiledDisplay(recovery) if recovery.capabilities.view == "tiles" else Display(recovery)


def texel_probe_of(recovery: RecoveryEngine) -> TexelProbe | TiledTexelProbe:
    """Return the texel probe of a recovery."""
    return TiledTexelProbe(recovery) if recovery.capabilities.view == "tiles" else TexelProbe(recovery)


class TiledDisplay:
    """Pictures of a recovery in tiles, with the interface of Display; ``close`` it before the recovery.

    A picture has the domain's size, with sides of at most 2048 texels. It is composed of the pictures of the tiles on
    the device; a tile that waits shows its last state there, or nothing before its first turn.
    """

    def __init__(self, recovery: RecoveryEngine):
        self._recovery = recovery
        self._displays: dict[RecoveryEngine, Display] = {}
        self._pictures: OrderedDict[Shown, Texture] = OrderedDict()
        self._copy_tile = Pass(
            Kernel("view/lay_tile.glsl", (Output("o_picture", "RGBA16F"),), {"u_tile": FLOAT_2D}, _PLACE, {})
        )

    def picture(self, shown: Shown, time_budget_s: float | None = None) -> Texture:
        """Return a texture as Display.picture; the budget is for all tiles together."""
        live = self._recovery.tiles()
        share = None if time_budget_s is None else time_budget_s / len(live)
        _update_views(self._displays, live, partial(Display, whole=self._recovery))
        target = self._texture_of(shown)
        for box, tile in live:
            piece = self._displays[tile].picture(shown, share)
            self._copy_tile.run([target], {"u_tile": piece}, self._place(box, tile, target))
        return target

    def pending(self, shown: Shown) -> bool:
        """Return whether the picture is older than the recovery's state, as Display.pending."""
        tiles = [tile for _, tile in self._recovery.tiles()]
        return shown not in self._pictures or any(
            tile not in self._displays or self._displays[tile].pending(shown) for tile in tiles
        )

    def unknown_at(self, row: int, column: int) -> dict[str, Cause] | None:
        """Return why a texel is unknown, as Display.unknown_at; None where its tile waits for its turn."""
        for (left, bottom, width, height), tile in self._recovery.tiles():
            if tile in self._displays and 0 <= column - left < width and 0 <= row - bottom < height:
                x, y = _corner(self._recovery.domain, tile)
                return self._displays[tile].unknown_at(row - y, column - x)
        return None

    def close(self) -> None:
        """Free shaders and textures."""
        _update_views(self._displays, [], Display)
        self._copy_tile.close()
        self._pictures.clear()

    def _texture_of(self, shown: Shown) -> Texture:
        if shown not in self._pictures:
            height, width = (min(side, _SIDE) for side in self._recovery.domain.shape)
            # A pass keeps the frame buffers of its targets, so textures are reused.
            texture = self._pictures.popitem(last=False)[1] if len(self._pictures) == KEPT else None
            texture = textures.empty(width, height, "RGBA16F") if texture is None else texture
            texture.clear(format="FLOAT", value=(0.0, 0.0, 0.0, 0.0))
            self._pictures[shown] = texture
        self._pictures.move_to_end(shown)
        return self._pictures[shown]

    def _place(self, box: Box, tile: RecoveryEngine, target: Texture) -> dict[str, int | float]:
        whole = self._recovery.domain
        (x, y), (left, bottom, width, height) = _corner(whole, tile), box
        return {
            "u_x": x, "u_y": y, "u_left": left, "u_bottom": bottom, "u_right": left + width, "u_top": bottom + height,
            "u_across": whole.shape[1] / target.width, "u_up": whole.shape[0] / target.height,
        }  # fmt: skip


class TiledTexelProbe:
    """Reads texels of a recovery in tiles, with the interface of TexelProbe; ``close`` it before the recovery."""

    def __init__(self, recovery: RecoveryEngine):
        self._recovery = recovery
        self._probes: dict[RecoveryEngine, TexelProbe] = {}

    def read(self, row: int, column: int) -> TexelState | None:
        """Return the state of a texel of the domain; None where it is not solved or its tile waits for its turn."""
        live = self._recovery.tiles()
        _update_views(self._probes, live, TexelProbe)
        for (left, bottom, width, height), tile in live:
            if 0 <= column - left < width and 0 <= row - bottom < height:
                x, y = _corner(self._recovery.domain, tile)
                return self._probes[tile].read(row - y, column - x)
        return None

    def close(self) -> None:
        """Free shaders and textures."""
        _update_views(self._probes, [], TexelProbe)


def _corner(whole: Domain, tile: RecoveryEngine) -> tuple[int, int]:
    """Return the texel of the domain at the corner of a tile with its halo."""
    (x, y), (x0, y0) = tile.domain.origin, whole.origin
    return x - x0, y - y0


def _update_views(
    made: dict[RecoveryEngine, View], live: list[tuple[Box, RecoveryEngine]], make: Callable[[RecoveryEngine], View]
) -> None:
    """Update ``made`` in place: create a view for each tile on the device, close the views of other tiles."""
    tiles = [tile for _, tile in live]
    for tile in [tile for tile in made if tile not in tiles]:
        made.pop(tile).close()
    for tile in tiles:
        if tile not in made:
            made[tile] = make(tile)
