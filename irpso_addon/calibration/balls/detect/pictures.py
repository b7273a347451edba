"""Photographs as the search reads them: small and whole, or a ball's surroundings, enlarged."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....capture.camera import Camera
from ....core.filters import block_means
from .edges import Edges

_WIDTH = 640  # pixels of the reduced images
_WHITE = 99.5  # percentile of all values
_DARK = 0.25  # of all values: noise is measured in them
_ENLARGED = 32.0  # pixels: smaller balls are measured in an enlarged part
_AROUND = 4.5  # radii: half the side of an enlarged part


@dataclass(frozen=True, eq=False)
class Pictures:
    """Grey photographs: values over ``white`` (K, h, w), clipped (K, h, w) bool, their edges and camera.

    noise: deviation of dark values. block: a value is the mean of block × block pixels of the photographs. origin: (2,)
    the pixel of a photograph where the first value begins.
    """

    values: np.ndarray
    clipped: np.ndarray
    steady: Edges
    strong: Edges
    camera: Camera
    white: float
    noise: float
    block: int
    origin: np.ndarray

    def in_photograph(self, places: np.ndarray) -> np.ndarray:
        """Return places (…, 2) in pixel coordinates of the photographs."""
        return places * self.block + self.origin


def reduced_steps(readers: Sequence[Callable[[], np.ndarray]], camera: Camera) -> Generator[float, None, Pictures]:
    """Yield the finished fraction; return the photographs, about 640 pixels wide."""
    block = max(1, round(camera.width / _WIDTH))
    whole = (0, 0, camera.width, camera.height)
    ((values, clipped),) = yield from _cut_steps(readers, [whole], [block])
    white = max(float(np.percentile(values[:, ::4, ::4], _WHITE)), 1e-9)
    return _pictures(values, clipped, camera, white, block, whole)


def enlarged_steps(
    readers: Sequence[Callable[[], np.ndarray]], reduced: Pictures, camera: Camera, circles: Sequence[np.ndarray]
) -> Generator[float, None, list[Pictures | None]]:
    """Yield the finished fraction; return what is around each circle, with a radius of 32 to 64 pixels if possible.

    circles: (3,) each, centre and radius in the photographs. None: the circle is not small in the reduced pictures, or
    the photographs show it no larger.
    """
    windows, blocks, small = [], [], []
    for circle in circles:
        block = max(1, int(circle[2] // _ENLARGED))
        small.append(block < reduced.block)
        if small[-1]:
            middle, reach = circle[:2], _AROUND * circle[2]
            low = np.maximum(np.floor(middle - reach), 0).astype(int)
            high = np.minimum(np.ceil(middle + reach), (camera.width, camera.height)).astype(int)
            windows.append((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
            blocks.append(block)
    cut = (yield from _cut_steps(readers, windows, blocks)) if windows else []
    made = []
    for stacks, block, window in zip(cut, blocks, windows, strict=True):
        yield 1.0
        made.append(_pictures(*stacks, camera, reduced.white, block, window))
    rest = iter(made)
    return [next(rest) if chosen else None for chosen in small]


def _cut_steps(
    readers: Sequence[Callable[[], np.ndarray]], windows: Sequence[tuple[int, int, int, int]], blocks: Sequence[int]
) -> Generator[float, None, list[tuple[np.ndarray, np.ndarray]]]:
    """Return values and clipped (K, h, w) of each window x0, y0, x1, y1, averaged over blocks."""
    values: list[list[np.ndarray]] = [[] for _ in windows]
    clipped: list[list[np.ndarray]] = [[] for _ in windows]
    for number, read in enumerate(readers):
        yield number / len(readers)
        image = read()
        for at, ((x0, y0, x1, y1), block) in enumerate(zip(windows, blocks, strict=True)):
            part = image[y0:y1, x0:x1]
            grey = np.ascontiguousarray(part[..., :3].mean(axis=-1, dtype=np.float32))
            values[at].append(block_means(grey, block))
            clipped[at].append(block_means((part[..., 3] == 0).astype(np.float32), block) > 0)
    return [(np.stack(v), np.stack(c)) for v, c in zip(values, clipped, strict=True)]


def _pictures(
    values: np.ndarray, clipped: np.ndarray, camera: Camera, white: float, block: int, window: tuple[int, int, int, int]
) -> Pictures:
    values = values / white
    height, width = values.shape[1:]
    steady, strong = Edges((height, width), -1.0, 1.0), Edges((height, width), 1.0, 0.6)
    for picture in values:
        steady.add(picture, 1.0)
        strong.add(picture, 1.0)
    origin = np.array(window[:2], float)
    (sx, sy), centre = camera.scale, (np.asarray(camera.centre) - origin) / block
    part = replace(
        camera, width=width, height=height, scale=(sx / block, sy / block),
        centre=(float(centre[0]), float(centre[1])), matrix=np.eye(4),
    )  # fmt: skip
    return Pictures(values, clipped, steady, strong, part, white, _noise(values), block, origin)


def _noise(values: np.ndarray) -> float:
    """Return the deviation of dark values (K, h, w) from the mean of their four neighbours."""
    inner = values[:, 1:-1, 1:-1]
    mean = (values[:, :-2, 1:-1] + values[:, 2:, 1:-1] + values[:, 1:-1, :-2] + values[:, 1:-1, 2:]) / 4
    dark = mean <= np.quantile(mean, _DARK)
    return float(1.4826 * np.median(np.abs(inner - mean)[dark]) / 1.25**0.5)
