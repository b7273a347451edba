"""Readers of the camera files of COLMAP, Agisoft Metashape and AliceVision (Meshroom)."""

from .posed import PoseFile, moved, similarity, upright_camera
from .read import read_poses

__all__ = ["PoseFile", "moved", "upright_camera", "read_poses", "similarity"]
