"""The converging map flat in the Image editor, as if the domain were an image of its size."""

from __future__ import annotations

from ...maps.textures import TAG as MAP_TAG
from .layout import Rectangle


def is_free(space) -> bool:
    """Return whether an Image editor may be drawn over: it shows no image, or one of the recovered maps."""
    if space.mode not in ("VIEW", "UV"):  # painting and masking are the user's own work
        return False
    return space.image is None or MAP_TAG in space.image


def map_area(region, space, shape: tuple[int, int]) -> Rectangle:
    """Return the rectangle of the region in which a domain of (H, W) texels lies, in pixels.

    Under texture coordinates it is the unit square; else it is as wide as that and of the domain's own proportions.
    """
    left, bottom = region.view2d.view_to_region(0.0, 0.0, clip=False)
    right, top = region.view2d.view_to_region(1.0, 1.0, clip=False)
    height, width = shape
    across = right - left
    return Rectangle(left, bottom, across, top - bottom if space.show_uvedit else across * height / width)


def texture_place(area: Rectangle, x: float, y: float) -> tuple[float, float]:
    """Return the texture coordinates at a pixel of the region."""
    return (x - area.x) / area.width, (y - area.y) / area.height
