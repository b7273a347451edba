"""Geometry of interreflection: the surface of the subject itself, a mesh or the relief of a card."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

import numpy as np

from ...capture.camera import Camera
from ...core.errors import InputError
from ...core.steps import map_steps
from ..domain import Domain
from ..surface.bake import surface_bake
from ..surface.mesh import MeshData
from .card_relief import card_surface_steps, relief_stride
from .light_transport import Cast, LightTransport, light_transport_steps, lit_steps

T = TypeVar("T")
Values = Mapping[str, np.ndarray]  # parameter name → (H, W, components)
CasterOf = Callable[[MeshData], Generator[None, None, Cast]]  # ray_caster_steps of blender/ray_caster.py
_KEPT_LIGHTS = 3  # sets of lights: of the fitted photographs, before and after a change, and of the held-out ones


@dataclass(frozen=True, eq=False)
class InterreflectionSurface:
    """A surface that lights itself. domain: its texels. transport: between its elements. values: the maps on it.

    shadowed: whether samples show indirect light alone where the surface hides their light.
    """

    domain: Domain
    transport: LightTransport
    values: Values
    shadowed: bool = True


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
    """A mesh: maps do not change its shape. resolution, rays: as for ``light_transport_steps``.

    shadowed: whether the mesh's cast shadows are those of the photographs.
    """

    mesh: MeshData
    caster_of: CasterOf
    resolution: int
    rays: int
    shadowed: bool = True
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
            cast = yield from _at_begin(self.caster_of(self.mesh))
            self._transport = yield from light_transport_steps(*shape, domain.lights, cast, self.resolution, self.rays)
            self._lit[lights] = self._transport.lit
        if lights not in self._lit:
            cast = yield from _at_begin(self.caster_of(self.mesh))
            lit = yield from lit_steps(*shape, self._transport.texels, domain.lights, cast)
            while len(self._lit) >= _KEPT_LIGHTS:
                self._lit.pop(next(iter(self._lit)))
            self._lit[lights] = lit
        return InterreflectionSurface(domain, replace(self._transport, lit=self._lit[lights]), values, self.shadowed)


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
        normals, stride = values[self.normal], relief_stride(domain.shape, self.resolution)
        mesh, bake = yield from _at_begin(
            card_surface_steps(self.camera, domain.bake, domain.solvable, normals, stride)
        )
        if not len(mesh.positions):
            raise InputError(
                "interreflection: the card's texels touch nowhere, so they have no relief that throws light; recover"
                " with --set interreflection_rounds=0"
            )
        cast = yield from _at_begin(self.caster_of(mesh))
        transport = yield from light_transport_steps(mesh, bake, domain.lights, cast, self.resolution, self.rays)
        own = np.zeros((*domain.shape, 3), np.float32)
        own[..., 2] = 1
        return InterreflectionSurface(replace(domain, bake=bake, card=False), transport, {**values, self.normal: own})


def _at_begin(steps: Generator[None, None, T]) -> Generator[float, None, T]:
    """Run steps before the first ray: yield 0 each time, return their result."""
    return map_steps(steps, lambda step: 0.0)
