"""Measurements of the prefits, and of the phases between them, for later phases."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...core.optional import present
from .separation_record import SEPARATED_SHADOW, Separation

# Arrays in checkpoints: field → name.
_ARRAYS = {
    field: f"prefit_{field}"
    for field in ("fitness", "indirect_misfit", "sheen", "sheen_chosen", "shadow", "separation")
}
FLAT_ARRAYS = frozenset(_ARRAYS[field] for field in ("fitness", "sheen_chosen", "shadow"))  # without channels


@dataclass(frozen=True, eq=False)
class PrefitMeasurements:
    """Packed measurements; None where not made yet, or replaced by a later one.

    fitness: (h, w) of the normals' prefit. indirect_misfit: (h, w, 4) of prefit/indirect_misfit.glsl. sheen: (h, w, 4)
    normal and fitness of the prefit with sheen. sheen_chosen: (h, w) float32, above 0 where that prefit is chosen.
    shadow: (h, w) raised shadow threshold, 0 where the light is not indirect. separation: (h, w) of indirect light.
    """

    fitness: np.ndarray | None = None
    indirect_misfit: np.ndarray | None = None
    sheen: np.ndarray | None = None
    sheen_chosen: np.ndarray | None = None
    shadow: np.ndarray | None = None
    separation: Separation | None = None

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray]) -> PrefitMeasurements:
        """Return the measurements among a checkpoint's arrays."""
        found = {field: arrays[name] for field, name in _ARRAYS.items() if name in arrays}
        separation = found.pop("separation", None)
        return cls(**found, separation=None if separation is None else Separation(separation))

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The measurements by their names in a checkpoint."""
        values = {field: getattr(self, field) for field in _ARRAYS}
        values["separation"] = self.separation and self.separation.values
        return {_ARRAYS[field]: value for field, value in values.items() if value is not None}

    @property
    def shadow_threshold(self) -> np.ndarray | float:
        """(h, w), or 0: the part of a texel's scale below which samples count as shadow, because of indirect light."""
        raised = 0.0 if self.shadow is None else self.shadow
        if self.separation is None:
            return raised
        return np.maximum(raised, np.where(self.separation.separated, SEPARATED_SHADOW, 0))

    @property
    def sheen_normal(self) -> np.ndarray:
        """(h, w, 3) of the prefit with sheen."""
        return present(self.sheen)[..., :3]

    @property
    def sheen_fitness(self) -> np.ndarray:
        """(h, w) of the prefit with sheen."""
        return present(self.sheen)[..., 3]
