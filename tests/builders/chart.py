"""Photographs of a 24-patch chart with known camera, lamp and position."""

import numpy as np

from irpso_addon.calibration.radiometry.colour_chart import COLUMNS, ROWS, patch_colours

GAP, CARD = 0.12, 0.018  # of the pitch, between patches; reflectance of the black card
SIZE = (240, 180)  # pixels, width and height
CORNERS = np.array([(40.0, 30.0), (205.0, 42.0), (196.0, 150.0), (33.0, 141.0)])  # seen in perspective
CAMERA = np.array([(0.72, 0.25, 0.03), (0.17, 0.75, 0.08), (0.02, 0.28, 0.70)])  # camera's RGB of Rec. 709
TINT = np.array([1.0, 0.8, 0.55])  # a warm lamp
SHADING = np.array([0.35, -0.25])  # slopes of the log illumination, right and down, over −1…1 of the longer side


def random_camera(rng):
    """Return a camera's (3, 3) matrix: rows sum to 1, crosstalk up to 30 %."""
    mixing = rng.uniform(0, 0.3, (3, 3)) * (1 - np.eye(3))
    return mixing + np.diag(1 - mixing.sum(axis=1))


def photographed(
    corners=CORNERS, camera=CAMERA, tint=TINT, shading=SHADING, exposure=0.7, noise=0.0, seed=0, patches=None
):
    """Return (H, W, 3) linear camera RGB, row 0 at the bottom, 2 × 2 samples a pixel. corners: as ``CORNERS``.

    patches: (ROWS, COLUMNS, 3) colours other than the chart's.
    """
    width, height = SIZE
    x, y = np.meshgrid((np.arange(2 * width) + 0.5) / 2, (np.arange(2 * height) + 0.5) / 2)
    # The square's points as homogeneous weights of the corners: independent of the program's solve.
    homogeneous = np.column_stack([corners, np.ones(4)])
    weights = np.linalg.solve(homogeneous[[0, 1, 3]].T, homogeneous[2])  # corner 2 of corners 0, 1 and 3
    basis = homogeneous[[0, 1, 3]] * (weights * (-1, 1, 1))[:, None]  # (0,0), (1,0), (0,1) with their depths
    to_square = np.linalg.inv(np.stack([basis[1] - basis[0], basis[2] - basis[0], basis[0]], axis=-1))
    u, v, w = np.moveaxis(np.stack([x, y, np.ones_like(x)], axis=-1) @ to_square.T, -1, 0)
    u, v = u / w, v / w
    column, row = u * (COLUMNS - GAP), v * (ROWS - GAP)
    inside = (column % 1 < 1 - GAP) & (row % 1 < 1 - GAP) & (u > 0) & (v > 0) & (u < 1) & (v < 1)
    colours = patch_colours() if patches is None else patches
    patch = colours[np.clip(row.astype(int), 0, ROWS - 1), np.clip(column.astype(int), 0, COLUMNS - 1)]
    reflectance = np.where(inside[..., None], patch, CARD)
    fall = np.exp(np.clip(shading[0] * (2 * u - 1) + shading[1] * (2 * v - 1) * ROWS / COLUMNS, -2, 2))
    light = exposure * fall[..., None] * tint * (reflectance @ camera.T)
    light = light.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))[::-1]
    return np.maximum(light + noise * np.random.default_rng(seed).standard_normal(light.shape), 0)


def whole(light):
    """Return (H, W, 4): the light and weight 1, 0 where a channel is 1 or more."""
    return np.concatenate([np.minimum(light, 1), (light < 1).all(axis=-1, keepdims=True)], axis=-1)
