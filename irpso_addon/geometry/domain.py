"""The grid on which maps are solved, and all that a solver needs to know of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from .seams.seams import SeamMap


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

    def frames(self, texels: Any = ...) -> np.ndarray:
        """Return (…, 3, 3) float64 rows tangent, bitangent, normal in world axes, of all texels or some.

        texels: an index into the (H, W) texels, as numpy takes it; without it the rows are of (H, W, 3, 3).
        """
        normal, tangent = self.normal[texels].astype(np.float64), self.tangent[texels].astype(np.float64)
        bitangent = tangent[..., 3:] * np.cross(normal, tangent[..., :3])
        return np.stack([tangent[..., :3], bitangent, normal], axis=-2)

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> GeometryBake:
        """Return the geometry of other texels: what ``change`` makes of each array."""
        return GeometryBake(**{item.name: change(getattr(self, item.name)) for item in fields(GeometryBake)})


@dataclass(frozen=True)
class Domain:
    """W×H texels with geometry, sample stack, lights and views: everything that one recovery reads.

    All arrays are float32, in world units and axes (on a card the camera's). bake: the geometry. stack: (K, H, W, 4)
    linear RGB radiance of every observation and its weight, 0…1, in alpha, below 0 where it is a lower bound
    (capture/bounds.py); a sample without weight (in the mesh's own shadow) keeps its radiance for pictures, and is 0
    where nothing was photographed. lights: (K, 4) xyz and
    0 for the unit direction toward a distant light, xyz and 1 for the position of a near one. intensities: (K, 3), of
    which 1 is an irradiance of π (of a near light at distance 1). views: (K, 4) xyz and 1 for the place of a
    perspective camera, xyz and 0 for the direction toward an orthographic one. origin: global (x, y) of texel (0, 0):
    random numbers are keyed by it, so that a tile of a domain is solved as the whole would be. halo: texels along each
    side of a tile that belong to its neighbours: they are read but never moved. card: whether the domain is the image
    itself rather than a UV square. seams: which texels are neighbours across UV seams; where None, as on a card, those
    beside a texel are. noise: standard deviation of the photographs' sRGB codes, as a fraction of white
    (capture/noise.py); 0 where their files are finer than that.
    """

    bake: GeometryBake
    stack: np.ndarray
    lights: np.ndarray
    intensities: np.ndarray
    views: np.ndarray
    origin: tuple[int, int] = (0, 0)
    halo: tuple[int, int, int, int] = (0, 0, 0, 0)  # left, right, bottom, top
    card: bool = True
    seams: SeamMap | None = None
    noise: float = 0.0

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return self.bake.coverage.shape

    @property
    def observations(self) -> int:
        """K, the number of observations."""
        return len(self.lights)

    @cached_property
    def solvable(self) -> np.ndarray:
        """(H, W) bool: covered texels that at least one observation sees lit.

        A texel that is black under every light says nothing: any normal that faces no light would do for it. Found
        once, since it reads the whole stack.
        """
        covered = self.bake.coverage
        if hasattr(self.stack, "lit"):  # a stack that lies with several processes knows where to ask
            return self.stack.lit()
        lit = np.zeros(self.shape, bool)
        for layer in self.stack:
            # Channel by channel: any() over an axis of three is ten times slower.
            lit |= (layer[..., 3] > 0) & ((layer[..., 0] > 0) | (layer[..., 1] > 0) | (layer[..., 2] > 0))
            if lit[covered].all():
                break
        return covered & lit


def subset(domain: Domain, observations: Sequence[int] | np.ndarray) -> Domain:
    """Return the domain with only some observations, by index or (K,) bool. Geometry and tiling stay as they are."""
    chosen = np.asarray(observations)
    chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen.astype(np.intp)
    if np.array_equal(chosen, np.arange(domain.observations)):
        return domain
    # Of the first ones a view, not a copy: the stack may be larger than the memory.
    first = np.array_equal(chosen, np.arange(len(chosen)))
    return replace(
        domain,
        stack=domain.stack[: len(chosen)] if first else domain.stack[chosen],
        lights=domain.lights[chosen],
        intensities=domain.intensities[chosen],
        views=domain.views[chosen],
    )


def laid_on(domain: Domain, bake: GeometryBake, stack: np.ndarray, seams: SeamMap | None = None) -> Domain:
    """Return a domain of other texels, whole and at the origin; lights, views and noise are those of the domain."""
    return replace(domain, bake=bake, stack=stack, seams=seams, origin=(0, 0), halo=(0, 0, 0, 0))
