"""The grid on which maps are solved, and all that a solver needs to know of it."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class GeometryBake:
    """Per-texel geometry of H×W texels, row 0 at the bottom, in world units and world axes.

    position: (H, W, 3). normal: (H, W, 3) unit. tangent: (H, W, 4) unit tangent and the bitangent's sign, so that
    bitangent = sign · normal × tangent. coverage: (H, W) bool. uv: (H, W, 2) the texel's texture coordinates.
    All float32.
    """

    position: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray
    coverage: np.ndarray
    uv: np.ndarray


@dataclass(frozen=True)
class Domain:
    """W×H texels with geometry, sample stack, lights and views: everything that one recovery reads.

    bake: the geometry. stack: (K, H, W, 4) float32, RGB radiance of every observation and its weight in alpha.
    lights: (K, 4) xyz and 0 for the unit direction toward a distant light, xyz and 1 for the position of a near one.
    intensities: (K, 3). views: (K, 4) xyz and 1 for the place of a perspective camera, xyz and 0 for the direction
    toward an orthographic one. origin: global (x, y) of texel (0, 0): random numbers are keyed by it, so that a tile
    of a domain is solved as the whole would be. halo: texels along each side of a tile that belong to its neighbours:
    they are read but never moved. card: whether the domain is the image itself rather than a UV square.
    """

    bake: GeometryBake
    stack: np.ndarray
    lights: np.ndarray
    intensities: np.ndarray
    views: np.ndarray
    origin: tuple[int, int] = (0, 0)
    halo: tuple[int, int, int, int] = (0, 0, 0, 0)  # left, right, bottom, top
    card: bool = True

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.bake.coverage.shape

    @property
    def observations(self) -> int:
        """K, the number of observations."""
        return len(self.lights)

    @property
    def solvable(self) -> np.ndarray:
        """(H, W) bool: covered texels that at least one observation says something about."""
        return self.bake.coverage & (self.stack[..., 3] > 0).any(axis=0)
