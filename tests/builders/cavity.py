"""Hollow spheres and parts of them, whose places all receive the same from one another: form factors are areas.

Siegel & Howell, Thermal Radiation Heat Transfer: the inside of a sphere.
"""

from __future__ import annotations

import numpy as np

from irpso_addon.geometry.domain import Domain, domain_of
from irpso_addon.geometry.surface.bake import bake_uv
from irpso_addon.geometry.surface.mesh import MeshData
from tests.oracles.geometry import mesh_from_grid


def cavity_mesh(opening: float = -1.0) -> MeshData:
    """Return a sphere of radius 1 whose normals face its middle, without what lies below z = ``opening``.

    Unwrapped by longitude and height, which keeps areas.
    """

    def place(u, v):
        height = np.clip(opening + v * (1 - opening), -1, 1)
        flat, around = np.sqrt(1 - height**2), -2 * np.pi * u
        return np.stack([flat * np.cos(around), flat * np.sin(around), height], axis=-1)

    return mesh_from_grid(place, lambda u, v: -place(u, v), 96, 48)


def cavity(mesh: MeshData, shape: tuple[int, int] = (24, 48)) -> Domain:
    """Return the domain (H, W) of one photograph from the middle, under a light of intensity 1 there."""
    bake = bake_uv(mesh, *shape[::-1], allow_overlap=True)
    middle = np.float32([[0, 0, 0, 1]])
    return domain_of(bake, np.ones((1, *shape, 4), np.float32), middle, np.ones((1, 3), np.float32), middle, card=False)


def half_cavity(mesh: MeshData, albedo: tuple[float, float, float], lights: np.ndarray, shape=(16, 64)) -> Domain:
    """Return the domain of a matt half sphere, open to −z, photographed along z under distant lights (K, 3).

    mesh: ``cavity_mesh(0.0)``. With the light that it throws on itself, exactly: the opening, of area π, lets in
    π cos θ, of which the mean place, of an area of 2π, receives cos θ / 2; half of what a place sends meets another.
    """
    bake = bake_uv(mesh, *shape[::-1], allow_overlap=True)
    normal, rho = bake.normal.astype(np.float64), np.array(albedo)
    stack = np.ones((len(lights), *shape, 4))
    for sample, light in zip(stack, lights, strict=True):
        cosine = normal @ light
        beyond = (
            -normal[..., 2] + 2 * cosine * light[2]
        )  # height of the place where the way to the light meets the sphere
        lit = (cosine > 0) & (beyond < 0)
        received = 0.5 * rho * (-light[2] / 2) / (1 - 0.5 * rho)
        sample[..., :3] = rho * ((cosine * lit)[..., None] + received)
        sample[..., 3] = lit
    table = np.concatenate([lights, np.zeros((len(lights), 1))], axis=-1)
    views = np.tile((0, 0, -1, 0), (len(lights), 1))
    rows = (np.asarray(a, np.float32) for a in (stack, table, np.ones_like(lights), views))
    return domain_of(bake, *rows, card=False)
