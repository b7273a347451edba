"""Readers of the camera files of COLMAP, Agisoft Metashape and AliceVision (Meshroom)."""

from .posed import PoseFile, moved, path_parts, similarity, turn_doubt, turn_of_camera, upright_camera
from .read import read_poses

__all__ = [
    "PoseFile",
    "moved",
    "path_parts",
    "read_poses",
    "similarity",
    "turn_doubt",
    "turn_of_camera",
    "upright_camera",
]
