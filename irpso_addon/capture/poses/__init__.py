"""Readers of the camera files of COLMAP, Agisoft Metashape and AliceVision (Meshroom)."""

from .posed import PoseFile, moved, path_parts, similarity, upright_camera
from .read import read_poses

__all__ = ["PoseFile", "moved", "path_parts", "read_poses", "similarity", "upright_camera"]
