"""Hand-held calibration: cameras and flash positions from photographs of a card, by a moving camera with its flash."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ...capture.camera import Camera
from ...capture.frame.board import Board
from ...capture.images.exif import upright_axes
from ...capture.types import Capture
from ...core.errors import InputError
from ...core.steps import map_steps
from .ambiguous_positions import ambiguous_positions
from .cameras import Placed, placed_cameras
from .flash import Flash, Samples, flash_of, usable_samples
from .pictures import picture_steps
from .tracks import Tracks, feature_tracks, marker_tracks

Box = tuple[float, float, float, float]
ENOUGH, MIN_PHOTOGRAPHS = 30, 8  # photographs
_GRID = 28  # points along a side of the card, for the fit of the flash
_BLURRED = 0.6  # of the median sharpness
_MIN_VIEW_ANGLE = 6.0  # degrees: least root mean square angle between views
_WHITE = 0.8  # reflectance of printer paper, and of the brightest part of a card without a board
_UNEVEN = 0.08  # standard deviation of the strengths' logarithm: above, exposures differ
_CONTRADICTS, _MUCH_SURER = 2.5, 0.5  # standard errors; of the other fit's standard error
_MIN_PAPER = 10  # points of bare paper that each photograph must show unclipped
_UNSURE = 0.02  # of the distance: largest usable standard error of the flash's position
_TRIM = 0.5  # percent of the features at each side, excluded from the extent of the card
_MIN_IN_VIEW = 0.6  # of the photographs that must show a point of a card without a board
_SIDE = 96  # samples along a side of the square for the test of ambiguous positions
_ALIKE = "the card looks the same after a turn or a shift, so its position is uncertain in"
_BOARD = "lay a marker board (`irpso markers`) around it"


@dataclass(frozen=True)
class Handheld:
    """cameras: of the photographs ``numbers``; the card lies in z = 0. field: (x0, y0, x1, y1), the recovered area.

    error: median reprojection error in pixels of the photographs. intensities: (K,) of the flash, at distance 1.
    views: root mean square angle between the views, in degrees. board: of the markers, None for features. turns:
    (K, 3, 3) from the sensor's axes, those of the flash's offset, to the camera's: EXIF turns pictures upright.
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
    turns: np.ndarray

    @property
    def lamps(self) -> np.ndarray:
        """(K, 3) positions of the flash."""
        sensors = _sensors(self.cameras, self.turns)
        return sensors[:, :3, :3] @ self.flash.offset + sensors[:, :3, 3]


def handheld_steps(
    capture: Capture,
    lens: str = "likely",
    flash_offset: np.ndarray | None = None,
    orientations: Sequence[int] | None = None,
) -> Generator[float, None, Handheld]:
    """Yield the fraction done; return the cameras and the flash of photographs.

    capture: one camera per photograph, with its size and focal length, without pose; all have one focal length. lens:
    "known" fixes the focal length; "likely" (EXIF's, which is rounded) and "unknown" fit it. flash_offset: (3,)
    millimetres from lens to flash, in the sensor's axes, with markers only; None to fit it. orientations: EXIF
    orientations that reading applied, None for none. Raises InputError if photographs are too few, blurred, without
    points, from one viewpoint, of another lens, or turned without an orientation.
    """
    _check_count(len(capture.observations), "")
    orientations = orientations or [1] * len(capture.observations)
    _check_size(capture, orientations)
    pictures = yield from map_steps(picture_steps(capture), lambda share: 0.5 * share)
    names = np.array([observation.name for observation in capture.observations])
    sharp = np.flatnonzero(pictures.sharp >= _BLURRED * np.median(pictures.sharp))
    blurred = _listed(np.delete(names, sharp))
    _check_count(len(sharp), f"; blurred: {blurred}")
    yield 0.5
    tracks, warnings = _tracks([pictures.codes[n] for n in sharp], flash_offset is not None)
    _check_count(len(tracks.used), f"; too little of the card is in {_listed(np.delete(names[sharp], tracks.used))}")
    yield 0.75
    seen_by, radiance = ([side[n] for n in sharp] for side in (capture.cameras, pictures.radiance))
    place = partial(placed_cameras, seen_by=seen_by, factor=pictures.factor, lens=lens)
    placed, left_out = yield from _placed_steps(tracks, place, radiance, names[sharp])
    numbers = sharp[list(placed.tracks.used)]
    field, cameras = _in_unit(_field(tracks.board, placed), placed.cameras, tracks.board)
    angle = _view_angle(cameras)
    if angle < _MIN_VIEW_ANGLE:
        raise InputError(
            f"the photographs are all from one place: their views differ by {angle:.1f}°; the flash moves with the"
            " lens, so go around the card, from straight above to 50° from the side"
        )
    yield 0.85
    places = _places(field, tracks.board)
    sampled = [_sampled(radiance[k], camera, places) for k, camera in zip(placed.tracks.used, cameras, strict=True)]
    turns = np.stack([upright_axes(orientations[number]) for number in numbers])
    samples = Samples(places, _sensors(cameras, turns), np.stack(sampled))
    flash, intensities, flash_warnings = _flash(samples, flash_offset, tracks.board)
    notes = (
        f"left out as blurred: {blurred}" if blurred else "",
        *left_out,
        f"{len(numbers)} photographs are used; {ENOUGH} or more are better" if len(numbers) < ENOUGH else "",
    )
    return Handheld(
        tuple(numbers.tolist()), cameras, flash, intensities, field, placed.error, angle, tracks.board,
        (*filter(None, notes), *warnings, *flash_warnings), turns,
    )  # fmt: skip


def _placed_steps(
    tracks: Tracks, place: Callable[[Tracks], Placed], radiance: Sequence[np.ndarray], names: np.ndarray
) -> Generator[float, None, tuple[Placed, tuple[str, ...]]]:
    """Yield the fraction done; return the cameras that ``place`` finds and why photographs are left out.

    names: of the photographs of ``tracks`` and ``radiance``. Without markers a card may look alike from two sides:
    such photographs are left out, and the others are placed again. Raises InputError if too few are left.
    """
    placed = place(tracks)
    failed = _listed(np.delete(names, placed.tracks.used))
    _check_count(len(placed.cameras), f"; the card is not recognised well in {failed}")
    ambiguous: tuple[int, ...] = ()
    if tracks.board is None:
        yield 0.8
        ambiguous = _ambiguous(placed, radiance)
    reason = f"{_ALIKE} {_listed(names[list(ambiguous)])}; {_BOARD}" if ambiguous else ""
    if ambiguous:
        _check_count(len(placed.cameras) - len(ambiguous), f"; {reason}")
        placed = place(placed.tracks.without(ambiguous))
        failed = _listed(np.delete(names, [*placed.tracks.used, *ambiguous]))
        _check_count(len(placed.cameras), f"; the card is not recognised well in {failed}")
    notes = (
        f"left out, because the card is not recognised well in it: {failed}" if failed else "",
        f"left out, because {reason}" if ambiguous else "",
    )
    return placed, notes


def _sensors(cameras: Sequence[Camera], turns: np.ndarray) -> np.ndarray:
    """Return the matrices (K, 4, 4) of cameras in the sensor's axes. turns: as of ``Handheld``."""
    matrices = np.stack([camera.matrix for camera in cameras])
    matrices[:, :3, :3] = matrices[:, :3, :3] @ turns
    return matrices


def _check_size(capture: Capture, orientations: Sequence[int]) -> None:
    """Raise InputError if photographs differ in size; portrait and landscape may mix, if EXIF tells the turn."""
    first, turned = capture.cameras[0], orientations[0] >= 5
    for observation, orientation in zip(capture.observations, orientations, strict=True):
        camera = capture.cameras[observation.camera]
        if {camera.width, camera.height} != {first.width, first.height}:
            raise InputError(
                f"{observation.name}: is {camera.width}×{camera.height} pixels where {capture.observations[0].name} has"
                f" {first.width}×{first.height}; give all photographs as the camera wrote them, in one size"
            )
        if (camera.width == first.width) != ((orientation >= 5) == turned) and camera.width != camera.height:
            raise InputError(
                f"{observation.name}: is turned against {capture.observations[0].name}, but their EXIF orientation does"
                " not say so, and the flash turns with the camera; give all photographs as the camera wrote them"
            )


def _check_count(count: int, why: str) -> None:
    if count < MIN_PHOTOGRAPHS:
        raise InputError(f"{count} photographs can be used, {MIN_PHOTOGRAPHS} are needed and {ENOUGH} are better{why}")


def _listed(names: np.ndarray) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _tracks(codes: list[np.ndarray], needs_markers: bool) -> tuple[Tracks, list[str]]:
    """Return tracks of markers, else of features, and warnings. Raises InputError if there are neither."""
    tracks = marker_tracks(codes)
    if tracks is not None and len(tracks.used) >= max(MIN_PHOTOGRAPHS, len(codes) // 2):
        return tracks, []
    if needs_markers:
        raise InputError("--flash-offset: is in millimetres and needs printed markers in the photographs; leave it out")
    features = feature_tracks(codes)
    if features is None or len(features.used) < 2:
        raise InputError(f"the photographs show neither printed markers nor enough features of one flat card; {_BOARD}")
    if tracks is None:
        return features, []
    return features, [
        f"three printed markers or more show in only {len(tracks.used)} of {len(codes)} photographs, so the"
        " features of the card are used, and lengths have no unit"
    ]


def _field(board: Board | None, placed: Placed) -> Box:
    """Return the recovered area: the board's field, or the box around the features that most photographs show."""
    if board is not None:
        width, height = board.field
        return -width / 2, -height / 2, width / 2, height / 2
    in_view = np.stack([_in_view(camera, placed.points[:, :2]) for camera in placed.cameras])
    covered = in_view.mean(axis=0) >= _MIN_IN_VIEW
    if covered.sum() < MIN_PHOTOGRAPHS:
        raise InputError("no part of the card is in most of the photographs; keep it in the middle of all of them")
    (x0, y0), (x1, y1) = np.percentile(placed.points[covered, :2], [_TRIM, 100 - _TRIM], axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _ambiguous(placed: Placed, radiance: Sequence[np.ndarray]) -> tuple[int, ...]:
    """Return the photographs, numbered as in ``tracks.used``, that match the card as well in another position."""
    x0, y0, x1, y1 = _field(None, placed)
    along = (min(x1 - x0, y1 - y0) / _SIDE) * (np.arange(_SIDE) + 0.5 - _SIDE / 2)
    square = np.stack(np.meshgrid((x0 + x1) / 2 + along, (y0 + y1) / 2 + along), axis=-1).reshape(-1, 2)
    pictures = [
        _sampled(radiance[k], camera, square) for k, camera in zip(placed.tracks.used, placed.cameras, strict=True)
    ]
    alike = ambiguous_positions(np.stack(pictures).reshape(-1, _SIDE, _SIDE))
    return tuple(k for k, doubt in zip(placed.tracks.used, alike.tolist(), strict=True) if doubt)


def _in_view(camera: Camera, places: np.ndarray) -> np.ndarray:
    pixels, depth = camera.project(np.concatenate([places, np.zeros((*places.shape[:-1], 1))], axis=-1))
    return (depth > 0) & (pixels > 0).all(axis=-1) & (pixels < (camera.width, camera.height)).all(axis=-1)


def _in_unit(field: Box, cameras: tuple[Camera, ...], board: Board | None) -> tuple[Box, tuple[Camera, ...]]:
    """Return field and cameras; without a board, moved and scaled to a field about the origin of width 1."""
    if board is not None:
        return field, cameras
    x0, y0, x1, y1 = field
    scale, centre = 1 / (x1 - x0), np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    moved = []
    for camera in cameras:
        matrix = camera.matrix.copy()
        matrix[:3, 3] = (matrix[:3, 3] - centre) * scale
        moved.append(replace(camera, matrix=matrix))
    half = (y1 - y0) / 2 * scale
    return (-0.5, -half, 0.5, half), tuple(moved)


def _view_angle(cameras: Sequence[Camera]) -> float:
    """Return the root mean square angle, in degrees, of the directions to the cameras from their mean."""
    directions = np.stack([camera.position / np.linalg.norm(camera.position) for camera in cameras])
    mean = directions.mean(axis=0) / np.linalg.norm(directions.mean(axis=0))
    return float(np.degrees(np.sqrt((np.arccos(np.clip(directions @ mean, -1, 1)) ** 2).mean())))


def _places(field: Box, board: Board | None) -> np.ndarray:
    """Return points (P, 2) of the card: those of bare paper, if there is a board, then a grid."""
    x0, y0, x1, y1 = field
    share = (np.arange(_GRID) + 0.5) / _GRID
    grid = np.stack(np.meshgrid(x0 + share * (x1 - x0), y0 + share * (y1 - y0)), axis=-1).reshape(-1, 2)
    return grid if board is None else np.concatenate([board.white, grid])


def _sampled(radiance: np.ndarray, camera: Camera, places: np.ndarray) -> np.ndarray:
    """Return the values (P,) of a reduced photograph at points of the plane; NaN outside of it."""
    pixels, _ = camera.project(np.insert(places, 2, 0.0, axis=1))
    height, width = radiance.shape
    with np.errstate(invalid="ignore"):
        inside = _in_view(camera, places) & np.isfinite(pixels).all(axis=1)
    position = np.where(inside[:, None], pixels * (width / camera.width, height / camera.height), 0.5)
    column, row = np.clip(position.astype(int), 0, [width - 1, height - 1]).T
    return np.where(inside, radiance[row, column], np.nan)


def _flash(samples: Samples, offset: np.ndarray | None, board: Board | None) -> tuple[Flash, np.ndarray, list[str]]:
    """Return the flash, its intensities (K,), and warnings.

    A glossy card biases the fit by more than its standard errors. The paper around it is matt: its samples are used
    alone if their fit is far more certain, or contradicts that of all samples.
    """
    flash, warnings = flash_of(samples, offset), []
    if board is not None and offset is None:
        count = len(board.white)
        paper = Samples(samples.places[:count], samples.cameras, samples.radiance[:, :count])
        if (usable_samples(paper).sum(axis=1) >= _MIN_PAPER).all():
            by_paper = flash_of(paper)
            difference = np.abs(by_paper.offset - flash.offset)[:2]
            surer = np.linalg.norm(by_paper.error) < _MUCH_SURER * np.linalg.norm(flash.error)
            if surer or (difference > _CONTRADICTS * np.hypot(by_paper.error, flash.error)).any():
                flash = by_paper
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
