"""Projection of camera images to texels: the place of each texel in an image, and its visibility."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..capture.bounds import bounded, weight_and_clipped
from ..capture.camera import Camera
from .spaces import unit
from .surface.bake import SurfaceBake
from .surface.footprint import MAX_PLACES, jacobian, place, places_along, slant_weight

GRAZING = 0.1  # cosine between face normal and view; below, a texel is not visible
# Least usable (visible, with weight) share of a texel of several pixels: the centre of this part is within an eighth of
# a texel of the texel's own.
USABLE = 0.75
# Surface within this many pixels (at the texel, in world units) of the texel's own plane is the same surface. The
# distance is perpendicular to the plane, so along the view it grows with the slope.
_SAME_SURFACE = 0.5
# Surfaces that meet at more than 60° are different at any distance: their radiances do not mix.
_SAME_FACING = 0.5
# Relative precision of float32 positions, times the largest coordinate.
ROUNDING = 4e-7
# A texel this near a row or column of pixel centres reads only that row or column: a neighbour without weight cannot
# spoil it.
_SNAP = 1e-3
_BLOCK = 1 << 15  # texels processed at a time: their data fit the processor's cache


@dataclass
class _Group:
    """N texels with the same number of sampling places. along: their number along u and v.

    texels: (N,) flat index. first: (N, 2) int32 pixel at or left of and below the texel's place. fraction: (N, 2) from
    that pixel. sides: (N, 2, 2) the Jacobian. counts: (N,) uint64, one bit per place that shows the texel's surface.
    worth: (N,) weight for the slant. Floats are float32.
    """

    along: tuple[int, int]
    texels: np.ndarray
    first: np.ndarray
    fraction: np.ndarray
    sides: np.ndarray
    counts: np.ndarray
    worth: np.ndarray

    def part(self, chosen: np.ndarray | slice) -> _Group:
        """Return the group of some of the texels."""
        arrays = (self.texels, self.first, self.fraction, self.sides, self.counts, self.worth)
        return _Group(self.along, *(array[chosen] for array in arrays))

    def places(self) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the number of each place and its position (N, 2) relative to ``first``."""
        if self.along == (1, 1):
            yield 0, self.fraction
            return
        for j in range(self.along[1]):
            for i in range(self.along[0]):
                along, across = np.asarray([place(i, self.along[0]), place(j, self.along[1])], np.float32)
                yield j * MAX_PLACES + i, self.fraction + along * self.sides[:, :, 0] + across * self.sides[:, :, 1]


class Projector:
    """Places of a bake's texels in one camera; ``sample`` reads an image at them.

    bake: the texels. seen: the surface in the camera's pixels (``bake_camera``). grazing: least cosine between face
    normal and view, 0…1. steps: (T, 2, 3) from ``texel_steps``; with them a texel larger than a pixel is the mean over
    its area, without them texels are read at their centres. fall: lower the weight of slanted samples. visible: (h, w)
    bool, texels that are inside the image by half a pixel (four pixel centres around them), not hidden, not grazing,
    and whose relevant pixel centres lie on the texel's own surface: all of them, or three quarters for a texel of
    several pixels.
    """

    def __init__(
        self,
        bake: SurfaceBake,
        seen: SurfaceBake,
        camera: Camera,
        grazing: float = GRAZING,
        steps: np.ndarray | None = None,
        fall: bool = True,
    ):
        self.camera = camera
        self._shape = bake.coverage.shape
        self._bake, self._seen, self._grazing, self._steps, self._fall = bake, seen, grazing, steps, fall
        self._rounding = ROUNDING * float(np.abs(seen.position).max(initial=0))
        parts = [self._visible_groups(block) for block in blocks(np.flatnonzero(bake.coverage))]
        self._groups = _joined([group for groups in parts for group in groups])
        del self._bake, self._seen, self._steps  # they may be large

    @property
    def visible(self) -> np.ndarray:
        """(h, w) bool: the texels that the camera sees."""
        visible = np.zeros(self._shape, bool)
        for group in self._groups:
            visible.ravel()[group.texels] = True
        return visible

    def sample(self, image: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
        """Return (h, w, 4) float32: an image's radiance at the texels, 0 where not visible, and its weight in alpha.

        image: (H, W, 4) of the camera's size, weight in alpha. mask: (H, W) bool, None for all pixels. Radiance and
        weight are interpolated between pixel centres; one pixel without weight (outside the mask, not a number) gives
        the texel weight 0. A texel of several pixels is the mean of the usable ones; its weight is their share, or 0
        where that is under three quarters. A bound among the pixels makes the texel a bound (capture/bounds.py). A
        texel of weight 0 keeps the radiance of its pixels, for display.
        """
        if image.shape != (self.camera.height, self.camera.width, 4):
            raise ValueError(f"the image is {image.shape}, the camera {self.camera.height} × {self.camera.width} × 4")
        pixels = np.array(image, np.float32).reshape(-1, 4)
        photographed = np.isfinite(pixels).all(axis=1)
        if mask is not None:
            photographed &= np.asarray(mask, bool).ravel()
        pixels[~photographed] = 0
        weight, clipped = weight_and_clipped(pixels[:, 3])
        pixels[:, 3] = weight
        usable = weight > 0
        stack = np.zeros((self._shape[0] * self._shape[1], 4), np.float32)
        bounds = np.flatnonzero(clipped.any(axis=1)).size > 0
        for group in self._groups:
            for start in range(0, len(group.texels), _BLOCK):
                part = group.part(slice(start, start + _BLOCK))
                stack[part.texels] = self._mean(part, pixels, usable)
                if bounds:
                    stack[part.texels, 3] = bounded(stack[part.texels, 3], self._any(part, clipped & usable[:, None]))
                blank = part.part(stack[part.texels, 3] == 0)
                if len(blank.texels):
                    stack[blank.texels, :3] = self._mean(blank, pixels, photographed)[:, :3]
        return stack.reshape(*self._shape, 4)

    def _mean(self, group: _Group, pixels: np.ndarray, usable: np.ndarray) -> np.ndarray:
        """Return (N, 4) the mean of the usable pixels and its weight. pixels: (P, 4), usable: (P,) bool."""
        total = np.zeros((len(group.texels), 4), np.float32)
        share = np.zeros(len(total), np.float32)
        number = group.along[0] * group.along[1]
        for bit, where in group.places():
            counts = (group.counts >> np.uint64(bit)) & np.uint64(1) > 0
            for pixel, weight in _taps(group.first, where, self.camera.width):
                pixel = np.where(counts, pixel, 0)
                weight = np.where(counts & usable[pixel], weight, np.float32(0))
                total += pixels[pixel] * weight[:, None]
                share += weight
        if number == 1:
            total[share < 1 - 1e-5] = 0  # the four weights sum to 1 up to rounding
        else:
            total[:, :3] /= np.maximum(share, 1e-6)[:, None]
            total[:, 3] /= number
            total[share < USABLE * number] = 0
        total[:, 3] *= group.worth
        return total

    def _any(self, group: _Group, flags: np.ndarray) -> np.ndarray:
        """Return (N, 3) bool: the flags (P, 3) that at least one of a texel's pixels has."""
        result = np.zeros((len(group.texels), 3), bool)
        for bit, where in group.places():
            counts = (group.counts >> np.uint64(bit)) & np.uint64(1) > 0
            for pixel, weight in _taps(group.first, where, self.camera.width):
                result |= flags[np.where(counts, pixel, 0)] & (counts & (weight > 0))[:, None]
        return result

    def _visible_groups(self, texels: np.ndarray) -> list[_Group]:
        """Return the visible texels in groups with the same number of places."""
        camera, size = self.camera, len(texels)
        texels = filled(texels)
        points = self._bake.position.reshape(-1, 3)[texels].astype(np.float64)
        faces = self._bake.face_normal.reshape(-1, 3)[texels].astype(np.float64)
        numbers = self._bake.triangle.ravel()[texels]
        where, depth = camera.project(points)
        where -= 0.5
        nearest = np.rint(where)
        where = np.where(np.abs(where - nearest) < _SNAP, nearest, where)
        limit = np.array([camera.width - 1, camera.height - 1])
        inside = ((where >= 0) & (where <= limit)).all(axis=1) & ((depth > 0) | (not camera.perspective))
        cosine = np.einsum("ij,ij->i", faces, _toward(camera, points))
        chosen = np.flatnonzero(inside & (cosine > 0) & (cosine >= self._grazing))
        chosen = chosen[chosen < size]
        sides = self._sides(points, numbers, chosen)
        worth = slant_weight(cosine[chosen], self._grazing, sides) if self._fall else np.ones(len(chosen))
        sides = np.zeros((len(chosen), 2, 2)) if sides is None else sides
        first = np.floor(where[chosen]).astype(np.int32)
        seen = _Group(
            (1, 1), texels[chosen], first, (where[chosen] - first).astype(np.float32), sides.astype(np.float32),
            np.zeros(len(chosen), np.uint64), worth.astype(np.float32),
        )  # fmt: skip
        pixel = (depth if camera.perspective else np.ones_like(depth)) / min(camera.scale)
        surface = _Surface(numbers[chosen], points[chosen], faces[chosen], pixel[chosen])
        return self._grouped(seen, surface, places_along(sides))

    def _sides(self, points: np.ndarray, numbers: np.ndarray, chosen: np.ndarray) -> np.ndarray | None:
        """Return the Jacobians of some texels of a block, None where texels are read at their centres."""
        if self._steps is None or not len(chosen):
            return None
        block = filled(chosen)
        return jacobian(self.camera, points[block], self._steps[numbers[block]])[: len(chosen)]

    def _grouped(self, seen: _Group, surface: _Surface, along: np.ndarray) -> list[_Group]:
        groups = []
        for key in np.unique(along[:, 0].astype(int) * (MAX_PLACES + 1) + along[:, 1]):
            chosen = np.flatnonzero(along[:, 0].astype(int) * (MAX_PLACES + 1) + along[:, 1] == key)
            group = seen.part(chosen)
            group.along = divmod(int(key), MAX_PLACES + 1)
            shown = self._mark_visible(group, surface.part(chosen))
            groups.append(group.part(shown >= (1 if group.along == (1, 1) else USABLE)))
        return [group for group in groups if len(group.texels)]

    def _mark_visible(self, group: _Group, surface: _Surface) -> np.ndarray:
        """Set the bits of the places that show each texel's surface; return their share."""
        limit = np.array([self.camera.width - 1, self.camera.height - 1], np.float32)
        tolerance = _SAME_SURFACE * surface.pixel * max(1.0, max(group.along) / 2) + self._rounding
        visible = np.zeros(len(group.texels), np.int32)
        for bit, where in group.places():
            at = group.first + where
            shown = ((at >= 0) & (at <= limit)).all(axis=1)
            for pixel, weight in _taps(group.first, where, self.camera.width):
                read = np.flatnonzero(shown & (weight > 0))
                shown[read] = _same_surface(self._seen, pixel[read], surface.part(read), tolerance[read])
            group.counts |= shown.astype(np.uint64) << np.uint64(bit)
            visible += shown
        return visible / (group.along[0] * group.along[1])


@dataclass
class _Surface:
    """The surface at N texels: triangle (N,), points and face normals (N, 3), a pixel's width in the world (N,)."""

    numbers: np.ndarray
    points: np.ndarray
    faces: np.ndarray
    pixel: np.ndarray

    def part(self, chosen: np.ndarray | slice) -> _Surface:
        """Return the surface at some of the texels."""
        return _Surface(self.numbers[chosen], self.points[chosen], self.faces[chosen], self.pixel[chosen])


def blocks(texels: np.ndarray) -> list[np.ndarray]:
    """Return the texels in blocks."""
    return [texels[start : start + _BLOCK] for start in range(0, len(texels), _BLOCK)]


def filled(texels: np.ndarray) -> np.ndarray:
    """Return a block of texels padded to full length with its last texel.

    The rounding of a matrix product may depend on its number of rows; with padding a texel's values do not depend on
    the rest of the block.
    """
    return np.concatenate([texels, np.repeat(texels[-1:], _BLOCK - len(texels))])


def _joined(groups: list[_Group]) -> list[_Group]:
    """Return one group for each number of places."""
    result = []
    for along in sorted({group.along for group in groups}):
        alike = [group for group in groups if group.along == along]
        names = ("texels", "first", "fraction", "sides", "counts", "worth")
        result.append(_Group(along, *(np.concatenate([getattr(group, name) for group in alike]) for name in names)))
    return result


def _taps(first: np.ndarray, where: np.ndarray, width: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield flat pixel indices and weights of the four pixels around places (N, 2) relative to pixels (N, 2)."""
    nearest = np.rint(where)
    where = np.where(np.abs(where - nearest) < _SNAP, nearest, where)
    corner = np.floor(where)
    x, y = (where - corner).T
    corner = first + corner.astype(np.int32)
    flat = corner[:, 0] + corner[:, 1] * width
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = (x if dx else 1 - x) * (y if dy else 1 - y)
        # A pixel of weight 0 may lie outside the image: the first replaces it.
        yield np.where(weight > 0, flat + dx + dy * width, flat), weight


def _toward(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Return (N, 3) unit vectors from the points toward the camera."""
    if not camera.perspective:
        return np.broadcast_to(camera.backward, points.shape)
    return unit(camera.position - points)


def _same_surface(seen: SurfaceBake, pixel: np.ndarray, surface: _Surface, tolerance: np.ndarray) -> np.ndarray:
    """Return whether a pixel shows the surface of the points: the same triangle, or a near one that faces alike.

    Distance is measured along the mean of the two normals, in which a chord of an evenly curved surface has no extent:
    curvature does not look like a gap.
    """
    numbers = seen.triangle.ravel()[pixel]
    same = numbers == surface.numbers
    other = np.flatnonzero(~same & (numbers >= 0))
    pixel, points, faces = pixel[other], surface.points[other], surface.faces[other]
    normal = seen.face_normal.reshape(-1, 3)[pixel].astype(np.float64)
    alike = np.einsum("ij,ij->i", normal, faces)
    mean = normal + faces
    gap = np.einsum("ij,ij->i", seen.position.reshape(-1, 3)[pixel] - points, mean)
    gap = np.abs(gap) / np.maximum(np.linalg.norm(mean, axis=1), 1e-30)
    same[other] = (alike > _SAME_FACING) & (gap <= tolerance[other])
    return same
