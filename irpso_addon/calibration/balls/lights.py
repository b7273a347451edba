"""From photographs of balls to the lights of a capture."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ...capture.types import Light, triple
from ...core.errors import InputError
from . import matte, mirror
from .ball import Ball
from .crops import BallView, reading_steps
from .matte import Fit, fit_lights
from .mirror import Sight, find_highlights
from .near import SIGNIFICANT, HaloOverlap, converge, meet
from .shading import shading_of

KINDS = ("mirror", "matte")
DISTANCES = ("auto", "distant", "near")
_UNCERTAIN = 2.0  # degrees
_MATTE_ERROR = 0.01  # radians, of what no ball is as matte as: measured in Cycles, 0.66° in the mean on a grey table
_LEAST_LIT = 0.15  # of a matte ball: less is a light behind it
_MISFIT, _LEFT_OUT = 0.1, 0.4
_APART = 3.0  # standard errors, and
_APART_DEGREES = 2.0  # degrees that two balls may contradict each other by


@dataclass(frozen=True)
class FoundLight:
    """One photograph's light. light: in world axes, None where there is none. error: of its direction, degrees.

    distance_error: of a near light, relative. sights: where each ball tells it, in the camera's axes; None for a ball
    that does not. warnings: what is doubtful.
    """

    light: Light | None
    error: float
    distance_error: float | None
    sights: tuple[Sight | None, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class Calibration:
    """What balls tell. kind: of KINDS. near: whether lights have places. how: why so, in words.

    bounce: (3,) normal of the table below the balls times its albedo, in the camera's axes (of matte balls).
    """

    kind: str
    near: bool
    how: str
    lights: tuple[FoundLight, ...]
    views: tuple[BallView, ...]
    bounce: np.ndarray


@dataclass(frozen=True)
class Request:
    """What is asked. kind: of KINDS. lights: of DISTANCES. distance: from the balls' middle to all lights, or None.

    albedo: (3,) or None: of matte balls; without it intensities are relative to the first light's.
    """

    kind: str
    lights: str = "auto"
    distance: float | None = None
    albedo: tuple[float, float, float] | None = None


def calibration_steps(
    readers: Sequence[Callable[[], np.ndarray]], balls: Sequence[Ball], request: Request
) -> Generator[int, None, Calibration]:
    """Yield the number of each photograph before it is read, and return the Calibration.

    readers: return (H, W, 4) as ``Observation.read`` does, all of the balls' camera. Raises InputError where balls
    cannot tell what is asked.
    """
    if request.lights == "near" and len(balls) < 2 and request.distance is None:
        raise InputError("near lights: one ball tells a direction only; give a second --ball, or --distance")
    if request.distance is not None and request.lights == "distant":
        raise InputError("--distance: distant lights have none; leave it out, or --lights distant")
    part = mirror if request.kind == "mirror" else matte
    views = yield from reading_steps(readers, balls, part.LARGEST_RADIUS)
    centre = np.mean([ball.centre for ball in balls], axis=0)
    find = _by_mirror if request.kind == "mirror" else _by_shading
    return find(views, centre, request)


def _by_mirror(views: list[BallView], centre: np.ndarray, request: Request) -> Calibration:
    shown = list(zip(*(find_highlights(view) for view in views), strict=True))
    sights = [tuple(s if isinstance(s, Sight) else None for s in row) for row in shown]
    several = [_meeting(row, centre, True) for row in sights if sum(s is not None for s in row) > 1]
    near, how = _decision(several, request, len(views))
    known = sorted(m.inverse for m in several if m.significance > SIGNIFICANT)
    usual = known[len(known) // 2] if known else None
    found = []
    for row, told in zip(sights, shown, strict=True):
        warnings = [t if isinstance(t, str) else w for t in told for w in ([t] if isinstance(t, str) else t.warnings)]
        if not any(row):
            found.append(FoundLight(None, np.inf, None, row, tuple(warnings)))
            continue
        meeting = _met(row, centre, near, request, usual)
        warnings += _contradiction(row, meeting)
        found.append(_placed(meeting, row, views[0].ball, centre, request, near, usual, (1.0,) * 3, warnings))
    return Calibration("mirror", near, how, tuple(found), tuple(views), np.zeros(3))


def _by_shading(views: list[BallView], centre: np.ndarray, request: Request) -> Calibration:
    shadings = [shading_of(views, photograph) for photograph in range(len(views[0].values))]
    asked = len(views) > 1 and request.lights != "distant" and request.distance is None
    fits, bounce = fit_lights(shadings, centre, asked, 1 / request.distance if request.distance else 0.0)
    meetings = [_of_fit(fit, views) for fit in fits if isinstance(fit, Fit)] if asked else []
    near, how = _decision(meetings, request, len(views))
    if asked and not near:
        fits, bounce = fit_lights(shadings, centre, False)
    known = sorted(m.inverse for m in meetings if m.significance > SIGNIFICANT)
    usual = known[len(known) // 2] if known else None
    first = next((fit.radiance for fit in fits if isinstance(fit, Fit)), np.ones(3))
    found = []
    for fit in fits:
        if isinstance(fit, str):
            found.append(FoundLight(None, np.inf, None, (None,) * len(views), (fit,)))
            continue
        meeting = _of_fit(fit, views)
        sights = tuple(_brightest(view.ball, fit, meeting) for view in views)
        white = np.asarray(request.albedo) if request.albedo else first
        intensity = triple(np.maximum(fit.radiance / np.maximum(white, 1e-12), 0))
        warnings = _doubts(fit)
        found.append(_placed(meeting, sights, views[0].ball, centre, request, near, usual, intensity, warnings))
    return Calibration("matte", near, how, _scaled(found, centre, request), tuple(views), bounce)


def _scaled(found: list[FoundLight], centre: np.ndarray, request: Request) -> tuple[FoundLight, ...]:
    """Return lights whose intensities, where no albedo was given, are relative to the first: of near ones at 1."""
    lit = [f.light for f in found if f.light is not None]
    if request.albedo or not lit or not np.min(lit[0].intensity) > 0:
        return tuple(found)
    first = np.asarray(lit[0].intensity)

    def relative(light: Light) -> Light:
        return Light(light.vector, triple(np.asarray(light.intensity) / first), light.distant)

    return tuple(
        f if f.light is None else FoundLight(relative(f.light), f.error, f.distance_error, f.sights, f.warnings)
        for f in found
    )


def _doubts(fit: Fit) -> list[str]:
    warnings = []
    if fit.lit < _LEAST_LIT:
        warnings.append(f"the light is behind the ball: it reaches {fit.lit:.0%} of what is seen")
    if fit.misfit > _MISFIT:
        warnings.append(f"the shading is {fit.misfit:.0%} off a matte ball's")
    if fit.left_out > _LEFT_OUT:
        warnings.append(f"{fit.left_out:.0%} of the ball is in cast shadow or in a highlight")
    return warnings


def _met(
    row: Sequence[Sight | None], centre: np.ndarray, near: bool, request: Request, usual: float | None
) -> HaloOverlap:
    """Return where a light is. usual: 1 / the distance that is taken for one whose own cannot be told.

    A direction is from where it was seen, on a ball: from the balls' middle a light 6 radii away lies up to 6° off it.
    """
    if not near:
        return _meeting(row, centre, False)
    if request.distance is not None:
        return _meeting(row, centre, False, 1 / request.distance)
    if sum(sight is not None for sight in row) > 1:
        found = _meeting(row, centre, True)
        if usual is None or found.significance > SIGNIFICANT:
            return found
    return _meeting(row, centre, False, usual or 0.0)


def _meeting(row: Sequence[Sight | None], centre: np.ndarray, near: bool, inverse: float = 0.0) -> HaloOverlap:
    sights = [sight for sight in row if sight is not None]
    return meet(
        np.array([s.point for s in sights]), np.array([s.direction for s in sights]), [s.error for s in sights],
        centre, near, inverse,
    )  # fmt: skip


def _of_fit(fit: Fit, views: Sequence[BallView]) -> HaloOverlap:
    """Return a fit as a meeting; that a ball's outline is uncertain turns its normals."""
    outline = np.mean([2 * (v.ball.error_px[0] ** 2) / v.ball.radius_px**2 for v in views]) ** 0.5
    return HaloOverlap(
        fit.direction, float(np.sqrt(fit.error**2 + outline**2 + _MATTE_ERROR**2)), fit.inverse,
        float(np.hypot(fit.inverse_error, outline * _baseline(views))), fit.misfit,
    )  # fmt: skip


def _baseline(views: Sequence[BallView]) -> float:
    """Return 1 / the largest distance between balls, or 0 where there is one."""
    centres = np.array([view.ball.centre for view in views])
    far = np.linalg.norm(centres[:, None] - centres[None], axis=-1).max()
    return float(1 / far) if far > 0 else 0.0


def _brightest(ball: Ball, fit: Fit, meeting: HaloOverlap) -> Sight:
    """Return where a matte ball's normal points to the light."""
    point = ball.centre + ball.radius * fit.direction
    return Sight(np.full(2, np.nan), point, fit.direction, meeting.error)


def _decision(meetings: Sequence[HaloOverlap], request: Request, balls: int) -> tuple[bool, str]:
    """Return whether lights are near, and why."""
    if request.lights == "distant":
        return False, "distant, as asked"
    if request.distance is not None:
        return True, f"near, {request.distance:g} from the balls as given"
    if balls < 2:
        return False, "distant: one ball tells directions only; a second one, or --distance, tells places"
    if request.lights == "near":
        return True, "near, as asked"
    if not meetings:
        return False, "distant: no light is seen by two balls"
    median = np.median([meeting.significance for meeting in meetings])
    if converge(meetings):
        return True, f"near: the balls' rays converge ({median:.0f} standard errors in the median)"
    return False, f"distant: the balls' rays do not converge ({median:.1f} standard errors in the median)"


def _contradiction(row: Sequence[Sight | None], meeting: HaloOverlap) -> list[str]:
    expected = np.sqrt(np.mean([s.error**2 for s in row if s is not None]))
    if meeting.misfit > max(_APART * expected, np.radians(_APART_DEGREES)):
        return [f"the balls contradict each other by {np.degrees(meeting.misfit):.1f}°: one may be in shadow"]
    return []


def _placed(
    meeting: HaloOverlap,
    sights: tuple[Sight | None, ...],
    ball: Ball,
    centre: np.ndarray,
    request: Request,
    near: bool,
    usual: float | None,
    radiance: tuple[float, float, float],
    warnings: list[str],
) -> FoundLight:
    """Return a light in world axes. usual: the 1 / distance for one whose own cannot be told."""
    matrix = np.asarray(ball.camera.matrix, np.float64)
    degrees = float(np.degrees(meeting.error))
    if degrees > _UNCERTAIN:
        warnings = [*warnings, f"its direction is uncertain by {degrees:.1f}°"]
    inverse, relative = meeting.inverse, meeting.inverse_error / max(abs(meeting.inverse), 1e-300)
    if request.distance is not None:
        inverse, relative = 1 / request.distance, 0.0
    elif near and meeting.significance < SIGNIFICANT:
        if usual is None:
            raise InputError(
                "near lights: the balls' rays do not converge; put the balls farther apart, or take --lights distant"
            )
        warnings = [*warnings, "its distance cannot be told: that of the others is taken"]
        inverse, relative = usual, 1.0
    if not near:
        vector = matrix[:3, :3] @ meeting.direction
        light = Light(triple(vector), radiance)
        return FoundLight(light, degrees, None, sights, tuple(warnings))
    place = matrix[:3, :3] @ (centre + meeting.direction / inverse) + matrix[:3, 3]
    at_one = triple(v / inverse**2 for v in radiance)
    return FoundLight(Light(triple(place), at_one, False), degrees, relative, sights, tuple(warnings))
