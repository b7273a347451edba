"""Search for balls in photographs: circles among the edges, tested by highlights, shading and cast shadows."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....capture.camera import Camera
from ....core.errors import InputError
from ...filters import block_means
from ..ball import SMALL, Ball, fit_ball, outline_of_circle
from ..mirror import reflected
from . import evidence
from .circles import candidates
from .edges import Edges
from .outline import Outline, fitted
from .shadow import Table, agreement

FEWEST = 3  # photographs
_MOST = 24  # photographs that the search reads
_WIDTH = 640  # pixels of the reduced images
_SMALLEST, _LARGEST = 0.012, 0.17  # radius over the images' width
_LEAST_RADIUS = 5.0  # pixels
_CANDIDATES = 150
_LEAST_SUPPORT = 0.3
_TESTED = 60
_LEAST_SHARE = 0.6  # of the photographs: each shows a light
_LEAST_MOVED = 0.12
_LEAST_FIT = 0.93
_LEAST_SHADOW = 0.75
_DOUBT = 0.15  # more agreement with the shadow, where photographs show no light
_PROMISING = 0.3  # agreement with the shadow that a better outline may raise
_SURE_SUPPORT, _SURE_SHARE, _SURE_MOVED, _SURE_FIT = 0.9, 0.8, 0.3, 0.98  # without a shadow
_WHITE = 99.5  # percentile of all values
_STARTS = (0.85, 0.93, 1.0, 1.08, 1.2, 1.41)  # of the radius: a mirrored horizon is a circle inside the outline
_SHADOW_STEPS = (0.03, 0.015, 0.01)  # of the radius
_CENTRE_ERROR, _RADIUS_ERROR = 0.004, 0.008  # of the radius: what shadows give, measured on tables rendered by Cycles
_SIZES = 1.15  # ratio of the radii of balls of one size


@dataclass(frozen=True, eq=False)
class FoundBall:
    """A ball in the photographs. points: (N, 2) pixel coordinates on its outline, row 0 at the bottom.

    support: fraction of its outline where an edge shows. shadow: correlation of the darkness around the ball with the
    shadow that it would throw, or None where nothing around it is lit. exact: the images in which it was found, 640
    pixels wide or so, show it with a radius of 15 pixels or more; a smaller one's lights may be off by 20°.
    """

    kind: str
    points: np.ndarray
    radius: float
    support: float
    shadow: float | None
    exact: bool = True

    @property
    def centre(self) -> np.ndarray:
        """(2,) pixel coordinates."""
        return (self.points.max(axis=0) + self.points.min(axis=0)) / 2


@dataclass(frozen=True)
class _Pictures:
    """Reduced photographs: values over white (K, h, w), clipped (K, h, w) bool, their edges and camera."""

    values: np.ndarray
    clipped: np.ndarray
    steady: Edges
    strong: Edges
    camera: Camera


@dataclass(frozen=True)
class _Hit:
    outline: Outline
    kind: str
    ball: Ball
    seen: evidence.Evidence
    shadow: float | None
    table: Table | None = None

    @property
    def score(self) -> float:
        return self.outline.support + 2 * (0.5 if self.shadow is None else self.shadow)


def search_steps(
    readers: Sequence[Callable[[], np.ndarray]], camera: Camera, kinds: Sequence[str]
) -> Generator[float, None, list[FoundBall]]:
    """Yield the finished fraction of the work; return the balls, the surest first, of the kinds ``mirror``, ``matte``.

    readers: return (H, W, 4) like ``Observation.read``. A ball is a circle of edges that stay while the lamp moves,
    whose highlights or shading give a light in most photographs, and whose shadow lies where these lights throw it.
    Raises InputError for fewer than three photographs.
    """
    if len(readers) < FEWEST:
        raise InputError(
            f"--ball auto: needs {FEWEST} photographs under different lights, there are {len(readers)}; give a mask or"
            " X,Y,R"
        )
    chosen = [readers[i] for i in np.unique(np.linspace(0, len(readers) - 1, min(len(readers), _MOST)).astype(int))]
    block = max(1, round(camera.width / _WIDTH))
    pictures = yield from _reduced_steps(chosen, camera, block)
    width = pictures.camera.width
    smallest = max(_SMALLEST * width, _LEAST_RADIUS)
    circles = candidates(pictures.steady, smallest, _LARGEST * width, _CANDIDATES)
    outlines = []
    for number, circle in enumerate(circles):
        yield 0.4 + 0.2 * number / len(circles)
        x, y, radius = circle.tolist()
        outlines.append(fitted(pictures.steady, x, y, radius))
    hits: list[_Hit] = []
    tested = _distinct(outlines)
    for number, outline in enumerate(tested):
        yield 0.6 + 0.2 * number / len(tested)
        hits += _tested(pictures, outline, kinds, _PROMISING)
    better: list[_Hit] = []
    separate = _separate(hits)
    for number, hit in enumerate(separate):
        yield 0.8 + 0.2 * number / len(separate)
        better += _improved(pictures, hit)
    return [_found(_measured_by_shadow(pictures, hit), block) for hit in _separate(better)]


def _reduced_steps(
    readers: Sequence[Callable[[], np.ndarray]], camera: Camera, block: int
) -> Generator[float, None, _Pictures]:
    values, clipped = [], []
    for number, read in enumerate(readers):
        yield 0.4 * number / len(readers)
        image = read()
        values.append(block_means(np.ascontiguousarray(image[..., :3].mean(axis=-1, dtype=np.float32)), block))
        clipped.append(block_means((image[..., 3] == 0).astype(np.float32), block) > 0)
    stack = np.stack(values)
    stack /= max(float(np.percentile(stack[:, ::4, ::4], _WHITE)), 1e-9)
    steady, strong = Edges(stack.shape[1:], -1.0, 1.0), Edges(stack.shape[1:], 1.0, 0.6)
    for picture in stack:
        steady.add(picture, 1.0)
        strong.add(picture, 1.0)
    return _Pictures(stack, np.stack(clipped), steady, strong, _reduced(camera, block))


def _reduced(camera: Camera, block: int) -> Camera:
    """Return the camera of images averaged over block × block pixels."""
    (sx, sy), (cx, cy) = camera.scale, camera.centre
    return replace(
        camera, width=camera.width // block, height=camera.height // block, scale=(sx / block, sy / block),
        centre=(cx / block, cy / block), matrix=np.eye(4),
    )  # fmt: skip


def _distinct(outlines: Sequence[Outline]) -> list[Outline]:
    """Return the best supported outlines, each circle once."""
    kept: list[Outline] = []
    for outline in sorted(outlines, key=lambda o: -o.support):
        if outline.support < _LEAST_SUPPORT or len(kept) == _TESTED:
            break
        if not any(_same(outline, other) for other in kept):
            kept.append(outline)
    return kept


def _same(one: Outline, other: Outline) -> bool:
    near = max(0.02 * other.radius, 0.3)
    return bool(np.hypot(one.x - other.x, one.y - other.y) < near and abs(one.radius - other.radius) < near)


def _tested(pictures: _Pictures, outline: Outline, kinds: Sequence[str], least: float) -> list[_Hit]:
    """Return a hit for each kind of ball that an outline may be of."""
    try:
        ball = fit_ball(outline_of_circle(outline.x, outline.y, outline.radius), pictures.camera)
    except InputError:
        return []
    hits = []
    for kind in kinds:
        of_kind = evidence.of_mirror if kind == "mirror" else evidence.of_matte
        seen = of_kind(pictures.values, pictures.clipped, ball)
        if seen.share < _LEAST_SHARE or seen.moved < _LEAST_MOVED or seen.fit < _LEAST_FIT:
            continue
        wanted = least if seen.share >= _SURE_SHARE else least + _DOUBT
        shadow_agrees = agreement(pictures.values, ball, seen.lights)
        if shadow_agrees is None:
            sure = seen.share >= _SURE_SHARE and seen.moved >= _SURE_MOVED and seen.fit >= _SURE_FIT
            if sure and outline.support >= _SURE_SUPPORT:
                hits.append(_Hit(outline, kind, ball, seen, None))
        elif shadow_agrees[0] >= wanted:
            hits.append(_Hit(outline, kind, ball, seen, *shadow_agrees))
    return hits


def _improved(pictures: _Pictures, hit: _Hit) -> list[_Hit]:
    """Return the hits at other circles that edges near a hit outline, where their shadow agrees."""
    old = hit.outline
    starts = [(old.x, old.y, factor * old.radius) for factor in _STARTS]
    outlines = _distinct([old, *(fitted(pictures.strong, *start) for start in starts)])
    return [better for outline in outlines for better in _tested(pictures, outline, [hit.kind], _LEAST_SHADOW)]


def _separate(hits: Sequence[_Hit]) -> list[_Hit]:
    """Return the best of hits that overlap."""
    kept: list[_Hit] = []
    for hit in sorted(hits, key=lambda h: -h.score):
        one = hit.outline
        if all(
            np.hypot(one.x - other.outline.x, one.y - other.outline.y) > max(one.radius, other.outline.radius)
            for other in kept
        ):
            kept.append(hit)
    return kept


def _measured_by_shadow(pictures: _Pictures, hit: _Hit) -> _Hit:
    """Return a mirror ball's hit with the circle at which its shadow agrees best.

    A mirror shows at its rim what lies behind it, so that the visible edge lies up to 3 % inside the outline. The
    shadow is as wide as the ball. One coordinate after the other moves to the top of a parabola.
    """
    if hit.kind != "mirror" or hit.table is None:
        return hit
    circle = np.array([hit.outline.x, hit.outline.y, hit.outline.radius])
    table = hit.table
    for step in _SHADOW_STEPS:
        for axis in (2, 0, 1, 2):
            moves = step * hit.outline.radius * np.arange(-1, 2)
            heights = []
            for move in moves:
                x, y, radius = circle + move * np.eye(3)[axis]
                ball = fit_ball(outline_of_circle(x, y, radius), pictures.camera, measured=False)
                lights = reflected(ball, hit.seen.pixels)[1]
                agrees = agreement(pictures.values, ball, lights, table, hit.ball)
                heights.append((-1.0, table) if agrees is None else agrees)
            low, middle, high = (height for height, _ in heights)
            bend = 2 * middle - low - high
            circle[axis] += np.clip(0.5 * (high - low) / bend, -1, 1) * moves[2] if bend > 0 else 0.0
            table = max(heights, key=lambda h: h[0])[1]
    x, y, radius = circle.tolist()
    agreed = max(height for height, _ in heights)
    return replace(
        hit, outline=Outline(x, y, radius, hit.outline.support, outline_of_circle(x, y, radius)), shadow=agreed
    )


def _found(hit: _Hit, block: int) -> FoundBall:
    outline = hit.outline
    return FoundBall(
        hit.kind, outline.points * block, outline.radius * block, outline.support, hit.shadow, outline.radius >= SMALL
    )


def of_one_kind(found: Sequence[FoundBall]) -> list[FoundBall]:
    """Return the exact balls that calibration uses: mirror before matte ones, and of these the size of the surest."""
    kind = "mirror" if any(ball.exact and ball.kind == "mirror" for ball in found) else "matte"
    same = [ball for ball in found if ball.exact and ball.kind == kind]
    return [ball for ball in same if 1 / _SIZES < ball.radius / same[0].radius < _SIZES]


def as_ball(found: FoundBall, camera: Camera, name: str, radius: float | None) -> Ball:
    """Return a found ball, placed. radius: in world units, or None."""
    ball = fit_ball(found.points, camera, name, radius)
    if found.kind == "mirror" and found.shadow is not None:
        return replace(ball, error_px=(_CENTRE_ERROR * ball.radius_px, _RADIUS_ERROR * ball.radius_px))
    return ball
