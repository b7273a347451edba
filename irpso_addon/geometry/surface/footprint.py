"""A texel's footprint in an image, and the places inside it at which the image is read."""

from __future__ import annotations

import numpy as np

from ...capture.camera import Camera
from .mesh import MeshData

MAX_PLACES = 8  # most places along a side of a texel: 64 bits hold their visibility
# A place is interpolated between four pixel centres: places this many pixels apart skip no pixel.
_SPACING = 1.25
# κ of slant_weight: the share of a head-on sample's variance that comes from the position of its pixel on the surface.
# Photographs of the head scan's colours (1 % noise, up to half a pixel off), projected to 512² and 1024² texels, have
# squared errors that grow with the stretch a, from 1 to 8, as 1 + κ (a² − 1) with κ from 0.07 to 0.12.
_SPREAD = 0.1


def texel_steps(mesh: MeshData, width: int, height: int) -> np.ndarray:
    """Return (T, 2, 3) float64: each triangle's world steps over one texel along u and along v.

    width, height: texels of the whole domain. 0 for triangles without UV area.
    """
    corners = mesh.positions.astype(np.float64)
    places = mesh.uvs.astype(np.float64) * (width, height)
    edges, across = corners[:, 1:] - corners[:, :1], places[:, 1:] - places[:, :1]
    area = across[:, 0, 0] * across[:, 1, 1] - across[:, 0, 1] * across[:, 1, 0]
    turned = np.stack([across[:, 1, ::-1], across[:, 0, ::-1]], axis=1) * np.array([[1, -1], [-1, 1]])
    inverse = turned.transpose(0, 2, 1) / np.where(area == 0, np.inf, area)[:, None, None]
    return np.einsum("tik,tkj->tij", inverse, edges)


def jacobian(camera: Camera, points: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the Jacobians (N, 2, 2) of a texel in the image: rows x and y, columns u and v, pixels per texel.

    points: (N, 3), the texels' centres. steps: (N, 2, 3) from ``texel_steps``. 0 where a side of the texel is not in
    front of the camera.
    """
    sides = []
    for axis in (0, 1):
        (ahead, near), (behind, far) = (camera.project(points + sign * steps[:, axis]) for sign in (0.5, -0.5))
        side = ahead - behind
        whole = np.isfinite(side).all(axis=1)
        if camera.perspective:
            whole &= (near > 0) & (far > 0)
        sides.append(np.where(whole[:, None], side, 0))
    return np.stack(sides, axis=-1)


def places_along(sides: np.ndarray) -> np.ndarray:
    """Return (N, 2) uint8: the number of places along u and v, 1 … MAX_PLACES, for Jacobians (N, 2, 2)."""
    lengths = np.sqrt((sides * sides).sum(axis=1))
    return np.clip(np.ceil(lengths - (_SPACING - 1)), 1, MAX_PLACES).astype(np.uint8)


def place(number: int, along: int) -> float:
    """Return the position of place ``number`` of ``along`` on a side of a texel: −0.5 … 0.5 of the side."""
    return (number + 0.5) / along - 0.5


def slant_weight(cosine: np.ndarray, grazing: float, sides: np.ndarray | None) -> np.ndarray:
    """Return (N,) 0…1: the weight of a slanted sample relative to a head-on one.

    cosine: (N,) between face normal and view. grazing: the cosine of weight 0. sides: Jacobians (N, 2, 2), or None.
    The weight has two factors. (1) A slanted pixel covers a = 1/cosine times its width on the surface, so displacement
    and blur of the image act a times as far: the inverse variance 1 / (1 + κ (a² − 1)). A texel longer than the pixel's
    footprint loses nothing: a is at most the footprint's longer side in texels, and at least 1. (2)
    1 − (grazing / cosine)², relative to head-on, falls smoothly to the cut-off: about 0.75 at twice its cosine, 0.96 at
    five times.
    """
    cosine = np.maximum(cosine, 1e-6)
    stretch = 1 / cosine
    if sides is not None:
        stretch = np.minimum(stretch, np.maximum(_longest(sides), 1))
    fade = np.maximum(1 - (grazing / cosine) ** 2, 0) / max(1 - grazing**2, 1e-6)
    return fade / (1 + _SPREAD * (stretch**2 - 1))


def _longest(sides: np.ndarray) -> np.ndarray:
    """Return (N,) the longer axis of a pixel's footprint in texels: 1 / the smaller singular value."""
    total = (sides * sides).sum(axis=(1, 2))
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    larger = (total + np.sqrt(np.maximum(total**2 - 4 * area**2, 0))) / 2  # squared singular value
    return np.sqrt(larger) / np.maximum(np.abs(area), 1e-30)
