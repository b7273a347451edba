"""Layout of the scene: positions of tile, ball, chart, lamps and camera in millimetres, and their pixels.

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
PITCH, PATCH, CHART_MARGIN = 19.0, 17.0, 4.0  # between patch centres, side of a patch, around the outer patches
LAMP_DISTANCE = 950.0  # from the ball: length of a string between hand-held lamp and ball
LAMP_RADIUS = 6.0
FOCAL_35MM = 52  # 35 mm equivalent focal length in EXIF: a phone's tele lens
_FIELD = (338.0, 252.0)  # smallest visible part of the table
_OFF_AXIS = (14.0, 58.0)  # degrees between the lamps' directions from the ball and z
_UNSTEADY = (6.0, 0.02)  # largest deviation of a hand: degrees, and fraction of the distance
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True)
class Layout:
    """Positions for one size and number of photographs. lamps: (K, 3) positions in the world."""

    camera: Camera
    lamps: np.ndarray

    @property
    def card_distance(self) -> float:
        """Distance of the tile's field from the camera."""
        return float(self.camera.position[2] - THICKNESS)

    @property
    def fov_degrees(self) -> float:
        """Field of view over the picture's width, in degrees."""
        return math.degrees(2 * math.atan(self.camera.width / 2 / self.camera.scale[0]))


def make_layout(size: tuple[int, int], photographs: int, seed: int) -> Layout:
    """Return the layout for a size in pixels and a number of photographs. seed: of the hand's deviations."""
    width, height = size
    focal = focal_in_pixels(FOCAL_35MM, width, height)
    matrix = np.eye(4)
    matrix[2, 3] = THICKNESS + focal * max(_FIELD[0] / width, _FIELD[1] / height)
    camera = Camera(width, height, (focal, focal), (width / 2, height / 2), matrix)
    return Layout(camera, _lamps(photographs, np.random.default_rng(seed)))


def ball_middle() -> np.ndarray:
    """Return (3,) the position of the ball's centre."""
    return np.array([*BALL, BALL_RADIUS])


def _lamps(count: int, random: np.random.Generator) -> np.ndarray:
    """Return (count, 3) positions on a spiral from high to low around the ball, with a hand's random deviations."""
    share = (np.arange(count) + 0.5) / count
    polar = np.radians(_OFF_AXIS[0] + (_OFF_AXIS[1] - _OFF_AXIS[0]) * np.sqrt(share))
    polar = polar + np.radians(_UNSTEADY[0]) * random.uniform(-1, 1, count)
    azimuth = _GOLDEN_ANGLE * np.arange(count) + random.uniform(0, 2 * np.pi)
    azimuth = azimuth + np.radians(_UNSTEADY[0]) * random.uniform(-1, 1, count)
    distance = LAMP_DISTANCE * (1 + _UNSTEADY[1] * random.uniform(-1, 1, count))
    direction = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    return ball_middle() + distance[:, None] * direction


def chart_patches() -> np.ndarray:
    """Return (ROWS, COLUMNS, 3) centres of the patches of the chart, which is rotated by 90° to the left.

    Its first row runs upward at the left; its grey row is at the right.
    """
    row, column = np.meshgrid(np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
    x = CHART[0] + PITCH * (row - (ROWS - 1) / 2)
    y = CHART[1] + PITCH * (column - (COLUMNS - 1) / 2)
    return np.stack([x, y, np.full(x.shape, CHART_THICKNESS)], axis=-1)


def chart_corners() -> np.ndarray:
    """Return (4, 3) corners of the grid of patches: the outer corners of the patches 1, 6, 24 and 19."""
    middles = chart_patches()
    outer = middles[[0, 0, -1, -1], [0, -1, -1, 0]]
    return outer + PATCH / 2 * np.array([(-1, -1, 0), (-1, 1, 0), (1, 1, 0), (1, -1, 0)])


def tile_corners() -> np.ndarray:
    """Return (4, 3) corners of the tile at its field's height: upper left, upper right, lower right, lower left."""
    signs = np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
    return np.column_stack([signs * HALF + TILE, np.full(4, THICKNESS)])


def tile_crop(camera: Camera) -> tuple[int, int, int, int]:
    """Return x, y, width, height of the tile in whole pixels, rounded inward, from the picture's upper left corner."""
    corners = seen_from_upper_left(camera, tile_corners())
    low, high = np.ceil(corners.min(axis=0)).astype(int), np.floor(corners.max(axis=0)).astype(int)
    return int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1])


def seen_from_upper_left(camera: Camera, places: np.ndarray) -> np.ndarray:
    """Return pixels (…, 2) of world points (…, 3), to the right and down from the picture's upper left corner."""
    pixels, _ = camera.project(np.asarray(places, np.float64))
    return np.stack([pixels[..., 0], camera.height - pixels[..., 1]], axis=-1)


def ball_circle(camera: Camera) -> tuple[float, float, float]:
    """Return x, y and radius of a circle close to the ball's outline, in pixels from the upper left corner.

    The outline of a sphere is an ellipse, the section of its tangent cone; the circle has the ellipse's centre and the
    mean of its half-axes.
    """
    place = ball_middle() - camera.position
    distance, off = float(np.linalg.norm(place)), math.hypot(place[0], place[1])
    axis, half = math.atan2(off, -place[2]), math.asin(BALL_RADIUS / distance)
    near, outer = math.tan(axis - half), math.tan(axis + half)
    middle = (near + outer) / 2  # radial distance in the picture, in focal lengths
    long = (outer - near) / 2
    # A cone of half-angle a whose axis is t from the camera's has the tangential half-axis
    # sin a / sqrt(cos² a − sin² t).
    short = math.sin(half) / math.sqrt(math.cos(half) ** 2 - math.sin(axis) ** 2)
    x, y = camera.scale[0] * middle * place[:2] / off + camera.centre
    return float(x), camera.height - float(y), camera.scale[0] * (long + short) / 2
