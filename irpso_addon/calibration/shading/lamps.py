"""Distant and near lamps in one parametrisation, and their irradiance on a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...capture.types import Light, triple

FREE = 4  # free parameters of a lamp: two angles, 1 / distance in units of 1 / ``size``, the logarithm of its strength
_FARTHEST = 1e-3  # least size / distance of a near lamp


@dataclass(frozen=True)
class Lamps:
    """K lamps about a centre. From x, lamp k lies along u = d − q (x − c); the irradiance / π is s n·u / |u|³.

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
        offsets = (points - self.centre) / self.size
        u = self.directions[:, None] - self.inverses[:, None, None] * offsets
        return u, np.maximum(np.linalg.norm(u, axis=-1), 1e-9)

    def vectors(self, points: np.ndarray) -> np.ndarray:
        """Return light vectors (K, T, 3): irradiance / π is their dot product with the normal."""
        u, length = self.seen_from(points)
        return self.strengths[:, None, None] * u / length[..., None] ** 3

    def shading(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return irradiance / π (K, T) at points (T, 3) with unit normals (T, 3), and the cosines; < 0 if unlit."""
        u, length = self.seen_from(points)
        cosine = np.einsum("ktc,tc->kt", u, normals) / length
        return self.strengths[:, None] * cosine / length**2, cosine

    def derivatives(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the derivatives (K, T, FREE) of the shading with respect to each lamp's parameters, along ``axes``."""
        u, length = self.seen_from(points)
        facing = np.einsum("ktc,tc->kt", u, normals)
        by_u = normals / length[..., None] ** 3 - 3 * (facing / length**5)[..., None] * u
        first, second = self.axes()
        offsets = (points - self.centre) / self.size
        parts = [
            np.einsum("ktc,kc->kt", by_u, first),
            np.einsum("ktc,kc->kt", by_u, second),
            -np.einsum("ktc,tc->kt", by_u, offsets),
            facing / length**3,
        ]
        return self.strengths[:, None, None] * np.stack(parts, axis=-1)

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return two unit vectors (K, 3) perpendicular to the directions and to each other."""
        least = np.eye(3)[np.abs(self.directions).argmin(axis=-1)]
        first = np.cross(self.directions, least)
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        return first, np.cross(self.directions, first)

    def moved(self, steps: np.ndarray) -> Lamps:
        """Return the lamps after steps (K, FREE), with an unchanged mean logarithm of the strengths."""
        first, second = self.axes()
        directions = self.directions + steps[:, :1] * first + steps[:, 1:2] * second
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        strengths = self.strengths * np.exp(steps[:, 3] - steps[:, 3].mean())
        return Lamps(self.centre, self.size, directions, self.inverses + steps[:, 2], strengths)

    def lights(self, near: bool, scale: float = 1.0) -> list[Light]:
        """Return the lights of a capture; if ``near``, positions, with intensities at distance 1.

        scale: factor of all intensities.
        """
        strengths = self.strengths * scale
        if not near:
            return [Light(triple(d), (float(s),) * 3) for d, s in zip(self.directions, strengths, strict=True)]
        distance = self.size / np.maximum(self.inverses, _FARTHEST)
        places = self.centre + self.directions * distance[:, None]
        rows = zip(places, strengths * distance**2, strict=True)
        return [Light(triple(place), (float(power),) * 3, False) for place, power in rows]
