"""Where things are: tile, ball, chart, lamps and camera, in millimetres; and where the camera sees them, in pixels.

The world's origin lies on the table below the camera; x right, y up in the picture, z toward the camera, which looks
straight down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..calibration.radiometry.colour_chart import COLUMNS, ROWS
from ..capture.camera import Camera
from ..capture.images.exif import focal_in_pixels
from .relief import HALF, THICKNESS

TILE = (-56.0, 0.0)  # its centre
BALL, BALL_RADIUS = (113.0, 78.0), 20.0
CHART, CHART_THICKNESS = (113.0, -38.0), 2.0  # its centre
PITCH, PATCH, CHART_MARGIN = 19.0, 17.0, 4.0  # from patch to patch, of a patch, beyond the outer patches
LAMP_DISTANCE = 950.0  # from the ball: the length of a string, which a hand keeps about tight
LAMP_RADIUS = 6.0
FOCAL_35MM = 52  # of the lens, as EXIF has it: the tele lens of a phone
_FIELD = (338.0, 252.0)  # of the table that the picture shows at least
_OFF_AXIS = (14.0, 58.0)  # degrees, of the lamps seen from the middle
_UNSTEADY = (6.0, 0.02)  # of a hand: degrees, and share of the distance
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True)
class Layout:
    """camera: in the world. lamps: (K, 3) places in the world."""

    camera: Camera
    lamps: np.ndarray

    @property
    def card_distance(self) -> float:
        """Distance of the tile's field from the camera."""
        return float(self.camera.position[2] - THICKNESS)

    @property
    def fov_degrees(self) -> float:
        """The camera's angle over the picture's width."""
        return math.degrees(2 * math.atan(self.camera.width / 2 / self.camera.scale[0]))


def arranged(size: tuple[int, int], photographs: int, seed: int) -> Layout:
    """Return the layout for a size in pixels and a number of photographs. seed: of the hand that holds the lamp."""
    width, height = size
    focal = focal_in_pixels(FOCAL_35MM, width, height)
    matrix = np.eye(4)
    matrix[2, 3] = THICKNESS + focal * max(_FIELD[0] / width, _FIELD[1] / height)
    camera = Camera(width, height, (focal, focal), (width / 2, height / 2), matrix)
    return Layout(camera, _lamps(photographs, np.random.default_rng(seed)))


def ball_middle() -> np.ndarray:
    """Return (3,) the place of the ball's centre."""
    return np.array([*BALL, BALL_RADIUS])


def _lamps(count: int, random: np.random.Generator) -> np.ndarray:
    """Return (count, 3) places on a spiral from high to low around the ball, held by hand on a string."""
    share = (np.arange(count) + 0.5) / count
    off = np.radians(_OFF_AXIS[0] + (_OFF_AXIS[1] - _OFF_AXIS[0]) * np.sqrt(share))
    off = off + np.radians(_UNSTEADY[0]) * random.uniform(-1, 1, count)
    around = _GOLDEN_ANGLE * np.arange(count) + random.uniform(0, 2 * np.pi)
    around = around + np.radians(_UNSTEADY[0]) * random.uniform(-1, 1, count)
    far = LAMP_DISTANCE * (1 + _UNSTEADY[1] * random.uniform(-1, 1, count))
    toward = np.stack([np.sin(off) * np.cos(around), np.sin(off) * np.sin(around), np.cos(off)], axis=-1)
    return ball_middle() + far[:, None] * toward


def chart_patches() -> np.ndarray:
    """Return (ROWS, COLUMNS, 3) places of the patches' middles; the chart stands upright, its grey row at the right.

    Turned by 90° to the left: the first row runs upward at the left.
    """
    row, column = np.meshgrid(np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
    x = CHART[0] + PITCH * (row - (ROWS - 1) / 2)
    y = CHART[1] + PITCH * (column - (COLUMNS - 1) / 2)
    return np.stack([x, y, np.full(x.shape, CHART_THICKNESS)], axis=-1)


def chart_corners() -> np.ndarray:
    """Return (4, 3) the outer corners of the patches 1, 6, 24 and 19: those of the grid, from the first patch on."""
    middles = chart_patches()
    outer = middles[[0, 0, -1, -1], [0, -1, -1, 0]]
    return outer + PATCH / 2 * np.array([(-1, -1, 0), (-1, 1, 0), (1, 1, 0), (1, -1, 0)])


def tile_corners() -> np.ndarray:
    """Return (4, 3) the corners of the tile at the height of its field: upper left, upper right, lower right, left."""
    signs = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
    return np.column_stack([signs * HALF + TILE, np.full(4, THICKNESS)])


def tile_crop(camera: Camera) -> tuple[int, int, int, int]:
    """Return x, y, width, height of the whole pixels that the tile fills, from the picture's upper left corner."""
    seen = seen_from_upper_left(camera, tile_corners())
    low, high = np.ceil(seen.min(axis=0)).astype(int), np.floor(seen.max(axis=0)).astype(int)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def seen_from_upper_left(camera: Camera, places: np.ndarray) -> np.ndarray:
    """Return (…, 2) pixels of places (…, 3), counted to the right and down from the picture's upper left corner."""
    pixels, _ = camera.project(np.asarray(places, np.float64))
    return np.stack([pixels[..., 0], camera.height - pixels[..., 1]], axis=-1)


def ball_circle(camera: Camera) -> tuple[float, float, float]:
    """Return x, y and radius of the circle of the ball's outline, in pixels from the upper left corner.

    The outline of a sphere is an ellipse, the picture of the cone that touches it; the circle has the ellipse's centre
    and the mean of its half-axes.
    """
    place = ball_middle() - camera.position
    far, off = float(np.linalg.norm(place)), math.hypot(place[0], place[1])
    axis, half = math.atan2(off, -place[2]), math.asin(BALL_RADIUS / far)
    near, outer = math.tan(axis - half), math.tan(axis + half)
    middle = (near + outer) / 2  # along the ray of the picture that goes through the ball, in focal lengths
    long = (outer - near) / 2
    # A cone of half-angle a around an axis t off the camera's: its section has the half-axis across of
    # sin a / sqrt(cos² a − sin² t).
    short = math.sin(half) / math.sqrt(math.cos(half) ** 2 - math.sin(axis) ** 2)
    x, y = camera.scale[0] * middle * place[:2] / off + camera.centre
    return float(x), camera.height - float(y), camera.scale[0] * (long + short) / 2
