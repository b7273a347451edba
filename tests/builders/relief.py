"""Surfaces with relief and lamps around them, for the tests of lights from shading."""

import numpy as np

from irpso_addon.capture.images.exr import write_exr
from tests.oracles.reflectance import MODELS, unit

SIDE = 72


def lamps(count, spread=55.0, uneven=0.15):
    """Return (K, 3) directions over a cone, and strengths."""
    height = np.cos(np.radians(spread)) + (1 - np.cos(np.radians(spread))) * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * 2.39996
    across = np.sqrt(1 - height**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=-1)
    return directions, np.exp(uneven * np.random.default_rng(count).standard_normal(count))


def relief(steep=0.9, perspective=None):
    """Return unit normals (H, W, 3) of a smooth relief. perspective: focal length of its camera in pixels."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE * 2 * np.pi
    slope_x = steep * (np.cos(1.3 * x + 0.4) * np.sin(1.1 * y) + 0.3 * np.cos(2 * x - y))
    slope_y = steep * (np.sin(1.3 * x + 0.4) * np.cos(1.1 * y) * 1.1 / 1.3 - 0.15 * np.cos(2 * x - y))
    if perspective is None:
        return unit(np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1))
    # Slopes of log depth: the point is z (X, Y, −1), the normal the cross product of its derivatives.
    plane = np.stack(np.meshgrid(*[(np.arange(SIDE) + 0.5 - SIDE / 2) / perspective] * 2), axis=-1)
    ray = np.concatenate([plane, -np.ones((SIDE, SIDE, 1))], axis=-1)
    along = [(-slope * perspective / 60)[..., None] * ray / perspective * 60 for slope in (slope_x, slope_y)]
    return unit(np.cross(along[0] + (1, 0, 0), along[1] + (0, 1, 0)))


def ball():
    """Return unit normals and mask of a hemisphere."""
    y, x = (np.mgrid[:SIDE, :SIDE] + 0.5 - SIDE / 2) / (0.45 * SIDE)
    mask = x**2 + y**2 < 0.98
    return np.where(
        mask[..., None], np.stack([x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1), (0, 0, 1)
    ), mask


def write_ball(folder, count=16):
    """Write photographs of a rough ball under lamps and its mask, without light files; return the light directions."""
    normals, mask = ball()
    surface = {"base_color": np.full((*mask.shape, 3), 0.5), "roughness": np.full(mask.shape, 0.85)}
    surface |= {"normal": normals, "specular": np.full(mask.shape, 0.5)}
    directions, strengths = lamps(count)
    write_exr(folder / "mask.exr", {"": {"Y": mask.astype(np.float32)}})
    for number, (light, strength) in enumerate(zip(directions, strengths, strict=True)):
        shown = MODELS["principled"](surface, light, np.array([0.0, 0.0, 1.0]))[..., 0]
        grey = np.where(mask, strength * shown, 0).astype(np.float32)
        write_exr(folder / f"{number:02}.exr", {"": dict.fromkeys("RGB", grey)})
    return directions
