"""Images for the search: reduced whole photographs, and enlarged crops around small balls."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....capture.camera import Camera
from ....core.filters import block_means
from .edges import Edges

_WIDTH = 640  # pixels of the reduced images
_WHITE = 99.5  # percentile of all values
_DARK = 0.25  # of all values: the darkest, in which noise is measured
_ENLARGED = 32.0  # pixels: least radius in an enlarged crop, if possible
_AROUND = 4.5  # radii: half the side of an enlarged crop


@dataclass(frozen=True, eq=False)
class Pictures:
    """Grey photographs: values over ``white`` (K, h, w), clipped (K, h, w) bool, their edges and camera.

    steady, strong: edges to detect and to measure outlines. noise: standard deviation of dark values. block: a value is
    the mean of block × block pixels. origin: (2,) lower left corner, in pixels of the photographs.
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
        """Convert pixel coordinates (…, 2) to those of the photographs."""
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
    """Yield the finished fraction; return a crop around each circle, with a radius of 32 to 64 pixels if possible.

    circles: (3,) each, centre and radius in the photographs. None: a crop would have no more pixels than ``reduced``.
    """
    windows, blocks, enlarged = [], [], []
    for circle in circles:
        block = max(1, int(circle[2] // _ENLARGED))
        enlarged.append(block < reduced.block)
        if enlarged[-1]:
            centre, reach = circle[:2], _AROUND * circle[2]
            low = np.maximum(np.floor(centre - reach), 0).astype(int)
            high = np.minimum(np.ceil(centre + reach), (camera.width, camera.height)).astype(int)
            windows.append((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
            blocks.append(block)
    cut = (yield from _cut_steps(readers, windows, blocks)) if windows else []
    results = []
    for stacks, block, window in zip(cut, blocks, windows, strict=True):
        yield 1.0
        results.append(_pictures(*stacks, camera, reduced.white, block, window))
    rest = iter(results)
    return [next(rest) if chosen else None for chosen in enlarged]


def _cut_steps(
    readers: Sequence[Callable[[], np.ndarray]], windows: Sequence[tuple[int, int, int, int]], blocks: Sequence[int]
) -> Generator[float, None, list[tuple[np.ndarray, np.ndarray]]]:
    """Yield the finished fraction; return values and clipped (K, h, w) of each window x0, y0, x1, y1, in blocks."""
    values: list[list[np.ndarray]] = [[] for _ in windows]
    clipped: list[list[np.ndarray]] = [[] for _ in windows]
    for number, read in enumerate(readers):
        yield number / len(readers)
        image = read()
        for index, ((x0, y0, x1, y1), block) in enumerate(zip(windows, blocks, strict=True)):
            part = image[y0:y1, x0:x1]
            grey = np.ascontiguousarray(part[..., :3].mean(axis=-1, dtype=np.float32))
            values[index].append(block_means(grey, block))
            clipped[index].append(block_means((part[..., 3] == 0).astype(np.float32), block) > 0)
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
    """Return the noise of dark values (K, h, w), by their deviations from the mean of four neighbours."""
    inner = values[:, 1:-1, 1:-1]
    mean = (values[:, :-2, 1:-1] + values[:, 2:, 1:-1] + values[:, 1:-1, :-2] + values[:, 1:-1, 2:]) / 4
    dark = mean <= np.quantile(mean, _DARK)
    return float(1.4826 * np.median(np.abs(inner - mean)[dark]) / 1.25**0.5)
