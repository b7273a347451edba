"""Seamless tiles of a card's maps: maps, relief, report and picture, for command line and window."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry.relief.height import Height
from ..geometry.relief.periodic import periodic_height
from ..results.derived_map import DerivedMap, height_map
from ..results.maps import Maps
from ..results.preview import display_image, gallery
from ..results.report import plain
from ..results.seamless import Seamless, seamless

_REPEATS = 3


@dataclass(frozen=True)
class Tile:
    """A seamless tile. maps: periodic. height: their relief, None if not requested. cut: how the maps were made."""

    maps: Maps
    height: Height | None
    cut: Seamless

    @property
    def derived(self) -> list[DerivedMap]:
        """The maps besides the model's."""
        return [] if self.height is None else [height_map(self.height)]

    def report(self, former: Mapping[str, Any]) -> dict[str, Any]:
        """Return the tile's report, with model, settings, seed and versions from the report of the original maps."""
        x, y, side = self.cut.crop
        seams = {
            "square": [x, y, side], "period": list(self.cut.period), "seam": round(self.cut.seam, 4),
            "seam_of_plain_repetition": round(self.cut.plain, 4),
        }  # fmt: skip
        original = {name: former[name] for name in ("model", "settings", "seed", "versions") if name in former}
        rows, columns = self.maps.solved.shape
        more = {} if self.height is None else {"height": self.height.described()}
        shape = {"size": [columns, rows], "texels": rows * columns}
        return plain({**original, **shape, **more, "tile": seams})

    def picture(self) -> np.ndarray:
        """Return (H, W, 3) display values: the maps, three times in each direction, side by side."""
        parameters = self.maps.model.parameters
        shown = [display_image([parameter], [self.maps.values[parameter.name]]) for parameter in parameters]
        names = [parameter.name.replace("_", " ") for parameter in parameters]
        return gallery(f"{_REPEATS} × {_REPEATS}", [np.tile(image, (_REPEATS, _REPEATS, 1)) for image in shown], names)


def tiled(maps: Maps, relief: bool, size: int | None = None, overlap: float | None = None) -> Tile:
    """Return a seamless tile of a card's maps; see ``seamless``. relief: with heights. Raises InputError."""
    cut = seamless(maps.model, maps.values, maps.solved, size, overlap)
    side = len(next(iter(cut.values.values())))
    repeating = Maps(maps.model, cut.values, np.ones((side, side), bool), wrapped=True)
    normal = next((parameter.name for parameter in maps.model.parameters if parameter.is_normal), None)
    height = periodic_height(cut.values[normal]) if relief and normal else None
    return Tile(repeating, height, cut)
