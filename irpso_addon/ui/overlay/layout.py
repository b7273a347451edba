"""Where things stand in a region: what its side regions leave free, and boxes put beside each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in pixels, x to the right and y up."""

    x: float
    y: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """The right edge's x."""
        return self.x + self.width

    @property
    def top(self) -> float:
        """The upper edge's y."""
        return self.y + self.height

    def inset(self, left: float, bottom: float, right: float, top: float) -> Rectangle:
        """Return what is left between margins."""
        return Rectangle(self.x + left, self.y + bottom, self.width - left - right, self.height - bottom - top)


def free_rectangle(window: Rectangle, sides: Iterable[tuple[str, Rectangle]]) -> Rectangle:
    """Return what regions drawn over a window's sides leave free, in pixels of the window.

    window, sides: in one frame of pixels; a side says at which of LEFT, RIGHT, TOP and BOTTOM it stands, any other
    stands nowhere.
    """
    left, bottom, right, top = window.x, window.y, window.right, window.top
    for side, area in sides:
        if area.x >= window.right or area.right <= window.x or area.y >= window.top or area.top <= window.y:
            continue
        if side == "LEFT":
            left = max(left, area.right)
        elif side == "RIGHT":
            right = min(right, area.x)
        elif side == "TOP":
            top = min(top, area.y)
        elif side == "BOTTOM":
            bottom = max(bottom, area.top)
    return Rectangle(left - window.x, bottom - window.y, max(0.0, right - left), max(0.0, top - bottom))


def stacked(free: Rectangle, sizes: Sequence[tuple[float, float]], gap: float) -> list[Rectangle | None]:
    """Place boxes (width, height) upward from the lower left corner, in further columns where there is no room above.

    A box that does not fit in at all is None.
    """
    places: list[Rectangle | None] = []
    x, y, column = free.x, free.y, 0.0
    for width, height in sizes:
        if y > free.y and y + height > free.top:
            x, y, column = x + column + gap, free.y, 0.0
        if x + width > free.right or y + height > free.top:
            places.append(None)
            continue
        places.append(Rectangle(x, y, width, height))
        y, column = y + height + gap, max(column, width)
    return places
