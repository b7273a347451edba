"""Reads camera files of other programs: ``read_poses`` detects the program from the path."""

from __future__ import annotations

from pathlib import Path

from ..distortion import MAX_COEFFICIENT
from ..errors import CaptureError
from . import alicevision, colmap, metashape
from .posed import PoseFile

_KINDS = "cameras are read from a COLMAP folder (cameras.txt, images.txt), Metashape's .xml, or AliceVision's .sfm"


def read_poses(path: Path | str) -> PoseFile:
    """Read the cameras of COLMAP (text), Agisoft Metashape (.xml) or AliceVision, as in Meshroom (.sfm, .json).

    The world is that of the program's exported mesh. Raises CaptureError naming the file and the remedy if it is
    missing, damaged or holds no usable camera.
    """
    path = Path(path)
    try:
        if not path.exists():
            raise CaptureError(f"{path}: is not there; {_KINDS}", "missing")
        if path.is_dir() or path.name.lower() in (colmap.CAMERAS, colmap.IMAGES):
            poses = colmap.read_colmap(path if path.is_dir() else path.parent)
        elif path.suffix.lower() == ".xml":
            poses = metashape.read_metashape(path)
        elif path.suffix.lower() in (".sfm", ".json"):
            poses = alicevision.read_alicevision(path)
        else:
            raise CaptureError(f"{path}: is no file of cameras; {_KINDS}", "kind")
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read ({error.strerror}); check its permissions", "missing") from error
    if not poses.cameras:
        name, why = next(iter(poses.unusable.items()), ("", ""))
        what = f"none of its cameras can be used: '{name}' {why}" if why else "holds no camera; align the photographs"
        raise CaptureError(f"{path}: {what}", "camera")
    for name, camera in poses.cameras.items():
        if max(map(abs, camera.distortion), default=0) > MAX_COEFFICIENT:
            raise CaptureError(
                f"{path}: camera '{name}': its distortion is no lens's; export the cameras again", "camera"
            )
    return poses
