"""One hand-held calibration, from photographs to cameras and lights."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...capture.camera import Camera
from ...capture.frame.find import display_codes
from ...capture.frame.homography import mapped
from ...capture.frame.sheet import Sheet
from ...capture.types import Capture
from ...core.errors import InputError
from .bundle import Bundle, Views, adjusted, seen
from .flash import Flash, Samples, flash_of
from .poses import camera_matrix, focal_of, plane_of, pose_of
from .tracks import Tracks, feature_tracks, marker_tracks

ENOUGH, FEWEST = 30, 8  # photographs
_WORKING = 1600  # pixels of the longer side in which points are searched
_GRID = 28  # places along a side of the card, for the flash
_BLURRED = 0.6  # of the median sharpness
_SPREAD = {"known": 0.5, "likely": 0.06, "unknown": 0.5}  # of the focal length where it is solved: a share
_ONE_PLACE = 6.0  # degrees between views, seen from the card: root mean square
_RELIEF = 0.01  # of the cameras' distance: standard deviation of the heights of features
_MOST_ERROR = 2.5  # pixels of _WORKING, median, above which no lens and no poses explain the photographs
_STRAY = 4.0  # times the median error of all photographs, from which one is left out
_LEAST_ERROR = 0.3  # pixels, that no lens is blamed for
_OTHER_LENS = 1.5  # times the error with a free lens, above which a given lens is wrong
_WHITE = 0.8  # reflectance of printer paper, and of the brightest part of a card without a sheet
_UNEVEN = 0.08  # standard deviation of the logarithm of the strengths above which exposures differ
_UNSURE = 0.02  # of the distance: standard error of the flash's place that makes it useless
_TRIMMED = 0.5  # percent of the features at each side that do not count for the extent of the card
_SHOWN = 0.6  # of the photographs that must show a place of a card without a sheet


@dataclass(frozen=True)
class Handheld:
    """cameras: of the photographs ``numbers``; the card lies in z = 0. field: (x0, y0, x1, y1) what is recovered.

    error: median reprojection error in pixels of the photographs. intensities: (K,) of the flash, at distance 1.
    views: root mean square angle between the views, in degrees. sheet: of the markers, None for features.
    """

    numbers: tuple[int, ...]
    cameras: tuple[Camera, ...]
    flash: Flash
    intensities: np.ndarray
    field: tuple[float, float, float, float]
    error: float
    views: float
    sheet: Sheet | None
    warnings: tuple[str, ...]

    @property
    def lamps(self) -> np.ndarray:
        """(K, 3) places of the flash."""
        return np.stack([camera.matrix[:3, :3] @ self.flash.offset + camera.position for camera in self.cameras])


@dataclass(frozen=True)
class _Read:
    """codes: (h, w) uint8 of each photograph, row 0 at the TOP. radiance: (h, w) grey, smaller, row 0 at the bottom.

    NaN where it is clipped. factor: of the size of codes. sharp: (K,) sharpness.
    """

    codes: list[np.ndarray]
    radiance: list[np.ndarray]
    factor: float
    sharp: np.ndarray


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
    read = yield from _read(capture)
    names = [shot.name for shot in capture.observations]
    sharp = [n for n in range(len(names)) if read.sharp[n] >= _BLURRED * np.median(read.sharp)]
    blurred = [n for n in range(len(names)) if n not in sharp]
    warnings = [f"left out as blurred: {_listed(names, range(len(names)), blurred)}"] if blurred else []
    _check_count(len(sharp), f"; blurred: {_listed(names, range(len(names)), blurred)}")
    yield 0.5
    tracks, more = _tracks([read.codes[n] for n in sharp], flash_offset is not None)
    warnings += more
    lost = [n for n in range(len(sharp)) if n not in tracks.used]
    _check_count(len(tracks.used), f"; too little of the card is recognised in {_listed(names, sharp, lost)}")
    yield 0.75
    seen_by = [capture.cameras[n] for n in sharp]
    bundle, errors = _solved(tracks, seen_by, read.factor, lens)
    stray = [n for n, off in zip(tracks.used, errors, strict=True) if off > max(_STRAY * np.median(errors), 1.0)]
    if stray:
        lost, tracks = sorted([*lost, *stray]), tracks.without(stray)
        _check_count(len(tracks.used), f"; no place of the camera explains {_listed(names, sharp, stray)}")
        bundle, errors = _solved(tracks, seen_by, read.factor, lens)
    if lost:
        warnings.append(f"left out, because the card is not recognised well in it: {_listed(names, sharp, lost)}")
    error = float(np.median(errors))
    _check_error(error, read.factor)
    numbers = [sharp[n] for n in tracks.used]
    cameras = [capture.cameras[n] for n in numbers]
    placed = [
        replace(_lens(camera, bundle, read.factor), matrix=camera_matrix(bundle.rotations[k], bundle.shifts[k]))
        for k, camera in enumerate(cameras)
    ]
    field = _field(tracks.sheet, bundle, placed)
    placed, field, sheet_scale = _in_unit(placed, field, tracks.sheet)
    angle = _view_angle(placed)
    if angle < _ONE_PLACE:
        raise InputError(
            f"the photographs are all from one place: their views differ by {angle:.1f}°; the flash moves with the"
            " lens, so go around the card, from straight above to 50° from the side"
        )
    yield 0.85
    samples = Samples(_places(field, tracks.sheet), np.stack([camera.matrix for camera in placed]), np.empty(0))
    radiance = np.stack([_sampled(read.radiance[n], camera, samples.places)
                         for n, camera in zip(numbers, placed, strict=True)])  # fmt: skip
    flash, intensities, more = _flash(replace(samples, radiance=radiance), flash_offset, tracks.sheet, placed)
    few = [] if len(numbers) >= ENOUGH else [f"{len(numbers)} photographs are used; {ENOUGH} or more are better"]
    return Handheld(
        tuple(numbers), tuple(placed), flash, intensities, field, error / read.factor, angle, tracks.sheet,
        (*warnings, *few, *more),
    )  # fmt: skip


def _check_count(count: int, why: str) -> None:
    if count < FEWEST:
        raise InputError(f"{count} photographs can be used, {FEWEST} are needed and {ENOUGH} are better{why}")


def _listed(all_names: Sequence[str], order: Sequence[int], numbers: Sequence[int]) -> str:
    names = [all_names[order[n]] for n in numbers]
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _read(capture: Capture) -> Generator[float, None, _Read]:
    longer = max(capture.cameras[0].width, capture.cameras[0].height)
    factor = max(1, int(np.ceil(longer / _WORKING)))
    codes, small, sharp = [], [], []
    for number, shot in enumerate(capture.observations):
        yield 0.5 * number / len(capture.observations)
        rgba = shot.read()
        grey = np.nan_to_num(rgba[..., :3].mean(axis=-1), posinf=0.0)
        reduced = _reduced(grey, factor)
        codes.append(display_codes(reduced))
        sharp.append(_sharpness(codes[-1]))
        known = (rgba[..., 3] > 0) & (grey > 0)
        part = _reduced(np.where(known, grey, np.nan), 2 * factor)
        small.append(part)
    return _Read(codes, small, 1 / factor, np.array(sharp))


def _reduced(image: np.ndarray, factor: int) -> np.ndarray:
    """Return means over blocks of factor × factor pixels; what is left over at the borders is left out."""
    height, width = (side // factor for side in image.shape)
    blocks = image[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return np.asarray(blocks.mean(axis=(1, 3)))


def _sharpness(codes: np.ndarray) -> float:
    """Return the energy of the finest details over that of larger ones, in the direction in which it is least.

    A shaken photograph is sharp across its motion.
    """
    image = codes.astype(np.float32)

    def energy(step: int, x: int, y: int) -> float:
        part = [np.roll(image, (sign * step * y, sign * step * x), axis=(0, 1)) for sign in (-1, 1)]
        curved = (2 * image - part[0] - part[1])[step:-step, step:-step]
        return float((curved**2).mean())

    return min(energy(1, x, y) / max(energy(4, x, y), 1e-6) for x, y in ((1, 0), (0, 1), (1, 1), (1, -1)))


def _tracks(codes: list[np.ndarray], needs_markers: bool) -> tuple[Tracks, list[str]]:
    """Return points by markers, else by features, and warnings. Raises InputError where there are neither."""
    tracks = marker_tracks(codes)
    if tracks is not None and len(tracks.used) >= max(FEWEST, len(codes) // 2):
        return tracks, []
    if needs_markers:
        raise InputError("--flash-offset: is in millimetres and needs printed markers in the photographs; leave it out")
    found = feature_tracks(codes)
    if found is None or len(found.used) < 2:
        raise InputError(
            "the photographs show neither printed markers nor enough features of one flat card; lay a sheet of `irpso"
            " markers` around it"
        )
    if tracks is None:
        return found, []
    return found, [
        f"three printed markers or more show in only {len(tracks.used)} of {len(codes)} photographs, so that features of"
        " the card are used, and lengths have no unit"
    ]


def _solved(tracks: Tracks, seen_by: Sequence[Camera], factor: float, lens: str) -> tuple[Bundle, np.ndarray]:
    """Return poses, lens and points, and the median reprojection error of each photograph used, in pixels of codes.

    Raises InputError where a known lens is wrong.
    """
    order = {number: k for k, number in enumerate(tracks.used)}
    views = Views(np.array([order[n] for n in tracks.photograph.tolist()]), tracks.point, tracks.pixels)
    cameras = [seen_by[n] for n in tracks.used]
    # In pixels of the codes, from the upper left corner.
    centres = np.array([(c.centre[0], c.height - c.centre[1]) for c in cameras]) * factor
    start = _start(tracks, cameras, centres, factor, lens)
    relief = None if tracks.sheet else _RELIEF * float(np.median(np.linalg.norm(start.shifts, axis=1)))
    free = adjusted(start, views, _SPREAD[lens], relief)
    if lens != "known":
        return free, _errors(free, views)
    kept = adjusted(start, views, 0.0, relief)
    error, best = (float(np.median(_errors(bundle, views))) for bundle in (kept, free))
    if error > max(_OTHER_LENS * best, _LEAST_ERROR):
        angle = np.degrees(2 * np.arctan(cameras[0].width * factor / 2 / free.focal))
        raise InputError(
            f"the given focal length explains the photographs to {error / factor:.2f} pixels, one of {angle:.1f}° over"
            f" the width to {best / factor:.2f}; correct --fov, or leave it out"
        )
    return kept, _errors(kept, views)


def _check_error(error: float, factor: float) -> None:
    if error > _MOST_ERROR:
        raise InputError(
            f"no cameras explain the photographs: points are off by {error / factor:.1f} pixels; the card must be flat"
            " and lie still, and the zoom must not change"
        )


def _errors(bundle: Bundle, views: Views) -> np.ndarray:
    off = np.linalg.norm(seen(bundle, views) - views.pixels, axis=1)
    return np.array([np.median(off[views.photograph == k]) for k in range(len(bundle.shifts))])


def _start(tracks: Tracks, cameras: Sequence[Camera], centres: np.ndarray, factor: float, lens: str) -> Bundle:
    """Return poses by homographies alone, before the adjustment."""
    maps = [np.array([(1, 0, -x), (0, 1, -y), (0, 0, 1)]) @ tracks.homography(n)
            for n, (x, y) in zip(tracks.used, centres, strict=True)]  # fmt: skip
    given = cameras[0].scale[0] * factor
    size = max(cameras[0].width, cameras[0].height) * factor
    if tracks.sheet is not None:
        focal = given if lens != "unknown" else focal_of(maps) or given
        plane = np.insert(tracks.plane, 2, 0.0, axis=1)
        seen_from = np.eye(3)
    else:
        k = tracks.used.index(tracks.reference) if tracks.reference in tracks.used else 0
        centre = centres[k]
        off = np.array([(1, 0, centre[0]), (0, 1, centre[1]), (0, 0, 1)])
        shape, focal, _ = plane_of([matrix @ off for matrix in maps], given if lens != "unknown" else None, size)
        seen_from = off @ np.diag([focal, focal, 1.0]) @ shape
        plane = np.insert(mapped(np.linalg.inv(seen_from), tracks.plane), 2, 0.0, axis=1)
    poses = [pose_of(np.diag([1 / focal, 1 / focal, 1.0]) @ matrix @ seen_from) for matrix in maps]
    rotations, shifts = (np.stack(part) for part in zip(*poses, strict=True))
    return Bundle(rotations, shifts, plane, focal, 0.0, centres)


def _lens(camera: Camera, bundle: Bundle, factor: float) -> Camera:
    focal = bundle.focal / factor
    distortion = (bundle.radial,) if bundle.radial else ()
    return replace(camera, scale=(focal, focal), distortion=distortion)


def _field(sheet: Sheet | None, bundle: Bundle, cameras: Sequence[Camera]) -> tuple[float, float, float, float]:
    """Return what is recovered: the sheet's field, or the box around the features that most photographs show."""
    if sheet is not None:
        width, height = sheet.field
        return -width / 2, -height / 2, width / 2, height / 2
    shown = np.stack([_shows(camera, bundle.points[:, :2]) for camera in cameras])
    there = shown.mean(axis=0) >= _SHOWN
    if there.sum() < FEWEST:
        raise InputError("no part of the card is in most of the photographs; keep it in the middle of all of them")
    (x0, y0), (x1, y1) = np.percentile(bundle.points[there, :2], [_TRIMMED, 100 - _TRIMMED], axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _shows(camera: Camera, places: np.ndarray) -> np.ndarray:
    pixels, depth = camera.project(np.concatenate([places, np.zeros((*places.shape[:-1], 1))], axis=-1))
    return (depth > 0) & (pixels > 0).all(axis=-1) & (pixels < (camera.width, camera.height)).all(axis=-1)


def _in_unit(
    cameras: list[Camera], field: tuple[float, float, float, float], sheet: Sheet | None
) -> tuple[list[Camera], tuple[float, float, float, float], float]:
    """Return cameras and field with the field around the origin, and without a sheet as 1 wide."""
    if sheet is not None:
        return cameras, field, 1.0
    x0, y0, x1, y1 = field
    scale, middle = 1 / (x1 - x0), np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    moved = []
    for camera in cameras:
        matrix = camera.matrix.copy()
        matrix[:3, 3] = (matrix[:3, 3] - middle) * scale
        moved.append(replace(camera, matrix=matrix))
    half = (y1 - y0) / 2 * scale
    return moved, (-0.5, -half, 0.5, half), scale


def _view_angle(cameras: Sequence[Camera]) -> float:
    """Return the root mean square angle, in degrees, of the directions to the cameras from their mean."""
    away = np.stack([camera.position / np.linalg.norm(camera.position) for camera in cameras])
    mean = away.mean(axis=0) / np.linalg.norm(away.mean(axis=0))
    return float(np.degrees(np.sqrt((np.arccos(np.clip(away @ mean, -1, 1)) ** 2).mean())))


def _places(field: tuple[float, float, float, float], sheet: Sheet | None) -> np.ndarray:
    """Return (P, 2) places of the card, a grid; before it those of bare paper, with a sheet."""
    x0, y0, x1, y1 = field
    share = (np.arange(_GRID) + 0.5) / _GRID
    grid = np.stack(np.meshgrid(x0 + share * (x1 - x0), y0 + share * (y1 - y0)), axis=-1).reshape(-1, 2)
    return grid if sheet is None else np.concatenate([sheet.white, grid])


def _sampled(radiance: np.ndarray, camera: Camera, places: np.ndarray) -> np.ndarray:
    """Return (P,) values of a reduced picture at places of the plane; NaN where it does not show them."""
    pixels, _ = camera.project(np.insert(places, 2, 0.0, axis=1))
    height, width = radiance.shape
    with np.errstate(invalid="ignore"):
        inside = _shows(camera, places) & np.isfinite(pixels).all(axis=1)
    at = np.where(inside[:, None], pixels * (width / camera.width, height / camera.height), 0.5)
    column, row = np.clip(at.astype(int), 0, [width - 1, height - 1]).T
    return np.where(inside, radiance[row, column], np.nan)


def _flash(
    samples: Samples, offset: np.ndarray | None, sheet: Sheet | None, cameras: Sequence[Camera]
) -> tuple[Flash, np.ndarray, list[str]]:
    """Return the flash, its intensities (K,), and warnings."""
    flash, warnings = flash_of(samples, offset), []
    distance = float(np.median([np.linalg.norm(camera.position) for camera in cameras]))
    if offset is None and (flash.error > _UNSURE * distance).any():
        warnings.append("the brightness does not tell the flash's place; it is taken to be the lens's (--flash-offset)")
        flash = flash_of(samples, np.zeros(3))
    gains = flash.gains
    if np.log(gains).std() < _UNEVEN:
        gains = np.ones_like(gains)
    else:
        warnings.append(
            f"the exposure differs between the photographs, by {np.log(gains).std():.0%} (standard deviation), and is"
            " divided out; fix it (AE lock) for a common one"
        )
    paper = flash.albedo[: len(sheet.white)] if sheet else flash.albedo[:0]
    if np.isfinite(paper).any():
        strength = float(np.nanmedian(paper)) / _WHITE
    else:
        strength = float(np.nanpercentile(flash.albedo, 95)) / _WHITE
        warnings.append("the base colour is known up to one factor: its brightest part is taken to reflect 80 %")
    return flash, strength * gains, warnings
