"""Search for balls in photographs: circles among the edges, tested by highlights, shading and cast shadows."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from functools import partial
from itertools import count

import numpy as np

from ....capture.camera import Camera
from ....core.errors import InputError
from ....core.steps import map_steps
from ..ball import SMALL
from .circles import candidates
from .found import FoundBall
from .hits import PROMISING, Hit, distinct, improved_steps, tested
from .outline import fitted, measured
from .paths import circles_of_paths
from .pictures import Pictures, enlarged_steps, reduced_steps

MIN_PHOTOGRAPHS = 3  # photographs
_MAX_PHOTOGRAPHS = 24  # photographs that the search reads
_MIN_RADIUS_SHARE, _MAX_RADIUS_SHARE = 0.012, 0.17  # radius over the images' width
_MIN_RADIUS = 5.0  # pixels
_CANDIDATES = 150
_SMALL, _CELLS = 15.0, 2.0  # pixels: for smaller circles, also a fit that may move by so many pixels
_MOVED = 20  # of the latter fits that are tested


def search_steps(
    readers: Sequence[Callable[[], np.ndarray]], camera: Camera, kinds: Sequence[str]
) -> Generator[float, None, list[FoundBall]]:
    """Yield the finished fraction of the work; return the balls of ``kinds``, highest score first.

    readers: each returns (H, W, 4) like ``Observation.read``. kinds: of ``mirror``, ``matte``. A ball is a circle of
    edges that do not move with the lamp; its highlights or shading give a light in most photographs, and its shadow
    agrees with these lights. The search uses reduced photographs; small balls are measured at full size, in a second
    pass over the photographs. Raises InputError for fewer than three photographs.
    """
    if len(readers) < MIN_PHOTOGRAPHS:
        raise InputError(
            f"--ball auto: needs {MIN_PHOTOGRAPHS} photographs under different lights, there are {len(readers)}; give"
            " a mask or X,Y,R"
        )
    if min(camera.width, camera.height) < 2:  # has no edges
        return []
    indices = np.linspace(0, len(readers) - 1, min(len(readers), _MAX_PHOTOGRAPHS)).astype(int)
    chosen = [readers[i] for i in np.unique(indices)]
    whole = yield from map_steps(reduced_steps(chosen, camera), lambda part: 0.3 * part)
    hits = yield from map_steps(_hits_steps(whole, kinds), lambda part: 0.3 + 0.4 * part)
    crops = yield from map_steps(
        enlarged_steps(chosen, whole, camera, [hit.circle for hit in hits]), lambda part: 0.7 + 0.1 * part
    )
    balls: list[Hit] = []
    for number, (hit, pictures) in enumerate(zip(hits, crops, strict=True)):
        progress = partial(_progress, number, len(hits), count(1))
        balls += yield from map_steps(_improved_steps(hit, pictures, whole), progress)
    return [_found_ball(hit) for hit in _separate(balls)]


def _progress(number: int, hits: int, steps: Iterator[int], _: None) -> float:
    """Return the finished fraction in hit ``number`` of ``hits``, whose number of steps is unknown."""
    return 0.8 + 0.2 * (number + 1 - 0.97 ** next(steps)) / hits


def _improved_steps(hit: Hit, crop: Pictures | None, whole: Pictures) -> Generator[None, None, list[Hit]]:
    """Yield often; return the balls near a hit: in a crop, or if it shows none, in the whole photographs."""
    near: list[Hit] = []
    if crop is not None:
        near = yield from improved_steps(crop, hit.circle, hit.kind, whole)
    return near or (yield from improved_steps(whole, hit.circle, hit.kind, whole))


def _hits_steps(pictures: Pictures, kinds: Sequence[str]) -> Generator[float, None, list[Hit]]:
    """Yield the finished fraction; return candidate balls that do not overlap."""
    smallest = max(_MIN_RADIUS_SHARE * pictures.camera.width, _MIN_RADIUS)
    largest = _MAX_RADIUS_SHARE * pictures.camera.width
    circles = candidates(pictures.steady, smallest, largest, _CANDIDATES)
    outlines, moved = [], []
    for number, circle in enumerate(circles):
        yield 0.5 * number / len(circles)
        x, y, radius = circle.tolist()
        outlines.append(fitted(pictures.steady, x, y, radius))
        if radius < _SMALL:
            moved.append(fitted(pictures.steady, x, y, radius, min_shift=_CELLS))
    hits: list[Hit] = []
    selected = distinct(outlines) + distinct(moved, _MOVED)
    for number, outline in enumerate(selected):
        yield 0.5 + 0.5 * number / len(selected)
        hits += tested(pictures, outline, kinds, PROMISING)
    if "mirror" in kinds:
        for circle in circles_of_paths(pictures.values, smallest, largest):
            yield 1.0
            hits += tested(pictures, measured(pictures.steady, *circle.tolist()), ["mirror"], PROMISING)
    return _separate(hits)


def _separate(hits: Sequence[Hit]) -> list[Hit]:
    """Return hits by score, without those that overlap a better one."""
    selected: list[Hit] = []
    for hit in sorted(hits, key=lambda h: -h.score):
        one = hit.circle
        if all(np.hypot(*(one - other.circle)[:2]) > max(one[2], other.circle[2]) for other in selected):
            selected.append(hit)
    return selected


def _found_ball(hit: Hit) -> FoundBall:
    outline = hit.outline
    points = hit.pictures.in_photograph(outline.points)
    exact = outline.radius >= SMALL
    return FoundBall(hit.kind, points, float(hit.circle[2]), outline.support, hit.shadow, exact, hit.inverse, hit.table)
