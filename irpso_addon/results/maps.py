"""``Maps``: the result of a recovery, as arrays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from ..core.udim import ONE_SQUARE, tile_part
from ..reflectance.model import ReflectanceModel

UNKNOWN = 0.25  # of a parameter's range: with a larger standard deviation it is unknown


class Cause(StrEnum):
    """Why a parameter of a texel is unknown; docs/reading_maps.md has the remedies."""

    LATER_ROUND = "later_round"  # a later round of interreflection searches it
    MOSTLY_INDIRECT = "mostly_indirect"  # most of the texel's light comes from the subject
    NOTHING_DETERMINED = "nothing_determined"  # no parameter is: few samples, or a hollow with unexplained light
    WIDE_DEVIATION = "wide_deviation"
    TWO_MODES = "two_modes"


@dataclass(frozen=True)
class Maps:
    """Recovered parameters of H×W texels, row 0 at the bottom.

    values: parameter name → (H, W, components) float32 in the parameter's own units; a normal is a unit vector in
    tangent space (mesh) or camera space (card). solved: (H, W) bool, the solved texels. residual: (H, W) mean
    absolute difference between render and reference over the weighted samples, in radiance, or None. confidence:
    parameter name → (H, W, components) standard deviation in the parameter's units, or None; a normal's is in radians,
    one component, at most π/2. tiles: the maps' UDIM tiles, side by side from the left. margin: (H, W) bool, texels
    past UV seams with the values of the seam's other side, or None. wrapped: whether the UV square may continue at its
    opposite border, as of a mesh unwrapped all around. alternatives: parameter name → (H, W, components), the deviance,
    −9 to 9, of materials far from the estimate in that number against the estimate (solver/state/alternatives.py);
    measured with the confidence, else None. two_modes: parameter name → (H, W) bool, solved texels whose material
    leaves that number open; {} before solver.modes.with_modes. unknown_texels: parameter name → cause → (H, W) bool,
    texels that are unknown whatever their estimate; their ``confidence`` is the widest (RecoveryEngine.unknown_texels).
    """

    model: ReflectanceModel
    values: dict[str, np.ndarray]
    solved: np.ndarray
    residual: np.ndarray | None = None
    confidence: dict[str, np.ndarray] | None = field(default=None)
    tiles: tuple[int, ...] = ONE_SQUARE
    margin: np.ndarray | None = None
    wrapped: bool = False
    alternatives: dict[str, np.ndarray] | None = None
    two_modes: dict[str, np.ndarray] = field(default_factory=dict)
    unknown_texels: dict[str, dict[Cause, np.ndarray]] = field(default_factory=dict)

    def unknown(self) -> dict[str, np.ndarray]:
        """Return, for normals and searched numbers, (H, W) bool: texels with wide ``confidence`` or two modes."""
        return {name: np.any(list(masks.values()), axis=0) for name, masks in self.unknown_by_cause().items()}

    def unknown_by_cause(self) -> dict[str, dict[Cause, np.ndarray]]:
        """Return the texels of ``unknown``, (H, W) bool by parameter and cause; of several causes the first counts."""
        if self.confidence is None:
            return {}
        widths = [(self.confidence[p.name][..., 0], np.float32(p.width)) for p in self.model.parameters]
        nothing = np.all([(sigma >= width) | (sigma == 0) for sigma, width in widths], axis=0)  # 0: fixed
        result: dict[str, dict[Cause, np.ndarray]] = {}
        for p, (sigma, _) in zip(self.model.parameters, widths, strict=True):
            if p.has_unknown:
                wide = sigma > UNKNOWN * p.width
                masks = self.unknown_texels.get(p.name, {}) | {
                    Cause.NOTHING_DETERMINED: nothing & wide, Cause.WIDE_DEVIATION: wide,
                    Cause.TWO_MODES: self.two_modes.get(p.name, np.zeros_like(wide)),
                }  # fmt: skip
                left, result[p.name] = self.solved, {}
                for cause, mask in masks.items():
                    result[p.name][cause], left = left & mask, left & ~mask
        return result


def split_maps(maps: Maps) -> Iterator[tuple[int, Maps]]:
    """Yield (number, maps) of each tile, as views."""
    count = len(maps.tiles)
    for index, number in enumerate(maps.tiles):

        def part(value: np.ndarray, index: int = index) -> np.ndarray:
            return value if np.ndim(value) < 2 else tile_part(np.asarray(value), index, count)

        yield (
            number,
            replace(
                maps,
                values={name: part(value) for name, value in maps.values.items()},
                solved=part(maps.solved),
                residual=None if maps.residual is None else part(maps.residual),
                confidence=maps.confidence and {name: part(value) for name, value in maps.confidence.items()},
                tiles=(number,),
                margin=None if maps.margin is None else part(maps.margin),
                alternatives=maps.alternatives and {name: part(value) for name, value in maps.alternatives.items()},
                two_modes={name: part(value) for name, value in maps.two_modes.items()},
                unknown_texels={
                    name: {cause: part(value) for cause, value in masks.items()}
                    for name, masks in maps.unknown_texels.items()
                },
            ),
        )
