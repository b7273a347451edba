"""What a set of lights is enough for: normals, the roughness of one lobe, two lobes. Judged by what was measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import CaptureError
from ..types import Light

GOALS = ("normals", "roughness", "two lobes")
FEW = 0.1  # of the texels may fail where lights are called enough


@dataclass(frozen=True)
class Figure:
    """A set of lights that was tried. value: of what was varied. failed: the part of the texels, for each of GOALS.

    A texel failed with a normal off by more than 5°, or a lobe's parameter by more than 10 % of its range.
    """

    value: float
    failed: tuple[float, float, float]


# docs/benchmarks/lights.md, of the preset standard; even lights down to 73° from the axis. On cards with 15 % cast
# shadow and 10 % interreflection, as photographs have them: the number of lights.
NUMBER = (
    Figure(3, (0.106, 0.673, 0.971)),
    Figure(5, (0.137, 0.592, 0.924)),
    Figure(10, (0.0, 0.354, 0.812)),
    Figure(20, (0.0, 0.092, 0.382)),
    Figure(50, (0.0, 0.054, 0.108)),
    Figure(100, (0.0, 0.033, 0.054)),
)
# On cards with noise alone, 50 lights: the degrees between their middle and the outermost,
CONE = (
    Figure(10, (0.024, 0.300, 0.789)),
    Figure(20, (0.0, 0.152, 0.368)),
    Figure(30, (0.0, 0.088, 0.172)),
    Figure(45, (0.0, 0.033, 0.040)),
)
# and how far they spread across the plane that they are nearest to, over how far along it.
ACROSS = (
    Figure(0.02, (0.017, 0.199, 0.409)),
    Figure(0.05, (0.0, 0.179, 0.342)),
    Figure(0.1, (0.0, 0.162, 0.292)),
    Figure(0.2, (0.0, 0.117, 0.215)),
    Figure(0.5, (0.0, 0.037, 0.063)),
)
FEWEST = 3  # lights of a normal
FLAT_USELESS = 1e-3  # smallest over largest singular value of lights below which they have no third direction
_ONE_PLACE = 1e-6  # of their distance from the world's origin: near lights that stand no further apart
# A set that misses a measured value by less than this is taken to reach it.
_SLACK = 0.97


@dataclass(frozen=True)
class Shortfall:
    """What lights lack for something: a short name, and a sentence with the measured figure."""

    code: str
    message: str


def no_normal(lights: Sequence[Light]) -> Shortfall | None:
    """Return why lights give a normal at no texel, whatever is photographed; None where they may.

    Seen from a point, lights whose directions lie in one plane leave the normal's part across that plane open.
    Distant lights do so everywhere where their directions have rank 2, near lights where they stand on one line.
    """
    if len(lights) < FEWEST:
        what = f"has {len(lights)} light{'s' * (len(lights) != 1)}"
        return Shortfall("few", f"{what}; a normal needs at least three")
    rows = _projective(lights)
    different = len(np.unique(np.round(rows, 6), axis=0))
    if different < FEWEST:
        what = f"has {len(lights)} images under {different} different light{'s' * (different > 1)}"
        return Shortfall("same", f"{what}; a normal needs at least three")
    values = np.linalg.svd(rows, compute_uv=False)
    if values[FEWEST - 1] >= FLAT_USELESS * values[0]:
        return None
    what = "all lights lie in one plane through the subject" if lights[0].distant else "all lights stand on one line"
    return Shortfall("coplanar", f"{what}, across which no normal can be told; add lights off it")


def _projective(lights: Sequence[Light]) -> np.ndarray:
    """Return (K, 4) lights as points of projective space: (x, y, z, 1) of near ones about their middle, in units of
    their spread, and (x, y, z, 0) of distant ones. From a point t light (p, w) is seen along p − w t.
    """
    rows = np.array([(*light.vector, 0.0 if light.distant else 1.0) for light in lights])
    near = rows[:, 3] > 0
    if near.any():
        places = rows[near, :3]
        about = places - places.mean(axis=0)
        spread = np.linalg.norm(about, axis=1).max()
        rows[near, :3] = about / spread if spread > _ONE_PLACE * np.linalg.norm(places, axis=1).max() else 0.0
    return rows


def check_normal(source: str, lights: Sequence[Light]) -> None:
    """Raise CaptureError, naming the source, where lights can give no normal."""
    if lack := no_normal(lights):
        message = f"{source}: {lack.message}; or give the normals, and recover the rest"
        raise CaptureError(message, f"lights_{lack.code}")


def half_angle(directions: np.ndarray) -> float:
    """Return the degrees between the middle and the border of an even cap of lights, from unit directions (K, 3).

    Over such a cap the cosine to the middle is even between 1 and its border's (Archimedes), so that its mean tells.
    """
    total = np.linalg.norm(directions.sum(axis=0)) / len(directions)
    return float(np.degrees(np.arccos(np.clip(2 * total - 1, -1, 1))))


def spread_across(directions: np.ndarray) -> float:
    """Return how far unit directions (K, 3) spread across the plane that they are nearest to, over along it: 0 to 1."""
    values = np.linalg.svd(directions, compute_uv=False)
    return float(values[2] / values[1]) if len(values) == 3 and values[1] > 0 else 0.0


def shortfalls(goal: str, count: int, directions: np.ndarray | None) -> Iterator[Shortfall]:
    """Yield what ``count`` lights lack for one of GOALS. directions: (K, 3) unit, or None where lights are near."""
    at = GOALS.index(goal)
    if found := _short(NUMBER, at, count):
        row, enough = found
        yield Shortfall(
            "few",
            f"{count} lights are few for {goal}: with {row.value:g}, {row.failed[at]:.0%} of the texels failed on a"
            f" card with cast shadows and interreflection; take {enough:g} or more",
        )
    if directions is None or len(directions) < 3:
        return
    angle = half_angle(directions)
    if found := _short(CONE, at, angle):
        row, enough = found
        yield Shortfall(
            "narrow",
            f"the lights lie within about {angle:.0f}° of their middle, which is narrow for {goal}: of 50 lights within"
            f" {row.value:g}° {row.failed[at]:.0%} of the texels failed; spread them over {enough:g}° or more",
        )
    across = spread_across(directions)
    if found := _short(ACROSS, at, across):
        row, enough = found
        yield Shortfall(
            "flat",
            f"the lights spread only {across:.2f} times as far one way as the other, which is little for {goal}: of 50"
            f" lights with {row.value:g} {row.failed[at]:.0%} of the texels failed; add some off their plane, to"
            f" {enough:g} or more",
        )


def _short(figures: tuple[Figure, ...], at: int, value: float) -> tuple[Figure, float] | None:
    """Return the next figure below a value that is not enough, and the least that is; None for one that is."""
    good = [f.value for f in figures if f.failed[at] <= FEW]
    # Fewer may do by chance what more do not: enough begins above all that are not.
    enough = min(v for v in good if all(f.value < v for f in figures if f.failed[at] > FEW))
    if value >= _SLACK * enough:
        return None
    below = [f for f in figures if f.value <= value]
    return below[-1] if below else figures[0], enough
