"""Edges summed over photographs, which favours outlines: shadows and highlights move with the lamp."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ....core.filters import blurred, sampled


@dataclass
class Edges:
    """Sum over photographs of g gᵀ |g|^power, with g the gradient of an image's square root.

    power −1, for detection: a strong edge in one photograph, of a shadow or a highlight, does not outweigh a weak edge
    in all of them. power 1, for measurement: photographs with a bright rim count most; where a ball darkens toward its
    rim, the edge seems to lie inside. sigma: of the blur before the gradient, pixels.
    """

    size: tuple[int, int]  # height, width
    power: float
    sigma: float
    count: int = 0
    xx: np.ndarray = field(init=False)
    xy: np.ndarray = field(init=False)
    yy: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.xx, self.xy, self.yy = (np.zeros(self.size, np.float32) for _ in range(3))

    def add(self, grey: np.ndarray, white: float) -> None:
        """Add a photograph (H, W), linear; values above ``white`` count as white."""
        smooth = blurred(np.sqrt(np.clip(grey / white, 0, 1)).astype(np.float32), self.sigma)
        gy, gx = np.gradient(smooth)
        weight = (np.sqrt(gx * gx + gy * gy) + 1e-6) ** self.power
        self.xx += gx * gx * weight
        self.xy += gx * gy * weight
        self.yy += gy * gy * weight
        self.count += 1

    @property
    def strength(self) -> np.ndarray:
        """(H, W) mean contrast of a pixel's edges."""
        return ((self.xx + self.yy) / max(self.count, 1)) ** (1 / (2 + self.power))

    @property
    def normal(self) -> tuple[np.ndarray, np.ndarray]:
        """x and y (H, W) of the unit vector across the edges; its sign is arbitrary."""
        angle = 0.5 * np.arctan2(2 * self.xy, self.xx - self.yy)
        return np.cos(angle), np.sin(angle)

    def across(self, places: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return the contrast (…) across ``directions`` (…, 2), unit, at pixel coordinates (…, 2)."""
        x, y = directions[..., 0], directions[..., 1]
        total = x * x * sampled(self.xx, places) + y * y * sampled(self.yy, places)
        total = total + 2 * x * y * sampled(self.xy, places)
        return (np.maximum(total, 0) / max(self.count, 1)) ** (1 / (2 + self.power))
