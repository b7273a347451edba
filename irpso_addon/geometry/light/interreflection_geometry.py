"""Geometry of interreflection: the surface of the subject itself, a mesh or the relief of a card."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from ...capture.camera import Camera
from ...core.errors import InputError
from ..domain import Domain
from ..relief.relief import card_height
from ..surface.bake import SurfaceBake, surface_bake
from ..surface.mesh import MeshData
from .light_transport import Cast, LightTransport, light_transport_steps, lit_steps

Values = Mapping[str, np.ndarray]  # parameter name → (H, W, components)
CasterOf = Callable[[MeshData], Cast]  # blender/ray_caster.py
RELIEF_TRIANGLES = 2  # of a card's relief, per texel
_KEPT_LIGHTS = 3  # sets of lights: of the fitted photographs, before and after a change, and of the held-out ones


@dataclass(frozen=True, eq=False)
class InterreflectionSurface:
    """A surface that lights itself. domain: its texels. transport: between its elements. values: the maps on it."""

    domain: Domain
    transport: LightTransport
    values: Values


class InterreflectionGeometry(Protocol):
    """Builds the surface of the subject from a domain and its maps.

    known_shape: whether the surface is independent of the maps. identity: what must be equal, besides the domain, to
    resume a checkpoint.
    """

    known_shape: bool

    @property
    def identity(self) -> dict[str, str]: ...

    def steps(self, domain: Domain, values: Values) -> Generator[float, None, InterreflectionSurface]:
        """Yield the fraction of the work done; return the surface."""


@dataclass
class MeshInterreflection:
    """A mesh: maps do not change its shape. resolution, rays: as for ``light_transport_steps``."""

    mesh: MeshData
    caster_of: CasterOf
    resolution: int
    rays: int
    known_shape: bool = True
    _transport: LightTransport | None = None
    _lit: dict[bytes, np.ndarray] = field(default_factory=dict)  # of the last lights (K, 4): LightTransport.lit

    @property
    def identity(self) -> dict[str, str]:
        """A hash of what blocks light: the samples do not always show that an occluder or another slot has changed."""
        mesh = self.mesh
        others = mesh.positions[:0] if mesh.solved is None else mesh.positions[~mesh.solved]
        return {"occluders": hashlib.sha256(mesh.occluders.tobytes() + others.tobytes()).hexdigest()}

    def steps(self, domain: Domain, values: Values) -> Generator[float, None, InterreflectionSurface]:
        """As InterreflectionGeometry. The first call casts all rays, one under new lights only those to the lights."""
        shape, lights = (self.mesh, surface_bake(domain.bake)), domain.lights.tobytes()
        if self._transport is None:
            cast = self.caster_of(self.mesh)
            self._transport = yield from light_transport_steps(*shape, domain.lights, cast, self.resolution, self.rays)
            self._lit[lights] = self._transport.lit
        if lights not in self._lit:
            texels = self._transport.texels
            lit = yield from lit_steps(*shape, texels, domain.lights, self.caster_of(self.mesh))
            while len(self._lit) >= _KEPT_LIGHTS:
                self._lit.pop(next(iter(self._lit)))
            self._lit[lights] = lit
        return InterreflectionSurface(domain, replace(self._transport, lit=self._lit[lights]), values)


@dataclass
class CardInterreflection:
    """The relief of a card, integrated from its normals. normal: the parameter's name."""

    camera: Camera
    normal: str
    caster_of: CasterOf
    resolution: int
    rays: int
    known_shape: bool = False

    @property
    def identity(self) -> dict[str, str]:
        """As InterreflectionGeometry."""
        return {}

    def steps(self, domain: Domain, values: Values) -> Generator[float, None, InterreflectionSurface]:
        """As InterreflectionGeometry. Every call casts all rays: the relief depends on the maps."""
        mesh, bake = card_surface(self.camera, domain, values[self.normal])
        if not len(mesh.positions):
            raise InputError(
                "interreflection: the card's texels touch nowhere, so they have no relief that throws light; recover"
                " with --set interreflection_rounds=0"
            )
        cast = self.caster_of(mesh)
        transport = yield from light_transport_steps(mesh, bake, domain.lights, cast, self.resolution, self.rays)
        own = np.zeros((*domain.shape, 3), np.float32)
        own[..., 2] = 1
        return InterreflectionSurface(replace(domain, bake=bake, card=False), transport, {**values, self.normal: own})


def card_surface(camera: Camera, domain: Domain, normals: np.ndarray) -> tuple[MeshData, SurfaceBake]:
    """Return the relief of a card's normals (H, W, 3) as a mesh with a vertex at each texel, and as a bake.

    The frames of the bake have the normals as z. Its coverage is the domain's solvable texels.
    """
    covered, flat = domain.solvable, domain.bake
    up = np.where(covered[..., None], normals, (0.0, 0.0, 1.0)).astype(np.float64)
    height = card_height(camera, up, covered).values.astype(np.float64)[..., None] / camera.scale[0]
    places = flat.position * (1 - height) if camera.perspective else flat.position + height * (0, 0, 1)
    along = np.stack([up[..., 2], np.zeros(covered.shape), -up[..., 0]], axis=-1)
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    facing = np.cross(np.gradient(places, axis=1), np.gradient(places, axis=0)) if min(covered.shape) > 1 else up
    # Beside an uncovered texel a difference of positions is no slope: rim texels would face along the card.
    facing = np.where((facing[..., 2:] > 0) & _surrounded(covered)[..., None], facing, up)
    facing /= np.linalg.norm(facing, axis=-1, keepdims=True)
    tangent = np.concatenate([along, np.ones((*covered.shape, 1))], axis=-1)
    bake = SurfaceBake(
        places.astype(np.float32), up.astype(np.float32), tangent.astype(np.float32), covered, flat.uv,
        facing.astype(np.float32), np.zeros(covered.shape, np.int32),
    )  # fmt: skip
    return _mesh_over(bake), bake


def _surrounded(covered: np.ndarray) -> np.ndarray:
    """Return (H, W) bool: covered texels whose neighbours in row and column are covered, or beyond the image."""
    around = np.pad(covered, 1, mode="edge")
    return covered & around[:-2, 1:-1] & around[2:, 1:-1] & around[1:-1, :-2] & around[1:-1, 2:]


def _mesh_over(bake: SurfaceBake) -> MeshData:
    """Return two triangles for each four covered texels beside one another."""
    covered = bake.coverage
    row, column = np.nonzero(covered[:-1, :-1] & covered[1:, :-1] & covered[:-1, 1:] & covered[1:, 1:])
    corners = np.array([[(0, 0), (0, 1), (1, 1)], [(0, 0), (1, 1), (1, 0)]])
    at = (np.stack([row, column], axis=-1)[:, None, None] + corners).reshape(-1, 3, 2)
    part = at[..., 0], at[..., 1]
    return MeshData(
        "relief", bake.position[part], bake.normal[part], bake.tangent[part], bake.uv[part],
        np.zeros(len(at), np.int32), "", np.eye(4),
    )  # fmt: skip
