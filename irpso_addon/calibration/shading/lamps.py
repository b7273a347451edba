"""Distant and near lamps in one form, and how they light a matt surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...capture.types import Light, triple

FREE = 4  # free parameters of a lamp: two angles, 1 / distance in units of 1 / ``size``, the logarithm of its strength
_FARTHEST = 1e-3  # least size / distance of a near lamp


@dataclass(frozen=True)
class Lamps:
    """K lamps as seen from a centre. A place x sees lamp k along u = d − q (x − c); its irradiance / π is s n·u / |u|³.

    centre: c, (3,). size: unit of length, about the subject's radius. directions: d, (K, 3) unit. inverses: q · size,
    (K,), 0 for a distant lamp. strengths: s, (K,) irradiance / π at the centre on a surface that faces the lamp.
    """

    centre: np.ndarray
    size: float
    directions: np.ndarray
    inverses: np.ndarray
    strengths: np.ndarray

    def seen_from(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return u (K, T, 3) and |u| (K, T) at points (T, 3)."""
        arms = (points - self.centre) / self.size
        u = self.directions[:, None] - self.inverses[:, None, None] * arms
        return u, np.maximum(np.linalg.norm(u, axis=-1), 1e-9)

    def vectors(self, points: np.ndarray) -> np.ndarray:
        """Return (K, T, 3) directions to the lamps times irradiance / π: shading is their product with the normal."""
        u, length = self.seen_from(points)
        return self.strengths[:, None, None] * u / length[..., None] ** 3

    def shading(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (K, T) irradiance / π on points (T, 3) with unit normals (T, 3), below 0 behind, and the cosines."""
        u, length = self.seen_from(points)
        cosine = np.einsum("ktc,tc->kt", u, normals) / length
        return self.strengths[:, None] * cosine / length**2, cosine

    def derivatives(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return (K, T, FREE) of the shading by each lamp's own parameters, along ``axes``."""
        u, length = self.seen_from(points)
        facing = np.einsum("ktc,tc->kt", u, normals)
        by_u = normals / length[..., None] ** 3 - 3 * (facing / length**5)[..., None] * u
        first, second = self.axes()
        arms = (points - self.centre) / self.size
        parts = [
            np.einsum("ktc,kc->kt", by_u, first),
            np.einsum("ktc,kc->kt", by_u, second),
            -np.einsum("ktc,tc->kt", by_u, arms),
            facing / length**3,
        ]
        return self.strengths[:, None, None] * np.stack(parts, axis=-1)

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return two (K, 3) unit vectors perpendicular to the directions and to each other."""
        least = np.eye(3)[np.abs(self.directions).argmin(axis=-1)]
        first = np.cross(self.directions, least)
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        return first, np.cross(self.directions, first)

    def moved(self, steps: np.ndarray) -> Lamps:
        """Return the lamps after steps (K, FREE); the mean logarithm of the strengths stays."""
        first, second = self.axes()
        turned = self.directions + steps[:, :1] * first + steps[:, 1:2] * second
        turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
        strengths = self.strengths * np.exp(steps[:, 3] - steps[:, 3].mean())
        return Lamps(self.centre, self.size, turned, self.inverses + steps[:, 2], strengths)

    def lights(self, near: bool, scale: float = 1.0) -> list[Light]:
        """Return the lights of a capture: positions where ``near``, with their intensities at distance 1.

        scale: of all intensities.
        """
        strengths = self.strengths * scale
        if not near:
            return [Light(triple(d), (float(s),) * 3) for d, s in zip(self.directions, strengths, strict=True)]
        distance = self.size / np.maximum(self.inverses, _FARTHEST)
        places = self.centre + self.directions * distance[:, None]
        rows = zip(places, strengths * distance**2, strict=True)
        return [Light(triple(place), (float(power),) * 3, False) for place, power in rows]
