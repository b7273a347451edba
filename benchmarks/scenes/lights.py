"""Where the lights of a capture stand and how bright they are. Plain numpy."""

from __future__ import annotations

import numpy as np

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def grid_lights(
    columns: int = 12, rows: int = 8, widest: tuple[float, float] = (45.0, 35.0), seed: int = 0
) -> np.ndarray:
    """Return (columns·rows, 3) unit directions on a grid around +z, as the light frame of DiLiGenT has them.

    widest: degrees to the side and up of the outermost lights. Each light is up to a degree off its place (seed).
    """
    rng = np.random.default_rng(seed)
    side, up = np.meshgrid(np.linspace(-widest[0], widest[0], columns), np.linspace(widest[1], -widest[1], rows))
    angles = np.radians(np.stack([side, up], axis=-1).reshape(-1, 2) + rng.uniform(-1, 1, (columns * rows, 2)))
    return _unit(np.concatenate([np.tan(angles), np.ones((columns * rows, 1))], axis=-1))


def dome_lights(count: int, widest: float) -> np.ndarray:
    """Return (count, 3) unit directions spread evenly, on a spiral, over the cap of ``widest`` degrees around +z."""
    height = 1 - (1 - np.cos(np.radians(widest))) * (np.arange(count) + 0.5) / count
    flat, around = np.sqrt(1 - height**2), _GOLDEN_ANGLE * np.arange(count)
    return np.stack([flat * np.cos(around), flat * np.sin(around), height], axis=-1)


def seen_and_unseen() -> tuple[np.ndarray, np.ndarray]:
    """Return the directions of a capture's 40 lights, up to 60° off +z, and of 10 more, 5° to 10° from the nearest."""
    return dome_lights(40, 60.0), dome_lights(10, 54.0)


def uneven_intensities(count: int, low: float, high: float, seed: int = 0) -> np.ndarray:
    """Return (count, 3) RGB intensities from ``low`` to ``high``: bulbs that differ, a little in hue too."""
    rng = np.random.default_rng(seed)
    brightness = rng.uniform(low, high, (count, 1))
    return np.clip(brightness * rng.uniform(0.8, 1.25, (count, 3)), low, high)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
