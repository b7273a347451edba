"""A table with balls and decoys, ray traced in numpy (float64) under distant or near lights."""

from dataclasses import dataclass

import numpy as np

from irpso_addon.capture.camera import Camera
from tests.builders.balls import coarse, photographed, rays
from tests.builders.domains import unit

LAMP_DEGREES, LAMP = 5.0, 60.0  # width and radiance of a lamp in mirrors
SKY = 0.03
TABLE = 8.0  # distance from the camera


@dataclass(frozen=True)
class Sphere:
    """A ball. kind: mirror, or matte. centre (3,) and radius: in camera axes."""

    kind: str
    centre: tuple
    radius: float
    albedo: float = 0.7
    hollow: bool = False  # a bowl: the lower half alone


@dataclass(frozen=True)
class Scene:
    """A table with balls. camera: perspective, along −z. up: the table's normal. discs: (x, y, radius, albedo) on it.

    near: lights are positions, as bright in the table's middle as distant ones.
    """

    spheres: tuple = ()
    albedo: float = 0.4
    up: tuple = (0.0, 0.0, 1.0)
    discs: tuple = ()
    texture: float = 0.0
    near: bool = False
    camera: Camera = Camera.from_fov(320, 240, 35.0)


def place(scene, x, y, radius):
    """Return the centre of a ball that lies on the table at x, y of the plane z = −TABLE."""
    up = np.asarray(scene.up)
    foot = np.array([x, y, -TABLE - (x * up[0] + y * up[1]) / up[2]])
    return tuple(foot + radius * up)


def _nearest(scene, origin, ray):
    """Return the distance of the first hit of rays (N, 3) and its object: a sphere's number, −1 the table, −2 none."""
    up = np.asarray(scene.up)
    falling = ray @ up
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(falling < -1e-9, ((np.array([0, 0, -TABLE]) - origin) @ up) / falling, np.inf)
    t = np.where(t > 1e-6, t, np.inf)
    hit = np.where(np.isfinite(t), -1, -2)
    for number, sphere in enumerate(scene.spheres):
        away = origin - np.asarray(sphere.centre)
        half = (away * ray).sum(-1)
        root = half**2 - (away**2).sum(-1) + sphere.radius**2
        for sign in (-1, 1):
            s = np.where(root > 0, -half + sign * np.sqrt(np.maximum(root, 0)), np.inf)
            s = np.where(s > 1e-6, s, np.inf)
            if sphere.hollow:
                point = away + np.where(np.isfinite(s), s, 0)[:, None] * ray
                s = np.where(point @ up < 0, s, np.inf)
            hit, t = np.where(s < t, number, hit), np.minimum(t, s)
    return t, hit


def _radiance(scene, origin, ray, light, bounces=2):
    t, hit = _nearest(scene, origin, ray)
    up = np.asarray(scene.up)
    value = np.full(len(ray), SKY)
    angle = np.degrees(np.arccos(np.clip((ray * _toward(scene, origin, light)[0]).sum(-1), -1, 1)))
    value[(hit == -2) & (angle < LAMP_DEGREES / 2)] = LAMP
    for number in range(-1, len(scene.spheres)):
        mask = hit == number
        if not mask.any():
            continue
        point = origin[mask] + t[mask, None] * ray[mask]
        if number < 0:
            normal = np.broadcast_to(up, point.shape)
            albedo = scene.albedo * (1 + scene.texture * np.sin(9 * point[:, 0]) * np.cos(7 * point[:, 1]))
            for x, y, radius, other in scene.discs:
                albedo = np.where(np.hypot(point[:, 0] - x, point[:, 1] - y) < radius, other, albedo)
        else:
            sphere = scene.spheres[number]
            normal = (point - sphere.centre) / sphere.radius
            normal = np.where((normal * ray[mask]).sum(-1, keepdims=True) > 0, -normal, normal)
            albedo = sphere.albedo
            if sphere.kind == "mirror" and bounces:
                seen = ray[mask] - 2 * (ray[mask] * normal).sum(-1, keepdims=True) * normal
                value[mask] = albedo * _radiance(scene, point + 1e-6 * normal, seen, light, bounces - 1)
                continue
        toward, strength = _toward(scene, point, light)
        shadowed = _nearest(scene, point + 1e-6 * normal, toward)[1] >= 0
        value[mask] = albedo * (SKY + strength * np.maximum((normal * toward).sum(-1), 0) * ~shadowed)
    return value


def _toward(scene, point, light):
    """Return unit vectors from points (N, 3) to the light, and its irradiance there over that of a distant one."""
    if not scene.near:
        return np.broadcast_to(light, point.shape), 1.0
    away = light - point
    square = (away**2).sum(-1)
    return unit(away), ((np.asarray(light) - (0, 0, -TABLE)) ** 2).sum() / square


def photographs(scene, lights, seed=0, fine=2, blur=0.7, noise=0.004, clip=1.0):
    """Return an image (H, W, 4) like a reader's for each light (K, 3), with blur, noise and clipped highlights."""
    camera, rng, images = scene.camera, np.random.default_rng(seed), []
    origin, ray = (np.ascontiguousarray(part).reshape(-1, 3) for part in rays(camera, fine))
    for light in lights:
        light = np.asarray(light, np.float64)
        value = _radiance(scene, origin, ray, light if scene.near else unit(light))
        image = coarse(value.reshape(camera.height * fine, camera.width * fine), fine)
        images.append(photographed(image, rng, blur, noise, clip))
    return images
