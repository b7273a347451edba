"""Pictures of a flat card on a table, warped in numpy, with corners and camera known in float64."""

from __future__ import annotations

import numpy as np

from irpso_addon.capture.camera import Camera

_OVER = 2  # samples of a pixel along each side


def looking_camera(
    size: tuple[int, int], focal: float, distance: float, tilt: float, around: float, roll: float = 0.0,
    aim: tuple[float, float] = (0.0, 0.0),
) -> Camera:  # fmt: skip
    """Return a camera that looks at the point ``aim`` of the plane z = 0 from ``distance``; angles in degrees."""
    tilt, around, roll = np.radians([tilt, around, roll])
    backward = np.array([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)])
    up = np.array([-np.sin(roll), np.cos(roll), 0.0])
    right = np.cross(up, backward)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(backward, right), backward], axis=-1)
    matrix[:3, 3] = np.array([*aim, 0.0]) + distance * backward
    return Camera(*size, (focal, focal), (size[0] / 2, size[1] / 2), matrix)


def seen_plane(camera: Camera, value) -> np.ndarray:
    """Return the camera's picture (H, W) of the plane z = 0, row 0 at the bottom. value: points (…, 2) → (…)."""
    width, height = camera.width, camera.height
    x = (np.arange(width * _OVER) + 0.5) / _OVER
    y = (np.arange(height * _OVER) + 0.5) / _OVER
    plane = (np.stack(np.meshgrid(x, y), axis=-1) - camera.centre) / np.asarray(camera.scale)
    rays = np.concatenate([plane, np.full((*plane.shape[:-1], 1), -1.0)], axis=-1) @ camera.matrix[:3, :3].T
    places = camera.position[:2] - rays[..., :2] * (camera.position[2] / rays[..., 2:])
    return np.asarray(value(places), float).reshape(height, _OVER, width, _OVER).mean(axis=(1, 3))


def from_upper_left(camera: Camera, places: np.ndarray) -> np.ndarray:
    """Return the pixels (N, 2), from the upper left corner, of points (N, 2) on the plane z = 0."""
    pixels, _ = camera.project(np.insert(np.asarray(places, float), 2, 0.0, axis=1))
    return np.stack([pixels[:, 0], camera.height - pixels[:, 1]], axis=-1)


def texture(seed: int, scale: float = 8.0):
    """Return a function points (…, 2) → values of mean 0.5: waves of several lengths, saturated to sharp blobs."""
    random = np.random.default_rng(seed)
    waves = [(random.normal(size=2) * 2 ** random.uniform(-1, 2) / scale, random.uniform(0, 6.3)) for _ in range(24)]

    def value(places: np.ndarray) -> np.ndarray:
        total = sum(np.sin(places @ k + phase) for k, phase in waves) / np.sqrt(len(waves))
        return 0.5 + 0.4 * np.tanh(2.5 * np.asarray(total))

    return value
