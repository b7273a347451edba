"""Videos of a textured relief under a moving lamp, rendered in numpy and written by OpenCV, for the tests."""

import numpy as np


def scene(height=120, width=160, seed=0, texture=0.5):
    """Return normals (H, W, 3) and albedo (H, W, 3) of a bumpy textured card, row 0 at the top."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / 24
    waves = [(rng.normal(size=2), rng.uniform(0, 6, 2), rng.uniform(0.1, 0.3)) for _ in range(8)]
    slope_x = sum(a * k[0] * np.cos(k[0] * x + k[1] * y + p[0]) for k, p, a in waves)
    slope_y = sum(a * k[1] * np.cos(k[0] * x + k[1] * y + p[0]) for k, p, a in waves)
    normals = np.stack([-slope_x, slope_y, np.ones_like(x)], axis=-1)
    blocks = np.kron(rng.uniform(1 - texture, 1, (height // 6 + 1, width // 6 + 1)), np.ones((6, 6)))[:height, :width]
    albedo = 0.7 * blocks[..., None] * np.array([1.0, 0.8, 0.6])
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True), albedo


def lit(normals, albedo, light):
    """Return linear radiance (H, W, 3) under a distant light (3,)."""
    return albedo * np.maximum(normals @ np.asarray(light), 0)[..., None]


def direction(azimuth, elevation):
    """Return the unit vector at angles in radians."""
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def rec709(linear):
    """Return the video signal 0…1 of scene-linear values (Rec. ITU-R BT.709-6, item 1.2)."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear < 0.018, 4.5 * linear, 1.099 * linear**0.45 - 0.099)


def write_video(path, frames, code="MJPG"):
    """Write frames (H, W, 3) of values 0…1, row 0 at the top, RGB."""
    import cv2

    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), 24, (width, height))
    for frame in frames:
        writer.write(np.rint(255 * frame[..., ::-1]).astype(np.uint8))
    writer.release()
