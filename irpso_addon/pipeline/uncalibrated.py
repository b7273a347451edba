"""Calibrates lights from the subject itself: first by Lambertian shading, then by recoveries of the material."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..calibration.shading.ambiguity import rotation
from ..calibration.shading.estimate import PARTS, ShadingLights, errors_of, parts_of, shading_normals, shading_steps
from ..calibration.shading.known import WHITE
from ..capture.bounds import without_bounds
from ..capture.camera import Camera
from ..capture.framing import Framing, framed
from ..capture.types import Capture, Light, triple
from ..core.errors import InputError
from ..core.steps import map_steps
from ..geometry.build import card_steps, check_card
from ..geometry.domain import Domain
from ..geometry.relief.occlusion import open_sky
from ..geometry.relief.relief import card_height
from ..reflectance.model import ReflectanceModel
from ..solver.lights.light_texels import draw_texels
from ..solver.lights.refine import Lights, light_steps
from ..solver.state.prepare import lambert_fit

_TEXELS = 15_000  # of the reduced capture, about: lights need no more
_MIN_SCALE = 0.05
_READ_PART, _SHADED_PART = 0.1, 0.25  # of the work, at the ends of reading and of the first estimate
_ROUNDS = 2  # of refinement, each from the lights of the one before
_FIRST_ERROR = 10.0  # degrees: assumed standard deviation of the first estimate's directions
# Degrees between the lights of different parts of the subject by matt shading (warning, stricter limits). Of captures
# above 40, two of metal paint and steel end 0.8° off, but gold, bronze, patina and velvet 10 to 77°: parts of the
# former agree to 1.6° with the recovered material, of the latter to 4.4 to 12.6°.
_DOUBTFUL_DISAGREEMENT, _UNSURE_DISAGREEMENT = 15.0, 40.0
# The most where the model does not fit. Disagreement and error are 10 and 3° on bunnies that darken as no material of
# the model does, 15 and 36° on a goblet of satin brass.
_MAX_UNFIT = 12.0
# A refinement that raises the spread of the intensities by this factor and amount has fitted what the model lacks. On a
# bunny that darkens as no material of the model does, it rises from 0.8 to 11 %, the lights' error from 3.5 to 11°.
_SPREAD_FACTOR, _SPREAD_MARGIN = 2.0, 0.03
_BRIGHT = 95.0  # percentile of radiance, which becomes WHITE
_OPEN, _MIN_OPEN = 0.9, 0.65  # least part of the sky that texels of the refinement see; of all texels
_JACKKNIFE_TEXELS = 256  # in each fit without one part
_DOUBTFUL_REFINED = 3.0  # degrees between refined lights by parts


@dataclass(frozen=True)
class _Limits:
    """Limits of refined lights, in degrees. rotation: that makes the normals under them integrable. errors: by parts.

    remedy: what else gives the lights.
    """

    rotation: float
    errors: float
    remedy: str


# Rotations are at most 2 for clay, glaze and terracotta, 5 for a pot of metal paint, 17 to 24 for matt and brass
# goblets, whose lights are 18 and 36° off. Parts of golden fruits, 49° off, agree to 12°. Where matt shading disagrees
# by more than _UNSURE_DISAGREEMENT, rotations are at most 3 for metal paint and steel, 5 to 28 for the others.
_USUAL = _Limits(10.0, 10.0, "put a ball into the photographs")
_STRICT = _Limits(4.0, _DOUBTFUL_REFINED, f"{_USUAL.remedy}, or if it is flat and lamps stood near it, use --flat")


@dataclass(frozen=True)
class Uncalibrated:
    """Lights calibrated from the subject. capture: in full size, with them. first: by shading; refined: by recoveries.

    errors: (K,) standard deviation in degrees between parts of the subject, as in ShadingLights. kept: whether the
    capture has the refined lights. warnings: what the photographs do not determine.
    """

    capture: Capture
    errors: np.ndarray
    first: ShadingLights
    refined: Lights
    kept: bool
    warnings: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        """Return the table of the report."""
        rows = []
        errors = zip(self.first.errors, self.errors, strict=True)
        for observation, (before, error) in zip(self.capture.observations, errors, strict=True):
            row = {"direction": list(observation.light.vector), "intensity": list(observation.light.intensity)}
            degrees = {"first_error_degrees": round(float(before), 3), "error_degrees": round(float(error), 3)}
            rows.append({"name": observation.name, **row, **degrees})
        return {
            "kind": "shading",
            "near": False,
            "how": "by the subject's shading" + ", then by recoveries of its material" * self.kept,
            "rounds": self.refined.rounds,
            "last_change": round(self.refined.change, 6),
            "lights": rows,
            "warnings": list(self.warnings),
        }


def uncalibrated_steps(
    capture: Capture, model: ReflectanceModel, seed: int = 0, inside_out: bool = False
) -> Generator[float, None, Uncalibrated]:
    """Calibrate the distant lights of a capture of one camera; yield the fraction done, return the result.

    The capture's own lights are ignored. The first estimate assumes a Lambertian subject and equally strong lamps. Then
    recoveries of some texels with ``model`` and corrections of the lights alternate (``light_steps``); after each, a
    rotation of the lights makes the normals integrable. Where that makes even lamps uneven, the first estimate stays.
    All intensities have a common unknown factor. inside_out: return the other of two solutions, with the inverse
    relief; only an outline tells them apart. Raises InputError where photographs do not determine the lights.
    """
    capture = replace(capture, card_distance=None)
    mask = check_card(replace(capture, card_distance=1.0))
    scale = min(1.0, float(np.sqrt(_TEXELS / mask.sum())))
    small = framed(capture, Framing(scale=max(scale, _MIN_SCALE)))
    values, weight = yield from map_steps(_radiance(small), lambda part: _READ_PART * part)
    steps = shading_steps(values, weight, small.masks[0], seed, [o.name for o in small.observations])
    first = yield from map_steps(steps, lambda part: _READ_PART + (_SHADED_PART - _READ_PART) * part)
    disagreement = float(first.errors.mean())
    apart = f"lights from different parts of the subject differ by {disagreement:.0f}°"
    limits = _USUAL if disagreement <= _UNSURE_DISAGREEMENT else _STRICT
    if inside_out:
        first = replace(first, directions=first.directions * (-1, -1, 1))
    strength = first.intensities * float(np.percentile(values.max(axis=0), _BRIGHT)) / WHITE
    lit = _with_lights(small, first.directions, np.repeat(strength[:, None], 3, axis=1))
    domain = yield from map_steps(card_steps(lit), lambda _: _SHADED_PART)
    pixels = _Pixels(values, weight, small, seed, limits)
    refined, kept, domain = yield from pixels.refined(domain, model, _spread(first.intensities))
    if not kept:
        if disagreement > _MAX_UNFIT:
            raise InputError(f"{apart}, and no material explains them; {limits.remedy}")
        power = strength[:, None]
        turn = pixels.rotation(first.directions * power, domain, check=True)
        directions, intensities, errors = first.directions @ turn, np.repeat(power, 3, axis=1), first.errors
        warnings = [
            f"{model.name} does not fit the subject, because it makes equal lamps unequal: the lights of matt shading"
            " are used"
        ]
    else:
        directions, intensities = refined.lights[:, :3].astype(np.float64), refined.intensities
        errors = errors_of((yield from pixels.without_parts(domain, model)), directions)
        warnings = refined.warnings()
        still = f"lights from different parts of the subject differ by {errors.mean():.0f}° with its recovered material"
        if not errors.mean() <= limits.errors:
            raise InputError(f"{still}; {limits.remedy}")
        if errors.mean() > _DOUBTFUL_REFINED:
            warnings.append(f"{still}; a ball beside it shows them better")
    if disagreement > _DOUBTFUL_DISAGREEMENT:
        warnings.append(f"{apart} before its material is recovered; check whether the recovered relief is right")
    if not first.solid:
        warnings.append(
            "photographs do not show whether a relief is inside out; if it looks so, use --inside-out (a mask with the"
            " subject's outline decides it)"
        )
    calibrated = _with_lights(capture, directions, intensities)
    return Uncalibrated(calibrated, errors, first, refined, kept, tuple(warnings))


@dataclass(frozen=True)
class _Pixels:
    """Refines the lights of a reduced capture. values, weight: (K, P) radiance and weight of its P masked pixels."""

    values: np.ndarray
    weight: np.ndarray
    capture: Capture
    seed: int
    limits: _Limits

    def refined(
        self, domain: Domain, model: ReflectanceModel, spread: float
    ) -> Generator[float, None, tuple[Lights, bool, Domain]]:
        """Yield the fraction done; return the lights after all rounds, whether the model fits, and the domain.

        spread: ``_spread`` of the first intensities. Where the model does not fit, the domain has the lights before it.
        """
        for number in range(_ROUNDS):
            part = partial(_fraction, number / _ROUNDS, 1 / _ROUNDS)
            texels = open_texels(domain, self.capture.cameras[0])
            steps = light_steps(texels, model, seed=self.seed, refine_degrees=_FIRST_ERROR)
            lights = yield from map_steps(steps, part)
            if _spread(lights.intensities.mean(axis=-1)) > _SPREAD_FACTOR * spread + _SPREAD_MARGIN:
                return lights, False, domain
            lights = self.turned(lights, domain, check=True)
            domain = lights.applied(domain)
        return lights, True, domain

    def turned(
        self, refined: Lights, domain: Domain, left_out: np.ndarray | None = None, check: bool = False
    ) -> Lights:
        """Return the lights, rotated so that the normals under them are integrable, as far as highlights allow."""
        directions = refined.lights[:, :3].astype(np.float64)
        power = refined.intensities.mean(axis=-1, keepdims=True)
        turn = self.rotation(directions * power, refined.applied(domain), left_out, check, refined.rotation)
        lights = np.concatenate([directions @ turn, np.zeros((len(directions), 1))], axis=-1)
        return replace(refined, lights=lights.astype(np.float32))

    def rotation(
        self,
        lights: np.ndarray,
        domain: Domain,
        left_out: np.ndarray | None = None,
        check: bool = False,
        covariance: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the ``rotation`` (3, 3) that makes matt shading under lights (K, 3) integrable: lights @ rotation.

        Only open texels count. left_out: (H, W) bool, other texels. covariance: of the rotation by highlights, None for
        matt subjects, whose shading does not determine it. check: raise InputError where this rotation, or that by the
        surface alone, exceeds the limit.
        """
        mask, chosen = self.capture.masks[0], open_texels(domain, self.capture.cameras[0]).solvable
        chosen = chosen if left_out is None else chosen & ~left_out
        surface = *shading_normals(self.values, self.weight * chosen[mask], lights), mask, _plane(self.capture)
        turn = rotation(*surface, covariance)
        for checked in (turn, rotation(*surface)) if check else ():
            degrees = float(np.degrees(np.arccos(np.clip((np.trace(checked) - 1) / 2, -1, 1))))
            if not degrees <= self.limits.rotation:
                raise InputError(
                    f"the lights from its shading are turned by {degrees:.0f}° against those from the visible surface;"
                    f" {self.limits.remedy}"
                )
        return turn

    def without_parts(self, domain: Domain, model: ReflectanceModel) -> Generator[float, None, np.ndarray]:
        """Yield the fraction done; return (PARTS, K, 3) directions of the lights without each part of the subject."""
        mask = self.capture.masks[0]
        part_of = np.full(mask.shape, -1)
        part_of[mask] = parts_of(mask, self.seed)
        texels, directions = open_texels(domain, self.capture.cameras[0]), []
        for part in range(PARTS):
            rest = replace(texels, solvable=texels.solvable & (part_of != part))
            chosen = draw_texels(rest, self.seed, np.arange(domain.observations), _JACKKNIFE_TEXELS)
            steps = light_steps(rest, model, seed=self.seed, refine_degrees=_FIRST_ERROR, texels=chosen)
            refined = yield from map_steps(steps, partial(_fraction, 1 + part / PARTS, 1 / PARTS))
            directions.append(self.turned(refined, domain, part_of == part).lights[:, :3])
        return np.stack(directions).astype(np.float64)


def open_texels(domain: Domain, camera: Camera) -> Domain:
    """Return a card's domain with only those texels solvable that see most of the sky, by a Lambertian relief.

    Interreflection in hollows biases the shading of all parts alike: lights of terracotta fruits in a bowl are off by
    4.2° with the texels in it, by 1.3° without them. About a third of all is left out at most.
    """
    normals, _ = lambert_fit(domain)
    sky = open_sky(card_height(camera, normals, domain.solvable))
    least = min(_OPEN, float(np.quantile(sky[domain.solvable], 1 - _MIN_OPEN)))
    return replace(domain, solvable=domain.solvable & (sky >= least))


def _spread(intensities: np.ndarray) -> float:
    """Return the robust standard deviation of the logarithms."""
    logs = np.log(np.maximum(intensities, 1e-12))
    return 1.4826 * float(np.median(np.abs(logs - np.median(logs))))


def _plane(capture: Capture) -> np.ndarray | None:
    """Return (P, 2) the plane coordinates at distance 1 of the masked pixels of a perspective camera."""
    camera = replace(capture.cameras[0], matrix=np.eye(4))
    plane: np.ndarray = camera.points(1.0)[capture.masks[0]][:, :2]
    return plane if camera.perspective else None


def _fraction(begun: float, share: float, part: float) -> float:
    """Return the fraction of all work done; begun + share · part: 0 to 1 in the refinement, to 2 in its errors."""
    return _SHADED_PART + (1 - _SHADED_PART) * (begun + share * part) / 2


def _radiance(capture: Capture) -> Generator[float, None, tuple[np.ndarray, np.ndarray]]:
    """Return grey radiance and weight (K, P) of the pixels of the mask; yield the fraction read."""
    values, weights = [], []
    for number, observation in enumerate(capture.observations):
        pixels = without_bounds(observation.read()[capture.masks[0]])
        weights.append(pixels[:, 3])
        values.append(np.where(pixels[:, 3] > 0, pixels[:, :3].mean(axis=-1), 0).astype(np.float64))
        yield (number + 1) / len(capture.observations)
    return np.stack(values), np.stack(weights)


def _with_lights(capture: Capture, directions: np.ndarray, intensities: np.ndarray) -> Capture:
    """Return a capture with distant lights (K, 3) in its camera's axes, and their intensities (K, 3)."""
    world = directions @ capture.cameras[0].matrix[:3, :3].T
    observations = zip(capture.observations, world, intensities, strict=True)
    lit = tuple(
        replace(observation, light=Light(triple(direction), triple(power)))
        for observation, direction, power in observations
    )
    return replace(capture, observations=lit)
