"""Cameras: projection of world points to pixels, and view directions."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from . import distortion as lens
from .errors import CaptureError

_RIGID = 1e-4  # largest entry of RᵀR − I in a rotation R: files print six digits


def is_rotation(axes: np.ndarray) -> bool:
    """Return whether a (3, 3) matrix is a rotation, to within 1e-4."""
    return bool(np.abs(axes.T @ axes - np.eye(3)).max() <= _RIGID and np.linalg.det(axes) > 0)


@dataclass(frozen=True)
class Camera:
    """A pinhole or orthographic camera with square or oblong pixels; a perspective one may have lens distortion.

    Axes are Blender's: x right, y up, z toward the viewer (the camera looks along −z). Pixel coordinates start at the
    lower left corner of the lower left pixel, whose centre is (0.5, 0.5).

    width, height: pixels. matrix: (4, 4) camera to world, float64. scale: (2,) the focal length in pixels of a
    perspective camera, or pixels per world unit of an orthographic one. centre: (2,) principal point in pixels.
    distortion: the Brown–Conrady coefficients k1, k2, p1, p2, k3, k4, k5, k6 of OpenCV's formulas (``distortion.py``),
    trailing ones may be omitted; empty for none. Raises InputError if they are too many or not finite, or the
    camera is orthographic.
    """

    width: int
    height: int
    scale: tuple[float, float]
    centre: tuple[float, float]
    matrix: np.ndarray = field(default_factory=lambda: np.eye(4))
    perspective: bool = True
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.distortion) > len(lens.NAMES) or not all(map(math.isfinite, self.distortion)):
            raise CaptureError(f"distortion must be up to 8 finite numbers: {', '.join(lens.NAMES)}", "camera")
        if self.distortion and not self.perspective:
            raise CaptureError("an orthographic camera has no lens distortion; undistort its images", "camera")

    @staticmethod
    def from_fov(width: int, height: int, fov_degrees: float, matrix: np.ndarray | None = None) -> Camera:
        """Return a centred perspective camera; ``fov_degrees`` is the full angle over the image's width."""
        focal = 0.5 * width / math.tan(math.radians(fov_degrees) / 2)
        return Camera(width, height, (focal, focal), (width / 2, height / 2), np.eye(4) if matrix is None else matrix)

    @staticmethod
    def orthographic(width: int, height: int, world_width: float, matrix: np.ndarray | None = None) -> Camera:
        """Return a centred orthographic camera whose image is ``world_width`` units wide."""
        scale = width / world_width
        return Camera(
            width, height, (scale, scale), (width / 2, height / 2), np.eye(4) if matrix is None else matrix, False
        )

    @property
    def key(self) -> tuple[object, ...]:
        """All fields, hashable: cameras with equal keys are equal."""
        lens = (self.width, self.height, *self.scale, *self.centre, self.perspective, self.distortion)
        return (*lens, np.asarray(self.matrix, np.float64).tobytes())

    @property
    def position(self) -> np.ndarray:
        """(3,) the camera's position in the world."""
        return self.matrix[:3, 3]

    @property
    def backward(self) -> np.ndarray:
        """(3,) unit vector from the scene toward the camera, along its axis."""
        axis = self.matrix[:3, 2]
        return axis / np.linalg.norm(axis)

    @property
    def view(self) -> np.ndarray:
        """(4,) for shaders: the position and 1, or the direction toward the camera and 0."""
        return np.append(self.position, 1.0) if self.perspective else np.append(self.backward, 0.0)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixel coordinates (…, 2) and depth (…) along the axis, in world units, of world points (…, 3).

        Points behind a perspective camera have depth ≤ 0 and undefined pixels; points beyond the field of a lens with
        distortion have NaN.
        """
        inverse = np.linalg.inv(self.matrix)
        local = points @ inverse[:3, :3].T + inverse[:3, 3]
        depth = -local[..., 2]
        plane = local[..., :2]
        if self.perspective:
            plane = plane / np.where(depth > 0, depth, np.inf)[..., None]
        if any(self.distortion):
            plane = lens.distorted(plane, self.distortion)
        return plane * np.asarray(self.scale) + np.asarray(self.centre), depth

    def points(self, depth: float = 1.0) -> np.ndarray:
        """Return (H, W, 3) the world points at ``depth`` on the rays of the pixel centres, row 0 at the bottom.

        NaN for pixels beyond the radius at which the distortion folds back.
        """
        x = (np.arange(self.width) + 0.5 - self.centre[0]) / self.scale[0]
        y = (np.arange(self.height) + 0.5 - self.centre[1]) / self.scale[1]
        plane = np.stack(np.meshgrid(x, y), axis=-1)
        if any(self.distortion):
            plane = lens.undistorted(plane, self.distortion)
        if self.perspective:
            plane = plane * depth
        local = np.concatenate([plane, np.full((*plane.shape[:2], 1), -depth)], axis=-1)
        return local @ self.matrix[:3, :3].T + self.matrix[:3, 3]
