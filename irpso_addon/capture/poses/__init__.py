"""Cameras as photogrammetry programs write them: COLMAP, Agisoft Metashape, AliceVision (Meshroom)."""

from .posed import PoseFile, moved, of_picture, similarity
from .read import read_poses

__all__ = ["PoseFile", "moved", "of_picture", "read_poses", "similarity"]
