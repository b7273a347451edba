"""Readers of the camera files of COLMAP, Agisoft Metashape and AliceVision (Meshroom)."""

from .posed import PoseFile, moved, of_picture, similarity
from .read import read_poses

__all__ = ["PoseFile", "moved", "of_picture", "read_poses", "similarity"]
