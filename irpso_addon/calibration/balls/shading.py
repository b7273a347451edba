"""How a light shades matte balls: Lambert's law under a point light, and what the table below sends back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .crops import BallView

SECTORS = 8
_RIM = 0.3  # n·v: beyond, Lambert's law holds less well
_RIM_PIXELS = 3.0  # from the outline: nearer, blur and what is behind the ball decide
_STEP = 1e-5  # of the numbers that derivatives are taken by


@dataclass(frozen=True)
class Shading:
    """The values of matte balls in one photograph. points, normals: (N, 3). values: (N, 3) linear radiance.

    own: (N, balls) 1 for the ball that a value is of. sector: (N,) which of SECTORS parts of its ball.
    """

    points: np.ndarray
    normals: np.ndarray
    values: np.ndarray
    own: np.ndarray
    sector: np.ndarray

    @property
    def balls(self) -> int:
        """How many there are."""
        return self.own.shape[1]


def shading_of(views: Sequence[BallView], photograph: int) -> Shading:
    """Return the values of balls in one photograph that are away from the rim and neither clipped nor masked out."""
    parts = []
    for number, view in enumerate(views):
        points, normals, toward, hit = view.ball.surface(view.pixels)
        margin = max(_RIM, np.sqrt(1 - (1 - min(_RIM_PIXELS / view.ball.radius_px, 1)) ** 2))
        keep = hit & ((normals * toward).sum(axis=-1) > margin) & view.usable[photograph]
        around = np.arctan2(normals[..., 1], normals[..., 0])[keep]
        sector = np.floor((around / (2 * np.pi) + 0.5) * SECTORS).astype(int) % SECTORS
        own = np.broadcast_to(np.eye(len(views))[number], (len(sector), len(views)))
        parts.append((points[keep], normals[keep], np.float64(view.values[photograph][keep]), own, sector))
    return Shading(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def direct(shading: Shading, centre: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
    """Return (N,) k max(n·L, 0) / |L|³ with L = direction − inverse (point − centre).

    That is Lambert's law under a point light, written so that a distant one is inverse = 0. unknowns: k times the unit
    direction from ``centre`` to the light (3), inverse distance (1), and what ``radiance`` adds.
    """
    if unknowns[3] == 0:
        return np.maximum(shading.normals @ unknowns[:3], 0)
    strength = np.linalg.norm(unknowns[:3])
    toward = unknowns[:3] / max(strength, 1e-300) - unknowns[3] * (shading.points - centre)
    length = np.maximum(np.linalg.norm(toward, axis=-1), 1e-6)
    return strength * np.maximum((shading.normals * toward).sum(axis=-1), 0) / length**3


def bounced(shading: Shading, unknowns: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return (N,) k max(l·g, 0) (1 − n·g/|g|) / 2: what an endless lit plane under a ball sends to it.

    ground: (3,) g, the plane's normal times its albedo. The balls' albedo is in k.
    """
    albedo = np.linalg.norm(ground)
    if albedo == 0:
        return np.zeros(len(shading.normals))
    return max(unknowns[:3] @ ground, 0.0) * (1 - shading.normals @ ground / albedo) / 2


def radiance(shading: Shading, centre: np.ndarray, unknowns: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return (N,) the radiance of balls; ``unknowns`` ends with the ambient radiance of each."""
    return shading.own @ unknowns[4:] + direct(shading, centre, unknowns) + bounced(shading, unknowns, ground)


def jacobian(shading: Shading, centre: np.ndarray, unknowns: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return (N, 4 + balls) the derivatives of ``radiance`` by the unknowns."""
    size, here = np.linalg.norm(unknowns[:3]), direct(shading, centre, unknowns)
    result = np.zeros((len(here), len(unknowns)))
    result[:, 4:] = shading.own
    if unknowns[3] == 0:
        result[:, :3] = shading.normals * (here > 0)[:, None]
    for index in range(4) if unknowns[3] else (3,):
        moved = unknowns.copy()
        moved[index] += (step := _STEP * (size if index < 3 else 1.0))
        result[:, index] = (direct(shading, centre, moved) - here) / step
    strength = unknowns[:3] @ ground
    if strength > 0:
        result[:, :3] += ground * (bounced(shading, unknowns, ground) / strength)[:, None]
    return result


def ground_jacobian(shading: Shading, unknowns: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """Return (N, 3) the derivatives of ``radiance`` by the bounce."""
    here = bounced(shading, unknowns, ground)
    return np.stack([(bounced(shading, unknowns, ground + d) - here) / _STEP for d in _STEP * np.eye(3)], axis=-1)
