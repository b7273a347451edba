"""Calibration by balls, from options to lights and report. The command line and the window share it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.camera import Camera
from ..capture.errors import CaptureError
from ..capture.formats.table import CARD_DISTANCE
from ..capture.images.image import ImageRef, ImageStore
from ..capture.images.linearise import Decoder
from ..capture.rectify import rectified_camera
from ..capture.spec import CaptureSpec, ViewSpec, build_capture
from ..core.errors import InputError
from ..core.steps import map_steps
from .balls.ball import MIN_POINTS, Ball, fit_ball, outline_of_circle, outline_of_mask
from .balls.checks import ball_warnings, near_lamps, unknown_lens
from .balls.detect.found import FoundBall, as_ball, known_tables, usable_balls
from .balls.detect.search import search_steps
from .balls.lights import KINDS, Calibration, FoundLight, Request, calibration_steps
from .balls.second_opinion import contradiction
from .photographs import calibrated_table

AUTO = "auto"
_MIN_LIT = 0.5  # least fraction of the photographs with a light
_SEARCH = 0.7  # fraction of the work in the search for balls
_NO_BALL = (
    "no ball was found in the photographs; paint a mask that is white on the ball, or give its place as X,Y,R (--ball);"
    " --ball none finds lights by the subject's own shading"
)
# A stated card_distance is that of the table less the card's thickness: these parts of the table's are plausible.
_THICKEST, _SAME_DISTANCE = 0.7, 0.02


@dataclass(frozen=True)
class BallRequest:
    """Location of a ball. mask: an image, white on the ball. numbers: x, y, radius, or x1, y1, x2, y2, x3, y3, ….

    Pixels count from the upper left corner, as in image programs. Without both, all balls are searched.
    """

    mask: Path | None = None
    numbers: tuple[float, ...] = ()

    @property
    def searched(self) -> bool:
        """Whether the photographs are searched for balls."""
        return self.mask is None and not self.numbers


def ball_of_text(text: str) -> BallRequest:
    """Parse "auto", "mask.png", "X,Y,R" or "X1,Y1,X2,Y2,X3,Y3,…". Raises InputError."""
    if text == AUTO:
        return BallRequest()
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        if not Path(text).is_file():
            raise InputError(
                f"--ball {text}: there is no such file; give auto, a mask, X,Y,RADIUS, or three or more points"
                " X1,Y1,X2,Y2,…"
            ) from None
        return BallRequest(Path(text))
    if not np.isfinite(numbers).all() or not (len(numbers) == 3 or (len(numbers) >= 6 and len(numbers) % 2 == 0)):
        raise InputError(f"--ball {text}: give X,Y,RADIUS, or three or more points X1,Y1,X2,Y2,X3,Y3,…")
    if len(numbers) == 3 and numbers[2] <= 0:
        raise InputError(f"--ball {text}: the radius, the third number, must be above 0")
    return BallRequest(None, numbers)


def find_ball(request: BallRequest, camera: Camera, store: ImageStore, number: int, radius: float | None) -> Ball:
    """Return the requested ball. Raises InputError if the mask has another size or shows no ball."""
    name = f"ball {number}"
    if request.mask is not None:
        size = store.size(ImageRef(request.mask))
        if size != (camera.width, camera.height):
            raise CaptureError(
                f"{request.mask}: the mask is {size[0]}×{size[1]} pixels, the photographs {camera.width}×"
                f"{camera.height}; save it at their size",
                "mask_size",
            )
        mask = store.mask(ImageRef(request.mask))
        if not mask.any() or mask.all():
            raise InputError(f"{request.mask}: shows no ball; paint the ball white and the rest black")
        outline = outline_of_mask(mask)
        if len(outline) < MIN_POINTS:
            raise InputError(
                f"{request.mask}: is white up to its borders, so no ball ends in it; paint the ball white and the rest"
                " black"
            )
        return fit_ball(outline, camera, f"{name} ({request.mask.name})", radius)
    if len(request.numbers) == 3:
        x, y, across = request.numbers
        return fit_ball(outline_of_circle(x, camera.height - y, across), camera, name, radius, measured=False)
    points = np.reshape(request.numbers, (-1, 2)) * (1, -1) + (0, camera.height)
    return fit_ball(points, camera, name, radius, measured=False)


@dataclass(frozen=True)
class Calibrated:
    """Calibrated lights. camera: index. indices: of the photographs in the spec. names: of the photographs.

    request: the options. radius: of the balls, as given. found_balls: all that the search found, used or not.
    """

    spec: CaptureSpec
    camera: int
    indices: tuple[int, ...]
    names: tuple[str, ...]
    result: Calibration
    warnings: tuple[str, ...]
    request: Request
    radius: float | None = None
    found_balls: tuple[FoundBall, ...] = ()

    @property
    def card_distance(self) -> float:
        """Distance along the camera's axis to the table below the balls, in the unit of near lights' positions.

        The table is parallel to the card, which faces the camera or has the capture's ``corners``.
        """
        normal, balls = self._table_normal(), [view.ball for view in self.result.views]
        return float(np.mean([(ball.radius - np.dot(ball.centre, normal)) / normal[2] for ball in balls]))

    def _table_normal(self) -> np.ndarray:
        """Return (3,) in the camera's axes."""
        camera, corners = self.result.views[0].ball.camera, self.spec.framing.corners
        if corners is None or isinstance(corners, str) or not camera.perspective:
            return np.array([0.0, 0.0, 1.0])
        return camera.matrix[:3, :3].T @ rectified_camera(camera, corners, 1.0).backward

    @property
    def shows_distance(self) -> bool:
        """Whether ``card_distance`` is that of every card on the table: lights are near, and there is one camera."""
        return self.result.near and len(self.spec.views) == 1

    @property
    def new_distance(self) -> float | None:
        """The ``card_distance`` of the new capture.toml, in six digits; None if the source states it or a width."""
        return float(f"{self.card_distance:.6g}") if self.shows_distance and not self.spec.states_distance else None


def calibrate_steps(
    spec: CaptureSpec,
    requests: Sequence[BallRequest],
    request: Request,
    decoder: Decoder | None = None,
    radius: float | None = None,
    view: str | None = None,
    dropped: Collection[str] = (),
) -> Generator[float, None, Calibrated]:
    """Yield the finished fraction of the work; return the lights by balls.

    Without requests, or if all are ``searched``, the photographs are searched for balls. radius: of the balls, in world
    units. view: name of the camera, required if the spec has several. dropped: names of photographs to leave out, whose
    highlight is not the lamp's. Raises InputError, also if more than half of the photographs show no light.
    """
    number, original_request = _camera_number(spec, view), request
    capture = build_capture(spec, decoder)
    indices = tuple(n for n, observation in enumerate(spec.observations) if observation.camera == number)
    camera = capture.cameras[number]
    _check_distance(request, spec.views[number], camera, radius)
    readers = [capture.observations[n].read for n in indices]
    found: tuple[FoundBall, ...] = ()
    if all(ball.searched for ball in requests):
        kinds = KINDS if request.kind == AUTO else (request.kind,)
        found = tuple((yield from map_steps(search_steps(readers, camera, kinds), lambda part: _SEARCH * part)))
        balls, request = _found_balls(found, request, camera, radius)
    else:
        balls = _given_balls(requests, request, camera, ImageStore(decoder), radius)
    start = _SEARCH if found else 0.0
    others = [ball for ball in found if ball.exact and ball.kind != request.kind][:1]
    each = (1 - start) / (1 + len(others)) / len(indices)
    result = yield from map_steps(calibration_steps(readers, balls, request), lambda n: start + each * n)
    names = tuple(spec.observations[n].name for n in indices)
    result = replace(result, lights=tuple(map(partial(_without, dropped), names, result.lights)))
    contradictions: list[str] = []
    for other in others:
        steps = _second_opinion_steps(readers, camera, usable_balls(found)[0], result, other)
        contradictions += yield from map_steps(steps, lambda n: 1 - each * (len(indices) - n))
    if result.near and camera.perspective and radius is None:
        _refuse_radii(spec, number)
    _check_lit(names, result)
    warnings = [
        *unknown_lens(spec.views[number], camera, balls), *ball_warnings(found), *contradictions,
        *near_lamps(found, result, camera, radius, original_request.distance),
        *(w for ball in balls for w in ball.warnings),
    ]  # fmt: skip
    for name, light in zip(names, result.lights, strict=True):
        left = "; left out" if light.light is None else ""
        warnings += [f"{name}: {warning}{left}" for warning in light.warnings]
    calibrated = Calibrated(spec, number, indices, names, result, tuple(warnings), original_request, radius, found)
    general = *_distance_warnings(calibrated), *_intensity_warnings(calibrated)
    return replace(calibrated, warnings=(*calibrated.warnings, *general))


def _found_balls(
    found: tuple[FoundBall, ...], request: Request, camera: Camera, radius: float | None
) -> tuple[list[Ball], Request]:
    """Return the usable balls of a search and the request with their kind. Raises InputError if there are none."""
    if not found:
        raise InputError(_NO_BALL)
    used = usable_balls(found)
    if not used:
        raise _too_small(found[0], camera)
    balls = [as_ball(ball, camera, f"ball {n}", radius) for n, ball in enumerate(used, 1)]
    inverse = float(np.mean([one.inverse[0] / ball.radius for one, ball in zip(used, balls, strict=True)]))
    return balls, replace(request, kind=used[0].kind, inverse=inverse, tables=known_tables(used))


def _check_lit(names: Sequence[str], result: Calibration) -> None:
    """Raise InputError if more than half of the photographs ``names`` show no light."""
    lit = sum(light.light is not None for light in result.lights)
    if lit < max(1, _MIN_LIT * len(names)):
        missing = next(i for i, light in enumerate(result.lights) if light.light is None)
        raise InputError(
            f"{names[missing]}: {'; '.join(result.lights[missing].warnings)} ({len(names) - lit} of {len(names)}"
            " photographs show no light; check --ball and --kind)"
        )


def _second_opinion_steps(
    readers: Sequence[Callable[[], np.ndarray]], camera: Camera, used: FoundBall, result: Calibration, other: FoundBall
) -> Generator[int, None, list[str]]:
    """Yield the number of each photograph; return a warning if a ball of the other kind shows other lights."""
    if result.near:
        return []
    ball = as_ball(other, camera, "other", None)
    request = Request(other.kind, inverse=other.inverse[0] / ball.radius, tables=known_tables([other]))
    calibration = yield from calibration_steps(readers, [ball], request)
    warning = contradiction(used, result.lights, other, calibration.lights, camera)
    return [warning] if warning else []


def _without(dropped: Collection[str], name: str, light: FoundLight) -> FoundLight:
    if name not in dropped:
        return light
    return FoundLight(None, np.inf, None, light.sights, ("its highlight is dropped by hand",))


def _given_balls(
    requests: Sequence[BallRequest], request: Request, camera: Camera, store: ImageStore, radius: float | None
) -> list[Ball]:
    """Return the balls at given places. Raises InputError if some are to be searched, or no kind is given."""
    if any(ball.searched for ball in requests):
        raise InputError("--ball auto: finds all balls; omit the other --ball, or give the place of every ball")
    if request.kind == AUTO:
        raise InputError("--kind auto: goes with --ball auto only; give --kind mirror or --kind matte")
    return [find_ball(ball, camera, store, n, radius) for n, ball in enumerate(requests, 1)]


def _too_small(ball: FoundBall, camera: Camera) -> InputError:
    x, y = ball.centre
    return InputError(
        f"the {ball.kind} ball at {x:.0f},{camera.height - y:.0f} has a radius of {ball.radius:.0f} pixels, too small"
        " for the search to measure it; paint a mask that is white on the ball, or give its place as X,Y,R (--ball)"
    )


def _check_distance(request: Request, view: ViewSpec, camera: Camera, radius: float | None) -> None:
    """Raise InputError if a distance has no unit or lies within the ball."""
    if request.distance is None:
        return
    if radius is not None and request.distance <= radius:
        raise InputError(
            f"--lamp-distance {request.distance:g}: puts the lamps into the ball, whose --radius is {radius:g}; give"
            " both in one unit"
        )
    if camera.perspective and radius is None:
        raise InputError("--lamp-distance: needs --radius, which sets its unit (--radius 1: the distance is in radii)")
    if not camera.perspective and not view.lens:
        raise InputError(
            "--lamp-distance: has no unit; give --fov and --radius, or --camera with world_width in that unit"
        )


def _distance_warnings(calibrated: Calibrated) -> list[str]:
    """Return a warning if the source's distance is not that of a card on the table under the balls, or it may tilt."""
    stated, table = calibrated.spec.card_distance, calibrated.card_distance
    if calibrated.new_distance is not None and calibrated.spec.framing.corners == AUTO:
        return [
            f"{CARD_DISTANCE} = {calibrated.new_distance:g} is that of a table that faces the camera; corners are"
            ' searched later: where they show a tilt, give the four corners in place of "auto", or --card-width'
        ]
    if not calibrated.shows_distance or stated is None or _THICKEST <= stated / table <= 1 + _SAME_DISTANCE:
        return []
    return [
        f"{calibrated.spec.source}: {CARD_DISTANCE} = {stated:.6g} stays, but the table under the balls is {table:.6g}"
        " from the camera, in the unit of --radius; correct it, or take it out and calibrate again"
    ]


def _intensity_warnings(calibrated: Calibrated) -> list[str]:
    """Return a warning if intensities are relative, and the capture has other cameras, whose intensities stay."""
    spec = calibrated.spec
    if calibrated.result.kind != "matte" or calibrated.request.albedo or len(spec.views) == 1:
        return []
    return [
        f"intensities are relative to the first light of '{spec.views[calibrated.camera].name}', and those of the other"
        " cameras stay; give --albedo for every camera's ball, so that they compare"
    ]


def _refuse_radii(spec: CaptureSpec, number: int) -> None:
    """Raise InputError if the capture has a unit of length, but light positions would be in ball radii."""
    placed = spec.views[number].placed
    if placed or spec.card_distance is not None:
        raise InputError(
            f"{spec.source}: has {'a camera with a position' if placed else 'card_distance'}; near lights need the same"
            " unit: give --radius in it, or --lights distant"
        )


def _camera_number(spec: CaptureSpec, view: str | None) -> int:
    names = [v.name for v in spec.views]
    if view is not None:
        if view not in names:
            raise InputError(f"--view {view}: there is no such camera; choose one of {', '.join(names)}")
        return names.index(view)
    if len(names) > 1:
        raise InputError(f"{spec.source}: has {len(names)} cameras; name the one that saw the ball with --view")
    return 0


def written_table(calibrated: Calibrated, folder: Path, camera_keys: Mapping[str, Any]) -> str:
    """Return the text of a capture.toml in ``folder`` with the calibrated lights and ``new_distance``."""
    lights = {n: light.light for n, light in zip(calibrated.indices, calibrated.result.lights, strict=True)}
    view, camera = calibrated.spec.views[calibrated.camera], calibrated.result.views[0].ball.camera
    if calibrated.result.near and not (camera_keys or view.lens):  # the unit of the positions is the assumed width
        camera_keys = {"world_width": camera.width / camera.scale[0]}
    cameras = {calibrated.camera: camera_keys} if camera_keys else {}
    distance = calibrated.new_distance
    card = {} if distance is None else {CARD_DISTANCE: distance}
    return calibrated_table(calibrated.spec, cameras, lights, folder, card)
