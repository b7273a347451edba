"""Domains: the texels on which maps are solved, with their geometry, samples, lights and views."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from .samples import ArrayStack, SampleStack
from .seams.seams import SeamMap
from .seams.tiles import tile_seams


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

    def map_arrays(self, change: Callable[[np.ndarray], np.ndarray]) -> GeometryBake:
        """Return the geometry with ``change`` applied to each array."""
        return GeometryBake(**{item.name: change(getattr(self, item.name)) for item in fields(GeometryBake)})


def flat_bake(position: np.ndarray, coverage: np.ndarray, uv: np.ndarray) -> GeometryBake:
    """Return the geometry of texels (H, W) that face +Z, their tangents along +X; arguments as in GeometryBake."""
    normal, tangent = (
        np.tile(np.asarray(axis, np.float32), (*coverage.shape, 1)) for axis in ((0, 0, 1), (1, 0, 0, 1))
    )
    return GeometryBake(position.astype(np.float32), normal, tangent, coverage, uv.astype(np.float32))


@dataclass(frozen=True)
class Domain:
    """W×H texels with geometry, sample stack, lights and views: everything that one recovery reads.

    All arrays are float32, in world units and axes (on a card the camera's). bake: the geometry. stack: the samples;
    one without weight (in the mesh's own shadow) keeps its radiance for pictures, and is 0 where nothing was
    photographed. solvable: (H, W) bool, of ``solvable_texels``. lights: (K, 4) xyz and 0 for the unit direction toward
    a distant light, xyz and 1 for the position of a near one. intensities: (K, 3), of which 1 is an irradiance of π (of
    a near light at distance 1). views: (K, 4) xyz and 1 for the place of a perspective camera, xyz and 0 for the
    direction toward an orthographic one. origin: global (x, y) of texel (0, 0): random numbers are keyed by it, so that
    a tile of a domain is solved as the whole would be. halo: texels along each side of a tile that belong to its
    neighbours: they are read but never moved. card: whether the domain is the image itself rather than a UV square.
    seams: which texels are neighbours across UV seams; where None, as on a card, those beside a texel are. noise:
    standard deviation of the photographs' sRGB codes, as a fraction of white (capture/noise.py); 0 where their files
    are finer than that. beams: (K, 8) place of each light and its (5,) of ``beam_share``, by which the samples were
    divided; None where all lights are isotropic. unseen: the observations, by index, whose cameras see no texel of the
    mesh. shaded: those whose light reaches, by the predicted shadows, no texel that their cameras see; with the unseen.
    """

    bake: GeometryBake
    stack: SampleStack
    solvable: np.ndarray
    lights: np.ndarray
    intensities: np.ndarray
    views: np.ndarray
    origin: tuple[int, int] = (0, 0)
    halo: tuple[int, int, int, int] = (0, 0, 0, 0)  # left, right, bottom, top
    card: bool = True
    seams: SeamMap | None = None
    noise: float = 0.0
    beams: np.ndarray | None = None
    unseen: tuple[int, ...] = ()
    shaded: tuple[int, ...] = ()

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.bake.coverage.shape
        return height, width

    @property
    def observations(self) -> int:
        """K, the number of observations."""
        return len(self.lights)


def solvable_texels(bake: GeometryBake, stack: SampleStack) -> np.ndarray:
    """Return (H, W) bool: covered texels that at least one observation sees lit. May read the whole stack.

    A texel that is black under every light has no information: any normal that faces away from all lights fits it.
    """
    return stack.lit(bake.coverage)


def domain_of(
    bake: GeometryBake,
    values: np.ndarray,
    lights: np.ndarray,
    intensities: np.ndarray,
    views: np.ndarray,
    card: bool = True,
    seams: SeamMap | None = None,
    noise: float = 0.0,
) -> Domain:
    """Return the domain of samples (K, H, W, 4); the rest is as in Domain."""
    stack = ArrayStack(values)
    solvable = solvable_texels(bake, stack)
    return Domain(bake, stack, solvable, lights, intensities, views, card=card, seams=seams, noise=noise)


def with_samples(domain: Domain, values: np.ndarray) -> Domain:
    """Return the domain with other samples, (K, H, W, 4) float32 in memory."""
    stack = ArrayStack(values)
    return replace(domain, stack=stack, solvable=solvable_texels(domain.bake, stack))


def with_lights(domain: Domain, lights: np.ndarray, intensities: np.ndarray) -> Domain:
    """Return the domain under other lights (K, 4) and intensities (K, 3)."""
    return replace(domain, lights=lights.astype(np.float32), intensities=intensities.astype(np.float32))


def subset(domain: Domain, observations: Sequence[int] | np.ndarray, solvable: np.ndarray | None = None) -> Domain:
    """Return the domain with only some observations, by index or (K,) bool. Geometry and tiling stay as they are.

    solvable: (H, W) bool of the result; None: computed from its samples.
    """
    chosen = np.asarray(observations)
    chosen = np.flatnonzero(chosen) if chosen.dtype == bool else chosen.astype(np.intp)
    if np.array_equal(chosen, np.arange(domain.observations)):
        return domain
    stack = domain.stack.subset(chosen)
    return replace(
        domain,
        stack=stack,
        solvable=solvable_texels(domain.bake, stack) if solvable is None else solvable,
        lights=domain.lights[chosen],
        intensities=domain.intensities[chosen],
        views=domain.views[chosen],
        beams=None if domain.beams is None else domain.beams[chosen],
        unseen=tuple(np.flatnonzero(np.isin(chosen, domain.unseen)).tolist()),
        shaded=tuple(np.flatnonzero(np.isin(chosen, domain.shaded)).tolist()),
    )


def with_texels(domain: Domain, bake: GeometryBake, values: np.ndarray, seams: SeamMap | None = None) -> Domain:
    """Return a domain of other texels, whole and at the origin, with samples ``values`` (K, H, W, 4).

    Lights, views, noise, unseen and shaded stay those of ``domain``.
    """
    return with_samples(replace(domain, bake=bake, seams=seams, origin=(0, 0), halo=(0, 0, 0, 0)), values)


def tile(domain: Domain, x0: int, y0: int, width: int, height: int, halo: int = 0) -> Domain:
    """Return texels [x0, x0 + width) × [y0, y0 + height) of a domain as one of its own, with a halo around them.

    The halo is ``halo`` texels wide, less where the domain ends; the tile's arrays include it, and its origin is that
    of the halo's corner. The arrays are views, not copies; the texels that it sees across UV seams are the ghosts of
    its seams. Raises ValueError where the tile leaves the domain.
    """
    rows, columns = domain.shape
    if not (width > 0 and height > 0 and halo >= 0 and 0 <= x0 <= columns - width and 0 <= y0 <= rows - height):
        raise ValueError(f"tile {width}×{height} at ({x0}, {y0}), halo {halo}, leaves the domain of {columns}×{rows}")
    left, right = min(halo, x0), min(halo, columns - x0 - width)
    bottom, top = min(halo, y0), min(halo, rows - y0 - height)
    part = (slice(y0 - bottom, y0 + height + top), slice(x0 - left, x0 + width + right))
    seams, box = domain.seams, (x0, y0, width, height)
    if seams is not None:
        frames = domain.bake.normal, domain.bake.tangent
        seams = tile_seams(seams, domain.solvable, *frames, domain.origin, box, halo)
    return replace(
        domain,
        bake=domain.bake.map_arrays(lambda values: values[part]),
        stack=domain.stack.window(*part),
        solvable=domain.solvable[part],
        origin=(domain.origin[0] + x0 - left, domain.origin[1] + y0 - bottom),
        halo=(left, right, bottom, top),
        seams=seams,
    )
