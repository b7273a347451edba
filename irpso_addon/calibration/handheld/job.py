"""One hand-held calibration, from photographs to cameras and lights."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...capture.camera import Camera
from ...capture.frame.board import Board
from ...capture.types import Capture
from ...core.errors import InputError
from ...core.steps import map_steps
from .cameras import Placed, placed_cameras
from .flash import Flash, Samples, flash_of, usable_samples
from .likeness import doubtful
from .pictures import picture_steps
from .tracks import Tracks, feature_tracks, marker_tracks

Box = tuple[float, float, float, float]
ENOUGH, FEWEST = 30, 8  # photographs
_GRID = 28  # places along a side of the card, for the flash
_BLURRED = 0.6  # of the median sharpness
_ONE_PLACE = 6.0  # degrees between views, seen from the card: root mean square
_WHITE = 0.8  # reflectance of printer paper, and of the brightest part of a card without a board
_UNEVEN = 0.08  # standard deviation of the logarithm of the strengths above which exposures differ
_CONTRADICTS, _FAR_SURER = 2.5, 0.5  # standard errors; of the other's
_LEAST_PAPER = 10  # places of bare paper that each photograph must show unclipped
_UNSURE = 0.02  # of the distance: standard error of the flash's place that makes it useless
_TRIMMED = 0.5  # percent of the features at each side that do not count for the extent of the card
_SHOWN = 0.6  # of the photographs that must show a place of a card without a board
_SIDE = 96  # samples along a side of the square in which positions of a card are compared
_ALIKE = "the card looks the same after a turn or a shift, so its position is uncertain in"
_BOARD = "lay a marker board (`irpso markers`) around it"


@dataclass(frozen=True)
class Handheld:
    """cameras: of the photographs ``numbers``; the card lies in z = 0. field: (x0, y0, x1, y1) what is recovered.

    error: median reprojection error in pixels of the photographs. intensities: (K,) of the flash, at distance 1.
    views: root mean square angle between the views, in degrees. board: of the markers, None for features.
    """

    numbers: tuple[int, ...]
    cameras: tuple[Camera, ...]
    flash: Flash
    intensities: np.ndarray
    field: Box
    error: float
    views: float
    board: Board | None
    warnings: tuple[str, ...]

    @property
    def lamps(self) -> np.ndarray:
        """(K, 3) places of the flash."""
        return np.stack([camera.matrix[:3, :3] @ self.flash.offset + camera.position for camera in self.cameras])


def handheld_steps(
    capture: Capture, lens: str = "likely", flash_offset: np.ndarray | None = None
) -> Generator[float, None, Handheld]:
    """Yield the share that is done; return cameras and flash of photographs, each of its own camera.

    capture: its cameras have the size and the focal length of the photographs and no pose; all focal lengths are one.
    lens: "known" keeps the focal length; "likely" (EXIF's, which is rounded) and "unknown" solve it. flash_offset:
    (3,) millimetres, with markers only.
    Raises InputError where photographs are too few, blurred, without points, from one place or of another lens.
    """
    _check_count(len(capture.observations), "")
    _check_size(capture)
    pictures = yield from map_steps(picture_steps(capture), lambda share: 0.5 * share)
    names = np.array([shot.name for shot in capture.observations])
    sharp = np.flatnonzero(pictures.sharp >= _BLURRED * np.median(pictures.sharp))
    blurred = _listed(np.delete(names, sharp))
    _check_count(len(sharp), f"; blurred: {blurred}")
    yield 0.5
    tracks, warnings = _tracks([pictures.codes[n] for n in sharp], flash_offset is not None)
    _check_count(len(tracks.used), f"; too little of the card is in {_listed(np.delete(names[sharp], tracks.used))}")
    yield 0.75
    seen_by, radiance = ([side[n] for n in sharp] for side in (capture.cameras, pictures.radiance))
    placed = placed_cameras(tracks, seen_by, pictures.factor, lens)
    lost = _listed(np.delete(names[sharp], placed.tracks.used))
    _check_count(len(placed.cameras), f"; the card is not recognised well in {lost}")
    doubt: tuple[int, ...] = ()
    if tracks.board is None:
        yield 0.8
        doubt = _in_doubt(placed, radiance)
    alike = f"{_ALIKE} {_listed(names[sharp[list(doubt)]])}; {_BOARD}" if doubt else ""
    if doubt:
        _check_count(len(placed.cameras) - len(doubt), f"; {alike}")
        placed = placed_cameras(placed.tracks.without(doubt), seen_by, pictures.factor, lens)
        lost = _listed(np.delete(names[sharp], [*placed.tracks.used, *doubt]))
        _check_count(len(placed.cameras), f"; the card is not recognised well in {lost}")
    numbers = sharp[list(placed.tracks.used)]
    field, cameras = _in_unit(_field(tracks.board, placed), placed.cameras, tracks.board)
    angle = _view_angle(cameras)
    if angle < _ONE_PLACE:
        raise InputError(
            f"the photographs are all from one place: their views differ by {angle:.1f}°; the flash moves with the"
            " lens, so go around the card, from straight above to 50° from the side"
        )
    yield 0.85
    places = _places(field, tracks.board)
    seen = [_sampled(radiance[k], camera, places) for k, camera in zip(placed.tracks.used, cameras, strict=True)]
    samples = Samples(places, np.stack([camera.matrix for camera in cameras]), np.stack(seen))
    flash, intensities, more = _flash(samples, flash_offset, tracks.board)
    told = (
        f"left out as blurred: {blurred}" if blurred else "",
        f"left out, because the card is not recognised well in it: {lost}" if lost else "",
        f"left out, because {alike}" if doubt else "",
        f"{len(numbers)} photographs are used; {ENOUGH} or more are better" if len(numbers) < ENOUGH else "",
    )
    return Handheld(
        tuple(numbers.tolist()), cameras, flash, intensities, field, placed.error, angle, tracks.board,
        (*filter(None, told), *warnings, *more),
    )  # fmt: skip


def _check_size(capture: Capture) -> None:
    """Raise InputError where photographs differ in size; some may be turned."""
    first = capture.cameras[0]
    for shot in capture.observations:
        camera = capture.cameras[shot.camera]
        if {camera.width, camera.height} != {first.width, first.height}:
            raise InputError(
                f"{shot.name}: is {camera.width}×{camera.height} pixels where {capture.observations[0].name} has"
                f" {first.width}×{first.height}; give all photographs as the camera wrote them, in one size"
            )


def _check_count(count: int, why: str) -> None:
    if count < FEWEST:
        raise InputError(f"{count} photographs can be used, {FEWEST} are needed and {ENOUGH} are better{why}")


def _listed(names: np.ndarray) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _tracks(codes: list[np.ndarray], needs_markers: bool) -> tuple[Tracks, list[str]]:
    """Return points by markers, else by features, and warnings. Raises InputError where there are neither."""
    tracks = marker_tracks(codes)
    if tracks is not None and len(tracks.used) >= max(FEWEST, len(codes) // 2):
        return tracks, []
    if needs_markers:
        raise InputError("--flash-offset: is in millimetres and needs printed markers in the photographs; leave it out")
    found = feature_tracks(codes)
    if found is None or len(found.used) < 2:
        raise InputError(f"the photographs show neither printed markers nor enough features of one flat card; {_BOARD}")
    if tracks is None:
        return found, []
    return found, [
        f"three printed markers or more show in only {len(tracks.used)} of {len(codes)} photographs, so the"
        " features of the card are used, and lengths have no unit"
    ]


def _field(board: Board | None, placed: Placed) -> Box:
    """Return what is recovered: the board's field, or the box around the features that most photographs show."""
    if board is not None:
        width, height = board.field
        return -width / 2, -height / 2, width / 2, height / 2
    shown = np.stack([_shows(camera, placed.points[:, :2]) for camera in placed.cameras])
    there = shown.mean(axis=0) >= _SHOWN
    if there.sum() < FEWEST:
        raise InputError("no part of the card is in most of the photographs; keep it in the middle of all of them")
    (x0, y0), (x1, y1) = np.percentile(placed.points[there, :2], [_TRIMMED, 100 - _TRIMMED], axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _in_doubt(placed: Placed, radiance: Sequence[np.ndarray]) -> tuple[int, ...]:
    """Return the photographs, numbered as in ``tracks.used``, that fit the card as well in another position."""
    x0, y0, x1, y1 = _field(None, placed)
    along = (min(x1 - x0, y1 - y0) / _SIDE) * (np.arange(_SIDE) + 0.5 - _SIDE / 2)
    square = np.stack(np.meshgrid((x0 + x1) / 2 + along, (y0 + y1) / 2 + along), axis=-1).reshape(-1, 2)
    pictures = [
        _sampled(radiance[k], camera, square) for k, camera in zip(placed.tracks.used, placed.cameras, strict=True)
    ]
    alike = doubtful(np.stack(pictures).reshape(-1, _SIDE, _SIDE))
    return tuple(k for k, doubt in zip(placed.tracks.used, alike.tolist(), strict=True) if doubt)


def _shows(camera: Camera, places: np.ndarray) -> np.ndarray:
    pixels, depth = camera.project(np.concatenate([places, np.zeros((*places.shape[:-1], 1))], axis=-1))
    return (depth > 0) & (pixels > 0).all(axis=-1) & (pixels < (camera.width, camera.height)).all(axis=-1)


def _in_unit(field: Box, cameras: tuple[Camera, ...], board: Board | None) -> tuple[Box, tuple[Camera, ...]]:
    """Return field and cameras, without a board with the field around the origin and 1 wide."""
    if board is not None:
        return field, cameras
    x0, y0, x1, y1 = field
    scale, middle = 1 / (x1 - x0), np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    moved = []
    for camera in cameras:
        matrix = camera.matrix.copy()
        matrix[:3, 3] = (matrix[:3, 3] - middle) * scale
        moved.append(replace(camera, matrix=matrix))
    half = (y1 - y0) / 2 * scale
    return (-0.5, -half, 0.5, half), tuple(moved)


def _view_angle(cameras: Sequence[Camera]) -> float:
    """Return the root mean square angle, in degrees, of the directions to the cameras from their mean."""
    away = np.stack([camera.position / np.linalg.norm(camera.position) for camera in cameras])
    mean = away.mean(axis=0) / np.linalg.norm(away.mean(axis=0))
    return float(np.degrees(np.sqrt((np.arccos(np.clip(away @ mean, -1, 1)) ** 2).mean())))


def _places(field: Box, board: Board | None) -> np.ndarray:
    """Return (P, 2) places of the card, a grid; before it those of bare paper, with a board."""
    x0, y0, x1, y1 = field
    share = (np.arange(_GRID) + 0.5) / _GRID
    grid = np.stack(np.meshgrid(x0 + share * (x1 - x0), y0 + share * (y1 - y0)), axis=-1).reshape(-1, 2)
    return grid if board is None else np.concatenate([board.white, grid])


def _sampled(radiance: np.ndarray, camera: Camera, places: np.ndarray) -> np.ndarray:
    """Return (P,) values of a reduced picture at places of the plane; NaN where it does not show them."""
    pixels, _ = camera.project(np.insert(places, 2, 0.0, axis=1))
    height, width = radiance.shape
    with np.errstate(invalid="ignore"):
        inside = _shows(camera, places) & np.isfinite(pixels).all(axis=1)
    at = np.where(inside[:, None], pixels * (width / camera.width, height / camera.height), 0.5)
    column, row = np.clip(at.astype(int), 0, [width - 1, height - 1]).T
    return np.where(inside, radiance[row, column], np.nan)


def _flash(samples: Samples, offset: np.ndarray | None, board: Board | None) -> tuple[Flash, np.ndarray, list[str]]:
    """Return the flash, its intensities (K,), and warnings.

    A card that shines bends what its brightness says of the flash, by more than the errors know. The paper around it
    is matt: it counts alone where it is far surer or both contradict each other.
    """
    flash, warnings = flash_of(samples, offset), []
    if board is not None and offset is None:
        count = len(board.white)
        paper = Samples(samples.places[:count], samples.cameras, samples.radiance[:, :count])
        if (usable_samples(paper).sum(axis=1) >= _LEAST_PAPER).all():
            told = flash_of(paper)
            apart = np.abs(told.offset - flash.offset)[:2]
            surer = np.linalg.norm(told.error) < _FAR_SURER * np.linalg.norm(flash.error)
            if surer or (apart > _CONTRADICTS * np.hypot(told.error, flash.error)).any():
                flash = told
    distance = float(np.median(np.linalg.norm(samples.cameras[:, :3, 3], axis=1)))
    if offset is None and (flash.error > _UNSURE * distance).any():
        warnings.append(
            "the brightness does not show where the flash is, so the place of the lens is used; give --flash-offset"
        )
        flash = flash_of(samples, np.zeros(3))
    gains = flash.gains
    if np.log(gains).std() < _UNEVEN:
        gains = np.ones_like(gains)
    else:
        warnings.append(
            f"the exposure differs between the photographs, by {np.log(gains).std():.0%} (standard deviation), and is"
            " divided out; lock the exposure (AE lock) for the next photographs"
        )
    white = flash.albedo[: len(board.white)] if board else flash.albedo[:0]
    if np.isfinite(white).any():
        strength = float(np.nanmedian(white)) / _WHITE
    else:
        strength = float(np.nanpercentile(flash.albedo, 95)) / _WHITE
        warnings.append("the base colour is known up to one factor: its brightest part is assumed to reflect 80 %")
    return flash, strength * gains, warnings
