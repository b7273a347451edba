"""A ball seen by a camera: fit of its position to its outline; surface points and normals at pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...capture import distortion as lens
from ...capture.camera import Camera
from ...core.errors import InputError

SMALL = 15.0  # pixels of radius: below, half a pixel in the highlight is 4° in the light
MIN_POINTS = 3  # of an outline
_MIN_RADIUS = 5.0
_UNEVEN, _NO_BALL = 0.02, 0.08  # RMS distance of the outline from the fit, in radii: warning, error
_DIGITAL_NOISE = 0.7  # pixels: an outline of whole pixels deviates by as much
_ARC, _SHORT_ARC = 0.6, 0.25  # visible fraction of the outline: warning, error
_STATED_ERROR = 0.5  # pixels: standard error of a circle that the user states
_ITERATIONS = 30
_CIRCLE_POINTS = 180


@dataclass(frozen=True)
class Ball:
    """A sphere in camera axes (x right, y up, z toward the viewer; a perspective camera is the origin).

    name: for messages. centre: (3,) and radius: in world units where the radius is known, else in ball radii;
    for an orthographic camera in world units, at z = 0. radius_px: of the outline. error_px: (2,) standard errors
    of the outline's centre (per axis) and radius, in pixels. warnings: about the outline.
    """

    name: str
    camera: Camera
    centre: np.ndarray
    radius: float
    radius_px: float
    error_px: tuple[float, float]
    warnings: tuple[str, ...] = ()

    @property
    def outline(self) -> np.ndarray:
        """(N, 2) pixel coordinates of the outline: an ellipse in a perspective camera."""
        phi = np.linspace(0, 2 * np.pi, _CIRCLE_POINTS)
        if not self.camera.perspective:
            rim = self.centre + self.radius * np.stack([np.cos(phi), np.sin(phi), 0 * phi], axis=-1)
        else:
            distance = np.linalg.norm(self.centre)
            axis, sine = self.centre / distance, self.radius / distance
            across, upward = tangents(axis)
            rim = np.sqrt(1 - sine**2) * axis + sine * (np.cos(phi)[:, None] * across + np.sin(phi)[:, None] * upward)
        return to_pixels(self.camera, rim)

    def surface(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return points (…, 3), unit normals (…, 3), unit vectors to the viewer (…, 3), and whether rays hit, bool (…).

        pixels: (…, 2) pixel coordinates. A ray that misses gets the values of its point nearest to the ball.
        """
        origin, ray = pixel_rays(self.camera, np.asarray(pixels, np.float64))
        toward = self.centre - origin
        along = (toward * ray).sum(axis=-1)
        discriminant = self.radius**2 - (toward**2).sum(axis=-1) + along**2
        point = origin + (along - np.sqrt(np.maximum(discriminant, 0)))[..., None] * ray
        normal = point - self.centre
        return point, normal / np.linalg.norm(normal, axis=-1, keepdims=True), -ray, discriminant > 0


def tangents(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit vectors that form a right-handed frame with a unit ``axis`` (3,)."""
    across = np.cross((0.0, 1.0, 0.0) if abs(axis[1]) < 0.9 else (1.0, 0.0, 0.0), axis)
    across /= np.linalg.norm(across)
    return across, np.cross(axis, across)


def pixel_rays(camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and unit directions (…, 3), in camera axes, of the rays through pixels (…, 2)."""
    plane = (pixels - np.asarray(camera.centre)) / np.asarray(camera.scale)
    if any(camera.distortion):
        plane = lens.undistorted(plane, camera.distortion)
    ones = np.ones((*plane.shape[:-1], 1))
    if not camera.perspective:
        return np.concatenate([plane, 0 * ones], axis=-1), np.broadcast_to((0.0, 0.0, -1.0), (*plane.shape[:-1], 3))
    rays = np.concatenate([plane, -ones], axis=-1)
    return np.zeros_like(rays), rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def to_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Return pixel coordinates (…, 2) of points (…, 3) in camera axes."""
    return replace(camera, matrix=np.eye(4)).project(points)[0]


def outline_of_mask(mask: np.ndarray) -> np.ndarray:
    """Return the outer border (N, 2), in pixel coordinates, of a mask (H, W) bool, row 0 at the bottom.

    A mask that touches the edge of the image has no border there: the ball may continue outside.
    """
    rows = _crossings(mask)
    columns = _crossings(mask.T)[:, ::-1]
    return np.concatenate([rows, columns])


def _crossings(mask: np.ndarray) -> np.ndarray:
    """Return x, y (N, 2) where each row first enters the mask and last leaves it."""
    rows = np.flatnonzero(mask.any(axis=1))
    first = mask[rows].argmax(axis=1)
    last = mask.shape[1] - mask[rows, ::-1].argmax(axis=1)
    y = rows + 0.5
    starts, ends = first > 0, last < mask.shape[1]
    return np.concatenate([
        np.stack([first[starts], y[starts]], axis=-1), np.stack([last[ends], y[ends]], axis=-1)
    ]).astype(np.float64)  # fmt: skip


def outline_of_circle(x: float, y: float, radius: float) -> np.ndarray:
    """Return (N, 2) pixel coordinates of a circle."""
    phi = np.linspace(0, 2 * np.pi, _CIRCLE_POINTS, endpoint=False)
    return np.stack([x + radius * np.cos(phi), y + radius * np.sin(phi)], axis=-1)


def fit_ball(
    points: np.ndarray, camera: Camera, name: str = "ball", radius: float | None = None, measured: bool = True
) -> Ball:
    """Return the sphere whose outline passes through points (N, 2) in pixel coordinates.

    The rays of a perspective camera that touch a sphere form a right circular cone about the ray to its centre. The
    fit solves for this cone's axis and opening, not for an ellipse; for an orthographic camera, for a circle. Tukey's
    weights (1960) suppress outliers, such as dents of a mask. radius: of the ball, in world units. measured: the
    scatter of the points gives the standard errors; else they are 0.5 pixels. Raises InputError for points that do not
    outline a ball.
    """
    points = np.asarray(points, np.float64)
    if len(points) < MIN_POINTS:
        raise InputError(f"{name}: its outline needs three points; click more")
    if radius is not None and not camera.perspective:
        raise InputError(
            f"{name}: an orthographic camera has its scale in world_width; leave the ball's radius out, or give --fov"
        )
    cone = _Cone(points, camera)
    weights = np.ones(len(points))
    for _ in range(_ITERATIONS):
        step = cone.refine(weights)
        weights = cone.weights()
        if step < 1e-9:
            break
    pixels_per_unit = cone.pixels_a_unit
    radius_px = cone.opening * pixels_per_unit
    distance = cone.residuals() * pixels_per_unit
    size = 1.0 if radius is None else radius
    if camera.perspective:
        centre = cone.axis * size / np.sin(cone.opening)
    else:
        centre, size = cone.axis, cone.opening
    warnings, error = _size(name, radius_px), np.full(2, _STATED_ERROR)
    if measured:
        warnings += _shape(name, radius_px, distance, weights, cone.seen_arc())
        error = cone.errors(weights) * pixels_per_unit
    return Ball(name, camera, centre, float(size), float(radius_px), (float(error[0]), float(error[1])), warnings)


class _Cone:
    """The axis and opening of a cone through rays (for an orthographic camera: a cylinder).

    In polar coordinates about the axis the cone is a circle about the origin; residuals are distances from it.
    """

    def __init__(self, points: np.ndarray, camera: Camera):
        self._camera = camera
        origins, rays = pixel_rays(camera, points)
        self._rays = rays if camera.perspective else origins
        # Algebraic start: the product of ray and axis is constant on the cone.
        if camera.perspective:
            middle = self._rays.mean(axis=0)
            solution = np.linalg.lstsq(self._rays, np.ones(len(points)), rcond=None)[0]
            if not solution @ middle > 0:
                solution = middle
            self.axis = solution / np.linalg.norm(solution)
        else:
            self.axis = self._rays.mean(axis=0)
        self.opening = float(np.median(np.linalg.norm(self._polar(), axis=-1)))
        spread = np.linalg.norm(points - points.mean(axis=0), axis=-1).mean()
        polar = self._polar()
        self.pixels_a_unit = spread / max(np.linalg.norm(polar - polar.mean(axis=0), axis=-1).mean(), 1e-300)

    def _polar(self) -> np.ndarray:
        """Return (N, 2): the direction of each ray about the axis, times its angle (orthographic: distance) to it."""
        if not self._camera.perspective:
            return (self._rays - self.axis)[:, :2]
        across, upward = tangents(self.axis)
        plane = np.stack([self._rays @ across, self._rays @ upward], axis=-1)
        sine = np.linalg.norm(plane, axis=-1)
        angle = np.arctan2(sine, self._rays @ self.axis)
        return plane * (angle / np.maximum(sine, 1e-300))[:, None]

    def residuals(self) -> np.ndarray:
        return np.linalg.norm(self._polar(), axis=-1) - self.opening

    def weights(self) -> np.ndarray:
        """Return Tukey's weights. The scale is at least 0.3 pixels, so points within half a pixel always count."""
        residuals = self.residuals()
        scale = max(1.4826 * np.median(np.abs(residuals)), 0.3 / self.pixels_a_unit)
        return tukey(residuals, scale)

    def refine(self, weights: np.ndarray) -> float:
        """Make one Gauss–Newton step; return its length relative to the opening."""
        polar = self._polar()
        distance = np.linalg.norm(polar, axis=-1)
        jacobian = self._jacobian(polar, distance)
        root = np.sqrt(weights)
        step = np.linalg.lstsq(jacobian * root[:, None], (self.opening - distance) * root, rcond=None)[0]
        self.opening += step[2]
        if self._camera.perspective:
            across, upward = tangents(self.axis)
            self.axis = self.axis + step[0] * across + step[1] * upward
            self.axis /= np.linalg.norm(self.axis)
        else:
            self.axis = self.axis + (step[0], step[1], 0.0)
        return float(np.linalg.norm(step) / max(abs(self.opening), 1e-300))

    @staticmethod
    def _jacobian(polar: np.ndarray, distance: np.ndarray) -> np.ndarray:
        return np.concatenate([-polar / np.maximum(distance, 1e-300)[:, None], -np.ones((len(polar), 1))], axis=1)

    def errors(self, weights: np.ndarray) -> np.ndarray:
        """Return standard errors (2,) of centre and opening; half of the points count, as neighbours correlate."""
        polar = self._polar()
        jacobian = self._jacobian(polar, np.linalg.norm(polar, axis=-1))
        variance = (weights * self.residuals() ** 2).sum() / max(weights.sum() / 2 - 3, 1)
        covariance = np.linalg.pinv((jacobian * weights[:, None]).T @ jacobian / 2) * variance
        return np.sqrt([np.trace(covariance[:2, :2]) / 2, covariance[2, 2]])

    def seen_arc(self) -> float:
        """Return the fraction, 0…1, of 24 sectors of the outline that contain points."""
        polar = self._polar()
        bins = np.floor((np.arctan2(polar[:, 1], polar[:, 0]) / (2 * np.pi) + 0.5) * 24).astype(int) % 24
        return len(np.unique(bins)) / 24


def _size(name: str, radius_px: float) -> tuple[str, ...]:
    if radius_px < _MIN_RADIUS:
        raise InputError(
            f"{name}: its radius is {radius_px:.1f} pixels; come closer or use a larger ball, at least {SMALL:g} pixels"
        )
    if radius_px < SMALL:
        return (f"{name}: its radius is {radius_px:.1f} pixels; {SMALL:g} or more are better",)
    return ()


def _shape(name: str, radius_px: float, distance: np.ndarray, weights: np.ndarray, arc: float) -> tuple[str, ...]:
    """Return warnings about an outline. Raises InputError if it is not round or shows too short an arc."""
    warnings = []
    uneven = np.sqrt(np.mean(distance**2))
    if len(distance) > 12:  # the scatter of a few clicked points does not show the shape
        if uneven > max(_NO_BALL * radius_px, 2 * _DIGITAL_NOISE):
            raise InputError(
                f"{name}: the outline is not round: {uneven:.1f} pixels off a ball's of radius {radius_px:.0f}; paint"
                " one ball white, all of it, and the rest black"
            )
        if uneven > max(_UNEVEN * radius_px, _DIGITAL_NOISE):
            warnings.append(f"{name}: the outline is {uneven:.1f} pixels off a ball's; is the mask exact?")
        if arc < _SHORT_ARC:
            raise InputError(
                f"{name}: only {arc:.0%} of its outline is in the picture; at least {_SHORT_ARC:.0%} is needed"
            )
        if arc < _ARC:
            warnings.append(f"{name}: only {arc:.0%} of its outline is in the picture; its position is uncertain")
        if (weights > 0).mean() < 0.8:
            warnings.append(f"{name}: {(weights == 0).mean():.0%} of the outline is not round and was left out")
    return tuple(warnings)


def tukey(residuals: np.ndarray, scale: float) -> np.ndarray:
    """Return Tukey's biweights of residuals of deviation ``scale``, 0 beyond 4.685 deviations (Beaton & Tukey 1974)."""
    return np.maximum(1 - (residuals / (4.685 * scale)) ** 2, 0) ** 2
