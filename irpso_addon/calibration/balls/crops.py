"""Crops of the balls from all photographs, averaged down where they are large."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.errors import InputError
from ...core.filters import block_means
from .ball import Ball

_MARGIN = 3  # pixels around the outline
_REACH, _COARSE = 6.0, 6.0  # radii: margin of a ball's surroundings; values along a radius there


@dataclass(frozen=True)
class BallView:
    """One ball in K photographs. pixels: (H, W, 2) pixel coordinates of the values in the full image.

    values: (K, H, W, 3) float32 linear radiance, row 0 at the bottom. usable: (K, H, W) bool, False where clipped or
    without weight. block: a value is the mean of block × block pixels.
    """

    ball: Ball
    pixels: np.ndarray
    values: np.ndarray
    usable: np.ndarray
    block: int

    @property
    def inside(self) -> np.ndarray:
        """(H, W) bool: pixels that show the ball."""
        return self.ball.surface(self.pixels)[3]


@dataclass(frozen=True)
class Surroundings:
    """The surroundings of a ball in K photographs.

    values: (K, h, w, 3) linear radiance, means of block × block pixels. origin: (2,) lower left corner of the first
    value, in pixel coordinates.
    """

    values: np.ndarray
    origin: np.ndarray
    block: int


def reading_steps(
    readers: Sequence[Callable[[], np.ndarray]], balls: Sequence[Ball], radius: float
) -> Generator[int, None, tuple[list[BallView], list[Surroundings]]]:
    """Yield each image's number before reading it; return a BallView and the Surroundings of each ball.

    readers: each returns (H, W, 4) like ``Observation.read``. radius: largest radius of a view, in values; larger balls
    are averaged down to it. Raises InputError for a ball outside the image.
    """
    windows = [_window(ball) for ball in balls]
    blocks = [max(1, int(np.ceil(ball.radius_px / radius))) for ball in balls]
    wide = [_window(ball, int(_REACH * ball.radius_px)) for ball in balls]
    coarse = [max(1, int(ball.radius_px / _COARSE)) for ball in balls]
    around: list[list[np.ndarray]] = [[] for _ in balls]
    cut: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in balls]
    for number, read in enumerate(readers):
        yield number
        image = read()
        for into, (x0, y0, x1, y1), block in zip(cut, windows, blocks, strict=True):
            into.append(_averaged(image[y0:y1, x0:x1], block))
        for pictures, (x0, y0, x1, y1), block in zip(around, wide, coarse, strict=True):
            pictures.append(block_means(image[y0:y1, x0:x1, :3].astype(np.float32, copy=False), block))
    views = []
    for ball, crops, (x0, y0, _, _), block in zip(balls, cut, windows, blocks, strict=True):
        height, width = crops[0][1].shape
        grid = np.meshgrid(x0 + block * (np.arange(width) + 0.5), y0 + block * (np.arange(height) + 0.5))
        views.append(
            BallView(ball, np.stack(grid, -1), np.stack([v for v, _ in crops]), np.stack([u for _, u in crops]), block)
        )
    surroundings = [
        Surroundings(np.stack(pictures), np.array(window[:2], float), block)
        for pictures, window, block in zip(around, wide, coarse, strict=True)
    ]
    return views, surroundings


def _window(ball: Ball, margin: int = _MARGIN) -> tuple[int, int, int, int]:
    """Return x0, y0, x1, y1 of the ball's crop, with ``margin`` pixels around its outline."""
    size = (ball.camera.width, ball.camera.height)
    outline = ball.outline[np.isfinite(ball.outline).all(axis=-1)]
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - margin, 0)
    high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + margin, size)
    if (high - low < 2 * _MARGIN).any():
        raise InputError(f"{ball.name}: lies outside the image of {size[0]} × {size[1]} pixels; check its numbers")
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _averaged(part: np.ndarray, block: int) -> tuple[np.ndarray, np.ndarray]:
    """Return block means (h, w, 3) of an image (H, W, 4), and bool (h, w): all pixels of the block have weight."""
    usable = block_means((part[..., 3] > 0).astype(np.float32), block) == 1
    return block_means(part[..., :3].astype(np.float32, copy=False), block), usable
