"""The table below a ball, and the ball's irradiance from that table, integrated from the photographs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .ball import Ball, to_pixels
from .crops import BallView, Surroundings

_RAYS = 96  # per point of the ball
_MIN_FALLING = 0.02  # cosine between a ray and the table's downward normal: flatter rays meet the table too far away
_BESIDE = 1.06  # radii from the outline's centre: nearer pixels show the ball or its blur


@dataclass(frozen=True)
class Table:
    """The surface below a ball. up: (3,) its normal in camera axes. height: of the ball's centre above it, in radii."""

    up: np.ndarray
    height: float


def radiance_from_table(view: BallView, around: Surroundings, table: Table) -> np.ndarray:
    """Return the radiance (K, H, W, 3) of a white matte ball under the table's light alone; 0 outside the ball.

    Rays from each point of the ball are distributed as the cosine to its normal. Where a ray meets the table, the
    photograph shows the table's radiance, which a matte table sends in all directions, with its pattern, the fall-off
    of near lamps and all shadows (Nayar, Ikeuchi and Kanade 1991, with photographs in place of a model). Points of the
    table behind the ball take the value beside it.
    """
    _, normals, _, inside = view.ball.surface(view.pixels)
    result = np.zeros((len(around.values), *inside.shape, 3), np.float32)
    rows, columns, meets = _places(view.ball, around, table, normals[inside])
    for number, picture in enumerate(around.values):
        result[number, inside] = (picture[rows, columns] * meets[..., None]).mean(axis=0)
    return result


def _places(
    ball: Ball, around: Surroundings, table: Table, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows and columns (R, N) in ``around`` where rays from normals (N, 3) end, and whether on the table."""
    rays = _rays(normals)
    falling = -(rays @ table.up)
    meets = falling > _MIN_FALLING
    length = (table.height + normals @ table.up) / np.where(meets, falling, 1.0)
    points = ball.centre + ball.radius * (normals + length[..., None] * rays)
    if ball.camera.perspective:
        meets &= points[..., 2] < 0
    pixels = to_pixels(ball.camera, np.where(meets[..., None], points, ball.centre))
    middle = ball.outline[:-1].mean(axis=0)
    offset = pixels - middle
    nearest = _BESIDE * ball.radius_px + around.block
    pixels = middle + offset * np.maximum(nearest / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9), 1)
    size = np.array(around.values.shape[2:0:-1])
    index = np.clip(np.floor((pixels - around.origin) / around.block), 0, size - 1).astype(int)
    return index[..., 1], index[..., 0], meets


def _rays(normals: np.ndarray) -> np.ndarray:
    """Return unit rays (R, N, 3) about normals (N, 3), distributed as the cosine to the normal."""
    number = np.arange(_RAYS) + 0.5
    flat, turn = np.sqrt(number / _RAYS), np.pi * (3 - np.sqrt(5)) * number
    x, y, z = (part[:, None, None] for part in (flat * np.cos(turn), flat * np.sin(turn), np.sqrt(1 - flat**2)))
    # Orthonormal basis about each normal (Duff et al. 2017).
    nx, ny, nz = normals.T
    sign = np.where(nz < 0, -1.0, 1.0)
    scale = -1 / (sign + nz)
    across = np.stack([1 + sign * nx**2 * scale, sign * nx * ny * scale, -sign * nx], axis=-1)
    upward = np.stack([nx * ny * scale, sign + ny**2 * scale, -ny], axis=-1)
    return x * across + y * upward + z * normals
