"""Cameras of a capture table: its own [[camera]] tables, or those of another program's file by image name."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..camera import Camera, is_rotation
from ..errors import CaptureError
from ..images.exr_header import Turn
from ..images.image import ImageRef, ImageStore
from ..poses import PoseFile, moved, path_parts, read_poses, similarity, turn_doubt, turn_of_camera, upright_camera
from ..spec import ViewSpec
from .toml_file import CAMERA_KEYS, camera_maker, has_lens, image_ref, is_number, known_keys, rows, text

_MASK = {"mask", "mask_part", "mask_layer"}
_KNOWN = {"name", "width", "height", "matrix"} | _MASK | CAMERA_KEYS


class Views:
    """Cameras of one table, in order of definition or first use. specs: one ViewSpec per camera so far.

    Raises CaptureError if keys are unknown, missing or wrong.
    """

    def __init__(self, table: dict[str, Any], path: Path):
        self.specs: list[ViewSpec] = []
        self._poses = _poses(table, path)
        self._world = _world(table, path, self._poses)
        self._masks: dict[str, ImageRef] = {}
        self._images: dict[str, list[ImageRef]] = {}  # name of a camera of another program → its images
        self._image_of: dict[str, str] = {}  # name of a camera of another program → the first image that it is used for
        for count, row in enumerate(rows(table, "camera", path, needed=self._poses is None), 1):
            # The table may only add a mask to a camera of another program.
            if self._poses is not None and {"name", "mask"} <= set(row) <= {"name"} | _MASK:
                name = self._poses.name_of(text(row, "name", str(path)), f"{path}: camera {row['name']}")
                self._masks[name] = image_ref(row, "mask", path, f"{path}: camera {name}")
            else:
                self.specs.append(_view(row, path, count))
        names = self._names()
        if len(set(names)) != len(names):
            raise CaptureError(f"{path}: two cameras have the same name; names must differ", "camera")

    def index(self, row: dict[str, Any], image: ImageRef, where: str) -> int:
        """Return the index of an observation's camera: the named one, else its image's, else the first."""
        names = self._names()
        if "camera" not in row and self._poses is None:
            return 0
        wanted = text(row, "camera", where) if "camera" in row else row["image"]
        if wanted in names and (self._poses is None or wanted not in self._poses.cameras):
            return names.index(wanted)
        if self._poses is None:
            raise CaptureError(
                f"{where}: there is no camera '{wanted}'; its name must be one of {', '.join(names)}", "camera"
            )
        name = self._poses.name_of(wanted, where)
        first = wanted if "camera" in row else self._image_of.setdefault(name, wanted)
        if path_parts(first)[:-1] != path_parts(wanted)[:-1]:
            raise CaptureError(
                f"{where}: '{wanted}' and '{first}' both fit the camera '{name}' of {self._poses.path}; set camera for"
                " each",
                "camera",
            )
        if name not in names:
            self.specs.append(self._posed(self._poses, name))
            names.append(name)
        self._images.setdefault(name, []).append(image)
        return names.index(name)

    def _names(self) -> list[str]:
        return [view.name for view in self.specs]

    def _posed(self, poses: PoseFile, name: str) -> ViewSpec:
        camera, where = poses.cameras[name], f"{poses.path}: camera '{name}'"
        images, store = self._images.setdefault(name, []), ImageStore()

        def make(width: int, height: int) -> Camera:
            orientation = turn_of_camera(camera, _turn(images, store))
            return moved(upright_camera(camera, width, height, orientation, where), self._world)

        def doubt() -> str:
            return turn_doubt(poses, name, _turn(images, store), where)

        return ViewSpec(name, make, where, None, self._masks.get(name), True, foreign=True, doubt=doubt)


def _turn(images: list[ImageRef], store: ImageStore) -> Turn:
    """Return the turn of a camera's images, by the first that can be read: damaged ones may be left out."""
    for image in images[:-1]:
        with suppress(CaptureError):
            return store.turn(image) or Turn(1, 1)
    return store.turn(images[-1]) or Turn(1, 1)


def _poses(table: dict[str, Any], path: Path) -> PoseFile | None:
    return read_poses(path.parent / text(table, "cameras", str(path))) if "cameras" in table else None


def _world(table: dict[str, Any], path: Path, poses: PoseFile | None) -> np.ndarray:
    """Return the (4, 4) similarity from the world of the cameras file to the capture's."""
    if "cameras_matrix" not in table:
        return np.eye(4)
    if poses is None:
        raise CaptureError(f"{path}: cameras_matrix is for a file of cameras; add cameras, or remove it", "matrix")
    return similarity(_four_by_four(table["cameras_matrix"], f"{path}: cameras_matrix"), f"{path}: cameras_matrix")


def _view(row: dict[str, Any], path: Path, count: int) -> ViewSpec:
    where = f"{path}: camera {row.get('name', count)}"
    known_keys(row, _KNOWN, where)
    name = text(row, "name", where) if "name" in row else f"camera {count}"
    matrix = _matrix(row["matrix"], where) if "matrix" in row else None
    size = None
    if "width" in row or "height" in row:
        size = row.get("width", 0), row.get("height", 0)
        if not all(isinstance(v, int) and not isinstance(v, bool) and v > 0 for v in size):
            raise CaptureError(f"{where}: width and height must both be whole numbers above 0", "value")
    mask = image_ref(row, "mask", path, where) if "mask" in row else None
    placed = matrix is not None and not np.array_equal(matrix, np.eye(4))
    return ViewSpec(name, camera_maker(row, where, matrix), where, size, mask, placed, has_lens(row))


def _matrix(value: Any, where: str) -> np.ndarray:
    matrix = _four_by_four(value, f"{where}: matrix", ": camera to world")
    if not np.isfinite(matrix).all() or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise CaptureError(f"{where}: matrix must end with the row 0, 0, 0, 1; write it row by row", "matrix")
    if not is_rotation(matrix[:3, :3]):
        raise CaptureError(
            f"{where}: matrix must be a rotation and a position (it scales, mirrors or has no inverse);"
            " write the camera's matrix with its scale applied",
            "matrix",
        )
    return matrix


def _four_by_four(value: Any, where: str, what: str = "") -> np.ndarray:
    flat = sum(value, []) if isinstance(value, list) and all(isinstance(r, list) for r in value) else value
    if not isinstance(flat, list) or len(flat) != 16 or not all(map(is_number, flat)):
        raise CaptureError(f"{where} must be 16 numbers, row by row{what}", "matrix")
    return np.asarray(flat, float).reshape(4, 4)
