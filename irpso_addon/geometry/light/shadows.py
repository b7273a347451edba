"""Cast and attached shadows that the mesh predicts: the visible fraction of a light at each texel.

A shadow map (Williams 1978, Casting curved shadows on curved surfaces) with triangle numbers in place of depths. A
texel is compared with the plane of the triangle that the light sees, at the texel's own place: a slope alone cannot
make a surface shade itself, and the bias is a distance perpendicular to the plane.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ...capture.camera import Camera
from ...capture.types import Light
from ..project import ROUNDING, blocks, filled
from ..surface.bake import SurfaceBake, camera_triangles
from ..surface.footprint import texel_steps
from ..surface.mesh import MeshData

_PIXELS_A_TEXEL = 1.5  # along a side: the weight changes from lit to dark within two texels
_MIN_SIDE, _MAX_SIDE = 256, 4096  # pixels along a side of a map
_BORDER = 2  # pixels of a map around its content
_WIDEST = math.radians(50)  # largest half-angle of one map of a near light
# A plane shades a texel that lies more than a pixel behind it, measured perpendicular to the plane. With half a pixel
# 0.6 to 1.5 % of the lit head scan counted as shaded, nearly all at n·l < 0.2; with one pixel under 1 %.
_BIAS = 1.0
# A plane seen edge-on also shades when it is this many pixels nearer to the light.
_FARTHEST = 8.0
# Cosine to the light, below zero, at which a face's weight reaches 0: 95 % of the normals in the head scan's normal map
# are within 7° of the mesh's own, so faces turned away by less may still be lit.
_TURNED = 0.12
# Cosines from face to light between which the rise of a texel falls from the whole to none. On a convex surface the
# neighbours shade a face that is turned to the light only within the map's resolution: there a rise up to a texel's
# width remains. More lifts texels out of cast shadows. (Cycles limits its terminator offset to cosines under 0.1, too.)
_TERMINATOR = 0.0, 0.1
# Cosines from face to corner normal between which the rise grows from nothing to whole: the edge of a box, 45°, has
# none; an icosahedron as a coarse ball, 37°, has the whole.
_SHARP = 0.71, 0.79


class ShadowCaster:
    """Shadows of a mesh under the lights of a capture; ``weights`` draws one shadow map at a time.

    mesh: all of its triangles and its occluders cast shadows. bake: the texels that receive them. texel: a texel's
    width in the world (``texel_size``); maps have about 1.5 pixels per texel along each side, 256 to 4096 in all. They
    show the mesh, and of the occluders what stands before or behind it.
    """

    def __init__(self, mesh: MeshData, bake: SurfaceBake, texel: float):
        self._mesh, self._bake, self._texel = mesh, bake, texel
        corners = mesh.opaque.astype(np.float64)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
        offset = -np.einsum("ij,ij->i", across, corners[:, 0])
        self._planes = np.concatenate([across, offset[:, None]], axis=1)
        own = corners[: len(mesh.positions)]
        self._rounding = ROUNDING * float(np.abs(own).max())  # of the texels: an occluder may be far larger
        self._centre = (own.min(axis=(0, 1)) + own.max(axis=(0, 1))) / 2
        self._radius = float(np.linalg.norm(own - self._centre, axis=-1).max())
        self._rise = _rise(mesh, bake)

    def weights(self, light: Light, texels: np.ndarray) -> np.ndarray:
        """Return (N,) float32 the weight of each texel's sample under a light: 1 lit, 0 in shadow.

        texels: (N,) flat indices into the bake. At the border of a cast shadow the weight is 2 s − 1, where s is the
        lit share of the four map pixels around the texel: a half shaded sample errs by half. Where both the face and
        the shading normal turn away from the light, the weight falls to 0 at 7°.
        """
        result = self._attached(light, texels)
        planes = self._planes_facing(light)
        for view, chosen in self._views(light, texels, np.flatnonzero(result > 0)):
            numbers = camera_triangles(self._mesh, view)
            for part in blocks(chosen):
                lit = self._lit(light, view, numbers, planes, texels[filled(part)])
                result[part] *= np.clip(2 * lit - 1, 0, 1)[: len(part)]
        return result

    def _attached(self, light: Light, texels: np.ndarray) -> np.ndarray:
        """Return (N,) float32 weights of attached shadow, 0…1."""
        result = np.zeros(len(texels), np.float32)
        for part in blocks(np.arange(len(texels))):
            block = texels[filled(part)]
            toward = _toward(light, self._bake.position.reshape(-1, 3)[block].astype(np.float64))
            cosines = [
                np.einsum("ij,ij->i", normals.reshape(-1, 3)[block].astype(np.float64), toward)
                for normals in (self._bake.face_normal, self._bake.normal)
            ]
            result[part] = np.clip(1 + np.maximum(*cosines) / _TURNED, 0, 1)[: len(part)]
        return result

    def _points(self, light: Light, texels: np.ndarray) -> np.ndarray:
        """Return (N, 3) float64 positions of texels, at the terminator on the curved surface."""
        points = self._bake.position.reshape(-1, 3)[texels].astype(np.float64)
        faces = self._bake.face_normal.reshape(-1, 3)[texels].astype(np.float64)
        cosine = np.einsum("ij,ij->i", faces, _toward(light, points))
        rise = self._rise[texels]
        small = np.clip(2 - np.linalg.norm(rise, axis=1) / max(self._texel, 1e-30), 0, 1)
        return points + np.maximum(small, 1 - _ramp(cosine, _TERMINATOR))[:, None] * rise

    def _views(self, light: Light, texels: np.ndarray, left: np.ndarray) -> Iterator[tuple[Camera, np.ndarray]]:
        """Yield cameras at the light, each with the remaining texels that it covers."""
        if not len(left):
            return
        vector = np.asarray(light.vector, np.float64)
        if light.distant:
            toward = vector / np.linalg.norm(vector)
            size = self._size(2 * self._radius)
            scale = (size - 2 * _BORDER) / (2 * max(self._radius, 1e-30))
            place = self._centre + 2 * self._radius * toward
            yield Camera(size, size, (scale, scale), (size / 2, size / 2), _camera_matrix(place, toward), False), left
            return
        away = vector - self._centre
        distance = float(np.linalg.norm(away))
        if distance * math.sin(_WIDEST) > self._radius:
            half = math.tan(math.asin(self._radius / distance))
            yield _perspective(vector, away / distance, half, self._size(2 * half * distance)), left
            return
        # For a light inside: the six sides of a cube.
        size = self._size(2 * (distance + self._radius))
        side = np.empty(len(left), np.uint8)
        for part in blocks(np.arange(len(left))):
            points = self._points(light, texels[left[part]]) - vector
            longest = np.abs(points).argmax(axis=1)
            side[part] = 2 * longest + (np.take_along_axis(points, longest[:, None], axis=1)[:, 0] < 0)
        for number in range(6):
            if (side == number).any():
                backward = np.zeros(3)
                backward[number // 2] = 1 if number % 2 else -1
                yield _perspective(vector, backward, 1.0, size), left[side == number]

    def _size(self, width: float) -> int:
        """Return the pixels along a side of a map that is ``width`` wide in the world."""
        return int(np.clip(math.ceil(_PIXELS_A_TEXEL * width / max(self._texel, 1e-30)), _MIN_SIDE, _MAX_SIDE))

    def _planes_facing(self, light: Light) -> np.ndarray:
        """Return (T, 4) the planes of the triangles, with the light on their positive side."""
        vector = np.asarray(light.vector, np.float64)
        height = self._planes[:, :3] @ vector + (0 if light.distant else self._planes[:, 3])
        return self._planes * np.where(height < 0, -1.0, 1.0)[:, None]

    def _lit(
        self, light: Light, view: Camera, numbers: np.ndarray, planes: np.ndarray, texels: np.ndarray
    ) -> np.ndarray:
        """Return (N,) the lit share of the map pixels around each texel."""
        own = self._bake.triangle.ravel()[texels]
        points = self._points(light, texels)
        place, depth = view.project(points)
        place = np.clip(place - 0.5, 0, [view.width - 1.001, view.height - 1.001])
        corner = np.floor(place).astype(np.int64)
        x, y = (place - corner).T
        first = corner[:, 0] + corner[:, 1] * view.width
        pixel = (depth if view.perspective else np.ones_like(depth)) / view.scale[0]
        toward = _toward(light, points)
        lit = np.ones(len(texels))
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            weight = (x if dx else 1 - x) * (y if dy else 1 - y)
            number = numbers.ravel()[first + dx + dy * view.width]
            other = np.flatnonzero((number >= 0) & (number != own))
            plane, point = planes[number[other]], points[other]
            height = np.einsum("ij,ij->i", plane[:, :3], point) + plane[:, 3]
            slope = np.einsum("ij,ij->i", plane[:, :3], toward[other])
            bias = pixel[other] * np.minimum(_BIAS, _FARTHEST * np.abs(slope)) + self._rounding
            lit[other] -= weight[other] * (height < -bias)
        return lit


def texel_size(mesh: MeshData, bake: SurfaceBake) -> float:
    """Return a texel's width in the world: the root of the mean area of all covered texels."""
    height, width = bake.coverage.shape
    steps = texel_steps(mesh, width, height)
    areas = np.linalg.norm(np.cross(steps[:, 0], steps[:, 1]), axis=1)
    counts = np.bincount(bake.triangle[bake.coverage], minlength=len(areas))
    return math.sqrt(float((areas * counts).sum()) / max(int(counts.sum()), 1))


def _rise(mesh: MeshData, bake: SurfaceBake) -> np.ndarray:
    """Return (H · W, 3) float32: the way from flat triangles to the curved surface of the shading normals.

    Without it the facets of a smooth mesh shade each other near the terminator (Hanika 2021, Hacking the shadow
    terminator): a point rises by its depth below the planes at the corners.
    """
    rise = np.zeros((bake.coverage.size, 3), np.float32)
    for part in blocks(np.flatnonzero(bake.coverage)):
        numbers = bake.triangle.ravel()[part]
        corners, normals = mesh.positions[numbers].astype(np.float64), mesh.normals[numbers].astype(np.float64)
        points = bake.position.reshape(-1, 3)[part].astype(np.float64)
        faces = bake.face_normal.reshape(-1, 3)[part].astype(np.float64)
        below = np.minimum(np.einsum("nkj,nkj->nk", points[:, None] - corners, normals), 0)
        below *= _ramp(np.einsum("nj,nkj->nk", faces, normals), _SHARP)
        rise[part] = -np.einsum("nk,nkj->nj", corner_weights(corners, points) * below, normals)
    return rise


def _ramp(values: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    """Return 0 below the first end, 1 above the second, linear between."""
    return np.clip((values - ends[0]) / (ends[1] - ends[0]), 0, 1)


def _toward(light: Light, points: np.ndarray) -> np.ndarray:
    """Return (N, 3) unit vectors from points toward a light."""
    vector = np.asarray(light.vector, np.float64)
    if light.distant:
        return np.broadcast_to(vector / np.linalg.norm(vector), points.shape)
    toward = vector - points
    return toward / np.maximum(np.linalg.norm(toward, axis=1), 1e-300)[:, None]


def corner_weights(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return (N, 3) barycentric weights, 0…1, of points (N, 3) in triangles (N, 3, 3); thirds in collapsed ones."""
    a, b, p = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    aa, ab, bb = (np.einsum("ij,ij->i", u, v) for u, v in ((a, a), (a, b), (b, b)))
    pa, pb = (np.einsum("ij,ij->i", p, v) for v in (a, b))
    area = aa * bb - ab * ab
    flat = area <= 1e-12 * aa * bb
    area = np.where(flat, 1, area)
    second, third = (bb * pa - ab * pb) / area, (aa * pb - ab * pa) / area
    weights = np.clip(np.stack([1 - second - third, second, third], axis=1), 0, 1)
    weights[flat] = 1 / 3
    return weights / weights.sum(axis=1, keepdims=True)


def _perspective(place: np.ndarray, backward: np.ndarray, half: float, size: int) -> Camera:
    """Return a camera that looks against ``backward``. half: tangent of its half field of view."""
    scale = (size / 2 - _BORDER) / half
    return Camera(size, size, (scale, scale), (size / 2, size / 2), _camera_matrix(place, backward))


def _camera_matrix(place: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """Return the (4, 4) matrix of a camera at a place, with its z axis along a unit vector."""
    aside = np.zeros(3)
    aside[np.abs(backward).argmin()] = 1
    right = np.cross(aside, backward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(backward, right), backward], axis=1)
    matrix[:3, 3] = place
    return matrix
