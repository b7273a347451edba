"""Lights of a capture from mirror or matte balls: directions, positions and intensities with their errors."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ...capture.types import Light, triple
from ...core.errors import InputError
from . import matte, mirror
from .ball import Ball
from .crops import BallView, Surroundings, reading_steps
from .matte import Fit, fit_lights
from .mirror import Sight, find_highlights
from .near import SIGNIFICANT, Intersection, converge, meet
from .shading import shading_of
from .table import Table, radiance_from_table

KINDS = ("mirror", "matte")
DISTANCES = ("auto", "distant", "near")
_UNCERTAIN, _USELESS = 2.0, 10.0  # degrees: worth a warning; worse than no light
_MATTE_ERROR = 0.01  # radians: no ball is perfectly matte; measured in Cycles, 0.66° in the mean on a grey table
_MIN_LIT = 0.15  # fraction of a matte ball; below, the light is behind it
_MISFIT, _LEFT_OUT = 0.1, 0.4
_FAINT = 0.05  # of the photographs' median light; a wall under a lamp that is hidden from the ball gives less
_APART, _APART_DEGREES = 3.0, 2.0  # two balls disagree beyond both: standard errors, degrees


@dataclass(frozen=True)
class FoundLight:
    """One photograph's light.

    light: in world axes, or None. error: standard error of its direction, degrees. distance_error: relative standard
    error of a near light's distance, or None. sights: the light as each ball shows it, in camera axes, or None.
    """

    light: Light | None
    error: float
    distance_error: float | None
    sights: tuple[Sight | None, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Calibration:
    """Lights from balls. kind: one of KINDS. near: lights have positions. how: in words, why they are near or distant.

    bounce: (3,) normal of the table below matte balls times its albedo, in camera axes; or (1,) the balls' albedo,
    where the photographs show the table's light (see ``table.gathered``).
    """

    kind: str
    near: bool
    how: str
    lights: tuple[FoundLight, ...]
    views: tuple[BallView, ...]
    bounce: np.ndarray


@dataclass(frozen=True)
class Request:
    """Options. kind: one of KINDS. lights: one of DISTANCES. distance: from the balls' centre to all lights, or None.

    albedo: (3,) of matte balls, or None: intensities are relative to the first light's. inverse: 1 / distance of lamps
    that are output as distant; their directions start at the balls' centre. tables: one below each ball, or () if they
    are unknown.
    """

    kind: str
    lights: str = "auto"
    distance: float | None = None
    albedo: tuple[float, float, float] | None = None
    inverse: float = 0.0
    tables: tuple[Table, ...] = ()


def calibration_steps(
    readers: Sequence[Callable[[], np.ndarray]], balls: Sequence[Ball], request: Request
) -> Generator[int, None, Calibration]:
    """Yield the number of each photograph before reading it; return the Calibration.

    readers: return (H, W, 4) like ``Observation.read``, all from the balls' camera. Raises InputError where the balls
    do not determine the requested lights.
    """
    if request.lights == "near" and len(balls) < 2 and request.distance is None:
        raise InputError("near lights: one ball gives a direction only; add a second --ball, or --lamp-distance")
    if request.distance is not None and request.lights == "distant":
        raise InputError("--lamp-distance: distant lights have none; omit it, or --lights distant")
    method = mirror if request.kind == "mirror" else matte
    views, surroundings = yield from reading_steps(readers, balls, method.MAX_RADIUS)
    centre = np.mean([ball.centre for ball in balls], axis=0)
    return _by_mirror(views, centre, request) if method is mirror else _by_shading(views, surroundings, centre, request)


def _by_mirror(views: list[BallView], centre: np.ndarray, request: Request) -> Calibration:
    ups: list[np.ndarray | None] = [table.up for table in request.tables]
    highlights = list(zip(*map(find_highlights, views, ups or [None] * len(views)), strict=True))
    sights = [tuple(s if isinstance(s, Sight) else None for s in row) for row in highlights]
    intersections = [_intersected(row, centre, True) for row in sights if sum(s is not None for s in row) > 1]
    near, how = _decision(intersections, request, len(views))
    median = _median_inverse(intersections)
    lights = []
    for row, shown in zip(sights, highlights, strict=True):
        warnings = [s if isinstance(s, str) else w for s in shown for w in ([s] if isinstance(s, str) else s.warnings)]
        if not any(row):
            lights.append(FoundLight(None, np.inf, None, row, tuple(warnings)))
            continue
        intersection = _located(row, centre, near, request, median)
        warnings += _contradiction(row, intersection)
        lights.append(_placed(intersection, row, views[0].ball, centre, request, near, median, (1.0,) * 3, warnings))
    return Calibration("mirror", near, how, tuple(lights), tuple(views), np.zeros(3))


def _by_shading(
    views: list[BallView], surroundings: list[Surroundings], centre: np.ndarray, request: Request
) -> Calibration:
    free = len(views) > 1 and request.lights != "distant" and request.distance is None
    inverse = 1 / request.distance if request.distance else request.inverse
    shadings = [shading_of(views, photograph) for photograph in range(len(views[0].values))]
    fits, bounce = fit_lights(shadings, centre, free, inverse)
    for tables in _tables(request.tables, bounce):
        light = [radiance_from_table(*one) for one in zip(views, surroundings, tables, strict=True)]
        shaded = [shading_of(views, photograph, light) for photograph in range(len(shadings))]
        other, albedo = fit_lights(shaded, centre, free, inverse)
        if _misfit(other) < _misfit(fits):
            fits, bounce, shadings = other, albedo, shaded
    intersections = [_of_fit(fit, views) for fit in fits if isinstance(fit, Fit)] if free else []
    near, how = _decision(intersections, request, len(views))
    if free and not near:
        fits, bounce = fit_lights(shadings, centre, False, request.inverse)
    median = _median_inverse(intersections)
    first = next((fit.radiance for fit in fits if isinstance(fit, Fit)), np.ones(3))
    typical = float(np.median([fit.radiance.mean() for fit in fits if isinstance(fit, Fit)] or [0.0]))
    lights = []
    for fit in fits:
        if isinstance(fit, str):
            lights.append(FoundLight(None, np.inf, None, (None,) * len(views), (fit,)))
            continue
        intersection = _of_fit(fit, views)
        sights = tuple(_brightest(view.ball, fit, intersection) for view in views)
        white = np.asarray(request.albedo) if request.albedo else first
        intensity = triple(np.maximum(fit.radiance / np.maximum(white, 1e-12), 0))
        warnings = _fit_warnings(fit, typical)
        lights.append(_placed(intersection, sights, views[0].ball, centre, request, near, median, intensity, warnings))
    return Calibration("matte", near, how, _scaled(lights, request), tuple(views), bounce)


def _tables(found: tuple[Table, ...], bounce: np.ndarray) -> list[tuple[Table, ...]]:
    """Return candidate tables: those of the shadows, which may err by 25°, and those with the bounce's normal."""
    if not found or not bounce.any():
        return [found] if found else []
    up = bounce / np.linalg.norm(bounce)
    return [found, tuple(Table(up, table.height) for table in found)]


def _misfit(fits: Sequence[Fit | str]) -> float:
    """Return the median misfit of the lights; infinity if there are none."""
    misfits = [fit.misfit for fit in fits if isinstance(fit, Fit)]
    return float(np.median(misfits)) if misfits else np.inf


def _median_inverse(intersections: Sequence[Intersection]) -> float | None:
    """Return the median 1 / distance of the lights whose distance is significant, or None."""
    inverses = sorted(i.inverse for i in intersections if i.significance > SIGNIFICANT)
    return inverses[len(inverses) // 2] if inverses else None


def _scaled(lights: list[FoundLight], request: Request) -> tuple[FoundLight, ...]:
    """Return lights; without an albedo, with intensities over that of the first light (near lights: at distance 1)."""
    lit = [f.light for f in lights if f.light is not None]
    if request.albedo or not lit or not np.min(lit[0].intensity) > 0:
        return tuple(lights)
    first = np.asarray(lit[0].intensity)

    def relative(light: Light) -> Light:
        return Light(light.vector, triple(np.asarray(light.intensity) / first), light.distant)

    return tuple(
        f if f.light is None else FoundLight(relative(f.light), f.error, f.distance_error, f.sights, f.warnings)
        for f in lights
    )


def _fit_warnings(fit: Fit, typical: float) -> list[str]:
    """typical: median radiance of the photographs' lights."""
    warnings = []
    if fit.radiance.mean() < _FAINT * typical:
        faint = fit.radiance.mean() / typical
        warnings.append(f"the ball is lit {faint:.0%} as strongly as in other photographs: the lamp may be hidden")
    if fit.lit < _MIN_LIT:
        warnings.append(f"the light is behind the ball: it reaches {fit.lit:.0%} of the visible side")
    if fit.misfit > _MISFIT:
        warnings.append(f"the shading is {fit.misfit:.0%} off a matte ball's")
    if fit.left_out > _LEFT_OUT:
        warnings.append(f"{fit.left_out:.0%} of the ball is in cast shadow or in a highlight")
    return warnings


def _located(
    row: Sequence[Sight | None], centre: np.ndarray, near: bool, request: Request, median: float | None
) -> Intersection:
    """Return a light's intersection. median: 1 / distance for a light whose own distance is uncertain.

    A sight's direction starts on its ball. From the balls' centre, a light 6 radii away lies up to 6° off it.
    """
    if not near:
        return _intersected(row, centre, False, request.inverse)
    if request.distance is not None:
        return _intersected(row, centre, False, 1 / request.distance)
    if sum(sight is not None for sight in row) > 1:
        intersection = _intersected(row, centre, True)
        if median is None or intersection.significance > SIGNIFICANT:
            return intersection
    return _intersected(row, centre, False, median or 0.0)


def _intersected(row: Sequence[Sight | None], centre: np.ndarray, near: bool, inverse: float = 0.0) -> Intersection:
    sights = [sight for sight in row if sight is not None]
    return meet(
        np.array([s.point for s in sights]), np.array([s.direction for s in sights]), [s.error for s in sights],
        centre, near, inverse,
    )  # fmt: skip


def _of_fit(fit: Fit, views: Sequence[BallView]) -> Intersection:
    """Return a fit as an Intersection whose errors include those of the outlines, which rotate the balls' normals."""
    outline = np.mean([2 * (v.ball.error_px[0] ** 2) / v.ball.radius_px**2 for v in views]) ** 0.5
    centres = np.array([view.ball.centre for view in views])
    far = np.linalg.norm(centres[:, None] - centres[None], axis=-1).max()  # 0 for one ball
    return Intersection(
        fit.direction, float(np.sqrt(fit.error**2 + outline**2 + _MATTE_ERROR**2)), fit.inverse,
        float(np.hypot(fit.inverse_error, outline / far if far > 0 else 0.0)), fit.misfit,
    )  # fmt: skip


def _brightest(ball: Ball, fit: Fit, intersection: Intersection) -> Sight:
    """Return the Sight at the point of a matte ball whose normal points to the light."""
    point = ball.centre + ball.radius * fit.direction
    return Sight(np.full(2, np.nan), point, fit.direction, intersection.error)


def _decision(intersections: Sequence[Intersection], request: Request, balls: int) -> tuple[bool, str]:
    """Return whether lights are near, and why."""
    if request.lights == "distant":
        return False, "distant, by --lights"
    if request.distance is not None:
        return True, f"near, {request.distance:g} from the balls, by --lamp-distance"
    if balls < 2:
        return False, "distant: one ball gives directions only; a second ball or --lamp-distance gives positions"
    if request.lights == "near":
        return True, "near, by --lights"
    if not intersections:
        return False, "distant: no light is seen by two balls"
    median = np.median([i.significance for i in intersections])
    if converge(intersections):
        return True, f"near: the balls' rays converge ({median:.0f} standard errors in the median)"
    return False, f"distant: the balls' rays do not converge ({median:.1f} standard errors in the median)"


def _contradiction(row: Sequence[Sight | None], intersection: Intersection) -> list[str]:
    expected = np.sqrt(np.mean([s.error**2 for s in row if s is not None]))
    if intersection.misfit > max(_APART * expected, np.radians(_APART_DEGREES)):
        off = f"{np.degrees(intersection.misfit):.1f}°"
        if sum(s is not None for s in row) > 1:
            return [f"the balls disagree by {off}: one may be in shadow"]
        return [f"the lamp at --lamp-distance is {off} off the ball's ray: check --lamp-distance and --radius"]
    return []


def _placed(
    intersection: Intersection,
    sights: tuple[Sight | None, ...],
    ball: Ball,
    centre: np.ndarray,
    request: Request,
    near: bool,
    median: float | None,
    radiance: tuple[float, float, float],
    warnings: list[str],
) -> FoundLight:
    """Return a light in world axes. median: 1 / distance for a light whose own distance is uncertain."""
    matrix = np.asarray(ball.camera.matrix, np.float64)
    degrees = float(np.degrees(intersection.error))
    if degrees > _UNCERTAIN:
        warnings = [*warnings, f"its direction is uncertain by {degrees:.1f}°"]
    if degrees > _USELESS:
        return FoundLight(None, degrees, None, sights, tuple(warnings))
    inverse, relative = intersection.inverse, intersection.inverse_error / max(abs(intersection.inverse), 1e-300)
    if request.distance is not None:
        inverse, relative = 1 / request.distance, 0.0
    elif near and intersection.significance < SIGNIFICANT:
        if median is None:
            raise InputError(
                "near lights: the balls' rays do not converge; put the balls farther apart, or use --lights distant"
            )
        warnings = [*warnings, "its distance is uncertain: the median of the others is used"]
        inverse, relative = median, 1.0
    if not near:
        vector = matrix[:3, :3] @ intersection.direction
        light = Light(triple(vector), radiance)
        return FoundLight(light, degrees, None, sights, tuple(warnings))
    position = matrix[:3, :3] @ (centre + intersection.direction / inverse) + matrix[:3, 3]
    at_one = triple(v / inverse**2 for v in radiance)
    return FoundLight(Light(triple(position), at_one, False), degrees, relative, sights, tuple(warnings))
