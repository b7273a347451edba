"""Reads cameras of AliceVision, which Meshroom runs, from its JSON format: .sfm files.

AliceVision's sfmDataIO with its CHANGES.md: numbers are written as strings; from version 1.2.1 the principal point is
an offset from the image's middle, from 1.2.2 the focal length is in millimetres; matrices are written column by column,
and a pose's rotation is that of the world into the camera (x right, y down, z to the front). The centres of pixels have
whole coordinates, as in its image undistortion. Meshes are written with y and z negated since version 1.2.3.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..camera import is_rotation
from ..errors import CaptureError
from .posed import Lens, PoseFile, camera_from_vision, moved, stated_orientation

# Distortion model, by either of its names → OpenCV's names of its parameters, in order.
_DISTORTIONS = {
    "none": (),
    "pinhole": (),
    "radial1": ("k1",),
    "radialk1": ("k1",),
    "radial3": ("k1", "k2", "k3"),
    "radialk3": ("k1", "k2", "k3"),
    "brown": ("k1", "k2", "k3", "p1", "p2"),
}
_OFFSET_SINCE, _MILLIMETRES_SINCE, _MESH_TURNED_SINCE = (1, 2, 1), (1, 2, 2), (1, 2, 3)
_MESH_TURN = np.diag([1.0, -1.0, -1.0, 1.0])
_AGAIN = "write it again with Meshroom's ConvertSfMFormat, with views, intrinsics and extrinsics"


def read_alicevision(path: Path) -> PoseFile:
    """Return the cameras of a .sfm file in the world of the mesh that the same version writes.

    Views without a pose are unusable. Raises CaptureError if the file is damaged.
    """
    table = _parsed(path)
    version = tuple(int(value) for value in _numbers(table, "version", 3, str(path)))
    lenses = {_text(row, "intrinsicId", path): _lens(row, version, path) for row in _rows(table, "intrinsics", path)}
    poses = {_text(row, "poseId", path): _pose(row, path) for row in _rows(table, "poses", path)}
    cameras, unusable = {}, {}
    orientations: dict[str, int] = {}
    for view in _rows(table, "views", path):
        name = _text(view, "path", path)
        where = f"{path}: view '{name}'"
        if name in cameras or name in unusable:
            raise CaptureError(f"{where}: is there twice; {_AGAIN}", "camera")
        lens, pose = lenses.get(str(view.get("intrinsicId"))), poses.get(str(view.get("poseId")))
        if lens is None:
            unusable[name] = "has no intrinsics; run StructureFromMotion"
        elif "rigId" in view and str(view.get("isPoseIndependant", "true")).lower() in ("false", "0"):
            unusable[name] = "is part of a rig, whose poses are not read; switch rigs off in CameraInit"
        elif pose is None:
            unusable[name] = "was not aligned; give the .sfm that StructureFromMotion wrote"
        elif isinstance(lens, str):
            unusable[name] = lens
        else:
            camera = camera_from_vision(*lens, *pose)
            cameras[name] = moved(camera, _MESH_TURN) if version >= _MESH_TURNED_SINCE else camera
            tags = view["metadata"] if isinstance(view.get("metadata"), dict) else {}
            orientations |= stated_orientation(name, tags.get("Exif:Orientation", tags.get("Orientation")))
    return PoseFile(path, "AliceVision", cameras, unusable, orientations)


def _parsed(path: Path) -> dict[str, Any]:
    try:
        table = json.loads(path.read_text(encoding="utf-8-sig"))
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise CaptureError(f"{path}: is cut short or no JSON ({error}); {_AGAIN}", "not_text") from error
    if not isinstance(table, dict) or "views" not in table:
        raise CaptureError(f"{path}: is no file of AliceVision's (it has no views); {_AGAIN}", "kind")
    return table


def _lens(row: dict[str, Any], version: tuple[int, ...], path: Path) -> Lens | str:
    """Return (size, focal length, centre, distortion), or the reason why the intrinsics are unsupported."""
    where = f"{path}: intrinsics {row.get('intrinsicId')}"
    kind = str(row.get("type", "")).lower()
    # In files with distortionType, type is that of the projection.
    distortion, reverse = (
        str(row.get(key, default)).lower() for key, default in (("distortionType", kind), ("undistortionType", "none"))
    )
    odd = next(
        (name for name in (kind, distortion) if name not in _DISTORTIONS), reverse if reverse != "none" else None
    )
    if odd is not None:
        return f"has intrinsics of type '{odd}', which is not read; choose pinhole, radialk1, radialk3 or brown"
    names = _DISTORTIONS[distortion]
    if abs(float(_value(row.get("pixelRatio", 1), f"{where}: pixelRatio")) - 1) > 1e-6:
        return "has oblong pixels (pixelRatio), which are not read; lock the ratio to 1 in CameraInit"
    width, height = _value(row.get("width"), f"{where}: width"), _value(row.get("height"), f"{where}: height")
    focal = _focal(row, version, width, where)
    if min(width, height, *focal) <= 0 or width % 1 or height % 1:
        raise CaptureError(f"{where}: size and focal length must be above 0; {_AGAIN}", "camera")
    x, y = _numbers(row, "principalPoint", 2, where)
    if version >= _OFFSET_SINCE:
        x, y = x + width / 2, y + height / 2
    values = _numbers(row, "distortionParams", len(names), where) if row.get("distortionParams") else [0.0] * len(names)
    by_name = dict(zip(names, values, strict=True))
    coefficients = tuple(by_name.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3"))
    return (int(width), int(height)), focal, (x + 0.5, y + 0.5), coefficients


def _focal(row: dict[str, Any], version: tuple[int, ...], width: float, where: str) -> tuple[float, float]:
    """Return the focal length along x and y in pixels."""
    if version >= _MILLIMETRES_SINCE:
        sensor = _value(row.get("sensorWidth"), f"{where}: sensorWidth")
        if sensor <= 0:
            raise CaptureError(f"{where}: sensorWidth must be above 0; {_AGAIN}", "camera")
        return (_value(row.get("focalLength"), f"{where}: focalLength") / sensor * width,) * 2
    focal = row.get("pxFocalLength")
    if isinstance(focal, list):
        x, y = _numbers(row, "pxFocalLength", 2, where)
        return x, y
    return (_value(focal, f"{where}: pxFocalLength"),) * 2


def _pose(row: dict[str, Any], path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation (3, 3), camera to world, and position (3,)."""
    where = f"{path}: pose {row.get('poseId')}"
    pose = row.get("pose")
    transform = pose.get("transform") if isinstance(pose, dict) else None
    if not isinstance(transform, dict):
        raise CaptureError(f"{where}: has no transform; {_AGAIN}", "camera")
    # World to camera in column order is camera to world in row order.
    rotation = np.reshape(_numbers(transform, "rotation", 9, where), (3, 3))
    if not is_rotation(rotation):
        raise CaptureError(f"{where}: its rotation scales or mirrors; {_AGAIN}", "matrix")
    return rotation, np.array(_numbers(transform, "center", 3, where))


def _rows(table: dict[str, Any], key: str, path: Path) -> list[dict[str, Any]]:
    rows = table.get(key) or []
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise CaptureError(f"{path}: its {key} are no list; {_AGAIN}", "kind")
    return rows


def _text(row: dict[str, Any], key: str, path: Path) -> str:
    if key not in row:
        raise CaptureError(f"{path}: an entry has no {key}; {_AGAIN}", "kind")
    return str(row[key])


def _numbers(row: dict[str, Any], key: str, count: int, where: str) -> list[float]:
    values = row.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise CaptureError(f"{where}: {key} must be {count} numbers; {_AGAIN}", "not_number")
    return [_value(value, f"{where}: {key}") for value in values]


def _value(value: Any, where: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise CaptureError(f"{where} must be a number; {_AGAIN}", "not_number") from error
    if not np.isfinite(number):
        raise CaptureError(f"{where} must be a finite number; {_AGAIN}", "not_number")
    return number
