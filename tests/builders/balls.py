"""Pictures of balls under known lights, ray traced in numpy, for the tests of the calibration."""

import numpy as np

from irpso_addon.capture.camera import Camera
from tests.builders.domains import unit


def rays(camera, fine=1):
    """Return origins and unit directions (H·fine, W·fine, 3) of rays in camera axes, row 0 at the bottom."""
    x = ((np.arange(camera.width * fine) + 0.5) / fine - camera.centre[0]) / camera.scale[0]
    y = ((np.arange(camera.height * fine) + 0.5) / fine - camera.centre[1]) / camera.scale[1]
    x, y = np.meshgrid(x, y)
    if camera.perspective:
        return np.zeros((*x.shape, 3)), unit(np.stack([x, y, -np.ones_like(x)], axis=-1))
    return np.stack([x, y, 0 * x], axis=-1), np.broadcast_to([0.0, 0.0, -1.0], (*x.shape, 3))


def trace(camera, centre, radius, fine=1):
    """Return points, normals, rays, and whether each hits the sphere, by the quadratic |o + t d − c|² = r²."""
    origin, ray = rays(camera, fine)
    away = origin - np.asarray(centre)
    half = (away * ray).sum(-1)
    inside = half**2 - (away**2).sum(-1) + radius**2
    t = -half - np.sqrt(np.maximum(inside, 0))
    point = origin + t[..., None] * ray
    return point, unit(point - centre), ray, inside > 0


def mirror_image(camera, balls, light, distant=True, width=4.0, fine=6, room=0.05):
    """Return (H, W, 3) of mirror balls [(centre, radius)] in a striped room; lamp: ``width`` degrees, radiance 100."""
    whole = np.full((camera.height, camera.width, 3), room / 2)
    for centre, radius in balls:
        rows, columns = around(camera, centre, radius)
        image = np.repeat(np.repeat(whole[rows, columns, 0], fine, axis=0), fine, axis=1)
        point, normal, ray, hit = trace(part_of(camera, rows, columns), centre, radius, fine)
        seen = ray - 2 * (ray * normal).sum(-1, keepdims=True) * normal
        toward = unit(light) if distant else unit(np.asarray(light) - point)
        off = np.degrees(np.arccos(np.clip((seen * toward).sum(-1), -1, 1)))
        shown = room * (1 + np.sin(9 * seen[..., 0]) * np.cos(7 * seen[..., 1])) + 100 * (off < width / 2)
        whole[rows, columns] = coarse(np.where(hit, shown, image), fine)
    return whole


def around(camera, centre, radius):
    """Return the rows and columns of a ball, as slices."""
    pixels = np.argwhere(trace(camera, centre, radius)[3])
    low, high = np.maximum(pixels.min(axis=0) - 2, 0), pixels.max(axis=0) + 3
    return slice(low[0], min(high[0], camera.height)), slice(low[1], min(high[1], camera.width))


def part_of(camera, rows, columns):
    """Return the camera of a rectangle of the image."""
    middle = (camera.centre[0] - columns.start, camera.centre[1] - rows.start)
    return Camera(columns.stop - columns.start, rows.stop - rows.start, camera.scale, middle, camera.matrix,
                  camera.perspective)  # fmt: skip


def matte_image(camera, balls, light, distant=True, albedo=(0.5, 0.5, 0.5), ambient=0.02, fine=2):
    """Return (H, W, 3) of Lambertian balls: albedo · n·l · irradiance, which a near light has at distance 1."""
    whole = np.full((camera.height, camera.width, 3), float(ambient))
    for centre, radius in balls:
        rows, columns = around(camera, centre, radius)
        image = np.repeat(np.repeat(whole[rows, columns], fine, axis=0), fine, axis=1)
        point, normal, _, hit = trace(part_of(camera, rows, columns), centre, radius, fine)
        toward = np.broadcast_to(light, point.shape) if distant else np.asarray(light) - point
        length = np.linalg.norm(toward, axis=-1)
        shade = np.maximum((normal * toward).sum(-1), 0) / (length if distant else length**3)
        image = np.where(hit[..., None], ambient + shade[..., None] * np.asarray(albedo), image)
        whole[rows, columns] = coarse(image, fine)
    return whole


def coarse(image, fine):
    """Return the mean over fine × fine values; grey becomes RGB."""
    height, width = (side // fine for side in image.shape[:2])
    mean = image.reshape(height, fine, width, fine, -1).mean(axis=(1, 3))
    return np.repeat(mean, 3, axis=-1) if mean.shape[-1] == 1 else mean


def photographed(image, rng, blur=0.0, noise=0.0, clip=None):
    """Return (H, W, 4) like a reader's: blurred (Gaussian, pixels), with noise; clipped pixels have weight 0."""
    if blur:
        reach = int(np.ceil(4 * blur))
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / blur) ** 2)
        kernel /= kernel.sum()
        for axis in (0, 1):
            image = np.apply_along_axis(np.convolve, axis, image, kernel, mode="same")
    image = image + noise * rng.normal(size=image.shape)
    weight = np.ones(image.shape[:2])
    if clip is not None:
        weight = (image < clip).all(axis=-1).astype(float)
        image = np.minimum(image, clip)
    return np.dstack([image, weight]).astype(np.float32)


def degrees(a, b):
    """Return the angle between vectors, degrees."""
    a, b = unit(a), unit(b)
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def cap(count, widest, seed=0):
    """Return (count, 3) unit directions, even over the cap within ``widest`` degrees of z."""
    z = 1 - (1 - np.cos(np.radians(widest))) * (np.arange(count) + 0.5) / count
    phi = np.pi * (3 - np.sqrt(5)) * np.arange(count) + seed
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(phi), flat * np.sin(phi), z], axis=-1)


CAMERAS = {"perspective": Camera.from_fov(200, 160, 40.0), "orthographic": Camera.orthographic(200, 160, 4.0)}
