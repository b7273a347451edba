"""Layout in a region: the free space between its side regions, and boxes placed in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Rectangle:
    """A rectangle in pixels: x to the right, y up."""

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

    def corner(self, width: float, height: float) -> Rectangle:
        """Return a rectangle of this size in the lower right corner."""
        return Rectangle(self.right - width, self.y, width, height)

    def overlaps(self, other: Rectangle) -> bool:
        """Return whether the rectangles overlap."""
        return self.x < other.right and other.x < self.right and self.y < other.top and other.y < self.top

    def holds(self, other: Rectangle) -> bool:
        """Return whether the other rectangle lies inside."""
        return self.x <= other.x and other.right <= self.right and self.y <= other.y and other.top <= self.top

    def inset(self, left: float, bottom: float, right: float, top: float) -> Rectangle:
        """Return the rectangle inside the margins."""
        return Rectangle(self.x + left, self.y + bottom, self.width - left - right, self.height - bottom - top)


def free_rectangle(window: Rectangle, sides: Iterable[tuple[str, Rectangle]]) -> Rectangle:
    """Return the part of a window that the regions at its sides do not cover, in the window's pixels.

    window, sides: in the same coordinates. A side's name is LEFT, RIGHT, TOP or BOTTOM; other names are ignored.
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
    """Place boxes (width, height) upward from the lower left corner; if a column is full, start the next one.

    A box that does not fit is None.
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


def stacked_around(
    corner: Rectangle | None, free: Rectangle, sizes: Sequence[tuple[float, float]], gap: float
) -> list[Rectangle | None]:
    """Place boxes like ``stacked``, left of a box in the lower right corner, or above it if more of them fit there."""
    if corner is None:
        return stacked(free, sizes, gap)
    left = Rectangle(free.x, free.y, corner.x - gap - free.x, free.height)
    above = Rectangle(free.x, corner.top + gap, free.width, free.top - corner.top - gap)
    choices = [stacked(area, sizes, gap) for area in (left, above)]
    return max(choices, key=lambda places: sum(place is not None for place in places))


def beside(
    point: Sequence[float], size: tuple[float, float], gap: float, free: Rectangle, taken: Iterable[Rectangle]
) -> Rectangle | None:
    """Return the first box right, left, above or below a point that lies in ``free`` and overlaps none of ``taken``."""
    (x, y), (width, height), taken = point, size, list(taken)
    low, left = y - height / 2, x - width / 2
    for corner in ((x + gap, low), (x - gap - width, low), (left, y + gap), (left, y - gap - height)):
        box = Rectangle(*corner, width, height)
        if free.holds(box) and not any(box.overlaps(other) for other in taken):
            return box
    return None
