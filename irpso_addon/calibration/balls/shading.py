"""Radiance model of matte balls: Lambert's law under a point light, ambient light and the table's bounce."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .crops import BallView

SECTORS = 8
_RIM = 0.3  # n·v: at smaller values Lambert's law holds less well
_RIM_PIXELS = 3.0  # distance from the outline: closer, blur and background dominate
_STEP = 1e-5  # of numeric derivatives, relative


@dataclass(frozen=True)
class Shading:
    """The values of matte balls in one photograph. points, normals: (N, 3). values: (N, 3) linear radiance.

    own: (N, balls) 1 in the column of the value's ball. sector: (N,) 0…SECTORS − 1, angle about the ball's centre.
    table: (N, 3) radiance of a white ball under the table's light alone, or None if unknown.
    """

    points: np.ndarray
    normals: np.ndarray
    values: np.ndarray
    own: np.ndarray
    sector: np.ndarray
    table: np.ndarray | None = None

    @property
    def balls(self) -> int:
        """Number of balls."""
        return self.own.shape[1]


def shading_of(views: Sequence[BallView], photograph: int, tables: Sequence[np.ndarray] = ()) -> Shading:
    """Return the balls' values in one photograph that are usable and not at the rim.

    tables: (K, H, W, 3) for each ball, from ``table.gathered``; () if unknown.
    """
    parts, table_values = [], []
    for number, view in enumerate(views):
        points, normals, toward, hit = view.ball.surface(view.pixels)
        margin = max(_RIM, np.sqrt(1 - (1 - min(_RIM_PIXELS / view.ball.radius_px, 1)) ** 2))
        keep = hit & ((normals * toward).sum(axis=-1) > margin) & view.usable[photograph]
        around = np.arctan2(normals[..., 1], normals[..., 0])[keep]
        sector = np.floor((around / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
        own = np.broadcast_to(np.eye(len(views))[number], (len(sector), len(views)))
        parts.append((points[keep], normals[keep], np.float64(view.values[photograph][keep]), own, sector))
        table_values += [tables[number][photograph][keep]] if len(tables) else []
    points, normals, values, own, sector = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Shading(points, normals, values, own, sector, np.concatenate(table_values) if table_values else None)


def direct(shading: Shading, centre: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Return k max(n·L, 0) / |L|³ (N,) with L = direction − inverse (point − centre).

    This is Lambert's law under a point light; inverse = 0 is a distant one. parameters: k times the unit direction from
    ``centre`` to the light (3), inverse distance (1), ambient radiance of each ball (see ``radiance``).
    """
    if parameters[3] == 0:
        return np.maximum(shading.normals @ parameters[:3], 0)
    strength = np.linalg.norm(parameters[:3])
    toward = parameters[:3] / max(strength, 1e-300) - parameters[3] * (shading.points - centre)
    length = np.maximum(np.linalg.norm(toward, axis=-1), 1e-6)
    return strength * np.maximum((shading.normals * toward).sum(axis=-1), 0) / length**3


def bounced(shading: Shading, parameters: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return the radiance (N,) by the light of the table.

    With a known table, ``ground`` (1,) is the balls' albedo. Else it is g (3,), the normal of an infinite lit plane
    times its albedo; the radiance is k max(l·g, 0) (1 − n·g/|g|) / 2, where k includes the balls' albedo.
    """
    if shading.table is not None:
        return ground[0] * shading.table.mean(axis=-1)
    albedo = np.linalg.norm(ground)
    if albedo == 0:
        return np.zeros(len(shading.normals))
    return max(parameters[:3] @ ground, 0.0) * (1 - shading.normals @ ground / albedo) / 2


def radiance(shading: Shading, centre: np.ndarray, parameters: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return the radiance (N,) of balls. ``parameters`` ends with the ambient radiance of each ball."""
    return shading.own @ parameters[4:] + direct(shading, centre, parameters) + bounced(shading, parameters, ground)


def jacobian(shading: Shading, centre: np.ndarray, parameters: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return the derivatives (N, 4 + balls) of ``radiance`` with respect to ``parameters``."""
    size, value = np.linalg.norm(parameters[:3]), direct(shading, centre, parameters)
    result = np.zeros((len(value), len(parameters)))
    result[:, 4:] = shading.own
    if parameters[3] == 0:
        result[:, :3] = shading.normals * (value > 0)[:, None]
    for index in range(4) if parameters[3] else (3,):
        moved = parameters.copy()
        moved[index] += (step := _STEP * (size if index < 3 else 1.0))
        result[:, index] = (direct(shading, centre, moved) - value) / step
    strength = parameters[:3] @ ground if shading.table is None else 0.0
    if strength > 0:
        result[:, :3] += ground * (bounced(shading, parameters, ground) / strength)[:, None]
    return result


def ground_jacobian(shading: Shading, parameters: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return the derivatives (N, len(ground)) of ``radiance`` with respect to ``ground``."""
    value, moves = bounced(shading, parameters, ground), _STEP * np.eye(len(ground))
    return np.stack([(bounced(shading, parameters, ground + d) - value) / _STEP for d in moves], axis=-1)
