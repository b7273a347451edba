"""Photographs with and without a 24-patch chart or a grey card: random camera, lamp, pose and clutter."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from irpso_addon.calibration.radiometry.colour_chart import COLUMNS, ROWS, patch_colours

from .chart import random_camera

_PITCH = 40  # pixels of the chart's picture between patches
_FINE = 2  # samples of the photograph along a pixel's side


@dataclass(frozen=True)
class Scene:
    """rgba: (H, W, 4) linear, row 0 at the bottom. corners: (4, 2) of the patches, from the upper left; or None."""

    rgba: np.ndarray
    corners: np.ndarray | None


def scene(
    seed: int, chart: bool = True, mirrored: bool = False, coded: bool = True, card: bool = False, dimmest: float = 0.5
) -> Scene:
    """Return the scene of a seed. coded: with 8-bit codes of gamma 2.2, made linear again.

    card: a grey card in place of the chart. dimmest: the least channel of the lamp's tint, up to 1.
    """
    rng = np.random.default_rng(seed)
    width, height = [(640, 480), (960, 720), (1280, 800)][rng.integers(3)]
    seen = _background(rng, width * _FINE, height * _FINE)
    corners = None
    if card:
        corners = _corners(rng, width, height, rng.uniform(0.08, 0.4))
        cv2.fillConvexPoly(seen, (corners * _FINE).astype(int), (0.18 * rng.uniform(0.97, 1.03, 3)).tolist())
    elif chart:
        corners, gap = _corners(rng, width, height), rng.uniform(0.08, 0.16)
        seen = _with_chart(rng, seen, corners * _FINE, gap, mirrored)
        corners = _of_patches(corners, gap, mirrored)
    seen = cv2.resize(seen, (width, height), interpolation=cv2.INTER_AREA)
    seen = cv2.GaussianBlur(seen, (0, 0), rng.uniform(0.3, 1.0))
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    fall = np.exp(rng.uniform(-0.5, 0.5) * x + rng.uniform(-0.5, 0.5) * y)
    tint = rng.uniform(dimmest, 1, 3)
    light = rng.uniform(0.5, 0.95) * fall[..., None] * (tint / tint.max()) * (seen @ random_camera(rng).T)
    light += light.max() * rng.uniform(0.001, 0.008) * rng.standard_normal(light.shape)
    codes = np.rint(255 * np.clip(light, 0, 1) ** (1 / 2.2)) if coded else 255 * np.clip(light, 0, 1) ** (1 / 2.2)
    rgba = np.concatenate([(codes / 255) ** 2.2, (codes < 255).all(axis=-1, keepdims=True)], axis=-1)
    return Scene(rgba[::-1].astype(np.float32), corners)


def _corners(rng, width, height, share=None):
    """Return corners (4, 2) of a randomly turned and tilted card, all inside the picture."""
    while True:
        wide = (share or rng.uniform(0.18, 0.8)) * width
        flat = wide * np.array([(-1, -0.7), (1, -0.7), (1, 0.7), (-1, 0.7)]) / 2
        turn, tilt, axis = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(0, 45)), rng.uniform(0, 2 * np.pi)
        places = np.column_stack([flat @ _turn(turn).T @ _turn(axis).T, np.zeros(4)])
        places = places @ np.array([(1, 0, 0), (0, np.cos(tilt), -np.sin(tilt)), (0, np.sin(tilt), np.cos(tilt))])
        places[:, :2] = places[:, :2] @ _turn(-axis).T
        far = 2.0 * width
        corners = far * places[:, :2] / (far - places[:, 2:]) + rng.uniform(0.1, 0.9, 2) * (width, height)
        if ((corners > 2) & (corners < (width - 2, height - 2))).all():
            return corners


def _turn(angle):
    return np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])


_MARGIN = 0.35  # of the pitch, of black card beyond the patches


def _of_patches(corners, gap, mirrored):
    """Return the corners of the field of patches from those of the card."""
    wide, tall = COLUMNS - gap + 2 * _MARGIN, ROWS - gap + 2 * _MARGIN
    whole = np.array([(0, 0), (wide, 0), (wide, tall), (0, tall)], np.float32)
    to_picture = cv2.getPerspectiveTransform(whole, corners.astype(np.float32))
    inner = np.array([(_MARGIN, _MARGIN), (wide - _MARGIN, _MARGIN), (wide - _MARGIN, tall - _MARGIN),
                      (_MARGIN, tall - _MARGIN)], np.float32)  # fmt: skip
    patch_corners = cv2.perspectiveTransform(inner[None], to_picture)[0].astype(np.float64)
    return patch_corners[[1, 0, 3, 2]] if mirrored else patch_corners


def _with_chart(rng, seen, corners, gap, mirrored):
    wide, tall = COLUMNS - gap + 2 * _MARGIN, ROWS - gap + 2 * _MARGIN
    x = (np.arange(round(wide * _PITCH)) + 0.5) / _PITCH - _MARGIN
    y = (np.arange(round(tall * _PITCH)) + 0.5) / _PITCH - _MARGIN
    inside = ((y % 1 < 1 - gap) & (y > 0) & (y < ROWS))[:, None] & ((x % 1 < 1 - gap) & (x > 0) & (x < COLUMNS))
    row, column = (np.clip(np.floor(p).astype(int), 0, n - 1) for p, n in ((y, ROWS), (x, COLUMNS)))
    picture = np.where(inside[..., None], patch_colours()[row[:, None], column], rng.uniform(0.01, 0.03))
    if mirrored:
        picture = picture[:, ::-1]
    height, width = picture.shape[:2]
    whole = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32)
    matrix = cv2.getPerspectiveTransform(whole, corners.astype(np.float32))
    size = seen.shape[1::-1]
    over = cv2.warpPerspective(picture, matrix, size, flags=cv2.INTER_AREA)
    cover = cv2.warpPerspective(np.ones(picture.shape[:2]), matrix, size)[..., None]
    return seen * (1 - cover) + over * cover


def _background(rng, width, height):
    """Return (H, W, 3) reflectance: a grained ground with cards, tiles, checks, discs, lines and text-like rows."""
    ground = rng.uniform(0.05, 0.6, 3)
    grain = sum(cv2.resize(rng.standard_normal((max(2, height // s), max(2, width // s))), (width, height)) / 3
                for s in (4, 16, 64))  # fmt: skip
    picture = ground * np.exp(rng.uniform(0, 0.5) * grain)[..., None]
    for _ in range(rng.integers(0, 14)):
        kind, colour = rng.integers(5), rng.uniform(0.02, 0.9, 3)
        x, y, size = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(0.03, 0.3) * width
        if kind == 0:
            box = cv2.boxPoints(((x, y), (size, size * rng.uniform(0.2, 1)), rng.uniform(0, 180)))
            cv2.fillConvexPoly(picture, box.astype(int), colour.tolist())
        elif kind == 1:
            cv2.circle(picture, (int(x), int(y)), int(size / 2), colour.tolist(), -1)
        elif kind == 2:
            _tiles(rng, picture, int(x), int(y), size)
        elif kind == 3:
            for _ in range(5):
                end = rng.uniform(0, 1, 2) * (width, height)
                cv2.line(
                    picture, (int(x), int(y)), tuple(int(v) for v in end), colour.tolist(), int(rng.integers(1, 8))
                )
        else:
            for n in range(8):
                cv2.putText(picture, "IRPSO 0123", (int(x), int(y + n * size / 6)), 0, size / 300, colour.tolist(), 2)
    return picture


def _tiles(rng, picture, x, y, size):
    """Paint rows of tiles that resemble a chart: checks, greys or random colours."""
    columns, rows, pitch = rng.integers(3, 9), rng.integers(3, 7), max(4, int(size / 6))
    colours = rng.uniform(0.02, 0.9, (rows, columns, 3))
    style = rng.integers(3)
    if style == 0:
        colours[:] = np.where((np.indices((rows, columns)).sum(axis=0) % 2)[..., None], 0.03, 0.8)
    elif style == 1:
        colours[:] = colours[..., :1]
    gap = int(rng.uniform(0.05, 0.2) * pitch)
    cv2.rectangle(picture, (x - gap, y - gap), (x + int(columns) * pitch, y + int(rows) * pitch), (0.02,) * 3, -1)
    for r in range(rows):
        for c in range(columns):
            low = (x + c * pitch, y + r * pitch)
            cv2.rectangle(picture, low, (low[0] + pitch - gap, low[1] + pitch - gap), colours[r, c].tolist(), -1)
