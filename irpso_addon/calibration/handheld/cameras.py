"""Poses and lens of photographs from points of a card. Pixels are those of the reduced photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...capture.camera import Camera
from ...capture.frame.homography import mapped
from ...core.errors import InputError
from .bundle import Bundle, Views, adjusted, rotation_errors, seen
from .poses import camera_matrix, focal_of, plane_of, pose_of
from .tracks import Tracks

_FOCAL_SPREAD = {"known": 0.5, "likely": 0.06, "unknown": 0.5}  # lens → relative deviation of the focal length
_RELIEF = 0.01  # of the cameras' distance: standard deviation of the heights of features
_MAX_ERROR = 2.5  # pixels of the reduced photographs, median: larger errors are refused
_OUTLIER = 4.0  # times the median error of all photographs: above, one is excluded
_UNSURE = 0.7  # degrees: standard error of the rotation above which a photograph is excluded
_MIN_ERROR = 0.3  # pixels: errors below never refute a stated lens
_OTHER_LENS = 1.5  # times the error with a free lens: above, a stated lens is wrong


@dataclass(frozen=True)
class Placed:
    """cameras: with pose and lens, of ``tracks.used``. points: (P, 3) of the card.

    error: median reprojection error, in pixels of the full photographs.
    """

    cameras: tuple[Camera, ...]
    tracks: Tracks
    points: np.ndarray
    error: float


def placed_cameras(tracks: Tracks, seen_by: Sequence[Camera], factor: float, lens: str) -> Placed:
    """Return the cameras of least reprojection error, without photographs of large errors or uncertain rotations.

    Rotations are least certain straight above the card, where tilt changes the image least. seen_by: a camera without
    pose for each photograph. factor: reduced over full size. lens: as in ``handheld_steps``. Raises InputError if a
    known lens is wrong, or the points do not fit.
    """
    bundle, errors, turns = _solved(tracks, seen_by, factor, lens)
    excluded = (turns > _UNSURE) | (errors > max(_OUTLIER * float(np.median(errors)), 1.0))
    outliers = tuple(number for number, bad in zip(tracks.used, excluded.tolist(), strict=True) if bad)
    if outliers:
        tracks = tracks.without(outliers)
        bundle, errors, _ = _solved(tracks, seen_by, factor, lens)
    error = float(np.median(errors)) / factor
    if error * factor > _MAX_ERROR:
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
    """Return the bundle, and of each photograph used the median reprojection error and rotation's standard error.

    Units: pixels of the reduced photographs, degrees. Raises InputError if a known lens is wrong.
    """
    order = {number: k for k, number in enumerate(tracks.used)}
    views = Views(np.array([order[n] for n in tracks.photograph.tolist()]), tracks.point, tracks.pixels)
    cameras = [seen_by[n] for n in tracks.used]
    # In pixels of the reduced photographs, from the upper left corner.
    centres = np.array([(c.centre[0], c.height - c.centre[1]) for c in cameras]) * factor
    start = _start(tracks, cameras, centres, factor, lens)
    relief = None if tracks.board else _RELIEF * float(np.median(np.linalg.norm(start.shifts, axis=1)))
    free = adjusted(start, views, _FOCAL_SPREAD[lens], relief)
    if lens != "known":
        return free, _errors(free, views), rotation_errors(free, views)
    fixed = adjusted(start, views, 0.0, relief)
    error, best = (float(np.median(_errors(bundle, views))) for bundle in (fixed, free))
    if error > max(_OTHER_LENS * best, _MIN_ERROR):
        angle = np.degrees(2 * np.arctan(cameras[0].width * factor / 2 / free.focal))
        raise InputError(
            f"points are off by {error / factor:.2f} pixels with the given focal length, and by"
            f" {best / factor:.2f} with one of {angle:.1f}° over the width; correct --fov, or leave it out"
            " (likewise the angle in the folder's camera.toml)"
        )
    return fixed, _errors(fixed, views), rotation_errors(fixed, views)


def _errors(bundle: Bundle, views: Views) -> np.ndarray:
    distances = np.linalg.norm(seen(bundle, views) - views.pixels, axis=1)
    return np.array([np.median(distances[views.photograph == k]) for k in range(len(bundle.shifts))])


def _start(tracks: Tracks, cameras: Sequence[Camera], centres: np.ndarray, factor: float, lens: str) -> Bundle:
    """Return the start of the adjustment: poses by homographies alone."""
    maps = [np.array([(1, 0, -x), (0, 1, -y), (0, 0, 1)]) @ tracks.homography(n)
            for n, (x, y) in zip(tracks.used, centres, strict=True)]  # fmt: skip
    stated = cameras[0].scale[0] * factor
    size = max(cameras[0].width, cameras[0].height) * factor
    if tracks.board is not None:
        focal = stated if lens != "unknown" else focal_of(maps) or stated
        plane = np.insert(tracks.plane, 2, 0.0, axis=1)
        to_reference = np.eye(3)
    else:
        k = tracks.used.index(tracks.reference) if tracks.reference in tracks.used else 0
        centre = centres[k]
        offset = np.array([(1, 0, centre[0]), (0, 1, centre[1]), (0, 0, 1)])
        shape, focal, _ = plane_of([matrix @ offset for matrix in maps], stated if lens != "unknown" else None, size)
        to_reference = offset @ np.diag([focal, focal, 1.0]) @ shape
        plane = np.insert(mapped(np.linalg.inv(to_reference), tracks.plane), 2, 0.0, axis=1)
    poses = [pose_of(np.diag([1 / focal, 1 / focal, 1.0]) @ matrix @ to_reference) for matrix in maps]
    rotations, shifts = (np.stack(part) for part in zip(*poses, strict=True))
    return Bundle(rotations, shifts, plane, focal, 0.0, centres)
