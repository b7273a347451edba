"""Rectangles and pixels of the flat map in the Image editor, which shows the domain like an image of its size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...blender.materials.textures import TAG as MAP_TAG
from ...core.udim import ONE_SQUARE, tile_place
from ..common.words import iface
from .layout import Rectangle


def why_covered(space) -> str:
    """Return a sentence on why an Image editor has no overlay, "" if it shows no image or a recovered map."""
    if space.mode not in ("VIEW", "UV"):  # painting and masking are the user's own work
        return iface("This editor paints or masks: choose View in its header")
    if space.image is not None and MAP_TAG not in space.image:
        return iface("This editor shows '{name}': unlink it, or choose a recovered map", name=space.image.name)
    return ""


def map_areas(region, space, shape: tuple[int, int], tiles: Sequence[int] = ONE_SQUARE) -> list[Rectangle]:
    """Return the rectangles, in pixels of the region, of the tiles of a domain of (H, W) texels.

    A tile is as wide as the unit square. With a UV editor it is also as high, else it has the proportions of its
    texels. UDIM tiles stand beside and above each other, as in Blender.
    """
    left, bottom = region.view2d.view_to_region(0.0, 0.0, clip=False)
    right, top = region.view2d.view_to_region(1.0, 1.0, clip=False)
    height, width = shape[0], shape[1] / len(tiles)
    across = right - left
    up = top - bottom if space.show_uvedit else across * height / width
    places = [tile_place(number) for number in tiles]
    return [Rectangle(left + column * across, bottom + row * up, across, up) for column, row in places]


def bounds(areas: Sequence[Rectangle]) -> Rectangle:
    """Return the bounding rectangle of areas."""
    left, bottom = min(area.x for area in areas), min(area.y for area in areas)
    right, top = max(area.right for area in areas), max(area.top for area in areas)
    return Rectangle(left, bottom, right - left, top - bottom)


def texture_place(areas: Sequence[Rectangle], x: float, y: float) -> np.ndarray | None:
    """Return the texture coordinates (2,) in the domain, 0…1, at a pixel of the region, None outside."""
    for index, area in enumerate(areas):
        if area.x <= x <= area.right and area.y <= y <= area.top:
            return np.array([((x - area.x) / area.width + index) / len(areas), (y - area.y) / area.height])
    return None


def flat_place(areas: Sequence[Rectangle], shape: tuple[int, int], row: int, column: int) -> np.ndarray:
    """Return the pixel (2,) of a texel's centre. areas: the tiles of the whole domain, shape (H, W)."""
    width = shape[1] // len(areas)
    area = areas[column // width]
    return np.array([
        area.x + area.width * (column % width + 0.5) / width, area.y + area.height * (row + 0.5) / shape[0]
    ])  # fmt: skip
