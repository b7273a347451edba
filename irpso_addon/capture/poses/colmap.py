"""Reads cameras of COLMAP (Schönberger and Frahm 2016) from its text format: cameras.txt and images.txt.

COLMAP's documentation, "Output Format" and "Camera Models": poses are quaternion and translation from world to camera,
x right, y down, z to the front; the upper left pixel's centre is (0.5, 0.5). On models that COLMAP 4.2.1 wrote,
projections through all six lenses agree with its own within 2e-13 pixels.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import CaptureError
from ..formats.lists import numbers, read_text
from .posed import Lens, PoseFile, camera_from_vision

CAMERAS, IMAGES = "cameras.txt", "images.txt"
# Folders below a project in which COLMAP itself writes the two files.
_PLACES = (".", "sparse/0", "sparse")
# Model → names of its parameters, in order.
_MODELS = {
    "SIMPLE_PINHOLE": ("f", "cx", "cy"),
    "PINHOLE": ("fx", "fy", "cx", "cy"),
    "SIMPLE_RADIAL": ("f", "cx", "cy", "k1"),
    "RADIAL": ("f", "cx", "cy", "k1", "k2"),
    "OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}
_COUNT = re.compile(r"#\s*Number of (?:cameras|images):\s*(\d+)")
_UNIT = 0.01  # tolerance of a quaternion's length: COLMAP writes 17 digits, people fewer
_AGAIN = "export the model as text again"


def read_colmap(folder: Path) -> PoseFile:
    """Return the cameras of a folder with cameras.txt and images.txt, or with them below in sparse/0 or sparse.

    Raises CaptureError if they are missing or damaged.
    """
    model = next((folder / place for place in _PLACES if (folder / place / CAMERAS).is_file()), None)
    if model is None:
        binary = any((folder / place / "cameras.bin").is_file() for place in _PLACES)
        remedy = "export the model as text (File > Export model as text)" if binary else "give the folder that holds it"
        raise CaptureError(f"{folder}: has no {CAMERAS}; {remedy}", "missing")
    lenses = _lenses(model / CAMERAS)
    cameras, unusable = {}, {}
    for where, words in _images(model / IMAGES):
        name, lens = words[9].strip(), lenses.get(words[8])
        if lens is None:
            raise CaptureError(f"{where}: {CAMERAS} has no camera {words[8]}; {_AGAIN}", "camera")
        if name in cameras or name in unusable:
            raise CaptureError(f"{where}: '{name}' is listed twice; {_AGAIN}", "camera")
        rotation, position = _pose(_finite(words[1:8], where), where)
        if isinstance(lens, str):
            unusable[name] = lens
        else:
            cameras[name] = camera_from_vision(*lens, rotation, position)
    return PoseFile(model, "COLMAP", cameras, unusable)


def _lenses(path: Path) -> dict[str, Lens | str]:
    """Return number → (size, focal length, centre, distortion), or the reason why the model is unsupported."""
    lenses: dict[str, Lens | str] = {}
    for where, line in _lines(path):
        words = line.split()
        if len(words) < 4:
            raise CaptureError(f"{where}: is no camera (number, model, width, height, parameters); {_AGAIN}", "camera")
        model = words[1]
        if words[0] in lenses:
            raise CaptureError(f"{where}: camera {words[0]} is listed twice; {_AGAIN}", "camera")
        if model not in _MODELS:
            lenses[words[0]] = f"is of model {model}, which is not read; undistort in COLMAP, or choose OPENCV there"
            continue
        values = _finite(words[2:], where)
        names = _MODELS[model]
        if len(values) != 2 + len(names):
            raise CaptureError(
                f"{where}: {model} has {len(names)} parameters ({', '.join(names)}), not {len(values) - 2}; {_AGAIN}",
                "camera",
            )
        by_name = dict(zip(names, values[2:], strict=True))
        focal = (by_name["fx"], by_name["fy"]) if "fx" in by_name else (by_name["f"], by_name["f"])
        if min(*values[:2], *focal) <= 0 or any(value % 1 for value in values[:2]):
            raise CaptureError(f"{where}: size and focal length must be above 0; {_AGAIN}", "camera")
        distortion = tuple(by_name.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"))
        lenses[words[0]] = (int(values[0]), int(values[1])), focal, (by_name["cx"], by_name["cy"]), distortion
    return lenses


def _images(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield (place, ten words) of each image's first line; skips the second, its points, which may be missing."""
    points_next = False
    for where, line in _lines(path):
        if points_next and _is_points(line):
            points_next = False
            continue
        words = line.split(maxsplit=9)
        if len(words) != 10:
            raise CaptureError(f"{where}: is neither an image (ten words) nor an image's points; {_AGAIN}", "camera")
        yield where, words
        points_next = True


def _is_points(line: str) -> bool:
    """Return whether a line holds points, X Y POINT3D_ID each; tests the first and the last."""
    words = line.split()
    try:
        numbers([*words[:3], *words[-3:]], "")
    except CaptureError:  # a name
        return False
    return len(words) % 3 == 0


def _lines(path: Path) -> list[tuple[str, str]]:
    """Return (place, text) of all lines except empty ones and comments. Checks their number against the comment's."""
    rows = [(f"{path}: line {n}", line.strip()) for n, line in enumerate(read_text(path, _AGAIN).splitlines(), 1)]
    lines = [(where, line) for where, line in rows if line and not line.startswith("#")]
    stated = next((int(match[1]) for _, line in rows if (match := _COUNT.match(line))), None)
    listed = len([line for _, line in lines if path.name != IMAGES or not _is_points(line)])
    if stated is not None and stated != listed:
        raise CaptureError(f"{path}: says it lists {stated} and lists {listed}; it is cut short: {_AGAIN}", "count")
    return lines


def _pose(values: list[float], where: str) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation (3, 3), camera to world, and position (3,) of QW QX QY QZ TX TY TZ."""
    quaternion, translation = np.array(values[:4]), np.array(values[4:])
    length = np.linalg.norm(quaternion)
    if abs(length - 1) > _UNIT:
        raise CaptureError(f"{where}: the quaternion has length {length:.3g}, not 1; {_AGAIN}", "camera")
    w, (x, y, z) = quaternion[0] / length, quaternion[1:] / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    # Rodrigues' formula in a unit quaternion; the transpose of world to camera is camera to world.
    rotation = (np.eye(3) + 2 * w * cross + 2 * cross @ cross).T
    return rotation, -rotation @ translation


def _finite(words: list[str], where: str) -> list[float]:
    values = numbers(words, where)
    if not np.isfinite(values).all():
        raise CaptureError(f"{where}: holds a value that is no finite number; {_AGAIN}", "not_number")
    return values
