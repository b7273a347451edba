"""Lights from the photographs themselves: first by matt shading, then by recoveries of the material."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..calibration.shading.estimate import ShadingLights, shading_steps, surface_rotation
from ..calibration.shading.known import WHITE
from ..capture.bounds import without_bounds
from ..capture.framing import Framing, framed
from ..capture.types import Capture, Light, triple
from ..core.errors import InputError
from ..core.steps import map_steps
from ..geometry.build import card_steps, check_card
from ..reflectance.model import ReflectanceModel
from ..solver.lights.refine import Lights, light_steps

_TEXELS = 15_000  # about as many are used: lights need no more
_LEAST_SCALE = 0.05
_READ, _SHADED = 0.15, 0.45  # fractions of the work, at the ends of reading and of the first estimate
_ROUNDS = 2  # of refinement, each from where the last one ended
_ERROR = 10.0  # degrees: of the first estimate, as the refinement takes it
# Degrees between the lights that parts of the subject tell. Of nine captures 8 or less ended 1 to 3° off, 31 (a cow of
# metal paint) 2.7°, 46 and 104 (velvet, a metal goblet) over 30°.
_DOUBTFUL, _MOST_ERROR = 15.0, 40.0
# Strengths that a refinement spreads further than those before have taken up what the model lacks. On a bunny that
# darkens like no material of the model they go from 0.8 to 11 %, and its lights from 3.5 to 11° off.
_MORE, _ROUGHLY = 2.0, 0.03
_BRIGHT = 95.0  # percentile


@dataclass(frozen=True)
class Uncalibrated:
    """Lights found without calibration. capture: with them, in full size. first: from shading; refined: by recoveries.

    kept: whether the capture has the refined ones. warnings: what the photographs cannot tell.
    """

    capture: Capture
    first: ShadingLights
    refined: Lights
    kept: bool
    warnings: tuple[str, ...]

    @property
    def lights(self) -> list[Light]:
        """The light of each photograph."""
        return [shot.light for shot in self.capture.observations]

    def report(self) -> dict[str, Any]:
        """Return the table of the report."""
        rows = []
        for shot, error in zip(self.capture.observations, self.first.errors, strict=True):
            row = {"direction": list(shot.light.vector), "intensity": list(shot.light.intensity)}
            rows.append({"name": shot.name, **row, "first_error_degrees": round(float(error), 3)})
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
    """Yield the fraction done; return the distant lights of a capture of one camera, whose own lights do not count.

    The first estimate takes the subject for matt and lamps for equally strong. Then recoveries of some texels with
    ``model`` and corrections of the lights alternate (``light_steps``), which knows highlights; after each, lights are
    turned by what makes the normals a surface's. Where that makes lamps uneven that were even, the first estimate
    stays. All intensities have a common free factor. inside_out: take the other of two answers, the relief turned
    inside out, which only an outline tells apart. Raises InputError where the photographs do not determine the lights.
    """
    capture = replace(capture, card_distance=None)
    mask = check_card(replace(capture, card_distance=1.0))
    scale = min(1.0, float(np.sqrt(_TEXELS / mask.sum())))
    small = framed(capture, Framing(scale=max(scale, _LEAST_SCALE)))
    values, weight = yield from map_steps(_radiance(small), lambda part: _READ * part)
    steps = shading_steps(values, weight, small.masks[0], seed)
    first = yield from map_steps(steps, lambda part: _READ + (_SHADED - _READ) * part)
    disagreement = float(first.errors.mean())
    apart = f"parts of the subject tell lights that differ by {disagreement:.0f}°"
    if not disagreement <= _MOST_ERROR:
        raise InputError(
            f"{apart}: they cannot be found from its shading; put a ball into the photographs, or if it is flat and"
            " lamps stood near it, use --flat"
        )
    if inside_out:
        first = replace(first, directions=first.directions * (-1, -1, 1))
    strength = first.intensities * float(np.percentile(values.max(axis=0), _BRIGHT)) / WHITE
    lit = _with_lights(small, first.directions, np.repeat(strength[:, None], 3, axis=1))
    domain = yield from map_steps(card_steps(lit), lambda _: _SHADED)
    for number in range(_ROUNDS):
        refining = light_steps(domain, model, seed=seed, refine_degrees=_ERROR)
        refined = yield from map_steps(refining, partial(_fraction, number))
        kept = _spread(refined.intensities.mean(axis=-1)) <= _MORE * _spread(first.intensities) + _ROUGHLY
        if not kept:
            break
        directions = refined.lights[:, :3].astype(np.float64)
        power = refined.intensities.mean(axis=-1, keepdims=True)
        turn = surface_rotation(values, weight, small.masks[0], directions * power, _plane(small))
        turned = np.concatenate([directions @ turn, np.zeros((len(directions), 1))], axis=-1)
        refined = replace(refined, lights=turned.astype(np.float32))
        domain = refined.applied(domain)
    if not kept and disagreement > _DOUBTFUL:
        raise InputError(f"{apart}, and its material none that explains them; put a ball into the photographs")
    if kept:
        found, warnings = _with_lights(capture, directions @ turn, refined.intensities), refined.warnings()
    else:
        power = strength[:, None]
        turn = surface_rotation(values, weight, small.masks[0], first.directions * power, _plane(small))
        found = _with_lights(capture, first.directions @ turn, np.repeat(power, 3, axis=1))
        warnings = [
            f"{model.name} makes even lamps uneven, so it does not fit the subject: lights are those of matt shading"
        ]
    if disagreement > _DOUBTFUL:
        warnings.append(f"{apart} before its material is known; see whether the recovered relief is right")
    if not first.solid:
        warnings.append(
            "photographs do not tell relief from its inverse; if it looks inside out, use --inside-out (a mask with the"
            " subject's outline tells)"
        )
    return Uncalibrated(found, first, refined, kept, tuple(warnings))


def _spread(intensities: np.ndarray) -> float:
    """Return the robust standard deviation of the logarithms."""
    logs = np.log(np.maximum(intensities, 1e-12))
    return 1.4826 * float(np.median(np.abs(logs - np.median(logs))))


def _plane(capture: Capture) -> np.ndarray | None:
    """Return (P, 2) the plane coordinates at distance 1 of the masked pixels of a perspective camera."""
    camera = replace(capture.cameras[0], matrix=np.eye(4))
    plane: np.ndarray = camera.points(1.0)[capture.masks[0]][:, :2]
    return plane if camera.perspective else None


def _fraction(number: int, part: float) -> float:
    return _SHADED + (1 - _SHADED) * (number + part) / _ROUNDS


def _radiance(capture: Capture) -> Generator[float, None, tuple[np.ndarray, np.ndarray]]:
    """Return grey radiance and weight (K, P) of the pixels of the mask; yield the fraction read."""
    values, weights = [], []
    for number, shot in enumerate(capture.observations):
        pixels = without_bounds(shot.read()[capture.masks[0]])
        weights.append(pixels[:, 3])
        values.append(np.where(pixels[:, 3] > 0, pixels[:, :3].mean(axis=-1), 0).astype(np.float64))
        yield (number + 1) / len(capture.observations)
    return np.stack(values), np.stack(weights)


def _with_lights(capture: Capture, directions: np.ndarray, intensities: np.ndarray) -> Capture:
    """Return a capture with distant lights (K, 3) in its camera's axes, and their intensities (K, 3)."""
    world = directions @ capture.cameras[0].matrix[:3, :3].T
    shots = zip(capture.observations, world, intensities, strict=True)
    lit = tuple(replace(shot, light=Light(triple(way), triple(power))) for shot, way, power in shots)
    return replace(capture, observations=lit)
