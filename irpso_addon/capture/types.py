"""``Capture``: observations with their lights and cameras."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .camera import Camera
from .errors import CaptureError
from .images.encoding import Encoding


def triple(values: Iterable[float]) -> tuple[float, float, float]:
    """Return three numbers, such as an array (3,), as a tuple of floats."""
    x, y, z = map(float, values)
    return x, y, z


@dataclass(frozen=True)
class Light:
    """One light of a capture.

    vector: (3,) a unit direction from the surface to a distant light, or the position of a near one in world units.
    intensity: (3,) linear RGB; 1 is an irradiance of π at normal incidence (at distance 1 from a near light, falling
    with the inverse square), so that a white Lambertian texel facing the light has radiance 1. For a
    directed near light it is the intensity along the axis. axis: (3,) unit direction of emission. cone: half-angle of
    a spot in degrees; the intensity is 0 outside it. cosine: exponent of the cosine of the angle to the axis, by which
    the intensity falls off: 0 for none, 1 for a flat emitter, more for a phone's flash. Raises InputError if these
    contradict each other.
    """

    vector: tuple[float, float, float]
    intensity: tuple[float, float, float] = (1.0, 1.0, 1.0)
    distant: bool = True
    axis: tuple[float, float, float] | None = None
    cone: float | None = None
    cosine: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.vector).all() or (self.distant and not np.any(self.vector)):
            raise CaptureError("a light's direction or position is three finite numbers, a direction not all zero")
        if self.axis is None and (self.cone is not None or self.cosine):
            raise CaptureError("a light with a cone or a cosine has an axis; give the direction in which it shines")
        if self.axis is not None and self.distant:
            raise CaptureError("a distant light has no axis and no cone; give its position, or leave them out")
        if not 0 <= self.cosine < math.inf:
            raise CaptureError("a light's cosine is a power of 0 or more")
        if self.cone is not None and not 0 < self.cone <= 180:
            raise CaptureError("a light's cone is a half-angle above 0 and up to 180 degrees")

    def relative_intensity(self, points: np.ndarray) -> np.ndarray:
        """Return (…) the fraction 0…1 of the axial intensity in the direction of points (…, 3), without distance."""
        return beam_share(points - np.asarray(self.vector, np.float64), self.beam)

    @property
    def beam(self) -> np.ndarray:
        """(5,) for ``beam_share``: axis, cosine of the cone, exponent; (0, 0, 0, −1, 0) for an isotropic light."""
        # 5e-7 degrees of tolerance: points on the cone's border within rounding are inside.
        border = -1.0 if self.cone is None else math.cos(math.radians(min(self.cone + 5e-7, 180)))
        return np.array([*((0.0, 0.0, 0.0) if self.axis is None else self.axis), border, self.cosine])


def beam_share(away: np.ndarray, beam: np.ndarray) -> np.ndarray:
    """Return (…) the fraction 0…1 of a light's axial intensity along vectors (…, 3) away from it; beam: (5,)."""
    axis, border, exponent = beam[:3], beam[3], beam[4]
    cosine = away @ axis / np.maximum(np.linalg.norm(away, axis=-1), 1e-300)
    share = np.maximum(cosine, 0) ** exponent if exponent else np.ones_like(cosine)
    return np.where(cosine >= border, share, 0.0)


@dataclass(frozen=True)
class Observation:
    """One image, its light and its camera.

    read: returns (H, W, 4) float32, row 0 at the bottom: linear Rec. 709 radiance, and in alpha the weight of the
    pixel, 0 for NaN, below 0 for clipped pixels (capture/bounds.py). camera: index in Capture.cameras. coarse: whether
    its file holds 8-bit sRGB codes.
    """

    name: str
    read: Callable[[], np.ndarray]
    light: Light
    camera: int = 0
    coarse: bool = False


@dataclass(frozen=True)
class LeftOut:
    """An observation excluded for its damaged image. index: in the list of the capture's files, from 0.

    name: in that list, "" for that of the image.
    """

    index: int
    image: str
    why: str
    name: str = ""


@dataclass(frozen=True)
class Capture:
    """The observations of one subject. masks: one (H, W) bool array per camera, row 0 at the bottom.

    card_distance: from the camera to a flat subject, along the camera's axis, in the unit of the lights' positions;
    None if unknown. Raises InputError if it is not above 0. left_out: listed observations that were excluded.
    encoding: of files that were read with colour_space "auto". warnings: of reading the headers. card_warnings: of the
    card's place.
    """

    name: str
    observations: tuple[Observation, ...]
    cameras: tuple[Camera, ...]
    masks: tuple[np.ndarray, ...]
    source: Path | None = None
    card_distance: float | None = None
    left_out: tuple[LeftOut, ...] = ()
    encoding: Encoding | None = None
    warnings: tuple[str, ...] = ()
    card_warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.card_distance is not None and not 0 < self.card_distance < math.inf:
            raise CaptureError(f"card_distance is {self.card_distance:g}; give a length above 0", "value")

    @property
    def listed(self) -> int:
        """Number of observations that the capture's files list, excluded ones included."""
        return len(self.observations) + len(self.left_out)

    @property
    def listed_names(self) -> list[str]:
        """Names of the observations that the capture's files list, excluded ones included."""
        names = [observation.name for observation in self.observations]
        for one in sorted(self.left_out, key=lambda one: one.index):
            names.insert(one.index, one.name or Path(one.image).name)
        return names

    @property
    def listed_numbers(self) -> list[int]:
        """Index of each of ``observations`` in the files' list."""
        excluded = [one.index for one in self.left_out]
        return [index for index in range(self.listed) if index not in excluded]

    @property
    def listed_cameras(self) -> list[int]:
        """Camera of each listed observation; −1 of an excluded one."""
        cameras = [observation.camera for observation in self.observations]
        for one in sorted(self.left_out, key=lambda one: one.index):
            cameras.insert(one.index, -1)
        return cameras

    @property
    def lights(self) -> list[Light]:
        """The light of each observation."""
        return [observation.light for observation in self.observations]

    def numbers(self, listed: Iterable[int]) -> list[int]:
        """Convert indices in the files' list to indices of ``observations``; drop those of excluded observations."""
        excluded = [one.index for one in self.left_out]
        return [index - sum(other < index for other in excluded) for index in listed if index not in excluded]
