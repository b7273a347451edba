"""Photographs of a matt sphere under lamps, computed in closed form."""

import numpy as np

LAMPS, SIDE = 8, 72
STRENGTHS = np.exp(0.3 * np.random.default_rng(3).standard_normal(LAMPS))


def sphere_photographs(camera, places, near):
    """Return radiance (K, H, W, 3) and mask of a matt sphere of radius 1 at the origin."""
    across = camera.points(1.0) - camera.position
    ray = across / np.linalg.norm(across, axis=-1, keepdims=True)
    b = ray @ camera.position
    inside = b**2 - camera.position @ camera.position + 1
    mask = inside > 0.02
    normal = camera.position + ray * (-b - np.sqrt(np.maximum(inside, 0)))[..., None]
    albedo = 0.45 + 0.25 * np.sin(9 * normal)
    pictures = []
    for place, strength in zip(places, STRENGTHS, strict=True):
        toward = place - normal if near else np.broadcast_to(place / np.linalg.norm(place), normal.shape)
        far = np.linalg.norm(toward, axis=-1)
        shading = np.maximum((toward * normal).sum(axis=-1), 0) / far**3
        scale = strength * (place @ place if near else 1)
        pictures.append((albedo * shading[..., None] * scale).astype(np.float32) * mask[..., None])
    return pictures, mask
