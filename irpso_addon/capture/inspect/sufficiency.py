"""Measured sufficiency of a set of lights for normals, the roughness of one lobe, and two lobes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import CaptureError
from ..types import Light

GOALS = ("normals", "roughness", "two lobes")
FEW = 0.1  # largest fraction of failed texels under sufficient lights


@dataclass(frozen=True)
class Figure:
    """Measurement of one set of lights. value: of the varied quantity. failed: fraction of failed texels per GOAL.

    A texel fails with a normal error above 5°, or a lobe parameter's error above 10 % of its range.
    """

    value: float
    failed: tuple[float, float, float]


# docs/benchmarks/lights.md, of the preset standard; even lights down to 73° from the axis. On cards with 15 % cast
# shadow and 10 % interreflection, as photographs have them: the number of lights.
NUMBER = (
    Figure(3, (0.101, 0.779, 0.898)),
    Figure(5, (0.146, 0.448, 0.846)),
    Figure(10, (0.01, 0.167, 0.643)),
    Figure(20, (0.0, 0.019, 0.149)),
    Figure(50, (0.0, 0.031, 0.038)),
    Figure(100, (0.0, 0.022, 0.027)),
)
# On cards with noise alone, 50 lights: the angle in degrees between their mean and the outermost,
CONE = (
    Figure(10, (0.001, 0.091, 0.354)),
    Figure(20, (0.0, 0.062, 0.1)),
    Figure(30, (0.0, 0.011, 0.014)),
    Figure(45, (0.0, 0.001, 0.001)),
)
# and their spread perpendicular to the best-fitting plane over the spread in it.
ACROSS = (
    Figure(0.02, (0.003, 0.051, 0.191)),
    Figure(0.05, (0.0, 0.041, 0.089)),
    Figure(0.1, (0.0, 0.044, 0.043)),
    Figure(0.2, (0.0, 0.029, 0.029)),
    Figure(0.5, (0.0, 0.006, 0.001)),
)
MIN_LIGHTS = 3  # lights of a normal
FLAT_USELESS = 1e-3  # smallest over largest singular value: below, lights have no third direction
_ONE_PLACE = 1e-6  # of the distance from the world's origin: closer near lights are at one position
_SLACK = 0.97  # this fraction of a measured value counts as the value


@dataclass(frozen=True)
class Shortfall:
    """A lack of lights: its code, and a sentence with the measured figure."""

    code: str
    message: str


def no_normal(lights: Sequence[Light]) -> Shortfall | None:
    """Return the shortfall that makes normals impossible at all texels; None if there is none.

    Light directions in one plane do not determine the normal's component perpendicular to it. This is so at all points
    for distant lights of rank 2 and for near lights on one line.
    """
    if len(lights) < MIN_LIGHTS:
        what = f"has {len(lights)} light{'s' * (len(lights) != 1)}"
        return Shortfall("few", f"{what}; a normal needs at least three")
    rows = _projective(lights)
    different = len(np.unique(np.round(rows, 6), axis=0))
    if different < MIN_LIGHTS:
        what = f"has {len(lights)} images under {different} different light{'s' * (different > 1)}"
        return Shortfall("same", f"{what}; a normal needs at least three")
    values = np.linalg.svd(rows, compute_uv=False)
    if values[MIN_LIGHTS - 1] >= FLAT_USELESS * values[0]:
        return None
    what = "all lights lie in one plane through the subject" if lights[0].distant else "all lights are on one line"
    return Shortfall("coplanar", f"{what}, across which normals are undetermined; add lights off it")


def _projective(lights: Sequence[Light]) -> np.ndarray:
    """Return (K, 4) lights as points (p, w) of projective space, which a point t sees in the direction p − w t.

    Near ones are (x, y, z, 1) about their mean, in units of their spread; distant ones (x, y, z, 0).
    """
    rows = np.array([(*light.vector, 0.0 if light.distant else 1.0) for light in lights])
    near = rows[:, 3] > 0
    if near.any():
        positions = rows[near, :3]
        relative = positions - positions.mean(axis=0)
        spread = np.linalg.norm(relative, axis=1).max()
        rows[near, :3] = relative / spread if spread > _ONE_PLACE * np.linalg.norm(positions, axis=1).max() else 0.0
    return rows


def check_normal(source: str, lights: Sequence[Light]) -> None:
    """Raise CaptureError, naming the source, if lights cannot give a normal."""
    if lack := no_normal(lights):
        message = f"{source}: {lack.message}; or give the normals, and recover the rest"
        raise CaptureError(message, f"lights_{lack.code}")


def half_angle(directions: np.ndarray) -> float:
    """Return the half-angle in degrees of the cap that lights of unit directions (K, 3) cover evenly.

    On an even cap the cosine to its axis is uniform between 1 and the border's (Archimedes): its mean gives the angle.
    """
    total = np.linalg.norm(directions.sum(axis=0)) / len(directions)
    return float(np.degrees(np.arccos(np.clip(2 * total - 1, -1, 1))))


def spread_across(directions: np.ndarray) -> float:
    """Return the spread of unit directions (K, 3) perpendicular to their best-fitting plane over that in it: 0 to 1."""
    values = np.linalg.svd(directions, compute_uv=False)
    return float(values[2] / values[1]) if len(values) == 3 and values[1] > 0 else 0.0


def shortfalls(goal: str, count: int, directions: np.ndarray | None) -> Iterator[Shortfall]:
    """Yield the shortfalls of ``count`` lights for one of GOALS. directions: (K, 3) unit, or None for near lights."""
    index = GOALS.index(goal)
    if shortfall := _short(NUMBER, index, count):
        row, enough = shortfall
        test = _measured(row, index, "with {:g} lights, on a card with cast shadows and interreflection,")
        yield Shortfall("few", f"{count} lights are few for {goal}; take {enough:g} or more ({test})")
    if directions is None or len(directions) < 3:
        return
    angle = half_angle(directions)
    if shortfall := _short(CONE, index, angle):
        row, enough = shortfall
        yield Shortfall(
            "narrow",
            f"the lights lie within about {angle:.0f}° of their middle, which is narrow for {goal}; spread them over"
            f" {enough:g}° or more ({_measured(row, index, 'with 50 lights within {:g}°,')})",
        )
    across = spread_across(directions)
    if shortfall := _short(ACROSS, index, across):
        row, enough = shortfall
        yield Shortfall(
            "flat",
            f"the lights spread only {across:.2f} times as far one way as the other, which is little for {goal}; add"
            f" some off their plane, to {enough:g} or more ({_measured(row, index, 'with 50 lights at {:g} times,')})",
        )


def _measured(row: Figure | None, goal: int, lights: str) -> str:
    """Return the words of a measurement. lights: of the test, with a place for the value."""
    if row is None:
        return "we have not measured less"
    return f"in our test {lights.format(row.value)} {row.failed[goal]:.0%} of the texels failed"


def _short(figures: tuple[Figure, ...], goal: int, value: float) -> tuple[Figure | None, float] | None:
    """Return an insufficient figure, and the least sufficient value; None for a sufficient value.

    The figure is the next one below the value, or above it the least measured one; None where that is sufficient.
    """
    sufficient = [f.value for f in figures if f.failed[goal] <= FEW]
    # Sufficient values lie above all insufficient ones: fewer lights may succeed by chance.
    enough = min(v for v in sufficient if all(f.value < v for f in figures if f.failed[goal] > FEW))
    if value >= _SLACK * enough:
        return None
    nearest = [f for f in figures if f.value <= value][-1:] or [f for f in figures[:1] if f.failed[goal] > FEW]
    return nearest[0] if nearest else None, enough
