"""The separation of direct and indirect light at each texel: named parts of one array."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...core.files import defined
from .packing import Packing

HARMONICS = int(defined("prefit/shadow_light.glsl")["HARMONICS"])  # spherical harmonics to order 2
SHADOW_LIGHT = HARMONICS + 3  # numbers of shadow_light.glsl: coefficients, red and green of a chroma, a share
# Part of a texel's scale. A sample whose direct light is below it counts as shadow.
SEPARATED_SHADOW = defined("common/frame.glsl", "SEPARATED_")["SHADOW"]

_FIRST, _SECOND, _SHARE, _HARMONICS = slice(2), slice(2, 4), 4, slice(5, 5 + HARMONICS)
_NUMBERS = 5 + HARMONICS


@dataclass(frozen=True, eq=False)
class Separation:
    """The indirect light of texels: by colour as two chromas, by shadows as a chroma and spherical harmonics.

    values: (…, 14) float32, also the layout in checkpoints; zeros where no light is separated. A chroma is its red and
    green.
    """

    values: np.ndarray

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> Separation:
        """Return a separation of no light."""
        return cls(np.zeros((*shape, _NUMBERS), np.float32))

    @classmethod
    def of_colours(cls, direct: np.ndarray, bounced: np.ndarray, share: np.ndarray) -> Separation:
        """Return a separation by colour. direct, bounced: chromas (…, 2). share: (…,) of indirect light."""
        result = cls.none(share.shape)
        result.values[..., _FIRST], result.values[..., _SECOND], result.values[..., _SHARE] = direct, bounced, share
        return result

    @classmethod
    def of_shadows(cls, output: np.ndarray) -> Separation:
        """Return a separation by shadows. output: (…, SHADOW_LIGHT) of shadow_light.glsl."""
        result = cls.none(output.shape[:-1])
        chroma, share = output[..., HARMONICS:-1], output[..., -1]
        result.values[..., _FIRST] = np.where(share[..., None] > 0, np.maximum(chroma, 1e-6), 0)
        result.values[..., _SHARE], result.values[..., _HARMONICS] = share, output[..., :HARMONICS]
        return result

    @property
    def separated(self) -> np.ndarray:
        """(…,) bool: where indirect light is separated."""
        return self.values[..., 0] > 0

    @property
    def by_colour(self) -> np.ndarray:
        """(…,) bool: where it is separated by colour."""
        return self.values[..., 2] > 0

    @property
    def direct_chroma(self) -> np.ndarray:
        """(…, 2), by colour: the chroma of the direct light."""
        return self.values[..., _FIRST]

    @property
    def bounced_chroma(self) -> np.ndarray:
        """(…, 2), by colour: the chroma of the light after one more bounce."""
        return self.values[..., _SECOND]

    @property
    def shadow_chroma(self) -> np.ndarray:
        """(…, 2), by shadows: the chroma of the indirect light, in the place of ``direct_chroma``."""
        return self.values[..., _FIRST]

    @cached_property
    def indirect_share(self) -> np.ndarray:
        """(…,) the indirect part of the texel's light."""
        return self.values[..., _SHARE]

    @property
    def harmonics(self) -> np.ndarray:
        """(…, HARMONICS), by shadows: coefficients of the indirect light (shadow_light.py)."""
        return self.values[..., _HARMONICS]

    def __getitem__(self, texels: Any) -> Separation:
        """Return the separation at some texels, as numpy indexes."""
        return Separation(self.values[texels])

    def __setitem__(self, texels: Any, other: Separation) -> None:
        self.values[texels] = other.values

    def any(self) -> bool:
        """Return whether any light is separated."""
        return bool(self.values.any())

    def equals(self, other: Separation) -> bool:
        """Return whether all numbers are equal."""
        return np.array_equal(self.values, other.values)

    def where(self, chosen: np.ndarray, other: Separation) -> Separation:
        """Return the separation at the ``chosen`` texels, (…,) bool, and the other one elsewhere."""
        return Separation(np.where(chosen[..., None], self.values, other.values))

    def packed(self, packing: Packing) -> Separation:
        """Return (h, w) of (H, W)."""
        return Separation(packing.pack(self.values))

    def unpacked(self, packing: Packing) -> Separation:
        """Return (H, W) of (h, w)."""
        return Separation(packing.unpack(self.values))
