"""Cameras and lens of photographs by the points of a card that they show. Pixels are those of the reduced pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...capture.camera import Camera
from ...capture.frame.homography import mapped
from ...core.errors import InputError
from .bundle import Bundle, Views, adjusted, seen, turn_errors
from .poses import camera_matrix, focal_of, plane_of, pose_of
from .tracks import Tracks

_SPREAD = {"known": 0.5, "likely": 0.06, "unknown": 0.5}  # of the focal length where it is solved: a share
_RELIEF = 0.01  # of the cameras' distance: standard deviation of the heights of features
_MOST_ERROR = 2.5  # pixels of _WORKING, median, above which no lens and no poses explain the photographs
_STRAY = 4.0  # times the median error of all photographs, from which one is left out
_UNSURE = 0.7  # degrees: standard error of a photograph's rotation from which it is left out
_LEAST_ERROR = 0.3  # pixels, that no lens is blamed for
_OTHER_LENS = 1.5  # times the error with a free lens, above which a given lens is wrong


@dataclass(frozen=True)
class Placed:
    """cameras: with pose and lens, of the photographs that ``tracks`` uses.

    points: (P, 3) of the card. error: median reprojection error, in pixels of the photographs.
    """

    cameras: tuple[Camera, ...]
    tracks: Tracks
    points: np.ndarray
    error: float


def placed_cameras(tracks: Tracks, seen_by: Sequence[Camera], factor: float, lens: str) -> Placed:
    """Return the cameras that explain the tracks, and leave out photographs that none explains or that show too few
    points for their angle: those from straight above, whose tilt changes the picture least.

    seen_by: a camera without pose for each photograph. factor: of the reduced pictures' size. lens: as in
    ``handheld_steps``. Raises InputError where a known lens is wrong, or no cameras explain the points.
    """
    bundle, errors, turns = _solved(tracks, seen_by, factor, lens)
    off = (turns > _UNSURE) | (errors > max(_STRAY * float(np.median(errors)), 1.0))
    stray = tuple(number for number, far in zip(tracks.used, off.tolist(), strict=True) if far)
    if stray:
        tracks = tracks.without(stray)
        bundle, errors, _ = _solved(tracks, seen_by, factor, lens)
    error = float(np.median(errors)) / factor
    if error * factor > _MOST_ERROR:
        raise InputError(
            f"no camera positions fit the photographs: points are off by {error:.1f} pixels; the card must be flat and"
            " lie still, and the zoom must not change"
        )
    focal = (bundle.focal / factor,) * 2
    distortion = (bundle.radial,) if bundle.radial else ()
    cameras = tuple(
        replace(seen_by[n], scale=focal, distortion=distortion, matrix=camera_matrix(rotation, shift))
        for n, rotation, shift in zip(tracks.used, bundle.rotations, bundle.shifts, strict=True)
    )
    return Placed(cameras, tracks, bundle.points, error)


def _solved(
    tracks: Tracks, seen_by: Sequence[Camera], factor: float, lens: str
) -> tuple[Bundle, np.ndarray, np.ndarray]:
    """Return poses, lens and points, and for each photograph used the median reprojection error, in pixels of codes,
    and the standard error of its rotation, in degrees.

    Raises InputError where a known lens is wrong.
    """
    order = {number: k for k, number in enumerate(tracks.used)}
    views = Views(np.array([order[n] for n in tracks.photograph.tolist()]), tracks.point, tracks.pixels)
    cameras = [seen_by[n] for n in tracks.used]
    # In pixels of the codes, from the upper left corner.
    centres = np.array([(c.centre[0], c.height - c.centre[1]) for c in cameras]) * factor
    start = _start(tracks, cameras, centres, factor, lens)
    relief = None if tracks.board else _RELIEF * float(np.median(np.linalg.norm(start.shifts, axis=1)))
    free = adjusted(start, views, _SPREAD[lens], relief)
    if lens != "known":
        return free, _errors(free, views), turn_errors(free, views)
    kept = adjusted(start, views, 0.0, relief)
    error, best = (float(np.median(_errors(bundle, views))) for bundle in (kept, free))
    if error > max(_OTHER_LENS * best, _LEAST_ERROR):
        angle = np.degrees(2 * np.arctan(cameras[0].width * factor / 2 / free.focal))
        raise InputError(
            f"points are off by {error / factor:.2f} pixels with the given focal length, and by"
            f" {best / factor:.2f} with one of {angle:.1f}° over the width; correct --fov, or leave it out"
        )
    return kept, _errors(kept, views), turn_errors(kept, views)


def _errors(bundle: Bundle, views: Views) -> np.ndarray:
    off = np.linalg.norm(seen(bundle, views) - views.pixels, axis=1)
    return np.array([np.median(off[views.photograph == k]) for k in range(len(bundle.shifts))])


def _start(tracks: Tracks, cameras: Sequence[Camera], centres: np.ndarray, factor: float, lens: str) -> Bundle:
    """Return poses by homographies alone, before the adjustment."""
    maps = [np.array([(1, 0, -x), (0, 1, -y), (0, 0, 1)]) @ tracks.homography(n)
            for n, (x, y) in zip(tracks.used, centres, strict=True)]  # fmt: skip
    given = cameras[0].scale[0] * factor
    size = max(cameras[0].width, cameras[0].height) * factor
    if tracks.board is not None:
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
