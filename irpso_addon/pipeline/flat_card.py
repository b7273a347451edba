"""Calibrates near lights by their fall-off over a flat card."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from ..calibration.shading.flat import even_steps, falloff_steps
from ..calibration.shading.known import LampFit, Samples, cells, free_scale, nearer
from ..calibration.shading.lamp_colours import coloured, whitened
from ..capture.bounds import without_bounds
from ..capture.camera import Camera
from ..capture.framing import Framing, framed
from ..capture.types import Capture, triple
from ..core.errors import InputError
from ..core.steps import map_steps
from ..geometry.build import check_card
from .known_shape import check_explained, light_rows

MIN_PHOTOGRAPHS = 6  # photographs
_PIXELS = 6000  # of the reduced card, about: averages relief and texture
_TEXELS = 1500  # in the fit
_MIN_TEXELS, _MIN_LIT = 300, 100  # in the fit, and lit in each photograph
_MIN_SCALE = 0.02
_READ_PART = 0.2  # of the work, at the end of reading
_MAX_DEGREES, _MAX_DISTANCE = 8.0, 0.25  # mean standard errors: of directions, and of distances as fractions
_UP = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class FlatCard:
    """Near lights calibrated over a card. capture: with them and ``card_distance`` in their unit. fit: of the lamps."""

    capture: Capture
    fit: LampFit
    warnings: tuple[str, ...] = ()

    @property
    def distance_error(self) -> float:
        """Mean standard error of the lamps' distances, as a fraction."""
        return float(self.fit.distance_errors.mean())

    def report(self) -> dict[str, Any]:
        """Return the table of the report."""
        return {
            "kind": "flat",
            "near": True,
            "how": "by the fall-off of near lights over a flat card",
            "card_distance": self.capture.card_distance,
            "misfit": round(self.fit.misfit, 5),
            "lights": light_rows(self.capture, self.fit, near=True),
            "warnings": list(self.warnings),
        }


def width_keys(whole: Camera) -> dict[str, float]:
    """Return the keys of a camera without a known lens: the width of its whole picture is the positions' unit."""
    return {"world_width": whole.width / whole.scale[0]}


def part_warnings(whole: Capture, framing: Framing) -> tuple[str, ...]:
    """Return a warning if neither a mask nor the framing names the card's part of whole photographs."""
    if framing.crop is not None or framing.corners or not whole.masks[0].all():
        return ()
    return (
        "all of each photograph counts as the flat card; if it shows more, name the card's part by crop or corners in"
        " capture.toml and calibrate that",
    )


def flat_card_steps(capture: Capture, seed: int = 0) -> Generator[float, None, FlatCard]:
    """Calibrate the near lights of a flat card; yield the fraction done, return the result.

    The capture's own lights are ignored. The card faces its one camera, at the capture's ``card_distance``, or else
    where its picture is 1 wide: then positions are in widths of the picture. All intensities have a common unknown
    factor. Raises InputError where the photographs do not determine the lights: distant ones have no fall-off.
    """
    if len(capture.observations) < MIN_PHOTOGRAPHS:
        raise InputError(
            f"{len(capture.observations)} photographs are too few to find lights over a flat card; take"
            f" {MIN_PHOTOGRAPHS} or more"
        )
    camera = capture.cameras[0]
    capture = replace(capture, card_distance=capture.card_distance or _unit_width_distance(camera))
    mask = check_card(capture)
    scale = min(1.0, float(np.sqrt(_PIXELS / mask.sum())))
    small = framed(capture, Framing(scale=max(scale, _MIN_SCALE)))
    samples, views, colours = yield from map_steps(_samples(small, seed), lambda part: _READ_PART * part)
    _check_lit(capture, samples)
    middle = samples.points.mean(axis=0)
    size = float(np.linalg.norm(samples.points - middle, axis=-1).max())
    steps = count(1)
    fitting = falloff_steps(samples, views, middle, size)
    fit = yield from map_steps(fitting, lambda _: 1 - (1 - _READ_PART) * 0.985 ** next(steps))
    even = yield from map_steps(even_steps(samples, fit.lamps), lambda _: 1 - (1 - _READ_PART) * 0.985 ** next(steps))
    _check_known(fit, even)
    check_explained(capture, fit, "the card")
    lights = coloured(fit.lamps.lights(near=True, scale=free_scale(samples, fit)), colours)
    places = np.array([light.vector for light in lights]) @ camera.matrix[:3, :3].T + camera.position
    observations = tuple(
        replace(observation, light=replace(light, vector=triple(place)))
        for observation, light, place in zip(capture.observations, lights, places, strict=True)
    )
    return FlatCard(replace(capture, observations=observations), fit)


def _unit_width_distance(camera: Camera) -> float:
    """Return the distance at which a perspective camera's picture is 1 wide; else the width of the picture."""
    width = camera.width / camera.scale[0]
    return 1 / width if camera.perspective else width


def _samples(capture: Capture, seed: int) -> Generator[float, None, tuple[Samples, np.ndarray, np.ndarray]]:
    """Return some pixels' samples, in the camera's axes, directions to the camera, and the lamps' colours (K, 3).

    Yields the fraction read.
    """
    camera = replace(capture.cameras[0], matrix=np.eye(4))
    points = camera.points(capture.card_distance or 1.0)
    places = np.flatnonzero(capture.masks[0] & np.isfinite(points).all(axis=-1))
    chosen = np.sort(np.random.default_rng(seed).permutation(places)[:_TEXELS])
    points = points.reshape(-1, 3)[chosen]
    radiance, weights = [], []
    for number, observation in enumerate(capture.observations):
        pixels = without_bounds(observation.read()).reshape(-1, 4)[chosen].astype(np.float64)
        weights.append(pixels[:, 3])
        radiance.append(np.where(pixels[:, 3:] > 0, pixels[:, :3], 0))
        yield (number + 1) / len(capture.observations)
    normals = np.broadcast_to(_UP, points.shape)
    views = -points / np.linalg.norm(points, axis=-1, keepdims=True) if camera.perspective else normals
    values, colours = whitened(np.stack(radiance), np.stack(weights))
    return Samples(values, np.stack(weights), points, normals, cells(points, seed)), views, colours


def _check_lit(capture: Capture, samples: Samples) -> None:
    lit = ((samples.weight > 0) & (samples.values > 0)).sum(axis=1)
    if samples.values.shape[1] < _MIN_TEXELS or lit.min() < _MIN_LIT:
        number = int(lit.argmin())
        raise InputError(
            f"'{capture.observations[number].name}': shows only {lit[number]} lit pixels of the card, but {_MIN_LIT}"
            f" are needed to find its light, and {_MIN_TEXELS} pixels of the card in all"
        )


def _check_known(fit: LampFit, even: LampFit) -> None:
    if not nearer(fit, even):
        raise InputError(
            "the lamps are too far from the card, or too close together: distant lamps light a matt card evenly, and"
            " its shading does not show their directions; put a ball into the photographs"
        )
    degrees, distance = float(fit.degrees.mean()), float(fit.distance_errors.mean())
    if degrees > _MAX_DEGREES or distance > _MAX_DISTANCE:
        raise InputError(
            f"the fall-off over the card shows the lamps only to {degrees:.0f}° and {distance:.0%} of their distance:"
            " the card is not matt, flat or large enough; bring the lamps nearer, or put a ball into the photographs"
        )
