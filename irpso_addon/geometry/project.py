"""Carrying camera images into texels: where each texel falls in an image, and whether it is seen there."""

from __future__ import annotations

import numpy as np

from ..capture.camera import Camera
from .bake import SurfaceBake

GRAZING = 0.1  # cosine between the face's normal and the view below which a texel counts as not seen
# Surface that lies within this many pixels (in the world's units, at the texel) of the texel's own plane is the same
# surface. Measured across the plane, so along the view it already grows with the slope.
_SAME_SURFACE = 0.5
# Surfaces that meet at more than 60° are two, however near: their radiances do not mix.
_SAME_FACING = 0.5
# float32 positions of a world are known to about this part of its largest coordinate.
_ROUNDING = 4e-7
# A texel this near a row or column of pixel centres reads only that, so that no neighbour with no weight spoils it.
_SNAP = 1e-3
_BLOCK = 1 << 18  # texels worked on at a time, which bounds the memory of the float64 arithmetic


class Projector:
    """Where the texels of a bake are seen by one camera; ``sample`` reads an image there.

    bake: the texels. seen: what the camera's pixels show of the same mesh (``bake_camera``). grazing: the least cosine
    between face normal and view, 0…1. visible: (h, w) bool, the texels that the camera sees: inside the image by half a
    pixel (four pixel centres around them), not hidden by another part of the mesh, not grazing, and with all the pixel
    centres that matter on the texel's own surface.
    """

    def __init__(self, bake: SurfaceBake, seen: SurfaceBake, camera: Camera, grazing: float = GRAZING):
        self.camera = camera
        self._shape = bake.coverage.shape
        self._texels = np.flatnonzero(bake.coverage)
        self._first = np.zeros(len(self._texels), np.int32)
        self._fraction = np.zeros((len(self._texels), 2), np.float32)
        keep = np.zeros(len(self._texels), bool)
        for start in range(0, len(keep), _BLOCK):
            block = slice(start, start + _BLOCK)
            keep[block] = self._look(bake, seen, grazing, block)
        self._texels, self._first = self._texels[keep], self._first[keep]
        self._fraction = self._fraction[keep]

    @property
    def visible(self) -> np.ndarray:
        """(h, w) bool: the texels that the camera sees."""
        visible = np.zeros(self._shape, bool)
        visible.ravel()[self._texels] = True
        return visible

    def sample(self, image: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
        """Return (h, w, 4) float32: an image's radiance at the texels and its weight in alpha, 0 where it says nothing.

        image: (H, W, 4) of the camera's size, weight in alpha. mask: (H, W) bool, None for all of it. Between pixel
        centres radiance and weight are interpolated; where one of the pixels that count has no weight (clipped,
        outside the mask, not a number) the texel has none either.
        """
        if image.shape != (self.camera.height, self.camera.width, 4):
            raise ValueError(f"the image is {image.shape}, the camera {self.camera.height} × {self.camera.width} × 4")
        pixels = np.asarray(image, np.float32).reshape(-1, 4)
        stack = np.zeros((self._shape[0] * self._shape[1], 4), np.float32)
        for start in range(0, len(self._texels), _BLOCK):
            block = slice(start, start + _BLOCK)
            total = np.zeros((len(self._texels[block]), 4), np.float32)
            usable = np.ones(len(total), bool)
            for tap, weight in self._taps(block):
                counts = weight > 0
                values = pixels[tap]
                if mask is not None:
                    values[:, 3] *= mask.ravel()[tap]
                usable &= ~counts | ((values[:, 3] > 0) & np.isfinite(values).all(axis=1))
                total += np.where(counts[:, None], values * weight[:, None], 0)
            total[~usable] = 0
            stack[self._texels[block]] = total
        return stack.reshape(*self._shape, 4)

    def _taps(self, block: slice):
        """Yield flat pixel indices and weights of the four pixels around each texel of a block."""
        width = self.camera.width
        first, (x, y) = self._first[block], self._fraction[block].T
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            weight = (x if dx else 1 - x) * (y if dy else 1 - y)
            # A pixel of weight 0 may lie beyond the image's edge: the first stands in for it.
            yield np.where(weight > 0, first + dx + dy * width, first), weight

    def _look(self, bake: SurfaceBake, seen: SurfaceBake, grazing: float, block: slice) -> np.ndarray:
        """Fill in pixels and weights of a block of texels and return which of them are seen."""
        camera, texels = self.camera, self._texels[block]
        points = bake.position.reshape(-1, 3)[texels].astype(np.float64)
        faces = bake.face_normal.reshape(-1, 3)[texels].astype(np.float64)
        place, depth = camera.project(points)
        place -= 0.5
        nearest = np.rint(place)
        place = np.where(np.abs(place - nearest) < _SNAP, nearest, place)
        limit = np.array([camera.width - 1, camera.height - 1])
        inside = ((place >= 0) & (place <= limit)).all(axis=1) & ((depth > 0) | (not camera.perspective))
        corner = np.floor(np.where(inside[:, None], place, 0)).astype(np.int64)
        self._first[block] = corner[:, 0] + corner[:, 1] * camera.width
        self._fraction[block] = np.where(inside[:, None], place - corner, 0)

        cosine = np.einsum("ij,ij->i", faces, _toward(camera, points))
        visible = inside & (cosine > 0) & (cosine >= grazing)
        pixel = (depth if camera.perspective else np.ones_like(depth)) / min(camera.scale)
        tolerance = _SAME_SURFACE * pixel + _ROUNDING * np.abs(seen.position).max()
        numbers = bake.triangle.ravel()[texels]
        for tap, weight in self._taps(block):
            visible &= (weight <= 0) | _same_surface(seen, tap, numbers, points, faces, tolerance)
        return visible


def _toward(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Return (N, 3) unit vectors from the points toward the camera."""
    if not camera.perspective:
        return np.broadcast_to(camera.backward, points.shape)
    toward = camera.position - points
    return toward / np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-30)


def _same_surface(
    seen: SurfaceBake,
    tap: np.ndarray,
    numbers: np.ndarray,
    points: np.ndarray,
    faces: np.ndarray,
    tolerance: np.ndarray,
) -> np.ndarray:
    """Return whether what a pixel shows continues the surface at the points: same triangle, or near and facing alike.

    Nearness is measured along the mean of the two normals: along it a chord of an evenly curved surface has no extent,
    so curvature does not look like a gap.
    """
    number = seen.triangle.ravel()[tap]
    normal = seen.face_normal.reshape(-1, 3)[tap].astype(np.float64)
    alike = np.einsum("ij,ij->i", normal, faces)
    mean = normal + faces
    gap = np.einsum("ij,ij->i", seen.position.reshape(-1, 3)[tap] - points, mean)
    gap = np.abs(gap) / np.maximum(np.linalg.norm(mean, axis=1), 1e-30)
    return (number == numbers) | ((number >= 0) & (alike > _SAME_FACING) & (gap <= tolerance))
