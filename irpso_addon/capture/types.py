"""What was photographed: observations, their lights, their cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .camera import Camera


@dataclass(frozen=True)
class Light:
    """One light of a capture.

    vector: (3,) a unit direction from the surface to a distant light, or the position of a near one in world units.
    intensity: (3,) linear RGB; 1 is an irradiance of π at normal incidence (at distance 1 from a near light, falling
    with the inverse square), so that a white Lambertian texel facing the light has radiance 1.
    """

    vector: tuple[float, float, float]
    intensity: tuple[float, float, float] = (1.0, 1.0, 1.0)
    distant: bool = True


@dataclass(frozen=True)
class Observation:
    """One image, its light and its camera.

    read: returns (H, W, 4) float32, row 0 at the bottom: linear Rec. 709 radiance, and in alpha the weight of the
    pixel, 0 where it is clipped or not a number. Reading is put off until it is needed. camera: an index.
    """

    name: str
    read: Callable[[], np.ndarray]
    light: Light
    camera: int = 0


@dataclass(frozen=True)
class Capture:
    """The observations of one subject. masks: one (H, W) bool array per camera, row 0 at the bottom."""

    name: str
    observations: tuple[Observation, ...]
    cameras: tuple[Camera, ...]
    masks: tuple[np.ndarray, ...]
    source: Path | None = None
