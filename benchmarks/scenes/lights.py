"""Directions, positions and intensities of the lights of a capture. Plain numpy."""

from __future__ import annotations

import numpy as np

from irpso_addon.geometry.spaces import unit

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
_GOLDEN_RATIO = (np.sqrt(5) - 1) / 2


def grid_lights(
    columns: int = 12, rows: int = 8, widest: tuple[float, float] = (45.0, 35.0), seed: int = 0
) -> np.ndarray:
    """Return (columns·rows, 3) unit directions on a grid around +z, as on DiLiGenT's light frame.

    widest: degrees to the side and up of the outermost lights. Each light is up to a degree off its place (seed).
    """
    rng = np.random.default_rng(seed)
    side, up = np.meshgrid(np.linspace(-widest[0], widest[0], columns), np.linspace(widest[1], -widest[1], rows))
    angles = np.radians(np.stack([side, up], axis=-1).reshape(-1, 2) + rng.uniform(-1, 1, (columns * rows, 2)))
    return unit(np.concatenate([np.tan(angles), np.ones((columns * rows, 1))], axis=-1))


def dome_lights(count: int, widest: float, narrowest: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Return (count, 3) unit directions spread evenly, on a spiral, over the cap of ``widest`` degrees around +z.

    narrowest: least degrees off +z. turn: degrees by which the spiral is turned around +z.
    """
    top, low = np.cos(np.radians([narrowest, widest]))
    height = top - (top - low) * (np.arange(count) + 0.5) / count
    flat, around = np.sqrt(1 - height**2), _GOLDEN_ANGLE * np.arange(count) + np.radians(turn)
    return np.stack([flat * np.cos(around), flat * np.sin(around), height], axis=-1)


def lamp_places(
    count: int, off_axis: tuple[float, float], distance: tuple[float, float], turn: float = 0.0
) -> np.ndarray:
    """Return (count, 3) positions of near lamps, evenly between two angles off +z and two distances from the origin.

    off_axis: degrees. Distances follow the golden ratio, so that those of neighbouring lamps differ.
    """
    share = np.arange(1, count + 1) * _GOLDEN_RATIO % 1
    far = distance[0] + (distance[1] - distance[0]) * share
    return far[:, None] * dome_lights(count, off_axis[1], off_axis[0], turn)


def seen_and_unseen() -> tuple[np.ndarray, np.ndarray]:
    """Return the directions of a capture's 40 lights, up to 60° off +z, and of 10 more, 5° to 10° from the nearest."""
    return dome_lights(40, 60.0), dome_lights(10, 54.0)


def uneven_intensities(count: int, low: float, high: float, seed: int = 0) -> np.ndarray:
    """Return (count, 3) RGB intensities from ``low`` to ``high``, with slightly different hues."""
    rng = np.random.default_rng(seed)
    brightness = rng.uniform(low, high, (count, 1))
    return np.clip(brightness * rng.uniform(0.8, 1.25, (count, 3)), low, high)
