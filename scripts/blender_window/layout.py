"""Rectangles of the screen, in pixels from its upper left corner, like mouse positions."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Box:
    """A rectangle of the screen: upper left corner, width and height, in pixels."""

    x: int
    y: int
    width: int
    height: int

    @property
    def centre(self) -> tuple[int, int]:
        """The pixel in the middle."""
        return self.x + self.width // 2, self.y + self.height // 2

    def at(self, across: float, down: float) -> tuple[int, int]:
        """Return the pixel at fractions of the width and the height, 0…1."""
        return self.x + round(across * (self.width - 1)), self.y + round(down * (self.height - 1))
