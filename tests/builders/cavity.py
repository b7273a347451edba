"""Hollow spheres and parts of them: the form factor to any part of a sphere from inside is its share of the area.

Siegel & Howell, Thermal Radiation Heat Transfer: the inside of a sphere.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from irpso_addon.capture.camera import Camera
from irpso_addon.geometry.domain import Domain, GeometryBake, domain_of
from irpso_addon.geometry.surface.bake import bake_uv
from irpso_addon.geometry.surface.mesh import MeshData
from tests.oracles.geometry import mesh_from_grid


def cavity_mesh(opening: float = -1.0) -> MeshData:
    """Return a sphere of radius 1 with normals to its centre, cut off below z = ``opening``.

    Unwrapped by longitude and height, which preserves areas.
    """

    def place(u, v):
        height = np.clip(opening + v * (1 - opening), -1, 1)
        flat, around = np.sqrt(1 - height**2), -2 * np.pi * u
        return np.stack([flat * np.cos(around), flat * np.sin(around), height], axis=-1)

    return mesh_from_grid(place, lambda u, v: -place(u, v), 96, 48)


def cavity(mesh: MeshData, shape: tuple[int, int] = (24, 48)) -> Domain:
    """Return the domain (H, W) of one photograph from the centre, under a light of intensity 1 there."""
    bake = bake_uv(mesh, *shape[::-1], allow_overlap=True)
    middle = np.float32([[0, 0, 0, 1]])
    return domain_of(bake, np.ones((1, *shape, 4), np.float32), middle, np.ones((1, 3), np.float32), middle, card=False)


def cap_card(
    albedo: tuple[float, float, float], lights: np.ndarray, side: int = 40
) -> tuple[Domain, Camera, np.ndarray]:
    """Return domain, camera and normals (H, W, 3) of a matt hollow cap, 60° of a sphere of radius 1, seen from above.

    Interreflection is exact: the opening, of area 3π/4, lets in 3π/4 cos θ, which falls on an area of π; a quarter of
    the light that a point reflects meets the cap again. lights: (K, 3) distant.
    """
    camera = Camera.orthographic(side, side, 2.0)
    along = ((np.arange(side) + 0.5) / side - 0.5) * 2
    x, y = np.meshgrid(along, along)
    covered = np.hypot(x, y) < np.sin(np.pi / 3)
    place = np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)
    normal = np.where(covered[..., None], -place, (0.0, 0.0, 1.0))
    rho, stack = np.array(albedo), np.zeros((len(lights), side, side, 4))
    for sample, light in zip(stack, lights, strict=True):
        cosine = normal @ light
        beyond = place[..., 2] + 2 * cosine * light[2]  # height where the ray to the light meets the sphere
        direct = np.where((cosine > 0) & (beyond > -0.5), cosine, 0)
        received = 0.25 * rho * (0.75 * light[2]) / (1 - 0.25 * rho)
        sample[covered] = np.concatenate([rho * (direct[..., None] + received), np.ones((side, side, 1))], axis=-1)[
            covered
        ]
    flat = np.stack([x, y, np.zeros_like(x)], axis=-1)
    bake = GeometryBake(
        flat.astype(np.float32), np.tile(np.float32([0, 0, 1]), (side, side, 1)),
        np.tile(np.float32([1, 0, 0, 1]), (side, side, 1)), covered,
        ((flat[..., :2] + 1) / 2).astype(np.float32),
    )  # fmt: skip
    return domain_of(bake, *_rows(stack, lights, (0, 0, 1, 0))), camera, normal


def half_cavity(mesh: MeshData, albedo: tuple[float, float, float], lights: np.ndarray, shape=(16, 64)) -> Domain:
    """Return the domain of a matt half sphere, open to −z, photographed along z under distant lights (K, 3).

    mesh: ``cavity_mesh(0.0)``. Interreflection is exact: the opening, of area π, lets in π cos θ, which is cos θ / 2 on
    average over the area of 2π; half of the light that a point reflects meets the half sphere again.
    """
    bake = bake_uv(mesh, *shape[::-1], allow_overlap=True)
    normal, rho = bake.normal.astype(np.float64), np.array(albedo)
    stack = np.ones((len(lights), *shape, 4))
    for sample, light in zip(stack, lights, strict=True):
        cosine = normal @ light
        beyond = -normal[..., 2] + 2 * cosine * light[2]  # height where the ray to the light meets the sphere
        lit = (cosine > 0) & (beyond < 0)
        received = 0.5 * rho * (-light[2] / 2) / (1 - 0.5 * rho)
        sample[..., :3] = rho * ((cosine * lit)[..., None] + received)
        sample[..., 3] = lit
    return domain_of(bake, *_rows(stack, lights, (0, 0, -1, 0)), card=False)


def _rows(stack: np.ndarray, lights: np.ndarray, view: tuple[float, ...]) -> Iterator[np.ndarray]:
    """Yield samples, lights, intensities and views as a Domain has them."""
    table = np.concatenate([lights, np.zeros((len(lights), 1))], axis=-1)
    for values in (stack, table, np.ones_like(lights), np.tile(view, (len(lights), 1))):
        yield np.asarray(values, np.float32)
