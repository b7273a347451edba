"""``PoseFile``: named cameras of another program; and their conversion to our axes, world and image sizes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from operator import eq
from os.path import commonprefix
from pathlib import Path, PurePosixPath, PureWindowsPath
from unicodedata import normalize

import numpy as np

from ...core.errors import some
from ..camera import Camera, is_rotation
from ..errors import CaptureError
from ..images.exr_header import Turn

# EXIF orientation (2.3, tag 274) → quarter turns clockwise from the stored to the upright image; the others mirror.
_TURNS = {1: 0, 6: 1, 3: 2, 8: 3}
_SIZE = 0.75  # pixels: tolerance of a scaled image's height, for rounding
_BACK = np.diag([1.0, -1.0, -1.0])  # y down and z away, as in computer vision, to y up and z toward the viewer


@dataclass(frozen=True)
class PoseFile:
    """Cameras of one file or folder. program: its writer. cameras: image name in the file → Camera.

    unusable: image name → reason why its camera cannot be used. orientations: image name → EXIF orientation of the
    aligned photograph, where the program states it.
    """

    path: Path
    program: str
    cameras: Mapping[str, Camera]
    unusable: Mapping[str, str]
    orientations: Mapping[str, int] = field(default_factory=dict)

    def name_of(self, image_name: str, where: str) -> str:
        """Return the name of an image's camera: equal, else equal without case, else without suffix and case.

        Without case accents count alike, alone or as a part of their letter (Unicode NFC), as macOS writes them.
        Folders that only one of the two names has, or that all cameras share, are ignored; others must agree from the
        last on.
        Raises CaptureError, beginning with ``where``, for none or several.
        """
        names = self._matches(image_name)
        if len(names) > 1:
            raise CaptureError(
                f"{where}: '{image_name}' may be any of {some(names)} of {self.path}; give camera its whole name",
                "camera",
            )
        if names and names[0] in self.cameras:
            return names[0]
        if names:
            why = f"its '{names[0]}' {self.unusable[names[0]]}"
        else:
            why = f"it has no '{image_name}'; set camera to one that it has: {some(list(self.cameras))}"
        raise CaptureError(f"{where}: its camera should be in {self.path}: {why}", "camera")

    def _matches(self, image_name: str) -> list[str]:
        if image_name in self.cameras or image_name in self.unusable:
            return [image_name]
        for key, names in zip(_KEYS, self._names_by_last, strict=True):
            wanted = key(path_parts(image_name))
            if matches := [name for name, parts in names.get(wanted[-1], ()) if _agree(parts, wanted)]:
                return matches
        return []

    @cached_property
    def _names_by_last(self) -> list[dict[str, list[tuple[str, tuple[str, ...]]]]]:
        """Return for each of _KEYS: last part of a name → the names that end with it, with their parts.

        The folders that all share say nothing: the photographs may have moved, or been developed, since.
        """
        names = [*self.cameras, *self.unusable]
        shared = len(commonprefix([path_parts(name)[:-1] for name in names]))
        tables: list[dict[str, list[tuple[str, tuple[str, ...]]]]] = [{} for _ in _KEYS]
        for table, key in zip(tables, _KEYS, strict=True):
            for name in names:
                parts = key(path_parts(name)[shared:])
                table.setdefault(parts[-1], []).append((name, parts))
        return tables


# (width, height), focal length, centre, distortion: see camera_from_vision.
Lens = tuple[tuple[int, int], tuple[float, float], tuple[float, float], tuple[float, ...]]


def camera_from_vision(
    size: tuple[int, int],
    focal: tuple[float, float],
    centre: tuple[float, float],
    distortion: tuple[float, ...],
    rotation: np.ndarray,
    position: np.ndarray,
) -> Camera:
    """Return a camera given in the axes of computer vision: x right, y down, z away from the viewer.

    size: (width, height) pixels. focal: (2,) pixels. centre: (2,) pixels from the upper left corner of the image, whose
    first pixel's centre is (0.5, 0.5). distortion: as Camera's. rotation: (3, 3) camera to world. position: (3,).
    """
    matrix = np.eye(4)
    matrix[:3, :3] = rotation @ _BACK
    matrix[:3, 3] = position
    while distortion and distortion[-1] == 0:
        distortion = distortion[:-1]
    return Camera(*size, focal, (centre[0], size[1] - centre[1]), matrix, True, distortion)


def stated_orientation(name: str, text: object) -> dict[str, int]:
    """Return an entry of PoseFile.orientations; {} if the text is no EXIF orientation."""
    return {name: int(str(text))} if str(text).strip() in tuple("12345678") else {}


def similarity(matrix: np.ndarray, where: str) -> np.ndarray:
    """Return a (4, 4) similarity transform as float64. Raises CaptureError for any other matrix."""
    matrix = np.asarray(matrix, np.float64)
    scale = np.cbrt(np.linalg.det(matrix[:3, :3])) if np.isfinite(matrix).all() else 0.0
    if not scale > 0 or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise CaptureError(
            f"{where} must be a rotation, a shift and a scale, without mirroring, and end with the row 0, 0, 0, 1",
            "matrix",
        )
    if not is_rotation(matrix[:3, :3] / scale):
        raise CaptureError(f"{where} scales unevenly or skews; write a rotation times one scale", "matrix")
    return matrix


def moved(camera: Camera, world: np.ndarray) -> Camera:
    """Return a camera after a ``similarity`` transform of its world."""
    scale = np.cbrt(np.linalg.det(world[:3, :3]))
    matrix = world @ camera.matrix
    matrix[:3, :3] /= scale
    return replace(camera, matrix=matrix)


def upright_camera(camera: Camera, width: int, height: int, orientation: int, where: str) -> Camera:
    """Return the camera of an upright image of width × height pixels from the camera of the stored image.

    orientation: the image's EXIF tag. Raises CaptureError if the picture has other proportions or is mirrored.
    """
    if orientation not in _TURNS:
        raise CaptureError(f"{where}: the picture is stored mirrored; save it upright, and align that one", "size")
    # A program that rotated the image itself gives the upright size. Half a turn and square images do not show it; the
    # camera counts as that of the stored image, which these programs align, except perhaps of HEIC (turn_of_camera).
    turned_already = _fits(camera, width, height) and not _fits(camera, height, width)
    if not (turned_already and _TURNS[orientation] % 2):
        for _ in range(_TURNS[orientation]):
            camera = _quarter_turn(camera)
    if not _fits(camera, width, height):
        if _fits(camera, height, width):
            raise CaptureError(
                f"{where}: the picture is {width}×{height} pixels, its camera {camera.width}×{camera.height}, and no"
                " EXIF orientation in its file states a quarter turn; give the photograph as the camera stored it, or"
                " one that this irpso develop has written",
                "size",
            )
        raise CaptureError(
            f"{where}: the picture is {width}×{height} pixels, its camera {camera.width}×{camera.height}; align the"
            " uncropped pictures that the capture names",
            "size",
        )
    x, y = width / camera.width, height / camera.height
    return replace(
        camera, width=width, height=height, scale=(camera.scale[0] * x, camera.scale[1] * y),
        centre=(camera.centre[0] * x, camera.centre[1] * y),
    )  # fmt: skip


def turn_of_camera(camera: Camera, turn: Turn) -> int:
    """Return the EXIF orientation by which the camera of a stored picture is turned, for ``upright_camera``.

    If the program turned a HEIC file by a quarter, too, its size shows it, unless the picture is a square.
    """
    return turn.tag if _size_tells(camera, turn.tag) else turn.turned_by


def turn_doubt(poses: PoseFile, name: str, turn: Turn, where: str) -> str:
    """Return a warning if a picture may be turned against the photograph of its camera ``name``, else "".

    turn: of the picture. Raises CaptureError for HEIC files of COLMAP: its Bitmap::Read switches OpenImageIO's
    oiio:reorient off, but a decoder below OpenImageIO may turn the pixels.
    """
    camera, aligned = poses.cameras[name], poses.orientations.get(name, turn.turned_by)
    if turn.tag != turn.turned_by:
        if _size_tells(camera, turn.tag):
            return ""
        what = f"{where}: a HEIC file has the EXIF orientation {turn.tag}, and {poses.program} may not have applied it;"
        if poses.program == "COLMAP":
            raise CaptureError(f"{what} convert the photographs to JPEG, align those, and give them", "orientation")
        return f"{what} it is read as if it had: if the result is upside down, convert to JPEG, and align again"
    if 1 not in (aligned, turn.turned_by) or _size_tells(camera, max(aligned, turn.turned_by)):
        return ""
    if aligned == turn.turned_by:
        return ""
    return (
        f"{where}: {poses.program} aligned a photograph of EXIF orientation {aligned}, and the capture's picture has"
        f" {turn.turned_by}; if a program turned its pixels, it is read turned: give the photograph as the camera"
        " stored it, or one that this irpso develop has written"
    )


def _size_tells(camera: Camera, orientation: int) -> bool:
    """Return whether a picture's size shows if it was turned by an EXIF orientation: no square, a quarter turn."""
    return bool(_TURNS.get(orientation, 0) % 2) and camera.width != camera.height


def _fits(camera: Camera, width: int, height: int) -> bool:
    return abs(camera.height * width / camera.width - height) <= _SIZE * max(1.0, width / camera.width)


def _quarter_turn(camera: Camera) -> Camera:
    """Return the camera of the image rotated by 90° clockwise."""
    matrix = camera.matrix.copy()
    matrix[:3, 0], matrix[:3, 1] = camera.matrix[:3, 1], -camera.matrix[:3, 0]
    k1, k2, p1, p2, *rest = (*camera.distortion, *(0.0,) * (4 - len(camera.distortion)))
    return Camera(
        camera.height, camera.width, camera.scale[::-1], (camera.centre[1], camera.width - camera.centre[0]), matrix,
        True, (k1, k2, p2, -p1, *rest) if camera.distortion else (),
    )  # fmt: skip


@cache
def path_parts(name: str) -> tuple[str, ...]:
    """Return the folders and the last part of a POSIX or Windows path."""
    return tuple(part for part in PureWindowsPath(name).parts if part != "..") or (name,)


def _lower(parts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(normalize("NFC", part.lower()) for part in parts)


def _without_suffix(parts: tuple[str, ...]) -> tuple[str, ...]:
    *folders, last = _lower(parts)
    return (*folders, PurePosixPath(last).stem)


def _agree(parts: tuple[str, ...], wanted: tuple[str, ...]) -> bool:
    """Return whether two paths agree from their last parts on, as far as both go."""
    return all(map(eq, parts[::-1], wanted[::-1]))


# What two names are compared by, the strictest first: parts of a path → parts.
_KEYS: tuple[Callable[[tuple[str, ...]], tuple[str, ...]], ...] = (tuple, _lower, _without_suffix)
